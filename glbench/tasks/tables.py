"""The tables of a task file, one frozen record each.

Keys carry their unit in their name (``step_seconds``), are plain fractions, or are written ``{ value = 16.5, unit =
"degC" }``; a wrong unit is refused. The description of a field is what an error message says is allowed.
"""

from __future__ import annotations

import datetime as dt
import re
import unicodedata
from calendar import monthrange
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, PrivateAttr, model_validator

from glbench.errors import did_you_mean
from glbench.tasks import vocabulary as words
from glbench.tasks.inheritance import as_written
from glbench.tasks.ledger import LIMITED, VIOLATION_PRICES
from glbench.tasks.prices import HOURS_A_DAY, SHAPE, Market, PriceTable

SECONDS_A_DAY = 86400
LONGEST_FORECAST = 72
"""Hours that a forecast may look ahead."""
MOST_SEASONS = 10000
"""Generated seasons that a split may have."""
PERFECT = "perfect"


class Table(BaseModel):
    """Base of the tables: frozen, strict, no unknown keys, no NaN and no infinity."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False, validate_by_name=False)


def in_unit(unit: str) -> BeforeValidator:
    """Read ``{ value = ..., unit = "..." }`` and hand on the value, if the unit is ``unit``."""

    def value_of(given: object) -> object:
        if not isinstance(given, Mapping) or set(given) != {"value", "unit"}:
            msg = f'Write it with its unit: {{ value = ..., unit = "{unit}" }}.'
            raise ValueError(msg)
        if given["unit"] != unit:
            msg = f'Its unit is "{unit}", not {as_written(given["unit"])}: convert the value and write that unit.'
            raise ValueError(msg)
        return given["value"]

    return BeforeValidator(value_of)


def one_of(known: words.Registry[Any]) -> BeforeValidator:
    """Accept a word of the registry ``known``; refuse any other with the nearest."""

    def word(given: object) -> str:
        if not isinstance(given, str):
            msg = f"It must be the name of a {known.kind}, in quotes."
            raise ValueError(msg)  # noqa: TRY004 -- pydantic turns ValueErrors into messages, TypeErrors into crashes
        if given not in known:
            msg = f"There is no {known.kind} called '{given}'.{did_you_mean(given, known.names)}"
            raise ValueError(msg)
        return given

    return BeforeValidator(word)


def list_of(kind: str, example: str, known: Callable[[], tuple[str, ...]] | None = None) -> BeforeValidator:
    """Accept a list of different names, at least one; out of ``known()`` if that is given."""

    def names(given: object) -> tuple[str, ...]:
        if not isinstance(given, list | tuple) or not given or not all(isinstance(name, str) for name in given):
            msg = f'It must be a list of names of {kind}s, such as ["{example}"].'
            raise ValueError(msg)
        for name in given:
            if known is not None and name not in known():
                msg = f"There is no {kind} called '{name}'.{did_you_mean(name, known())}"
                raise ValueError(msg)
            if given.count(name) > 1:
                msg = f"'{name}' is listed twice."
                raise ValueError(msg)
        return tuple(given)

    return BeforeValidator(names)


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
            msg = f"step_seconds = {self.step_seconds} does not divide a day of {SECONDS_A_DAY} s. Use 300, 600, 900, 1800, ..."
            raise ValueError(msg)
        return self

    @property
    def steps(self) -> int:
        """Number of control steps of the period."""
        return self.days * SECONDS_A_DAY // self.step_seconds


Override = tuple[str, float, str]
"""Name of a parameter, its value, and the unit of the value."""


def _sorted_overrides(given: object) -> tuple[Override, ...]:
    if not isinstance(given, Mapping):
        msg = 'It must be a table: [model.overrides] with lines such as hAir = { value = 5.7, unit = "m" }.'
        raise ValueError(msg)  # noqa: TRY004 -- see one_of
    overrides = []
    for name, entry in sorted(given.items()):
        if not isinstance(entry, Mapping) or set(entry) != {"value", "unit"} or not isinstance(entry["unit"], str):
            msg = f'Write {name} with its unit: {name} = {{ value = ..., unit = "..." }}.'
            raise ValueError(msg)
        if isinstance(entry["value"], bool) or not isinstance(entry["value"], int | float):
            msg = f"The value of {name} is {as_written(entry['value'])}, which is not a number."
            raise ValueError(msg)  # noqa: TRY004 -- see one_of
        overrides.append((name, float(entry["value"]), entry["unit"]))
    return tuple(overrides)


class ModelTable(Table):
    """``[model]``: the equations, the set of parameters, and single parameters that differ from the set."""

    variant: Annotated[str, one_of(words.MODEL_VARIANTS)] = Field(description="a variant of the equations")
    parameters: str = Field(min_length=1, description='the name of a parameter set in quotes, such as "benchmark"')
    overrides: Annotated[tuple[Override, ...], BeforeValidator(_sorted_overrides)] = Field(
        default=(), description="a table of parameters, each with value and unit"
    )


class InitialStateTable(Table):
    """``[initial_state]``: what stands in the greenhouse when the period starts."""

    kind: Annotated[str, one_of(words.INITIAL_STATES)] = Field(description="a start")
    air_temperature: Annotated[float, in_unit("degC")] = Field(
        ge=-20.0, le=50.0, description='a temperature of -20 to 50 degC: { value = 16.5, unit = "degC" }'
    )


def _set_or_list(given: object) -> str | tuple[str, ...]:
    if isinstance(given, str) and given:
        return given
    if isinstance(given, list | tuple) and given and all(isinstance(name, str) for name in given):
        if len(set(given)) < len(given):
            msg = "A parameter is listed twice."
            raise ValueError(msg)
        return tuple(given)
    msg = 'It must be the name of a set, such as "crop28", or a list of parameters, such as ["sla", "rgFruit"].'
    raise ValueError(msg)


class UncertaintyTable(Table):
    """``[uncertainty]``: which parameters are redrawn, how often and how widely."""

    distribution: Annotated[str, one_of(words.DISTRIBUTIONS)] = Field(description="a distribution")
    delta: float = Field(ge=0.0, lt=1.0, description="a fraction from 0 to below 1, such as 0.10 for 10 %")
    half_width_factor: float = Field(gt=0.0, le=1.0, description="a factor above 0, up to 1")
    parameters: Annotated[str | tuple[str, ...], BeforeValidator(_set_or_list)] = Field(
        description="a parameter set or a list of parameters"
    )
    redraw: Literal["step", "episode"] = Field(description='"step" or "episode"')

    @property
    def half_width(self) -> float:
        """Largest relative deviation of a parameter from its nominal value."""
        return self.delta * self.half_width_factor


def _listed(given: object) -> object:
    return tuple(given) if isinstance(given, list) else given


class ForecastTable(Table):
    """``[observation.forecast]``: how far ahead the weather is shown."""

    steps: int = Field(ge=1, le=2000, description="a whole number of steps, 1 to 2000")


class ObservationTable(Table):
    """``[observation]``: what an agent sees, and of which moment."""

    modules: Annotated[
        tuple[str, ...], list_of(words.OBSERVATION_MODULES.kind, "time", lambda: words.OBSERVATION_MODULES.names)
    ] = Field(description="a list of observation modules")
    timing: Literal["current", "published"] = Field(description='"current" or "published"')
    forecast: ForecastTable | None = None

    @model_validator(mode="after")
    def _forecast_is_granted_and_shown(self) -> Self:
        known = words.OBSERVATION_MODULES
        shown = [name for name in self.modules if name in known and known[name].is_forecast]
        if shown and self.forecast is None:
            msg = f"'{shown[0]}' is among the modules, so say how far it looks: add [observation.forecast] with steps = 48."
            raise ValueError(msg)
        if self.forecast is not None and not shown:
            msg = 'There is a table [observation.forecast], but no forecast among the modules: add "forecast" to them.'
            raise ValueError(msg)
        return self

    @property
    def forecast_steps(self) -> int:
        """Rows of coming weather that are shown; 0 without a forecast."""
        return self.forecast.steps if self.forecast is not None else 0

    @property
    def forecast_hours(self) -> tuple[int, ...]:
        """Hours ahead of a forecast by the hour; none without one."""
        return ()


class ActuationTable(Table):
    """``[actuation]``: how an action becomes a control. Controls that are not listed stay at 0."""

    kind: Annotated[str, one_of(words.ACTUATION_KINDS)] = Field(description="a kind of actuation")
    max_change: float = Field(gt=0.0, le=1.0, description="the largest change of a control in a step, above 0, up to 1")
    controls: Annotated[tuple[str, ...], list_of("control", "uVent")] = Field(description="a list of controls")


class Limits(Table):
    """Lowest and highest value allowed, in ``unit``."""

    low: float = Field(description="a number")
    high: float = Field(description="a number")
    unit: str = Field(description="the unit in quotes")

    @model_validator(mode="after")
    def _low_is_below_high(self) -> Self:
        if self.low >= self.high:
            msg = f"low = {self.low:g} must be below high = {self.high:g}."
            raise ValueError(msg)
        return self


def _limits_in(unit: str) -> BeforeValidator:
    def check(given: object) -> object:
        if isinstance(given, Mapping) and given.get("unit", unit) != unit:
            msg = f'Its unit is "{unit}", not {as_written(given["unit"])}: convert low and high and write that unit.'
            raise ValueError(msg)
        return given

    return BeforeValidator(check)


class OfTheAir(Table):
    """A table with an entry for limited quantities of the air."""

    def items(self) -> tuple[tuple[str, Any], ...]:
        """Names and entries that are there: air temperature, CO2, relative humidity."""
        entries = ((name, getattr(self, name)) for name in LIMITED)
        return tuple((name, entry) for name, entry in entries if entry is not None)


class ConstraintsTable(OfTheAir):
    """``[constraints]``: the climate to stay within, checked after every step."""

    air_temperature: Annotated[Limits, _limits_in(LIMITED["air_temperature"])]
    co2: Annotated[Limits, _limits_in(LIMITED["co2"])]
    relative_humidity: Annotated[Limits, _limits_in(LIMITED["relative_humidity"])]


class PricesTable(Table):
    """``[prices]``: what fruit is sold for and resources are bought for."""

    fruit: Annotated[float, in_unit("EUR kg-1")] = Field(ge=0.0, description="a price per kg of fresh fruit, 0 or more")
    dry_matter_content: Annotated[float, in_unit("kg kg-1")] = Field(
        gt=0.0, le=1.0, description="kg dry per kg fresh fruit, above 0, up to 1"
    )
    co2: Annotated[float, in_unit("EUR kg-1")] = Field(ge=0.0, description="a price per kg of CO2, 0 or more")
    heat: Annotated[float, in_unit("EUR kWh-1")] = Field(ge=0.0, description="a price per kWh of heat, 0 or more")
    electricity: Annotated[float, in_unit("EUR kWh-1")] = Field(
        ge=0.0, description="a price per kWh of electricity, 0 or more"
    )


class PenaltyScale(OfTheAir):
    """Violation that costs 1 per step, for each constraint."""

    air_temperature: Annotated[float, in_unit(LIMITED["air_temperature"])] = Field(gt=0.0, description="above 0 degC")
    co2: Annotated[float, in_unit(LIMITED["co2"])] = Field(gt=0.0, description="above 0 ppm")
    relative_humidity: Annotated[float, in_unit(LIMITED["relative_humidity"])] = Field(gt=0.0, description="above 0 %")


class RewardTable(Table):
    """``[reward]``: the sum of these modules is the reward of a step."""

    modules: Annotated[
        tuple[str, ...], list_of(words.REWARD_MODULES.kind, "epi", lambda: words.REWARD_MODULES.names)
    ] = Field(description="a list of reward modules")
    penalty_scale: PenaltyScale


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


def _profit_is_epi(given: object) -> object:
    return "epi" if given == "profit" else given


class EvaluationTable(Table):
    """``[evaluation]``: the seeds of the evaluation and the number that ranks."""

    first_seed: int = Field(ge=0, lt=2**32, description="a whole number, 0 or more")
    runs: int = Field(ge=1, le=10000, description="a whole number, 1 to 10000")
    metric: Annotated[str, one_of(words.METRICS), BeforeValidator(_profit_is_epi)] = Field(description="a metric")
    failed_step: FailedStep
    time_limits: TimeLimitsTable | None = None

    @property
    def seeds(self) -> range:
        """Seeds of the evaluation runs."""
        return range(self.first_seed, self.first_seed + self.runs)


def _text(given: object) -> object:
    """Text for people, which stands in terminals and on pages: without characters that steer them."""
    strange = next((letter for letter in given if not _can_be_shown(letter)), None) if isinstance(given, str) else None
    if strange is not None:
        msg = f"It holds the character U+{ord(strange):04X}, which cannot be shown. Take it out."
        raise ValueError(msg)
    return given


def _can_be_shown(letter: str) -> bool:
    return letter.isprintable() or letter in "\n\t" or unicodedata.category(letter) == "Zs"


def _one_line(given: object) -> object:
    if isinstance(given, str) and len(given.splitlines()) > 1:
        msg = "It must be one line."
        raise ValueError(msg)
    return _text(given)


def _suite_names(given: object) -> tuple[str, ...]:
    if not isinstance(given, list | tuple) or not all(isinstance(name, str) and name for name in given):
        msg = 'It must be a list of names, such as ["paper"].'
        raise ValueError(msg)
    return tuple(str(_one_line(name)) for name in given)


class TaskFile(Table):
    """What a task file says, as pure data. The tables of the file are fields of the same name; ``[initial_state]`` is ``initial``."""

    id: str = Field(
        pattern=r"^[A-Za-z0-9_-]+/[A-Za-z0-9_.-]+-v[1-9][0-9]*$",
        description='an id in quotes with a namespace and a version, such as "mylab/Winter2011-v1"',
    )
    title: Annotated[str, BeforeValidator(_one_line)] = Field(min_length=1, description="a title in quotes")
    description: Annotated[str, BeforeValidator(_text)] = Field(default="", description="text in quotes")
    suites: Annotated[tuple[str, ...], BeforeValidator(_suite_names)] = Field(default=(), description="a list of names")
    weather: WeatherTable
    actuation: ActuationTable
    evaluation: EvaluationTable


class TaskFile1(TaskFile):
    """Schema 1: the tomato greenhouse of the paper, one season, prices of four things."""

    schema_version: Literal[1] = Field(alias="schema", description="1 or 2")
    model: ModelTable
    initial: InitialStateTable = Field(alias="initial_state")
    uncertainty: UncertaintyTable
    observation: ObservationTable
    constraints: ConstraintsTable
    prices: PricesTable
    reward: RewardTable

    @model_validator(mode="after")
    def _has_no_computer(self) -> Self:
        if self.actuation.kind == PROCESS_COMPUTER:
            msg = "[actuation] A process computer needs a task of schema 2: add schema = 2 to a file with a base."
            raise ValueError(msg)
        return self


def _check_hours(hours: tuple[int, ...], longest: int) -> None:
    if any(not 1 <= hour <= longest for hour in hours) or any(later <= earlier for earlier, later in pairwise(hours)):
        msg = f"hours = {list(hours)} must be different whole hours from 1 to {longest}, the nearest first."
        raise ValueError(msg)


# Schema 2: any model, a ledger, a scenario. Everything with a default may be left out; what is left out stays out of the digest.


class PinnedModelTable(ModelTable):
    """``[model]``: which model, by name and version, its parameters, and single parameters that differ from the set."""

    id: str = Field(min_length=1, description='the id of a model in quotes, such as "greenlight-tomato-1.0.0"')
    variant: str = Field(default="author", min_length=1, description="a variant of the model, in quotes")
    parameters: str = Field(default="benchmark", min_length=1, description='a parameter set, such as "benchmark"')


class AnyInitialStateTable(InitialStateTable):
    """``[initial_state]``: one of the model's starts."""

    kind: str = Field(min_length=1, description="the name of a start in quotes")


