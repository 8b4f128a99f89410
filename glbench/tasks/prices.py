"""Prices that change with time: by hour, by date, as a series, or like those of a power market that sun and wind make cheap.

A market's price of an hour is

    level (shape(h) + weekend W - sun G / 1000 - wind (v - 5) / 5 + spread a)

with the hour h of the task's clock, W = 1 on Saturday and Sunday, the means over the hour of global radiation G [W m-2] and wind v
[m s-1] of the run's own weather, and an autocorrelated hourly path a with mean 0 and standard deviation 1
(``glbench.env.random``). It is kept within ``lowest`` and ``highest``. This is a generator of plausible prices and no model of a
market: its form and its defaults are chosen, docs/prices.md shows what comes out.

``PriceTableTable`` and ``Market`` are tables of a task file; the ``value`` of the former is a ``PriceTable``.
"""

from __future__ import annotations

import datetime as dt
import re
from calendar import monthrange
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from glbench.arrays import Floats
from glbench.errors import refuse
from glbench.tasks.fields import Table, as_tuple

HOURS_A_DAY = 24
DAY = 86400
SHAPE = (
    0.84, 0.80, 0.77, 0.76, 0.78, 0.84, 0.96, 1.10, 1.18, 1.13, 1.06, 1.02,
    0.99, 0.96, 0.95, 0.97, 1.03, 1.14, 1.25, 1.28, 1.20, 1.08, 0.99, 0.92,
)  # fmt: skip
"""Price of each hour of a working day without sun and at 5 m s-1 of wind, as a share of the level, with a mean of 1."""

RADIATION, WIND = 1000.0, 5.0
"""Radiation [W m-2] and wind [m s-1] by which a market's influences are counted."""


def _hours_of_a_day(shares: tuple[float, ...]) -> tuple[float, ...]:
    if len(shares) != HOURS_A_DAY:
        refuse(f"There must be {HOURS_A_DAY} numbers, one an hour; there are {len(shares)}.")
    return shares


class Market(Table):
    """``[price_tables.<name>.market]``: a power market; all shares are of ``level``."""

    level: float = Field(gt=0.0, description="a price above 0, in the unit of the table")
    """Mean price of a working day without sun and at 5 m s-1 of wind, in the unit of the table."""
    shape: Annotated[tuple[float, ...], BeforeValidator(as_tuple), AfterValidator(_hours_of_a_day)] | None = Field(
        default=None, description="24 shares of the level, one an hour"
    )
    """24 shares, one an hour of the task's clock; ``SHAPE`` where there are none."""
    weekend: float = Field(ge=-1.0, le=1.0, description="a share of the level, -1 to 1")
    """Added on Saturday and Sunday, mostly negative."""
    sun: float = Field(ge=0.0, le=10.0, description="a share of the level, 0 to 10")
    wind: float = Field(ge=0.0, le=10.0, description="a share of the level, 0 to 10")
    """``sun`` and ``wind``: by how much 1000 W m-2 of radiation, and 5 m s-1 more wind, make it cheaper."""
    spread: float = Field(ge=0.0, le=10.0, description="a share of the level, 0 to 10")
    persistence: float = Field(ge=0.0, lt=1.0, description="a fraction from 0 to below 1")
    """``spread`` and ``persistence``: standard deviation of what nothing explains, and how much of it is left an hour later."""
    lowest: float = Field(description="a price, in the unit of the table")
    highest: float = Field(description="a price, in the unit of the table")
    """``lowest`` and ``highest``: limits of the price, in the unit of the table."""

    @model_validator(mode="after")
    def _limits_are_in_order(self) -> Self:
        if self.lowest >= self.highest:
            refuse(f"lowest = {self.lowest:g} must be below highest = {self.highest:g}.")
        return self

    def price(self, hour: NDArray[np.int64], weekend: NDArray[np.bool_], sun: Floats, wind: Floats, path: Floats) -> Floats:
        """Prices of hours, all arguments ``(hours,)``: hour of day, whether a weekend, W m-2, m s-1, the unexplained part."""
        share = np.array(self.shape or SHAPE)[hour] + np.where(weekend, self.weekend, 0.0)
        share = share - self.sun * (sun / RADIATION) - self.wind * ((wind - WIND) / WIND) + self.spread * path
        return np.minimum(np.maximum(self.level * share, self.lowest), self.highest)


@dataclass(frozen=True)
class SeasonOfPrices:
    """What a market's prices of a season depend on, a row for each row of its calendar."""

    every: int
    """Rows an hour."""
    radiation: Floats
    wind: Floats
    """``radiation`` and ``wind``: of the season's weather ``(rows,)`` [W m-2, m s-1]."""
    paths: Mapping[str, Floats]
    """The unexplained part of each market by the name of its table ``(hours,)``."""


