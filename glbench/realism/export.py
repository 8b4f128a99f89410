"""Reads a greenhouse's own export: tables with a unit in each title, in steps of 1 to 15 minutes (docs/measured-data.md).

Encodings, delimiters, decimal commas, stamps and clocks are those of every outside table (``glbench.outside_tables``).
"""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from glbench import outside_tables as outside
from glbench.errors import ArchiveError, did_you_mean, refuse
from glbench.untrusted import visible
from glbench.weather import preprocessing
from glbench.weather.column_map import JOULES, UNITS, split_title, unit_among
from glbench.weather.record import FloatArray, IntArray, time_zone

SHORTEST, LONGEST = 60, 900  # Steps that are read [s]
FIVE_MINUTES = 300
EXPORT, EXPORT_WEATHER = "indoor.csv", "weather.csv"  # Files of an export; the first may have all columns
WEATHER_UNITS = {
    "global_radiation": "W/m2", "outdoor_temperature": "degC", "outdoor_humidity": "%", "wind_speed": "m/s", "sky_temperature": "degC",
}  # fmt: skip
"""Columns of the weather; without the last the sky is estimated."""
UNIT_FACTORS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "degC": UNITS["air_temperature"],
    "%": UNITS["relative_humidity"],
    "m/s": UNITS["wind_speed"],
    "W/m2": {"W/m2": (1.0, 0.0), "kW/m2": (1e3, 0.0)},
    "ppm": {"ppm": (1.0, 0.0)},
    "g/m3": {"g/m3": (1.0, 0.0)},
    "kg/m2/h": {"kg/m2/h": (1.0, 0.0), "g/m2/h": (1e-3, 0.0), "kg/ha/h": (1e-4, 0.0)},
}
"""Units in which a quantity of this unit may come: factor and offset."""