class AnyForecastTable(Table):
    """``[observation.forecast]``: coming weather, as the rows that will come or as a forecast that errs."""

    steps: int | None = Field(default=None, ge=1, le=2000, description="a whole number of steps, 1 to 2000")
    hours: Annotated[tuple[int, ...], BeforeValidator(_listed)] = Field(
        default=(), description="a list of whole hours ahead, such as [1, 2, 3, 6, 12, 18, 24]"
    )
    error: Annotated[str, one_of(words.FORECAST_ERRORS)] = Field(
        default=PERFECT, description="how much the forecast errs"
    )

    @model_validator(mode="after")
    def _hours_rise(self) -> Self:
        _check_hours(self.hours, LONGEST_FORECAST)
        if self.error != PERFECT and not self.hours:
            msg = f'error = "{self.error}" belongs to a forecast by the hour: add hours = [1, 2, 3, 6, 12, 18, 24].'
            raise ValueError(msg)
        return self


class DayAheadTable(Table):
    """``[observation.day_ahead]``: of which prices the coming hours are shown, as far as they are known."""

    prices: Annotated[tuple[str, ...], list_of("price table", "power")] = Field(description="a list of price tables")
    hours: Annotated[tuple[int, ...], BeforeValidator(_listed)] = Field(
        min_length=1, description="a list of whole hours ahead, such as [1, 2, 3, 6, 12]"
    )

    @model_validator(mode="after")
    def _hours_rise(self) -> Self:
        _check_hours(self.hours, HOURS_A_DAY)
        return self


