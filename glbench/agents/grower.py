"""A grower at the process computer: a page of settings, from which the set points of every step follow.

``baselines/grower/settings.toml`` is that page, and explains each setting. The periods of the day follow the sun, which is computed
from the task card's place and clock. The rest is observed: the time, the radiation, the position of the vents.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from glbench.agents.controllers import CLOCK, ObservedController, clock_from, controller
from glbench.agents.daylight import Sun
from glbench.errors import SubmissionError, did_you_mean
from glbench.settings import read_settings
from glbench.tasks import set_points as names

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]

_RADIATION, _VENTS = "global_radiation", "vents"
_MEAN_HOURS = 1.0
"""Light is a running mean: its weight fades by 1/e within this time [h]."""

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


@controller(
    "grower",
    read=read_grower_settings,
    version="b39f2da424cbd9fc5f64fc9e0ab4be3edb32723be330b22a89cc3c66c9d2233e",
)
class GrowerAgent(ObservedController):
    """Enters set points at the process computer; an ``Agent``. Its memory is the mean radiation of the last hour."""

    title = "the grower"
    actuations = ("process_computer",)

    def __init__(self, settings: GrowerSettings) -> None:
        self.settings = settings

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget the light; ``n_runs`` runs of ``task`` begin.

        Raises
        ------
        SubmissionError
            When the task has no process computer, or does not show clock and radiation.
        """
        if task.actuation not in self.actuations:
            msg = f"The grower works at a process computer, and {task.id} has the actuation '{task.actuation}'."
            raise SubmissionError(msg)
        self.begin(task, n_runs, (*CLOCK, _RADIATION), optional=(_VENTS,))
        rules = self._rules()
        for action in task.actions:
            if action.name not in rules:
                near = did_you_mean(action.name, rules)
                msg = f"The grower's settings page has no '{action.name}', a set point of {task.id}.{near}"
                raise SubmissionError(msg)
        self._sun, self._shut = Sun(task), np.zeros(n_runs)
        self._mean: Array | None = None
        self._weight = 1.0 - math.exp(-task.step_seconds / 3600.0 / _MEAN_HOURS)

    def decide(self, readings: dict[str, Array], positions: dict[str, Array], /) -> Array:
        """Actions (n_runs, actions): the set points of the page, or the nearest that the task takes."""
        radiation = readings[_RADIATION]
        self._mean = radiation if self._mean is None else self._mean + self._weight * (radiation - self._mean)
        hour, day = clock_from(readings)
        period = _period(self.settings.periods, hour, *self._sun.hours(day))
        page, rules = _Page(self.settings, period, self._mean, readings.get(_VENTS, self._shut)), self._rules()
        low, high = self.task.action_bounds
        set_points = [np.broadcast_to(one.of(rules[one.name](page)), self.runs) for one in self.task.actions]
        actions: Array = np.minimum(np.maximum(np.stack(set_points, axis=1), low), high)
        return actions

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


def _check_order(first: str, low: float, second: str, high: float) -> None:
    if low >= high:
        msg = f"{first} = {low:g} must be below {second} = {high:g}"
        raise ValueError(msg)
