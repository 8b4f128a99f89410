"""Agents over all tasks of a suite: normalised scores, or money where there is no scale, with aggregates and tiers.

A normalised score is 0 for the mean of the agent that the scale of the task names, and 1 for the best known runs. If these are no plans, 1
is what some ranked agent scores itself. So where all tasks score money and some have no plans, tables show money: the mean score, and
the difference to the tuned rules.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from pydantic import Field

from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard import statistics
from glbench.leaderboard.collect import Expectation, Origin, StoredResult
from glbench.leaderboard.entries import Entry, entries_by_task, metric_of, of_one_version, resolution_of
from glbench.leaderboard.ranking import Row, TaskTable, combined, in_money
from glbench.leaderboard.regret import PENALTY, best_runs
from glbench.leaderboard.violations import AtPrice, Turn, at_prices, frontier, ranks_of, turns_of
from glbench.quantities import MONEY
from glbench.tasks import list_suites, published_task
from glbench.tasks.references import SEVERAL, BestKnown, References, read_best_known, read_references

ZERO_TRAININGS = 5  # Fewest trainings of a trained agent whose mean is the zero of a task

RULES = "rule_based_tuned"  # Name of the agent that suites show the difference to

_THRESHOLDS = 101
_LOWEST_THRESHOLD = -0.25  # Profiles begin here at the lowest: how far below doing nothing a failed run lies is not worth the room


class SuiteFigures(statistics.FrozenModel):
    """What an agent earned, grew and used over a suite: means over the tasks, in the units that ``units`` names."""

    metrics: dict[str, float]
    failed: int = Field(serialization_alias="failed_runs")
    decision_milliseconds: float = Field(serialization_alias="decision_ms")
    training_steps: int | None = Field(description="of the task with the longest training; null when not stated")
    privileged: bool
    information: str
    sandbox: str
    reproduced: bool = Field(description="whether all of its results were reproduced")
    origin: Origin = Field(description="released when all of its results are")
    runs: int = Field(exclude=True)

    @property
    def means(self) -> dict[str, float]:
        """As ``metrics``."""
        return self.metrics


class Money(statistics.FrozenModel):
    """An agent over a suite whose tasks all score money, at their prices, over the tasks that it has."""

    rank: int | None = Field(description="by the mean; null where it lacks tasks")
    mean: statistics.Interval = Field(description="mean over the tasks of its score [EUR m-2]")
    against_rules: statistics.Interval | None = Field(
        default=None,
        description=f"mean over the tasks of its score minus that of {RULES}, paired by run [EUR m-2]; null if {RULES} lacks tasks of "
        "the suite",
    )
    reversal: float | None = Field(default=None, description="as of a row, of the order by the mean score in money")


class SuiteRow(statistics.FrozenModel):
    """One agent over a suite, in normalised scores: 0 is the agent that the scale names, 1 the best known result of each task."""

    rank: int | None = Field(description="by the mean normalised score; by the mean score in money if the suite has no scale")
    agent: str
    iqm: statistics.Interval | None
    mean: statistics.Interval | None = Field(
        description="as the other normalised scores null if a task has no scale, or no best known plans yet"
    )
    median: statistics.Interval | None
    optimality_gap: statistics.Interval | None
    reversal: float | None = Field(
        default=None,
        description="probability that it is truly better than the ranked row above it: half the p-value of their paired test; null for the "
        "first, and where not ranked",
    )
    regret: statistics.Interval | None = Field(
        default=None,
        description="mean over the tasks of the mean regret to the best known runs [EUR m-2]; null where it lacks tasks, or a task has "
        "no best known runs or counts no money",
    )
    against_rules: statistics.Interval | None = Field(
        default=None,
        description=f"mean over the tasks of its score minus that of {RULES}, paired by run [EUR m-2]; null if one of the two lacks "
        "tasks, or a task has no best known runs or does not score money",
    )
    money: Money | None = Field(default=None, description="null where a task does not score money")
    at_prices: tuple[AtPrice, ...] = Field(
        default=(), description="rank and mean in money at multiples of the price of violations; empty where it lacks tasks"
    )
    frontier: bool | None = Field(
        default=None, description="as of a row of a task, of the means over the tasks; null where it is privileged or lacks tasks"
    )
    trainings: tuple[int, int] = Field(description="fewest and most trainings on a task")
    missing: tuple[str, ...] = Field(serialization_alias="missing_tasks")
    figures: SuiteFigures | None = None
    tasks: int = Field(exclude=True)
    runs: int = Field(exclude=True)


class Improvement(statistics.FrozenModel):
    """Probability that ``first`` scores above ``second`` in the same run, averaged over the tasks, ties half, with its interval."""

    first: str
    second: str
    probability: statistics.Interval


class SuiteTable(statistics.FrozenModel):
    """One suite and all agents on it, best first by mean normalised score; agents that lack tasks last."""

    suite: str = Field(serialization_alias="name")
    tasks: tuple[str, ...]
    zero: tuple[str, ...] = Field(default=(), description="agents whose mean is 0 on a task; empty if a task has no scale")
    scale_versions: dict[str, int] = Field(default={}, description="version of the scale of each task that has one")
    without_plans: tuple[str, ...] = Field(
        default=(), description="tasks on which no plans are known for all runs: 1 is there what some ranked agent scores itself"
    )
    turns: tuple[Turn, ...] = Field(
        default=(), description="agents of different ranks in money that change places between half and double the price of violations"
    )
    rows: tuple[SuiteRow, ...]
    improvements: tuple[Improvement, ...] = ()
    profiles: tuple[statistics.Profile, ...] = ()

    @property
    def in_money(self) -> bool:
        """Whether it is shown in money, because it scores money and some of its tasks have no plans to measure by."""
        return bool(self.without_plans) and any(row.money is not None for row in self.rows)

    @property
    def shown_rows(self) -> list[SuiteRow]:
        """The rows in the order of what is shown; agents that lack tasks last."""
        if not self.in_money:
            return list(self.rows)

        def place(row: SuiteRow) -> tuple[float, str]:
            return (math.inf, "") if row.money is None or row.money.rank is None else (-row.money.mean.value, row.agent)

        return sorted(self.rows, key=place)


def scores_by_task(
    stored: Iterable[StoredResult], expected: Mapping[str, Expectation], metric: str | None = None
) -> dict[str, dict[str, statistics.Array]]:
    """What ranks of complete entries of published tasks ``(trainings, n)``, by task id and entry, in the order of the task's seeds.

    ``metric`` is another metric in its place, of the entries that state it. A training with one seed is in the same row of all tasks, as
    far as their numbers of trainings allow it.
    """
    complete = {
        task_id: {entry.name: entry for entry in entries if entry.complete and entry.states(metric_of(task_id, expected))}
        for task_id, entries in of_one_version(entries_by_task(stored, expected)).items()
        if task_id in expected
    }
    trained: dict[str, dict[str, tuple[int, ...]]] = {}
    for task_id, entries in complete.items():
        for name, entry in entries.items():
            if len(entry.training_seeds) > 1:
                trained.setdefault(name, {})[task_id] = entry.training_seeds
    orders = {name: _same_rows(by_task) for name, by_task in trained.items()}
    return {
        task_id: {
            name: entry.by_training(metric or metric_of(task_id, expected))[orders.get(name, {}).get(task_id, slice(None))]
            for name, entry in entries.items()
            if metric is None or entry.states(metric)
        }
        for task_id, entries in complete.items()
        if entries
    }


def _same_rows(by_task: Mapping[str, Sequence[int]]) -> dict[str, list[int]]:
    """For each task the order of its trainings in which one seed has the same row in all tasks that have it, where that is possible.

    ``by_task`` has the seeds of the trainings, different within a task. Seeds that most tasks have are placed first.
    """
    rows: dict[str, list[int | None]] = {task: [None] * len(seeds) for task, seeds in by_task.items()}
    having = {seed: [task for task, seeds in by_task.items() if seed in seeds] for seeds in by_task.values() for seed in seeds}
    for seed, tasks in sorted(having.items(), key=lambda item: (-len(item[1]), item[0])):
        free = set[int].intersection(*({i for i, one in enumerate(rows[task]) if one is None} for task in tasks))
        for task in tasks:
            rows[task][min(free) if free else rows[task].index(None)] = by_task[task].index(seed)
    return {task: [one for one in order if one is not None] for task, order in rows.items()}


def suite_table(
    suite: str,
    tasks: tuple[str, ...],
    scores: Mapping[str, Mapping[str, statistics.Array]],
    references: Mapping[str, References],
    tables: Sequence[TaskTable] = (),
    best_known: Mapping[str, BestKnown] | None = None,
    scenarios: Mapping[str, Sequence[Hashable]] | None = None,
    penalties: Mapping[str, Mapping[str, statistics.Array]] | None = None,
) -> SuiteTable | None:
    """Aggregates of every agent over the tasks of a suite.

    Parameters
    ----------
    suite, tasks
        Name, and ids of its tasks.
    scores
        Rewards by task and entry, ``(n,)`` or ``(trainings, n)``, see ``scores_by_task``.
    references
        Zero and one of each task's normalised score. If all tasks score money, some may lack it: then no score is normalised.
    tables
        Ranked rows of the tasks, for what agents earned, grew and used, and in which unit.
    best_known
        Best known runs of the tasks, with the seeds of ``scores`` in their order, for regrets.
    scenarios
        For each task, a name for each run; runs of different tasks with the same name have the same draws. ``None``: all draws differ.
    penalties
        Penalties as ``scores``, for orders at other prices of violations.

    Returns
    -------
    SuiteTable or None
        ``None`` when no task of the suite has both results and references, and not all score money.
    """
    of_task = {table.task_id: table for table in tables}
    usable = tuple(task for task in tasks if task in scores)
    money = bool(usable) and all(task in of_task and _scores_money(of_task[task]) for task in usable)
    ends = {task: both for task in usable if task in references and (both := references[task].ends) is not None}
    if not money:
        usable = tuple(ends)
    if not usable:
        return None
    scaled = len(ends) == len(usable)
    by_agent: dict[str, dict[str, statistics.Array]] = {}
    for task in usable:
        for agent, rewards in scores[task].items():
            values = statistics.normalise(rewards, *ends[task]) if scaled else rewards
            by_agent.setdefault(agent, {})[task] = values
    whole = {agent: by_task for agent, by_task in by_agent.items() if len(by_task) == len(usable)}
    smallest = [resolution_of(of_task[task].metric, of_task[task].task) if task in of_task else statistics.RESOLUTION for task in usable]
    spans = [ends[task][1] - ends[task][0] if scaled else 1.0 for task in usable]
    resolutions = [resolution / span for resolution, span in zip(smallest, spans, strict=True)]
    names = None if scenarios is None else [scenarios[task] for task in usable]
    rows_of: dict[str, list[Row]] = {}
    for row in (row for table in tables if table.task_id in usable for row in table.rows if row.rank is not None):
        rows_of.setdefault(row.agent, []).append(row)
    fixed = {agent for agent, rows in rows_of.items() if not any(row.training_steps for row in rows)}
    values_of = {agent: [by_task[task] for task in usable] for agent, by_task in whole.items()}
    order = statistics.tiers(values_of, resolutions, names, fixed)
    ranks, ordered = ranks_of(order), [agent for tier in order for agent in tier]
    reversals = statistics.reversals(ordered, values_of, resolutions, names, fixed)
    more = _in_money(usable, scores, best_known or {}, names, fixed)
    turns: tuple[Turn, ...] = ()
    if money:
        turns = _add_money(more, usable, scores, penalties or {}, scenarios, fixed)
    rows = [
        _row(agent, ranks.get(agent), by_agent[agent], usable, rows_of.get(agent, ()), scenarios, scaled=scaled, **more.get(agent, {}))
        for agent in (*ordered, *sorted(set(by_agent) - set(whole)))
    ]
    unbeaten = frontier({row.agent: row.figures.means for row in rows if row.at_prices and row.figures and not row.figures.privileged})
    rows = [row.model_copy(update={"reversal": reversals.get(row.agent), "frontier": unbeaten.get(row.agent)}) for row in rows]
    improvements = []
    for first, other in combinations(ordered, 2):
        p = statistics.probability_of_improvement(whole[first], whole[other], scenarios)
        # What one has above the other is what the other has below it.
        back = statistics.Interval(value=1.0 - p.value, low=1.0 - p.high, high=1.0 - p.low)
        improvements.append(Improvement(first=first, second=other, probability=p))
        improvements.append(Improvement(first=other, second=first, probability=back))
    return SuiteTable(
        suite=suite,
        tasks=usable,
        zero=tuple(sorted({references[task].zero_agent for task in ends})) if scaled else (),
        scale_versions={task: references[task].version for task in usable if task in ends},
        without_plans=tuple(task for task in usable if task not in ends or not references[task].plans),
        turns=turns,
        rows=tuple(rows),
        improvements=tuple(improvements),
        profiles=_profiles(whole, usable) if scaled else (),
    )


def _scores_money(table: TaskTable) -> bool:
    """Whether the ranked rows of a task state a score in money."""
    ranked = [row for row in table.rows if row.rank is not None]
    return table.metric == RANKING_METRIC and bool(ranked) and all(map(in_money, ranked))


def suite_tables(
    stored: Sequence[StoredResult], expected: Mapping[str, Expectation], tables: Sequence[TaskTable]
) -> tuple[SuiteTable, ...]:
    """Tables of all published suites that have results, and references or scores in money."""
    scores, references = scores_by_task(stored, expected), read_references()
    best_known = {
        task_id: best
        for task_id in scores
        if (best := read_best_known(task_id)) is not None
        and (best.task_digest, best.seeds, RANKING_METRIC) == (expected[task_id].digest, expected[task_id].seeds, expected[task_id].metric)
    }
    names = {task_id: scenario_names(task_id, expected[task_id].seeds) for task_id in scores}
    penalties = scores_by_task(stored, expected, PENALTY)
    suites = [
        suite_table(name, tuple(ids), scores, references, tables, best_known, names, penalties) for name, ids in list_suites().items()
    ]
    return tuple(table for table in suites if table is not None)


def scenario_names(task_id: str, seeds: Sequence[int]) -> list[tuple[Hashable, ...]]:
    """A name for each run of a published task: runs with one seed in tasks of one family and salt have the same season and crop."""
    scenario = published_task(task_id).scored.scenario
    family = (task_id,) if scenario.legacy else (scenario.family, scenario.salt)
    return [(*family, seed) for seed in seeds]


def _row(
    agent: str,
    rank: int | None,
    scores: Mapping[str, statistics.Array],
    tasks: Sequence[str],
    table_rows: Sequence[Row],
    scenarios: Mapping[str, Sequence[Hashable]] | None,
    *,
    scaled: bool,
    **more: Any,
) -> SuiteRow:
    arrays = [scores[task] for task in tasks if task in scores]
    names = None if scenarios is None else [scenarios[task] for task in tasks if task in scores]
    counts = [len(np.atleast_2d(runs)) for runs in arrays]
    rows = [row for row in table_rows if row.task_id in scores]
    names_of_all = [name for name in rows[0].means if all(name in row.means for row in rows)] if rows else []
    means = {name: float(np.mean([row.means[name] for row in rows])) for name in names_of_all}
    more |= {score: statistics.aggregate(arrays, score, names) if scaled else None for score in statistics.SCORES}
    return SuiteRow(
        rank=rank,
        agent=agent,
        **more,
        trainings=(min(counts), max(counts)),
        missing=tuple(task for task in tasks if task not in scores),
        figures=SuiteFigures(metrics=means, **combined(rows)) if rows else None,
        tasks=len(arrays),
        runs=sum(runs.size for runs in arrays),
    )


def _in_money(
    tasks: Sequence[str],
    scores: Mapping[str, Mapping[str, statistics.Array]],
    best_known: Mapping[str, BestKnown],
    scenarios: Sequence[Sequence[Hashable]] | None,
    fixed: Collection[str],
) -> dict[str, dict[str, Any]]:
    """For agents with all tasks, if all tasks score money: mean regret, and mean score minus that of the tuned rules."""
    if any(task not in best_known or best_known[task].units["reward"] != MONEY for task in tasks):
        return {}
    best = [np.array([run.reward for run in best_known[task].runs]) for task in tasks]
    everywhere = set[str].intersection(*(set(scores[task]) for task in tasks))
    intervals: dict[str, dict[str, Any]] = {}
    for agent in everywhere:
        own = [scores[task][agent] for task in tasks]
        gaps = [top - values for top, values in zip(best, own, strict=True)]
        intervals[agent] = {"regret": statistics.aggregate(gaps, "mean", scenarios)}
        if RULES in everywhere - {agent}:
            rules = [scores[task][RULES] for task in tasks]
            intervals[agent]["against_rules"] = statistics.estimate_difference(
                own, rules, scenarios, (agent in fixed, RULES in fixed)
            ).interval()
    return intervals


def _add_money(
    rows: dict[str, dict[str, Any]],
    tasks: Sequence[str],
    scores: Mapping[str, Mapping[str, statistics.Array]],
    penalties: Mapping[str, Mapping[str, statistics.Array]],
    scenarios: Mapping[str, Sequence[Hashable]] | None,
    fixed: Collection[str],
) -> tuple[Turn, ...]:
    """Add to ``rows`` each agent's money over the tasks that it has and, if it has all, its places at prices; return who changes places."""
    having = {agent: [task for task in tasks if agent in scores[task]] for task in tasks for agent in scores[task]}
    names = {agent: None if scenarios is None else [scenarios[task] for task in of_agent] for agent, of_agent in having.items()}
    values = {agent: [scores[task][agent] for task in of_agent] for agent, of_agent in having.items()}
    whole = {agent: values[agent] for agent, of_agent in having.items() if len(of_agent) == len(tasks)}
    exact, every = [0.0] * len(tasks), None if scenarios is None else [scenarios[task] for task in tasks]
    order = statistics.tiers(whole, exact, every, fixed)
    ranks = ranks_of(order)
    reversals = statistics.reversals([agent for tier in order for agent in tier], whole, exact, every, fixed)
    for agent, of_agent in having.items():
        against = None
        if RULES in set(whole) - {agent}:
            rules = [scores[task][RULES] for task in of_agent]
            against = statistics.estimate_difference(values[agent], rules, names[agent], (agent in fixed, RULES in fixed)).interval()
        rows.setdefault(agent, {})["money"] = Money(
            rank=ranks.get(agent),
            mean=statistics.aggregate(values[agent], "mean", names[agent]),
            against_rules=against,
            reversal=reversals.get(agent),
        )
    if not all(agent in penalties.get(task, {}) for task in tasks for agent in whole):
        return ()
    costs = {agent: [penalties[task][agent] for task in tasks] for agent in whole}
    for agent, places in at_prices(whole, costs, order, every, fixed).items():
        rows[agent]["at_prices"] = places
    return turns_of(whole, costs, ranks)


