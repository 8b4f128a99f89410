"""When it is light, and how much sun a day will have had.

``DaylightEstimator`` estimates both from the radiation so far and the clock, with no model of the sun and no knowledge of the place:
yesterday's dawn and dusk, and the average course of the days before, scaled by today's share. ``Sun`` computes the sun's hours from
place and date. All arrays have one row a run; rows do not mix, so a run gets the same bits alone and in a batch.
"""

from __future__ import annotations

import datetime as dt
import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats

if TYPE_CHECKING:
    from glbench.tasks import TaskCard


MEMORY = 0.2  # Weight of the latest complete day in the mean course of the radiation [-]; earlier days fade by 0.8 a day

PRIOR = 0.5
"""Radiation [MJ m-2] that today and the mean day are both credited with before they are compared: before so much has come in,
today counts as an average day. ``MEMORY`` and ``PRIOR`` were chosen on the springs of 2008, 2009, 2011 and 2012 at Schiphol."""

RAMP_HOURS = 1.0  # Length of dusk and dawn [h], as in the published day flags

_SECONDS_A_DAY = 86400.0
_HORIZON = math.radians(-0.833)  # Height of the middle of the sun when it rises and sets: refraction, and half its width
_SIGMOID_STEEPNESS = 10.0  # as in the published smooth day flag


@dataclass(frozen=True)
class Daylight:
    """Estimates for the present step, shape (n,) each."""

    is_day: Floats
    """1 by day, 0 by night, linear within dusk and dawn [-]."""
    is_day_smooth: Floats
    """The same with sigmoid dusk and dawn [-]."""
    radiation_sum: Floats
    """Radiation sum of the calendar day, the hours to come included [MJ m-2 d-1]."""


class DaylightEstimator:
    """Follows the days of ``n_runs`` runs; ``observe`` is called once a control step.

    ``step_seconds`` is the control step, ``age_seconds`` how old the radiation is when it is seen.

    Measured at Schiphol, March and April, within the lamp hours: docs/adr/0007-privileged-baseline-and-fair-twin.md.
    """

    def __init__(self, n_runs: int, step_seconds: float, age_seconds: float = 0.0) -> None:
        self._step_hours = step_seconds / 3600.0
        self._age_hours = age_seconds / 3600.0
        self._megajoules = step_seconds * 1e-6  # MJ m-2 in a step at 1 W m-2
        self._slots = math.ceil(_SECONDS_A_DAY / step_seconds)
        self._rows = np.arange(n_runs)
        self._hour = np.full(n_runs, np.nan)
        self._radiation = np.zeros(n_runs)
        self._dawn = np.full(n_runs, np.nan)
        self._dusk = np.full(n_runs, np.nan)
        self._today = np.zeros((n_runs, self._slots))
        self._so_far = np.zeros(n_runs)
        self._whole = np.zeros(n_runs, dtype=np.bool_)
        self._days = np.zeros(n_runs)
        self._mean = np.zeros((n_runs, self._slots))
        self._expected = np.zeros((n_runs, self._slots))

    def observe(self, hour: Floats, radiation: Floats) -> Daylight:
        """Take in the clock [h] and the global radiation [W m-2] of this step, shape (n,) each, and estimate."""
        slot = np.minimum((hour / self._step_hours).astype(np.int64), self._slots - 1)
        self._begin_days(hour, slot)
        # It became light or dark half a step ago: the edge is between two observations.
        before = ~np.isnan(self._hour)
        edge = hour - 0.5 * self._step_hours - self._age_hours
        self._dawn = np.where(before & (self._radiation <= 0.0) & (radiation > 0.0), edge, self._dawn)
        self._dusk = np.where(before & (self._radiation > 0.0) & (radiation <= 0.0), edge, self._dusk)
        self._today[self._rows, slot] = radiation * self._megajoules
        self._so_far = self._so_far + radiation * self._megajoules
        self._hour, self._radiation = hour.copy(), radiation.copy()

        # Day flag with linear ramps centred on the latest dawn and dusk; light or dark itself until there was each of them.
        both = ~(np.isnan(self._dawn) | np.isnan(self._dusk))
        dawn, dusk = np.where(both, self._dawn, 0.0), np.where(both, self._dusk, 0.0)
        rising = np.clip((hour - dawn) / RAMP_HOURS + 0.5, 0.0, 1.0)
        falling = np.clip((dusk - hour) / RAMP_HOURS + 0.5, 0.0, 1.0)
        # Where the clock's midnight falls into the day, light is after dawn or before dusk instead of both.
        ramped = np.where(dawn < dusk, np.minimum(rising, falling), np.maximum(rising, falling))
        is_day = np.where(both, ramped, (radiation > 0.0).astype(np.float64))
        inside = 1.0 / (1.0 + np.exp(-_SIGMOID_STEEPNESS * (is_day - 0.5)))
        smooth = np.where((is_day <= 0.0) | (is_day >= 1.0), is_day, inside)
        # What came in so far, and the rest of a mean day scaled by how today compares with it.
        expected_now = self._expected[self._rows, slot]
        rest = self._expected[:, -1] - expected_now
        return Daylight(is_day, smooth, self._so_far + rest * (self._so_far + PRIOR) / (expected_now + PRIOR))

    def _begin_days(self, hour: Floats, slot: NDArray[np.int64]) -> None:
        """At the start of a new day: learn from the one that ended, if it was observed from its start."""
        first = np.isnan(self._hour)
        # Half a day back is midnight; an hour back is only the end of summer time.
        new = first | (hour < self._hour - 12.0)
        learn = new & self._whole
        if learn.any():
            days = self._days[learn] + 1.0
            weight = np.maximum(MEMORY, 1.0 / days)[:, None]
            self._days[learn] = days
            self._mean[learn] += weight * (self._today[learn] - self._mean[learn])
            self._expected[learn] = np.cumsum(self._mean[learn], axis=1)
        self._whole = np.where(new, slot == 0, self._whole)
        self._today[new] = 0.0
        self._so_far = np.where(new, 0.0, self._so_far)


class Sun:
    """Sunrise and sunset by the clock of a task, looked up once a day."""

    def __init__(self, task: TaskCard) -> None:
        self._task = task
        self._day: Floats | None = None

    def hours(self, day: Floats) -> tuple[Floats, Floats]:
        """Both [h], (n,) each, on days of the year (n,)."""
        today = np.floor(day)
        if self._day is None or not np.array_equal(today, self._day):
            place, clock, year = self._task.place, self._task.clock, self._task.start.year
            hours = [sun_hours(place.latitude, place.longitude, clock, year, number) for number in today.tolist()]
            self._day, (self._rise, self._fall) = today, np.array(hours).reshape(-1, 2).T.copy()
        return self._rise, self._fall


@lru_cache(maxsize=4096)
def sun_hours(latitude: float, longitude: float, clock: str, year: int, day: float) -> tuple[float, float]:
    """Sunrise and sunset [h] by a clock (IANA zone), at a place [degrees] on a day of the year counted from 0 at 1 January.

    Spencer's declination and equation of time (1971), to a few minutes; summer time as in ``year``. Where the sun does not rise both are
    noon; where it does not set they are a day apart.
    """
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
