"""What is measured of a run: names, units, meanings, and the sums over its steps.

A metric of a run is the plain sum, step by step, of one quantity of the simulation. The order of the additions is the order of the
steps, in every batch size, so that a run has the same bits alone and among others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.env.quantities import QUANTITY_NAMES

EUR = "EUR m-2"
KWH = "kWh m-2"
KG = "kg m-2"
HOURS = "h"
ONE = "-"

LIMITED = {
    "air_temperature": "the air temperature",
    "co2": "the CO2 concentration",
    "relative_humidity": "the relative humidity",
}
SIDES = {"low": "below", "high": "above"}


@dataclass(frozen=True)
class Metric:
    """One metric of a run.

    ``name`` in result files, ``unit``, ``meaning`` in words, and ``quantity``: the simulation's quantity that is summed over the steps
    (``None`` for what is derived from several quantities).
    """

    name: str
    unit: str
    meaning: str
    quantity: str | None = None


def _hours_outside() -> tuple[Metric, ...]:
    return tuple(
        Metric(
            f"hours_{what}_{side}",
            HOURS,
            f"time at which {words} was {SIDES[side]} its limit",
            f"hours_outside_{what}_{side}",
        )
        for what, words in LIMITED.items()
        for side in SIDES
    )


HOURS_OUTSIDE: tuple[Metric, ...] = _hours_outside()

METRICS: tuple[Metric, ...] = (
    Metric("reward", ONE, "sum of the task's reward; what the leaderboard ranks by", "reward"),
    Metric("epi", EUR, "economic performance: revenue minus the costs of heat, electricity and CO2", "epi"),
    Metric("revenue", EUR, "value of the fruit grown, when it grows and not when it is picked", "revenue"),
    Metric("cost_heat", EUR, "price of the heat", "cost_heat"),
    Metric("cost_electricity", EUR, "price of the electricity for the lamps", "cost_electricity"),
    Metric("cost_co2", EUR, "price of the CO2 dosed", "cost_co2"),
    Metric("penalty", ONE, "sum of the scaled distances outside the climate limits", "penalty"),
    Metric("yield", KG, "fresh fruit grown (dry increment divided by the dry matter content)", "fruit_fresh"),
    Metric("heat", KWH, "heat of the boiler", "heat"),
    Metric("electricity", KWH, "electricity of the lamps", "electricity"),
    Metric("co2", KG, "CO2 dosed", "co2_dosed"),
    *HOURS_OUTSIDE,
    Metric("hours_outside_limits", HOURS, "time at which at least one of these limits was broken"),
)
METRIC_NAMES: tuple[str, ...] = tuple(metric.name for metric in METRICS)
UNITS: dict[str, str] = {metric.name: metric.unit for metric in METRICS}

# The last metric is derived from others; it takes any quantity's place first.
_QUANTITIES = np.array([QUANTITY_NAMES.index(metric.quantity or "reward") for metric in METRICS])
_ANY_LIMIT = METRIC_NAMES.index("hours_outside_limits")
_FIRST_LIMIT = METRIC_NAMES.index(HOURS_OUTSIDE[0].name)


def step_values(quantities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values of all metrics in one step, shape ``(metrics, n)``, from the step's quantities ``(quantities, n)``."""
    values: NDArray[np.float64] = quantities.take(_QUANTITIES, axis=0)
    np.maximum.reduce(values[_FIRST_LIMIT : _FIRST_LIMIT + len(HOURS_OUTSIDE)], axis=0, out=values[_ANY_LIMIT])
    return values


def with_missing_steps(totals: Mapping[str, float], missing: int, failed_step: Mapping[str, float]) -> dict[str, float]:
    """Metrics of a run that lacks ``missing`` steps: each counts as ``failed_step``; what was used or grown stays as measured."""
    return {name: value + missing * failed_step.get(name, 0.0) for name, value in totals.items()}
