"""Rules of a climate computer whose numbers were tuned: set points by the sun and by light, humidity kept just below the limit.

``baselines/rule_based_tuned`` holds the numbers, and explains each. The rules look at observations and the task card alone and act
through the task's actuation. They know the limits of the climate from the card and the sun's hours from place and date.

All arithmetic goes element by element over arrays of shape (n,), one value a run, so that a run gets the same bits alone and in a
batch; every run may have numbers of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from glbench.agents.grower import sun_hours
from glbench.agents.rule_based_fair import clock_from
from glbench.agents.tuned_rule_settings import RulePages, TunedRuleSettings
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks.set_points import BLACKOUT, BOILER, DOSING, LAMPS, SCREEN, VENTS, WORKED

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]

_CLOCK = ("sin_hour_of_day", "cos_hour_of_day", "sin_day_of_year", "cos_day_of_year")
_NEEDED = ("air_temperature", "relative_humidity", "global_radiation", "outdoor_temperature", *_CLOCK)
_WELCOME = ("co2", "wind_speed")
"""Looked at where a task shows them: without the one no CO2 is dosed, without the other the air counts as calm."""
_SCREEN_BAND = 3.0
"""The thermal screen goes from closed to open while it gets so much warmer outside [K]."""
_COLD_BAND = 0.7
"""Vents go from shut to free while it gets so much warmer inside [K]."""
_NO_COLD, _FULL_COLD = 2.0, 18.0
"""Vents against humidity move less from a difference to the air outside [K] to another."""
_STRONG_WIND = 10.0
"""Wind [m s-1] in which they move least."""
_LOWEST_TEMPERATURE, _HIGHEST_HUMIDITY = 15.0, 85.0
"""Limits [degC] and [%] where a task has none."""


class TunedRulesAgent:
    """Rules with tuned numbers; an ``Agent``. It remembers the smoothed temperature and humidity of every run.

    ``settings`` are pages of numbers, of which the task's reward chooses one, or numbers for every run, one a run.
    """

    def __init__(self, settings: RulePages | Sequence[TunedRuleSettings]) -> None:
        self.settings = settings
        self._runs = 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget what was measured; ``n_runs`` runs of ``task`` begin.

        Raises
        ------
        SubmissionError
            When the task does not show a quantity that the rules need, has another kind of actuation, or no page is for it.
        ShapeError
            When there are numbers for another count of runs.
        """
        settings = self.settings
        if isinstance(settings, RulePages):
            given: Sequence[TunedRuleSettings] = [settings.numbers_for(task.reward_modules, task.id)] * n_runs
        else:
            given = settings
        if len(given) != n_runs:
            msg = f"The rules have numbers for {len(given)} runs, and {n_runs} begin."
            raise ShapeError(msg)
        columns = {name: np.array([getattr(one, name) for one in given]) for name in TunedRuleSettings.model_fields}
        self._plan = _plan(task)
        self._numbers: Any = SimpleNamespace(**columns)
        self._spans = _spans(self._numbers)
        self._limits = _limits(task)
        self._task, self._runs = task, n_runs
        self._step_hours = task.step_seconds / 3600.0
        self._sun = _Sun(task)
        self._temperature = _Smoothed(columns["temperature_smoothing"], self._step_hours)
        self._humidity = _Smoothed(columns["humidity_smoothing"], self._step_hours)
        self._calm = np.zeros(n_runs)

    def act(self, observations: NDArray[np.float32], /) -> Array:
        """Actions (n_runs, actions) towards the controls that the rules ask for.

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != self._runs:
            msg = f"act got observations of {len(observations)} runs, reset was called with {self._runs}. Call reset first."
            raise ShapeError(msg)
        plan = self._plan
        rows = observations.T[plan.places].astype(np.float64, order="C")
        controls = rows[len(plan.names) :] / plan.at_one
        wanted = self._wanted(dict(zip(plan.names, rows, strict=False)), controls[0])
        asked = np.stack([wanted[name] for name in plan.actions])
        if plan.rate:
            asked = np.minimum(np.maximum((asked - controls[1:]) / self._task.max_change, -1.0), 1.0)
        return asked.T

    def _wanted(self, seen: dict[str, Array], vents: Array) -> dict[str, Array]:
        """Controls (n,) by name, fractions of what is installed, with the vents where they are now."""
        n = self._numbers
        hour, day = clock_from(seen)
        temperature, warming = self._temperature.take(seen["air_temperature"])
        humidity, rising = self._humidity.take(seen["relative_humidity"])
        radiation, outdoor = seen["global_radiation"], seen["outdoor_temperature"]
        shares = self._shares(hour, day, radiation, temperature, outdoor, seen.get("wind_speed", self._calm))
        heating = _heating(n, shares)
        lamps = _lamps(n, hour, radiation)
        above = humidity - self._limits[1]
        return {
            BOILER: _boiler(n, shares, heating, temperature, warming / self._step_hours, outdoor, above),
            DOSING: _co2(n, shares, radiation, vents, seen["co2"]) if "co2" in seen else self._calm,
            SCREEN: _screen(n, shares, above),
            VENTS: _vents(n, shares, vents, temperature, above, rising, self._step_hours),
            LAMPS: lamps,
            BLACKOUT: np.where(radiation <= 0.0, lamps, 0.0),
        }

    def _shares(
        self, hour: Array, day: Array, radiation: Array, temperature: Array, outdoor: Array, wind: Array
    ) -> _Shares:
        """All shares at once: numpy takes as long for one of them as for ten."""
        n = self._numbers
        noon, half = self._sun.at(day)
        since_noon = np.mod(hour - noon, 24.0)
        above = np.empty((len(_Shares._fields), self._runs))
        np.subtract(since_noon, 24.0 - half - n.morning_before_sunrise, out=above[0])
        np.subtract(since_noon, half - n.evening_before_sunset, out=above[1])
        np.subtract(since_noon, half + n.night_after_sunset, out=above[2])
        above[3] = radiation
        np.subtract(radiation, n.heating_light_from, out=above[4])
        np.subtract(radiation, n.co2_light_from, out=above[5])
        np.subtract(temperature - outdoor, _NO_COLD, out=above[6])
        above[7] = wind
        np.subtract(temperature, self._limits[0] + n.vents_cold, out=above[8])
        np.subtract(radiation, n.screen_light_from, out=above[9])
        np.subtract(outdoor, n.screen_outdoor, out=above[10])
        return _Shares(*np.minimum(np.maximum(above / self._spans, 0.0), 1.0))


class _Shares(NamedTuple):
    """How far along each of these is, from 0 to 1 in a straight line; shape (n,) each [-]."""

    morning: Array
    """From the temperature of the night to that of the morning."""
    evening: Array
    """From the end of the day's temperature on; stays 1 until morning."""
    night: Array
    """From the temperature of the evening to that of the night."""
    daylight: Array
    sunny: Array
    """Light that raises temperatures."""
    co2_sunny: Array
    """Light that raises the CO2 set point."""
    cold: Array
    """How much colder it is outside."""
    windy: Array
    warm_enough: Array
    """For open vents."""
    bright: Array
    """Too bright for the screen."""
    mild: Array
    """Too mild outside for the screen."""


