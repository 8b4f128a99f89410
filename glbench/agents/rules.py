"""The rules of the rule-based baselines: what a grower's climate computer would ask for, from what it measures; and two controllers.

Every rule is written once, for the published controller (which knows the true state and the coming sun) and for its fair twin
(which has observations and estimates). All functions work element by element on arrays of shape (n,), one value a run, so that
a run gets the same bits alone and in a batch.

Source: the published rule-based controller of the benchmark, after the GreenLight author's definition (Katzin, 2021). The two
disagree in two rules, see ``RuleSettings.thermal_screen_rule`` and ``RuleSettings.lamp_rule``.

The settings are read from a YAML file, the whole truth: no defaults here, so that what a controller does stands in one place.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal

import numpy as np
from pydantic import AfterValidator, Field

from glbench.agents.controllers import CLOCK, ObservedController, clock_from, controller
from glbench.agents.daylight import Daylight, DaylightEstimator
from glbench.arrays import Floats
from glbench.errors import ShapeError, SubmissionError, refuse
from glbench.model import TOMATO, co2_ppm, relative_humidity
from glbench.settings import Table, read_settings
from glbench.tasks import set_points

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Shared = Any  # An array (n,), or one ``float`` for all runs

_LOG_100 = math.log(100.0)

_Hour = Annotated[float, Field(ge=0.0, le=24.0)]
_Radiation = Annotated[float, Field(ge=0.0)]
_Heating = Annotated[float, set_points.set_point_field(set_points.HEATING)]
_Outdoors = Annotated[float, set_points.set_point_field(set_points.SCREEN_OUTDOOR)]


def _with_width(band: float) -> float:
    if band == 0.0:
        refuse("a proportional band of width 0 would be a division by zero; a narrow one such as 0.1 acts like a switch")
    return band


_Band = Annotated[float, AfterValidator(_with_width)]


class RuleSettings(Table):
    """Numbers of the rules; ``baselines/rule_based/rule_based.yml`` explains each, with its name in the publication.

    Temperatures [degC], temperature differences [K], humidity [%], CO2 [ppm], hours [h], days [day], radiation [W m-2],
    radiation sums [MJ m-2 d-1].
    """

    lamps_on: _Hour
    lamps_off: _Hour
    lamp_season_start: float
    lamp_season_end: float
    lamps_off_radiation: _Radiation
    lamps_off_day_sum: _Radiation
    lamp_extra_heat: float
    lamp_heat_band: _Band
    heating_day: _Heating
    heating_night: _Heating
    heating_lamp_shift: float
    heating_dead_zone: float
    heating_band: _Band
    co2_day: Annotated[float, set_points.set_point_field(set_points.CO2)]
    co2_band: _Band
    humidity_limit: float = Field(ge=0.0, le=100.0, json_schema_extra={"unit": "%"})
    vent_heat_band: _Band
    vent_humidity_band: _Band
    vent_cold_offset: float
    vent_cold_band: _Band
    screen_day: _Outdoors
    screen_night: _Outdoors
    screen_cold_band: _Band
    screen_dead_zone: float
    screen_humidity_offset: float
    screen_humidity_band: _Band
    blackout_screen: bool
    blackout_extra_humidity: float
    blackout_humidity_band: _Band
    thermal_screen_rule: Literal["code", "author"]
    """When the thermal screen opens: "code", when heat and humidity both ask for it; "author", when either does."""
    lamp_rule: Literal["code", "author"]
    """When humidity may switch lamps off: "code", at any hour; "author", only while the blackout screen is closed."""


def read_rule_settings(path: Path) -> RuleSettings:
    """Settings in a YAML file. Raises ``SubmissionError`` when it is missing or no mapping, lacks a setting, or has a wrong one."""
    return read_settings(RuleSettings, path, "the rule settings")


@dataclass(frozen=True)
class RuleInputs:
    """What the rules look at, at the start of a control step: float64 arrays of shape (n,), one value a run.

    What is outside may also be one number for all runs: the rules then follow from it for all runs at once, with the same bits.
    """

    air_temperature: Floats
    """Air below the screens [degC]."""
    relative_humidity: Floats
    """Relative humidity of that air [%]."""
    co2: Floats
    """CO2 of that air [ppm]."""
    radiation: Shared
    """Global radiation outside [W m-2]."""
    outdoor_temperature: Shared
    """Air outside [degC]."""
    day_radiation_sum: Shared
    """Radiation sum of the calendar day, the hours to come included [MJ m-2 d-1]."""
    is_day: Shared
    """1 by day, 0 by night, linear within dusk and dawn [-]."""
    is_day_smooth: Shared
    """The same with sigmoid dusk and dawn [-]."""
    hour_of_day: Shared
    """Clock [h], from 0 to below 24."""
    day_of_year: Shared
    """Day of the year [day], 0 at 1 January 00:00."""


def smooth_action(above: Floats, steepness: Any, half_band: Any, low: Any, span: Any) -> Floats:
    """Sigmoid of ``above``, a value minus its set point: ``low`` plus 1 % of ``span`` at 0, plus 99 % at the end of the band."""
    z = steepness * (above - half_band)
    # exp only ever sees numbers that are not positive, so no distance from the set point overflows.
    decay = np.exp(-np.abs(z))
    share = np.where(z >= 0.0, 1.0, decay) / (1.0 + decay)
    action: Floats = low + span * share
    return action


def within(start: float, stop: float, value: Shared) -> Shared:
    """1 where ``value`` lies strictly between ``start`` and ``stop``, else 0; over the turn of day or year when start > stop."""
    return ((start < value) & (value < stop) if start <= stop else (start < value) | (value < stop)) * 1.0


def _larger(a: Shared, b: Shared) -> Shared:
    return max(a, b) if isinstance(a, float) and isinstance(b, float) else np.maximum(a, b)


def _smaller(a: Shared, b: Shared) -> Shared:
    return min(a, b) if isinstance(a, float) and isinstance(b, float) else np.minimum(a, b)


def rule_controls(inputs: RuleInputs, settings: RuleSettings) -> Floats:
    """Boiler, CO2 dosing, thermal screen, vents, lamps, blackout screen as the rules ask for: shares of capacity, 0 to 1, ``(n, 6)``."""
    return Rules(settings).controls(inputs)


class Rules:
    """The rules with their settings, for a controller that is asked at every step."""

    def __init__(self, settings: RuleSettings) -> None:
        self.settings = settings
        s = settings
        # Of each share in ``controls``: band, and the action below and above it.
        bands = (
            (s.heating_band, 0.0, 1.0),
            (s.co2_band, 0.0, 1.0),
            (s.vent_cold_band, 1.0, 0.0),
            (s.vent_heat_band, 0.0, 1.0),
            (s.vent_humidity_band, 0.0, 1.0),
            (s.screen_cold_band, 0.0, 1.0),
            (-s.screen_cold_band, 1.0, 0.0),
            (s.screen_humidity_band, 1.0, 0.0),
            (s.lamp_heat_band, 0.0, 1.0),
            (s.blackout_humidity_band, 0.0, 1.0),
        )
        self._steepness, self._half_band, self._low, self._span = (
            np.array(column)[:, None]
            for column in zip(*((2.0 / b * _LOG_100, b / 2.0, low, high - low) for b, low, high in bands), strict=True)
        )

    def controls(self, inputs: RuleInputs) -> Floats:
        """Controls (n, 6) that the rules ask for, as ``rule_controls`` gives them."""
        s, air, humidity = self.settings, inputs.air_temperature, inputs.relative_humidity
        lamps_by_clock, heating, co2 = self._set_points(inputs)
        too_warm = heating + s.heating_dead_zone  # heat must leave
        screen = inputs.is_day * s.screen_day + (1.0 - inputs.is_day) * s.screen_night
        # How far each rule wants to go, from one side of its band to the other. All at once: numpy takes as long for one as for ten.
        above = np.empty((len(self._span), len(air)))
        np.subtract(air, heating, out=above[0])
        np.subtract(inputs.co2, co2, out=above[1])
        np.subtract(air, heating - s.vent_cold_offset, out=above[2])
        np.subtract(air, too_warm, out=above[3])
        np.subtract(humidity, s.humidity_limit, out=above[4])
        np.subtract(inputs.outdoor_temperature, screen, out=above[5])
        np.subtract(air, heating + s.screen_dead_zone, out=above[6])
        np.subtract(humidity, s.humidity_limit + s.screen_humidity_offset, out=above[7])
        np.subtract(air, too_warm + s.lamp_extra_heat, out=above[8])
        np.subtract(humidity, s.humidity_limit + s.blackout_extra_humidity, out=above[9])
        shares = smooth_action(above, self._steepness, self._half_band, self._low, self._span)
        boiler, dosing, not_cold, vents_heat, vents_humidity, screen_cold, screen_heat, screen_humidity, *rest = shares
        lamps_heat, lamps_humidity = rest

        not_humid = np.maximum(lamps_humidity, 1.0 - not_cold)
        if s.lamp_rule == "author":
            # By day the blackout screen is open, and humidity is no reason; the published code lost this by operator precedence.
            not_humid = inputs.is_day_smooth + (1.0 - inputs.is_day_smooth) * not_humid
        lamps: Floats = lamps_by_clock * lamps_heat * not_humid
        for_humidity = np.maximum(screen_humidity, 1.0 - not_cold)
        # Erratum of the published code: "opened for heat or humidity" became max, so only heat *and* humidity open the screen.
        keep_closed = np.maximum if s.thermal_screen_rule == "code" else np.minimum
        controls = np.empty((len(lamps), 6))
        controls[:, 0] = boiler
        controls[:, 1] = dosing
        controls[:, 2] = np.minimum(screen_cold, keep_closed(screen_heat, for_humidity))
        controls[:, 3] = np.minimum(not_cold, np.maximum(vents_heat, vents_humidity))
        controls[:, 4] = lamps
        controls[:, 5] = (1.0 - inputs.is_day_smooth) * lamps if s.blackout_screen else 0.0
        return controls

    def _set_points(self, inputs: RuleInputs) -> tuple[Shared, Shared, Shared]:
        """What follows from what is outside: 1 when clock, season and radiation call for lamps, heating [degC], CO2 [ppm]."""
        s, hour = self.settings, inputs.hour_of_day
        dim_day = (inputs.day_radiation_sum < s.lamps_off_day_sum) * 1.0
        in_season = within(s.lamp_season_start, s.lamp_season_end, inputs.day_of_year)
        dim_now = (inputs.radiation < s.lamps_off_radiation) * 1.0
        in_hours = within(s.lamps_on, s.lamps_off, hour)
        lamps = dim_now * dim_day * in_hours * in_season

        # The climate of the lamp hours fades in and out within an hour and, unlike the lamps, does not mind a sunny moment.
        if s.lamps_on == s.lamps_off:
            ramp = hour * 0.0
        else:
            rising = _smaller(_larger(hour - s.lamps_on + 1.0, 0.0), 1.0)
            falling = _smaller(_larger(s.lamps_off - hour + 1.0, 0.0), 1.0)
            ramp = _smaller(rising, falling) if s.lamps_on < s.lamps_off else _larger(rising, falling)
        day_climate = _larger(ramp * dim_day * in_season, inputs.is_day)
        heating = day_climate * s.heating_day + (1.0 - day_climate) * s.heating_night
        return lamps, heating + s.heating_lamp_shift * lamps, day_climate * s.co2_day


_STATES = [TOMATO.state_names.index(name) for name in ("tAir", "vpAir", "co2Air")]
_OUTSIDE = [TOMATO.disturbance_names.index(name) for name in ("iGlob", "tOut", "dayRadSum", "isDay", "isDaySmooth")]


@controller(
    "rule_based",
    read=read_rule_settings,
    version="6eb5ee2b12f66ad91f2b87c4999de3caca1a0bc3986c8cf392674cf2db260d8a",
    sees="state",
    information=(
        "privileged: true state, weather of the coming step, radiation sum of the whole day, dawn and dusk in advance; "
        "sets controls directly, without rate limit"
    ),
)
class RuleBasedController:
    """The controller as it was published, a ``PrivilegedController``: rules on the true state and the radiation to come.

    It knows the radiation sum of the day at midnight and dawn half an hour ahead, and sets controls at once, without the rate limit that
    every agent works under. It remembers nothing from one step to the next. Its fair twin is ``FairRuleBasedAgent``.
    """

    privileged: Final = True

    def __init__(self, settings: RuleSettings) -> None:
        self.settings = settings
        self._rules, self._others = Rules(settings), 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Nothing to forget: the rules look at the present step only. Controls of the model beyond the paper's six stay at 0."""
        self._others = max(len(task.controls) - len(TOMATO.control_names), 0)

    def controls(self, x: Floats, d: Floats, hour_of_day: float | Floats, day_of_year: float | Floats, /) -> Floats:
        """Controls (n, controls of the model) for the step that begins now, fractions of capacity.

        ``x`` is the state at the start of the step (n, states), ``d`` the disturbance acting in it, (n, disturbances) or (disturbances,),
        and ``hour_of_day`` [h] and ``day_of_year`` [day] the clock at its start, one number or (n,). Other shapes raise ``ShapeError``.
        """
        controls = self._rules.controls(privileged_inputs(x, d, hour_of_day, day_of_year))
        return np.pad(controls, ((0, 0), (0, self._others))) if self._others else controls


