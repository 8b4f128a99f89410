"""Reads the archive of the second Autonomous Greenhouse Challenge as published: doi 10.4121/uuid:88d22c60-21b3-4ea8-90db-20249a5be2a7.

A folder holds the weather (``Weather.csv`` or ``Weather.parquet``, also in a folder ``Weather``) and for each compartment
``Resources.csv``, ``Production.csv`` and ``TomQuality.csv``: in a folder of its name, or with its name in front (``AICU_Resources.csv``).
Dates are days since 30 December 1899 on the local clock. Columns may stand in any order and beside others; commas and tabs separate
them, ``%`` may precede the first. What is missing is filled when it is little, and noted.
"""

from __future__ import annotations

import datetime as dt
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ArchiveError, did_you_mean
from glbench.outside_tables import read_text
from glbench.realism.export import EXPORT, EXPORT_WEATHER, WEATHER_UNITS, read_export
from glbench.weather import preprocessing
from glbench.weather.hourly import SKY_ESTIMATED, sky_infrared
from glbench.weather.record import FloatArray, IntArray, Place

if TYPE_CHECKING:
    import pandas as pd

DAY_ZERO = dt.date(1899, 12, 30)
"""Day 0 of a spreadsheet's dates."""
ROWS_A_DAY = 288
"""Rows of weather and indoor climate: one in five minutes."""
ROW_SECONDS = 86400 // ROWS_A_DAY
_EPOCH = (dt.date(1970, 1, 1) - DAY_ZERO).days
MOST_DAYS_FILLED = 3
"""Days in a row that may be missing of what a compartment used."""

WEATHER = ("Iglob", "Tout", "Rhout", "Windsp", "Pyrgeo")
"""Global radiation [W m-2], temperature [degC], relative humidity [%], wind [m s-1], net long-wave radiation of the sky [W m-2]."""
RESOURCES = ("Heat_cons", "ElecHigh", "ElecLow", "CO2_cons")
"""Of a day: heat [MJ m-2], the lamps' electricity at high and low tariff [kWh m-2], CO2 [kg m-2]."""
_LIMITS: Mapping[str, tuple[float, float]] = {
    "Iglob": (-20.0, 2000.0), "Tout": (-60.0, 60.0), "Rhout": (0.0, 105.0), "Windsp": (0.0, 75.0), "Pyrgeo": (-300.0, 100.0),
    "Heat_cons": (0.0, 50.0), "ElecHigh": (0.0, 10.0), "ElecLow": (0.0, 10.0), "CO2_cons": (0.0, 2.0),
    "ProdA": (0.0, 20.0), "ProdB": (0.0, 20.0), "DMC_fruit": (1.0, 50.0), "TSS": (1.0, 30.0),
    "stem_dens": (0.1, 30.0), "plant_dens": (0.1, 30.0),
}  # fmt: skip
"""What a value can be."""


@dataclass(frozen=True, eq=False)
class Weather:
    """Measured weather.

    Attributes
    ----------
    rows
        Numbers of the five minutes, counted on the local clock from 30 December 1899, rising (rows,).
    columns
        The columns ``WEATHER`` (rows,), NaN where nothing was measured.
    source
        The file.
    """

    rows: IntArray
    columns: Mapping[str, FloatArray]
    source: Path


@dataclass(frozen=True, eq=False)
class Compartment:
    """What a compartment used and gave, day by day.

    Attributes
    ----------
    name
        As its files are called.
    heat
        [MJ m-2] (days,).
    high, low
        Electricity of the lamps at the two tariffs [kWh m-2] (days,).
    co2
        [kg m-2] (days,).
    harvest
        Fruit of class A and B, fresh [kg m-2] (days,).
    dry_matter
        Mean dry matter content of the fruit [kg kg-1]; ``None`` where it was not measured.
    indoor
        File of its indoor climate every five minutes, for ``read_indoor``; ``None`` where there is none.
    class_b, brix
        The part of ``harvest`` that is of class B [kg m-2], and the fruit's soluble solids [degrees Brix] (days,).
    stems, plants
        Densities [m-2] as counted last (days,). They and ``brix`` are ``None`` where nothing was measured.
    """

    name: str
    heat: FloatArray
    high: FloatArray
    low: FloatArray
    co2: FloatArray
    harvest: FloatArray
    dry_matter: float | None
    indoor: Path | None = None
    class_b: FloatArray | None = None
    brix: FloatArray | None = None
    stems: FloatArray | None = None
    plants: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Archive:
    """Weather and compartments over the same days.

    Attributes
    ----------
    first
        First day.
    days
        Their number.
    weather, compartments
        What was measured; compartments in alphabetical order.
    notes
        What was filled, moved or left out, in words.
    own
        Whether it is a greenhouse's own export, of which no heat, harvest and supplies of a day are known.
    """

    first: dt.date
    days: int
    weather: Weather
    compartments: tuple[Compartment, ...]
    notes: tuple[str, ...]
    own: bool = False

    @property
    def dates(self) -> NDArray[np.datetime64]:
        """The days (days,)."""
        return np.datetime64(self.first, "D") + np.arange(self.days)


