"""Files about published tasks that are not part of their definition: best known runs, zero and one of scores, deprecations.

- ``tasks/best_known/<Task>.json`` holds, for each seed that a published task is scored by, the highest reward that any released result
  has there: what a score's regret is measured by. A best known run is not a bound: better ones may exist.
- ``tasks/references.toml`` holds zero and one of normalised scores for every published task: the mean reward of the agent that the entry
  names, which is stored once, and the mean over the best known runs.
- ``tasks/deprecated.toml`` lists published tasks that new work should not use, with the reason and a replacement. Such a task still runs,
  and its results load and can be reproduced. A warning is logged, once a process.

The first two files change when a better run is released; the tasks do not.
"""

from __future__ import annotations

import json
import logging
import tomllib
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from glbench.errors import TaskError, refuse
from glbench.registration import DEPRECATED_NAME, REFERENCES_NAME
from glbench.resources import data_folder, write_atomically
from glbench.settings import Table
from glbench.tasks.digest import lock_path

logger = logging.getLogger(__name__)

FOLDER = "best_known"
"""Beside the tasks."""
SEVERAL = "several"
"""Stands for the agents' names where the best known runs are not all of one."""


class KnownRun(Table):
    """The best known run with a seed: what it scored, and whose it is. Units are those of the file."""

    seed: int
    reward: float
    epi: float
    penalty: float
    agent: str


