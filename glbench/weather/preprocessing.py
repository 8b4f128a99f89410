"""What both preprocessings share: the window of steps that is asked for, and what they hand back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glbench.weather.record import FloatArray, IntArray

COLUMNS = (
    "iGlob",
    "tOut",
    "vpOut",
    "co2Out",
    "wind",
    "tSky",
    "tSoOut",
    "dayRadSum",
    "isDay",
    "isDaySmooth",
)
RAW_SECONDS = 300
"""Both preprocessings pass through a 5-minute grid, like the published data."""
SLOPE = 10.0
"""Steepness of the sigmoid that rounds the day flag's ramps."""


@dataclass(frozen=True)
class Window:
    """``steps`` steps of ``step`` seconds from ``start`` (seconds since 1970-01-01 UTC), and the CO2 outside [ppm]."""

    start: int
    steps: int
    step: int
    co2_ppm: float

    @property
    def end(self) -> int:
        """End of the last step, seconds since 1970-01-01 UTC."""
        return self.start + self.steps * self.step

    @property
    def times(self) -> IntArray:
        """Start of every step, shape (steps,), seconds since 1970-01-01 UTC."""
        return self.start + self.step * np.arange(self.steps, dtype=np.int64)


@dataclass(frozen=True)
class Prepared:
    """Rows of disturbances (steps, 10) and the slots of the record that they were made from."""

    values: FloatArray
    first_slot: int
    last_slot: int


def sigmoid(ramp: FloatArray) -> FloatArray:
    """The published rounding of a ramp from 0 to 1: 0.0067 at its foot, 0.9933 at its head."""
    return np.asarray(1.0 / (1.0 + np.exp(-SLOPE * (ramp - 0.5))))
