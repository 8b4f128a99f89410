"""The signed-rank test by hand, by going through all signs, and against scipy."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy import stats

from glbench.leaderboard.comparisons import EXACT_UP_TO, signed_rank


def by_all_signs(differences: np.ndarray) -> float:
    known = differences[differences != 0.0]
    ranks = stats.rankdata(np.abs(known))
    centre = ranks.sum() / 2
    observed = abs(ranks[known > 0].sum() - centre)
    sums = [abs((ranks * np.array(signs)).sum() - centre) for signs in product([0, 1], repeat=known.size)]
    return sum(one >= observed - 1e-9 for one in sums) / len(sums)


def test_by_hand():
    # ranks 1 2 3, all above: 1 of 8 sums is as large, doubled
    assert signed_rank(np.array([1.0, 2.0, 3.0])).p_value == 0.25
    assert signed_rank(np.array([1.0, 2.0, 3.0])).favours == 1
    assert signed_rank(np.array([-1.0, -2.0, 3.0])).favours == 0
    assert signed_rank(np.zeros(4)).p_value == 1.0


@pytest.mark.parametrize("seed", range(8))
def test_ties_and_pairs_without_a_difference_are_judged_exactly(seed):
    differences = np.random.default_rng(seed).integers(-3, 5, 12).astype(float)
    assert signed_rank(differences).p_value == pytest.approx(by_all_signs(differences), abs=1e-14)


@pytest.mark.parametrize("size", [5, 30, 50])
def test_without_ties_it_is_the_exact_test_of_scipy(size):
    differences = np.random.default_rng(size).normal(0.2, 1.0, size)
    expected = stats.wilcoxon(differences, method="exact").pvalue
    assert signed_rank(differences).p_value == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_of_many_pairs_it_is_the_normal_approximation_of_scipy(step):
    differences = np.random.default_rng(3).normal(0.05, 1.0, 210)
    if step:
        differences = np.round(differences / step) * step
    expected = stats.wilcoxon(differences, zero_method="wilcox", correction=False, method="asymptotic").pvalue
    assert signed_rank(differences).p_value == pytest.approx(expected, rel=1e-9)


def test_where_the_approximation_takes_over_it_is_close_to_exact():
    for size in (EXACT_UP_TO, EXACT_UP_TO + 1):
        differences = np.random.default_rng(size).normal(0.25, 1.0, size)
        expected = stats.wilcoxon(differences, method="exact").pvalue
        assert signed_rank(differences).p_value == pytest.approx(expected, abs=2e-3)
