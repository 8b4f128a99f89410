"""Environments that execute a program with NumPy around any kernel.

They are the reference for the compiled environments and replace them where those cannot run. They execute the same tapes, so no formula is
written twice. Registered parts of a task are Python, which no tape can hold: they are called where tapes leave a gap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.kernels import Stepper
from glbench.env.random import uniforms
from glbench.env.uncertainty import DISTRIBUTIONS, UNIFORM, DerivedParameters, Deviation
from glbench.errors import TaskError
from glbench.kernel import StepFailure
from glbench.kernel.environment import ActionBounds, Environments, ParameterNoise, Program
from glbench.kernel.tape import Read, Source, Tape

ROWS_AHEAD = 1024
"""About how many rows of draws are made at once: the generator is far quicker for many than for one."""
STEPS_AHEAD = 64

_NOT_DRAWN = -(2**40)
"""First draw at hand when there is none: every other is far ahead of it."""


@dataclass(frozen=True, eq=False)
class ObservationInputs:
    """What an observation may look at, for ``n`` rows."""

    states: Floats
    controls: Floats
    """``states`` and ``controls``: after the step, ``(n, s)``, and fractions ``(n, c)``."""
    air: Floats
    """True air temperature [degC], CO2 [ppm] and relative humidity [%], ``(3, n)``, whatever sensors show."""
    steps: NDArray[np.int64]
    """Steps taken."""
    weather_rows: NDArray[np.int64]
    """Row of the weather's tables to show, by the task's timing: the one that acts next ("current") or the one that has just acted
    ("published")."""
    clock_rows: NDArray[np.int64]
    """Row of the clock's table."""


@dataclass(frozen=True, eq=False)
class PythonParts:
    """The parts of a task that no tape holds."""

    air: slice
    """Columns of the table with the air."""
    actuation: Callable[[Floats, Floats], Floats] | None = None
    """Controls ``(n, c)`` from the controls in force and the actions ``(n, m)``."""
    reward: tuple[int, Callable[[Floats, Floats, Floats, Floats], Floats]] | None = None
    """The column of the table, and what gives it from the table ``(n, width)``, the states before and after, and the controls."""
    observation: tuple[tuple[slice, Callable[[ObservationInputs, NDArray[np.bool_]], NDArray[np.floating[Any]]]], ...] = ()
    """Columns, and what gives them; it also gets the rows that count."""
    deviations: tuple[Deviation, ...] = ()
    """The distribution of each group of the program's parameters."""
    followers: DerivedParameters | None = None
    """What follows from drawn parameters by more than arithmetic."""


NO_PARTS = PythonParts(slice(0, 0))


