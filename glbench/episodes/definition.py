"""A task's definition as JSON inside a record, and back: a record of a user's own task can be replayed without the task's file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from glbench.errors import EpisodeError
from glbench.untrusted import parse_json, visible

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec


def definition_json(task: TaskSpec) -> bytes:
    """The definition of ``task``, prose included, as JSON for people and programs."""
    if task.schema_version > 1:
        return (json.dumps(task.written(), indent=2, ensure_ascii=False) + "\n").encode()
    plain: dict[str, Any] = task.model_dump(mode="json", by_alias=True)
    plain["model"]["overrides"] = {name: [value, unit] for name, value, unit in task.model.overrides}
    return (json.dumps(plain, indent=2, ensure_ascii=False) + "\n").encode()


def task_of(definition: bytes) -> TaskSpec:
    """The task that a record's attached definition defines. Whether it is the right one, its digest tells.

    Raises
    ------
    EpisodeError
        When the attachment defines no task.
    """
    from glbench.tasks import TaskSpec
    from glbench.tasks.serialisation import tables_of_schema_1, with_dates

    try:
        plain = parse_json(definition)
        if plain.get("schema") != 1:
            return TaskSpec.of_written(plain)
        return TaskSpec.model_validate(with_dates(tables_of_schema_1(plain)))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, ValidationError) as error:
        msg = f"The task definition in the record cannot be read ({visible(' '.join(str(error).split())[:200])}). Evaluate again."
        raise EpisodeError(msg) from error
