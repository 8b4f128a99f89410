"""KNMI's hourly web service: one station, one calendar year (UT), checked before anything is kept.

The service is asked for whole days and its answer is cut to the year, for it filters hours day by day and may add a day. An
answer is kept in the cache, with its SHA-256, only after it has proved whole.
"""

from __future__ import annotations

import hashlib
import http.client
import os
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from pathlib import Path

import numpy as np

from glbench.errors import WeatherError, whole_number
from glbench.resources import cache_folder, write_atomically
from glbench.weather.knmi import parse_knmi, record_from_knmi
from glbench.weather.record import WeatherRecord

KNMI_URL = "https://www.daggegevens.knmi.nl/klimatologie/uurgegevens"
URL_VARIABLE = "GLBENCH_KNMI_URL"
FIRST_YEAR = 1951  # KNMI's hourly observations begin here
TIMEOUT_SECONDS = 60.0
TOTAL_SECONDS = 600.0
_BLOCK_BYTES = 65536
_LARGEST_BYTES = 64 * 2**20

Progress = Callable[[int, int | None], None]
"""Called with the bytes received so far, and the bytes to come in all where the service says so."""


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
) -> WeatherRecord:
    """Weather record of a KNMI station and calendar year (UT), from the cache or from KNMI's service.

    Parameters
    ----------
    station, year : int
        KNMI's number of the station (240: Schiphol), and the year.
    name : str, optional
        Name of the record; ``knmi-240-2013`` by default.
    url : str, optional
        Address of the service; by default ``GLBENCH_KNMI_URL`` from the environment, else KNMI's own.
    timeout_seconds : float
        Longest silence of the service [s].
    total_seconds : float
        Longest time that the whole answer may take [s], however busily it drips.
    refresh : bool
        Ask the service although the cache has the answer.
    fill_gaps : int
        Fill up to so many missing hours in a row linearly (recorded in the notes); 0 fills nothing.
    progress : callable, optional
        Told about the download as it goes.

    Raises
    ------
    WeatherError
        When the service cannot be reached, refuses, is out of order, breaks off, or lacks a part of the year. Nothing of a
        bad answer is kept.
    """
    station, year = whole_number(station, "The number of a KNMI station"), whole_number(year, "A year")
    if year < FIRST_YEAR:
        msg = (
            f"KNMI's hourly observations begin in {FIRST_YEAR}: the year {year} cannot be fetched. Choose a later year."
        )
        raise WeatherError(msg)
    address = url or os.environ.get(URL_VARIABLE) or KNMI_URL
    form = {
        "start": f"{year}010101",
        "end": f"{year}123124",
        "stns": str(station),
        "vars": "Q:T:U:FH:N",
        "fmt": "csv",
    }
    cached = _cache_file(address, form, station, year)
    content = None if refresh else _read_cache(cached)
    fresh = content is None
    if content is None:
        content = _download(address, form, timeout_seconds, total_seconds, progress)
    record = _year_of(content, f"KNMI's answer for station {station}, {year}", station, year, name, fill_gaps)
    if fresh:
        # The checksum goes in front of the text: one file, so that there is no moment with one and not the other.
        write_atomically(cached, hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
    return record


def _cache_file(address: str, form: dict[str, str], station: int, year: int) -> Path:
    key = hashlib.sha256(f"{address}?{urllib.parse.urlencode(sorted(form.items()))}".encode()).hexdigest()[:12]
    return cache_folder() / "weather" / f"knmi_{station}_{year}_{key}.txt"


def _read_cache(path: Path) -> bytes | None:
    """Content of the cache file, or None when there is none or its checksum does not hold."""
    try:
        checksum, _, content = path.read_bytes().partition(b"\n")
    except OSError:
        return None
    return content if hashlib.sha256(content).hexdigest().encode() == checksum else None


def _download(
    address: str, form: dict[str, str], timeout_seconds: float, total_seconds: float, progress: Progress | None
) -> bytes:
    """The service's whole answer to the POST of ``form``."""
    if urllib.parse.urlsplit(address).scheme not in ("http", "https"):
        msg = (
            f"'{address}' is no web address. Give one that begins with https://, or leave {URL_VARIABLE} and --url out."
        )
        raise WeatherError(msg)
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
    except TimeoutError as error:
        raise _silent(address, timeout_seconds) from error
    except (OSError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", error)
        if isinstance(reason, TimeoutError):
            raise _silent(address, timeout_seconds) from error
        msg = f"KNMI's service {address} cannot be reached, or broke off: {reason}. Check the connection and try again."
        raise WeatherError(msg) from error
    if total is not None and len(received) < total:
        msg = f"KNMI's answer broke off after {len(received)} of {total} bytes. Try again."
        raise WeatherError(msg)
    return bytes(received)


def _silent(address: str, timeout_seconds: float) -> WeatherError:
    msg = (
        f"KNMI's service {address} was silent for {timeout_seconds:g} s. Try again later, or wait longer with --timeout. "
        "Files downloaded by hand come in with `glbench weather import`."
    )
    return WeatherError(msg)


def _year_of(content: bytes, file: str, station: int, year: int, name: str | None, fill_gaps: int) -> WeatherRecord:
    """Record of exactly the hours of ``year`` in KNMI's answer."""
    table = parse_knmi(content.decode("utf-8", errors="replace"), file)
    wanted = table.only(np.flatnonzero((table.columns["YYYYMMDD"] // 10000) == year))
    if wanted.lines.size == 0:
        msg = f"{file}: it holds no hour of {year}. Does the station exist, and did it measure in that year?"
        raise WeatherError(msg)
    record = record_from_knmi(wanted, name or f"knmi-{station}-{year}", station=station, fill_gaps=fill_gaps)
    expected = int((np.datetime64(f"{year + 1}-01-01") - np.datetime64(f"{year}-01-01")).astype(np.int64)) * 24
    if record.hours != expected:
        msg = (
            f"{file} runs from {record.period}: {record.hours} of {expected} hours. The answer was cut off, or the year is not "
            "over yet. Try again, or choose another year."
        )
        raise WeatherError(msg)
    return record
