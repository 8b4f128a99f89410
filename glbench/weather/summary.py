"""What a person checks after an import: monthly means and sums, the record in a few figures, and whether its radiation fits the sun."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from glbench.errors import WeatherError, refuse
from glbench.weather.conserving import TWILIGHT_SINE
from glbench.weather.hourly import clear_sky_radiation
from glbench.weather.preprocessing import saturation_vapour_pressure
from glbench.weather.record import SLOT_SECONDS, WeatherRecord, time_zone

UNITS: Mapping[str, str] = {
    "hours": "h", "air_temperature_mean": "degC", "air_temperature_min": "degC", "air_temperature_max": "degC",
    "relative_humidity_mean": "%", "vapour_pressure_deficit_mean": "kPa", "wind_speed_mean": "m/s", "radiation_mean": "W/m2",
    "radiation_sum": "MJ/m2", "daily_light_integral_mean": "mol/m2/d", "cloud_cover_mean": "octants", "sky_infrared_mean": "W/m2",
}  # fmt: skip
"""Unit of every number in ``Month``."""
PHOTONS_PER_JOULE = 0.5 * 4.6
"""Photons of PAR for each joule of global radiation [umol J-1]: half of it is PAR, with 4.6 umol J-1. Vanthoor (2011), tables 8.1 and 9.1,
as in the greenhouse model."""
DAY_HOURS = 24
DARK_RADIATION = 10.0  # Radiation [W m-2] that no sun gives in an hour that lies wholly in the night; an idle sensor may be off by a few
FEW_HOURS = 5  # So many such hours say that something is wrong
CLOCK_DAYS, LEVEL_DAYS = 30, 10
"""Shortest records [d] that are compared with the course and with the level of a clear sky. In the shipped records no stretch of this
length gives a warning."""
HIGH_SUN = float(np.sin(np.radians(10.0)))
BRIGHTEST_LOW, USUAL_HIGH = 0.5, 1.45
"""Limits of the radiation over that of a clear sky, in hours of high sun: 2 % of them exceed the first even in ten dull days, and nine
tenths stay below the second."""
MOST_CLOCK_HOURS = 4.0  # Hours by which a clock may differ from the sun: 3.3 h in the west of China
HOTTEST_MEAN, WINDIEST_MEAN = 35.0, 14.0
"""Means of a record [degC, m s-1] above which the unit is doubted; no place on land has them for a month."""
STUCK_HOURS = 36  # Hours of the same temperature, or the same humidity below 100 %, after which a sensor is doubted


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

    A slot belongs to the month in which it begins. Raises ``WeatherError`` when ``only`` is no month, or not in the record.
    """
    starts = record.begin + SLOT_SECONDS * np.arange(record.hours, dtype=np.int64)
    months = starts.astype("datetime64[s]").astype("datetime64[M]")
    names, first = np.unique(months, return_index=True)
    bounds = [*first.tolist(), record.hours]
    if only is None:
        numbers = list(range(len(names)))
    elif re.fullmatch(r"0?[1-9]|1[0-2]", only):
        numbers = [i for i, name in enumerate(names) if int(str(name)[5:]) == int(only)]
    else:
        numbers = [i for i, name in enumerate(names) if str(name) == only]
    rows = [_month(record, str(names[i]), bounds[i], bounds[i + 1]) for i in numbers]
    if not rows:
        refuse(f"Weather '{record.name}' covers {record.period}: it has no month '{only}'. Use a month such as {names[0]}.", WeatherError)
    return rows


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
        month=name, hours=last - first, air_temperature_mean=float(temperature.mean()), air_temperature_min=float(temperature.min()),
        air_temperature_max=float(temperature.max()), relative_humidity_mean=float(humidity.mean()),
        vapour_pressure_deficit_mean=float(deficit.mean()) * 1e-3, wind_speed_mean=float(record.values("wind_speed", first, last).mean()),
        radiation_mean=energy / (SLOT_SECONDS * (last - first)), radiation_sum=energy * 1e-6,
        daily_light_integral_mean=PHOTONS_PER_JOULE * 1e-6 * energy * 24.0 / (last - first),
        cloud_cover_mean=None if cloud is None else float(cloud.mean()), sky_infrared_mean=mean("sky_infrared"),
    )  # fmt: skip


def in_figures(record: WeatherRecord) -> list[str]:
    """Figures of the whole record, one a line, for comparison with a climate table."""
    temperature = record.values("air_temperature")
    radiation = float(record.values("global_radiation").mean()) * DAY_HOURS * SLOT_SECONDS
    wind = record.values("wind_speed")
    return [
        f"air temperature: lowest {temperature.min():.1f} degC, mean {temperature.mean():.1f} degC, highest {temperature.max():.1f} degC",
        f"light, mean of a day: {radiation * 1e-4:.0f} J/cm2 of global radiation, {radiation * PHOTONS_PER_JOULE * 1e-6:.1f} mol/m2 of PAR",
        f"wind: mean {wind.mean():.1f} m/s, highest {wind.max():.1f} m/s",
    ]


