"""A grower at the process computer: a page of settings, from which the set points of every step follow.

``baselines/grower/settings.toml`` is that page, and explains each setting. The periods of the day follow the sun, which is computed
from the task card's place and clock. The rest is observed: the time, the radiation, the position of the vents.
"""

from __future__ import annotations

import datetime as dt
import math
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from glbench.agents.rule_based_fair import clock_from
from glbench.errors import ShapeError, SubmissionError, did_you_mean
from glbench.settings import read_settings
from glbench.tasks import set_points as names

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]

_CLOCK = ("sin_hour_of_day", "cos_hour_of_day", "sin_day_of_year", "cos_day_of_year")
_RADIATION, _VENTS = "global_radiation", "vents"
_MEAN_HOURS = 1.0
"""Light is a running mean: its weight fades by 1/e within this time [h]."""

_HORIZON = math.radians(-0.833)
"""Height of the middle of the sun when it rises and sets: refraction, and half its width."""

_Hours = Annotated[float, Field(ge=-12.0, le=12.0)]
_Celsius = Annotated[float, Field(ge=-20.0, le=50.0)]
_Kelvin = Annotated[float, Field(ge=0.0, le=20.0)]
_Watts = Annotated[float, Field(ge=0.0, le=2000.0)]
_Ppm = Annotated[float, Field(ge=0.0, le=5000.0)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Hour = Annotated[float, Field(ge=0.0, le=24.0)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Periods(_Table):
    """When day, pre-night and night begin [h]."""

    day_before_sunrise: _Hours
    pre_night_before_sunset: _Hours
    night_after_sunset: _Hours


class Heating(_Table):
    """Heating temperatures [degC], and what light adds to that of the day [K] between two radiations [W m-2]."""

    day: _Celsius
    pre_night: _Celsius
    night: _Celsius
    light_raise: _Kelvin
    light_from: _Watts
    light_full: _Watts

    @model_validator(mode="after")
    def _in_order(self) -> Heating:
        _check_order("light_from", self.light_from, "light_full", self.light_full)
        return self


class Ventilation(_Table):
    """How far the vents open above the heating temperature, and what light adds [K]."""

    day: _Kelvin
    night: _Kelvin
    light_raise: _Kelvin


class CarbonDioxide(_Table):
    """CO2 [ppm] with vents shut and open, between two positions of the vents, and in less light than a radiation [W m-2]."""

    shut: _Ppm
    vented: _Ppm
    vents_shut: _Share
    vents_open: _Share
    dark: _Ppm
    dark_below: _Watts

    @model_validator(mode="after")
    def _in_order(self) -> CarbonDioxide:
        _check_order("vents_shut", self.vents_shut, "vents_open", self.vents_open)
        return self


class HumidityDeficit(_Table):
    """Humidity deficit [g m-3] by day and by night."""

    day: float = Field(ge=0.0, le=20.0)
    night: float = Field(ge=0.0, le=20.0)


class Lamps(_Table):
    """Whether there is lamp light, its hours [h] and the radiation [W m-2] above which it goes off."""

    used: bool
    from_: _Hour = Field(alias="from")
    until: _Hour
    radiation_limit: _Watts


class Screen(_Table):
    """Radiation [W m-2] and outdoor temperatures [degC] below which the thermal screen is closed."""

    radiation_limit: _Watts
    outdoor_day: _Celsius
    outdoor_night: _Celsius


class GrowerSettings(_Table):
    """The page of settings, one table a heading."""

    periods: Periods
    heating: Heating
    ventilation: Ventilation
    co2: CarbonDioxide
    humidity_deficit: HumidityDeficit
    lamps: Lamps
    screen: Screen


def read_grower_settings(path: Path) -> GrowerSettings:
    """Read the page of settings from a TOML file.

    Raises
    ------
    SubmissionError
        When the file cannot be read, lacks a setting, or has an unknown or impossible one.
    """
    return read_settings(GrowerSettings, path, "the grower's settings", toml=True)


class GrowerAgent:
    """Enters set points at the process computer; an ``Agent``. Its memory is the mean radiation of the last hour."""

    def __init__(self, settings: GrowerSettings) -> None:
        self.settings = settings
        self._runs = 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget the light; ``n_runs`` runs of ``task`` begin.

        Raises
        ------
        SubmissionError
            When the task has no process computer, or does not show clock and radiation.
        """
        if task.actuation != "process_computer":
            msg = f"The grower works at a process computer, and {task.id} has the actuation '{task.actuation}'."
            raise SubmissionError(msg)
        self._columns = {name: index for index, name in enumerate(task.observation_names)}
        missing = [name for name in (*_CLOCK, _RADIATION) if name not in self._columns]
        if missing:
            msg = f"The grower needs the observations {', '.join(missing)}, which {task.id} does not show."
            raise SubmissionError(msg)
        known = self._rules()
        for action in task.actions:
            if action.name not in known:
                near = did_you_mean(action.name, known)
                msg = f"The grower's settings page has no '{action.name}', a set point of {task.id}.{near}"
                raise SubmissionError(msg)
        self._task, self._runs = task, n_runs
        self._mean: Array | None = None
        self._weight = 1.0 - math.exp(-task.step_seconds / 3600.0 / _MEAN_HOURS)

    def act(self, observations: NDArray[np.float32], /) -> Array:
        """Actions (n_runs, actions): the set points of the page, or the nearest that the task takes.

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != self._runs:
            msg = f"act got observations of {len(observations)} runs, reset was called with {self._runs}. Call reset first."
            raise ShapeError(msg)
        page, rules = _Page(self.settings, *self._seen(observations)), self._rules()
        low, high = self._task.action_bounds
        wanted = [np.broadcast_to(one.of(rules[one.name](page)), self._runs) for one in self._task.actions]
        actions: Array = np.minimum(np.maximum(np.stack(wanted, axis=1), low), high)
        return actions

    def _seen(self, observations: NDArray[np.float32]) -> tuple[Array, Array, Array]:
        """Period of the day (0 day, 1 pre-night, 2 night), mean radiation [W m-2] and position of the vents."""
        places, rows = self._columns, observations.astype(np.float64)
        radiation = rows[:, places[_RADIATION]]
        self._mean = radiation if self._mean is None else self._mean + self._weight * (radiation - self._mean)
        hour, day = clock_from({name: rows[:, places[name]] for name in _CLOCK})
        sun = np.array([sun_hours(self._task, int(number)) for number in day.tolist()]).reshape(-1, 2)
        vents = rows[:, places[_VENTS]] if _VENTS in places else np.zeros(self._runs)
        return _period(self.settings.periods, hour, sun[:, 0], sun[:, 1]), self._mean, vents

    def _rules(self) -> dict[str, Callable[[_Page], Array | float]]:
        s = self.settings
        return {
            names.HEATING: _Page.heating,
            names.VENTILATION: _Page.ventilation,
            names.CO2: _Page.co2,
            names.HUMIDITY: lambda page: page.by_day(s.humidity_deficit.day, s.humidity_deficit.night),
            names.LAMPS_FROM: lambda page: s.lamps.from_ if s.lamps.used else 0.0,
            names.LAMPS_UNTIL: lambda page: s.lamps.until if s.lamps.used else 0.0,
            names.LAMP_RADIATION: lambda page: s.lamps.radiation_limit if s.lamps.used else 0.0,
            names.SCREEN_RADIATION: lambda page: s.screen.radiation_limit,
            names.SCREEN_OUTDOOR: lambda page: page.by_day(s.screen.outdoor_day, s.screen.outdoor_night),
        }


class _Page:
    """What the settings say at one moment, an array with a number a run each."""

    def __init__(self, settings: GrowerSettings, period: Array, radiation: Array, vents: Array) -> None:
        self.settings, self.period, self.radiation, self.vents = settings, period, radiation, vents
        heating = settings.heating
        light = _share(radiation, heating.light_from, heating.light_full)
        self.light = np.where(period == 0.0, light, 0.0)

    def by_day(self, day: float, otherwise: float) -> Array:
        """One value by day, another in pre-night and night."""
        return np.where(self.period == 0.0, day, otherwise)

    def heating(self) -> Array:
        """Heating temperature [degC]."""
        s = self.settings.heating
        base = np.where(self.period == 0.0, s.day, np.where(self.period == 1.0, s.pre_night, s.night))
        return base + s.light_raise * self.light

    def ventilation(self) -> Array:
        """Ventilation temperature [degC]."""
        s = self.settings.ventilation
        return self.heating() + self.by_day(s.day, s.night) + s.light_raise * self.light

    def co2(self) -> Array:
        """CO2 set point [ppm]."""
        s = self.settings.co2
        vented = s.shut + (s.vented - s.shut) * _share(self.vents, s.vents_shut, s.vents_open)
        return np.where(self.radiation < s.dark_below, s.dark, vented)


def _share(value: Array, start: float, full: float) -> Array:
    """From 0 at ``start`` to 1 at ``full``."""
    return np.minimum(np.maximum((value - start) / (full - start), 0.0), 1.0)


def _period(periods: Periods, hour: Array, sunrise: Array, sunset: Array) -> Array:
    """0 by day, 1 in the pre-night, 2 at night, which may go on after midnight."""
    day = (hour >= sunrise - periods.day_before_sunrise) & (hour < sunset - periods.pre_night_before_sunset)
    since_sunset = np.mod(hour - sunset, 24.0)
    night = (since_sunset >= periods.night_after_sunset) & (since_sunset < 24.0 - periods.pre_night_before_sunset)
    return np.where(day, 0.0, np.where(night, 2.0, 1.0))


def sun_hours(task: TaskCard, day_of_year: int) -> tuple[float, float]:
    """Sunrise and sunset [h] by the clock of a task, on a day counted from 0 at 1 January.

    Spencer's declination and equation of time (1971), to a few minutes; summer time as in the year of the task's start. Where the
    sun does not rise both are noon; where it does not set they are a day apart.
    """
    return _sun_hours(task.place.latitude, task.place.longitude, task.clock, task.start.year, day_of_year)


@lru_cache(maxsize=4096)
def _sun_hours(latitude: float, longitude: float, clock: str, year: int, day: int) -> tuple[float, float]:
    angle = 2.0 * math.pi * day / 365.0
    declination = (
        0.006918 - 0.399912 * math.cos(angle) + 0.070257 * math.sin(angle) - 0.006758 * math.cos(2.0 * angle)
        + 0.000907 * math.sin(2.0 * angle) - 0.002697 * math.cos(3.0 * angle) + 0.00148 * math.sin(3.0 * angle)
    )  # fmt: skip
    minutes = 229.18 * (
        0.000075 + 0.001868 * math.cos(angle) - 0.032077 * math.sin(angle)
        - 0.014615 * math.cos(2.0 * angle) - 0.040849 * math.sin(2.0 * angle)
    )  # fmt: skip
    noon = dt.datetime(year, 1, 1, 12, tzinfo=ZoneInfo(clock)) + dt.timedelta(days=day)
    offset = (noon.utcoffset() or dt.timedelta()).total_seconds() / 3600.0
    middle = 12.0 - minutes / 60.0 - longitude / 15.0 + offset
    north = math.radians(latitude)
    cosine = (math.sin(_HORIZON) - math.sin(north) * math.sin(declination)) / (math.cos(north) * math.cos(declination))
    half = math.degrees(math.acos(min(max(cosine, -1.0), 1.0))) / 15.0
    return middle - half, middle + half


def _check_order(first: str, low: float, second: str, high: float) -> None:
    if low >= high:
        msg = f"{first} = {low:g} must be below {second} = {high:g}"
        raise ValueError(msg)
