"""Names, units and bounds of everything a task can show to an agent.

The bounds hold for whatever controls an agent chooses and whatever weather a record can contain; they are wide on
purpose and no statement about good growing conditions. How they were found:

* Outdoors: a little beyond what was ever measured on earth (-89 and 57 degC; 1900 W m-2 under broken cloud).
* Indoor temperatures: sky and leaks cannot cool below ``COLDEST``. The warmest house is closed, calm and humid, with the
  sun standing still at 1500 W m-2 over air of 60 degC, boiler and lamps at 1: 170 degC. At ``HOTTEST`` the cover alone would
  give off 2600 W m-2, which is more than all of these supply. Pipes and lamps stand up to 100 K above the air.
* Indoor CO2: the largest dose without photosynthesis, through the main compartment's own leaks at the lowest wind, or
  gathered over the whole horizon where that is less. The model does not know that CO2 displaces air, so the number
  exceeds what physics allows; in ordinary wind a dose that never stops leads to about 20 000 ppm.
* Vapour pressure: saturation at ``HOTTEST``.
* Crop: growth at three times the rate at 20 degC, with every crop parameter at its most favourable.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

CONTROLS = ("uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr")
"""Names of the controls in the model's order, repeated here so that task files can be read without loading the model."""
LIMITED = {"air_temperature": "degC", "co2": "ppm", "relative_humidity": "%"}
"""Quantities that a task constrains, with the unit their limits are written in."""

COLDEST = -100.0
"""Lower bound of every temperature [degC]."""
HOTTEST = 200.0
"""Upper bound of temperatures of air, crop, cover, screens and soil [degC]."""
HOTTEST_METAL = 300.0
"""Upper bound of pipe and lamp temperatures [degC]."""

_METAL = ("tPipe", "tGroPipe", "tLamp", "tIntLamp")
_LARGEST_VAPOUR_PRESSURE = 2.0e6  # Pa; saturation at 200 degC is 1.6e6 Pa
_OLD_CROP_SUM = 4000.0  # degC day; above every temperature sum an episode can start with
_RESPIRED_CO2 = 2.0e5  # mg m-3; all carbohydrate of a mature crop breathed into the house
_FASTEST_FRUIT_GROWTH = 0.25  # kg m-2 a day; 0.328 mg m-2 s-1 is 0.028 kg m-2 a day, times 2^3 for the best parameters
_FRUIT_AT_START = 1.0  # kg m-2
_BELOW_ZERO = 0.01  # kg m-2; a mass that is used up may undershoot zero by the tolerance of the integration


@dataclass(frozen=True)
class Quantity:
    """One column of an observation: its name, unit and finite bounds."""

    name: str
    unit: str
    low: float
    high: float
    meaning: str


@dataclass(frozen=True)
class ObservationContext:
    """What the bounds of an observed quantity may depend on."""

    steps: int
    """Control steps of the horizon."""
    step_seconds: float
    """Length of a control step [s]."""
    forecast_steps: int
    """Rows of coming weather that the task grants."""
    parameters: Mapping[str, float]
    """All model parameters by name, nominal values."""

    @property
    def days(self) -> float:
        """Length of the horizon [day]."""
        return self.steps * self.step_seconds / 86400.0


class QuantityTable(Protocol):
    """The columns of an observation module in a given task."""

    def __call__(self, context: ObservationContext) -> tuple[Quantity, ...]:
        """Columns in the order observed."""


@dataclass(frozen=True)
class Capacity:
    """What a control is and what it delivers at 1."""

    name: str
    """Name in the model."""
    quantity: str
    """Name in observations."""
    unit: str
    at_one: float
    meaning: str


def capacities(parameters: Mapping[str, float]) -> tuple[Capacity, ...]:
    """Installed capacities: the six controls in the model's order, and what each delivers at 1."""
    floor = parameters["aFlr"]
    installed = (
        ("boiler", "W m-2", parameters["pBoil"] / floor, "heat to the rail pipes"),
        ("co2_supply", "mg m-2 s-1", parameters["phiExtCo2"] / floor, "CO2 dosed"),
        ("thermal_screen", "-", 1.0, "closure of the thermal screen"),
        ("vents", "-", 1.0, "opening of the roof vents"),
        ("lamps", "W m-2", parameters["thetaLampMax"], "electric power of the lamps"),
        ("blackout_screen", "-", 1.0, "closure of the blackout screen"),
    )
    return tuple(Capacity(name, *entry) for name, entry in zip(CONTROLS, installed, strict=True))