def privileged_inputs(x: Floats, d: Floats, hour_of_day: float | Floats, day_of_year: float | Floats) -> RuleInputs:
    """What the rules look at, from states ``x`` and disturbances ``d`` as ``RuleBasedController.controls`` takes them."""
    n = x.shape[0] if x.ndim == 2 else -1
    state_count, outdoor_count = len(TOMATO.state_names), len(TOMATO.disturbance_names)
    if x.ndim != 2 or x.shape[1] != state_count or d.shape not in ((n, outdoor_count), (outdoor_count,)):
        msg = (
            f"Expected states of shape (n, {state_count}) and disturbances (n, {outdoor_count}) or ({outdoor_count},), "
            f"got {x.shape} and {d.shape}."
        )
        raise ShapeError(msg)
    # Rows of arrays of their own: numpy may take another path, with another last bit, through the columns of a larger array.
    states = np.empty((3, n))
    states[:] = x.T[_STATES]
    air_temperature, vapour_pressure, co2_density = states
    outside = d[_OUTSIDE].tolist() if d.ndim == 1 else np.ascontiguousarray(d.T[_OUTSIDE])
    radiation, outdoor_temperature, day_radiation_sum, is_day, is_day_smooth = outside
    return RuleInputs(
        air_temperature=air_temperature,
        relative_humidity=np.asarray(relative_humidity(air_temperature, vapour_pressure)),
        co2=np.asarray(co2_ppm(air_temperature, co2_density)),
        radiation=radiation,
        outdoor_temperature=outdoor_temperature,
        day_radiation_sum=day_radiation_sum,
        is_day=is_day,
        is_day_smooth=is_day_smooth,
        hour_of_day=hour_of_day,
        day_of_year=day_of_year,
    )


