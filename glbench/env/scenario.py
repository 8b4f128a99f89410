"""The scenario of each run: its weather, its start and its parameters, all functions of the task and the run's seed.

The weather of a task's seasons is one pool of rows, and so are calendar and prices. What a run draws once (season, first day,
start, parameters of the episode) is drawn here with NumPy when it starts; what is drawn in the step belongs to the program
(``glbench.env.program``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.climate import read_air
from glbench.env.philox import uniforms
from glbench.env.uncertainty import DISTRIBUTIONS, DerivedParameters, stream_key
from glbench.weather import COLUMNS

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.tasks.scenario import ParameterGroup

Floats = NDArray[np.float64]

CLOCK = ("hour_of_day", "day_of_year")
"""Columns of a calendar before those of its price tables."""

HOURS_A_DAY = 24.0
DAYS_A_YEAR = 365.0

_RADIATION, _TEMPERATURE, _PRESSURE, _CO2, _WIND = (
    COLUMNS.index(name) for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")
)


@dataclass(frozen=True, eq=False)
class WeatherPool:
    """All rows of weather and calendar that runs of a task can have, season after season; arrays are read-only.

    Attributes
    ----------
    values
        Disturbances ``(rows, d)``.
    times
        Start of every row, UTC ``(rows,)``.
    calendar
        Hour of day, day of year, then the prices of ``prices`` ``(rows, c)``.
    prices
        Names of the price tables, in the order of their columns.
    seasons
        Row at which each season begins.
    day
        Rows a day.
    days
        Days of a run's sequence: those of the episode, and those that the observation at its end and a forecast reach.
    """

    values: Floats
    times: NDArray[np.datetime64]
    calendar: Floats
    prices: tuple[str, ...]
    seasons: tuple[int, ...]
    day: int
    days: int

    def price_column(self, name: str) -> int:
        """Column of the calendar that holds a price table."""
        return len(CLOCK) + self.prices.index(name)

    @staticmethod
    def of(task: TaskSpec) -> WeatherPool:
        """The pool of a task, shared by all its runs in this process."""
        return _pool(task)


@lru_cache(maxsize=16)
def _pool(task: TaskSpec) -> WeatherPool:
    day, forecast = task.steps_per_day, task.observation.forecast_steps
    length = task.steps + 1 + forecast
    seasons = [task.season(season, forecast) for season in task.scenario.seasons]
    tables = task.price_tables
    prices = [
        np.concatenate([table.values(season.times, season.hour_of_day) for season in seasons])
        for table in tables.values()
    ]
    lengths = [len(season.values) for season in seasons]
    clock = [np.concatenate([getattr(season, name) for season in seasons]) for name in CLOCK]
    values = seasons[0].values if len(seasons) == 1 else np.concatenate([season.values for season in seasons])
    arrays = values, np.concatenate([season.times for season in seasons]), np.stack([*clock, *prices], axis=1)
    for array in arrays:
        array.flags.writeable = False
    firsts = tuple(int(row) for row in np.cumsum([0, *lengths[:-1]]))
    return WeatherPool(*arrays, tuple(tables), firsts, day, -(-length // day))


@dataclass(frozen=True, eq=False)
class WeatherTables:
    """Weather and clock by row of the pool (``WeatherPool``), read-only float32 as observed.

    ``measured``: global radiation [W m-2], temperature [degC], relative humidity [%], CO2 [ppm], wind [m s-1].
    ``published``: the same with vapour pressure [Pa] and CO2 density [mg m-3].
    ``clock``: sine and cosine of the hour of day, then of the day of year.
    """

    measured: NDArray[np.float32]
    published: NDArray[np.float32]
    clock: NDArray[np.float32]

    @staticmethod
    def of(task: TaskSpec) -> WeatherTables:
        """Tables of a task, shared by all its environments in this process."""
        return _tables(task)


@lru_cache(maxsize=16)
def _tables(task: TaskSpec) -> WeatherTables:
    pool = WeatherPool.of(task)
    rows = pool.values
    air = read_air(rows[:, _TEMPERATURE], rows[:, _CO2], rows[:, _PRESSURE])
    measured = np.stack([rows[:, _RADIATION], air[0], air[2], air[1], rows[:, _WIND]], axis=1)
    published = rows[:, [_RADIATION, _TEMPERATURE, _PRESSURE, _CO2, _WIND]]
    clock = [
        (*_turn(hour / HOURS_A_DAY), *_turn(day / DAYS_A_YEAR)) for hour, day in pool.calendar[:, : len(CLOCK)].tolist()
    ]
    return WeatherTables(_frozen(measured), _frozen(published), _frozen(np.array(clock)))


def _turn(share: float) -> tuple[float, float]:
    """Sine and cosine of a share of a full turn, by the C library like everything else that is observed."""
    angle = 2.0 * math.pi * share
    return math.sin(angle), math.cos(angle)


def _frozen(values: NDArray[np.float64]) -> NDArray[np.float32]:
    table = np.ascontiguousarray(values, dtype=np.float32)
    table.flags.writeable = False
    return table


@dataclass(frozen=True, eq=False)
class Scenes:
    """What some runs start with, one row each: the arrays of ``glbench.kernel.environment.Environments`` but ``x``."""

    states: Floats
    days: NDArray[np.int64]
    first: NDArray[np.int64]
    keys: NDArray[np.uint64]
    parameters: Floats | None
    traits: Floats
    memory: Floats


class RunScenarios:
    """Draws the scenarios of a task's runs from their seeds.

    Attributes
    ----------
    pool
        Weather and calendar.
    nominal
        Nominal parameters ``(p,)``.
    in_step, in_episode
        The groups of parameters that the step draws, and those that are drawn here.
    """

    def __init__(self, task: TaskSpec) -> None:
        self.task, self.scenario = task, task.scenario
        self.pool = WeatherPool.of(task)
        self.nominal = task.parameters()
        drawn = [group for group in self.scenario.groups if group.half_width > 0.0]
        self.in_step = tuple(group for group in drawn if group.redraw != "episode")
        self.in_episode = tuple(group for group in drawn if group.redraw == "episode")
        self._model = task.model_value
        self._derived = DerivedParameters(self._model, self.nominal, self.places(self.in_episode))
        self._starts: dict[int, Floats] = {}

    def places(self, groups: Sequence[ParameterGroup]) -> tuple[int, ...]:
        """Places of the parameters of some groups, in their order."""
        names = self._model.parameter_names
        return tuple(names.index(name) for group in groups for name in group.parameters)

    def draw(self, seeds: Sequence[int]) -> Scenes:
        """What runs with ``seeds`` start with."""
        first = self._first(seeds)
        steps = np.arange(self.pool.days, dtype=np.int64) * self.pool.day
        names = [parameter_stream(group) for group in self.in_step]
        n = len(seeds)
        return Scenes(
            self._states(seeds, first),
            first[:, None] + steps,
            first,
            np.array([[stream_key(self.scenario, seed, name) for name in names] for seed in seeds], np.uint64).reshape(
                n, len(names), 2
            ),
            self._parameters(seeds),
            np.zeros((n, 0)),
            np.zeros((n, 0)),
        )

    def _numbers(self, seeds: Sequence[int], stream: str, count: int) -> Floats:
        """The numbers of a stream that is drawn once an episode, ``(n, count)``."""
        keys = np.array([stream_key(self.scenario, seed, stream) for seed in seeds], np.uint64).reshape(-1, 2)
        return uniforms(keys, np.zeros((len(seeds), 1), np.int64), count)[:, 0]

    def _first(self, seeds: Sequence[int]) -> NDArray[np.int64]:
        """Rows of the pool at which the runs start."""
        first = np.zeros(len(seeds), np.int64)
        seasons, late = np.array(self.pool.seasons, np.int64), self.scenario.start_within_days
        if len(seasons) > 1:
            first += seasons[(self._numbers(seeds, "season", 1)[:, 0] * len(seasons)).astype(np.int64)]
        if late:
            first += (self._numbers(seeds, "start day", 1)[:, 0] * (late + 1)).astype(np.int64) * self.pool.day
        return first

    def _states(self, seeds: Sequence[int], first: NDArray[np.int64]) -> Floats:
        states = np.stack([self._start(row) for row in first.tolist()])
        for group in self.scenario.start_groups:
            deviation = DISTRIBUTIONS[group.distribution]
            numbers = self._numbers(seeds, f"start {group.name}", len(group.states))
            columns = [self._model.state_index(name) for name in group.states]
            states[:, columns] *= 1.0 + deviation(numbers, group.half_width)
        return states

    def _start(self, row: int) -> Floats:
        """State of an episode that starts with a row of the pool, before factors."""
        if row not in self._starts:
            self._starts[row] = self.task.start_state(self.pool.values[row])
        return self._starts[row]

    def _parameters(self, seeds: Sequence[int]) -> Floats | None:
        """Parameters at the start, ``None`` where all runs have the nominal ones."""
        if not self.in_episode:
            return None
        drawn = np.tile(self.nominal, (len(seeds), 1))
        for group in self.in_episode:
            places = list(self.places((group,)))
            numbers = self._numbers(seeds, parameter_stream(group), len(places))
            drawn[:, places] = self.nominal[places] * (
                1.0 + DISTRIBUTIONS[group.distribution](numbers, group.half_width)
            )
        self._derived.complete(drawn)
        return drawn


@dataclass(frozen=True, eq=False)
class RunWeather:
    """What acts on one run, row k on step k: disturbances ``(rows, d)``, and start [UTC], hour of day and day of year of each row."""

    values: Floats
    times: NDArray[np.datetime64]
    hour_of_day: Floats
    day_of_year: Floats


def run_weather(task: TaskSpec, seed: int) -> RunWeather:
    """The weather of the run with ``seed``: ``steps + 1`` rows, and those that a forecast reaches."""
    scenarios = RunScenarios(task)
    pool, scenes = scenarios.pool, scenarios.draw([seed])
    steps = np.arange(task.steps + 1 + task.observation.forecast_steps)
    dates = scenes.first[0] + steps
    hour_of_day, day_of_year = pool.calendar[dates, : len(CLOCK)].T
    weather = pool.values[scenes.days[0, steps // pool.day] + steps % pool.day]
    return RunWeather(weather, pool.times[dates], hour_of_day, day_of_year)


def parameter_stream(group: ParameterGroup) -> str:
    """Name of the stream from which a group of parameters is drawn."""
    return f"parameters {group.name}"
