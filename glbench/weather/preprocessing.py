"""What both preprocessings share: the window of steps that is asked for, clocks, and the small physics of outside air and sky.

Every function of the physics takes numpy arrays (or floats) and returns arrays of the same shape; its constants are the greenhouse model's.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from glbench.errors import WeatherError, refuse
from glbench.weather.record import FloatArray, IntArray, WeatherRecord, time_zone

COLUMNS = ("iGlob", "tOut", "vpOut", "co2Out", "wind", "tSky", "tSoOut", "dayRadSum", "isDay", "isDaySmooth")
SLOPE = 10.0  # Steepness of the sigmoid that rounds the day flag's ramps
EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
OFFSET_SECONDS = 900  # Clocks change at whole quarters of an hour (UTC), so the offset needs to be looked up once a quarter
QUARTERS_OF_A_DAY = 86400 // OFFSET_SECONDS
KELVIN = 273.15
STEFAN_BOLTZMANN = 5.67e-8  # W m-2 K-4, as the cloud correlation was published
STEFAN_BOLTZMANN_ENERGYPLUS = 5.6697e-8  # W m-2 K-4, as EnergyPlus turns sky infrared into a temperature
GAS_CONSTANT = 8.3144598  # J mol-1 K-1
MOLAR_MASS_CO2 = 44.01e-3  # kg mol-1
PRESSURE = 101325.0  # Pa
COMMON_YEAR_SECONDS = 365.0 * 86400.0


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


def to_utc_seconds(start: dt.datetime | dt.date, clock: str) -> int:
    """Seconds since 1970-01-01 UTC of ``start``; without a time zone of its own it is read on ``clock`` (an IANA name).

    Raises ``WeatherError`` when ``start`` is not a whole second, or names an hour that the clock skips or strikes twice.
    """
    moment = start if isinstance(start, dt.datetime) else dt.datetime.combine(start, dt.time())
    if moment.microsecond:
        refuse(f"The start must be a whole second, not {moment.isoformat()}.", WeatherError)
    if moment.tzinfo is None:
        zone = time_zone(clock)
        early, late = (moment.replace(tzinfo=zone, fold=fold) for fold in (0, 1))
        if early.utcoffset() != late.utcoffset():
            skipped = early.astimezone(dt.UTC).astimezone(zone).replace(tzinfo=None) != moment
            msg = (
                f"The clock of {clock} {'skips' if skipped else 'strikes twice'} {moment.isoformat(sep=' ')} "
                "(summer time begins or ends). Give the start as a datetime with a time zone, such as UTC."
            )
            raise WeatherError(msg)
        moment = early
    return int((moment - EPOCH) // dt.timedelta(seconds=1))


def utc_offsets(times: IntArray, clock: str) -> IntArray:
    """Seconds by which ``clock`` is ahead of UTC at each of ``times`` (seconds since 1970), the same shape."""
    quarters = times // OFFSET_SECONDS
    days, which = np.unique(quarters // QUARTERS_OF_A_DAY, return_inverse=True)
    if not days.size:
        return np.empty(np.shape(times), dtype=np.int64)
    offsets = np.stack([_offsets_of_day(int(day), clock) for day in days])
    return np.asarray(offsets[which.reshape(np.shape(times)), quarters % QUARTERS_OF_A_DAY])


@lru_cache(maxsize=4096)
def _offsets_of_day(day: int, clock: str) -> IntArray:
    """Seconds by which ``clock`` is ahead of UTC at each quarter of an hour of the day (UTC) ``day`` days after 1970-01-01, (96,)."""
    zone = time_zone(clock)
    quarters = range(day * QUARTERS_OF_A_DAY, (day + 1) * QUARTERS_OF_A_DAY)
    moments = (dt.datetime.fromtimestamp(quarter * OFFSET_SECONDS, tz=zone) for quarter in quarters)
    ahead = [int((moment.utcoffset() or dt.timedelta()).total_seconds()) for moment in moments]
    offsets = np.array(ahead, dtype=np.int64)
    offsets.setflags(write=False)
    return offsets


def clock_time(window: Window, clock: str) -> tuple[FloatArray, FloatArray]:
    """Hour of day (steps,) [h, 0..24) and day of year (steps,) [d, 0.0 at 1 January 00:00 of the year it is] on ``clock``."""
    local = window.times + utc_offsets(window.times, clock)
    hour_of_day = (local % 86400) / 3600.0
    year_begin = local.astype("datetime64[s]").astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64)
    return hour_of_day, (local - year_begin) / 86400.0


def saturation_vapour_pressure(temperature: FloatArray) -> FloatArray:
    """Saturation vapour pressure [Pa] at ``temperature`` [degC]. Magnus form of the GreenLight model."""
    return np.asarray(610.78 * np.exp(17.2694 * temperature / (temperature + 238.3)))


def vapour_pressure(temperature: FloatArray, relative_humidity: FloatArray) -> FloatArray:
    """Vapour pressure [Pa] of air at ``temperature`` [degC] and ``relative_humidity`` [%]."""
    return np.asarray(relative_humidity / 100.0 * saturation_vapour_pressure(temperature))


def co2_density(temperature: FloatArray, ppm: float | FloatArray) -> FloatArray:
    """CO2 density [mg m-3] of ``ppm`` at ``temperature`` [degC] and 101325 Pa (ideal gas; 731.82 for 400 ppm at 20)."""
    return np.asarray(1e6 * PRESSURE * 1e-6 * ppm * MOLAR_MASS_CO2 / (GAS_CONSTANT * (temperature + KELVIN)))


def sky_temperature_from_cloud(temperature: FloatArray, cloud_fraction: FloatArray) -> FloatArray:
    """Apparent sky temperature [degC] from air ``temperature`` [degC] and ``cloud_fraction`` [0..1].

    De Zwart (1996), eq. 5.22, 5.26 and 5.32: a clear sky radiates 213 + 5.5 t W m-2; cloud adds 84 % of a black body.
    """
    black_body = STEFAN_BOLTZMANN * (temperature + KELVIN) ** 4
    clear = (213.0 + 5.5 * temperature) / black_body
    emissivity = (1.0 - 0.84 * cloud_fraction) * clear + 0.84 * cloud_fraction
    return np.asarray(emissivity**0.25 * (temperature + KELVIN) - KELVIN)


def sky_temperature_from_infrared(infrared: FloatArray) -> FloatArray:
    """Apparent sky temperature [degC] from the sky's infrared radiation on the horizontal [W m-2] (EnergyPlus)."""
    return np.asarray((infrared / STEFAN_BOLTZMANN_ENERGYPLUS) ** 0.25 - KELVIN)


