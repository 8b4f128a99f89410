"""From controls that are planned to the actions that bring them about."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.errors import TaskError

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]


def actions_of(task: TaskSpec, before: Floats, wanted: Floats) -> Floats:
    """What an agent has to do to get from the controls in force ``(..., c)`` to those wanted ``(..., c)``; ``(..., actions)``.

    Raises
    ------
    TaskError
        When the task's actions are not about single controls: set points of a process computer.
    """
    names = task.model_value.control_names
    granted = [names.index(name) for name in task.actuation.controls]
    if task.actuation.kind == "set_point":
        return wanted[..., granted]
    if task.actuation.kind != "rate":
        msg = f"A plan gives controls, and the actions of {task.id} are of the kind '{task.actuation.kind}'."
        raise TaskError(msg)
    return np.clip((wanted[..., granted] - before[..., granted]) / task.actuation.max_change, -1.0, 1.0)
