"""From the rows of a file to a canonical record: every row is checked, nothing is filled unless it was asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from glbench.errors import WeatherError
from glbench.weather.preprocessing import RAW_SECONDS, time_zone
from glbench.weather.record import (
    QUANTITIES,
    REQUIRED,
    SKY,
    SLOT_SECONDS,
    FloatArray,
    IntArray,
    Place,
    Timing,
    WeatherRecord,
    utc_text,
)

LONGEST_FILL = 48
"""Most hours in a row that may be filled on request: beyond two days a straight line says nothing about the weather."""


USUAL_TIMING: Mapping[str, Timing] = {
    "air_temperature": "instant",
    "relative_humidity": "instant",
    "cloud_cover": "instant",
    "sky_temperature": "instant",
    "wind_speed": "mean",
    "global_radiation": "mean",
    "sky_infrared": "mean",
}
"""What a value is in most files: of means, the slot's mean; of instants, the value at its end."""


@dataclass(frozen=True)
class Rows:
    """The rows of one file, as read: NaN where the file has no value.

    Attributes
    ----------
    file : str
        Where the rows come from, for messages.
    slot_ends : ndarray of int64
        End of each row's slot, seconds since 1970-01-01 UTC.
    columns : Mapping[str, ndarray of float64]
        Values in the units of ``QUANTITIES``.
    timing : Mapping[str, Timing]
        What each column's value means.
    row_numbers : ndarray of int64
        Line (or row) of the file, counted from 1, for messages.
    """

    file: str
    slot_ends: IntArray
    columns: Mapping[str, FloatArray]
    timing: Mapping[str, Timing]
    row_numbers: IntArray


@dataclass(frozen=True)
class Origin:
    """Who measured the rows where, and the terms under which they may be used."""

    name: str
    place: Place
    source: str
    licence: str
    typical_year: bool = False
    notes: tuple[str, ...] = ()


def assemble(rows: Rows, origin: Origin, *, fill_gaps: int = 0) -> WeatherRecord:
    """Checked canonical record of ``rows``.

    Parameters
    ----------
    rows, origin : Rows, Origin
        The figures, and what is known about them.
    fill_gaps : int
        Fill up to so many missing hours in a row linearly and say so in the record's notes; 0 fills nothing.

    Raises
    ------
    WeatherError
        For an empty file, hours out of order or twice, gaps, missing or impossible values, an impossible place. The message
        names the file, the row and the value.
    """
    _check_place(rows.file, origin.place)
    check_order(rows)
    for name in rows.columns:
        _check_range(rows, name)  # before gaps are filled: an impossible value must not hide in what is made from it
    rows, notes = _fill(rows, fill_gaps) if fill_gaps > 0 else (rows, ())
    _check_gaps(rows)
    names, dropped = _complete_columns(rows)
    counts: dict[str, IntArray] = {}
    for name in names:
        column = np.rint(rows.columns[name] * QUANTITIES[name].counts_per_unit).astype(np.int64)
        column.setflags(write=False)
        counts[name] = column
    return WeatherRecord(
        name=origin.name,
        place=origin.place,
        begin=int(rows.slot_ends[0]) - SLOT_SECONDS,
        counts=MappingProxyType(counts),
        timing=MappingProxyType({name: rows.timing[name] for name in names}),
        source=origin.source,
        licence=origin.licence,
        typical_year=origin.typical_year,
        notes=(*origin.notes, *notes, *dropped),
    )


def _check_place(file: str, place: Place) -> None:
    limits = (("latitude", place.latitude, 90.0, "deg"), ("longitude", place.longitude, 180.0, "deg"))
    for name, value, limit, unit in limits:
        if not abs(value) <= limit:
            msg = f"{file}: the {name} {value} {unit} is impossible. Correct the station's coordinates."
            raise WeatherError(msg)
    if not -500.0 <= place.altitude <= 9000.0:
        msg = f"{file}: the altitude {place.altitude} m is impossible. Correct the station's altitude."
        raise WeatherError(msg)
    time_zone(place.timezone)


def check_order(rows: Rows) -> None:
    """Raise ``WeatherError`` when there are no rows, or hours appear twice or out of order; names the row."""
    ends = rows.slot_ends
    if ends.size == 0:
        msg = f"{rows.file} holds no hourly values. Is it the right file, and whole?"
        raise WeatherError(msg)
    if ends[0] % RAW_SECONDS:
        msg = f"{rows.file}, row {rows.row_numbers[0]}: the hour ends at {utc_text(int(ends[0]))} UTC, off the 5-minute grid."
        raise WeatherError(msg)
    spacing = np.diff(ends)
    wrong = np.flatnonzero((spacing <= 0) | (spacing % SLOT_SECONDS != 0))
    if wrong.size:
        i = int(wrong[0])
        here, before = utc_text(int(ends[i + 1])), utc_text(int(ends[i]))
        what = (
            f"the hour ending {here} UTC appears twice"
            if spacing[i] == 0
            else f"the hour ending {here} UTC follows {before} UTC; rows must be hourly and in order of time"
        )
        msg = f"{rows.file}, row {rows.row_numbers[i + 1]}: {what}. Correct the file or fetch it again."
        raise WeatherError(msg)


