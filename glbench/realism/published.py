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

from glbench.errors import ArchiveError, did_you_mean, refuse
from glbench.outside_tables import read_text
from glbench.realism.export import EXPORT, EXPORT_WEATHER, WEATHER_UNITS, read_export
from glbench.weather import preprocessing
from glbench.weather.hourly import SKY_ESTIMATED, sky_infrared
from glbench.weather.record import FloatArray, IntArray, Place, check_place

if TYPE_CHECKING:
    import pandas as pd

DAY_ZERO = dt.date(1899, 12, 30)  # Day 0 of a spreadsheet's dates
ROWS_A_DAY = 288  # Rows of weather and indoor climate: one in five minutes
ROW_SECONDS = 86400 // ROWS_A_DAY
_EPOCH = (dt.date(1970, 1, 1) - DAY_ZERO).days
MOST_DAYS_FILLED = 3  # Days in a row that may be missing of what a compartment used

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
    """Measured weather: the columns ``WEATHER`` (rows,), NaN where nothing was measured, and the file they come from.

    ``rows`` are numbers of five minutes, counted on the local clock from 30 December 1899, rising (rows,).
    """

    rows: IntArray
    columns: Mapping[str, FloatArray]
    source: Path


@dataclass(frozen=True, eq=False)
class Compartment:
    """What a compartment, named as its files are, used and gave; every array is (days,).

    ``heat`` [MJ m-2], the lamps' electricity at the ``high`` and ``low`` tariff [kWh m-2], ``co2`` [kg m-2], ``harvest`` of class A and B,
    fresh [kg m-2], of which ``class_b`` is class B; mean ``dry_matter`` of the fruit [kg kg-1], its soluble solids ``brix`` [degrees Brix],
    and densities of ``stems`` and ``plants`` as counted last [m-2]: these are ``None`` where nothing was measured, as is the file
    ``indoor`` of its climate every five minutes, for ``read_indoor``.
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
    """Weather and compartments, in alphabetical order, over the same ``days`` from ``first`` on.

    ``notes`` say what was filled, moved or left out. ``own`` is a greenhouse's own export, without heat, harvest and supplies of a day.
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


@dataclass(frozen=True, eq=False)
class Sheet:
    """A file of the archive; column names are without blanks and ``%``, and the index counts its rows from 0."""

    path: Path
    table: pd.DataFrame

    @classmethod
    def read(cls, path: Path) -> Sheet:
        """A CSV or Parquet file; an ``ArchiveError`` says why it cannot be read."""
        import pandas as pd

        try:
            if path.suffix == ".parquet":
                table = pd.read_parquet(path)
            else:
                text = re.sub(r"[ \t]*[,\t][ \t]*", ",", read_text(path, ArchiveError))
                table = pd.read_csv(io.StringIO(text), skipinitialspace=True, index_col=False)
        except (OSError, ValueError) as error:
            refuse(f"Cannot read {path}: it is no table with one line of titles. Is the file whole?", ArchiveError, error)
        table = table.reset_index(drop=isinstance(table.index, pd.RangeIndex))
        table.columns = [str(name).strip().lstrip("%").strip() for name in table.columns]
        if table.empty:
            refuse(f"{path} has no rows. Is the file whole?", ArchiveError)
        return cls(path, table.rename(columns={name: "time" for name in table.columns if name.lower() == "time"}))

    def numbers(self, name: str) -> FloatArray:
        """Numbers of a column (rows,), NaN where it has none.

        An ``ArchiveError`` names file and row of a text that is not a number or of an impossible value, and the file without the column.
        """
        import pandas as pd

        if name not in self.table:
            meaning = " (days since 30 December 1899)" if name == "time" else ""
            near, names = did_you_mean(name, self.table.columns), ", ".join(self.table.columns[:8])
            msg = f"{self.path} has no column '{name}'{meaning}.{near} It has {names}. docs/realism.md lists the columns that are read."
            raise ArchiveError(msg)
        column = self.table[name]
        numbers = pd.to_numeric(column, errors="coerce")
        values = np.asarray(numbers, dtype=np.float64)
        low, high = _LIMITS.get(name, (-np.inf, np.inf))
        words = numbers.isna() & column.notna() & ~column.astype(str).str.strip().str.lower().isin(["nan", ""])
        for wrong, problem in (
            (words, "which is not a number. Correct or empty it"),
            ((values < low) | (values > high), f"outside {low:g} to {high:g}. Correct or empty it"),
            (~np.isfinite(values) & (name == "time"), "but each row needs one. Add it, or take the row out"),
        ):
            if np.any(wrong):
                place = int(np.argmax(wrong))
                value = f"'{column.iloc[place]}'" if wrong is words else f"{values[place]:g}"
                refuse(f"{self.path}, row {self.table.index[place] + 2}: {name} is {value}, {problem}.", ArchiveError)
        return values

    def days(self) -> IntArray:
        """Numbers of the days since 30 December 1899 (rows,)."""
        return np.floor(self.numbers("time") + 1e-6).astype(np.int64)


