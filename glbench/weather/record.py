"""The canonical hourly weather table: what is measured, in which unit, and at which moment of the hour; and how a file's rows become one.

A record is a run of hourly slots without a gap. Slot ``i`` covers ``(begin + i h, begin + (i + 1) h]`` in UTC. Values are
kept as whole numbers in a fixed fine unit (thousandths; radiation as the slot's energy in J m-2), because whole numbers
have one digest on every machine. ``WeatherRecord.frame`` shows them in the units people read.
``assemble`` checks every row of a file, and fills nothing unless it was asked to.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, NoReturn
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
import numpy.typing as npt

from glbench.errors import GlbenchError, WeatherError, refuse

if TYPE_CHECKING:
    import pandas as pd

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
Timing = Literal["instant", "mean"]  # ``instant``: the value at the end of the slot. ``mean``: the mean over the slot.

SLOT_SECONDS = 3600
RAW_SECONDS = 300  # Both preprocessings pass through a 5-minute grid, like the published data
SCHEMA = 1
LONGEST_FILL = 48  # Most hours in a row that may be filled on request: beyond two days a straight line says nothing about the weather
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
class HourlyQuantity:
    """A column of the table: ``counts_per_unit`` whole counts make one ``unit``; ``low`` and ``high`` limit what is physically possible."""

    name: str
    unit: str
    counts_per_unit: int
    low: float
    high: float
    meaning: str


QUANTITIES: Mapping[str, HourlyQuantity] = MappingProxyType(
    {
        q.name: q
        for q in (
            HourlyQuantity("air_temperature", "degC", 1000, -60.0, 60.0, "air temperature at 1.5 to 2 m"),
            HourlyQuantity("relative_humidity", "%", 1000, 0.0, 100.0, "relative humidity at 1.5 to 2 m"),
            HourlyQuantity("wind_speed", "m/s", 1000, 0.0, 75.0, "wind speed at 10 m"),
            # One count is 1 J m-2 in the slot, so that both J cm-2 and Wh m-2 come out whole.
            HourlyQuantity("global_radiation", "W/m2", SLOT_SECONDS, 0.0, 1500.0, "global horizontal radiation"),
            HourlyQuantity("cloud_cover", "octants", 1000, 0.0, 9.0, "cloud cover; 9 = sky invisible (KNMI's code)"),
            HourlyQuantity("sky_infrared", "W/m2", 1000, 50.0, 700.0, "infrared radiation from the sky on the horizontal"),
            HourlyQuantity("sky_temperature", "degC", 1000, -100.0, 60.0, "apparent sky temperature"),
        )
    }
)
REQUIRED = ("air_temperature", "relative_humidity", "wind_speed", "global_radiation")
SKY = ("sky_temperature", "sky_infrared", "cloud_cover")  # What tells the sky's temperature, best first; a record has at least one of them


def canonical_digest(header: Mapping[str, object], columns: Mapping[str, IntArray]) -> str:
    """SHA-256 [hex] over a JSON header and whole-number columns (int64, little-endian), in the order given."""
    text = json.dumps(header, sort_keys=True, separators=(",", ":"), allow_nan=False).encode()
    digest = hashlib.sha256(len(text).to_bytes(8, "little") + text)
    for name, counts in columns.items():
        payload = np.ascontiguousarray(counts, dtype="<i8").tobytes()
        digest.update(name.encode() + b"\0" + len(payload).to_bytes(8, "little") + payload)
    return digest.hexdigest()


def utc_text(seconds: float) -> str:
    """``2010-03-01 05:00`` for seconds since 1970 (UTC)."""
    # Not by datetime, which ends with the year 9999: periods that nobody has weather of are reported, too.
    return str(np.datetime_as_string(np.datetime64(math.floor(seconds), "s"), unit="m")).replace("T", " ")


def ends_of_hours(
    year: FloatArray, month: FloatArray, day: FloatArray, hour: FloatArray, fault: Callable[[int, str], NoReturn]
) -> IntArray:
    """Ends of the hours 1 to 24 of calendar dates ``(rows,)`` [s since 1970-01-01]; ``fault`` raises the error of a row and its fault."""
    years, months, days, hours = (np.nan_to_num(part, nan=-1.0).astype(np.int64) for part in (year, month, day, hour))
    calendar_months = (12 * (years - 1970) + months - 1).astype("datetime64[M]")
    dates = calendar_months.astype("datetime64[D]") + (days - 1)
    wrong = np.flatnonzero((years < 0) | (months < 1) | (months > 12) | (dates.astype("datetime64[M]") != calendar_months))
    if wrong.size:
        i = int(wrong[0])
        fault(i, f"the date {year[i]:04.0f}-{month[i]:02.0f}-{day[i]:02.0f} does not exist")
    wrong = np.flatnonzero(~((hour >= 1) & (hour <= 24) & (hour % 1 == 0)))
    if wrong.size:
        fault(int(wrong[0]), f"hour {hour[wrong[0]]:g} does not exist: hours run from 1 to 24")
    return np.asarray(dates.astype("datetime64[s]").astype(np.int64) + SLOT_SECONDS * hours, dtype=np.int64)


def time_zone(name: str) -> ZoneInfo:
    """IANA time zone ``name``. Raises ``WeatherError`` when the time-zone database has no such zone."""
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError) as error:
        refuse(f"'{name}' is no time zone of the IANA database. Use a name such as Europe/Amsterdam or Etc/GMT-1.", WeatherError, error)


Coordinates = tuple[float, float, float]  # Degrees north, degrees east, metres above sea level


@dataclass(frozen=True)
class Place:
    """Where a record was measured: degrees north and east, metres above sea level, IANA time zone."""

    station: str
    latitude: float
    longitude: float
    altitude: float
    timezone: str


@dataclass(frozen=True, eq=False)
class Origin:
    """Who measured something where.

    ``name`` is used by ``load_weather``; ``place`` has station, coordinates and clock, of a record also reachable as ``record.latitude``
    and so on. ``source`` and ``licence`` say where the figures come from, and the terms under which they may be used. The months of a
    ``typical_year`` come from different years and carry one nominal year (EPW and TMY files). ``notes`` are what was done to the figures on
    the way in (gaps filled, columns left out).
    """

    name: str
    place: Place
    source: str
    licence: str
    typical_year: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class WeatherRecord(Origin):
    """Hourly weather of one place, without a gap, that never changes."""

    begin: int
    """Start of the first slot, seconds since 1970-01-01 UTC."""
    counts: Mapping[str, IntArray]
    """The canonical whole numbers (read-only), see ``QUANTITIES``."""
    timing: Mapping[str, Timing]
    """For every column: the value at the end of the slot, or the mean over the slot."""

    @property
    def station(self) -> str:
        """Name of the station."""
        return self.place.station

    @property
    def latitude(self) -> float:
        """Degrees north."""
        return self.place.latitude

    @property
    def longitude(self) -> float:
        """Degrees east."""
        return self.place.longitude

    @property
    def altitude(self) -> float:
        """Metres above sea level."""
        return self.place.altitude

    @property
    def timezone(self) -> str:
        """IANA name of the local clock."""
        return self.place.timezone

    @property
    def hours(self) -> int:
        """Number of hourly slots."""
        return int(self.counts["air_temperature"].size)

    @property
    def end(self) -> int:
        """End of the last slot, seconds since 1970-01-01 UTC."""
        return self.begin + SLOT_SECONDS * self.hours

    @property
    def first(self) -> dt.datetime:
        """Start of the first slot, UTC."""
        return dt.datetime.fromtimestamp(self.begin, tz=dt.UTC)

    @property
    def last(self) -> dt.datetime:
        """End of the last slot, UTC."""
        return dt.datetime.fromtimestamp(self.end, tz=dt.UTC)

    @property
    def period(self) -> str:
        """The period in words, UTC."""
        return f"{utc_text(self.begin)} to {utc_text(self.end)} UTC"

    @cached_property
    def digest(self) -> str:
        """SHA-256 over the canonical values, their timing, period and place. The name and the texts do not enter."""
        header: dict[str, object] = {
            "schema": SCHEMA,
            "begin": utc_text(self.begin),
            "hours": self.hours,
            "columns": {name: [QUANTITIES[name].counts_per_unit, self.timing[name]] for name in self.counts},
            "place": [self.latitude, self.longitude, self.altitude, self.timezone],
        }
        return canonical_digest(header, {name: self.counts[name] for name in QUANTITIES if name in self.counts})

    def values(self, name: str, first_slot: int = 0, last_slot: int | None = None) -> FloatArray:
        """Column ``name`` in its unit, shape (slots,); one correctly rounded division, the same on every machine."""
        return self.counts[name][first_slot:last_slot].astype(np.float64) / QUANTITIES[name].counts_per_unit

    @property
    def frame(self) -> pd.DataFrame:
        """The hourly table with one column a quantity (units in ``QUANTITIES``), indexed by the slot's end in UTC."""
        import pandas as pd

        ends = self.begin + SLOT_SECONDS * np.arange(1, self.hours + 1, dtype=np.int64)
        index = pd.DatetimeIndex(ends.astype("datetime64[s]"), name="slot_end").tz_localize("UTC")
        return pd.DataFrame({name: self.values(name) for name in self.counts}, index=index)


