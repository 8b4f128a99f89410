"""The last two days of a run, as a picture shows them."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glbench.model import CONTROL_NAMES
from glbench.tasks.quantities import LIMITED

HOURS_SHOWN = 48.0

SHOWN = slice(3, 3 + len(LIMITED) + len(CONTROL_NAMES))
"""Rows of ``Simulation.info_columns`` that a trail keeps: the air and the controls in physical units."""
AIR = slice(0, len(LIMITED))
CONTROLS = slice(len(LIMITED), -1)
MONEY = -1


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
        """One row a point, the last one now: air in the order of ``LIMITED``, controls in physical units, EPI so far."""
        return np.array(self._points)
