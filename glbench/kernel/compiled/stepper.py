"""The compiled stepper: rows of states through one control step, in place, without allocation; presets and tolerances.

The error of a substep is measured in units of ``relative*|x| + absolute``, summed over the states as squares; a sum above
one is rejected. ``absolute`` is relative to the size below which a state's value means little for the others
(``Variable.small``): 0.1 K, 1 mg m-3 of CO2, 10 Pa, 100 mg m-2 in the tomato model. Its factors (``Variable.balance``) were found by
search over 60 runs of 60 days of walking and of jumping controls: with them all states come about equally close to the errors of
CVODES. Vapour and the integrals of the canopy's temperature are what CVODES is best at.
"""

from __future__ import annotations

import ctypes
import functools
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np

from glbench.arrays import Floats
from glbench.errors import ShapeError, StepError, UnknownNameError, did_you_mean, refuse
from glbench.kernel.compiled import binding
from glbench.kernel.compiled.compiler import CompiledUnavailable
from glbench.kernel.compiled.differentiator import CompiledDifferentiator
from glbench.kernel.compiled.environment import CompiledEnvironments, fits
from glbench.kernel.compiled.library import Build, absent_equipment, build, built_files, library_is_built, traits_of
from glbench.kernel.environment import Program
from glbench.kernel.records import Rows, StepFailure, inputs_in_words
from glbench.kernel.trajectories import Horizons
from glbench.model import TOMATO, Model

Method = Literal["Rodas4P2", "GRK4T"]
METHODS: tuple[Method, ...] = ("Rodas4P2", "GRK4T")
"""As native/rows.hpp numbers them."""


@dataclass(frozen=True)
class Preset:
    """Settings of the step-size control."""

    relative: float
    """Relative tolerance of a substep."""
    first_substep: float
    """Length of the first substep of every control step [s]; fixed, so that a step depends on its inputs only."""
    fast_error_floor: float
    """The least factor on the squared errors of the fast states, long before the end of the step."""
    fast_time_constant: float = 70.0
    """Time in which an error of a fast state is taken to fade to 1/e of itself [s]."""
    singular_error_factor: float = 1e3
    """Factor on the squared errors of a substep that changes the difference of the singular states by more than half of its size. Very
    tight tolerances do without: with it they would ask for less than rounding."""
    method: Method = "Rodas4P2"
    """``"Rodas4P2"`` or ``"GRK4T"``, see native/rosenbrock.hpp."""
    last_stretch: float = math.inf
    """The end of the control step that no substep enters from before [s]. GRK4T looks at nothing beyond 0.88 of a substep: where water
    begins to condense on a screen after that, the next substep mends it, and there must be one."""
    balanced: bool = False
    """Whether the states are weighted for the comparison with CVODES (``Variable.balance``), or all alike but for a few
    (``Variable.sharper``): thin screens, all but decoupled while open, whose rare large errors when they close decide that comparison."""


PRESETS = {
    "reference": Preset(relative=1.8e-8, first_substep=1.0, fast_error_floor=3e-3, singular_error_factor=1e2),
    "standard": Preset(relative=8e-6, first_substep=3.0, fast_error_floor=1e-3, method="GRK4T", last_stretch=50.0, balanced=True),
    "fast": Preset(relative=2e-4, first_substep=8.0, fast_error_floor=2e-3, method="GRK4T", last_stretch=50.0, balanced=True),
    "tight": Preset(relative=1e-10, first_substep=0.1, fast_error_floor=1.0, singular_error_factor=1.0),
}
"""``reference``: what scores are made with, 1e-6 a step (with followers 1e-5). ``standard``: at least as accurate as CVODES at 1e-6,
which the benchmark's paper used. ``fast``: for training. ``tight``: to check the others against."""

LARGEST_SUBSTEPS = 20_000
"""More substeps than this in one control step are a failure of that row."""

SMALLEST_SUBSTEP = 1e-7
"""[s] A substep that would have to be shorter is a failure of that row."""


