"""The worst tenth, intervals over groups of runs and over trainings: against hand values, numpy, and what they promise."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest

from glbench.errors import ResultError
from glbench.leaderboard import rank
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.statistics import (
    bootstrap_interval,
    crossed_interval,
    difference_interval,
    mean,
    resampling_indices,
    worst_tenth,
)
from tests.leaderboard.synthetic import make_entry

YEARS = ["2011", "2012"]


def test_the_worst_tenth_of_thirty_runs_is_the_mean_of_three():
    runs = np.random.default_rng(0).permutation(np.arange(30.0))
    assert float(worst_tenth(runs)) == 1.0


def test_where_a_tenth_is_no_whole_number_the_last_run_counts_by_its_fraction():
    # Of 25 runs 2.5 count: 0, 1 and half of 2.
    assert float(worst_tenth(np.arange(25.0)[::-1])) == pytest.approx((0.0 + 1.0 + 0.5 * 2.0) / 2.5)


@pytest.mark.parametrize("size", [1, 2, 9])
def test_of_fewer_than_ten_runs_the_worst_tenth_is_the_worst_run(size):
    assert float(worst_tenth(np.arange(5.0, 5.0 + size))) == 5.0


@pytest.mark.parametrize("size", [10, 33, 100])
def test_the_worst_tenth_is_the_integral_of_the_quantiles_below_a_tenth(size):
    runs = np.random.default_rng(size).normal(size=size)
    ordered, fine = np.sort(runs), 100_000
    levels = (np.arange(fine) + 0.5) / fine * 0.1
    by_integral = np.mean(ordered[np.minimum((levels * size).astype(int), size - 1)])
    assert float(worst_tenth(runs)) == pytest.approx(by_integral, abs=1e-3)


def test_the_worst_tenth_of_many_samples_is_that_of_each():
    samples = np.random.default_rng(3).normal(size=(7, 12))
    assert worst_tenth(samples).tolist() == [float(worst_tenth(one)) for one in samples]


def test_two_groups_have_the_ends_that_can_be_counted_by_hand():
    # Resamples of two groups: (A, A), (A, B), (B, A), (B, B). The ends are the two means, moved out by sqrt(2).
    low, high = bootstrap_interval([0.0, 1.0, 2.0, 10.0, 11.0, 12.0], clusters=list("aaabbb"))
    assert (low, high) == pytest.approx((6.0 - 5.0 * math.sqrt(2.0), 6.0 + 5.0 * math.sqrt(2.0)))


def test_groups_of_different_sizes_are_drawn_whole():
    values, names = np.array([1.0, 2.0, 3.0, 10.0, 20.0, 5.0]), ["a", "b", "a", "b", "c", "a"]
    groups = {name: values[[one == name for one in names]] for name in "abc"}
    draws = [np.concatenate([groups["abc"[i]] for i in row]).mean() for row in resampling_indices(3, 500, 7)]
    wide = values.mean() + math.sqrt(1.5) * (np.array(draws) - values.mean())
    expected = np.percentile(wide, [2.5, 97.5])
    assert bootstrap_interval(values, clusters=names, resamples=500, seed=7) == pytest.approx(tuple(expected))


def test_the_worst_tenth_has_an_interval_over_groups_too():
    values = np.random.default_rng(4).normal(size=40)
    low, high = bootstrap_interval(values, worst_tenth, clusters=[i // 8 for i in range(40)])
    assert low < float(worst_tenth(values)) < high


def test_intervals_over_groups_repeat_to_the_last_bit():
    values, names = np.random.default_rng(5).normal(size=30), [i % 3 for i in range(30)]
    assert bootstrap_interval(values, clusters=names) == bootstrap_interval(values, clusters=names)
    state = np.random.get_state()[1].copy()  # noqa: NPY002 -- that nobody touches it is the point
    crossed_interval(values.reshape(3, 10))
    assert (np.random.get_state()[1] == state).all()  # noqa: NPY002


@pytest.mark.parametrize(
    ("clusters", "words"), [(["a"] * 4, "two or more"), (["a", "b"], "2 groups' names for 4 runs")]
)
def test_groups_that_say_nothing_are_refused(clusters, words):
    with pytest.raises(ResultError, match=words):
        bootstrap_interval([1.0, 2.0, 3.0, 4.0], clusters=clusters)


def test_resampling_indices_are_kept_and_cannot_be_spoiled():
    with pytest.raises(ValueError, match="read-only"):
        resampling_indices(5, 5, 0)[0, 0] = 3


def covers(between: float, groups: int, *, clustered: bool) -> float:
    """Share of 300 simulated tables, six runs a group, of which the interval holds the true mean 0."""
    random, hits = np.random.default_rng(6), 0
    names = [i // 6 for i in range(6 * groups)]
    for _ in range(300):
        values = (random.normal(0.0, between, (groups, 1)) + random.normal(size=(groups, 6))).ravel()
        low, high = bootstrap_interval(values, clusters=names if clustered else None, resamples=600)
        hits += low <= 0.0 <= high
    return hits / 300


def test_where_runs_fall_into_groups_an_interval_over_groups_covers_and_one_over_runs_does_not():
    assert covers(1.0, 12, clustered=True) > 0.88
    assert covers(1.0, 12, clustered=False) < 0.75
    assert covers(0.0, 12, clustered=True) > 0.88, "nor does it fail where groups do not matter"


def test_from_two_groups_it_covers_about_as_often_as_the_footnote_says():
    assert 0.5 < covers(3.0, 2, clustered=True) < 0.7


def test_over_trainings_alone_the_interval_is_that_of_drawing_trainings():
    # Three trainings whose runs are all alike: only the drawing of trainings matters, and all 27 draws can be counted.
    means = np.array([1.0, 2.0, 6.0])
    values = np.repeat(means[:, None], 8, axis=1)
    draws = 3.0 + math.sqrt(1.5) * (np.array([np.mean(one) for one in product(means, repeat=3)]) - 3.0)
    low, high = crossed_interval(values)
    assert (low, high) == pytest.approx((draws.min(), draws.max()))  # each has more than 2.5 % of the draws


def test_trainings_that_agree_add_nothing_to_the_interval_over_runs():
    runs = np.random.default_rng(8).normal(size=30)
    assert crossed_interval(np.tile(runs, (3, 1))) == pytest.approx(bootstrap_interval(runs))


def test_the_crossed_interval_covers_where_trainings_and_runs_are_chance():
    random, hits = np.random.default_rng(9), 0
    for _ in range(200):
        values = random.normal(0, 1, (8, 1)) + random.normal(0, 0.5, (1, 20)) + random.normal(0, 0.5, (8, 20))
        low, high = crossed_interval(values, mean, resamples=600)
        hits += low <= 0.0 <= high
    assert hits / 200 > 0.85


def test_one_training_has_no_interval_over_trainings():
    with pytest.raises(ResultError, match="two or more"):
        crossed_interval(np.ones((1, 5)))


def test_a_difference_of_pairs_is_resampled_in_pairs():
    runs = np.random.default_rng(10).normal(0.0, 100.0, 30)
    low, high = difference_interval(runs + 1.0, runs)
    assert (low, high) == pytest.approx((1.0, 1.0))
    with pytest.raises(ResultError, match="the same runs"):
        difference_interval(runs, runs[1:])


def test_a_row_has_the_worst_tenth_and_the_interval_over_its_groups(store):
    rewards = [float(i) + (50.0 if i % 2 else 0.0) for i in range(30)]
    names = [YEARS[i % 2] for i in range(30)]
    (table,) = rank([store("a", rewards, clusters=names), store("b", rewards)], {})
    rows = {row.agent: row for row in table.rows}
    assert rows["a"].worst_tenth.value == (0.0 + 2.0 + 4.0) / 3
    assert rows["a"].groups == 2
    overall = rows["a"].estimates["reward"].overall
    assert (overall.low, overall.high) == bootstrap_interval(rewards, clusters=names)
    assert overall.low < rows["a"].estimates["reward"].low
    assert (rows["b"].groups, rows["b"].estimates["reward"].overall) == (None, None)
    assert rows["a"].estimates["reward"].low == rows["b"].estimates["reward"].low


def test_a_row_of_trainings_has_their_deviation_and_an_interval_that_includes_it(store):
    runs = np.random.default_rng(11).normal(size=30)
    shifts = (("a", 0.0), ("a_seed1", 3.0), ("a_seed2", 6.0))
    stored = [store(name, list(runs + shift), recipe=("a", i)) for i, (name, shift) in enumerate(shifts)]
    ((row,),) = [table.rows for table in rank(stored, {})]
    reward = row.estimates["reward"]
    assert reward.deviation == pytest.approx(3.0)
    assert (reward.overall.low, reward.overall.high) == crossed_interval(np.stack([runs, runs + 3.0, runs + 6.0]))
    assert row.worst_tenth.value == pytest.approx(float(worst_tenth(runs)) + 3.0)
    assert row.worst_tenth.low == pytest.approx(float(worst_tenth(runs)))
    assert row.trainings[0].estimates["reward"].overall is None


def test_a_comparison_has_an_interval_over_the_groups_of_common_runs():
    random = np.random.default_rng(12)
    names = [YEARS[i % 2] for i in range(30)]
    base = random.normal(size=30)
    better = base + np.where(np.array(names) == "2011", 5.0, 1.0) + 0.01 * random.normal(size=30)
    pair = compare_entries(make_entry("a", list(better), clusters=names), make_entry("b", list(base), clusters=names))
    one = pair.metrics["reward"]
    assert pair.groups == 2
    assert one.overall.low < 1.0 < one.difference.low < 3.0 < one.difference.high < 5.0 < one.overall.high
    others = compare_entries(make_entry("a", list(better), clusters=names), make_entry("b", list(base)))
    assert (others.groups, others.metrics["reward"].overall) == (0, None)
