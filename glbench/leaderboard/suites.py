"""Agents over all tasks of a suite: normalised scores, aggregates and tiers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from glbench.evaluation.metrics import METRIC_NAMES
from glbench.leaderboard.aggregates import (
    Aggregate,
    Interval,
    Profile,
    aggregate,
    normalise,
    performance_profile,
    pooled,
    probability_of_improvement,
)
from glbench.leaderboard.collect import ORIGINS, Expectation, Origin, StoredResult
from glbench.leaderboard.comparisons import RESOLUTION, tiers
from glbench.leaderboard.entries import entries_by_task, metric_of
from glbench.leaderboard.ranking import SANDBOXES, Row, TaskTable
from glbench.leaderboard.resampling import Array
from glbench.tasks import list_suites
from glbench.tasks.references import References, read_references

NOTHING = "do_nothing"
"""Name of the agent whose reward is the zero of normalised scores."""

_THRESHOLDS = 101
_LOWEST_THRESHOLD = -0.25
"""Profiles begin here at the lowest: how far below doing nothing a failed run lies is not worth the room."""


@dataclass(frozen=True)
class SuiteFigures:
    """What an agent earned, grew and used over a suite: means over the tasks of the means over the runs, in the metrics' units.

    ``training_steps`` is that of the task with the longest training; ``None``: not stated. ``origin`` is ``released`` when all of
    its results are.
    """

    metrics: Mapping[str, float]
    runs: int
    failed: int
    decision_milliseconds: float
    training_steps: int | None
    privileged: bool
    information: str
    sandbox: str
    """``bubblewrap``, ``unsandboxed``, ``built-in`` or ``unknown``; of several the one that says least."""
    reproduced: bool
    origin: Origin


@dataclass(frozen=True)
class SuiteRow:
    """One entry over a suite. ``rank`` is shared by agents that cannot be told apart; ``None`` when tasks are missing."""

    rank: int | None
    aggregate: Aggregate
    missing: tuple[str, ...]
    figures: SuiteFigures | None = None


@dataclass(frozen=True)
class Improvement:
    """Probability that a run of ``first`` (of any of its trainings) scores above a run of ``second`` on the same task."""

    first: str
    second: str
    probability: Interval


@dataclass(frozen=True)
class SuiteTable:
    """Agents over the tasks of a suite, best first by mean normalised score; agents that lack tasks last.

    ``improvements`` holds every ordered pair of ranked agents, ``profiles`` their performance profiles over the same thresholds.
    """

    suite: str
    tasks: tuple[str, ...]
    rows: tuple[SuiteRow, ...]
    improvements: tuple[Improvement, ...] = ()
    profiles: Mapping[str, Profile] = field(default_factory=dict)


def scores_by_task(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, dict[str, Array]]:
    """What ranks of complete entries of published tasks ``(trainings, n)``, by task id and entry, in the order of the task's seeds."""
    return {
        task_id: {entry.name: entry.by_training(metric_of(task_id, expected)) for entry in entries if entry.complete}
        for task_id, entries in entries_by_task(stored, expected).items()
        if task_id in expected and any(entry.complete for entry in entries)
    }


