"""Builds the shared library of a model once, keeps it in the cache, and never trusts a broken file.

A library is named by the digest of everything that could change it: the model's equations, the generator's sources, compiler,
flags and processor. It is built in a temporary folder under a lock and moved into place in one go, so that processes that start
together build it once and none sees a part of it. A loaded library is never overwritten: a replacement is a new file.

For machines without a compiler and first uses without waiting, a wheel carries libraries that were compiled while it was built: the
usual library of every registered model, for a few levels of processors, under ``glbench/_data/kernel``. Parameters are inputs of the
library, so one serves every greenhouse. A library is taken only when its model has the same equations, the generator is byte for byte
that of the installed package, its bytes are those that were built, and the processor has every instruction it may use. The bits of a
step do not depend on the level (docs/kernel-compiled.md).
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from filelock import FileLock, Timeout

from glbench.errors import GlbenchError, refuse
from glbench.kernel.compiled.compiler import CompiledUnavailable, find_compiler, machine_digest
from glbench.kernel.compiled.generate import Traits, generate
from glbench.model import Model
from glbench.resources import cache_folder, data_folder, with_unix_line_ends, write_atomically

FOLDER = "kernel"
"""Where the libraries lie in the wheel's data."""

_V3 = frozenset({"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"})
_V4 = _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
# Levels of the x86-64 psABI, the best first, with the processor features (as Linux names them) that they stand on.
_X86_LEVELS = {"x86-64-v4": _V4, "x86-64-v3": _V3}


@dataclass(frozen=True)
class Prebuilt:
    """A library in the wheel: its ``file`` name in the folder, and what built it.

    ``key`` is the digest of the model, its equations and traits, and all sources; ``level`` the processor level it was compiled for;
    ``digest`` the SHA-256 of its bytes.
    """

    file: str
    key: str
    level: str
    digest: str
    compiler: str
    flags: str


def levels_to_build() -> tuple[str, ...]:
    """Processor levels worth a library on machines like this one; none where the wheel carries no libraries."""
    if not sys.platform.startswith("linux"):
        return ()
    machine = platform.machine()
    if machine == "x86_64":
        return tuple(_X86_LEVELS)
    return ("armv8-a",) if machine == "aarch64" else ()


def write_manifest(folder: Path, libraries: list[Prebuilt]) -> None:
    """Write what ``find_prebuilt`` reads."""
    text = json.dumps([asdict(library) for library in libraries], indent=1) + "\n"
    (folder / "manifest.json").write_text(text, encoding="utf-8")


def find_prebuilt(key: str) -> tuple[Path, Prebuilt] | None:
    """The best library with that key that this processor can run; ``None`` when there is none, or it is damaged."""
    folder, usable = data_folder("tasks").parent / FOLDER, _usable_levels()
    if folder.parent.name != "_data" or not folder.is_dir() or not usable:  # a checkout has no such folder
        return None
    try:
        offered = [Prebuilt(**entry) for entry in json.loads((folder / "manifest.json").read_text(encoding="utf-8"))]
        fitting = [one for one in offered if one.key == key and one.level in usable]
        for one in sorted(fitting, key=lambda one: usable.index(one.level)):
            if hashlib.sha256((folder / one.file).read_bytes()).hexdigest() == one.digest:
                return folder / one.file, one
    except (OSError, ValueError, TypeError):
        return None
    return None


@cache
def _usable_levels() -> tuple[str, ...]:
    """Levels that this processor has, the best first."""
    if not sys.platform.startswith("linux"):
        return ()
    if platform.machine() == "aarch64":
        return ("armv8-a",)
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ()
    flags = (line.partition(":")[2] for line in text.splitlines() if line.partition(":")[0].strip() == "flags")
    features = frozenset(next(flags, "").split())
    return tuple(level for level, needed in _X86_LEVELS.items() if needed <= features)


_HERE = Path(__file__).resolve().parent
_NATIVE = _HERE / "native"
LENT = "GLBENCH_KERNELS"
"""Names a folder with libraries that another process of this machine built."""
_LOCK_SECONDS = 1800.0
_GENERATOR = ("derivative", "emit", "generate", "graph", "lu", "regroup", "sensitivity_code")
_SOURCE = '#include "model.hpp"\n#include "driver.hpp"\n#include "environment.hpp"\n'
_SENSITIVITY_SOURCE = '#include "model.hpp"\n#include "sensitivity_model.hpp"\n#include "trajectory.hpp"\n'


@dataclass(frozen=True)
class Build:
    """A library on disk at ``path``, with the SHA-256 of its bytes, and what built it in how many ``seconds``."""

    path: str
    digest: str
    compiler: str
    flags: str
    seconds: float


