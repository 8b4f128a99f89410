"""Sums since midnight by the task's clock: radiation and light of the day so far, never of the hours to come."""

from __future__ import annotations

from typing import Any

import numpy as np

from glbench.arrays import Floats
from glbench.tasks import TaskSpec

DAILY_SUMS = "light of the day"
"""Part of a run's memory that holds these sums (``glbench.env.memory_layout``)."""

HOURS_BACK = 12.0
"""The clock falls back by more than this at midnight, and by an hour at most when summer time ends."""
SECONDS_AN_HOUR = 3600.0


def initial_memory(task: TaskSpec) -> dict[str, float]:
    """The sums that a run of ``task`` keeps, by the names of their columns, and what they start with."""
    model, horizon = task.model_value, task.observation_context().horizon
    columns = (column for module in task.observation.modules for column in model.observed(module, horizon) or ())
    return {column.name: 0.0 for column in columns if column.today is not None}


def daily_sum(so_far: Any, rate: Any, hour_before: Any, hour: Any, step_seconds: float) -> Any:
    """Sum since midnight at the end of a step, from that at its start.

    ``so_far`` is the sum at the start of the step, ``rate`` what comes in a second of it. Its start and end are at ``hour_before`` and
    ``hour`` of the day, 0 to 24, and it lasts ``step_seconds`` [s], at most an hour. Returns a number, an array or a recorded value, as
    given. Of a step over midnight only the part after it counts.
    """
    share, seconds = _daily_share(hour_before, hour, step_seconds)
    return so_far * share + rate * seconds


def daily_sums(rates: Floats, hours: Floats, step_seconds: float) -> Floats:
    """The same for all steps of a run, to the bit: ``(steps + 1,)`` from rates ``(steps,)`` and hours of day ``(steps + 1,)``."""
    share, seconds = _daily_share(hours[:-1], hours[1:], step_seconds)
    sums = [0.0]
    for same_day, amount in zip(share.tolist(), (rates * seconds).tolist(), strict=True):
        sums.append(sums[-1] * same_day + amount)
    return np.array(sums)


def _daily_share(hour_before: Any, hour: Any, step_seconds: float) -> tuple[Any, Any]:
    """Whether the sum so far counts (1, or 0 over midnight), and the seconds of the step that count."""
    passed = np.sign(np.maximum(hour_before - hour - HOURS_BACK, 0.0))
    return 1.0 - passed, step_seconds + passed * (np.minimum(hour * SECONDS_AN_HOUR, step_seconds) - step_seconds)
