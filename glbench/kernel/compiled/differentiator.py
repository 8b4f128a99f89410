"""Derivatives of compiled control steps: a second library, built when first needed, that steps rows and differentiates them."""

from __future__ import annotations

import ctypes
from functools import cache, cached_property

import numpy as np

from glbench.errors import StepError
from glbench.kernel.compiled.binding import (
    Failure,
    RowPointers,
    Settings,
    failed_with,
    members,
    of_another_version,
    open_library,
    settings_type,
)
from glbench.kernel.compiled.library import build
from glbench.kernel.compiled.stepper import CompiledStepper, Status, absent_equipment, traits_of
from glbench.kernel.records import FloatArray, Rows
from glbench.kernel.sensitivities import Directions, Forward, Reverse
from glbench.model import Model


class Request(ctypes.Structure):
    """``glb::Request`` of native/sensitivity_driver.hpp."""

    _fields_ = members("directions stride dx* du* dd* dp* tangents* cotangents* xb* ub* db* pb*")


class SensitivityLibrary:
    """A loaded library. Calls release Python's global lock."""

    def __init__(self, path: str, model: Model) -> None:
        handle = open_library(path, "glb_differentiate", "glb_sensitivity_layout")
        kinds = (settings_type(model.sizes["x"]), RowPointers, Request)
        self._differentiate = handle.glb_differentiate
        self._differentiate.restype = ctypes.c_int32
        self._differentiate.argtypes = [ctypes.POINTER(kind) for kind in kinds]
        sizes = (ctypes.c_int64 * 4)()
        handle.glb_sensitivity_layout(sizes)
        if tuple(sizes) != (*(ctypes.sizeof(kind) for kind in kinds), model.sizes["x"]):
            raise of_another_version(path)

    def run(self, settings: Settings, rows: Rows, request: Request) -> tuple[FloatArray, Status]:
        """States after the step (n, states) and status (n,).

        Raises
        ------
        StepError
            When there is not enough memory.
        """
        count = len(rows.x)
        out = np.empty_like(rows.x)
        status, substeps, reached = np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros(count)
        pointers = RowPointers(
            n=count,
            p_stride=rows.p.shape[1] if len(rows.p) > 1 else 0,
            **{key: table.ctypes.data for key, table in rows._asdict().items()},
            out=out.ctypes.data,
            status=status.ctypes.data,
            substeps=substeps.ctypes.data,
            reached=reached.ctypes.data,
        )
        if self._differentiate(ctypes.byref(settings), ctypes.byref(pointers), ctypes.byref(request)) != 0:
            msg = f"There is not enough memory to differentiate {count} rows. Give fewer rows at a time."
            raise StepError(msg)
        return out, status


@cache
def _load(path: str, model: Model) -> SensitivityLibrary:
    return SensitivityLibrary(path, model)


class CompiledDifferentiator:
    """Forward and reverse derivatives of the steps of a ``CompiledStepper``, with its settings.

    The usual library knows no equipment that the benchmark's greenhouse lacks. Rows that have such are left to the library of the
    full model; so are derivatives with respect to its parameters, which add to the others because derivatives are linear.

    Raises
    ------
    CompiledUnavailable
        When a library can be neither loaded nor built, here or in a call.
    """

    def __init__(self, stepper: CompiledStepper) -> None:
        self._stepper = stepper
        self._sizes = stepper.model.sizes
        absent = absent_equipment(stepper.model)
        self._absent = np.array(absent, dtype=np.intp)
        self._usual = self._library(absent)

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""
        found, status = self._forward(rows, directions, self._usual)
        again = failed_with(status, Failure.EQUIPMENT_PRESENT)
        if again.size:
            part, _ = self._forward(rows.chosen(again), directions.of_rows(again), self._full)
            for ours, theirs in zip(found, part, strict=True):
                ours[again] = theirs
        absent = self._absent_part(directions)
        others = np.flatnonzero(status == 0)
        if absent is not None and others.size:
            part, _ = self._forward(rows.chosen(others), absent.of_rows(others), self._full)
            found.tangents[others] += part.tangents
            found.failed[others] |= part.failed
        return found

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, states) back."""
        found, status = self._reverse(rows, cotangents, self._usual)
        gradients = found.gradients
        again = failed_with(status, Failure.EQUIPMENT_PRESENT)
        if again.size:
            part, _ = self._reverse(rows.chosen(again), cotangents[again], self._full)
            found.x_next[again], found.failed[again] = part.x_next, part.failed
            for key, gradient in gradients.items():
                gradient[again] = part.gradients[key]
        if not parameters:
            del gradients["p"]
            return found
        others = np.flatnonzero(status == 0)
        if others.size:
            part, _ = self._reverse(rows.chosen(others), cotangents[others], self._full)
            gradients["p"][np.ix_(others, self._absent)] = part.gradients["p"][:, self._absent]
            found.failed[others] |= part.failed
        return found

    def _forward(self, rows: Rows, directions: Directions, library: SensitivityLibrary) -> tuple[Forward, Status]:
        tangents = np.zeros((len(rows.x), directions.count, self._sizes["x"]))
        request = Request(directions=directions.count, stride=int(not directions.shared), tangents=tangents.ctypes.data)
        for key, seeds in directions.seeds.items():
            setattr(request, f"d{key}", seeds.ctypes.data)
        x_next, status = library.run(self._stepper.settings, rows, request)
        return Forward(x_next, tangents, status != 0), status

    def _reverse(self, rows: Rows, cotangents: FloatArray, library: SensitivityLibrary) -> tuple[Reverse, Status]:
        gradients = {key: np.zeros((len(rows.x), size)) for key, size in self._sizes.items()}
        pointers = {f"{key}b": table.ctypes.data for key, table in gradients.items()}
        request = Request(cotangents=cotangents.ctypes.data, **pointers)
        x_next, status = library.run(self._stepper.settings, rows, request)
        return Reverse(x_next, gradients, status != 0), status

    def _absent_part(self, directions: Directions) -> Directions | None:
        """The part of the directions in parameters of absent equipment, which the usual library does not know; None if none."""
        seeds = directions.seeds.get("p")
        if seeds is None or not seeds[..., self._absent].any():
            return None
        part = np.zeros_like(seeds)
        part[..., self._absent] = seeds[..., self._absent]
        return Directions(directions.count, directions.shared, {"p": part})

    @cached_property
    def _full(self) -> SensitivityLibrary:
        return self._library(())

    def _library(self, zeros: tuple[int, ...]) -> SensitivityLibrary:
        model = self._stepper.model
        return _load(build(model, traits_of(model, zeros), self._stepper.width, sensitivities=True).path, model)
