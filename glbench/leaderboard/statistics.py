"""Statistics over runs and tasks: means with their intervals, normalised scores, profiles, paired tests. Pure functions of their arguments.

Means have intervals of Student's t. The random effects are runs (which two agents share, so that differences are paired) and trainings,
where a recipe has several. They are crossed, and their variances are added with the degrees of freedom of Welch and Cochran.
IQM, median and worst tenth have the percentile bootstrap over runs that Agarwal et al. (2021, "Deep reinforcement learning
at the edge of the statistical precipice", NeurIPS 34) recommend. Rewards of different tasks cannot be averaged as they are: a run's
normalised score is 0 for the mean of the agent that the task's scale names and 1 for the best result known there
(``tasks/references.toml``).

Runs of two agents with the same seed have the same weather and the same draws of the crop's parameters, so agents are compared run by run;
several trainings of a recipe are a second source of variance. The test is of the number that ranks: the
difference of the two means (over several tasks, of the means over tasks), divided by its standard error, against Student's t
(``estimate_difference``). Each pair of agents is told apart by mistake in at most 5 % of cases. P-values of all pairs of a table
are corrected together (Benjamini and Hochberg, 1995, J. R. Stat. Soc. B 57, 289-300; for all pairs of a set Williams, Jones and Tukey,
1999, J. Educ. Behav. Stat. 24, 42-69): of the pairs that are told apart, at most 5 % are expected to be mistakes; if all agents are
equally good, about 5 % of tables tell some pair apart. Agents that cannot be told apart from the first of their tier share its rank.

The resampling indices come from the raw output of a PCG64 generator, whose stream numpy guarantees, so a bootstrap interval has the same
bits with every numpy version. Runs are drawn with replacement within their task (stratified): tasks are fixed, runs are chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, pairwise
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.special import stdtr, stdtridf, stdtrit

from glbench.errors import ResultError, refuse
from glbench.evaluation import Result

Array: TypeAlias = NDArray[np.float64]
Values: TypeAlias = Sequence[float] | Array
Statistic: TypeAlias = Callable[[Array], Array]

RESAMPLES = 10_000
CONFIDENCE = 0.95
_CACHED_ARRAYS = 6  # Arrays of resampling indices that are kept; one of 100 runs has 8 MB
WORST = 10  # The worst tenth of the runs: ``worst_tenth`` means one in so many
TARGET = 1.0  # The normalised score that the optimality gap is measured from: the best known result
_ROUNDING = 1e-12  # Relative differences up to this are rounding


class FrozenModel(BaseModel):
    """Base of what ``leaderboard.json`` is made of: frozen, and described by ``docs/schema/leaderboard.schema.json``."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Interval(FrozenModel):
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float


class Bounds(FrozenModel):
    """Both ends of a 95 % interval."""

    low: float
    high: float


class Profile(FrozenModel):
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
    cut = values.shape[-1] // 4
    return np.asarray(np.sort(values, axis=-1)[..., cut : values.shape[-1] - cut].mean(axis=-1), dtype=np.float64)


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
    return np.asarray((np.sort(values, axis=-1)[..., :most] * weights).sum(axis=-1) / count, dtype=np.float64)


@lru_cache(maxsize=_CACHED_ARRAYS)
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
    return [stratum[resampling_indices(stratum.size, resamples, seed + number)] for number, stratum in enumerate(strata)]


def bootstrap_interval(
    values: Values, statistic: Statistic = mean, *, confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = 0
) -> tuple[float, float]:
    """Percentile bootstrap interval of ``statistic`` over runs.

    ``values`` are one a run, ``(n,)``, n >= 1, finite; ``statistic`` maps ``(resamples, n)`` to ``(resamples,)``: ``mean``,
    ``interquartile_mean`` or ``worst_tenth``. ``confidence`` is the coverage between 0 and 1, ``resamples`` the number of samples drawn
    with replacement; the same ``seed`` gives the same bits. Returns the lower and upper end, in the unit of ``values``. With one run, or
    with equal values, both ends are that value. Raises ``ResultError`` for no values, one not finite, or an impossible ``confidence``.
    """
    return stratified_interval(
        [_checked(values)], lambda samples: statistic(samples[0]), confidence=confidence, resamples=resamples, seed=seed
    )


