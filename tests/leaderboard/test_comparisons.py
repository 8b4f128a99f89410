"""Paired tests, their error rate, their correction and the tiers: against hand values, other implementations, and what they promise."""

from __future__ import annotations

from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from glbench.errors import ResultError
from glbench.evaluation import load_result
from glbench.leaderboard.statistics import RESOLUTION, SIGNIFICANCE, corrected, estimate_difference, paired_test, pairs_apart, tiers

RELEASED = Path(__file__).resolve().parents[2] / "reports" / "released" / "results"
MOST = 0.06
"""Share of equal pairs that may be told apart at the 5 % level."""


def p_of(first: np.ndarray, second: np.ndarray, **keywords) -> float:
    return paired_test([first], [second], **keywords).p_value


def test_of_one_training_each_it_is_the_paired_t_test():
    generator = np.random.default_rng(0)
    first, second = generator.normal(0.4, 1.0, 10), generator.normal(0.0, 1.0, 10)
    expected = stats.ttest_rel(first, second)
    assert p_of(first, second) == pytest.approx(expected.pvalue, rel=1e-9)
    found, interval = estimate_difference([first], [second]).interval(), expected.confidence_interval()
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high))


def test_where_runs_are_alike_trainings_are_compared_by_welchs_t_test():
    first, second = np.array([1.0, 2.0, 6.0]), np.array([3.0, 9.0, 8.0, 12.0])
    found = p_of(np.repeat(first[:, None], 5, axis=1), np.repeat(second[:, None], 5, axis=1), resolutions=(0.0,))
    assert found == pytest.approx(stats.ttest_ind(first, second, equal_var=False).pvalue, rel=1e-9)


def test_one_training_against_several_is_one_more_draw_with_their_variance_by_hand():
    # Means 1, 2 and 6: variance 7. The difference 7 - 3 has variance 7 (1 + 1/3), t = 4/sqrt(28/3), two degrees of freedom.
    several, one = np.repeat([[1.0], [2.0], [6.0]], 5, axis=1), np.full(5, 7.0)
    expected = 2.0 * stats.t.sf(4.0 / np.sqrt(28.0 / 3.0), 2)
    assert p_of(one, several, resolutions=(0.0,)) == pytest.approx(expected, rel=1e-9)
    fixed = 2.0 * stats.t.sf(4.0 / np.sqrt(7.0 / 3.0), 2)
    assert p_of(one, several, resolutions=(0.0,), fixed=(True, False)) == pytest.approx(fixed, rel=1e-9)


def test_of_several_tasks_the_mean_over_tasks_is_tested_and_not_the_pool_of_their_runs():
    generator = np.random.default_rng(1)
    many, few = generator.normal(0.0, 1.0, 100), generator.normal(3.0, 1.0, 30)
    found = estimate_difference([many, few], [0 * many, 0 * few])
    assert found.value == pytest.approx((many.mean() + few.mean()) / 2)
    assert found.variance == pytest.approx((many.var(ddof=1) / 100 + few.var(ddof=1) / 30) / 4)
    assert paired_test([many - many.mean(), few - few.mean()], [0 * many, 0 * few]).p_value > 0.99


def test_runs_of_two_tasks_that_meet_the_same_draws_vary_together():
    generator = np.random.default_rng(2)
    season = generator.normal(size=30)
    tasks = [season + 0.1 * generator.normal(size=30), season + 0.1 * generator.normal(size=30)]
    found = estimate_difference(tasks, [np.zeros(30)] * 2, [range(30)] * 2)
    expected = stats.ttest_1samp(np.mean(tasks, axis=0), 0.0)
    assert found.p_value() == pytest.approx(expected.pvalue, rel=1e-9)
    with pytest.raises(ResultError, match="needs its own name"):
        estimate_difference(tasks, [np.zeros(30)] * 2, [[1] * 30] * 2)


def test_trainings_of_all_tasks_are_units_because_they_may_be_one_policy():
    means = np.array([0.0, 1.0, 5.0])
    tasks = [np.repeat(means[:, None], 4, axis=1), np.repeat(2 * means[:, None], 4, axis=1)]
    found = estimate_difference(tasks, [np.zeros(4)] * 2, fixed=(False, True))
    assert found.variance == pytest.approx((1.5 * means).var(ddof=1) / 3)
    assert found.degrees == pytest.approx(2.0)


def test_where_tasks_have_different_numbers_of_trainings_a_single_one_varies_like_the_others_by_hand():
    several, single = np.repeat([[1.0], [2.0], [6.0]], 4, axis=1), np.full(4, 3.0)
    found = estimate_difference([several, single], [np.zeros(4)] * 2, fixed=(False, True))
    assert found.variance == pytest.approx((7.0 / 3 + 7.0) / 4)


