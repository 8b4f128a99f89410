"""Whether all numbers of a table are finite, asked at every step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PRODUCT_SIZE = 8192
"""Up to here numpy's linear algebra takes a product without threads. Those it starts beyond go on spinning for their next task,
and took the other processors from whoever used them."""


def all_finite(values: NDArray[np.floating[Any]]) -> bool:
    """Whether no value is infinite or not a number. Finite values beyond 1e150 may count as infinite."""
    if values.size <= _PRODUCT_SIZE:
        # A sum of squares is not finite as soon as one value is not: one pass, no temporary array, no warning.
        return math.isfinite(np.vdot(values, values))
    return bool(np.isfinite(values).all())
