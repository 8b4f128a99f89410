"""What one step of a simulation gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from glbench.kernel import StepFailure


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """``array``, which nobody can write to any more."""
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class StepResult:
    """What one step of ``n`` runs gave.

    Attributes
    ----------
    observations
        ``(n, columns)`` float32.
    rewards
        ``(n,)``.
    terminated
        ``(n,)``; whether the run has ended, in this step or before.
    failed
        Runs that could not be integrated in this step, with the reason in words. Such a run keeps its state and ends. Its
        reward, EPI and penalty are what the task counts for one failed step; the other quantities are those of a step
        in which nothing grew.
    quantities
        Each ``(n,)``; names and units in ``glbench.env.QUANTITIES``. 0 for a run that had ended before.
    """

    observations: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    failed: list[StepFailure]
    quantities: dict[str, NDArray[np.float64]]
