"""``n`` runs of one task in lockstep: behind the environment, the vector environment and the evaluation."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.arrays import Floats, real_numbers
from glbench.env.accounts import REWARD, make_accounts
from glbench.env.actuation import ActionReader, run_calendar
from glbench.env.kernels import SCORING_PRESET, Stepper, check_kernel, shared_kernel
from glbench.env.numpy_environments import NO_PARTS, NumpyEnvironments, ParameterDraws, tape_reader
from glbench.env.program import air_columns, info_columns, make_program
from glbench.env.scenario import RunScenarios
from glbench.env.snapshot import Snapshot
from glbench.env.spaces import GENERATOR_WORDS, checked_seed, the_task
from glbench.errors import GlbenchError, ShapeError, TaskError, refuse
from glbench.kernel import StepFailure
from glbench.kernel.environment import Environments
from glbench.kernel.records import all_finite
from glbench.kernel.tape import Tape
from glbench.tasks import TaskSpec

_REAL_TYPES = "fd"
"""Codes of the types that are copied without a look at them: float32 and float64."""


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """``array``, made read-only."""
    array.flags.writeable = False
    return array


@dataclass(frozen=True, eq=False)
class StepResult:
    """What one step of ``n`` runs gave."""

    observations: NDArray[np.float32]
    """``(n, columns)`` float32."""
    rewards: Floats
    """``(n,)``."""
    terminated: NDArray[np.bool_]
    """``(n,)``; whether the run has ended, in this step or before."""
    failed: list[StepFailure]
    """Runs that could not be integrated in this step, with the reason in words. Such a run keeps its state and ends. Its reward, EPI and
    penalty are what the task counts for one failed step; the other quantities are those of a step in which nothing grew."""
    table: Floats
    """The quantities of the step, ``(quantities, n)``; rows, units and meanings in ``task.quantities``. 0 for a run that had ended before.
    """
    names: tuple[str, ...]
    """Names of the quantities."""

    @property
    def whole(self) -> bool:
        """Whether no run failed and every number is finite; huge ones (1e150) may count as infinite."""
        return not self.failed and all_finite(self.table)

    @cached_property
    def quantities(self) -> dict[str, Floats]:
        """The rows of ``table`` by name, each ``(n,)``."""
        return dict(zip(self.names, self.table, strict=True))


def check_runs(n: int) -> None:
    """Refuse an impossible number of runs. Raises ``ShapeError`` when it is not a whole number, or less than one."""
    if not isinstance(n, int | np.integer) or isinstance(n, bool) or n < 1:
        refuse(f"A simulation has a whole number of runs, at least one; got {n!r}.", ShapeError)


def run_parameters(task: TaskSpec, seed: int) -> Floats:
    """Parameters of the run with ``seed``: ``(p,)`` if they are constant, ``(steps, p)`` if some are drawn in every step."""
    program, parts = make_program(task)
    scenes = RunScenarios(task).draw([seed])
    start = program.nominal[None] if scenes.parameters is None else scenes.parameters
    if not program.parameter_noise:
        constant: Floats = start[0].copy()
        return constant
    draws = ParameterDraws(program, parts, task.steps)
    draws.begin(start)
    return draws.of_step(start, scenes.keys.repeat(task.steps, axis=0), np.arange(task.steps))


class Simulation:
    """``n`` runs of ``task``, each with its own seed and step counter, stepped together.

    A run gives the same bits alone, in any batch, at any place in it. A run that has ended (at the horizon or by a failed
    step) stays as it is: its action is not looked at, its quantities are 0. Not safe for use by several threads at once.

    The runs' environments overwrite their arrays in every step. The arrays here are read-only copies, made on first access after a step.

    ``n`` is 1 or more. ``kernel`` integrates a step: a ``Kernel``, or the name of a preset, by default ``"reference"``, for a kernel that
    all simulations of this thread share. ``fused``: whether a step may be one call of the compiled kernel, where that is the kernel and
    every part of the task is one that glbench ships. It changes no bit; without it numpy steps around the kernel.

    ``seeds`` are those of the runs ``(n,)``, read-only, ``over`` how many have ended, ``p_nominal`` the nominal parameters
    ``(parameters,)``; ``scenarios`` draws the scenario of a run from its seed.
    """

    def __init__(self, task: TaskSpec | str, n: int, kernel: Stepper | str | None = None, *, fused: bool = True) -> None:
        check_runs(n)
        self.task = task = the_task(task)
        check_kernel(kernel, task)
        self.n = n
        self.p_nominal = task.parameters()
        self.accounts = make_accounts(task)
        self._program = make_program(task)  # raises for an unknown part, or one that does not fit the task
        self.scenarios = RunScenarios(task)
        self.seeds = read_only(np.zeros(n, dtype=np.uint64))
        self.over = 0
        self._kernel_choice, self._may_fuse = kernel, fused
        self._readers = {"actions": ActionReader.of_task(task), "direct_controls": ActionReader.of_controls(task)}
        self._air, self._info = air_columns(task), info_columns(task)
        self._ready = False  # whether reset or restore was called
        self._has_result = False
        self._failures = 0
        self._copies: dict[str, Any] = {}

    @cached_property
    def kernel(self) -> Stepper:
        """What integrates a step."""
        choice = self._kernel_choice
        if choice is None or isinstance(choice, str):
            return shared_kernel(self.task.model_value, self.task.step_seconds, choice or SCORING_PRESET)
        return choice

    @cached_property
    def _environments(self) -> Environments:
        """Made when first needed, because it may compile the kernel; before ``reset`` they stand at the start of seed 0."""
        program, parts = self._program
        make = getattr(self.kernel, "environments", None)  # a custom kernel steps states only
        environments: Environments | None = None
        if self._may_fuse and make is not None and parts is NO_PARTS:
            environments = make(program, self.n)
        if environments is None:
            states = len(self.task.model_value.states)
            environments = NumpyEnvironments(program, self.n, self.kernel, states, parts)
        vars(self)["_environments"] = environments
        self._first_run = environments.table[0], environments.observations[0], environments.actions[0]
        self._start(np.arange(self.n), [0] * self.n)
        return environments

    @property
    def fused(self) -> bool:
        """Whether a step is one call of the compiled kernel."""
        return not isinstance(self._environments, NumpyEnvironments)

    @property
    def x(self) -> Floats:
        """States ``(n, states)``, read-only; replaced in every step, never written to."""
        return self._copy("x")

    @property
    def u(self) -> Floats:
        """Controls in force ``(n, controls)``, fractions: what actuators deliver; read-only, replaced in every step."""
        return self._copy("u")

    @property
    def commands(self) -> Floats:
        """What the actuators were told, ``(n, controls)``, fractions, read-only: ``u`` where they are ideal."""
        commands = self.u.copy()
        for index, place in self.scenarios.actuators.command_places(self.scenarios.memory_layout).items():
            commands[:, index] = self._environments.memory[:, place]
        return read_only(commands)

    @property
    def k(self) -> NDArray[np.int64]:
        """Steps taken ``(n,)``, read-only; replaced in every step."""
        return self._copy("k")

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Whether a run has ended ``(n,)``, read-only."""
        return self._copy("ended")

    @property
    def memory(self) -> Floats:
        """What the runs keep from step to step besides states and controls ``(n, m)``, read-only."""
        return self._copy("memory")

    @property
    def air(self) -> Floats:
        """Air temperature [degC], CO2 [ppm] and relative humidity [%] inside, ``(3, n)``, read-only; ``(0, n)`` without an air."""
        if "air" not in self._copies:
            self._copies["air"] = read_only(self._table()[self._air].copy())
        air: Floats = self._copies["air"]
        return air

    @property
    def info_columns(self) -> Floats:
        """Steps taken, hour of day [h], day of year, air, controls in physical units, ``(columns, n)``: ``info`` without a step."""
        return self._table()[: self._info]

    @property
    def result(self) -> StepResult | None:
        """What the last step gave; ``None`` when runs were reset or restored since."""
        if not self._has_result:
            return None
        if "result" not in self._copies:
            table = self._table()[self._info :]
            self._copies["result"] = StepResult(
                self._environments.observations.copy(),
                table[REWARD],
                self.ended,
                self._environments.failures() if self._failures else [],
                table,
                tuple(quantity.name for quantity in self.task.quantities),
            )
        result: StepResult = self._copies["result"]
        return result

    @property
    def d(self) -> Floats:
        """Disturbances that act in each run's next step, ``(n, disturbances)``: what a privileged controller may know."""
        day, k = self.scenarios.pool.day, self._environments.k
        rows: Floats = self.scenarios.pool.values[self._environments.days[np.arange(self.n), k // day] + k % day]
        return rows

    @property
    def hour_of_day(self) -> Floats:
        """Hour of day at the start of each run's next step, ``(n,)``, 0 to 24."""
        rows: Floats = self.scenarios.pool.calendar[self._calendar_rows(), 0]
        return rows

    @property
    def day_of_year(self) -> Floats:
        """Day of year at the start of each run's next step, ``(n,)``, 0 at the start of 1 January."""
        rows: Floats = self.scenarios.pool.calendar[self._calendar_rows(), 1]
        return rows

    @property
    def time(self) -> NDArray[np.datetime64]:
        """Date and time (UTC) at the start of each run's next step, ``(n,)``."""
        return self.scenarios.pool.times[self._calendar_rows()]

    def reset(self, seeds: Sequence[int] | NDArray[np.integer], rows: ArrayLike | None = None) -> NDArray[np.float32]:
        """Restart runs with ``seeds`` (one each), in all rows or in ``rows`` (numbers or a mask).

        Raises ``GlbenchError`` when there are not as many seeds as rows, a seed is not a whole number from 0 to 2**64 - 1, or some rows
        only are reset before all were. Returns the observations of all rows, ``(n, columns)`` float32.
        """
        places = self._rows(rows)
        numbers = [checked_seed(seed) for seed in seeds]
        if len(numbers) != len(places):
            refuse(f"reset got {len(numbers)} seeds for {len(places)} runs. Give one seed a run.", ShapeError)
        if rows is not None and not self._ready:
            refuse("Some runs cannot be reset before all were: call reset with one seed for each run first.", GlbenchError)
        all_seeds = self.seeds.copy()
        all_seeds[places] = np.array(numbers, dtype=np.uint64)
        self.seeds = read_only(all_seeds)
        self._start(places, numbers)
        self._ready = True
        return self.observe()

    def observe(self) -> NDArray[np.float32]:
        """Observations of all runs as they stand, ``(n, columns)`` float32."""
        return self._environments.observations.copy()

    def step(self, actions: ArrayLike) -> StepResult:
        """Take one step with ``actions`` ``(n, m)``, in the order and bounds of the task's card.

        Raises ``ActionError`` for a wrong shape, or a value that is not finite or out of bounds; nothing is simulated then. Raises
        ``GlbenchError`` when all runs have ended, or none was started.
        """
        self._check_running()
        self._write("actions", actions)
        self._finish_step("actions", self._environments.step())
        return self._step_result()

    def step_single(self, action: ArrayLike) -> tuple[NDArray[np.float32], list[float], bool]:
        """Take one step with the only run, without the cost of arrays for many.

        The action is ``(m,)``. Returns the observation ``(columns,)`` float32; the numbers of ``info_columns`` and, after them, the step's
        quantities; whether the run has ended. ``result`` has the rest.
        """
        if not self._ready or self.over == self.n:
            self._check_running()
        environments = self._environments
        table, observation, values = self._first_run
        if type(action) is np.ndarray and action.shape == values.shape and action.dtype.char in _REAL_TYPES:
            values[:] = action
        else:
            numbers = real_numbers(action)
            self._write("actions", action if numbers is None else numbers[None])
        self._finish_step("actions", environments.step())
        return observation.copy(), table.tolist(), self.over == 1

    def step_controls(self, controls: ArrayLike) -> StepResult:
        """Take one step with ``controls`` ``(n, controls)``, fractions applied as they are: no actuation, no rate limit.

        They are commands where the task has actuators that are not ideal. Scheduled ones follow the schedule, whatever is given. For
        privileged controllers and for replaying. Raises as ``step`` does.
        """
        self._check_running()
        self._write("direct_controls", controls)
        if places := [*self.task.scheduled_places.values()]:
            calendar = run_calendar(self.task, self.scenarios.pool.calendar[self._calendar_rows()], self._environments.k)
            self._environments.direct_controls[:, places] = calendar[:, -len(places) :]
        if self.scenarios.actuators.actuators:
            self._deliver()
        self._finish_step("direct_controls", self._environments.step_controls())
        return self._step_result()

    @cached_property
    def _delivery(self) -> Tape:
        return self.scenarios.actuators.tape(self.scenarios.memory_layout, self.scenarios.actuator_draws)

    def _deliver(self) -> None:
        """Replace the commands among the controls given by what actuators deliver, as the program does in a step with actions."""
        runs, tape, running = self._environments, self._delivery, ~self._environments.ended
        commands = self._readers["direct_controls"](runs.direct_controls, self.n, runs.ended)
        read = tape_reader(self._program[0], runs, tape, runs.x, runs.x, runs.u, runs.k, actions=commands, weather_steps=runs.k)
        for target, index, values in tape.play(read):
            array = runs.memory if target == "memory" else runs.direct_controls
            array[running, index] = values[running]

    def end(self, rows: ArrayLike) -> None:
        """End the runs in ``rows`` (numbers or a mask) where they stand, for a reason outside the simulation."""
        ended = self._environments.ended
        ended[self._rows(rows)] = True
        self.over = int(np.count_nonzero(ended))
        self._copies.pop("ended", None)

    def __getstate__(self) -> dict[str, Any]:
        """What makes another simulation that continues from here: no kernel's memory, no arrays of the compiled library."""
        return {
            "made_with": (self.task, self.n, self._kernel_choice),
            "fused": self._may_fuse,
            "snapshot": self.snapshot() if self._ready else None,
            "result": self.result if self._ready else None,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Continue where the copied or pickled simulation stood."""
        self.__init__(*state["made_with"], fused=state["fused"])  # type: ignore[misc]
        if state["snapshot"] is not None:
            self._continue(state["snapshot"], state["result"])

    def snapshot(self) -> Snapshot:
        """What ``restore`` needs to continue from here with the same bits."""
        self._check_ready()
        task, generators = self.task, np.empty((0, GENERATOR_WORDS), dtype=np.uint64)  # no environment draws the seeds
        return Snapshot(
            task.id, task.digest, self.x, self.u, self.k, self.seeds, self.ended, generators, self.memory, _split(task)
        )  # fmt: skip

    def restore(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Continue from ``snapshot``; the observations of all rows, ``(n, columns)`` float32.

        Raises ``TaskError`` when it was taken of another task, of another version of it, or of another of its splits. Raises ``ShapeError``
        when it has another number of rows.
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
            refuse(f"The snapshot has {snapshot.n} rows, the simulation {self.n}. Choose rows with snapshot.take([...]).", ShapeError)
        self._continue(snapshot, None)
        return self.observe()

    def _continue(self, snapshot: Snapshot, result: StepResult | None) -> None:
        """Continue all runs from ``snapshot``; ``result`` is what their last step gave, if that is known."""
        environments = self._environments
        self.seeds = read_only(snapshot.seeds.copy())
        self._set_scenarios(np.arange(self.n), snapshot.seeds.tolist())
        environments.x[:], environments.u[:], environments.k[:] = snapshot.states, snapshot.controls, snapshot.steps
        environments.ended[:], environments.memory[:] = snapshot.ended, snapshot.memory
        self._observe()
        if result is not None:
            self._copies["result"], self._has_result = result, True
        self._ready = True

    def _start(self, rows: NDArray[np.intp], seeds: Sequence[int]) -> None:
        environments = self._environments
        environments.x[rows], environments.memory[rows] = self._set_scenarios(rows, seeds)
        environments.u[rows], environments.k[rows], environments.ended[rows] = self.task.initial_controls, 0, False
        self._observe()

    def _set_scenarios(self, rows: NDArray[np.intp], seeds: Sequence[int]) -> tuple[Floats, Floats]:
        """Give the runs in ``rows`` the scenarios of ``seeds``; returns the states and the memory that they start with."""
        environments, scenes = self._environments, self.scenarios.draw(seeds)
        environments.days[rows], environments.first[rows] = scenes.days, scenes.first
        environments.keys[rows], environments.traits[rows] = scenes.keys, scenes.traits
        if scenes.parameters is not None:
            environments.parameters[rows] = scenes.parameters
        return scenes.states, scenes.memory

    def _observe(self) -> None:
        self._copies.clear()
        self._has_result = False
        self._environments.observe()
        self.over = int(np.count_nonzero(self._environments.ended))

    def _write(self, name: str, values: ArrayLike) -> None:
        """Write actions or controls into the environments' array ``name``."""
        array: Floats = getattr(self._environments, name)
        if type(values) is np.ndarray and values.shape == array.shape and values.dtype.char in _REAL_TYPES:
            array[:] = values
        else:
            array[:] = self._readers[name].read(values, self.n)

    def _finish_step(self, name: str, failures: int) -> None:
        """Take note of a step; raises for values that the environments did not accept, with the message of their reader."""
        environments = self._environments
        if failures < 0:
            self._readers[name](getattr(environments, name), self.n, environments.ended)
        self._failures, self._has_result, self.over = failures, True, environments.over
        self._copies.clear()

    def _step_result(self) -> StepResult:
        result = self.result
        assert result is not None
        return result

    def _calendar_rows(self) -> NDArray[np.int64]:
        """Row of the pool's calendar at which each run stands ``(n,)``."""
        return self._environments.first + self._environments.k

    def _table(self) -> Floats:
        if "table" not in self._copies:
            self._copies["table"] = self._environments.table.copy().T
        table: Floats = self._copies["table"]
        return table

    def _copy(self, name: str) -> NDArray[Any]:
        if name not in self._copies:
            self._copies[name] = read_only(getattr(self._environments, name).copy())
        array: NDArray[Any] = self._copies[name]
        return array

    def _rows(self, rows: ArrayLike | None) -> NDArray[np.intp]:
        """Row numbers from numbers, a mask, or ``None`` for all."""
        everything = np.arange(self.n)
        if rows is None:
            return everything
        index = np.asarray(rows)
        return np.atleast_1d(everything[index if index.dtype == np.bool_ else index.astype(np.intp)])

    def _check_ready(self) -> None:
        if not self._ready:
            refuse("Nothing was started yet: call reset first.", GlbenchError)

    def _check_running(self) -> None:
        self._check_ready()
        if self.over == self.n:
            refuse("Every run has ended. Call reset to start new ones.", GlbenchError)


def _split(task: TaskSpec) -> str:
    """What determines the scenario of a run besides the digest of the task and the seed."""
    if not task.sealed:
        return task.split or ""
    return f"{task.split}, secret salt {hashlib.sha256(task.sealed.encode('utf-8')).hexdigest()[:16]}"