def weather_rows(program: Program, runs: Environments, steps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows of the pool that are the weather of ``steps`` of ``runs``, ``(n,)`` or ``(n, m)``."""
    rows = np.arange(len(runs.k))
    return runs.days[rows if steps.ndim == 1 else rows[:, None], steps // program.day] + steps % program.day


def shown_steps(program: Program, runs: Environments) -> NDArray[np.int64]:
    """Steps whose weather is shown, ``(n,)``."""
    return np.maximum(runs.k - program.lag, 0)


def tape_reader(
    program: Program,
    runs: Environments,
    tape: Tape,
    before: Floats,
    after: Floats,
    controls: Floats,
    steps_before: NDArray[np.int64],
    *,
    controls_before: Floats | None = None,
    actions: Floats | None = None,
    weather_steps: NDArray[np.int64] | None = None,
) -> Read:
    """What a tape reads of ``runs``, which may be any environments of ``program``.

    ``weather_steps`` are the steps whose weather it reads, by default those shown; ``controls_before`` are by default the controls now.
    """
    noise = None
    if tape.reads("noise"):  # the numbers of all streams in this step, side by side
        streams = enumerate(program.streams, len(program.parameter_noise))
        noise = np.hstack([uniforms(runs.keys[:, place], runs.k[:, None], count)[:, 0] for place, count in streams])
    calendar = {"calendar": runs.first + runs.k, "calendar_before": runs.first + steps_before}
    arrays = {
        "before": before,
        "after": after,
        "controls": controls,
        "controls_before": controls if controls_before is None else controls_before,
        "given": actions,
        "trait": runs.traits,
        "memory": runs.memory.copy(),
        "noise": noise,
    }

    def read(source: Source, index: int) -> Any:
        if source in calendar:
            return program.calendar[calendar[source], index]
        if source == "weather":
            steps = shown_steps(program, runs) if weather_steps is None else weather_steps
            return program.weather[weather_rows(program, runs, steps), index]
        if source == "weather_before":
            return program.weather[weather_rows(program, runs, steps_before), index]
        if source == "counter":
            return (runs.k if index == 0 else shown_steps(program, runs)).astype(np.float64)
        array = arrays[source]
        assert array is not None
        return array[:, index]

    return read


class NumpyEnvironments(Environments):
    """``n`` environments of ``program`` around ``kernel``, of a model with ``states``."""

    def __init__(self, program: Program, n: int, kernel: Stepper, states: int, parts: PythonParts = NO_PARTS) -> None:
        super().__init__(program, n, states)
        self._program, self._kernel, self._parts, self._n = program, kernel, parts, n
        self._draws = ParameterDraws(program, parts, n)
        self._failures: list[StepFailure] = []
        self._forget()

    @property
    def over(self) -> int:
        return int(np.count_nonzero(self.ended))

    def step(self) -> int:
        actions = self._within(self._program.actions, self.actions)
        if actions is None:
            return -1
        controls, running = np.zeros_like(self.u), ~self.ended
        if self._parts.actuation is not None:
            controls = np.array(self._parts.actuation(self.u, actions), dtype=np.float64)
            if not np.isfinite(controls[running]).all():
                msg = "The task's kind of actuation, a registered part, returned controls that are not finite numbers (NaN or infinite)."
                raise TaskError(msg)
        tape = self._program.actuation
        read = tape_reader(self._program, self, tape, self.x, self.x, self.u, self.k, actions=actions, weather_steps=self.k)
        for target, index, values in tape.play(read):
            if target == "memory":
                self.memory[running, index] = np.broadcast_to(values, self._n)[running]
            else:
                controls[:, index] = values
        return self._advance(controls)

    def step_controls(self) -> int:
        controls = self._within(self._program.controls, self.direct_controls)
        return -1 if controls is None else self._advance(controls)

    def observe(self) -> None:
        self._forget()
        self._look(self.x, self.x, self.k, controls_before=None)

    def failures(self) -> list[StepFailure]:
        return self._failures

    def _forget(self) -> None:
        """Invalidate prefetched draws; keys or parameters may have changed."""
        self._draws.begin(self.parameters)

    def _within(self, bounds: ActionBounds, values: Floats) -> Floats | None:
        """A copy of ``values`` within their bounds; ``None`` when one of a running environment is not accepted."""
        values = values.copy()
        values[self.ended] = bounds.low
        if not ((values >= bounds.lowest) & (values <= bounds.highest)).all():  # False for NaN as well
            return None
        values += 0.0  # -0.0 becomes 0.0: which of two zeros is the larger depends on the place in the batch
        return np.minimum(np.maximum(values, bounds.low), bounds.high)

    def _advance(self, controls: Floats) -> int:
        """One step of all environments that run under ``controls``, which are this method's to keep."""
        program, before, controls_before, had_ended = self._program, self.x, self.u, self.ended.copy()
        controls[had_ended] = self.u[had_ended]
        after, self._failures = self._flow(controls)
        success = ~had_ended
        success[[failure.row for failure in self._failures]] = False
        steps_before = self.k.copy()
        self.k[success] += 1
        self.x, self.u = after, controls
        if len(program.update.outputs) and success.any():
            read = tape_reader(program, self, program.update, before, after, controls, steps_before, controls_before=controls_before)
            for _, index, values in program.update.play(read):
                self.memory[success, index] = np.broadcast_to(values, self._n)[success]
        self._look(before, after, steps_before, controls_before=controls_before)
        self.table[had_ended, program.info_columns :] = 0.0
        for failure in self._failures:
            self.ended[failure.row] = True
            for column, value in program.charges.items():
                self.table[failure.row, column] = value
        self.ended |= self.k >= program.steps
        return len(self._failures)

    def _flow(self, controls: Floats) -> tuple[Floats, list[StepFailure]]:
        """States after the step, and the rows that failed; rows that have ended are not integrated."""
        program = self._program
        weather = program.weather[weather_rows(program, self, self.k)]
        if program.parameter_noise:
            parameters = self._draws.of_step(self.parameters, self.keys, self.k)
        else:  # ``(p,)`` where all share them
            parameters = self.parameters if program.own_parameters else self.parameters[0]
        if not self.ended.any():
            return self._kernel.try_step(self.x, controls, weather, parameters)
        after = self.x.copy()
        rows = np.flatnonzero(~self.ended)
        if rows.size == 0:
            return after, []
        own = parameters if parameters.ndim == 1 else parameters[rows]
        moved, failed = self._kernel.try_step(self.x[rows], controls[rows], weather[rows], own)
        after[rows] = moved
        return after, [replace(failure, row=int(rows[failure.row])) for failure in failed]

    def _valid_rows(self) -> NDArray[np.bool_]:
        """Rows whose numbers count: neither ended before the step nor failed in it."""
        valid: NDArray[np.bool_] = ~self.ended
        valid[[failure.row for failure in self._failures]] = False
        return valid

    def _look(self, before: Floats, after: Floats, steps_before: NDArray[np.int64], *, controls_before: Floats | None) -> None:
        """Fill table and observations after a step, or without one: then there are no ``controls_before``."""
        program, parts = self._program, self._parts
        read = tape_reader(program, self, program.outcome, before, after, self.u, steps_before, controls_before=controls_before)
        with np.errstate(over="ignore"):
            for target, index, values in program.outcome.play(read):
                (self.table if target == "table" else self.observations)[:, index] = values
        for lookup in program.lookups:
            ahead = np.arange(lookup.rows) + lookup.ahead
            clock, weather = (self.first + self.k)[:, None] + ahead, shown_steps(program, self)[:, None] + ahead
            rows = clock if lookup.clocked else weather_rows(program, self, weather)
            if lookup.numbered:
                rows = np.fmax(self.observations[:, [lookup.at]], 0.0).astype(np.int64)  # not a number: the first row
            width = lookup.rows * lookup.table.shape[1]
            self.observations[:, lookup.at : lookup.at + width] = lookup.table[rows // lookup.every].reshape(self._n, width)
        if parts.reward is not None and controls_before is not None:
            column, reward = parts.reward
            self.table[:, column] = reward(self.table, before, after, self.u)
            if not np.isfinite(self.table[self._valid_rows(), column]).all():
                msg = "A reward module of the task, a registered part, returned a reward that is no finite number (NaN or infinite)."
                raise TaskError(msg)
        if parts.observation:
            air = self.table[:, parts.air].T.copy()
            rows = weather_rows(program, self, shown_steps(program, self))
            inputs = ObservationInputs(after, self.u, air, self.k.copy(), rows, self.first + self.k)
            for columns, part in parts.observation:
                self.observations[:, columns] = part(inputs, self._valid_rows())


class ParameterDraws:
    """The parameters of steps in which a program draws some, for ``n`` rows."""

    def __init__(self, program: Program, parts: PythonParts, n: int) -> None:
        deviations = parts.deviations or (DISTRIBUTIONS[UNIFORM],) * len(program.parameter_noise)
        self._groups = [_Group(noise, deviation, n) for noise, deviation in zip(program.parameter_noise, deviations, strict=True)]
        self._python_followers, self._followers = parts.followers, program.followers
        self._p = np.empty((n, len(program.nominal)))

    def begin(self, parameters: Floats) -> None:
        """Take the parameters of other runs, ``(n, p)`` or ``(1, p)``."""
        self._p[:] = parameters
        for group in self._groups:
            group.first[:] = _NOT_DRAWN

    def of_step(self, parameters: Floats, keys: NDArray[np.uint64], k: NDArray[np.int64]) -> Floats:
        """Parameters ``(n, p)`` in the steps ``k``, overwritten by the next call; ``parameters`` are those of ``begin``."""
        for number, group in enumerate(self._groups):
            deviations = group.deviations(keys[:, number], k)
            self._p[:, group.places] = parameters[:, group.places] * (1.0 + deviations)
        if self._python_followers is not None:
            self._python_followers.complete(self._p)
        for _, place, values in self._followers.play(lambda source, index: self._p[:, index].copy()):
            self._p[:, place] = values
        return self._p


class _Group:
    """Draws of a group of parameters, some steps ahead."""

    def __init__(self, noise: ParameterNoise, deviation: Deviation, n: int) -> None:
        self.places = np.asarray(noise.places)
        self._half_width, self._every, self._deviation = noise.half_width, noise.every, deviation
        self._ahead = max(1, min(STEPS_AHEAD, ROWS_AHEAD // n))
        self.first = np.full(n, _NOT_DRAWN)
        self._prefetched = np.empty((n, self._ahead, len(self.places)))
        self._rows = np.arange(n)

    def deviations(self, keys: NDArray[np.uint64], k: NDArray[np.int64]) -> Floats:
        """Relative deviations in the steps ``k`` of the runs, ``(n, places)``."""
        draws = k // self._every
        offset = draws - self.first
        if offset.max() >= self._ahead:
            rows = np.flatnonzero(offset >= self._ahead)
            steps = draws[rows, None] + np.arange(self._ahead)
            numbers = uniforms(keys[rows], steps, len(self.places))
            self._prefetched[rows] = self._deviation(numbers, self._half_width)
            self.first[rows] = draws[rows]
            offset[rows] = 0
        deviations: Floats = self._prefetched[self._rows, offset]
        return deviations
