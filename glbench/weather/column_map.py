"""Tables of weather that people have: the documented CSV, and exports of climate computers through a column map.

A **column map** says which column of a table is what, in which unit, on which clock, and where the station is. ``guess_column_map``
proposes one from the titles and values of a file, ``write_column_map`` writes it as TOML for a person to check, and ``read_columns``
reads a table through it. The documented CSV (docs/weather.md) carries its map in its titles and comments.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from pydantic import Field, field_validator

from glbench import outside_tables as outside
from glbench.errors import WeatherError, did_you_mean, refuse
from glbench.resources import write_atomically
from glbench.settings import Table, read_settings
from glbench.untrusted import visible
from glbench.weather import record
from glbench.weather.hourly import hourly_record
from glbench.weather.preprocessing import KELVIN

JOULES: Mapping[str, float] = {"Wh/m2": 3600.0, "kWh/m2": 3.6e6, "J/cm2": 1e4, "kJ/m2": 1e3, "MJ/m2": 1e6, "J/m2": 1.0}
"""Units of radiation [J m-2] that are sums over the interval."""
UNITS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "air_temperature": {"degC": (1.0, 0.0), "K": (1.0, -KELVIN), "degF": (5 / 9, -160 / 9)},
    "relative_humidity": {"%": (1.0, 0.0), "fraction": (100.0, 0.0)},
    "wind_speed": {"m/s": (1.0, 0.0), "km/h": (1 / 3.6, 0.0), "mph": (0.44704, 0.0), "kn": (1852 / 3600, 0.0)},
    # 2.3 umol of PAR a joule of sunlight (Vanthoor 2011, tables 8.1 and 9.1), as in the greenhouse model
    "global_radiation": {
        "W/m2": (1.0, 0.0),
        "kW/m2": (1e3, 0.0),
        **dict.fromkeys(JOULES, (1.0, 0.0)),
        "J/cm2/h": (1e4 / 3600, 0.0),
        "umol/m2/s": (1 / 2.3, 0.0),
    },
    "cloud_cover": {"octants": (1.0, 0.0), "tenths": (0.8, 0.0), "%": (0.08, 0.0)},
    "sky_infrared": {"W/m2": (1.0, 0.0)},
    "sky_temperature": {"degC": (1.0, 0.0), "K": (1.0, -KELVIN), "degF": (5 / 9, -160 / 9)},
}
"""For every column, the units it may come in: factor and offset to the canonical unit. Sums of energy are also divided by the interval."""
_SPELLINGS: Mapping[str, str] = {
    "c": "degC", "celsius": "degC", "gradc": "degC",  "oc": "degC", "f": "degF", "degf": "degF", "kelvin": "K", "pct": "%", "percent": "%",
    "procent": "%", "%rh": "%", "%rv": "%", "0-1": "fraction", "-": "fraction", "ms-1": "m/s", "m.s-1": "m/s", "m/sec": "m/s",
    "kmh": "km/h", "kph": "km/h", "km/u": "km/h",  "mp/h": "mph", "kt": "kn", "kts": "kn", "knots": "kn", "wm-2": "W/m2", "watt/m2": "W/m2",
    "w/m^2": "W/m2", "w.m-2": "W/m2", "jcm-2": "J/cm2", "j/cm^2": "J/cm2", "whm-2": "Wh/m2", "wh/m^2": "Wh/m2", "kjm-2": "kJ/m2",
    "mjm-2": "MJ/m2", "okta": "octants", "oktas": "octants", "octas": "octants", "1/8": "octants", "umolm-2s-1": "umol/m2/s",
    "umol/m2s": "umol/m2/s", "gradenc": "degC", "graden": "degC", "grc": "degC", "j/cm2/uur": "J/cm2/h", "j/cm2h": "J/cm2/h",
    "km/uur": "km/h", "w": "W/m2", "watt": "W/m2", "w/m": "W/m2", "ms": "m/s", "meters/second": "m/s",
}  # fmt: skip
"""Other spellings of units, in lower case, without spaces and degree signs, with a plain 2 and u."""
TIME_COLUMNS: Mapping[str, Literal["end", "start"]] = {"slot_end [UTC]": "end", "slot_start [UTC]": "start"}
_EXPECTED = ("slot_end [UTC]", "air_temperature [degC]", "relative_humidity [%]", "wind_speed [m/s]", "global_radiation [W/m2]")
EXPECTED_HEADER = (
    f"{','.join(_EXPECTED)}\n  Other units, cloud_cover, sky_infrared or sky_temperature, and the comment lines above it: docs/weather.md."
)
"""The line of titles that the documented CSV needs, and where the rest is explained."""
REQUIRED_KEYS = ("latitude", "longitude", "altitude", "timezone")
TEXT_KEYS = ("station", "source", "licence")
_INSIDE = r"kas|greenhouse|indoor|inside|binnen|innen|set|wens|berekend|calc|bodem|soil|pijp|pipe|rail|water|blad|leaf|gewas|crop|cpu"
_INSIDE += r"|\babt|gew[äa]e?chsh|\bhaus\b|treibhaus|invernadero|\bserre\b|interior|suelo|\bdu sol\b|boden|blatt"
_INSIDE += r"|\bafd|compartment|stook|heat|verwarm|scherm|screen|mat\b|buffer|ketel|boiler"
_GUESSES: Mapping[str, tuple[str, str]] = {
    "relative_humidity": (
        r"\brv\b|\brh\b|rv.?bui|rel.*hum|humid|vocht|feucht(?!e?.?(temp|kugel|therm))|humed|hygrom|^hr.?(ext|out|rel)|\bhum(\b|out|ext)",
        rf"{_INSIDE}|abs|defi[cz]it|vpd|\bvd\b",
    ),
    "wind_speed": (r"wind|\bws(n|\b)|vent\b|viento", rf"{_INSIDE}|dir|richt[iu]ng|gust|stoot|window|luwe|raam|zijde|(?<!out)side|roof|lee"),
    "sky_infrared": (r"pyrgeo|long.?wave|infrared|langwel", rf"{_INSIDE}|net|up"),
    "sky_temperature": (r"sky.?temp|hemeltemp", _INSIDE),
    "cloud_cover": (r"cloud|bewolk|wolken|nubos|\boctants\b", _INSIDE),
    "global_radiation": (
        r"straling|radiation|strahlung|solar|pyrano|glob|\bghi\b|irradi|rayonn|radiaci|^rad$|^slr|^sun|zon",
        rf"{_INSIDE}|uitstraling|\bnet|long|diff|direct|\bdni\b|\bdhi\b",
    ),
    "air_temperature": (
        r"temp|tair|airtc|tout|\bt (air|out)|t.?bui|^t$|\bta\b|dry.?bulb",
        rf"{_INSIDE}|dauw|dew|\bwet(?!ter)|natte|feucht|sky|hemel",
    ),
}
"""What titles of each quantity look like, and what rules them out; in lower case. The first that fits is taken."""


_OUTSIDE = re.compile(r"buiten|bui\b|out|ext|au(ss|ß)en|meteo|weer|weather|wetter", re.IGNORECASE)


class ColumnEntry(Table):
    """Which column holds a quantity, and in which unit."""

    column: str
    unit: str
    total: Literal["interval", "day"] = "interval"
    """Of sums of radiation: over each interval, or running since midnight."""


class PlaceEntry(Table):
    """Where the station is: degrees north and east, metres above sea level, IANA time zone."""

    latitude: float
    longitude: float
    altitude: float
    station: str = ""


class ColumnMap(Table):
    """Which column of a table is what.

    ``time`` is the column of stamps, or those of dates and of times of day; ``stamps`` says whether a stamp is the start, the middle or the
    end of the interval that its row covers. ``clock`` is the IANA zone of the stamps, where they carry no offset from UTC. ``dates``,
    whether day or month comes first, and ``decimal``, the decimal sign, are recognised by default. ``columns`` has the column of each
    quantity, by the quantity's name. ``timezone`` is the IANA zone of the greenhouse, by default the stamps'; ``place`` is the station's.
    """

    time: tuple[str, ...] = Field(min_length=1, max_length=2)
    stamps: Literal["start", "middle", "end"] = "start"
    clock: str = "UTC"
    dates: outside.DateOrder | None = None
    decimal: Literal[".", ","] | None = None
    columns: dict[str, ColumnEntry]
    timezone: str | None = None
    place: PlaceEntry | None = None

    @field_validator("time", mode="before")
    @classmethod
    def _one_or_two(cls, value: object) -> object:
        return (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value

    @field_validator("columns")
    @classmethod
    def _check_units(cls, columns: dict[str, ColumnEntry]) -> dict[str, ColumnEntry]:
        for quantity, entry in columns.items():
            if quantity not in UNITS:
                refuse(f"there is no quantity '{visible(quantity)}'.{did_you_mean(quantity, UNITS)}")
            if canonical_unit(quantity, entry.unit) is None:
                refuse(f"{quantity} cannot come in '{visible(entry.unit)}'. Use one of {', '.join(UNITS[quantity])}.")
        missing = [quantity for quantity in record.REQUIRED if quantity not in columns]
        if missing:
            refuse(f"no column is named for {', '.join(missing)}, which the model needs.")
        return columns


def canonical_unit(quantity: str, unit: str) -> str | None:
    """The unit of ``UNITS`` that ``unit`` is a spelling of; ``None`` for one that the quantity cannot have."""
    return unit_among(UNITS.get(quantity, ()), unit)


def unit_among(units: Iterable[str], unit: str) -> str | None:
    """The one of ``units`` that ``unit`` is a spelling of; ``None`` for another."""
    plain = re.sub("[ °ºâ]", "", unit.lower()).translate(str.maketrans("²µμ⁻¹", "2uu-1"))
    spelling = _SPELLINGS.get(plain, plain).lower()
    return next((name for name in units if name.lower() == spelling), None)


def read_csv(
    path: Path | str,
    *,
    name: str | None = None,
    timezone: str | None = None,
    coordinates: record.Coordinates | None = None,
    fill_gaps: int = 0,
) -> record.WeatherRecord:
    """Weather record of a CSV in the form documented in docs/weather.md.

    ``timezone`` and ``coordinates`` go before those of the comments. Raises ``WeatherError`` when a column, unit or comment is missing or
    unknown, a value is not a number, or the hours have gaps; names file, row and value.
    """
    path = Path(path)
    text = outside.read_text(path, WeatherError)
    documented = re.search(rf"^[^#\n]*\b({'|'.join(UNITS)}|slot_end|slot_start) ?\[", text, re.MULTILINE) is not None
    titles = (lambda fields: any(split_title(field)[0] in (*UNITS, "slot_end", "slot_start") for field in fields)) if documented else None
    table = outside.split_table(text, str(path), WeatherError, is_titles=titles)
    comments = {
        key.strip(): value.strip(" \t,;")
        for key, colon, value in (line.lstrip("# \t").partition(":") for line in table.preamble if line.lstrip().startswith("#"))
        if colon
    }
    entries, time = _documented_columns(table)
    timing = dict(record.USUAL_TIMING)
    notes = tuple(comments.pop(key) for key in list(comments) if key.startswith("note "))
    keys = (*REQUIRED_KEYS, *TEXT_KEYS, "typical year", *(f"timing {quantity}" for quantity in record.QUANTITIES))
    for key, value in comments.items():
        if key not in keys:
            table.refuse(f"unknown comment '# {visible(key)}: ...'.{did_you_mean(key, keys)} Leave other remarks without a colon.")
        if key.startswith("timing "):
            if value not in get_args(record.Timing):
                table.refuse(f"'# {visible(key)}: {visible(value)}' must be instant (at the slot's end) or mean (over the slot).")
            timing[key.removeprefix("timing ")] = cast(record.Timing, value)
    typical = comments.pop("typical year", "no")
    if typical not in ("yes", "no"):
        table.refuse(f"'# typical year: {visible(typical)}' must be yes (its months come from different years) or no.")
    if timing["global_radiation"] != "mean":
        table.refuse("global radiation must be a mean (or sum) over the slot; an instant does not tell the hour's energy.")
    needed = (*(REQUIRED_KEYS[:3] if coordinates is None else ()), *(REQUIRED_KEYS[3:] if timezone is None else ()))
    missing = [key for key in needed if key not in comments]
    if missing:
        option = "--timezone ZONE" if missing == ["timezone"] else "--place LATITUDE,LONGITUDE,ALTITUDE"
        table.refuse(f"the comment lines do not give {', '.join(missing)}. Add '# {missing[0]}: ...' on top, or import with {option}.")
    if coordinates is None:
        numbers = {key: outside.parse_number(comments[key].replace(",", ".")) for key in REQUIRED_KEYS[:2]}
        height = comments[REQUIRED_KEYS[2]]  # which may have thousands
        numbers[REQUIRED_KEYS[2]] = outside.parse_number(height, table.decimal) or outside.parse_number(height)
        for key, number in numbers.items():
            if number is None or not np.isfinite(number):
                table.refuse(f"'{visible(comments[key])}' for {key} is not a number. Correct the file.")
        coordinates = cast(record.Coordinates, tuple(numbers.values()))
    place = record.Place(comments.get("station", name or path.stem.lower()), *coordinates, timezone or comments["timezone"])
    columns = ColumnMap(time=(time,), stamps=TIME_COLUMNS[time], columns=entries)
    source, licence = comments.get("source", f"file {path.name}"), comments.get("licence", "Not stated in the file.")
    origin = record.Origin(name or path.stem.lower(), place, source, licence, typical == "yes", notes)
    return _record_of(table, columns, origin, timing, fill_gaps)


def read_columns(
    path: Path | str,
    columns: ColumnMap | Path | str,
    *,
    name: str | None = None,
    timezone: str | None = None,
    coordinates: record.Coordinates | None = None,
    fill_gaps: int = 0,
) -> record.WeatherRecord:
    """Weather record of a table through a column map, as ``ColumnMap`` or as its TOML file.

    ``timezone`` and ``coordinates`` go before those of the map. Raises ``WeatherError`` when map and table do not fit together, a value is
    not a number, or the hours have gaps; names file, row and value.
    """
    path = Path(path)
    if not isinstance(columns, ColumnMap):
        columns = read_settings(ColumnMap, Path(columns), "the column map", WeatherError, toml=True)
    table = outside.split_table(outside.read_text(path, WeatherError), str(path), WeatherError, decimal=columns.decimal)
    zone = timezone or columns.timezone or columns.clock
    entry = columns.place
    if coordinates is None:
        if entry is None:
            table.refuse("the column map does not say where the station is. Fill in its [place], or import with --place LAT,LON,ALT.")
        coordinates = (entry.latitude, entry.longitude, entry.altitude)
    place = record.Place((entry and entry.station) or path.stem, *coordinates, zone)
    origin = record.Origin(name or path.stem.lower(), place, f"file {path.name}", "Your own measurements.")
    return _record_of(table, columns, origin, dict(record.USUAL_TIMING), fill_gaps)


def _record_of(
    table: outside.TextTable, columns: ColumnMap, origin: record.Origin, timing: Mapping[str, record.Timing], fill_gaps: int
) -> record.WeatherRecord:
    table, stamps = outside.oldest_first(table, outside.read_stamps(table, columns.time, columns.dates))
    zone = record.time_zone(columns.clock)
    seconds = stamps.seconds if stamps.zoned else outside.utc_of_local(table, stamps.seconds, zone, columns.time[0])
    step = outside.step_of(seconds) if seconds.size > 1 else record.SLOT_SECONDS
    others = outside.of_another_step(seconds, step)
    if others.size and any(canonical_unit(quantity, entry.unit) in JOULES for quantity, entry in columns.columns.items()):
        problem = (
            f"its step changes: most rows are {step / 60:g} min apart, but not those around this row, and radiation is a sum over each"
        )
        table.refuse(f"{problem}. Export one step throughout.", int(others[0]), columns.time[0])
    ends = seconds + {"start": step, "middle": step // 2, "end": 0}["start" if stamps.length else columns.stamps]
    values: dict[str, record.FloatArray] = {}
    for quantity, entry in columns.columns.items():
        numbers = table.numbers(entry.column, sentinels=(-999.0, -9999.0))
        unit = cast(str, canonical_unit(quantity, entry.unit))
        if entry.total == "day":
            numbers = _rises(numbers, seconds, step)
        factor, offset = UNITS[quantity][unit]
        # one rounded division, so that J/cm2 and Wh/m2 come out whole
        values[quantity] = numbers * JOULES[unit] / step if unit in JOULES else np.asarray(numbers * factor + offset)
    running = any(entry.total == "day" for entry in columns.columns.values())
    usable = slice(1 if running else 0, None)  # the first of a running sum has none before it
    values = {quantity: numbers[usable] for quantity, numbers in values.items()}
    rows = record.Rows(table.file, ends[usable], values, dict(timing), np.array(table.lines, dtype=np.int64)[usable])
    return hourly_record(rows, replace(origin, notes=(*origin.notes, *table.notes)), fill_gaps=fill_gaps)


def _rises(sums: record.FloatArray, seconds: outside.IntArray, step: int) -> record.FloatArray:
    """What a sum since midnight gains in each row's ``step`` [s], over missing rows its mean; NaN where a gap hides when it began again."""
    rises = np.full(sums.size, np.nan)
    valid = np.flatnonzero(~np.isnan(sums))
    gains, times = np.diff(sums[valid]), np.diff(seconds[valid])
    again = gains < 0
    with np.errstate(divide="ignore", invalid="ignore"):
        means = np.where(again, np.where(times > step, np.nan, sums[valid[1:]]), gains * np.minimum(step / times, 1.0))
    if valid.size:
        rises[valid[0] + 1 : valid[-1] + 1] = np.repeat(means, np.diff(valid))
    return rises


