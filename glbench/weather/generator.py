"""Seasons without number from some years of a record: a matched-block bootstrap.

A season is a chain of blocks of whole days. Each block is taken from the same time of the year, from a day before which the
weather was like the weather at the end of the chain. Hours of a block keep their joint course; docs/weather.md has the formulae
and the figures that show how well the seasons resemble the years they are made of.

A day begins at midnight of mean solar time, rounded to a slot of the record, so that blocks are joined at night everywhere. Years
are those of these days. A year's day of the calendar runs from 0 to 364; 29 February counts as 28 February.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from glbench.errors import WeatherError, refuse
from glbench.weather.record import QUANTITIES, RAW_SECONDS, SKY, SLOT_SECONDS, FloatArray, IntArray, Place, WeatherRecord

DAY_SECONDS = 86400
DAY_HOURS = 24
YEAR_DAYS = 365
MARGIN_DAYS = 2
"""Days before the first and after the last day of a season: its local midnights and a day of forecast lie inside in every time zone."""
RAMP_HOURS = 24
LOW_SUN = 15.0  # W m-2 of clear sky: below, the ratio to the clear sky says little
OVERCAST = 8.0  # octants
MATCHED = ("air_temperature", "relative_humidity", "wind_speed")


@dataclass(frozen=True)
class Blocks:
    """How blocks are cut and matched. The defaults were settled on Schiphol 2008 to 2010 (docs/weather.md)."""

    shortest: int = 4
    longest: int = 10
    """``shortest`` and ``longest``: length of a block [d], uniform between them."""
    window: int = 12
    """A block begins at most so many calendar days away from its place in the season."""
    nearest: int = 5
    """One of so many best matches is drawn."""
    neighbours: int = 10
    """A squared distance is divided by the candidate's own distance to so many days that are most like it (root mean square), so that
    unusual days are chosen, too."""
    rest: int = 10
    """A block holds none of the last so many days of the chain, and does not follow one of them."""
    midnight: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    day: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 0.5)
    days: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 0.0)
    """``midnight``, ``day`` and ``days``: weights of the squared differences, each in standard deviations: of the state in the hour before
    midnight (temperature, humidity, wind, sky), and of the means of the day and of the five days before (temperature, humidity, wind,
    clearness, daily range of temperature). Temperatures are anomalies from the mean course of the year."""


@dataclass(frozen=True, eq=False)
class GeneratedSeason:
    """One season, which starts on the day ``start``.

    ``record`` is hourly weather from ``MARGIN_DAYS``, two, before the first day to two days after the last; its dates are nominal.
    ``sources`` ``(days + 4,)`` int64 are the days that those of the record were taken from, in days since 1970-01-01
    (``sources.astype("datetime64[D]")``). ``joints`` ``(days + 4,)`` says whether a block begins with a day; false for the first.
    """

    start: dt.date
    record: WeatherRecord
    sources: IntArray
    joints: npt.NDArray[np.bool_]


class SeasonGenerator:
    """Seasons from some years of a record.

    ``record`` has whole calendar years of hourly weather; no hour of a year other than ``years`` is read. A single year, such as a typical
    year, works; its seasons resemble each other more. ``blocks`` says how blocks are cut and matched. Raises ``WeatherError``, with the
    year, when there are no years, or one of them is not wholly in the record.
    """

    def __init__(self, record: WeatherRecord, years: Sequence[int], blocks: Blocks = Blocks()) -> None:
        if not years:
            refuse(f"A season of weather '{record.name}' was asked for without years to draw from. Name at least one year.", WeatherError)
        self.record = record
        self.years = tuple(sorted({int(year) for year in years}))
        self.blocks = blocks
        self._days = _days_of(record, self.years)
        self._features, self._loneliness = _matching(record, self.years, blocks)

    def numbers(self, days: int) -> int:
        """How many random numbers a season of ``days`` days is made of."""
        return 2 * (1 + -(-(_length(days) - 1) // self.blocks.shortest))

    def real_days(self) -> tuple[IntArray, Mapping[str, FloatArray]]:
        """The days to draw from: days since 1970-01-01 (n,), and their hours (n, 24) by quantity in its unit."""
        return self._days.numbers, {name: self._days.values(name) for name in self._days.names}

    def season(self, start: dt.date, days: int, numbers: npt.NDArray[np.float64]) -> GeneratedSeason:
        """The season that ``numbers`` stand for; the same arguments give the same season, to the last bit.

        Of ``start``, the first day, the time of the year counts; the year itself names the hours. ``days`` is the length, at least 1.
        ``numbers`` ``(self.numbers(days),)`` are uniform in [0, 1). Raises ``WeatherError`` when an argument is impossible.
        """
        first, calendar, chain, joints = self._chained(start, days, numbers)
        sources = self._days.numbers[chain]
        for array in (sources, joints):
            array.setflags(write=False)
        record, years = self.record, ", ".join(str(year) for year in self.years)
        season = WeatherRecord(
            name=f"{record.name}-season",
            place=record.place,
            begin=first * DAY_SECONDS - self._days.ahead,
            counts=self._days.joined(chain, joints, calendar),
            timing=record.timing,
            source=f"season generated from the years {years} of weather '{record.name}': {record.source}",
            licence=record.licence,
            notes=(f"generated: blocks of days of the years {years}, joined in a new order; its dates are nominal",),
        )
        return GeneratedSeason(start, season, sources, joints)

    def source_years(self, start: dt.date, days: int, numbers: npt.NDArray[np.float64]) -> IntArray:
        """Source year of each day ``(days,)`` of the season; arguments and errors as for ``season``, but faster."""
        chain = self._chained(start, days, numbers)[2][MARGIN_DAYS : MARGIN_DAYS + days]
        return 1970 + self._days.numbers[chain].astype("datetime64[D]").astype("datetime64[Y]").astype(np.int64)

    def _chained(
        self, start: dt.date, days: int, numbers: npt.NDArray[np.float64]
    ) -> tuple[int, IntArray, IntArray, npt.NDArray[np.bool_]]:
        """First day of the record, and of each day the calendar, the day of the years that it is taken from, and whether a block begins."""
        count = self.numbers(days)
        numbers = np.asarray(numbers, dtype=np.float64)
        if numbers.shape != (count,) or not bool(np.all((numbers >= 0.0) & (numbers < 1.0))):
            msg = (
                f"A season of {days} days is made of {count} random numbers from 0 to 1 (1 excluded), see "
                f"SeasonGenerator.numbers; got an array of shape {numbers.shape}."
            )
            raise WeatherError(msg)
        if isinstance(start, dt.datetime) or not isinstance(start, dt.date):
            refuse(f"A season starts on a datetime.date; got {start!r}.", WeatherError)
        first = (start - dt.date(1970, 1, 1)).days - MARGIN_DAYS
        calendar = calendar_days(first + np.arange(_length(days)))
        chain = np.empty(calendar.size, dtype=np.int64)
        joints = np.zeros(calendar.size, dtype=np.bool_)
        shortest, longest = self.blocks.shortest, self.blocks.longest
        at = 0
        for for_length, for_choice in numbers.reshape(-1, 2).tolist():
            if at == 0:
                # What is left of the block that the season begins in, so that joints are equally likely on all days.
                at_least = np.minimum(longest - np.arange(longest), longest - shortest + 1)  # lengths of 1, 2, ... days or more
                running = np.cumsum(at_least)
                length = 1 + int(np.searchsorted(running, for_length * running[-1], side="right"))
            else:
                length = shortest + int(for_length * (longest - shortest + 1))
            choice = self._choices(chain[max(at - self.blocks.rest, 0) : at], int(calendar[at]), length)
            begin = choice[int(for_choice * choice.size)]
            end = min(at + length, calendar.size)
            chain[at:end] = np.arange(begin, begin + end - at)
            joints[at] = at > 0
            at = end
            if at == calendar.size:
                break
        return first, calendar, chain, joints

    def _choices(self, recent: IntArray, calendar_day: int, length: int) -> IntArray:
        """Days that a block of ``length`` days may begin with after the days ``recent``: all near the calendar day, or the best matches."""
        days, blocks = self._days, self.blocks
        after = recent.size > 0
        possible = days.runs >= length
        if after:
            possible = possible & days.follows
            possible[recent[-1] + 1 : recent[-1] + 2] = False  # what truly came next
        from_place = np.abs((days.calendar - calendar_day + YEAR_DAYS // 2) % YEAR_DAYS - YEAR_DAYS // 2)
        for window in range(blocks.window, YEAR_DAYS, 5):
            begins = np.flatnonzero(possible & (from_place <= window))
            if after:
                overlap = (recent >= begins[:, None] - 1) & (recent < begins[:, None] + length)
                begins = begins[~overlap.any(axis=1)]
            if begins.size >= blocks.nearest:
                break
        if not after:
            return begins
        distance = np.square(self._features[begins - 1] - self._features[recent[-1]]).sum(axis=1) / self._loneliness[begins - 1]
        return begins[np.argsort(distance, kind="stable")[: blocks.nearest]]


def calendar_days(numbers: IntArray) -> IntArray:
    """Day of a common year, 0 to 364, of days since 1970-01-01; 29 February counts as 28 February. Same shape."""
    days = numbers.astype("datetime64[D]")
    years = days.astype("datetime64[Y]")
    position = (days - years.astype("datetime64[D]")).astype(np.int64)
    following = years + np.timedelta64(1, "Y")
    leap = (following.astype("datetime64[D]") - years.astype("datetime64[D]")).astype(np.int64) > YEAR_DAYS
    return np.asarray(position - (leap & (position > 58)), dtype=np.int64)


def _length(days: int) -> int:
    if days < 1 or days != int(days):
        refuse(f"A season was asked for of {days!r} days; ask for a whole number, at least 1.", WeatherError)
    return int(days) + 2 * MARGIN_DAYS


class _Days:
    """The days of some years of a record, and what matching and joining need to know of them.

    All arrays are ``(n,)``: ``numbers`` are days since 1970-01-01 and ``calendar`` days of the calendar, int64; ``follows`` says whether
    the day before is the one before in these arrays, and ``runs`` how many days in a row begin here. ``ahead`` is how far the clock of
    these days is ahead of UTC [s].
    """

    def __init__(self, record: WeatherRecord, years: tuple[int, ...]) -> None:
        self.names = tuple(record.counts)
        # Mean solar time, rounded so that midnight is the beginning of a slot.
        past = record.begin % SLOT_SECONDS
        self.ahead = round((record.longitude / 15.0 * 3600.0 + past) / SLOT_SECONDS) * SLOT_SECONDS - past
        self.place = record.place
        self.numbers, first_slots = _whole_years(record, years, self.ahead)
        self.calendar = calendar_days(self.numbers)
        self.follows = np.diff(self.numbers, prepend=self.numbers[0]) == 1
        ends = np.append(np.flatnonzero(~self.follows)[1:], self.numbers.size)
        self.runs = ends[np.searchsorted(ends, np.arange(self.numbers.size), side="right")] - np.arange(self.numbers.size)
        # A typical year is a circle: hours that its days lack at the end are those at its beginning.
        slots = (first_slots[:, None] + np.arange(DAY_HOURS)) % record.hours
        counts = np.stack([record.counts[name][slots] for name in self.names], axis=-1)
        if "cloud_cover" in self.names:
            sky = counts[..., self.names.index("cloud_cover")]
            np.minimum(sky, int(OVERCAST) * QUANTITIES["cloud_cover"].counts_per_unit, out=sky)
        self.grid = np.maximum(np.gcd.reduce(counts.reshape(-1, len(self.names)), axis=0), 1)
        self.counts = counts.astype(np.float64)  # (n, 24, columns); whole numbers
        limits = [(QUANTITIES[name].low, OVERCAST if name == "cloud_cover" else QUANTITIES[name].high) for name in self.names]
        per_unit = np.array([QUANTITIES[name].counts_per_unit for name in self.names], dtype=np.float64)
        self.low, self.high = np.array(limits).T * per_unit

    def values(self, name: str) -> FloatArray:
        """Column ``name`` in its unit, (n, 24)."""
        return np.asarray(self.counts[..., self.names.index(name)] / QUANTITIES[name].counts_per_unit)

    @cached_property
    def clear_sky(self) -> FloatArray:
        """Radiation under a clear sky (365, 24) [W m-2]."""
        return clear_sky(self.place, self.ahead)

    @cached_property
    def warmth(self) -> FloatArray:
        """Mean course of the temperature through the year (365, 24) [counts]: two waves through the daily means."""
        mean = self.counts[..., self.names.index("air_temperature")].mean(axis=1)
        through = _waves(self.calendar.astype(np.float64) + 0.5)
        waves = np.linalg.solve(through.T @ through, through.T @ mean)
        hours = np.arange(1.0, YEAR_DAYS * DAY_HOURS + 1.0) / DAY_HOURS
        return np.asarray((_waves(hours) @ waves).reshape(YEAR_DAYS, DAY_HOURS))

    def features(self, blocks: Blocks) -> FloatArray:
        """What two days are compared by (n, 14): squared differences of the rows add up to the distance."""
        anomaly = self.values("air_temperature") - self.warmth[self.calendar] / QUANTITIES["air_temperature"].counts_per_unit
        sky = next(name for name in SKY if name in self.names)
        hourly = np.stack([anomaly, *(self.values(name) for name in (*MATCHED[1:], sky))], axis=-1)
        clear = np.maximum(self.clear_sky.mean(axis=1)[self.calendar], 1.0)
        clearness = self.values("global_radiation").mean(axis=1) / clear
        day = np.column_stack([hourly[..., :3].mean(axis=1), clearness, np.ptp(self.values("air_temperature"), axis=1)])
        # Means over each day and the (up to four) days before it.
        last = np.arange(self.numbers.size)
        before = np.minimum(last - np.maximum.accumulate(np.where(self.follows, 0, last)), 4)
        running = np.concatenate((np.zeros((1, day.shape[1])), np.cumsum(day, axis=0)))
        five_days = (running[last + 1] - running[last - before]) / (before + 1)[:, None]
        parts = ((hourly[:, -1], blocks.midnight), (day, blocks.day), (five_days, blocks.days))
        scaled = [part / np.maximum(part.std(axis=0), 1e-9) * np.sqrt(weights) for part, weights in parts]
        # Rounded, so that another processor's last bit does not change the order of matches.
        return np.asarray(np.round(np.concatenate(scaled, axis=1), 9))

    def joined(self, chain: IntArray, joints: npt.NDArray[np.bool_], calendar: IntArray) -> Mapping[str, IntArray]:
        """Columns of a season whose days are ``chain``, moved to the days of the year ``calendar`` and joined smoothly."""
        season = self.counts[chain]
        from_calendar = self.calendar[chain]
        # Columns that hold temperatures follow the mean course of the year.
        warm = [i for i, name in enumerate(self.names) if name in ("air_temperature", "sky_temperature")]
        season[..., warm] += (self.warmth[calendar] - self.warmth[from_calendar])[..., None]
        radiation = self.names.index("global_radiation")
        # Radiation: the clearness of each hour, under the sun of its new day.
        measured = self.counts[chain, :, radiation]
        here, there = self.clear_sky[calendar], self.clear_sky[from_calendar]
        high = there > LOW_SUN
        moved = measured * np.where(high, here, 0.0) / np.where(high, there, 1.0)
        # Where the sun stands high in this season only, the nearest sunlit hour of the day says how clear it is.
        risen = self._clearness[chain] * here
        twilight = np.where((here > 0.0) | (there == 0.0), measured, 0.0)
        season[..., radiation] = np.where(high, moved, np.where(here > LOW_SUN, risen, twilight))
        begins = np.flatnonzero(joints)
        if begins.size:
            before, own = (chain[begins - 1], chain[begins] - 1)  # the day before the joint, and the day that truly came before the block
            gap = self.counts[before, -1] - self.counts[own, -1]
            warmth = self.warmth[:, -1]
            gap[:, warm] += (warmth[self.calendar[own]] - warmth[self.calendar[before]])[:, None]
            gap[:, radiation] = 0.0
            ramp = np.arange(1, RAMP_HOURS + 1) / (2.0 * RAMP_HOURS)
            season[begins - 1] -= ramp[:, None] * gap[:, None, :]
            season[begins] += ramp[::-1, None] * gap[:, None, :]
        np.rint(season / self.grid, out=season)
        season *= self.grid
        np.clip(season, self.low, self.high, out=season)
        columns = np.ascontiguousarray(season.reshape(-1, len(self.names)).T).astype(np.int64)
        columns.setflags(write=False)
        return MappingProxyType(dict(zip(self.names, columns, strict=True)))

    @cached_property
    def _clearness(self) -> FloatArray:
        """Radiation over clear sky (n, 24) [counts m2 W-1]; of an hour with a low sun, that of the nearest hour with a high one."""
        sun = self.clear_sky[self.calendar]
        high = sun > LOW_SUN
        ratio = self.counts[..., self.names.index("global_radiation")] / np.where(high, sun, 1.0)
        apart = np.abs(np.arange(DAY_HOURS)[:, None] - np.arange(DAY_HOURS))
        nearest = np.where(high[:, None, :], apart, DAY_HOURS).argmin(axis=-1)
        return np.where(high.any(axis=1, keepdims=True), np.take_along_axis(ratio, nearest, axis=1), 0.0)


@lru_cache(maxsize=16)
def _days_of(record: WeatherRecord, years: tuple[int, ...]) -> _Days:
    return _Days(record, years)


@lru_cache(maxsize=16)
def _matching(record: WeatherRecord, years: tuple[int, ...], blocks: Blocks) -> tuple[FloatArray, FloatArray]:
    """What days are compared by (n, 14), and each day's distance to its neighbours (n,), root mean square."""
    days = _days_of(record, years)
    features = days.features(blocks)
    loneliness = np.empty(len(features))
    for day in range(len(features)):
        apart = np.abs((days.calendar - days.calendar[day] + YEAR_DAYS // 2) % YEAR_DAYS - YEAR_DAYS // 2)
        near = np.flatnonzero(apart <= blocks.window)
        distance = np.sort(np.square(features[near] - features[day]).sum(axis=1))
        loneliness[day] = distance[1 : blocks.neighbours + 1].mean()  # the first is the day itself
    return features, np.maximum(np.sqrt(loneliness), 1e-9)


@lru_cache(maxsize=16)
def clear_sky(place: Place, ahead: int) -> FloatArray:
    """Global radiation under a clear sky at ``place`` (365, 24) [W m-2], hourly means on a clock ``ahead`` seconds of UTC.

    Haurwitz (1945): 1098 s exp(-0.057 / s) with s the sine of the sun's elevation; declination and equation of time of each day by Spencer
    (1971), which is near enough for the ratio of two days.
    """
    declination, minutes = spencer_1971(np.arange(YEAR_DAYS))
    parts = SLOT_SECONDS // RAW_SECONDS
    clock = (np.arange(DAY_HOURS * parts) + 0.5) / parts - ahead / SLOT_SECONDS  # UTC [h]
    solar = clock + place.longitude / 15.0 + minutes[:, None] / 60.0
    latitude, hour_angle = np.radians(place.latitude), np.radians(15.0 * (solar - 12.0))
    sine = np.sin(latitude) * np.sin(declination[:, None]) + np.cos(latitude) * np.cos(declination[:, None]) * np.cos(hour_angle)
    radiation = np.where(sine > 0.0, 1098.0 * sine * np.exp(-0.057 / np.maximum(sine, 1e-3)), 0.0)
    clear: FloatArray = radiation.reshape(YEAR_DAYS, DAY_HOURS, parts).mean(axis=-1)
    clear.setflags(write=False)
    return clear


def spencer_1971(days: IntArray) -> tuple[FloatArray, FloatArray]:
    """Declination of the sun [rad] and equation of time [min] on days ``(n,)`` from 0, 1 January: Spencer's Fourier series (1971).

    The bits are those of pvlib, which takes a second to load.
    """
    angle = (2.0 * np.pi / YEAR_DAYS) * days
    cosine, sine, cosine2, sine2 = np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)
    declination = 0.006918 - 0.399912 * cosine + 0.070257 * sine - 0.006758 * cosine2 + 0.000907 * sine2
    declination = declination - 0.002697 * np.cos(3.0 * angle) + 0.00148 * np.sin(3.0 * angle)
    time = 0.0000075 + 0.001868 * cosine - 0.032077 * sine - 0.014615 * cosine2 - 0.040849 * sine2
    return declination, (1440.0 / 2.0 / np.pi) * time


def _waves(days: FloatArray) -> FloatArray:
    """A constant, a yearly and a half-yearly wave at ``days`` (n,) of the year: (n, 5)."""
    angle = 2.0 * np.pi / YEAR_DAYS * days
    return np.column_stack([np.ones_like(angle), *(f(k * angle) for k in (1.0, 2.0) for f in (np.cos, np.sin))])


def _whole_years(record: WeatherRecord, years: tuple[int, ...], ahead: int) -> tuple[IntArray, IntArray]:
    """Days since 1970 of these years, and the slot of the record that each begins with."""
    numbers = []
    for year in years:
        first, last = ((dt.date(y, 1, 1) - dt.date(1970, 1, 1)).days for y in (year, year + 1))
        begin, end = (day * DAY_SECONDS - ahead for day in (first, last))
        circle = record.typical_year and record.hours == YEAR_DAYS * DAY_HOURS
        if circle:
            begin, end = begin + ahead, end + ahead  # the hours that its clock differs by are turned over its end
        if begin < record.begin or end > record.end:
            msg = (
                f"The year {year} is not wholly in weather '{record.name}', which covers {record.period} (days begin at midnight "
                f"of solar time, UTC{ahead / 3600:+g} h). Choose years inside it."
            )
            raise WeatherError(msg)
        numbers.append(np.arange(first, last, dtype=np.int64))
    days = np.concatenate(numbers)
    return days, np.asarray((days * DAY_SECONDS - ahead - record.begin) // SLOT_SECONDS)
