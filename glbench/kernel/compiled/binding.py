"""The library's two functions through ctypes, with the layout of their arguments."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path

from glbench.kernel.compiled.unavailable import CompiledUnavailable
from glbench.model import STATE_NAMES

STATES = len(STATE_NAMES)


class Settings(ctypes.Structure):
    """``glb::Settings`` of native/driver.hpp."""

    _fields_ = (
        ("step", ctypes.c_double),
        ("first", ctypes.c_double),
        ("forgotten", ctypes.c_double),
        ("guard", ctypes.c_double),
        ("memory", ctypes.c_double),
        ("smallest", ctypes.c_double),
        ("most", ctypes.c_double),
        ("absolute", ctypes.c_double * STATES),
        ("relative", ctypes.c_double * STATES),
        ("threads", ctypes.c_int32),
    )


class RowPointers(ctypes.Structure):
    """``glb::Rows`` of native/driver.hpp."""

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


class Library:
    """A loaded library. Calls release Python's global lock."""

    def __init__(self, path: str) -> None:
        try:
            handle = ctypes.CDLL(path)
            self.step_rows = handle.glb_step_rows
            layout = handle.glb_layout
        except (OSError, AttributeError) as error:
            msg = f"The kernel library {path} cannot be loaded: {error}. Delete {Path(path).parent} and try again."
            raise CompiledUnavailable(msg) from error
        self.step_rows.restype = ctypes.c_int64  # how many rows have a status other than 0
        self.step_rows.argtypes = (ctypes.POINTER(Settings), ctypes.POINTER(RowPointers))
        sizes = (ctypes.c_int64 * 4)()
        layout(sizes)
        if tuple(sizes[:3]) != (ctypes.sizeof(Settings), ctypes.sizeof(RowPointers), STATES):
            msg = f"The kernel library {path} belongs to another version of glbench. Delete {Path(path).parent} and try again."
            raise CompiledUnavailable(msg)
        self.width = int(sizes[3])


@functools.cache
def load(path: str) -> Library:
    """The library at ``path``, loaded once in a process.

    Raises
    ------
    CompiledUnavailable
        When it cannot be loaded or does not belong to this version.
    """
    return Library(path)