def _documented_columns(table: outside.TextTable) -> tuple[dict[str, ColumnEntry], str]:
    """Columns of the documented CSV and its time column; every title must be known, so that a misspelt one is not quietly left out."""
    entries: dict[str, ColumnEntry] = {}
    problems = []
    titles = [f"{quantity} [{unit}]" for quantity, units in UNITS.items() for unit in units]
    for title in table.titles:
        if title in TIME_COLUMNS:
            continue
        quantity, unit = split_title(title)
        own_unit = canonical_unit(quantity, unit) if quantity in UNITS and unit else None
        if own_unit is None:
            near = guess_quantity(title)
            means = (
                f"{near} [{next(iter(UNITS[near]))}]"
                if near
                else "slot_end [UTC]"
                if re.match("date|time|utc|stamp", title.lower())
                else ""
            )
            hint = f" Did you mean '{means}'?" if means else did_you_mean(title, [*titles, *TIME_COLUMNS])
            problems.append(f"unknown column '{visible(title)}'.{hint}")
        elif quantity in entries:
            problems.append(f"two columns for {quantity}: '{entries[quantity].column}' and '{title}'. Keep one.")
        else:
            entries[quantity] = ColumnEntry(column=title, unit=own_unit)
    time = next((title for title in table.titles if title in TIME_COLUMNS), None)
    if time is None:
        problems.append("no time column. Name it 'slot_end [UTC]' or 'slot_start [UTC]'.")
    missing = [title for title in _EXPECTED if title not in TIME_COLUMNS and split_title(title)[0] not in entries]
    if problems or missing or time is None:
        lines = [*problems[:12], *([f"missing: {', '.join(missing)}"] if missing else [])]
        listing, titles_there = "\n".join(f"  - {line}" for line in lines), visible(",".join(table.titles)[:300])
        table.refuse(
            f"the titles of its columns cannot be used.\n{listing}\n  titles:   {titles_there}\n  expected: {EXPECTED_HEADER}\n"
            f"  For an export that has other titles, `glbench weather columns {Path(table.file).name}` writes a column map."
        )
    return entries, time