_MEASURED = ("air_temperature", "relative_humidity", "co2", "global_radiation", "outdoor_temperature")


@controller("rule_based_fair", read=read_rule_settings, version="422c7198decf7d13b7615521fba8f7915ad3235b7cb7256e2355ceb9327db821")
class FairRuleBasedAgent(ObservedController):
    """Rules under the conditions of every agent: observations only, and the task's actuation. Its memory is the radiation so far.

    What observations do not tell is estimated (``DaylightEstimator``).
    """

    title = "the fair rule-based agent"

    def __init__(self, settings: RuleSettings) -> None:
        self.settings = settings
        self._rules = Rules(settings)

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget the weather; ``n_runs`` runs of ``task`` begin.

        Raises ``SubmissionError`` when the task hides a quantity that the rules need, or has another actuation or greenhouse.
        """
        self.check_actuation(task)
        self._controls = [control.name for control in task.controls][:6]
        unknown = [name for name in task.action_names if name not in self._controls]
        if unknown:
            msg = f"The rules work {', '.join(self._controls)}; {task.id} is another kind of greenhouse ({', '.join(unknown)})."
            raise SubmissionError(msg)
        self.begin(task, n_runs, (*_MEASURED, *CLOCK))
        # With the published timing the weather shown is that of the step before.
        age_seconds = task.step_seconds if task.timing == "published" else 0.0
        self._daylight = DaylightEstimator(n_runs, task.step_seconds, age_seconds)

    def decide(self, readings: dict[str, Floats], positions: dict[str, Floats], /) -> Floats:
        """Actions (n_runs, actions) towards the controls that the rules ask for."""
        hour, day = clock_from(readings)
        daylight = self._daylight.observe(hour, readings["global_radiation"])
        controls = self._rules.controls(fair_inputs(readings, hour, day, daylight))
        return self.towards(dict(zip(self._controls, controls.T, strict=False)), positions)


def fair_inputs(readings: dict[str, Floats], hour: Floats, day: Floats, daylight: Daylight) -> RuleInputs:
    """What the rules look at, from readings by name, the clock, and the estimates of the day."""
    return RuleInputs(
        air_temperature=readings["air_temperature"],
        relative_humidity=readings["relative_humidity"],
        co2=readings["co2"],
        radiation=readings["global_radiation"],
        outdoor_temperature=readings["outdoor_temperature"],
        day_radiation_sum=daylight.radiation_sum,
        is_day=daylight.is_day,
        is_day_smooth=daylight.is_day_smooth,
        hour_of_day=hour,
        day_of_year=day,
    )
