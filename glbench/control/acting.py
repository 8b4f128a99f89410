"""From controls that are planned to the actions that bring them about."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.actuation import off_position
from glbench.errors import TaskError

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]


def actions_of(task: TaskSpec, before: Floats, wanted: Floats) -> Floats:
    """What an agent has to do to get from the controls in force ``(..., c)`` to those wanted ``(..., c)``; ``(..., actions)``.

    A control that is off or on is asked for the nearest that it can do; whether it may be switched is not looked at.

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
    change = wanted[..., granted] - before[..., granted]
    for place, name in enumerate(task.actuation.controls):
        if name in task.on_off:
            machine, control = task.on_off[name], names.index(name)
            off = off_position(task, machine)
            there, here = (
                np.where(u >= 0.5 * machine.lowest, np.maximum(u, machine.lowest), off)
                for u in (wanted[..., control], before[..., control])
            )
            change[..., place] = there - here
    return np.clip(change / task.actuation.max_change, -1.0, 1.0)
