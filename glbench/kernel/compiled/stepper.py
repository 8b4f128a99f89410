"""The compiled stepper: rows of states through one control step, in place, without allocation."""

from __future__ import annotations

import ctypes
import functools
import math

import numpy as np

from glbench.errors import StepError
from glbench.kernel.compiled.batch import COPIED_ROWS, SHARED, SIZES, Array, Batch, Status, new_batch, wrong_arrays
from glbench.kernel.compiled.binding import Library, RowPointers, Settings, load
from glbench.kernel.compiled.bound import CompiledBoundStep
from glbench.kernel.compiled.environment import CompiledEnvironments, fits
from glbench.kernel.compiled.failures import Failure, explain
from glbench.kernel.compiled.generate import Traits
from glbench.kernel.compiled.library import Build, build, library_is_built
from glbench.kernel.compiled.tolerances import (
    FAST_STATES,
    LARGEST_SUBSTEPS,
    METHODS,
    SINGULAR_STATES,
    SMALLEST_SUBSTEP,
    Preset,
    get_preset,
    tolerances,
)
from glbench.kernel.compiled.unavailable import CompiledUnavailable
from glbench.kernel.environment import Program
from glbench.model import STATE_NAMES, default_parameters
from glbench.model.variants import get_variant

_DOUBLE = np.dtype(np.float64)


