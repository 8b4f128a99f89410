"""What the entries of an action are: one for each control, or the set points of a process computer.

The set points are those that a grower enters at the process computer; ``glbench.env.process_computer`` works the controls by them. An
agent gives each as a number from -1, the lowest, to 1, the highest (``Action.of``, ``Action.value``). An entry is there only where the
task grants a control that it steers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from glbench.errors import TaskError, UnknownNameError, did_you_mean
from glbench.model.controls import Controls
from glbench.model.quantities import table_of

HEATING, VENTILATION, CO2, HUMIDITY = (
    "heating_temperature",
    "ventilation_temperature",
    "co2_set_point",
    "humidity_deficit",
)
LAMPS_FROM, LAMPS_UNTIL, LAMP_RADIATION = "lamps_from", "lamps_until", "lamp_radiation_limit"
SCREEN_RADIATION, SCREEN_OUTDOOR = "screen_radiation_limit", "screen_outdoor_temperature"

WORKED = tuple(entry.name for entry in table_of(Controls))
"""The controls that a process computer can work: the equipment of the GreenLight greenhouse."""
BOILER, DOSING, SCREEN, VENTS, LAMPS, BLACKOUT = WORKED


@dataclass(frozen=True)
class Action:
    """One entry of an action: what it is called, its bounds, and the quantity that it stands for.

    Attributes
    ----------
    name
        A control of the task, or a set point.
    low, high
        Bounds of what an agent gives.
    unit, meaning
        Of the quantity that it stands for; "-" for a share.
    idle
        What an agent gives to ask for nothing: no change, no heat beyond frost protection, vents shut, screens open.
    stands_for
        Values [unit] that ``low`` and ``high`` stand for, in a straight line between them; ``None``: what is given is the value.

    Raises
    ------
    TaskError
        When there is ``stands_for``, and it or the bounds are not finite and in order.
    """

    name: str
    low: float
    high: float
    unit: str = "-"
    meaning: str = ""
    idle: float = 0.0
    stands_for: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.stands_for is None:
            return
        for low, high in ((self.low, self.high), self.stands_for):
            if not (math.isfinite(high - low) and low < high):
                msg = (
                    f"The action '{self.name}' from {self.low:g} to {self.high:g} cannot stand for values from {self.lowest:g} to "
                    f"{self.highest:g} {self.unit}. Give finite bounds, the lower one first."
                )
                raise TaskError(msg)

    @property
    def lowest(self) -> float:
        """Value [unit] that ``low`` stands for."""
        return self.low if self.stands_for is None else self.stands_for[0]

    @property
    def highest(self) -> float:
        """Value [unit] that ``high`` stands for."""
        return self.high if self.stands_for is None else self.stands_for[1]

    def of(self, value: Any) -> Any:
        """What to give for ``value`` [unit]: a number, or an array of any shape. Nothing is clipped."""
        return value if self.stands_for is None else (value - self.lowest) / self._slope + self.low

    def value(self, given: Any) -> Any:
        """The value [unit] that ``given`` stands for: a number, an array of any shape, or a recorded value."""
        return given if self.stands_for is None else (given - self.low) * self._slope + self.lowest

    @property
    def _slope(self) -> float:
        return (self.highest - self.lowest) / (self.high - self.low)


def _set_point(name: str, lowest: float, highest: float, unit: str, meaning: str, *, idle: float = -1.0) -> Action:
    """A set point between ``lowest`` and ``highest``, which an agent gives as a number from -1 to 1."""
    return Action(name, -1.0, 1.0, unit, meaning, idle, (lowest, highest))


_SET_POINTS: tuple[tuple[tuple[str, ...], Action], ...] = (
    ((BOILER,), _set_point(HEATING, 0.0, 30.0, "degC", "air is heated below it")),
    (
        (VENTS,),
        _set_point(VENTILATION, 5.0, 40.0, "degC", "vents open above it; at least a dead zone above the heating temperature", idle=1.0),
    ),
    ((DOSING,), _set_point(CO2, 0.0, 1600.0, "ppm", "CO2 is dosed below it, in light, as far as the vents are shut")),
    (
        (BOILER, VENTS, SCREEN),
        _set_point(HUMIDITY, 0.0, 8.0, "g m-3", "below it the air is too humid: minimum heat, a gap in vents and screen"),
    ),
    ((LAMPS,), _set_point(LAMPS_FROM, 0.0, 24.0, "h", "lamps may be on from this hour of the day")),
    ((LAMPS,), _set_point(LAMPS_UNTIL, 0.0, 24.0, "h", "until this hour of the same day; never when it is not the later one")),
    ((LAMPS,), _set_point(LAMP_RADIATION, 0.0, 1000.0, "W m-2", "lamps go off when the radiation outside reaches it")),
    (
        (SCREEN,),
        _set_point(SCREEN_RADIATION, 0.0, 500.0, "W m-2", "the thermal screen may be closed while the radiation outside is below it"),
    ),
    (
        (SCREEN,),
        _set_point(SCREEN_OUTDOOR, -10.0, 30.0, "degC", "the thermal screen may be closed while the air outside is colder"),
    ),
)  # fmt: skip


def set_points(controls: tuple[str, ...]) -> tuple[Action, ...]:
    """The set points of a process computer that works ``controls``.

    Raises
    ------
    UnknownNameError
        When it cannot work one of them, or none that a set point steers.
    """
    for name in controls:
        if name not in WORKED:
            msg = f"The process computer cannot work '{name}', only {', '.join(WORKED)}.{did_you_mean(name, WORKED)}"
            raise UnknownNameError(msg)
    found = tuple(action for needed, action in _SET_POINTS if set(needed) & set(controls))
    if not found:
        msg = f"No set point steers {', '.join(controls)}. Grant {BOILER}, {VENTS} or another control as well."
        raise UnknownNameError(msg)
    return found
