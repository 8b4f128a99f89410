"""Readers of weather files by name, and one that tells the format from the content.

**Parquet**: glbench's own canonical table with its description, as ``glbench weather generate`` and ``save_weather`` write it. **CSV**: a
unit in every column's title, and the place in comment lines (docs/weather.md). Others: ``typical_years``, ``services``, ``knmi``.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from glbench.errors import UnknownNameError, WeatherError, did_you_mean, refuse
from glbench.outside_tables import read_text
from glbench.untrusted import open_regular, read_pieces, reason_of
from glbench.weather import record
from glbench.weather.column_map import EXPECTED_HEADER, guess_quantity, read_columns, read_csv
from glbench.weather.knmi import parse_knmi, record_from_knmi
from glbench.weather.reading import Reading, record_of
from glbench.weather.services import OPEN_METEO_HEADER, parse_nsrdb, parse_open_meteo, parse_pvgis, parse_solar_anywhere
from glbench.weather.store import read_stored
from glbench.weather.typical_years import TMY2_HEADER, parse_epw, parse_tmy

Format = Literal["knmi", "epw", "tmy", "pvgis", "nsrdb", "openmeteo", "solaranywhere", "csv", "parquet"]
FORMATS: tuple[Format, ...] = get_args(Format)


_PARSERS: Mapping[str, Callable[[str, str], Reading]] = {
    "epw": parse_epw,
    "tmy": parse_tmy,
    "pvgis": parse_pvgis,
    "nsrdb": parse_nsrdb,
    "openmeteo": parse_open_meteo,
    "solaranywhere": parse_solar_anywhere,
}
_HEAD_CHARACTERS = 65536
_SIGNS: Mapping[Format, re.Pattern[str]] = {
    "epw": re.compile(r'\s*"?LOCATION"?\s*,', re.IGNORECASE),
    "knmi": re.compile(r"(?s).*?STN\s*,\s*YYYYMMDD\s*,\s*HH?\s*,"),
    "nsrdb": re.compile(r"(?si).*?^\W?Year\W+Month\W+Day\W+Hour\b", re.MULTILINE),
    "openmeteo": re.compile(rf"(?s)[^\n]*{OPEN_METEO_HEADER}"),
    "solaranywhere": re.compile(r"(?s)[^\n]*\n[^\n]*ObservationTime\(LST\)"),
    "tmy": re.compile(rf"(?s)[^\n]*\n\W?Date\s*\(MM/DD/YYYY\)|{TMY2_HEADER.pattern}\n", re.IGNORECASE),
    "pvgis": re.compile(
        r'(?s).*?(^"?time\(UTC\)|^"?time"?[,;\t].*?(G\([hi]\)|G[bd]\(i\))|"(tmy_hourly|G\(i\)|time\(UTC\))")', re.MULTILINE
    ),
}
"""How the formats are recognised, in this order."""


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
    estimate_humidity: bool = False,
    fill_gaps: int = 0,
) -> record.WeatherRecord:
    """Weather record of a file.

    Raises ``UnknownNameError`` when there is no such format, and ``WeatherError`` when the format cannot be told, an option does not belong
    to it, or its reader refuses the file.

    Parameters
    ----------
    path
        The file; one alone in a zip or gzip archive, too.
    file_format
        One of ``FORMATS``, or ``"auto"``: told from its content.
    name
        Name of the record; the file's own name by default.
    timezone
        IANA zone of the local clock, instead of the file's. A file with a fixed offset from UTC has ``Etc/GMT-1`` and no summer time.
    year
        Nominal (common) year of a typical year; 2001 by default.
    station
        KNMI's number, for a file of several stations.
    coordinates
        Degrees north, degrees east and metres above sea level, instead of the file's.
    columns
        File of a column map, for tables that are in none of the formats.
    estimate_humidity
        For the hourly series of PVGIS, which have none: the day's lowest temperature is taken for the dew point.
    fill_gaps
        Fill up to so many missing hours in a row linearly (recorded in the notes); 0 fills nothing.
    """
    path = Path(path)
    if columns is not None:
        if file_format != "auto" or year is not None or station is not None or estimate_humidity:
            refuse("A column map says how the file is read: no --format, --year, --station or --estimate-humidity.", WeatherError)
        return read_columns(path, columns, name=name, timezone=timezone, coordinates=coordinates, fill_gaps=fill_gaps)
    if file_format not in ("auto", *FORMATS):
        refuse(f"There is no weather format '{file_format}'.{did_you_mean(file_format, ('auto', *FORMATS))}", UnknownNameError)
    kind = detect_format(path) if file_format == "auto" else file_format
    for option, value, fits in (
        ("--timezone", timezone, kind != "parquet"),
        ("--place", coordinates, kind != "parquet"),
        ("--year", year, kind in _PARSERS),
        ("--station", station, kind == "knmi"),
        ("--estimate-humidity", estimate_humidity or None, kind == "pvgis"),
        ("--fill-gaps", fill_gaps or None, kind != "parquet"),
    ):
        if value is not None and not fits:
            refuse(f"{path} is read as {kind}, which takes no {option}. Leave it out, or choose the --format.", WeatherError)
    if kind == "knmi":
        table, places = parse_knmi(read_text(path, WeatherError), str(path))
        options: dict[str, Any] = {"station": station, "timezone": timezone, "coordinates": coordinates, "fill_gaps": fill_gaps}
        return record_from_knmi(table, places, name or path.stem.lower(), **options)
    if kind == "csv":
        return read_csv(path, name=name, timezone=timezone, coordinates=coordinates, fill_gaps=fill_gaps)
    if kind == "parquet":
        return read_stored(path, name)
    text, file = read_text(path, WeatherError), str(path)
    reading = parse_pvgis(text, file, estimate_humidity=True) if estimate_humidity else _PARSERS[kind](text, file)
    return record_of(reading, name=name or path.stem.lower(), timezone=timezone, year=year, coordinates=coordinates, fill_gaps=fill_gaps)


def detect_format(path: Path) -> Format:
    """Format of a weather file, from its beginning (TMY2: its suffix). Raises ``WeatherError`` when it cannot be read or told."""
    try:
        with open_regular(path) as file:
            head = read_pieces(file.read, 4)
    except OSError as error:
        refuse(f"Cannot read {path}: {reason_of(error)}. Check the path.", WeatherError, error)
    if head == b"PAR1":
        return "parquet"
    text = read_text(path, WeatherError)[:_HEAD_CHARACTERS]
    if path.suffix.lower() in (".tm2", ".tmy2"):
        return "tmy"
    for kind, sign in _SIGNS.items():
        if sign.match(text):
            return kind
    if any(f"{quantity} [" in text for quantity in record.QUANTITIES):
        return "csv"
    # Whether the first line that is no comment looks like the titles of a table of weather, if not the documented ones.
    first = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    if sum(guess_quantity(title.strip(' "\ufeff')) is not None for title in re.split("[,;\t]", first)) > 1:
        return "csv"
    msg = (
        f"{path} looks like none of the known weather formats ({', '.join(FORMATS)}). If it is one, name it with --format. For the "
        f"export of a climate computer, `glbench weather columns {shlex.quote(str(path))}` writes a column map. "
        f"The titles of a CSV of your own are:\n"
        f"  {EXPECTED_HEADER}"
    )
    raise WeatherError(msg)