class AnyObservationTable(ObservationTable):
    """``[observation]``: modules that every model has, and the model's own."""

    modules: Annotated[tuple[str, ...], list_of(words.OBSERVATION_MODULES.kind, "time")] = Field(
        description="a list of observation modules"
    )
    forecast: AnyForecastTable | None = None  # type: ignore[assignment]
    day_ahead: DayAheadTable | None = None

    @model_validator(mode="after")
    def _forecast_is_granted_and_shown(self) -> Self:
        known, forecast = words.OBSERVATION_MODULES, self.forecast
        by_row = [name for name in self.modules if name in known and known[name].is_forecast]
        by_hour = [name for name in self.modules if name == words.WEATHER_FORECAST]
        for key, shown, example, module in (
            ("steps", by_row, "steps = 48", "forecast"),
            ("hours", by_hour, "hours = [1, 2, 3, 6, 12, 18, 24]", words.WEATHER_FORECAST),
        ):
            given = forecast is not None and bool(getattr(forecast, key))
            if shown and not given:
                msg = f"'{shown[0]}' is among the modules, so say how far it looks: add [observation.forecast] with {example}."
                raise ValueError(msg)
            if given and not shown:
                msg = f'[observation.forecast] has {key}, but no such forecast is among the modules: add "{module}" to them.'
                raise ValueError(msg)
        if forecast is not None and not by_row and not by_hour:
            msg = f'There is a table [observation.forecast], but no forecast among the modules: add "{words.WEATHER_FORECAST}" to them.'
            raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _day_ahead_is_granted_and_shown(self) -> Self:
        shown = words.DAY_AHEAD in self.modules
        if shown and self.day_ahead is None:
            msg = (
                f"'{words.DAY_AHEAD}' is among the modules, so say of which prices and how far ahead: add [observation.day_ahead] "
                'with prices = ["power"] and hours = [1, 2, 3, 6, 12].'
            )
            raise ValueError(msg)
        if self.day_ahead is not None and not shown:
            msg = f'There is a table [observation.day_ahead]: add "{words.DAY_AHEAD}" to the modules, or leave it out.'
            raise ValueError(msg)
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
    """A setting of the process computer: 0 or more, or more than ``above``; its meaning stands in docs/process-computer.md."""
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
            msg = (
                f"ventilation_band_most = {self.ventilation_band_most:g} K must not be below "
                f"ventilation_band = {self.ventilation_band:g} K."
            )
            raise ValueError(msg)
        if self.co2_vents >= self.co2_vents_off:
            msg = f"co2_vents = {self.co2_vents:g} must be below co2_vents_off = {self.co2_vents_off:g}."
            raise ValueError(msg)
        return self


