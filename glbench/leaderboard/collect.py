"""The results that there are: those that came with glbench and the user's own, and which of them can stand in one table."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Literal

from glbench.agents.baselines import digests_of_baseline, shipped_sight
from glbench.agents.identity import baseline_names
from glbench.agents.naming import skeleton, skeletons
from glbench.env import run_years
from glbench.episodes.header import task_of
from glbench.errors import GlbenchError, ResultError
from glbench.evaluation import Result, load_result, result_path
from glbench.evaluation.evaluation import TRIALS, VALIDATION
from glbench.evaluation.metrics import units_of
from glbench.evaluation.profiles import profile_path, read_profile
from glbench.evaluation.records import AgentRecord
from glbench.evaluation.saving import recorded_actions
from glbench.leaderboard.catalogue import catalogue, catalogue_of
from glbench.leaderboard.fresh_draws import fresh_score
from glbench.resources import data_folder, is_released
from glbench.tasks import TaskSpec, list_tasks, published_task, read_lock
from glbench.untrusted import real_path
from glbench.verification import SUFFIX, was_reproduced

Origin = Literal["released", "own", "trial"]
"""Where a result comes from: it came with glbench, is the user's own, or is the user's own with other seeds than the task's."""
ORIGINS: tuple[Origin, ...] = ("released", "own", "trial")


@dataclass(frozen=True)
class StoredResult:
    """A result, the file that holds it, and whether its runs were reproduced, here or before it was released."""

    path: Path
    result: Result
    reproduced: bool = False
    trial: bool = False
    """Whether its seeds are known not to be the task's."""
    confirmed: bool = False
    """Whether it came with glbench, and the user's own evaluation gave the same runs."""

    @property
    def released(self) -> bool:
        """Whether it came with glbench, as read-only data of the package; otherwise it is the user's own."""
        return is_released(self.path)

    @property
    def origin(self) -> Origin:
        """Released, the user's own, or a trial."""
        return "released" if self.released else "trial" if self.trial else "own"

    @property
    def board(self) -> str:
        """Name of the leaderboard that it belongs to: the task's id, and what keeps it apart from other draws of the task.

        Runs under a secret salt, or on another split than the one that agents are judged by, stand on boards of their own.
        """
        task = self.result.task
        apart = None if task.split == "test" else task.split, task.salt_commitment
        return "@".join([task.id, *filter(None, apart)])

    @cached_property
    def task(self) -> TaskSpec | None:
        """The definition of its task: as published, else as stored beside the result; ``None`` where neither has it with its digest."""
        locked = read_lock().get(self.result.task.id)
        if locked is not None and locked.digest == self.result.task.digest:
            return published_task(self.result.task.id)
        try:
            if profile_path(self.path).exists():
                definition = read_profile(profile_path(self.path)).text_of_task
            else:
                definition = recorded_actions(self.result, self.path).definition
            return _defined_task(definition, self.result.task.id, self.result.task.digest, self.result.task.steps)
        except GlbenchError:
            return None


@lru_cache(maxsize=64)
def _defined_task(definition: bytes, task_id: str, digest: str, steps: int) -> TaskSpec | None:
    """The task that ``definition`` defines; ``None`` where it is another one. What tables need of it is resolved here."""
    task = task_of(definition)
    if (task.id, task.steps) != (task_id, steps) or task.digest != digest:
        return None
    catalogue(task)
    return task


def years_of_runs(item: StoredResult) -> tuple[int, ...]:
    """Weather year of each run; empty if all are of one year, or the task's definition or its secret salt is not known.

    Raises ``TaskError`` when the task has no such split, or the weather record lacks its years.
    """
    evaluated, task = item.result.task, item.task
    if task is None or evaluated.salt_commitment != task.salt_commitment:
        return ()
    return run_years(task.scored_in(evaluated.split), item.result.evaluation.seeds)


def task_of_board(board: str) -> str:
    """Id of the task of a board, see ``StoredResult.board``; no id holds an ``@``."""
    return board.partition("@")[0]


