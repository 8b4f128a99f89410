"""The library's functions through ctypes, with the layout of their arguments."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

from glbench.kernel.compiled.unavailable import CompiledUnavailable
from glbench.model import PARAMETER_NAMES, STATE_NAMES

STATES, PARAMETERS = len(STATE_NAMES), len(PARAMETER_NAMES)


class Settings(ctypes.Structure):
    """``glb::Settings`` of native/rows.hpp."""

    _fields_ = (
        ("step", ctypes.c_double),
        ("first", ctypes.c_double),
        ("forgotten", ctypes.c_double),
        ("guard", ctypes.c_double),
        ("memory", ctypes.c_double),
        ("last", ctypes.c_double),
        ("smallest", ctypes.c_double),
        ("most", ctypes.c_double),
        ("absolute", ctypes.c_double * STATES),
        ("relative", ctypes.c_double * STATES),
        ("threads", ctypes.c_int32),
        ("method", ctypes.c_int32),
    )


class RowPointers(ctypes.Structure):
    """``glb::Rows`` of native/rows.hpp."""

    _fields_ = (
        ("n", ctypes.c_int64),
        ("x", ctypes.c_void_p),
        ("u", ctypes.c_void_p),
        ("d", ctypes.c_void_p),
        ("p", ctypes.c_void_p),
        ("p_stride", ctypes.c_int64),
        ("out", ctypes.c_void_p),
        ("status", ctypes.c_void_p),
        ("substeps", ctypes.c_void_p),
        ("reached", ctypes.c_void_p),
        ("failed", ctypes.c_int64),
    )


class TapePointers(ctypes.Structure):
    """``glb::Tape`` of native/tape.hpp."""

    _fields_ = (
        ("constants", ctypes.c_int64),
        ("inputs", ctypes.c_int64),
        ("operations", ctypes.c_int64),
        ("outputs", ctypes.c_int64),
        ("constant", ctypes.c_void_p),
        ("input", ctypes.c_void_p),
        ("operation", ctypes.c_void_p),
        ("output", ctypes.c_void_p),
    )


class ActionBoundsPointers(ctypes.Structure):
    """``glb::ActionBounds`` of native/environment.hpp."""

    _fields_ = (
        ("count", ctypes.c_int64),
        ("lowest", ctypes.c_void_p),
        ("highest", ctypes.c_void_p),
        ("low", ctypes.c_void_p),
        ("high", ctypes.c_void_p),
    )


class LookupPointers(ctypes.Structure):
    """``glb::Lookup`` of native/environment.hpp."""

    _fields_ = (
        ("table", ctypes.c_void_p),
        ("width", ctypes.c_int64),
        ("count", ctypes.c_int64),
        ("at", ctypes.c_int64),
        ("clocked", ctypes.c_int64),
        ("ahead", ctypes.c_int64),
    )


class ParameterNoisePointers(ctypes.Structure):
    """``glb::ParameterNoise`` of native/environment.hpp."""

    _fields_ = (
        ("count", ctypes.c_int64),
        ("place", ctypes.c_void_p),
        ("half_width", ctypes.c_double),
        ("every", ctypes.c_int64),
    )


class ProgramPointers(ctypes.Structure):
    """``glb::Program`` of native/environment.hpp."""

    _fields_ = (
        ("actuation", TapePointers),
        ("followers", TapePointers),
        ("update", TapePointers),
        ("outcome", TapePointers),
        ("actions", ActionBoundsPointers),
        ("controls", ActionBoundsPointers),
        ("steps", ctypes.c_int64),
        ("weather", ctypes.c_void_p),
        ("day", ctypes.c_int64),
        ("calendar", ctypes.c_void_p),
        ("calendar_width", ctypes.c_int64),
        ("lag", ctypes.c_int64),
        ("drawn", ctypes.c_int64),
        ("group", ctypes.POINTER(ParameterNoisePointers)),
        ("streams", ctypes.c_int64),
        ("numbers", ctypes.c_void_p),
        ("traits", ctypes.c_int64),
        ("memory", ctypes.c_int64),
        ("lookups", ctypes.c_int64),
        ("lookup", ctypes.POINTER(LookupPointers)),
        ("columns", ctypes.c_int64),
        ("width", ctypes.c_int64),
        ("info_columns", ctypes.c_int64),
        ("charges", ctypes.c_int64),
        ("charged", ctypes.c_void_p),
        ("charge", ctypes.c_void_p),
    )


class EnvironmentPointers(ctypes.Structure):
    """``glb::Environments`` of native/environment.hpp."""

    _fields_ = (
        ("n", ctypes.c_int64),
        ("x", ctypes.c_void_p),
        ("after", ctypes.c_void_p),
        ("u", ctypes.c_void_p),
        ("next", ctypes.c_void_p),
        ("k", ctypes.c_void_p),
        ("ended", ctypes.c_void_p),
        ("key", ctypes.c_void_p),
        ("days", ctypes.c_void_p),
        ("days_stride", ctypes.c_int64),
        ("first", ctypes.c_void_p),
        ("p", ctypes.c_void_p),
        ("p_stride", ctypes.c_int64),
        ("traits", ctypes.c_void_p),
        ("memory", ctypes.c_void_p),
        ("given", ctypes.c_void_p),
        ("given_controls", ctypes.c_void_p),
        ("table", ctypes.c_void_p),
        ("observations", ctypes.c_void_p),
        ("status", ctypes.c_void_p),
        ("substeps", ctypes.c_void_p),
        ("reached", ctypes.c_void_p),
        ("failed", ctypes.c_int64),
        ("over", ctypes.c_int64),
        ("refused", ctypes.c_int64),
    )


class EnvironmentCall(ctypes.Structure):
    """``EnvironmentCall`` of native/environment.hpp."""

    _fields_ = (
        ("settings", ctypes.c_void_p),
        ("program", ctypes.c_void_p),
        ("all", ctypes.c_void_p),
        ("request", ctypes.c_int64),
    )


class Library:
    """A loaded library. Calls release Python's global lock."""

    def __init__(self, path: str) -> None:
        try:
            handle = ctypes.CDLL(path)
            self.step_rows = handle.glb_step_rows
            self.environment = handle.glb_environment
            layout, environment_layout = handle.glb_layout, handle.glb_environment_layout
        except (OSError, AttributeError) as error:
            msg = f"The kernel library {path} cannot be loaded: {error}. Delete {Path(path).parent} and try again."
            raise CompiledUnavailable(msg) from error
        self.step_rows.restype = ctypes.c_int64  # how many rows have a status other than 0
        self.step_rows.argtypes = (ctypes.POINTER(Settings), ctypes.POINTER(RowPointers))
        sizes = (ctypes.c_int64 * 4)()
        layout(sizes)
        self.environment.restype = None
        self.environment.argtypes = (ctypes.c_void_p,)  # the address as a number is the quickest argument
        others = (ctypes.c_int64 * 8)()
        environment_layout(others)
        laid_out = (ProgramPointers, EnvironmentPointers, EnvironmentCall, LookupPointers, ParameterNoisePointers)
        if tuple(sizes[:3]) != (ctypes.sizeof(Settings), ctypes.sizeof(RowPointers), STATES) or tuple(others[:6]) != (
            *map(ctypes.sizeof, laid_out),
            PARAMETERS,
        ):
            msg = f"The kernel library {path} belongs to another version of glbench. Delete {Path(path).parent} and try again."
            raise CompiledUnavailable(msg)
        self.width = int(sizes[3])
        self.most_registers, self.most_drawn = int(others[6]), int(others[7])


@functools.cache
def load(path: str) -> Library:
    """The library at ``path``, loaded once in a process.

    Raises
    ------
    CompiledUnavailable
        When it cannot be loaded or does not belong to this version.
    """
    return Library(path)
