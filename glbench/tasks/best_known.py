"""The best known run of every scenario of a task: what a score's regret is measured by.

``tasks/best_known/<Task>.json`` holds, for each seed that a published task is scored by, the highest reward that any released result has
there. The files stand beside the locked definitions and are no part of them: they change when somebody does better, the task does not.
A best known run is no bound. Nobody has shown that nothing better exists.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from glbench.errors import TaskError
from glbench.resources import data_folder, write_atomically

FOLDER = "best_known"
"""Beside the tasks."""
SEVERAL = "several"
"""Stands for the agents' names where the best known runs are not all of one."""


class KnownRun(BaseModel):
    """The best known run with a seed: what it scored, and whose it is. Units are those of the file."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    seed: int
    reward: float
    epi: float
    penalty: float
    agent: str


class BestKnown(BaseModel):
    """The best known runs of a task, by seed, and the results that they are taken from."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, populate_by_name=True)

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
            msg = "the runs are not in the order of their seeds, or two have the same"
            raise ValueError(msg)
        if set(self.units) != {"reward", "epi", "penalty"}:
            msg = "the units are not those of reward, epi and penalty"
            raise ValueError(msg)
        if {run.agent for run in self.runs} != set(self.agents):
            msg = "the agents are not those of the runs"
            raise ValueError(msg)
        return self

    @property
    def seeds(self) -> tuple[int, ...]:
        """Seeds of the runs."""
        return tuple(run.seed for run in self.runs)

    @property
    def agent(self) -> str:
        """Whose the runs are; ``several`` where they are not all of one agent."""
        return next(iter(self.agents)) if len(self.agents) == 1 else SEVERAL

    def of(self, seeds: Sequence[int]) -> tuple[KnownRun, ...] | None:
        """The runs with these seeds, in their order; ``None`` where there is no best known run of one of them."""
        by_seed = {run.seed: run for run in self.runs}
        return tuple(by_seed[seed] for seed in seeds) if set(seeds) <= by_seed.keys() else None


def best_known_path(task_id: str) -> Path:
    """The file of a task."""
    return data_folder("tasks") / FOLDER / f"{task_id.rpartition('/')[2]}.json"


def read_best_known(task_id: str) -> BestKnown | None:
    """The best known runs of a task; ``None`` where none are stored, as for every custom task.

    Raises
    ------
    TaskError
        When the file cannot be used.
    """
    path = best_known_path(task_id)
    if not path.is_file():
        return None
    status = path.stat()
    found = _read(path, status.st_mtime_ns, status.st_size)
    return found if found.task == task_id else None


@lru_cache(maxsize=256)
def _read(path: Path, _changed: int, _size: int) -> BestKnown:
    """What stands in a file that was changed then and has that size: read once."""
    try:
        return BestKnown.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        msg = f"{path} cannot be used: {error}. `glbench tasks references --write` makes it again from the results."
        raise TaskError(msg) from error


def write_best_known(known: BestKnown) -> Path:
    """Write the file of a task, a line a run, and return where it is.

    Raises
    ------
    GlbenchError
        When it cannot be written.
    """
    path = best_known_path(known.task)
    head = known.model_dump_json(by_alias=True, exclude={"runs"}, indent=1).removesuffix("\n}")
    runs = ",\n".join(f"  {run.model_dump_json()}" for run in known.runs)
    write_atomically(path, f'{head},\n "runs": [\n{runs}\n ]\n}}\n')
    return path
