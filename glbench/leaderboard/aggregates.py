"""Scores over several tasks: normalised, aggregated, with stratified bootstrap intervals.

Rewards of different tasks cannot be averaged as they are. A run's normalised score is 0 for what doing nothing earns on the task
and 1 for the best result known there; both stand in ``tasks/references.toml``. The aggregates are those of Agarwal et al. (2021, "Deep
reinforcement learning at the edge of the statistical precipice", NeurIPS 34), sections 4 and A.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from glbench.errors import ResultError
from glbench.leaderboard.resampling import CONFIDENCE, RESAMPLES, Array, resampling_indices, stratified_interval
from glbench.leaderboard.statistics import QUARTER

TARGET = 1.0
"""The normalised score that the optimality gap is measured from: the best known result."""


@dataclass(frozen=True)
class Interval:
    """An estimate with its 95 % interval, all in the same unit; of several trainings with the range over them."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Aggregate:
    """One entry over the tasks of a suite, in normalised scores: 0 is doing nothing, 1 the best known result.

    ``trainings`` are the fewest and the most of them on a task. Where a task has several, ``low`` and ``high`` of the scores are what
    the lowest and the highest training of each task make; else they are 95 % intervals over the runs.
    """

    agent: str
    tasks: int
    runs: int
    trainings: tuple[int, int]
    mean: Interval
    median: Interval
    iqm: Interval
    optimality_gap: Interval


@dataclass(frozen=True)
class Profile:
    """Share of runs with a normalised score above each threshold, averaged over tasks; all ``(thresholds,)``."""

    thresholds: Array
    share: Array
    low: Array
    high: Array


def normalise(values: Array, nothing: float, best: float) -> Array:
    """Rewards ``(n,)`` as normalised scores.

    Raises
    ------
    ResultError
        When the best known reward is not above that of doing nothing.
    """
    if not best > nothing:
        msg = f"The best known reward ({best:g}) is not above that of doing nothing ({nothing:g}): scores cannot be normalised."
        raise ResultError(msg)
    return (values - nothing) / (best - nothing)


def mean_score(tasks: Sequence[Array]) -> Array:
    """Mean over tasks of the mean over runs; one array ``(..., n_i)`` a task to ``(...)``."""
    return np.asarray(np.mean([runs.mean(axis=-1) for runs in tasks], axis=0), dtype=np.float64)


def median_score(tasks: Sequence[Array]) -> Array:
    """Median over tasks of the mean over runs."""
    return np.asarray(np.median([runs.mean(axis=-1) for runs in tasks], axis=0), dtype=np.float64)


def interquartile_mean_score(tasks: Sequence[Array]) -> Array:
    """Mean of the middle half of all runs of all tasks."""
    together = np.concatenate(list(tasks), axis=-1)
    return np.asarray(stats.trim_mean(together, proportiontocut=QUARTER, axis=-1), dtype=np.float64)


def optimality_gap(tasks: Sequence[Array]) -> Array:
    """How far runs stay below ``TARGET`` on average; runs above it count as the target itself."""
    return mean_score([TARGET - np.minimum(runs, TARGET) for runs in tasks])


def aggregate(agent: str, tasks: Sequence[Array], *, resamples: int = RESAMPLES, seed: int = 0) -> Aggregate:
    """All aggregates of one entry's normalised scores.

    Parameters
    ----------
    agent
        Name of the entry.
    tasks
        One array ``(n_i,)`` a task, or ``(trainings_i, n_i)``.
    resamples, seed
        Of the bootstrap.

    Raises
    ------
    ResultError
        When there is no task, or a task without runs.
    """
    by_training = [np.atleast_2d(runs) for runs in tasks]
    counts = [len(runs) for runs in by_training] or [0]
    together = pooled(tasks)
    found = {}
    for name, statistic in (
        ("mean", mean_score),
        ("median", median_score),
        ("iqm", interquartile_mean_score),
        ("optimality_gap", optimality_gap),
    ):
        if max(counts) > 1:
            lowest = [runs[runs.mean(axis=1).argmin()] for runs in by_training]
            highest = [runs[runs.mean(axis=1).argmax()] for runs in by_training]
            low, high = sorted(float(statistic(which)) for which in (lowest, highest))
        else:
            low, high = stratified_interval(together, statistic, resamples=resamples, seed=seed)
        found[name] = Interval(float(statistic(together)), low, high)
    return Aggregate(agent, len(tasks), sum(runs.size for runs in together), (min(counts), max(counts)), **found)


