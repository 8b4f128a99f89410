"""KNMI's hourly observations: the web service and its answers, the bulk files, and the native whole numbers.

A slot HH covers (HH-1, HH] in UT. T, U and N are instants at its end, Q is its sum, FH its mean.

The service gives one station and one calendar year (UT). It is asked for whole days and its answer is cut to the year, for it filters
hours day by day and may add a day. An answer is kept in the cache, with its SHA-256, only after it has proved whole.
"""

from __future__ import annotations

import contextlib
import csv
import functools
import hashlib
import http.client
import os
import re
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NoReturn

import numpy as np

from glbench.errors import WeatherError, refuse, whole_number
from glbench.outside_tables import TextTable
from glbench.resources import cache_folder, data_folder, write_atomically
from glbench.weather import record
from glbench.weather.hourly import hourly_record

KNMI_SOURCE = "Royal Netherlands Meteorological Institute (KNMI), hourly observations"
KNMI_LICENCE = (
    "These data can be used freely provided that the following source is acknowledged: Royal Netherlands Meteorological Institute"
)
KNMI_TIMEZONE = "Europe/Amsterdam"
NATIVE_COLUMNS = ("T", "U", "N", "FH", "Q")
NEEDED_COLUMNS = ("STN", "YYYYMMDD", "HH", "T", "U", "FH", "Q")

_HEADER = re.compile(r"^STN\s*,\s*YYYYMMDD\s*,\s*HH?\s*(,|$)")
_STATION = re.compile(r"^(\d{3})[:\s]\s*(-?\d+\.\d+)\s+(-?\d+\.\d+)\s+(-?\d+(?:\.\d+)?)\s+(\S.*)$")
KNMI_URL = "https://www.daggegevens.knmi.nl/klimatologie/uurgegevens"
URL_VARIABLE = "GLBENCH_KNMI_URL"
FIRST_YEAR = 1951  # KNMI's hourly observations begin here
TIMEOUT_SECONDS = 60.0
TOTAL_SECONDS = 600.0
_BLOCK_BYTES = 65536
_LARGEST_BYTES = 64 * 2**20
Progress = Callable[[int, int | None], None]
"""Called with the bytes received so far, and the bytes to come in all where the service says so."""


@functools.cache
def known_stations() -> Mapping[int, record.Place]:
    """Places of the stations with hourly observations, by KNMI's number; for files without a station table."""
    with (data_folder("weather") / "knmi_stations.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    return {
        int(number): record.Place(f"KNMI {number}, {name}", float(latitude), float(longitude), float(altitude), KNMI_TIMEZONE)
        for number, longitude, latitude, altitude, name in rows
    }


