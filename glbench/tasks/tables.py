"""The tables of a task file, one frozen record each.

Keys carry their unit in their name (``step_seconds``), are plain fractions, or are written ``{ value = 16.5, unit =
"degC" }``; a wrong unit is refused. The description of a field is what an error message says is allowed.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from glbench.errors import did_you_mean
from glbench.tasks import vocabulary as words
from glbench.tasks.bases import as_written
from glbench.tasks.quantities import CONTROLS, LIMITED

SECONDS_A_DAY = 86400


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


def list_of(kind: str, known: Callable[[], tuple[str, ...]]) -> BeforeValidator:
    """Accept a list of different names out of ``known()``, at least one."""

    def names(given: object) -> tuple[str, ...]:
        if not isinstance(given, list | tuple) or not given or not all(isinstance(name, str) for name in given):
            msg = f'It must be a list of names of {kind}s, such as ["{known()[0]}"].'
            raise ValueError(msg)
        for name in given:
            if name not in known():
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
    """``[uncertainty]``: which parameters are drawn anew, how often and how widely."""

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


class ForecastTable(Table):
    """``[observation.forecast]``: how far ahead the weather is shown."""

    steps: int = Field(ge=1, le=2000, description="a whole number of steps, 1 to 2000")


class ObservationTable(Table):
    """``[observation]``: what an agent sees, and of which moment."""

    modules: Annotated[
        tuple[str, ...], list_of(words.OBSERVATION_MODULES.kind, lambda: words.OBSERVATION_MODULES.names)
    ] = Field(description="a list of observation modules")
    timing: Literal["current", "published"] = Field(description='"current" or "published"')
    forecast: ForecastTable | None = None

    @model_validator(mode="after")
    def _forecast_is_granted_and_shown(self) -> Self:
        shown = [name for name in self.modules if words.OBSERVATION_MODULES[name].is_forecast]
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


class ActuationTable(Table):
    """``[actuation]``: how an action becomes a control. Controls that are not listed stay at 0."""

    kind: Annotated[str, one_of(words.ACTUATION_KINDS)] = Field(description="a kind of actuation")
    max_change: float = Field(gt=0.0, le=1.0, description="the largest change of a control in a step, above 0, up to 1")
    controls: Annotated[tuple[str, ...], list_of("control", lambda: CONTROLS)] = Field(description="a list of controls")


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


class ConstraintsTable(Table):
    """``[constraints]``: the climate to stay within, checked after every step."""

    air_temperature: Annotated[Limits, _limits_in(LIMITED["air_temperature"])]
    co2: Annotated[Limits, _limits_in(LIMITED["co2"])]
    relative_humidity: Annotated[Limits, _limits_in(LIMITED["relative_humidity"])]

    def items(self) -> tuple[tuple[str, Limits], ...]:
        """Names and limits, in the order of the file's definition: air temperature, CO2, relative humidity."""
        return tuple((name, getattr(self, name)) for name in LIMITED)


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


class PenaltyScale(Table):
    """Violation that costs 1 per step, for each constraint."""

    air_temperature: Annotated[float, in_unit(LIMITED["air_temperature"])] = Field(gt=0.0, description="above 0 degC")
    co2: Annotated[float, in_unit(LIMITED["co2"])] = Field(gt=0.0, description="above 0 ppm")
    relative_humidity: Annotated[float, in_unit(LIMITED["relative_humidity"])] = Field(gt=0.0, description="above 0 %")

    def items(self) -> tuple[tuple[str, float], ...]:
        """Names and scales, in the order of the constraints."""
        return tuple((name, getattr(self, name)) for name in LIMITED)


class RewardTable(Table):
    """``[reward]``: the sum of these modules is the reward of a step."""

    modules: Annotated[tuple[str, ...], list_of(words.REWARD_MODULES.kind, lambda: words.REWARD_MODULES.names)] = Field(
        description="a list of reward modules"
    )
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


class EvaluationTable(Table):
    """``[evaluation]``: the seeds of the evaluation and the number that ranks."""

    first_seed: int = Field(ge=0, lt=2**32, description="a whole number, 0 or more")
    runs: int = Field(ge=1, le=10000, description="a whole number, 1 to 10000")
    metric: Annotated[str, one_of(words.METRICS)] = Field(description="a metric")
    failed_step: FailedStep
    time_limits: TimeLimitsTable | None = None

    @property
    def seeds(self) -> range:
        """Seeds of the evaluation runs."""
        return range(self.first_seed, self.first_seed + self.runs)