def get_preset(name: str | Preset) -> Preset:
    """Preset of that name; a preset of the caller's own is given back. Raises ``UnknownNameError`` when there is none."""
    if isinstance(name, Preset):
        return name
    if name not in PRESETS:
        refuse(f"The compiled kernel has no preset '{name}'.{did_you_mean(name, PRESETS)}", UnknownNameError)
    return PRESETS[name]


def tolerances(model: Model, preset: Preset) -> tuple[Floats, Floats]:
    """Absolute [unit of the state] and relative tolerance of each state (states,)."""
    weights = [state.balance if preset.balanced else state.sharper for state in model.states]
    relative = np.array([preset.relative * weight for weight in weights])
    return relative * np.array([state.small for state in model.states]), relative


_DOUBLE = np.dtype(np.float64)
_COPIED_ROWS = 64
"""Up to so many rows it is quicker to copy the inputs beside fixed pointers than to ask arrays for theirs."""


class CompiledStepper:
    """Rosenbrock methods in generated C++, see docs/kernel-compiled.md: a backend of the kernel. Not thread-safe.

    Raises ``UnknownNameError`` when there is no such preset, ``CompiledUnavailable`` when the library can be neither loaded nor built.

    A control step of ``model`` takes ``step_seconds`` [s]. ``preset`` is ``"reference"``, ``"standard"``, ``"fast"`` or ``"tight"``, or
    settings of one's own; ``settings`` has its step length and tolerances, fixed for the library. ``threads`` for large batches change no
    bit, and neither does ``width``, the number of lanes, 1, 2, 4 or 8, instead of what suits the processor.
    """

    name = "compiled"

    def __init__(
        self, model: Model, step_seconds: float, *, preset: str | Preset = "reference", threads: int = 1, width: int | None = None
    ) -> None:
        self.model = model
        self.preset = get_preset(preset)
        self.step_seconds = float(step_seconds)
        self.width = width
        self._sizes = model.sizes
        self._shared = ((model.sizes["p"],), (1, model.sizes["p"]))
        self._build = self._library_build(absent_equipment(model))
        self._library = binding.load(self._build.path, model)
        absolute, relative = tolerances(model, self.preset)
        self.settings = binding.settings_type(len(absolute))(
            step=self.step_seconds,
            first=self.preset.first_substep,
            fast_error_floor=self.preset.fast_error_floor,
            singular_error_factor=self.preset.singular_error_factor,
            fast_time_constant=self.preset.fast_time_constant,
            last=self.preset.last_stretch,
            smallest=SMALLEST_SUBSTEP,
            most=float(LARGEST_SUBSTEPS),
            absolute=tuple(absolute),
            relative=tuple(relative),
            threads=threads,
            method=METHODS.index(self.preset.method),
        )
        self._settings_call = ctypes.byref(self.settings)
        self._batch = self._new_batch(1)

    @property
    def substeps(self) -> binding.Status:
        """Substeps that each row of the last call took (n,), rejected ones included. Overwritten by the next call."""
        return self._batch.substeps

    @property
    def reached(self) -> Floats:
        """Time within the step that each row of the last call reached (n,) [s]. Overwritten by the next call."""
        return self._batch.reached

    def step_rows(self, x: Floats, u: Floats, d: Floats, p: Floats, out: Floats) -> binding.Status:
        """Advance all rows by one control step.

        States ``x`` (n, states), controls ``u`` (n, controls) and disturbances ``d`` (n, disturbances) are float64 and C-contiguous;
        parameters ``p`` (n, parameters), or (parameters,) or (1, parameters) shared by all rows. ``out`` gets the states after the step (n,
        states) and may be ``x``; rows that fail keep their state. Returns the status (n,), 0 for rows that were stepped, else for
        ``explain``, which the next call overwrites. Raises ``ShapeError`` for another shape, type or (above 64 rows) layout.
        """
        batch = self._batch
        if batch.n != len(x):
            batch = self._batch = self._new_batch(len(x))
        fits = x.shape == out.shape == batch.x_shape and u.shape == batch.u_shape and d.shape == batch.d_shape
        shared = p.shape in self._shared
        if not (fits and (shared or p.shape == batch.p_shape)) or not (x.dtype == u.dtype == d.dtype == p.dtype == out.dtype == _DOUBLE):
            raise self._wrong_arrays(x, u, d, p, out)
        pointers = batch.pointers
        pointers.p_stride = 0 if shared else batch.p_shape[1]
        if batch.n <= _COPIED_ROWS:
            batch.x[...] = x
            batch.u[...] = u
            batch.d[...] = d
            batch.p[: 1 if shared else batch.n] = p
            failed = self._library.step_rows(self._settings_call, batch.call)
            out[...] = batch.out
        else:
            if not all(a.flags.c_contiguous for a in (x, u, d, p, out)):
                raise self._wrong_arrays(x, u, d, p, out)
            pointers.x, pointers.u, pointers.d, pointers.p, pointers.out = (a.ctypes.data for a in (x, u, d, p, out))
            failed = self._library.step_rows(self._settings_call, batch.call)
        if failed:
            self._step_with_full_model(batch, x, u, d, p, out)
        return batch.status

    def advance(self, rows: Rows, out: Floats) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out`` (n, states); failed rows keep their old state and are reported."""
        if len(rows.x) == 0:
            return []
        status = self.step_rows(*rows, out)
        if not status.any():
            return []
        return [
            StepFailure(row, f"{self.explain(row)} ({inputs_in_words(self.model, rows, row)})") for row in map(int, status.nonzero()[0])
        ]

    def bind(self, rows: Rows, out: Floats) -> CompiledBoundStep:
        """A step of these very arrays, all of them tables and C-contiguous; ``out`` may be ``rows.x``. See ``Kernel.bind``."""
        pointers = binding.RowPointers()
        call = functools.partial(self._library.step_rows, self._settings_call, ctypes.byref(pointers))
        return CompiledBoundStep(self, call, pointers, rows, out)

    def walk(self, horizons: Horizons, states: Floats) -> int:
        """Step horizons together, step by step, with every pointer set beforehand: lanes and threads share them; see ``Backend.walk``."""
        n, steps = horizons.count, horizons.steps
        u, d = (np.ascontiguousarray(table.swapaxes(0, 1)) for table in (horizons.u, horizons.d))
        p, size = horizons.p, horizons.p.shape[2]
        status, substeps, reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
        calls, width = np.zeros(steps, np.dtype(binding.RowPointers)), states.shape[2]
        calls["n"], calls["p_stride"] = n, p.shape[1] * size if len(p) > 1 else 0
        strides = {"u": n * u.shape[2], "d": n * d.shape[2], "x": n * width, "p": size if p.shape[1] > 1 else 0}
        first = {"u": u.ctypes.data, "d": d.ctypes.data, "x": states.ctypes.data, "p": p.ctypes.data}
        for key, stride in strides.items():
            calls[key] = first[key] + _DOUBLE.itemsize * stride * np.arange(steps)
        calls["out"] = calls["x"] + np.uint64(_DOUBLE.itemsize * strides["x"])
        calls["status"], calls["substeps"] = status.ctypes.data, substeps.ctypes.data
        calls["reached"] = reached.ctypes.data
        equipped = p[..., list(absent_equipment(self.model))].any(axis=-1)
        library = self._full_library if equipped.size and equipped.all() else self._library
        settings, address = ctypes.addressof(self.settings), calls.ctypes.data
        for step in range(steps):
            if library.step_rows_at(settings, address + step * calls.itemsize) and self.advance(
                horizons.at(step, states[step]), states[step + 1]
            ):
                return step
        return steps

    def differentiator(self) -> CompiledDifferentiator:
        """What differentiates the steps: a second library. Raises ``CompiledUnavailable`` when it can be neither loaded nor built."""
        return CompiledDifferentiator(self.model, self.settings, self.width)

    def prepare(self, p: Floats) -> None:
        """Build now the libraries of the full model, where parameters ``p`` have equipment that the usual ones leave out."""
        if p[list(absent_equipment(self.model))].any():
            for sensitivities in (False, True):
                build(self.model, traits_of(self.model, ()), self.width, sensitivities=sensitivities)

    def environments(self, program: Program, n: int) -> CompiledEnvironments | None:
        """``n`` environments that run ``program`` around steps of this stepper's length and tolerances.

        None for a program that is too large.
        Raises ``CompiledUnavailable`` when its greenhouse has equipment that the usual library leaves out, and the other cannot be built.
        """
        equipped = bool(program.nominal[list(absent_equipment(self.model))].any())
        library = self._full_library if equipped else self._library
        return CompiledEnvironments(library, self.settings, program, n) if fits(library, program) else None

    def explain(self, row: int) -> str:
        """What went wrong in a row of the last call: which state, when, why."""
        batch = self._batch
        reached, substeps = float(batch.reached[row]), int(batch.substeps[row])
        return binding.explain(self.model, int(batch.status[row]), reached, substeps, self.settings)

    def error(self, row: int) -> StepError:
        """The error to raise for a row of the last call that failed."""
        return StepError(f"The step of {self.step_seconds:g} s failed in row {row}: {self.explain(row)}.")

    def describe(self) -> dict[str, str | float]:
        """Method, tolerances and the compiler; recorded in results."""
        preset = self.preset
        return {
            "method": preset.method,
            "relative_tolerance": preset.relative,
            "first_substep_seconds": preset.first_substep,
            "forgotten": preset.fast_error_floor,
            "memory_seconds": preset.fast_time_constant,
            "guard": preset.singular_error_factor,
            **({"last_stretch_seconds": preset.last_stretch} if math.isfinite(preset.last_stretch) else {}),
            "weights": "balanced" if preset.balanced else "even",
            "lanes": float(self._library.width),
            "compiler": self._build.compiler,
            "compiler_flags": self._build.flags,
            "library_digest": self._build.digest,
        }

    def _step_with_full_model(self, batch: _Batch, x: Floats, u: Floats, d: Floats, p: Floats, out: Floats) -> None:
        """Steps the rows whose greenhouse has equipment that the usual library leaves out."""
        rows = binding.failed_with(batch.status, binding.Failure.EQUIPMENT_PRESENT)
        if rows.size == 0:
            return
        part = self._new_batch(rows.size, copies=True)
        part.x[:], part.u[:], part.d[:] = x[rows], u[rows], d[rows]
        part.p[:] = np.broadcast_to(p, batch.p_shape)[rows]
        self._full_library.step_rows(self._settings_call, part.call)
        out[rows] = part.out
        batch.status[rows], batch.substeps[rows], batch.reached[rows] = part.status, part.substeps, part.reached

    @cached_property
    def _full_library(self) -> binding.Library:
        """Library of the model with all equipment, built when first needed."""
        return binding.load(self._library_build(()).path, self.model)

    def _library_build(self, zeros: tuple[int, ...]) -> Build:
        return build(self.model, traits_of(self.model, zeros), self.width)

    def _new_batch(self, n: int, *, copies: bool | None = None) -> _Batch:
        """Arrays for ``n`` rows; ``copies`` says whether inputs are copied (by default up to ``_COPIED_ROWS`` rows)."""
        own = n if (n <= _COPIED_ROWS if copies is None else copies) else 0
        x, u, d, p, out = (np.zeros((own, self._sizes[key])) for key in "xudpx")
        status, substeps, reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
        inputs = (a.ctypes.data for a in (x, u, d, p))
        outputs = (a.ctypes.data for a in (out, status, substeps, reached))
        pointers = binding.RowPointers(n, *inputs, self._sizes["p"], *outputs)
        shapes = ((n, self._sizes[key]) for key in "xudp")
        return _Batch(n, x, u, d, p, out, status, substeps, reached, pointers, ctypes.byref(pointers), *shapes)

    def _wrong_arrays(self, *arrays: Floats) -> ShapeError:
        got = ", ".join(f"{name} {a.dtype}{a.shape}" for name, a in zip(("x", "u", "d", "p", "out"), arrays, strict=True))
        x, u, d, p = self._sizes.values()
        msg = (
            f"step_rows wants C-contiguous float64 arrays x (n, {x}), u (n, {u}), d (n, {d}), p (n, {p}) or ({p},), "
            f"out (n, {x}), not {got}."
        )
        return ShapeError(msg)


@dataclass(frozen=True)
class _Batch:
    """Arrays and pointers for ``n`` rows; the inputs are empty where the caller's own arrays are used."""

    n: int
    x: Floats
    u: Floats
    d: Floats
    p: Floats
    out: Floats
    status: binding.Status
    substeps: binding.Status
    reached: Floats
    pointers: binding.RowPointers
    call: object  # ctypes.byref(pointers)
    x_shape: tuple[int, int]
    u_shape: tuple[int, int]
    d_shape: tuple[int, int]
    p_shape: tuple[int, int]