def _check_gaps(rows: Rows) -> None:
    gaps = np.flatnonzero(np.diff(rows.slot_ends) != SLOT_SECONDS)
    if gaps.size:
        i = int(gaps[0])
        hours = int(rows.slot_ends[i + 1] - rows.slot_ends[i]) // SLOT_SECONDS - 1
        msg = (
            f"{rows.file}, row {rows.row_numbers[i + 1]}: {hours} h are missing between {utc_text(int(rows.slot_ends[i]))} and "
            f"{utc_text(int(rows.slot_ends[i + 1]))} UTC ({gaps.size} gap{'s' if gaps.size > 1 else ''} in all). {_remedy(hours)}"
        )
        raise WeatherError(msg)


def _remedy(hours: int) -> str:
    """What to do about ``hours`` missing hours in a row."""
    if hours > LONGEST_FILL:
        return f"That is more than the {LONGEST_FILL} h in a row that --fill-gaps may fill: choose another period, or another station."
    return f"Nothing is filled unasked: choose another period, or import with --fill-gaps {hours}."


def _longest_run(present: NDArray[np.bool_]) -> int:
    """Length of the longest run of false values."""
    edges = np.flatnonzero(np.concatenate([[True], present, [True]]))
    return int(np.diff(edges).max()) - 1


def _complete_columns(rows: Rows) -> tuple[list[str], tuple[str, ...]]:
    """Names of the columns to keep, and notes on the sky columns left out for being incomplete."""
    missing = {name: np.flatnonzero(np.isnan(values)) for name, values in rows.columns.items()}
    sky = [name for name in SKY if name in missing and missing[name].size == 0]
    partial = [name for name in SKY if name in missing and 0 < missing[name].size < rows.slot_ends.size]
    required = [*REQUIRED, *([] if sky else partial[:1])]
    for name in required:
        if name not in missing:
            msg = f"{rows.file} has no column for {name.replace('_', ' ')} [{QUANTITIES[name].unit}], which is needed."
            raise WeatherError(msg)
        if missing[name].size:
            i = int(missing[name][0])
            msg = (
                f"{rows.file}, row {rows.row_numbers[i]}: no value for {name.replace('_', ' ')} in the hour ending "
                f"{utc_text(int(rows.slot_ends[i]))} UTC ({missing[name].size} missing in all). "
                f"{_remedy(_longest_run(~np.isnan(rows.columns[name])))}"
            )
            raise WeatherError(msg)
    if not sky:
        msg = f"{rows.file} says nothing about the sky: it needs cloud cover, sky infrared or sky temperature."
        raise WeatherError(msg)
    if rows.timing["air_temperature"] != rows.timing["relative_humidity"]:
        msg = (
            f"{rows.file}: temperature and humidity must both be instants or both be means, to make a vapour pressure."
        )
        raise WeatherError(msg)
    notes = tuple(f"{name} left out: {missing[name].size} h without a value" for name in partial)
    return [name for name in QUANTITIES if name in REQUIRED or name in sky], notes


def _check_range(rows: Rows, name: str) -> None:
    quantity = QUANTITIES[name]
    values = rows.columns[name]
    bad = np.flatnonzero((values < quantity.low) | (values > quantity.high))
    if bad.size:
        i = int(bad[0])
        msg = (
            f"{rows.file}, row {rows.row_numbers[i]}: {name.replace('_', ' ')} of {values[i]:g} {quantity.unit} in the hour ending "
            f"{utc_text(int(rows.slot_ends[i]))} UTC is impossible (limits {quantity.low:g} to {quantity.high:g} "
            f"{quantity.unit}; {bad.size} such value{'s' if bad.size > 1 else ''}). Correct the file; values are never clipped."
        )
        raise WeatherError(msg)


def _fill(rows: Rows, most: int) -> tuple[Rows, tuple[str, ...]]:
    """Rows on the full hourly axis with every run of at most ``most`` missing hours filled linearly, and what was filled."""
    hours = int(rows.slot_ends[-1] - rows.slot_ends[0]) // SLOT_SECONDS + 1
    ends = rows.slot_ends[0] + SLOT_SECONDS * np.arange(hours, dtype=np.int64)
    present = (rows.slot_ends - rows.slot_ends[0]) // SLOT_SECONDS
    # A missing row is reported with the number of the row before which it is missing.
    numbers = rows.row_numbers[np.searchsorted(present, np.arange(hours))]
    columns: dict[str, FloatArray] = {}
    notes: list[str] = []
    for name, values in rows.columns.items():
        full = np.full(hours, np.nan)
        full[present] = values
        columns[name], filled = _fill_runs(full, most)
        if filled.size:
            first = utc_text(int(ends[filled[0]]))
            notes.append(f"{name}: {filled.size} h filled linearly, the first of them ending {first} UTC")
    return Rows(rows.file, ends, columns, rows.timing, numbers), tuple(notes)


def _fill_runs(values: FloatArray, most: int) -> tuple[FloatArray, IntArray]:
    missing = np.isnan(values)
    if not missing.any() or missing.all():
        return values, np.empty(0, dtype=np.int64)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False]))))
    filled = values.copy()
    indices: list[IntArray] = []
    known = np.flatnonzero(~missing)
    for begin, end in edges.reshape(-1, 2):
        if end - begin <= most and begin > 0 and end < values.size:
            run = np.arange(begin, end, dtype=np.int64)
            filled[run] = np.interp(run, known, values[known])
            indices.append(run)
    return filled, np.concatenate(indices) if indices else np.empty(0, dtype=np.int64)


def require_columns(file: str, found: Sequence[str], wanted: Sequence[str]) -> None:
    """Raise ``WeatherError`` that names the columns of ``wanted`` that are not in ``found``."""
    missing = [name for name in wanted if name not in found]
    if missing:
        msg = f"{file} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}. It has: {', '.join(found)}."
        raise WeatherError(msg)
