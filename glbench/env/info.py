"""Contents of ``info`` after a reset and a step: flat names, plain numbers, one unit each."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.simulation import Simulation, StepResult
from glbench.quantities import CLOCK
from glbench.tasks import TaskSpec
from glbench.tasks.ledger import LIMITED, StepQuantity

FAILURE = "failure"
"""Key of the reason, in words, why a step could not be integrated; there only when that happened."""

STEP_REWARD = "step_reward"
"""Key of the reward: tools that merge ``info`` with what a step returns (TorchRL) have a ``reward`` of their own."""


def info_quantities(task: TaskSpec) -> tuple[StepQuantity, ...]:
    """Names, units and meanings of the numbers in ``info``; the last, the quantities of the step, are missing after a reset."""
    return (
        StepQuantity("seed", "-", "seed of the episode"),
        StepQuantity("step", "-", "steps taken"),
        *(StepQuantity(entry.name, entry.unit, entry.at_end) for entry in CLOCK.values()),
        *(
            StepQuantity(name, unit, f"{name.replace('_', ' ')} inside, true value")
            for name, unit in LIMITED.items()
            if task.model_value.air is not None
        ),
        *(StepQuantity(capacity.quantity, capacity.unit, capacity.meaning) for capacity in task.capacities()),
        *(replace(q, name=STEP_REWARD) if q.name == "reward" else q for q in task.quantities),
    )


_NO_SEEDS: NDArray[Any] = np.empty(0, dtype=np.int64)


def add_objects(info: dict[str, Any], name: str, objects: dict[int, Any], n: int) -> None:
    """Add what only some rows have, by row, in Gymnasium's form: an array of objects and its mask."""
    array, mask = np.full(n, None, dtype=object), np.zeros(n, dtype=np.bool_)
    for row, value in objects.items():
        array[row], mask[row] = value, True
    info[name], info[f"_{name}"] = array, mask


def add_failures(info: dict[str, Any], result: StepResult) -> None:
    """Add the reasons of the rows that could not be integrated, if any."""
    if result.failed:
        add_objects(info, FAILURE, {failure.row: failure.reason for failure in result.failed}, len(result.rewards))


class InfoWriter:
    """Makes ``info`` from a simulation and what its last step gave."""

    def __init__(self, task: TaskSpec) -> None:
        names = tuple(quantity.name for quantity in info_quantities(task))
        self._of_info = names[1 : len(names) - len(task.quantities)]
        self._of_step = names[1:]
        self._quantities = frozenset(names[len(names) - len(task.quantities) :])
        self._masks = tuple(f"_{name}" for name in names)
        # Filling in a dictionary that has its keys is quicker than making one.
        self._empty = dict.fromkeys(names)
        self._seeds = self._seed_column = _NO_SEEDS

    def columns(self, simulation: Simulation, result: StepResult | None) -> dict[str, NDArray[np.generic]]:
        """Every quantity of ``info_quantities`` for all rows, each ``(n,)``."""
        if simulation.seeds is not self._seeds:
            self._seeds = self._seed_column = seeds = simulation.seeds
            if int(seeds.max()) < 2**63:  # every library can index int64
                self._seed_column = seeds.astype(np.int64)
        columns: dict[str, NDArray[np.generic]] = {"seed": self._seed_column}
        columns.update(zip(self._of_info, simulation.info_columns, strict=True))
        columns["step"] = simulation.k
        if result is not None:
            columns.update(zip(self._of_step[len(self._of_info) :], result.table, strict=True))
        return columns

    def masked(self, columns: dict[str, NDArray[np.generic]], rows: NDArray[np.bool_], stepped: NDArray[np.bool_]) -> dict[str, Any]:
        """Columns with Gymnasium's masks: those of a step hold for the rows in ``stepped``, others for ``rows``; elsewhere 0."""
        info: dict[str, Any] = {}
        in_step, in_row = (stepped, bool(stepped.all())), (rows, bool(rows.all()))
        for name, values in columns.items():
            mask, everywhere = in_step if name in self._quantities else in_row
            info[name] = values if everywhere else np.where(mask, values, np.zeros_like(values))
            info[f"_{name}"] = mask
        return info

    def everywhere(self, columns: dict[str, NDArray[np.generic]], n: int) -> dict[str, Any]:
        """Columns that hold for all ``n`` rows, with Gymnasium's masks."""
        masks = self._masks if len(columns) == len(self._masks) else self._masks[: len(columns)]
        return columns | dict.fromkeys(masks, np.ones(n, dtype=np.bool_))

    def standing(self, simulation: Simulation) -> dict[str, object]:
        """The same for the only row of a simulation that was reset, as plain numbers."""
        return {name: column.item() for name, column in self.columns(simulation, None).items()}

    def stepped(self, simulation: Simulation, numbers: list[float]) -> dict[str, Any]:
        """The same after a step, from its numbers (``Simulation.step_single``)."""
        info: dict[str, Any] = self._empty.copy()
        info.update(zip(self._of_step, numbers, strict=True))
        info["seed"], info["step"] = simulation.seeds.item(), int(numbers[0])
        return info
