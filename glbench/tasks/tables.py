"""The tables of a task file, one frozen record each.

Keys carry their unit in their name (``step_seconds``), are plain fractions, or are written ``{ value = 16.5, unit =
"degC" }``; a wrong unit is refused. The description of a field is what an error message says is allowed.
"""

from __future__ import annotations

import copy
import datetime as dt
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from glbench.errors import TaskError, did_you_mean, refuse
from glbench.quantities import OUTDOOR
from glbench.tasks import vocabulary as words
from glbench.tasks.fields import (
    ClimateQuantityTable,
    Limits,
    Override,
    Table,
    as_tuple,
    check_hours,
    in_unit,
    limits_in,
    list_of,
    one_line,
    one_of,
    price_in,
    printable,
    set_or_list,
    sorted_overrides,
    suite_names,
)
from glbench.tasks.inheritance import as_written
from glbench.tasks.ledger import LIMITED, TRAVEL, VIOLATION_PRICES, Ledger
from glbench.tasks.prices import HOURS_A_DAY, PriceTableTable
from glbench.tasks.schedule import ScheduleEntry
from glbench.tasks.spreads import LARGEST_FACTOR, Spread, read_spread

SECONDS_A_DAY = 86400
LONGEST_FORECAST = 72
"""Hours that a forecast may look ahead."""
MOST_SEASONS = 10000
"""Generated seasons that a split may have."""
PERFECT = "perfect"


class WeatherTable(Table):
    """``[weather]``: the record, how it is prepared, and the period that is simulated."""

    source: str = Field(min_length=1, description='the name of a weather record in quotes, such as "schiphol"')
    preprocessing: Annotated[str, one_of(words.PREPROCESSINGS)] = Field(description="a way to prepare the record")
    start: dt.date = Field(
        ge=dt.date(1900, 1, 1),
        lt=dt.date(2200, 1, 1),
        description="the first day, without quotes, such as 2010-03-01, in the years 1900 to 2199",
    )
    days: int = Field(ge=1, le=3660, description="a whole number of days, 1 to 3660")
    step_seconds: int = Field(ge=60, le=3600, description="the control step: whole seconds, 60 to 3600")
    co2_ppm: float = Field(ge=100.0, le=2000.0, description="CO2 outside in ppm, 100 to 2000")

    @model_validator(mode="after")
    def _steps_fill_the_day(self) -> Self:
        if SECONDS_A_DAY % self.step_seconds:
            refuse(f"step_seconds = {self.step_seconds} does not divide a day of {SECONDS_A_DAY} s. Use 300, 600, 900, 1800, ...")
        return self

    @property
    def steps(self) -> int:
        """Number of control steps of the period."""
        return self.days * SECONDS_A_DAY // self.step_seconds


class FailedStep(Table):
    """What every missing step of a failed run counts."""

    reward: float = Field(description="a number")
    epi: Annotated[float, in_unit("EUR m-2")] = Field(description='a number: { value = -0.012975, unit = "EUR m-2" }')
    penalty: float = Field(ge=0.0, description="0 or more")


class TimeLimitsTable(Table):
    """What an agent may take of the clock, in seconds; the keys are those of ``glbench.evaluation.TimeLimits``."""

    start: Annotated[float, in_unit("s")] = Field(gt=0.0, description="above 0 s")
    step: Annotated[float, in_unit("s")] = Field(gt=0.0, description="above 0 s")
    run: Annotated[float, in_unit("s")] = Field(gt=0.0, description="above 0 s")


class EvaluationTable(Table):
    """``[evaluation]``: the seeds of the evaluation and the number that ranks."""

    first_seed: int = Field(ge=0, lt=2**32, description="a whole number, 0 or more")
    runs: int = Field(ge=1, le=10000, description="a whole number, 1 to 10000")
    metric: Annotated[str, one_of(words.METRICS), BeforeValidator(lambda name: "epi" if name == "profit" else name)] = Field(
        description="a metric"
    )
    failed_step: FailedStep
    time_limits: TimeLimitsTable | None = None

    @property
    def seeds(self) -> range:
        """Seeds of the evaluation runs."""
        return range(self.first_seed, self.first_seed + self.runs)


class ModelTable(Table):
    """``[model]``: which model, by name and version, its parameters, and single parameters that differ from the set."""

    variant: str = Field(default="author", min_length=1, description="a variant of the model, in quotes")
    parameters: str = Field(default="benchmark", min_length=1, description='a parameter set, such as "benchmark"')
    overrides: Annotated[tuple[Override, ...], BeforeValidator(sorted_overrides)] = Field(
        default=(), description="a table of parameters, each with value and unit"
    )
    id: str = Field(min_length=1, description='the id of a model in quotes, such as "greenlight-tomato-1.0.0"')


class InitialStateTable(Table):
    """``[initial_state]``: one of the model's starts, and the controls before the first step."""

    kind: str = Field(min_length=1, description="the name of a start in quotes")
    air_temperature: Annotated[float, in_unit("degC")] = Field(
        ge=-20.0, le=50.0, description='a temperature of -20 to 50 degC: { value = 16.5, unit = "degC" }'
    )
    controls: Annotated[tuple[Override, ...], BeforeValidator(sorted_overrides)] = Field(
        default=(), description="a table of controls, each with value and unit"
    )


class UncertaintyTable(Table):
    """Which parameters are redrawn, how often and how widely: ``[uncertainty]`` of schema 1."""

    distribution: Annotated[str, one_of(words.DISTRIBUTIONS)] = Field(description="a distribution")
    delta: float = Field(ge=0.0, lt=1.0, description="a fraction from 0 to below 1, such as 0.10 for 10 %")
    half_width_factor: float = Field(gt=0.0, le=1.0, description="a factor above 0, up to 1")
    parameters: Annotated[str | tuple[str, ...], BeforeValidator(set_or_list)] = Field(
        description="a parameter set or a list of parameters"
    )
    redraw: Literal["step", "episode"] = Field(description='"step" or "episode"')

    @property
    def half_width(self) -> float:
        """Largest relative deviation of a parameter from its nominal value."""
        return self.delta * self.half_width_factor