def test_pairing_sees_a_small_difference_that_runs_of_different_luck_would_hide():
    luck = np.random.default_rng(0).normal(0.0, 100.0, 30)
    jitter = np.random.default_rng(1).normal(0.0, 0.1, 30)
    assert p_of(luck + 1.0 + jitter, luck) < 1e-6


def test_where_nothing_is_drawn_differences_within_rounding_count_as_none():
    alike = np.full(30, 3100.0)
    assert p_of(alike, alike - 0.9 * RESOLUTION) == 1.0
    assert p_of(alike, alike - 1.1 * RESOLUTION) == 0.0
    assert p_of(alike, alike, resolutions=(0.0,)) == 1.0


def test_a_single_run_says_nothing_about_others():
    assert p_of(np.array([5000.0]), np.array([0.0])) == 1.0
    assert estimate_difference([np.array([3.0])], [np.array([1.0])]).interval().low == 2.0


def test_the_order_of_runs_and_of_trainings_does_not_matter():
    generator = np.random.default_rng(3)
    first, second = generator.normal(0.3, 1.0, (3, 12)), generator.normal(size=(5, 12))
    runs = generator.permutation(12)
    again = p_of(first[::-1][:, runs], second[[2, 0, 4, 1, 3]][:, runs])
    assert again == pytest.approx(p_of(first, second), rel=1e-9)
    assert p_of(second, first) == pytest.approx(p_of(first, second), rel=1e-9)


def of_recipes(generator, first, second, n, between, shared, alone, tails):
    """Runs of two recipes of equal mean: trainings and single runs differ, they share runs, and some of what they do is their own."""

    def draws(*shape):
        return generator.standard_t(tails, shape) if tails else generator.normal(size=shape)

    seasons = 3.0 * generator.normal(size=n)
    return [seasons + between * draws(count, 1) + shared * generator.normal(size=n) + alone * draws(count, n) for count in (first, second)]


@pytest.mark.parametrize("tails", [None, 3.0], ids=["normal", "heavy tails"])
@pytest.mark.parametrize(("first", "second"), [(1, 1), (3, 3), (5, 5), (1, 3), (1, 5), (3, 5)])
def test_equal_recipes_are_told_apart_in_at_most_six_percent_of_cases(first, second, tails):
    if tails and (first, second) in ((1, 3), (1, 5)):
        pytest.skip("one draw with heavy tails: 8 to 9 %, see docs/statistics.md")
    generator = np.random.default_rng(4)
    for between, shared, alone in ((1.0, 0.0, 0.01), (1.0, 0.5, 0.5), (0.0, 0.0, 1.0)):
        spread = 0.0 if first == second == 1 else between  # of one training each the policies are equal
        apart = [p_of(*of_recipes(generator, first, second, 30, spread, shared, alone, tails)) < SIGNIFICANCE for _ in range(800)]
        assert np.mean(apart) <= MOST, (between, shared, alone)


@pytest.mark.parametrize("kind", ["one policy on all tasks", "a training for each task"])
@pytest.mark.parametrize(("first", "second"), [(1, 1), (3, 3), (1, 3), (5, 5)])
def test_over_a_suite_equal_recipes_are_told_apart_in_at_most_six_percent_of_cases(first, second, kind):
    generator, sizes, hits = np.random.default_rng(5), (60, 20, 20), 0
    names = [range(size) for size in sizes]
    spread = 0.0 if first == second == 1 else 0.5
    for _ in range(600):
        own = [generator.normal(size=60) for _ in range(2)]  # what a recipe makes of a season, on whatever task
        sides = []
        for count, seasons in zip((first, second), own, strict=True):
            of_all = generator.normal(size=(count, 1))
            of_each = [generator.normal(size=(count, 1)) for _ in sizes]
            trainings = [of_all] * 3 if kind.startswith("one") else of_each
            sides.append([
                spread * one + seasons[:size] + 0.3 * generator.normal(size=(count, size))
                for one, size in zip(trainings, sizes, strict=True)
            ])  # fmt: skip
        hits += paired_test(*sides, scenarios=names).p_value < SIGNIFICANCE
    assert hits / 600 <= MOST


@pytest.mark.parametrize("counts", [((5, 3, 3, 3), (3, 3, 3, 3)), ((5, 3), (3, 5)), ((6, 3, 4), (1, 1, 1))])
@pytest.mark.parametrize("kind", ["one policy on all tasks", "a training for each task"])
def test_recipes_with_fewer_trainings_on_some_tasks_are_told_apart_in_at_most_six_percent_of_cases(counts, kind):
    generator, hits = np.random.default_rng(9), 0
    for _ in range(1000):
        sides = []
        for of_tasks in counts:
            policies = generator.normal(size=(max(of_tasks), 1))
            sides.append([
                (policies[:count] if kind.startswith("one") else generator.normal(size=(count, 1)))
                + 0.5 * generator.normal(size=(1, 30))
                + 0.3 * generator.normal(size=(count, 30))
                for count in of_tasks
            ])  # fmt: skip
        hits += paired_test(*sides).p_value < SIGNIFICANCE
    assert hits / 1000 <= MOST