class OnOffTable(Table):
    """``[actuation.on_off.<control>]``: a machine that is off or runs between ``lowest`` and 1, and stays on or off for a while."""

    lowest: float = Field(gt=0.0, le=1.0, description="a fraction above 0, up to 1")
    hold_minutes: float = Field(default=0.0, ge=0.0, le=1440.0, description="a number of minutes, 0 to 1440")


class AnyActuationTable(ActuationTable):
    """``[actuation]``: as in schema 1, and the settings of a process computer, and machines that are switched."""

    process_computer: ProcessComputerTable = ProcessComputerTable()
    on_off: dict[str, OnOffTable] = Field(default={}, description="tables [actuation.on_off.<control>]")

    @model_validator(mode="after")
    def _settings_are_used(self) -> Self:
        if "process_computer" in self.model_fields_set and self.kind != PROCESS_COMPUTER:
            msg = f'There is a table [actuation.process_computer], but the kind is "{self.kind}". Take one of them out.'
            raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _machines_can_be_switched(self) -> Self:
        if self.on_off and self.kind not in SWITCHING:
            msg = f'There are tables [actuation.on_off], but the kind is "{self.kind}". It must be {" or ".join(SWITCHING)}.'
            raise ValueError(msg)
        for name in self.on_off:
            if name not in self.controls:
                msg = f"[actuation.on_off.{name}] is about a control that the task does not grant.{did_you_mean(name, self.controls)}"
                raise ValueError(msg)
        return self