class PricesTable(Table):
    """What fruit is sold for and resources are bought for: ``[prices]`` of schema 1."""

    fruit: Annotated[float, in_unit("EUR kg-1")] = Field(ge=0.0, description="a price per kg of fresh fruit, 0 or more")
    dry_matter_content: Annotated[float, in_unit("kg kg-1")] = Field(
        gt=0.0, le=1.0, description="kg dry per kg fresh fruit, above 0, up to 1"
    )
    co2: Annotated[float, in_unit("EUR kg-1")] = Field(ge=0.0, description="a price per kg of CO2, 0 or more")
    heat: Annotated[float, in_unit("EUR kWh-1")] = Field(ge=0.0, description="a price per kWh of heat, 0 or more")
    electricity: Annotated[float, in_unit("EUR kWh-1")] = Field(ge=0.0, description="a price per kWh of electricity, 0 or more")


class ForecastTable(Table):
    """``[observation.forecast]``: coming weather, as the rows that will come or as a forecast that errs."""

    steps: int | None = Field(default=None, ge=1, le=2000, description="a whole number of steps, 1 to 2000")
    hours: Annotated[tuple[int, ...], BeforeValidator(as_tuple)] = Field(
        default=(), description="a list of whole hours ahead, such as [1, 2, 3, 6, 12, 18, 24]"
    )
    error: Annotated[str, one_of(words.FORECAST_ERRORS)] = Field(default=PERFECT, description="how much the forecast errs")
    unbiased: bool = Field(default=False, description="true or false")

    @model_validator(mode="after")
    def _hours_rise(self) -> Self:
        check_hours(self.hours, LONGEST_FORECAST)
        if self.error != PERFECT and not self.hours:
            refuse(f'error = "{self.error}" belongs to a forecast by the hour: add hours = [1, 2, 3, 6, 12, 18, 24].')
        return self


class DayAheadTable(Table):
    """``[observation.day_ahead]``: of which prices the coming hours are shown, as far as they are known."""

    prices: Annotated[tuple[str, ...], list_of("price table", "power")] = Field(description="a list of price tables")
    hours: Annotated[tuple[int, ...], BeforeValidator(as_tuple)] = Field(
        min_length=1, description="a list of whole hours ahead, such as [1, 2, 3, 6, 12]"
    )

    @model_validator(mode="after")
    def _hours_rise(self) -> Self:
        check_hours(self.hours, HOURS_A_DAY)
        return self


class ObservationTable(Table):
    """``[observation]``: what an agent sees: modules that every model has, and the model's own; and of which moment."""

    modules: Annotated[tuple[str, ...], list_of(words.OBSERVATION_MODULES.kind, "time")] = Field(
        description="a list of observation modules"
    )
    timing: Literal["current", "published"] = Field(description='"current" or "published"')
    forecast: ForecastTable | None = None
    day_ahead: DayAheadTable | None = None

    @model_validator(mode="after")
    def _forecast_is_granted_and_shown(self) -> Self:
        registry, forecast = words.OBSERVATION_MODULES, self.forecast
        if any(name not in registry for name in self.modules):
            return self  # a name that does not exist is reported by itself
        by_row = [name for name in self.modules if name in registry and registry[name].is_forecast]
        by_hour = [name for name in self.modules if name == words.WEATHER_FORECAST]
        ahead = [name for name in self.modules if registry[name].may_forecast] if forecast is not None and forecast.steps else []
        for key, modules, example, module in (
            ("steps", by_row, "steps = 48", "forecast"),
            ("hours", by_hour, "hours = [1, 2, 3, 6, 12, 18, 24]", words.WEATHER_FORECAST),
        ):
            reaches = forecast is not None and bool(getattr(forecast, key))
            if modules and not reaches:
                refuse(f"'{modules[0]}' is among the modules, so say how far it looks: add [observation.forecast] with {example}.")
            if reaches and not modules and not (key == "steps" and ahead):
                refuse(f'[observation.forecast] has {key}, but no such forecast is among the modules: add "{module}" to them.')
        if forecast is not None and not by_row and not by_hour and not ahead:
            refuse(f'There is a table [observation.forecast], but no forecast among the modules: add "{words.WEATHER_FORECAST}" to them.')
        return self

    @model_validator(mode="after")
    def _day_ahead_is_granted_and_shown(self) -> Self:
        is_shown = words.DAY_AHEAD in self.modules
        if is_shown and self.day_ahead is None:
            refuse(
                f"'{words.DAY_AHEAD}' is among the modules, so say of which prices and how far ahead: add [observation.day_ahead] "
                'with prices = ["power"] and hours = [1, 2, 3, 6, 12].'
            )
        if self.day_ahead is not None and not is_shown:
            refuse(f'There is a table [observation.day_ahead]: add "{words.DAY_AHEAD}" to the modules, or leave it out.')
        return self

    @property
    def forecast_steps(self) -> int:
        """Rows of coming weather that are shown as they are; 0 without such a forecast."""
        return (self.forecast.steps or 0) if self.forecast is not None else 0

    @property
    def forecast_hours(self) -> tuple[int, ...]:
        """Hours ahead of a forecast by the hour; none without one."""
        return self.forecast.hours if self.forecast is not None else ()


PROCESS_COMPUTER = "process_computer"
"""The kind of actuation that has a table of its own."""
SWITCHING = ("rate", "set_point")
"""The kinds that can work machines that are off or on."""


