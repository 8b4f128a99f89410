"""Environments that the compiled library steps: what surrounds the kernel's step is done in the same call."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.kernel.compiled.binding import (
    EnvironmentCall,
    EnvironmentPointers,
    Library,
    LookupPointers,
    ProgramPointers,
    ReaderPointers,
    Settings,
    TapePointers,
    explain,
)
from glbench.kernel.environment import Draws, Program, Reader
from glbench.kernel.records import Rows, StepFailure, inputs_in_words
from glbench.kernel.tape import Recorder, Tape

_ACTIONS, _CONTROLS, _OBSERVE = range(3)  # ``Request`` of native/environment.hpp
_NOTHING_DRAWN = Draws(np.empty(0, np.int32), 0.0, True, Recorder().tape())


class CompiledEnvironments:
    """``n`` environments of ``program``, see ``glbench.kernel.environment.Environments``."""

    def __init__(self, library: Library, settings: Settings, program: Program, n: int) -> None:
        self._program, self._settings, self._model = program, settings, library.model
        sizes = library.model.sizes
        self._kept: list[Any] = []  # what the library holds addresses of
        self.x, self._after = np.zeros((n, sizes["x"])), np.zeros((n, sizes["x"]))
        self.u, self._next = np.zeros((n, sizes["u"])), np.zeros((n, sizes["u"]))
        self.k = np.zeros(n, np.int64)
        self.ended = np.zeros(n, np.bool_)
        self.keys = np.zeros((n, 2), np.uint64)
        self.given = np.zeros((n, len(program.actions.low)))
        self.given_controls = np.zeros((n, sizes["u"]))
        self.table = np.zeros((n, program.width))
        self.observations = np.zeros((n, program.columns), np.float32)
        self._status, self._substeps, self._reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
        own = (
            self.x, self._after, self.u, self._next, self.k, self.ended, self.keys, self.given, self.given_controls,
            self.table, self.observations, self._status, self._substeps, self._reached,
        )  # fmt: skip
        self._pointers = EnvironmentPointers(n, *(array.ctypes.data for array in own))
        pointers = self._program_pointers(program)
        calls = [
            EnvironmentCall(ctypes.addressof(settings), ctypes.addressof(pointers), ctypes.addressof(self._pointers), request)
            for request in (_ACTIONS, _CONTROLS, _OBSERVE)
        ]  # fmt: skip
        self._kept += [pointers, calls]
        self._run = library.environment
        self._step, self._step_controls, self._look = (ctypes.addressof(call) for call in calls)

    @property
    def over(self) -> int:
        """How many environments have ended, by the last call."""
        ended: int = self._pointers.over
        return ended

    def step(self) -> int:
        """Take a step with the actions ``given``.

        Returns
        -------
        int
            How many environments failed in it; -1 when a value given is out of bounds or no number, and nothing was done.
        """
        return self._advance(self._step)

    def step_controls(self) -> int:
        """Take a step with ``given_controls``, as they are. Returns what ``step`` does."""
        return self._advance(self._step_controls)

    def look(self) -> None:
        """Fill ``table`` and ``observations`` from where the environments stand."""
        self._run(self._look)

    def failures(self) -> list[StepFailure]:
        """Environments that failed in the last step, in words."""
        rows = np.flatnonzero(self._status)
        if rows.size == 0:
            return []
        # A row that failed has counted no step: its weather is still that of k.
        inputs = Rows(self._after[rows], self.u[rows], self._program.weather[self.k[rows]], self._program.nominal[None])
        return [
            StepFailure(row, f"{self._explain(row)} ({inputs_in_words(self._model, inputs, place)})")
            for place, row in enumerate(rows.tolist())
        ]

    def _advance(self, call: int) -> int:
        self._run(call)
        if self._pointers.refused:
            return -1
        self.x, self._after = self._after, self.x
        self.u, self._next = self._next, self.u
        failed: int = self._pointers.failed
        return failed

    def _explain(self, row: int) -> str:
        reached, substeps = float(self._reached[row]), int(self._substeps[row])
        return explain(self._model, int(self._status[row]), reached, substeps, self._settings)

    def _program_pointers(self, program: Program) -> ProgramPointers:
        draws = program.draws or _NOTHING_DRAWN
        lookups = (LookupPointers * len(program.lookups))(
            *(
                LookupPointers(
                    self._address(a.table, np.float32), a.table.shape[1], a.rows * a.table.shape[1], a.at, a.clocked, a.ahead
                )
                for a in program.lookups
            )
        )  # fmt: skip
        self._kept.append(lookups)
        return ProgramPointers(
            actuation=self._tape(program.actuation),
            followers=self._tape(draws.followers),
            outcome=self._tape(program.outcome),
            actions=self._reader(program.actions),
            controls=self._reader(program.controls),
            steps=program.steps,
            weather=self._address(program.weather),
            clock=self._address(program.clock),
            lag=program.lag,
            nominal=self._address(program.nominal),
            drawn=len(draws.places),
            place=self._address(draws.places, np.int32),
            half_width=draws.half_width,
            once=draws.once,
            lookups=len(program.lookups),
            lookup=lookups,
            columns=program.columns,
            width=program.width,
            head=program.head,
            charges=len(program.charges),
            charged=self._address(list(program.charges), np.int32),
            charge=self._address(list(program.charges.values())),
        )

    def _tape(self, tape: Tape) -> TapePointers:
        counts = (len(part) for part in (tape.constants, tape.inputs, tape.operations, tape.outputs))
        places = (self._address(part, np.int32) for part in (tape.inputs, tape.operations, tape.outputs))
        return TapePointers(*counts, self._address(tape.constants), *places)

    def _reader(self, reader: Reader) -> ReaderPointers:
        bounds = (reader.lowest, reader.highest, reader.low, reader.high)
        return ReaderPointers(len(reader.low), *map(self._address, bounds))

    def _address(self, values: NDArray[Any] | Sequence[float], kind: type[Any] = np.float64) -> int:
        """Address of ``values`` as C-contiguous numbers of a kind; they are kept as long as this object."""
        array = np.ascontiguousarray(values, dtype=kind)
        self._kept.append(array)
        return int(array.ctypes.data)


def fits(library: Library, program: Program) -> bool:
    """Whether the library has room for what the program works with."""
    draws = program.draws or _NOTHING_DRAWN
    registers = max(tape.registers for tape in (program.actuation, program.outcome, draws.followers))
    return registers <= library.most_registers and len(draws.places) <= library.most_drawn
