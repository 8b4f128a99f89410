"""The library's functions through ctypes, with the layout of their arguments and the meaning of what they report."""

from __future__ import annotations

import ctypes
import functools
from enum import IntEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glbench.kernel.compiled.compiler import CompiledUnavailable
from glbench.model import Model

Status = NDArray[np.int32]

_STATES = 1 << 16  # a status is a failure times this, and the number of a state
_NO_STATE = _STATES - 1


class Failure(IntEnum):
    """Why a row was not stepped."""

    INPUT_NOT_FINITE = 1
    TOO_MANY_SUBSTEPS = 2
    SUBSTEP_TOO_SMALL = 3
    EQUIPMENT_PRESENT = 4  # internal: the row goes to the library of the full model
    FOLLOWER_NOT_FINITE = 5


def failed_with(status: NDArray[np.int32], failure: Failure) -> NDArray[np.intp]:
    """Rows that have this status."""
    return np.flatnonzero(status // _STATES == failure)


class Settings(ctypes.Structure):
    """``glb::Settings`` of native/rows.hpp, but for the arrays that have a number for each state: see ``settings_type``."""

    step: float
    smallest: float
    most: float


@functools.cache
def settings_type(states: int) -> type[Settings]:
    """``glb::Settings`` for a model of so many states."""
    numbers = (
        "step", "first", "fast_error_floor", "singular_error_factor", "fast_time_constant", "last", "smallest", "most",
    )  # fmt: skip
    fields = [(name, ctypes.c_double) for name in numbers]
    arrays = [(name, ctypes.c_double * states) for name in ("absolute", "relative")]
    members = {"_fields_": [*fields, *arrays, ("threads", ctypes.c_int32), ("method", ctypes.c_int32)]}
    return type(f"Settings{states}", (Settings,), members)


def members(text: str) -> tuple[tuple[str, type[ctypes.c_int64 | ctypes.c_void_p]], ...]:
    """Members of a C structure in their order: ``name`` is an ``int64_t``, ``name*`` an address."""
    return tuple((name.rstrip("*"), ctypes.c_void_p if name.endswith("*") else ctypes.c_int64) for name in text.split())


class RowPointers(ctypes.Structure):
    """``glb::Rows`` of native/rows.hpp."""

    _fields_ = members("n x* u* d* p* p_stride out* status* substeps* reached* failed")


class TapePointers(ctypes.Structure):
    """``glb::Tape`` of native/tape.hpp."""

    _fields_ = members("constants inputs operations outputs constant* input* operation* output*")


class ActionBoundsPointers(ctypes.Structure):
    """``glb::ActionBounds`` of native/environment.hpp."""

    _fields_ = members("count lowest* highest* low* high*")


class LookupPointers(ctypes.Structure):
    """``glb::Lookup`` of native/environment.hpp."""

    _fields_ = members("table* width count at clocked numbered ahead every")


class ParameterNoisePointers(ctypes.Structure):
    """``glb::ParameterNoise`` of native/environment.hpp."""

    _fields_ = (*members("count place*"), ("half_width", ctypes.c_double), *members("every"))


class ProgramPointers(ctypes.Structure):
    """``glb::Program`` of native/environment.hpp."""

    _fields_ = (
        *((name, TapePointers) for name in ("actuation", "followers", "update", "outcome")),
        ("actions", ActionBoundsPointers),
        ("controls", ActionBoundsPointers),
        *members("steps weather* day calendar* calendar_width lag drawn"),
        ("group", ctypes.POINTER(ParameterNoisePointers)),
        *members("streams numbers* traits memory lookups"),
        ("lookup", ctypes.POINTER(LookupPointers)),
        *members("columns width info_columns charges charged* charge*"),
    )


class EnvironmentPointers(ctypes.Structure):
    """``glb::Environments`` of native/environment.hpp."""

    _fields_ = members(
        "n x* after* u* next* k* ended* key* days* days_stride first* p* p_stride traits* memory* given* given_controls* "
        "table* observations* status* substeps* reached* failed over refused"
    )


class EnvironmentCall(ctypes.Structure):
    """``EnvironmentCall`` of native/environment.hpp."""

    _fields_ = members("settings* program* all* request")


class Library:
    """A loaded library of ``model``, with ``width`` lanes a batch. Calls release Python's global lock.

    ``most_registers`` and ``most_drawn`` are what the program of environments has room for.
    """

    def __init__(self, path: str, model: Model) -> None:
        self.model = model
        handle = open_library(path, "glb_step_rows", "glb_environment", "glb_layout", "glb_environment_layout")
        self.step_rows, self.environment = handle.glb_step_rows, handle.glb_environment
        settings = settings_type(model.sizes["x"])
        self.step_rows.restype = ctypes.c_int64  # how many rows have a status other than 0
        self.step_rows.argtypes = (ctypes.POINTER(settings), ctypes.POINTER(RowPointers))
        self.step_rows_at = handle["glb_step_rows"]  # the same, for addresses of both structures
        self.step_rows_at.restype = ctypes.c_int64
        self.step_rows_at.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
        self.environment.restype = None
        self.environment.argtypes = (ctypes.c_void_p,)  # the address as a number is the quickest argument
        own, others = (ctypes.c_int64 * 7)(), (ctypes.c_int64 * 8)()
        handle.glb_layout(own)
        handle.glb_environment_layout(others)
        structures = (ProgramPointers, EnvironmentPointers, EnvironmentCall, LookupPointers, ParameterNoisePointers)
        laid_out = map(ctypes.sizeof, structures)
        expected = ctypes.sizeof(settings), ctypes.sizeof(RowPointers), *model.sizes.values()
        if tuple(own[:6]) != expected or tuple(others[:6]) != (*laid_out, model.sizes["p"]):
            raise of_another_version(path)
        self.width = int(own[6])
        self.most_registers, self.most_drawn = int(others[6]), int(others[7])


def open_library(path: str, *functions: str) -> ctypes.CDLL:
    """The library at ``path``, which has these functions; CompiledUnavailable when it cannot be loaded or lacks one."""
    try:
        handle = ctypes.CDLL(path)
        for name in functions:
            getattr(handle, name)
    except (OSError, AttributeError) as error:
        msg = f"The kernel library {path} cannot be loaded: {error}. Delete {Path(path).parent} and try again."
        raise CompiledUnavailable(msg) from error
    return handle


def of_another_version(path: str) -> CompiledUnavailable:
    """The error for a library whose layout is not what this version expects."""
    return CompiledUnavailable(
        f"The kernel library {path} belongs to another version of glbench. Delete {Path(path).parent} and try again."
    )


@functools.cache
def load(path: str, model: Model) -> Library:
    """The library of ``model`` at ``path``, loaded once. Raises ``CompiledUnavailable`` when it cannot be, or is of another version."""
    return Library(path, model)


def explain(model: Model, status: int, reached: float, substeps: int, settings: Settings) -> str:
    """What went wrong in a step under ``settings``: which state, when, why."""
    failure, state = Failure(status // _STATES), status % _STATES
    name = model.state_names[state] if state != _NO_STATE else ""
    if failure == Failure.INPUT_NOT_FINITE:
        return f"the state {name} is not finite" if name else "controls, weather or parameters are not usable numbers"
    if failure == Failure.FOLLOWER_NOT_FINITE:
        return f"{name} is not finite at the end of the step"
    cause = (
        f"needed more than {int(settings.most)} substeps"
        if failure == Failure.TOO_MANY_SUBSTEPS
        else f"needed substeps below {settings.smallest:g} s"
    )
    return f"{name} {cause} to stay within its tolerance, {reached:.4g} s into the step after {substeps} substeps"
