"""What ``info`` holds after a reset and a step: flat names, plain numbers, one unit each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.quantities import QUANTITIES, StepQuantity
from glbench.tasks.quantities import LIMITED

if TYPE_CHECKING:
    from glbench.env.simulation import Simulation
    from glbench.env.step_result import StepResult
    from glbench.tasks import TaskSpec

FAILURE = "failure"
"""Key of the reason, in words, why a step could not be integrated; there only when that happened."""


def info_quantities(task: TaskSpec) -> tuple[StepQuantity, ...]:
    """Names, units and meanings of the numbers in ``info`` for ``task``.

    The last group, the quantities of the step, is missing after a reset.
    """
    return (
        StepQuantity("seed", "-", "seed of the episode"),
        StepQuantity("step", "-", "steps taken"),
        StepQuantity("hour_of_day", "h", "clock at the end of the step"),
        StepQuantity("day_of_year", "day", "calendar at the end of the step, 0 at the start of 1 January"),
        *(StepQuantity(name, unit, f"{name.replace('_', ' ')} inside, true value") for name, unit in LIMITED.items()),
        *(StepQuantity(capacity.quantity, capacity.unit, capacity.meaning) for capacity in task.capacities()),
        *QUANTITIES,
    )


class InfoWriter:
    """Makes the columns of ``info`` from a simulation and, after a step, its result."""

    def __init__(self, task: TaskSpec) -> None:
        self._controls = tuple(capacity.quantity for capacity in task.capacities())
        self._at_one = np.array([capacity.at_one for capacity in task.capacities()])

    def columns(self, simulation: Simulation, result: StepResult | None) -> dict[str, NDArray[np.generic]]:
        """Every quantity of ``info_quantities`` for all rows, each ``(n,)``."""
        columns: dict[str, NDArray[np.generic]] = {
            "seed": simulation.seeds,
            "step": simulation.k,
            "hour_of_day": simulation.hour_of_day,
            "day_of_year": simulation.day_of_year,
        }
        columns.update(zip(LIMITED, simulation.air, strict=True))
        columns.update(zip(self._controls, (simulation.u * self._at_one).T, strict=True))
        if result is not None:
            columns.update(result.quantities)
        return columns

    def row(self, simulation: Simulation, result: StepResult | None) -> dict[str, object]:
        """The same for the only row of a simulation, as plain numbers."""
        info: dict[str, object] = {name: column.item() for name, column in self.columns(simulation, result).items()}
        if result is not None and result.failed:
            info[FAILURE] = result.failed[0].reason
        return info