@dataclass(frozen=True, kw_only=True)
class WeatherInfo(Origin):
    """A line of ``glbench weather list``: what a record is, without its values."""

    first: dt.datetime
    last: dt.datetime
    hours: int
    digest: str
    origin: Literal["shipped", "yours"]
    path: Path


@dataclass(frozen=True)
class Rows:
    """The rows of one file, as read: NaN where the file has no value.

    ``file`` is where they come from, and ``row_numbers`` are their lines (or rows) in it, counted from 1; both are for messages.
    ``slot_ends`` are the ends of the rows' slots, int64 seconds since 1970-01-01 UTC. ``columns`` holds the values in the units of
    ``QUANTITIES``; ``timing`` says what those of a column mean.
    """

    file: str
    slot_ends: IntArray
    columns: Mapping[str, FloatArray]
    timing: Mapping[str, Timing]
    row_numbers: IntArray


def check_place(place: Place, file: object, kind: type[GlbenchError] = WeatherError) -> None:
    """Refuse impossible coordinates with an error of ``kind`` that names ``file``, and an unknown time zone with ``WeatherError``."""
    limits = (("latitude", place.latitude, 90.0, "deg"), ("longitude", place.longitude, 180.0, "deg"))
    for name, value, limit, unit in limits:
        if not abs(value) <= limit:
            refuse(f"{file}: the {name} {value} {unit} is impossible. Correct the station's coordinates.", kind)
    if not -500.0 <= place.altitude <= 9000.0:
        refuse(f"{file}: the altitude {place.altitude} m is impossible. Correct the station's altitude.", kind)
    time_zone(place.timezone)