class SomeConstraintsTable(OfTheAir):
    """``[constraints]``: some limits of the air, or none."""

    judged: Literal["end", "mean"] = Field(default="end", description='"end" or "mean"')
    air_temperature: Annotated[Limits | None, _limits_in(LIMITED["air_temperature"])] = None
    co2: Annotated[Limits | None, _limits_in(LIMITED["co2"])] = None
    relative_humidity: Annotated[Limits | None, _limits_in(LIMITED["relative_humidity"])] = None


class SomePenaltyScales(OfTheAir):
    """Violation that costs 1 per step, for each constraint."""

    air_temperature: Annotated[float | None, in_unit(LIMITED["air_temperature"])] = Field(
        default=None, gt=0.0, description="above 0 degC"
    )
    co2: Annotated[float | None, in_unit(LIMITED["co2"])] = Field(default=None, gt=0.0, description="above 0 ppm")
    relative_humidity: Annotated[float | None, in_unit(LIMITED["relative_humidity"])] = Field(
        default=None, gt=0.0, description="above 0 %"
    )


class ViolationPrices(OfTheAir):
    """What a violation costs for every unit beyond the limit and every hour."""

    air_temperature: Annotated[float | None, in_unit(VIOLATION_PRICES["air_temperature"])] = Field(
        default=None, gt=0.0, description="a price above 0"
    )
    co2: Annotated[float | None, in_unit(VIOLATION_PRICES["co2"])] = Field(
        default=None, gt=0.0, description="a price above 0"
    )
    relative_humidity: Annotated[float | None, in_unit(VIOLATION_PRICES["relative_humidity"])] = Field(
        default=None, gt=0.0, description="a price above 0"
    )


class ProfitScale(Limits):
    """The profit of a step that counts as 0 and that which counts as 1 in ``scaled_epi``."""


class AnyRewardTable(Table):
    """``[reward]``: the sum of these modules is the reward of a step."""

    modules: Annotated[
        tuple[str, ...], list_of(words.REWARD_MODULES.kind, "epi", lambda: words.REWARD_MODULES.names)
    ] = Field(description="a list of reward modules")
    penalty_scale: SomePenaltyScales = SomePenaltyScales()
    violation_price: ViolationPrices = ViolationPrices()
    epi_scale: Annotated[ProfitScale | None, _limits_in("EUR m-2")] = None


class BeyondTable(Table):
    """``[ledger.<column>.beyond]``: what the rest costs when more than an amount has flowed since the start."""

    amount: float = Field(gt=0.0, description='above 0, as in { value = 12.0, unit = "kg m-2" }')
    amount_unit: str = Field(default="", exclude=True)
    price: float = Field(description='{ value = 0.20, unit = "EUR kg-1" }')
    price_unit: str = Field(default="", exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _with_units(cls, given: object) -> object:
        if not isinstance(given, Mapping):
            return given
        read = dict(given)
        for key in ("amount", "price"):
            entry = given.get(key)
            if not isinstance(entry, Mapping) or set(entry) != {"value", "unit"} or not isinstance(entry["unit"], str):
                msg = (
                    'Write amount and price with their units: beyond = { amount = { value = 12.0, unit = "kg m-2" }, '
                    'price = { value = 0.20, unit = "EUR kg-1" } }.'
                )
                raise ValueError(msg)
            read |= {key: entry["value"], f"{key}_unit": entry["unit"]}
        return read


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
    def _price_with_unit(cls, given: object) -> object:
        if not isinstance(given, Mapping) or "price" not in given:
            return given
        price = given["price"]
        text = price.get("value") if isinstance(price, Mapping) else price
        if isinstance(text, str) and _NUMBER.fullmatch(text.strip()):
            plain = text.strip().replace(",", ".")
            msg = f'price is "{text}": a number is written without quotes, price = {{ value = {plain}, unit = "EUR kWh-1" }}.'
            raise ValueError(msg)
        if isinstance(price, str):
            return given
        if not isinstance(price, Mapping) or set(price) != {"value", "unit"} or not isinstance(price["unit"], str):
            msg = 'Write the price with its unit, price = { value = 0.09, unit = "EUR kWh-1" }, or name a price table.'
            raise ValueError(msg)
        return {**given, "price": price["value"], "price_unit": price["unit"]}

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.flow is None) == (self.stock is None):
            msg = 'It must name either a flow or a stock: flow = "heat", or stock = "fruit".'
            raise ValueError(msg)
        if self.factor != 1.0 and (self.amount is None or self.unit is None):
            msg = (
                "With a factor the amount is another one than the flow: name it, and its unit: amount = ..., unit = ..."
            )
            raise ValueError(msg)
        return self