def _spans(n: Any) -> Array:
    """What each share goes from 0 to 1 in."""
    ramp = n.ramp_hours
    lights = n.heating_daylight, n.heating_light_span, n.co2_light_span
    constant = (np.full_like(ramp, span) for span in (_FULL_COLD - _NO_COLD, _STRONG_WIND, _COLD_BAND))
    return np.stack([ramp, ramp, ramp, *lights, *constant, n.screen_light_span, np.full_like(ramp, _SCREEN_BAND)])


class _Smoothed:
    """A reading smoothed over some hours: it goes step/(step + hours) of the way to what is read."""

    def __init__(self, hours: Array, step: float) -> None:
        self._weight = step / (step + hours)
        self._value: Array | None = None

    def take(self, reading: Array) -> tuple[Array, Array]:
        """The smoothed value, and its change in this step."""
        change = np.zeros_like(reading) if self._value is None else self._weight * (reading - self._value)
        self._value = reading if self._value is None else self._value + change
        return self._value, change


class _Sun:
    """Noon [h] and half the length of the day [h], looked up once a day."""

    def __init__(self, task: TaskCard) -> None:
        self._task = task
        self._day: Array | None = None

    def at(self, day: Array) -> tuple[Array, Array]:
        """Both on days of the year, (n,) each."""
        today = np.floor(day)
        if self._day is None or not np.array_equal(today, self._day):
            rise, fall = np.array([sun_hours(self._task, int(number)) for number in today.tolist()]).reshape(-1, 2).T
            self._day, self._half = today, 0.5 * (fall - rise)
            self._noon = rise + self._half
        return self._noon, self._half


def _share(value: Array, span: Array) -> Array:
    """From 0 at 0 to 1 at ``span``."""
    return np.minimum(np.maximum(value / span, 0.0), 1.0)


def _heating(n: Any, s: _Shares) -> Array:
    """Heating temperature [degC]: one in the dark by the sun's clock, that of the day as it gets light, more in full sun."""
    dark = n.heating_evening + s.night * (n.heating_night - n.heating_evening)
    dark = dark + s.morning * (n.heating_morning - dark)
    afternoon_left = 1.0 - s.evening * (1.0 - s.morning)
    wanted: Array = dark + (s.daylight * (n.heating_day - dark) + n.heating_light_raise * s.sunny) * afternoon_left
    return wanted


