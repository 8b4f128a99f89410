"""The scenario of each run: its weather, its start and its parameters, all functions of the task and the run's seed.

What a run draws once (season, first day, start, parameters of the episode, what its sensors are off by) is drawn here with NumPy when
it starts; what is drawn in the step belongs to the program (``glbench.env.program``).
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env import actuation, actuators, air, samples
from glbench.env.camera import Camera
from glbench.env.daily_sums import DAILY_SUMS, initial_memory
from glbench.env.generated import SeasonMaker
from glbench.env.memory_layout import DrawingPart, DrawPlaces, allocate
from glbench.env.outdoor import OutdoorSensors
from glbench.env.random import uniforms
from glbench.env.uncertainty import DISTRIBUTIONS, DerivedParameters, spread_multipliers, stream_key
from glbench.env.weather_pool import CLOCK, WeatherPool
from glbench.tasks import TaskSpec
from glbench.tasks.resolver import ParameterGroup, Scenario


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

    ``nominal`` are the nominal parameters ``(p,)``; ``in_step`` and ``in_episode`` the groups of them that the step draws, and those that
    are drawn here. ``sensors`` and ``outdoor_sensors`` err; ``actuators`` are not ideal, and their draws begin at ``actuator_draws``;
    ``samples`` are counted or weighed by hand, ``camera`` takes pictures. ``drawing_parts`` draw numbers of their own, in the order in
    which tapes read them (``DrawPlaces``). ``pool`` has weather and calendar, ``memory_layout`` what the runs keep in memory.
    """

    def __init__(self, task: TaskSpec) -> None:
        self.task, self.scenario = task, task.scenario
        self.pool = WeatherPool.of(task)
        self.nominal = task.parameters()
        uncertain = [group for group in self.scenario.groups if group.half_width > 0.0]
        self.in_step = tuple(group for group in uncertain if group.redraw != "episode")
        self.in_episode = tuple(group for group in uncertain if group.redraw == "episode")
        self._model = task.model_value
        self._derived = DerivedParameters(self._model, self.nominal, self.places(self.in_episode))
        self.sensors = air.Sensors.of(task)
        self.outdoor_sensors = OutdoorSensors.of(task, DrawPlaces().after(self.sensors))
        self.actuators = actuators.Actuators.of(task)
        self.actuator_draws = DrawPlaces().after(self.sensors).after(self.outdoor_sensors)
        self.samples = samples.Samples.of(task, self.actuator_draws.after(self.actuators))
        self.camera = Camera.of(task, self.samples.places.after(self.samples))
        parts: list[DrawingPart | None] = [self.sensors, self.outdoor_sensors, self.actuators, self.samples, self.camera]
        self.drawing_parts = tuple(part for part in parts if part is not None)
        self.memory_layout = allocate(
            **{
                actuation.PART: actuation.actuation_memory(task),
                air.PART: self.sensors.initial_memory(),
                DAILY_SUMS: initial_memory(task),
                actuators.PART: self.actuators.initial_memory(),
                samples.PART: self.samples.initial_memory(),
                Camera.PART: {} if self.camera is None else self.camera.initial_memory(),
            }
        )
        self._starts: dict[int, Floats] = {}  # by row of the pool: the state before factors

    def places(self, groups: Sequence[ParameterGroup]) -> tuple[int, ...]:
        """Places of the parameters of some groups, in their order."""
        names = self._model.parameter_names
        return tuple(names.index(name) for group in groups for name in group.parameters)

    def draw(self, seeds: Sequence[int]) -> Scenes:
        """What runs with ``seeds`` start with."""
        n, scenario, pool = len(seeds), self.scenario, self.pool
        if scenario.generated is not None:
            generated = scenario.generated
            first, weather = pool.starts([(seed - generated.first_seed) % generated.seasons for seed in seeds])
        else:
            first = np.zeros(n, np.int64)
            if len(pool.seasons) > 1:
                first += np.array(pool.seasons, np.int64)[_season_numbers(scenario, seeds)]
            if scenario.start_within_days:
                first += _days_late(scenario, seeds) * pool.day
            weather = first
        names = [parameter_stream(group) for group in self.in_step]
        names += [part.STREAM for part in self.drawing_parts if part.numbers]
        keys = np.array([[stream_key(scenario, seed, name) for name in names] for seed in seeds], np.uint64)
        return Scenes(
            self.start_states(seeds, weather),
            weather[:, None] + np.arange(pool.days, dtype=np.int64) * pool.day,
            first,
            keys.reshape(n, len(names), 2),
            self._episode_parameters(seeds),
            np.concatenate(
                [part.traits(_episode_numbers(scenario, seeds, part.TRAIT_STREAM, part.trait_numbers)) for part in self.drawing_parts],
                axis=1,
            ),
            self.memory_layout.rows(n),
        )

    def start_states(self, seeds: Sequence[int], first: NDArray[np.int64]) -> Floats:
        """States in which runs with ``seeds`` start, each at its row ``first`` of the pool of weather, ``(n, s)``."""
        for row in first.tolist():
            if row not in self._starts:
                self._starts[row] = self.task.start_state(self.pool.values[row])
        states = np.stack([self._starts[row] for row in first.tolist()])
        for group in self.scenario.start_groups:
            deviation = DISTRIBUTIONS[group.distribution]
            numbers = _episode_numbers(self.scenario, seeds, f"start {group.name}", len(group.states))
            columns = [self._model.state_index(name) for name in group.states]
            states[:, columns] *= 1.0 + deviation(numbers, group.half_width)
        return states

    def _episode_parameters(self, seeds: Sequence[int]) -> Floats | None:
        """Parameters at the start, ``None`` where all runs have the nominal ones."""
        if not self.in_episode:
            return None
        parameters = np.tile(self.nominal, (len(seeds), 1))
        for group in self.in_episode:
            places, stream = list(self.places((group,))), parameter_stream(group)
            if group.spread is not None:
                parameters[:, places] *= spread_multipliers(group.spread, _episode_keys(self.scenario, seeds, stream))
                continue
            numbers = _episode_numbers(self.scenario, seeds, stream, len(places))
            parameters[:, places] = self.nominal[places] * (1.0 + DISTRIBUTIONS[group.distribution](numbers, group.half_width))
        self._derived.complete(parameters)
        return parameters


