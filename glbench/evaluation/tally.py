"""The books of runs that are under way: sums so far, who is still running, and why the others are not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env import StepResult
from glbench.evaluation.acting import Failure
from glbench.evaluation.metrics import METRIC_NAMES, METRICS, step_values, with_missing_steps
from glbench.evaluation.records import RunResult, Status
from glbench.fields import LONGEST_TEXT
from glbench.kernel.records import all_finite
from glbench.untrusted import as_one_line


class Tally:
    """Books of ``n`` runs, kept step by step.

    ``totals`` has shape ``(metrics, n)``; ``asked`` ``(n,)`` counts the decisions asked for, ``steps`` ``(n,)`` the simulated steps;
    ``seconds`` ``(n,)`` is the time of the decisions; ``alive`` ``(n,)`` is true for runs that have not failed,
    ``all_alive`` while that is all of them.
    """

    def __init__(self, seeds: tuple[int, ...]) -> None:
        n = len(seeds)
        self.seeds = seeds
        self.totals = np.zeros((len(METRICS), n))
        self.asked = np.zeros(n, dtype=np.int64)
        self.steps = np.zeros(n, dtype=np.int64)
        self.seconds = np.zeros(n)
        self.alive = np.ones(n, dtype=np.bool_)
        self.all_alive = True
        self._ends: dict[int, tuple[Status, str]] = {}

    def end(self, failures: Iterable[Failure]) -> list[int]:
        """End the runs that failed, all that still run where a failure names none; the rows that ended now."""
        ended = []
        for failure in failures:
            rows = range(len(self.seeds)) if failure.row is None else (failure.row,)
            for row in rows:
                if self.alive[row]:
                    self.alive[row] = self.all_alive = False
                    self._ends[row] = (failure.status, as_one_line(failure.reason[:LONGEST_TEXT]))
                    ended.append(row)
        return ended

    def add(self, outcome: StepResult) -> list[int]:
        """Book a simulated step; the rows that could not be simulated end and are returned."""
        values = step_values(outcome.table)
        failures = [Failure(failure.row, "simulation_failed", failure.reason) for failure in outcome.failed]
        if not all_finite(values):  # huge values only look broken
            broken = ~np.isfinite(values).all(axis=0)
            failures += [_not_finite(int(row), values[:, row]) for row in np.flatnonzero(broken)]
        ended = self.end(failures) if failures else []
        if self.all_alive:
            self.totals += values
        else:
            np.add(self.totals, values, out=self.totals, where=self.alive)
        self.steps += self.alive
        return ended

    def results(self, all_steps: int, failed_step: Mapping[str, float]) -> tuple[RunResult, ...]:
        """Every run as a record, missing steps at the task's price."""
        return tuple(self._result(row, all_steps, failed_step) for row in range(len(self.seeds)))

    def _result(self, row: int, all_steps: int, failed_step: Mapping[str, float]) -> RunResult:
        end: tuple[Status, str | None] = self._ends.get(row, ("ok", None))
        status, reason = end
        steps = int(self.steps[row])
        totals = dict(zip(METRIC_NAMES, self.totals[:, row].tolist(), strict=True))
        return RunResult(
            seed=self.seeds[row],
            status=status,
            reason=reason,
            steps=steps,
            metrics=with_missing_steps(totals, all_steps - steps, failed_step),
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The numbers, for a checkpoint."""
        return {name: getattr(self, name) for name in ("totals", "asked", "steps", "seconds", "alive")}

    def ends(self) -> dict[str, list[str]]:
        """Status and reason by row, for a checkpoint."""
        return {str(row): [status, reason] for row, (status, reason) in self._ends.items()}

    def restore(self, arrays: Mapping[str, NDArray[Any]], ends: Mapping[str, tuple[Status, str]]) -> None:
        """Go back to what ``arrays`` and ``ends`` gave."""
        self.totals = arrays["totals"].copy()
        self.asked, self.steps = arrays["asked"].copy(), arrays["steps"].copy()
        self.seconds, self.alive = arrays["seconds"].copy(), arrays["alive"].copy()
        self.all_alive = bool(self.alive.all())
        self._ends = {int(row): (status, reason) for row, (status, reason) in ends.items()}


def _not_finite(row: int, values: NDArray[np.float64]) -> Failure:
    name = METRIC_NAMES[int(np.flatnonzero(~np.isfinite(values))[0])]
    return Failure(row, "simulation_failed", f"the step's {name} is not a finite number")
