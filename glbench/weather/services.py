"""Readers of what weather services export: PVGIS, NSRDB (PSM3, PSM4), Open-Meteo, SolarAnywhere.

**PVGIS** typical years and hourly series. Stamps are UTC. Radiation is an instant, in typical years later than the stamp by the file's
"Irradiance Time Offset"; the rest are instants at the stamp. **NSRDB**: the stamp is the middle of the interval, whose mean the values are
taken for; standard time by the file's "Time Zone". **Open-Meteo**: radiation is the mean over the interval before the stamp, the rest are
instants. **SolarAnywhere**: means over the interval before the stamp, local standard time.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from zoneinfo import ZoneInfo

import numpy as np

from glbench.errors import WeatherError, refuse
from glbench.outside_tables import HOUR, Stamps, TextTable, read_stamps, split_table, step_of, utc_of_local
from glbench.untrusted import parse_json, reason_of
from glbench.weather import reading, record
from glbench.weather.column_map import UNITS, canonical_unit

_MISSING = (-9999, -999)
_PVGIS_LICENCE = "PVGIS (c) European Union: free to use, with the source acknowledged."
_OPEN_METEO_LICENCE = "CC BY 4.0, weather data by Open-Meteo.com"
_OPEN_METEO_NAMES: Mapping[str, tuple[str, ...]] = {
    "air_temperature": ("temperature_2m",),
    "relative_humidity": ("relative_humidity_2m", "relativehumidity_2m"),
    "wind_speed": ("wind_speed_10m", "windspeed_10m"),
    "global_radiation": ("shortwave_radiation",),
    "cloud_cover": ("cloud_cover", "cloudcover"),
}
"""What Open-Meteo calls the quantities."""
OPEN_METEO_HEADER = "utc_offset_seconds"


def parse_pvgis(text: str, file: str, *, estimate_humidity: bool = False) -> reading.Reading:
    """A typical year or an hourly series of PVGIS, as CSV or JSON.

    The hourly series has no humidity. With ``estimate_humidity`` the day's lowest temperature is taken for the dew point; otherwise it is
    refused. Raises ``WeatherError`` when columns are missing, or the plane is tilted; a row that does not fit is named.
    """
    table, facts = _pvgis_table(text, file)
    # stamps such as 20200101:0010
    title = reading.needed_title(table, "time(UTC)")
    day = r"2001\2 " if "G(h)" in table.titles else r"\1\2 "  # the months of a typical year are of several years, and none has 29 February
    texts = [[re.sub(r"^(\d{4})(\d{4}):", day, text)] for text in table.texts(title)]
    stamps = read_stamps(TextTable(table.file, table.refusal, (), (title,), texts, table.lines), (title,)).seconds
    notes: list[str] = []
    tilted = [title for title in ("G(i)", "Gb(i)", "Gd(i)", "Gr(i)") if title in table.titles]
    typical = "G(h)" in table.titles
    if not typical and not tilted:
        table.refuse(f"there is no column of radiation, G(h) or G(i). It has: {', '.join(table.titles)}.")
    slope = facts.get("slope")
    reflects = "Gr(i)" in table.titles and table.numbers("Gr(i)").any()
    is_horizontal = slope == 0.0 if isinstance(slope, float) else slope is None and "Gr(i)" in table.titles and not reflects
    if not typical and not is_horizontal:
        table.refuse(
            f"its radiation is that on a tilted plane (slope {facts.get('slope', 'not stated')}). The greenhouse needs "
            "global horizontal radiation: export it again with slope 0, or take the typical year of PVGIS."
        )
    parts = ["G(h)"] if typical else ["G(i)"] if "G(i)" in tilted else tilted
    columns = {
        "air_temperature": table.numbers(reading.needed_title(table, "T2m")),
        "wind_speed": table.numbers(reading.needed_title(table, "WS10m")),
        "global_radiation": np.sum([table.numbers(title) for title in parts], axis=0),
    }
    if "IR(h)" in table.titles:
        columns["sky_infrared"] = table.numbers("IR(h)")
    if humidity := reading.title_of(table, "RH"):
        columns["relative_humidity"] = table.numbers(humidity)
    elif estimate_humidity:
        columns["relative_humidity"] = reading.humidity_of_daily_minimum(stamps, columns["air_temperature"])
        notes.append("relative humidity estimated: the day's lowest temperature taken for the dew point (FAO-56, equation 48)")
    else:
        msg = (
            f"{file} has no humidity, which the greenhouse needs; PVGIS gives it in its typical years only. Export the typical year, take "
            "another source such as Open-Meteo, or estimate it from the day's lowest temperature with --estimate-humidity."
        )
        raise WeatherError(msg)
    lines = np.array(table.lines, dtype=np.int64)
    if typical:
        delay = _fact(facts, "irradiance time offset") or 0.0
        whole = round(delay)
        share = 0.5 + delay - whole  # of the hour before the stamp, what lies nearer to the instant that its beginning has
        late = np.roll(columns["global_radiation"], whole)
        columns["global_radiation"] = share * np.roll(late, 1) + (1.0 - share) * late
        rows = record.Rows(file, stamps, columns, {**reading.TIMING, "sky_infrared": "instant"}, lines)
        notes.append(f"radiation is an instant {delay * 60:.0f} min after the stamp; an hour takes that of the nearest instant")
    else:
        rows = record.Rows(file, stamps + HOUR // 2, columns, reading.MEANS, lines)
        minute = int(np.median(stamps % HOUR)) // 60
        notes.append(f"values are instants at minute {minute}, each taken for the hour around it")
    return reading.Reading(
        rows,
        f"PVGIS {facts.get('latitude', '?')}, {facts.get('longitude', '?')}",
        f"PVGIS (European Commission, Joint Research Centre), {'typical year' if typical else 'hourly series'}, {reading.file_name(file)}",
        (_fact(facts, "latitude"), _fact(facts, "longitude"), _fact(facts, "elevation")),
        licence=_PVGIS_LICENCE,
        typical=typical,
        notes=tuple(notes),
    )


def _fact(facts: Mapping[str, float | str], key: str) -> float | None:
    value = facts.get(key)
    return value if isinstance(value, float) else None


def _pvgis_table(text: str, file: str) -> tuple[TextTable, dict[str, float | str]]:
    """The table, and the numbers (or texts) of its heading by their names in small letters, without units."""
    facts: dict[str, float | str] = {}
    if text.lstrip().startswith(("{", "[")):
        try:
            document = parse_json(text)
            inputs = document.get("inputs", {}) if isinstance(document, dict) else {}
            outputs = document.get("outputs", {}) if isinstance(document, dict) else document
            series = outputs if isinstance(outputs, list) else outputs.get("tmy_hourly") or outputs.get("hourly")
            if not isinstance(series, list):
                refuse(f"{file} holds no hourly values of PVGIS. Export it again, as CSV or JSON.", WeatherError)
            titles = tuple(series[0])
            rows = [[str(row[title]) for title in titles] for row in series]
            facts = {key.replace("_", " "): float(value) for key, value in inputs.get("location", {}).items() if value is not None}
            slopes = re.findall(r'"slope"\s*:\s*\{\s*"value"\s*:\s*("[^"]*"|[-\d.]+)', text)
            for slope in slopes:
                facts["slope"] = float(slope) if re.fullmatch(r"[-\d.]+", slope) else slope.strip('"')
        except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
            refuse(f"{file} is no weather of PVGIS: {reason_of(error)}. Export it again, as CSV.", WeatherError, error)
        return TextTable(file, WeatherError, (), titles, rows, range(1, len(rows) + 1)), facts
    lines = text.split("\n")
    titles_pattern = re.compile(r"\s*\"?time\s*(\(UTC\))?\"?\s*[,;\t]")
    first = next((i for i, line in enumerate(lines) if titles_pattern.match(line)), None)
    if first is None:
        msg = f"{file} holds no hourly values of PVGIS: there is no line of titles such as 'time(UTC),T2m,RH,G(h)'. Export it again."
        raise WeatherError(msg)
    last = next((i for i in range(first, len(lines)) if not lines[i].strip(" ,;\t")), len(lines))
    for line in lines[:first]:
        match = re.match(r"\s*\"?([A-Za-z ]+?)\s*(?:\([^)]*\))?\s*:\s*(.*?)[\s,;\"]*$", line)
        if match:
            number = re.match(r"-?\d+(?:[.,]\d+)?(?=$|\s|°|deg)", match[2])
            facts[match[1].lower()] = float(number[0].replace(",", ".")) if number else match[2]
    body = "\n".join(["" for _ in lines[:first]] + lines[first:last])
    return split_table(body, file, WeatherError, is_titles=lambda fields: fields[0].startswith("time")), facts


def parse_nsrdb(text: str, file: str) -> reading.Reading:
    """A file of NREL's National Solar Radiation Database: PSM3 or PSM4, 5 to 60 minutes, real or typical years.

    Raises ``WeatherError`` when columns or facts of the heading are missing; a row that does not fit is named.
    """
    table = split_table(
        text, file, WeatherError, is_titles=lambda fields: [field.lower() for field in fields[:4]] == ["year", "month", "day", "hour"]
    )
    facts = _heading(table.preamble)
    calendar_columns = [table.numbers(reading.needed_title(table, name)) for name in ("Year", "Month", "Day", "Hour")]
    minute = reading.title_of(table, "Minute")
    minutes = table.numbers(minute) if minute else np.zeros(len(table.rows))
    hours = zip(*calendar_columns, strict=True)
    texts = [[f"{year:04.0f}-{month:02.0f}-{day:02.0f} {hour:02.0f}:00"] for year, month, day, hour in hours]
    dates = TextTable(table.file, table.refusal, (), ("Year, Month, Day, Hour",), texts, table.lines)
    stamps = read_stamps(dates, dates.titles).seconds + minutes.astype(np.int64) * 60
    notes: list[str] = []
    temperature = table.numbers(reading.needed_title(table, "Temperature", "air_temperature"), _MISSING)
    columns = {
        "air_temperature": temperature,
        "relative_humidity": reading.humidity_column(table, temperature, ("Relative Humidity",), ("Dew Point",), _MISSING, notes),
        "wind_speed": table.numbers(reading.needed_title(table, "Wind Speed"), _MISSING),
        "global_radiation": table.numbers(reading.needed_title(table, "GHI"), _MISSING),
    }
    step = step_of(stamps)
    ends, lines = stamps + step // 2, np.array(table.lines, dtype=np.int64)
    if ends[-1] % HOUR:  # the last row counts to the end of its hour
        ends, lines = np.append(ends, -(-ends[-1] // HOUR) * HOUR), np.append(lines, lines[-1])
        columns = {quantity: np.append(values, values[-1]) for quantity, values in columns.items()}
    place = {name: facts.get(name) for name in ("latitude", "longitude", "elevation", "time zone")}
    latitude, longitude, altitude, offset = (
        None if field is None else reading.number_of(file, 2, name, field) for name, field in place.items()
    )
    if offset is None:
        refuse(f"{file}, row 1: the heading has no 'Time Zone', so it is unclear when the rows are. Download the file again.", WeatherError)
    local = facts.get("local time zone")
    shift = reading.number_of(file, 2, "local time zone", local) if local else offset
    # Typical years are turned in the clock of their rows; the local clock is another one where the rows are in UTC.
    zone = f"Etc/GMT{-int(shift):+d}" if shift and shift == int(shift) and not offset else None
    state = ", ".join(facts[name] for name in ("city", "state", "country") if facts.get(name, "-").strip("-"))
    return reading.Reading(
        record.Rows(file, ends, columns, reading.MEANS, lines),
        state or f"NSRDB {facts.get('location id', '')}".strip(),
        f"NREL {facts.get('source', 'NSRDB')}, location {facts.get('location id', 'not stated')}, {reading.file_name(file)}",
        (latitude, longitude, altitude),
        offset,
        zone,
        notes=(*notes, f"stamps are the middles of intervals of {step // 60} min"),
    )


def _heading(lines: Sequence[str]) -> dict[str, str]:
    """Names in the first line, in small letters, and the texts below them."""
    rows = [row for row in csv.reader(lines, delimiter=";" if lines and lines[0].count(";") > lines[0].count(",") else ",") if row]
    return {} if len(rows) < 2 else {name.strip().lower(): text.strip() for name, text in zip(rows[0], rows[1], strict=False)}


def parse_open_meteo(text: str, file: str) -> reading.Reading:
    """A CSV of Open-Meteo: its hourly rows, or those of 15 minutes.

    Raises ``WeatherError`` when it holds several places, only daily rows, or lacks a column; a row that does not fit is named.
    """
    lines = text.split("\n")
    blocks: list[list[int]] = [[]]
    for i, line in enumerate(lines):
        if line.strip(" ,;\t"):
            blocks[-1].append(i)
        elif blocks[-1]:
            blocks.append([])
    facts = _heading([lines[i] for i in blocks[0][:2]])
    if len(blocks[0]) > 2 and not re.match(r"\W?(location_id[,;])?time\b", lines[blocks[0][2]]):
        refuse(f"{file} holds {len(blocks[0]) - 1} places. Download one place a file.", WeatherError)
    if len(blocks[0]) > 2:  # no blank line between the heading and the table
        blocks.insert(1, blocks[0][2:])
    tables = []
    for block in blocks[1:]:
        if len(block) > 1 and re.match(r"\W?(location_id[,;\t])?time\b", lines[block[0]]):
            body = ["" for _ in lines[: block[-1] + 1]]
            for i in block:
                body[i] = lines[i]
            table = split_table("\n".join(body), file, WeatherError, is_titles=lambda fields: "time" in fields[:2])
            stamps = read_stamps(table, ("time",))
            if len(table.rows) > 1 and step_of(stamps.seconds) <= HOUR:
                tables.append((table, stamps))
    if not tables:
        refuse(f"{file} holds no hourly values. Choose hourly variables in Open-Meteo's export; daily ones are too coarse.", WeatherError)
    # The hourly rows where they have all that is needed, else the finer ones.
    tables.sort(key=lambda pair: (_open_meteo_column(pair[0], "temperature_2m", "air_temperature") is None, -step_of(pair[1].seconds)))
    table, stamps = tables[0]
    notes: list[str] = []
    columns = _open_meteo_columns(table, notes)
    latitude, longitude, altitude = (
        None if facts.get(name, "nan").lower() == "nan" else reading.number_of(file, 2, name, facts[name])
        for name in ("latitude", "longitude", "elevation")
    )
    seconds, zone = _open_meteo_clock(table, stamps, facts, notes)
    return reading.Reading(
        record.Rows(file, seconds, columns, reading.TIMING, np.array(table.lines, dtype=np.int64)),
        f"Open-Meteo {facts.get('latitude', '?')}, {facts.get('longitude', '?')}",
        f"Open-Meteo.com, {reading.file_name(file)}",
        (latitude, longitude, altitude),
        zone=zone,
        licence=_OPEN_METEO_LICENCE,
        notes=tuple(notes),
    )


def _open_meteo_columns(table: TextTable, notes: list[str]) -> dict[str, record.FloatArray]:
    """Quantities of a table of Open-Meteo, in canonical units."""

    def column(quantity: str, *names: str) -> record.FloatArray | None:
        return next((values for name in names if (values := _open_meteo_column(table, name, quantity)) is not None), None)

    present = {name: values for name, names in _OPEN_METEO_NAMES.items() if (values := column(name, *names)) is not None}
    dew_point = column("air_temperature", "dew_point_2m", "dewpoint_2m")
    direct, diffuse = column("global_radiation", "direct_radiation"), column("global_radiation", "diffuse_radiation")
    if "relative_humidity" not in present and "air_temperature" in present and dew_point is not None:
        notes.append("relative humidity from the dew point")
        present["relative_humidity"] = reading.humidity_of_dew_point(present["air_temperature"], dew_point)
    if "global_radiation" not in present and direct is not None and diffuse is not None:
        present["global_radiation"] = direct + diffuse
    for quantity in record.REQUIRED:
        if quantity not in present:
            reading.needed_title(table, _OPEN_METEO_NAMES[quantity][0])
    return present


def _open_meteo_column(table: TextTable, name: str, quantity: str) -> record.FloatArray | None:
    """Values of a variable in the unit of ``quantity``; ``None`` where the table has no such column."""
    title = next((title for title in table.titles if re.sub(r"\s*[\[(].*", "", title) == name), None)
    if title is None:
        return None
    unit = re.sub(r"[^A-Za-z0-9/%]", "", title[len(name) :])
    own_unit = canonical_unit(quantity, unit)
    if own_unit is None:
        table.refuse(f"the unit '{unit}' is unknown. Known are {', '.join(UNITS[quantity])}.", None, title)
    factor, offset = UNITS[quantity][own_unit]
    return np.asarray(table.numbers(title) * factor + offset)


def _open_meteo_clock(table: TextTable, stamps: Stamps, facts: Mapping[str, str], notes: list[str]) -> tuple[record.IntArray, str | None]:
    """Stamps in UTC [s since 1970-01-01], and the zone of the local clock where the file names one."""
    name = facts.get("timezone", "GMT")
    zone = None if name in ("GMT", "UTC", "Etc/UTC", "Etc/GMT") else name
    offset = round(reading.number_of(table.file, 2, "utc_offset_seconds", facts.get("utc_offset_seconds", "0")))
    if zone is not None:
        record.time_zone(zone)
    if stamps.zoned:
        return stamps.seconds, zone
    fixed = stamps.seconds - offset
    if zone is not None and np.unique(np.diff(stamps.seconds)).size > 1:
        # An hour that is missing or twice: the stamps follow the clock of the zone, if they are regular on it.
        try:
            seconds = utc_of_local(table, stamps.seconds, ZoneInfo(zone), "time")
        except WeatherError:
            return fixed, zone
        if np.unique(np.diff(seconds)).size == 1:
            return seconds, zone
    if zone is not None:
        notes.append(f"the file's clock is {offset / HOUR:+g} h from UTC all year, without a change to or from summer time")
    return fixed, zone


def parse_solar_anywhere(text: str, file: str) -> reading.Reading:
    """A file of SolarAnywhere in its own form. Raises ``WeatherError`` as ``parse_nsrdb`` does."""
    table = split_table(text, file, WeatherError, is_titles=lambda fields: fields[0].startswith("ObservationTime"))
    above = next(csv.reader([line for line in table.preamble if line.strip()][:1]), [])
    if len(above) < 7:
        msg = f"{file}, row 1: it is not 'number, name, state, time zone, latitude, longitude, altitude'. Download the file again."
        raise WeatherError(msg)
    offset, latitude, longitude, altitude = (
        reading.number_of(file, 1, what, field)
        for what, field in zip(("time zone", "latitude", "longitude", "altitude"), above[3:7], strict=True)
    )
    about = " ".join(above[7:])
    if "end of period" not in about.lower():
        msg = f"{file}, row 1: its values are not means to the end of a period ('{about[:80]}'). Export them with 'End of Period'."
        raise WeatherError(msg)
    stamps = read_stamps(table, (table.titles[0],), order="month first")
    temperature = table.numbers(reading.needed_title(table, "AmbientTemperature (deg C)"), _MISSING)
    columns = {
        "air_temperature": temperature,
        "relative_humidity": table.numbers(reading.needed_title(table, "Relative Humidity (%)"), _MISSING),
        "wind_speed": table.numbers(reading.needed_title(table, "WindSpeed (m/s)"), _MISSING),
        "global_radiation": table.numbers(
            next((title for title in table.titles if "(GHI)" in title), None) or reading.needed_title(table, "GHI"), _MISSING
        ),
    }
    return reading.Reading(
        record.Rows(file, stamps.seconds, columns, reading.MEANS, np.array(table.lines, dtype=np.int64)),
        " ".join(above[1].split()),
        f"SolarAnywhere {reading.file_name(file)}",
        (latitude, longitude, altitude),
        offset,
        typical="typical" in about.lower(),
    )