def build(model: Model, traits: Traits, width: int | None = None, *, sensitivities: bool = False) -> Build:
    """The library of a model: lent by another process, from the installed wheel, from the cache, or built now.

    ``traits`` are what is known of the model beyond its equations. ``width`` is the number of lanes; None for what suits this processor.
    With ``sensitivities``, the library is one that steps and differentiates, instead of the one that steps. Raises ``CompiledUnavailable``
    when it is not in the cache and cannot be built: no compiler, a failing one, a cache that cannot be written, an unknown operation.
    """
    lent = _lent(model, traits, width, sensitivities=sensitivities)
    if lent is not None:
        return lent
    if width is None and not sensitivities:
        carried = find_prebuilt(prebuilt_key(model, traits))
        if carried is not None:
            path, facts_of = carried
            return Build(str(path), facts_of.digest, facts_of.compiler, facts_of.flags, 0.0)
    folder, name, flags = _place(model, traits, width, sensitivities=sensitivities)
    whole = intact(folder, name)
    if whole is not None:
        return whole
    try:
        with build_lock(folder / f"{name}.lock", "the kernel", _LOCK_SECONDS):
            whole = intact(folder, name)  # another process may have built it meanwhile
            return whole or _build(folder, name, model, traits, flags, sensitivities=sensitivities)
    except CompiledUnavailable:
        raise
    except (GlbenchError, ValueError) as error:
        refuse(f"The model {model} cannot be compiled: {error}", CompiledUnavailable, error)


@contextmanager
def build_lock(lock: Path, what: str, seconds: float) -> Iterator[None]:
    """Lock ``what`` while it is built. Raises ``CompiledUnavailable`` when another holds it for ``seconds``, or the folder fails."""
    try:
        lock.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(lock, timeout=seconds):
            yield
    except Timeout as error:
        refuse(f"Another process has been building {what} for {seconds:g} s (lock {lock}). Try again later.", CompiledUnavailable, error)
    except OSError as error:
        reason = f"The kernel's cache folder {lock.parent} cannot be used: {error.strerror or error}."
        refuse(f"{reason} Set GLBENCH_CACHE to a folder that you may write to.", CompiledUnavailable, error)


def library_is_built(model: Model, traits: Traits, width: int | None = None) -> bool:
    """Whether ``build`` with these arguments finds the library. Raises ``CompiledUnavailable`` when there is no compiler."""
    if _lent(model, traits, width, sensitivities=False) is not None:
        return True
    if width is None and find_prebuilt(prebuilt_key(model, traits)) is not None:
        return True
    folder, name, _ = _place(model, traits, width)
    return intact(folder, name) is not None


def built_files(model: Model, traits: Traits) -> dict[str, Path]:
    """The files in the cache that ``build`` would take for stepping and for derivatives, by the names that they need in a lent folder.

    Raises ``CompiledUnavailable`` when there is no compiler, by which libraries in the cache are named.
    """
    files: dict[str, Path] = {}
    for sensitivities in (False, True):
        folder, name, _ = _place(model, traits, None, sensitivities=sensitivities)
        whole = intact(folder, name)
        if whole is not None:
            path = Path(whole.path)
            files |= {path.name: path, f"{_lent_name(model, traits, sensitivities=sensitivities)}.json": folder / f"{name}.json"}
    return files


def _lent(model: Model, traits: Traits, width: int | None, *, sensitivities: bool) -> Build | None:
    """The library that another process of this machine lends in the folder that ``GLBENCH_KERNELS`` names, whatever compiled it."""
    folder = os.environ.get(LENT)
    if not folder or width is not None:
        return None
    return intact(Path(folder), _lent_name(model, traits, sensitivities=sensitivities))


def _lent_name(model: Model, traits: Traits, *, sensitivities: bool) -> str:
    kind = "sensitivities" if sensitivities else "step"
    return f"{_file_name(model)}-{kind}-{prebuilt_key(model, traits)[:20]}"


def _place(model: Model, traits: Traits, width: int | None, *, sensitivities: bool = False) -> tuple[Path, str, tuple[str, ...]]:
    """Folder and name of a library, and the flags that it is compiled with."""
    compiler = find_compiler()
    flags = compiler.flags(width)
    try:
        casadi_version = version("casadi")
    except PackageNotFoundError:
        casadi_version = "unknown"
    facts = (compiler.command, compiler.version, flags, machine_digest(), casadi_version)
    kind = f"{_file_name(model)}-sensitivities" if sensitivities else _file_name(model)
    name = f"{kind}-{_digest([repr(facts).encode(), prebuilt_key(model, traits).encode()])[:20]}"
    return cache_folder() / "kernel", name, flags


