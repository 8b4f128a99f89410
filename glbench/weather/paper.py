"""The preprocessing ``paper``: what the published benchmark did with KNMI's hourly figures.

Every value of slot HH, sums and means included, is placed at the **start** of the slot and runs linearly to the next; the
sky temperature is found at those hourly nodes with cloud = N/9 and runs linearly too. Humidity, CO2, soil temperature, the
day flags and the day's radiation sum are found on the resulting 5-minute grid, and all ten columns are taken to the control
step by monotone cubic interpolation (PCHIP). Clock and calendar are UTC.

Three things follow the recommended reading instead of the published code: the control grid is exact (not stretched by 0.02 %),
the day's radiation sum belongs to its whole calendar day, and overlapping day-flag ramps look at the unedited flag.
"""

from __future__ import annotations

import numpy as np

from glbench.errors import WeatherError
from glbench.weather import preprocessing
from glbench.weather.record import RAW_SECONDS, SLOT_SECONDS, FloatArray, WeatherRecord, utc_text

VERSION = 1
NODES_PER_SLOT = SLOT_SECONDS // RAW_SECONDS
DAY_SECONDS = 86400
RADIATION_FLOOR = 1e-10  # W m-2; smaller values after resampling are rounding and become 0


def prepare(record: WeatherRecord, window: preprocessing.Window) -> preprocessing.Prepared:
    """Disturbances of ``window`` as the published pipeline makes them; row k is the value at the start of step k.

    Raises ``WeatherError`` when a calendar day (UTC) of the window is only partly in the record: its radiation sum would be wrong.
    """
    first_day = window.start // DAY_SECONDS * DAY_SECONDS
    after = -(-window.end // DAY_SECONDS) * DAY_SECONDS
    if first_day < record.begin or after > record.end:
        day = first_day if first_day < record.begin else after - DAY_SECONDS
        msg = (
            f"Weather '{record.name}' covers {record.period}: it holds only a part of the day {utc_text(day)[:10]}, "
            "so that day's radiation sum is unknown. Start a day later, or end a day earlier."
        )
        raise WeatherError(msg)
    # The whole days of the window and one day on either side are read, as far as the record goes.
    first_slot = int(max(0, (first_day - DAY_SECONDS - record.begin) // SLOT_SECONDS))
    last_slot = int(min(record.hours, -(-(after + DAY_SECONDS - record.begin) // SLOT_SECONDS)))
    grid = _five_minute_grid(record, first_slot, last_slot, window.co2_ppm)
    since = window.times - (record.begin + first_slot * SLOT_SECONDS)
    index, rest = np.divmod(since, RAW_SECONDS)
    if rest.any():
        from scipy.interpolate import PchipInterpolator

        # In units of the grid step, so that a node is met exactly; PCHIP passes through its nodes.
        between = PchipInterpolator(np.arange(grid.shape[0], dtype=np.float64), grid, axis=0)
        values = np.asarray(between(since / RAW_SECONDS), dtype=np.float64)
    else:
        values = grid[index]
    radiation = values[:, 0]
    radiation[radiation < RADIATION_FLOOR] = 0.0
    return preprocessing.Prepared(values, first_slot, last_slot)


def _five_minute_grid(record: WeatherRecord, first_slot: int, last_slot: int, co2_ppm: float) -> FloatArray:
    """The ten columns every 5 minutes from the start of ``first_slot`` to the end of ``last_slot`` inclusive."""

    def line(hourly: FloatArray) -> FloatArray:
        # The node after the last slot belongs to the next slot; at the record's very end the last value is held.
        here, later = hourly[:-1, None], hourly[1:, None]
        return np.append((here + (later - here) * (np.arange(NODES_PER_SLOT) / NODES_PER_SLOT)).ravel(), hourly[-1])

    def column(name: str) -> FloatArray:
        hourly = record.values(name, first_slot, last_slot + 1)
        return hourly if last_slot < record.hours else np.append(hourly, hourly[-1])

    temperature_hourly = column("air_temperature")
    radiation = line(column("global_radiation"))
    temperature = line(temperature_hourly)
    times = record.begin + first_slot * SLOT_SECONDS + RAW_SECONDS * np.arange(radiation.size, dtype=np.int64)
    days = times // DAY_SECONDS
    days -= days[0]
    edges_before_record = first_slot * NODES_PER_SLOT
    is_day, is_day_smooth = day_flags(radiation > 0.0, edges_before_record, record.hours * NODES_PER_SLOT - edges_before_record)
    return np.column_stack(
        [
            radiation,
            temperature,
            preprocessing.vapour_pressure(temperature, line(column("relative_humidity"))),
            preprocessing.co2_density(temperature, co2_ppm),
            line(column("wind_speed")),
            line(preprocessing.sky_temperature(record, column, temperature_hourly, overcast=9.0)),
            preprocessing.soil_temperature(preprocessing.seconds_into_year(times.astype(np.float64))),
            (np.bincount(days, weights=radiation) * RAW_SECONDS * 1e-6)[days],  # of each node's calendar day (UTC)
            is_day,
            is_day_smooth,
        ]
    )


def day_flags(light: np.ndarray, offset: int = 0, raw_samples: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Day flag with linear and with sigmoid dusk and dawn, from ``light`` (n,) on the 5-minute grid.

    At every edge of ``light`` (unedited), one hour of samples around it is replaced by a ramp; a later edge overrides an
    earlier one. Edges in the first and last hour of the raw data are left alone. ``offset`` is the index of ``light[0]`` in
    the raw data, and ``raw_samples`` the number of raw samples from ``light[0]`` on (default: ``light`` is all of it).
    """
    flag = light.astype(np.float64)
    n = NODES_PER_SLOT
    ramp = np.linspace(0.0, 1.0, n)
    edges = np.flatnonzero(light[1:] != light[:-1])
    last = (light.size if raw_samples is None else raw_samples) - n
    edges = edges[(edges + offset >= n) & (edges < last) & (edges >= n // 2) & (edges + n // 2 <= light.size)]
    rising = light[edges + 1]
    where = (edges[:, None] + np.arange(-(n // 2), n // 2)).ravel()
    linear, smooth = flag.copy(), flag.copy()
    linear[where] = np.where(rising[:, None], ramp, 1.0 - ramp).ravel()
    smooth[where] = np.where(rising[:, None], preprocessing.sigmoid(ramp), 1.0 - preprocessing.sigmoid(ramp)).ravel()
    return linear, smooth
