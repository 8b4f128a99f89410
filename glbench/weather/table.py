"""The documented CSV of hourly weather: a unit in every column's title, and the place in comment lines (docs/weather.md)."""

from __future__ import annotations

import csv
import datetime as dt
import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast, get_args

import numpy as np

from glbench.errors import WeatherError, did_you_mean
from glbench.weather.assemble import Origin, Rows, assemble
from glbench.weather.psychrometrics import KELVIN
from glbench.weather.record import QUANTITIES, SLOT_SECONDS, FloatArray, Place, Timing, WeatherRecord

UNITS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "air_temperature": {"degC": (1.0, 0.0), "K": (1.0, -KELVIN)},
    "relative_humidity": {"%": (1.0, 0.0)},
    "wind_speed": {"m/s": (1.0, 0.0), "km/h": (1 / 3.6, 0.0)},
    "global_radiation": {"W/m2": (1.0, 0.0), "Wh/m2": (1.0, 0.0), "J/cm2": (1 / 0.36, 0.0)},
    "cloud_cover": {"octants": (1.0, 0.0), "tenths": (0.8, 0.0), "%": (0.08, 0.0)},
    "sky_infrared": {"W/m2": (1.0, 0.0)},
    "sky_temperature": {"degC": (1.0, 0.0), "K": (1.0, -KELVIN)},
}
"""For every column, the units it may come in: factor and offset to the canonical unit."""

DEFAULT_TIMING: Mapping[str, Timing] = {
    "air_temperature": "instant",
    "relative_humidity": "instant",
    "cloud_cover": "instant",
    "sky_temperature": "instant",
    "wind_speed": "mean",
    "global_radiation": "mean",
    "sky_infrared": "mean",
}
TIME_COLUMNS = {"slot_end [UTC]": 0, "slot_start [UTC]": SLOT_SECONDS}
_MOST_PROBLEMS = 12
_LONGEST_HEADER = 300
_TITLES = {f"{quantity} [{unit}]": quantity for quantity, units in UNITS.items() for unit in units}
_EXPECTED = (
    "slot_end [UTC]",
    "air_temperature [degC]",
    "relative_humidity [%]",
    "wind_speed [m/s]",
    "global_radiation [W/m2]",
    "cloud_cover [octants]",
)
EXPECTED_HEADER = (
    f"{','.join(_EXPECTED)}\n  Other units, sky_infrared or sky_temperature instead of cloud_cover, and the comment lines above it: "
    "docs/weather.md."
)
"""The line of titles that a CSV needs, and where the rest is explained."""
_SHORT = {
    "slot_end [UTC]": ("time", "date", "datetime", "date_time", "timestamp", "utc", "slot_end"),
    "air_temperature [degC]": ("temp", "temperature", "t", "tair", "t_air", "tout", "air_temp", "outdoor_temperature"),
    "relative_humidity [%]": ("rh", "humidity", "relhum", "rel_humidity"),
    "wind_speed [m/s]": ("wind", "windspeed", "ws", "wind_velocity"),
    "global_radiation [W/m2]": ("radiation", "ghi", "rad", "solar", "solar_radiation", "global", "iglob", "glob"),
    "cloud_cover [octants]": ("cloud", "clouds", "cloudiness"),
}
REQUIRED_KEYS = ("latitude", "longitude", "altitude", "timezone")
TEXT_KEYS = ("station", "source", "licence")


def read_csv(path: Path | str, *, name: str | None = None, fill_gaps: int = 0) -> WeatherRecord:
    """Weather record of a CSV in the form documented in docs/weather.md.

    Raises
    ------
    WeatherError
        When a column, unit or comment is missing or unknown, a value is no number, or the hours have gaps; names file, row
        and value.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        msg = f"Cannot read {path}: {error}. The file must exist and be UTF-8 text."
        raise WeatherError(msg) from error
    file = str(path)
    comments, header, rows, numbers = _split(text, file)
    titles = _columns(file, header)
    origin, timing = _described(file, comments, name or path.stem.lower())
    time_title = next(title for title in header if title in TIME_COLUMNS)
    position = header.index(time_title)
    ends = np.array(
        [_time(file, n, row[position]) + TIME_COLUMNS[time_title] for n, row in zip(numbers, rows, strict=True)],
        dtype=np.int64,
    )
    columns = {quantity: _values(file, numbers, rows, header, titles[quantity], quantity) for quantity in titles}
    return assemble(Rows(file, ends, columns, timing, np.array(numbers, dtype=np.int64)), origin, fill_gaps=fill_gaps)


def _split(text: str, file: str) -> tuple[dict[str, str], list[str], list[list[str]], list[int]]:
    """Comments, header, rows, and the rows' line numbers."""
    comments: dict[str, str] = {}
    header: list[str] = []
    rows: list[list[str]] = []
    numbers: list[int] = []
    for number, line in enumerate(io.StringIO(text), start=1):
        if line.lstrip().startswith("#"):
            key, colon, value = line.lstrip("# \t").partition(":")
            if colon:
                comments[key.strip()] = value.strip()
        elif line.strip():
            fields = [field.strip() for field in next(csv.reader([line]))]
            if not header:
                header = fields
                continue
            if len(fields) != len(header):
                msg = f"{file}, row {number}: {len(fields)} fields instead of {len(header)}. Is the file whole?"
                raise WeatherError(msg)
            rows.append(fields)
            numbers.append(number)
    if not rows:
        msg = f"{file} holds no hourly values. Is it the right file, and whole?"
        raise WeatherError(msg)
    return comments, header, rows, numbers