def _episode_numbers(scenario: Scenario, seeds: Sequence[int], stream: str, count: int) -> Floats:
    """The numbers of a stream that is drawn once an episode, ``(n, count)``."""
    if count == 0:
        return np.zeros((len(seeds), 0))
    return uniforms(_episode_keys(scenario, seeds, stream), np.zeros((len(seeds), 1), np.int64), count)[:, 0]


def _episode_keys(scenario: Scenario, seeds: Sequence[int], stream: str) -> NDArray[np.uint64]:
    """Keys of a stream ``(n, 2)``."""
    return np.array([stream_key(scenario, seed, stream) for seed in seeds], np.uint64).reshape(-1, 2)


def _season_numbers(scenario: Scenario, seeds: Sequence[int]) -> NDArray[np.int64]:
    """Which of the scenario's seasons each run is in."""
    return (_episode_numbers(scenario, seeds, "season", 1)[:, 0] * len(scenario.seasons)).astype(np.int64)


def _days_late(scenario: Scenario, seeds: Sequence[int]) -> NDArray[np.int64]:
    """Days from the first possible day to the first day of each run."""
    return (_episode_numbers(scenario, seeds, "start day", 1)[:, 0] * (scenario.start_within_days + 1)).astype(np.int64)


@lru_cache(maxsize=1024)
def first_day(task: TaskSpec, seed: int) -> dt.date:
    """First day of the run with ``seed``, on the clock of the greenhouse; its weather is not made.

    Raises ``TaskError`` when the weather record does not have the years of the task.
    """
    scenario, generated = task.scenario, task.scenario.generated
    if generated is None:
        season, late = int(_season_numbers(scenario, [seed])[0]), int(_days_late(scenario, [seed])[0])
        return scenario.seasons[season].start + dt.timedelta(days=late)
    maker = SeasonMaker(task, np.datetime64(task.weather.start))
    (late,) = maker.start_days(np.array([(seed - generated.first_seed) % generated.seasons]))
    return task.weather.start + dt.timedelta(days=int(late))


def season_names(task: TaskSpec, seeds: Sequence[int]) -> tuple[str | None, ...]:
    """Which real season each run is in, such as "2011"; ``None`` where all are in one, or each is in a generated one."""
    scenario = task.scenario
    if len(scenario.seasons) == 1 or scenario.generated is not None:
        return (None,) * len(seeds)
    several = len({season.source for season in scenario.seasons}) > 1
    years = [f"{season.source} {season.start.year}" if several else f"{season.start.year}" for season in scenario.seasons]
    return tuple(years[number] for number in _season_numbers(scenario, seeds))


@lru_cache(maxsize=64)
def run_years(task: TaskSpec, seeds: tuple[int, ...]) -> tuple[int, ...]:
    """Weather year of each run: for a generated season, the year with the most days (the earlier of two). Empty if all runs share one year.

    Raises ``TaskError`` when the weather record does not have the years of the task.
    """
    generated, seasons = task.scenario.generated, task.scenario.seasons
    if generated is None:
        years = [season.start.year for season in seasons]
        return tuple(years[number] for number in _season_numbers(task.scenario, seeds)) if len(set(years)) > 1 else ()
    if len(generated.years) == 1:
        return ()
    maker = SeasonMaker(task, np.datetime64(task.weather.start))
    return tuple(maker.year((seed - generated.first_seed) % generated.seasons) for seed in seeds)


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
