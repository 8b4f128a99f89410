"""Paired tests, their correction and the tiers, against hand values and other implementations."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.errors import ResultError
from glbench.leaderboard.comparisons import RESOLUTION, holm, paired_test, pairs_apart, tiers


def p_of(first: np.ndarray, second: np.ndarray) -> float:
    return paired_test([first], [second]).p_value


def exact_signed_rank_p(difference: np.ndarray) -> float:
    """Two-sided p-value by going through all signs: the definition of the test."""
    ranks = np.argsort(np.argsort(np.abs(difference))) + 1
    observed = abs(ranks[difference > 0].sum() - ranks.sum() / 2)
    signs = list(product([0, 1], repeat=difference.size))
    extreme = sum(abs((ranks * np.array(sign)).sum() - ranks.sum() / 2) >= observed for sign in signs)
    return extreme / len(signs)


@pytest.mark.parametrize("seed", range(6))
def test_the_paired_test_is_the_exact_signed_rank_test(seed):
    generator = np.random.default_rng(seed)
    first, second = generator.normal(0.4, 1.0, 10), generator.normal(0.0, 1.0, 10)
    assert p_of(first, second) == pytest.approx(exact_signed_rank_p(first - second))


def test_pairing_sees_a_small_difference_that_runs_of_different_luck_would_hide():
    luck = np.random.default_rng(0).normal(0.0, 100.0, 30)
    jitter = np.random.default_rng(1).normal(0.0, 0.1, 30)
    assert p_of(luck + 1.0 + jitter, luck) < 1e-6


def test_where_nothing_is_drawn_differences_within_rounding_count_as_none():
    alike = np.full(30, 3100.0)
    assert p_of(alike, alike - 0.9 * RESOLUTION) == 1.0
    assert p_of(alike, alike - 1.1 * RESOLUTION) == 0.0


def test_holm_by_hand():
    # sorted: .01*4=.04, .02*3=.06, .03*2=.06, .2*1=.2; never falling
    assert holm([0.03, 0.01, 0.2, 0.02]) == pytest.approx([0.06, 0.04, 0.2, 0.06])


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=12))
def test_a_correction_never_makes_a_p_value_smaller_nor_changes_their_order(p_values):
    corrected = holm(p_values)
    assert all(c >= p for p, c in zip(p_values, corrected, strict=True))
    assert max(corrected) <= 1.0
    for i, j in product(range(len(p_values)), repeat=2):
        if p_values[i] < p_values[j]:
            assert corrected[i] <= corrected[j]


def test_agents_that_cannot_be_told_apart_share_a_tier():
    luck = np.random.default_rng(3).normal(0.0, 5.0, 30)
    noise = np.random.default_rng(4).normal(0.0, 1.0, 30)
    noise -= noise.mean()
    scores = {"low": (luck - 50.0 + noise,), "high": (luck + 0.01,), "also_high": (luck + noise,)}
    assert tiers(scores) == (("high", "also_high"), ("low",))


def test_tiers_hold_every_agent_once_the_best_first():
    generator = np.random.default_rng(5)
    scores = {f"agent{i}": (generator.normal(i, 0.5, 30),) for i in range(6)}
    found = tiers(scores)
    assert sorted(agent for tier in found for agent in tier) == sorted(scores)
    assert found[0][0] == "agent5"


def test_one_agent_is_a_tier_of_its_own():
    assert tiers({"only": (np.ones(30),)}) == (("only",),)


def test_of_every_pair_it_is_said_whether_it_can_be_told_apart():
    noise = np.random.default_rng(2).normal(0.0, 0.1, 30)
    scores = {"a": (noise + 1.0,), "b": (noise[::-1].copy(),), "c": (noise - 0.001 * noise**2,)}
    assert pairs_apart(scores) == {frozenset("ab"), frozenset("ac")}


def test_agents_with_different_runs_are_not_compared():
    with pytest.raises(ResultError, match="same runs"):
        pairs_apart({"a": (np.ones(3),), "b": (np.ones(4),)})


def test_an_agent_that_fails_sometimes_is_not_called_worse_by_a_test_that_favours_it():
    luck = np.random.default_rng(6).normal(0.0, 5.0, 30)
    steady = luck
    brilliant = luck + np.random.default_rng(7).uniform(1.0, 2.0, 30)
    brilliant[:3] -= 1000.0  # three failed runs: the lower mean, and the higher ranks
    found = paired_test([brilliant], [steady])
    assert brilliant.mean() < steady.mean()
    assert (found.p_value < 0.05, found.favours) == (True, 1)
    assert pairs_apart({"brilliant": (brilliant,), "steady": (steady,)}) == set()
    assert tiers({"brilliant": (brilliant,), "steady": (steady,)}) == (("steady", "brilliant"),)


def test_a_task_that_draws_nothing_is_one_pair_among_those_of_a_suite():
    generator = np.random.default_rng(8)
    noise = generator.normal(0.0, 1.0, 30)
    by_chance = noise - noise.mean()
    zero, alike = np.zeros(30), np.full(30, 3000.0)
    resolutions = (RESOLUTION, RESOLUTION)
    within = paired_test([alike + 0.9 * RESOLUTION, by_chance], [alike, zero], resolutions)
    beyond = paired_test([alike + 50.0, by_chance], [alike, zero], resolutions)
    assert within.p_value == p_of(by_chance, zero), "rounding is no difference, and 30 equal runs are no evidence"
    assert beyond.p_value == p_of(np.append(by_chance, 50.0), np.zeros(31))
    assert beyond.p_value > 0.3


def test_where_no_task_of_a_suite_draws_anything_the_mean_difference_decides():
    alike = np.ones(30)
    small, large = [alike * 0.01, alike * 0.01], [alike * 0.2, alike * 0.2]
    assert paired_test(small, [0 * alike, 0 * alike], (0.02, 0.02)).p_value == 1.0
    assert paired_test(large, [0 * alike, 0 * alike], (0.02, 0.02)).favours == 1


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
