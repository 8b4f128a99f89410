"""The sun and a clear sky, by formulas that need nothing but numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

YEAR_DAYS = 365.2425


def sine_of_elevation(seconds: Floats, latitude: float, longitude: float) -> Floats:
    """Sine of the sun's elevation at ``seconds`` since 1970 UTC, at a place [degrees north and east].

    Declination and equation of time by Spencer (1971), to some tenths of a degree.
    """
    moments = np.floor(seconds).astype(np.int64).astype("datetime64[s]")
    begin = moments.astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64)
    a = 2.0 * np.pi * (seconds - begin) / (86400.0 * YEAR_DAYS)
    declination = (
        0.006918 - 0.399912 * np.cos(a) + 0.070257 * np.sin(a) - 0.006758 * np.cos(2 * a) + 0.000907 * np.sin(2 * a)
        - 0.002697 * np.cos(3 * a) + 0.00148 * np.sin(3 * a)
    )  # fmt: skip
    minutes = 229.18 * (
        0.000075 + 0.001868 * np.cos(a) - 0.032077 * np.sin(a) - 0.014615 * np.cos(2 * a) - 0.04089 * np.sin(2 * a)
    )
    solar_hour = seconds % 86400.0 / 3600.0 + longitude / 15.0 + minutes / 60.0
    angle, north = np.radians(15.0 * (solar_hour - 12.0)), np.radians(latitude)
    sine: Floats = np.sin(north) * np.sin(declination) + np.cos(north) * np.cos(declination) * np.cos(angle)
    return sine


def clear_sky(seconds: Floats, latitude: float, longitude: float) -> Floats:
    """Global radiation under a clear sky [W m-2] at ``seconds`` since 1970 UTC: Haurwitz (1945)."""
    sine = sine_of_elevation(seconds, latitude, longitude)
    return np.where(sine > 0.0, 1098.0 * sine * np.exp(-0.057 / np.maximum(sine, 1e-3)), 0.0)
