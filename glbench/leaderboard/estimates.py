"""Estimates over runs: mean, interquartile mean and intervals of a metric, for a row of a table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from pydantic import Field

from glbench.evaluation import Result
from glbench.leaderboard.statistics import (
    Array,
    Ends,
    Interval,
    Published,
    bootstrap_interval,
    crossed_interval,
    interquartile_mean,
    mean,
    worst_tenth,
)


class Estimate(Published):
    """A metric of one entry on one task, over the task's runs, in the unit that ``units`` names."""

    mean: float = Field(description="arithmetic mean over the runs; of several trainings the mean over them")
    iqm: float = Field(description="mean of the middle half of the runs; of several trainings the mean over them")
    low: float = Field(
        description="lower end of the 95 % bootstrap interval of the mean; of several trainings the lowest of their means"
    )
    high: float = Field(description="upper end of it; of several trainings the highest of their means")
    deviation: float | None = Field(
        default=None, description="of several trainings: standard deviation of their means (n - 1)"
    )
    overall: Ends | None = Field(
        default=None,
        description="95 % bootstrap interval of the mean over all that was drawn: groups of runs, where runs fall into groups, and "
        "trainings, where there are several; null where runs are all there is",
    )


def estimate(values: Iterable[float], clusters: Sequence[str] | None = None) -> Estimate:
    """Mean, interquartile mean and 95 % interval of one metric over runs, and over the groups (``clusters``) that they fall into."""
    sample = np.fromiter(values, dtype=np.float64)
    low, high = bootstrap_interval(sample)
    overall = None if groups_of(clusters) < 2 else _ends(bootstrap_interval(sample, clusters=clusters))
    center = float(mean(sample))
    return Estimate(mean=center, iqm=float(interquartile_mean(sample)), low=low, high=high, overall=overall)


def groups_of(clusters: Sequence[str] | None) -> int:
    """How many groups runs fall into; 0 where they name none."""
    return len(set(clusters or ()))


def _ends(interval: tuple[float, float]) -> Ends:
    return Ends(low=interval[0], high=interval[1])


def estimates_of(result: Result) -> dict[str, Estimate]:
    """Estimates of every metric that all runs of ``result`` hold."""
    names = [name for name in result.runs[0].metrics if all(name in run.metrics for run in result.runs)]
    return {name: estimate(result.values(name), result.clusters) for name in names}


def estimate_over_trainings(
    trainings: Sequence[Estimate], values: Array | None = None, clusters: Sequence[str] | None = None
) -> Estimate:
    """Mean over trainings, with the lowest and the highest of them; of one training its own estimate with its interval.

    With the ``values`` ``(trainings, n)`` of the runs, and the groups that these fall into, it has an overall interval, too.
    """
    if len(trainings) == 1:
        return trainings[0]
    grouped = clusters if groups_of(clusters) > 1 else None
    means = [one.mean for one in trainings]
    return Estimate(
        mean=float(np.mean(means)),
        iqm=float(np.mean([one.iqm for one in trainings])),
        low=min(means),
        high=max(means),
        deviation=float(np.std(means, ddof=1)),
        overall=None if values is None else _ends(crossed_interval(values, clusters=grouped)),
    )


def worst_of(values: Array) -> Interval:
    """The worst tenth of the runs ``(n,)`` with its interval; of several trainings ``(trainings, n)`` as ``worst_tenth`` of a row."""
    trainings = np.atleast_2d(values)
    found = worst_tenth(trainings)
    if len(trainings) > 1:
        return Interval(value=float(found.mean()), low=float(found.min()), high=float(found.max()))
    low, high = bootstrap_interval(trainings[0], worst_tenth)
    return Interval(value=float(found[0]), low=low, high=high)