def _setting(default: float, unit: str, about: str, *, above: float | None = None) -> Any:
    """A setting of the process computer: 0 or more, or more than ``above``; docs/process-computer.md explains it."""
    about = f'{about}: {{ value = {default:g}, unit = "{unit}" }}'
    return Field(default=default, ge=0.0 if above is None else None, gt=above, description=about)


_Kelvin = Annotated[float, in_unit("K")]
_Celsius = Annotated[float, in_unit("degC")]
_Rate = Annotated[float, in_unit("K h-1")]
_Slope = Annotated[float, in_unit("K K-1")]
_WindSlope = Annotated[float, in_unit("K s m-1")]
_Watts = Annotated[float, in_unit("W m-2")]
_Grams = Annotated[float, in_unit("g m-3")]
_Ppm = Annotated[float, in_unit("ppm")]
_Hours = Annotated[float, in_unit("h")]


class ProcessComputerTable(Table):
    """``[actuation.process_computer]``: the rules that the set points do not change. All keys may be left out."""

    dead_zone: _Kelvin = _setting(1.0, "K", "0 K or more")
    temperature_rise: _Rate = _setting(1.5, "K h-1", "above 0 K h-1", above=0.0)
    temperature_fall: _Rate = _setting(3.0, "K h-1", "above 0 K h-1", above=0.0)
    heating_band: _Kelvin = _setting(2.0, "K", "above 0 K", above=0.0)
    ventilation_band: _Kelvin = _setting(6.0, "K", "above 0 K", above=0.0)
    ventilation_band_below: _Celsius = Field(default=20.0, ge=-50.0, le=50.0, description="-50 to 50 degC")
    ventilation_band_cold: _Slope = _setting(0.6, "K K-1", "0 or more")
    ventilation_band_wind: _WindSlope = _setting(0.3, "K s m-1", "0 or more")
    ventilation_band_most: _Kelvin = _setting(25.0, "K", "not below ventilation_band", above=0.0)
    vent_time: _Hours = _setting(0.5, "h", "0 h or more")
    humidity_band: _Grams = _setting(1.0, "g m-3", "above 0 g m-3", above=0.0)
    minimum_heat: _Watts = _setting(20.0, "W m-2", "0 W m-2 or more")
    minimum_heat_radiation: _Watts = _setting(250.0, "W m-2", "above 0 W m-2", above=0.0)
    vent_gap: float = Field(default=0.25, ge=0.0, le=1.0, description="a fraction from 0 to 1")
    vent_gap_cold: _Kelvin = _setting(2.0, "K", "above 0 K", above=0.0)
    co2_band: _Ppm = _setting(200.0, "ppm", "above 0 ppm", above=0.0)
    co2_radiation: _Watts = _setting(30.0, "W m-2", "above 0 W m-2", above=0.0)
    co2_vents: float = Field(default=0.1, ge=0.0, lt=1.0, description="a fraction from 0 to below 1")
    co2_vents_off: float = Field(default=0.3, gt=0.0, le=1.0, description="a fraction above co2_vents, up to 1")
    lamp_hysteresis: _Watts = _setting(50.0, "W m-2", "0 W m-2 or more")
    lamp_minimum_time: _Hours = _setting(0.5, "h", "0 h or more")
    screen_radiation_hysteresis: _Watts = _setting(20.0, "W m-2", "0 W m-2 or more")
    screen_temperature_hysteresis: _Kelvin = _setting(1.0, "K", "0 K or more")
    screen_minimum_time: _Hours = _setting(0.5, "h", "0 h or more")
    screen_gap: float = Field(default=0.1, ge=0.0, le=1.0, description="a fraction from 0 to 1")
    screen_heat_band: _Kelvin = _setting(2.0, "K", "above 0 K", above=0.0)
    blackout_radiation: _Watts = _setting(10.0, "W m-2", "0 W m-2 or more")

    @model_validator(mode="after")
    def _bands_are_in_order(self) -> Self:
        if self.ventilation_band_most < self.ventilation_band:
            refuse(
                f"ventilation_band_most = {self.ventilation_band_most:g} K must not be below "
                f"ventilation_band = {self.ventilation_band:g} K."
            )
        if self.co2_vents >= self.co2_vents_off:
            refuse(f"co2_vents = {self.co2_vents:g} must be below co2_vents_off = {self.co2_vents_off:g}.")
        return self


class DueTable(Table):
    """``due`` of a machine: it is on while a state is at least a value, ``first`` at the highest action and ``last`` at the lowest."""

    state: str = Field(min_length=1, description='the name of a state of the model in quotes, such as "plantingDays"')
    first: float = Field(description="a number")
    last: float = Field(description="a number above that of first")
    unit: str = Field(description="the unit of the state in quotes")

    @model_validator(mode="after")
    def _first_comes_first(self) -> Self:
        if self.first >= self.last:
            refuse(f"first = {self.first:g} must be below last = {self.last:g}.")
        return self


class OnOffTable(Table):
    """``[actuation.on_off.<control>]``: a machine that is off or runs between ``lowest`` and 1, and stays on or off for a while."""

    lowest: float = Field(gt=0.0, le=1.0, description="a fraction above 0, up to 1")
    hold_minutes: float = Field(default=0.0, ge=0.0, le=1440.0, description="a number of minutes, 0 to 1440")
    due: DueTable | None = Field(default=None, description='a table such as { state = "plantingDays", first = 20, last = 65, unit = "day"}')

    @model_validator(mode="after")
    def _what_is_due_has_one_load(self) -> Self:
        if self.due is not None and self.lowest < 1.0:
            refuse(f"lowest = {self.lowest:g}: a machine with due is off or fully on. Write lowest = 1.0.")
        return self


