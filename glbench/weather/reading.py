"""From what a reader took out of a weather file to a record: its place, its clock, its year, and estimates of what it leaves out.

A reader gives a ``Reading``: rows on the file's own clock, which is a fixed offset ahead of UTC, and what the file says of its place.
``record_of`` makes the record.

**Typical years.** A typical year joins months of different years. It gets one nominal common year. Because a typical year is a circle,
the few hours that local time and UTC differ by are turned over its end: the record is the nominal year from 1 January 00:00 UTC, whole.
A file whose rows all carry one year is taken as that year's own weather instead.
"""

from __future__ import annotations

import calendar
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from glbench.errors import WeatherError, refuse
from glbench.outside_tables import DAY, HOUR, TextTable, parse_number, step_of
from glbench.untrusted import visible
from glbench.weather import record
from glbench.weather.hourly import hourly_record
from glbench.weather.preprocessing import saturation_vapour_pressure

NOMINAL_YEAR = 2001  # Year given to typical years: a common year, like every typical year
YEAR_DAYS = 365
UNKNOWN_LICENCE = "Not stated in the file: ask its provider before you pass it on."
TIMING: Mapping[str, record.Timing] = {**record.USUAL_TIMING, "wind_speed": "instant"}
"""Of files whose stamps are moments: all but radiation are instants at the stamp."""
MEANS: Mapping[str, record.Timing] = dict.fromkeys(record.USUAL_TIMING, "mean")
OCTANTS_PER_TENTH = 0.8
_SEAM = 180 * DAY  # A jump of the stamps [s] that only the seam of two years makes
_FIXED_ZONES = {
    4.5: "Asia/Kabul",
    5.5: "Asia/Kolkata",
    5.75: "Asia/Kathmandu",
    6.5: "Asia/Yangon",
    8.75: "Australia/Eucla",
    9.5: "Australia/Darwin",
    -9.5: "Pacific/Marquesas",
}
"""Zones without summer time whose offset from UTC [h] is no whole hour."""


@dataclass(frozen=True)
class Reading:
    """A weather file as read: ``rows`` in canonical units, of any regular step from 5 to 60 minutes.

    The slots' ends are seconds since 1970-01-01 on the file's clock, which is ``utc_offset`` hours ahead of UTC; ``zone`` is the IANA name
    of the local clock. ``station``, ``source`` and ``licence`` are as in ``record.Origin``, ``coordinates`` degrees north and east, and
    metres above sea level. What the file does not say is ``None``. ``typical``: the file is known to be a typical year; otherwise the rows
    tell. ``notes`` are what was done to the figures.
    """

    rows: record.Rows
    station: str
    source: str
    coordinates: tuple[float | None, float | None, float | None]
    utc_offset: float = 0.0
    zone: str | None = None
    licence: str = UNKNOWN_LICENCE
    typical: bool = False
    notes: tuple[str, ...] = field(default=())


def record_of(
    reading: Reading,
    *,
    name: str,
    timezone: str | None = None,
    year: int | None = None,
    coordinates: record.Coordinates | None = None,
    fill_gaps: int = 0,
) -> record.WeatherRecord:
    """Checked hourly record called ``name`` of a file as read.

    ``timezone`` is the IANA zone of the local clock; by default what the file names, or its fixed offset from UTC, which has no summer
    time. ``year`` is the nominal (common) year of a typical year, 2001 by default, and not for weather of real years. ``coordinates`` are
    latitude [deg north], longitude [deg east] and altitude [m], instead of what the file says. Up to ``fill_gaps`` missing hours in a row
    are filled linearly (recorded in the notes). Raises ``WeatherError``, with file, row and value, when the place is unknown, an option
    does not fit, or the rows have gaps or impossible values.
    """
    rows, notes, file = reading.rows, list(reading.notes), reading.rows.file
    latitude, longitude, altitude = coordinates or reading.coordinates
    if latitude is None or longitude is None:
        msg = f"{file} does not say where it was measured. Give it with --place LATITUDE,LONGITUDE,ALTITUDE [deg north, deg east, m]."
        raise WeatherError(msg)
    if altitude is None:
        altitude = 0.0
        notes.append("the altitude is unknown: 0 m is taken")
    step = step_of(rows.slot_ends)
    dates = (rows.slot_ends - step).astype("datetime64[s]")
    typical = reading.typical or _joins_years(dates, step)
    if year is not None and not typical:
        years = sorted({int(number) + 1970 for number in dates.astype("datetime64[Y]").astype(np.int64)})
        what = f"one real year ({years[0]})" if len(years) == 1 else f"the real years {years[0]} to {years[-1]}"
        refuse(f"{file} holds the weather of {what}: --year is only for typical years. Leave it out.", WeatherError)
    if not -14 <= reading.utc_offset <= 14:
        msg = f"{file}: a clock that is {reading.utc_offset:g} h from UTC does not exist. Correct the time zone in the file's heading."
        raise WeatherError(msg)
    shift = round(reading.utc_offset * HOUR)
    if typical:
        rows, turned = _nominal_year(rows, dates, step, year or NOMINAL_YEAR, shift, fill_gaps)
        notes += turned
    else:
        rows = replace(rows, slot_ends=rows.slot_ends - shift)
    zone = timezone or reading.zone or _zone_of(reading, file, longitude, notes)
    place = record.Place(reading.station, latitude, longitude, altitude, zone)
    origin = record.Origin(name, place, reading.source, reading.licence, typical, tuple(notes))
    return hourly_record(rows, origin, fill_gaps=fill_gaps)