def _columns(file: str, header: Sequence[str]) -> dict[str, str]:
    """Title of each quantity's column; every title must be known, so that a misspelt one is not quietly left out."""
    titles: dict[str, str] = {}
    problems = []
    for title in header:
        if title in TIME_COLUMNS:
            continue
        quantity = _TITLES.get(title)
        if quantity is None:
            near = meant_by(title)
            hint = f" Did you mean '{near}'?" if near else did_you_mean(title, [*_TITLES, *TIME_COLUMNS])
            problems.append(f"unknown column '{title}'.{hint}")
        elif quantity in titles:
            problems.append(f"two columns for {quantity}: '{titles[quantity]}' and '{title}'. Keep one.")
        else:
            titles[quantity] = title
    if not any(title in TIME_COLUMNS or meant_by(title) in TIME_COLUMNS for title in header):
        problems.append(f"no time column. Name it '{next(iter(TIME_COLUMNS))}' or 'slot_start [UTC]'.")
    if problems:
        missing = [title for title in _EXPECTED if _TITLES.get(title) in QUANTITIES and _TITLES[title] not in titles]
        lines = [*problems[:_MOST_PROBLEMS], *([f"missing: {', '.join(missing)}"] if missing else [])]
        listed, found = "\n".join(f"  - {line}" for line in lines), ",".join(header)[:_LONGEST_HEADER]
        msg = f"{file}: the titles of its columns cannot be used.\n{listed}\n  found:    {found}\n  expected: {EXPECTED_HEADER}"
        raise WeatherError(msg)
    return titles


def meant_by(title: str) -> str | None:
    """The documented title that a short one such as ``temp`` or ``RH (%)`` seems to mean."""
    word = re.sub(r"[\[(].*", "", title).strip().lower().replace(" ", "_").replace("-", "_")
    return next((meant for meant, words in _SHORT.items() if word in words), None)


def _described(file: str, comments: Mapping[str, str], name: str) -> tuple[Origin, dict[str, Timing]]:
    timing = dict(DEFAULT_TIMING)
    known = (*REQUIRED_KEYS, *TEXT_KEYS, *(f"timing {quantity}" for quantity in QUANTITIES))
    for key, value in comments.items():
        if key not in known:
            msg = f"{file}: unknown comment '# {key}: ...'.{did_you_mean(key, known)} Leave other remarks without a colon."
            raise WeatherError(msg)
        if key.startswith("timing "):
            if value not in get_args(Timing):
                msg = f"{file}: '# {key}: {value}' must be instant (at the slot's end) or mean (over the slot)."
                raise WeatherError(msg)
            timing[key.removeprefix("timing ")] = cast(Timing, value)
    if timing["global_radiation"] != "mean":
        msg = f"{file}: global radiation must be a mean (or sum) over the slot; an instant does not tell the hour's energy."
        raise WeatherError(msg)
    missing = [key for key in REQUIRED_KEYS if key not in comments]
    if missing:
        msg = f"{file}: the comment lines do not give {', '.join(missing)}. Add a line such as '# {missing[0]}: ...' on top."
        raise WeatherError(msg)
    latitude, longitude, altitude = (_number(file, 0, key, comments[key]) for key in REQUIRED_KEYS[:3])
    place = Place(comments.get("station", name), latitude, longitude, altitude, comments["timezone"])
    source = comments.get("source", f"file {Path(file).name}")
    return Origin(name, place, source, comments.get("licence", "Not stated in the file.")), timing


def _time(file: str, row: int, text: str) -> int:
    try:
        moment = dt.datetime.fromisoformat(text)
    except ValueError as error:
        msg = f"{file}, row {row}: '{text}' is no time such as 2010-03-01T05:00Z. Correct the file."
        raise WeatherError(msg) from error
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=dt.UTC)
    return int(moment.timestamp())


def _values(
    file: str, numbers: Sequence[int], rows: Sequence[Sequence[str]], header: Sequence[str], title: str, quantity: str
) -> FloatArray:
    """The column ``title`` in the canonical unit of ``quantity``; an empty field is a missing value (NaN)."""
    factor, offset = UNITS[quantity][title[title.index("[") + 1 : -1]]
    position = header.index(title)
    raw = [
        _number(file, number, title, row[position]) if row[position] else math.nan
        for number, row in zip(numbers, rows, strict=True)
    ]
    return np.asarray(np.array(raw) * factor + offset)


def _number(file: str, row: int, what: str, text: str) -> float:
    where = f", row {row}" if row else ""
    try:
        value = float(text)
    except ValueError as error:
        msg = f"{file}{where}: '{text}' for {what} is no number. Correct the file; leave a missing value empty."
        raise WeatherError(msg) from error
    if not math.isfinite(value):
        msg = f"{file}{where}: '{text}' for {what} is not finite. Correct the file; leave a missing value empty."
        raise WeatherError(msg)
    return value
