"""Zero and one of normalised scores: the reward of doing nothing, and the mean over the best known runs (``best_known.py``).

``tasks/references.toml`` holds both for every published task. It stands beside the locked definitions and is no part of them: the
best known result changes when somebody does better, the task does not.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict, model_validator

from glbench.errors import TaskError
from glbench.registration import REFERENCES_NAME
from glbench.resources import data_folder, write_atomically

_HEAD = """# Zero and one of normalised scores: the mean reward of doing nothing (submissions/do_nothing.py) and that of the best known
# run of each seed (tasks/best_known), over the task's runs. Written by `glbench tasks references --write` from reports/released.
"""


class References(BaseModel):
    """Zero and one of a task's normalised score; rewards have no unit."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    nothing: float
    nothing_results_digest: str
    best: float
    best_agent: str
    best_results_digest: str
    """Digests of the results that the best known runs are taken from, with a space between two, by the agents' names."""

    @model_validator(mode="after")
    def _in_order(self) -> References:
        if not self.best > self.nothing:
            msg = f"the best known reward {self.best:g} is not above that of doing nothing, {self.nothing:g}"
            raise ValueError(msg)
        return self


def references_path() -> Path:
    """The file."""
    return data_folder("tasks") / REFERENCES_NAME


@cache
def read_references() -> Mapping[str, References]:
    """References by task id; a task that nobody has evaluated yet is missing.

    Raises
    ------
    TaskError
        When the file cannot be used.
    """
    path = references_path()
    if not path.is_file():
        return {}
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return {task_id: References.model_validate(entry) for task_id, entry in data.items()}
    except (OSError, ValueError, RecursionError) as error:
        msg = f"{path} cannot be used: {error}. `glbench tasks references --write` makes it again from the results."
        raise TaskError(msg) from error


def write_references(references: Mapping[str, References]) -> Path:
    """Write the file and return where it is.

    Raises
    ------
    GlbenchError
        When it cannot be written.
    """
    parts = [_HEAD]
    for task_id, one in sorted(references.items()):
        parts.append(
            f'["{task_id}"]\n'
            f"nothing = {one.nothing!r}\n"
            f'nothing_results_digest = "{one.nothing_results_digest}"\n'
            f"best = {one.best!r}\n"
            f'best_agent = "{one.best_agent}"\n'
            f'best_results_digest = "{one.best_results_digest}"\n'
        )
    write_atomically(references_path(), "\n".join(parts))
    read_references.cache_clear()
    return references_path()
