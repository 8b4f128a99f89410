"""Where the sun stands: the sine of its geometric elevation, on the 5-minute sub-intervals of hourly slots.

Geometric, not apparent: refraction lifts the sun by half a degree at the horizon only, depends on the day's air, and would
add direct sun to minutes that have none. The twilight before sunrise is treated on its own (``glbench.weather.conserving``).
Algorithm: NREL's SPA (Reda and Andreas, 2004) as in pvlib, numpy version, with a fixed difference between terrestrial and
universal time, so that nothing depends on tables that are updated.
"""

from __future__ import annotations

import numpy as np

from glbench.weather.record import FloatArray, Place

DELTA_T = 67.0  # s, terrestrial minus universal time; 65.5 to 69.4 s from 2008 to 2024, 1 s moves the sun by 0.004 deg
STANDARD_PRESSURE_HPA = 1013.25
MEAN_TEMPERATURE = 12.0  # degC; enters the refraction only, which is not used
REFRACTION_AT_SUNRISE = 0.5667  # deg; likewise


def sine_of_elevation(times: FloatArray, place: Place) -> FloatArray:
    """Sine of the sun's geometric elevation at ``times`` (seconds since 1970-01-01 UTC), the same shape."""
    from pvlib import spa

    flat = np.ascontiguousarray(times, dtype=np.float64).ravel()
    position = spa.solar_position_numpy(
        flat,
        place.latitude,
        place.longitude,
        place.altitude,
        STANDARD_PRESSURE_HPA,
        MEAN_TEMPERATURE,
        DELTA_T,
        REFRACTION_AT_SUNRISE,
        1,
    )
    geometric_elevation = np.asarray(position[3], dtype=np.float64)
    return np.sin(np.radians(geometric_elevation)).reshape(np.shape(times))
