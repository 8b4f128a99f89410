"""Uncertain crop parameters: drawn anew in every step, or once an episode, from addresses instead of a stream.

The draw of parameter j in step k of the run with seed s of task t is a function of (t, s, k, j) and of nothing else. See
docs/adr/0006-counter-based-uncertainty-draws.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.derived import DerivedParameters
from glbench.env.parts import Parts
from glbench.env.philox import key_of, uniforms
from glbench.tasks.vocabulary import DISTRIBUTIONS as DISTRIBUTION_WORDS

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

Deviation = Callable[[Floats, float], Floats]
"""Relative deviations from uniform numbers in [0, 1) and the task's half width; element by element."""

DISTRIBUTIONS: Parts[Deviation] = Parts("distribution", DISTRIBUTION_WORDS)

ROWS_AHEAD = 1024
"""About how many rows of draws are made at once: the generator is far quicker for many than for one."""
STEPS_AHEAD = 64

_NOT_DRAWN = -(2**40)
"""First step of the draws at hand when there are none: every step is far behind it."""


def register_distribution(name: str, meaning: str, deviation: Deviation) -> None:
    """Make a distribution known under ``name``, here and in task files.

    ``deviation`` maps each uniform number to the relative deviation of one parameter, such as an inverse distribution
    function would.

    Raises
    ------
    TaskError
        When the name is taken.
    """
    DISTRIBUTIONS.register(name, meaning, deviation)


def _uniform(numbers: Floats, half_width: float) -> Floats:
    """Between -half_width and +half_width."""
    return (2.0 * numbers - 1.0) * half_width


DISTRIBUTIONS.provide("uniform", "parameters times 1 + e, e uniform between minus and plus the half width", _uniform)


def draw_key(task_id: str, seed: int) -> tuple[int, int]:
    """Key of the draws of the run with ``seed`` of the task ``task_id``."""
    return key_of(f"glbench uncertain parameters\n{task_id}\n{seed}")


class ParameterDraws:
    """Model parameters of ``n`` runs of a task, step by step.

    Without uncertainty nothing is drawn and every row shares the nominal vector.
    """

    def __init__(self, task: TaskSpec, n: int) -> None:
        uncertainty = task.uncertainty
        self.nominal = task.parameters()
        self.certain = uncertainty.delta == 0.0
        if self.certain:
            return
        self._task_id = task.id
        self._once = uncertainty.redraw == "episode"
        self._half_width = uncertainty.half_width
        self._deviation = DISTRIBUTIONS[uncertainty.distribution]
        self._derived = DerivedParameters(self.nominal, task.uncertain_parameters())
        self._columns = np.array(self._derived.columns)
        self._keys = np.zeros((n, 2), dtype=np.uint64)
        self._ahead = 1 if self._once else max(1, min(STEPS_AHEAD, ROWS_AHEAD // n))
        self._first = np.full(n, _NOT_DRAWN)
        self._drawn = np.empty((n, self._ahead, self._columns.size))
        self._rows = np.arange(n)
        self._parameters = np.repeat(self.nominal[None, :], n, axis=0)

    def start(self, rows: NDArray[np.intp], seeds: Sequence[int]) -> None:
        """Begin the runs with ``seeds`` in ``rows``."""
        if self.certain:
            return
        self._keys[rows] = [draw_key(self._task_id, seed) for seed in seeds]
        self._first[rows] = _NOT_DRAWN

    def parameters(self, steps: NDArray[np.int64]) -> Floats:
        """Parameters of every row in its step: ``(208,)`` nominal without uncertainty, else ``(n, 208)``.

        The array is used again in the next step.
        """
        if self.certain:
            return self.nominal
        wanted = np.zeros_like(steps) if self._once else steps
        offset = wanted - self._first
        if offset.max() >= self._ahead:
            rows = np.flatnonzero(offset >= self._ahead)
            self._draw(rows, wanted[rows])
            offset[rows] = 0
        self._parameters[:, self._columns] = self._drawn[self._rows, offset]
        return self._parameters

    def _draw(self, rows: NDArray[np.intp], first: NDArray[np.int64]) -> None:
        """Draw the next steps of ``rows``, beginning with the steps ``first``."""
        steps = first[:, None] + np.arange(self._ahead)
        count = len(self._derived.uncertain)
        deviation = self._deviation(uniforms(self._keys[rows], steps, count), self._half_width)
        drawn = self.nominal[self._derived.uncertain] * (1.0 + deviation)
        self._drawn[rows] = self._derived.complete(drawn)
        self._first[rows] = first
