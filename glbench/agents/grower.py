"""A grower at the process computer: a page of settings, from which the set points of every step follow.

``baselines/grower/settings.toml`` is that page, and explains each setting. The periods of the day follow the sun, which is computed
from the task card's place and clock. The rest is observed: the time, the radiation, the position of the vents.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, model_validator

from glbench.agents.controllers import CLOCK, ObservedController, clock_from, controller
from glbench.agents.daylight import Sun
from glbench.arrays import Floats
from glbench.errors import SubmissionError, did_you_mean, refuse
from glbench.settings import Table, read_settings
from glbench.tasks import set_points as names

if TYPE_CHECKING:
    from glbench.tasks import TaskCard


_RADIATION, _VENTS = "global_radiation", "vents"
_MEAN_HOURS = 1.0  # Light is a running mean: its weight fades by 1/e within this time [h]

_Hours = Annotated[float, Field(ge=-12.0, le=12.0)]
_Celsius = Annotated[float, names.set_point_field(names.HEATING)]
_Outdoors = Annotated[float, names.set_point_field(names.SCREEN_OUTDOOR)]
_Deficit = Annotated[float, names.set_point_field(names.HUMIDITY)]
_Kelvin = Annotated[float, Field(ge=0.0, le=20.0)]
_Watts = Annotated[float, Field(ge=0.0, le=2000.0)]
_Ppm = Annotated[float, names.set_point_field(names.CO2)]
_Share = Annotated[float, Field(ge=0.0, le=1.0)]
_Hour = Annotated[float, Field(ge=0.0, le=24.0)]


class Periods(Table):
    """When day, pre-night and night begin [h]."""

    day_before_sunrise: _Hours
    pre_night_before_sunset: _Hours
    night_after_sunset: _Hours


class Heating(Table):
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


class Ventilation(Table):
    """How far the vents open above the heating temperature, and what light adds [K]."""

    day: _Kelvin
    night: _Kelvin
    light_raise: _Kelvin


class CarbonDioxide(Table):
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


class HumidityDeficit(Table):
    """Humidity deficit [g m-3] by day and by night."""

    day: _Deficit
    night: _Deficit


class Lamps(Table):
    """Whether there is lamp light, its hours [h] and the radiation [W m-2] above which it goes off."""

    used: bool
    from_: _Hour = Field(alias="from")
    until: _Hour
    radiation_limit: Annotated[float, names.set_point_field(names.LAMP_RADIATION)]


class Screen(Table):
    """Radiation [W m-2] and outdoor temperatures [degC] below which the thermal screen is closed."""

    radiation_limit: Annotated[float, names.set_point_field(names.SCREEN_RADIATION)]
    outdoor_day: _Outdoors
    outdoor_night: _Outdoors


class GrowerSettings(Table):
    """The page of settings, one table a heading."""

    periods: Periods
    heating: Heating
    ventilation: Ventilation
    co2: CarbonDioxide
    humidity_deficit: HumidityDeficit
    lamps: Lamps
    screen: Screen

    @model_validator(mode="after")
    def _computer_takes_sums(self) -> GrowerSettings:
        """Refuse settings that add up to a set point beyond what the process computer takes."""
        heating, above = self.heating, self.ventilation
        sunny, vented = heating.day + heating.light_raise, above.day + above.light_raise
        for name, words, value in (
            (names.HEATING, "heating.day + heating.light_raise", sunny),
            (names.VENTILATION, "heating.day + ventilation.day", heating.day + above.day),
            (names.VENTILATION, "heating.day + ventilation.day, with both values of light_raise,", sunny + vented),
            (names.VENTILATION, "heating.pre_night + ventilation.night", heating.pre_night + above.night),
            (names.VENTILATION, "heating.night + ventilation.night", heating.night + above.night),
        ):
            action = names.SET_POINTS[name]
            if not action.lowest <= value <= action.highest:
                refuse(
                    f"{words} is {value:g} {action.unit}, and the process computer takes a {name.replace('_', ' ')} "
                    f"from {action.lowest:g} to {action.highest:g} {action.unit}"
                )
        return self


def read_grower_settings(path: Path) -> GrowerSettings:
    """The page of settings in a TOML file. Raises ``SubmissionError`` when it cannot be read, lacks a setting, or has a wrong one."""
    return read_settings(GrowerSettings, path, "the grower's settings", toml=True)


@controller("grower", read=read_grower_settings, version="b39f2da424cbd9fc5f64fc9e0ab4be3edb32723be330b22a89cc3c66c9d2233e")
class GrowerAgent(ObservedController):
    """Enters set points at the process computer; an ``Agent``. Its memory is the mean radiation of the last hour."""

    title = "the grower"
    actuations = ("process_computer",)

    def __init__(self, settings: GrowerSettings) -> None:
        self.settings = settings

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """``n_runs`` runs of ``task`` begin. Raises ``SubmissionError`` when it has no process computer, or hides clock or radiation."""
        if task.actuation not in self.actuations:
            refuse(f"The grower works at a process computer, and {task.id} has the actuation '{task.actuation}'.", SubmissionError)
        self.begin(task, n_runs, (*CLOCK, _RADIATION), optional=(_VENTS,))
        rules = self._set_points(*np.zeros((3, n_runs)))
        for action in task.actions:
            if action.name not in rules:
                near = did_you_mean(action.name, rules)
                refuse(f"The grower's settings page has no '{action.name}', a set point of {task.id}.{near}", SubmissionError)
        self._sun, self._shut = Sun(task), np.zeros(n_runs)
        self._mean: Floats | None = None
        self._weight = 1.0 - math.exp(-task.step_seconds / 3600.0 / _MEAN_HOURS)

    def decide(self, readings: dict[str, Floats], positions: dict[str, Floats], /) -> Floats:
        """Actions (n_runs, actions): the set points of the page; bounds cut off what rounding adds."""
        radiation = readings[_RADIATION]
        self._mean = radiation if self._mean is None else self._mean + self._weight * (radiation - self._mean)
        hour, day = clock_from(readings)
        rise, fall = self._sun.hours(day)
        periods = self.settings.periods
        by_day = (hour >= rise - periods.day_before_sunrise) & (hour < fall - periods.pre_night_before_sunset)
        since_sunset = np.mod(hour - fall, 24.0)
        # A night may go on after midnight.
        by_night = (since_sunset >= periods.night_after_sunset) & (since_sunset < 24.0 - periods.pre_night_before_sunset)
        period = np.where(by_day, 0.0, np.where(by_night, 2.0, 1.0))
        rules = self._set_points(period, self._mean, readings.get(_VENTS, self._shut))
        low, high = self.task.action_bounds
        set_points = [np.broadcast_to(one.of(rules[one.name]), self.runs) for one in self.task.actions]
        actions: Floats = np.minimum(np.maximum(np.stack(set_points, axis=1), low), high)
        return actions

    def _set_points(self, period: Floats, radiation: Floats, vents: Floats) -> dict[str, Floats | float]:
        """Set points by name, for the period (0 day, 1 pre-night, 2 night), mean radiation [W m-2] and position of the vents."""
        s, day = self.settings, period == 0.0
        light = np.where(day, _share(radiation, s.heating.light_from, s.heating.light_full), 0.0)
        heating = np.where(day, s.heating.day, np.where(period == 1.0, s.heating.pre_night, s.heating.night))
        heating = heating + s.heating.light_raise * light
        above = np.where(day, s.ventilation.day, s.ventilation.night)
        co2 = s.co2.shut + (s.co2.vented - s.co2.shut) * _share(vents, s.co2.vents_shut, s.co2.vents_open)
        return {
            names.HEATING: heating,
            names.VENTILATION: heating + above + s.ventilation.light_raise * light,
            names.CO2: np.where(radiation < s.co2.dark_below, s.co2.dark, co2),
            names.HUMIDITY: np.where(day, s.humidity_deficit.day, s.humidity_deficit.night),
            names.LAMPS_FROM: s.lamps.from_ if s.lamps.used else 0.0,
            names.LAMPS_UNTIL: s.lamps.until if s.lamps.used else 0.0,
            names.LAMP_RADIATION: s.lamps.radiation_limit if s.lamps.used else 0.0,
            names.SCREEN_RADIATION: s.screen.radiation_limit,
            names.SCREEN_OUTDOOR: np.where(day, s.screen.outdoor_day, s.screen.outdoor_night),
        }


def _share(value: Floats, start: float, full: float) -> Floats:
    """From 0 at ``start`` to 1 at ``full``."""
    return np.minimum(np.maximum((value - start) / (full - start), 0.0), 1.0)


def _check_order(first: str, low: float, second: str, high: float) -> None:
    if low >= high:
        refuse(f"{first} = {low:g} must be below {second} = {high:g}")
