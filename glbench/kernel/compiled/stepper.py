"""The compiled stepper: rows of states through one control step, in place, without allocation."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from glbench.errors import ShapeError, StepError
from glbench.kernel.compiled.binding import Library, RowPointers, Settings, load
from glbench.kernel.compiled.library import Build, build
from glbench.kernel.compiled.tolerances import (
    FAST_STATES,
    LARGEST_SUBSTEPS,
    SMALLEST_SUBSTEP,
    Preset,
    get_preset,
    small_values,
)
from glbench.kernel.compiled.unavailable import CompiledUnavailable
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES, default_parameters

Array = NDArray[np.float64]
Status = NDArray[np.int32]

_SIZES = {"x": len(STATE_NAMES), "u": len(CONTROL_NAMES), "d": len(DISTURBANCE_NAMES), "p": len(PARAMETER_NAMES)}
_SHARED = (_SIZES["p"],)
_NO_STATE = 63
# Up to so many rows it is quicker to copy the inputs beside fixed pointers than to ask arrays for theirs.
_COPIED_ROWS = 64


class Failure(IntEnum):
    """Why a row was not stepped (``status // 64``)."""

    INPUT_NOT_FINITE = 1
    TOO_MANY_SUBSTEPS = 2
    SUBSTEP_TOO_SMALL = 3
    EQUIPMENT_PRESENT = 4  # internal: the row goes to the library of the full model


@dataclass(frozen=True)
class _Batch:
    """Arrays and pointers for ``n`` rows."""

    n: int
    x: Array
    u: Array
    d: Array
    p: Array
    out: Array
    status: Status
    substeps: Status
    reached: Array
    pointers: RowPointers
    call: object  # ctypes.byref(pointers)
    x_shape: tuple[int, int]
    u_shape: tuple[int, int]
    d_shape: tuple[int, int]
    p_shape: tuple[int, int]

    def any_failed(self) -> bool:
        """Whether a row was not stepped."""
        return self.pointers.failed != 0


class CompiledStepper:
    """Rodas4P2 in generated C++, see docs/kernel-compiled.md. Not thread-safe: one stepper a Python thread.

    Parameters
    ----------
    step_seconds : float
        Length of the control step [s].
    variant : str
        Model variant, see ``glbench.model.VARIANTS``.
    preset : str or Preset
        ``"reference"``, ``"fast"`` or ``"tight"``, or settings of one's own.
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
        self.step_seconds = float(step_seconds)
        self.variant = variant
        self.threads = threads
        self._width = width
        self._build = self._library_build(absent_equipment())
        self._library = load(self._build.path)
        self._full: Library | None = None
        absolute = self.preset.relative * small_values()
        relative = np.full(len(STATE_NAMES), self.preset.relative)
        self._settings = Settings(
            step=self.step_seconds,
            first=self.preset.first_substep,
            forgotten=self.preset.forgotten,
            memory=self.preset.memory,
            smallest=SMALLEST_SUBSTEP,
            most=float(LARGEST_SUBSTEPS),
            absolute=(ctypes.c_double * len(absolute))(*absolute),
            relative=(ctypes.c_double * len(relative))(*relative),
            threads=threads,
        )
        self._settings_call = ctypes.byref(self._settings)
        self._batch = _new_batch(1)

    @property
    def substeps(self) -> Status:
        """Substeps of the rows of the last call (n,)."""
        return self._batch.substeps

    @property
    def reached(self) -> Array:
        """Time that the rows of the last call reached (n,) [s]."""
        return self._batch.reached

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
            When an array has another shape; with more than 64 rows also when it has another type or layout.
        """
        batch = self._batch
        if batch.n != len(x):
            batch = self._batch = _new_batch(len(x))
        if not (x.shape == out.shape == batch.x_shape and u.shape == batch.u_shape and d.shape == batch.d_shape):
            raise _wrong_arrays(x, u, d, p, out)
        if batch.n <= _COPIED_ROWS:
            self._step_copies(batch, x, u, d, p, out)
        else:
            self._step_in_place(batch, x, u, d, p, out)
        if batch.any_failed():
            self._step_with_full_model(batch, x, u, d, p, out)
        return batch.status

    def _step_copies(self, batch: _Batch, x: Array, u: Array, d: Array, p: Array, out: Array) -> None:
        batch.x[...] = x
        batch.u[...] = u
        batch.d[...] = d
        if p.shape == _SHARED:
            batch.p[0] = p
            batch.pointers.p_stride = 0
        elif p.shape == batch.p_shape:
            batch.p[...] = p
            batch.pointers.p_stride = _SIZES["p"]
        elif p.shape == (1, *_SHARED):
            batch.p[0] = p[0]
            batch.pointers.p_stride = 0
        else:
            raise _wrong_arrays(x, u, d, p, out)
        self._library.step_rows(self._settings_call, batch.call)
        out[...] = batch.out

    def _step_in_place(self, batch: _Batch, x: Array, u: Array, d: Array, p: Array, out: Array) -> None:
        shared = p.size == _SIZES["p"]
        fits = shared or p.shape == batch.p_shape
        if not (fits and all(a.dtype == np.float64 and a.flags.c_contiguous for a in (x, u, d, p, out))):
            raise _wrong_arrays(x, u, d, p, out)
        pointers = batch.pointers
        pointers.x, pointers.u, pointers.d, pointers.p, pointers.out = (a.ctypes.data for a in (x, u, d, p, out))
        pointers.p_stride = 0 if shared else _SIZES["p"]
        self._library.step_rows(self._settings_call, batch.call)

    def _step_with_full_model(self, batch: _Batch, x: Array, u: Array, d: Array, p: Array, out: Array) -> None:
        """Steps the rows whose greenhouse has equipment that the usual library leaves out."""
        rows = np.flatnonzero(batch.status // 64 == Failure.EQUIPMENT_PRESENT)
        if rows.size == 0:
            return
        if self._full is None:
            self._full = load(self._library_build(()).path)
        parameters = np.broadcast_to(p, (batch.n, _SIZES["p"]))[rows]
        part = _new_batch(rows.size, copies=True)
        part.x[:], part.u[:], part.d[:], part.p[:] = x[rows], u[rows], d[rows], parameters
        part.pointers.p_stride = _SIZES["p"]
        self._full.step_rows(self._settings_call, part.call)
        out[rows] = part.out
        batch.status[rows], batch.substeps[rows], batch.reached[rows] = part.status, part.substeps, part.reached

    def explain(self, row: int) -> str:
        """What went wrong in a row of the last call: which state, when, why."""
        status = int(self._batch.status[row])
        failure, state = Failure(status // 64), status % 64
        name = STATE_NAMES[state] if state != _NO_STATE else ""
        if failure == Failure.INPUT_NOT_FINITE:
            return (
                f"the state {name} is not finite" if name else "controls, weather or parameters are not usable numbers"
            )
        reached, substeps = self._batch.reached[row], self._batch.substeps[row]
        cause = (
            f"needed more than {LARGEST_SUBSTEPS} substeps"
            if failure == Failure.TOO_MANY_SUBSTEPS
            else f"needed substeps below {SMALLEST_SUBSTEP:g} s"
        )
        return f"{name} {cause} to stay within its tolerance, {reached:.4g} s into the step after {substeps} substeps"

    def error(self, row: int) -> StepError:
        """The error to raise for a row of the last call that failed."""
        return StepError(f"The step of {self.step_seconds:g} s failed in row {row}: {self.explain(row)}.")

    def describe(self) -> dict[str, str | float]:
        """Method, tolerances and the compiler; recorded in results."""
        preset = self.preset
        return {
            "method": "Rodas4P2",
            "relative_tolerance": preset.relative,
            "first_substep_seconds": preset.first_substep,
            "forgotten": preset.forgotten,
            "memory_seconds": preset.memory,
            "lanes": float(self._library.width),
            "threads": float(self.threads),
            "compiler": self._build.compiler,
            "compiler_flags": self._build.flags,
            "library_digest": self._build.digest,
        }

    def _library_build(self, zeros: tuple[int, ...]) -> Build:
        fast = tuple(STATE_NAMES.index(name) for name in FAST_STATES)
        return build(self.variant, zeros, fast, self._width)


def absent_equipment() -> tuple[int, ...]:
    """Parameters that are zero in the benchmark greenhouse; the usual library leaves out what they multiply.

    Interlights, for example: their area is zero. Rows with other parameters are stepped by a library of the full model.
    """
    return tuple(int(i) for i in np.flatnonzero(default_parameters() == 0.0))


def availability() -> str | None:
    """None when the compiled stepper works here (built now if need be), else the reason why not."""
    try:
        CompiledStepper(900.0)
    except CompiledUnavailable as error:
        return str(error)
    return None


def _new_batch(n: int, *, copies: bool | None = None) -> _Batch:
    own = n if (n <= _COPIED_ROWS if copies is None else copies) else 0
    x, u, d, p, out = (np.zeros((own, _SIZES[name])) for name in ("x", "u", "d", "p", "x"))
    status, substeps, reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
    addresses = {
        name: array.ctypes.data
        for name, array in zip(
            ("x", "u", "d", "p", "out", "status", "substeps", "reached"),
            (x, u, d, p, out, status, substeps, reached),
            strict=True,
        )
    }
    pointers = RowPointers(n=n, p_stride=_SIZES["p"], **addresses)
    shapes = ((n, _SIZES[name]) for name in "xudp")
    return _Batch(n, x, u, d, p, out, status, substeps, reached, pointers, ctypes.byref(pointers), *shapes)


def _wrong_arrays(x: Array, u: Array, d: Array, p: Array, out: Array) -> ShapeError:
    found = ", ".join(
        f"{name} {a.dtype}{a.shape}" for name, a in (("x", x), ("u", u), ("d", d), ("p", p), ("out", out))
    )
    msg = (
        "step_rows wants C-contiguous float64 arrays x (n, 28), u (n, 6), d (n, 10), p (n, 208) or (208,), out (n, 28), "
        f"not {found}."
    )
    return ShapeError(msg)
