"""A task's definition as JSON inside a record, and back: a record of a user's own task can be replayed without the task's file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from pydantic import ValidationError

from glbench.errors import EpisodeError
from glbench.untrusted import parse_json, visible

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec


def definition_json(task: TaskSpec) -> bytes:
    """The definition of ``task``, prose included, as JSON for people and programs."""
    return (json.dumps(task.attachment(), indent=2, ensure_ascii=False) + "\n").encode()


def task_of(definition: bytes) -> TaskSpec:
    """The task that a record's attached definition defines. Whether it is the right one, its digest tells.

    Raises
    ------
    EpisodeError
        When the attachment defines no task.
    """
    from glbench.tasks import TaskSpec

    try:
        return TaskSpec.of_attachment(parse_json(definition))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, ValidationError) as error:
        msg = f"The task definition in the record cannot be read ({visible(' '.join(str(error).split())[:200])}). Evaluate again."
        raise EpisodeError(msg) from error