def read_archive(folder: Path, clock: str = "Europe/Amsterdam") -> Archive:
    """Read the archive in ``folder``, or a greenhouse's own export with stamps on ``clock`` (docs/measured-data.md).

    Raises
    ------
    ArchiveError
        When files or columns are missing, a value is none or impossible, or too much is missing; it names file, column and day.
    """
    if not folder.is_dir():
        msg = f"There is no folder {folder}. Unpack the archive (docs/realism.md says which) and name the folder."
        raise ArchiveError(msg)
    if (folder / EXPORT).is_file():
        return _read_own(folder, clock)
    places = [folder / part / f"Weather.{suffix}" for part in ("", "Weather") for suffix in ("parquet", "csv")]
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        msg = (
            f"{folder} has no weather: expected Weather.csv or Weather.parquet there, or in a folder Weather. "
            f"A greenhouse's own export has {EXPORT} and {EXPORT_WEATHER} (docs/measured-data.md)."
        )
        raise ArchiveError(msg)
    table, rows = read_rows(path)
    weather = Weather(rows, {name: _values(table, name, path) for name in WEATHER}, path)
    notes: list[str] = []
    used = {name: _Resources.read(name, path, notes) for name, path in _compartments(folder).items()}
    first, last = max(one.first for one in used.values()), min(one.last for one in used.values())
    if first > last:
        spans = "; ".join(f"{name}: {day_of(one.first)} to {day_of(one.last)}" for name, one in used.items())
        msg = f"The compartments in {folder} have no day in common ({spans}). Leave one of them out."
        raise ArchiveError(msg)
    if any((one.first, one.last) != (first, last) for one in used.values()):
        notes.append(f"The compartments cover different days; compared are those of all, {day_of(first)} to {day_of(last)}.")
    compartments = tuple(one.compartment(first, last, notes) for one in used.values())
    return Archive(day_of(first), last - first + 1, weather, compartments, tuple(notes))


def _read_own(folder: Path, clock: str) -> Archive:
    """Weather and the one compartment of an export, over the whole days of both.

    Where the sky's temperature was not measured, its infrared radiation is estimated hour by hour from clearness and humidity.
    """
    table = read_export(folder / EXPORT, WEATHER_UNITS, clock)
    days_inside = table.whole_days(clock)
    if not set(WEATHER_UNITS) & set(table.columns):
        if not (folder / EXPORT_WEATHER).is_file():
            msg = f"{folder} has no {EXPORT_WEATHER}, and {EXPORT} no columns of the weather: {', '.join(WEATHER_UNITS)}. Add one of them."
            raise ArchiveError(msg)
        table = read_export(folder / EXPORT_WEATHER, WEATHER_UNITS, clock)
    for name, unit in WEATHER_UNITS.items():
        if name != "sky_temperature":
            table.need(name, unit, "weather")
    spans = (days_inside, table.whole_days(clock))
    first = max(day for day, _ in spans)
    days = (min(day + dt.timedelta(days=count) for day, count in spans) - first).days
    if days < 1:
        msg = f"{folder}: climate and weather have no whole day in common. Export both for the same days."
        raise ArchiveError(msg)
    for name, column in zip(WEATHER_UNITS, WEATHER[:4], strict=False):
        low, high = _LIMITS[column]
        wrong = np.flatnonzero((table.columns[name] < low) | (table.columns[name] > high))
        if wrong.size:
            value, unit = table.columns[name][wrong[0]], WEATHER_UNITS[name]
            msg = (
                f"{table.file}, row {table.lines[wrong[0]]}: {name} is {value:g} {unit}, outside {low:g} to {high:g}. Correct or empty it."
            )
            raise ArchiveError(msg)
    times, numbers = five_minutes(first, days, clock)
    columns = {column: table.on(times, name) for name, column in zip(WEATHER_UNITS, WEATHER[:4], strict=False)}
    sky, outside, notes = table.on(times, "sky_temperature"), columns["Tout"], list(table.notes)
    if np.all(np.isnan(sky)):
        if not {"latitude", "longitude"} <= set(table.place):
            msg = f"{table.file} has no sky_temperature [degC]; to estimate it, add '# latitude: 52.0' and '# longitude: 4.5' on top."
            raise ArchiveError(msg)
        place = Place(folder.name, table.place["latitude"], table.place["longitude"], 0.0, clock)
        present = ~np.isnan(columns["Tout"] + columns["Rhout"] + columns["Iglob"])
        temperature, humidity, radiation = (
            np.interp(times, times[present], columns[name][present]).reshape(-1, 12).mean(axis=1) for name in ("Tout", "Rhout", "Iglob")
        )
        infrared = sky_infrared(temperature, humidity, radiation, int(times[0]), place)
        sky = np.interp(times, times[0] + 1800.0 + 3600.0 * np.arange(infrared.size), preprocessing.sky_temperature_from_infrared(infrared))
        notes.append(f"{table.file.name}: {SKY_ESTIMATED}.")
    kelvin = (sky + preprocessing.KELVIN, outside + preprocessing.KELVIN)
    columns["Pyrgeo"] = preprocessing.STEFAN_BOLTZMANN * (kelvin[0] ** 4 - kelvin[1] ** 4)
    rows, once = np.unique(numbers, return_index=True)
    weather = Weather(rows, {name: columns[name][once] for name in WEATHER}, table.file)
    none = np.full(days, np.nan)
    own = Compartment(folder.resolve().name, none, none, none, none, none, None, folder / EXPORT)
    return Archive(first, days, weather, (own,), tuple(notes), own=True)


