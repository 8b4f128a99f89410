"""What can be known of the day from radiation and clock."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest

from glbench.agents.daylight import Daylight, DaylightEstimator
from glbench.weather import disturbances, load_weather

STEP = 900.0
HOURS = np.arange(96) / 4


def bell(peak: float, dawn: float = 6.0, dusk: float = 18.0) -> np.ndarray:
    """Radiation of a day [W m-2], a half sine from dawn to dusk."""
    return np.asarray(peak * np.clip(np.sin(np.pi * (HOURS - dawn) / (dusk - dawn)), 0.0, None) * (dawn < HOURS) * (dusk > HOURS))


def follow(days: list[np.ndarray], hours: np.ndarray = HOURS, age: float = 0.0) -> list[Daylight]:
    """Estimates of all steps of ``days``."""
    estimator = DaylightEstimator(1, STEP, age)
    return [estimator.observe(np.array([hour]), np.array([sun])) for day in days for hour, sun in zip(hours, day, strict=True)]


def test_the_first_day_counts_what_has_come_in() -> None:
    day = bell(500.0)
    sums = [float(estimate.radiation_sum[0]) for estimate in follow([day])]
    np.testing.assert_allclose(sums, np.cumsum(day) * STEP * 1e-6, rtol=1e-12)


def test_a_day_like_the_one_before_is_known_from_its_first_minute() -> None:
    day = bell(500.0)
    estimates = follow([day, day])[96:]
    total = day.sum() * STEP * 1e-6  # 500 W m-2 x 2/pi x 12 h = 13.75 MJ m-2
    assert total == pytest.approx(13.75, rel=0.01)
    assert [float(e.radiation_sum[0]) for e in estimates] == pytest.approx([total] * 96)


def test_a_dull_morning_lowers_the_estimate_of_the_day() -> None:
    estimates = follow([bell(600.0), bell(60.0)])[96:]
    bright, dull = 600 * 0.0275, 60 * 0.0275
    assert float(estimates[0].radiation_sum[0]) == pytest.approx(bright, rel=0.01)
    assert float(estimates[48].radiation_sum[0]) < 0.2 * bright
    assert float(estimates[95].radiation_sum[0]) == pytest.approx(dull, rel=0.01)


def test_a_day_that_was_not_seen_whole_teaches_nothing() -> None:
    estimator = DaylightEstimator(1, STEP)
    for hour, sun in zip(HOURS[48:], bell(500.0)[48:], strict=True):
        estimator.observe(np.array([hour]), np.array([sun]))
    assert float(estimator.observe(np.array([0.0]), np.array([0.0])).radiation_sum[0]) == 0.0


def test_the_hour_that_comes_twice_at_the_end_of_summer_time_starts_no_day() -> None:
    hours = np.concatenate([HOURS[:12], HOURS[8:]])  # 02:00 to 03:00 twice
    day = np.concatenate([np.full(12, 100.0), np.full(88, 100.0)])
    estimate = follow([day], hours)[-1]
    assert float(estimate.radiation_sum[0]) == pytest.approx(100 * 100.0 * STEP * 1e-6)


def test_dawn_and_dusk_are_those_of_the_day_before() -> None:
    estimates = follow([bell(500.0)] * 2)[96:]
    is_day = np.array([float(e.is_day[0]) for e in estimates])
    # First light is seen at 06:15, so it dawned about 06:07, and the ramp lasts from half an hour before to half an hour after.
    assert is_day[HOURS <= 5.5].max() == 0.0
    assert 0.25 < is_day[HOURS == 6.0][0] < 0.5
    assert is_day[(HOURS >= 7.0) & (HOURS <= 17.0)].min() == 1.0
    assert 0.25 < is_day[HOURS == 18.0][0] < 0.75
    assert is_day[HOURS >= 18.75].max() == 0.0


def test_the_smooth_flag_is_steeper_and_equal_at_the_ends() -> None:
    estimates = follow([bell(500.0)] * 2)[96:]
    linear = np.array([float(e.is_day[0]) for e in estimates])
    smooth = np.array([float(e.is_day_smooth[0]) for e in estimates])
    assert np.array_equal(smooth == 1.0, linear == 1.0)
    assert np.array_equal(smooth == 0.0, linear == 0.0)
    ramp = (linear > 0.0) & (linear < 0.5)
    assert ramp.any()
    assert np.all(smooth[ramp] < linear[ramp])


def test_on_the_first_day_light_is_day() -> None:
    day = bell(500.0)
    assert [float(e.is_day[0]) for e in follow([day])][:60] == (day > 0.0).astype(float).tolist()[:60]


def test_a_day_over_the_clocks_midnight_is_one_day() -> None:
    shifted = np.roll(bell(500.0), 48)  # dark from 06:00 to 18:00 on this clock
    is_day = np.array([float(e.is_day[0]) for e in follow([shifted] * 3)[192:]])
    assert is_day[(HOURS < 5.0) | (HOURS > 19.0)].min() == 1.0
    assert is_day[(HOURS > 7.0) & (HOURS < 17.0)].max() == 0.0


def test_radiation_of_the_step_before_moves_dawn_back() -> None:
    late = np.roll(bell(500.0), 1)
    aged = [float(e.is_day[0]) for e in follow([late] * 2, age=STEP)[96:]]
    assert aged == pytest.approx([float(e.is_day[0]) for e in follow([bell(500.0)] * 2)[96:]])


def test_runs_do_not_mix() -> None:
    suns = np.random.default_rng(3).uniform(0, 600, (3 * 96, 5)) * (bell(1.0) > 0).repeat(1)[np.arange(288) % 96, None]
    together, alone = DaylightEstimator(5, STEP), [DaylightEstimator(1, STEP) for _ in range(5)]
    for step, sun in enumerate(suns):
        hour = HOURS[step % 96]
        batch = together.observe(np.full(5, hour), sun)
        each = [estimator.observe(np.array([hour]), sun[i : i + 1]) for i, estimator in enumerate(alone)]
        assert batch.radiation_sum.tolist() == [float(e.radiation_sum[0]) for e in each]
        assert batch.is_day_smooth.tolist() == [float(e.is_day_smooth[0]) for e in each]


def test_in_the_spring_of_the_benchmark_it_decides_like_the_truth_in_four_of_five_lamp_hours() -> None:
    weather = disturbances(load_weather("schiphol"), start=dt.date(2010, 3, 1), steps=60 * 96, preprocessing="paper")
    sun, true_sum = weather.values[:, 0], weather.values[:, 7]
    hours = weather.hour_of_day
    estimator = DaylightEstimator(1, STEP)
    guess = np.array([float(estimator.observe(hours[k : k + 1], sun[k : k + 1]).radiation_sum[0]) for k in range(len(sun))])
    lamps = (hours > 0.0) & (hours < 18.0)
    agreement = float(np.mean((guess < 10.0)[lamps] == (true_sum < 10.0)[lamps]))
    yesterday = np.concatenate([np.zeros(96), true_sum[:-96]])
    persistence = float(np.mean((yesterday < 10.0)[lamps] == (true_sum < 10.0)[lamps]))
    assert agreement > 0.82
    assert agreement > persistence + 0.1