def read_rows(path: Path) -> tuple[Sheet, IntArray]:
    """A file with a row in five minutes, oldest first, and the numbers of its five minutes (rows,), as in ``Weather``.

    An ``ArchiveError`` names the file that cannot be read or lacks a time, and the five minutes that it has twice.
    """
    sheet = Sheet.read(path)
    numbers = np.rint(sheet.numbers("time") * ROWS_A_DAY).astype(np.int64)
    order = np.argsort(numbers, kind="stable")
    numbers = numbers[order]
    if (twice := numbers[1:][np.diff(numbers) == 0]).size:
        refuse(f"{path} has two rows for the five minutes at {moment(twice[0])}. Keep one.", ArchiveError)
    return Sheet(path, sheet.table.iloc[order]), numbers


def read_archive(folder: Path, clock: str = "Europe/Amsterdam") -> Archive:
    """Read the archive in ``folder``, or a greenhouse's own export with stamps on ``clock`` (docs/measured-data.md).

    Raises ``ArchiveError`` when files or columns are missing, a value is none or impossible, or too much is; names file, column and day.
    """
    import pandas as pd

    if not folder.is_dir():
        refuse(f"There is no folder {folder}. Unpack the archive (docs/realism.md says which) and name the folder.", ArchiveError)
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
    sheet, rows = read_rows(path)
    weather, files = Weather(rows, {name: sheet.numbers(name) for name in WEATHER}, path), dict[str, Path]()
    for path in sorted((*folder.glob("*.csv"), *folder.glob("*/*.csv"))):
        match = re.fullmatch(r"(?i)(?:(.+?)_)?resources\.csv", path.name)
        if match and (match[1] or path.parent != folder):
            name = match[1] or path.parent.name
            if name in files:
                refuse(f"Compartment '{name}' has two files: {files[name]} and {path}. Keep one.", ArchiveError)
            files[name] = path
    if not files:
        msg = f"{folder} has no compartment: no NAME/Resources.csv and no NAME_Resources.csv. Name the folder that the archive is in."
        raise ArchiveError(msg)
    notes, used = list[str](), dict[str, pd.DataFrame]()
    for name, path in sorted(files.items()):
        sheet = Sheet.read(path)
        table = pd.DataFrame({column: sheet.numbers(column) for column in RESOURCES}, sheet.days()).sort_index()
        if table.index.has_duplicates:
            twice = table.index[table.index.duplicated()][0]
            refuse(f"{path} has {day_of(twice)} (day {twice}) twice. Keep one row a day.", ArchiveError)
        used[name] = table = table.reindex(range(table.index[0], table.index[-1] + 1))
        for column, missing in table.isna().items():
            begin, length = longest(missing.to_numpy())
            if length > MOST_DAYS_FILLED or missing.iloc[0] or missing.iloc[-1]:
                msg = (
                    f"{path}: {column} is missing on {length} days in a row from {day_of(table.index[begin])}. "
                    f"At most {MOST_DAYS_FILLED} between two known days are filled; complete the file, or take out its first or last rows."
                )
                raise ArchiveError(msg)
            if length:
                notes.append(f"{path.name}: {column} of {missing.sum()} of {missing.size} days filled linearly.")
        used[name] = table.interpolate()
    first, last = (int(extreme(one.index[end] for one in used.values())) for extreme, end in ((max, 0), (min, -1)))
    if first > last:
        spans = "; ".join(f"{name}: {day_of(one.index[0])} to {day_of(one.index[-1])}" for name, one in used.items())
        refuse(f"The compartments in {folder} have no day in common ({spans}). Leave one of them out.", ArchiveError)
    if any((one.index[0], one.index[-1]) != (first, last) for one in used.values()):
        notes.append(f"The compartments cover different days; compared are those of all, {day_of(first)} to {day_of(last)}.")
    compartments = tuple(_compartment(name, files[name], one.loc[first:last], notes) for name, one in used.items())
    return Archive(day_of(first), last - first + 1, weather, compartments, tuple(notes))


