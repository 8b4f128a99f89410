"""Estimates over runs: mean, interquartile mean and intervals of a metric, for a row of a table."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from pydantic import Field

from glbench.evaluation import Result
from glbench.leaderboard.statistics import (
    Array,
    Ends,
    Interval,
    Published,
    bootstrap_interval,
    estimate_mean,
    interquartile_mean,
    worst_tenth,
)


class Estimate(Published):
    """A metric of one entry on one task, over the task's runs, in the unit that ``units`` names."""

    mean: float = Field(description="arithmetic mean over the runs; of several trainings the mean over them")
    iqm: float = Field(description="mean of the middle half of the runs; of several trainings the mean over them")
    low: float = Field(
        description="lower end of the 95 % interval of the mean (Student's t, over runs); of several trainings the lowest of their means"
    )
    high: float = Field(description="upper end of it; of several trainings the highest of their means")
    deviation: float | None = Field(
        default=None, description="of several trainings: standard deviation of their means (n - 1)"
    )
    overall: Ends | None = Field(
        default=None,
        description="of several trainings: 95 % interval of the mean over trainings and runs (Student's t, crossed); else null",
    )


def estimate(values: Iterable[float]) -> Estimate:
    """Mean, interquartile mean and 95 % interval of one metric over runs."""
    sample = np.fromiter(values, dtype=np.float64)
    interval = estimate_mean([sample]).interval()
    return Estimate(mean=interval.value, iqm=float(interquartile_mean(sample)), low=interval.low, high=interval.high)


def estimates_of(result: Result) -> dict[str, Estimate]:
    """Estimates of every metric that all runs of ``result`` hold."""
    names = [name for name in result.runs[0].metrics if all(name in run.metrics for run in result.runs)]
    return {name: estimate(result.values(name)) for name in names}


def estimate_over_trainings(values: Array) -> Estimate:
    """Mean over trainings of values ``(trainings, n)``, the lowest and highest training, and the interval over trainings and runs.

    For one training, the ``estimate`` over its runs.
    """
    if len(values) == 1:
        return estimate(values[0])
    means, interval = values.mean(axis=1), estimate_mean([values]).interval()
    return Estimate(
        mean=interval.value,
        iqm=float(interquartile_mean(values).mean()),
        low=float(means.min()),
        high=float(means.max()),
        deviation=float(means.std(ddof=1)),
        overall=Ends(low=interval.low, high=interval.high),
    )


def worst_of(values: Array) -> Interval:
    """The worst tenth of the runs ``(n,)`` with its interval; of several trainings ``(trainings, n)`` as ``worst_tenth`` of a row."""
    trainings = np.atleast_2d(values)
    found = worst_tenth(trainings)
    if len(trainings) > 1:
        return Interval(value=float(found.mean()), low=float(found.min()), high=float(found.max()))
    low, high = bootstrap_interval(trainings[0], worst_tenth)
    return Interval(value=float(found[0]), low=low, high=high)