def sky_temperature(record: WeatherRecord, values: Callable[[str], FloatArray], temperature: FloatArray, *, overcast: float) -> FloatArray:
    """Apparent sky temperature [degC]: measured where the record has it, else from what it has.

    ``values`` gives the record's columns at the moments of the air ``temperature`` [degC]; ``overcast`` is a clouded sky's cover [octants].
    """
    if "sky_temperature" in record.counts:
        return values("sky_temperature")
    if "sky_infrared" in record.counts:
        return sky_temperature_from_infrared(values("sky_infrared"))
    return sky_temperature_from_cloud(temperature, values("cloud_cover") / overcast)


def soil_temperature(seconds_into_year: FloatArray) -> FloatArray:
    """Temperature [degC] of the soil 1 to 2 m deep: a yearly sine, 6.46 degC at the start of 1 January."""
    return np.asarray(10.0 + 5.0 * np.sin(2.0 * np.pi * (seconds_into_year / COMMON_YEAR_SECONDS + 0.625)))


def seconds_into_year(times: FloatArray) -> FloatArray:
    """Seconds since 1 January 00:00 UTC of each moment's own year; ``times`` in seconds since 1970."""
    moments = np.floor(times).astype(np.int64).astype("datetime64[s]")
    return np.asarray(times - moments.astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64))
