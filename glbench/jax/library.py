"""Builds the small library that answers XLA's calls, once for a machine and a version of JAX, and loads it.

It is compiled with the compiler and the flags of the kernel, against the headers that JAX brings. The kernel's own library is not touched.
"""

from __future__ import annotations

import ctypes
import hashlib
import tempfile
import time
from functools import cache
from importlib.metadata import version
from pathlib import Path

import jax

from glbench.kernel.compiled import binding
from glbench.kernel.compiled.compiler import find_compiler, machine_digest
from glbench.kernel.compiled.library import build_lock, intact, keep
from glbench.resources import cache_folder

RESET, STEP = "glbench_reset", "glbench_step"  # Names under which XLA knows the calls

_SOURCE = Path(__file__).resolve().parent / "native" / "door.cpp"
_LOCK_SECONDS = 300.0


class DoorPointers(ctypes.Structure):
    """``Door`` of native/door.cpp."""

    _fields_ = binding.members(
        "run* settings* program* states controls actions memory keys days traits parameters columns width shared_parameters "
        "scenarios places low* high* start* at* sequence* first* key* parameter* trait* in_force* remembered* reward shown show*"
    )


@cache
def library() -> ctypes.CDLL:
    """The library, built if need be, with its calls known to XLA.

    Raises ``CompiledUnavailable`` when it can be neither loaded nor built: no compiler, a failing one, a cache that cannot be written.
    """
    path = _build()
    handle = binding.open_library(path, "glb_door_reset", "glb_door_step", "glb_door_open", "glb_door_layout")
    sizes = (ctypes.c_int64 * 3)()
    handle.glb_door_layout(sizes)
    if tuple(sizes) != tuple(map(ctypes.sizeof, (DoorPointers, binding.EnvironmentPointers, binding.EnvironmentCall))):
        raise binding.of_another_version(path)
    handle.glb_door_open.argtypes = (ctypes.c_char_p, ctypes.c_void_p)
    handle.glb_door_open.restype = None
    jax.ffi.register_ffi_target(RESET, jax.ffi.pycapsule(handle.glb_door_reset))  # type: ignore[no-untyped-call]
    jax.ffi.register_ffi_target(STEP, jax.ffi.pycapsule(handle.glb_door_step))  # type: ignore[no-untyped-call]
    return handle


def _build() -> str:
    """The library in the cache, named by all that could change it."""
    compiler = find_compiler()
    flags = compiler.flags()
    facts = (compiler.command, compiler.version, flags, machine_digest(), version("jaxlib"), _SOURCE.read_bytes())
    folder = cache_folder() / "kernel"
    name = f"jax-{hashlib.sha256(repr(facts).encode()).hexdigest()[:20]}"
    with build_lock(folder / f"{name}.lock", "the library for JAX", _LOCK_SECONDS):
        built, started = intact(folder, name), time.perf_counter()
        if built is None:
            with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as work:
                target = Path(work) / "door.so"
                compiler.compile(_SOURCE, target, (Path(jax.ffi.include_dir()),), flags)
                built = keep(target, folder, name, flags, time.perf_counter() - started)
    return built.path
