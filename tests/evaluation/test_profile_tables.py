"""The few numbers of a profile, against numbers that a person can check."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.evaluation.profiles import record

NAN = math.nan


def lengths(*values: int) -> np.ndarray:
    return np.array(values)


@pytest.mark.parametrize(("step_seconds", "steps"), [(60.0, 15), (300.0, 3), (400.0, 3), (900.0, 1), (3600.0, 1), (864.0, 2)])
def test_a_slot_divides_the_day_and_lasts_a_quarter_of_an_hour_or_longer(step_seconds, steps):
    assert record.steps_a_slot(step_seconds) == steps


def test_quantiles_are_values_that_occurred():
    # Four days of two steps, five runs: step 0 of each day holds 1 to 20, step 1 the same times 100.
    first = np.arange(1.0, 21.0).reshape(4, 5)
    values = np.stack([first, 100 * first], axis=1).reshape(8, 5).astype(np.float32)
    day = record.typical_day(values, lengths(8, 8, 8, 8, 8), a_day=2, a_slot=1)
    assert day.T.tolist() == [[1, 5, 10, 15, 19], [100, 500, 1000, 1500, 1900]]


def test_what_a_failed_run_did_not_live_to_see_is_left_out_and_not_guessed():
    values = np.array([[1.0, 9.0], [2.0, 0.0], [3.0, 0.0], [4.0, 0.0]], dtype=np.float32)
    day = record.typical_day(values, lengths(4, 1), a_day=2, a_slot=1)
    assert day[:, 0].tolist() == [1, 1, 3, 9, 9]
    assert day[:, 1].tolist() == [2, 2, 2, 4, 4]
    sums = record.by_day(values, lengths(4, 1), a_day=2, add=True)
    assert sums.tolist() == [[3, math.inf], [7, math.inf]]
    assert record.middle_run(sums).tolist() == [3, 7]


def test_where_no_run_is_left_nothing_is_known():
    values = np.zeros((4, 1), dtype=np.float32)
    packed = record.pack(record.typical_day(values, lengths(3), a_day=4, a_slot=1), 2)
    assert packed["values"] == [[0, 0, 0, None]] * 5


def test_the_middle_run_of_an_even_number_is_the_lower_one():
    assert record.middle_run(np.array([[4.0, 1.0, 3.0, 2.0]])).tolist() == [2.0]


def test_hours_gather_their_steps():
    values = np.arange(8, dtype=np.float32)  # steps of half an hour
    assert record.by_hour(values, 8, 1800.0, add=True).tolist() == [1, 5, 9, 13]
    assert record.by_hour(values, 7, 1800.0, add=False).tolist() == [0.5, 2.5, 4.5, math.inf]


def test_hours_of_the_day_add_up_over_the_days():
    values = np.ones((2 * 48, 3), dtype=np.float32)
    hours = record.by_hour_of_day(values, 48, 1800.0)
    assert hours.shape == (24, 3)
    assert (hours == 4.0).all()


def test_the_calendar_counts_minutes_of_the_runs_that_were_there():
    outside = np.zeros((48, 2), dtype=np.bool_)
    outside[0] = [True, False]
    outside[1] = [True, True]
    outside[2] = [True, True]
    minutes = record.calendar(outside, lengths(48, 2), a_day=48, step_seconds=1800.0)
    assert minutes.shape == (1, 24)
    assert minutes[0, :3].tolist() == [45.0, 30.0, 0.0]


@given(st.lists(st.floats(-1e6, 1e6, width=32), min_size=1, max_size=20), st.integers(1, 5))
def test_packed_numbers_are_right_to_their_resolution(values, digits):
    given_ = np.array(values)
    packed = record.pack(given_, digits)
    assert np.abs(record.unpack(packed) - given_).max() <= 0.5001 * packed["resolution"]
    assert packed["resolution"] <= max(10.0**-digits * np.abs(given_).max(), 1.0 if not given_.any() else 0.0)