@dataclass(frozen=True)
class MeanEstimate:
    """A mean, or a difference of means, with its uncertainty."""

    value: float
    """The estimate."""
    variance: float
    """Square of its standard error."""
    degrees: float
    """Degrees of freedom of Student's t; infinite if nothing is drawn, 0 for a single run."""

    def interval(self, confidence: float = CONFIDENCE) -> Interval:
        """Interval of Student's t; both ends are the value if nothing is drawn, or for a single run.

        Raises ``ResultError`` when ``confidence`` is not between 0 and 1.
        """
        _check_settings(confidence)
        half = 0.0
        if self.degrees > 0.0 and self.variance > 0.0:
            half = float(stdtrit(self.degrees, 0.5 + confidence / 2.0)) * math.sqrt(self.variance)
        return Interval(value=self.value, low=self.value - half, high=self.value + half)

    def p_value(self, distance: float | None = None) -> float:
        """Two-sided p-value of the hypothesis that the true value is 0, for the value or for ``distance`` in its place."""
        away = abs(self.value if distance is None else distance)
        if self.degrees == 0.0 or away == 0.0:
            return 1.0
        return 2.0 * float(stdtr(self.degrees, -away / math.sqrt(self.variance))) if self.variance > 0.0 else 0.0


def estimate_mean(tasks: Sequence[Array], scenarios: Sequence[Sequence[Hashable]] | None = None) -> MeanEstimate:
    """An agent's mean over tasks of the mean over trainings and runs.

    ``tasks`` has the values of each task, ``(n,)`` of one training or ``(trainings, n)``, finite; training i of one task is training i of
    all. ``scenarios`` has for each task a name for each run; runs of different tasks with the same name have the same draws. ``None``: all
    draws differ. Raises ``ResultError`` when there is no task, a task has no runs, or a value is not finite.
    """
    side = _matrices(tasks)
    return _estimate([side], [one.mean(axis=0) for one in side], scenarios)


def estimate_difference(
    first: Sequence[Array],
    second: Sequence[Array],
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    fixed: tuple[bool, bool] = (False, False),
) -> MeanEstimate:
    """Difference of two agents' means over tasks, paired by run, with its uncertainty over runs and over several trainings.

    With d_s the difference in run s of the means over the trainings, and m_t the mean over the runs of training t, the variance is that
    of the mean of the n values d_s, plus for each agent that of the mean of its values m_t, minus the residuals of trainings and runs,
    which are in both. It is never below one of its two parts. Degrees of freedom between trainings are those of Welch; with those of the
    runs they give the mean of the two critical values at 5 %, weighted by the two variances (Cochran, 1964, Biometrics 20, 191-195). Over
    several tasks the means are taken first.

    If one agent has one training and the other has several, the single one is a draw that varies as much as one of the others, unless its
    agent is ``fixed``, which means not trained. If both have one training, the difference is that of these two policies. Raises
    ``ResultError`` as ``estimate_mean``, and when the two do not have the same tasks and runs. Values of the two agents are by task,
    ``(n,)`` or ``(trainings, n)``, in the order of the same runs, finite; ``scenarios`` as in ``estimate_mean``.
    """
    sides = _matrices(first), _matrices(second)
    if len(sides[0]) != len(sides[1]):
        refuse(f"A paired difference needs the same tasks of both agents; got {len(sides[0])} and {len(sides[1])}.", ResultError)
    for ours, theirs in zip(*sides, strict=True):
        if ours.shape[1] != theirs.shape[1]:
            refuse(f"A paired difference needs the same runs of both agents; got {ours.shape[1]} and {theirs.shape[1]}.", ResultError)
    return _estimate(sides, [x.mean(axis=0) - y.mean(axis=0) for x, y in zip(*sides, strict=True)], scenarios, fixed)


def draws_nothing(differences: Array, scale: float = 1.0) -> bool:
    """Whether two or more values ``(n,)`` are the same number up to the rounding of numbers as large as ``scale``."""
    return differences.size > 1 and float(np.ptp(differences)) <= _ROUNDING * max(scale, float(np.abs(differences).max()))


