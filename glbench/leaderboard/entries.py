"""Entries: what a row of a table stands for. A single result, or the trainings of one recipe that differ in their seed alone.

Cards of trainings state recipe and seed. Results are joined if recipe, authors, form, kind and origin are the same and policies and
seeds differ; names do not count. Shipped baselines are joined by the cards that came with glbench.
Trainings are sorted by seed, so their order does not depend on their scores.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from glbench.agents.baselines import digests_of_baseline, shipped_training
from glbench.agents.naming import without_seed
from glbench.errors import ResultError, did_you_mean
from glbench.evaluation import Result
from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard.catalogue import catalogue, of_published
from glbench.leaderboard.collect import ORIGINS, Expectation, Origin, StoredResult, task_of_board
from glbench.leaderboard.statistics import RESOLUTION, Array
from glbench.leaderboard.training_data import budget_of
from glbench.tasks import TaskSpec

_Recipe = tuple[object, ...]


@dataclass(frozen=True)
class Entry:
    """What one row of a task's table stands for.

    ``trainings`` share their evaluation seeds. ``training_seeds`` are the seeds that they were trained with; else empty.
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
        groups = {item.result.clusters for item in self.trainings}
        return groups.pop() if len(groups) == 1 else None

    @property
    def is_fixed(self) -> bool:
        """Whether it was not trained, as far as its results state: no training steps."""
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


