"""Readers of EnergyPlus weather files (EPW) and of NREL's typical years (TMY3, TMY2).

All stamp local standard time. Radiation is the mean over the interval before the stamp; temperature, humidity, wind and cloud are
instants at the stamp; the sky's infrared radiation in EPW is a mean over the interval. Codes for "missing" become gaps.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence

import numpy as np

from glbench.errors import WeatherError, refuse
from glbench.outside_tables import HOUR, TextTable, read_stamps, split_table
from glbench.untrusted import visible
from glbench.weather import reading, record

_EPW_FIELDS = (
    *("year", "month", "day", "hour", "minute", "flags", "dry-bulb temperature", "dew point", "relative humidity", "pressure"),
    *("extraterrestrial", "extraterrestrial direct", "horizontal infrared", "global horizontal radiation", "direct", "diffuse"),
    *("illuminance", "direct illuminance", "diffuse illuminance", "zenith luminance", "wind direction", "wind speed", "sky cover"),
)
_DEW_POINT = ("dew point", (99.9, 999, 999.9, 9999, -99, -99.9, -999, -9999))
_EPW_COLUMNS: Mapping[str, tuple[str, tuple[float, ...]]] = {
    "air_temperature": ("dry-bulb temperature", _DEW_POINT[1]),
    "relative_humidity": ("relative humidity", (999, 9999, -99, -999, -9999)),
    "wind_speed": ("wind speed", (99.9, 999, 999.9, 9999, -99, -999, -9999)),
    "global_radiation": ("global horizontal radiation", (9999, 99999, 999999, -999, -9999)),
    "cloud_cover": ("sky cover", (99, 999, 9999, -99, -999, -9999)),
    "sky_infrared": ("horizontal infrared", (0, 9999, 99999, 999999, -999, -9999)),
}
"""Fields of the quantities, and the codes for a missing value."""
_TMY3_MISSING = (-9900, -999, -9999)
_TMY2_FIELDS: Mapping[str, slice] = {
    "year": slice(1, 3), "month": slice(3, 5), "day": slice(5, 7), "hour": slice(7, 9), "global horizontal radiation": slice(17, 21),
    "total sky cover": slice(59, 61), "dry-bulb temperature": slice(67, 71), "relative humidity": slice(79, 82),
    "wind speed": slice(95, 98),
}  # fmt: skip
TMY2_HEADER = re.compile(
    r"\s*(?P<number>\d{5})\s+(?P<city>\S.*?)\s+(?P<state>[A-Z]{2})\s+(?P<zone>-?\d+(?:\.\d+)?)\s+(?P<ns>[NS])\s*(?P<north>\d+)\s+"
    r"(?P<north_minutes>\d+)\s+(?P<ew>[EW])\s*(?P<east>\d+)\s+(?P<east_minutes>\d+)\s+(?P<altitude>-?\d+)\s*"
)


def parse_epw(text: str, file: str) -> reading.Reading:
    """An EnergyPlus weather file, hourly or finer. Raises ``WeatherError``, with file, row and value, when it is none or wrong."""
    lines = text.split("\n")
    first = next((i for i, line in enumerate(lines) if line.strip()), 0)
    heading = next(csv.reader([lines[first].strip()]))
    if heading[0].strip().upper() != "LOCATION":
        msg = (
            f"{file} cannot be read as an EnergyPlus weather file (EPW): it begins with '{visible(lines[first][:60])}' instead of "
            "LOCATION. Choose another --format."
        )
        raise WeatherError(msg)
    while not heading[-1].strip():
        heading.pop()
    # From the end: a comma in the name of the place shifts the others.
    latitude, longitude, offset, altitude = (
        reading.number_of(file, first + 1, what, field)
        for what, field in zip(("latitude", "longitude", "time zone", "altitude"), heading[-4:], strict=False)
    )
    rows = [
        (number, [field.strip() for field in line.split(",")])
        for number, line in enumerate(lines[first + 1 :], start=first + 2)
        if re.match(r"\s*\d{1,4}\s*,\s*\d{1,2}\s*,\s*\d{1,2}\s*,\s*\d", line)
    ]
    begin = rows[0][0] if rows else len(lines)
    between = (i for i, line in enumerate(lines[begin:], begin + 1) if line.strip(" ,\x1a"))
    table = TextTable(
        file, WeatherError, (), _EPW_FIELDS, [fields[: len(_EPW_FIELDS)] for _, fields in rows], [number for number, _ in rows]
    )
    for i, (number, fields) in enumerate(rows):
        if i and (stray := next(between, number)) != number:
            refuse(f"{file}, row {stray}: '{visible(lines[stray - 1][:60])}' is no row of an EPW. Correct the file.", WeatherError)
        if len(fields) < len(_EPW_FIELDS):
            table.refuse(f"{len(fields)} fields instead of at least {len(_EPW_FIELDS)}. Is the file whole?", i)
    if not rows:
        refuse(f"{file} holds no hourly values. Is it the right file, and whole?", WeatherError)
    notes: list[str] = []
    ends = _epw_ends(table, notes)
    columns = {quantity: table.numbers(*field) for quantity, field in _EPW_COLUMNS.items()}
    columns["cloud_cover"] *= reading.OCTANTS_PER_TENTH
    if np.isnan(columns["sky_infrared"]).all():
        notes.append("the sky's infrared radiation is 0 or missing in every row: it is left out")
    if np.isnan(columns["relative_humidity"]).all():
        columns["relative_humidity"] = reading.humidity_of_dew_point(columns["air_temperature"], table.numbers(*_DEW_POINT))
        notes.append("relative humidity from the dew point")
    columns = reading.without_constant_zero(columns, ("cloud_cover",), notes)
    names = [field.strip() for field in heading[1:-4]]
    station = ", ".join(name for name in (names[0], *names[2:3]) if name.strip("-")) if names else ""
    source = f"EnergyPlus weather file {reading.file_name(file)} ({station}; {names[3] if len(names) > 3 else 'source not stated'})"
    return reading.Reading(
        record.Rows(file, ends, columns, reading.TIMING, np.array(table.lines, dtype=np.int64)),
        station,
        source,
        (latitude, longitude, altitude),
        offset,
        notes=tuple(notes),
    )


def _epw_ends(table: TextTable, notes: list[str]) -> record.IntArray:
    """End of each row's interval [s since 1970-01-01] on the file's clock; hours count to their end, 1 to 24."""
    year, month, day, hour = (table.numbers(name) for name in ("year", "month", "day", "hour"))
    zero, latest = np.flatnonzero(hour == 0), float(np.nanmax(hour))
    if zero.size and latest < 24:
        notes.append(
            f"hours run from 0 to {latest:g} instead of 1 to 24 (row {table.lines[zero[0]]}): each is taken for the one that begins then"
        )
        hour = hour + 1.0
    of_hour = record.ends_of_hours(year, month, day, hour, lambda i, what: table.refuse(f"{what}. Correct the file.", i)) // HOUR - 1
    # Several rows an hour follow each other within it; what the minutes are called differs from writer to writer.
    begins = np.flatnonzero(np.diff(of_hour, prepend=of_hour[0] - 1) != 0)
    counts = np.diff(begins, append=of_hour.size)
    per_hour = int(np.bincount(counts).argmax())
    wrong = np.flatnonzero(counts != per_hour)
    if wrong.size and per_hour > 1:
        table.refuse(f"this hour has {counts[wrong[0]]} rows, most have {per_hour}. Correct the file.", int(begins[wrong[0]]))
    if per_hour > 1 and HOUR % per_hour == 0:
        position = np.arange(of_hour.size) - np.repeat(begins, counts)
        return np.asarray(of_hour * HOUR + (position + 1) * (HOUR // per_hour), dtype=np.int64)
    return np.asarray((of_hour + 1) * HOUR, dtype=np.int64)


def parse_tmy(text: str, file: str) -> reading.Reading:
    """A typical year of NREL: TMY3, or another provider's file in that form, or TMY2. Raises ``WeatherError`` as ``parse_epw`` does."""
    if TMY2_HEADER.match(text.partition("\n")[0]) or file.lower().endswith((".tm2", ".tmy2")):
        return parse_tmy2(text, file)
    table = split_table(text, file, WeatherError, is_titles=lambda fields: bool(fields) and fields[0].lower().startswith("date (mm/dd"))
    above = [line for line in table.preamble if not line.startswith("#")]
    heading = next(csv.reader(above[:1], delimiter=";" if ";" in "".join(above[:1]) else ",", skipinitialspace=True), [])
    if len(heading) < 7:
        msg = f"{file} cannot be read as a TMY3 file: no line 'number, name, state, zone, latitude, longitude, altitude' above titles."
        raise WeatherError(msg)
    offset, latitude, longitude, altitude = (
        reading.number_of(file, 1, what, field)
        for what, field in zip(("time zone", "latitude", "longitude", "altitude"), heading[3:7], strict=True)
    )
    stamps = read_stamps(table, (table.titles[0], reading.needed_title(table, "Time (HH:MM)")), order="month first")
    if np.any(stamps.seconds % HOUR):
        table.refuse("its stamps are not whole hours, so it is unclear which hour a value belongs to. Use hour-ending TMY3.")
    notes: list[str] = []
    columns = {
        "air_temperature": table.numbers(reading.needed_title(table, "Dry-bulb (C)"), _TMY3_MISSING),
        "wind_speed": table.numbers(reading.needed_title(table, "Wspd (m/s)"), _TMY3_MISSING),
        "global_radiation": table.numbers(reading.needed_title(table, "GHI (W/m^2)"), _TMY3_MISSING),
    }
    columns["relative_humidity"] = reading.humidity_column(
        table, columns["air_temperature"], ("RHum (%)",), ("Dew-point (C)",), _TMY3_MISSING, notes
    )
    if cloud := reading.title_of(table, "TotCld (tenths)"):
        columns["cloud_cover"] = table.numbers(cloud, (*_TMY3_MISSING, 99)) * reading.OCTANTS_PER_TENTH
    columns = reading.without_constant_zero(columns, ("cloud_cover",), notes)
    return reading.Reading(
        record.Rows(file, stamps.seconds, columns, reading.TIMING, np.array(table.lines, dtype=np.int64)),
        " ".join(heading[1].strip('" ').split()),
        f"NREL TMY3 {reading.file_name(file)}, station {heading[0].strip()}",
        (latitude, longitude, altitude),
        offset,
        typical="timeseries" not in above[0].lower(),
        notes=tuple(notes),
    )


