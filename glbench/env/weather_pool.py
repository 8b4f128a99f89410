"""The weather of a task's runs: one pool of rows that all its environments in a process share.

The seasons of a record are in the pool from the start. Generated seasons have their place in it, a slot each, which is filled when a run
first asks for that season: thousands of environments cost no more memory than the seasons that a split has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from threading import Lock
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.air import read_air
from glbench.env.forecast import HOUR, ForecastTable
from glbench.env.generated import SeasonMaker
from glbench.env.random import ar1_paths
from glbench.env.uncertainty import season_key
from glbench.errors import TaskError, refuse
from glbench.model import vapour_density
from glbench.tasks import TaskSpec
from glbench.tasks.prices import SeasonOfPrices, day_ahead, local_times, price_rows
from glbench.tasks.schedule import schedule_rows
from glbench.tasks.vocabulary import DAY_AHEAD, PRICES, WEATHER_WINDOW
from glbench.weather import COLUMNS

CLOCK = ("hour_of_day", "day_of_year")
"""Columns of a calendar before those of its price tables and of its schedule."""

HOURS_A_DAY = 24.0
DAYS_A_YEAR = 365.0

_RADIATION, _TEMPERATURE, _PRESSURE, _CO2, _WIND = (COLUMNS.index(name) for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind"))
_MEASURED_RADIATION, _MEASURED_WIND = 0, 4  # their columns in ``WeatherTables.measured``
_PUBLISHED = [_RADIATION, _TEMPERATURE, _PRESSURE, _CO2, _WIND]


@dataclass(frozen=True, eq=False)
class WeatherTables:
    """Weather and clock by row of the pool, float32 as observed.

    ``measured``: global radiation [W m-2], temperature [degC], relative humidity [%], CO2 [ppm], wind [m s-1].
    ``published``: the same with vapour pressure [Pa] and CO2 density [mg m-3].
    ``window``: radiation, CO2 density [kg m-3], temperature, vapour density [kg m-3]; without rows if they are not observed.
    ``clock``: sine and cosine of the hour of day, then of the day of year, by row of the calendar.
    ``forecast``: the forecast by the hour, a row for each hour of the pool; without columns where a task has none.
    ``prices``, ``day_ahead``: prices of now and of coming hours, by row of the calendar; without rows if they are not observed.
    """

    measured: NDArray[np.float32]
    published: NDArray[np.float32]
    clock: NDArray[np.float32]
    forecast: NDArray[np.float32]
    prices: NDArray[np.float32]
    day_ahead: NDArray[np.float32]
    window: NDArray[np.float32]

    @staticmethod
    def of(task: TaskSpec) -> WeatherTables:
        """Tables of a task, shared by all its environments in this process."""
        return WeatherPool.of(task).tables


@dataclass(frozen=True, eq=False)
class SeasonPrices:
    """What fills the prices of a task's pool.

    A market's prices belong to a season, because its sun and wind make them. What nothing explains is a path of the season's own.
    """

    task: TaskSpec
    """The task."""
    every: int
    """Steps an hour."""
    widths: tuple[int, int]
    """Width of the table of prices of now, and of that of coming hours: 0 if it is not observed."""
    by_season: bool
    """Whether each season has prices of its own."""

    @staticmethod
    def of(task: TaskSpec) -> SeasonPrices:
        """The prices of a task, which may be none. Raises ``TaskError`` when prices go by the hour, which its step does not divide."""
        tables, ahead = task.price_tables, task.day_ahead
        modules = task.observation.modules
        markets = [name for name, table in tables.items() if table.market is not None]
        step = task.weather.step_seconds
        by_hour = [*(f"price_tables.{name}" for name in markets), *(["observation.day_ahead"] if ahead is not None else [])]
        if by_hour and HOUR % step:
            refuse(f"{task.source}: [{by_hour[0]}] is hourly; step_seconds = {step} does not divide an hour. Use 900.", TaskError)
        coming = 0 if ahead is None or DAY_AHEAD not in modules else len(ahead.prices) * len(ahead.hours)
        return SeasonPrices(task, max(HOUR // step, 1), (len(tables) if PRICES in modules else 0, coming), bool(markets))

    def room(self, rows: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Tables of the prices of now and of coming hours for so many rows of a calendar."""
        now, coming = (np.zeros((rows if width else 0, width), np.float32) for width in self.widths)
        return now, coming

    def rows(self, number: int, times: NDArray[np.datetime64], hour_of_day: Floats, measured: NDArray[np.floating]) -> Floats:
        """Prices at each row of the calendar of the season ``number``, ``(rows, price tables)``.

        ``times`` and ``hour_of_day`` are start [UTC] and hour of day of each row, ``(rows,)``, ``measured`` the season's weather as
        measured (``WeatherTables.measured``), ``(rows, 5)``.
        """
        tables, season = self.task.price_tables, None
        if self.by_season:
            hours = -(-len(times) // self.every)
            paths = {
                table.source or name: ar1_paths(
                    season_key(self.task.scenario, f"price {table.source or name}", f"season {number}"),
                    hours,
                    np.array([table.market.persistence]),
                )[:, 0]
                for name, table in tables.items()
                if table.market is not None
            }
            weather = np.asarray(measured, np.float64)
            season = SeasonOfPrices(self.every, weather[:, _MEASURED_RADIATION], weather[:, _MEASURED_WIND], paths)
        return price_rows(tables, tables, times, hour_of_day, season)

    def show(
        self,
        tables: tuple[NDArray[np.float32], NDArray[np.float32]],
        at: slice,
        prices: Floats,
        times: NDArray[np.datetime64],
        hour_of_day: Floats,
    ) -> None:
        """Write the observed prices of a season into the rows ``at`` of the tables of ``room``."""
        now, coming = tables
        if len(now):
            now[at] = prices
        if len(coming):
            ahead, names = self.task.day_ahead, list(self.task.price_tables)
            assert ahead is not None
            columns = [day_ahead(prices[:, names.index(name)], times, hour_of_day, self.every, ahead.hours) for name in ahead.prices]
            coming[at] = np.concatenate(columns, axis=1)


@dataclass(frozen=True, eq=False)
class WeatherPool:
    """All rows of weather and calendar that runs of a task can have, season after season."""

    values: Floats
    """Disturbances ``(rows, d)``."""
    times: NDArray[np.datetime64]
    """Start of every row of the calendar, UTC."""
    calendar: Floats
    """Hour of day, day of year, the prices of ``prices``, then whether each entry of the schedule applies. Its rows are those of
    ``values``, but for generated seasons whose prices follow from the clock alone: these share one calendar."""
    prices: tuple[str, ...]
    """Names of the price tables, in the order of their columns."""
    seasons: tuple[int, ...]
    """Row at which each season begins."""
    day: int
    """Rows a day."""
    days: int
    """Days of a run's sequence: those of the episode, and those that the observation at its end and a forecast reach."""
    tables: WeatherTables
    """Observed columns."""
    _maker: SeasonMaker | None = None
    _forecast: ForecastTable | None = None
    _season_prices: SeasonPrices | None = None
    _ready: set[int] = field(default_factory=set)

    def price_column(self, name: str) -> int:
        """Column of the calendar that holds a price table."""
        return len(CLOCK) + self.prices.index(name)

    @staticmethod
    def of(task: TaskSpec) -> WeatherPool:
        """The pool of a task, shared by all its runs in this process."""
        return _shared_pool(task)

    def starts(self, numbers: Sequence[int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows of the calendar and of the weather at which generated seasons start ``(n,)``; makes those that are missing."""
        maker = self._maker
        assert maker is not None
        rows = self.day * self.days
        for number in sorted(set(numbers) - self._ready):
            season, slot = maker.season(number, rows), slice(number * rows, (number + 1) * rows)
            measured = _measured(season.values)
            self.values[slot], self.tables.measured[slot] = season.values[:rows], measured[:rows]
            self.tables.published[slot] = season.values[:rows, _PUBLISHED]
            if len(self.tables.window):
                self.tables.window[slot] = _window(season.values[:rows])
            if self._forecast is not None:
                self._forecast.fill(self.tables.forecast, number * rows, rows, measured, season.times, number)
            if self._season_prices is not None:
                times, hours = self.times[slot], self.calendar[slot, 0]
                prices = self._season_prices.rows(number, times, hours, self.tables.measured[slot])
                self.calendar[slot, len(CLOCK) : len(CLOCK) + len(self.prices)] = prices
                self._season_prices.show((self.tables.prices, self.tables.day_ahead), slot, prices, times, hours)
            self._ready.add(number)
        slots = np.array(numbers, np.int64) * rows
        return slots if self._season_prices is not None else maker.start_days(np.array(numbers, np.int64)) * self.day, slots


_ALIVE: WeakValueDictionary[TaskSpec, WeatherPool] = WeakValueDictionary()
"""Pools in use: a generated season must be visible to all programs and runs of the task."""
_LOCK = Lock()


@lru_cache(maxsize=8)
def _shared_pool(task: TaskSpec) -> WeatherPool:
    with _LOCK:
        pool = _ALIVE.get(task)
        if pool is None:
            pool = _ALIVE[task] = _make_pool(task)
    return pool


def _make_pool(task: TaskSpec) -> WeatherPool:
    day, scenario = task.steps_per_day, task.scenario
    forecast = ForecastTable.of(task)
    length = task.steps + 1 + task.observation.forecast_steps
    days = -(-length // day)
    extra = task.observation.forecast_steps
    if forecast is not None:  # whole days, so that every season begins with a full hour
        extra = days * day - task.steps - 1 + forecast.reach
    seasons = [task.season(season, extra) for season in scenario.seasons]
    generated, priced = scenario.generated, SeasonPrices.of(task)
    clock = [np.concatenate([getattr(season, name) for season in seasons]) for name in CLOCK]
    times = np.concatenate([season.times for season in seasons])
    turns = _frozen(np.array([(*_turn(h / HOURS_A_DAY), *_turn(d / DAYS_A_YEAR)) for h, d in zip(*clock, strict=True)]))
    tables = tuple(task.price_tables)
    of_seasons = priced if generated is not None and priced.by_season else None
    if generated is not None:
        rows = generated.seasons * days * day
        values = np.zeros((rows, len(COLUMNS)))  # takes no memory until it is written
        measured, published = (np.zeros((rows, 5), np.float32) for _ in range(2))
        maker = SeasonMaker(task, times[0])
        if of_seasons is not None:  # a calendar for each season, whose prices come with its weather
            starts = maker.start_days(np.arange(generated.seasons)) * day
            of_pool = (starts[:, None] + np.arange(days * day)).ravel()
            times, turns, clock = times[of_pool], _frozen(turns[of_pool]), [column[of_pool] for column in clock]
            calendar, price_tables = _calendar(task, times, clock, np.zeros((rows, len(tables)))), priced.room(rows)
        else:
            calendar, price_tables = _priced(priced, times, clock, [(0, len(times))], np.zeros((len(times), 5)))
        window = np.zeros((rows if WEATHER_WINDOW in task.observation.modules else 0, 4), np.float32)
        weather_tables = WeatherTables(measured, published, turns, _room(forecast, rows), *price_tables, window)
        return WeatherPool(values, times, calendar, tables, (0,), day, days, weather_tables, maker, forecast, of_seasons)
    values = seasons[0].values if len(seasons) == 1 else np.concatenate([season.values for season in seasons])
    firsts = tuple(int(row) for row in np.cumsum([0, *(len(season.values) for season in seasons[:-1])]))
    measured_rows = _measured(values)
    spans = [(first, first + len(season.values)) for first, season in zip(firsts, seasons, strict=True)]
    calendar, price_tables = _priced(priced, times, clock, spans, measured_rows)
    window = _window(values if WEATHER_WINDOW in task.observation.modules else values[:0])
    weather_tables = WeatherTables(
        _frozen(measured_rows), _frozen(values[:, _PUBLISHED]), turns, _room(forecast, len(values)), *price_tables, window
    )
    if forecast is not None:
        for number, ((first, end), season) in enumerate(zip(spans, seasons, strict=True)):
            rows = end - first - forecast.reach
            forecast.fill(weather_tables.forecast, first, rows, measured_rows[first:end], season.times, number)
    for array in (values, weather_tables.forecast):
        array.flags.writeable = False
    return WeatherPool(values, times, calendar, tables, firsts, day, days, weather_tables)


def _calendar(task: TaskSpec, times: NDArray[np.datetime64], clock: list[Floats], prices: Floats) -> Floats:
    return np.concatenate([np.stack(clock, axis=1), prices, schedule_rows(task.schedule, local_times(times, clock[0]))], axis=1)


def _priced(
    priced: SeasonPrices, times: NDArray[np.datetime64], clock: list[Floats], spans: list[tuple[int, int]], measured: Floats
) -> tuple[Floats, tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Calendar and tables of prices of seasons that take up the rows ``spans``, with the weather as measured of all rows."""
    prices, tables = np.zeros((len(times), len(priced.task.price_tables))), priced.room(len(times))
    for number, (first, end) in enumerate(spans):
        at = slice(first, end)
        prices[at] = priced.rows(number, times[at], clock[0][at], measured[at])
        priced.show(tables, at, prices[at], times[at], clock[0][at])
    calendar = _calendar(priced.task, times, clock, prices)
    for array in (calendar, times, *tables):
        array.flags.writeable = False
    return calendar, tables


def _room(forecast: ForecastTable | None, rows: int) -> NDArray[np.float32]:
    return np.zeros((0, 0), np.float32) if forecast is None else np.zeros((rows // forecast.every, forecast.columns), np.float32)


def _measured(values: Floats) -> Floats:
    """Measured columns of some rows of weather ``(rows, 5)``."""
    air = read_air(values[:, _TEMPERATURE], values[:, _CO2], values[:, _PRESSURE])
    return np.stack([values[:, _RADIATION], air[0], air[2], air[1], values[:, _WIND]], axis=1)


def _window(values: Floats) -> NDArray[np.float32]:
    """Columns of the window of some rows of weather ``(rows, 4)``."""
    temperature = values[:, _TEMPERATURE]
    vapour = vapour_density(temperature, values[:, _PRESSURE])
    return _frozen(np.stack([values[:, _RADIATION], values[:, _CO2] * 1e-6, temperature, vapour], axis=1))


def _turn(share: float) -> tuple[float, float]:
    """Sine and cosine of a share of a full turn, by the C library like everything else that is observed."""
    angle = 2.0 * math.pi * share
    return math.sin(angle), math.cos(angle)


def _frozen(values: Floats) -> NDArray[np.float32]:
    table = np.ascontiguousarray(values, dtype=np.float32)
    table.flags.writeable = False
    return table