@dataclass(frozen=True)
class PriceTable:
    """A price that changes with time: exactly one of ``hourly``, ``dated``, ``series`` and ``market`` is there."""

    unit: str
    """Such as ``EUR kWh-1``."""
    hourly: tuple[float, ...] = ()
    """24 prices, one an hour of the task's clock."""
    dated: tuple[tuple[int, int, float], ...] = ()
    """Month, day, and the price from that day on, until the next entry, over the turn of the year."""
    series: tuple[tuple[dt.datetime, float], ...] = ()
    """Moments [UTC] in order, and the price from each on. Before the first the first holds."""
    yearly: bool = False
    """Whether the series, which is then of one year at most, holds for the same days and hours of every year."""
    market: Market | None = None
    """A market's prices."""
    source: str = ""
    """Name of the table that it follows, where it is another one plus or times something; else empty."""
    times: float = 1.0
    plus: float = 0.0
    """``times`` and ``plus``: the price is that of the source (or of the entries above) times ``times``, plus ``plus``."""

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest price that there can be."""
        if self.market is not None:
            ends = [self.market.lowest, self.market.highest]
        else:
            ends = [*self.hourly, *(price for _, _, price in self.dated), *(price for _, price in self.series)]
        ends = [self._adjusted(end) for end in ends]
        return min(ends), max(ends)

    def following(self, source: str, *, unit: str, times: float, plus: float) -> PriceTable:
        """The table that is this one, called ``source``, times ``times`` plus ``plus``."""
        return replace(self, unit=unit, source=self.source or source, times=self.times * times, plus=self.plus * times + plus)

    def values(self, times: NDArray[np.datetime64], hour_of_day: Floats, season: SeasonOfPrices | None = None, name: str = "") -> Floats:
        """The price at each row of a calendar ``(rows,)``, from its moments [UTC] and the hours of day of the task's clock.

        ``season`` is that of a market's prices, and ``name`` of the table there. Without it they are those of a day without sun and at
        5 m s-1 of wind: what can be expected of a market by the clock alone.
        """
        if self.market is not None:
            prices = _market_prices(self.market, times, hour_of_day, season, self.source or name)
        elif self.hourly:
            prices = np.array(self.hourly)[_hours(hour_of_day)]
        elif self.series:
            starts = np.array([moment.replace(tzinfo=None) for moment, _ in self.series], dtype="datetime64[s]")
            moments = times.astype("datetime64[s]")
            if self.yearly:
                place = np.searchsorted(in_year(starts), in_year(moments), side="right") - 1  # -1: the year before
            else:
                place = np.maximum(np.searchsorted(starts, moments, side="right") - 1, 0)
            prices = np.array([price for _, price in self.series])[place]
        else:
            days = in_year(local_times(times, hour_of_day)) // DAY
            entries = sorted(self.dated)
            place = np.searchsorted([100 * month + day for month, day, _ in entries], days, side="right") - 1
            prices = np.array([price for _, _, price in entries])[place]  # -1: the year before
        return prices if (self.times, self.plus) == (1.0, 0.0) else self._adjusted(prices)

    def _adjusted(self, price: Any) -> Any:
        return price * self.times + self.plus

    def in_words(self) -> str:
        """The dates that a series covers, and its mean, lowest and highest price."""
        first, last = self.series[0][0], self.series[-1][0]
        return (
            f"{len(self.series):,} prices from {first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M} "
            f"UTC{', repeated every year' if self.yearly else ''}; mean {self.mean:.4g}, lowest {self.limits[0]:.4g}, highest "
            f"{self.limits[1]:.4g} {self.unit}"
        )

    @property
    def mean(self) -> float:
        """Mean of a series over the time that each price holds, the last one as long as most."""
        prices = np.array([price for _, price in self.series])
        if prices.size < 2:
            return float(self._adjusted(prices.mean()))
        lengths = np.diff(np.array([moment.replace(tzinfo=None) for moment, _ in self.series], dtype="datetime64[s]").astype(np.int64))
        return float(self._adjusted(np.average(prices, weights=np.append(lengths, np.median(lengths)))))

    def is_stale(self, hours: NDArray[np.datetime64]) -> NDArray[np.bool_]:
        """Whether a series lacks a price for these hours [UTC] ``(hours,)``, so that an old one (or the first) is charged.

        Monthly prices are no gaps: a price may be a day old, or four times as old as the series' prices usually grow.
        """
        points = np.array([moment.replace(tzinfo=None) for moment, _ in self.series], dtype="datetime64[s]")
        if points.size < 2:
            return np.zeros(hours.size, dtype=bool) if self.yearly else np.asarray(hours < points[0])
        usual = int(np.median(np.diff(points).astype(np.int64)))
        longest = np.timedelta64(max(DAY, 4 * usual), "s")
        moments = hours.astype("datetime64[s]")
        if self.yearly:
            year = points[0].astype("datetime64[Y]")
            length = (year + 1).astype("datetime64[s]") - year.astype("datetime64[s]")
            moments = year.astype("datetime64[s]") + (moments - moments.astype("datetime64[Y]").astype("datetime64[s]"))
            points = np.concatenate([points - length, points, points + length])
        place = np.searchsorted(points, moments, side="right") - 1
        return np.asarray((place < 0) | (moments - points[np.maximum(place, 0)] > longest))


def _market_prices(market: Market, times: NDArray[np.datetime64], hour_of_day: Floats, season: SeasonOfPrices | None, name: str) -> Floats:
    """Prices of a market at each row of a calendar; without its season those of a day without sun and at 5 m s-1 of wind."""
    days = local_times(times, hour_of_day).astype("datetime64[D]").astype(np.int64)
    weekend, hour = (days + 3) % 7 >= 5, _hours(hour_of_day)  # day 0 was a Thursday
    if season is None:
        nothing = np.zeros(len(hour))
        return market.price(hour, weekend, nothing, nothing + WIND, nothing)
    every, hours = season.every, -(-len(hour) // season.every)
    first = np.arange(hours) * every
    sun, wind = (np.add.reduceat(values, first) / np.diff([*first, len(hour)]) for values in (season.radiation, season.wind))
    return np.repeat(market.price(hour[first], weekend[first], sun, wind, season.paths[name][:hours]), every)[: len(hour)]


def _hours(hour_of_day: Floats) -> NDArray[np.int64]:
    return np.floor(hour_of_day + 1e-9).astype(np.int64) % HOURS_A_DAY


def in_year(times: NDArray[np.datetime64]) -> NDArray[np.int64]:
    """Moments by month, day and second, in one number that rises through every year: (100 month + day) 86400 + second."""
    days = times.astype("datetime64[D]")
    month = days.astype("datetime64[M]")
    number = ((month - days.astype("datetime64[Y]").astype("datetime64[M]")).astype(np.int64) + 1) * 100
    number += (days - month.astype("datetime64[D]")).astype(np.int64) + 1
    seconds = (times.astype("datetime64[s]") - days.astype("datetime64[s]")).astype(np.int64)
    rising: NDArray[np.int64] = number * DAY + seconds
    return rising


def local_times(times: NDArray[np.datetime64], hour_of_day: Floats) -> NDArray[np.datetime64]:
    """The moments on the clock that ``hour_of_day`` shows."""
    seconds = times.astype("datetime64[s]")
    utc = (seconds - seconds.astype("datetime64[D]")).astype(np.int64)
    ahead = (np.rint(hour_of_day * 3600.0).astype(np.int64) - utc + 43200) % DAY - 43200
    local: NDArray[np.datetime64] = seconds + ahead.astype("timedelta64[s]")
    return local


def price_rows(
    tables: Mapping[str, PriceTable],
    names: Iterable[str],
    times: NDArray[np.datetime64],
    hour_of_day: Floats,
    season: SeasonOfPrices | None = None,
) -> Floats:
    """Prices of the tables ``names`` at each row of a calendar, ``(rows, names)``; ``season`` as for ``PriceTable.values``."""
    names = tuple(names)
    rows = np.zeros((len(times), len(names)))
    for column, name in enumerate(names):
        rows[:, column] = tables[name].values(times, hour_of_day, season, name)
    return rows


def day_ahead(prices: Floats, times: NDArray[np.datetime64], hour_of_day: Floats, every: int, hours: Iterable[int]) -> Floats:
    """What a day-ahead market lets know of coming prices, ``(rows, hours)``: those until midnight.

    An hour after midnight has the price of 24 h before: of the same hour today, unless the clock changes. Price, moment [UTC] and hour of
    day are those of each row of a calendar that begins at midnight, ``(rows,)``, with ``every`` rows an hour; ``hours`` are ahead, 1 to 24.
    """
    day = local_times(times, hour_of_day).astype("datetime64[D]")[::every]
    now = np.arange(len(day))
    hourly, columns = prices[::every], []
    for ahead in hours:
        then = np.minimum(now + ahead, len(day) - 1)
        until_midnight = (now + ahead < len(day)) & (day[then] == day)
        columns.append(hourly[np.where(until_midnight, then, np.maximum(now + ahead - HOURS_A_DAY, 0))])
    return np.repeat(np.stack(columns, axis=1), every, axis=0)[: len(prices)]


class SeriesPoint(Table):
    """A price from a moment on."""

    time: dt.datetime = Field(description="a moment")
    price: float = Field(description="a number")


_DAY = re.compile(r"(\d\d)-(\d\d)")


class PriceTableTable(Table):
    """``[price_tables.<name>]``: a price that changes with time, in one of several ways."""

    unit: str = Field(min_length=1, description='the unit in quotes, such as "EUR kWh-1"')
    hourly: tuple[float, ...] | None = Field(default=None, description="24 numbers, one an hour")
    from_day: dict[str, float] | None = Field(default=None, description='prices by day, such as { "01-15" = 3.5 }')
    series: tuple[SeriesPoint, ...] | None = Field(default=None, description="a list of { time = ..., price = ... }")
    yearly: bool = Field(default=False, description="true or false")
    market: Market | None = Field(default=None, description="a table [price_tables.<name>.market]")
    of: str | None = Field(default=None, min_length=1, description="the name of another price table, in quotes")
    times: float = Field(default=1.0, description="a factor")
    plus: float = Field(default=0.0, description="a price, in the unit of the table")

    @model_validator(mode="before")
    @classmethod
    def _lists(cls, table: object) -> object:
        return {key: as_tuple(value) for key, value in table.items()} if isinstance(table, Mapping) else table

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        ways = [name for name in ("hourly", "from_day", "series", "market", "of") if getattr(self, name) is not None]
        if len(ways) != 1:
            present = f"It has {' and '.join(ways)}. " if ways else ""
            refuse(
                "It must have exactly one of hourly (24 prices), from_day (prices by day), series (or file), market (prices by "
                f"sun and wind) and of (another table). {present}To replace the base's, leave it out "
                'at the top of the task, such as without = ["price_tables.power.market"].'
            )
        if self.yearly and self.series is None:
            refuse("yearly = true belongs to a series, which then holds for every year. Leave it out.")
        if self.hourly is not None and len(self.hourly) != 24:
            refuse(f"hourly must have 24 prices, one an hour; it has {len(self.hourly)}.")
        for day in self.from_day or ():
            month_and_day(day)
        if self.from_day is not None and not self.from_day:
            refuse('from_day must have a price: from_day = { "01-15" = 3.5 }.')
        if self.series is not None:
            moments = [point.time for point in self.series]
            odd = next((moment for moment in moments if (moment.tzinfo is None) != (moments[0].tzinfo is None)), None)
            if odd is not None:
                has = "has no" if odd.tzinfo is None else "has an"
                refuse(f"series: {odd:%Y-%m-%d %H:%M} {has} offset from UTC, unlike the first moment. Write all with one, or all without.")
            if not moments or any(later <= earlier for earlier, later in pairwise(moments)):
                refuse("series must have moments, each later than the one before.")
            if self.yearly and _utc(moments[0]).year != _utc(moments[-1]).year:
                refuse(
                    f"With yearly = true the series must be in one calendar year (UTC); it goes from {moments[0]:%Y-%m-%d} to "
                    f"{moments[-1]:%Y-%m-%d}. Keep one year of it."
                )
        return self

    def value(self, others: Mapping[str, PriceTableTable]) -> PriceTable:
        """The prices; ``others`` are the tables that this one may follow."""
        if self.of is not None:
            return others[self.of].value(others).following(self.of, unit=self.unit, times=self.times, plus=self.plus)
        return PriceTable(
            self.unit,
            self.hourly or (),
            tuple((*month_and_day(day), price) for day, price in sorted((self.from_day or {}).items())),
            tuple((_utc(point.time), point.price) for point in self.series or ()),
            self.yearly,
            self.market,
            times=self.times,
            plus=self.plus,
        )


def _utc(moment: dt.datetime) -> dt.datetime:
    return moment if moment.tzinfo is None else moment.astimezone(dt.UTC)


def month_and_day(text: object) -> tuple[int, int]:
    """Month and day of a text such as "01-15"; ValueError, in words, where there is no such day."""
    match = _DAY.fullmatch(text) if isinstance(text, str) else None
    month, day = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= month <= 12 or not 1 <= day <= monthrange(2000, month)[1]:
        refuse(f"'{text}' is not a day of the year. Write month and day with two digits each, such as \"01-15\".")
    return month, day
