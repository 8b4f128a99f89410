"""Which agents can be told apart: paired tests on shared seeds, corrected for their number, and the tiers they make.

Runs of two agents with the same seed meet the same weather and the same draws of the crop's parameters, so their difference is
judged pair by pair (Wilcoxon signed-rank test). All pairs of a task are corrected together (Holm, 1979). Agents that cannot be told
apart from the best of their tier share its rank.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import stats

from glbench.errors import ResultError
from glbench.leaderboard.resampling import Array

SIGNIFICANCE = 0.05

RESOLUTION = 8.0
"""Difference in a 60-day reward that means something where a task draws nothing.

All runs are alike there and no test can tell chance from skill. But closed loops amplify rounding: kernels that differ in the last
bit spread the reward of the rule-based controller over 6 to 8 units (docs/results.md). Smaller differences count as none.
"""


@dataclass(frozen=True)
class Comparison:
    """Two agents on the same seeds: mean of A minus B, p-value of the paired test, and the same after Holm's correction."""

    first: str
    second: str
    difference: float
    p_value: float
    corrected: float

    @property
    def differ(self) -> bool:
        """Whether they can be told apart at the 5 % level."""
        return self.corrected < SIGNIFICANCE


def paired_p_value(first: Array, second: Array) -> float:
    """Two-sided p-value of the Wilcoxon signed-rank test for paired values ``(n,)``.

    Where all differences are one and the same number (a task that draws nothing) there is no chance to test against: 0 beyond
    ``RESOLUTION``, else 1.

    Raises
    ------
    ResultError
        When the two do not have the same number of runs, or none.
    """
    if first.shape != second.shape or first.size == 0:
        msg = f"A paired test needs the same runs of both agents; got {first.size} and {second.size}."
        raise ResultError(msg)
    difference = first - second
    if np.ptp(difference) == 0.0:
        return 0.0 if abs(difference[0]) > RESOLUTION else 1.0
    return float(stats.wilcoxon(difference, zero_method="wilcox", method="auto").pvalue)


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values corrected for their number, in the order given. Holm (1979), Scandinavian Journal of Statistics 6, 65-70."""
    count = len(p_values)
    corrected = [0.0] * count
    largest = 0.0
    for rank, index in enumerate(sorted(range(count), key=lambda i: p_values[i])):
        largest = max(largest, min(1.0, (count - rank) * p_values[index]))
        corrected[index] = largest
    return corrected


def compare_all(scores: Mapping[str, Array]) -> tuple[Comparison, ...]:
    """Every pair of agents, from their run values ``(n,)`` in the order of the same seeds.

    Raises
    ------
    ResultError
        When the agents do not all have the same number of runs.
    """
    pairs = list(combinations(sorted(scores), 2))
    raw = [paired_p_value(scores[a], scores[b]) for a, b in pairs]
    return tuple(
        Comparison(a, b, float((scores[a] - scores[b]).mean()), p, corrected)
        for (a, b), p, corrected in zip(pairs, raw, holm(raw), strict=True)
    )


def tiers(scores: Mapping[str, Array]) -> tuple[tuple[str, ...], ...]:
    """Agents in tiers, best first: those that cannot be told apart from the first of their tier.

    Within a tier agents stand by their mean; equal means by name.

    Raises
    ------
    ResultError
        When the agents do not all have the same number of runs.
    """
    if not scores:
        return ()
    told_apart = {frozenset((one.first, one.second)) for one in compare_all(scores) if one.differ}
    order = sorted(scores, key=lambda agent: (-float(scores[agent].mean()), agent))
    found: list[list[str]] = []
    for agent in order:
        if found and frozenset((found[-1][0], agent)) not in told_apart:
            found[-1].append(agent)
        else:
            found.append([agent])
    return tuple(tuple(tier) for tier in found)
