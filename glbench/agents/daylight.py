"""What an observer can know about the day: when it is light, and how much sun it will have had.

The published controller knows both. Here they are estimated from the radiation seen so far and the clock, with no model of the
sun and no knowledge of the place: yesterday's dawn and dusk, and the average course of the days before, scaled by today's share.
All arrays have one row a run; rows do not mix, so a run gets the same bits alone and in a batch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MEMORY = 0.2
"""Weight of the latest complete day in the mean course of the radiation [-]; earlier days fade by 0.8 a day."""

PRIOR = 0.5
"""Radiation [MJ m-2] that today and the mean day are both credited with before they are compared: before so much has come in,
today counts as an average day. ``MEMORY`` and ``PRIOR`` were chosen on the springs of 2008, 2009, 2011 and 2012 at Schiphol."""

RAMP_HOURS = 1.0
"""Length of dusk and dawn [h], as in the published day flags."""

_SECONDS_A_DAY = 86400.0
_SIGMOID_STEEPNESS = 10.0  # as in the published smooth day flag


@dataclass(frozen=True)
class Daylight:
    """Estimates for the present step, shape (n,) each."""

    is_day: Array
    """1 by day, 0 by night, linear within dusk and dawn [-]."""
    is_day_smooth: Array
    """The same with sigmoid dusk and dawn [-]."""
    radiation_sum: Array
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

    def observe(self, hour: Array, radiation: Array) -> Daylight:
        """Take in the clock [h] and the global radiation [W m-2] of this step, shape (n,) each, and estimate."""
        slot = np.minimum((hour / self._step_hours).astype(np.int64), self._slots - 1)
        self._turn_page(hour, slot)
        self._follow_edges(hour, radiation)
        self._today[self._rows, slot] = radiation * self._megajoules
        self._so_far = self._so_far + radiation * self._megajoules
        self._hour, self._radiation = hour.copy(), radiation.copy()
        is_day = self._day_flag(hour, radiation)
        return Daylight(is_day, _smooth(is_day), self._radiation_sum(slot))

    def _turn_page(self, hour: Array, slot: NDArray[np.int64]) -> None:
        """At the start of a new day: learn from the one that ended, if it was seen from its start."""
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

    def _follow_edges(self, hour: Array, radiation: Array) -> None:
        """Remember when it became light and dark; half a step back, because the edge lies between two observations."""
        known = ~np.isnan(self._hour)
        edge = hour - 0.5 * self._step_hours - self._age_hours
        self._dawn = np.where(known & (self._radiation <= 0.0) & (radiation > 0.0), edge, self._dawn)
        self._dusk = np.where(known & (self._radiation > 0.0) & (radiation <= 0.0), edge, self._dusk)

    def _day_flag(self, hour: Array, radiation: Array) -> Array:
        """Day flag with linear ramps centred on the latest dawn and dusk; light or dark itself until both are known."""
        known = ~(np.isnan(self._dawn) | np.isnan(self._dusk))
        dawn, dusk = np.where(known, self._dawn, 0.0), np.where(known, self._dusk, 0.0)
        rising = np.clip((hour - dawn) / RAMP_HOURS + 0.5, 0.0, 1.0)
        falling = np.clip((dusk - hour) / RAMP_HOURS + 0.5, 0.0, 1.0)
        # Where the clock's midnight falls into the day, light is after dawn or before dusk instead of both.
        ramped = np.where(dawn < dusk, np.minimum(rising, falling), np.maximum(rising, falling))
        return np.where(known, ramped, (radiation > 0.0).astype(np.float64))

    def _radiation_sum(self, slot: NDArray[np.int64]) -> Array:
        """What came in so far, and the rest of a mean day scaled by how today compares with it."""
        expected_now = self._expected[self._rows, slot]
        rest = self._expected[:, -1] - expected_now
        return self._so_far + rest * (self._so_far + PRIOR) / (expected_now + PRIOR)


def _smooth(linear: Array) -> Array:
    """Sigmoid over the linear ramps, exactly 0 and 1 outside them."""
    inside = 1.0 / (1.0 + np.exp(-_SIGMOID_STEEPNESS * (linear - 0.5)))
    return np.where((linear <= 0.0) | (linear >= 1.0), linear, inside)
