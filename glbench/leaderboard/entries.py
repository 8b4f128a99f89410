"""Entries: what a row of a table stands for. A single result, or the trainings of one recipe that differ in their seed alone.

``ppo``, ``ppo_seed1`` and ``ppo_seed2`` are three trainings of ``ppo``; ``mine-seed0`` and ``mine-seed1`` (as ``glbench train`` names
them) are two of ``mine``. Only results of the same kind and origin make one entry, so that nobody's result can join a released one.
Trainings are in the order of their seeds: which one is shown first never depends on how well it did.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from glbench.errors import ResultError, did_you_mean
from glbench.evaluation import Result
from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard.budget import budget_of
from glbench.leaderboard.catalogue import catalogue, of_published
from glbench.leaderboard.collect import ORIGINS, Expectation, Origin, StoredResult, task_of_board
from glbench.leaderboard.comparisons import RESOLUTION
from glbench.leaderboard.statistics import Array

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

_SEEDED = re.compile(r"(.+)[_-]seed([0-9]{1,10})", re.DOTALL)


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
        """The board: the task's id, or more where draws are kept apart."""
        return self.trainings[0].board

    @property
    def task(self) -> TaskSpec | None:
        """The definition of the task, where one of its results has it."""
        return next((item.task for item in self.trainings if item.task is not None), None)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the evaluation."""
        return self.first.evaluation.seeds

    @property
    def clusters(self) -> tuple[str, ...] | None:
        """The group of each run; ``None`` where runs name none, or the trainings do not name the same."""
        found = {item.result.clusters for item in self.trainings}
        return found.pop() if len(found) == 1 else None

    @property
    def is_fixed(self) -> bool:
        """Whether no training made it, as far as it says: a result of a policy, and not one draw of a recipe."""
        return not any(budget_of(item.result).steps for item in self.trainings)

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
    """Entries of every board, by its name: the task's id, or more where draws are kept apart. Within a board their names differ.

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
        by_task.setdefault(item.board, []).append(item)
    seeds = {task_id: expected_seeds(task_id, items, expected) for task_id, items in by_task.items()}
    recipes: dict[tuple[object, ...], set[str]] = {}
    for task_id, items in by_task.items():
        for item in items:
            recipes.setdefault(_recipe(item, seeds[task_id]), set()).add(item.result.agent.name)
    found = {}
    for task_id in sorted(by_task):
        groups: dict[tuple[object, ...], list[StoredResult]] = {}
        for item in by_task[task_id]:
            recipe = _recipe(item, seeds[task_id])
            several = len(recipes[recipe]) > 1  # be it on different tasks
            key: tuple[object, ...] = (recipe, item.result.evaluation.seeds) if several else (item.path,)
            groups.setdefault(key, []).append(item)
        entries = []
        for key, group in groups.items():
            # Of two that claim to be the same training none is one.
            are_trainings = len(key) > 1 and len({_seed(item) for item in group}) == len(group)
            parts = [group] if are_trainings else [[item] for item in group]
            entries += [_entry(part, seeds[task_id], are_trainings=are_trainings) for part in parts]
        found[task_id] = _with_names_of_their_own(entries)
    return found


def _entry(items: list[StoredResult], seeds: tuple[int, ...], *, are_trainings: bool) -> Entry:
    """The entry of trainings of one recipe, or of one result."""
    ordered = sorted(items, key=_seed)
    first = ordered[0]
    return Entry(
        name=_split(first)[0] if are_trainings else first.result.agent.name,
        origin=origin_of(first, seeds),
        complete=not first.trial and first.result.evaluation.seeds == seeds,
        trainings=tuple(ordered),
        training_seeds=tuple(map(_seed, ordered)) if are_trainings else (),
    )


def entry_of(result: StoredResult) -> Entry:
    """An entry of one result, whatever others there are."""
    return Entry(result.result.agent.name, origin_of(result, result.result.evaluation.seeds), True, (result,))


def origin_of(item: StoredResult, seeds: tuple[int, ...]) -> Origin:
    """Whether a result came with glbench, is the user's own, or a trial: one with other seeds than the task's ``seeds``."""
    return "trial" if item.origin == "own" and item.result.evaluation.seeds != seeds else item.origin


def expected_seeds(task_id: str, items: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> tuple[int, ...]:
    """Seeds that a complete result of the task has."""
    task_id = task_of_board(task_id)
    if task_id in expected:
        return expected[task_id].seeds
    given = list(items)
    full = [item for item in given if not item.trial]
    return max((item.result.evaluation.seeds for item in full or given), key=lambda seeds: (len(seeds), seeds))


def metric_of(task_id: str, expected: Mapping[str, Expectation], task: TaskSpec | None = None) -> str:
    """The metric that ranks on a task: on a published one as ``expected`` says, else as its definition says where that is known.

    Raises
    ------
    ResultError
        When it is one that results do not hold, or of which less is better.
    """
    task_id = task_of_board(task_id)
    own = RANKING_METRIC if task is None else task.evaluation.metric
    metric = expected[task_id].metric if task_id in expected else own
    words = of_published([task_id]) if task is None else catalogue(task)
    rankable = [one.name for one in words.metrics.values() if one.better == "high"]
    if metric not in rankable:
        msg = (
            f"The task {task_id} asks for a ranking by '{metric}'.{did_you_mean(metric, rankable)} "
            f"Results are ranked by a metric of which more is better: {', '.join(rankable)}."
        )
        raise ResultError(msg)
    return metric


def resolution_of(metric: str, task: TaskSpec | None) -> float:
    """Difference of what ranks that rounding can make where a task draws nothing; known of rewards that are scaled as the paper's."""
    scaled = task is None or "scaled_epi" in task.reward.modules
    return RESOLUTION if metric == RANKING_METRIC and scaled else 0.0


def _split(item: StoredResult) -> tuple[str, int]:
    """Name without the seed of the training, and that seed; 0 where the name has none."""
    name = item.result.agent.name
    match = _SEEDED.fullmatch(name)
    return (name, 0) if match is None else (match.group(1), int(match.group(2)))


def _seed(item: StoredResult) -> int:
    return _split(item)[1]


def _recipe(item: StoredResult, seeds: tuple[int, ...]) -> tuple[object, ...]:
    """What trainings of one recipe have in common; ``seeds`` are the task's."""
    agent = item.result.agent
    return _split(item)[0], agent.kind, agent.privileged, origin_of(item, seeds)


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
