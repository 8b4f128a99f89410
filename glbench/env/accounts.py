"""The accounts of a control step: what was used and grown, what that costs and earns, and how far the climate was off.

All amounts are per m2 of greenhouse floor. The economic performance indicator (EPI) is that of the GreenLight-Gym paper
(2025): the value of the dry matter allocated to fruit, sold fresh, minus heat, electricity and CO2. Screens and vents are
free. Growth earns when it happens, not when it is picked, which is right as long as no fruit is harvested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.quantities import QUANTITY_NAMES
from glbench.model import CONTROL_NAMES, STATE_NAMES
from glbench.tasks.quantities import LIMITED

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

JOULES_PER_KWH = 3.6e6
KG_PER_MG = 1e-6

PAID = tuple(CONTROL_NAMES.index(name) for name in ("uBoil", "uLamp", "uCo2"))
FRUIT_STATE = STATE_NAMES.index("cFruit")


@dataclass(frozen=True, eq=False)
class Accounts:
    """Everything that turns states and controls of a step into its quantities.

    Parameters
    ----------
    step_seconds
        Length of the control step [s].
    full_use
        Heat [kWh m-2], electricity [kWh m-2] and CO2 [kg m-2] of one step with the control at 1.
    unit_costs
        Prices of these three [EUR kWh-1, EUR kWh-1, EUR kg-1].
    fresh_per_dry
        Fresh fruit [kg m-2] per carbohydrate allocated to fruit [mg m-2].
    fruit_price
        EUR per kg of fresh fruit.
    full_growth
        Carbohydrate [mg m-2] allocated to fruit in one step at the nominal potential growth rate at 20 degC.
    low, high, scale
        Limits of air temperature [degC], CO2 [ppm] and relative humidity [%], and their penalty scales, each ``(3,)``.
    """

    step_seconds: float
    full_use: NDArray[np.float64]
    unit_costs: NDArray[np.float64]
    fresh_per_dry: float
    fruit_price: float
    full_growth: float
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    scale: NDArray[np.float64]

    @property
    def lowest_epi(self) -> float:
        """EPI of a step with every paid control at 1 and no growth [EUR m-2]."""
        heat, electricity, co2 = (self.full_use * self.unit_costs).tolist()
        return -float(heat + electricity + co2)

    @property
    def highest_epi(self) -> float:
        """EPI of a step of full growth without any use [EUR m-2]."""
        return self.full_growth * self.fresh_per_dry * self.fruit_price

    def quantities(
        self,
        before: NDArray[np.float64],
        after: NDArray[np.float64],
        controls: NDArray[np.float64],
        air: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """All quantities of a step but the reward, which stays 0; rows as ``QUANTITY_NAMES``, shape ``(quantities, n)``.

        Parameters
        ----------
        before, after
            States at the start and at the end of the step, ``(n, 28)``.
        controls
            Controls during the step, fractions, ``(n, 6)``.
        air
            Air temperature, CO2 and relative humidity at the end of the step, ``(3, n)``.
        """
        rows = self.of_step(before[:, FRUIT_STATE], after[:, FRUIT_STATE], controls.T, air)
        table = np.zeros((len(QUANTITY_NAMES), len(after)))
        for row, name in enumerate(QUANTITY_NAMES):
            if name in rows:
                table[row] = rows[name]
        return table

    def of_step(
        self, fruit_before: Any, fruit_after: Any, controls: Sequence[Any] | NDArray[np.float64], air: Any
    ) -> dict[str, Any]:
        """The same by name, from and as arrays ``(n,)`` or values recorded for the compiled kernel."""
        used = [controls[control] * float(full) for control, full in zip(PAID, self.full_use, strict=True)]
        heat, electricity, co2 = (amount * float(cost) for amount, cost in zip(used, self.unit_costs, strict=True))
        fruit = (fruit_after - fruit_before) * self.fresh_per_dry
        revenue = fruit * self.fruit_price
        return {
            "epi": revenue - heat - electricity - co2,
            "revenue": revenue,
            "cost_heat": heat,
            "cost_electricity": electricity,
            "cost_co2": co2,
            **dict(zip(("heat", "electricity", "co2_dosed"), used, strict=True)),
            "fruit_fresh": fruit,
            **self._judged(air),
        }

    def _judged(self, air: Any) -> dict[str, Any]:
        """Penalty, violations, and the hours they lasted."""
        below = [np.maximum(low - value, 0.0) for low, value in zip(self.low.tolist(), air, strict=True)]
        above = [np.maximum(value - high, 0.0) for high, value in zip(self.high.tolist(), air, strict=True)]
        hours = self.step_seconds / 3600.0
        temperature, co2, humidity = (
            (low + high) / scale for low, high, scale in zip(below, above, self.scale.tolist(), strict=True)
        )
        judged: dict[str, Any] = {"penalty": temperature + co2 + humidity}
        for side, violations in (("low", below), ("high", above)):
            for name, violation in zip(LIMITED, violations, strict=True):
                judged[f"violation_{name}_{side}"] = violation
                judged[f"hours_outside_{name}_{side}"] = np.sign(violation) * hours
        return judged


def make_accounts(task: TaskSpec) -> Accounts:
    """Accounts of a task, from its nominal parameters, prices and constraints."""
    parameters, prices, seconds = task.parameters_by_name(), task.prices, task.step_seconds
    floor = parameters["aFlr"]
    per_watt = seconds / JOULES_PER_KWH
    use = [
        parameters["pBoil"] / floor * per_watt,
        parameters["thetaLampMax"] * per_watt,
        parameters["phiExtCo2"] / floor * seconds * KG_PER_MG,
    ]
    limits, scale = dict(task.constraints.items()), dict(task.reward.penalty_scale.items())
    return Accounts(
        step_seconds=seconds,
        full_use=_frozen(use),
        unit_costs=_frozen([prices.heat, prices.electricity, prices.co2]),
        fresh_per_dry=KG_PER_MG / prices.dry_matter_content,
        fruit_price=prices.fruit,
        full_growth=parameters["rgFruit"] * seconds,
        low=_frozen([limits[name].low for name in LIMITED]),
        high=_frozen([limits[name].high for name in LIMITED]),
        scale=_frozen([scale[name] for name in LIMITED]),
    )


def _frozen(values: list[float]) -> NDArray[np.float64]:
    column = np.array(values, dtype=np.float64)
    column.flags.writeable = False
    return column
