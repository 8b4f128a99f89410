"""Builds the shared library of a model once, keeps it in the cache, and never trusts a broken file.

A library is named by the digest of everything that could change it: model and generator sources, compiler, flags and
processor. It is built in a temporary folder under a lock and moved into place in one go, so that processes that start
together build it once and none sees a part of it. A loaded library is never overwritten: a replacement is a new file.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from filelock import FileLock, Timeout

import glbench.model
from glbench.errors import GlbenchError
from glbench.kernel.compiled.compiler import find_compiler, machine_digest
from glbench.kernel.compiled.generate import Traits, generate
from glbench.kernel.compiled.unavailable import CompiledUnavailable
from glbench.resources import cache_folder, write_atomically

_HERE = Path(__file__).resolve().parent
_NATIVE = _HERE / "native"
_LOCK_SECONDS = 600.0
_GENERATOR = ("derivative", "emit", "generate", "graph", "importer", "lu", "regroup", "schedule")
_SOURCE = '#include "model.hpp"\n#include "driver.hpp"\n'


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


def build(variant: str, traits: Traits, width: int | None = None) -> Build:
    """The library for a model variant, from the cache or built now.

    Parameters
    ----------
    variant
        Model variant.
    traits
        What is known of the model beyond its equations.
    width
        Number of lanes; None for what suits this processor.

    Raises
    ------
    CompiledUnavailable
        When it is not in the cache and cannot be built: no compiler, a failing one, a cache that cannot be written.
    """
    compiler = find_compiler()
    flags = compiler.flags(width)
    facts = (variant, traits, compiler.command, compiler.version, flags, machine_digest())
    name = f"{variant}-{_digest([repr(facts).encode(), _sources().encode()])[:20]}"
    folder = cache_folder() / "kernel"
    found = _intact(folder, name)
    if found is not None:
        return found
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / f"{name}.lock", timeout=_LOCK_SECONDS):
            found = _intact(folder, name)  # another process may have built it meanwhile
            if found is not None:
                return found
            return _build(folder, name, variant, traits, flags)
    except Timeout as error:
        msg = f"Another process has been building the kernel for {_LOCK_SECONDS:g} s (lock {error.lock_file}). Try again later."
        raise CompiledUnavailable(msg) from error
    except OSError as error:
        msg = (
            f"The kernel's cache folder {folder} cannot be used: {error.strerror or error}. "
            "Set GLBENCH_CACHE to a folder that you may write to."
        )
        raise CompiledUnavailable(msg) from error
    except GlbenchError as error:
        if isinstance(error, CompiledUnavailable):
            raise
        raise CompiledUnavailable(str(error)) from error


def _build(folder: Path, name: str, variant: str, traits: Traits, flags: tuple[str, ...]) -> Build:
    started = time.perf_counter()
    compiler = find_compiler()
    with tempfile.TemporaryDirectory(prefix=f".{name}.", dir=folder) as temporary:
        work = Path(temporary)
        (work / "model.hpp").write_text(generate(glbench.model.build_rhs(variant), traits).text, encoding="utf-8")
        (work / "kernel.cpp").write_text(_SOURCE, encoding="utf-8")
        library = work / "kernel.so"
        compiler.compile(work / "kernel.cpp", library, (work, _NATIVE), flags)
        digest = hashlib.sha256(library.read_bytes()).hexdigest()
        final = folder / f"{name}-{digest[:12]}.so"
        library.replace(final)
        (work / "model.hpp").replace(folder / f"{name}.hpp")
    seconds = round(time.perf_counter() - started, 2)
    built = Build(str(final), digest, f"{' '.join(compiler.command)}: {compiler.version}", " ".join(flags), seconds)
    write_atomically(folder / f"{name}.json", json.dumps(asdict(built), indent=1) + "\n")
    return built


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


@cache
def _sources() -> str:
    """Digest of everything the library is made from: the model, the generator, the C++ beside it, CasADi's version."""
    model = Path(glbench.model.__file__).resolve().parent
    files = [file for root in (model, _NATIVE) for file in root.rglob("*") if file.suffix in {".py", ".csv", ".hpp"}]
    files += [_HERE / f"{name}.py" for name in _GENERATOR]
    try:
        casadi_version = version("casadi")
    except PackageNotFoundError:
        casadi_version = "unknown"
    parts = [casadi_version.encode()]
    for file in sorted(files):
        parts += [file.name.encode(), file.read_bytes()]
    return _digest(parts)
