"""Paired tests of the means in the tables, and tiers of agents that cannot be told apart.

Runs of two agents with the same seed have the same weather and the same draws of the crop's parameters, so agents are compared run by run;
several trainings of a recipe are a second source of variance. The test is of the number that ranks: the
difference of the two means (over several tasks, of the means over tasks), divided by its standard error, against Student's t
(``statistics.estimate_difference``). Each pair of agents is told apart by mistake in at most 5 % of cases. P-values of all pairs of a table
are corrected together (Benjamini and Hochberg, 1995, J. R. Stat. Soc. B 57, 289-300; for all pairs of a set Williams, Jones and Tukey,
1999, J. Educ. Behav. Stat. 24, 42-69): of the pairs that are told apart, at most 5 % are expected to be mistakes; if all agents are
equally good, about 5 % of tables tell some pair apart. Agents that cannot be told apart from the first of their tier share its rank.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from glbench.leaderboard.statistics import Array, MeanEstimate, draws_nothing, estimate_difference

SIGNIFICANCE = 0.05

RESOLUTION = 8.0
"""Difference in a 60-day reward that means something where a task draws nothing.

All runs are alike there and no test can tell chance from skill. But closed loops amplify rounding: kernels that differ in the last
bit spread the reward of the rule-based controller over 6 to 8 units (docs/results.md). Smaller differences count as none.
"""


@dataclass(frozen=True)
class PairedTest:
    """The difference of two means, first minus second, with its standard error, and the two-sided p-value of no difference."""

    difference: MeanEstimate
    p_value: float


def paired_test(
    first: Sequence[Array],
    second: Sequence[Array],
    resolutions: Sequence[float] | None = None,
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    fixed: tuple[bool, bool] = (False, False),
) -> PairedTest:
    """Test whether two agents have the same mean over tasks of the mean over trainings and runs.

    Two agents are told apart at the 5 % level when ``p_value`` is below 0.05, which happens in at most 5 % of cases (6 % at few
    trainings that differ much) when their true means are equal. See ``estimate_difference`` for what varies, and what is assumed of an
    agent with a single training.

    If all differences on a task are the same number, the task draws nothing: its runs are a single observation, and a
    difference within its resolution counts as 0. If no task draws anything and trainings do not differ, there is no variance to
    test against: the p-value is 1 for no difference, else 0. From a single run the p-value is 1.

    Parameters
    ----------
    first, second
        Values of the two agents by task, ``(n,)`` or ``(trainings, n)``, in the order of the same seeds.
    resolutions
        For each task, the difference that rounding can cause if the task draws nothing, in the unit of the values; default ``RESOLUTION``.
    scenarios
        For each task, a name for each run; runs of different tasks with the same name have the same draws. ``None``: all draws differ.
    fixed
        For each agent, whether it was not trained, so that it has no variance between trainings.

    Raises
    ------
    ResultError
        When the two do not have the same runs, or none.
    """
    difference = estimate_difference(first, second, scenarios, fixed)
    tested = difference.value
    for x, y, resolution in zip(first, second, resolutions or (RESOLUTION,) * len(first), strict=True):
        ours, theirs = np.atleast_2d(x), np.atleast_2d(y)
        gaps = ours.mean(axis=0) - theirs.mean(axis=0)
        if draws_nothing(gaps, float(max(np.abs(ours).max(), np.abs(theirs).max()))) and abs(gaps[0]) <= resolution:
            tested -= float(gaps.mean()) / len(first)
    agree = tested * difference.value > 0.0
    return PairedTest(difference, difference.p_value(tested) if agree else 1.0)


def corrected(p_values: Sequence[float]) -> list[float]:
    """P-values corrected for their number (Benjamini and Hochberg 1995), in the given order; none is below its original."""
    values = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(-values, kind="stable")
    scaled = values[order] * (values.size / np.arange(values.size, 0, -1))
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.minimum.accumulate(scaled), 1.0)
    return [float(one) for one in adjusted]


def pairs_apart(
    scores: Mapping[str, Sequence[Array]],
    resolutions: Sequence[float] | None = None,
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    fixed: Collection[str] = (),
) -> set[frozenset[str]]:
    """The pairs of agents that can be told apart, from their values as in ``paired_test``, corrected for the number of pairs.

    ``fixed`` names agents that were not trained.

    Raises
    ------
    ResultError
        When the agents do not all have the same runs.
    """
    pairs = list(combinations(sorted(scores), 2))
    tests = [paired_test(scores[a], scores[b], resolutions, scenarios, (a in fixed, b in fixed)) for a, b in pairs]
    p_values = corrected([one.p_value for one in tests])
    return {frozenset(pair) for pair, p in zip(pairs, p_values, strict=True) if p < SIGNIFICANCE}


def tiers(
    scores: Mapping[str, Sequence[Array]],
    resolutions: Sequence[float] | None = None,
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    fixed: Collection[str] = (),
) -> tuple[tuple[str, ...], ...]:
    """Agents in tiers, best first: those that cannot be told apart from the first of their tier; arguments as for ``pairs_apart``.

    Within a tier agents stand by their mean; equal means by name. "Cannot be told apart" is not transitive: neighbours of different
    tiers may be hard to tell apart, and only the first of a tier is sure to be told apart from the first of the tier above.

    Raises
    ------
    ResultError
        When the agents do not all have the same runs.
    """
    if not scores:
        return ()
    apart = pairs_apart(scores, resolutions, scenarios, fixed)
    means = {agent: float(np.mean([np.mean(one) for one in values])) for agent, values in scores.items()}
    found: list[list[str]] = []
    for agent in sorted(scores, key=lambda agent: (-means[agent], agent)):
        if found and frozenset((found[-1][0], agent)) not in apart:
            found[-1].append(agent)
        else:
            found.append([agent])
    return tuple(tuple(tier) for tier in found)