@dataclass(frozen=True, eq=False)
class _Resources:
    """What a compartment used, and where its other files are."""

    name: str
    path: Path
    first: int
    columns: Mapping[str, FloatArray]

    @property
    def last(self) -> int:
        return self.first + self.columns[RESOURCES[0]].size - 1

    @classmethod
    def read(cls, name: str, path: Path, notes: list[str]) -> _Resources:
        table = _table(path)
        days = _days(table, path)
        order = np.argsort(days, kind="stable")
        days = days[order]
        if np.any(np.diff(days) == 0):
            twice = int(days[np.flatnonzero(np.diff(days) == 0)[0]])
            msg = f"{path} has {day_of(twice)} (day {twice}) twice. Keep one row a day."
            raise ArchiveError(msg)
        first, count = int(days[0]), int(days[-1] - days[0]) + 1
        columns = {}
        for column in RESOURCES:
            values = np.full(count, np.nan)
            values[days - first] = _values(table, column, path)[order]
            columns[column] = _filled(values, column, path, first, notes)
        return cls(name, path, first, columns)

    def compartment(self, first: int, last: int, notes: list[str]) -> Compartment:
        """With harvest and quality, of the days from ``first`` to ``last``."""
        days = slice(first - self.first, last - self.first + 1)
        heat, high, low, co2 = (self.columns[name][days] for name in RESOURCES)
        production, quality = self._beside("Production"), self._beside("TomQuality")
        if not production.is_file():
            msg = f"There is no {production.name} beside {self.path}. The archive has one for each compartment; add it."
            raise ArchiveError(msg)
        harvest = _harvest(production, first, last, notes)
        contents = np.array([np.nan])
        if quality.is_file():
            table = _table(quality)
            contents = _values(table, "DMC_fruit", quality) if "DMC_fruit" in table else contents
        dry_matter = None
        if np.any(np.isfinite(contents)):
            dry_matter = float(np.nanmean(contents)) / 100.0
        else:
            notes.append(f"{self.name}: no dry matter content was measured; the settings' value is used.")
        climate = (self._beside("GreenhouseClimate").with_suffix(suffix) for suffix in (".parquet", ".csv"))
        indoor = next((path for path in climate if path.is_file()), None)
        counts = self._beside("CropParameters")
        brix, stems, plants = (
            _by_day(path, name, first, last) for path, name in ((quality, "TSS"), (counts, "stem_dens"), (counts, "plant_dens"))
        )
        return Compartment(
            self.name, heat, high, low, co2, harvest.sum(axis=1), dry_matter, indoor, harvest[:, 1], brix, stems, plants
        )  # fmt: skip

    def _beside(self, what: str) -> Path:
        name = self.path.name
        at = name.lower().rindex("resources")
        return self.path.with_name(name[:at] + what + name[at + len("resources") :])


