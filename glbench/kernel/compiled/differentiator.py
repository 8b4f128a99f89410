"""Derivatives of compiled control steps: a second library, built when first needed, that steps rows and differentiates them."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache, cached_property

import numpy as np
import numpy.typing as npt

from glbench.errors import StepError, refuse
from glbench.kernel.compiled import binding
from glbench.kernel.compiled.library import absent_equipment, build, traits_of
from glbench.kernel.records import FloatArray, Rows
from glbench.kernel.sensitivities import Directions, Forward, Reverse
from glbench.kernel.trajectories import reverse_by_steps
from glbench.model import Model


class Request(ctypes.Structure):
    """``glb::Request`` of native/sensitivity_driver.hpp."""

    _fields_ = binding.members("directions stride dx* du* dd* dp* tangents* cotangents* xb* ub* db* pb*")


class Sweep(ctypes.Structure):
    """``glb::Sweep`` of native/trajectory.hpp."""

    _fields_ = binding.members("horizons steps moves jacobians* along* states*")


class SensitivityLibrary:
    """A loaded library. Calls release Python's global lock."""

    def __init__(self, path: str, model: Model) -> None:
        names = ("glb_differentiate", "glb_reverse_horizons", "glb_push", "glb_pull", "glb_sensitivity_layout")
        handle = binding.open_library(path, *names)
        settings = binding.settings_type(model.sizes["x"])
        kinds = (settings, binding.RowPointers, Request, Sweep)
        pointers = [ctypes.POINTER(kind) for kind in kinds]
        self._differentiate, self._reverse_horizons = handle.glb_differentiate, handle.glb_reverse_horizons
        self._differentiate.restype = self._reverse_horizons.restype = ctypes.c_int32
        self._differentiate.argtypes = pointers[:3]
        self._reverse_horizons.argtypes = [*pointers[:3], ctypes.c_int64, ctypes.c_void_p]
        self.push, self.pull = handle.glb_push, handle.glb_pull
        for sweep in (self.push, self.pull):
            sweep.restype, sweep.argtypes = None, [ctypes.POINTER(settings), ctypes.POINTER(Sweep)]
        sizes = (ctypes.c_int64 * 5)()
        handle.glb_sensitivity_layout(sizes)
        if tuple(sizes) != (*(ctypes.sizeof(kind) for kind in kinds), model.sizes["x"]):
            raise binding.of_another_version(path)

    def run(self, settings: binding.Settings, rows: Rows, request: Request, horizon: int = 0) -> tuple[FloatArray, binding.Status]:
        """States after the step (n, states) and status (n,); with ``horizon`` > 0, in reverse through horizons of so many rows.

        The request's cotangents gather what comes from later rows, then. Raises ``StepError`` when there is not enough memory.
        """
        count = len(rows.x)
        out = np.empty_like(rows.x)
        status, substeps, reached = np.zeros(count, np.int32), np.zeros(count, np.int32), np.zeros(count)
        pointers = binding.RowPointers(
            n=count,
            p_stride=rows.p.shape[1] if len(rows.p) > 1 else 0,
            **{key: table.ctypes.data for key, table in rows._asdict().items()},
            out=out.ctypes.data,
            status=status.ctypes.data,
            substeps=substeps.ctypes.data,
            reached=reached.ctypes.data,
        )
        further = (horizon, request.cotangents) if horizon else ()
        differentiate = self._reverse_horizons if horizon else self._differentiate
        if differentiate(ctypes.byref(settings), ctypes.byref(pointers), ctypes.byref(request), *further) != 0:
            refuse(f"There is not enough memory to differentiate {count} rows. Give fewer rows at a time.", StepError)
        return out, status


@cache
def _load(path: str, model: Model) -> SensitivityLibrary:
    return SensitivityLibrary(path, model)


