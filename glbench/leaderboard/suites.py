"""Agents over all tasks of a suite: normalised scores, aggregates and tiers."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from itertools import combinations

import numpy as np
from pydantic import Field

from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard import statistics
from glbench.leaderboard.collect import Expectation, Origin, StoredResult
from glbench.leaderboard.entries import entries_by_task, metric_of, of_one_version, resolution_of
from glbench.leaderboard.ranking import Row, TaskTable, combined
from glbench.leaderboard.regret import best_runs
from glbench.quantities import MONEY
from glbench.tasks import list_suites, published_task
from glbench.tasks.references import SEVERAL, BestKnown, References, read_best_known, read_references

NOTHING = "do_nothing"  # Name of the agent whose reward is the zero of normalised scores

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


class SuiteRow(statistics.FrozenModel):
    """One agent over a suite, in normalised scores: 0 is doing nothing, 1 the best known result of each task."""

    rank: int | None
    agent: str
    iqm: statistics.Interval
    mean: statistics.Interval
    median: statistics.Interval
    optimality_gap: statistics.Interval
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
    rows: tuple[SuiteRow, ...]
    improvements: tuple[Improvement, ...] = ()
    profiles: tuple[statistics.Profile, ...] = ()


def scores_by_task(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, dict[str, statistics.Array]]:
    """What ranks of complete entries of published tasks ``(trainings, n)``, by task id and entry, in the order of the task's seeds.

    A training with one seed is in the same row of all tasks, as far as their numbers of trainings allow it.
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
            name: entry.by_training(metric_of(task_id, expected))[orders.get(name, {}).get(task_id, slice(None))]
            for name, entry in entries.items()
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
) -> SuiteTable | None:
    """Aggregates of every agent over the tasks of a suite.

    Parameters
    ----------
    suite, tasks
        Name, and ids of its tasks.
    scores
        Rewards by task and entry, ``(n,)`` or ``(trainings, n)``, see ``scores_by_task``.
    references
        Zero and one of each task's normalised score.
    tables
        Ranked rows of the tasks, for what agents earned, grew and used.
    best_known
        Best known runs of the tasks, with the seeds of ``scores`` in their order, for regrets.
    scenarios
        For each task, a name for each run; runs of different tasks with the same name have the same draws. ``None``: all draws differ.

    Returns
    -------
    SuiteTable or None
        ``None`` when no task of the suite has both results and references.
    """
    usable = tuple(task for task in tasks if task in references and task in scores)
    if not usable:
        return None
    normalised: dict[str, dict[str, statistics.Array]] = {}
    for task in usable:
        reference = references[task]
        for agent, rewards in scores[task].items():
            normalised.setdefault(agent, {})[task] = statistics.normalise(rewards, reference.nothing, reference.best)
    whole = {agent: by_task for agent, by_task in normalised.items() if len(by_task) == len(usable)}
    of_task = {table.task_id: resolution_of(table.metric, table.task) for table in tables}
    resolutions = [of_task.get(task, statistics.RESOLUTION) / (references[task].best - references[task].nothing) for task in usable]
    names = None if scenarios is None else [scenarios[task] for task in usable]
    rows_of: dict[str, list[Row]] = {}
    for row in (row for table in tables if table.task_id in usable for row in table.rows if row.rank is not None):
        rows_of.setdefault(row.agent, []).append(row)
    fixed = {agent for agent, rows in rows_of.items() if not any(row.training_steps for row in rows)}
    values = {agent: [by_task[task] for task in usable] for agent, by_task in whole.items()}
    order = statistics.tiers(values, resolutions, names, fixed)
    in_money = _in_money(usable, scores, best_known or {}, names, fixed)
    rows: list[SuiteRow] = []
    for tier in order:
        shared = len(rows) + 1
        rows += [_row(agent, shared, whole[agent], usable, rows_of.get(agent, ()), scenarios, **in_money.get(agent, {})) for agent in tier]
    rows += [
        _row(agent, None, normalised[agent], usable, rows_of.get(agent, ()), scenarios) for agent in sorted(set(normalised) - set(whole))
    ]
    improvements = []
    for one, other in combinations([agent for tier in order for agent in tier], 2):
        p = statistics.probability_of_improvement(whole[one], whole[other], scenarios)
        # What one has above the other is what the other has below it.
        back = statistics.Interval(value=1.0 - p.value, low=1.0 - p.high, high=1.0 - p.low)
        improvements.append(Improvement(first=one, second=other, probability=p))
        improvements.append(Improvement(first=other, second=one, probability=back))
    return SuiteTable(suite=suite, tasks=usable, rows=tuple(rows), improvements=tuple(improvements), profiles=_profiles(whole, usable))


