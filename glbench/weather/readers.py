"""Readers of weather files: the format told from the content, the documented CSV, and EnergyPlus EPW and NREL TMY read with pvlib.

**Parquet**: glbench's own canonical table with its description, as ``glbench weather generate`` and ``save_weather`` write it.

**CSV**: a unit in every column's title, and the place in comment lines (docs/weather.md).

**EPW and TMY** stamp local standard time. Radiation is the sum over the hour before the stamp; temperature, humidity, wind and cloud are
instants at the stamp; the sky's infrared radiation in EPW is a sum over the hour. Codes for "missing" become gaps.

**Typical years.** A TMY, and an EPW made from one, joins months of different years. Such a file gets one nominal common year.
Because a typical year is a circle, the few hours that local time and UTC differ by are turned over its end: the record is the
nominal year from 1 January 00:00 UTC, whole. An EPW whose rows all carry one year is taken as that year's own weather instead.
"""

from __future__ import annotations

import calendar
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast, get_args

import numpy as np

from glbench.errors import UnknownNameError, WeatherError, did_you_mean
from glbench.untrusted import reason_of
from glbench.weather import record
from glbench.weather.column_map import EXPECTED_HEADER, guess_quantity, read_columns, read_csv
from glbench.weather.knmi import read_knmi
from glbench.weather.store import read_stored

if TYPE_CHECKING:
    import pandas as pd


NOMINAL_YEAR = 2001
"""Year given to typical years: a common year, like every typical year."""
YEAR_HOURS = 8760
UNKNOWN_LICENCE = "Not stated in the file: ask its provider before you pass it on."
TIMING: Mapping[str, record.Timing] = {**record.USUAL_TIMING, "wind_speed": "instant"}
OCTANTS_PER_TENTH = 0.8
EPW_HEADER_LINES = 8
TMY3_HEADER_LINES = 2
TMY2_HEADER_LINES = 1
_Sources = Mapping[str, tuple[str, float, tuple[float, ...]]]
"""Of each quantity: pvlib's name of its column, the factor to the canonical unit, and the codes for a missing value."""
EPW_COLUMNS: _Sources = {
    "air_temperature": ("temp_air", 1.0, (99.9,)),
    "relative_humidity": ("relative_humidity", 1.0, (999,)),
    "wind_speed": ("wind_speed", 1.0, (999,)),
    "global_radiation": ("ghi", 1.0, (9999,)),
    "cloud_cover": ("total_sky_cover", OCTANTS_PER_TENTH, (99,)),
    "sky_infrared": ("ghi_infrared", 1.0, (9999,)),
}
TMY3_COLUMNS: _Sources = {
    "air_temperature": ("temp_air", 1.0, (-9900,)),
    "relative_humidity": ("relative_humidity", 1.0, (-9900,)),
    "wind_speed": ("wind_speed", 1.0, (-9900,)),
    "global_radiation": ("ghi", 1.0, (-9900,)),
    "cloud_cover": ("TotCld (tenths)", OCTANTS_PER_TENTH, (-9900, 99)),
}
TMY2_COLUMNS: _Sources = {
    "air_temperature": ("DryBulb", 0.1, (9999,)),
    "relative_humidity": ("RHum", 1.0, (999,)),
    "wind_speed": ("Wspd", 0.1, (999,)),
    "global_radiation": ("GHI", 1.0, (9999,)),
    "cloud_cover": ("TotCld", OCTANTS_PER_TENTH, (99,)),
}
Format = Literal["knmi", "epw", "tmy", "csv", "parquet"]
FORMATS: tuple[Format, ...] = get_args(Format)
_HEAD_BYTES = 65536