def _compartments(folder: Path) -> dict[str, Path]:
    """Files ``Resources.csv`` by the name of their compartment."""
    files: dict[str, Path] = {}
    for path in sorted((*folder.glob("*.csv"), *folder.glob("*/*.csv"))):
        match = re.fullmatch(r"(?i)(?:(.+?)_)?resources\.csv", path.name)
        if match is None or (match[1] is None and path.parent == folder):
            continue
        name = match[1] or path.parent.name
        if name in files:
            msg = f"Compartment '{name}' has two files: {files[name]} and {path}. Keep one."
            raise ArchiveError(msg)
        files[name] = path
    if not files:
        msg = (
            f"{folder} has no compartment: no NAME/Resources.csv and no NAME_Resources.csv. "
            "Name the folder that the archive was unpacked to."
        )
        raise ArchiveError(msg)
    return dict(sorted(files.items()))


def moment(row: int) -> str:
    """``2020-03-29 01:50`` for the number of five minutes."""
    day, part = divmod(row, ROWS_A_DAY)
    return f"{day_of(day)} {part // 12:02d}:{part % 12 * 5:02d}"


def day_of(day: int) -> dt.date:
    """Date of a day's number."""
    return DAY_ZERO + dt.timedelta(days=int(day))


def _table(path: Path) -> pd.DataFrame:
    """A file as text or numbers, column names without blanks and ``%``."""
    import pandas as pd

    try:
        if path.suffix == ".parquet":
            table = pd.read_parquet(path)
        else:
            text = re.sub(r"[ \t]*[,\t][ \t]*", ",", read_text(path, ArchiveError))
            table = pd.read_csv(io.StringIO(text), skipinitialspace=True, index_col=False)
    except (OSError, ValueError, pd.errors.ParserError) as error:
        msg = f"Cannot read {path} as a table. Is the file whole?"
        raise ArchiveError(msg) from error
    table.columns = [str(name).strip().lstrip("%").strip() for name in table.columns]
    table = table.reset_index(drop=isinstance(table.index, pd.RangeIndex))
    if table.empty:
        msg = f"{path} has no rows. Is the file whole?"
        raise ArchiveError(msg)
    return table


def read_rows(path: Path) -> tuple[pd.DataFrame, IntArray]:
    """A file with a row in five minutes, oldest first, and the numbers of its five minutes (rows,), as in ``Weather``.

    Raises
    ------
    ArchiveError
        When it cannot be read, lacks a time, or has two rows for one; names file and row.
    """
    table = _table(path)
    numbers = np.rint(_moments(table, path) * ROWS_A_DAY).astype(np.int64)
    order = np.argsort(numbers, kind="stable")
    numbers = numbers[order]
    if np.any(np.diff(numbers) == 0):
        twice = int(numbers[np.flatnonzero(np.diff(numbers) == 0)[0]])
        msg = f"{path} has two rows for the five minutes at {moment(twice)}. Keep one."
        raise ArchiveError(msg)
    return table.iloc[order], numbers


def five_minutes(first: dt.date, days: int, clock: str) -> tuple[IntArray, IntArray]:
    """Every five minutes of these days: seconds UTC (rows,), and their numbers on ``clock``, as in ``Weather`` (rows,).

    The hour that summer time skips has none; the numbers of the hour that comes twice are there twice.
    """
    begin, end = (preprocessing.to_utc_seconds(first + dt.timedelta(days=count), clock) for count in (0, days))
    times = np.arange(begin, end, ROW_SECONDS, dtype=np.int64)
    return times, (times + preprocessing.utc_offsets(times, clock)) // ROW_SECONDS + _EPOCH * ROWS_A_DAY


def on_rows(values: FloatArray, rows: IntArray, numbers: IntArray) -> FloatArray:
    """``values`` of ``rows`` (rising) at ``numbers``; NaN where there is no such row."""
    places = np.minimum(np.searchsorted(rows, numbers), rows.size - 1)
    return np.where(rows[places] == numbers, values[places], np.nan)


def _moments(table: pd.DataFrame, path: Path) -> FloatArray:
    """Dates and times [d] since 30 December 1899."""
    name = next((name for name in table.columns if name.lower() == "time"), None)
    if name is None:
        msg = f"{path} has no column 'time' (days since 30 December 1899). It has {', '.join(table.columns[:8])}."
        raise ArchiveError(msg)
    moments = numbers_of(table, name, path)
    if not np.all(np.isfinite(moments)):
        msg = (
            f"{path}, row {table.index[np.flatnonzero(~np.isfinite(moments))[0]] + 2}: there is no time. Give each row one, or take it out."
        )
        raise ArchiveError(msg)
    return moments