def _matrices(tasks: Sequence[Array]) -> list[Array]:
    """Values ``(trainings, n)`` of each task."""
    matrices = [np.atleast_2d(np.asarray(one, dtype=np.float64)) for one in tasks]
    if not matrices:
        refuse("A mean over tasks needs at least one task.", ResultError)
    for one in matrices:
        if one.ndim != 2:
            refuse(f"Values of a task are (runs,) or (trainings, runs); got shape {one.shape}.", ResultError)
        _checked(one.ravel())
    return matrices


def _estimate(
    sides: Sequence[Sequence[Array]],
    runs: Sequence[Array],
    scenarios: Sequence[Sequence[Hashable]] | None,
    fixed: Sequence[bool] = (False, False),
) -> MeanEstimate:
    """Mean over tasks of ``runs`` ``(n,)``: means over trainings of the first of ``sides`` ``(trainings, n)`` minus the second, if any."""
    value = float(np.mean([one.mean() for one in runs]))
    scale = max(float(np.abs(one).max()) for side in sides for one in side)
    random = [not draws_nothing(one, scale) for one in runs]
    over_runs = _variance_over_runs(runs, random, scenarios)
    runs_degrees = min((one.size - 1.0 for one, by_chance in zip(runs, random, strict=True) if by_chance), default=math.inf)
    between = [_over_trainings(side) for side in sides]
    several = [one for one in between if one is not None]
    parts = [(one.of_mean, one.degrees) for one in several]
    both = sum(one.residual for one in several)
    if len(several) == 1 and any(one is None and not alone for one, alone in zip(between, fixed, strict=False)):
        parts = [(several[0].of_mean + several[0].of_one, several[0].degrees)]
        both += several[0].residual_of_one
    over_trainings = sum(part for part, _ in parts)
    if runs_degrees == 0.0 or not over_trainings > (_ROUNDING * scale) ** 2:
        return MeanEstimate(value, over_runs, runs_degrees)
    variance = max(over_trainings, over_runs, over_trainings + over_runs - both)
    degrees = 1.0 / sum((part / over_trainings) ** 2 / degrees for part, degrees in parts)
    if over_runs > 0.0:
        level = 0.5 + CONFIDENCE / 2.0
        of_trainings, of_runs = float(stdtrit(degrees, level)), float(stdtrit(runs_degrees, level))
        together = (over_trainings * of_trainings + over_runs * of_runs) / (over_trainings + over_runs)
        degrees = float(stdtridf(level, together))
    return MeanEstimate(value, variance, degrees)


def _variance_over_runs(runs: Sequence[Array], random: Sequence[bool], scenarios: Sequence[Sequence[Hashable]] | None) -> float:
    """Variance of the mean over tasks of the mean of runs; runs of different tasks with the same name vary together."""
    if scenarios is None:
        each = [one.var(ddof=1) / one.size for one, by_chance in zip(runs, random, strict=True) if by_chance and one.size > 1]
        return float(sum(each)) / len(runs) ** 2
    by_name: dict[Hashable, float] = {}
    for task, (one, by_chance) in enumerate(zip(runs, random, strict=True)):
        if not by_chance or one.size < 2:
            continue
        names = scenarios[task]
        if len(names) != one.size or len(set(names)) != one.size:
            refuse(f"Every run of a task needs its own name; got {len(set(names))} names for {one.size} runs.", ResultError)
        weight = 1.0 / (len(runs) * math.sqrt(one.size * (one.size - 1.0)))
        for name, deviation in zip(names, ((one - one.mean()) * weight).tolist(), strict=True):
            by_name[name] = by_name.get(name, 0.0) + deviation
    return float(sum(deviation**2 for deviation in by_name.values()))


@dataclass(frozen=True)
class _OverTrainings:
    """Variances between an agent's trainings, of their mean and of a single one, and the residual part of each."""

    of_mean: float
    of_one: float
    degrees: float
    residual: float
    residual_of_one: float


