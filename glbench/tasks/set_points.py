"""The set points that a grower enters at the process computer; ``glbench.env.process_computer`` works the controls by them.

An agent gives each as a number from -1, the lowest, to 1, the highest (``Action.of``, ``Action.value``). A set point is there only where
the task grants a control that it steers.
"""

from __future__ import annotations

from typing import Any

from pydantic import Field

from glbench.errors import UnknownNameError, did_you_mean, refuse
from glbench.model.controls import Controls
from glbench.model.quantities import table_of
from glbench.tasks.quantities import Action

HEATING, VENTILATION, CO2, HUMIDITY = ("heating_temperature", "ventilation_temperature", "co2_set_point", "humidity_deficit")
LAMPS_FROM, LAMPS_UNTIL, LAMP_RADIATION = "lamps_from", "lamps_until", "lamp_radiation_limit"
SCREEN_RADIATION, SCREEN_OUTDOOR = "screen_radiation_limit", "screen_outdoor_temperature"

WORKED = tuple(entry.name for entry in table_of(Controls))
"""The controls that a process computer can work: the equipment of the GreenLight greenhouse."""
BOILER, DOSING, SCREEN, VENTS, LAMPS, BLACKOUT = WORKED


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

SET_POINTS = {action.name: action for _, action in _SET_POINTS}
"""All set points by name."""


def set_point_field(name: str) -> Any:
    """A field of settings for the set point ``name``, within the range that the process computer takes."""
    action = SET_POINTS[name]
    return Field(ge=action.lowest, le=action.highest, json_schema_extra={"unit": action.unit})


def set_points(controls: tuple[str, ...]) -> tuple[Action, ...]:
    """Set points of a process computer for ``controls``. Raises ``UnknownNameError`` when it cannot work one, or nothing steers any."""
    for name in controls:
        if name not in WORKED:
            refuse(f"The process computer cannot work '{name}', only {', '.join(WORKED)}.{did_you_mean(name, WORKED)}", UnknownNameError)
    actions = tuple(action for steered, action in _SET_POINTS if set(steered) & set(controls))
    if not actions:
        refuse(f"No set point steers {', '.join(controls)}. Grant {BOILER}, {VENTS} or another control as well.", UnknownNameError)
    return actions