class CompiledBoundStep:
    """Made by ``CompiledStepper.bind``: ``step()`` advances rows, by one call of the library with all pointers set beforehand.

    Of each row, ``(n,)``, ``status`` is 0 where it was stepped, ``substeps`` are those that it took, rejected ones included, and
    ``reached`` is the time within the step that it reached [s].
    """

    def __init__(
        self, stepper: CompiledStepper, call: functools.partial[int], pointers: binding.RowPointers, rows: Rows, out: Floats
    ) -> None:
        self._stepper, self._call, self._rows, self._out = stepper, call, rows, out
        n = len(out)
        self.status, self.substeps, self.reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
        pointers.n, pointers.p_stride = n, rows.p.shape[1] if len(rows.p) > 1 else 0
        pointers.x, pointers.u, pointers.d, pointers.p = (a.ctypes.data for a in rows)
        pointers.out, pointers.reached = out.ctypes.data, self.reached.ctypes.data
        pointers.status, pointers.substeps = self.status.ctypes.data, self.substeps.ctypes.data

    def __call__(self) -> None:
        """Step the rows. Raises ``StepError`` when one could not be integrated, or an input is not finite; the others have been stepped."""
        if not self._call():
            return
        rows = np.flatnonzero(self.status)  # those that need the library of the full model, and failures
        stepped = np.empty((rows.size, self._out.shape[1]))
        status = self._stepper.step_rows(*self._rows.take(rows), stepped)
        self._out[rows], self.status[rows] = stepped, status
        self.substeps[rows], self.reached[rows] = self._stepper.substeps, self._stepper.reached
        failed = np.flatnonzero(status)
        if failed.size:
            reason = self._stepper.explain(int(failed[0]))
            refuse(f"The step of {self._stepper.step_seconds:g} s failed in row {rows[failed[0]]}: {reason}.", StepError)


def is_built(model: Model) -> bool:
    """Whether there is nothing to build for ``model``: the library is in the cache, or no compiler is there."""
    try:
        return library_is_built(model, traits_of(model, absent_equipment(model)))
    except CompiledUnavailable:
        return True


def built_libraries(model: Model, p: Floats, *, for_plans: bool) -> dict[str, Path]:
    """The files of the libraries of ``model`` in the cache, by the names for lending them; built if they are ``for_plans``.

    That of the full model is among them where parameters ``p`` have equipment that the usual one leaves out.
    """
    absent, files = absent_equipment(model), dict[str, Path]()
    try:
        for zeros in (absent, ()) if p[list(absent)].any() else (absent,):
            traits = traits_of(model, zeros)
            if for_plans:
                build(model, traits)
                build(model, traits, sensitivities=True)
            files |= built_files(model, traits)
    except CompiledUnavailable:
        return {}
    return files


def availability(model: Model = TOMATO) -> str | None:
    """None when the compiled stepper works here (built now if need be), else the reason why not."""
    try:
        CompiledStepper(model, 900.0)
    except CompiledUnavailable as error:
        return str(error)
    return None