def split_title(title: str) -> tuple[str, str]:
    """Words and unit of a title such as ``Buitentemp [°C]``, ``wind (m/s)`` or ``Straling W/m2``; the unit is empty where there is none."""
    match = re.fullmatch(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*", title) or re.fullmatch(r"(.*\S)\s+(\S+)\s*", title)
    if match and (title.rstrip()[-1:] in "])" or any(canonical_unit(quantity, match[2]) for quantity in UNITS)):
        return match[1].strip(), match[2].strip()
    return title.strip(), ""


def guess_quantity(title: str) -> str | None:
    """The quantity that a title such as ``Buitentemp [°C]`` or ``RH (%)`` seems to mean."""
    words = re.sub(r"[_.]", " ", split_title(title)[0].lower())
    return next(
        (quantity for quantity, (fits, not_this) in _GUESSES.items() if re.search(fits, words) and not re.search(not_this, words)), None
    )


def guess_column_map(path: Path | str) -> tuple[ColumnMap, dict[str, str], list[str]]:
    """A column map for a table, as far as titles and values tell; what to check about a column, by its quantity; the columns left out.

    Raises ``WeatherError`` when the file is not a table, or no column looks like the time or one of the quantities that the model needs.
    """
    table = outside.split_table(outside.read_text(Path(path), WeatherError), str(path), WeatherError)
    time = outside.time_titles(table)
    entries: dict[str, ColumnEntry] = {}
    checks: dict[str, str] = {}
    # titles that name the outside before those that do not, and those with a unit of their quantity before others
    unit_of = {title: canonical_unit(guess_quantity(title) or "", split_title(title)[1]) for title in table.titles}
    order = sorted(table.titles, key=lambda title: (_OUTSIDE.search(title) is None, unit_of[title] is None))
    for title in (title for title in order if title not in time):
        quantity = guess_quantity(title)
        if quantity is None:
            continue
        if quantity in entries:
            checks[quantity] = f"or is it '{visible(title)}'?"
            continue
        _, unit = split_title(title)
        own_unit = unit_of[title]
        if _OUTSIDE.search(title) is None and quantity in ("air_temperature", "relative_humidity"):
            checks[quantity] = "is it measured outside, not in the greenhouse?"
        if own_unit is None:
            own_unit = next(iter(UNITS[quantity]))
            checks[quantity] = f"the unit {visible(unit)!r} is not one of {', '.join(UNITS[quantity])}" if unit else "the title has no unit"
            if quantity == "relative_humidity" and np.nanmax(table.numbers(title)) <= 1.0:
                own_unit = "fraction"
            if quantity == "global_radiation" and _is_running(title, table.numbers(title)):
                own_unit = "J/cm2"
        running = own_unit in JOULES and _is_running(title, table.numbers(title))
        entries[quantity] = ColumnEntry(column=title, unit=own_unit, total="day" if running else "interval")
    missing = [quantity for quantity in record.REQUIRED if quantity not in entries]
    if missing or not time:
        lacking = ", ".join([*([] if time else ["the time"]), *(f"{name} [{record.QUANTITIES[name].unit}]" for name in missing)])
        table.refuse(
            f"no column looks like {lacking}. Its columns are: {visible(', '.join(table.titles)[:600])}. "
            "Export these quantities, or write the map by hand (docs/weather.md)."
        )
    stamps, ahead = outside.read_stamps(table, time), outside.hours_ahead(" ".join(time))
    clock = "Europe/Amsterdam" if ahead is None else f"Etc/GMT{-ahead:+d}"
    columns = ColumnMap(
        time=time,
        stamps="end" if stamps.ends or "TOA5" in "".join(table.preamble[:1]) else "start",
        clock="UTC" if stamps.zoned or outside.says_utc(" ".join(time)) else clock,
        dates=stamps.order,
        decimal=cast(Any, table.decimal),
        columns={name: entries[name] for name in UNITS if name in entries},
    )
    used = {*time, *(entry.column for entry in entries.values())}
    return columns, checks, [title for title in table.titles if title not in used]


def _is_running(title: str, numbers: record.FloatArray) -> bool:
    """Whether values rise until they fall to almost nothing, as a sum since midnight does; the title tells if none falls."""
    values = numbers[~np.isnan(numbers)]
    values = values[:: -1 if np.sign(np.diff(values)).sum() < 0 else 1]
    falls = np.flatnonzero(np.diff(values) < 0)
    if not falls.size:
        return re.search("som|sum|total|cum", title.lower()) is not None
    return float(np.mean(values[falls + 1] <= 0.1 * values[falls])) > 0.9


def write_column_map(columns: ColumnMap, checks: Mapping[str, str], unused: Sequence[str], source: Path, path: Path) -> None:
    """Write a column map as TOML with a comment for everything that a person has to check."""

    def text(value: object) -> str:
        return json.dumps(value, ensure_ascii=False)

    time = text(columns.time[0]) if len(columns.time) == 1 else f"[{', '.join(map(text, columns.time))}]"
    lines = [
        f"# Column map of {visible(source.name)} for `glbench weather import --columns`. Check every line; CHECK marks a guess.",
        f"time = {time}",
        f"stamps = {text(columns.stamps)}  # CHECK: is a stamp the start, middle or end of its row's interval?",
        f"clock = {text(columns.clock)}  # CHECK: clock of the stamps: UTC, a zone with summer time, or Etc/GMT-1 (1 h ahead all year)",
        f"dates = {text(columns.dates)}",
        f"decimal = {text(columns.decimal)}",
        "",
        '# timezone = "Europe/Amsterdam"  # clock of the greenhouse; that of the stamps by default',
        "",
        "# Where the station is; --place and --timezone on the command line override it.",
        "# [place]",
        "# latitude = 52.0    # degrees north",
        "# longitude = 4.5    # degrees east",
        "# altitude = 0.0     # m above sea level",
        "",
    ]
    for quantity, entry in columns.columns.items():
        lines += [
            f"[columns.{quantity}]  # units: {', '.join(UNITS[quantity])}",
            f"column = {text(entry.column)}",
            f"unit = {text(entry.unit)}" + (f"  # CHECK: {checks[quantity]}" if quantity in checks else ""),
        ]
        if entry.unit in JOULES:
            lines.append(f'total = "{entry.total}"  # a sum over each "interval", or running since midnight ("day")')
        lines.append("")
    lines.append(f"# Columns left out: {visible(', '.join(unused)) or 'none'}")
    write_atomically(path, "\n".join(lines) + "\n")
