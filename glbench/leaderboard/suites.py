"""Agents over all tasks of a suite: normalised scores with aggregates and tiers.

Without plans on a task, 1 is what some ranked agent scores itself. So where all tasks score money and some have no plans, money is shown.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from pydantic import Field

from glbench.evaluation import Result
from glbench.evaluation.records import RANKING_METRIC, RunResult
from glbench.leaderboard import statistics
from glbench.leaderboard.collect import Expectation, Origin, StoredResult
from glbench.leaderboard.entries import Entry, entries_by_task, metric_of, of_one_version, resolution_of
from glbench.leaderboard.ranking import Row, TaskTable, combined, scores_money
from glbench.leaderboard.regret import PENALTY, best_runs
from glbench.leaderboard.violations import AtPrice, Turn, at_prices, ranks_of
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
    """An agent over a suite whose tasks all score money, over the tasks that it has."""

    rank: int | None = Field(description="by the mean; null where it lacks tasks")
    mean: statistics.Interval = Field(description="mean over the tasks of its score [EUR m-2]")
    against_rules: statistics.Interval | None = Field(description=f"its mean minus that of {RULES} [EUR m-2]; null if that one lacks tasks")
    reversal: float | None = Field(description="as that of the row, by the mean score in money")


class SuiteRow(statistics.FrozenModel):
    """One agent over a suite, in normalised scores: 0 is the agent that the scale names, 1 the best known result of each task."""

    rank: int | None = Field(description="by the mean normalised score; by the mean score in money if the suite has no scale")
    agent: str
    iqm: statistics.Interval | None
    mean: statistics.Interval | None = Field(description="null, as the other normalised scores, if a task has no scale")
    median: statistics.Interval | None
    optimality_gap: statistics.Interval | None
    reversal: float | None = Field(default=None, description="as of a row of a task")
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
    at_prices: tuple[AtPrice, ...] = Field(default=(), description="as of a row of a task, over the tasks; empty where it lacks tasks")
    frontier: bool | None = Field(default=None, description="as of a row of a task, of the means over the tasks")
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
    without_plans: tuple[str, ...] = Field(default=(), description="tasks without plans for all runs, where 1 is an agent's own score")
    turns: tuple[Turn, ...] = Field(default=(), description="as of a task, by ranks in money")
    rows: tuple[SuiteRow, ...]
    improvements: tuple[Improvement, ...] = ()
    profiles: tuple[statistics.Profile, ...] = ()

    @property
    def in_money(self) -> bool:
        """Whether it is shown in money, because it scores money and some of its tasks have no plans to measure by."""
        return bool(self.without_plans) and any(row.money is not None for row in self.rows)

    @property
    def shown_rows(self) -> list[SuiteRow]:
        """The rows as they are shown: in money with its ranks and no normalised score or regret, agents that lack tasks last."""
        if not self.in_money:
            return list(self.rows)
        none = dict.fromkeys((*statistics.SCORES, "regret"))
        rows = [row.model_copy(update=none | dict(row.money)) for row in self.rows if row.money is not None]
        return sorted(rows, key=lambda row: (row.rank is None, 0.0 if row.rank is None or row.mean is None else -row.mean.value))


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

    ``tasks`` are the ids of its tasks; ``scores`` rewards by task and entry, ``(n,)`` or ``(trainings, n)``, see ``scores_by_task``, and
    ``penalties`` as these, for ranks at other prices of violations. ``references`` are zero and one of each task's normalised score; if all
    tasks score money, some may lack it: then no score is normalised. ``tables`` are ranked rows of the tasks, for what agents earned, grew
    and used, and in which unit. ``best_known`` are the best known runs of the tasks, with the seeds of ``scores`` in their order, for
    regrets. ``scenarios`` has for each task a name for each run; runs of different tasks with the same name have the same draws. ``None``:
    all draws differ. Returns ``None`` when no task of the suite has both results and references, and not all score money.
    """
    of_task = {table.task_id: table for table in tables}
    usable = tuple(task for task in tasks if task in scores)
    money = bool(usable) and all(
        best_known[task].units["reward"] == MONEY if best_known and task in best_known
        else task in of_task and scores_money(of_task[task].metric, [row for row in of_task[task].rows if row.rank is not None])
        for task in usable
    )  # fmt: skip
    ends = {task: both for task in usable if task in references and (both := references[task].ends) is not None}
    if not money:
        usable = tuple(ends)
    if not usable:
        return None
    scaled = len(ends) == len(usable)
    by_agent: dict[str, dict[str, statistics.Array]] = {}
    for task in usable:
        for agent, rewards in scores[task].items():
            by_agent.setdefault(agent, {})[task] = statistics.normalise(rewards, *ends[task]) if scaled else rewards
    whole = {agent: by_task for agent, by_task in by_agent.items() if len(by_task) == len(usable)}
    resolutions = [
        (resolution_of(of_task[task].metric, of_task[task].task, of_task[task].units) if task in of_task else statistics.RESOLUTION)
        / (ends[task][1] - ends[task][0] if scaled else 1.0)
        for task in usable
    ]
    names = None if scenarios is None else [scenarios[task] for task in usable]
    rows_of: dict[str, list[Row]] = {}
    for row in (row for table in tables if table.task_id in usable for row in table.rows if row.rank is not None):
        rows_of.setdefault(row.agent, []).append(row)
    fixed = {agent for agent, rows in rows_of.items() if not any(row.training_steps for row in rows)}
    values = {agent: [by_task[task] for task in usable] for agent, by_task in whole.items()}
    order = statistics.tiers(values, resolutions, names, fixed)
    ranks, ordered = ranks_of(order), [agent for tier in order for agent in tier]
    reversals = statistics.reversals(ordered, values, resolutions, names, fixed)
    more: dict[str, dict[str, Any]] = {}
    turns: tuple[Turn, ...] = ()
    if money:
        privileged = {agent for agent, rows in rows_of.items() if any(row.privileged for row in rows)}
        more, turns = _in_money(usable, scores, penalties or {task: {} for task in usable}, best_known or {}, scenarios, fixed, privileged)
    rows = [
        _row(agent, ranks.get(agent), by_agent[agent], usable, rows_of.get(agent, ()), scenarios, scaled=scaled,
             reversal=reversals.get(agent), **more.get(agent, {}))
        for agent in (*ordered, *sorted(set(by_agent) - set(whole)))
    ]  # fmt: skip
    improvements = []
    for first, other in combinations(ordered, 2):
        p = statistics.probability_of_improvement(whole[first], whole[other], scenarios)
        # What one has above the other is what the other has below it.
        back = statistics.Interval(value=1.0 - p.value, low=1.0 - p.high, high=1.0 - p.low)
        improvements.append(Improvement(first=first, second=other, probability=p))
        improvements.append(Improvement(first=other, second=first, probability=back))
    return SuiteTable(
        suite=suite, tasks=usable, rows=tuple(rows), turns=turns, improvements=tuple(improvements),
        zero=tuple(sorted({references[task].zero_agent for task in ends})) if scaled else (),
        scale_versions={task: references[task].version for task in usable if task in ends},
        without_plans=tuple(task for task in usable if task not in ends or not references[task].plans),
        profiles=_profiles(whole, usable) if scaled else (),
    )  # fmt: skip


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
    others = references, tables, best_known, names, scores_by_task(stored, expected, PENALTY)
    suites = [suite_table(name, tuple(ids), scores, *others) for name, ids in list_suites().items()]
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
    penalties: Mapping[str, Mapping[str, statistics.Array]],
    best_known: Mapping[str, BestKnown],
    scenarios: Mapping[str, Sequence[Hashable]] | None,
    fixed: Collection[str],
    privileged: Collection[str],
) -> tuple[dict[str, dict[str, Any]], tuple[Turn, ...]]:
    """Of each agent its money over the tasks that it has and, if it has all, regret and places at other prices; and who changes places."""
    having = {agent: [task for task in tasks if agent in scores[task]] for task in tasks for agent in scores[task]}
    names = {agent: None if scenarios is None else [scenarios[task] for task in of_agent] for agent, of_agent in having.items()}
    values = {agent: [scores[task][agent] for task in of_agent] for agent, of_agent in having.items()}
    whole = {agent: of_agent for agent, of_agent in values.items() if len(of_agent) == len(tasks)}
    exact, every = [0.0] * len(tasks), None if scenarios is None else [scenarios[task] for task in tasks]
    order = statistics.tiers(whole, exact, every, fixed)
    ranks, reversals = ranks_of(order), statistics.reversals([one for tier in order for one in tier], whole, exact, every, fixed)
    rows: dict[str, dict[str, Any]] = {}
    for agent, of_agent in having.items():
        against = None
        if RULES in set(whole) - {agent}:
            rules = [scores[task][RULES] for task in of_agent]
            against = statistics.estimate_difference(values[agent], rules, names[agent], (agent in fixed, RULES in fixed)).interval()
        mean = statistics.estimate_mean(values[agent], names[agent]).interval()
        rows[agent] = {"money": Money(rank=ranks.get(agent), mean=mean, against_rules=against, reversal=reversals.get(agent))}
        if agent in whole and best_known.keys() >= set(tasks):
            gaps = [np.array([run.reward for run in best_known[task].runs]) - scores[task][agent] for task in tasks]
            rows[agent] |= {"regret": statistics.aggregate(gaps, "mean", every), "against_rules": against}
    costs = {agent: [penalties[task][agent] for task in tasks] for agent in whole if all(agent in penalties[task] for task in tasks)}
    places, turns = at_prices(whole, costs, order, privileged, every, fixed)
    return {agent: one | places.get(agent, {}) for agent, one in rows.items()}, turns


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
    stored: Iterable[StoredResult], expected: Mapping[str, Expectation], before: Mapping[str, References]
) -> dict[str, References]:
    """References of the tasks in ``before``, in the metric that ranks, from complete results; what results do not change stays as it is.

    A zero that is there stays; else it is the mean of the agent that the entry names, over ``ZERO_TRAININGS`` trainings or more if it was
    trained. One is the mean of the best known runs, whichever agents they are of, if plans made them or if one was there before.
    """
    items = tuple(stored)
    entries, best = entries_by_task(items, expected), best_runs(items, expected)
    return {
        task_id: _references(old, entries[task_id], best[task_id], metric_of(task_id, expected)) if task_id in best else old
        for task_id, old in before.items()
    }