def pooled(tasks: Sequence[Array]) -> list[Array]:
    """Runs of all trainings of a task together: ``(trainings_i, n_i)`` to ``(trainings_i * n_i,)``."""
    return [runs.ravel() for runs in tasks]


def performance_profile(tasks: Sequence[Array], thresholds: Array, *, resamples: int = 2_000, seed: int = 0) -> Profile:
    """Share of runs above each threshold, with pointwise 95 % bands.

    Raises
    ------
    ResultError
        When there is no task, or a task without runs.
    """
    if not tasks or any(runs.size == 0 for runs in tasks):
        msg = "A performance profile needs at least one task, and runs in each of them."
        raise ResultError(msg)
    above = [(runs[:, None] > thresholds).astype(np.float64) for runs in tasks]
    again = np.mean(
        [(_times_drawn(one.shape[0], resamples, seed + i) @ one) / one.shape[0] for i, one in enumerate(above)], axis=0
    )
    tail = 100.0 * (1.0 - CONFIDENCE) / 2.0
    low, high = np.percentile(again, [tail, 100.0 - tail], axis=0)
    share = np.mean([one.mean(axis=0) for one in above], axis=0)
    return Profile(np.asarray(thresholds, dtype=np.float64), share, low, high)


def probability_of_improvement(
    ours: Mapping[str, Array], theirs: Mapping[str, Array], *, resamples: int = 2_000, seed: int = 0
) -> Interval:
    """Probability that a run of one agent scores above a run of another, averaged over their common tasks.

    Equal scores count half, as in the Mann-Whitney statistic. Runs are resampled within tasks, both agents independently.

    Parameters
    ----------
    ours, theirs
        Run values ``(n,)`` by task, in any unit that orders them.

    Raises
    ------
    ResultError
        When the agents have no task in common.
    """
    common = sorted(set(ours) & set(theirs))
    if not common:
        msg = "The two agents have no task in common, so neither can be said to improve on the other."
        raise ResultError(msg)
    values, again = [], []
    for number, task in enumerate(common):
        x, y = ours[task], theirs[task]
        above = _above(x, y)
        values.append(above.mean())
        drawn_x = _times_drawn(x.size, resamples, seed + number)
        drawn_y = _times_drawn(y.size, resamples, seed + len(common) + number)
        again.append(((drawn_x @ above) * drawn_y).sum(axis=-1) / above.size)
    tail = 100.0 * (1.0 - CONFIDENCE) / 2.0
    low, high = np.percentile(np.mean(again, axis=0), [tail, 100.0 - tail])
    return Interval(float(np.mean(values)), float(low), float(high))


def _above(x: Array, y: Array) -> Array:
    """1 where a run of x is above a run of y, ties half: ``(n,)`` and ``(m,)`` to ``(n, m)``."""
    difference = x[:, None] - y[None, :]
    return np.asarray((difference > 0.0) + 0.5 * (difference == 0.0), dtype=np.float64)


def _times_drawn(size: int, resamples: int, seed: int) -> Array:
    """How often each run is in each resample ``(resamples, size)``: pairs of resampled runs are then counted, not gone through."""
    indices = resampling_indices(size, resamples, seed) + size * np.arange(resamples)[:, None]
    return np.bincount(indices.ravel(), minlength=resamples * size).reshape(resamples, size).astype(np.float64)
