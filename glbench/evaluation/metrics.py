"""What is measured of a run: names, units, meanings, and the sums over its steps.

A metric of a run is the plain sum, step by step, of one quantity of the simulation; which there are, the task's ledger and limits say.
The order of the additions is the order of the steps, in every batch size, so that a run has the same bits alone and among others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.env.accounts import QUANTITIES
from glbench.quantities import OUTSIDE, RUN, STEP, VIOLATION
from glbench.tasks import TaskSpec
from glbench.tasks.ledger import StepQuantity

ANY_LIMIT = "hours_outside_limits"
HOURS = RUN[ANY_LIMIT].unit

_PAPER_NAMES = {"fruit_fresh": "yield", "co2_dosed": "co2"}  # Metrics of tasks of schema 1 that have another name than their quantity
_PAPER_ORDER = (
    "reward", "epi", "revenue", "cost_heat", "cost_electricity", "cost_co2", "penalty", "yield", "heat", "electricity", "co2",
)  # fmt: skip


@dataclass(frozen=True)
class Metric:
    """One metric of a run.

    ``name`` in result files, ``unit``, ``meaning`` in words, and ``quantity``: the simulation's quantity that is summed over the steps
    (``None`` for what is derived from several quantities).
    """

    name: str
    unit: str
    meaning: str
    quantity: str | None = None


def _metrics(quantities: Iterable[StepQuantity], *, paper: bool) -> tuple[Metric, ...]:
    """Reward, profit, money, penalty and amounts; then the hours outside each limit, its lower side first, and outside any."""
    sums, hours = [], []
    for q in quantities:
        if q.name.startswith(OUTSIDE):
            meaning = q.meaning.replace("length of the step if", "time at which").replace(" at its end", "")
            meaning = meaning.replace(" at some time of it", ", in whole steps")
            hours.append(Metric(f"hours_{q.name.removeprefix(OUTSIDE)}", q.unit, meaning, q.name))
        elif not q.name.startswith(VIOLATION):
            name = _PAPER_NAMES.get(q.name, q.name) if paper else q.name
            summed = STEP[q.name].summed if q.name in STEP and q.meaning == STEP[q.name].meaning else ""
            sums.append(Metric(name, q.unit, summed or q.meaning, q.name))
    if paper:
        sums.sort(key=lambda metric: _PAPER_ORDER.index(metric.name))
    # The quantities have the lower sides of all limits first.
    limits = [metric.name.rpartition("_")[0] for metric in hours]
    hours.sort(key=lambda metric: limits.index(metric.name.rpartition("_")[0]))
    return (*sums, *hours, *([Metric(ANY_LIMIT, HOURS, RUN[ANY_LIMIT].meaning)] if hours else []))


METRICS: tuple[Metric, ...] = _metrics(QUANTITIES, paper=True)
"""The metrics of every task of schema 1; ``metrics_of`` has those of any task."""
METRIC_NAMES: tuple[str, ...] = tuple(metric.name for metric in METRICS)
UNITS: dict[str, str] = {metric.name: metric.unit for metric in METRICS}
PAPER_ONLY = frozenset(_PAPER_NAMES.values())  # Metrics by which a result of a task of schema 1 is known
COMMON_UNITS = {name: unit for name, unit in UNITS.items() if name in ("reward", "epi", "penalty") or unit == HOURS}
"""Units of the metrics that mean the same in every task."""

MONEY_TOO = {name: entry.priced["unit"] for name, entry in STEP.items() if entry.priced}
"""Units of those that are in money where violations have prices."""


def metrics_of(task: TaskSpec) -> tuple[Metric, ...]:
    """The metrics of a run of ``task``, in the order of its results."""
    return METRICS if task.conventions.paper_words else _metrics(task.quantities, paper=False)


def units_of(task: TaskSpec) -> dict[str, str]:
    """The unit of each metric of ``task``."""
    return {metric.name: metric.unit for metric in metrics_of(task)}


class StepMetrics:
    """Reads the values of all ``metrics`` of a task from its quantities, step by step, in the order of ``names``."""

    def __init__(self, task: TaskSpec) -> None:
        metrics = metrics_of(task)
        self.names = tuple(metric.name for metric in metrics)
        rows = {quantity.name: row for row, quantity in enumerate(task.quantities)}
        # What is derived from others takes any quantity's place first.
        self._rows = np.array([rows[metric.quantity or "reward"] for metric in metrics])
        outside = [i for i, metric in enumerate(metrics) if (metric.quantity or "").startswith(OUTSIDE)]
        self._any = self.names.index(ANY_LIMIT) if outside else None
        self._outside = slice(outside[0], outside[-1] + 1) if outside else slice(0)

    def __call__(self, quantities: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of all metrics in one step, shape ``(metrics, n)``, from the step's quantities ``(quantities, n)``."""
        values: NDArray[np.float64] = quantities.take(self._rows, axis=0)
        if self._any is not None:
            np.maximum.reduce(values[self._outside], axis=0, out=values[self._any])
        return values


def with_missing_steps(totals: Mapping[str, float], missing: int, failed_step: Mapping[str, float]) -> dict[str, float]:
    """Metrics of a run that lacks ``missing`` steps: each counts as ``failed_step``; what was used or grown stays as measured."""
    return {name: value + missing * failed_step.get(name, 0.0) for name, value in totals.items()}