@dataclass(frozen=True, eq=False)
class Export:
    """A table of an export.

    ``seconds`` are the beginning of what each row covers, since 1970 UTC, rising (rows,), ``step`` is its length [s], ``lines`` are its
    lines in the file, from 1. ``columns`` have the canonical name and unit (rows,), NaN where a value is missing; ``place`` is what comment
    lines (``# latitude: 52.0``) say in numbers, ``notes`` what was left out.
    """

    file: Path
    seconds: IntArray
    step: int
    columns: Mapping[str, FloatArray]
    lines: Sequence[int]
    place: Mapping[str, float]
    notes: tuple[str, ...]

    def need(self, name: str, unit: str, meaning: str) -> None:
        """Refuse with an ``ArchiveError`` where there is no value of a column."""
        if name not in self.columns or np.all(np.isnan(self.columns[name])):
            others = ", ".join(self.columns) or "none that is known"
            refuse(f"{self.file} has no values of {name} [{unit}] ({meaning}), which is needed. Its columns: {others}.", ArchiveError)

    def whole_days(self, clock: str) -> tuple[dt.date, int]:
        """The first day on ``clock`` that begins with the table, and the number up to its end; an ``ArchiveError`` where there is none."""
        ends = np.array([self.seconds[0], self.seconds[-1] + self.step])
        local = ends + preprocessing.utc_offsets(ends, clock)
        begin, end = -(-local[0] // 86400), local[1] // 86400
        if begin >= end:
            refuse(f"{self.file} covers no whole day from midnight to midnight. Export more days.", ArchiveError)
        return dt.date(1970, 1, 1) + dt.timedelta(days=int(begin)), int(end - begin)

    def on(self, times: IntArray, name: str) -> FloatArray:
        """A column on a grid of five minutes (times,): means of finer steps, coarser ones held; NaN where there are none."""
        values = self.columns.get(name)
        if values is None:
            return np.full(times.size, np.nan)
        if self.step > FIVE_MINUTES:
            last = np.searchsorted(self.seconds, times, side="right") - 1
            return np.where((last >= 0) & (times - self.seconds[last] < self.step), values[last], np.nan)
        bins = (self.seconds - times[0]) // FIVE_MINUTES
        inside = (bins >= 0) & (bins < times.size) & ~np.isnan(values)
        counts = np.bincount(bins[inside], minlength=times.size)
        sums = np.bincount(bins[inside], weights=values[inside], minlength=times.size)
        return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def read_export(path: Path, units: Mapping[str, str], clock: str, lamp_power: float | None = None) -> Export:
    """Read the columns that ``units`` names, with their canonical unit. None of them has to be there.

    Stamps without an offset from UTC are of ``clock``, unless their title says UTC or UTC+1; ``lamp_power`` [W m-2] is that of 100 % in the
    column ``lamps``. Raises ``ArchiveError`` when table or times cannot be read, a title lacks its unit, or a value is not a number.
    """
    text = outside.read_text(path, ArchiveError)
    table = outside.split_table(text, str(path), ArchiveError)
    time = outside.time_titles(table)
    if not time:
        table.refuse("no column looks like the time. Name it 'time' and write 2024-02-13 07:05.")
    table, stamps = outside.oldest_first(table, outside.read_stamps(table, time))
    step = outside.step_of(stamps.seconds)
    is_utc = stamps.zoned or outside.says_utc(" ".join(time))
    if not is_utc and (ahead := outside.hours_ahead(" ".join(time))) is not None:
        clock = f"Etc/GMT{-ahead:+d}"
        table = replace(table, notes=(*table.notes, f"times are read as UTC{ahead:+d} all year, as their title says"))
    seconds = stamps.seconds if is_utc else outside.utc_of_local(table, stamps.seconds, time_zone(clock), time[0])
    if not SHORTEST <= step <= LONGEST:
        what = f"its step is {step / 60:g} min" if seconds.size > 1 else "it has one row"
        table.refuse(f"{what}. Export means of {SHORTEST // 60} to {LONGEST // 60} min.")
    late = np.flatnonzero(np.diff(seconds) <= 0)
    if late.size:
        problem = f"'{' '.join(table.rows[late[0] + 1][table.titles.index(one)] for one in time)}' is not later than the row above. "
        table.refuse(problem + "Sort the rows by time, and take out those that are there twice.", int(late[0]) + 1, time[0])
    others = outside.of_another_step(seconds, step)
    if others.size:
        problem = f"its step changes: most rows are {step / 60:g} min apart, but not those around line {table.lines[others[0]]}"
        table = replace(table, notes=(*table.notes, f"{problem}. Times that no row covers count as missing. Export one step throughout"))
    columns: dict[str, FloatArray] = {}
    unread = []
    for title in (title for title in table.titles if title not in time):
        name, unit = split_title(title)
        if name not in units:
            unread.append(f"'{visible(title)}'{did_you_mean(name, [one for one in units if one not in columns]).rstrip()}")
            continue
        factors = UNITS["global_radiation"] if name == "global_radiation" else UNIT_FACTORS[units[name]]
        if name == "lamps" and lamp_power is not None:
            factors = {**factors, "%": (lamp_power / 100.0, 0.0)}
        own = unit_among(factors, unit)
        if name in columns:
            table.refuse(f"there are two columns {name}. Keep one.", None, title)
        if own is None:
            problem = f"the unit '{visible(unit)}' is unknown" if unit else "its title has no unit"
            problem += f". Write one of {', '.join(f'{name} [{one}]' for one in factors)}."
            table.refuse(problem, None, title)
        if own in JOULES and others.size:
            table.refuse(f"{problem}, and {name} is a sum over each row. Export one step throughout.", None, title)
        factor, offset = factors[own]
        columns[name] = table.numbers(title, sentinels=(-999.0, -9999.0)) * JOULES.get(own, step * factor) / step + offset
    above = "\n".join(line for line in table.preamble if line.lstrip(' "').startswith("#"))
    comments = re.findall(r"#\s*(\w+)\s*:\s*([-+]?\d+(?:[.,]\d+)?)\s*°?\s*([SW]\b)?", above)
    place = {key: float(words.replace(",", ".")) for key, words, _ in comments}
    place |= {key: -abs(place[key]) for key, _, side in comments if side and key in ("latitude", "longitude")}
    notes = (*table.notes, *([f"columns that are not read: {'; '.join(unread)}"] if unread else []))
    begin = seconds - (step if stamps.ends else 0)
    return Export(path, begin, step, columns, table.lines, place, tuple(f"{path.name}: {note}." for note in notes))
