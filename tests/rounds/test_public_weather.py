"""What a salt cannot hide: generated seasons are days of a public record, and a few hours of them are found there and go on as there."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest

from docs.carried_weather import CarriedOutlook
from glbench.control import Climatology, Outlook
from glbench.env import Simulation, run_weather
from glbench.tasks import get_task
from glbench.weather import SeasonGenerator, load_weather

YEARS = (2011, 2012)
HOURS = 6


def windows(columns: list[np.ndarray]) -> np.ndarray:
    """Every ``HOURS`` hours in a row, ``(hours - HOURS + 1, columns * HOURS)``."""
    return np.concatenate([np.lib.stride_tricks.sliding_window_view(column, HOURS) for column in columns], axis=1)


def test_six_hours_of_temperature_humidity_and_wind_find_their_day_and_the_block_goes_on_for_four() -> None:
    """By the plainest search there is: the nearest six hours of the record at the same hour of the day."""
    record = load_weather("schiphol")
    generator = SeasonGenerator(record, YEARS)
    names = ("air_temperature", "relative_humidity", "wind_speed")
    scale = np.array([1.0, 3.0, 1.0]).repeat(HOURS)
    known = windows([record.values(name) for name in names]) / scale
    day_of = (record.begin + 3600 * np.arange(len(known))) // 86400
    hour_of = (record.begin + 3600 * np.arange(len(known))) // 3600 % 24
    found, left = [], []
    for salt in range(12):
        numbers = np.random.default_rng(salt).random(generator.numbers(60))
        season = generator.season(dt.date(2010, 3, 1), 60, numbers)
        seen = windows([season.record.values(name) for name in names]) / scale
        first = season.record.begin // 3600 % 24
        joints = np.flatnonzero(season.joints)
        for day in range(3, 60, 4):
            at = 24 * day + 9  # from 9 hours into the day on
            same_hour = np.flatnonzero(hour_of == (first + at) % 24)
            nearest = same_hour[np.argmin(((known[same_hour] - seen[at]) ** 2).sum(axis=1))]
            found.append(abs(int(day_of[nearest]) - int(season.sources[day])) <= 1)
            after = joints[joints > day]
            if len(after):
                left.append(after[0] - day - 9 / 24)
    assert np.mean(found) > 0.8
    assert 3.0 < np.mean(left) < 4.5


@pytest.mark.slow
def test_who_carries_the_record_knows_the_next_hours_better_than_the_forecast() -> None:
    """On the validation split, whose seasons are made of other years than those of the test."""
    task = get_task("Spring-v1").in_split("validation")
    assert task.season_years is not None
    seeds = [task.evaluation.first_seed, task.evaluation.first_seed + 1]
    climatology = Climatology.of(task)
    usual, carried = (Outlook(task, climatology), CarriedOutlook(task, climatology, task.season_years, task.weather.source))
    simulation, errors = Simulation(task, len(seeds), kernel="fast"), []
    weather = np.array([run_weather(task, seed).values for seed in seeds])
    seen = simulation.reset(seeds)
    for outlook in (usual, carried):
        outlook.reset(len(seeds))
        outlook.update(seen)
    for step in range(1, 5 * task.steps_per_day):
        simulation.step(np.zeros((len(seeds), 6)))
        seen = simulation.observe()
        for outlook in (usual, carried):
            outlook.update(seen)
        if step > 24 and step % 16 == 0:
            true = weather[:, step : step + 25]
            errors.append([outlook.ahead(25).d[:, 1:] - true[:, 1:] for outlook in (usual, carried)])
    names = task.model_value.disturbance_names
    by_column = np.sqrt(np.square(np.array(errors)).mean(axis=(0, 2, 3)))
    for name in ("iGlob", "tOut", "vpOut", "wind", "tSky"):
        forecast, record = by_column[:, names.index(name)]
        assert record < 0.75 * forecast, name