def short_board(board: str) -> str:
    """A board with the first 16 digits of its commitment, as people write it."""
    return re.sub(r"(@\w{16})\w{48}$", r"\1", board)


@dataclass(frozen=True)
class Expectation:
    """What a published task asks of a result that wants a rank: the task's digest, the evaluation seeds, and the metric that ranks."""

    digest: str
    seeds: tuple[int, ...]
    metric: str = "reward"


def collect_results(folders: Iterable[Path]) -> tuple[StoredResult, ...]:
    """Read every ``*.json`` below ``folders``, sorted by task id and agent name; of two results the earlier folder's counts.

    Raises ``ResultError`` when a file is no valid result, or when one folder holds two results of one agent and task.
    """
    results, problems = collect_readable(folders)
    if problems:
        raise problems[0]
    return results


def collect_readable(folders: Iterable[Path]) -> tuple[tuple[StoredResult, ...], tuple[ResultError, ...]]:
    """As ``collect_results``, but files that are no valid result are left out, and the errors that say why returned beside the rest."""
    results: dict[tuple[str, str], StoredResult] = {}
    problems: list[ResultError] = []
    for folder in {folder.resolve(): folder for folder in folders if folder.is_dir()}.values():
        here, unreadable = read_folder(folder)
        problems += unreadable
        results = {**_single(here), **results}
    return tuple(results[key] for key in sorted(results)), tuple(problems)


def read_folder(folder: Path) -> tuple[list[StoredResult], list[ResultError]]:
    """Every result below ``folder``, and an error for every ``*.json`` that is none; both are empty where there is no folder."""
    results, problems = [], []
    for path in sorted(folder.rglob("*.json")):
        if path.name.endswith(SUFFIX):
            continue
        try:
            results.append(StoredResult(path, load_result(path), reproduced=was_reproduced(path)))
        except ResultError as error:
            problems.append(error)
    return results, problems