def _profiles(whole: Mapping[str, Mapping[str, statistics.Array]], tasks: Sequence[str]) -> tuple[statistics.Profile, ...]:
    """Profiles over thresholds from the lowest score that matters to a little above the best."""
    if not whole:
        return ()
    lists = {agent: [by_task[task].ravel() for task in tasks] for agent, by_task in whole.items()}
    every = np.concatenate([runs for each in lists.values() for runs in each])
    low, high = max(_LOWEST_THRESHOLD, min(0.0, float(every.min()))), max(1.0, float(every.max()))
    margin = 0.02 * (high - low)
    even = np.linspace(low - margin, high + margin, _THRESHOLDS)
    # As many again where the runs are, so that agents that lie close together keep their shape.
    dense = np.quantile(every[every >= low], np.linspace(0.0, 1.0, _THRESHOLDS))
    thresholds = np.unique(np.round(np.concatenate([even, dense]), 4))
    return tuple(statistics.performance_profile(agent, each, thresholds) for agent, each in lists.items())


def references_from(
    stored: Iterable[StoredResult],
    expected: Mapping[str, Expectation],
    known: Mapping[str, References],
    zero_agent: str,
    renewed: Collection[str] = (),
) -> dict[str, References]:
    """References of published tasks, in the metric that ranks, from complete results.

    A task in ``known`` keeps its zero, unless it is in ``renewed``. Otherwise zero is the mean of ``zero_agent``; without results of it, or
    with fewer than ``ZERO_TRAININGS`` trainings of an agent that was trained, the task has no references. One is the mean of the best known
    runs of all seeds, whichever agents they are of, if plans made them, or if one was stored before.
    """
    items = tuple(stored)
    entries, references = entries_by_task(items, expected), {}
    for task_id, runs in best_runs(items, expected).items():
        metric, owners = metric_of(task_id, expected), {one.agent.name: one.results_digest for one, _ in runs}
        old = known.get(task_id)
        kept = None if task_id in renewed else old
        zero = _zero_from(entries[task_id], zero_agent, metric) if kept is None else kept.model_dump(include=set(_ZERO))
        best, plans = float(np.mean([run.metrics[metric] for _, run in runs])), all(one.agent.privileged for one, _ in runs)
        if zero is None or best <= zero["zero"]:
            continue
        if plans or (kept is not None and kept.best is not None):
            owner = next(iter(owners)) if len(owners) == 1 else SEVERAL
            zero |= {"best": best, "best_agent": owner, "best_results_digest": " ".join(owners[name] for name in sorted(owners))}
        one = References(plans=plans, **zero)
        moved = old is not None and (one.zero, one.best) != (old.zero, old.best)
        references[task_id] = one.model_copy(update={"version": 1 if old is None else old.version + moved})
    return references


_ZERO = ("zero", "zero_agent", "zero_results_digest")


def _zero_from(entries: Iterable[Entry], agent: str, metric: str) -> dict[str, Any] | None:
    """Zero of a task by the mean of an agent, of several trainings over all of them; ``None`` where it lacks results."""
    entry = next((one for one in entries if one.name == agent and one.complete and one.states(metric)), None)
    if entry is None or ((entry.training_seeds or not entry.is_fixed) and len(entry.trainings) < ZERO_TRAININGS):
        return None
    digests = " ".join(item.result.results_digest for item in entry.trainings)
    return dict(zip(_ZERO, (float(entry.by_training(metric).mean()), agent, digests), strict=True))
