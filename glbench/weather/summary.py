"""Monthly means and sums of a record, for people to check a record against a climate table."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from glbench.errors import WeatherError
from glbench.weather.preprocessing import saturation_vapour_pressure
from glbench.weather.record import SLOT_SECONDS, WeatherRecord

UNITS: Mapping[str, str] = {
    "hours": "h",
    "air_temperature_mean": "degC",
    "air_temperature_min": "degC",
    "air_temperature_max": "degC",
    "relative_humidity_mean": "%",
    "vapour_pressure_deficit_mean": "kPa",
    "wind_speed_mean": "m/s",
    "radiation_mean": "W/m2",
    "radiation_sum": "MJ/m2",
    "daily_light_integral_mean": "mol/m2/d",
    "cloud_cover_mean": "octants",
    "sky_infrared_mean": "W/m2",
}
"""Unit of every number in ``Month``."""


PHOTONS_PER_JOULE = 0.5 * 4.6
"""Photons of PAR for each joule of global radiation [umol J-1]: half of it is PAR, with 4.6 umol J-1. Vanthoor (2011), tables 8.1 and 9.1,
as in the greenhouse model."""


@dataclass(frozen=True)
class Month:
    """One calendar month (UTC) of a record; ``None`` where the record has no such column. Units in ``UNITS``.

    The vapour pressure deficit (VPD) is that of the outside air, (1 - RH/100) x saturation pressure; the daily light integral (DLI)
    counts the photons of PAR outside.
    """

    month: str
    hours: int
    air_temperature_mean: float
    air_temperature_min: float
    air_temperature_max: float
    relative_humidity_mean: float
    vapour_pressure_deficit_mean: float
    wind_speed_mean: float
    radiation_mean: float
    radiation_sum: float
    daily_light_integral_mean: float
    cloud_cover_mean: float | None
    sky_infrared_mean: float | None


def monthly(record: WeatherRecord, only: str | None = None) -> list[Month]:
    """Means and sums of every month; ``only`` keeps one (``"2010-03"``) or the same one of every year (``"3"``).

    A slot belongs to the month in which it begins.

    Raises
    ------
    WeatherError
        When ``only`` is no month, or not in the record.
    """
    starts = record.begin + SLOT_SECONDS * np.arange(record.hours, dtype=np.int64)
    months = starts.astype("datetime64[s]").astype("datetime64[M]")
    names, first = np.unique(months, return_index=True)
    bounds = [*first.tolist(), record.hours]
    rows = [
        _month(record, str(name), bounds[i], bounds[i + 1]) for i, name in enumerate(names) if _wanted(str(name), only)
    ]
    if not rows:
        msg = f"Weather '{record.name}' covers {record.period}: it has no month '{only}'. Use 1 to 12, or a month such as 2010-03."
        raise WeatherError(msg)
    return rows


def _wanted(name: str, only: str | None) -> bool:
    if only is None:
        return True
    if re.fullmatch(r"0?[1-9]|1[0-2]", only):
        return int(name[5:]) == int(only)
    return name == only


def _month(record: WeatherRecord, name: str, first: int, last: int) -> Month:
    def mean(column: str) -> float | None:
        return float(record.values(column, first, last).mean()) if column in record.counts else None

    temperature = record.values("air_temperature", first, last)
    humidity = record.values("relative_humidity", first, last)
    # Of every hour, then the mean: the deficit of the mean hour would be smaller.
    deficit = saturation_vapour_pressure(temperature) * (1.0 - humidity / 100.0)
    energy = int(record.counts["global_radiation"][first:last].sum())
    cloud = np.minimum(record.values("cloud_cover", first, last), 8.0) if "cloud_cover" in record.counts else None
    return Month(
        month=name,
        hours=last - first,
        air_temperature_mean=float(temperature.mean()),
        air_temperature_min=float(temperature.min()),
        air_temperature_max=float(temperature.max()),
        relative_humidity_mean=float(humidity.mean()),
        vapour_pressure_deficit_mean=float(deficit.mean()) * 1e-3,
        wind_speed_mean=float(record.values("wind_speed", first, last).mean()),
        radiation_mean=energy / (SLOT_SECONDS * (last - first)),
        radiation_sum=energy * 1e-6,
        daily_light_integral_mean=PHOTONS_PER_JOULE * 1e-6 * energy * 24.0 / (last - first),
        cloud_cover_mean=None if cloud is None else float(cloud.mean()),
        sky_infrared_mean=mean("sky_infrared"),
    )
