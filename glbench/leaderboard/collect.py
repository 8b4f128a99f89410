"""Finding result files, and refusing sets of results that cannot be compared."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from glbench.errors import ResultError
from glbench.evaluation import Result, load_result
from glbench.resources import is_released
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

    @property
    def released(self) -> bool:
        """Whether it came with glbench, as read-only data of the package; otherwise it is the user's own."""
        return is_released(self.path)

    @property
    def origin(self) -> Origin:
        """Released, the user's own, or a trial."""
        return "released" if self.released else "trial" if self.trial else "own"


@dataclass(frozen=True)
class Expectation:
    """What a published task asks of a result that wants a rank: the task's digest, the evaluation seeds, and the metric that ranks."""

    digest: str
    seeds: tuple[int, ...]
    metric: str = "reward"


def collect_results(folders: Iterable[Path]) -> tuple[StoredResult, ...]:
    """Read every ``*.json`` below ``folders``; of two results of one agent and task the earlier folder's counts.

    Returns
    -------
    tuple of StoredResult
        Sorted by task id, then agent name.

    Raises
    ------
    ResultError
        When a file is no valid result, or when one folder holds two results of one agent and task.
    """
    results, problems = collect_readable(folders)
    if problems:
        raise problems[0]
    return results


def collect_readable(folders: Iterable[Path]) -> tuple[tuple[StoredResult, ...], tuple[ResultError, ...]]:
    """As ``collect_results``, but files that are no valid result are left out, and the errors that say why returned beside the rest.

    Raises
    ------
    ResultError
        When one folder holds two results of one agent and task.
    """
    chosen: dict[tuple[str, str], StoredResult] = {}
    problems: list[ResultError] = []
    for folder in _distinct(folders):
        here, unreadable = read_folder(folder)
        problems += unreadable
        chosen = {**by_task_and_agent(here), **chosen}
    return tuple(chosen[key] for key in sorted(chosen)), tuple(problems)


def read_folder(folder: Path) -> tuple[list[StoredResult], list[ResultError]]:
    """Every result below ``folder``, and an error for every ``*.json`` that is none; both are empty where there is no folder."""
    found, problems = [], []
    for path in sorted(folder.rglob("*.json")):
        if path.name.endswith(SUFFIX):
            continue
        try:
            found.append(StoredResult(path, load_result(path), reproduced=was_reproduced(path)))
        except ResultError as error:
            problems.append(error)
    return found, problems


def by_task_and_agent(stored: Iterable[StoredResult]) -> dict[tuple[str, str], StoredResult]:
    """Results by task id and agent name.

    Raises
    ------
    ResultError
        When there are two results of one agent and task.
    """
    found: dict[tuple[str, str], StoredResult] = {}
    for item in stored:
        key = (item.result.task.id, item.result.agent.name)
        if key in found:
            msg = (
                f"Two results of agent '{key[1]}' on task '{key[0]}': {found[key].path} and {item.path}. "
                "Remove one, or give one of the agents another name."
            )
            raise ResultError(msg)
        found[key] = item
    return found


def refuse_mixed_digests(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> None:
    """Results under one task id must be results of one and the same task.

    Raises
    ------
    ResultError
        When the digests of a task's results differ from each other, or from the published digest in ``expected``.
    """
    by_task: dict[str, dict[str, list[StoredResult]]] = {}
    for item in stored:
        by_task.setdefault(item.result.task.id, {}).setdefault(item.result.task.digest, []).append(item)
    for task_id, by_digest in by_task.items():
        published = expected.get(task_id)
        if published is not None:
            strangers = [item for digest, items in by_digest.items() if digest != published.digest for item in items]
            if strangers:
                raise ResultError(_stranger_message(task_id, published.digest, strangers))
        elif len(by_digest) > 1:
            raise ResultError(_mixture_message(task_id, by_digest))


def _distinct(folders: Iterable[Path]) -> list[Path]:
    """The folders that exist, each once, in the order given."""
    return list({folder.resolve(): folder for folder in folders if folder.is_dir()}.values())


def _stranger_message(task_id: str, digest: str, strangers: list[StoredResult]) -> str:
    files = "\n".join(f"  {item.path} ({item.result.task.digest[:12]}...)" for item in strangers)
    return (
        f"These results are not of '{task_id}' as it is published (digest {digest[:12]}...):\n{files}\n"
        "They were made with another definition, other weather or another version of the model, and cannot be ranked with it. "
        "Evaluate these agents again with `glbench evaluate`, or move the files away."
    )


def _mixture_message(task_id: str, by_digest: Mapping[str, list[StoredResult]]) -> str:
    lines = [
        f"  {digest[:12]}...: {', '.join(str(item.path) for item in items)}" for digest, items in by_digest.items()
    ]
    return (
        f"The results under the task id '{task_id}' are of {len(by_digest)} different tasks:\n"
        + "\n".join(lines)
        + "\n"
        "Evaluate the agents again on one definition of the task, or give the changed task another id."
    )
