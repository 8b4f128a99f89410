"""What one step of a simulation gives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.kernel.records import all_finite

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
    table
        The quantities of the step, ``(quantities, n)``; rows, units and meanings in ``task.quantities``. 0 for a run that
        had ended before.
    names
        Names of the quantities.
    """

    observations: NDArray[np.float32]
    rewards: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    failed: list[StepFailure]
    table: NDArray[np.float64]
    names: tuple[str, ...]

    @property
    def whole(self) -> bool:
        """Whether no run failed and every number is finite; huge ones (1e150) may count as infinite."""
        return not self.failed and all_finite(self.table)

    @cached_property
    def quantities(self) -> dict[str, NDArray[np.float64]]:
        """The rows of ``table`` by name, each ``(n,)``."""
        return dict(zip(self.names, self.table, strict=True))
