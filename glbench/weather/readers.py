"""One door to all readers: the format of a weather file, told from its content."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal, get_args

from glbench.errors import UnknownNameError, WeatherError, did_you_mean
from glbench.weather.knmi import read_knmi
from glbench.weather.record import WeatherRecord
from glbench.weather.table import EXPECTED_HEADER, UNITS, meant_by, read_csv
from glbench.weather.typical import read_epw, read_tmy

Format = Literal["knmi", "epw", "tmy", "csv"]
FORMATS: tuple[Format, ...] = get_args(Format)
_HEAD_BYTES = 65536


def read_weather(
    path: Path | str,
    file_format: str = "auto",
    *,
    name: str | None = None,
    timezone: str | None = None,
    year: int | None = None,
    station: int | None = None,
    fill_gaps: int = 0,
) -> WeatherRecord:
    """Weather record of a file in any known format (``"auto"``: told from its content).

    ``timezone`` and ``year`` are for EPW and TMY, ``station`` for KNMI; see their readers.

    Raises
    ------
    UnknownNameError
        When there is no such format.
    WeatherError
        When the format cannot be told, an option does not belong to it, or its reader refuses the file.
    """
    path = Path(path)
    chosen = detect_format(path) if file_format == "auto" else file_format
    if chosen not in FORMATS:
        msg = f"There is no weather format '{chosen}'.{did_you_mean(chosen, ('auto', *FORMATS))}"
        raise UnknownNameError(msg)
    typical = chosen in ("epw", "tmy")
    for option, value, fits in (
        ("--timezone", timezone, typical),
        ("--year", year, typical),
        ("--station", station, chosen == "knmi"),
    ):
        if value is not None and not fits:
            msg = f"{path} is read as {chosen}, which takes no {option}. Leave it out, or choose the --format."
            raise WeatherError(msg)
    if chosen == "knmi":
        return read_knmi(path, name=name, station=station, fill_gaps=fill_gaps)
    if chosen == "csv":
        return read_csv(path, name=name, fill_gaps=fill_gaps)
    read = read_epw if chosen == "epw" else read_tmy
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
    if head.startswith(b"PK") or re.search(r"STN\s*,\s*YYYYMMDD\s*,\s*HH?\s*,", text):
        return "knmi"
    if text.startswith("LOCATION,"):
        return "epw"
    if "Date (MM/DD/YYYY)" in text:
        return "tmy"
    if any(f"{quantity} [" in text for quantity in UNITS) or _has_titles(text):
        return "csv"
    msg = (
        f"{path} looks like none of the known weather formats ({', '.join(FORMATS)}). If it is one, name it with --format. "
        f"The titles of a CSV are:\n  {EXPECTED_HEADER}"
    )
    raise WeatherError(msg)


def _has_titles(text: str) -> bool:
    """Whether the first line that is no comment looks like the titles of a table of weather, if not the documented ones."""
    first = next((line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")), "")
    return sum(meant_by(title.strip(' "\ufeff')) is not None for title in re.split("[,;\t]", first)) > 1
