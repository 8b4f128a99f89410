"""The last two days of a run, as a picture shows them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

HOURS_SHOWN = 48.0

MONEY = -1
"""Column of a trail with the profit so far."""


class Trail:
    """Air, controls in force and EPI so far of one run.

    Parameters
    ----------
    first_step
        Steps taken when the trail begins; the EPI counts from there.
    step_seconds
        Length of a step [s].
    """

    def __init__(self, first_step: int, step_seconds: float) -> None:
        self.first_step = first_step
        self._epi = 0.0
        self._points: deque[list[float]] = deque(maxlen=int(HOURS_SHOWN * 3600.0 / step_seconds) + 1)

    def add(self, shown: Sequence[float], epi: float = 0.0) -> None:
        """Note the air and controls after a step that earned ``epi`` [EUR m-2]."""
        self._epi += epi
        self._points.append([*shown, self._epi])

    def table(self) -> NDArray[np.float64]:
        """One row a point, the last one now: air, controls in physical units, profit so far [EUR m-2]."""
        return np.array(self._points)