class SeriesPoint(Table):
    """A price from a moment on."""

    time: dt.datetime = Field(description="a moment")
    price: float = Field(description="a number")


_DAY = re.compile(r"(\d\d)-(\d\d)")


def _hours_of_a_day(shares: tuple[float, ...]) -> tuple[float, ...]:
    if len(shares) != HOURS_A_DAY:
        msg = f"There must be {HOURS_A_DAY} numbers, one an hour; there are {len(shares)}."
        raise ValueError(msg)
    return shares


class MarketTable(Table):
    """``[price_tables.<name>.market]``: prices by the hour like those of a power market; ``glbench.tasks.prices`` has the formula."""

    level: float = Field(gt=0.0, description="a price above 0, in the unit of the table")
    shape: Annotated[tuple[float, ...], BeforeValidator(_listed), AfterValidator(_hours_of_a_day)] | None = Field(
        default=None, description="24 shares of the level, one an hour"
    )
    weekend: float = Field(ge=-1.0, le=1.0, description="a share of the level, -1 to 1")
    sun: float = Field(ge=0.0, le=10.0, description="a share of the level, 0 to 10")
    wind: float = Field(ge=0.0, le=10.0, description="a share of the level, 0 to 10")
    spread: float = Field(ge=0.0, le=10.0, description="a share of the level, 0 to 10")
    persistence: float = Field(ge=0.0, lt=1.0, description="a fraction from 0 to below 1")
    lowest: float = Field(description="a price, in the unit of the table")
    highest: float = Field(description="a price, in the unit of the table")

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> Self:
        if self.lowest >= self.highest:
            msg = f"lowest = {self.lowest:g} must be below highest = {self.highest:g}."
            raise ValueError(msg)
        return self

    def value(self) -> Market:
        """The market."""
        return Market(**{**self.model_dump(), "shape": self.shape or SHAPE})


class PriceTableTable(Table):
    """``[price_tables.<name>]``: a price that changes with time, in one of several ways."""

    unit: str = Field(min_length=1, description='the unit in quotes, such as "EUR kWh-1"')
    hourly: tuple[float, ...] | None = Field(default=None, description="24 numbers, one an hour")
    from_day: dict[str, float] | None = Field(default=None, description='prices by day, such as { "01-15" = 3.5 }')
    series: tuple[SeriesPoint, ...] | None = Field(default=None, description="a list of { time = ..., price = ... }")
    yearly: bool = Field(default=False, description="true or false")
    market: MarketTable | None = Field(default=None, description="a table [price_tables.<name>.market]")
    of: str | None = Field(default=None, min_length=1, description="the name of another price table, in quotes")
    times: float = Field(default=1.0, description="a factor")
    plus: float = Field(default=0.0, description="a price, in the unit of the table")

    @model_validator(mode="before")
    @classmethod
    def _lists(cls, given: object) -> object:
        if isinstance(given, Mapping):
            return {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}
        return given

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = (self.hourly, self.from_day, self.series, self.market, self.of)
        if sum(way is not None for way in ways) != 1:
            msg = (
                "It must have exactly one of hourly (24 prices), from_day (prices by day), series (or file), market (prices by "
                "sun and wind) and of (another table)."
            )
            raise ValueError(msg)
        if self.yearly and self.series is None:
            msg = "yearly = true belongs to a series, which then holds for every year. Leave it out."
            raise ValueError(msg)
        if self.hourly is not None and len(self.hourly) != 24:
            msg = f"hourly must have 24 prices, one an hour; it has {len(self.hourly)}."
            raise ValueError(msg)
        for day in self.from_day or ():
            _month_and_day(day)
        if self.from_day is not None and not self.from_day:
            msg = 'from_day must have a price: from_day = { "01-15" = 3.5 }.'
            raise ValueError(msg)
        if self.series is not None:
            moments = [point.time for point in self.series]
            if not moments or any(later <= earlier for earlier, later in pairwise(moments)):
                msg = "series must have moments, each later than the one before."
                raise ValueError(msg)
            if self.yearly and _utc(moments[0]).year != _utc(moments[-1]).year:
                msg = (
                    f"With yearly = true the series must be in one calendar year (UTC); it goes from {moments[0]:%Y-%m-%d} to "
                    f"{moments[-1]:%Y-%m-%d}. Keep one year of it."
                )
                raise ValueError(msg)
        return self

    def value(self, others: Mapping[str, PriceTableTable]) -> PriceTable:
        """The prices; ``others`` are the tables that this one may follow."""
        if self.of is not None:
            return others[self.of].value(others).following(self.of, unit=self.unit, times=self.times, plus=self.plus)
        return PriceTable(
            self.unit,
            self.hourly or (),
            tuple((*_month_and_day(day), price) for day, price in sorted((self.from_day or {}).items())),
            tuple((_utc(point.time), point.price) for point in self.series or ()),
            self.yearly,
            None if self.market is None else self.market.value(),
            times=self.times,
            plus=self.plus,
        )