class PaperActuationTable(Table):
    """``[actuation]``: how an action becomes a control. Controls that are not listed stay at 0."""

    kind: Annotated[str, one_of(words.ACTUATION_KINDS)] = Field(description="a kind of actuation")
    max_change: float = Field(gt=0.0, le=1.0, description="the largest change of a control in a step, above 0, up to 1")
    controls: Annotated[tuple[str, ...], list_of("control", "uVent")] = Field(description="a list of controls")


class ActuationTable(PaperActuationTable):
    """``[actuation]`` of schema 2, with settings of a process computer, and machines that are switched on and off."""

    process_computer: ProcessComputerTable = ProcessComputerTable()
    on_off: dict[str, OnOffTable] = Field(default={}, description="tables [actuation.on_off.<control>]")

    @model_validator(mode="after")
    def _settings_are_used(self) -> Self:
        if "process_computer" in self.model_fields_set and self.kind != PROCESS_COMPUTER:
            refuse(f'There is a table [actuation.process_computer], but the kind is "{self.kind}". Take one of them out.')
        return self

    @model_validator(mode="after")
    def _machines_can_be_switched(self) -> Self:
        if self.on_off and self.kind not in SWITCHING:
            refuse(f'There are tables [actuation.on_off], but the kind is "{self.kind}". It must be {" or ".join(SWITCHING)}.')
        for name in self.on_off:
            if name not in self.controls:
                refuse(f"[actuation.on_off.{name}] is about a control that the task does not grant.{did_you_mean(name, self.controls)}")
        return self


class ConstraintsTable(ClimateQuantityTable):
    """``[constraints]``: some limits of the air, or none."""

    judged: Literal["end", "mean"] = Field(default="end", description='"end" or "mean"')
    air_temperature: Annotated[Limits | None, limits_in(LIMITED["air_temperature"])] = None
    co2: Annotated[Limits | None, limits_in(LIMITED["co2"])] = None
    relative_humidity: Annotated[Limits | None, limits_in(LIMITED["relative_humidity"])] = None


class PenaltyScales(ClimateQuantityTable):
    """Violation that costs 1 per step, for each constraint."""

    air_temperature: Annotated[float | None, in_unit(LIMITED["air_temperature"])] = Field(default=None, gt=0.0, description="above 0 degC")
    co2: Annotated[float | None, in_unit(LIMITED["co2"])] = Field(default=None, gt=0.0, description="above 0 ppm")
    relative_humidity: Annotated[float | None, in_unit(LIMITED["relative_humidity"])] = Field(default=None, gt=0.0, description="above 0 %")


Price = float | tuple[float, float]
"""A price, or that of a value too low and that of one too high."""


class ViolationPrices(ClimateQuantityTable):
    """What a violation costs for every unit beyond the limit and every hour."""

    air_temperature: Annotated[Price | None, price_in(VIOLATION_PRICES["air_temperature"])] = None
    co2: Annotated[Price | None, price_in(VIOLATION_PRICES["co2"])] = None
    relative_humidity: Annotated[Price | None, price_in(VIOLATION_PRICES["relative_humidity"])] = None


class RewardTable(Table):
    """``[reward]``: the sum of these modules is the reward of a step."""

    modules: Annotated[tuple[str, ...], list_of(words.REWARD_MODULES.kind, "epi", words.REWARD_MODULES)] = Field(
        description="a list of reward modules"
    )
    penalty_scale: PenaltyScales = PenaltyScales()
    violation_price: ViolationPrices = ViolationPrices()
    epi_scale: Annotated[Limits | None, limits_in("EUR m-2")] = None
    """The profit of a step that counts as 0, and that which counts as 1, in ``scaled_epi``."""


class BeyondTable(Table):
    """``[ledger.<column>.beyond]``: what the rest costs when more than an amount has flowed since the start."""

    amount: float = Field(gt=0.0, description='above 0, as in { value = 12.0, unit = "kg m-2" }')
    amount_unit: str = Field(default="", exclude=True)
    price: float = Field(description='{ value = 0.20, unit = "EUR kg-1" }')
    price_unit: str = Field(default="", exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _with_units(cls, table: object) -> object:
        if not isinstance(table, Mapping):
            return table
        plain = dict(table)
        for key in ("amount", "price"):
            entry = table.get(key)
            if not isinstance(entry, Mapping) or set(entry) != {"value", "unit"} or not isinstance(entry["unit"], str):
                refuse(
                    'Write amount and price with their units: beyond = { amount = { value = 12.0, unit = "kg m-2" }, '
                    'price = { value = 0.20, unit = "EUR kg-1" } }.'
                )
            plain |= {key: entry["value"], f"{key}_unit": entry["unit"]}
        return plain


_NUMBER = re.compile(r"[+-]?\d*[.,]?\d+")


class ItemTable(Table):
    """``[ledger.<column>]``: what is earned or paid, and at which price."""

    side: Literal["earned", "paid"] = Field(description='"earned" or "paid"')
    flow: str | None = Field(default=None, min_length=1, description="the name of a flow of the model, in quotes")
    stock: str | None = Field(default=None, min_length=1, description="the name of a stock of the model, in quotes")
    price: float | str = Field(description='{ value = 0.09, unit = "EUR kWh-1" }, or the name of a price table')
    price_unit: str | None = Field(default=None, exclude=True)
    amount: str | None = Field(default=None, min_length=1, description="the name of the amount's column, in quotes")
    unit: str | None = Field(default=None, description='the unit of the amount in quotes, such as "kg m-2"')
    factor: float = Field(default=1.0, gt=0.0, description="from the unit of the flow to that of the amount, above 0")
    label: str = Field(default="", description="a heading in quotes")
    beyond: BeyondTable | None = None

    @model_validator(mode="before")
    @classmethod
    def _price_with_unit(cls, table: object) -> object:
        if not isinstance(table, Mapping) or "price" not in table:
            return table
        price = table["price"]
        text = price.get("value") if isinstance(price, Mapping) else price
        if isinstance(text, str) and _NUMBER.fullmatch(text.strip()):
            plain = text.strip().replace(",", ".")
            refuse(f'price is "{text}": a number is written without quotes, price = {{ value = {plain}, unit = "EUR kWh-1" }}.')
        if isinstance(price, str):
            return table
        if not isinstance(price, Mapping) or set(price) != {"value", "unit"} or not isinstance(price["unit"], str):
            number = price if isinstance(price, int | float) else 0.09
            refuse(f'Write the price with its unit, such as price = {{ value = {number}, unit = "EUR kWh-1" }}, or name a price table.')
        return {**table, "price": price["value"], "price_unit": price["unit"]}

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.flow is None) == (self.stock is None):
            refuse('It must name either a flow or a stock: flow = "heat", or stock = "fruit".')
        if self.factor != 1.0 and (self.amount is None or self.unit is None):
            refuse("With a factor the amount is another one than the flow: name it, and its unit: amount = ..., unit = ...")
        return self