def assemble(rows: Rows, origin: Origin, *, fill_gaps: int = 0) -> WeatherRecord:
    """Checked canonical record of ``rows``, with what ``origin`` knows about them.

    Up to ``fill_gaps`` missing hours in a row are filled linearly, which the record's notes say. Raises ``WeatherError``, with file, row
    and value, for an empty file, hours out of order or twice, gaps, missing or impossible values, an impossible place.
    """
    check_place(origin.place, rows.file)
    check_order(rows)
    check_values(rows)  # before gaps are filled: an impossible value must not hide in the filling
    rows, notes = _fill(rows, fill_gaps) if fill_gaps > 0 else (rows, ())
    names, dropped = _complete_columns(rows)
    counts: dict[str, IntArray] = {}
    for name in names:
        column = np.rint(rows.columns[name] * QUANTITIES[name].counts_per_unit).astype(np.int64)
        column.setflags(write=False)
        counts[name] = column
    about = {field.name: getattr(origin, field.name) for field in fields(Origin)}
    return WeatherRecord(
        **about | {"notes": (*origin.notes, *notes, *dropped)},
        begin=int(rows.slot_ends[0]) - SLOT_SECONDS,
        counts=MappingProxyType(counts),
        timing=MappingProxyType({name: rows.timing[name] for name in names}),
    )


def check_values(rows: Rows) -> None:
    """Raise ``WeatherError`` for an impossible value; names the row."""
    for name, values in rows.columns.items():
        quantity = QUANTITIES[name]
        bad = np.flatnonzero((values < quantity.low) | (values > quantity.high))
        if bad.size:
            i = int(bad[0])
            msg = (
                f"{rows.file}, row {rows.row_numbers[i]}: {name.replace('_', ' ')} of {values[i]:g} {quantity.unit} at "
                f"{utc_text(int(rows.slot_ends[i]))} UTC is impossible (limits {quantity.low:g} to {quantity.high:g} {quantity.unit}; "
                f"{bad.size:,} such value{'s' if bad.size > 1 else ''}). Check its unit, or correct the file; values are never clipped."
            )
            raise WeatherError(msg)