def _days(table: pd.DataFrame, path: Path) -> IntArray:
    return np.floor(_moments(table, path) + 1e-6).astype(np.int64)


def _values(table: pd.DataFrame, name: str, path: Path) -> FloatArray:
    """A column, NaN where it has no value."""
    if name not in table:
        near = did_you_mean(name, table.columns)
        msg = f"{path} has no column '{name}'.{near} The archive's files have it; docs/realism.md lists the columns that are read."
        raise ArchiveError(msg)
    values = numbers_of(table, name, path)
    low, high = _LIMITS[name]
    wrong = np.flatnonzero((values < low) | (values > high))
    if wrong.size:
        msg = f"{path}, row {table.index[wrong[0]] + 2}: {name} is {values[wrong[0]]:g}, outside {low:g} to {high:g}. Correct or empty it."
        raise ArchiveError(msg)
    return values


def numbers_of(table: pd.DataFrame, name: str, path: Path) -> FloatArray:
    """Numbers of a column (rows,), NaN where it has none.

    Raises
    ------
    ArchiveError
        For a text that is not a number; names file and row.
    """
    import pandas as pd

    column = table[name]
    numbers = pd.to_numeric(column, errors="coerce")
    empty = column.isna() | column.astype(str).str.strip().str.lower().isin(["nan", ""])
    wrong = np.flatnonzero(numbers.isna() & ~empty)
    if wrong.size:
        msg = f"{path}, row {table.index[wrong[0]] + 2}: {name} is '{column.iloc[wrong[0]]}', which is not a number."
        raise ArchiveError(msg)
    return np.asarray(numbers, dtype=np.float64)


def _filled(values: FloatArray, name: str, path: Path, first: int, notes: list[str]) -> FloatArray:
    """A column of days with its gaps filled linearly."""
    missing = ~np.isfinite(values)
    if not missing.any():
        return values
    begin, length = longest(missing)
    if length > MOST_DAYS_FILLED or missing[0] or missing[-1]:
        msg = (
            f"{path}: {name} is missing on {length} days in a row from {day_of(first + begin)}. "
            f"At most {MOST_DAYS_FILLED} between two known days are filled; complete the file, or take out its first or last rows."
        )
        raise ArchiveError(msg)
    notes.append(f"{path.name}: {name} of {missing.sum()} of {values.size} days filled linearly.")
    present = np.flatnonzero(~missing)
    return np.interp(np.arange(values.size), present, values[present])


def longest(missing: NDArray[np.bool_]) -> tuple[int, int]:
    """Begin and length of the longest run of what is missing; 0 and 0 where nothing is."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False])).astype(np.int8)))
    begins, ends = edges[::2], edges[1::2]
    if not begins.size:
        return 0, 0
    place = int(np.argmax(ends - begins))
    return int(begins[place]), int(ends[place] - begins[place])


def _by_day(path: Path, name: str, first: int, last: int) -> FloatArray | None:
    """A column measured now and then (days,): straight between measurements, densities as counted last; ``None`` without measurements."""
    table = _table(path) if path.is_file() else None
    if table is None or name not in table:
        return None
    days, values, numbers = _days(table, path), _values(table, name, path), np.arange(first, last + 1)
    present = np.isfinite(values)
    if not present.any():
        return None
    days, values = days[present], values[present]
    if name == "TSS":
        return np.interp(numbers, days, values)
    return np.asarray(values[np.maximum(np.searchsorted(days, numbers, side="right") - 1, 0)])


def _harvest(path: Path, first: int, last: int, notes: list[str]) -> FloatArray:
    """Fresh fruit [kg m-2] on each day, a column a class (days, 2).

    A date before the one above it, or before the season, is a typo (the published file of the reference has one): the fruit
    counts on the date of the next row.
    """
    table = _table(path)
    days = _days(table, path)
    fruit = np.column_stack([np.nan_to_num(_values(table, name, path)) for name in ("ProdA", "ProdB")])
    harvest = np.zeros((last - first + 1, 2))
    for place, (day, weight) in enumerate(zip(days.tolist(), fruit, strict=True)):
        counted = day
        if day < first:
            counted = next((later for later in days[place + 1 :].tolist() if later >= first), first)
            notes.append(f"{path.name}: a harvest is dated {day_of(day)}, before the season; it is counted on {day_of(counted)}.")
        if counted > last:
            notes.append(f"{path.name}: the harvest of {day_of(day)}, after the last day, is left out.")
        else:
            harvest[counted - first] += weight
    return harvest