class SeasonTable(Table):
    """A season that a run may be in."""

    start: dt.date = Field(ge=dt.date(1900, 1, 1), lt=dt.date(2200, 1, 1), description="a first day, such as 2010-03-01")
    source: str | None = Field(default=None, min_length=1, description="a weather record, in quotes; that of [weather] if none is named")


class DrawTable(Table):
    """What parameters and start states that are drawn have in common."""

    name: str = Field(default="", description="a name in quotes")
    distribution: Annotated[str, one_of(words.DISTRIBUTIONS)] = Field(default="uniform", description="a distribution")
    half_width: float = Field(ge=0.0, lt=1.0, description="a fraction from 0 to below 1, such as 0.10 for 10 %")


class ParameterGroupTable(DrawTable):
    """``[[scenario.parameters]]``: parameters that are drawn."""

    parameters: Annotated[str | tuple[str, ...], BeforeValidator(set_or_list)] = Field(
        description="a parameter set or a list of parameters"
    )
    redraw: Literal["step", "day", "episode"] = Field(description='"step", "day" or "episode"')
    spread: str | None = Field(default=None, min_length=1, description='the name of a spread in quotes, such as "measured"')
    factor: float = Field(default=1.0, gt=0.0, le=LARGEST_FACTOR, description=f"a factor above 0, up to {LARGEST_FACTOR:g}")

    @model_validator(mode="before")
    @classmethod
    def _parameters_of_spread(cls, table: object) -> object:
        if not isinstance(table, Mapping):
            return table
        name = table.get("spread")
        if name is None and "factor" in table:
            refuse('factor scales a spread: add spread = "measured", or leave factor out.')
        if not isinstance(name, str):
            return table
        own = [key for key in ("parameters", "half_width", "distribution") if key in table]
        if own:
            refuse(f'spread = "{name}" says which parameters are drawn and how widely: leave {" and ".join(own)} out, or spread.')
        if table.get("redraw", "episode") != "episode":
            refuse(f'spread = "{name}" is about houses, which do not change during a run: write redraw = "episode".')
        return {**table, "half_width": 0.0, "parameters": [row.parameter for row in read_spread(name).rows]}

    @property
    def measured(self) -> Spread | None:
        """The spread that the group names, with its factor."""
        return None if self.spread is None else read_spread(self.spread, self.factor)

    @property
    def width(self) -> float:
        """Largest relative deviation of a parameter from its nominal value."""
        return self.half_width if self.measured is None else self.measured.width


class StartGroupTable(DrawTable):
    """``[[scenario.start]]``: states that are multiplied by a factor at the start of a run."""

    states: Annotated[tuple[str, ...], list_of("state", "cFruit")] = Field(description="a list of states")


class SplitTable(Table):
    """``[splits.<name>]``: the years from which seasons are drawn, and how many there are."""

    years: Annotated[tuple[int, ...], BeforeValidator(as_tuple)] = Field(description="a list of years")
    seasons: int | None = Field(default=None, ge=1, le=MOST_SEASONS, description=f"a whole number, 1 to {MOST_SEASONS}")

    @model_validator(mode="after")
    def _different_years(self) -> Self:
        if not self.years or len(set(self.years)) < len(self.years) or not all(1 <= year <= 9999 for year in self.years):
            refuse("years must be different years, at least one, each of which the weather record has.")
        return self


class SplitsTable(Table):
    """``[splits]``: what is for training, for choosing between agents, and for the score."""

    training: SplitTable | None = None
    validation: SplitTable | None = None
    test: SplitTable

    @property
    def names(self) -> tuple[str, ...]:
        """Those that are there: training, validation, test."""
        return tuple(name for name in ("training", "validation", "test") if getattr(self, name) is not None)

    @model_validator(mode="after")
    def _test_is_held_out(self) -> Self:
        for name in self.names[:-1]:
            shared = sorted(set(getattr(self, name).years) & set(self.test.years))
            if shared:
                refuse(f"{name} and test share the year {shared[0]}: no season that scores may be seen before.")
        return self


class OffsetSensorTable(Table):
    """``[outdoor_sensors.<quantity>]`` of a sensor that is off by an amount; what is 0 may be left out."""

    noise: float = Field(default=0.0, ge=0.0, description="0 or more")
    bias: float = Field(default=0.0, ge=0.0, description="0 or more")


class SensorTable(OffsetSensorTable):
    """``[sensors.<quantity>]``: how far a sensor is off; what is 0 may be left out."""

    drift: float = Field(default=0.0, ge=0.0, description="0 or more")


