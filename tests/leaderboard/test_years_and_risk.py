"""The worst tenth, intervals over trainings and runs, and years apart: against hand values, and what they promise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glbench.env import run_years
from glbench.env.generated import SeasonMaker
from glbench.leaderboard import collect_results, rank
from glbench.leaderboard.entries import entry_of
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.statistics import estimate_mean, resampling_indices, worst_tenth
from glbench.tasks import get_task

YEARS = ["2011", "2012"]
RELEASED = Path(__file__).resolve().parents[2] / "reports" / "released" / "results" / "Spring-v1"


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


def test_resampling_indices_are_kept_and_cannot_be_spoiled():
    with pytest.raises(ValueError, match="read-only"):
        resampling_indices(5, 5, 0)[0, 0] = 3


def test_of_equal_trainings_nothing_is_added_to_the_interval_over_runs():
    runs = np.random.default_rng(8).normal(size=30)
    assert estimate_mean([np.tile(runs, (3, 1))]).interval() == estimate_mean([runs]).interval()


def test_where_runs_are_alike_the_interval_is_students_over_trainings_by_hand():
    # Means 1, 2 and 6: 3 +- 4.303 sqrt(7/3).
    found = estimate_mean([np.repeat([[1.0], [2.0], [6.0]], 8, axis=1)]).interval()
    assert found.high - found.value == pytest.approx(4.302653 * np.sqrt(7.0 / 3.0), rel=1e-6)


@pytest.mark.parametrize("count", [3, 5])
def test_the_interval_over_trainings_and_runs_covers_the_truth(count):
    random, hits = np.random.default_rng(9), 0
    for _ in range(500):
        values = random.normal(0, 1, (count, 1)) + random.normal(0, 0.5, (1, 20)) + random.normal(0, 0.5, (count, 20))
        found = estimate_mean([values]).interval()
        hits += found.low <= 0.0 <= found.high
    assert hits / 500 > 0.94


def test_a_row_has_the_worst_tenth(store):
    rewards = [float(i) + (50.0 if i % 2 else 0.0) for i in range(30)]
    (table,) = rank([store("a", rewards, clusters=[YEARS[i % 2] for i in range(30)])], {})
    (row,) = table.rows
    assert row.worst_tenth.value == (0.0 + 2.0 + 4.0) / 3
    assert (row.by_year, row.estimates["reward"].overall) == ((), None), "of a task that is not known no year is known"


def test_a_row_of_trainings_has_their_deviation_and_an_interval_that_includes_it(store):
    runs = np.random.default_rng(11).normal(size=30)
    stored = [store(f"a_seed{seed}", list(runs + 3.0 * seed), recipe=("a", seed)) for seed in range(3)]
    ((row,),) = [table.rows for table in rank(stored, {})]
    reward, found = row.estimates["reward"], estimate_mean([np.stack([runs, runs + 3.0, runs + 6.0])]).interval()
    assert reward.deviation == pytest.approx(3.0)
    assert (reward.overall.low, reward.overall.high) == (found.low, found.high)
    assert row.worst_tenth.value == pytest.approx(float(worst_tenth(runs)) + 3.0)
    assert row.worst_tenth.low == pytest.approx(float(worst_tenth(runs)))
    assert row.trainings[0].estimates["reward"].overall is None


@pytest.fixture(scope="module")
def of_spring():
    """Released results of two agents on Spring-v1, whose seasons are made of 2011 and 2012."""
    return [item for item in collect_results([RELEASED]) if item.board.endswith("/Spring-v1")
            and item.result.agent.name in ("mpc", "rule_based_tuned")]  # fmt: skip


def test_years_are_shown_apart_each_run_in_the_year_of_most_of_its_days(of_spring):
    task = get_task("Spring-v1").scored
    seeds = of_spring[0].result.evaluation.seeds
    made = [SeasonMaker(task, np.datetime64(task.weather.start)).season(seed - seeds[0], task.steps) for seed in seeds[:8]]
    days = [one.days.sources[2 : 2 + task.weather.days].astype("datetime64[D]").astype("datetime64[Y]") for one in made]
    of_2011 = [int((one == np.datetime64("2011")).sum()) for one in days]
    assert run_years(task, seeds)[:8] == tuple(2011 if 2 * count >= task.weather.days else 2012 for count in of_2011)
    (table,) = rank(of_spring, {})
    for row in table.rows:
        assert [one.year for one in row.by_year] == [2011, 2012]
        assert sum(one.runs for one in row.by_year) == 100
        mean = sum(one.runs * one.mean for one in row.by_year) / 100
        assert mean == pytest.approx(row.estimates["reward"].mean)
        apart = row.by_year[0].mean - row.by_year[1].mean
        assert apart > row.estimates["reward"].high - row.estimates["reward"].mean, "more than the interval says"


def test_a_task_of_one_year_or_of_one_season_has_no_years():
    assert run_years(get_task("Transfer-Miami-v1").scored, (10000, 10001)) == ()
    assert run_years(get_task("Schiphol2010-Delta10-v1"), (666, 667)) == ()


def test_a_comparison_shows_years_apart(of_spring):
    one, other = map(entry_of, of_spring)
    pair = compare_entries(one, other)
    assert list(pair.by_year) == [2011, 2012]
    assert sum(runs * gap for runs, gap in pair.by_year.values()) / 100 == pytest.approx(pair.headline)
