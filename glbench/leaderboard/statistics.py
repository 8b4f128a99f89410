"""Statistics over the runs of one result: mean, interquartile mean, bootstrap intervals.

The estimators are those that Agarwal et al. (2021, "Deep reinforcement learning at the edge of the statistical precipice")
recommend for few runs. Everything is a pure function of its arguments: the resampling indices come from the raw output of a
PCG64 generator, whose stream numpy guarantees, so an interval has the same bits with every numpy version.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from glbench.errors import ResultError
from glbench.leaderboard.resampling import CONFIDENCE, RESAMPLES, resampling_indices

Values: TypeAlias = Sequence[float] | NDArray[np.float64]
Statistic: TypeAlias = Callable[[NDArray[np.float64]], NDArray[np.float64]]

QUARTER = 0.25


def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Arithmetic mean along the last axis, shape ``(..., n)`` to ``(...)``, in the unit of ``values``."""
    return np.asarray(np.mean(values, axis=-1), dtype=np.float64)


def interquartile_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of the middle half along the last axis, shape ``(..., n)`` to ``(...)``.

    The ``floor(n/4)`` smallest and largest values are left out, as in Agarwal et al. (2021): of 30 runs the middle 16 count.
    """
    return np.asarray(stats.trim_mean(values, proportiontocut=QUARTER, axis=-1), dtype=np.float64)


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
    confidence
        Coverage between 0 and 1.
    resamples
        Number of samples drawn with replacement.
    seed
        Seed of the resampling; the same seed gives the same bits.

    Returns
    -------
    tuple of float
        Lower and upper end, in the unit of ``values``. With one run, or with equal values, both ends are that value.

    Raises
    ------
    ResultError
        When there are no values, a value is not finite, or ``confidence`` is not between 0 and 1.
    """
    sample = _checked(values)
    if not 0.0 < confidence < 1.0:
        msg = f"The confidence of an interval lies between 0 and 1; got {confidence}."
        raise ResultError(msg)
    if resamples < 1:
        msg = f"A bootstrap needs at least one resample; got {resamples}."
        raise ResultError(msg)
    drawn = statistic(sample[resampling_indices(sample.size, resamples, seed)])
    tail = 100.0 * (1.0 - confidence) / 2.0
    low, high = np.percentile(drawn, [tail, 100.0 - tail])
    return float(low), float(high)


def _checked(values: Values) -> NDArray[np.float64]:
    sample = np.asarray(values, dtype=np.float64)
    if sample.ndim != 1 or sample.size == 0:
        msg = f"Statistics need a one-dimensional, non-empty list of values; got shape {sample.shape}."
        raise ResultError(msg)
    if not np.isfinite(sample).all():
        first = int(np.flatnonzero(~np.isfinite(sample))[0])
        msg = f"Statistics need finite values; value {first} is {sample[first]}."
        raise ResultError(msg)
    return sample
