"""The canonical hourly weather table: what is measured, in which unit, and at which moment of the hour.

A record is a run of hourly slots without a gap. Slot ``i`` covers ``(begin + i h, begin + (i + 1) h]`` in UTC. Values are
kept as whole numbers in a fixed fine unit (thousandths; radiation as the slot's energy in J m-2), because whole numbers
have one digest on every machine. ``WeatherRecord.frame`` shows them in the units people read.
"""

from __future__ import annotations

import datetime as dt
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import pandas as pd

IntArray = npt.NDArray[np.int64]
FloatArray = npt.NDArray[np.float64]
Timing = Literal["instant", "mean"]
"""``instant``: the value at the end of the slot. ``mean``: the mean over the slot."""

SLOT_SECONDS = 3600
SCHEMA = 1


@dataclass(frozen=True)
class HourlyQuantity:
    """One column of the canonical table.

    ``counts_per_unit`` whole counts make one ``unit``; ``low`` and ``high`` are the limits of the physically possible.
    """

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
            HourlyQuantity(
                "sky_infrared", "W/m2", 1000, 50.0, 700.0, "infrared radiation from the sky on the horizontal"
            ),
            HourlyQuantity("sky_temperature", "degC", 1000, -100.0, 60.0, "apparent sky temperature"),
        )
    }
)
REQUIRED = ("air_temperature", "relative_humidity", "wind_speed", "global_radiation")
SKY = ("sky_temperature", "sky_infrared", "cloud_cover")
"""What tells the sky's temperature, best first; a record has at least one of them."""


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


@dataclass(frozen=True)
class Place:
    """Where a record was measured: degrees north and east, metres above sea level, IANA time zone."""

    station: str
    latitude: float
    longitude: float
    altitude: float
    timezone: str


@dataclass(frozen=True, eq=False)
class WeatherRecord:
    """Hourly weather of one place, without a gap, that never changes.

    Attributes
    ----------
    name : str
        The name used by ``load_weather``.
    place : Place
        Station, coordinates and clock; also reachable as ``record.latitude`` and so on.
    begin : int
        Start of the first slot, seconds since 1970-01-01 UTC.
    counts : Mapping[str, ndarray of int64]
        The canonical whole numbers (read-only), see ``QUANTITIES``.
    timing : Mapping[str, "instant" | "mean"]
        For every column: the value at the end of the slot, or the mean over the slot.
    source, licence : str
        Where the figures come from, and the terms under which they may be used.
    typical_year : bool
        The months come from different years and carry one nominal year (EPW and TMY files).
    notes : tuple of str
        What was done to the figures on the way in (gaps filled, columns left out).
    """

    name: str
    place: Place
    begin: int
    counts: Mapping[str, IntArray]
    timing: Mapping[str, Timing]
    source: str
    licence: str
    typical_year: bool = False
    notes: tuple[str, ...] = field(default=())

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
        counts = self.counts[name][first_slot:last_slot]
        return counts.astype(np.float64) / QUANTITIES[name].counts_per_unit

    @property
    def frame(self) -> pd.DataFrame:
        """The hourly table with one column a quantity (units in ``QUANTITIES``), indexed by the slot's end in UTC."""
        import pandas as pd

        ends = self.begin + SLOT_SECONDS * np.arange(1, self.hours + 1, dtype=np.int64)
        index = pd.DatetimeIndex(ends.astype("datetime64[s]"), name="slot_end").tz_localize("UTC")
        return pd.DataFrame({name: self.values(name) for name in self.counts}, index=index)


@dataclass(frozen=True)
class WeatherInfo:
    """A line of ``glbench weather list``: what a record is, without its values."""

    name: str
    place: Place
    first: dt.datetime
    last: dt.datetime
    hours: int
    source: str
    licence: str
    digest: str
    origin: Literal["shipped", "yours"]
    path: Path
    typical_year: bool = False
    notes: tuple[str, ...] = ()
