"""Agents over all tasks of a suite: normalised scores, aggregates and tiers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from glbench.leaderboard.aggregates import Aggregate, aggregate, normalise
from glbench.leaderboard.collect import Expectation, StoredResult
from glbench.leaderboard.comparisons import tiers
from glbench.leaderboard.resampling import Array
from glbench.tasks.references import References

NOTHING = "do_nothing"
"""Name of the agent whose reward is the zero of normalised scores."""


@dataclass(frozen=True)
class SuiteRow:
    """One agent over a suite. ``rank`` is shared by agents that cannot be told apart; ``None`` when tasks are missing."""

    rank: int | None
    aggregate: Aggregate
    missing: tuple[str, ...]


@dataclass(frozen=True)
class SuiteTable:
    """Agents over the tasks of a suite, best first; agents that lack tasks last."""

    suite: str
    tasks: tuple[str, ...]
    rows: tuple[SuiteRow, ...]


def scores_by_task(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, dict[str, Array]]:
    """Rewards ``(n,)`` of complete results, by task id and agent, in the order of the task's seeds."""
    found: dict[str, dict[str, Array]] = {}
    for item in stored:
        result = item.result
        expectation = expected.get(result.task.id)
        if expectation is not None and result.evaluation.seeds == expectation.seeds:
            found.setdefault(result.task.id, {})[result.agent.name] = np.array(result.values("reward"))
    return found


def suite_table(
    suite: str,
    tasks: tuple[str, ...],
    scores: Mapping[str, Mapping[str, Array]],
    references: Mapping[str, References],
) -> SuiteTable | None:
    """Aggregates of every agent over the tasks of a suite.

    Parameters
    ----------
    suite, tasks
        Name, and ids of its tasks.
    scores
        Rewards by task and agent, see ``scores_by_task``.
    references
        Zero and one of each task's normalised score.

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
    # All runs of all tasks side by side: pairs of equal task and seed.
    order = tiers({agent: np.concatenate([by_task[task] for task in usable]) for agent, by_task in whole.items()})
    rows: list[SuiteRow] = []
    ahead = 0
    for tier in order:
        rows += [SuiteRow(ahead + 1, aggregate(agent, [whole[agent][task] for task in usable]), ()) for agent in tier]
        ahead += len(tier)
    for agent in sorted(set(normalised) - set(whole)):
        by_task = normalised[agent]
        missing = tuple(task for task in usable if task not in by_task)
        rows.append(SuiteRow(None, aggregate(agent, list(by_task.values())), missing))
    return SuiteTable(suite, usable, tuple(rows))


def references_from(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, References]:
    """References of every published task that has a complete result of ``do_nothing`` and a better one."""
    by_task: dict[str, list[tuple[float, StoredResult]]] = {}
    for item in stored:
        expectation = expected.get(item.result.task.id)
        if expectation is not None and item.result.evaluation.seeds == expectation.seeds:
            mean = float(np.mean(item.result.values("reward")))
            by_task.setdefault(item.result.task.id, []).append((mean, item))
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