def _references(old: References, entries: Iterable[Entry], runs: Sequence[tuple[Result, RunResult]], metric: str) -> References:
    """An entry with what results change; ``runs`` are the best known ones."""
    changes: dict[str, Any] = {}
    zero = next((one for one in entries if one.name == old.zero_agent and one.complete and one.states(metric)), None)
    if old.zero is None and zero is not None and (len(zero.trainings) >= ZERO_TRAININGS or (zero.is_fixed and not zero.training_seeds)):
        digests = " ".join(item.result.results_digest for item in zero.trainings)
        changes = {"zero": float(zero.by_training(metric).mean()), "zero_results_digest": digests}
    owners = {one.agent.name: one.results_digest for one, _ in runs}
    plans = all(one.agent.privileged for one, _ in runs)
    if plans or old.best is not None:
        changes |= {
            "plans": plans,
            "best": float(np.mean([run.metrics[metric] for _, run in runs])),
            "best_agent": next(iter(owners)) if len(owners) == 1 else SEVERAL,
            "best_results_digest": " ".join(digest for _, digest in sorted(owners.items())),
        }
    new = old.model_copy(update=changes)
    if new.ends is not None and new.ends[1] <= new.ends[0]:
        return old
    return new.model_copy(update={"version": old.version + (None is not old.best != new.best)})
