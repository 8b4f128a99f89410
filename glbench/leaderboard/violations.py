"""What hangs on the price of violations: ranks at other prices, agents that change places, and who is not beaten at any price.

A score in money is the profit minus what violations of the limits cost, so at ``factor`` times their price a run scores
``reward - (factor - 1) * penalty``. Results hold both, and nothing is simulated: agents act as they were made for the task's price.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Hashable, Mapping, Sequence
from itertools import combinations
from typing import Any, TypeAlias

from pydantic import Field

from glbench.leaderboard.statistics import Array, FrozenModel, mean_score, tiers

FACTORS = (0.5, 1.0, 2.0)
"""Multiples of the price of violations at which ranks are shown."""
Values: TypeAlias = Mapping[str, Sequence[Array]]
"""By agent, ``(n,)`` or ``(trainings, n)`` for each task [EUR m-2]."""


class AtPrice(FrozenModel):
    """Rank and score of an agent at another price of violations."""

    factor: float = Field(description="multiple of the task's price of violations")
    rank: int = Field(description="shared by agents that cannot be told apart at this price")
    mean: float = Field(description="mean score at this price [EUR m-2]")


class Turn(FrozenModel):
    """Two agents of different ranks that change places at another price of violations."""

    first: str = Field(description="has the higher mean at the task's price")
    second: str
    factor: float = Field(description="multiple of the task's price of violations at which their means are equal")


def ranks_of(order: Sequence[Sequence[str]]) -> dict[str, int]:
    """Rank of every agent in tiers: one more than the number of agents in the tiers above."""
    return {agent: 1 + sum(map(len, order[:place])) for place, tier in enumerate(order) for agent in tier}


def at_prices(
    rewards: Values,
    penalties: Values,
    order: Sequence[Sequence[str]],
    privileged: Collection[str] = (),
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    fixed: Collection[str] = (),
) -> tuple[dict[str, dict[str, Any]], tuple[Turn, ...]]:
    """Places of each agent at ``FACTORS`` times the price and on the frontier, and who changes places; nothing if penalties are missing.

    ``order`` are the tiers by ``rewards``; ``scenarios`` and ``fixed`` are as in ``statistics.tiers``. Agents on the frontier are not
    ``privileged``, and no other such agent has at least their profit with at most their violations, and one of them better.
    """
    if not rewards.keys() <= penalties.keys():
        return {}, ()
    ranks, exact = {1.0: ranks_of(order)}, [0.0] * len(next(iter(rewards.values()), ()))  # money has no resolution
    for factor in set(FACTORS) - set(ranks):
        scores = {agent: scores_at(values, penalties[agent], factor) for agent, values in rewards.items()}
        ranks[factor] = ranks_of(tiers(scores, exact, scenarios, fixed))
    means = {agent: [float(mean_score([one.ravel() for one in of[agent]])) for of in (rewards, penalties)] for agent in rewards}
    points = {agent: (reward + penalty, -penalty) for agent, (reward, penalty) in means.items() if agent not in privileged}
    places: dict[str, dict[str, Any]] = {}
    for agent, (reward, penalty) in means.items():
        of_agent = tuple(AtPrice(factor=one, rank=ranks[one][agent], mean=reward - (one - 1.0) * penalty) for one in FACTORS)
        point = points.get(agent)
        beaten = point and any(other != point and other[0] >= point[0] and other[1] >= point[1] for other in points.values())
        places[agent] = {"at_prices": of_agent, "frontier": None if point is None else not beaten}
    return places, _turns(means, ranks[1.0])


def scores_at(rewards: Sequence[Array], penalties: Sequence[Array], factor: float) -> list[Array]:
    """Scores of each task at ``factor`` times its price of violations, in the shape and unit of ``rewards``; at 1 the same bits."""
    return [reward - (factor - 1.0) * penalty for reward, penalty in zip(rewards, penalties, strict=True)]


def _turns(means: Mapping[str, Sequence[float]], ranks: Mapping[str, int]) -> tuple[Turn, ...]:
    """Agents of different ranks that change places within ``FACTORS``: the best first, then those whose order turns near the task's price.

    With d the difference of the mean rewards and v that of the mean penalties, the means are equal at ``1 + d / v`` times the price.
    """
    turns, ordered = [], sorted(means, key=lambda agent: (-means[agent][0], agent))
    for first, second in combinations(ordered, 2):
        gap, more = (one - other for one, other in zip(means[first], means[second], strict=True))
        factor = 1.0 + gap / more if more else math.inf
        if ranks[first] != ranks[second] and FACTORS[0] <= factor <= FACTORS[-1]:
            turns.append(Turn(first=first, second=second, factor=factor))
    return tuple(sorted(turns, key=lambda turn: (ranks[turn.first], abs(math.log(turn.factor)))))