class CompiledStepper:
    """Rosenbrock methods in generated C++, see docs/kernel-compiled.md. Not thread-safe: one stepper a Python thread.

    Parameters
    ----------
    step_seconds : float
        Length of the control step [s].
    variant : str
        Model variant, see ``glbench.model.VARIANTS``.
    preset : str or Preset
        ``"reference"``, ``"standard"``, ``"fast"`` or ``"tight"``, or settings of one's own.
    threads : int
        Threads for large batches. They change no bit.
    width : int, optional
        Number of lanes, 1, 2, 4 or 8, instead of what suits the processor. It changes no bit.

    Attributes
    ----------
    substeps : ndarray
        Substeps that each row of the last call took (n,), rejected ones included. Overwritten by the next call.
    reached : ndarray
        Time within the step that each row of the last call reached (n,) [s].
    settings : Settings
        What the library is told of step length and tolerances; fixed.

    Raises
    ------
    UnknownNameError
        When there is no such variant or preset.
    CompiledUnavailable
        When the library can be neither loaded nor built.
    """

    def __init__(
        self,
        step_seconds: float,
        *,
        variant: str = "author",
        preset: str | Preset = "reference",
        threads: int = 1,
        width: int | None = None,
    ) -> None:
        self.preset = get_preset(preset)
        get_variant(variant)
        self.step_seconds = float(step_seconds)
        self.variant = variant
        self.threads = threads
        self._width = width
        self._build = self._library_build(absent_equipment())
        self._library = load(self._build.path)
        self._full: Library | None = None
        absolute, relative = tolerances(self.preset)
        self.settings = Settings(
            step=self.step_seconds,
            first=self.preset.first_substep,
            forgotten=self.preset.forgotten,
            guard=self.preset.guard,
            memory=self.preset.memory,
            last=self.preset.last_stretch,
            smallest=SMALLEST_SUBSTEP,
            most=float(LARGEST_SUBSTEPS),
            absolute=(ctypes.c_double * len(absolute))(*absolute),
            relative=(ctypes.c_double * len(relative))(*relative),
            threads=threads,
            method=METHODS.index(self.preset.method),
        )
        self._settings_call = ctypes.byref(self.settings)
        self._batch = new_batch(1)

    @property
    def substeps(self) -> Status:
        """Substeps of the rows of the last call (n,)."""
        return self._batch.substeps

    @property
    def reached(self) -> Array:
        """Time that the rows of the last call reached (n,) [s]."""
        return self._batch.reached

    @property
    def width(self) -> int | None:
        """Number of lanes that was asked for, if any."""
        return self._width

    @property
    def library_path(self) -> str:
        """The shared library in the cache."""
        return self._build.path

    def step_rows(self, x: Array, u: Array, d: Array, p: Array, out: Array) -> Status:
        """Advance all rows by one control step.

        Parameters
        ----------
        x, u, d : ndarray
            States (n, 28), controls (n, 6), disturbances (n, 10): float64, C-contiguous.
        p : ndarray
            Parameters (n, 208), or (208,) or (1, 208) shared by all rows.
        out : ndarray
            States after the step (n, 28); may be ``x``. Rows that fail keep their state.

        Returns
        -------
        ndarray
            Status (n,), 0 for rows that were stepped, else for ``explain``. Overwritten by the next call.

        Raises
        ------
        ShapeError
            When an array has another shape or type, or, with more than 64 rows, another layout.
        """
        batch = self._batch
        if batch.n != len(x):
            batch = self._batch = new_batch(len(x))
        fits = x.shape == out.shape == batch.x_shape and u.shape == batch.u_shape and d.shape == batch.d_shape
        if not (fits and x.dtype == u.dtype == d.dtype == p.dtype == out.dtype == _DOUBLE):
            raise wrong_arrays(x, u, d, p, out)
        if batch.n <= COPIED_ROWS:
            self._step_copies(batch, x, u, d, p, out)
        else:
            self._step_in_place(batch, x, u, d, p, out)
        if batch.any_failed():
            self._step_with_full_model(batch, x, u, d, p, out)
        return batch.status

    def bind(self, x: Array, u: Array, d: Array, p: Array, out: Array) -> CompiledBoundStep:
        """A step of these very arrays, for many calls: ``step()`` steps what they hold then, without any overhead.

        Parameters
        ----------
        x, u, d, p, out : ndarray
            As for ``step_rows``, all of them tables and C-contiguous: (n, 28), (n, 6), (n, 10), (1, 208) or (n, 208), (n, 28).
            ``out`` may be ``x``.

        Raises
        ------
        ShapeError
            When an array has another shape, type or layout.
        """
        n = len(x)
        shapes = ((n, SIZES["x"]), (n, SIZES["u"]), (n, SIZES["d"]), (len(p), SIZES["p"]), (n, SIZES["x"]))
        arrays = (x, u, d, p, out)
        fits = all(a.shape == shape and a.dtype == _DOUBLE for a, shape in zip(arrays, shapes, strict=True))
        if not (fits and len(p) in (1, n) and all(a.flags.c_contiguous for a in arrays)):
            raise wrong_arrays(x, u, d, p, out)
        pointers = RowPointers()
        call = functools.partial(self._library.step_rows, self._settings_call, ctypes.byref(pointers))
        return CompiledBoundStep(self, call, pointers, arrays)

    def _step_copies(self, batch: Batch, x: Array, u: Array, d: Array, p: Array, out: Array) -> None:
        batch.x[...] = x
        batch.u[...] = u
        batch.d[...] = d
        if p.shape == SHARED:
            batch.p[0] = p
            batch.pointers.p_stride = 0
        elif p.shape == batch.p_shape:
            batch.p[...] = p
            batch.pointers.p_stride = SIZES["p"]
        elif p.shape == (1, *SHARED):
            batch.p[0] = p[0]
            batch.pointers.p_stride = 0
        else:
            raise wrong_arrays(x, u, d, p, out)
        self._library.step_rows(self._settings_call, batch.call)
        out[...] = batch.out

    def _step_in_place(self, batch: Batch, x: Array, u: Array, d: Array, p: Array, out: Array) -> None:
        shared = p.size == SIZES["p"]
        fits = shared or p.shape == batch.p_shape
        if not (fits and all(a.flags.c_contiguous for a in (x, u, d, p, out))):
            raise wrong_arrays(x, u, d, p, out)
        pointers = batch.pointers
        pointers.x, pointers.u, pointers.d, pointers.p, pointers.out = (a.ctypes.data for a in (x, u, d, p, out))
        pointers.p_stride = 0 if shared else SIZES["p"]
        self._library.step_rows(self._settings_call, batch.call)

    def _step_with_full_model(self, batch: Batch, x: Array, u: Array, d: Array, p: Array, out: Array) -> None:
        """Steps the rows whose greenhouse has equipment that the usual library leaves out."""
        rows = np.flatnonzero(batch.status // 64 == Failure.EQUIPMENT_PRESENT)
        if rows.size == 0:
            return
        full = self._full_library()
        parameters = np.broadcast_to(p, (batch.n, SIZES["p"]))[rows]
        part = new_batch(rows.size, copies=True)
        part.x[:], part.u[:], part.d[:], part.p[:] = x[rows], u[rows], d[rows], parameters
        part.pointers.p_stride = SIZES["p"]
        full.step_rows(self._settings_call, part.call)
        out[rows] = part.out
        batch.status[rows], batch.substeps[rows], batch.reached[rows] = part.status, part.substeps, part.reached

    def _full_library(self) -> Library:
        """Library of the model with all equipment, built when first needed."""
        if self._full is None:
            self._full = load(self._library_build(()).path)
        return self._full

    def environments(self, program: Program, n: int) -> CompiledEnvironments | None:
        """``n`` environments that run ``program`` around steps of this stepper's length and tolerances.

        None for a program that is too large.

        Raises
        ------
        CompiledUnavailable
            When its greenhouse has equipment that the usual library leaves out, and the other cannot be built.
        """
        equipped = bool(program.nominal[list(absent_equipment())].any())
        library = self._full_library() if equipped else self._library
        return CompiledEnvironments(library, self.settings, program, n) if fits(library, program) else None

    def explain(self, row: int) -> str:
        """What went wrong in a row of the last call: which state, when, why."""
        batch = self._batch
        reached, substeps = float(batch.reached[row]), int(batch.substeps[row])
        return explain(int(batch.status[row]), reached, substeps, self.settings)

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
            "forgotten": preset.forgotten,
            "memory_seconds": preset.memory,
            "guard": preset.guard,
            **({"last_stretch_seconds": preset.last_stretch} if math.isfinite(preset.last_stretch) else {}),
            "weights": "balanced" if preset.balanced else "even",
            "lanes": float(self._library.width),
            "compiler": self._build.compiler,
            "compiler_flags": self._build.flags,
            "library_digest": self._build.digest,
        }

    def _library_build(self, zeros: tuple[int, ...]) -> Build:
        return build(self.variant, traits_of(zeros), self._width)


def traits_of(zeros: tuple[int, ...]) -> Traits:
    """What the generator is told of the greenhouse, when the parameters ``zeros`` are zero in every row."""
    fast = tuple(STATE_NAMES.index(name) for name in FAST_STATES)
    first, second = (STATE_NAMES.index(name) for name in SINGULAR_STATES)
    return Traits(zeros, fast, (first, second))


def absent_equipment() -> tuple[int, ...]:
    """Parameters that are zero in the benchmark greenhouse; the usual library leaves out what they multiply.

    Interlights, for example: their area is zero. Rows with other parameters are stepped by a library of the full model.
    """
    return tuple(int(i) for i in np.flatnonzero(default_parameters() == 0.0))


def is_built(variant: str) -> bool:
    """Whether there is nothing to build for ``variant``: the library is in the cache, or no compiler is there."""
    try:
        return library_is_built(variant, traits_of(absent_equipment()))
    except CompiledUnavailable:
        return True


def availability() -> str | None:
    """None when the compiled stepper works here (built now if need be), else the reason why not."""
    try:
        CompiledStepper(900.0)
    except CompiledUnavailable as error:
        return str(error)
    return None