class BestKnown(Table):
    """The best known runs of a task, by seed, and the results that they are taken from."""

    model_config = ConfigDict(populate_by_name=True)

    schema_name: Literal["glbench/best-known"] = Field(default="glbench/best-known", alias="schema")
    schema_version: Literal[1] = 1
    task: str
    task_digest: str
    units: dict[str, str]
    """Of reward, epi and penalty."""
    agents: dict[str, str]
    """Digest of the results of each agent that has a best known run."""
    runs: tuple[KnownRun, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _is_consistent(self) -> Self:
        if list(self.seeds) != sorted(set(self.seeds)):
            refuse("the runs are not in the order of their seeds, or two have the same")
        if set(self.units) != {"reward", "epi", "penalty"}:
            refuse("the units are not those of reward, epi and penalty")
        if {run.agent for run in self.runs} != set(self.agents):
            refuse("the agents are not those of the runs")
        return self

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the runs."""
        return tuple(run.seed for run in self.runs)

    @property
    def agent(self) -> str:
        """Whose the runs are; ``several`` where they are not all of one agent."""
        return next(iter(self.agents)) if len(self.agents) == 1 else SEVERAL

    def of(self, seeds: Sequence[int]) -> tuple[KnownRun, ...]:
        """The runs with these seeds, in their order, without those that have no best known run."""
        by_seed = {run.seed: run for run in self.runs}
        return tuple(by_seed[seed] for seed in seeds if seed in by_seed)


def best_known_path(task_id: str) -> Path:
    """The file of a task."""
    return data_folder("tasks") / FOLDER / f"{task_id.rpartition('/')[2]}.json"


def read_best_known(task_id: str) -> BestKnown | None:
    """The best known runs of a task; ``None`` where there are none, as for custom tasks. Raises ``TaskError`` when the file is bad."""
    path = best_known_path(task_id)
    if not path.is_file():
        return None
    status = path.stat()
    best = _read(path, status.st_mtime_ns, status.st_size)
    return best if best.task == task_id else None


@lru_cache(maxsize=256)
def _read(path: Path, _changed: int, _size: int) -> BestKnown:
    """The content of a file, read once for each time of change and size."""
    try:
        return BestKnown.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        refuse(f"{path} cannot be used: {error}. `glbench tasks references --write` makes it again from the results.", TaskError, error)


def write_best_known(best: BestKnown) -> Path:
    """Write the file of a task, a line a run, and return where it is. Raises ``GlbenchError`` when it cannot be written."""
    path = best_known_path(best.task)
    head = best.model_dump_json(by_alias=True, exclude={"runs"}, indent=1).removesuffix("\n}")
    runs = ",\n".join(f"  {run.model_dump_json()}" for run in best.runs)
    write_atomically(path, f'{head},\n "runs": [\n{runs}\n ]\n}}\n')
    return path


_HEAD = """\
# Zero and one of normalised scores: means over the task's runs of what ranks, of zero_agent and of the best known run of each seed
# (tasks/best_known). For a new task write its id and zero_agent; `glbench tasks references --write` takes the rest from reports/released,
# and keeps every zero that is here. plans: whether plans that know the season made all best known runs. Where not, one is what ranked
# agents scored themselves. version: of the scale of the task, raised when zero or one moves.
"""


class References(Table):
    """Zero and one of a task's normalised score, in the unit of what ranks there."""

    version: int = Field(default=1, ge=1)
    """Of the scale: raised when zero or one moves. Scores on scales of different versions cannot be compared."""
    zero_agent: str
    """Whose mean is zero; a maintainer writes it, and the rest follows from results."""
    zero: float | None = None
    """Mean of that agent, of several trainings over all of them; stored once and kept, whatever results are added later."""
    zero_results_digest: str | None = None
    """Digests of its results, by the seeds of the trainings, with a space between two."""
    plans: bool = False
    """Whether all best known runs are of agents that know the season in advance. If not, one is what some ranked agent scores itself."""
    best: float | None = None
    """``None`` where no plans are known."""
    best_agent: str | None = None
    best_results_digest: str | None = None
    """Digests of the results that the best known runs are taken from, with a space between two, by the agents' names."""

    @model_validator(mode="after")
    def _in_order(self) -> References:
        if self.ends is not None and not self.ends[1] > self.ends[0]:
            refuse(f"the best known reward {self.best:g} is not above that of {self.zero_agent}, {self.zero:g}")
        if self.plans and self.best is None:
            refuse("there are plans, but no best known reward")
        return self

    @property
    def ends(self) -> tuple[float, float] | None:
        """Zero and one; ``None`` where one of them is missing."""
        return None if self.zero is None or self.best is None else (self.zero, self.best)


def references_path() -> Path:
    """The file."""
    return data_folder("tasks") / REFERENCES_NAME


@cache
def read_references() -> Mapping[str, References]:
    """References by task id; a task without results is missing. Raises ``TaskError`` when the file cannot be used."""
    return _entries(references_path(), References, "Restore the file: `glbench tasks references --write` takes what is missing.")


Entry = TypeVar("Entry", bound=BaseModel)


def _entries(path: Path, kind: type[Entry], advice: str) -> Mapping[str, Entry]:
    """The entries of a TOML file by task id; none where there is no file."""
    if not path.is_file():
        return {}
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return {task_id: kind.model_validate(entry) for task_id, entry in data.items()}
    except (OSError, ValueError, RecursionError) as error:
        refuse(f"{path} cannot be used: {error}. {advice}", TaskError, error)


def write_references(references: Mapping[str, References]) -> Path:
    """Write the file and return where it is. Raises ``GlbenchError`` when it cannot be written."""
    parts = [_HEAD]
    for task_id, one in sorted(references.items()):
        values = one.model_dump(exclude_none=True).items()
        parts.append(f'["{task_id}"]\n' + "".join(f"{key} = {json.dumps(value)}\n" for key, value in values))
    write_atomically(references_path(), "\n".join(parts))
    read_references.cache_clear()
    return references_path()


class Deprecation(Table):
    """Why a published task should not be used for new work."""

    since: str
    """Version of glbench, such as "0.2.0"."""
    reason: str = Field(min_length=10)
    """One sentence without a full stop at its end, such as "its forecast shows the weather of the next day exactly"."""
    use: str | None = None
    """Id of the task to use instead; ``None`` where there is none."""

    def in_words(self, task_id: str) -> str:
        """The sentence that users read."""
        instead = f" Use {self.use}." if self.use is not None else ""
        return f"{task_id} is deprecated since glbench {self.since}: {self.reason}.{instead}"


def read_deprecated() -> Mapping[str, Deprecation]:
    """Deprecated tasks by id. Raises ``TaskError`` when the file cannot be used."""
    path = lock_path().with_name(DEPRECATED_NAME)
    return _entries(path, Deprecation, "Restore the file; docs/maintain.md describes its entries.")


def warn_if_deprecated(task_id: str) -> None:
    """Log a warning when ``task_id`` is deprecated. Raises ``TaskError`` when the list of deprecated tasks cannot be used."""
    entry = read_deprecated().get(task_id)
    if entry is not None:
        logger.warning("%s", entry.in_words(task_id))
