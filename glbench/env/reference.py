"""Steps with numpy around any kernel: the reference for the compiled environments, and what steps where they cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.env.accounts import make_accounts
from glbench.env.actuation import ActionReader, make_actuation
from glbench.env.climate import AIR_STATES, AirReader
from glbench.env.observations import Observer
from glbench.env.quantities import EPI, PENALTY, REWARD
from glbench.env.rewards import StepOutcome, make_reward
from glbench.env.step_result import StepResult, read_only
from glbench.env.uncertainty import ParameterDraws
from glbench.model import CONTROL_NAMES, STATE_NAMES

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.kernel import StepFailure
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]


class ReferenceRuns:
    """The runs of a simulation, stepped with numpy; attributes and methods as ``glbench.env.runs.Runs`` says."""

    def __init__(self, task: TaskSpec, n: int, kernel: Stepper) -> None:
        self.task, self.n, self._kernel = task, n, kernel
        self._accounts = make_accounts(task)
        self._weather = task.disturbances(extra_rows=task.observation.forecast_steps)
        self._observer = Observer(task)
        self._reward = make_reward(task, self._accounts)
        self._actuation = make_actuation(task)
        self._read_actions, self._read_controls = ActionReader.of_task(task), ActionReader.of_controls()
        self._draws = ParameterDraws(task, n)
        self._read_air = AirReader(n)
        self._delivered = np.array([[capacity.at_one] for capacity in task.capacities()])
        self._furthest = 0  # no run has taken more steps than this: spares a look at every run in every step
        self.result: StepResult | None = None
        self.place(
            np.zeros((n, len(STATE_NAMES))),
            np.zeros((n, len(CONTROL_NAMES))),
            np.zeros(n, np.int64),
            np.zeros(n, np.bool_),
        )

    @property
    def over(self) -> int:
        """How many runs have ended."""
        return int(np.count_nonzero(self.ended)) if self._any_ended else 0

    @property
    def head(self) -> Floats:
        """What ``info`` tells of every run besides the step's quantities, ``(12, n)``."""
        k, weather = self.k, self._weather
        return np.vstack([k, weather.hour_of_day[k], weather.day_of_year[k], self.air, self.u.T * self._delivered])

    def start(self, rows: NDArray[np.intp], seeds: Sequence[int], state: Floats) -> None:
        """Start the runs in ``rows`` with ``seeds`` from ``state``."""
        x, u, k, ended = self.x.copy(), self.u.copy(), self.k.copy(), self.ended.copy()
        x[rows], u[rows], k[rows], ended[rows] = state, 0.0, 0, False
        self._draws.start(rows, seeds)
        self.place(x, u, k, ended)

    def restore(
        self,
        x: Floats,
        u: Floats,
        k: NDArray[np.int64],
        ended: NDArray[np.bool_],
        seeds: Sequence[int],
        result: StepResult | None = None,
    ) -> None:
        """Continue all runs from where a snapshot left them."""
        self._draws.start(np.arange(self.n), seeds)
        self.place(x.copy(), u.copy(), k.copy(), ended.copy())
        self.result = result

    def place(self, x: Floats, u: Floats, k: NDArray[np.int64], ended: NDArray[np.bool_]) -> None:
        """Take over arrays as they are."""
        self.x, self.u, self.k = read_only(x), read_only(u), read_only(k)
        self.air = self._air_of(x)
        self._set_ended(ended)
        self._furthest = int(k.max())
        self.result = None

    def end(self, rows: NDArray[np.intp]) -> None:
        """End the runs in ``rows`` where they stand."""
        ended = self.ended.copy()
        ended[rows] = True
        self._set_ended(ended)

    def observe(self) -> NDArray[np.float32]:
        """Observations of all runs as they stand."""
        return self._observer(self.x, self.u, self.air, self.k)

    def step(self, actions: ArrayLike) -> StepResult:
        """One step with actions."""
        checked = self._read_actions(actions, self.n, self.ended if self._any_ended else None)
        return self._advance(self._actuation(self.u, checked))

    def step_controls(self, controls: ArrayLike) -> StepResult:
        """One step with controls, without actuation."""
        return self._advance(self._read_controls(controls, self.n, self.ended if self._any_ended else None))

    def step_single(self, action: ArrayLike) -> tuple[NDArray[np.float32], list[float], bool]:
        """One step of the only run."""
        result = self.step(np.asarray(action)[None])
        numbers = [*self.head[:, 0].tolist(), *result.table[:, 0].tolist()]
        return result.observations[0], numbers, bool(result.terminated[0])

    @cached_property
    def _charge(self) -> tuple[float, float, float]:
        charge = self.task.evaluation.failed_step
        return charge.reward, charge.epi, charge.penalty

    def _air_of(self, x: Floats) -> Floats:
        temperature, density, pressure = AIR_STATES
        return read_only(self._read_air(x[:, temperature], x[:, density], x[:, pressure]))

    def _set_ended(self, ended: NDArray[np.bool_]) -> None:
        self.ended = read_only(ended)
        self._any_ended = bool(ended.any())

    def _advance(self, controls: Floats) -> StepResult:
        """One step of all running rows under ``controls``, which are this method's to keep."""
        before, had_ended = self.x, self.ended if self._any_ended else None
        if had_ended is not None:
            controls[had_ended] = self.u[had_ended]
        after, failed = self._flow(controls, had_ended)
        self.x, self.u = read_only(after), read_only(controls)
        self.k = read_only(self._count(had_ended, failed))
        self._end_runs(failed)
        air = self.air = self._air_of(after)
        table = self._accounts.quantities(before, after, controls, air)
        table[REWARD] = self._reward(StepOutcome(table, before, after, controls, air))
        for failure in failed:
            table[[REWARD, EPI, PENALTY], failure.row] = self._charge
        if had_ended is not None:
            table[:, had_ended] = 0.0
        observations = self._observer(after, controls, air, self.k)
        self.result = StepResult(observations, table[REWARD], self.ended, failed, table)
        return self.result

    def _flow(self, controls: Floats, had_ended: NDArray[np.bool_] | None) -> tuple[Floats, list[StepFailure]]:
        """States after the step, and the rows that failed; rows that had ended are not integrated."""
        disturbances = self._weather.values.take(self.k, axis=0)
        parameters = self._draws.parameters(self.k)
        if had_ended is None:
            return self._kernel.try_step(self.x, controls, disturbances, parameters)
        rows = np.flatnonzero(~had_ended)
        own = parameters if parameters.ndim == 1 else parameters[rows]
        moved, failed = self._kernel.try_step(self.x[rows], controls[rows], disturbances[rows], own)
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
        if not failed and self._furthest < self.task.steps:
            return
        ended = self.ended | (self.k >= self.task.steps)
        ended[[failure.row for failure in failed]] = True
        self._set_ended(ended)
