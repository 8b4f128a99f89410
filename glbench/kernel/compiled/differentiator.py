"""Derivatives of compiled control steps: a second library, built when first needed, that steps rows and differentiates them."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

import numpy as np

from glbench.errors import StepError
from glbench.kernel.compiled.binding import RowPointers, Settings
from glbench.kernel.compiled.library import build
from glbench.kernel.compiled.stepper import CompiledStepper, Failure, absent_equipment, model_traits
from glbench.kernel.compiled.unavailable import CompiledUnavailable
from glbench.kernel.records import FloatArray, Rows
from glbench.kernel.sensitivities import SIZES, Directions, Forward, Reverse


class Request(ctypes.Structure):
    """``glb::Request`` of native/sensitivity_driver.hpp."""

    _fields_ = (
        ("directions", ctypes.c_int64),
        ("stride", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("dx", "du", "dd", "dp")),
        ("tangents", ctypes.c_void_p),
        ("cotangents", ctypes.c_void_p),
        *((name, ctypes.c_void_p) for name in ("xb", "ub", "db", "pb")),
    )


class SensitivityLibrary:
    """A loaded library. Calls release Python's global lock."""

    def __init__(self, path: str) -> None:
        advice = f"Delete {Path(path).parent} and try again."
        try:
            handle = ctypes.CDLL(path)
            self._differentiate, layout = handle.glb_differentiate, handle.glb_sensitivity_layout
        except (OSError, AttributeError) as error:
            msg = f"The sensitivity library {path} cannot be loaded: {error}. {advice}"
            raise CompiledUnavailable(msg) from error
        self._differentiate.restype = ctypes.c_int32
        self._differentiate.argtypes = [ctypes.POINTER(kind) for kind in (Settings, RowPointers, Request)]
        sizes = (ctypes.c_int64 * 4)()
        layout(sizes)
        if tuple(sizes) != (*(ctypes.sizeof(kind) for kind in (Settings, RowPointers, Request)), SIZES["x"]):
            msg = f"The sensitivity library {path} belongs to another version of glbench. {advice}"
            raise CompiledUnavailable(msg)

    def run(self, settings: Settings, rows: Rows, request: Request) -> tuple[FloatArray, FloatArray]:
        """States after the step (n, 28) and status (n,).

        Raises
        ------
        StepError
            When there is not enough memory.
        """
        count = len(rows.x)
        out = np.empty_like(rows.x)
        status, substeps, reached = np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros(count)
        given = {"x": rows.x, "u": rows.u, "d": rows.d, "p": rows.p}
        results = {"out": out, "status": status, "substeps": substeps, "reached": reached}
        pointers = RowPointers(
            n=count,
            p_stride=SIZES["p"] if len(rows.p) > 1 else 0,
            **{name: array.ctypes.data for name, array in (given | results).items()},
        )
        if self._differentiate(ctypes.byref(settings), ctypes.byref(pointers), ctypes.byref(request)) != 0:
            msg = f"There is not enough memory to differentiate {count} rows. Give fewer rows at a time."
            raise StepError(msg)
        return out, status


@functools.cache
def _load(path: str) -> SensitivityLibrary:
    return SensitivityLibrary(path)


class CompiledDifferentiator:
    """Forward and reverse derivatives of the steps of a ``CompiledStepper``, with its settings.

    Rows with equipment that the usual library leaves out, and derivatives with respect to its parameters, are left to the library
    of the full model.

    Raises
    ------
    CompiledUnavailable
        When a library can be neither loaded nor built, here or in a call.
    """

    def __init__(self, stepper: CompiledStepper) -> None:
        self._stepper = stepper
        self._absent = list(absent_equipment())
        self._usual = self._library(tuple(self._absent))

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""
        absent_moves = directions.p is not None and bool(directions.p[..., self._absent].any())
        found = self._forward(rows, directions, full=absent_moves)
        if absent_moves:
            self._step(rows, found.x_next)
        return found

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, 28) back."""
        found = self._reverse(rows, cotangents, full=parameters)
        if parameters:
            self._step(rows, found.x_next)
        return found if parameters else found._replace(p=None)

    def _forward(self, rows: Rows, directions: Directions, *, full: bool) -> Forward:
        tangents = np.zeros((len(rows.x), directions.count, SIZES["x"]))
        request = Request(directions=directions.count, stride=int(not directions.shared), tangents=tangents.ctypes.data)
        for key in SIZES:
            seeds = getattr(directions, key)
            if seeds is not None:
                setattr(request, f"d{key}", seeds.ctypes.data)
        x_next, status = self._run(rows, request, full=full)
        found = Forward(x_next, tangents, status != 0)
        again = np.flatnonzero(status // 64 == Failure.EQUIPMENT_PRESENT)
        if again.size:
            seeds = (None if a is None or directions.shared else a[again] for a in directions[2:])
            part = directions if directions.shared else Directions(directions.count, False, *seeds)  # noqa: FBT003
            _replace_rows(found, again, self._forward(_chosen(rows, again), part, full=True))
        return found

    def _reverse(self, rows: Rows, cotangents: FloatArray, *, full: bool) -> Reverse:
        gradients = {key: np.zeros((len(rows.x), size)) for key, size in SIZES.items()}
        pointers = {f"{key}b": array.ctypes.data for key, array in gradients.items()}
        x_next, status = self._run(rows, Request(cotangents=cotangents.ctypes.data, **pointers), full=full)
        found = Reverse(x_next, *gradients.values(), status != 0)
        again = np.flatnonzero(status // 64 == Failure.EQUIPMENT_PRESENT)
        if again.size:
            part = np.ascontiguousarray(cotangents[again])
            _replace_rows(found, again, self._reverse(_chosen(rows, again), part, full=True))
        return found

    def _run(self, rows: Rows, request: Request, *, full: bool) -> tuple[FloatArray, FloatArray]:
        library = self._library(()) if full else self._usual
        return library.run(self._stepper.settings, rows, request)

    def _step(self, rows: Rows, out: FloatArray) -> None:
        """The full model's states differ from the usual library's in the last bits; what is given is what ``step`` gives."""
        self._stepper.step_rows(rows.x, rows.u, rows.d, rows.p, out)

    def _library(self, zeros: tuple[int, ...]) -> SensitivityLibrary:
        stepper = self._stepper
        return _load(build(stepper.variant, model_traits(zeros), stepper.width, sensitivities=True).path)


def _chosen(rows: Rows, which: np.ndarray) -> Rows:
    p = rows.p if len(rows.p) == 1 else rows.p[which]
    return Rows(rows.x[which], rows.u[which], rows.d[which], np.ascontiguousarray(p))


def _replace_rows(whole: Forward | Reverse, which: np.ndarray, part: Forward | Reverse) -> None:
    for ours, theirs in zip(whole, part, strict=True):
        ours[which] = theirs
