"""The task of an agent in a sandbox, where there are no task files: its definition without seeds and salts.

An evaluation passes the definition of its task to the agent's process, which calls ``set_task`` with it. From then on ``get_task`` finds
that task there, and no other. It is as public as the card: models, parameters, limits, prices and how widely things are drawn. Weather
that it names is not there, so whatever needs weather fails.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from glbench.errors import TaskError

if TYPE_CHECKING:
    from glbench.tasks.spec import TaskSpec

_DEFINITION: list[str] = []


def public_definition(task: TaskSpec) -> str:
    """The definition of ``task`` for its agents as text: without the first seed and the salt; "" for a task that has no file.

    A round's secret, the split and where the file lies are not part of it.
    """
    try:
        tables: dict[str, Any] = task.written()
    except TaskError:
        return ""
    tables["evaluation"]["first_seed"] = 0
    tables.get("scenario", {}).pop("salt", None)
    return json.dumps(tables)


def set_task(definition: str) -> None:
    """Let ``get_task`` find the task of a ``public_definition``, in the life of this process."""
    _DEFINITION[:] = [definition] if definition else []


def injected_task(task_id: str) -> TaskSpec | None:
    """The injected task, if that is its id or its short form.

    Raises
    ------
    TaskError
        When its parts are not known here: somebody registered them in another process.
    """
    if not _DEFINITION:
        return None
    task = _read(_DEFINITION[0])
    return task if task_id in (task.id, task.short_id) else None


@lru_cache(maxsize=1)
def _read(definition: str) -> TaskSpec:
    from glbench.tasks.spec import TaskSpec

    try:
        return TaskSpec.of_written(json.loads(definition))
    except ValueError as error:
        msg = f"The task cannot be read in this process: {error}"
        raise TaskError(msg) from error
