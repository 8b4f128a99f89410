"""EnergyPlus EPW and NREL TMY files, read with pvlib.

Both stamp local standard time. Radiation is the sum over the hour before the stamp; temperature, humidity, wind and cloud are
instants at the stamp; the sky's infrared radiation in EPW is a sum over the hour. Codes for "missing" become gaps.

**Typical years.** A TMY, and an EPW made from one, joins months of different years. Such a file gets one nominal common year.
Because a typical year is a circle, the few hours that local time and UTC differ by are turned over its end: the record is the
nominal year from 1 January 00:00 UTC, whole. An EPW whose rows all carry one year is taken as that year's own weather instead.
"""

from __future__ import annotations

import calendar
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from glbench.errors import WeatherError
from glbench.weather.assemble import Origin, Rows, assemble, check_order, require_columns
from glbench.weather.record import SLOT_SECONDS, FloatArray, IntArray, Place, Timing, WeatherRecord

if TYPE_CHECKING:
    import pandas as pd

NOMINAL_YEAR = 2001
"""Year given to typical years: a common year, like every typical year."""
YEAR_HOURS = 8760
UNKNOWN_LICENCE = "Not stated in the file: ask its provider before you pass it on."
TIMING: Mapping[str, Timing] = {
    "air_temperature": "instant",
    "relative_humidity": "instant",
    "wind_speed": "instant",
    "cloud_cover": "instant",
    "global_radiation": "mean",
    "sky_infrared": "mean",
}
OCTANTS_PER_TENTH = 0.8
EPW_HEADER_LINES = 8
TMY3_HEADER_LINES = 2
TMY2_HEADER_LINES = 1
TMY3_COLUMNS = ("temp_air", "relative_humidity", "wind_speed", "ghi", "TotCld (tenths)")


@dataclass(frozen=True)
class _Local:
    """A file's rows in local standard time: calendar of each slot's start, values, place and clock."""

    file: str
    years: IntArray
    months: IntArray
    days: IntArray
    hours: IntArray
    columns: dict[str, FloatArray]
    row_numbers: IntArray
    utc_offset: float  # h
    station: str
    coordinates: tuple[float, float, float]
    source: str


def read_epw(
    path: Path | str,
    *,
    name: str | None = None,
    timezone: str | None = None,
    year: int | None = None,
    fill_gaps: int = 0,
) -> WeatherRecord:
    """Weather record of an EnergyPlus weather file.

    Parameters
    ----------
    path : Path or str
        The ``.epw`` file.
    name : str, optional
        Name of the record; the file's own name by default.
    timezone : str, optional
        IANA zone of the local clock. By default the file's fixed offset (``Etc/GMT-1``), which has no summer time.
    year : int, optional
        Nominal (common) year of a typical year; 2001 by default. Not for a file of one real year.
    fill_gaps : int
        Fill up to so many missing hours in a row linearly (recorded in the notes); 0 fills nothing.

    Raises
    ------
    WeatherError
        When the file is no EPW, or has gaps or impossible values; names file, row and value.
    """
    path = Path(path)
    from pvlib.iotools import read_epw as pvlib_read_epw

    data, meta = _through_pvlib(path, "an EnergyPlus weather file (EPW)", lambda: pvlib_read_epw(str(path)))
    columns = {
        "air_temperature": _known(data["temp_air"], 99.9),
        "relative_humidity": _known(data["relative_humidity"], 999),
        "wind_speed": _known(data["wind_speed"], 999),
        "global_radiation": _known(data["ghi"], 9999),
        "cloud_cover": _known(data["total_sky_cover"], 99) * OCTANTS_PER_TENTH,
        "sky_infrared": _known(data["ghi_infrared"], 9999),
    }
    years = _whole(data["year"])
    typical = np.unique(years).size > 1
    if year is not None and not typical:
        msg = f"{path} holds the weather of one real year ({years[0]}): --year is only for typical years. Leave it out."
        raise WeatherError(msg)
    place_name = ", ".join(str(meta[key]).strip() for key in ("city", "country"))
    local = _Local(
        file=str(path),
        years=years,
        months=_whole(data["month"]),
        days=_whole(data["day"]),
        hours=_whole(data["hour"]) - 1,
        columns=columns,
        row_numbers=np.arange(len(data), dtype=np.int64) + EPW_HEADER_LINES + 1,
        utc_offset=meta["TZ"],
        station=place_name,
        coordinates=(meta["latitude"], meta["longitude"], meta["altitude"]),
        source=f"EnergyPlus weather file {path.name} ({place_name}; {str(meta['data_type']).strip()})",
    )
    return _record(local, name, timezone, (year or NOMINAL_YEAR) if typical else None, fill_gaps)