@dataclass(frozen=True)
class _Local:
    """A file's rows in local standard time: calendar of each slot's start ``(n, 4)`` (year, month, day, hour), values, place, clock."""

    file: str
    calendar: record.IntArray
    columns: dict[str, record.FloatArray]
    row_numbers: record.IntArray
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
) -> record.WeatherRecord:
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
    place_name = ", ".join(str(meta[key]).strip() for key in ("city", "country"))
    local = _Local(
        file=str(path),
        calendar=_calendar(data),
        columns=_values_of(data, EPW_COLUMNS),
        row_numbers=_rows_after(EPW_HEADER_LINES, data),
        utc_offset=meta["TZ"],
        station=place_name,
        coordinates=(meta["latitude"], meta["longitude"], meta["altitude"]),
        source=f"EnergyPlus weather file {path.name} ({place_name}; {str(meta['data_type']).strip()})",
    )
    typical = np.unique(local.calendar[:, 0]).size > 1
    if year is not None and not typical:
        msg = f"{path} holds the weather of one real year ({local.calendar[0, 0]}): --year is only for typical years. Leave it out."
        raise WeatherError(msg)
    return _record(local, name, timezone, (year or NOMINAL_YEAR) if typical else None, fill_gaps)


def read_tmy(
    path: Path | str,
    *,
    name: str | None = None,
    timezone: str | None = None,
    year: int | None = None,
    fill_gaps: int = 0,
) -> record.WeatherRecord:
    """Weather record of an NREL typical meteorological year: TMY3 (``.csv``) or TMY2 (``.tm2``).

    Parameters and errors as for ``read_epw``; a TMY is always a typical year.
    """
    path = Path(path)
    if path.suffix.lower() in (".tm2", ".tmy2"):
        from pvlib.iotools import read_tmy2

        data, meta = _through_pvlib(path, "a TMY2 file", lambda: read_tmy2(str(path)))
        local = _Local(
            file=str(path),
            calendar=_calendar(data, first_year=1900),
            columns=_values_of(data, TMY2_COLUMNS),
            row_numbers=_rows_after(TMY2_HEADER_LINES, data),
            utc_offset=float(meta["TZ"]),
            station=str(meta["City"]).replace("_", " ").title(),
            coordinates=(meta["latitude"], meta["longitude"], meta["altitude"]),
            source=f"NREL TMY2 {path.name}, station {meta['WBAN']}",
        )
    else:
        from pvlib.iotools import read_tmy3

        data, meta = _through_pvlib(path, "a TMY3 file", lambda: read_tmy3(str(path), coerce_year=NOMINAL_YEAR))
        record.require_columns(
            str(path), [str(title) for title in data.columns], [column for column, *_ in TMY3_COLUMNS.values()]
        )
        index = cast("pd.DatetimeIndex", data.index)
        if bool(np.any(index.minute != 0)):
            msg = f"{path}: its stamps are not whole hours, so it is unclear which hour a value belongs to. Use hour-ending TMY3."
            raise WeatherError(msg)
        starts = index.tz_localize(None) - np.timedelta64(1, "h")
        local = _Local(
            file=str(path),
            calendar=np.stack([starts.year, starts.month, starts.day, starts.hour], axis=1).astype(np.int64),
            columns=_values_of(data, TMY3_COLUMNS),
            row_numbers=_rows_after(TMY3_HEADER_LINES, data),
            utc_offset=meta["TZ"],
            station=str(meta["Name"]).strip().strip('"'),
            coordinates=(meta["latitude"], meta["longitude"], meta["altitude"]),
            source=f"NREL TMY3 {path.name}, station {meta['USAF']}",
        )
    return _record(local, name, timezone, year or NOMINAL_YEAR, fill_gaps)