def suite_table(
    suite: str,
    tasks: tuple[str, ...],
    scores: Mapping[str, Mapping[str, Array]],
    references: Mapping[str, References],
    tables: Sequence[TaskTable] = (),
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

    Returns
    -------
    SuiteTable or None
        ``None`` when no task of the suite has both results and references.
    """
    usable = tuple(task for task in tasks if task in references and task in scores)
    if not usable:
        return None
    normalised: dict[str, dict[str, Array]] = {}
    for task in usable:
        reference = references[task]
        for agent, rewards in scores[task].items():
            normalised.setdefault(agent, {})[task] = normalise(rewards, reference.nothing, reference.best)
    whole = {agent: by_task for agent, by_task in normalised.items() if len(by_task) == len(usable)}
    resolutions = [RESOLUTION / (references[task].best - references[task].nothing) for task in usable]
    means = {agent: [np.atleast_2d(by_task[task]).mean(axis=0) for task in usable] for agent, by_task in whole.items()}
    order = tiers(means, resolutions)
    shown = _rows_of_agents(usable, tables)
    rows: list[SuiteRow] = []
    for tier in order:
        rank = len(rows) + 1
        for agent in tier:
            found = aggregate(agent, [whole[agent][task] for task in usable])
            rows.append(SuiteRow(rank, found, (), _figures(shown.get(agent, ()))))
    for agent in sorted(set(normalised) - set(whole)):
        by_task = normalised[agent]
        missing = tuple(task for task in usable if task not in by_task)
        some = [row for row in shown.get(agent, ()) if row.task_id in by_task]
        rows.append(SuiteRow(None, aggregate(agent, list(by_task.values())), missing, _figures(some)))
    return SuiteTable(suite, usable, tuple(rows), _improvements(whole, order), _profiles(whole, usable))


def suite_tables(
    stored: Sequence[StoredResult], expected: Mapping[str, Expectation], tables: Sequence[TaskTable]
) -> tuple[SuiteTable, ...]:
    """Tables of all published suites that have results and references."""
    scores, references = scores_by_task(stored, expected), read_references()
    found = [suite_table(name, tuple(ids), scores, references, tables) for name, ids in list_suites().items()]
    return tuple(table for table in found if table is not None)


def _rows_of_agents(tasks: Sequence[str], tables: Sequence[TaskTable]) -> dict[str, list[Row]]:
    """Complete rows of the tasks by agent."""
    found: dict[str, list[Row]] = {}
    for table in tables:
        if table.task_id in tasks:
            for row in table.rows:
                if row.rank is not None:
                    found.setdefault(row.agent, []).append(row)
    return found


def _figures(rows: Sequence[Row]) -> SuiteFigures | None:
    if not rows:
        return None
    steps = [row.training_steps for row in rows]
    sandboxes = {row.sandbox or "unknown" for row in rows}
    origins = {row.origin for row in rows}
    return SuiteFigures(
        metrics={name: float(np.mean([row.estimates[name].mean for row in rows])) for name in METRIC_NAMES},
        runs=sum(row.runs for row in rows),
        failed=sum(row.failed for row in rows),
        decision_milliseconds=float(np.mean([row.decision_milliseconds for row in rows])),
        training_steps=None if None in steps else max(step for step in steps if step is not None),
        privileged=any(row.privileged for row in rows),
        information=rows[0].information,
        sandbox=next(kind for kind in SANDBOXES if kind in sandboxes),
        reproduced=all(row.reproduced for row in rows),
        origin=next(origin for origin in reversed(ORIGINS) if origin in origins),
    )


def _improvements(whole: Mapping[str, Mapping[str, Array]], order: Sequence[Sequence[str]]) -> tuple[Improvement, ...]:
    """Both directions of every pair: what one has above the other is what the other has below it."""
    agents = [agent for tier in order for agent in tier]
    runs = {agent: {task: scores.ravel() for task, scores in whole[agent].items()} for agent in agents}
    found = []
    for one, other in combinations(agents, 2):
        p = probability_of_improvement(runs[one], runs[other])
        found.append(Improvement(one, other, p))
        found.append(Improvement(other, one, Interval(1.0 - p.value, 1.0 - p.high, 1.0 - p.low)))
    return tuple(found)


def _profiles(whole: Mapping[str, Mapping[str, Array]], tasks: Sequence[str]) -> dict[str, Profile]:
    """Profiles over thresholds from the lowest score that matters to a little above the best."""
    if not whole:
        return {}
    lists = {agent: pooled([by_task[task] for task in tasks]) for agent, by_task in whole.items()}
    every = np.concatenate([runs for each in lists.values() for runs in each])
    low, high = max(_LOWEST_THRESHOLD, min(0.0, float(every.min()))), max(1.0, float(every.max()))
    margin = 0.02 * (high - low)
    even = np.linspace(low - margin, high + margin, _THRESHOLDS)
    # As many again where the runs are, so that agents that lie close together keep their shape.
    dense = np.quantile(every[every >= low], np.linspace(0.0, 1.0, _THRESHOLDS))
    thresholds = np.unique(np.round(np.concatenate([even, dense]), 4))
    return {agent: performance_profile(each, thresholds) for agent, each in lists.items()}


def references_from(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, References]:
    """References of every published task that has a complete result of ``do_nothing`` and a better one, in the metric that ranks."""
    by_task: dict[str, list[tuple[float, StoredResult]]] = {}
    for item in stored:
        task_id = item.result.task.id
        if task_id in expected and item.result.evaluation.seeds == expected[task_id].seeds:
            mean = float(np.mean(item.result.values(metric_of(task_id, expected))))
            by_task.setdefault(task_id, []).append((mean, item))
    found = {}
    for task_id, results in by_task.items():
        nothing = [pair for pair in results if pair[1].result.agent.name == NOTHING]
        best = max(results, key=lambda pair: (pair[0], pair[1].result.agent.name))
        if nothing and best[0] > nothing[0][0]:
            found[task_id] = References(
                nothing=nothing[0][0],
                nothing_results_digest=nothing[0][1].result.results_digest,
                best=best[0],
                best_agent=best[1].result.agent.name,
                best_results_digest=best[1].result.results_digest,
            )
    return found