def _sensor_in(unit: str) -> BeforeValidator:
    """Read the numbers of a sensor, each with its unit."""
    number = in_unit(unit).func

    def sensor(table: object) -> object:
        if not isinstance(table, Mapping):
            return table
        plain = dict(table)
        for key, entry in table.items():
            try:
                plain[key] = number(entry) if key in SensorTable.model_fields else entry  # type: ignore[call-arg]
            except ValueError as error:
                msg = f"{key} = {as_written(entry)}: {error}"
                raise ValueError(msg) from None
        return plain

    return BeforeValidator(sensor)


class FaultsTable(Table):
    """How often a sensor or an actuator has a fault, and for how long; both are means."""

    days_between: float = Field(gt=0.0, le=3660.0, description="a number of days above 0")
    hours: float = Field(gt=0.0, le=240.0, description="a number of hours above 0, up to 240")

    def chances(self, step_seconds: float) -> tuple[float, float]:
        """Chance in a step that a fault begins, and that one lasts."""
        hours = step_seconds / 3600.0
        return min(hours / (24.0 * self.days_between), 1.0), max(1.0 - hours / self.hours, 0.0)


class SensorsTable(ClimateQuantityTable):
    """``[sensors]``: sensors of the air inside that err. What is judged is the truth."""

    air_temperature: Annotated[SensorTable | None, _sensor_in(LIMITED["air_temperature"])] = None
    co2: Annotated[SensorTable | None, _sensor_in(LIMITED["co2"])] = None
    relative_humidity: Annotated[SensorTable | None, _sensor_in(LIMITED["relative_humidity"])] = None
    dropouts: FaultsTable | None = None

    @model_validator(mode="after")
    def _something_drops_out(self) -> Self:
        if self.dropouts is not None and not self.items():
            refuse("There are [sensors.dropouts], but no sensor that could drop out: add [sensors.air_temperature].")
        return self


class ScaleTable(Table):
    """Lowest and highest factor that a sensor is off by."""

    low: float = Field(gt=0.0, le=10.0, description="a factor above 0, up to 10")
    high: float = Field(gt=0.0, le=10.0, description="a factor above 0, up to 10")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low > self.high:
            refuse(f"low = {self.low:g} must not be above high = {self.high:g}.")
        return self


class ScaledSensorTable(Table):
    """``[outdoor_sensors.<quantity>]`` of a sensor that is off by a factor; what is left out is right."""

    scale: ScaleTable = ScaleTable(low=1.0, high=1.0)
    noise: float = Field(default=0.0, ge=0.0, le=0.3, description="a fraction of the reading from 0 to 0.3, such as 0.02 for 2 %")


class OutdoorSensorsTable(Table):
    """``[outdoor_sensors]``: sensors of the weather that err. What acts on the greenhouse is the truth."""

    global_radiation: ScaledSensorTable | None = None
    outdoor_temperature: Annotated[OffsetSensorTable | None, _sensor_in(OUTDOOR["outdoor_temperature"].unit)] = None
    outdoor_relative_humidity: Annotated[OffsetSensorTable | None, _sensor_in(OUTDOOR["outdoor_relative_humidity"].unit)] = None
    wind_speed: ScaledSensorTable | None = None

    def items(self) -> tuple[tuple[str, ScaledSensorTable | OffsetSensorTable], ...]:
        """Names and entries of those that the table has, in the order above."""
        entries = ((name, getattr(self, name)) for name in type(self).model_fields)
        return tuple((name, entry) for name, entry in entries if entry is not None)


class WindLimitTable(Table):
    """``[actuators.<control>.wind]``: from a wind speed on, a control delivers less, down to a share of its command."""

    above: Annotated[float, in_unit("m s-1")] = Field(ge=0.0, description='a wind speed, 0 or more: { value = 12.0, unit = "m s-1" }')
    full: Annotated[float, in_unit("m s-1")] = Field(description='a wind speed higher than above: { value = 16.0, unit = "m s-1" }')
    share: float = Field(default=0.0, ge=0.0, lt=1.0, description="a fraction from 0 to below 1")

    @model_validator(mode="after")
    def _speeds_rise(self) -> Self:
        if self.full <= self.above:
            refuse(f"full = {self.full:g} m s-1 must be higher than above = {self.above:g} m s-1.")
        return self


class ActuatorTable(Table):
    """``[actuators.<control>]``: how what an actuator delivers differs from its command; what is left out is ideal."""

    lag_minutes: float = Field(default=0.0, ge=0.0, le=240.0, description="a number of minutes, 0 to 240")
    shortfall: float = Field(default=0.0, ge=0.0, lt=1.0, description="a fraction from 0 to below 1")
    sticks: FaultsTable | None = None
    fails: FaultsTable | None = None
    wind: WindLimitTable | None = None


class SampleTable(Table):
    """``[samples.<module>]``: an observation module whose columns are counted or weighed by hand, first at the start of a run."""

    every_days: int = Field(ge=1, le=366, description="a whole number of days, 1 to 366")
    noise: float = Field(default=0.0, ge=0.0, le=0.3, description="a fraction of the value from 0 to 0.3, such as 0.06 for 6 %")


class CameraTable(Table):
    """``[camera]``: the observation module ``camera``, a picture once a day and one at the start of a run."""

    library: str = Field(
        pattern=r"^[a-z]+-[1-9][0-9]*$", description='a library of pictures with its version in quotes, such as "lettuce-2"'
    )
    hour: int = Field(default=12, ge=1, le=23, description="a whole hour of the day, 1 to 23")