def write_source(folder: Path, model: Model, traits: Traits, *, sensitivities: bool = False) -> tuple[Path, tuple[Path, ...]]:
    """Write the C++ of a model into ``folder``: the file to compile, and the folders that it includes from."""
    function = model.rhs_function()
    (folder / "model.hpp").write_text(generate(function, traits).text, encoding="utf-8")
    if sensitivities:
        from glbench.kernel.compiled.sensitivity_code import generate_sensitivities

        (folder / "sensitivity_model.hpp").write_text(generate_sensitivities(function, traits), encoding="utf-8")
    source = folder / "kernel.cpp"
    source.write_text(_SENSITIVITY_SOURCE if sensitivities else _SOURCE, encoding="utf-8")
    return source, (folder, _NATIVE)


def _build(folder: Path, name: str, model: Model, traits: Traits, flags: tuple[str, ...], *, sensitivities: bool) -> Build:
    started = time.perf_counter()
    compiler = find_compiler()
    for killed in folder.glob(f".{name}.*"):  # nobody else builds it: the caller has the lock
        shutil.rmtree(killed, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as temporary:
        work = Path(temporary)
        source, include = write_source(work, model, traits, sensitivities=sensitivities)
        library = work / "kernel.so"
        compiler.compile(source, library, include, flags)
        (work / "model.hpp").replace(folder / f"{name}.hpp")
        return keep(library, folder, name, flags, time.perf_counter() - started)


def keep(library: Path, folder: Path, name: str, flags: tuple[str, ...], seconds: float) -> Build:
    """Move a library that took ``seconds`` to build into the cache, with a record by which ``intact`` knows it and its bytes again."""
    compiler, digest = find_compiler(), hashlib.sha256(library.read_bytes()).hexdigest()
    final = folder / f"{name}-{digest[:12]}.so"
    library.replace(final)
    built = Build(str(final), digest, f"{' '.join(compiler.command)}: {compiler.version}", " ".join(flags), round(seconds, 2))
    write_atomically(folder / f"{name}.json", json.dumps(asdict(built), indent=1) + "\n")
    return built


def prebuild(folder: Path, model: Model, traits: Traits) -> list[Prebuilt]:
    """Compile a model for all levels that a wheel carries into ``folder``. Raises ``CompiledUnavailable`` when that cannot be."""
    compiler, key = find_compiler(), prebuilt_key(model, traits)
    libraries = []
    with tempfile.TemporaryDirectory() as temporary:
        source, include = write_source(Path(temporary), model, traits)
        for level in levels_to_build():
            flags = compiler.flags(level=level)
            path = folder / f"{_file_name(model)}-{level}.so"
            compiler.compile(source, path, include, flags)
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            libraries.append(Prebuilt(path.name, key, level, digest, compiler.version, " ".join(flags)))
    return libraries


def prebuilt_key(model: Model, traits: Traits) -> str:
    """Digest of what a library is made from: the model, its equations and traits, the generator and the C++ beside it.

    Without CasADi's version: the library computes the same equations whichever wrote it, and builder and user may have two.
    """
    facts = (model.name, model.version, model.variant, model.digest, traits)
    return _digest([repr(facts).encode(), _sources().encode()])


def traits_of(model: Model, zeros: tuple[int, ...]) -> Traits:
    """What is known of a model beyond its equations, with these parameters known to be zero."""
    fast = tuple(i for i, state in enumerate(model.states) if state.fast)
    singular = None if model.singular is None else (model.state_index(model.singular[0]), model.state_index(model.singular[1]))
    followers = tuple(i for i, state in enumerate(model.states) if state.follower)
    return Traits(zeros, fast, singular, followers, model.state_names if followers else ())


@cache
def absent_equipment(model: Model) -> tuple[int, ...]:
    """Parameters that are zero in the model's benchmark set; the usual library leaves out what they multiply.

    Interlights, for example: their area is zero. Rows with other parameters are stepped by a library of the full model. Parameters that a
    part declares beside its equations stay: a model that has such a part is there for it.
    """
    zero = model.parameters.default() == 0.0
    return tuple(int(i) for i in np.flatnonzero(zero) if model.table[i].used != "always")


def _file_name(model: Model) -> str:
    """Beginning of the names of a model's files."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", f"{model.id}-{model.variant}")


def intact(folder: Path, name: str) -> Build | None:
    """The finished build of that name, unless it is missing or damaged: to load half a library would crash the process."""
    try:
        record = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        built = Build(**record)
        path = folder / Path(built.path).name  # the cache may have been moved
        if hashlib.sha256(path.read_bytes()).hexdigest() != built.digest:
            return None
    except (OSError, ValueError, TypeError):
        return None
    return Build(str(path), built.digest, built.compiler, built.flags, built.seconds)


def _digest(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "big") + part)
    return digest.hexdigest()


@cache
def _sources() -> str:
    """Digest of the files of the generator and the C++ beside it."""
    files = [*_NATIVE.glob("*.hpp"), *(_HERE / f"{name}.py" for name in _GENERATOR)]
    return _digest(part for file in sorted(files) for part in (file.name.encode(), with_unix_line_ends(file.name, file.read_bytes())))
