"""Which agents can be told apart: paired tests on shared seeds, corrected for their number, and the tiers they make.

Runs of two agents with the same seed meet the same weather and the same draws of the crop's parameters, so their difference is
judged pair by pair (Wilcoxon signed-rank test). All pairs of agents are corrected together (Holm, 1979). Two agents are told apart when
the test says so and the ranks favour the one with the higher mean: an agent that is a little better in most runs and fails in some has
the lower mean and the higher ranks, and calling it worse *because of the test* would be wrong. Agents that cannot be told apart from the
first of their tier share its rank.

The signed-rank test is our own code, so that a p-value has the same bits with every version of scipy, and ties (runs that failed alike) are
judged exactly, too: exact for as many pairs as a task has runs. Pairs without a difference say nothing and are left out, as Wilcoxon did.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from glbench.errors import ResultError
from glbench.leaderboard.statistics import Array, mean_score

SIGNIFICANCE = 0.05
EXACT_UP_TO = 60
"""Number of differing pairs up to which all signs are gone through; beyond, the normal approximation is as good as exact."""


RESOLUTION = 8.0
"""Difference in a 60-day reward that means something where a task draws nothing.

All runs are alike there and no test can tell chance from skill. But closed loops amplify rounding: kernels that differ in the last
bit spread the reward of the rule-based controller over 6 to 8 units (docs/results.md). Smaller differences count as none.
"""


def told_apart(p_value: float, favours: int, difference: float) -> bool:
    """Whether a corrected p-value is significant and ranks and mean point the same way."""
    return p_value < SIGNIFICANCE and favours * difference > 0.0


def paired_test(
    first: Sequence[Array], second: Sequence[Array], resolutions: Sequence[float] = (RESOLUTION,)
) -> SignedRank:
    """Signed-rank test of paired values, one array ``(n_i,)`` a task.

    A task on which all differences are one and the same number draws nothing: its runs are one observation and not many, so it
    counts as one pair, and as no difference within its resolution. Where no task draws anything there is no chance to test against:
    the p-value is 0 when the mean difference is beyond the mean resolution, else 1.

    Parameters
    ----------
    first, second
        Values of the two agents by task, in the order of the same seeds.
    resolutions
        For each task the difference that rounding can make where it draws nothing, in the unit of the values.

    Raises
    ------
    ResultError
        When the two do not have the same runs, or none.
    """
    differences = [_difference(x, y) for x, y in zip(first, second, strict=True)]
    drawn = [bool(np.ptp(one) > 0.0) for one in differences]
    if not any(drawn):
        mean, resolution = float(np.mean([one[0] for one in differences])), float(np.mean(resolutions))
        favours = int(mean > resolution) - int(mean < -resolution)
        return SignedRank(0.0 if favours else 1.0, favours)
    pairs = [
        one if by_chance else np.where(np.abs(one[:1]) > resolution, one[:1], 0.0)
        for one, by_chance, resolution in zip(differences, drawn, resolutions, strict=True)
    ]
    return signed_rank(np.concatenate(pairs))


def _difference(first: Array, second: Array) -> Array:
    if first.shape != second.shape or first.size == 0:
        msg = f"A paired test needs the same runs of both agents; got {first.size} and {second.size}."
        raise ResultError(msg)
    return first - second


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values corrected for their number, in the order given. Holm (1979), Scandinavian Journal of Statistics 6, 65-70."""
    count = len(p_values)
    corrected = [0.0] * count
    largest = 0.0
    for rank, index in enumerate(sorted(range(count), key=lambda i: p_values[i])):
        largest = max(largest, min(1.0, (count - rank) * p_values[index]))
        corrected[index] = largest
    return corrected


def pairs_apart(
    scores: Mapping[str, Sequence[Array]], resolutions: Sequence[float] = (RESOLUTION,)
) -> set[frozenset[str]]:
    """The pairs of agents that can be told apart, from their run values: one array ``(n_i,)`` a task, in the order of the same seeds.

    Raises
    ------
    ResultError
        When the agents do not all have the same runs.
    """
    pairs = list(combinations(sorted(scores), 2))
    found = [paired_test(scores[a], scores[b], resolutions) for a, b in pairs]
    means = {agent: float(mean_score(values)) for agent, values in scores.items()}
    corrected = holm([one.p_value for one in found])
    return {
        frozenset((a, b))
        for (a, b), one, p in zip(pairs, found, corrected, strict=True)
        if told_apart(p, one.favours, means[a] - means[b])
    }


def tiers(
    scores: Mapping[str, Sequence[Array]], resolutions: Sequence[float] = (RESOLUTION,)
) -> tuple[tuple[str, ...], ...]:
    """Agents in tiers, best first: those that cannot be told apart from the first of their tier.

    Within a tier agents stand by their mean; equal means by name. "Cannot be told apart" is not transitive: neighbours of different
    tiers may be hard to tell apart, and only the first of a tier is sure to be told apart from the first of the tier above.

    Raises
    ------
    ResultError
        When the agents do not all have the same runs.
    """
    if not scores:
        return ()
    apart = pairs_apart(scores, resolutions)
    order = sorted(scores, key=lambda agent: (-float(mean_score(scores[agent])), agent))
    found: list[list[str]] = []
    for agent in order:
        if found and frozenset((found[-1][0], agent)) not in apart:
            found[-1].append(agent)
        else:
            found.append([agent])
    return tuple(tuple(tier) for tier in found)


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


def _exact(ranks: NDArray[np.int64], tail: int) -> float:
    """Probability that the ranks above zero sum up to at most ``tail`` when every sign is a coin's."""
    chance = np.zeros(int(ranks.sum()) + 1)
    chance[0] = 1.0
    for rank in ranks.tolist():
        shifted = np.zeros_like(chance)
        shifted[rank:] = chance[:-rank]
        chance = 0.5 * chance + 0.5 * shifted
    return float(chance[: tail + 1].sum())


def _normal(ranks: NDArray[np.int64], tail: int) -> float:
    """The same by the normal approximation; the sum of squares holds the correction for ties."""
    deviation = 0.5 * math.sqrt(float((ranks.astype(np.float64) ** 2).sum()))
    z = (tail - 0.5 * float(ranks.sum())) / deviation
    return 0.5 * math.erfc(-z / math.sqrt(2.0))