def highest_co2_density(context: ObservationContext) -> float:
    """Highest CO2 density of the main air [mg m-3]: see the module's text.

    Only the leaks of the main compartment count, at the wind below which leakage no longer falls.
    """
    p = context.parameters
    dose = p["phiExtCo2"] / p["aFlr"]  # mg m-2 s-1
    gathered = dose * context.steps * context.step_seconds / p["capCo2Air"]
    leak = (1.0 - p["cLeakTop"]) * p["cLeakage"] * p["minWind"]  # m3 m-2 s-1
    excess = min(gathered, dose / leak) if leak > 0.0 else gathered
    return _round_up(excess + _RESPIRED_CO2 + 1.0e4)


def _highest_co2_ppm(context: ObservationContext) -> float:
    """``highest_co2_density`` as a volume fraction [ppm], in the hottest air the bounds allow."""
    molar = 8.3144598 * (HOTTEST + 273.15) / (101325.0 * 44.01e-3)  # m3 per kg of CO2
    return _round_up(highest_co2_density(context) * molar)


def _round_up(value: float) -> float:
    """Next number of two significant digits that is not smaller."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / unit) * unit


def _air_temperature() -> Quantity:
    return Quantity("air_temperature", "degC", COLDEST, HOTTEST, "air below the screens")


def _co2(context: ObservationContext) -> Quantity:
    return Quantity("co2", "ppm", 0.0, _highest_co2_ppm(context), "CO2 of the air below the screens")


def _relative_humidity() -> Quantity:
    return Quantity("relative_humidity", "%", 0.0, 100.0, "relative humidity of the air below the screens")


def _pipe_temperature() -> Quantity:
    return Quantity("pipe_temperature", "degC", COLDEST, HOTTEST_METAL, "rail pipes")


def indoor_climate(context: ObservationContext) -> tuple[Quantity, ...]:
    """Air temperature, CO2, relative humidity, pipe temperature."""
    return (_air_temperature(), _co2(context), _relative_humidity(), _pipe_temperature())


def _mean_temperature() -> Quantity:
    return Quantity("canopy_temperature_24h", "degC", COLDEST, HOTTEST, "24-hour low-pass of the canopy temperature")


def _temperature_sum(context: ObservationContext) -> Quantity:
    low, high = COLDEST * context.days, _OLD_CROP_SUM + HOTTEST * context.days
    return Quantity("temperature_sum", "degC day", low, high, "temperature sum of the canopy since planting")


def crop(context: ObservationContext) -> tuple[Quantity, ...]:
    """Fruit dry mass, 24-hour mean canopy temperature, temperature sum."""
    heaviest = _FRUIT_AT_START + _FASTEST_FRUIT_GROWTH * context.days
    fruit = Quantity("fruit_dry_mass", "kg m-2", -_BELOW_ZERO, heaviest, "dry mass of the fruit on the plants")
    return (fruit, _mean_temperature(), _temperature_sum(context))


def _cycle(name: str, period: str) -> tuple[Quantity, Quantity]:
    return (
        Quantity(f"sin_{name}", "-", -1.0, 1.0, f"sine of the {period}, one turn a cycle"),
        Quantity(f"cos_{name}", "-", -1.0, 1.0, f"cosine of the {period}, one turn a cycle"),
    )


def time(context: ObservationContext) -> tuple[Quantity, ...]:
    """Sine and cosine of the hour of day (24 h), then of the day of year (365 days)."""
    return _cycle("hour_of_day", "hour of day") + _cycle("day_of_year", "day of year")


def controls(context: ObservationContext) -> tuple[Quantity, ...]:
    """Boiler, CO2 supply, thermal screen, vents, lamps, blackout screen as in force, in physical units."""
    return tuple(Quantity(c.quantity, c.unit, 0.0, c.at_one, c.meaning) for c in capacities(context.parameters))


def control_fractions(context: ObservationContext) -> tuple[Quantity, ...]:
    """Boiler, CO2 supply, thermal screen, vents, lamps, blackout screen as in force, as fractions of capacity."""
    return tuple(
        Quantity(f"{c.quantity}_fraction", "-", 0.0, 1.0, f"{c.meaning}, share of capacity")
        for c in capacities(context.parameters)
    )


_GLOBAL_RADIATION = Quantity("global_radiation", "W m-2", 0.0, 2000.0, "sun and sky on a horizontal plane outside")
_OUTDOOR_TEMPERATURE = Quantity("outdoor_temperature", "degC", -90.0, 60.0, "air outside")
_OUTDOOR_HUMIDITY = Quantity("outdoor_relative_humidity", "%", 0.0, 100.0, "relative humidity outside")
_OUTDOOR_CO2 = Quantity("outdoor_co2", "ppm", 0.0, 2500.0, "CO2 outside")
_WIND = Quantity("wind_speed", "m s-1", 0.0, 120.0, "wind speed")
_OUTDOOR_VAPOUR_PRESSURE = Quantity("outdoor_vapour_pressure", "Pa", 0.0, 2.5e4, "vapour pressure outside")
_OUTDOOR_CO2_DENSITY = Quantity("outdoor_co2_density", "mg m-3", 0.0, 1.0e4, "CO2 density outside")

_WEATHER = (_GLOBAL_RADIATION, _OUTDOOR_TEMPERATURE, _OUTDOOR_HUMIDITY, _OUTDOOR_CO2, _WIND)
_PUBLISHED_FORECAST = (_GLOBAL_RADIATION, _OUTDOOR_TEMPERATURE, _OUTDOOR_VAPOUR_PRESSURE, _OUTDOOR_CO2_DENSITY, _WIND)


def weather(context: ObservationContext) -> tuple[Quantity, ...]:
    """Global radiation, outdoor temperature, relative humidity, CO2, wind speed."""
    return _WEATHER


def _ahead(rows: int, row: tuple[Quantity, ...]) -> tuple[Quantity, ...]:
    """``rows`` copies of ``row``, row after row; the first is the row after the one that ``weather`` shows."""
    return tuple(
        Quantity(f"{q.name}_ahead_{n}", q.unit, q.low, q.high, f"{q.meaning}, {n} step{'s' if n > 1 else ''} ahead")
        for n in range(1, rows + 1)
        for q in row
    )


def forecast(context: ObservationContext) -> tuple[Quantity, ...]:
    """Weather of the next ``forecast_steps`` rows, five quantities each, row after row."""
    return _ahead(context.forecast_steps, _WEATHER)


def step_counter(context: ObservationContext) -> tuple[Quantity, ...]:
    """Count of steps taken, 0 after reset; with the timing ``published``, the number of the step just taken."""
    return (Quantity("step_counter", "-", 0.0, float(context.steps), "steps since the start"),)


def published_indoor_climate(context: ObservationContext) -> tuple[Quantity, ...]:
    """CO2, air temperature, relative humidity, pipe temperature."""
    return (_co2(context), _air_temperature(), _relative_humidity(), _pipe_temperature())


def published_crop(context: ObservationContext) -> tuple[Quantity, ...]:
    """24-hour mean canopy temperature, fruit in mg m-2, temperature sum."""
    fruit = crop(context)[0]
    milligrams = Quantity("fruit_carbohydrate", "mg m-2", fruit.low * 1e6, fruit.high * 1e6, fruit.meaning)
    return (_mean_temperature(), milligrams, _temperature_sum(context))


def published_time(context: ObservationContext) -> tuple[Quantity, ...]:
    """Sine and cosine of the day of year (365 days), then of the hour of day (24 h)."""
    return _cycle("day_of_year", "day of year") + _cycle("hour_of_day", "hour of day")


def published_forecast(context: ObservationContext) -> tuple[Quantity, ...]:
    """As ``forecast``, with vapour pressure [Pa] and CO2 density [mg m-3] in the places of humidity and CO2."""
    return _ahead(context.forecast_steps, _PUBLISHED_FORECAST)


def full_state(context: ObservationContext) -> tuple[Quantity, ...]:
    """All states of the model under their own names and units."""
    from glbench.model import STATES

    summed = _temperature_sum(context)
    heaviest = _FRUIT_AT_START + _FASTEST_FRUIT_GROWTH * context.days
    by_unit = {
        "mg m-3": (0.0, highest_co2_density(context)),
        "Pa": (0.0, _LARGEST_VAPOUR_PRESSURE),
        "degC": (COLDEST, HOTTEST),
        "degC day": (summed.low, summed.high),
        # Buffer and organs; in long darkness the buffer falls below zero by less than 2000 mg m-2.
        "mg m-2": (-_BELOW_ZERO * 1e6, heaviest * 1e6),
        "day": (0.0, context.days * (1.0 + 1e-6)),
    }
    columns = []
    for state in STATES:
        unit = state.unit.replace("°C", "degC")
        low, high = (COLDEST, HOTTEST_METAL) if state.name in _METAL else by_unit[unit]
        columns.append(Quantity(state.name, unit, low, high, state.meaning))
    return tuple(columns)
