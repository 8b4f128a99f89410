"""Small weather files for the tests, in the formats that the readers know."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Mapping
from pathlib import Path

KNMI_COMMENTS = (
    "# DISCLAIMER: these are made-up figures for a test.",
    '"# Opmerking: door stationsverplaatsingen zijn deze reeksen mogelijk inhomogeen, zie www.knmi.nl"',
    "# STN         LON(east)   LAT(north)  ALT(m)      NAME",
    "# 209         4.518       52.465      0.00        IJmond",
    "# 240         4.790       52.318      -3.30       Schiphol",
    "# Q        : Globale straling (in J/cm2) per uurvak / Global radiation (in J/cm2) during the hourly division",
)
KNMI_HEADER = "# STN,YYYYMMDD,   HH,    Q,    T,    U,   FH,    N"


def knmi_line(day: dt.date, hour: int, values: Mapping[str, object] | None = None, station: int = 240) -> str:
    """One row as KNMI writes it: the sun shines from 8 to 16 UT, the rest is constant, ``values`` replaces some."""
    row: dict[str, object] = {"Q": 50 if 8 < hour <= 16 else 0, "T": 20 + hour, "U": 80, "FH": 50, "N": 4}
    row |= values or {}
    fields = ",".join(f"{row[name]!s:>5}" for name in ("Q", "T", "U", "FH", "N"))
    return f"  {station},{day:%Y%m%d},{hour:>5},{fields}"


def knmi_days(first: dt.date, days: int, station: int = 240) -> list[str]:
    """Rows of whole days."""
    dates = (first + dt.timedelta(days=i) for i in range(days))
    return [knmi_line(day, hour, station=station) for day in dates for hour in range(1, 25)]


def knmi_text(rows: Iterable[str], *, header: str = KNMI_HEADER, comments: Iterable[str] = KNMI_COMMENTS, end: str = "\r\n") -> str:
    """A whole file or answer."""
    return end.join([*comments, header, *rows, ""])


def write_epw(path: Path, years: Mapping[int, int] | int, *, offset: float = 1.0, edits: Mapping[int, str] | None = None) -> Path:
    """An EPW of a common year; ``years`` is the year, or the year of each month; ``edits`` replaces data rows (from 0)."""
    lines = [
        f"LOCATION,Testdam,NH,NLD,MADE UP,062400,52.3,4.8,{offset},-3.0",
        "DESIGN CONDITIONS,0",
        "TYPICAL/EXTREME PERIODS,0",
        "GROUND TEMPERATURES,0",
        "HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0",
        "COMMENTS 1,made up",
        "COMMENTS 2,",
        "DATA PERIODS,1,1,Data,Sunday,1/1,12/31",
    ]
    begin = dt.datetime(2001, 1, 1)
    for index in range(8760):
        start = begin + dt.timedelta(hours=index)
        year = years if isinstance(years, int) else years[start.month]
        lines.append((edits or {}).get(index) or epw_line(start, year))
    path.write_text("\n".join(lines) + "\n")
    return path


def epw_line(start: dt.datetime, year: int, *, temperature: float | None = None, infrared: float = 300.0, wind: float = 4.5) -> str:
    """One EPW row: temperature 0.1 degC times the hour's number (1..24), radiation 100 Wh/m2 from 8 to 16 h, cloud 5 tenths."""
    hour = start.hour + 1
    degrees = hour / 10 if temperature is None else temperature
    radiation = 100 if 8 < hour <= 16 else 0
    values = [year, start.month, start.day, hour, 60, "?9?9?9", degrees, 2.0, 75, 101300, 0, 0, infrared, radiation]
    values += [0, 0, 0, 0, 0, 0, 180, wind, 5, 5, 10, 7777, 9, 999999999, 0, 0, 0, 88, 0.2, 0, 0]
    return ",".join(str(value) for value in values)


def write_tmy3(path: Path, *, drop: int = 0) -> Path:
    """A TMY3 whose February comes from a leap year (without its 29th); ``drop`` rows are missing at the end."""
    header = ["Date (MM/DD/YYYY)", "Time (HH:MM)", "GHI (W/m^2)", "TotCld (tenths)", "Dry-bulb (C)", "RHum (%)", "Wspd (m/s)"]
    lines = ['724940,"TESTFIELD",CA,-8.0,37.617,-122.400,2', ",".join(header)]
    begin = dt.datetime(2001, 1, 1)
    for index in range(8760 - drop):
        start = begin + dt.timedelta(hours=index)
        year = 1996 if start.month == 2 else 1988 + start.month
        hour = start.hour + 1
        radiation = 200 if 8 < hour <= 16 else 0
        lines.append(f"{start.month:02d}/{start.day:02d}/{year},{hour:02d}:00,{radiation},10,{hour / 10},60,3.5")
    path.write_text("\n".join(lines) + "\n")
    return path


CSV_COMMENTS = (
    "# station: Testveld",
    "# latitude: 52.0",
    "# longitude: 5.0",
    "# altitude: 10",
    "# timezone: Europe/Amsterdam",
    "# source: made up for a test",
    "# licence: CC0",
)
CSV_HEADER = "slot_end [UTC],air_temperature [degC],relative_humidity [%],wind_speed [m/s],global_radiation [W/m2],cloud_cover [octants]"


def csv_rows(hours: int, first_end: dt.datetime = dt.datetime(2020, 6, 1, 1)) -> list[str]:
    """Hourly rows with the sun from 8 to 16 UT."""
    ends = (first_end + dt.timedelta(hours=i) for i in range(hours))
    return [f"{end:%Y-%m-%dT%H:%MZ},15.5,70,3.25,{400 if 8 < end.hour <= 16 else 0},6" for end in ends]


def csv_text(rows: Iterable[str], *, header: str = CSV_HEADER, comments: Iterable[str] = CSV_COMMENTS) -> str:
    """A whole CSV file."""
    return "\n".join([*comments, header, *rows, ""])
