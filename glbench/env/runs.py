"""What steps the runs of a simulation, and the choice between the two ways of doing it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.env.actuation import make_actuation
from glbench.env.fused import FusedRuns
from glbench.env.observations import Observer
from glbench.env.program import make_program
from glbench.env.reference import ReferenceRuns
from glbench.env.rewards import make_reward

if TYPE_CHECKING:
    from glbench.env.accounts import Accounts
    from glbench.env.kernels import Stepper
    from glbench.env.step_result import StepResult
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]


class Runs(Protocol):
    """``n`` runs of a task in lockstep. Arrays are read-only, replaced in every step and never written to."""

    @property
    def x(self) -> Floats:
        """States ``(n, 28)``."""

    @property
    def u(self) -> Floats:
        """Controls in force ``(n, 6)``."""

    @property
    def k(self) -> NDArray[np.int64]:
        """Steps taken ``(n,)``."""

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Whether a run has ended ``(n,)``."""

    @property
    def air(self) -> Floats:
        """Air temperature [degC], CO2 [ppm] and relative humidity [%] inside, ``(3, n)``."""

    @property
    def over(self) -> int:
        """How many runs have ended."""

    @property
    def head(self) -> Floats:
        """Steps taken, hour of day, day of year, air, controls in physical units: what ``info`` tells without a step, ``(12, n)``."""

    @property
    def result(self) -> StepResult | None:
        """What the last step gave; ``None`` when runs were started or restored since."""

    def start(self, rows: NDArray[np.intp], seeds: Sequence[int], state: Floats) -> None:
        """Start the runs in ``rows`` with ``seeds`` from ``state`` ``(28,)``."""

    def restore(
        self,
        x: Floats,
        u: Floats,
        k: NDArray[np.int64],
        ended: NDArray[np.bool_],
        seeds: Sequence[int],
        result: StepResult | None = None,
    ) -> None:
        """Continue all runs from where a snapshot left them; ``result`` is what their last step gave, if that is known."""

    def end(self, rows: NDArray[np.intp]) -> None:
        """End the runs in ``rows`` where they stand."""

    def observe(self) -> NDArray[np.float32]:
        """Observations of all runs as they stand, ``(n, columns)``."""

    def step(self, actions: ArrayLike) -> StepResult:
        """One step with actions ``(n, m)``; ActionError when they cannot be used, and nothing is done."""

    def step_controls(self, controls: ArrayLike) -> StepResult:
        """One step with controls ``(n, 6)``, without actuation."""

    def step_single(self, action: ArrayLike) -> tuple[NDArray[np.float32], list[float], bool]:
        """One step of the only run with an action ``(m,)``: observation, ``head`` and quantities, whether it has ended."""


def check_parts(task: TaskSpec, accounts: Accounts) -> None:
    """Raise for a part that the task names and nobody made, or that does not fit it."""
    Observer(task)
    make_reward(task, accounts)
    make_actuation(task)


def make_runs(task: TaskSpec, n: int, kernel: Stepper, *, fused: bool = True) -> Runs:
    """``n`` runs of ``task`` around ``kernel``; fused where the kernel and all parts of the task allow it."""
    make = getattr(kernel, "environments", None)  # a kernel of one's own, or a pool of processes, steps states only
    program = make_program(task) if fused and make is not None else None
    environments = make(program, n) if make is not None and program is not None else None
    return ReferenceRuns(task, n, kernel) if environments is None else FusedRuns(task, n, environments)
