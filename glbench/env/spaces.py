"""Gymnasium's view of a task: its spaces, and what else both kinds of environment check alike."""

from __future__ import annotations

from typing import TypeAlias, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from glbench.env.actuation import action_bounds
from glbench.tasks import TaskSpec, get_task

Vectors: TypeAlias = "spaces.Space[NDArray[np.float32]]"
"""A ``Box`` of float32 (Gymnasium's annotations do not say which numbers a box holds)."""


def the_task(task: TaskSpec | str) -> TaskSpec:
    """A task from itself, its id, or the path of its file."""
    return task if isinstance(task, TaskSpec) else get_task(task)


def observation_space(task: TaskSpec) -> Vectors:
    """Observed columns of a task with their finite bounds, float32."""
    columns = task.observed()
    low, high = [column.low for column in columns], [column.high for column in columns]
    box = spaces.Box(np.array(low, dtype=np.float32), np.array(high, dtype=np.float32), dtype=np.float32)
    return cast("Vectors", box)


def action_space(task: TaskSpec) -> Vectors:
    """Actions of a task with the bounds of its card, float32."""
    low, high = action_bounds(task)
    return cast("Vectors", spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32))
