"""Statistics over runs and tasks: means, normalised scores, bootstrap intervals, profiles. Pure functions of their arguments.

The estimators are those that Agarwal et al. (2021, "Deep reinforcement learning at the edge of the statistical precipice", NeurIPS 34)
recommend for few runs. Rewards of different tasks cannot be averaged as they are: a run's normalised score is 0 for what doing nothing
earns on the task and 1 for the best result known there (``tasks/references.toml``).

Runs that share a season's year, or anything else that moves them alike, are no independent draws: an interval over groups of runs
(``clusters``) resamples whole groups. Several trainings of one recipe are a second source of chance, crossed with the runs.

The resampling indices come from the raw output of a PCG64 generator, whose stream numpy guarantees, so an interval has the same bits
with every numpy version. Runs are drawn with replacement within their task (stratified): tasks are fixed, runs are chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import lru_cache
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
_KEPT = 6
"""Arrays of resampling indices that are kept; one of 100 runs has 8 MB."""
WORST = 10
"""The worst tenth of the runs: ``worst_tenth`` means one in so many."""
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


class Ends(Published):
    """Both ends of a 95 % interval."""

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


def worst_tenth(values: Array) -> Array:
    """Mean of the worst tenth along the last axis (CVaR10), shape ``(..., n)`` to ``(...)``, in the unit of ``values``; low is bad.

    The ``n/10`` smallest values count: where that is not a whole number the last of them with the fraction that is left, so of 25 runs the
    two worst whole and the third by half. Of fewer than ten runs it is the worst one. This is the conditional value at risk of the
    empirical distribution (Rockafellar and Uryasev, 2002, Journal of Banking & Finance 26, 1443-1471).
    """
    size = values.shape[-1]
    count = max(size / WORST, 1.0)
    most = math.ceil(count)
    weights = np.minimum(1.0, count - np.arange(most))
    worst = np.sort(values, axis=-1)[..., :most]
    return np.asarray((worst * weights).sum(axis=-1) / count, dtype=np.float64)


@lru_cache(maxsize=_KEPT)
def resampling_indices(size: int, resamples: int, seed: int) -> NDArray[np.intp]:
    """Indices ``(resamples, size)`` in ``[0, size)`` from the upper 32 bits of PCG64's raw 64-bit words (multiply and shift).

    The array cannot be written to: all metrics of a table are resampled alike, so the last ones are kept.
    """
    raw = np.random.PCG64(seed).random_raw(resamples * size) >> np.uint64(32)
    indices = ((raw * np.uint64(size)) >> np.uint64(32)).astype(np.intp).reshape(resamples, size)
    indices.flags.writeable = False
    return indices


def resampled(strata: Sequence[Array], resamples: int = RESAMPLES, seed: int = 0) -> list[Array]:
    """Each stratum resampled: arrays ``(n_i,)`` to arrays ``(resamples, n_i)``, independently of one another."""
    return [
        stratum[resampling_indices(stratum.size, resamples, seed + number)] for number, stratum in enumerate(strata)
    ]


def bootstrap_interval(
    values: Values,
    statistic: Statistic = mean,
    *,
    clusters: Sequence[Hashable] | None = None,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[float, float]:
    """Bootstrap interval of ``statistic`` over runs, or over groups of runs.

    Without ``clusters`` it is the percentile interval over runs. With them whole groups are drawn with replacement, and the runs of a
    drawn group stay together (Davison and Hinkley, 1997, Bootstrap Methods and their Application, section 3.8). Of G groups the means
    of resamples spread too little, by sqrt((G - 1) / G), so the ends are moved away from the estimate by sqrt(G / (G - 1)). With
    few groups such an interval still covers less than it says; docs/statistics.md has figures.

    Parameters
    ----------
    values
        One value a run, shape ``(n,)``, n >= 1, finite.
    statistic
        Function that maps ``(resamples, n)`` to ``(resamples,)``: ``mean``, ``interquartile_mean`` or ``worst_tenth``.
    clusters
        For each run the group that it belongs to, of which there are at least two; ``None``: runs are independent.
    confidence, resamples, seed
        Coverage between 0 and 1, number of samples drawn with replacement, seed of the resampling; the same seed gives the same bits.

    Returns
    -------
    tuple of float
        Lower and upper end, in the unit of ``values``. With one run, or with equal values, both ends are that value.

    Raises
    ------
    ResultError
        When there are no values, a value is not finite, ``confidence`` is not between 0 and 1, or ``clusters`` are fewer than two or
        not one a run.
    """
    sample = _checked(values)
    if clusters is None:
        return stratified_interval(
            [sample], lambda drawn: statistic(drawn[0]), confidence=confidence, resamples=resamples, seed=seed
        )
    _check_settings(confidence, resamples)
    members = _members(clusters, sample.size)
    center = float(statistic(sample[None, :])[0])
    drawn = _over_clusters(sample, statistic, members, resamples, seed)
    low, high = _ends(_widened(drawn, center, len(members)), confidence)
    return float(low), float(high)


def crossed_interval(
    values: Array,
    statistic: Statistic = mean,
    *,
    clusters: Sequence[Hashable] | None = None,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[float, float]:
    """Bootstrap interval of the mean over trainings of a ``statistic`` of their runs, when both trainings and runs are chance.

    All trainings met the same runs, so both are drawn with replacement, independently: runs (or ``clusters`` of them) once for all
    trainings, and trainings. What the drawing of T trainings adds is widened by sqrt(T / (T - 1)), as that of groups is.

    Parameters
    ----------
    values
        One row a training and one column a run, shape ``(trainings, n)``, at least two trainings, finite.
    statistic, clusters, confidence, resamples, seed
        As in ``bootstrap_interval``.

    Raises
    ------
    ResultError
        As ``bootstrap_interval``, and when there are fewer than two trainings.
    """
    trainings = np.asarray(values, dtype=np.float64)
    if trainings.ndim != 2 or len(trainings) < 2:
        msg = f"An interval over trainings needs two or more of them, with the same runs; got values of shape {trainings.shape}."
        raise ResultError(msg)
    _check_settings(confidence, resamples)
    low, high = _ends(_crossed(trainings, statistic, clusters, resamples, (seed, seed + 1)), confidence)
    return float(low), float(high)


def difference_interval(
    first: Array,
    second: Array,
    *,
    clusters: Sequence[Hashable] | None = None,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[float, float]:
    """Bootstrap interval of the difference of two agents' means, each of one or several trainings on the same runs.

    Runs (or ``clusters`` of them) are drawn in pairs, the same for both agents; trainings, where there are several, for each by itself.

    Parameters
    ----------
    first, second
        Values ``(trainings, n)`` of each agent, in the order of the same seeds, finite.
    clusters, confidence, resamples, seed
        As in ``bootstrap_interval``.

    Raises
    ------
    ResultError
        As ``bootstrap_interval``, and when the two do not have the same number of runs.
    """
    ours, theirs = (np.atleast_2d(np.asarray(values, dtype=np.float64)) for values in (first, second))
    if ours.shape[1] != theirs.shape[1]:
        msg = f"A paired difference needs the same runs of both agents; got {ours.shape[1]} and {theirs.shape[1]}."
        raise ResultError(msg)
    _check_settings(confidence, resamples)
    drawn = [
        _crossed(values, mean, clusters, resamples, (seed, seed + 1 + place))
        for place, values in enumerate((ours, theirs))
    ]
    low, high = _ends(drawn[0] - drawn[1], confidence)
    return float(low), float(high)


def _crossed(
    trainings: Array,
    statistic: Statistic,
    clusters: Sequence[Hashable] | None,
    resamples: int,
    seeds: tuple[int, int],
) -> Array:
    """Mean over trainings of the statistic of their runs, in resamples ``(resamples,)`` of runs or groups, and of trainings if several.

    ``seeds`` are those of the drawing of runs and of trainings.
    """
    _checked(trainings.ravel())
    count, size = trainings.shape
    if clusters is None:
        indices = resampling_indices(size, resamples, seeds[0])
        drawn = np.array([statistic(one[indices]) for one in trainings])
    else:
        members = _members(clusters, size)
        drawn = np.array([
            _widened(_over_clusters(one, statistic, members, resamples, seeds[0]), float(center), len(members))
            for one, center in zip(trainings, statistic(trainings), strict=True)
        ])  # fmt: skip
    if count == 1:
        return np.asarray(drawn[0])
    weights = _times_drawn(count, resamples, seeds[1]).T / count - 1.0 / count
    by_training = (weights * drawn).sum(axis=0)
    return np.asarray(drawn.mean(axis=0) + math.sqrt(count / (count - 1)) * by_training)


def _widened(drawn: Array, center: float, count: int) -> Array:
    """Resampled statistics with the spread that so many independent groups have."""
    return center + math.sqrt(count / (count - 1)) * (drawn - center)


def _members(clusters: Sequence[Hashable], size: int) -> list[NDArray[np.intp]]:
    """The runs of each group, groups in the order in which they first occur."""
    if len(clusters) != size:
        msg = f"Every run belongs to one group; got {len(clusters)} groups' names for {size} runs."
        raise ResultError(msg)
    found: dict[Hashable, list[int]] = {}
    for run, name in enumerate(clusters):
        found.setdefault(name, []).append(run)
    if len(found) < 2:
        msg = "An interval over groups of runs needs two or more of them: from one group nothing is known about others."
        raise ResultError(msg)
    return [np.array(runs, dtype=np.intp) for runs in found.values()]


def _over_clusters(
    sample: Array, statistic: Statistic, members: Sequence[NDArray[np.intp]], resamples: int, seed: int
) -> Array:
    """The statistic of resamples ``(resamples,)`` that are made of whole groups."""
    groups, largest = len(members), max(runs.size for runs in members)
    table = np.full((groups, largest), -1, dtype=np.intp)
    for row, runs in enumerate(members):
        table[row, : runs.size] = runs
    drawn = resampling_indices(groups, resamples, seed)
    runs_of = table[drawn].reshape(resamples, groups * largest)
    found, sizes = np.empty(resamples), (runs_of >= 0).sum(axis=1)
    for size in np.unique(sizes):  # groups may differ in size, and so do resamples
        rows = sizes == size
        chosen = runs_of[rows]
        found[rows] = statistic(sample[chosen[chosen >= 0]].reshape(-1, int(size)))
    return found


def _checked(values: Values) -> Array:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        msg = f"Statistics need a one-dimensional, non-empty list of values; got shape {sample.shape}."
        raise ResultError(msg)
    if not np.isfinite(sample).all():
        first = int(np.flatnonzero(~np.isfinite(sample))[0])
        msg = f"Statistics need finite values; value {first} is {sample[first]}."
        raise ResultError(msg)
    return sample


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
    _check_settings(confidence, resamples)
    low, high = _ends(statistic(resampled(strata, resamples, seed)), confidence)
    return float(low), float(high)


def _check_settings(confidence: float, resamples: int) -> None:
    if not 0.0 < confidence < 1.0:
        msg = f"The confidence of an interval lies between 0 and 1; got {confidence}."
        raise ResultError(msg)
    if resamples < 1:
        msg = f"A bootstrap needs at least one resample; got {resamples}."
        raise ResultError(msg)


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
