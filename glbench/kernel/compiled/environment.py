"""Environments that the compiled library steps: what surrounds the kernel's step is done in the same call."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.kernel.compiled import binding
from glbench.kernel.environment import ActionBounds, Environments, Program
from glbench.kernel.records import Rows, StepFailure, inputs_in_words
from glbench.kernel.tape import Tape

_ACTIONS, _CONTROLS, _OBSERVE = range(3)  # ``Request`` of native/environment.hpp


class CompiledEnvironments(Environments):
    """``n`` environments of ``program``, each step one call of ``library``."""

    def __init__(self, library: binding.Library, settings: binding.Settings, program: Program, n: int) -> None:
        sizes = library.model.sizes
        super().__init__(program, n, sizes["x"])
        self._program, self._settings, self._model = program, settings, library.model
        self._addressed: list[Any] = []  # what the library holds addresses of
        self._after, self._next = np.zeros_like(self.x), np.zeros_like(self.u)
        self._status, self._substeps, self._reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
        self._pointers = binding.EnvironmentPointers(n=n, days_stride=program.days, p_stride=sizes["p"] if program.own_parameters else 0)
        for name, array in {
            "x": self.x, "after": self._after, "u": self.u, "next": self._next, "k": self.k, "ended": self.ended, "key": self.keys,
            "days": self.days, "first": self.first, "p": self.parameters, "traits": self.traits, "memory": self.memory,
            "given": self.actions, "given_controls": self.direct_controls, "table": self.table, "observations": self.observations,
            "status": self._status, "substeps": self._substeps, "reached": self._reached,
        }.items():  # fmt: skip
            setattr(self._pointers, name, array.ctypes.data)
        pointers = self._program_pointers(program)
        calls = [
            binding.EnvironmentCall(ctypes.addressof(settings), ctypes.addressof(pointers), ctypes.addressof(self._pointers), request)
            for request in (_ACTIONS, _CONTROLS, _OBSERVE)
        ]  # fmt: skip
        self._addressed += [pointers, calls]
        self._run = library.environment
        self._step, self._step_controls, self._observe = (ctypes.addressof(call) for call in calls)

    @property
    def over(self) -> int:
        ended: int = self._pointers.over
        return ended

    def step(self) -> int:
        return self._advance(self._step)

    def step_controls(self) -> int:
        return self._advance(self._step_controls)

    def observe(self) -> None:
        self._run(self._observe)

    def failures(self) -> list[StepFailure]:
        rows = np.flatnonzero(self._status)
        if rows.size == 0:
            return []
        # A row that failed has counted no step: its weather is still that of k.
        day, k = self._program.day, self.k[rows]
        weather = self._program.weather[self.days[rows, k // day] + k % day]
        parameters = self.parameters[rows] if self._program.own_parameters else self.parameters
        inputs = Rows(self._after[rows], self.u[rows], weather, parameters)
        failures = []
        for place, row in enumerate(rows.tolist()):
            status, reached, substeps = int(self._status[row]), float(self._reached[row]), int(self._substeps[row])
            reason = binding.explain(self._model, status, reached, substeps, self._settings)
            failures.append(StepFailure(row, f"{reason} ({inputs_in_words(self._model, inputs, place)})"))
        return failures

    def _advance(self, call: int) -> int:
        self._run(call)
        if self._pointers.refused:
            return -1
        self.x, self._after = self._after, self.x
        self.u, self._next = self._next, self.u
        failed: int = self._pointers.failed
        return failed

    def _program_pointers(self, program: Program) -> binding.ProgramPointers:
        lookups = (binding.LookupPointers * len(program.lookups))(
            *(
                binding.LookupPointers(
                    self._address(a.table, np.float32), a.table.shape[1], a.rows, a.at, a.clocked, a.numbered, a.ahead, a.every
                )
                for a in program.lookups
            )
        )
        groups = (binding.ParameterNoisePointers * len(program.parameter_noise))(
            *(
                binding.ParameterNoisePointers(len(a.places), self._address(a.places, np.int32), a.half_width, a.every)
                for a in program.parameter_noise
            )
        )
        self._addressed += [lookups, groups]
        return binding.ProgramPointers(
            actuation=self._tape(program.actuation),
            followers=self._tape(program.followers),
            update=self._tape(program.update),
            outcome=self._tape(program.outcome),
            actions=self._bounds(program.actions),
            controls=self._bounds(program.controls),
            steps=program.steps,
            weather=self._address(program.weather),
            day=program.day,
            calendar=self._address(program.calendar),
            calendar_width=program.calendar.shape[1],
            lag=program.lag,
            drawn=len(program.parameter_noise),
            group=groups,
            streams=len(program.streams),
            numbers=self._address(program.streams, np.int64),
            traits=program.traits,
            memory=program.memory,
            lookups=len(program.lookups),
            lookup=lookups,
            columns=program.columns,
            width=program.width,
            info_columns=program.info_columns,
            charges=len(program.charges),
            charged=self._address(list(program.charges), np.int32),
            charge=self._address(list(program.charges.values())),
        )

    def _tape(self, tape: Tape) -> binding.TapePointers:
        counts = (len(part) for part in (tape.constants, tape.inputs, tape.operations, tape.outputs))
        places = (self._address(part, np.int32) for part in (tape.inputs, tape.operations, tape.outputs))
        return binding.TapePointers(*counts, self._address(tape.constants), *places)

    def _bounds(self, bounds: ActionBounds) -> binding.ActionBoundsPointers:
        each = (bounds.lowest, bounds.highest, bounds.low, bounds.high)
        return binding.ActionBoundsPointers(len(bounds.low), *map(self._address, each))

    def _address(self, values: NDArray[Any] | Sequence[float], kind: type[Any] = np.float64) -> int:
        """Address of ``values`` as C-contiguous numbers of a kind; they are kept as long as this object."""
        array = np.ascontiguousarray(values, dtype=kind)
        self._addressed.append(array)
        return int(array.ctypes.data)


def fits(library: binding.Library, program: Program) -> bool:
    """Whether the library has room for what the program works with."""
    tapes = (program.actuation, program.followers, program.update, program.outcome)
    numbers = (sum(program.streams), *(len(group.places) for group in program.parameter_noise))
    return max(tape.registers for tape in tapes) <= library.most_registers and max(numbers) <= library.most_drawn


@dataclass(frozen=True, eq=False)
class Entry:
    """Addresses of ``glb_environment`` (native/environment.hpp) and of its arguments but the environments themselves.

    They are valid as long as this object. ``settings`` and ``program`` are its ``EnvironmentCall``'s, ``parameters`` the model's count.
    """

    function: int
    settings: int
    program: int
    parameters: int
    _environments: CompiledEnvironments


def entry_of(environments: CompiledEnvironments) -> Entry:
    """The entry by which any number of environments runs the program of these."""
    call = binding.EnvironmentCall.from_address(environments._step)
    function = ctypes.cast(environments._run, ctypes.c_void_p).value
    assert function is not None
    return Entry(function, call.settings, call.program, environments.parameters.shape[1], environments)