def _joins_years(dates: np.ndarray, step: int) -> bool:
    """Whether the slots beginning at ``dates`` are a typical year: months of several years, or a leap year without its 29 February."""
    months = dates.astype("datetime64[M]").astype(np.int64)
    calendar_months = months % 12
    jumps = np.diff(dates.astype(np.int64))
    seams = np.flatnonzero((jumps < 0) | (jumps > _SEAM))
    if seams.size:
        return bool(np.all(np.diff(calendar_months) >= 0) and np.all(np.diff(months)[seams] != 0))
    one_year = np.unique(months // 12).size == 1
    return bool(
        one_year and dates.size * step == YEAR_DAYS * DAY and calendar.isleap(int(months[0]) // 12 + 1970) and not _leap_days(dates).any()
    )


def _leap_days(dates: np.ndarray) -> np.ndarray:
    days = (dates.astype("datetime64[D]") - dates.astype("datetime64[M]").astype("datetime64[D]")).astype(np.int64)
    return np.asarray((dates.astype("datetime64[M]").astype(np.int64) % 12 == 1) & (days == 28))


def _nominal_year(rows: record.Rows, dates: np.ndarray, step: int, year: int, shift: int, fill_gaps: int) -> tuple[record.Rows, list[str]]:
    """The rows in the nominal ``year``, in UTC, turned so that they begin with the year; and notes."""
    if calendar.isleap(year):
        refuse(f"{year} is a leap year and a typical year has no 29 February. Choose a common year with --year.", WeatherError)
    notes = [f"typical year, its months from different years; all named {year}"]
    leap = _leap_days(dates)
    if leap.any():
        notes.append(f"29 February left out ({int(leap.sum())} rows): a typical year is a common year")
    months = dates.astype("datetime64[M]")
    within = (dates - months.astype("datetime64[s]")).astype(np.int64)
    nominal = np.datetime64(f"{year}-01", "M") + months.astype(np.int64) % 12
    ends = (nominal.astype("datetime64[s]").astype(np.int64) + within + step - shift)[~leap]
    numbers = rows.row_numbers[~leap]
    wrong = np.flatnonzero(np.diff(ends) <= 0)
    if wrong.size == 1 and ends[-1] < ends[0]:
        wrong = wrong[:0]  # the year is a circle: it may begin anywhere
    if wrong.size:
        i = int(wrong[0])
        here, before = (record.utc_text(int(moment) + shift)[5:] for moment in (ends[i + 1], ends[i]))
        problem = f"{here} appears twice" if here == before else f"{here} follows {before}; rows must be in order of time"
        refuse(f"{rows.file}, row {numbers[i + 1]}: {problem}. Correct the file or fetch it again.", WeatherError)
    if ends.size * step != YEAR_DAYS * DAY and fill_gaps == 0:
        count, whole = ("hours", YEAR_DAYS * 24) if step == HOUR else ("rows", YEAR_DAYS * DAY // step)
        msg = (
            f"{rows.file} holds {ends.size} {count} instead of the {whole} of a typical year. Get the whole file, "
            "or import with --fill-gaps N if single hours are missing."
        )
        raise WeatherError(msg)
    begin = calendar.timegm((year, 1, 1, 0, 0, 0))
    ends = begin + (ends - begin - 1) % (YEAR_DAYS * DAY) + 1
    order = np.argsort(ends, kind="stable")
    if ends.min() % HOUR:  # the slot over the end of the year serves both ends
        order = np.append(order, order[0])
    columns = {column: values[~leap][order] for column, values in rows.columns.items()}
    turned = ends[order]
    turned[1:] += YEAR_DAYS * DAY * (np.diff(turned) < 0)
    return record.Rows(rows.file, turned, columns, rows.timing, numbers[order]), notes


def _zone_of(reading: Reading, file: str, longitude: float, notes: list[str]) -> str:
    """Fixed zone of the file's clock, or of the longitude where the stamps are UTC."""
    offset = reading.utc_offset
    if offset == 0 and abs(longitude) > 7.5:
        offset = float(round(longitude / 15.0))
        zone = f"Etc/GMT{-int(offset):+d}"
        notes.append(
            f"the file names no local clock: {zone} ({offset:+g} h from UTC, from the longitude) is taken; name it with --timezone"
        )
        return zone
    if offset in _FIXED_ZONES:
        return _FIXED_ZONES[offset]
    if offset != int(offset) or not -12 <= offset <= 14:
        refuse(f"{file}: its clock is {offset:+g} h from UTC, which has no fixed IANA zone. Give one with --timezone.", WeatherError)
    # In the names of fixed zones east of Greenwich is minus.
    return f"Etc/GMT{-int(offset):+d}" if offset else "Etc/GMT"


def humidity_of_dew_point(temperature: record.FloatArray, dew_point: record.FloatArray) -> record.FloatArray:
    """Relative humidity [%] of air at ``temperature`` with ``dew_point`` [degC], at most 100 %."""
    share = saturation_vapour_pressure(dew_point) / saturation_vapour_pressure(temperature)
    return np.asarray(np.minimum(100.0 * share, 100.0))


def humidity_of_daily_minimum(ends: record.IntArray, temperature: record.FloatArray) -> record.FloatArray:
    """Relative humidity [%] where nothing was measured: the dew point is taken as the day's lowest temperature (FAO-56, equation 48)."""
    _, day = np.unique((ends - 1) // DAY, return_inverse=True)
    lowest = np.full(int(day.max()) + 1, np.inf)
    np.fmin.at(lowest, day, temperature)
    return humidity_of_dew_point(temperature, lowest[day])


def without_constant_zero(columns: Mapping[str, record.FloatArray], names: Sequence[str], notes: list[str]) -> dict[str, record.FloatArray]:
    """The columns, those of ``names`` left out that are 0 in every row of a long file, as where nobody measured; said in ``notes``."""
    present = dict(columns)
    for name in names:
        values = present.get(name)
        if values is not None and values.size > 100 and not np.any(values[~np.isnan(values)]) and not np.isnan(values).all():
            del present[name]
            notes.append(f"{name.replace('_', ' ')} is 0 in every row, which is taken as missing")
    return present


def title_of(table: TextTable, *words: str) -> str | None:
    """The first title of the table that is one of ``words``, whatever its case, spaces, dashes and unit in brackets."""
    plain = {_plain(title): title for title in reversed(table.titles)}
    return next((plain[word] for word in map(_plain, words) if word in plain), None)


def needed_title(table: TextTable, *words: str) -> str:
    """As ``title_of``. Raises the table's refusal when there is none of them."""
    title = title_of(table, *words)
    if title is None:
        table.refuse(f"there is no column '{words[0]}', which is needed. It has: {visible(', '.join(table.titles)[:300])}.")
    return title


def _plain(title: str) -> str:
    return re.sub(r"[^a-z0-9]", "", re.sub(r"[\[(].*", "", title.lower()))


def humidity_column(
    table: TextTable,
    temperature: record.FloatArray,
    words: Sequence[str],
    dew_point_words: Sequence[str],
    missing: Sequence[float],
    notes: list[str],
) -> record.FloatArray:
    """Relative humidity [%] of a table; where it has no such column, or an empty one, from the dew point, which is said in ``notes``.

    ``temperature`` [degC] is that of the rows, ``missing`` the codes for no value.
    """
    title, dew_point = title_of(table, *words), title_of(table, *dew_point_words)
    values = table.numbers(title, missing) if title else np.full(temperature.size, np.nan)
    if dew_point and np.isnan(values).all():
        notes.append("relative humidity from the dew point")
        return humidity_of_dew_point(temperature, table.numbers(dew_point, missing))
    needed_title(table, *words)
    return values


def file_name(file: str) -> str:
    """The last part of a path."""
    return re.split(r"[/\\]", file)[-1]


def number_of(file: str, row: int, what: str, field: str) -> float:
    """Number of a field of the heading. Raises ``WeatherError`` that names row and value."""
    value = parse_number(field, "," if "," in field else ".")
    if value is None or not math.isfinite(value):
        refuse(f"{file}, row {row}: '{visible(field[:40])}' for the {what} is not a number. Correct the file.", WeatherError)
    return value
