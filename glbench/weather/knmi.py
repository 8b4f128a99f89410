"""KNMI's hourly observations: the web service's answers, the bulk files, and the native whole numbers.

A slot HH covers (HH-1, HH] in UT. T, U and N are instants at its end, Q is its sum, FH its mean.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from glbench.errors import WeatherError
from glbench.weather.assemble import Origin, Rows, assemble, require_columns
from glbench.weather.record import SLOT_SECONDS, FloatArray, IntArray, Place, Timing, WeatherRecord

KNMI_SOURCE = "Royal Netherlands Meteorological Institute (KNMI), hourly observations"
KNMI_LICENCE = (
    "These data can be used freely provided that the following source is acknowledged: "
    "Royal Netherlands Meteorological Institute"
)
KNMI_TIMEZONE = "Europe/Amsterdam"
KNMI_TIMING: Mapping[str, Timing] = {
    "air_temperature": "instant",
    "relative_humidity": "instant",
    "cloud_cover": "instant",
    "wind_speed": "mean",
    "global_radiation": "mean",
}
# For files without a station table: the station whose record is shipped.
KNOWN_STATIONS: Mapping[int, Place] = {240: Place("KNMI 240, Schiphol", 52.318, 4.790, -3.3, KNMI_TIMEZONE)}
NATIVE_COLUMNS = ("T", "U", "N", "FH", "Q")

_HEADER = re.compile(r"^STN\s*,\s*YYYYMMDD\s*,\s*HH?\s*(,|$)")
_STATION = re.compile(r"^(\d{3})[:\s]\s*(-?\d+\.\d+)\s+(-?\d+\.\d+)\s+(-?\d+(?:\.\d+)?)\s+(\S.*)$")


def native_rows(
    file: str, native: Mapping[str, IntArray] | Mapping[str, FloatArray], numbers: IntArray | None = None
) -> Rows:
    """Rows in canonical units from KNMI's own numbers.

    ``native`` holds YYYYMMDD, HH, T and FH [0.1 degC, 0.1 m/s], U [%], N [octants], Q [J/cm2]; NaN for a missing value.
    ``numbers`` are the rows' numbers in ``file``, 1, 2, 3, ... when not given.

    Raises
    ------
    WeatherError
        When a column is missing, or a date or hour does not exist.
    """
    require_columns(file, list(native), ("YYYYMMDD", "HH", *NATIVE_COLUMNS))
    value = {name: np.asarray(column, dtype=np.float64) for name, column in native.items()}
    if numbers is None:
        numbers = np.arange(1, value["HH"].size + 1, dtype=np.int64)
    columns: dict[str, FloatArray] = {
        "air_temperature": value["T"] / 10.0,
        "relative_humidity": value["U"],
        "cloud_cover": value["N"],
        "wind_speed": value["FH"] / 10.0,
        # J cm-2 in the slot; 1e4 J m-2 over 3600 s as one rounded division.
        "global_radiation": value["Q"] * 10000.0 / SLOT_SECONDS,
    }
    return Rows(file, _slot_ends(file, value["YYYYMMDD"], value["HH"], numbers), columns, KNMI_TIMING, numbers)


def _slot_ends(file: str, dates: FloatArray, hours: FloatArray, numbers: IntArray) -> IntArray:
    """End of each slot [s since 1970-01-01 UTC] from YYYYMMDD and HH."""
    unique, which = np.unique(dates.astype(np.int64), return_inverse=True)
    midnights = np.empty(unique.size, dtype=np.int64)
    for i, date in enumerate(unique):
        text = f"{int(date):08d}"
        try:
            midnights[i] = np.datetime64(f"{text[:4]}-{text[4:6]}-{text[6:]}", "s").astype(np.int64)
        except ValueError as error:
            row = numbers[np.flatnonzero(which == i)[0]]
            msg = f"{file}, row {row}: the date {text} does not exist. Correct the file or fetch it again."
            raise WeatherError(msg) from error
    bad = np.flatnonzero(~((hours >= 1) & (hours <= 24) & (hours % 1 == 0)))
    if bad.size:
        i = int(bad[0])
        msg = f"{file}, row {numbers[i]}: the hour {hours[i]:g} is not one of 1 to 24. Correct the file or fetch it again."
        raise WeatherError(msg)
    return np.asarray(midnights[which] + SLOT_SECONDS * hours.astype(np.int64), dtype=np.int64)


@dataclass(frozen=True)
class KnmiTable:
    """A KNMI text file as read: native columns (NaN for a blank), line numbers, and the station table of its comments."""

    file: str
    columns: Mapping[str, FloatArray]
    lines: IntArray
    stations: Mapping[int, Place]

    def only(self, rows: IntArray) -> KnmiTable:
        """The same table with the rows numbered ``rows`` (from 0)."""
        columns = {name: column[rows] for name, column in self.columns.items()}
        return KnmiTable(self.file, columns, self.lines[rows], self.stations)


def read_knmi(
    path: Path | str, *, name: str | None = None, station: int | None = None, fill_gaps: int = 0
) -> WeatherRecord:
    """Weather record of a KNMI file of hourly values: an answer of the web service, or a bulk file (``.txt`` or ``.zip``).

    Parameters
    ----------
    path : Path or str
        The file. Comment lines, quotes and Windows line ends are as KNMI writes them.
    name : str, optional
        Name of the record; the file's own name by default.
    station : int, optional
        KNMI's number; needed when the file holds several stations.
    fill_gaps : int
        Fill up to so many missing hours in a row linearly (recorded in the notes); 0 fills nothing.

    Raises
    ------
    WeatherError
        When the file is no KNMI file, is cut off, or has gaps or impossible values; names file, row and value.
    """
    path = Path(path)
    table = parse_knmi(_text(path), str(path))
    return record_from_knmi(table, name or path.stem.lower(), station=station, fill_gaps=fill_gaps)


def record_from_knmi(table: KnmiTable, name: str, *, station: int | None = None, fill_gaps: int = 0) -> WeatherRecord:
    """Checked record of one station of a KNMI table. Raises ``WeatherError`` as ``read_knmi`` does."""
    found = sorted({int(number) for number in table.columns["STN"]})
    if station is None and len(found) > 1:
        msg = f"{table.file} holds the stations {', '.join(map(str, found))}: choose one with --station."
        raise WeatherError(msg)
    if station is not None and station not in found:
        held = ", ".join(map(str, found)) or "no station at all"
        msg = f"{table.file} holds {held}, not station {station}. Choose the right file or station."
        raise WeatherError(msg)
    chosen = found[0] if station is None else station
    if chosen not in table.stations:
        msg = (
            f"{table.file} gives no coordinates for station {chosen}: its comments have no station table. Fetch the file from "
            "KNMI's hourly service (`glbench weather fetch`), which writes one."
        )
        raise WeatherError(msg)
    own = table.only(np.flatnonzero(table.columns["STN"] == chosen))
    origin = Origin(name, own.stations[chosen], f"{KNMI_SOURCE}, station {chosen}", KNMI_LICENCE)
    return assemble(native_rows(own.file, own.columns, own.lines), origin, fill_gaps=fill_gaps)


def parse_knmi(text: str, file: str) -> KnmiTable:
    """KNMI's text as a table; only the columns that are needed are kept.

    Raises
    ------
    WeatherError
        When there is no header line, a line has too few or too many fields, or a field is no number.
    """
    header: list[str] = []
    stations = dict(KNOWN_STATIONS)
    numbers: list[int] = []
    rows: list[list[str]] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip().strip('"').lstrip("# ").strip()
        if _HEADER.match(line):
            header = ["HH" if title.strip() == "H" else title.strip() for title in line.split(",")]
            require_columns(file, header, ("STN", "YYYYMMDD", "HH", *NATIVE_COLUMNS))
        elif station := _STATION.match(line):
            stations[int(station[1])] = _place(station)
        elif header and line and not raw.lstrip(' "').startswith("#"):
            rows.append(raw.split(","))
            numbers.append(number)
    if not header:
        beginning = " ".join(text.split())[:80]
        msg = (
            f"{file} is no KNMI file of hourly values: no header line 'STN,YYYYMMDD,HH,...' (it begins with '{beginning}'). "
            "If KNMI's service answered with a web page, it is out of order: try again later."
        )
        raise WeatherError(msg)
    lines = np.array(numbers, dtype=np.int64)
    kept = ("STN", "YYYYMMDD", "HH", *NATIVE_COLUMNS)
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(header):
            content = ",".join(row).strip()
            msg = (
                f"{file}, row {number}: {len(row)} fields instead of {len(header)} ('{content[:60]}'). The file is cut off or "
                "damaged: fetch it again."
            )
            raise WeatherError(msg)
    columns = {name: _numbers(file, name, [row[header.index(name)] for row in rows], lines) for name in kept}
    return KnmiTable(file, columns, lines, stations)


def _place(match: re.Match[str]) -> Place:
    number, longitude, latitude, altitude, title = match.groups()
    name = title.strip().title() if title.isupper() else title.strip()
    return Place(f"KNMI {number}, {name}", float(latitude), float(longitude), float(altitude), KNMI_TIMEZONE)


def _numbers(file: str, name: str, fields: list[str], lines: IntArray) -> FloatArray:
    """Fields as numbers; blanks become NaN, except in the columns that say which hour it is."""
    values = np.empty(len(fields))
    for i, text in enumerate(fields):
        stripped = text.strip()
        try:
            values[i] = float(int(stripped)) if stripped else np.nan
        except ValueError as error:
            msg = f"{file}, row {lines[i]}: '{stripped}' in column {name} is no whole number. Correct the file or fetch it again."
            raise WeatherError(msg) from error
    if name not in NATIVE_COLUMNS and np.isnan(values).any():
        row = lines[np.flatnonzero(np.isnan(values))[0]]
        msg = f"{file}, row {row}: no value in column {name}. Correct the file or fetch it again."
        raise WeatherError(msg)
    return values


def _text(path: Path) -> str:
    """Text of a KNMI file, out of its zip archive where it is in one."""
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                members = [member for member in archive.namelist() if member.lower().endswith((".txt", ".csv"))]
                if len(members) != 1:
                    msg = f"{path} holds {len(members)} text files instead of one. Unpack it and import the right file."
                    raise WeatherError(msg)
                content = archive.read(members[0])
        else:
            content = path.read_bytes()
    except (OSError, zipfile.BadZipFile) as error:
        msg = f"Cannot read {path}: {error}. Check the path, and that the file is whole."
        raise WeatherError(msg) from error
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # KNMI's older files carry Dutch comments in Latin-1; the figures themselves are ASCII.
        return content.decode("latin-1")