class ScenarioTable(Table):
    """``[scenario]``: what a run draws. Tasks of one family and salt share their random numbers."""

    family: Annotated[str, BeforeValidator(one_line)] = Field(min_length=1, description="a name in quotes")
    salt: Annotated[str, BeforeValidator(one_line)] = Field(default="", description="text in quotes")
    seasons: Annotated[tuple[SeasonTable, ...], BeforeValidator(as_tuple)] = Field(
        default=(), description='a list of { start = 2010-03-01, source = "schiphol" }'
    )
    years: Annotated[tuple[int, ...], BeforeValidator(as_tuple)] = Field(default=(), description="a list of years")
    start_within_days: int = Field(default=0, ge=0, le=366, description="a whole number of days, 0 to 366")
    generated: bool = Field(default=False, description="true or false")
    co2_range: Annotated[Limits | None, limits_in("ppm")] = None
    parameters: Annotated[tuple[ParameterGroupTable, ...], BeforeValidator(as_tuple)] = Field(
        default=(), description="tables [[scenario.parameters]]"
    )
    start: Annotated[tuple[StartGroupTable, ...], BeforeValidator(as_tuple)] = Field(default=(), description="tables [[scenario.start]]")

    @model_validator(mode="after")
    def _one_list_of_seasons(self) -> Self:
        if self.seasons and self.years:
            refuse("It has both seasons and years: years are seasons that start on the day of [weather]. Keep one of them.")
        if len(set(self.years)) < len(self.years) or not all(1 <= year <= 9999 for year in self.years):
            refuse("years must be different years, each of which the weather record has.")
        for groups in (self.parameters, self.start):
            names = [group.name or str(place) for place, group in enumerate(groups)]
            if len(set(names)) < len(names):
                refuse("Two groups have the same name: a stream of random numbers is called after it.")
        return self


class TaskFile(Table):
    """What task files of both schemas say. Tables of the file are fields of the same name; ``[initial_state]`` is ``initial``."""

    id: str = Field(
        pattern=r"^[A-Za-z0-9_-]+/[A-Za-z0-9_.-]+-v[1-9][0-9]*$",
        description='an id in quotes with a namespace and a version, such as "mylab/Winter2011-v1"',
    )
    title: Annotated[str, BeforeValidator(one_line)] = Field(min_length=1, description="a title in quotes")
    description: Annotated[str, BeforeValidator(printable)] = Field(default="", description="text in quotes")
    suites: Annotated[tuple[str, ...], BeforeValidator(suite_names)] = Field(default=(), description="a list of names")
    weather: WeatherTable
    actuation: PaperActuationTable
    evaluation: EvaluationTable


@dataclass(frozen=True)
class Conventions:
    """What the schema of a task fixes outside its tables, because published results, records and pages have it."""

    keys_by_task: bool = False
    """Random numbers are keyed by task id and seed, not by family, salt, seed and stream."""
    draws_table: str = "scenario.parameters"
    seasons_table: str = "scenario"
    """``draws_table`` and ``seasons_table``: tables of the file that say what is drawn and in which seasons, as messages name them."""
    extra_quantities: tuple[str, ...] = (TRAVEL,)
    """Quantities of a step besides money, amounts and violations: entries of ``step`` in ``glbench/quantities.toml``."""
    paper_words: bool = False
    """Metrics and pages have the names and words of the GreenLight-Gym paper."""
    profiles_deficits: bool = True
    """Profiles have vapour deficits and light sums."""
    names_model: bool = True
    """Records and pages name the model by its id, not by its version alone."""
    shows_delta: bool = False
    """Lists and pages state delta, by which the tasks of a family differ."""
    freezes_draws: bool = True
    """``tasks/behaviour.toml`` has what runs draw and observe."""