def suite_tables(
    stored: Sequence[StoredResult], expected: Mapping[str, Expectation], tables: Sequence[TaskTable]
) -> tuple[SuiteTable, ...]:
    """Tables of all published suites that have results and references."""
    scores, references = scores_by_task(stored, expected), read_references()
    best_known = {
        task_id: best
        for task_id in scores
        if (best := read_best_known(task_id)) is not None
        and (best.task_digest, best.seeds, RANKING_METRIC) == (expected[task_id].digest, expected[task_id].seeds, expected[task_id].metric)
    }
    names = {task_id: scenario_names(task_id, expected[task_id].seeds) for task_id in scores}
    suites = [suite_table(name, tuple(ids), scores, references, tables, best_known, names) for name, ids in list_suites().items()]
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
    **in_money: statistics.Interval,
) -> SuiteRow:
    arrays = [scores[task] for task in tasks if task in scores]
    names = None if scenarios is None else [scenarios[task] for task in tasks if task in scores]
    counts = [len(np.atleast_2d(runs)) for runs in arrays]
    rows = [row for row in table_rows if row.task_id in scores]
    names_of_all = [name for name in rows[0].means if all(name in row.means for row in rows)] if rows else []
    means = {name: float(np.mean([row.means[name] for row in rows])) for name in names_of_all}
    return SuiteRow(
        rank=rank,
        agent=agent,
        **{score: statistics.aggregate(arrays, score, names) for score in statistics.SCORES},
        **in_money,
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
) -> dict[str, dict[str, statistics.Interval]]:
    """For agents with all tasks, if all tasks score money: mean regret, and mean score minus that of the tuned rules."""
    if any(task not in best_known or best_known[task].units["reward"] != MONEY for task in tasks):
        return {}
    best = [np.array([run.reward for run in best_known[task].runs]) for task in tasks]
    everywhere = set[str].intersection(*(set(scores[task]) for task in tasks))
    intervals: dict[str, dict[str, statistics.Interval]] = {}
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


def references_from(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, References]:
    """References of every published task that has a complete result of ``do_nothing`` and a better one, in the metric that ranks.

    The best is the mean of the best known runs of all seeds, whichever agents they are of.
    """
    items = tuple(stored)
    nothing = {
        item.board: item.result
        for item in items
        if item.board in expected and item.result.agent.name == NOTHING and item.result.evaluation.seeds == expected[item.board].seeds
    }
    references = {}
    for task_id, runs in best_runs(items, expected).items():
        if task_id not in nothing:
            continue
        metric, owners = metric_of(task_id, expected), {one.agent.name: one.results_digest for one, _ in runs}
        zero, best = (float(np.mean(values)) for values in (
            nothing[task_id].values(metric), [run.metrics[metric] for _, run in runs]
        ))  # fmt: skip
        if best > zero:
            references[task_id] = References(
                nothing=zero,
                nothing_results_digest=nothing[task_id].results_digest,
                best=best,
                best_agent=next(iter(owners)) if len(owners) == 1 else SEVERAL,
                best_results_digest=" ".join(digest for _, digest in sorted(owners.items())),
            )
    return references