def read_tmy(
    path: Path | str,
    *,
    name: str | None = None,
    timezone: str | None = None,
    year: int | None = None,
    fill_gaps: int = 0,
) -> WeatherRecord:
    """Weather record of an NREL typical meteorological year: TMY3 (``.csv``) or TMY2 (``.tm2``).

    Parameters and errors as for ``read_epw``; a TMY is always a typical year.
    """
    path = Path(path)
    local = _read_tmy2(path) if path.suffix.lower() in (".tm2", ".tmy2") else _read_tmy3(path)
    return _record(local, name, timezone, year or NOMINAL_YEAR, fill_gaps)


def _read_tmy3(path: Path) -> _Local:
    from pvlib.iotools import read_tmy3

    data, meta = _through_pvlib(path, "a TMY3 file", lambda: read_tmy3(str(path), coerce_year=NOMINAL_YEAR))
    require_columns(str(path), [str(title) for title in data.columns], TMY3_COLUMNS)
    index = cast("pd.DatetimeIndex", data.index)
    if bool(np.any(index.minute != 0)):
        msg = f"{path}: its stamps are not whole hours, so it is unclear which hour a value belongs to. Use hour-ending TMY3."
        raise WeatherError(msg)
    starts = index.tz_localize(None) - np.timedelta64(1, "h")
    return _Local(
        file=str(path),
        years=np.asarray(starts.year, dtype=np.int64),
        months=np.asarray(starts.month, dtype=np.int64),
        days=np.asarray(starts.day, dtype=np.int64),
        hours=np.asarray(starts.hour, dtype=np.int64),
        columns={
            "air_temperature": _known(data["temp_air"], -9900),
            "relative_humidity": _known(data["relative_humidity"], -9900),
            "wind_speed": _known(data["wind_speed"], -9900),
            "global_radiation": _known(data["ghi"], -9900),
            "cloud_cover": _known(data["TotCld (tenths)"], -9900, 99) * OCTANTS_PER_TENTH,
        },
        row_numbers=np.arange(len(data), dtype=np.int64) + TMY3_HEADER_LINES + 1,
        utc_offset=meta["TZ"],
        station=str(meta["Name"]).strip().strip('"'),
        coordinates=(meta["latitude"], meta["longitude"], meta["altitude"]),
        source=f"NREL TMY3 {path.name}, station {meta['USAF']}",
    )


def _read_tmy2(path: Path) -> _Local:
    from pvlib.iotools import read_tmy2

    data, meta = _through_pvlib(path, "a TMY2 file", lambda: read_tmy2(str(path)))
    return _Local(
        file=str(path),
        years=_whole(data["year"]) + 1900,
        months=_whole(data["month"]),
        days=_whole(data["day"]),
        hours=_whole(data["hour"]) - 1,
        columns={
            "air_temperature": _known(data["DryBulb"], 9999) / 10.0,
            "relative_humidity": _known(data["RHum"], 999),
            "wind_speed": _known(data["Wspd"], 999) / 10.0,
            "global_radiation": _known(data["GHI"], 9999),
            "cloud_cover": _known(data["TotCld"], 99) * OCTANTS_PER_TENTH,
        },
        row_numbers=np.arange(len(data), dtype=np.int64) + TMY2_HEADER_LINES + 1,
        utc_offset=float(meta["TZ"]),
        station=str(meta["City"]).replace("_", " ").title(),
        coordinates=(meta["latitude"], meta["longitude"], meta["altitude"]),
        source=f"NREL TMY2 {path.name}, station {meta['WBAN']}",
    )


