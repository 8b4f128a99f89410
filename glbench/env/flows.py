"""What flowed in the steps of runs, from their states and controls: flows of the model, whether a ledger prices them or not."""

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.model import Step

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.floating]


def flow_amounts(task: TaskSpec, names: Collection[str], x: Floats, u: Floats) -> dict[str, NDArray[np.float64]]:
    """Amounts of the flows ``names`` of the task's model in every step, each as ``u`` without its last axis.

    Parameters
    ----------
    task
        Whose model and nominal parameters count.
    names
        Those that the model does not have are left out.
    x
        States ``(steps + 1, ..., states)``, the start included.
    u
        Controls ``(steps, ..., controls)``.
    """
    model = task.model_value
    held = np.concatenate([np.zeros_like(u[:1]), u[:-1]])
    step = Step(
        before=model.State(*np.moveaxis(x[:-1], -1, 0)),
        after=model.State(*np.moveaxis(x[1:], -1, 0)),
        controls=model.Controls(*np.moveaxis(u, -1, 0)),
        parameters=model.Parameters(*task.parameters().tolist()),
        seconds=task.step_seconds,
        held=model.Controls(*np.moveaxis(held, -1, 0)),
    )
    return {
        flow.name: np.broadcast_to(np.asarray(flow.amount(step), dtype=np.float64), u.shape[:-1])
        for flow in model.flows()
        if flow.name in names
    }
