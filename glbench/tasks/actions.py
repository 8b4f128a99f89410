"""What the entries of an action are: one for each control, or the set points of a process computer.

The set points are those that a grower enters at the process computer; ``glbench.env.process_computer`` works the controls by them.
An entry is there only where the task grants a control that it steers.
"""

from __future__ import annotations

from dataclasses import dataclass

from glbench.errors import UnknownNameError, did_you_mean

HEATING, VENTILATION, CO2, HUMIDITY = (
    "heating_temperature",
    "ventilation_temperature",
    "co2_set_point",
    "humidity_deficit",
)
LAMPS_FROM, LAMPS_UNTIL, LAMP_RADIATION = "lamps_from", "lamps_until", "lamp_radiation_limit"
SCREEN_RADIATION, SCREEN_OUTDOOR = "screen_radiation_limit", "screen_outdoor_temperature"

BOILER, DOSING, SCREEN, VENTS, LAMPS, BLACKOUT = "uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"
WORKED = (BOILER, DOSING, SCREEN, VENTS, LAMPS, BLACKOUT)
"""The controls that a process computer can work."""


@dataclass(frozen=True)
class Action:
    """One entry of an action: what it is called, its bounds, its unit ("-" for a share) and what it means.

    ``idle`` is the value with which it asks for nothing: no change, no heat beyond frost protection, vents shut, screens open.
    """

    name: str
    low: float
    high: float
    unit: str = "-"
    meaning: str = ""
    idle: float = 0.0


_SET_POINTS: tuple[tuple[tuple[str, ...], Action], ...] = (
    ((BOILER,), Action(HEATING, 0.0, 30.0, "degC", "air is heated below it")),
    ((VENTS,), Action(VENTILATION, 5.0, 40.0, "degC", "vents open above it; at least a dead zone above the heating temperature", 40.0)),
    ((DOSING,), Action(CO2, 0.0, 1600.0, "ppm", "CO2 is dosed below it, in light, as far as the vents are shut")),
    (
        (BOILER, VENTS, SCREEN),
        Action(HUMIDITY, 0.0, 8.0, "g m-3", "below it the air is too humid: minimum heat, a gap in vents and screen"),
    ),
    ((LAMPS,), Action(LAMPS_FROM, 0.0, 24.0, "h", "lamps may be on from this hour of the day")),
    ((LAMPS,), Action(LAMPS_UNTIL, 0.0, 24.0, "h", "until this hour of the same day; never when it is not the later one")),
    ((LAMPS,), Action(LAMP_RADIATION, 0.0, 1000.0, "W m-2", "lamps go off when the radiation outside reaches it")),
    ((SCREEN,), Action(SCREEN_RADIATION, 0.0, 500.0, "W m-2", "the thermal screen may be closed while the radiation outside is below it")),
    (
        (SCREEN,),
        Action(SCREEN_OUTDOOR, -10.0, 30.0, "degC", "the thermal screen may be closed while the air outside is colder", -10.0),
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