def entries_by_task(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> dict[str, tuple[Entry, ...]]:
    """Entries of every board, by its name: the task's id, or more where draws are kept apart. Within a board their names differ.

    ``expected`` is what published tasks ask for, by id. One that is not in it (a user's own) asks for the seeds of its definition;
    where no result has that, for the largest set of seeds of its results.
    """
    by_task: dict[str, list[StoredResult]] = {}
    for item in stored:
        by_task.setdefault(item.board, []).append(item)
    seeds = {task_id: expected_seeds(task_id, items, expected) for task_id, items in by_task.items()}
    joined = {task_id: _joined(items, seeds[task_id]) for task_id, items in by_task.items()}
    recipes: dict[_Recipe, set[str]] = {}
    for groups in joined.values():
        for (recipe, _), group in groups.items():
            recipes.setdefault(recipe, set()).update(item.result.agent.name for item in group)
    names = _names_of_recipes(recipes, {item.result.agent.name for items in by_task.values() for item in items})
    by_board = {}
    for task_id in sorted(by_task):
        # One training on this task is one of several where there are others on other tasks.
        several = [(names[key[0]], group) for key, group in joined[task_id].items() if len(recipes[key[0]]) > 1]
        members = {id(item) for _, group in several for item in group}
        entries = [_entry(group, seeds[task_id], name=name) for name, group in several]
        entries += [_entry([item], seeds[task_id]) for item in by_task[task_id] if id(item) not in members]
        by_board[task_id] = _with_names_of_their_own(entries)
    return by_board


def of_one_version(by_task: Mapping[str, Iterable[Entry]]) -> dict[str, tuple[Entry, ...]]:
    """For each name the entries with one digest or recipe: that with the most tasks; if equally many, the latest.

    Different agents can have the same name, so figures over several tasks need this.
    """
    times: dict[str, dict[str, list[str]]] = {}
    for entries in by_task.values():
        for entry in entries:
            times.setdefault(entry.name, {}).setdefault(_version(entry), []).append(entry.first.created)
    version = {name: max(of, key=lambda one: (len(of[one]), max(of[one]))) for name, of in times.items()}
    return {task: tuple(one for one in entries if _version(one) == version[one.name]) for task, entries in by_task.items()}


def _version(entry: Entry) -> str:
    """An agent's digest, or the recipe of its trainings; of a baseline without plans today's digest, also where it had another."""
    agent = entry.first.agent
    if not entry.training_seeds:
        every = () if agent.privileged else digests_of_baseline(agent.name)
        return every[0] if agent.digest in every else agent.digest
    return "" if agent.training is None else agent.training.recipe


def _joined(items: Iterable[StoredResult], seeds: tuple[int, ...]) -> dict[tuple[_Recipe, tuple[int, ...]], list[StoredResult]]:
    """Trainings on one board, by recipe and seeds of the evaluation, in the order of the seeds that they were trained with.

    Each policy occurs once (the same rewards in all runs mean the same policy, unless all failed). A recipe with a seed twice is left out.
    """
    groups: dict[tuple[_Recipe, tuple[int, ...]], list[StoredResult]] = {}
    policies = set[object]()
    for item in sorted(items, key=lambda one: (_seed(one), one.result.agent.name)):
        recipe = _recipe(item, seeds)
        if recipe is not None:
            key, agent = (recipe, item.result.evaluation.seeds), item.result.agent
            weights = None if agent.kind == "baseline" or agent.training is None else agent.training.policy
            same: set[object] = {(key, agent.digest), (key, weights or agent.digest)}
            if len(item.result.failed) < len(item.result.runs):  # where all runs failed, every policy has what the task charges
                same.add((key, tuple(item.result.values(RANKING_METRIC))))
            if not same & policies:
                groups.setdefault(key, []).append(item)
            policies |= same
    return {key: group for key, group in groups.items() if len({_seed(item) for item in group}) == len(group)}


def _names_of_recipes(recipes: Mapping[_Recipe, set[str]], agent_names: set[str]) -> dict[_Recipe, str]:
    """Names of entries: the trainings' common name without the seed or, if it differs or another agent has it, the first training's."""
    entry_names: dict[_Recipe, str] = {}
    owners: dict[str, _Recipe] = {}
    for recipe, names in recipes.items():
        shared = min(without_seed(name) for name in names)
        same = {without_seed(name) for name in names} == {shared} and shared not in agent_names - names
        entry_names[recipe] = shared if same and owners.setdefault(shared, recipe[:-1]) == recipe[:-1] else min(names)
    return entry_names


def _entry(items: list[StoredResult], seeds: tuple[int, ...], *, name: str | None = None) -> Entry:
    """The entry ``name`` of trainings of one recipe in the order of their seeds, or of one result."""
    first = items[0]
    return Entry(
        name=name or first.result.agent.name,
        origin=origin_of(first, seeds),
        complete=not first.trial and first.result.evaluation.seeds == seeds,
        trainings=tuple(items),
        training_seeds=() if name is None else tuple(map(_seed, items)),
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
    results = list(items)
    task = next((item.task for item in results if item.task is not None), None)
    if task is not None:
        return tuple(task.evaluation.seeds)
    full = [item for item in results if not item.trial]
    return max((item.result.evaluation.seeds for item in full or results), key=lambda seeds: (len(seeds), seeds))


def metric_of(task_id: str, expected: Mapping[str, Expectation], task: TaskSpec | None = None) -> str:
    """The metric that ranks on a task: on a published one as ``expected`` says, else as its definition says where that is known.

    Raises ``ResultError`` when it is one that results do not hold, or of which less is better.
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


def resolution_of(metric: str, task: TaskSpec | None, units: Mapping[str, str]) -> float:
    """Difference of what ranks that rounding can make where a task draws nothing; known of rewards that are scaled as the paper's.

    Of a task that is not known, these are the rewards that have no unit in ``units``.
    """
    scaled = units.get(metric, "-") == "-" if task is None else "scaled_epi" in task.reward.modules
    return RESOLUTION if metric == RANKING_METRIC and scaled else 0.0


def _seed(item: StoredResult) -> int:
    """The seed of a training, as its card states it; 0 of any other agent."""
    agent = item.result.agent
    training = shipped_training(agent.name) if agent.kind == "baseline" else agent.training
    return 0 if training is None else training.seed


def _recipe(item: StoredResult, seeds: tuple[int, ...]) -> _Recipe | None:
    """Values that trainings of one recipe share, the origin last; ``None`` for an agent without a recipe. ``seeds`` are the task's."""
    agent = item.result.agent
    where = agent.kind, agent.privileged, origin_of(item, seeds)
    if agent.kind == "baseline":
        shipped = shipped_training(agent.name)
        genuine = shipped is not None and (item.released or agent.digest in digests_of_baseline(agent.name))
        return (shipped.recipe, *where) if shipped is not None and genuine else None
    if agent.training is None:
        return None
    # Folders of settings state no authors, so their names must be the same except for the seed.
    owner = without_seed(agent.name) if agent.card is None else tuple(sorted(agent.card.authors))
    return agent.training.recipe, agent.training.form, owner, agent.information, *where


def _with_names_of_their_own(entries: list[Entry]) -> tuple[Entry, ...]:
    """Of several entries with one name (a trial beside a full result) the released one keeps it; the others say what they are."""
    names: set[str] = set()
    named = []
    for entry in sorted(entries, key=lambda one: (ORIGINS.index(one.origin), one.name, str(one.trainings[0].path))):
        name, number = entry.name, 1
        while name in names:
            number += 1
            name = f"{entry.name} ({entry.origin}{'' if number == 2 else f' {number - 1}'})"
        names.add(name)
        named.append(replace(entry, name=name))
    return tuple(sorted(named, key=lambda one: one.name))