def native_rows(
    file: str, native: Mapping[str, record.IntArray] | Mapping[str, record.FloatArray], numbers: record.IntArray | None = None
) -> record.Rows:
    """Rows in canonical units from KNMI's own numbers.

    ``native`` holds YYYYMMDD, HH, T and FH [0.1 degC, 0.1 m/s], U [%], N [octants], Q [J/cm2]; NaN for a missing value. ``numbers`` are the
    rows' numbers in ``file``, 1, 2, 3, ... when not given. Raises ``WeatherError`` when a column is missing, or a date or hour is none.
    """
    record.require_columns(file, list(native), NEEDED_COLUMNS[1:])
    value = {name: np.asarray(column, dtype=np.float64) for name, column in native.items()}
    date, hour = value["YYYYMMDD"], value["HH"]
    row_numbers = np.arange(1, hour.size + 1, dtype=np.int64) if numbers is None else numbers

    def fault(row: int, problem: str) -> NoReturn:
        refuse(f"{file}, row {row_numbers[row]}: {problem}. Correct the file or fetch it again.", WeatherError)

    slot_ends = record.ends_of_hours(date // 10000, date // 100 % 100, date % 100, hour, fault)
    columns: dict[str, record.FloatArray] = {
        "air_temperature": value["T"] / 10.0,
        "relative_humidity": value["U"],
        **({"cloud_cover": value["N"]} if "N" in value else {}),
        "wind_speed": value["FH"] / 10.0,
        # J cm-2 in the slot; 1e4 J m-2 over 3600 s as one rounded division.
        "global_radiation": value["Q"] * 10000.0 / record.SLOT_SECONDS,
    }
    return record.Rows(file, slot_ends, columns, record.USUAL_TIMING, row_numbers)


def record_from_knmi(
    table: TextTable,
    places: Mapping[int, record.Place],
    name: str,
    *,
    station: int | None = None,
    timezone: str | None = None,
    coordinates: record.Coordinates | None = None,
    fill_gaps: int = 0,
) -> record.WeatherRecord:
    """Checked record of one station of a table of ``parse_knmi``; the options are those of ``read_weather``.

    Raises ``WeatherError``, with file, row and value, for an unknown station or several, no number, gaps or impossible values.
    """
    columns = {}
    for title in (title for title in (*NEEDED_COLUMNS, "N") if title in table.titles):
        columns[title] = values = table.numbers(title)
        blank = np.isnan(values) & (title in NATIVE_COLUMNS)
        odd = np.flatnonzero(~(values % 1 == 0) & ~blank)
        if odd.size:
            table.refuse(f"'{table.texts(title)[odd[0]]}' is not a whole number. Correct the file or fetch it again.", int(odd[0]), title)
    present = sorted({int(number) for number in columns["STN"]})
    if station is None and not present:
        refuse(f"{table.file} holds no hourly values. Is it the right file, and whole?", WeatherError)
    if station is None and len(present) > 1:
        refuse(f"{table.file} holds the stations {', '.join(map(str, present))}: choose one with --station.", WeatherError)
    if station is not None and station not in present:
        stations = ", ".join(map(str, present)) or "no station at all"
        refuse(f"{table.file} holds {stations}, not station {station}. Choose the right file or station.", WeatherError)
    number = present[0] if station is None else station
    place = places.get(number)
    if coordinates is not None:
        place = record.Place(place.station if place else f"KNMI {number}", *coordinates, KNMI_TIMEZONE)
    if place is None:
        msg = (
            f"{table.file} gives no coordinates for station {number}: its comments have no station table, and the station is not in KNMI's "
            "list. Give the place with --place LATITUDE,LONGITUDE,ALTITUDE [deg north, deg east, m]."
        )
        raise WeatherError(msg)
    own = columns["STN"] == number
    native = {title: values[own] for title, values in columns.items()}
    place = replace(place, timezone=timezone or place.timezone)
    origin = record.Origin(name, place, f"{KNMI_SOURCE}, station {number}", KNMI_LICENCE)
    return hourly_record(native_rows(table.file, native, np.array(table.lines, dtype=np.int64)[own]), origin, fill_gaps=fill_gaps)


def parse_knmi(text: str, file: str) -> tuple[TextTable, Mapping[int, record.Place]]:
    """KNMI's text as a table, and the places of stations by their numbers, from its comments and from KNMI's list.

    Raises ``WeatherError`` when there is no header line, or a line has too few or too many fields.
    """
    header: list[str] = []
    stations = dict(known_stations())
    numbers: list[int] = []
    rows: list[list[str]] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.strip().strip('"').lstrip("# ").strip()
        if _HEADER.match(line):
            header = ["HH" if title.strip() == "H" else title.strip() for title in line.split(",")]
            record.require_columns(file, header, NEEDED_COLUMNS)
        elif station := _STATION.match(line):
            code, longitude, latitude, altitude, title = station.groups()
            town = title.strip().title() if title.isupper() else title.strip()
            place = record.Place(f"KNMI {code}, {town}", float(latitude), float(longitude), float(altitude), KNMI_TIMEZONE)
            stations[int(code)] = place
        elif header and line and not raw.lstrip(' "').startswith("#"):
            rows.append([field.strip() for field in raw.split(",")])
            numbers.append(number)
    if not header:
        beginning = " ".join(text.split())[:80]
        msg = (
            f"{file} is no KNMI file of hourly values: no header line 'STN,YYYYMMDD,HH,...' (it begins with '{beginning}'). "
            "If KNMI's service answered with a web page, it is out of order: try again later."
        )
        raise WeatherError(msg)
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(header):
            content = ",".join(row)
            msg = (
                f"{file}, row {number}: {len(row)} fields instead of {len(header)} ('{content[:60]}'). The file is cut off or "
                "damaged: fetch it again."
            )
            raise WeatherError(msg)
    return TextTable(file, WeatherError, (), tuple(header), rows, numbers), stations


def fetch_knmi(
    station: int,
    year: int,
    *,
    name: str | None = None,
    url: str | None = None,
    timeout_seconds: float = TIMEOUT_SECONDS,
    total_seconds: float = TOTAL_SECONDS,
    refresh: bool = False,
    fill_gaps: int = 0,
    progress: Progress | None = None,
) -> record.WeatherRecord:
    """Weather record of a KNMI station and calendar year (UT), from the cache or from KNMI's service.

    Raises ``WeatherError`` when the service cannot be reached, refuses, is out of order, breaks off, or lacks a part of the year.

    ``station`` is KNMI's number (240: Schiphol). ``name`` is that of the record, ``knmi-240-2013`` by default, ``url`` the address of the
    service, by default ``GLBENCH_KNMI_URL`` from the environment, else KNMI's own. The longest silence of the service is
    ``timeout_seconds`` [s], the longest time that the whole answer may take, however busily it drips, ``total_seconds`` [s]. ``refresh``
    asks the service although the cache has the answer. Up to ``fill_gaps`` missing hours in a row are filled linearly (recorded in the
    notes); 0 fills nothing. ``progress`` is told about the download as it goes.
    """
    station, year = whole_number(station, "The number of a KNMI station"), whole_number(year, "A year")
    if year < FIRST_YEAR:
        refuse(f"KNMI's hourly observations begin in {FIRST_YEAR}: the year {year} cannot be fetched. Choose a later year.", WeatherError)
    address = url or os.environ.get(URL_VARIABLE) or KNMI_URL
    form = {"start": f"{year}010101", "end": f"{year}123124", "stns": str(station), "vars": "Q:T:U:FH:N", "fmt": "csv"}
    key = hashlib.sha256(f"{address}?{urllib.parse.urlencode(sorted(form.items()))}".encode()).hexdigest()[:12]
    cache = cache_folder() / "weather" / f"knmi_{station}_{year}_{key}.txt"
    content = None
    if not refresh:
        with contextlib.suppress(OSError):
            # The checksum goes in front of the text: one file, so that there is no moment with one and not the other.
            checksum, _, text = cache.read_bytes().partition(b"\n")
            content = text if hashlib.sha256(text).hexdigest().encode() == checksum else None
    fresh = content is None
    if content is None:
        content = _download(address, form, timeout_seconds, total_seconds, progress)
    file = f"KNMI's answer for station {station}, {year}"
    table, places = parse_knmi(content.decode("utf-8", errors="replace"), file)
    own = [i for i, date in enumerate(table.texts("YYYYMMDD")) if date.startswith(str(year))]
    if not own:
        refuse(f"{file}: it holds no hour of {year}. Does the station exist, and did it measure in that year?", WeatherError)
    table = replace(table, rows=[table.rows[i] for i in own], lines=[table.lines[i] for i in own])
    season = record_from_knmi(table, places, name or f"knmi-{station}-{year}", station=station, fill_gaps=fill_gaps)
    expected = int((np.datetime64(f"{year + 1}-01-01") - np.datetime64(f"{year}-01-01")).astype(np.int64)) * 24
    if season.hours != expected:
        msg = (
            f"{file} runs from {season.period}: {season.hours} of {expected} hours. The answer was cut off, or the year is not "
            "over yet. Try again, or choose another year."
        )
        raise WeatherError(msg)
    if fresh:
        write_atomically(cache, hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
    return season


def _download(address: str, form: dict[str, str], timeout_seconds: float, total_seconds: float, progress: Progress | None) -> bytes:
    """The service's whole answer to the POST of ``form``."""
    if urllib.parse.urlsplit(address).scheme not in ("http", "https"):
        refuse(f"'{address}' is no web address. Give one that begins with https://, or leave {URL_VARIABLE} and --url out.", WeatherError)
    request = urllib.request.Request(address, data=urllib.parse.urlencode(form).encode(), method="POST")
    received = bytearray()
    began = time.monotonic()
    try:
        with urllib.request.urlopen(request, timeout=timeout_seconds) as answer:
            announced = answer.headers.get("Content-Length")
            total = int(announced) if announced and announced.isdigit() else None
            while block := answer.read1(_BLOCK_BYTES):  # what is there, and not a whole block: a trickle is noticed
                received += block
                if time.monotonic() - began > total_seconds:
                    msg = (
                        f"KNMI's service {address} is too slow: {len(received)} bytes in {total_seconds:g} s. "
                        "Try again later, or wait longer with --total-timeout."
                    )
                    raise WeatherError(msg)
                if len(received) > _LARGEST_BYTES:
                    msg = f"{address} sends more than {_LARGEST_BYTES // 2**20} MiB, too much for a year of hours. Check the address."
                    raise WeatherError(msg)
                if progress is not None:
                    progress(len(received), total)
    except urllib.error.HTTPError as error:
        msg = f"KNMI's service {address} answered with HTTP {error.code} ({error.reason}). Try again later."
        error.close()
        raise WeatherError(msg) from error
    except (OSError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", error)
        msg = f"KNMI's service {address} cannot be reached, or broke off: {reason}. Check the connection and try again."
        if isinstance(reason, TimeoutError):
            msg = (
                f"KNMI's service {address} was silent for {timeout_seconds:g} s. Try again later, or wait longer with --timeout. "
                "Files downloaded by hand come in with `glbench weather import`."
            )
        raise WeatherError(msg) from error
    if total is not None and len(received) < total:
        refuse(f"KNMI's answer broke off after {len(received)} of {total} bytes. Try again.", WeatherError)
    return bytes(received)