def doubts(record: WeatherRecord) -> list[str]:
    """What about a record does not fit together, one a sentence or two; empty when nothing does.

    Its clock against its longitude, its radiation against the sun over the station, and the units and the sensors behind its values.
    """
    offset = time_zone(record.timezone).utcoffset(record.first.replace(month=1, tzinfo=None)) or dt.timedelta()
    ahead, sun = offset / dt.timedelta(hours=1), record.longitude / 15.0
    of_clock = (
        f"the clock {record.timezone} is {ahead:+g} h from UTC, but at {record.longitude:g} deg east the sun is {sun:+.1f} h from it. "
        "Is the zone that of another place, or the longitude's sign wrong (east is plus)?"
    )
    is_odd = abs((ahead - sun + 12.0) % 24.0 - 12.0) > MOST_CLOCK_HOURS
    return [*([of_clock] if is_odd else []), *_doubts_of_values(record), *_doubts_of_radiation(record)]


def _doubts_of_values(record: WeatherRecord) -> list[str]:
    temperature, humidity, wind = (record.values(name) for name in ("air_temperature", "relative_humidity", "wind_speed"))
    signs = []
    if temperature.mean() > HOTTEST_MEAN:
        signs.append(f"the mean temperature is {temperature.mean():.1f} degC. Is it in degrees Fahrenheit?")
    if humidity.max() <= 1.5:
        signs.append(f"the highest humidity is {humidity.max():g} %. Is it a fraction (0 to 1) instead of %?")
    if wind.mean() > WINDIEST_MEAN:
        signs.append(f"the mean wind is {wind.mean():.1f} m/s. Is it in km/h or knots?")
    for name, values in (("air_temperature", temperature), ("relative_humidity", np.where(humidity >= 100.0, np.nan, humidity))):
        changes = np.flatnonzero(np.concatenate([[True], np.diff(values) != 0, [True]]))
        longest = int(np.diff(changes).max())
        if longest >= STUCK_HOURS:
            signs.append(f"the {name.replace('_', ' ')} stays the same for {longest} h in a row. Did the sensor fail?")
    if record.first.year < 1950 or record.last > dt.datetime.now(dt.UTC) + dt.timedelta(days=366):
        signs.append(f"the record is of {record.period}. Are the years right?")
    return signs


def _doubts_of_radiation(record: WeatherRecord) -> list[str]:
    clear, highest = clear_sky_radiation(record.begin, record.hours, record.place)
    radiation = record.values("global_radiation")
    at_night = int(np.count_nonzero((highest < -TWILIGHT_SINE) & (radiation > DARK_RADIATION)))
    # By how many hours the course of a clear sky has to be late to fit the radiation best.
    shifts = range(-DAY_HOURS // 2, DAY_HOURS // 2 + 1)
    late = max(shifts, key=lambda shift: (float(radiation @ np.roll(clear, shift)), -abs(shift)))
    if at_night >= FEW_HOURS or (late != 0 and record.hours >= CLOCK_DAYS * DAY_HOURS):
        signs = [f"sun at night in {at_night} hours (more than {DARK_RADIATION:g} W/m2 in the dark)"] if at_night else []
        if late:
            signs.append(f"the radiation is {abs(late)} h {'late' if late > 0 else 'early'} for the sun")
        return [
            f"{'; '.join(signs)}, at {record.latitude:g} deg north, {record.longitude:g} deg east. Are the stamps local time instead of "
            "UTC, or the coordinates of another place? Write local stamps with their offset, such as 2024-05-01T03:00+02:00."
        ]
    high = highest > HIGH_SUN
    if record.hours < LEVEL_DAYS * DAY_HOURS or not high.any():
        return []
    share = radiation[high] / clear[high]
    brightest, usual = np.quantile(share, 0.98), np.quantile(share, 0.9)
    if brightest < BRIGHTEST_LOW:
        return [
            f"radiation is low: with a high sun, 98 % of the hours have less than {100 * brightest:.0f} % of what a clear sky gives. "
            "Is it in the unit of the column's title? J/cm2 taken for W/m2 makes it 0.36 of what it is."
        ]
    if usual > USUAL_HIGH:
        return [
            f"radiation is high: with a high sun, one hour in ten has more than {100 * usual:.0f} % of what a clear sky gives. "
            "Is it in the unit of the column's title? W/m2 taken for J/cm2 makes it 2.8 times what it is."
        ]
    return []
