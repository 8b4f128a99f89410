"""Builds the shared library of a model once, keeps it in the cache, and never trusts a broken file.

A library is named by the digest of everything that could change it: the model's equations, the generator's sources, compiler,
flags and processor. It is built in a temporary folder under a lock and moved into place in one go, so that processes that start
together build it once and none sees a part of it. A loaded library is never overwritten: a replacement is a new file.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from filelock import FileLock, Timeout

from glbench.errors import GlbenchError
from glbench.kernel.compiled import prebuilt
from glbench.kernel.compiled.compiler import CompiledUnavailable, find_compiler, machine_digest
from glbench.kernel.compiled.generate import Traits, generate
from glbench.kernel.compiled.sensitivity_code import generate_sensitivities
from glbench.model import Model
from glbench.resources import cache_folder, with_unix_line_ends, write_atomically

_HERE = Path(__file__).resolve().parent
_NATIVE = _HERE / "native"
LENT = "GLBENCH_KERNELS"
"""Names a folder with libraries that another process of this machine built."""
_LOCK_SECONDS = 600.0
_GENERATOR = ("derivative", "emit", "generate", "graph", "importer", "lu", "regroup", "schedule")
_SENSITIVITY_GENERATOR = ("reverse", "sensitivity_code", "substitution")
_SOURCE = '#include "model.hpp"\n#include "driver.hpp"\n#include "environment.hpp"\n'
_SENSITIVITY_SOURCE = '#include "model.hpp"\n#include "sensitivity_model.hpp"\n#include "trajectory.hpp"\n'


@dataclass(frozen=True)
class Build:
    """A library on disk and how it came there.

    Attributes
    ----------
    path : str
        The shared library.
    digest : str
        SHA-256 of its bytes.
    compiler, flags : str
        What built it.
    seconds : float
        How long generating and compiling took [s].
    """

    path: str
    digest: str
    compiler: str
    flags: str
    seconds: float


def build(model: Model, traits: Traits, width: int | None = None, *, sensitivities: bool = False) -> Build:
    """The library of a model: lent by another process, from the installed wheel, from the cache, or built now.

    Parameters
    ----------
    model
        What it steps.
    traits
        What is known of the model beyond its equations.
    width
        Number of lanes; None for what suits this processor.
    sensitivities
        Whether to build the library that steps and differentiates, instead of the one that steps.

    Raises
    ------
    CompiledUnavailable
        When it is not in the cache and cannot be built: no compiler, a failing one, a cache that cannot be written, equations with an
        operation that the generator does not know.
    """
    lent = _lent(model, traits, width, sensitivities=sensitivities)
    if lent is not None:
        return lent
    if width is None and not sensitivities:
        carried = prebuilt.find(prebuilt_key(model, traits))
        if carried is not None:
            path, facts_of = carried
            return Build(str(path), facts_of.digest, facts_of.compiler, facts_of.flags, 0.0)
    folder, name, flags = _place(model, traits, width, sensitivities=sensitivities)
    found = _intact(folder, name)
    if found is not None:
        return found
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / f"{name}.lock", timeout=_LOCK_SECONDS):
            found = _intact(folder, name)  # another process may have built it meanwhile
            if found is not None:
                return found
            return _build(folder, name, model, traits, flags, sensitivities=sensitivities)
    except Timeout as error:
        msg = f"Another process has been building the kernel for {_LOCK_SECONDS:g} s (lock {error.lock_file}). Try again later."
        raise CompiledUnavailable(msg) from error
    except OSError as error:
        msg = (
            f"The kernel's cache folder {folder} cannot be used: {error.strerror or error}. "
            "Set GLBENCH_CACHE to a folder that you may write to."
        )
        raise CompiledUnavailable(msg) from error
    except CompiledUnavailable:
        raise
    except (GlbenchError, ValueError) as error:
        msg = f"The model {model} cannot be compiled: {error}"
        raise CompiledUnavailable(msg) from error


def library_is_built(model: Model, traits: Traits, width: int | None = None) -> bool:
    """Whether ``build`` with these arguments finds the library in the wheel or in the cache.

    Raises
    ------
    CompiledUnavailable
        When there is no compiler.
    """
    if _lent(model, traits, width, sensitivities=False) is not None:
        return True
    if width is None and prebuilt.find(prebuilt_key(model, traits)) is not None:
        return True
    folder, name, _ = _place(model, traits, width)
    return _intact(folder, name) is not None


def built_files(model: Model, traits: Traits) -> dict[str, Path]:
    """The files in the cache that ``build`` would take for stepping and for derivatives, by the names that they need in a lent folder.

    Raises
    ------
    CompiledUnavailable
        When there is no compiler, by which libraries in the cache are named.
    """
    files: dict[str, Path] = {}
    for sensitivities in (False, True):
        folder, name, _ = _place(model, traits, None, sensitivities=sensitivities)
        found = _intact(folder, name)
        if found is not None:
            path = Path(found.path)
            files |= {
                path.name: path,
                f"{_lent_name(model, traits, sensitivities=sensitivities)}.json": folder / f"{name}.json",
            }
    return files


def _lent(model: Model, traits: Traits, width: int | None, *, sensitivities: bool) -> Build | None:
    """The library that another process of this machine lends in the folder that ``GLBENCH_KERNELS`` names, whatever compiled it."""
    folder = os.environ.get(LENT)
    if not folder or width is not None:
        return None
    return _intact(Path(folder), _lent_name(model, traits, sensitivities=sensitivities))


def _lent_name(model: Model, traits: Traits, *, sensitivities: bool) -> str:
    kind = "sensitivities" if sensitivities else "step"
    return f"{_file_name(model)}-{kind}-{prebuilt_key(model, traits)[:20]}"


def _place(
    model: Model, traits: Traits, width: int | None, *, sensitivities: bool = False
) -> tuple[Path, str, tuple[str, ...]]:
    """Folder and name of a library, and the flags that it is compiled with."""
    compiler = find_compiler()
    flags = compiler.flags(width)
    facts = (compiler.command, compiler.version, flags, machine_digest(), _casadi_version())
    kind = f"{_file_name(model)}-sensitivities" if sensitivities else _file_name(model)
    name = f"{kind}-{_digest([repr(facts).encode(), prebuilt_key(model, traits).encode()])[:20]}"
    return cache_folder() / "kernel", name, flags


def write_source(
    folder: Path, model: Model, traits: Traits, *, sensitivities: bool = False
) -> tuple[Path, tuple[Path, ...]]:
    """Write the C++ of a model into ``folder``: the file to compile, and the folders that it includes from."""
    function = model.rhs_function()
    (folder / "model.hpp").write_text(generate(function, traits).text, encoding="utf-8")
    if sensitivities:
        (folder / "sensitivity_model.hpp").write_text(generate_sensitivities(function, traits), encoding="utf-8")
    source = folder / "kernel.cpp"
    source.write_text(_SENSITIVITY_SOURCE if sensitivities else _SOURCE, encoding="utf-8")
    return source, (folder, _NATIVE)


def _build(
    folder: Path, name: str, model: Model, traits: Traits, flags: tuple[str, ...], *, sensitivities: bool
) -> Build:
    started = time.perf_counter()
    compiler = find_compiler()
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as temporary:
        work = Path(temporary)
        source, include = write_source(work, model, traits, sensitivities=sensitivities)
        library = work / "kernel.so"
        compiler.compile(source, library, include, flags)
        digest = hashlib.sha256(library.read_bytes()).hexdigest()
        final = folder / f"{name}-{digest[:12]}.so"
        library.replace(final)
        (work / "model.hpp").replace(folder / f"{name}.hpp")
    seconds = round(time.perf_counter() - started, 2)
    built = Build(str(final), digest, f"{' '.join(compiler.command)}: {compiler.version}", " ".join(flags), seconds)
    write_atomically(folder / f"{name}.json", json.dumps(asdict(built), indent=1) + "\n")
    return built


def prebuild(folder: Path, model: Model, traits: Traits) -> list[prebuilt.Prebuilt]:
    """Compile a model for every processor level that a wheel carries, into ``folder``.

    Raises
    ------
    CompiledUnavailable
        When there is no compiler, or it fails.
    """
    compiler = find_compiler()
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        source, include = write_source(work, model, traits)

        def compile_into(library: Path, flags: tuple[str, ...]) -> None:
            compiler.compile(source, library, include, flags)

        return prebuilt.prebuild(folder, compiler, prebuilt_key(model, traits), _file_name(model), compile_into)


def prebuilt_key(model: Model, traits: Traits) -> str:
    """Digest of what a library is made from: the model, its equations and traits, the generator and the C++ beside it.

    Without CasADi's version: the library computes the same equations whichever wrote it, and builder and user may have two.
    """
    facts = (model.name, model.version, model.variant, model.digest, traits)
    return _digest([repr(facts).encode(), _sources().encode()])


def _file_name(model: Model) -> str:
    """Beginning of the names of a model's files."""
    return re.sub(r"[^A-Za-z0-9._-]", "_", f"{model.id}-{model.variant}")


def _intact(folder: Path, name: str) -> Build | None:
    """The finished build of that name, unless it is missing or damaged."""
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


def _casadi_version() -> str:
    try:
        return version("casadi")
    except PackageNotFoundError:
        return "unknown"


@cache
def _sources() -> str:
    """Digest of the files of the generator and the C++ beside it."""
    files = [*_NATIVE.glob("*.hpp"), *(_HERE / f"{name}.py" for name in (*_GENERATOR, *_SENSITIVITY_GENERATOR))]
    return _digest(
        part
        for file in sorted(files)
        for part in (file.name.encode(), with_unix_line_ends(file.name, file.read_bytes()))
    )