def test_of_tasks_with_different_numbers_of_trainings_training_i_is_one_unit_by_hand():
    # Means of five and three trainings; deviations of the mean over two tasks: (m - mean) / (2 sqrt(T (T - 1))), added by training.
    five, three = np.array([0.0, 1.0, 2.0, 3.0, 9.0]), np.array([1.0, 2.0, 6.0])
    unit = (five - 3.0) / (2 * np.sqrt(20.0))
    unit[:3] += (three - 3.0) / (2 * np.sqrt(6.0))
    tasks = [np.repeat(means[:, None], 4, axis=1) for means in (five, three)]
    found = estimate_difference(tasks, [np.zeros(4)] * 2, fixed=(False, True))
    assert found.variance == pytest.approx(np.square(unit).sum())
    assert found.degrees == pytest.approx(2.0)


def share_apart(make, fixed=(False, False)):
    return np.mean([paired_test(*make(), fixed=fixed).p_value < SIGNIFICANCE for _ in range(1500)])


def test_what_the_page_says_of_the_cases_in_which_the_error_is_larger():
    """The exceptions of docs/statistics.md, as large as the page says."""
    generator = np.random.default_rng(10)

    def of_policies(policies, task_spread=1.0):
        policies = np.atleast_2d(policies)
        return task_spread * (policies.reshape(-1, 1) + 0.4 * generator.normal(size=(policies.size, 30)))

    def failing(count):
        return of_policies(-10.0 * ((generator.random(count) < 0.2) - 0.2) + 0.3 * generator.normal(size=count))

    for count, stated in ((3, 0.52), (5, 0.33)):
        rate = share_apart(lambda count=count: ([failing(count)], [of_policies([0.0])]), (False, True))
        assert rate == pytest.approx(stated, abs=0.05)
        assert share_apart(lambda count=count: ([failing(count)], [failing(count)])) <= MOST

    def mixed():
        policies = generator.normal(size=3)
        return [of_policies(policies), *(of_policies(policies[:1]) for _ in range(3))], [of_policies([0.0])] * 4

    assert share_apart(mixed, (False, True)) == pytest.approx(0.095, abs=0.02)

    def wider():
        return [
            [of_policies(0.5 * generator.normal(size=count), spread) for count, spread in zip(of_tasks, (1, 5), strict=True)]
            for of_tasks in ((3, 1), (3, 3))
        ]

    assert share_apart(wider) == pytest.approx(0.145, abs=0.04)


def test_of_many_equal_agents_any_two_are_told_apart_in_at_most_six_percent_of_tables():
    generator, hits = np.random.default_rng(6), 0
    for _ in range(400):
        seasons = generator.normal(0.0, 3.0, 30)
        scores = {f"a{i}": (seasons + generator.normal(size=30),) for i in range(6)}
        hits += len(tiers(scores)) > 1
    assert hits / 400 <= MOST


def test_equal_recipes_made_of_the_shipped_trainings_are_not_told_apart():
    """Trainings as different as the released ones are, one of which failed; seasons drawn again."""
    found = []
    for recipe in ("ppo_fast", "ppo_memory", "ppo_long"):
        files = [RELEASED / "SpringYears-v1" / f"{recipe}{seed}.json" for seed in ("", "_seed1", "_seed2")]
        values = np.array([load_result(file).values("reward") for file in files])
        found += list(values - values.mean())
    pool, generator = np.array(found), np.random.default_rng(7)
    for count in (3, 5):
        hits = 0
        for _ in range(600):
            runs = generator.integers(0, 30, 30)
            first, second = (pool[generator.integers(0, len(pool), count)][:, runs] for _ in range(2))
            hits += p_of(first, second, resolutions=(0.0,)) < SIGNIFICANCE
        assert hits / 600 <= MOST


def test_different_recipes_are_told_apart():
    generator, hits = np.random.default_rng(8), 0
    for _ in range(300):
        first, second = of_recipes(generator, 3, 3, 30, 0.1, 0.2, 0.2, None)
        hits += p_of(first + 1.0, second) < SIGNIFICANCE
    assert hits / 300 > 0.9


