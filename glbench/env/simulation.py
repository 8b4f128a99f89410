"""``n`` runs of one task in lockstep: the one implementation behind environment, vector environment and evaluation."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.env.accounts import make_accounts
from glbench.env.kernels import SCORING_PRESET, Stepper, check_kernel, shared_kernel
from glbench.env.program import make_program
from glbench.env.runs import Runs
from glbench.env.seeds import checked_seed, no_generators
from glbench.env.snapshot import Snapshot
from glbench.env.spaces import the_task
from glbench.env.step_result import StepResult, read_only
from glbench.errors import GlbenchError, ShapeError, TaskError

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]


def check_runs(n: int) -> None:
    """Refuse what is not a number of runs.

    Raises
    ------
    ShapeError
        When it is not a whole number, or less than one.
    """
    if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 1:
        msg = f"A simulation has a whole number of runs, at least one; got {n!r}."
        raise ShapeError(msg)


class Simulation:
    """``n`` runs of ``task``, each with its own seed and step counter, stepped together.

    A run gives the same bits alone, in any batch, at any place in it. A run that has ended (at the horizon or by a failed
    step) stays as it is: its action is not looked at, its quantities are 0. Not safe for use by several threads at once.

    Parameters
    ----------
    task
        The task, or its id.
    n
        Number of runs, 1 or more.
    kernel
        What integrates a step: a ``Kernel``, or the name of a preset, by default ``"reference"``, for a kernel that all
        simulations of this thread share.
    fused
        Whether a step may be one call of the compiled kernel, where that is the kernel and every part of the task is one that
        glbench ships. It changes no bit; without it numpy steps around the kernel.

    Attributes
    ----------
    seeds
        Seeds of the runs ``(n,)``, read-only.
    p_nominal
        Nominal parameters ``(parameters,)``.
    """

    def __init__(
        self, task: TaskSpec | str, n: int, kernel: Stepper | str | None = None, *, fused: bool = True
    ) -> None:
        check_runs(n)
        self.task = task = the_task(task)
        check_kernel(kernel, task)
        self.n = n
        self.p_nominal = task.parameters()
        self.accounts = make_accounts(task)
        make_program(task)  # raises for a part that the task names and nobody made, or that does not fit it
        self._given_kernel = kernel
        self._may_fuse = fused
        self._begun = False
        self.seeds = read_only(np.zeros(n, dtype=np.uint64))

    @cached_property
    def kernel(self) -> Stepper:
        """What integrates a step."""
        given = self._given_kernel
        if given is None or isinstance(given, str):
            return shared_kernel(self.task.model_value, self.task.step_seconds, given or SCORING_PRESET)
        return given

    @cached_property
    def _runs(self) -> Runs:
        """Made when first needed, because it may compile the kernel."""
        return Runs(self.task, self.n, self.kernel, fused=self._may_fuse)

    @property
    def fused(self) -> bool:
        """Whether a step is one call of the compiled kernel."""
        return self._runs.fused

    @property
    def x(self) -> Floats:
        """States ``(n, states)``, read-only; replaced in every step, never written to."""
        return self._runs.x

    @property
    def u(self) -> Floats:
        """Controls in force ``(n, controls)``, fractions; read-only, replaced in every step."""
        return self._runs.u

    @property
    def k(self) -> NDArray[np.int64]:
        """Steps taken ``(n,)``, read-only; replaced in every step."""
        return self._runs.k

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Whether a run has ended ``(n,)``, read-only."""
        return self._runs.ended

    @property
    def over(self) -> int:
        """How many runs have ended."""
        return self._runs.over

    @property
    def air(self) -> Floats:
        """Air temperature [degC], CO2 [ppm] and relative humidity [%] inside, ``(3, n)``, read-only."""
        return self._runs.air

    @property
    def info_columns(self) -> Floats:
        """Steps taken, hour of day [h], day of year, air, controls in physical units, ``(columns, n)``: ``info`` without a step."""
        return self._runs.info

    @property
    def result(self) -> StepResult | None:
        """What the last step gave; ``None`` when runs were reset or restored since."""
        return self._runs.result

    @property
    def d(self) -> Floats:
        """Disturbances that act in each run's next step, ``(n, disturbances)``: what a privileged controller may know."""
        rows: Floats = self._runs.scenarios.pool.values[self._runs.weather_rows]
        return rows

    @property
    def hour_of_day(self) -> Floats:
        """Hour of day at the start of each run's next step, ``(n,)``, 0 to 24."""
        rows: Floats = self._runs.scenarios.pool.calendar[self._runs.calendar_rows, 0]
        return rows

    @property
    def day_of_year(self) -> Floats:
        """Day of year at the start of each run's next step, ``(n,)``, 0 at the start of 1 January."""
        rows: Floats = self._runs.scenarios.pool.calendar[self._runs.calendar_rows, 1]
        return rows

    @property
    def time(self) -> NDArray[np.datetime64]:
        """Date and time (UTC) at the start of each run's next step, ``(n,)``."""
        rows: NDArray[np.datetime64] = self._runs.scenarios.pool.times[self._runs.calendar_rows]
        return rows

    def reset(self, seeds: Sequence[int] | NDArray[np.integer], rows: ArrayLike | None = None) -> NDArray[np.float32]:
        """Restart runs with ``seeds`` (one each), in all rows or in ``rows`` (numbers or a mask).

        Returns
        -------
        ndarray
            Observations of all rows, ``(n, columns)`` float32.

        Raises
        ------
        GlbenchError
            When there are not as many seeds as rows, a seed is not a whole number from 0 to 2**64 - 1, or some rows only
            are reset before all were.
        """
        chosen = self._rows(rows)
        numbers = [checked_seed(seed) for seed in seeds]
        if len(numbers) != len(chosen):
            msg = f"reset got {len(numbers)} seeds for {len(chosen)} runs. Give one seed a run."
            raise ShapeError(msg)
        if rows is not None and not self._begun:
            msg = "Some runs cannot be reset before all were: call reset with one seed for each run first."
            raise GlbenchError(msg)
        all_seeds = self.seeds.copy()
        all_seeds[chosen] = np.array(numbers, dtype=np.uint64)
        self.seeds = read_only(all_seeds)
        self._runs.start(chosen, numbers)
        self._begun = True
        return self.observe()

    def observe(self) -> NDArray[np.float32]:
        """Observations of all runs as they stand, ``(n, columns)`` float32."""
        return self._runs.observe()

    def step(self, actions: ArrayLike) -> StepResult:
        """Take one step with ``actions`` ``(n, m)``, in the order and bounds of the task's card.

        Raises
        ------
        ActionError
            For a wrong shape, or a value that is not finite or out of bounds; nothing is simulated then.
        GlbenchError
            When all runs have ended, or none was started.
        """
        self._check_running()
        return self._runs.step(actions)

    def step_single(self, action: ArrayLike) -> tuple[NDArray[np.float32], list[float], bool]:
        """Take one step with the only run, without the cost of arrays for many.

        Parameters
        ----------
        action
            ``(m,)``.

        Returns
        -------
        observation, numbers, ended
            ``(columns,)`` float32; the numbers of ``info_columns`` and, after them, the step's quantities; whether the run has ended.
            ``result`` has the rest.
        """
        runs = self._runs
        if not self._begun or runs.over == self.n:
            self._check_running()
        return runs.step_single(action)

    def step_controls(self, controls: ArrayLike) -> StepResult:
        """Take one step with ``controls`` ``(n, controls)``, fractions applied as they are: no actuation, no rate limit.

        For privileged controllers and for replaying. Raises as ``step`` does.
        """
        self._check_running()
        return self._runs.step_controls(controls)

    def end(self, rows: ArrayLike) -> None:
        """End the runs in ``rows`` (numbers or a mask) where they stand, for a reason outside the simulation."""
        self._runs.end(self._rows(rows))

    def __getstate__(self) -> dict[str, Any]:
        """What makes another simulation that continues from here: no kernel's memory, no arrays of the compiled library."""
        return {
            "made_with": (self.task, self.n, self._given_kernel),
            "fused": self._may_fuse,
            "snapshot": self.snapshot() if self._begun else None,
            "result": self.result if self._begun else None,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Continue where the copied or pickled simulation stood."""
        self.__init__(*state["made_with"], fused=state["fused"])  # type: ignore[misc]
        if state["snapshot"] is not None:
            self._continue(state["snapshot"], state["result"])

    def snapshot(self) -> Snapshot:
        """What ``restore`` needs to continue from here with the same bits."""
        self._check_begun()
        task = self.task
        return Snapshot(
            task.id, task.digest, self.x, self.u, self.k, self.seeds, self.ended, no_generators(), self._runs.memory, _split(task)
        )  # fmt: skip

    def restore(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Continue from ``snapshot``; the observations of all rows, ``(n, columns)`` float32.

        Raises
        ------
        TaskError
            When it was taken of another task, of another version of it, or of another of its splits.
        ShapeError
            When it has another number of rows.
        """
        if (snapshot.task_id, snapshot.task_digest) != (self.task.id, self.task.digest):
            msg = (
                f"The snapshot belongs to {snapshot.task_id} (digest {snapshot.task_digest[:8]}...), this is {self.task.id} "
                f"(digest {self.task.digest[:8]}...). Make the simulation of the task that the snapshot was taken of."
            )
            raise TaskError(msg)
        if snapshot.split != _split(self.task):
            msg = (
                f"The snapshot is of {self.task.id} in its split {snapshot.split or 'none'}, this is its split {_split(self.task)}: the "
                "same seeds stand for other scenarios there. Make the simulation with the split that the snapshot was taken of."
            )
            raise TaskError(msg)
        if snapshot.n != self.n:
            msg = f"The snapshot has {snapshot.n} rows, the simulation {self.n}. Choose rows with snapshot.take([...])."
            raise ShapeError(msg)
        self._continue(snapshot, None)
        return self.observe()

    def _continue(self, snapshot: Snapshot, result: StepResult | None) -> None:
        self.seeds = read_only(snapshot.seeds.copy())
        self._runs.restore(snapshot, result)
        self._begun = True

    def _rows(self, rows: ArrayLike | None) -> NDArray[np.intp]:
        """Row numbers from numbers, a mask, or ``None`` for all."""
        everything = np.arange(self.n)
        if rows is None:
            return everything
        given = np.asarray(rows)
        return np.atleast_1d(everything[given if given.dtype == np.bool_ else given.astype(np.intp)])

    def _check_begun(self) -> None:
        if not self._begun:
            msg = "Nothing was started yet: call reset first."
            raise GlbenchError(msg)

    def _check_running(self) -> None:
        self._check_begun()
        if self._runs.over == self.n:
            msg = "Every run has ended. Call reset to start new ones."
            raise GlbenchError(msg)


def _split(task: TaskSpec) -> str:
    """What of a task decides, besides its digest and a seed, which scenario a run is in."""
    if not task.sealed:
        return task.split or ""
    return f"{task.split}, secret salt {hashlib.sha256(task.sealed.encode('utf-8')).hexdigest()[:16]}"
