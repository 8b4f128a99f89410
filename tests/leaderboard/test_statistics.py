"""Statistics against hand values, against scipy, and against their own promises."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from glbench.errors import ResultError
from glbench.leaderboard.statistics import bootstrap_interval, interquartile_mean, mean, resampling_indices

RUNS = np.array([3.1, -1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0])


def test_interquartile_mean_of_eight_values_is_the_mean_of_the_middle_four():
    # sorted: -1 1 2 3.1 4 5 6 9 -> middle four: 2, 3.1, 4, 5
    assert float(interquartile_mean(RUNS)) == pytest.approx((2.0 + 3.1 + 4.0 + 5.0) / 4, abs=1e-15)


def test_interquartile_mean_of_thirty_runs_counts_the_middle_sixteen():
    runs = np.arange(30.0)
    assert float(interquartile_mean(runs)) == pytest.approx(np.mean(np.arange(7, 23)), abs=1e-15)


def test_one_outlier_moves_the_mean_but_not_the_interquartile_mean():
    spoiled = RUNS.copy()
    spoiled[5] = 1e6
    assert float(interquartile_mean(spoiled)) == float(interquartile_mean(RUNS))
    assert float(mean(spoiled)) > 1e5


def test_interval_of_equal_runs_is_that_value():
    assert bootstrap_interval(np.full(30, -4.7)) == (-4.7, -4.7)


def test_interval_repeats_to_the_last_bit_and_is_pinned():
    assert bootstrap_interval(RUNS) == (1.6375, 5.6375)
    assert bootstrap_interval(list(RUNS), interquartile_mean) == (1.25, 6.0)
    assert bootstrap_interval(RUNS, seed=1) != (1.6375, 5.6375)


def test_resampling_draws_every_run_equally_often():
    counts = np.bincount(resampling_indices(30, 10_000, 0).ravel(), minlength=30)
    assert counts.size == 30
    assert stats.chisquare(counts).pvalue > 1e-3


@pytest.mark.parametrize(("own", "scipys"), [(mean, np.mean), (interquartile_mean, lambda v, axis: stats.trim_mean(v, 0.25, axis=axis))])
def test_interval_agrees_with_scipys_bootstrap(own, scipys):
    rng = np.random.default_rng(11)
    runs = rng.normal(100.0, 15.0, size=30)
    low, high = bootstrap_interval(runs, own)
    reference = stats.bootstrap((runs,), scipys, method="percentile", n_resamples=20_000, rng=rng).confidence_interval
    width = reference.high - reference.low
    assert low == pytest.approx(reference.low, abs=0.05 * width)
    assert high == pytest.approx(reference.high, abs=0.05 * width)


def test_a_95_percent_interval_covers_the_truth_about_95_times_in_100():
    rng = np.random.default_rng(5)
    covered = 0
    for k in range(300):
        low, high = bootstrap_interval(rng.normal(size=30), resamples=1000, seed=k)
        covered += low <= 0.0 <= high
    assert 0.88 < covered / 300 < 0.98


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
def test_interval_lies_within_the_range_of_the_runs(values):
    low, high = bootstrap_interval(values, resamples=200)
    slack = 1e-9 * (1 + max(abs(v) for v in values))
    assert min(values) - slack <= low <= high <= max(values) + slack


@pytest.mark.parametrize(
    ("values", "words"), [([], "non-empty"), ([1.0, float("nan")], "value 1 is nan"), (np.ones((2, 2)), r"shape \(2, 2\)")]
)
def test_values_that_have_no_statistics_are_refused_in_words(values, words):
    with pytest.raises(ResultError, match=words):
        bootstrap_interval(values)


def test_a_confidence_in_percent_is_refused():
    with pytest.raises(ResultError, match="between 0 and 1"):
        bootstrap_interval(RUNS, confidence=95)