def test_the_correction_by_hand():
    # sorted .01 .02 .03 .2: .01*4/1=.04, .02*4/2=.04, .03*4/3=.04, .2*4/4=.2; never falling
    assert corrected([0.03, 0.01, 0.2, 0.02]) == pytest.approx([0.04, 0.04, 0.2, 0.04])
    assert corrected([]) == []


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=12))
def test_a_correction_is_scipys_and_never_changes_the_order_of_p_values(p_values):
    found = corrected(p_values)
    assert found == pytest.approx(list(stats.false_discovery_control(p_values)), abs=1e-12)
    assert all(c >= p for p, c in zip(p_values, found, strict=True))
    for i, j in product(range(len(p_values)), repeat=2):
        if p_values[i] < p_values[j]:
            assert found[i] <= found[j]


def test_agents_that_cannot_be_told_apart_share_a_tier():
    luck = np.random.default_rng(3).normal(0.0, 5.0, 30)
    noise = np.random.default_rng(4).normal(0.0, 1.0, 30)
    noise -= noise.mean()
    scores = {"low": (luck - 50.0 + noise,), "high": (luck + 0.01 * noise + 0.01,), "also_high": (luck + noise,)}
    assert tiers(scores) == (("high", "also_high"), ("low",))


def test_tiers_hold_every_agent_once_the_best_first():
    generator = np.random.default_rng(5)
    scores = {f"agent{i}": (generator.normal(i, 0.5, 30),) for i in range(6)}
    found = tiers(scores)
    assert sorted(agent for tier in found for agent in tier) == sorted(scores)
    assert found[0][0] == "agent5"


def test_one_agent_is_a_tier_of_its_own():
    assert tiers({"only": (np.ones(30),)}) == (("only",),)
    assert tiers({}) == ()


def test_of_every_pair_it_is_said_whether_it_can_be_told_apart():
    noise = np.random.default_rng(2).normal(0.0, 0.1, 30)
    scores = {"a": (noise + 1.0,), "b": (noise[::-1].copy(),), "c": (noise - 0.001 * noise**2,)}
    assert pairs_apart(scores, (0.0,)) == {frozenset("ab"), frozenset("ac")}


def test_agents_with_different_runs_are_not_compared():
    with pytest.raises(ResultError, match="same runs"):
        pairs_apart({"a": (np.ones(3),), "b": (np.ones(4),)})
    with pytest.raises(ResultError, match="same tasks"):
        paired_test([np.ones(3)], [np.ones(3), np.ones(3)])


def test_an_agent_that_fails_sometimes_is_not_told_apart_by_how_often_it_is_ahead():
    luck = np.random.default_rng(6).normal(0.0, 5.0, 30)
    brilliant = luck + np.random.default_rng(7).uniform(1.0, 2.0, 30)
    brilliant[:3] -= 1000.0  # three failed runs: the lower mean, though it is ahead in 27 of 30
    assert p_of(brilliant, luck) > 0.05
    assert tiers({"brilliant": (brilliant,), "steady": (luck,)}) == (("steady", "brilliant"),)


def test_a_task_that_draws_nothing_adds_no_chance_to_that_of_a_suite():
    generator = np.random.default_rng(8)
    noise = generator.normal(0.0, 1.0, 30)
    noise *= np.sign(noise.mean())
    zero, alike = np.zeros(30), np.full(30, 3000.0)
    within = paired_test([alike + 0.9 * RESOLUTION, noise], [alike, zero])
    beyond = paired_test([alike + 50.0, noise], [alike, zero])
    assert within.p_value == pytest.approx(p_of(noise, zero)), "rounding is no difference"
    assert beyond.p_value < 1e-10
    assert beyond.difference.variance == pytest.approx(noise.var(ddof=1) / 30 / 4)


def test_where_no_task_of_a_suite_draws_anything_differences_beyond_rounding_decide():
    alike = np.ones(30)
    assert paired_test([alike * 0.01] * 2, [0 * alike] * 2, (0.02, 0.02)).p_value == 1.0
    assert paired_test([alike * 0.01, alike * 0.2], [0 * alike] * 2, (0.02, 0.02)).p_value == 0.0


def test_the_first_of_a_tier_is_told_apart_from_the_first_of_the_tier_above():
    for seed in range(20):
        generator = np.random.default_rng(seed)
        luck = generator.normal(0.0, 3.0, 30)
        spreads = generator.uniform(0.1, 6.0, 8)
        scores = {f"a{i}": (luck + 0.5 * i + generator.normal(0.0, spread, 30),) for i, spread in enumerate(spreads)}
        apart = pairs_apart(scores)
        found = tiers(scores)
        means = [scores[agent][0].mean() for tier in found for agent in tier]
        assert means == sorted(means, reverse=True)
        for tier in found:
            assert not any(frozenset((tier[0], agent)) in apart for agent in tier[1:])
        for above, below in pairwise(found):
            assert frozenset((above[0], below[0])) in apart
