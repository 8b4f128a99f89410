"""Aggregates over tasks against hand values and against other implementations on random scores."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from glbench.errors import ResultError
from glbench.leaderboard.statistics import (
    SCORES,
    aggregate,
    interquartile_mean_score,
    mean_score,
    median_score,
    normalise,
    optimality_gap,
    performance_profile,
    probability_of_improvement,
    resampled,
    stratified_interval,
)

TASKS = [np.array([0.0, 0.5, 1.0, 1.5]), np.array([0.2, 0.4, 0.6, 0.8])]


def random_tasks(seed: int, tasks: int = 5, runs: int = 30) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [generator.normal(generator.uniform(0, 1), 0.3, runs) for _ in range(tasks)]


def test_nothing_scores_zero_and_the_best_known_result_one():
    assert normalise(np.array([100.0, 300.0, 200.0]), 100.0, 300.0).tolist() == [0.0, 1.0, 0.5]


def test_a_best_result_that_is_no_better_than_nothing_is_refused():
    with pytest.raises(ResultError, match="cannot be normalised"):
        normalise(np.array([1.0]), 5.0, 5.0)


def test_mean_and_median_are_over_tasks_by_hand():
    # means of the tasks: 0.75 and 0.5
    assert float(mean_score(TASKS)) == pytest.approx(0.625)
    assert float(median_score([*TASKS, np.array([9.0])])) == pytest.approx(0.75)


def test_interquartile_mean_is_over_all_runs_by_hand():
    # sorted: 0 .2 .4 .5 .6 .8 1 1.5 -> middle four: .4 .5 .6 .8
    assert float(interquartile_mean_score(TASKS)) == pytest.approx(0.575)


def test_the_optimality_gap_counts_runs_beyond_the_target_as_the_target_by_hand():
    # 1 - min(x, 1): 1 .5 0 0 -> .375; .8 .6 .4 .2 -> .5
    assert float(optimality_gap(TASKS)) == pytest.approx(0.4375)


@pytest.mark.parametrize("seed", range(5))
def test_aggregates_agree_with_plain_loops_on_random_scores(seed):
    tasks = random_tasks(seed)
    found = {score: aggregate(tasks, score, resamples=200) for score in SCORES}
    everything = sorted(float(x) for runs in tasks for x in runs)
    cut = int(0.25 * len(everything))
    assert found["iqm"].value == pytest.approx(np.mean(everything[cut : len(everything) - cut]))
    assert found["mean"].value == pytest.approx(np.mean([runs.mean() for runs in tasks]))
    assert found["median"].value == pytest.approx(np.median([runs.mean() for runs in tasks]))
    gaps = [np.mean([1.0 - min(x, 1.0) for x in runs]) for runs in tasks]
    assert found["optimality_gap"].value == pytest.approx(np.mean(gaps))


def test_a_stratified_interval_agrees_with_the_normal_one_of_a_mean():
    tasks = random_tasks(1, tasks=4, runs=100)
    low, high = stratified_interval(tasks, mean_score)
    error = np.sqrt(sum(runs.var() / runs.size for runs in tasks)) / len(tasks)
    centre = float(mean_score(tasks))
    assert low == pytest.approx(centre - 1.96 * error, abs=0.15 * error)
    assert high == pytest.approx(centre + 1.96 * error, abs=0.15 * error)


def test_resampling_stays_within_its_task_and_tasks_are_drawn_independently():
    first, second = resampled([np.zeros(8), np.arange(1.0, 9.0)], 500, seed=3)
    assert not first.any()
    assert set(np.unique(second)) == set(range(1, 9))
    a, b = resampled([np.arange(8.0), np.arange(8.0)], 500, seed=3)
    assert not np.array_equal(a, b)


def test_an_interval_covers_the_true_mean_as_often_as_it_says():
    generator = np.random.default_rng(7)
    hits = 0
    for trial in range(300):
        tasks = [generator.normal(0.3, 0.2, 30), generator.normal(0.7, 0.1, 30)]
        low, high = stratified_interval(tasks, mean_score, resamples=400, seed=trial)
        hits += low <= 0.5 <= high
    assert 0.89 < hits / 300 < 0.99


def test_the_same_seed_gives_the_same_bits():
    tasks = random_tasks(2)
    assert aggregate(tasks, "iqm", resamples=300) == aggregate(tasks, "iqm", resamples=300)


def test_a_profile_is_the_share_of_runs_above_each_threshold():
    profile = performance_profile("a", TASKS, np.array([-1.0, 0.5, 0.7, 2.0]), resamples=200)
    # above 0.5: 2 of 4 and 2 of 4; above 0.7: 2 of 4 and 1 of 4
    assert profile.share == (1.0, 0.5, 0.375, 0.0)
    assert all(low <= share <= high for low, share, high in zip(profile.low, profile.share, profile.high, strict=True))


@pytest.mark.parametrize("seed", range(5))
def test_the_probability_of_improvement_counts_pairs_of_one_run(seed):
    generator = np.random.default_rng(seed)
    ours = {f"t{i}": generator.integers(0, 10, (2, 30)).astype(float) for i in range(3)}
    theirs = {f"t{i}": generator.integers(0, 10, (3, 30)).astype(float) for i in range(3)}
    pairs = [
        np.mean([(x > y) + 0.5 * (x == y) for one in ours[task] for other in theirs[task] for x, y in zip(one, other, strict=True)])
        for task in ours
    ]
    found = probability_of_improvement(ours, theirs)
    assert found.value == pytest.approx(np.mean(pairs))
    assert 0.0 < found.low < found.value < found.high < 1.0


def test_an_agent_that_is_a_little_ahead_in_every_run_improves_for_sure_however_runs_differ():
    luck = np.random.default_rng(1).normal(0.0, 100.0, 30)
    found = probability_of_improvement({"t": luck + 1.0}, {"t": luck})
    assert (found.value, found.high) == (1.0, 1.0)
    t = stats.t.ppf(0.975, 29)
    assert found.low == pytest.approx(30 / (30 + t**2)), "30 of 30 runs say no more (Wilson)"


def test_the_interval_of_a_probability_covers_it():
    generator, hits = np.random.default_rng(2), 0
    for _ in range(400):
        found = probability_of_improvement({"t": generator.normal(0.5, 1.0, 30)}, {"t": generator.normal(0.0, 1.0, 30)})
        hits += found.low <= stats.norm.cdf(0.5 / np.sqrt(2.0)) <= found.high
    assert hits / 400 > 0.93


def test_an_agent_improves_on_itself_half_the_time():
    runs = {"t": np.arange(30.0)}
    assert probability_of_improvement(runs, runs).value == 0.5


def test_only_common_tasks_count_and_without_one_nothing_can_be_said():
    ours, theirs = {"a": np.ones(3), "b": np.zeros(3)}, {"b": np.ones(3), "c": np.zeros(3)}
    assert probability_of_improvement(ours, theirs).value == 0.0
    with pytest.raises(ResultError, match="same runs"):
        probability_of_improvement({"a": np.ones(3)}, {"a": np.ones(4)})
    with pytest.raises(ResultError, match="no task in common"):
        probability_of_improvement({"a": np.ones(3)}, {"c": np.ones(3)})
