"""The last two days of a run and its light since midnight, as a picture shows them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.daily_sums import HOURS_BACK, daily_sum
from glbench.env.simulation import Simulation
from glbench.tasks import TaskSpec
from glbench.tasks.prices import local_times

HOURS_SHOWN = 48.0

MONEY = -1
"""Column of a history with the profit so far."""


@dataclass(frozen=True, eq=False)
class DailyLight:
    """Light of a run since midnight, and what its next step begins with."""

    sums: tuple[float, ...]
    """One for each column of ``DailyLightSums``; not a number as long as the history does not reach back to midnight."""
    weather: tuple[float, ...]
    """Disturbances that act in the next step."""
    hour: float
    """Hour of day."""


class DailyLightSums:
    """Sums up the light of the day of runs, whether a task observes it or not: ``columns`` are those of the model that are sums."""

    def __init__(self, task: TaskSpec) -> None:
        model = task.model_value
        columns = model.observed("light_today", task.observation_context().horizon) or ()
        self.columns = tuple(column for column in columns if column.today is not None)
        self._model, self._seconds = model, task.step_seconds
        self._nominal: Any = model.Parameters(*task.parameters().tolist())

    def begin(self, simulation: Simulation, row: int) -> DailyLight:
        """Where a run stands whose past is not known."""
        hour = float(simulation.hour_of_day[row])
        since_midnight = simulation.k[row] == 0 or hour == 0.0
        return self._light(simulation, row, [0.0 if since_midnight else math.nan for _ in self.columns])

    def add(self, light: DailyLight | None, simulation: Simulation, row: int) -> DailyLight:
        """After a step that began with ``light``."""
        if light is None:
            return self.begin(simulation, row)
        now = float(simulation.hour_of_day[row])
        u, d = self._model.Controls(*simulation.u[row].tolist()), self._model.Disturbances(*light.weather)
        sums = []
        for column, so_far in zip(self.columns, light.sums, strict=True):
            assert column.today is not None
            before = 0.0 if now < light.hour - HOURS_BACK else so_far
            sums.append(float(daily_sum(before, column.today(u, d, self._nominal), light.hour, now, self._seconds)))
        return self._light(simulation, row, sums)

    def _light(self, simulation: Simulation, row: int, sums: Sequence[float]) -> DailyLight:
        return DailyLight(tuple(sums), tuple(simulation.d[row].tolist()), float(simulation.hour_of_day[row]))


class RecentHistory:
    """Air, controls in force and EPI so far of one run.

    ``first_step`` steps were taken when the history begins; the EPI counts from there. A step lasts ``step_seconds`` [s]. ``light`` is that
    since midnight, where it is followed.
    """

    def __init__(self, first_step: int, step_seconds: float) -> None:
        self.first_step = first_step
        self.light: DailyLight | None = None
        self._epi = 0.0
        self._points: deque[list[float]] = deque(maxlen=int(HOURS_SHOWN * 3600.0 / step_seconds) + 1)

    def add(self, values: Sequence[float], epi: float = 0.0) -> None:
        """Note the air and controls after a step that earned ``epi`` [EUR m-2]."""
        self._epi += epi
        self._points.append([*values, self._epi])

    def table(self) -> NDArray[np.float64]:
        """One row a point, the last one now: air, controls in physical units, profit so far [EUR m-2]."""
        return np.array(self._points)


def time_words(time: np.datetime64, hour_of_day: float) -> str:
    """A moment in UTC and, where it shows another time, on the clock of the greenhouse."""
    local = local_times(np.array([time]), np.array([hour_of_day]))[0]
    words = np.datetime_as_string(time, unit="m").replace("T", " ")
    return f"{words} UTC" if local == time else f"{words} UTC, {np.datetime_as_string(local, unit='m')[-5:]} local"
