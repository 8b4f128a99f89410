"""Statistics over runs and tasks: means, normalised scores, bootstrap intervals, profiles. Pure functions of their arguments.

The estimators are those that Agarwal et al. (2021, "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 34)
recommend for few runs. Rewards of different tasks cannot be averaged as they are: a run's normalised score is 0 for what doing nothing
earns on the task and 1 for the best result known there (``tasks/references.toml``).

The resampling indices come from the raw output of a PCG64 generator, whose stream numpy guarantees, so an interval has the same bits
with every numpy version. Runs are drawn with replacement within their task (stratified): tasks are fixed, runs are chance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from scipy import stats

from glbench.errors import ResultError

Array: TypeAlias = NDArray[np.float64]
Values: TypeAlias = Sequence[float] | Array
Statistic: TypeAlias = Callable[[Array], Array]

RESAMPLES = 10_000
CONFIDENCE = 0.95
QUARTER = 0.25
TARGET = 1.0
"""The normalised score that the optimality gap is measured from: the best known result."""


class Published(BaseModel):
    """Base of what ``leaderboard.json`` is made of: frozen, and described by ``docs/schema/leaderboard.schema.json``."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Interval(Published):
    """An estimate with its 95 % stratified bootstrap interval over runs; where a task has several trainings, with the range over them."""

    value: float
    low: float
    high: float


class Profile(Published):
    """Share of an agent's runs with a normalised score above each threshold, with pointwise 95 % bands."""

    agent: str
    thresholds: tuple[float, ...]
    share: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


def mean(values: Array) -> Array:
    """Arithmetic mean along the last axis, shape ``(..., n)`` to ``(...)``, in the unit of ``values``."""
    return np.asarray(np.mean(values, axis=-1), dtype=np.float64)


def interquartile_mean(values: Array) -> Array:
    """Mean of the middle half along the last axis, shape ``(..., n)`` to ``(...)``.

    The ``floor(n/4)`` smallest and largest values are left out, as in Agarwal et al. (2021): of 30 runs the middle 16 count.
    """
    return np.asarray(stats.trim_mean(values, proportiontocut=QUARTER, axis=-1), dtype=np.float64)


def resampling_indices(size: int, resamples: int, seed: int) -> NDArray[np.intp]:
    """Indices ``(resamples, size)`` in ``[0, size)`` from the upper 32 bits of PCG64's raw 64-bit words (multiply and shift)."""
    raw = np.random.PCG64(seed).random_raw(resamples * size) >> np.uint64(32)
    return ((raw * np.uint64(size)) >> np.uint64(32)).astype(np.intp).reshape(resamples, size)


def resampled(strata: Sequence[Array], resamples: int = RESAMPLES, seed: int = 0) -> list[Array]:
    """Each stratum drawn anew: arrays ``(n_i,)`` to arrays ``(resamples, n_i)``, independently of one another."""
    return [
        stratum[resampling_indices(stratum.size, resamples, seed + number)] for number, stratum in enumerate(strata)
    ]


