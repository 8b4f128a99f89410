"""``n`` runs of one task in lockstep: the one implementation behind environment, vector environment and evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.env.accounts import make_accounts
from glbench.env.actuation import ActionReader, make_actuation
from glbench.env.climate import AirReader
from glbench.env.kernels import Stepper, shared_kernel
from glbench.env.observations import Observer
from glbench.env.quantities import EPI, PENALTY, QUANTITY_NAMES, REWARD
from glbench.env.rewards import StepOutcome, make_reward
from glbench.env.seeds import checked_seed, no_generators
from glbench.env.snapshot import Snapshot
from glbench.env.step_result import StepResult
from glbench.env.uncertainty import ParameterDraws
from glbench.errors import GlbenchError, ShapeError, TaskError
from glbench.model import CONTROL_NAMES, STATE_NAMES

if TYPE_CHECKING:
    from glbench.kernel import StepFailure
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

_AIR = tuple(STATE_NAMES.index(name) for name in ("tAir", "co2Air", "vpAir"))


class Simulation:
    """``n`` runs of ``task``, each with its own seed and step counter, stepped together.

    A run gives the same bits alone, in any batch, at any place in it. A run that has ended (at the horizon or by a failed
    step) stays as it is: its action is not looked at, its quantities are 0. Not safe for use by several threads at once.

    Parameters
    ----------
    task
        The task.
    n
        Number of runs, 1 or more.
    kernel
        What integrates a step; by default a kernel that all simulations of this thread share. A ``KernelPool`` spreads the
        rows over processes; who made it closes it.

    Attributes
    ----------
    x, u, k
        States ``(n, 28)``, controls in force ``(n, 6)`` and steps taken ``(n,)``, read-only; replaced in every step, never
        written to.
    air
        Air temperature [degC], CO2 [ppm] and relative humidity [%] inside, ``(3, n)``, read-only.
    ended, seeds
        Whether a run has ended, and its seed, ``(n,)``, read-only.
    p_nominal
        Nominal parameters ``(208,)``.
    """

    def __init__(self, task: TaskSpec, n: int, kernel: Stepper | None = None) -> None:
        if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 1:
            msg = f"A simulation has a whole number of runs, at least one; got {n!r}."
            raise ShapeError(msg)
        self.task = task
        self.n = n
        self.p_nominal = task.parameters()
        self.accounts = make_accounts(task)
        self._kernel = kernel
        self._start = task.initial_state()
        self._weather = task.disturbances(extra_rows=task.observation.forecast_steps)
        self._observer = Observer(task)
        self._reward = make_reward(task, self.accounts)
        self._actuation = make_actuation(task)
        self._read_actions = ActionReader.of_task(task)
        self._read_controls = ActionReader("control", CONTROL_NAMES, np.zeros(6), np.ones(6))
        self._draws = ParameterDraws(task, n)
        self._read_air = AirReader(n)
        self._begun = False
        self._horizon = task.steps
        self._furthest = 0  # no run has taken more steps than this: spares a look at every run in every step
        self.seeds = _read_only(np.zeros(n, dtype=np.uint64))
        self.x = _read_only(np.tile(self._start, (n, 1)))
        self.u = _read_only(np.zeros((n, len(CONTROL_NAMES))))
        self.k = _read_only(np.zeros(n, dtype=np.int64))
        self.air = self._air_of(self.x)
        self.ended = _read_only(np.zeros(n, dtype=np.bool_))
        self._any_ended = False

    @property
    def kernel(self) -> Stepper:
        """What integrates a step."""
        if self._kernel is None:
            self._kernel = shared_kernel(self.task.step_seconds, self.task.model.variant)
        return self._kernel

    @property
    def d(self) -> Floats:
        """Disturbances that act in each run's next step, ``(n, 10)``: what a privileged controller may know."""
        rows: Floats = self._weather.values[self.k]
        return rows

    @property
    def hour_of_day(self) -> Floats:
        """Hour of day at the start of each run's next step, ``(n,)``, 0 to 24."""
        rows: Floats = self._weather.hour_of_day[self.k]
        return rows

    @property
    def day_of_year(self) -> Floats:
        """Day of year at the start of each run's next step, ``(n,)``, 0 at the start of 1 January."""
        rows: Floats = self._weather.day_of_year[self.k]
        return rows

    @property
    def time(self) -> NDArray[np.datetime64]:
        """Date and time (UTC) at the start of each run's next step, ``(n,)``."""
        rows: NDArray[np.datetime64] = self._weather.times[self.k]
        return rows

    def reset(self, seeds: Sequence[int] | NDArray[np.integer], rows: ArrayLike | None = None) -> NDArray[np.float32]:
        """Start runs anew with ``seeds`` (one each), in all rows or in ``rows`` (numbers or a mask).

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
        x, u, k, ended = self.x.copy(), self.u.copy(), self.k.copy(), self.ended.copy()
        x[chosen], u[chosen], k[chosen], ended[chosen] = self._start, 0.0, 0, False
        all_seeds = self.seeds.copy()
        all_seeds[chosen] = np.array(numbers, dtype=np.uint64)
        self.seeds = _read_only(all_seeds)
        self._draws.start(chosen, numbers)
        self._place(x, u, k, ended)
        return self.observe()

    def observe(self) -> NDArray[np.float32]:
        """Observations of all runs as they stand, ``(n, columns)`` float32."""
        return self._observer(self.x, self.u, self.air, self.k)

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
        checked = self._read_actions(actions, self.n, self.ended if self._any_ended else None)
        return self._advance(self._actuation(self.u, checked))

    def step_controls(self, controls: ArrayLike) -> StepResult:
        """Take one step with ``controls`` ``(n, 6)``, fractions applied as they are: no actuation, no rate limit.

        For privileged controllers and for replaying. Raises as ``step`` does.
        """
        self._check_running()
        return self._advance(self._read_controls(controls, self.n, self.ended if self._any_ended else None))

    def end(self, rows: ArrayLike) -> None:
        """End the runs in ``rows`` (numbers or a mask) where they stand, for a reason outside the simulation."""
        ended = self.ended.copy()
        ended[self._rows(rows)] = True
        self._set_ended(ended)

    def snapshot(self) -> Snapshot:
        """What ``restore`` needs to continue from here with the same bits."""
        self._check_begun()
        task = self.task
        return Snapshot(task.id, task.digest, self.x, self.u, self.k, self.seeds, self.ended, no_generators())

    def restore(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Continue from ``snapshot``; the observations of all rows, ``(n, columns)`` float32.

        Raises
        ------
        TaskError
            When it was taken of another task, or of another version of it.
        ShapeError
            When it has another number of rows.
        """
        if (snapshot.task_id, snapshot.task_digest) != (self.task.id, self.task.digest):
            msg = (
                f"The snapshot belongs to {snapshot.task_id} (digest {snapshot.task_digest[:8]}...), this is {self.task.id} "
                f"(digest {self.task.digest[:8]}...). Make the simulation of the task that the snapshot was taken of."
            )
            raise TaskError(msg)
        if snapshot.n != self.n:
            msg = f"The snapshot has {snapshot.n} rows, the simulation {self.n}. Choose rows with snapshot.take([...])."
            raise ShapeError(msg)
        self.seeds = _read_only(snapshot.seeds.copy())
        self._draws.start(np.arange(self.n), self.seeds.tolist())
        self._place(snapshot.states.copy(), snapshot.controls.copy(), snapshot.steps.copy(), snapshot.ended.copy())
        return self.observe()

    def _rows(self, rows: ArrayLike | None) -> NDArray[np.intp]:
        """Row numbers from numbers, a mask, or ``None`` for all."""
        everything = np.arange(self.n)
        if rows is None:
            return everything
        given = np.asarray(rows)
        return np.atleast_1d(everything[given if given.dtype == np.bool_ else given.astype(np.intp)])

    def _place(self, x: Floats, u: Floats, k: NDArray[np.int64], ended: NDArray[np.bool_]) -> None:
        self.x, self.u, self.k = _read_only(x), _read_only(u), _read_only(k)
        self.air = self._air_of(x)
        self._set_ended(ended)
        self._furthest = int(k.max())
        self._begun = True

    def _air_of(self, x: Floats) -> Floats:
        temperature, density, pressure = _AIR
        return _read_only(self._read_air(x[:, temperature], x[:, density], x[:, pressure]))

    def _set_ended(self, ended: NDArray[np.bool_]) -> None:
        self.ended = _read_only(ended)
        self._any_ended = bool(ended.any())

    def _check_begun(self) -> None:
        if not self._begun:
            msg = "Nothing was started yet: call reset first."
            raise GlbenchError(msg)

    def _check_running(self) -> None:
        self._check_begun()
        if self._any_ended and self.ended.all():
            msg = "Every run has ended. Call reset to start new ones."
            raise GlbenchError(msg)

    def _advance(self, controls: Floats) -> StepResult:
        """One step of all running rows under ``controls``, which are this method's to keep."""
        before, had_ended = self.x, self.ended if self._any_ended else None
        if had_ended is not None:
            controls[had_ended] = self.u[had_ended]
        after, failed = self._flow(controls, had_ended)
        self.x, self.u = _read_only(after), _read_only(controls)
        self.k = _read_only(self._count(had_ended, failed))
        self._end_runs(failed)
        air = self.air = self._air_of(after)
        table = self.accounts.quantities(before, after, controls, air)
        table[REWARD] = self._reward(StepOutcome(table, before, after, controls, air))
        for failure in failed:
            charge = self.task.evaluation.failed_step
            table[[REWARD, EPI, PENALTY], failure.row] = charge.reward, charge.epi, charge.penalty
        if had_ended is not None:
            table[:, had_ended] = 0.0
        observations = self._observer(after, controls, air, self.k)
        return StepResult(
            observations, table[REWARD], self.ended, failed, dict(zip(QUANTITY_NAMES, table, strict=True))
        )

    def _flow(self, controls: Floats, had_ended: NDArray[np.bool_] | None) -> tuple[Floats, list[StepFailure]]:
        """States after the step, and the rows that failed; rows that had ended are not integrated."""
        disturbances = self._weather.values.take(self.k, axis=0)
        parameters = self._draws.parameters(self.k)
        if had_ended is None:
            return self.kernel.try_step(self.x, controls, disturbances, parameters)
        rows = np.flatnonzero(~had_ended)
        own = parameters if parameters.ndim == 1 else parameters[rows]
        moved, failed = self.kernel.try_step(self.x[rows], controls[rows], disturbances[rows], own)
        after = self.x.copy()
        after[rows] = moved
        return after, [replace(failure, row=int(rows[failure.row])) for failure in failed]

    def _count(self, had_ended: NDArray[np.bool_] | None, failed: list[StepFailure]) -> NDArray[np.int64]:
        """Steps taken by each row, now that this one is done."""
        counted = self.k + 1
        if had_ended is not None:
            counted[had_ended] -= 1
        for failure in failed:
            counted[failure.row] -= 1
        return counted

    def _end_runs(self, failed: list[StepFailure]) -> None:
        """Mark the rows that failed or reached the horizon."""
        self._furthest += 1
        if not failed and self._furthest < self._horizon:
            return
        ended = self.ended | (self.k >= self._horizon)
        ended[[failure.row for failure in failed]] = True
        self._set_ended(ended)


def _read_only(array: NDArray[np.generic]) -> NDArray:  # type: ignore[type-arg]
    array.flags.writeable = False
    return array
