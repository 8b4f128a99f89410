"""What the viewer shows of an episode: every curve with its title and unit, and how it follows from the columns of a record.

Nothing is recomputed here but sums over time, signs and powers of ten of units.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glbench.env.quantities import QUANTITIES

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]
"""Columns of an episode by name, each ``(steps,)``: climate, states, controls, weather and quantities of the steps."""

CELSIUS, PERCENT, PPM, ONE = "°C", "%", "ppm", "–"
EUR, KG, GRAM, HOURS = "EUR m⁻²", "kg m⁻²", "g m⁻²", "h"
GRAM_PER_MG = 1e-3

_HOURS_OUTSIDE = tuple(quantity.name for quantity in QUANTITIES if quantity.name.startswith("hours_outside_"))


@dataclass(frozen=True)
class Signal:
    """One curve for each controller.

    Attributes
    ----------
    path
        Place in the recording, ``group/quantity``; the controller's name follows, unless the signal is ``shared``.
    title, unit
        As shown.
    columns
        Names of the columns that ``values`` reads.
    values
        The curve ``(steps,)`` from the columns of a record, in ``unit``.
    moment
        Whether a value belongs to the ``start`` of its step, from where it holds (controls, weather), or to its ``end``.
    limits
        The task's constraint that belongs to it, if any.
    shared
        Whether it is the same for all controllers, such as the weather.
    whole
        Whether it is first shown over the whole episode (slow: sums, the crop), not over a few days.
    from_zero
        Whether it begins at 0, which is then shown too.
    """

    path: str
    title: str
    unit: str
    columns: tuple[str, ...]
    values: Callable[[Columns], Floats]
    moment: Literal["start", "end"] = "end"
    limits: str | None = None
    shared: bool = False
    whole: bool = False
    from_zero: bool = False

    @property
    def heading(self) -> str:
        """Title with unit."""
        return f"{self.title} [{self.unit}]"


def _value(path: str, title: str, unit: str, column: str, limits: str | None = None) -> Signal:
    return Signal(path, title, unit, (column,), lambda columns: columns[column], limits=limits)


def _crop(path: str, title: str, unit: str, column: str, factor: float = 1.0) -> Signal:
    return Signal(path, title, unit, (column,), lambda columns: columns[column] * factor, whole=True)


def _total(path: str, title: str, unit: str, column: str) -> Signal:
    """The plain sum from the first step on, in the order of the steps: its last value is the run's metric."""
    return Signal(
        path,
        f"{title}, summed",
        unit,
        (column,),
        lambda columns: np.cumsum(columns[column]),
        whole=True,
        from_zero=True,
    )


def _control(path: str, title: str, column: str) -> Signal:
    return Signal(path, title, PERCENT, (column,), lambda columns: columns[column] * 100.0, moment="start")


def _weather(path: str, title: str, unit: str, column: str) -> Signal:
    return Signal(path, title, unit, (column,), lambda columns: columns[column], moment="start", shared=True)


def _violation(name: str, title: str, unit: str) -> Signal:
    low, high = f"violation_{name}_low", f"violation_{name}_high"
    # One of the two is 0 in every step: the difference is exact, above the limits positive and below them negative.
    return Signal(
        f"violations/{name}",
        f"{title} beyond its limits, − below, + above",
        unit,
        (low, high),
        lambda columns: columns[high] - columns[low],
    )


def _hours_outside(columns: Columns) -> Floats:
    """Time with at least one limit broken, as the metric ``hours_outside_limits`` counts it."""
    total: Floats = np.cumsum(np.max([columns[name] for name in _HOURS_OUTSIDE], axis=0))
    return total


CLIMATE = (
    _value("climate/air_temperature", "Air temperature", CELSIUS, "air_temperature", "air_temperature"),
    _value("climate/relative_humidity", "Relative humidity", PERCENT, "relative_humidity", "relative_humidity"),
    _value("climate/co2", "CO₂", PPM, "co2", "co2"),
    _value("climate/canopy_temperature", "Canopy temperature", CELSIUS, "tCan"),
    _value("climate/pipe_temperature", "Rail pipe temperature", CELSIUS, "tPipe"),
)
CROP = (
    _total("crop/fruit_fresh", "Fruit grown, fresh", KG, "fruit_fresh"),
    _crop("crop/fruit", "Carbohydrates in the fruit", GRAM, "cFruit", GRAM_PER_MG),
    _crop("crop/leaves", "Carbohydrates in the leaves", GRAM, "cLeaf", GRAM_PER_MG),
    _crop("crop/stems", "Carbohydrates in stems and roots", GRAM, "cStem", GRAM_PER_MG),
    _crop("crop/buffer", "Carbohydrate buffer", GRAM, "cBuf", GRAM_PER_MG),
    _crop("crop/canopy_temperature_24h", "Canopy temperature, 24 h mean", CELSIUS, "tCan24"),
)
CONTROLS = (
    _control("controls/boiler", "Boiler valve (heating)", "uBoil"),
    _control("controls/vents", "Roof vents open", "uVent"),
    _control("controls/lamps", "Lamps", "uLamp"),
    _control("controls/co2_dosing", "CO₂ dosing valve", "uCo2"),
    _control("controls/thermal_screen", "Thermal screen closed", "uThScr"),
    _control("controls/blackout_screen", "Blackout screen closed", "uBlScr"),
)
WEATHER = (
    _weather("weather/global_radiation", "Sun outside (global radiation)", "W m⁻²", "iGlob"),
    _weather("weather/temperature", "Outside temperature", CELSIUS, "tOut"),
    _weather("weather/wind", "Wind", "m s⁻¹", "wind"),
    _weather("weather/vapour_pressure", "Outside vapour pressure", "Pa", "vpOut"),
)
MONEY = (
    _total("money/epi", "Economic performance (EPI)", EUR, "epi"),
    _total("money/revenue", "Revenue of the fruit", EUR, "revenue"),
    _total("money/cost_heat", "Cost of heat", EUR, "cost_heat"),
    _total("money/cost_electricity", "Cost of electricity", EUR, "cost_electricity"),
    _total("money/cost_co2", "Cost of CO₂", EUR, "cost_co2"),
    _total("money/reward", "Reward", ONE, "reward"),
)
VIOLATIONS = (
    _violation("air_temperature", "Air temperature", CELSIUS),
    _violation("relative_humidity", "Relative humidity", PERCENT),
    _violation("co2", "CO₂", PPM),
    Signal(
        "violations/hours",
        "Time outside the limits, summed",
        HOURS,
        _HOURS_OUTSIDE,
        _hours_outside,
        whole=True,
        from_zero=True,
    ),
    _total("violations/penalty", "Penalty", ONE, "penalty"),
)
SIGNALS: tuple[Signal, ...] = (*CLIMATE, *CROP, *CONTROLS, *WEATHER, *MONEY, *VIOLATIONS)
NEEDED_COLUMNS: tuple[str, ...] = tuple(dict.fromkeys(name for signal in SIGNALS for name in signal.columns))
"""Columns that a record must have to be shown."""
