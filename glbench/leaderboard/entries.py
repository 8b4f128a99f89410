"""Entries: what a row of a table stands for. A single result, or the trainings of one recipe that differ in their seed alone.

``ppo``, ``ppo_seed1`` and ``ppo_seed2`` are three trainings of ``ppo``; ``mine-seed0`` and ``mine-seed1`` (as ``glbench train`` names
them) are two of ``mine``. Only results of the same kind and origin make one entry, so that nobody's result can join a released one.
Trainings are in the order of their seeds: which one is shown first never depends on how well it did.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from glbench.errors import ResultError, did_you_mean
from glbench.evaluation import Result
from glbench.leaderboard.catalogue import catalogue
from glbench.leaderboard.collect import ORIGINS, Expectation, Origin, StoredResult
from glbench.leaderboard.statistics import Array

RANKING_METRIC = catalogue().score.name
"""What ranks where no task says otherwise."""

_SEEDED = re.compile(r"(.+)[_-]seed([0-9]{1,10})", re.DOTALL)
_Family = tuple[str, str, bool, Origin]


@dataclass(frozen=True)
class Entry:
    """What one row of a task's table stands for.

    ``trainings`` share their evaluation seeds. ``training_seeds`` are the seeds that they were trained with; empty for a result that is no
    training among others.
    """

    name: str
    origin: Origin
    complete: bool
    """Whether it has all runs that the task asks for."""
    trainings: tuple[StoredResult, ...]
    training_seeds: tuple[int, ...] = ()

    @property
    def first(self) -> Result:
        """The training with the lowest seed; of a single result that result."""
        return self.trainings[0].result

    @property
    def task_id(self) -> str:
        """The task."""
        return self.first.task.id

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the evaluation."""
        return self.first.evaluation.seeds

    def states(self, metric: str) -> bool:
        """Whether all its results hold a metric: one of another version may lack it."""
        return all(metric in run.metrics for item in self.trainings for run in item.result.runs)

    def by_training(self, metric: str) -> Array:
        """Values ``(trainings, runs)`` of a metric, in its unit."""
        return np.array([item.result.values(metric) for item in self.trainings], dtype=np.float64)

    def values(self, metric: str) -> Array:
        """Values ``(runs,)`` of a metric, each the mean over the trainings in the run of that seed; of a single result as they are."""
        values = self.by_training(metric)
        return np.asarray(values[0] if len(values) == 1 else values.mean(axis=0), dtype=np.float64)


def entries_by_task(
    stored: Iterable[StoredResult], expected: Mapping[str, Expectation]
) -> dict[str, tuple[Entry, ...]]:
    """Entries of every task, by task id. Within a task their names differ.

    Parameters
    ----------
    stored
        Results.
    expected
        What the published tasks ask for, by id. A task that is not in it (a user's own) asks for the largest set of seeds among its
        results.
    """
    by_task: dict[str, list[StoredResult]] = {}
    for item in stored:
        by_task.setdefault(item.result.task.id, []).append(item)
    origins: dict[int, Origin] = {}
    complete: dict[int, bool] = {}
    for task_id, items in by_task.items():
        seeds = expected_seeds(task_id, items, expected)
        for item in items:
            complete[id(item)] = not item.trial and item.result.evaluation.seeds == seeds
            origins[id(item)] = origin_of(item, seeds)
    families = _families((item, origins[id(item)]) for items in by_task.values() for item in items)
    found = {}
    for task_id in sorted(by_task):
        groups: dict[tuple[object, ...], list[tuple[int | None, StoredResult]]] = {}
        for item in by_task[task_id]:
            family, seed = _family(item, origins[id(item)], families)
            alone = () if seed is not None else (item.path,)
            groups.setdefault((family, item.result.evaluation.seeds, *alone), []).append((seed, item))
        entries = [
            Entry(
                name=name,
                origin=origins[id(items[0])],
                complete=complete[id(items[0])],
                trainings=items,
                training_seeds=seeds_of_trainings,
            )
            for group in groups.values()
            for name, items, seeds_of_trainings in _trainings(group)
        ]
        found[task_id] = _with_names_of_their_own(entries)
    return found