class TaskFile2(TaskFile):
    """The record of a task, as schema 2 says it: any model, a ledger, a scenario for every run.

    Files of schema 1 become such a record as well (``glbench.tasks.schema1.PaperTaskFile``). ``content`` are the tables that it was read
    from; ``None`` for an unchecked copy.
    """

    conventions: ClassVar[Conventions] = Conventions()

    schema_version: Literal[2] = Field(alias="schema", description="1 or 2")
    model: ModelTable
    initial: InitialStateTable = Field(alias="initial_state")
    observation: ObservationTable
    actuation: ActuationTable
    constraints: ConstraintsTable = ConstraintsTable()
    ledger: dict[str, ItemTable] = Field(default={}, description="tables [ledger.<column>]")
    price_tables: dict[str, PriceTableTable] = Field(default={}, description="tables [price_tables.<name>]")
    schedule: Annotated[tuple[ScheduleEntry, ...], BeforeValidator(as_tuple)] = Field(default=(), description="tables [[schedule]]")
    scenario: ScenarioTable
    splits: SplitsTable | None = None
    sensors: SensorsTable | None = None
    outdoor_sensors: OutdoorSensorsTable | None = None
    actuators: dict[str, ActuatorTable] = Field(default={}, description="tables [actuators.<control>]")
    samples: dict[str, SampleTable] = Field(default={}, description="tables [samples.<module>]")
    camera: CameraTable | None = None
    reward: RewardTable

    _content: Mapping[str, Any] | None = PrivateAttr(default=None)

    @classmethod
    def of_content(cls, content: Mapping[str, Any]) -> Self:
        """The record of the tables ``content``, as TOML gives them. Raises ``pydantic.ValidationError`` when they define no task."""
        record = cls.model_validate(content)
        record._content = content
        return record

    def content(self, source: str) -> dict[str, Any]:
        """The tables as TOML gives them; messages call the task ``source``. Raises ``TaskError`` when the record is an unchecked copy."""
        if self._content is None:
            refuse(f"{source} is a changed copy of a task, which nothing checked. Make it with replace, or write it as a file.", TaskError)
        return copy.deepcopy(dict(self._content))

    def with_tables(self, update: Mapping[str, Any]) -> TaskFile2:
        """A copy with other tables, which are not checked."""
        record = self.model_copy(update=dict(update))
        record._content = None
        return record

    def plain(self, **options: Any) -> dict[str, Any]:
        """What the file says as plain values, as ``pydantic.BaseModel.model_dump`` gives them."""
        return self.model_dump(**options)

    def attachment(self, source: str) -> dict[str, Any]:
        """The tables as plain JSON values, as records of runs have them attached. Errors as for ``content``."""
        return as_json(self.content(source))

    def paper_ledger(self) -> Ledger | None:
        """The ledger, where the file has prices of the paper's four goods instead of ledger items."""
        return None

    @property
    def prices(self) -> PricesTable | None:
        """Prices of the paper's four goods; ``None`` where the file has a ledger."""
        return None

    @property
    def uncertainty(self) -> UncertaintyTable:
        """Which parameters are redrawn: the widest group of the scenario, or the table of schema 1."""
        widest = sorted(self.scenario.parameters, key=lambda group: group.width)[-1:]
        facts: dict[str, Any] = {"distribution": "uniform", "delta": 0.0, "parameters": (), "redraw": "episode"}
        for group in widest:
            facts = {"distribution": group.distribution, "delta": group.width, "parameters": group.parameters, "redraw": group.redraw}
        return UncertaintyTable.model_construct(half_width_factor=1.0, **facts)

    @model_validator(mode="after")
    def _actuators_are_moved(self) -> Self:
        for name, table in self.actuators.items():
            if name not in self.actuation.controls:
                refuse(f"[actuators.{name}] is about a control that the task does not grant.{did_you_mean(name, self.actuation.controls)}")
            if name in self.actuation.on_off and (table.lag_minutes or table.shortfall or table.wind):
                refuse(f"[actuators.{name}] {name} is off or on ([actuation.on_off]): it can fail or stick, and has no other key.")
        return self

    @model_validator(mode="after")
    def _samples_are_shown(self) -> Self:
        for name in self.samples:
            if name not in self.observation.modules:
                near = did_you_mean(name, self.observation.modules)
                refuse(f"[samples.{name}] is about an observation module that the task does not show.{near}")
        if self.camera is not None and "camera" not in self.observation.modules:
            refuse('[camera] takes pictures that the task does not show: add "camera" to [observation] modules, or leave the table out.')
        return self

    @model_validator(mode="after")
    def _prices_follow_each_other(self) -> Self:
        for name, table in self.price_tables.items():
            if table.of is None:
                continue
            followed = self.price_tables.get(table.of)
            if followed is None:
                refuse(f"[price_tables.{name}] of = '{table.of}': there is no such table.{did_you_mean(table.of, self.price_tables)}")
            if followed.of is not None:
                refuse(f"[price_tables.{name}] of = '{table.of}', which follows '{followed.of}' itself. Name that one.")
            if followed.unit != table.unit:
                refuse(f"[price_tables.{name}] is in {table.unit}, and '{table.of}', which it follows, in {followed.unit}.")
        return self

    @model_validator(mode="after")
    def _day_ahead_prices_are_there(self) -> Self:
        day_ahead = self.observation.day_ahead
        for name in day_ahead.prices if day_ahead is not None else ():
            if name not in self.price_tables:
                refuse(f"[observation.day_ahead] prices: there is no price table '{name}'.{did_you_mean(name, self.price_tables)}")
        return self

    @model_validator(mode="after")
    def _seasons_are_stated_once(self) -> Self:
        scenario, splits = self.scenario, self.splits
        if splits is not None and (scenario.seasons or scenario.years):
            refuse("[scenario] has seasons or years, and [splits] has years too. Keep those of [splits].")
        if scenario.generated and splits is None:
            refuse("[scenario] generated = true needs [splits]: which years seasons are made of, for training and for the test.")
        if scenario.co2_range is not None and not scenario.generated:
            refuse("[scenario.co2_range] goes with generated seasons: add generated = true, or leave it out.")
        for name in splits.names if splits is not None else ():
            if (getattr(splits, name).seasons is None) is scenario.generated:
                refuse(
                    f"[splits.{name}] must say how many seasons are generated: seasons = 100."
                    if scenario.generated
                    else f"[splits.{name}] has a number of seasons, but they are not generated: add generated = true to [scenario]."
                )
        return self

    @model_validator(mode="after")
    def _violations_cost_something(self) -> Self:
        scales, prices = (dict(table.items()) for table in (self.reward.penalty_scale, self.reward.violation_price))
        if scales and prices:
            refuse(
                f"[reward.penalty_scale] has {next(iter(scales))} and [reward.violation_price] has {next(iter(prices))}: violations cost "
                "points or money, not both. Keep one of the tables."
            )
        if self.constraints.judged == "mean" and not self.constraints.items():
            refuse('[constraints] has judged = "mean" and no limit to judge by. Add one, or leave judged out.')
        for name, limits in self.constraints.items():
            if name in scales or name in prices:
                continue
            scale = f'{name} = {{ value = ..., unit = "{limits.unit}" }}'
            price = f'{name} = {{ value = ..., unit = "{VIOLATION_PRICES[name]}" }}'
            msg = f"[constraints.{name}] needs what a violation costs: add {price} to [reward.violation_price]"
            if not prices:
                msg = (
                    f"[constraints.{name}] needs the violation that costs 1 a step: add {scale} to [reward.penalty_scale]; "
                    f"or what it costs in money: {price} in [reward.violation_price]"
                )
            refuse(f"{msg}.")
        return self


def as_json(content: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a file as plain JSON values: days and moments as text (ISO 8601)."""
    plain: dict[str, Any] = json.loads(json.dumps(content, default=lambda moment: moment.isoformat()))
    return plain