def check_order(rows: Rows) -> None:
    """Raise ``WeatherError`` when there are no rows, or hours appear twice or out of order; names the row."""
    ends = rows.slot_ends
    if ends.size == 0:
        refuse(f"{rows.file} holds no hourly values. Is it the right file, and whole?", WeatherError)
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
        refuse(f"{rows.file}, row {rows.row_numbers[i + 1]}: {what}. Correct the file or fetch it again.", WeatherError)


def _remedy(hours: int) -> str:
    """What to do about ``hours`` missing hours in a row."""
    if hours > LONGEST_FILL:
        return f"That is more than the {LONGEST_FILL} h in a row that --fill-gaps may fill: choose another period, or another station."
    return f"Nothing is filled unasked: choose another period, or import with --fill-gaps {hours}."


def _complete_columns(rows: Rows) -> tuple[list[str], tuple[str, ...]]:
    """Names of the columns to keep, and notes on the sky columns left out for being incomplete. Hours must follow each other."""
    gaps = np.flatnonzero(np.diff(rows.slot_ends) != SLOT_SECONDS)
    if gaps.size:
        i = int(gaps[0])
        hours = int(rows.slot_ends[i + 1] - rows.slot_ends[i]) // SLOT_SECONDS - 1
        msg = (
            f"{rows.file}, row {rows.row_numbers[i + 1]}: {hours} h are missing between {utc_text(int(rows.slot_ends[i]))} and "
            f"{utc_text(int(rows.slot_ends[i + 1]))} UTC ({gaps.size} gap{'s' if gaps.size > 1 else ''} in all). {_remedy(hours)}"
        )
        raise WeatherError(msg)
    missing = {name: np.flatnonzero(np.isnan(values)) for name, values in rows.columns.items()}
    sky = [name for name in SKY if name in missing and missing[name].size == 0]
    partial = [name for name in SKY if name in missing and 0 < missing[name].size < rows.slot_ends.size]
    required = [*REQUIRED, *([] if sky else partial[:1])]
    for name in required:
        if name not in missing:
            refuse(f"{rows.file} has no column for {name.replace('_', ' ')} [{QUANTITIES[name].unit}], which is needed.", WeatherError)
        if missing[name].size:
            i = int(missing[name][0])
            edges = np.flatnonzero(np.concatenate([[True], ~np.isnan(rows.columns[name]), [True]]))
            msg = (
                f"{rows.file}, row {rows.row_numbers[i]}: no value for {name.replace('_', ' ')} in the hour ending "
                f"{utc_text(int(rows.slot_ends[i]))} UTC ({missing[name].size} missing in all). {_remedy(int(np.diff(edges).max()) - 1)}"
            )
            raise WeatherError(msg)
    if not sky:
        refuse(f"{rows.file} says nothing about the sky: it needs cloud cover, sky infrared or sky temperature.", WeatherError)
    if rows.timing["air_temperature"] != rows.timing["relative_humidity"]:
        refuse(f"{rows.file}: temperature and humidity must both be instants or both be means, to make a vapour pressure.", WeatherError)
    notes = tuple(f"{name} left out: {missing[name].size} h without a value" for name in partial)
    return [name for name in QUANTITIES if name in REQUIRED or name in sky], notes


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
        columns[name] = full = np.full(hours, np.nan)
        full[present] = values
        missing = np.isnan(full)
        if not missing.any() or missing.all():
            continue
        measured = np.flatnonzero(~missing)
        edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False]))))
        runs = [
            np.arange(begin, end, dtype=np.int64)
            for begin, end in edges.reshape(-1, 2)
            if end - begin <= most and begin > 0 and end < hours
        ]
        if runs:
            filling = np.concatenate(runs)
            full[filling] = np.interp(filling, measured, full[measured])
            first = utc_text(int(ends[filling[0]]))
            notes.append(f"{name}: {filling.size} h filled linearly, the first of them ending {first} UTC")
    return Rows(rows.file, ends, columns, rows.timing, numbers), tuple(notes)


def require_columns(file: str, present: Sequence[str], needed: Sequence[str]) -> None:
    """Raise ``WeatherError`` that names the columns of ``needed`` that are not in ``present``."""
    missing = [name for name in needed if name not in present]
    if missing:
        msg = f"{file} lacks the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}. It has: {', '.join(present)}."
        raise WeatherError(msg)