def entry_of(result: StoredResult) -> Entry:
    """An entry of one result, whatever others there are."""
    return Entry(result.result.agent.name, origin_of(result, result.result.evaluation.seeds), True, (result,))


def origin_of(item: StoredResult, seeds: tuple[int, ...]) -> Origin:
    """Whether a result came with glbench, is the user's own, or a trial: one with other seeds than the task's ``seeds``."""
    return "trial" if item.origin == "own" and item.result.evaluation.seeds != seeds else item.origin


def expected_seeds(task_id: str, items: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> tuple[int, ...]:
    """Seeds that a complete result of the task has."""
    if task_id in expected:
        return expected[task_id].seeds
    given = list(items)
    full = [item for item in given if not item.trial]
    return max((item.result.evaluation.seeds for item in full or given), key=lambda seeds: (len(seeds), seeds))


def metric_of(task_id: str, expected: Mapping[str, Expectation]) -> str:
    """The metric that ranks on a task.

    Raises
    ------
    ResultError
        When it is one that results do not hold, or of which less is better.
    """
    metric = expected[task_id].metric if task_id in expected else RANKING_METRIC
    rankable = [one.name for one in catalogue().metrics.values() if one.better == "high"]
    if metric not in rankable:
        msg = (
            f"The task {task_id} asks for a ranking by '{metric}'.{did_you_mean(metric, rankable)} "
            f"Results are ranked by a metric of which more is better: {', '.join(rankable)}."
        )
        raise ResultError(msg)
    return metric


def _split(item: StoredResult) -> tuple[str, int | None]:
    """Name without the seed, and the seed."""
    name = item.result.agent.name
    match = _SEEDED.fullmatch(name)
    return (name, None) if match is None else (match.group(1), int(match.group(2)))


def _families(items: Iterable[tuple[StoredResult, Origin]]) -> frozenset[_Family]:
    """Recipes of which several trainings have results, be it on different tasks."""
    names: dict[_Family, set[str]] = {}
    for item, origin in items:
        agent = item.result.agent
        names.setdefault((_split(item)[0], agent.kind, agent.privileged, origin), set()).add(agent.name)
    return frozenset(family for family, known in names.items() if len(known) > 1)


def _family(item: StoredResult, origin: Origin, families: frozenset[_Family]) -> tuple[_Family, int | None]:
    """The family of a result, and the seed of its training; the seed is ``None`` when it has none."""
    agent = item.result.agent
    base, seed = _split(item)
    family = (base, agent.kind, agent.privileged, origin)
    if family in families:
        return family, seed or 0
    return (agent.name, agent.kind, agent.privileged, origin), None


def _trainings(
    group: list[tuple[int | None, StoredResult]],
) -> list[tuple[str, tuple[StoredResult, ...], tuple[int, ...]]]:
    """Name, results and training seeds of the entries that a group makes: one; or one each where two claim to be the same training."""
    seeds = [seed for seed, _ in group if seed is not None]
    if not seeds or len(set(seeds)) < len(seeds):
        return [(item.result.agent.name, (item,), ()) for _, item in group]
    ordered = sorted(zip(seeds, (item for _, item in group), strict=True), key=lambda pair: pair[0])
    return [(_split(ordered[0][1])[0], tuple(item for _, item in ordered), tuple(seed for seed, _ in ordered))]


def _with_names_of_their_own(entries: list[Entry]) -> tuple[Entry, ...]:
    """Of several entries with one name (a trial beside a full result) the released one keeps it; the others say what they are."""
    taken: set[str] = set()
    named = []
    for entry in sorted(entries, key=lambda one: (ORIGINS.index(one.origin), one.name, str(one.trainings[0].path))):
        name, number = entry.name, 1
        while name in taken:
            number += 1
            name = f"{entry.name} ({entry.origin}{'' if number == 2 else f' {number - 1}'})"
        taken.add(name)
        named.append(replace(entry, name=name))
    return tuple(sorted(named, key=lambda one: one.name))