def _through_pvlib(
    path: Path, what: str, read: Callable[[], tuple[pd.DataFrame, dict[str, Any]]]
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """What pvlib reads, with its many ways of failing turned into one sentence."""
    try:
        data, meta = read()
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        msg = f"{path} cannot be read as {what}: {reason_of(error)}. Check the path and the file, or choose another --format."
        raise WeatherError(msg) from error
    if data.empty:
        msg = f"{path} holds no hourly values. Is it the right file, and whole?"
        raise WeatherError(msg)
    return data, meta


def _values_of(data: pd.DataFrame, sources: _Sources) -> dict[str, record.FloatArray]:
    """Columns in canonical units, with the codes for "missing" turned into NaN; a text that is not a number is a missing value too."""
    import pandas as pd

    columns = {}
    for quantity, (source, factor, missing) in sources.items():
        values = pd.to_numeric(data[source], errors="coerce").to_numpy(dtype=np.float64, copy=True)
        values[np.isin(values, missing)] = np.nan
        # Tenths are divided, as one correctly rounded operation.
        columns[quantity] = values / 10.0 if factor == 0.1 else values * factor
    return columns


def _calendar(data: pd.DataFrame, first_year: int = 0) -> record.IntArray:
    """Year, month, day and hour of each slot's start ``(n, 4)``, from columns whose hours count to the slot's end."""
    stamps: record.IntArray = data[["year", "month", "day", "hour"]].to_numpy(dtype=np.int64)
    return np.asarray(stamps + np.array([first_year, 0, 0, -1]), dtype=np.int64)


def _rows_after(header_lines: int, data: pd.DataFrame) -> record.IntArray:
    return np.arange(len(data), dtype=np.int64) + header_lines + 1


def _record(
    local: _Local, name: str | None, timezone: str | None, nominal_year: int | None, fill_gaps: int
) -> record.WeatherRecord:
    starts = _starts(local, nominal_year)
    rows = record.Rows(local.file, starts + record.SLOT_SECONDS, local.columns, TIMING, local.row_numbers)
    if nominal_year is not None:
        # The whole typical year from 1 January 00:00 UTC: hours that UTC puts outside the year re-enter at its other end.
        record.check_order(rows)
        if rows.slot_ends.size != YEAR_HOURS and fill_gaps == 0:
            msg = (
                f"{rows.file} holds {rows.slot_ends.size} hours instead of the {YEAR_HOURS} of a typical year. Get the whole file, "
                "or import with --fill-gaps N if single hours are missing."
            )
            raise WeatherError(msg)
        begin = calendar.timegm((nominal_year, 1, 1, 0, 0, 0))
        ends = begin + (rows.slot_ends - begin - 1) % (YEAR_HOURS * record.SLOT_SECONDS) + 1
        order = np.argsort(ends, kind="stable")
        columns = {column: values[order] for column, values in rows.columns.items()}
        rows = record.Rows(rows.file, ends[order], columns, rows.timing, rows.row_numbers[order])
    offset = local.utc_offset
    if not timezone and (offset != int(offset) or not -12 <= offset <= 14):
        msg = f"{local.file}: its clock is {offset:+g} h from UTC, which has no fixed IANA zone. Give one with --timezone."
        raise WeatherError(msg)
    # In the names of fixed zones east of Greenwich is minus.
    zone = timezone or (f"Etc/GMT{-int(offset):+d}" if offset else "Etc/GMT")
    latitude, longitude, altitude = local.coordinates
    place = record.Place(local.station, latitude, longitude, altitude, zone)
    notes = (
        () if nominal_year is None else (f"typical year, its months from different years; all named {nominal_year}",)
    )
    origin = record.Origin(
        name or Path(local.file).stem.lower(), place, local.source, UNKNOWN_LICENCE, nominal_year is not None, notes
    )
    return record.assemble(rows, origin, fill_gaps=fill_gaps)


def _starts(local: _Local, nominal_year: int | None) -> record.IntArray:
    """Start of each slot [s since 1970-01-01 UTC], in the nominal year where one is given."""
    if nominal_year is not None and calendar.isleap(nominal_year):
        msg = f"{nominal_year} is a leap year and a typical year has no 29 February. Choose a common year with --year."
        raise WeatherError(msg)
    starts = np.empty(len(local.calendar), dtype=np.int64)
    for i, (own_year, month, day, hour) in enumerate(local.calendar.tolist()):
        year = own_year if nominal_year is None else nominal_year
        if not (1 <= month <= 12 and 1 <= day <= calendar.monthrange(year, month)[1] and 0 <= hour <= 23):
            row = local.row_numbers[i]
            msg = f"{local.file}, row {row}: {year}-{month:02d}-{day:02d}, hour {hour + 1} does not exist. Correct the file."
            raise WeatherError(msg)
        starts[i] = calendar.timegm((year, month, day, hour, 0, 0))
    return starts - round(local.utc_offset * record.SLOT_SECONDS)


def read_weather(
    path: Path | str,
    file_format: str = "auto",
    *,
    name: str | None = None,
    timezone: str | None = None,
    year: int | None = None,
    station: int | None = None,
    coordinates: record.Coordinates | None = None,
    columns: Path | None = None,
    fill_gaps: int = 0,
) -> record.WeatherRecord:
    """Weather record of a file in any known format (``"auto"``: told from its content).

    ``year`` is for EPW and TMY, ``station`` for KNMI; see their readers. ``coordinates`` (degrees north, degrees east, m above sea level)
    go before those of the file. ``columns`` is the file of a column map, for tables that are in none of the formats.

    Raises
    ------
    UnknownNameError
        When there is no such format.
    WeatherError
        When the format cannot be told, an option does not belong to it, or its reader refuses the file.
    """
    path = Path(path)
    if columns is not None:
        return read_columns(path, columns, name=name, timezone=timezone, coordinates=coordinates, fill_gaps=fill_gaps)
    kind = detect_format(path) if file_format == "auto" else file_format
    if kind not in FORMATS:
        msg = f"There is no weather format '{kind}'.{did_you_mean(kind, ('auto', *FORMATS))}"
        raise UnknownNameError(msg)
    typical = kind in ("epw", "tmy")
    for option, value, fits in (
        ("--timezone", timezone, typical or kind == "csv"),
        ("--place", coordinates, kind == "csv"),
        ("--year", year, typical),
        ("--station", station, kind == "knmi"),
    ):
        if value is not None and not fits:
            msg = f"{path} is read as {kind}, which takes no {option}. Leave it out, or choose the --format."
            raise WeatherError(msg)
    if kind == "knmi":
        return read_knmi(path, name=name, station=station, fill_gaps=fill_gaps)
    if kind == "csv":
        return read_csv(path, name=name, timezone=timezone, coordinates=coordinates, fill_gaps=fill_gaps)
    if kind == "parquet":
        return read_stored(path, name)
    read = read_epw if kind == "epw" else read_tmy
    return read(path, name=name, timezone=timezone, year=year, fill_gaps=fill_gaps)


def detect_format(path: Path) -> Format:
    """Format of a weather file, from its first 64 KiB (and its suffix for zip archives and TMY2).

    Raises
    ------
    WeatherError
        When the file cannot be read, or is of no known format.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        msg = f"Cannot read {path}: {error.strerror or error}. Check the path."
        raise WeatherError(msg) from error
    text = head.decode("latin-1")
    if path.suffix.lower() in (".tm2", ".tmy2"):
        return "tmy"
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"PK") or re.search(r"STN\s*,\s*YYYYMMDD\s*,\s*HH?\s*,", text):
        return "knmi"
    if text.startswith("LOCATION,"):
        return "epw"
    if "Date (MM/DD/YYYY)" in text:
        return "tmy"
    if any(f"{quantity} [" in text for quantity in record.QUANTITIES):
        return "csv"
    # Whether the first line that is no comment looks like the titles of a table of weather, if not the documented ones.
    first = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    if sum(guess_quantity(title.strip(' "\ufeff')) is not None for title in re.split("[,;\t]", first)) > 1:
        return "csv"
    msg = (
        f"{path} looks like none of the known weather formats ({', '.join(FORMATS)}). If it is one, name it with --format. For the "
        f"export of a climate computer, `glbench weather columns {path}` writes a column map. The titles of a CSV of your own are:\n"
        f"  {EXPECTED_HEADER}"
    )
    raise WeatherError(msg)