def bootstrap_interval(
    values: Values,
    statistic: Statistic = mean,
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[float, float]:
    """Percentile bootstrap interval of ``statistic`` over runs.

    Parameters
    ----------
    values
        One value a run, shape ``(n,)``, n >= 1, finite.
    statistic
        Function that maps ``(resamples, n)`` to ``(resamples,)``: ``mean`` or ``interquartile_mean``.
    confidence, resamples, seed
        Coverage between 0 and 1, number of samples drawn with replacement, seed of the resampling; the same seed gives the same bits.

    Returns
    -------
    tuple of float
        Lower and upper end, in the unit of ``values``. With one run, or with equal values, both ends are that value.

    Raises
    ------
    ResultError
        When there are no values, a value is not finite, or ``confidence`` is not between 0 and 1.
    """
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        msg = f"Statistics need a one-dimensional, non-empty list of values; got shape {sample.shape}."
        raise ResultError(msg)
    if not np.isfinite(sample).all():
        first = int(np.flatnonzero(~np.isfinite(sample))[0])
        msg = f"Statistics need finite values; value {first} is {sample[first]}."
        raise ResultError(msg)
    return stratified_interval(
        [sample], lambda drawn: statistic(drawn[0]), confidence=confidence, resamples=resamples, seed=seed
    )


def stratified_interval(
    strata: Sequence[Array],
    statistic: Callable[[Sequence[Array]], Array],
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[float, float]:
    """``bootstrap_interval`` over several tasks: one array of run values ``(n_i,)`` a task, and a statistic of all of them.

    Raises
    ------
    ResultError
        When there is no task, a task has no runs, or ``confidence`` is not between 0 and 1.
    """
    if not strata or any(stratum.size == 0 for stratum in strata):
        msg = "An interval over tasks needs at least one task, and runs in each of them."
        raise ResultError(msg)
    if not 0.0 < confidence < 1.0:
        msg = f"The confidence of an interval lies between 0 and 1; got {confidence}."
        raise ResultError(msg)
    if resamples < 1:
        msg = f"A bootstrap needs at least one resample; got {resamples}."
        raise ResultError(msg)
    low, high = _ends(statistic(resampled(strata, resamples, seed)), confidence)
    return float(low), float(high)


def _ends(drawn: Array, confidence: float = CONFIDENCE) -> Array:
    """Lower and upper percentile of resampled statistics along the first axis."""
    tail = 100.0 * (1.0 - confidence) / 2.0
    return np.asarray(np.percentile(drawn, [tail, 100.0 - tail], axis=0), dtype=np.float64)


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
    return interquartile_mean(np.concatenate(list(tasks), axis=-1))


def optimality_gap(tasks: Sequence[Array]) -> Array:
    """How far runs stay below ``TARGET`` on average; runs above it count as the target itself."""
    return mean_score([TARGET - np.minimum(runs, TARGET) for runs in tasks])


Score = Literal["iqm", "mean", "median", "optimality_gap"]
SCORES: Mapping[Score, Callable[[Sequence[Array]], Array]] = {
    "iqm": interquartile_mean_score,
    "mean": mean_score,
    "median": median_score,
    "optimality_gap": optimality_gap,
}


def aggregate(tasks: Sequence[Array], score: Score, *, resamples: int = RESAMPLES, seed: int = 0) -> Interval:
    """A score over tasks, from one array of normalised scores ``(n_i,)`` or ``(trainings_i, n_i)`` a task.

    Where a task has several trainings, the ends are what the lowest and the highest training of each task make; else they are those of
    the 95 % interval over the runs.

    Raises
    ------
    ResultError
        When there is no task, or a task without runs.
    """
    statistic, by_training, together = SCORES[score], [np.atleast_2d(runs) for runs in tasks], pooled(tasks)
    if any(len(runs) > 1 for runs in by_training):
        lowest = [runs[runs.mean(axis=1).argmin()] for runs in by_training]
        highest = [runs[runs.mean(axis=1).argmax()] for runs in by_training]
        low, high = sorted(float(statistic(which)) for which in (lowest, highest))
    else:
        low, high = stratified_interval(together, statistic, resamples=resamples, seed=seed)
    return Interval(value=float(statistic(together)), low=low, high=high)


def pooled(tasks: Sequence[Array]) -> list[Array]:
    """Runs of all trainings of a task together: ``(trainings_i, n_i)`` to ``(trainings_i * n_i,)``."""
    return [runs.ravel() for runs in tasks]


def performance_profile(
    agent: str, tasks: Sequence[Array], thresholds: Array, *, resamples: int = 2_000, seed: int = 0
) -> Profile:
    """Share of runs above each threshold, averaged over tasks, with pointwise 95 % bands.

    Raises
    ------
    ResultError
        When there is no task, or a task without runs.
    """
    if not tasks or any(runs.size == 0 for runs in tasks):
        msg = "A performance profile needs at least one task, and runs in each of them."
        raise ResultError(msg)
    above = [(runs[:, None] > thresholds).astype(np.float64) for runs in tasks]
    again = [(_times_drawn(one.shape[0], resamples, seed + i) @ one) / one.shape[0] for i, one in enumerate(above)]
    low, high = _ends(np.asarray(np.mean(again, axis=0)))
    lines = (thresholds, np.mean([one.mean(axis=0) for one in above], axis=0), low, high)
    x, share, lower, upper = (tuple(map(float, line)) for line in lines)
    return Profile(agent=agent, thresholds=x, share=share, low=lower, high=upper)


def probability_of_improvement(
    ours: Mapping[str, Array], theirs: Mapping[str, Array], *, resamples: int = 2_000, seed: int = 0
) -> Interval:
    """Probability that a run of one agent scores above a run of another, averaged over their common tasks.

    Equal scores count half, as in the Mann-Whitney statistic. Runs are resampled within tasks, both agents independently. ``ours`` and
    ``theirs`` are run values ``(n,)`` by task, in any unit that orders them.

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
        difference = x[:, None] - y[None, :]
        above = (difference > 0.0) + 0.5 * (difference == 0.0)
        values.append(above.mean())
        drawn_x = _times_drawn(x.size, resamples, seed + number)
        drawn_y = _times_drawn(y.size, resamples, seed + len(common) + number)
        again.append(((drawn_x @ above) * drawn_y).sum(axis=-1) / above.size)
    low, high = _ends(np.asarray(np.mean(again, axis=0)))
    return Interval(value=float(np.mean(values)), low=float(low), high=float(high))


def _times_drawn(size: int, resamples: int, seed: int) -> Array:
    """How often each run is in each resample ``(resamples, size)``: pairs of resampled runs are then counted, not gone through."""
    indices = resampling_indices(size, resamples, seed) + size * np.arange(resamples)[:, None]
    return np.bincount(indices.ravel(), minlength=resamples * size).reshape(resamples, size).astype(np.float64)