def _over_trainings(tasks: Sequence[Array]) -> _OverTrainings | None:
    """Variance of the mean over tasks between trainings; ``None`` if every task has one training.

    Training i of all tasks is one unit, because it may be one policy. If their numbers differ, the fewest give the degrees of
    freedom. A task with one training gets the mean variance of the others, and is independent of them.
    """
    several = [one for one in tasks if len(one) > 1]
    if not several:
        return None
    counts = np.array([len(one) for one in several], dtype=np.float64)
    each = np.array([one.mean(axis=1).var(ddof=1) for one in several]) / len(tasks) ** 2
    if counts.min() == counts.max():
        of_one = float((np.sum([one.mean(axis=1) for one in several], axis=0) / len(tasks)).var(ddof=1))
        of_mean = of_one / counts[0]
    else:
        mean_parts, single_parts = np.zeros(int(counts.max())), np.zeros(int(counts.max()))
        for one, count in zip(several, counts, strict=True):
            deviation = (one.mean(axis=1) - one.mean()) / (len(tasks) * math.sqrt(count - 1.0))
            single_parts[: len(one)] += deviation
            mean_parts[: len(one)] += deviation / math.sqrt(count)
        of_one, of_mean = float(np.square(single_parts).sum()), float(np.square(mean_parts).sum())
    degrees = counts.min() - 1.0
    alone = (len(tasks) - len(several)) * float(each.mean())
    unexplained = []  # variance that neither the training nor the run explains
    for one in several:
        rest = one - one.mean(axis=1, keepdims=True) - one.mean(axis=0) + one.mean()
        count, size = one.shape
        unexplained.append(float(np.square(rest).sum() / max((count - 1) * (size - 1), 1)) / size)
    residuals = np.array(unexplained) / len(tasks) ** 2
    return _OverTrainings(of_mean + alone, of_one + alone, degrees, float((residuals / counts).sum()), float(residuals.sum()))


def _checked(values: Values) -> Array:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        refuse(f"Statistics need a one-dimensional, non-empty list of values; got shape {sample.shape}.", ResultError)
    if not np.isfinite(sample).all():
        first = int(np.flatnonzero(~np.isfinite(sample))[0])
        refuse(f"Statistics need finite values; value {first} is {sample[first]}.", ResultError)
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

    Raises ``ResultError`` when there is no task, a task has no runs, or ``confidence`` is not between 0 and 1.
    """
    if not strata or any(stratum.size == 0 for stratum in strata):
        refuse("An interval over tasks needs at least one task, and runs in each of them.", ResultError)
    _check_settings(confidence, resamples)
    low, high = _ends(statistic(resampled(strata, resamples, seed)), confidence)
    return float(low), float(high)


def _check_settings(confidence: float, resamples: int = 1) -> None:
    if not 0.0 < confidence < 1.0:
        refuse(f"The confidence of an interval lies between 0 and 1; got {confidence}.", ResultError)
    if resamples < 1:
        refuse(f"A bootstrap needs at least one resample; got {resamples}.", ResultError)


def _ends(values: Array, confidence: float = CONFIDENCE) -> Array:
    """Lower and upper percentile of resampled statistics along the first axis."""
    tail = 100.0 * (1.0 - confidence) / 2.0
    return np.asarray(np.percentile(values, [tail, 100.0 - tail], axis=0), dtype=np.float64)


def normalise(values: Array, zero: float, best: float) -> Array:
    """Rewards ``(n,)`` as normalised scores. Raises ``ResultError`` when the best known reward is not above the scale's zero."""
    if not best > zero:
        refuse(f"The best known reward ({best:g}) is not above the scale's zero ({zero:g}): scores cannot be normalised.", ResultError)
    return (values - zero) / (best - zero)


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


