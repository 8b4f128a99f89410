"""Runs of a task in lockstep, in environments that execute its program: compiled or with NumPy, to the same bits."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.arrays import real_numbers
from glbench.env.actuation import ActionReader
from glbench.env.program import air_columns, info_columns, make_program
from glbench.env.quantities import REWARD
from glbench.env.reference import NO_PARTS, ParameterDraws, PlainEnvironments
from glbench.env.scenario import RunScenarios
from glbench.env.step_result import StepResult, read_only

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.env.snapshot import Snapshot
    from glbench.kernel.environment import Environments
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

_PLAIN = "fd"
"""Codes of the types that are copied without a look at them: float32 and float64."""


def make_environments(task: TaskSpec, n: int, kernel: Stepper, *, fused: bool = True) -> Environments:
    """``n`` environments of ``task`` around ``kernel``; compiled where the kernel is and all parts of the task allow it."""
    program, parts = make_program(task)
    make = getattr(kernel, "environments", None)  # a custom kernel steps states only
    if fused and make is not None and parts is NO_PARTS:
        compiled: Environments | None = make(program, n)
        if compiled is not None:
            return compiled
    return PlainEnvironments(program, n, kernel, len(task.model_value.states), parts)


def run_parameters(task: TaskSpec, seed: int) -> Floats:
    """Parameters of the run with ``seed``: ``(p,)`` where it keeps them to its end, ``(steps, p)`` where steps draw some."""
    program, parts = make_program(task)
    scenes = RunScenarios(task).draw([seed])
    start = program.nominal[None] if scenes.parameters is None else scenes.parameters
    if not program.drawn:
        own: Floats = start[0].copy()
        return own
    draws = ParameterDraws(program, parts, task.steps)
    draws.begin(start)
    return draws.of_step(start, scenes.keys.repeat(task.steps, axis=0), np.arange(task.steps))


class Runs:
    """``n`` runs of a task in lockstep.

    The environments overwrite their arrays in every step. What is handed out is a read-only copy, made when it is first asked for.
    """

    def __init__(self, task: TaskSpec, n: int, kernel: Stepper, *, fused: bool = True) -> None:
        self.n = n
        self.scenarios = RunScenarios(task)
        self._all = environments = make_environments(task, n, kernel, fused=fused)
        self._readers = {"given": ActionReader.of_task(task), "given_controls": ActionReader.of_controls(task)}
        self._air, self._info = air_columns(task), info_columns(task)
        self._names = tuple(quantity.name for quantity in task.quantities)
        self.over = 0
        """How many runs have ended."""
        self._failed = 0
        self._stepped = False
        self._copies: dict[str, Any] = {}
        self._only = environments.table[0], environments.observations[0], environments.given[0]
        self._one_action = self._only[2].shape
        self.start(np.arange(n), [0] * n)

    @property
    def fused(self) -> bool:
        """Whether a step is one call of the compiled kernel."""
        return not isinstance(self._all, PlainEnvironments)

    @property
    def x(self) -> Floats:
        """States ``(n, s)``."""
        return self._copy("x")

    @property
    def u(self) -> Floats:
        """Controls in force ``(n, c)``."""
        return self._copy("u")

    @property
    def k(self) -> NDArray[np.int64]:
        """Steps taken ``(n,)``."""
        return self._copy("k")

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Whether a run has ended ``(n,)``."""
        return self._copy("ended")

    @property
    def memory(self) -> Floats:
        """What the runs keep from step to step besides states and controls ``(n, m)``."""
        return self._copy("memory")

    @property
    def air(self) -> Floats:
        """Air temperature [degC], CO2 [ppm] and relative humidity [%] inside, ``(3, n)``; ``(0, n)`` of a model without an air."""
        found: Floats | None = self._copies.get("air")
        if found is None:
            found = self._copies["air"] = read_only(self._table()[self._air].copy())
        return found

    @property
    def info(self) -> Floats:
        """Steps taken, hour of day, day of year, air, controls in physical units: what ``info`` tells without a step, ``(columns, n)``."""
        return self._table()[: self._info]

    @property
    def calendar_rows(self) -> NDArray[np.int64]:
        """Row of the pool's calendar at which each run stands ``(n,)``."""
        rows: NDArray[np.int64] = self._all.first + self._all.k
        return rows

    @property
    def weather_rows(self) -> NDArray[np.int64]:
        """Row of the pool's weather that acts in each run's next step ``(n,)``."""
        day, k = self.scenarios.pool.day, self._all.k
        rows: NDArray[np.int64] = self._all.days[np.arange(self.n), k // day] + k % day
        return rows

    @property
    def result(self) -> StepResult | None:
        """What the last step gave; ``None`` when runs were started or restored since."""
        if not self._stepped:
            return None
        found: StepResult | None = self._copies.get("result")
        if found is None:
            table = self._table()[self._info :]
            found = self._copies["result"] = StepResult(
                self._all.observations.copy(),
                table[REWARD],
                self.ended,
                self._all.failures() if self._failed else [],
                table,
                self._names,
            )
        return found

    def start(self, rows: NDArray[np.intp], seeds: Sequence[int], states: Floats | None = None) -> None:
        """Start the runs in ``rows`` with ``seeds``, from their own start or from ``states`` ``(rows, s)``."""
        a = self._all
        own, memory = self._set_scenes(rows, seeds)
        a.x[rows], a.u[rows], a.k[rows], a.ended[rows] = own if states is None else states, 0.0, 0, False
        a.memory[rows] = memory
        self._observe()

    def restore(self, snapshot: Snapshot, result: StepResult | None = None) -> None:
        """Continue all runs from where a snapshot left them; ``result`` is what their last step gave, if that is known."""
        a = self._all
        self._set_scenes(np.arange(self.n), snapshot.seeds.tolist())
        a.x[:], a.u[:], a.k[:], a.ended[:] = snapshot.states, snapshot.controls, snapshot.steps, snapshot.ended
        a.memory[:] = snapshot.memory
        self._observe()
        if result is not None:
            self._copies["result"], self._stepped = result, True

    def end(self, rows: NDArray[np.intp]) -> None:
        """End the runs in ``rows`` where they stand."""
        self._all.ended[rows] = True
        self.over = int(np.count_nonzero(self._all.ended))
        self._copies.pop("ended", None)

    def observe(self) -> NDArray[np.float32]:
        """Observations of all runs as they stand, ``(n, columns)``."""
        return self._all.observations.copy()

    def step(self, actions: ArrayLike) -> StepResult:
        """One step with actions ``(n, m)``; ActionError when they cannot be used, and nothing is done."""
        self._give("given", actions)
        return self._finished("given", self._all.step())

    def step_controls(self, controls: ArrayLike) -> StepResult:
        """One step with controls ``(n, c)``, without actuation."""
        self._give("given_controls", controls)
        return self._finished("given_controls", self._all.step_controls())

    def step_single(self, action: ArrayLike) -> tuple[NDArray[np.float32], list[float], bool]:
        """One step of the only run with an action ``(m,)``: observation, ``info`` and quantities, whether it has ended."""
        table, observation, given = self._only
        if type(action) is np.ndarray and action.shape == self._one_action and action.dtype.char in _PLAIN:
            given[:] = action
        else:
            numbers = real_numbers(action)
            self._give("given", action if numbers is None else numbers[None])
        failed = self._all.step()
        if failed:
            self._refuse("given", failed)
        self._failed, self._stepped, self.over = failed, True, self._all.over
        self._copies.clear()
        return observation.copy(), table.tolist(), self.over == 1

    def _set_scenes(self, rows: NDArray[np.intp], seeds: Sequence[int]) -> tuple[Floats, Floats]:
        """Give the runs in ``rows`` the scenarios of ``seeds``; the states and memory that they start with."""
        a, scenes = self._all, self.scenarios.draw(seeds)
        a.days[rows], a.first[rows], a.keys[rows], a.traits[rows] = (
            scenes.days,
            scenes.first,
            scenes.keys,
            scenes.traits,
        )
        if scenes.parameters is not None:
            a.parameters[rows] = scenes.parameters
        return scenes.states, scenes.memory

    def _give(self, name: str, values: ArrayLike) -> None:
        to: Floats = getattr(self._all, name)
        if type(values) is np.ndarray and values.shape == to.shape and values.dtype.char in _PLAIN:
            to[:] = values
        else:
            to[:] = self._readers[name].read(values, self.n)

    def _finished(self, name: str, failed: int) -> StepResult:
        self._refuse(name, failed)
        self._failed, self._stepped, self.over = failed, True, self._all.over
        self._copies.clear()
        result = self.result
        assert result is not None
        return result

    def _refuse(self, name: str, failed: int) -> None:
        """Raise for values that the environments did not accept, in the words of their reader."""
        if failed < 0:
            self._readers[name](getattr(self._all, name), self.n, self._all.ended)

    def _observe(self) -> None:
        self._copies.clear()
        self._stepped = False
        self._all.observe()
        self.over = int(np.count_nonzero(self._all.ended))

    def _table(self) -> Floats:
        found: Floats | None = self._copies.get("table")
        if found is None:
            found = self._copies["table"] = self._all.table.copy().T
        return found

    def _copy(self, name: str) -> NDArray[Any]:
        found: NDArray[Any] | None = self._copies.get(name)
        if found is None:
            found = self._copies[name] = read_only(getattr(self._all, name).copy())
        return found