def _compartment(name: str, path: Path, used: pd.DataFrame, notes: list[str]) -> Compartment:
    """A compartment of which ``path`` is the file of what it ``used`` on the days of the archive.

    A harvest dated before the one above it, or before the season, is a typo (the published file of the reference has one): the fruit
    counts on the date of the next row.
    """
    at = path.name.lower().rindex("resources")
    kinds = ("Production.csv", "TomQuality.csv", "CropParameters.csv", "GreenhouseClimate.parquet", "GreenhouseClimate.csv")
    production, *others = (path.with_name(path.name[:at] + kind) for kind in kinds)
    if not production.is_file():
        refuse(f"There is no {production.name} beside {path}. The archive has one for each compartment; add it.", ArchiveError)
    quality, counts, *climate = (other if other.is_file() else None for other in others)
    numbers, sheet = used.index.to_numpy(), Sheet.read(production)
    first, last, days = int(numbers[0]), int(numbers[-1]), sheet.days().tolist()
    harvest = np.zeros((numbers.size, 2))
    for place, weight in enumerate(np.nan_to_num([[a, b] for a, b in zip(*map(sheet.numbers, ("ProdA", "ProdB")), strict=True)])):
        counted = day = days[place]
        if day < first:
            counted = next((later for later in days[place + 1 :] if later >= first), first)
            notes.append(f"{production.name}: a harvest is dated {day_of(day)}, before the season; it is counted on {day_of(counted)}.")
        if counted > last:
            notes.append(f"{production.name}: the harvest of {day_of(day)}, after the last day, is left out.")
        else:
            harvest[counted - first] += weight
    series, dry_matter = dict[str, tuple[IntArray, FloatArray]](), None
    for file, column in ((quality, "DMC_fruit"), (quality, "TSS"), (counts, "stem_dens"), (counts, "plant_dens")):
        if file is not None and column in (sheet := Sheet.read(file)).table:
            present = np.isfinite(values := sheet.numbers(column))
            series |= {column: (sheet.days()[present], values[present])} if present.any() else {}
            if column == "DMC_fruit" and present.any():
                dry_matter = float(np.nanmean(values)) / 100.0
    if dry_matter is None:
        notes.append(f"{name}: no dry matter content was measured; the settings' value is used.")
    heat, high, low, co2 = (used[column].to_numpy() for column in RESOURCES)
    densities = (series.get(column) for column in ("stem_dens", "plant_dens"))
    stems, plants = (one and one[1][np.maximum(np.searchsorted(one[0], numbers, side="right") - 1, 0)] for one in densities)
    return Compartment(
        name, heat, high, low, co2, harvest.sum(axis=1), dry_matter, next(filter(None, climate), None), harvest[:, 1],
        np.interp(numbers, *series["TSS"]) if "TSS" in series else None, stems, plants,
    )  # fmt: skip