class CompiledDifferentiator:
    """Forward and reverse derivatives of the steps of a ``CompiledStepper``, with its model, settings and width.

    The usual library knows no equipment that the benchmark's greenhouse lacks. Rows that have such are left to the library of the
    full model; so are derivatives with respect to its parameters, which add to the others because derivatives are linear.
    Raises ``CompiledUnavailable`` when a library can be neither loaded nor built, here or in a call.
    """

    def __init__(self, model: Model, settings: binding.Settings, width: int | None = None) -> None:
        self._model, self._settings, self._width = model, settings, width
        self._sizes = model.sizes
        absent = absent_equipment(model)
        self._absent = np.array(absent, dtype=np.intp)
        self._usual = self._library(absent)

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""
        if self._equipped(rows).all():
            return self._forward(rows, directions, self._full)[0]
        result, status = self._forward(rows, directions, self._usual)
        again = binding.failed_with(status, binding.Failure.EQUIPMENT_PRESENT)
        if again.size:
            part, _ = self._forward(rows.take(again), directions.of_rows(again), self._full)
            for ours, theirs in zip(result, part, strict=True):
                ours[again] = theirs
        seeds, others = directions.seeds.get("p"), np.flatnonzero(status == 0)
        if seeds is not None and seeds[..., self._absent].any() and others.size:  # the usual library does not know these
            part_of_seeds = np.zeros_like(seeds)
            part_of_seeds[..., self._absent] = seeds[..., self._absent]
            absent = Directions(directions.count, directions.shared, {"p": part_of_seeds})
            part, _ = self._forward(rows.take(others), absent.of_rows(others), self._full)
            result.tangents[others] += part.tangents
            result.failed[others] |= part.failed
        return result

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, states) back."""
        if self._equipped(rows).all():
            return self._reverse(rows, cotangents, self._full, parameters=parameters)[0]
        result, status = self._reverse(rows, cotangents, self._usual, parameters=parameters)
        again = binding.failed_with(status, binding.Failure.EQUIPMENT_PRESENT)
        if again.size:
            part, _ = self._reverse(rows.take(again), cotangents[again], self._full, parameters=parameters)
            result.x_next[again], result.failed[again] = part.x_next, part.failed
            for key, gradient in result.gradients.items():
                gradient[again] = part.gradients[key]
        if parameters:
            self._add_absent(result, np.flatnonzero(status == 0), rows, cotangents)
        return result

    def reverse_horizons(self, rows: Rows, steps: int, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents back through horizons of ``steps`` rows each."""
        equipped = self._equipped(rows)
        if equipped.any() and not equipped.all():  # two libraries take turns
            return reverse_by_steps(self.reverse, rows, steps, cotangents, parameters=parameters)
        library = self._full if equipped.any() else self._usual
        costates = cotangents.copy()
        result, _ = self._reverse(rows, costates, library, parameters=parameters, horizon=steps)
        if parameters and library is self._usual:
            self._add_absent(result, np.arange(len(rows.x)), rows, costates)
        return result

    def push(self, jacobians: FloatArray, along: FloatArray, first: FloatArray) -> FloatArray:
        """Changes of all states."""
        n, steps, _, size = jacobians.shape
        changes = np.empty((n, steps + 1, size))
        changes[:, 0] = first
        self._sweep(self._usual.push, jacobians, along, changes)
        return changes

    def pull(self, jacobians: FloatArray, cotangents: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Costates and gradients of the inputs."""
        n, steps, directions, size = jacobians.shape
        costates, along = cotangents.copy(), np.empty((n, steps, directions - size))
        self._sweep(self._usual.pull, jacobians, along, costates)
        return costates, along

    def _sweep(self, run: Callable[..., None], jacobians: FloatArray, along: FloatArray, states: FloatArray) -> None:
        if len(jacobians) > 1 and not jacobians.flags.c_contiguous and jacobians[0].flags.c_contiguous:
            for horizon in range(len(jacobians)):  # a part of a larger table: nothing is copied
                part = slice(horizon, horizon + 1)
                self._sweep(run, jacobians[part], along[part], states[part])
            return
        tables = (np.ascontiguousarray(jacobians), np.ascontiguousarray(along), states)
        sweep = Sweep(*along.shape, *(table.ctypes.data for table in tables))
        run(ctypes.byref(self._settings), ctypes.byref(sweep))

    def _equipped(self, rows: Rows) -> npt.NDArray[np.bool_]:
        """Which rows, or the one set of parameters that all share, have equipment that the usual library does not know."""
        return np.asarray(rows.p[:, self._absent].any(axis=1))

    def _add_absent(self, result: Reverse, which: npt.NDArray[np.intp], rows: Rows, cotangents: FloatArray) -> None:
        """Gradients for the parameters of absent equipment, which the usual library does not know."""
        if which.size:
            part, _ = self._reverse(rows.take(which), cotangents[which], self._full, parameters=True)
            result.gradients["p"][np.ix_(which, self._absent)] = part.gradients["p"][:, self._absent]
            result.failed[which] |= part.failed

    def _forward(self, rows: Rows, directions: Directions, library: SensitivityLibrary) -> tuple[Forward, binding.Status]:
        tangents = np.zeros((len(rows.x), directions.count, self._sizes["x"]))
        request = Request(directions=directions.count, stride=int(not directions.shared), tangents=tangents.ctypes.data)
        for key, seeds in directions.seeds.items():
            setattr(request, f"d{key}", seeds.ctypes.data)
        x_next, status = library.run(self._settings, rows, request)
        return Forward(x_next, tangents, status != 0), status

    def _reverse(
        self, rows: Rows, cotangents: FloatArray, library: SensitivityLibrary, *, parameters: bool, horizon: int = 0
    ) -> tuple[Reverse, binding.Status]:
        keys = "xudp" if parameters else "xud"
        gradients = {key: np.zeros((len(rows.x), self._sizes[key])) for key in keys}
        pointers = {f"{key}b": table.ctypes.data for key, table in gradients.items()}
        request = Request(cotangents=cotangents.ctypes.data, **pointers)
        x_next, status = library.run(self._settings, rows, request, horizon)
        return Reverse(x_next, gradients, status != 0), status

    @cached_property
    def _full(self) -> SensitivityLibrary:
        return self._library(())

    def _library(self, zeros: tuple[int, ...]) -> SensitivityLibrary:
        built = build(self._model, traits_of(self._model, zeros), self._width, sensitivities=True)
        return _load(built.path, self._model)
