"""Test whether an agent earns less with fresh draws than with the published ones, compared with reference agents.

Seasons differ, so two sets of draws give two means. Reference agents are evaluated in the same seasons, and the difference from them, run
by run, removes most of that. For an agent that carries nothing, these differences have the same distribution in both sets.
docs/statistics.md has the formula, the error rate and the limits of the test.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from pydantic import Field

from glbench.errors import ResultError, refuse
from glbench.evaluation import Result
from glbench.evaluation.records import FreshDraws
from glbench.leaderboard.catalogue import Metric
from glbench.leaderboard.statistics import Array, FrozenModel

ERROR: Final = 0.001  # Largest probability that an agent is marked that carries nothing
RANK_ERROR: Final = 0.00001
"""The same by the ranks of the runs, which show an agent that spoils a few fresh runs to widen the interval of the mean."""
FEWEST: Final = 5  # Smallest number of runs for a mark


class FreshScore(FrozenModel):
    """Mean of the ranking metric over runs with fresh draws, and the drop compared with reference agents."""

    mean: float = Field(description="mean of the ranking metric with the fresh draws; of several trainings the mean over them")
    drop: float = Field(description="drop from the published to the fresh draws, minus that of the reference agent 'reference'")
    low: float | None = Field(
        description="lower end of the one-sided 99.9 % interval of the drop, or of that by ranks if only this one is above the margin; "
        "null with too few runs"
    )
    margin: float = Field(description="largest difference between the drops of two reference agents")
    reference: str = Field(description="the reference agent with the smallest lower end")
    failed: int = Field(description="runs with fresh draws that failed; of several trainings those of the one that dropped most")
    marked: bool = Field(description="whether the lower end is above the margin for every reference agent")


def fresh_score(result: Result) -> FreshScore | None:
    """Score with fresh draws; ``None`` if the result has none. Raises ``ResultError`` when its numbers are too large or too small."""
    if result.fresh_draws is None:
        return None
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            return _score(result, result.fresh_draws)
    except ArithmeticError as error:
        reason = "has numbers among its fresh draws and reference agents that are too large or too small for the test of a drop"
        refuse(f"The result of {result.agent.name} on {result.task.id} {reason} ({error}).", ResultError, error)


def _score(result: Result, fresh: FreshDraws) -> FreshScore:
    published = np.array(result.values(fresh.metric))
    again = np.array([run.metrics[fresh.metric] for run in fresh.runs])
    references = [(np.array(one.published), np.array(one.fresh)) for one in fresh.references]
    first = drop_beside(*references[0])[0]
    margin = max(abs(drop_beside(*one)[0] - first) for one in references)
    drops = []
    for before, after in references:
        drop, low = drop_beside(published - before, again - after)
        by_ranks = shift_by_ranks(published - before, again - after)
        drops.append((drop, by_ranks if low <= margin < by_ranks else low))
    place = min(range(len(drops)), key=lambda place: drops[place][1])
    drop, low = drops[place]
    too_few_runs = len(published) < FEWEST
    return FreshScore(
        mean=float(again.mean()),
        drop=drop,
        low=None if too_few_runs else low,
        margin=margin,
        reference=fresh.references[place].name,
        failed=sum(run.status != "ok" for run in fresh.runs),
        marked=not too_few_runs and low > margin,
    )


def drop_beside(published: Array, fresh: Array, error: float = ERROR) -> tuple[float, float]:
    """Mean of ``published`` minus that of ``fresh``, and the lower end of its one-sided interval (Welch 1947).

    Both have one value a run, ``(n,)``, of independent runs. ``error`` is the probability that the lower end is above the true difference.
    """
    from scipy import special  # not at the top: most boards have no fresh draws

    drop = float(published.mean() - fresh.mean())
    parts = [float(values.var(ddof=1)) / len(values) if len(values) > 1 else math.inf for values in (published, fresh)]
    if not math.isfinite(sum(parts)):
        return drop, -math.inf
    if sum(parts) == 0.0:
        return drop, drop
    freedom = sum(parts) ** 2 / sum(part**2 / (len(values) - 1) for part, values in zip(parts, (published, fresh), strict=True))
    return drop, drop - float(special.stdtrit(freedom, 1.0 - error)) * math.sqrt(sum(parts))


def shift_by_ranks(published: Array, fresh: Array, error: float = RANK_ERROR) -> float:
    """Lower end of the one-sided interval of the shift between two samples, by the ranks of their values (Hodges and Lehmann 1963).

    Takes what ``drop_beside`` takes. A few runs, whatever they earn, hardly change it. Minus infinity for samples too small for ``error``.
    """
    from scipy import special

    pairs, runs = len(published) * len(fresh), len(published) + len(fresh)
    spread = math.sqrt(pairs * (runs + 1) / 12.0)  # of the statistic of Mann and Whitney
    place = math.floor((pairs - 1.0) / 2.0 - float(special.ndtri(1.0 - error)) * spread)
    return -math.inf if place < 0 else float(np.sort(np.subtract.outer(published, fresh), axis=None)[place])


def fresh_score_over(trainings: Sequence[FreshScore | None]) -> FreshScore | None:
    """Mean over several trainings, with the drop of the one that dropped most.

    ``None`` if one has no fresh draws and no other is marked: a training without fresh draws must not hide a mark.
    """
    scores = [one for one in trainings if one is not None]
    if not scores or (len(scores) < len(trainings) and not any(one.marked for one in scores)):
        return None
    worst = max(scores, key=lambda one: (one.marked, one.drop))
    return worst.model_copy(update={"mean": float(np.mean([one.mean for one in scores]))})


def fresh_note(agent: str, score: FreshScore, metric: Metric) -> str:
    """Why an agent is marked, in words."""
    return (
        f"With fresh draws {agent} drops by {metric.number(score.drop)} more in {metric.words} than {score.reference} in the same seasons, "
        f"by at least {metric.number(score.low or 0.0)}; the drops of reference agents differ by {metric.number(score.margin)}. "
        + (f"{score.failed} of its runs with fresh draws failed." if score.failed else "It may know the published draws.")
    )


def fresh_words(result: Result, metric: Metric) -> str:
    """Sentences on the mean of ``metric`` with fresh draws, and on whether the agent is marked."""
    score = fresh_score(result)
    assert score is not None
    words = f"{metric.phrase(score.mean)}, published {metric.number(result.summary.mean[metric.name])}."
    if score.failed and not score.marked:
        words += f" {score.failed} runs with fresh draws failed."
    if score.marked:
        return f"{words} {fresh_note(result.agent.name, score, metric)}"
    if score.low is None:
        return f"{words} {len(result.runs)} runs are too few to test for a drop."
    return f"{words} Compared with {score.reference} it dropped by {metric.number(score.drop)}, no more than chance explains."