def _utc(moment: dt.datetime) -> dt.datetime:
    return moment if moment.tzinfo is None else moment.astimezone(dt.UTC)


def _month_and_day(text: str) -> tuple[int, int]:
    found = _DAY.fullmatch(text)
    month, day = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= month <= 12 or not 1 <= day <= monthrange(2000, month)[1]:
        msg = f"'{text}' is not a day of the year. Write month and day with two digits each, such as \"01-15\"."
        raise ValueError(msg)
    return month, day


class SeasonTable(Table):
    """A season that a run may be in."""

    start: dt.date = Field(
        ge=dt.date(1900, 1, 1), lt=dt.date(2200, 1, 1), description="a first day, such as 2010-03-01"
    )
    source: str | None = Field(
        default=None, min_length=1, description="a weather record, in quotes; that of [weather] if none is named"
    )


class DrawTable(Table):
    """What parameters and start states that are drawn have in common."""

    name: str = Field(default="", description="a name in quotes")
    distribution: Annotated[str, one_of(words.DISTRIBUTIONS)] = Field(default="uniform", description="a distribution")
    half_width: float = Field(ge=0.0, lt=1.0, description="a fraction from 0 to below 1, such as 0.10 for 10 %")


class ParameterGroupTable(DrawTable):
    """``[[scenario.parameters]]``: parameters that are drawn."""

    parameters: Annotated[str | tuple[str, ...], BeforeValidator(_set_or_list)] = Field(
        description="a parameter set or a list of parameters"
    )
    redraw: Literal["step", "day", "episode"] = Field(description='"step", "day" or "episode"')


class StartGroupTable(DrawTable):
    """``[[scenario.start]]``: states that are multiplied by a factor at the start of a run."""

    states: Annotated[tuple[str, ...], list_of("state", "cFruit")] = Field(description="a list of states")


class SplitTable(Table):
    """``[splits.<name>]``: the years from which seasons are drawn, and how many there are."""

    years: Annotated[tuple[int, ...], BeforeValidator(_listed)] = Field(description="a list of years")
    seasons: int | None = Field(default=None, ge=1, le=MOST_SEASONS, description=f"a whole number, 1 to {MOST_SEASONS}")

    @model_validator(mode="after")
    def _different_years(self) -> Self:
        if (
            not self.years
            or len(set(self.years)) < len(self.years)
            or not all(1 <= year <= 9999 for year in self.years)
        ):
            msg = "years must be different years, at least one, each of which the weather record has."
            raise ValueError(msg)
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
                msg = f"{name} and test share the year {shared[0]}: no season that scores may be seen before."
                raise ValueError(msg)
        return self


class SensorTable(Table):
    """``[sensors.<quantity>]``: how far a sensor is off; what is 0 may be left out."""

    noise: float = Field(default=0.0, ge=0.0, description="0 or more")
    bias: float = Field(default=0.0, ge=0.0, description="0 or more")
    drift: float = Field(default=0.0, ge=0.0, description="0 or more")


def _sensor_in(unit: str) -> BeforeValidator:
    """Read the numbers of a sensor, each with its unit."""
    read = in_unit(unit).func

    def value_of(key: str, given: object) -> object:
        try:
            return read(given) if key in SensorTable.model_fields else given  # type: ignore[call-arg]
        except ValueError as error:
            msg = f"{key} = {as_written(given)}: {error}"
            raise ValueError(msg) from None

    def values_of(given: object) -> object:
        return {key: value_of(key, value) for key, value in given.items()} if isinstance(given, Mapping) else given

    return BeforeValidator(values_of)


class DropoutsTable(Table):
    """``[sensors.dropouts]``: how often a sensor hangs at its last value, and for how long; both are means."""

    days_between: float = Field(gt=0.0, le=3660.0, description="a number of days above 0")
    hours: float = Field(gt=0.0, le=240.0, description="a number of hours above 0, up to 240")


class SensorsTable(OfTheAir):
    """``[sensors]``: sensors of the air inside that err. What is judged is the truth."""

    air_temperature: Annotated[SensorTable | None, _sensor_in(LIMITED["air_temperature"])] = None
    co2: Annotated[SensorTable | None, _sensor_in(LIMITED["co2"])] = None
    relative_humidity: Annotated[SensorTable | None, _sensor_in(LIMITED["relative_humidity"])] = None
    dropouts: DropoutsTable | None = None

    @model_validator(mode="after")
    def _something_drops_out(self) -> Self:
        if self.dropouts is not None and not self.items():
            msg = "There are [sensors.dropouts], but no sensor that could drop out: add [sensors.air_temperature]."
            raise ValueError(msg)
        return self


