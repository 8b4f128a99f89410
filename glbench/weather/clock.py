"""Clocks: from a start in words to seconds in UTC, and back to hour of day and day of year."""

from __future__ import annotations

import datetime as dt
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from glbench.errors import WeatherError
from glbench.weather.preprocessing import Window
from glbench.weather.record import FloatArray, IntArray

EPOCH = dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
OFFSET_SECONDS = 900
"""Clocks change at whole quarters of an hour (UTC), so the offset needs to be looked up once a quarter."""


def time_zone(name: str) -> ZoneInfo:
    """IANA time zone ``name``.

    Raises
    ------
    WeatherError
        When the time-zone database has no such zone.
    """
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        msg = f"'{name}' is no time zone of the IANA database. Use a name such as Europe/Amsterdam or Etc/GMT-1."
        raise WeatherError(msg) from error


def to_utc_seconds(start: dt.datetime | dt.date, clock: str) -> int:
    """Seconds since 1970-01-01 UTC of ``start``; without a time zone of its own it is read on ``clock`` (an IANA name).

    Raises
    ------
    WeatherError
        When ``start`` is not a whole second, or names an hour that the clock skips or strikes twice.
    """
    moment = start if isinstance(start, dt.datetime) else dt.datetime.combine(start, dt.time())
    if moment.microsecond:
        msg = f"The start must be a whole second, not {moment.isoformat()}."
        raise WeatherError(msg)
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
    zone = time_zone(clock)
    quarters, which = np.unique(times // OFFSET_SECONDS, return_inverse=True)
    offsets = [_offset(int(q) * OFFSET_SECONDS, zone) for q in quarters]
    return np.asarray(offsets, dtype=np.int64)[which]


def _offset(seconds: int, zone: ZoneInfo) -> int:
    offset = dt.datetime.fromtimestamp(seconds, tz=zone).utcoffset()
    return int(offset.total_seconds()) if offset is not None else 0


def clock_time(window: Window, clock: str) -> tuple[FloatArray, FloatArray]:
    """Hour of day (steps,) [h, 0..24) and day of year (steps,) [d, 0.0 at 1 January 00:00 of the year it is] on ``clock``."""
    local = window.times + utc_offsets(window.times, clock)
    hour_of_day = (local % 86400) / 3600.0
    year_begin = local.astype("datetime64[s]").astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64)
    return hour_of_day, (local - year_begin) / 86400.0