def _boiler(
    n: Any, s: _Shares, heating: Array, temperature: Array, warming: Array, outdoor: Array, above: Array
) -> Array:
    """P-band, feed-forward on what is lost to the outside, minimum heat by day and against humidity."""
    power = (heating - temperature) / n.boiler_band + n.boiler_outside * (heating - outdoor)
    power = power + n.boiler_daylight * s.daylight - n.boiler_trend * warming
    power = power + n.boiler_humidity * np.maximum(above - n.boiler_humidity_above, 0.0)
    share: Array = np.minimum(np.maximum(power, 0.0), 1.0)
    return share


def _co2(n: Any, s: _Shares, radiation: Array, vents: Array, co2: Array) -> Array:
    """P-band below a set point by light, lower the wider the vents are open."""
    wanted = n.co2_dim + (n.co2_sunny - n.co2_dim) * s.co2_sunny - n.co2_vents * vents
    return np.where(radiation >= n.co2_dark, _share(wanted - co2, n.co2_band), 0.0)


def _vents(n: Any, s: _Shares, vents: Array, temperature: Array, above: Array, rising: Array, step: float) -> Array:
    """Against humidity a PI controller in velocity form: it moves the vents from where they are, so that nothing winds up."""
    wanted = n.vents_humidity_night + (n.vents_humidity_day - n.vents_humidity_night) * s.daylight
    change = n.vents_gain * step * (above - wanted) + n.vents_trend * rising
    change = change * (1.0 - n.vents_cold_less * s.cold) * (1.0 - n.vents_wind_less * s.windy)
    humid = np.minimum(np.maximum(vents + change, 0.0), n.vents_most) * s.warm_enough
    hot = _share(temperature - n.vents_temperature - n.vents_light_raise * s.sunny, n.vents_band)
    wider: Array = np.maximum(humid, hot)
    return wider


def _screen(n: Any, s: _Shares, above: Array) -> Array:
    """Closed in the dark when it is cold outside, but for a gap against humidity."""
    gap = np.minimum(np.maximum(n.screen_gap * (above - n.screen_humidity), 0.0), n.screen_gap_most)
    closed: Array = (1.0 - s.bright) * (1.0 - s.mild) * (1.0 - gap)
    return closed


def _lamps(n: Any, hour: Array, radiation: Array) -> Array:
    """On between two hours of the day, unless it is bright."""
    return np.where((hour >= n.lamps_from) & (hour < n.lamps_until) & (radiation < n.lamps_radiation), 1.0, 0.0)


@dataclass(frozen=True)
class _Plan:
    """Where a task's observations are and how its actions act."""

    names: tuple[str, ...]
    """Observed quantities that the rules use."""
    places: list[int]
    """Their columns, then that of the vents, then those of the controls that are acted on."""
    at_one: Array
    """What each of these controls is at 1, (1 + controls, 1)."""
    actions: tuple[str, ...]
    """Controls that are acted on."""
    rate: bool


def _plan(task: TaskCard) -> _Plan:
    if task.actuation not in ("rate", "set_point"):
        msg = (
            f"The tuned rules move controls themselves (actuation 'rate' or 'set_point'), and {task.id} has "
            f"'{task.actuation}'. The baseline 'grower' works at a process computer."
        )
        raise SubmissionError(msg)
    controls = {control.name: control for control in task.controls}
    unknown = [name for name in (VENTS, *task.action_names) if name not in WORKED or name not in controls]
    if unknown:
        msg = (
            f"The tuned rules work {', '.join(WORKED)}; {task.id} is another kind of greenhouse ({', '.join(unknown)})."
        )
        raise SubmissionError(msg)
    rate = task.actuation == "rate"
    moved = [controls[VENTS], *(controls[name] for name in task.action_names if rate)]
    columns = {name: index for index, name in enumerate(task.observation_names)}
    missing = [name for name in dict.fromkeys([*_NEEDED, *(one.quantity for one in moved)]) if name not in columns]
    if missing:
        msg = f"The tuned rules need the observations {', '.join(missing)}, which {task.id} does not show."
        raise SubmissionError(msg)
    names = (*_NEEDED, *(name for name in _WELCOME if name in columns))
    return _Plan(
        names=names,
        places=[columns[name] for name in (*names, *(one.quantity for one in moved))],
        # Where nothing is installed the observation is 0, whatever it is divided by.
        at_one=np.array([[one.at_one if one.at_one > 0.0 else 1.0] for one in moved]),
        actions=task.action_names,
        rate=rate,
    )


def _limits(task: TaskCard) -> tuple[float, float]:
    """Lower limit of air temperature [degC] and upper limit of relative humidity [%]."""
    by_name = {limit.name: limit for limit in task.constraints}
    temperature, humidity = by_name.get("air_temperature"), by_name.get("relative_humidity")
    return (
        _LOWEST_TEMPERATURE if temperature is None else temperature.low,
        _HIGHEST_HUMIDITY if humidity is None else humidity.high,
    )