def aggregate(
    tasks: Sequence[Array],
    score: Score,
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """A score over tasks, from one array of normalised scores ``(n_i,)`` or ``(trainings_i, n_i)`` a task.

    The mean has a 95 % interval over runs and trainings, see ``estimate_mean``. If a task has several trainings, other scores have the
    range from the lowest to the highest training of each task; otherwise the 95 % bootstrap interval over runs. Raises ``ResultError`` when
    there is no task, or a task without runs.
    """
    if score == "mean":
        return estimate_mean(tasks, scenarios).interval()
    statistic, by_training, together = SCORES[score], [np.atleast_2d(runs) for runs in tasks], [runs.ravel() for runs in tasks]
    if any(len(runs) > 1 for runs in by_training):
        lowest = [runs[runs.mean(axis=1).argmin()] for runs in by_training]
        highest = [runs[runs.mean(axis=1).argmax()] for runs in by_training]
        low, high = sorted(float(statistic(which)) for which in (lowest, highest))
    else:
        low, high = stratified_interval(together, statistic, resamples=resamples, seed=seed)
    return Interval(value=float(statistic(together)), low=low, high=high)


def performance_profile(agent: str, tasks: Sequence[Array], thresholds: Array, *, resamples: int = 2_000, seed: int = 0) -> Profile:
    """Mean share over tasks of runs above each threshold, with pointwise 95 % bands. Raises ``ResultError`` without tasks or runs."""
    if not tasks or any(runs.size == 0 for runs in tasks):
        refuse("A performance profile needs at least one task, and runs in each of them.", ResultError)
    above = [(runs[:, None] > thresholds).astype(np.float64) for runs in tasks]
    again = []
    for i, one in enumerate(above):
        size = one.shape[0]
        # How often each run is in each resample: pairs of resampled runs are then counted, not gone through.
        indices = resampling_indices(size, resamples, seed + i) + size * np.arange(resamples)[:, None]
        times = np.bincount(indices.ravel(), minlength=resamples * size).reshape(resamples, size).astype(np.float64)
        again.append((times @ one) / size)
    low, high = _ends(np.asarray(np.mean(again, axis=0)))
    lines = (thresholds, np.mean([one.mean(axis=0) for one in above], axis=0), low, high)
    x, share, lower, upper = (tuple(map(float, line)) for line in lines)
    return Profile(agent=agent, thresholds=x, share=share, low=lower, high=upper)


def probability_of_improvement(
    ours: Mapping[str, Array], theirs: Mapping[str, Array], scenarios: Mapping[str, Sequence[Hashable]] | None = None
) -> Interval:
    """Probability that one agent scores above another in the same run, averaged over their common tasks.

    Equal scores count half. Of several trainings every pair counts, run by run. ``ours`` and ``theirs`` are values ``(n,)`` or
    ``(trainings, n)`` by task, in the order of the same runs, in any unit that orders them; ``scenarios`` name the runs as in
    ``estimate_mean``, by task. The interval is Wilson's (1927, J. Am. Stat. Assoc. 22, 209-212), with the number of independent pairs that
    gives the estimated variance, at most the actual number of pairs. So its ends are never both 0 or both 1. Raises ``ResultError`` when
    the agents have no task in common, or not the same runs.
    """
    common = sorted(set(ours) & set(theirs))
    if not common:
        refuse("The two agents have no task in common, so neither can be said to improve on the other.", ResultError)
    sides: tuple[list[Array], list[Array]] = ([], [])
    pairs = []
    for x, y in zip(_matrices([ours[task] for task in common]), _matrices([theirs[task] for task in common]), strict=True):
        if x.shape[1] != y.shape[1]:
            refuse(f"A paired probability needs the same runs of both agents; got {x.shape[1]} and {y.shape[1]}.", ResultError)
        difference = x[:, None] - y[None, :]
        above = (difference > 0.0) + 0.5 * (difference == 0.0)
        sides[0].append(above.mean(axis=1))
        sides[1].append(above.mean(axis=0))
        pairs.append(above.mean(axis=(0, 1)))
    mean = _estimate(sides, pairs, None if scenarios is None else [scenarios[task] for task in common])
    p, most = mean.value, float(sum(one.size for one in pairs))
    size = min(most, p * (1.0 - p) / mean.variance) if mean.variance > 0.0 and 0.0 < p < 1.0 else most
    degrees = mean.degrees if 0.0 < mean.degrees < math.inf else max(most - 1.0, 1.0)
    square = float(stdtrit(degrees, 0.5 + CONFIDENCE / 2.0)) ** 2 / size
    middle = (p + square / 2.0) / (1.0 + square)
    half = math.sqrt(square * (p * (1.0 - p) + square / 4.0)) / (1.0 + square)
    return Interval(value=p, low=max(0.0, min(p, middle - half)), high=min(1.0, max(p, middle + half)))


class Estimate(FrozenModel):
    """A metric of one entry on one task, over the task's runs, in the unit that ``units`` names."""

    mean: float = Field(description="arithmetic mean over the runs; of several trainings the mean over them")
    iqm: float = Field(description="mean of the middle half of the runs; of several trainings the mean over them")
    low: float = Field(
        description="lower end of the 95 % interval of the mean (Student's t, over runs); of several trainings the lowest of their means"
    )
    high: float = Field(description="upper end of it; of several trainings the highest of their means")
    deviation: float | None = Field(default=None, description="of several trainings: standard deviation of their means (n - 1)")
    overall: Bounds | None = Field(
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
        overall=Bounds(low=interval.low, high=interval.high),
    )


def worst_of(values: Array) -> Interval:
    """The worst tenth of the runs ``(n,)`` with its interval; of several trainings ``(trainings, n)`` as ``worst_tenth`` of a row."""
    trainings = np.atleast_2d(values)
    worst = worst_tenth(trainings)
    if len(trainings) > 1:
        return Interval(value=float(worst.mean()), low=float(worst.min()), high=float(worst.max()))
    low, high = bootstrap_interval(trainings[0], worst_tenth)
    return Interval(value=float(worst[0]), low=low, high=high)


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

    If all differences on a task are the same number, the task draws nothing: its runs are a single observation, and a difference within its
    resolution counts as 0. If no task draws anything and trainings do not differ, there is no variance to test against: the p-value is 1
    for no difference, else 0. From a single run the p-value is 1. Raises ``ResultError`` when the two do not have the same runs, or none.

    Values and ``scenarios`` are as in ``estimate_difference``. ``resolutions`` has for each task the difference that rounding can cause if
    the task draws nothing, in the unit of the values; default ``RESOLUTION``. ``fixed`` says of each agent whether it was not trained, so
    that it has no variance between trainings.
    """
    difference = estimate_difference(first, second, scenarios, fixed)
    tested = difference.value
    for x, y, resolution in zip(first, second, resolutions or (RESOLUTION,) * len(first), strict=True):
        ours, theirs = np.atleast_2d(x), np.atleast_2d(y)
        gaps = ours.mean(axis=0) - theirs.mean(axis=0)
        if draws_nothing(gaps, float(max(np.abs(ours).max(), np.abs(theirs).max()))) and abs(gaps[0]) <= resolution:
            tested -= float(gaps.mean()) / len(first)
    return PairedTest(difference, difference.p_value(tested) if tested * difference.value > 0.0 else 1.0)


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

    ``fixed`` names agents that were not trained. Raises ``ResultError`` when the agents do not all have the same runs.
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

    Within a tier agents stand by their mean; equal means by name. "Cannot be told apart" is not transitive: neighbours of different tiers
    may be hard to tell apart, and only the first of a tier is sure to be told apart from the first of the tier above. Raises
    ``ResultError`` when the agents do not all have the same runs.
    """
    if not scores:
        return ()
    apart = pairs_apart(scores, resolutions, scenarios, fixed)
    means = {agent: float(np.mean([np.mean(one) for one in values])) for agent, values in scores.items()}
    groups: list[list[str]] = []
    for agent in sorted(scores, key=lambda agent: (-means[agent], agent)):
        if groups and frozenset((groups[-1][0], agent)) not in apart:
            groups[-1].append(agent)
        else:
            groups.append([agent])
    return tuple(tuple(tier) for tier in groups)


def reversals(
    order: Sequence[str],
    scores: Mapping[str, Sequence[Array]],
    resolutions: Sequence[float] | None = None,
    scenarios: Sequence[Sequence[Hashable]] | None = None,
    fixed: Collection[str] = (),
) -> dict[str, float]:
    """For every agent of ``order`` but the first, the probability that it is truly better than the one before it.

    Half the p-value of their ``paired_test``, not corrected; 0.5 for equal means or a single run. Other arguments as for ``tiers``.
    """
    return {
        lower: paired_test(scores[upper], scores[lower], resolutions, scenarios, (upper in fixed, lower in fixed)).p_value / 2.0
        for upper, lower in pairwise(order)
    }
