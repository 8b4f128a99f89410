"""The last two days of a run, as a picture shows them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.today import HOURS_BACK, since_midnight

if TYPE_CHECKING:
    from glbench.env.simulation import Simulation
    from glbench.tasks import TaskSpec

HOURS_SHOWN = 48.0

MONEY = -1
"""Column of a trail with the profit so far."""


@dataclass(frozen=True, eq=False)
class Light:
    """Light of a run since midnight, and what its next step begins with.

    Attributes
    ----------
    sums
        One for each column of ``DayLight``; not a number as long as the trail does not reach back to midnight.
    weather
        Disturbances that act in the next step.
    hour
        Hour of day.
    """

    sums: tuple[float, ...]
    weather: tuple[float, ...]
    hour: float


class DayLight:
    """Sums up the light of the day while runs are followed, whether a task observes it or not.

    Attributes
    ----------
    columns
        What is summed up, as the task's model observes it.
    """

    def __init__(self, task: TaskSpec) -> None:
        model = task.model_value
        seen = model.observed("light_today", task.observation_context().horizon) or ()
        self.columns = tuple(column for column in seen if column.today is not None)
        self._model, self._seconds = model, task.step_seconds
        self._nominal: Any = model.Parameters(*task.parameters().tolist())

    def begin(self, simulation: Simulation, row: int) -> Light:
        """Where a run stands whose past is not known."""
        hour = float(simulation.hour_of_day[row])
        known = simulation.k[row] == 0 or hour == 0.0
        return self._light(simulation, row, [0.0 if known else math.nan for _ in self.columns])

    def add(self, light: Light | None, simulation: Simulation, row: int) -> Light:
        """After a step that began with ``light``."""
        if light is None:
            return self.begin(simulation, row)
        now = float(simulation.hour_of_day[row])
        u, d = self._model.Controls(*simulation.u[row].tolist()), self._model.Disturbances(*light.weather)
        sums = []
        for column, so_far in zip(self.columns, light.sums, strict=True):
            assert column.today is not None
            known = 0.0 if now < light.hour - HOURS_BACK else so_far
            sums.append(float(since_midnight(known, column.today(u, d, self._nominal), light.hour, now, self._seconds)))
        return self._light(simulation, row, sums)

    def _light(self, simulation: Simulation, row: int, sums: Sequence[float]) -> Light:
        return Light(tuple(sums), tuple(simulation.d[row].tolist()), float(simulation.hour_of_day[row]))


class Trail:
    """Air, controls in force and EPI so far of one run.

    Parameters
    ----------
    first_step
        Steps taken when the trail begins; the EPI counts from there.
    step_seconds
        Length of a step [s].

    Attributes
    ----------
    light
        Light since midnight, where somebody follows it.
    """

    def __init__(self, first_step: int, step_seconds: float) -> None:
        self.first_step = first_step
        self.light: Light | None = None
        self._epi = 0.0
        self._points: deque[list[float]] = deque(maxlen=int(HOURS_SHOWN * 3600.0 / step_seconds) + 1)

    def add(self, shown: Sequence[float], epi: float = 0.0) -> None:
        """Note the air and controls after a step that earned ``epi`` [EUR m-2]."""
        self._epi += epi
        self._points.append([*shown, self._epi])

    def table(self) -> NDArray[np.float64]:
        """One row a point, the last one now: air, controls in physical units, profit so far [EUR m-2]."""
        return np.array(self._points)
