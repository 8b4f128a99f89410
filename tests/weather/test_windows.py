"""Asking for disturbances: periods, arguments, digests, and what both preprocessings promise."""

from __future__ import annotations

import datetime as dt
from dataclasses import replace
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from glbench.errors import UnknownNameError, WeatherError
from glbench.weather import COLUMNS, PREPROCESSINGS, WeatherRecord, disturbances, load_weather

BOTH = pytest.mark.parametrize("preprocessing", PREPROCESSINGS)


@pytest.fixture(scope="module")
def schiphol() -> WeatherRecord:
    return load_weather("schiphol")


def test_columns_are_the_models_disturbances() -> None:
    from glbench.model import DISTURBANCE_NAMES

    assert tuple(DISTURBANCE_NAMES) == COLUMNS


@BOTH
def test_arrays_are_read_only_and_have_the_promised_shapes(schiphol: WeatherRecord, preprocessing: str) -> None:
    made = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=100, preprocessing=preprocessing)
    assert made.preprocessing == preprocessing
    assert made.values.shape == (100, 10)
    assert made.values.dtype == np.float64
    assert made.times.dtype == np.dtype("datetime64[s]")
    for array in (made.values, made.times, made.hour_of_day, made.day_of_year):
        assert array.shape[0] == 100
        assert not array.flags.writeable


@BOTH
def test_all_values_of_a_leap_year_are_finite_and_possible(schiphol: WeatherRecord, preprocessing: str) -> None:
    start = dt.datetime(2012, 1, 1, tzinfo=dt.UTC)
    steps = 365 * 48
    values = disturbances(schiphol, start=start, steps=steps, step_seconds=1800, preprocessing=preprocessing).values
    limits = [(0, 1100), (-20, 36), (100, 3000), (650, 860), (0, 20), (-65, 36), (5, 15), (0, 33), (0, 1), (0, 1)]
    for name, column, (low, high) in zip(COLUMNS, values.T, limits, strict=True):
        assert low <= column.min() <= column.max() <= high, name


@pytest.mark.parametrize(
    ("start", "steps", "missing"),
    [
        (dt.date(2012, 12, 25), 5760, "53.00 days after its end are missing"),
        (dt.date(2007, 12, 31), 96, "1.00 days before its beginning are missing"),
        (dt.date(2007, 1, 1), 96 * 3000, "before its beginning are missing and .* days after its end are missing"),
        (dt.datetime(2012, 12, 31, 23, 50), 1, "0.00 days after its end are missing"),
    ],
)
def test_outside_the_period_the_error_names_the_period_and_what_is_missing(
    schiphol: WeatherRecord, start: dt.date, steps: int, missing: str
) -> None:
    with pytest.raises(WeatherError, match=f"covers 2008-01-01 00:00 to 2013-01-01 00:00 UTC, .*{missing}"):
        disturbances(schiphol, start=start, steps=steps)


def test_the_whole_record_can_be_asked_for(schiphol: WeatherRecord) -> None:
    made = disturbances(schiphol, start=schiphol.first, steps=schiphol.hours, step_seconds=3600)
    np.testing.assert_array_equal(made.values[:, 1], schiphol.values("air_temperature"))


@pytest.mark.parametrize("step", [0, -900, 0.5, 900.5, 86401, float("nan")])
def test_impossible_steps_are_refused(schiphol: WeatherRecord, step: float) -> None:
    with pytest.raises(WeatherError, match="whole number of seconds from 1 to 86400"):
        disturbances(schiphol, start=dt.date(2010, 3, 1), steps=4, step_seconds=step)


@pytest.mark.parametrize("steps", [0, -1])
def test_no_steps_are_refused(schiphol: WeatherRecord, steps: int) -> None:
    with pytest.raises(WeatherError, match="at least 1"):
        disturbances(schiphol, start=dt.date(2010, 3, 1), steps=steps)


@pytest.mark.parametrize("ppm", [-1.0, float("nan"), 1e6])
def test_impossible_co2_is_refused(schiphol: WeatherRecord, ppm: float) -> None:
    with pytest.raises(WeatherError, match="between 0 and 5000 ppm"):
        disturbances(schiphol, start=dt.date(2010, 3, 1), steps=4, co2_ppm=ppm)


def test_unknown_preprocessing_points_to_the_nearest(schiphol: WeatherRecord) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'conserving'"):
        disturbances(schiphol, start=dt.date(2010, 3, 1), steps=4, preprocessing="conserve")


@BOTH
def test_a_start_with_a_time_zone_means_that_moment(schiphol: WeatherRecord, preprocessing: str) -> None:
    local = dt.datetime(2010, 7, 1, 12, tzinfo=ZoneInfo("Europe/Amsterdam"))
    utc = dt.datetime(2010, 7, 1, 10, tzinfo=dt.UTC)
    a, b = (disturbances(schiphol, start=start, steps=8, preprocessing=preprocessing) for start in (local, utc))
    np.testing.assert_array_equal(a.values, b.values)
    assert a.digest == b.digest
    assert a.times[0] == np.datetime64("2010-07-01T10:00:00")


