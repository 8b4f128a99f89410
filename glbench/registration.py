"""Gymnasium ids of the shipped tasks, registered by ``import glbench`` from the ids in the task files alone.

The environment, with the model and all that it needs, is loaded when one is made.
"""

from __future__ import annotations

import tomllib
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import gymnasium

from glbench.resources import data_folder

LOCK_NAME = "lock.toml"
REFERENCES_NAME = "references.toml"
BEHAVIOUR_NAME = "behaviour.toml"
DEPRECATED_NAME = "deprecated.toml"
DRAFTS = "drafts"
ENTRY_POINT = "glbench.env:GreenhouseEnv"
VECTOR_ENTRY_POINT = "glbench.env:GreenhouseVectorEnv"


def task_files() -> list[Path]:
    """Files of the shipped tasks, in the order of their names."""
    others = {LOCK_NAME, REFERENCES_NAME, BEHAVIOUR_NAME, DEPRECATED_NAME}
    return sorted(path for path in data_folder("tasks").glob("*.toml") if path.name not in others)


def draft_files() -> list[Path]:
    """Files of the shipped drafts: tasks that can be used but are not published, in the order of their names."""
    return sorted((data_folder("tasks") / DRAFTS).glob("*.toml"))


def task_ids() -> dict[str, Path]:
    """Ids of the shipped tasks, drafts included, and their files, read without checking anything else.

    Files that are no TOML or have no id are left out: one that is being edited must not keep the package from loading.
    ``get_task`` and ``glbench tasks check`` say what is wrong with them.
    """
    ids: dict[str, Path] = {}
    for path in (*task_files(), *draft_files()):
        with suppress(OSError, ValueError, RecursionError):
            status = path.stat()
            task_id = _id_in(path, status.st_mtime_ns, status.st_size)
            if isinstance(task_id, str):
                ids[task_id] = path
    return ids


@lru_cache(maxsize=256)
def _id_in(path: Path, _changed: int, _size: int) -> object:
    """What stands as the id in a file that was changed then and has that size: read once."""
    return tomllib.loads(path.read_text(encoding="utf-8")).get("id")


def task_argument(task_id: str) -> str:
    """Value of ``--task`` in a suggested command: the id of a shipped task, or the placeholder ``FILE.toml`` for any other."""
    return task_id if task_id in task_ids() else "FILE.toml"


def register_tasks() -> None:
    """Make the shipped tasks known to Gymnasium, for ``make`` and ``make_vec``; a second call changes nothing.

    A draft of a published task's next version is left out: beside it, Gymnasium would call the published one out of date.
    """
    ids = task_ids()
    published = {task_id.rpartition("-v")[0] for task_id, path in ids.items() if path.parent.name != DRAFTS}
    for task_id, path in ids.items():
        is_next = path.parent.name == DRAFTS and task_id.rpartition("-v")[0] in published
        if task_id not in gymnasium.registry and not is_next:
            gymnasium.register(
                id=task_id, entry_point=ENTRY_POINT, vector_entry_point=VECTOR_ENTRY_POINT, max_episode_steps=None, kwargs={"task": task_id}
            )
