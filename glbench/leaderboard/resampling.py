"""Bootstrap over runs, within each task: what the intervals of every table rest on.

The resampling indices come from the raw output of a PCG64 generator, whose stream numpy guarantees, so an interval has the same bits
with every numpy version. Runs are drawn with replacement within their task (stratified): tasks are fixed, runs are chance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ResultError

Array: TypeAlias = NDArray[np.float64]

RESAMPLES = 10_000
CONFIDENCE = 0.95


def resampling_indices(size: int, resamples: int, seed: int) -> NDArray[np.intp]:
    """Indices ``(resamples, size)`` in ``[0, size)`` from the upper 32 bits of PCG64's raw 64-bit words (multiply and shift)."""
    raw = np.random.PCG64(seed).random_raw(resamples * size) >> np.uint64(32)
    return ((raw * np.uint64(size)) >> np.uint64(32)).astype(np.intp).reshape(resamples, size)


def resampled(strata: Sequence[Array], resamples: int = RESAMPLES, seed: int = 0) -> list[Array]:
    """Each stratum drawn anew: arrays ``(n_i,)`` to arrays ``(resamples, n_i)``, independently of one another."""
    return [
        stratum[resampling_indices(stratum.size, resamples, seed + number)] for number, stratum in enumerate(strata)
    ]


def stratified_interval(
    strata: Sequence[Array],
    statistic: Callable[[Sequence[Array]], Array],
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[float, float]:
    """Percentile bootstrap interval of a statistic over several tasks.

    Parameters
    ----------
    strata
        One array of run values ``(n_i,)`` a task, finite.
    statistic
        Maps one array ``(resamples, n_i)`` a task to ``(resamples,)``.
    confidence, resamples, seed
        Coverage between 0 and 1, number of resamples, seed of the resampling.

    Returns
    -------
    tuple of float
        Lower and upper end.

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
    drawn = statistic(resampled(strata, resamples, seed))
    tail = 100.0 * (1.0 - confidence) / 2.0
    low, high = np.percentile(drawn, [tail, 100.0 - tail])
    return float(low), float(high)
