"""AR(1) processes with approximately normal innovations."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.philox import uniforms

BELL_NUMBERS = 3
"""Uniform numbers that a bell-shaped number is made of."""


def bell(a: Any, b: Any, c: Any) -> Any:
    """A number with mean 0 and standard deviation 1 from three uniform ones: nearly normal, and never beyond 3.

    Their sum has mean 3/2 and variance 3/12. Only additions and a product: the same bits everywhere, in tapes as well.
    """
    return (a + b + c - 1.5) * 2.0


def wandering(key: NDArray[np.uint64], length: int, persistence: NDArray[np.float64]) -> NDArray[np.float64]:
    """Paths a(t) = phi a(t - 1) + sqrt(1 - phi**2) w(t), with w bell-shaped and a(0) = w(0); mean 0 and standard deviation 1.

    Parameters
    ----------
    key
        Of the stream of random numbers, ``(1, 2)``.
    length
        How many values a path has.
    persistence
        phi of each path, ``(paths,)``.

    Returns
    -------
    ndarray
        Shape ``(length, paths)``.
    """
    count = len(persistence)
    numbers = uniforms(key, np.arange(length, dtype=np.int64)[None], BELL_NUMBERS * count)[0]
    a, b, c = numbers.reshape(length, count, BELL_NUMBERS).transpose(2, 0, 1)
    shocks = bell(a, b, c)
    paths = np.empty((length, count))
    for path in range(count):
        phi = float(persistence[path])
        fresh = float(np.sqrt(1.0 - phi * phi))
        value = float(shocks[0, path])
        walked = [value]
        for shock in shocks[1:, path].tolist():
            value = phi * value + fresh * shock
            walked.append(value)
        paths[:, path] = walked
    return paths
