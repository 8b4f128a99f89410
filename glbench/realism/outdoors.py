"""The measured weather as the model's disturbances, a row a quarter of an hour, and the days and hours that the archive's clock shows."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

import numpy as np

from glbench.errors import ArchiveError
from glbench.realism.published import DAY_ZERO, ROWS_A_DAY, WEATHER, Archive, Weather, longest, moment
from glbench.weather.preprocessing import (
    COLUMNS,
    KELVIN,
    STEFAN_BOLTZMANN,
    co2_density,
    seconds_into_year,
    soil_temperature,
    to_utc_seconds,
    utc_offsets,
    vapour_pressure,
)
from glbench.weather.record import FloatArray, IntArray

STEP_SECONDS = 900
"""Length of a step [s]: that of the benchmark's tasks."""
_ROW_SECONDS = 86400 // ROWS_A_DAY
LONGEST_GAP_HOURS = 3
"""Weather that may be missing at once [h]."""
_EPOCH = (dt.date(1970, 1, 1) - DAY_ZERO).days
_DAY_SECONDS = 86400


@dataclass(frozen=True, eq=False)
class Outdoors:
    """What acts in each step from outside.

    Attributes
    ----------
    values
        Disturbances in the model's order (steps, 10).
    day
        Number of the step's day, from 0 at the first (steps,).
    hour
        Hour on the local clock at its start [h] (steps,).
    notes
        What was filled.
    """

    values: FloatArray
    day: IntArray
    hour: FloatArray
    notes: tuple[str, ...]

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.day.size

    def of(self, name: str) -> FloatArray:
        """A column by its public name (steps,)."""
        return self.values[:, COLUMNS.index(name)]


def outdoors(archive: Archive, clock: str, co2_ppm: float) -> Outdoors:
    """Weather over the days of the archive, from midnight to midnight on ``clock``, with ``co2_ppm`` outside.

    What was read at a time holds for the five minutes after it; a step has their means. Gaps are filled linearly. The hour
    that summer time skips does not exist, whatever the archive has in its rows; the hour that comes twice is read twice.

    The sky's temperature follows from the net long-wave radiation of the pyrgeometer, whose own temperature is the air's:
    sigma Tsky^4 = sigma Tout^4 + Pyrgeo.

    Raises
    ------
    ArchiveError
        When more than ``LONGEST_GAP_HOURS`` are missing at once, or the weather does not reach over all days.
    """
    begin, end = (to_utc_seconds(archive.first + dt.timedelta(days=days), clock) for days in (0, archive.days))
    readings = np.arange(begin, end, _ROW_SECONDS, dtype=np.int64)
    numbers = (readings + utc_offsets(readings, clock)) // _ROW_SECONDS + _EPOCH * ROWS_A_DAY
    places = np.minimum(np.searchsorted(archive.weather.rows, numbers), archive.weather.rows.size - 1)
    has_row = archive.weather.rows[places] == numbers
    radiation, temperature, humidity, wind, net = (
        np.where(has_row, archive.weather.columns[name][places], np.nan) for name in WEATHER
    )
    missing = np.isnan(radiation + temperature + humidity + wind + net)
    notes = _check(archive.weather, missing, numbers)
    present = np.flatnonzero(~missing)
    radiation, temperature, humidity, wind, net = (
        np.interp(np.arange(values.size), present, values[present])
        for values in (radiation, temperature, humidity, wind, net)
    )
    sky = STEFAN_BOLTZMANN * (temperature + KELVIN) ** 4 + net
    vapour = vapour_pressure(temperature, np.minimum(humidity, 100.0))
    radiation, temperature, vapour, wind, sky = (
        values.reshape(-1, STEP_SECONDS // _ROW_SECONDS).mean(axis=1)
        for values in (np.maximum(radiation, 0.0), temperature, vapour, wind, sky)
    )
    times = np.arange(begin, end, STEP_SECONDS, dtype=np.int64)
    local = times + utc_offsets(times, clock)
    day = local // _DAY_SECONDS - int(local[0] // _DAY_SECONDS)
    sums = np.bincount(day, weights=radiation) * STEP_SECONDS * 1e-6
    light = (radiation > 0.0).astype(np.float64)
    columns = {
        "iGlob": radiation,
        "tOut": temperature,
        "vpOut": vapour,
        "co2Out": co2_density(temperature, co2_ppm),
        "wind": wind,
        "tSky": (sky / STEFAN_BOLTZMANN) ** 0.25 - KELVIN,
        "tSoOut": soil_temperature(seconds_into_year(times.astype(np.float64))),
        # The last three serve controllers only; no equation of the model reads them.
        "dayRadSum": sums[day],
        "isDay": light,
        "isDaySmooth": light,
    }
    values = np.column_stack([columns[name] for name in COLUMNS])
    return Outdoors(values, day, (local % _DAY_SECONDS) / 3600.0, notes)


def _check(weather: Weather, missing: np.ndarray[tuple[int], np.dtype[np.bool_]], numbers: IntArray) -> tuple[str, ...]:
    """What is filled, in words; refuses what is too much."""
    if not missing.any():
        return ()
    begin, length = longest(missing)
    hours = length * _ROW_SECONDS / 3600.0
    if hours > LONGEST_GAP_HOURS:
        msg = (
            f"{weather.source}: the weather of {hours:.1f} h is missing from {moment(int(numbers[begin]))}; at most "
            f"{LONGEST_GAP_HOURS} h are filled. Complete {', '.join(WEATHER)} there, or cut the compartments' days."
        )
        raise ArchiveError(msg)
    return (
        f"{weather.source.name}: {missing.sum():,} of {missing.size:,} rows filled linearly; the longest gap, {length * 5} min, "
        f"begins {moment(int(numbers[begin]))}.",
    )