def _through_pvlib(
    path: Path, what: str, read: Callable[[], tuple[pd.DataFrame, dict[str, Any]]]
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """What pvlib reads, with its many ways of failing turned into one sentence."""
    try:
        data, meta = read()
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        msg = f"{path} cannot be read as {what}: {error}. Check the path and the file, or choose another --format."
        raise WeatherError(msg) from error
    if data.empty:
        msg = f"{path} holds no hourly values. Is it the right file, and whole?"
        raise WeatherError(msg)
    return data, meta


def _known(column: pd.Series[Any], *missing: float) -> FloatArray:
    """Values with the codes for "missing" turned into NaN; a text that is no number is a missing value too."""
    import pandas as pd

    values = pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64, copy=True)
    values[np.isin(values, missing)] = np.nan
    return values


def _whole(column: pd.Series[Any]) -> IntArray:
    return np.asarray(column.to_numpy(dtype=np.int64))


def _record(
    local: _Local, name: str | None, timezone: str | None, nominal_year: int | None, fill_gaps: int
) -> WeatherRecord:
    starts = _starts(local, nominal_year)
    rows = Rows(local.file, starts + SLOT_SECONDS, local.columns, TIMING, local.row_numbers)
    if nominal_year is not None:
        rows = _turned(rows, nominal_year, fill_gaps)
    latitude, longitude, altitude = local.coordinates
    place = Place(local.station, latitude, longitude, altitude, timezone or _fixed_zone(local.file, local.utc_offset))
    notes = (
        () if nominal_year is None else (f"typical year, its months from different years; all named {nominal_year}",)
    )
    origin = Origin(
        name or Path(local.file).stem.lower(), place, local.source, UNKNOWN_LICENCE, nominal_year is not None, notes
    )
    return assemble(rows, origin, fill_gaps=fill_gaps)


def _starts(local: _Local, nominal_year: int | None) -> IntArray:
    """Start of each slot [s since 1970-01-01 UTC], in the nominal year where one is given."""
    if nominal_year is not None and calendar.isleap(nominal_year):
        msg = f"{nominal_year} is a leap year and a typical year has no 29 February. Choose a common year with --year."
        raise WeatherError(msg)
    years = local.years if nominal_year is None else np.full_like(local.years, nominal_year)
    starts = np.empty(years.size, dtype=np.int64)
    for i, (year, month, day, hour) in enumerate(zip(years, local.months, local.days, local.hours, strict=True)):
        if not (1 <= month <= 12 and 1 <= day <= calendar.monthrange(int(year), int(month))[1] and 0 <= hour <= 23):
            row = local.row_numbers[i]
            msg = f"{local.file}, row {row}: {year}-{month:02d}-{day:02d}, hour {hour + 1} does not exist. Correct the file."
            raise WeatherError(msg)
        starts[i] = calendar.timegm((int(year), int(month), int(day), int(hour), 0, 0))
    return starts - round(local.utc_offset * SLOT_SECONDS)


def _turned(rows: Rows, year: int, fill_gaps: int) -> Rows:
    """The whole typical year from 1 January 00:00 UTC: hours that UTC puts outside the year re-enter at its other end."""
    check_order(rows)
    if rows.slot_ends.size != YEAR_HOURS and fill_gaps == 0:
        msg = (
            f"{rows.file} holds {rows.slot_ends.size} hours instead of the {YEAR_HOURS} of a typical year. Get the whole file, "
            "or import with --fill-gaps N if single hours are missing."
        )
        raise WeatherError(msg)
    begin = calendar.timegm((year, 1, 1, 0, 0, 0))
    ends = begin + (rows.slot_ends - begin - 1) % (YEAR_HOURS * SLOT_SECONDS) + 1
    order = np.argsort(ends, kind="stable")
    columns = {name: values[order] for name, values in rows.columns.items()}
    return Rows(rows.file, ends[order], columns, rows.timing, rows.row_numbers[order])


def _fixed_zone(file: str, utc_offset: float) -> str:
    """IANA name of a fixed offset [h]; in these names east of Greenwich is minus."""
    if utc_offset != int(utc_offset) or not -12 <= utc_offset <= 14:
        msg = (
            f"{file}: its clock is {utc_offset:+g} h from UTC, which has no fixed IANA zone. Give one with --timezone."
        )
        raise WeatherError(msg)
    return f"Etc/GMT{-int(utc_offset):+d}" if utc_offset else "Etc/GMT"