def parse_tmy2(text: str, file: str) -> reading.Reading:
    """A typical year of NREL in the form TMY2, with columns of fixed width. Raises ``WeatherError`` as ``parse_epw`` does."""
    lines = text.split("\n")
    heading = TMY2_HEADER.fullmatch(lines[0])
    if heading is None:
        msg = (
            f"{file} cannot be read as a TMY2 file: its first line is not 'number, city, state, time zone, latitude, longitude, altitude'. "
            "Choose another --format."
        )
        raise WeatherError(msg)
    rows: list[Sequence[str]] = []
    numbers = []
    for number, line in enumerate(lines[1:], start=2):
        if line.strip(" \x1a"):
            rows.append([line[position] for position in _TMY2_FIELDS.values()])
            numbers.append(number)
    table = TextTable(file, WeatherError, (), tuple(_TMY2_FIELDS), rows, numbers)
    year, month, day, hour = (table.numbers(name) for name in ("year", "month", "day", "hour"))
    columns = {
        # Tenths are divided, as one correctly rounded operation.
        "air_temperature": table.numbers("dry-bulb temperature", (9999,)) / 10.0,
        "relative_humidity": table.numbers("relative humidity", (999,)),
        "wind_speed": table.numbers("wind speed", (999,)) / 10.0,
        "global_radiation": table.numbers("global horizontal radiation", (9999,)),
        "cloud_cover": table.numbers("total sky cover", (99,)) * reading.OCTANTS_PER_TENTH,
    }
    latitude, longitude = (
        (float(heading[degrees]) + float(heading[f"{degrees}_minutes"]) / 60) * (1 if heading[side] in "NE" else -1)
        for degrees, side in (("north", "ns"), ("east", "ew"))
    )
    return reading.Reading(
        record.Rows(
            file,
            record.ends_of_hours(year + 1900, month, day, hour, lambda i, what: table.refuse(f"{what}. Correct the file.", i)),
            columns,
            reading.TIMING,
            np.array(numbers, dtype=np.int64),
        ),
        heading["city"].replace("_", " ").title(),
        f"NREL TMY2 {reading.file_name(file)}, station {heading['number']}",
        (latitude, longitude, float(heading["altitude"])),
        float(heading["zone"]),
        typical=True,
    )