@pytest.mark.parametrize(
    ("start", "words"), [(dt.datetime(2010, 3, 28, 2, 30), "skips"), (dt.datetime(2010, 10, 31, 2, 30), "strikes twice")]
)
def test_hours_that_the_clock_skips_or_repeats_are_refused(schiphol: WeatherRecord, start: dt.datetime, words: str) -> None:
    with pytest.raises(WeatherError, match=f"{words} {start}"):
        disturbances(schiphol, start=start, steps=4, preprocessing="conserving")
    assert disturbances(schiphol, start=start, steps=4).hour_of_day[0] == 2.5


def test_a_start_between_seconds_is_refused(schiphol: WeatherRecord) -> None:
    with pytest.raises(WeatherError, match="whole second"):
        disturbances(schiphol, start=dt.datetime(2010, 3, 1, 0, 0, 0, 5), steps=4)


def test_an_unknown_time_zone_is_refused(schiphol: WeatherRecord) -> None:
    nowhere = replace(schiphol, place=replace(schiphol.place, timezone="Europe/Nowhere"))
    with pytest.raises(WeatherError, match="'Europe/Nowhere' is no time zone"):
        disturbances(nowhere, start=dt.date(2010, 3, 1), steps=4, preprocessing="conserving")


# Task digests contain these: a change here changes every published task, and must be a new version of the preprocessing.
LOCKED_DIGESTS = {
    "paper": "049969d15abd63be1682d2359bf2bfe2af14d80b7ab895e487f48df419bc6ee5",
    "conserving": "3a7b89bcf70f4f230a5e4f4b98435865f1c4e099960bef4ec1454e13fefe2d25",
}


@BOTH
def test_the_digest_of_the_spring_is_locked(schiphol: WeatherRecord, preprocessing: str) -> None:
    made = disturbances(schiphol, start=dt.date(2010, 3, 1), steps=5761, preprocessing=preprocessing)
    assert made.digest == LOCKED_DIGESTS[preprocessing]


@BOTH
def test_the_digest_sees_every_argument_and_the_data(schiphol: WeatherRecord, preprocessing: str) -> None:
    def digest(record: WeatherRecord = schiphol, start: dt.date = dt.date(2010, 3, 1), steps: int = 96, **rest: float) -> str:
        return disturbances(record, start=start, steps=steps, preprocessing=preprocessing, **rest).digest

    warmer = schiphol.counts["air_temperature"].copy()
    warmer[(dt.date(2010, 3, 1) - dt.date(2008, 1, 1)).days * 24 + 12] += 100
    changed = replace(schiphol, counts={**schiphol.counts, "air_temperature": warmer})
    made = [
        digest(),
        digest(start=dt.date(2010, 3, 2)),
        digest(steps=97),
        digest(step_seconds=300.0),
        digest(co2_ppm=410.0),
        digest(changed),
    ]
    assert len(set(made)) == len(made)
    assert digest(replace(schiphol, name="renamed")) == made[0]


def test_the_digest_of_conserving_sees_place_and_timing_and_that_of_paper_does_not(schiphol: WeatherRecord) -> None:
    moved = replace(schiphol, place=replace(schiphol.place, longitude=5.0))
    start = dt.datetime(2010, 3, 1, tzinfo=dt.UTC)
    for preprocessing, same in (("paper", True), ("conserving", False)):
        a, b = (disturbances(r, start=start, steps=8, preprocessing=preprocessing).digest for r in (schiphol, moved))
        assert (a == b) is same


def test_the_digest_ignores_hours_outside_the_window(schiphol: WeatherRecord) -> None:
    warmer = schiphol.counts["air_temperature"].copy()
    warmer[: 365 * 24] += 100
    changed = replace(schiphol, counts={**schiphol.counts, "air_temperature": warmer})
    a, b = (disturbances(r, start=dt.date(2010, 3, 1), steps=96).digest for r in (schiphol, changed))
    assert a == b


@settings(max_examples=25, deadline=None)
@given(
    hour=st.integers(0, 43000),
    minute=st.integers(0, 59),
    steps=st.integers(1, 60),
    step=st.sampled_from([60, 300, 450, 900, 1000, 3600, 7200]),
)
def test_any_window_of_conserving_keeps_the_energy_between_its_ends(hour: int, minute: int, steps: int, step: int) -> None:
    record = load_weather("schiphol")
    start = record.first + dt.timedelta(hours=hour + 1, minutes=minute)
    made = disturbances(record, start=start, steps=steps, step_seconds=step, preprocessing="conserving")
    whole = disturbances(record, start=start, steps=1, step_seconds=min(steps * step, 86400), preprocessing="conserving")
    if steps * step <= 86400:
        assert made.values[:, 0].mean() == pytest.approx(whole.values[0, 0], rel=1e-11, abs=1e-9)
        assert made.values[:, 1].mean() == pytest.approx(whole.values[0, 1], rel=1e-11, abs=1e-9)
    assert (made.values[:, 0] >= 0).all()
    assert made.values[:, 7].min() >= 0
