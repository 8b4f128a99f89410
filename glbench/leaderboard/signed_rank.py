"""The Wilcoxon signed-rank test of paired differences (Wilcoxon 1945), exact for as many pairs as a task has runs.

Own code, so that a p-value has the same bits with every version of scipy, and ties (runs that failed alike) are judged exactly, too.
Pairs without a difference say nothing and are left out, as Wilcoxon did.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import stats

from glbench.leaderboard.resampling import Array

EXACT_UP_TO = 60
"""Number of differing pairs up to which all signs are gone through; beyond, the normal approximation is as good as exact."""


@dataclass(frozen=True)
class SignedRank:
    """Two-sided p-value, and which side the ranks favour: 1 above zero, -1 below, 0 neither."""

    p_value: float
    favours: int


def signed_rank(differences: Array) -> SignedRank:
    """Test whether paired differences ``(n,)`` lie as often and as far above zero as below."""
    known = differences[differences != 0.0]
    if known.size == 0:
        return SignedRank(1.0, 0)
    # Twice the ranks, so that ranks shared by ties are whole numbers, too.
    ranks = np.rint(2.0 * stats.rankdata(np.abs(known))).astype(np.int64)
    above, total = int(ranks[known > 0.0].sum()), int(ranks.sum())
    favours = (2 * above > total) - (2 * above < total)
    tail = min(above, total - above)
    p_value = _exact(ranks, tail) if known.size <= EXACT_UP_TO else _normal(ranks, tail)
    return SignedRank(min(1.0, 2.0 * p_value), favours)


def _exact(ranks: np.ndarray, tail: int) -> float:
    """Probability that the ranks above zero sum up to at most ``tail`` when every sign is a coin's."""
    chance = np.zeros(int(ranks.sum()) + 1)
    chance[0] = 1.0
    for rank in ranks.tolist():
        shifted = np.zeros_like(chance)
        shifted[rank:] = chance[:-rank]
        chance = 0.5 * chance + 0.5 * shifted
    return float(chance[: tail + 1].sum())


def _normal(ranks: np.ndarray, tail: int) -> float:
    """The same by the normal approximation; the sum of squares holds the correction for ties."""
    deviation = 0.5 * math.sqrt(float((ranks.astype(np.float64) ** 2).sum()))
    z = (tail - 0.5 * float(ranks.sum())) / deviation
    return 0.5 * math.erfc(-z / math.sqrt(2.0))