def refuse_mixed_digests(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> None:
    """Results under one task id must be results of one and the same task.

    Raises ``ResultError`` when the digests of a task's results differ from each other, or from the published digest in ``expected``.
    """
    items = list(stored)
    strangers = [problem for item in items if (problem := _problem_of_task(item, expected.get(item.result.task.id)))]
    problems = [*map(ResultError, strangers), *_one_version_each(items)[1]]
    if problems:
        raise problems[0]


def _single(stored: Iterable[StoredResult]) -> dict[tuple[str, str], StoredResult]:
    results, doubles = _one_each(stored)
    if doubles:
        raise doubles[0]
    return results


def published_expectations() -> dict[str, Expectation]:
    """Expectation of every locked task by id. The digests are those of the lock; nothing is computed again."""
    locked = read_lock()
    return {
        task.id: Expectation(
            digest=locked[task.id].digest,
            seeds=tuple(range(task.evaluation.first_seed, task.evaluation.first_seed + task.evaluation.runs)),
            metric=task.evaluation.metric,
        )
        for task in list_tasks()
        if task.id in locked
    }


def own_and_released_results(out: Path) -> tuple[tuple[StoredResult, ...], tuple[ResultError, ...]]:
    """The results that came with glbench, those in ``<out>/results``, and the trials of agents that have no full result there.

    A released result always keeps its place. The user's own evaluation of a built-in agent takes a place that is free, is not needed where
    it has the bits of the released one, and is left out where it differs. Whatever bears the name of a released agent and is another one is
    left out, and so is a file that cannot be ranked. In the folder of a sealed round, where all results are of one, only these are
    returned. Raises ``ResultError`` when the released results hold two of one agent and task.

    Returns at most one result an agent and task, sorted by task id and agent name; and an error for every file that is left out.
    """
    home = data_folder("reports/released/results")
    released, problems = read_folder(home)
    results = _single(released)
    agents = {item.result.agent.name: item.result.agent for item in released}
    by_skeleton = {skeleton(name): name for name in (*agents, *baseline_names())}
    expected = published_expectations()
    for folder, of_trials in ((out / "results", False), *((out / place / "results", True) for place in (TRIALS, VALIDATION))):
        if real_path(folder) == real_path(home):
            continue
        items, unreadable = read_folder(folder)
        problems += unreadable
        own = []
        for item in items:
            result = item.result
            published = expected.get(result.task.id)
            problem = (
                _name_problem(item, agents, by_skeleton)
                or _problem_of_task(item, published)
                or _problem_of_row(item)
                or _problem_beside(item, results.get((item.board, result.agent.name)))
            )
            if problem is not None:
                problems.append(ResultError(problem))
                continue
            is_trial = of_trials or (item.task is not None and tuple(item.task.evaluation.seeds) != result.evaluation.seeds)
            own.append(replace(item, trial=is_trial))
        single, doubles = _one_each(own, folder.parent)
        problems += doubles
        for key, item in single.items():
            place = results.setdefault(key, item)
            if place.released and same_runs(item.result, place.result):
                results[key] = replace(place, confirmed=True)
    mine = {key: item for key, item in results.items() if not item.released}
    if mine and all(item.result.task.salt_commitment for item in mine.values()):
        results = mine
    ranked, strangers = _one_version_each([results[key] for key in sorted(results)])
    return ranked, (*problems, *strangers)


def _name_problem(item: StoredResult, released: Mapping[str, AgentRecord], by_skeleton: Mapping[str, str]) -> str | None:
    """Why a result cannot stand under its agent's name; ``None`` where it can.

    The names of built-in agents and of ``released`` ones belong to them; ``by_skeleton`` are all of these names.
    """
    agent = item.result.agent
    alike = [by_skeleton[one] for one in skeletons(agent.name) if one in by_skeleton]
    namesake = agent.name if agent.name in alike else min(alike, default=None)
    if namesake is None:
        if agent.kind != "baseline":
            return None
        return f"{item.path} calls '{agent.name}' a baseline, and glbench has none of that name."
    if agent.name == namesake:
        identity, original = (agent.digest, agent.kind, agent.privileged), released.get(agent.name)
        if original is not None and identity == (original.digest, original.kind, original.privileged):
            return None
        shipped = agent.kind == "baseline" and agent.digest in digests_of_baseline(agent.name)
        if shipped and agent.privileged == (shipped_sight(agent.name) != "observations"):
            return None
    same = "is the name" if agent.name == namesake else f"looks like '{namesake}', the name"
    return (
        f"{item.path} is of another agent than the one that came with glbench: '{agent.name}' {same} of that one, and the digest, "
        f"kind or privileges differ. Give the agent another name and evaluate it again."
    )


def _one_each(stored: Iterable[StoredResult], out: Path | None = None) -> tuple[dict[tuple[str, str], StoredResult], list[ResultError]]:
    """One result an agent and task, the one in its place below ``out`` before all others; and an error for each other."""
    results: dict[tuple[str, str], StoredResult] = {}
    problems = []

    def elsewhere(item: StoredResult) -> bool:
        return out is None or item.path != result_path(out, item.result.task.id, item.result.agent.name)

    for item in sorted(stored, key=elsewhere):
        key = task_id, name = item.board, item.result.agent.name
        if key in results:
            msg = (
                f"{item.path} is a second result of '{name}' on '{task_id}', beside {results[key].path}. "
                "Remove one, or give one of the agents another name."
            )
            problems.append(ResultError(msg))
        else:
            results[key] = item
    return results, problems


def _weight(items: list[StoredResult]) -> tuple[int, int, str]:
    """What the results of one version of a task weigh against those of another; ``created`` is a claim, so it comes last."""
    return len(items), sum(item.reproduced for item in items), max((item.result.created for item in items), default="")


def _one_version_each(stored: list[StoredResult]) -> tuple[tuple[StoredResult, ...], list[ResultError]]:
    """Of each task the version with the most results, and an error for each result of another.

    Of equally many counts the version with more reproduced ones; failing that, that of the latest.
    """
    by_digest: dict[tuple[str, str], list[StoredResult]] = {}
    for item in stored:
        by_digest.setdefault((item.result.task.id, item.result.task.digest), []).append(item)
    best: dict[str, list[StoredResult]] = {}
    for (task_id, _), items in by_digest.items():
        best[task_id] = max(best.get(task_id, []), items, key=_weight)
    current, problems = [], []
    for item in stored:
        task = item.result.task
        digest = best[task.id][0].result.task.digest
        if task.digest == digest:
            current.append(item)
            continue
        msg = (
            f"{item.path} is of another version of '{task.id}' (digest {task.digest[:12]}...) than most results of it "
            f"({digest[:12]}...). Evaluate the agent again, or give the changed task another id."
        )
        problems.append(ResultError(msg))
    return tuple(current), problems


def _problem_of_task(item: StoredResult, published: Expectation | None) -> str | None:
    """Why a result cannot stand under the id of a published task; ``None`` where it can, or where the task is a user's own."""
    task = item.result.task
    if published is None or task.digest == published.digest:
        return None
    return (
        f"{item.path} is not of '{task.id}' as it is published (digest {task.digest[:12]}..., published {published.digest[:12]}...): it "
        "was made with another definition, other weather or another version of the model. Evaluate the agent again with `glbench evaluate`."
    )


def _problem_of_row(item: StoredResult) -> str | None:
    """Why no table can have a row of a result; ``None`` where it can."""
    try:
        years_of_runs(item)
        fresh_score(item.result)
        task, own = item.task and item.task.scored_in(item.result.task.split), item.result
    except GlbenchError as error:
        return f"{item.path} cannot be ranked: {error}"
    units = {} if task is None else units_of(task)
    if task is not None and (own.task.split != task.split or any(units.get(name, unit) != unit for name, unit in own.units.items())):
        return f"{item.path} states a split or units that are not those of '{task.id}'. Evaluate the agent again with `glbench evaluate`."
    return None


def same_runs(own: Result, released: Result) -> bool:
    """Whether an evaluation has the bits of a released one; of a baseline also where it had an earlier digest then."""
    digests = digests_of_baseline(own.agent.name) if own.agent.kind == "baseline" else ()
    shipped = {own.agent.digest, released.agent.digest} <= {*digests} and own.task.digest == released.task.digest
    return own.results_digest == released.results_digest or (shipped and own.runs == released.runs)


def _problem_beside(item: StoredResult, released: StoredResult | None) -> str | None:
    """Why an evaluation of the user's own is not shown beside the released one with the same seeds; ``None`` if it is."""
    if released is None or item.result.evaluation.seeds != released.result.evaluation.seeds:
        return None
    if same_runs(item.result, released.result):
        return None
    words = catalogue_of(item.task, item.result.units)
    metric = words.score if item.task is None else words.metrics[item.task.evaluation.metric]
    name, means = item.result.agent.name, (one.result.summary.mean.get(metric.name) for one in (item, released))
    own, theirs = ("not stated" if mean is None else metric.number(mean) for mean in means)
    return (
        f"{item.path} differs from the released result of '{name}', which keeps its row: {metric.words} {own}, released {theirs}. "
        f"{_what_differs(item.result, released.result)} See both with `glbench compare {name} {shlex.quote(str(item.path))}`."
    )


def _what_differs(own: Result, released: Result) -> str:
    """What can explain other numbers, as far as the results state it."""
    pairs = {
        "task": (own.task.digest[:8], released.task.digest[:8]),
        "agent": (own.agent.digest[:8], released.agent.digest[:8]),
        "kernel": (_kernel(own), _kernel(released)),
        "processor": (own.machine.processor, released.machine.processor),
        **{name: (number, released.versions.model_dump()[name]) for name, number in own.versions.model_dump().items()},
    }
    differing = [f"{name} ({mine}, released {theirs})" for name, (mine, theirs) in pairs.items() if mine != theirs]
    return f"What differs: {', '.join(differing)}." if differing else "The files state no reason."


def _kernel(result: Result) -> str:
    kernel = result.evaluation.kernel
    return "/".join(str(kernel[key])[:16] for key in ("backend", "preset", "library_digest") if key in kernel)