def _read_own(folder: Path, clock: str) -> Archive:
    """Weather and the one compartment of an export, over the whole days of both.

    Where the sky's temperature was not measured, its infrared radiation is estimated hour by hour from clearness and humidity.
    """
    table = read_export(folder / EXPORT, WEATHER_UNITS, clock)
    spans = [table.whole_days(clock)]
    if (folder / EXPORT_WEATHER).is_file() and not {*WEATHER_UNITS} - {"sky_temperature"} <= {*table.columns}:
        table = read_export(folder / EXPORT_WEATHER, WEATHER_UNITS, clock)
    elif not {*WEATHER_UNITS} & {*table.columns}:
        msg = f"{folder} has no {EXPORT_WEATHER}, and {EXPORT} no columns of the weather: {', '.join(WEATHER_UNITS)}. Add one of them."
        raise ArchiveError(msg)
    measured = dict(zip(WEATHER_UNITS, WEATHER[:4], strict=False))
    for name in measured:
        table.need(name, WEATHER_UNITS[name], "weather")
    spans.append(table.whole_days(clock))
    first = max(day for day, _ in spans)
    days = (min(day + dt.timedelta(days=count) for day, count in spans) - first).days
    if days < 1:
        refuse(f"{folder}: climate and weather have no whole day in common. Export both for the same days.", ArchiveError)
    times, numbers = five_minutes(first, days, clock)
    columns, notes = dict[str, FloatArray](), list(table.notes if table.file.name == EXPORT_WEATHER else ())
    for name, column in measured.items():
        values, unit, (low, high) = table.columns[name], WEATHER_UNITS[name], _LIMITS[column]
        if (wrong := np.flatnonzero((values < low) | (values > high))).size:
            where, value = f"{table.file}, row {table.lines[wrong[0]]}", f"{values[wrong[0]]:g} {unit}"
            refuse(f"{where}: {name} is {value}, outside {low:g} to {high:g}. Correct or empty it.", ArchiveError)
        columns[column] = table.on(times, name)
    sky, outside = table.on(times, "sky_temperature"), columns["Tout"]
    if np.all(np.isnan(sky)):
        if not {"latitude", "longitude"} <= set(table.place):
            msg = f"{table.file} has no sky_temperature [degC]; to estimate it, add '# latitude: 52.0' and '# longitude: 4.5' on top."
            raise ArchiveError(msg)
        place = Place(folder.name, table.place["latitude"], table.place["longitude"], 0.0, clock)
        check_place(place, table.file, ArchiveError)
        present = ~np.isnan(outside + columns["Rhout"] + columns["Iglob"])
        if not present.any():
            together = "global_radiation, outdoor_temperature and outdoor_humidity together"
            refuse(
                f"{table.file}: none of the {days} days from {first} has a row with {together}. Export averages of all three.", ArchiveError
            )
        temperature, humidity, radiation = (
            np.interp(times, times[present], columns[name][present]).reshape(-1, 12).mean(axis=1) for name in ("Tout", "Rhout", "Iglob")
        )
        infrared = sky_infrared(temperature, humidity, radiation, int(times[0]), place)
        sky = np.interp(times, times[0] + 1800.0 + 3600.0 * np.arange(infrared.size), preprocessing.sky_temperature_from_infrared(infrared))
        notes.append(f"{table.file.name}: {SKY_ESTIMATED}.")
    columns["Pyrgeo"] = preprocessing.STEFAN_BOLTZMANN * ((sky + preprocessing.KELVIN) ** 4 - (outside + preprocessing.KELVIN) ** 4)
    weather = Weather(numbers, columns, table.file)
    none = np.full(days, np.nan)
    own = Compartment(folder.resolve().name, none, none, none, none, none, None, folder / EXPORT)
    return Archive(first, days, weather, (own,), tuple(notes), own=True)


def moment(row: int) -> str:
    """``2020-03-29 01:50`` for the number of five minutes."""
    return f"{day_of(row // ROWS_A_DAY)} {row % ROWS_A_DAY // 12:02d}:{row % 12 * 5:02d}"


def day_of(day: int) -> dt.date:
    """Date of a day's number."""
    return DAY_ZERO + dt.timedelta(days=int(day))


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


def longest(missing: NDArray[np.bool_]) -> tuple[int, int]:
    """Begin and length of the longest run of what is missing; 0 and 0 where nothing is."""
    runs = np.flatnonzero(np.diff(np.pad(missing.astype(np.int8), 1))).reshape(-1, 2).tolist()
    begin, end = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
    return begin, end - begin
