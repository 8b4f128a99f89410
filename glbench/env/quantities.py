"""What is measured in every control step, with units: the one table behind ``StepResult.quantities`` and ``info``."""

from __future__ import annotations

from dataclasses import dataclass

from glbench.tasks.quantities import LIMITED

_MEANING = {
    "air_temperature": "air temperature",
    "co2": "CO2 of the indoor air",
    "relative_humidity": "relative humidity of the indoor air",
}
_SIDES = (("low", "below"), ("high", "above"))


@dataclass(frozen=True)
class StepQuantity:
    """One quantity of a control step."""

    name: str
    unit: str
    meaning: str


def _violations() -> tuple[StepQuantity, ...]:
    return tuple(
        StepQuantity(
            f"violation_{name}_{side}",
            unit,
            f"distance of the {_MEANING[name]} {word} its limit at the end of the step",
        )
        for side, word in _SIDES
        for name, unit in LIMITED.items()
    )


def _hours() -> tuple[StepQuantity, ...]:
    return tuple(
        StepQuantity(
            f"hours_outside_{name}_{side}",
            "h",
            f"length of the step if the {_MEANING[name]} is {word} its limit at its end",
        )
        for side, word in _SIDES
        for name in LIMITED
    )


QUANTITIES: tuple[StepQuantity, ...] = (
    StepQuantity("reward", "-", "reward of the step"),
    StepQuantity("epi", "EUR m-2", "economic performance: revenue minus the costs of heat, electricity and CO2"),
    StepQuantity("revenue", "EUR m-2", "value of the fresh fruit grown, when it grows and not when it is picked"),
    StepQuantity("cost_heat", "EUR m-2", "price of the boiler's heat"),
    StepQuantity("cost_electricity", "EUR m-2", "price of the lamps' electricity"),
    StepQuantity("cost_co2", "EUR m-2", "price of the CO2 dosed"),
    StepQuantity("penalty", "-", "sum of the violations, each divided by its penalty scale"),
    StepQuantity("heat", "kWh m-2", "heat of the boiler"),
    StepQuantity("electricity", "kWh m-2", "electricity of the lamps"),
    StepQuantity("co2_dosed", "kg m-2", "CO2 dosed"),
    StepQuantity("fruit_fresh", "kg m-2", "fresh fruit grown: dry increment divided by the dry matter content"),
    *_violations(),
    *_hours(),
)

QUANTITY_NAMES: tuple[str, ...] = tuple(quantity.name for quantity in QUANTITIES)

_INDEX = {name: index for index, name in enumerate(QUANTITY_NAMES)}
REWARD = _INDEX["reward"]
EPI = _INDEX["epi"]
REVENUE = _INDEX["revenue"]
COSTS = slice(_INDEX["cost_heat"], _INDEX["cost_co2"] + 1)
PENALTY = _INDEX["penalty"]
AMOUNTS = slice(_INDEX["heat"], _INDEX["co2_dosed"] + 1)
FRUIT = _INDEX["fruit_fresh"]
VIOLATIONS = slice(_INDEX["violation_air_temperature_low"], _INDEX["violation_relative_humidity_high"] + 1)
HOURS = slice(_INDEX["hours_outside_air_temperature_low"], _INDEX["hours_outside_relative_humidity_high"] + 1)
