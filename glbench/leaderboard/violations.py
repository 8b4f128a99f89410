"""What conclusions hang on the price of violations: orders at other prices, where two agents change places, and who is not beaten.

The score of a task in money is the profit minus what violations of the limits cost, so at ``factor`` times their price a run scores
``reward - (factor - 1) * penalty``. Results hold both, and nothing is simulated. Agents act as they were made for the task's price; one
that was made for another price would act otherwise.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence
from typing import TypeAlias

import numpy as np
from pydantic import Field

from glbench.leaderboard import statistics
from glbench.leaderboard.regret import PENALTY, PROFIT
from glbench.leaderboard.statistics import Array, FrozenModel

FACTORS = (0.5, 1.0, 2.0)
"""Multiples of the price of violations at which orders are shown."""
Values: TypeAlias = Mapping[str, Sequence[Array]]
"""By agent, ``(n,)`` or ``(trainings, n)`` for each task."""


class AtPrice(FrozenModel):
    """Rank and score of an agent at another price of violations."""

    factor: float = Field(description="multiple of the task's price of violations")
    rank: int | None = Field(description="shared by agents that cannot be told apart at this price; null when not ranked")
    mean: float = Field(description="mean score at this price [EUR m-2]")


class Turn(FrozenModel):
    """Two agents that rank differently, and change places at another price of violations."""

    first: str = Field(description="has the higher mean at the task's price")
    second: str
    factor: float = Field(description="multiple of the task's price of violations at which their means are equal")


def scores_at(rewards: Sequence[Array], penalties: Sequence[Array], factor: float) -> list[Array]:
    """Scores of each task at ``factor`` times its price of violations, in the shape and unit of ``rewards``; at 1 the same bits."""
    return [reward - (factor - 1.0) * penalty for reward, penalty in zip(rewards, penalties, strict=True)]


def at_prices(
    rewards: Values,
    penalties: Values,
    order: Sequence[Sequence[str]],
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    fixed: Collection[str] = (),
) -> dict[str, tuple[AtPrice, ...]]:
    """Ranks and means of agents at ``FACTORS`` times the prices of violations [EUR m-2].

    Parameters
    ----------
    rewards, penalties
        Values of the agents in money, for the same tasks and runs.
    order
        Tiers of the agents by ``rewards``.
    scenarios, fixed
        As in ``statistics.tiers``.
    """
    found: dict[str, list[AtPrice]] = {agent: [] for agent in rewards}
    for factor in FACTORS:
        scores = {agent: scores_at(values, penalties[agent], factor) for agent, values in rewards.items()}
        exact = [0.0] * len(next(iter(scores.values()), ()))  # money has no resolution
        of_agents = ranks_of(order if factor == 1.0 else statistics.tiers(scores, exact, scenarios, fixed))
        for agent, values in scores.items():
            found[agent].append(AtPrice(factor=factor, rank=of_agents[agent], mean=mean_over_tasks(values)))
    return {agent: tuple(places) for agent, places in found.items()}


def ranks_of(order: Sequence[Sequence[str]]) -> dict[str, int]:
    """Rank of every agent in tiers: one more than the number of agents in the tiers above."""
    return {agent: 1 + sum(map(len, order[:place])) for place, tier in enumerate(order) for agent in tier}


def mean_over_tasks(values: Sequence[Array]) -> float:
    """Mean over tasks of the mean over trainings and runs."""
    return float(np.mean([one.mean() for one in values]))


def turns_of(rewards: Values, penalties: Values, ranks: Mapping[str, int]) -> tuple[Turn, ...]:
    """Agents of different ranks whose means change places within ``FACTORS``: the best first, then whose order turns near the task's price.

    With d the difference of the mean rewards and v that of the mean penalties, the means are equal at ``1 + d / v`` times the price.
    """
    means = {agent: (mean_over_tasks(values), mean_over_tasks(penalties[agent])) for agent, values in rewards.items()}
    ordered = sorted(means, key=lambda agent: (-means[agent][0], agent))
    turns = []
    for place, first in enumerate(ordered):
        for second in ordered[place + 1 :]:
            gap, more = means[first][0] - means[second][0], means[first][1] - means[second][1]
            if ranks[first] == ranks[second] or more == 0.0:
                continue
            factor = 1.0 + gap / more
            if FACTORS[0] <= factor <= FACTORS[-1]:
                turns.append(Turn(first=first, second=second, factor=factor))
    return tuple(sorted(turns, key=lambda turn: (ranks[turn.first], abs(np.log(turn.factor)))))


def frontier(means: Mapping[str, Mapping[str, float]]) -> dict[str, bool]:
    """Of each agent, by its mean metrics, whether no other has at least its profit with at most its violations, and one of them better."""
    points = {agent: (of[PROFIT], -of[PENALTY]) for agent, of in means.items()}
    return {
        agent: not any(other != point and other[0] >= point[0] and other[1] >= point[1] for other in points.values())
        for agent, point in points.items()
    }