class ScenarioTable(Table):
    """``[scenario]``: what a run draws. Tasks of one family and salt share their random numbers."""

    family: Annotated[str, BeforeValidator(_one_line)] = Field(min_length=1, description="a name in quotes")
    salt: Annotated[str, BeforeValidator(_one_line)] = Field(default="", description="text in quotes")
    seasons: Annotated[tuple[SeasonTable, ...], BeforeValidator(_listed)] = Field(
        default=(), description='a list of { start = 2010-03-01, source = "schiphol" }'
    )
    years: Annotated[tuple[int, ...], BeforeValidator(_listed)] = Field(default=(), description="a list of years")
    start_within_days: int = Field(default=0, ge=0, le=366, description="a whole number of days, 0 to 366")
    generated: bool = Field(default=False, description="true or false")
    co2_range: Annotated[Limits | None, _limits_in("ppm")] = None
    parameters: Annotated[tuple[ParameterGroupTable, ...], BeforeValidator(_listed)] = Field(
        default=(), description="tables [[scenario.parameters]]"
    )
    start: Annotated[tuple[StartGroupTable, ...], BeforeValidator(_listed)] = Field(
        default=(), description="tables [[scenario.start]]"
    )

    @model_validator(mode="after")
    def _one_list_of_seasons(self) -> Self:
        if self.seasons and self.years:
            msg = (
                "It has both seasons and years: years are seasons that start on the day of [weather]. Keep one of them."
            )
            raise ValueError(msg)
        if len(set(self.years)) < len(self.years) or not all(1 <= year <= 9999 for year in self.years):
            msg = "years must be different years, each of which the weather record has."
            raise ValueError(msg)
        for groups in (self.parameters, self.start):
            names = [group.name or str(place) for place, group in enumerate(groups)]
            if len(set(names)) < len(names):
                msg = "Two groups have the same name: a stream of random numbers is called after it."
                raise ValueError(msg)
        return self


class TaskFile2(TaskFile):
    """Schema 2: any model, a ledger, a scenario for every run."""

    schema_version: Literal[2] = Field(alias="schema", description="1 or 2")
    model: PinnedModelTable
    initial: AnyInitialStateTable = Field(alias="initial_state")
    observation: AnyObservationTable
    actuation: AnyActuationTable
    constraints: SomeConstraintsTable = SomeConstraintsTable()
    ledger: dict[str, ItemTable] = Field(default={}, description="tables [ledger.<column>]")
    price_tables: dict[str, PriceTableTable] = Field(default={}, description="tables [price_tables.<name>]")
    scenario: ScenarioTable
    splits: SplitsTable | None = None
    sensors: SensorsTable | None = None
    reward: AnyRewardTable

    _written: Mapping[str, Any] | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _prices_follow_each_other(self) -> Self:
        for name, table in self.price_tables.items():
            if table.of is None:
                continue
            followed = self.price_tables.get(table.of)
            if followed is None:
                msg = f"[price_tables.{name}] of = '{table.of}': there is no such table.{did_you_mean(table.of, self.price_tables)}"
                raise ValueError(msg)
            if followed.of is not None:
                msg = f"[price_tables.{name}] of = '{table.of}', which follows '{followed.of}' itself. Name that one."
                raise ValueError(msg)
            if followed.unit != table.unit:
                msg = (
                    f"[price_tables.{name}] is in {table.unit}, and '{table.of}', which it follows, in {followed.unit}."
                )
                raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _day_ahead_prices_are_there(self) -> Self:
        shown = self.observation.day_ahead
        for name in shown.prices if shown is not None else ():
            if name not in self.price_tables:
                msg = f"[observation.day_ahead] prices: there is no price table '{name}'.{did_you_mean(name, self.price_tables)}"
                raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _seasons_are_told_once(self) -> Self:
        scenario, splits = self.scenario, self.splits
        if splits is not None and (scenario.seasons or scenario.years):
            msg = "[scenario] has seasons or years, and [splits] has years too. Keep those of [splits]."
            raise ValueError(msg)
        if scenario.generated and splits is None:
            msg = "[scenario] generated = true needs [splits]: which years seasons are made of, for training and for the test."
            raise ValueError(msg)
        if scenario.co2_range is not None and not scenario.generated:
            msg = "[scenario.co2_range] goes with generated seasons: add generated = true, or leave it out."
            raise ValueError(msg)
        for name in splits.names if splits is not None else ():
            if (getattr(splits, name).seasons is None) is scenario.generated:
                msg = (
                    f"[splits.{name}] must say how many seasons are generated: seasons = 100."
                    if scenario.generated
                    else f"[splits.{name}] has a number of seasons, but they are not generated: add generated = true to [scenario]."
                )
                raise ValueError(msg)
        return self

    @model_validator(mode="after")
    def _violations_cost_something(self) -> Self:
        scales, prices = (dict(table.items()) for table in (self.reward.penalty_scale, self.reward.violation_price))
        if scales and prices:
            msg = (
                f"[reward.penalty_scale] has {_first(scales)} and [reward.violation_price] has {_first(prices)}: violations cost "
                "points or money, not both. Keep one of the tables."
            )
            raise ValueError(msg)
        if self.constraints.judged == "mean" and not self.constraints.items():
            msg = '[constraints] has judged = "mean" and no limit to judge by. Add one, or leave judged out.'
            raise ValueError(msg)
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
            msg += "."
            raise ValueError(msg)
        return self


def _first(entries: Mapping[str, object]) -> str:
    return next(iter(entries))
