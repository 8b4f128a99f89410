"""Libraries that were compiled while the wheel was built, for machines without a compiler and first uses without waiting.

A wheel from a machine with a compiler carries the usual library of every registered model for a few levels of processors,
under ``glbench/_data/kernel``. Parameters are inputs of the library, so one serves every greenhouse. A library is taken only
when its model has the same equations, the generator is byte for byte that of the installed package, its bytes are those that were
built, and the processor has every instruction it may use. The bits of a step do not depend on the level (docs/kernel-compiled.md).
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from glbench.kernel.compiled.compiler import Compiler
from glbench.resources import data_folder

FOLDER = "kernel"
"""Where the libraries lie in the wheel's data."""

_V3 = frozenset({"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"})
_V4 = _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}
# Levels of the x86-64 psABI, the best first, with the processor features (as Linux names them) that they stand on.
_X86_LEVELS = {"x86-64-v4": _V4, "x86-64-v3": _V3}


@dataclass(frozen=True)
class Prebuilt:
    """A library in the wheel.

    Attributes
    ----------
    file : str
        Name in the folder.
    key : str
        Digest of the model, its equations and traits, and all sources.
    level : str
        Processor level it was compiled for.
    digest : str
        SHA-256 of its bytes.
    compiler, flags : str
        What built it.
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


def prebuild(
    folder: Path, compiler: Compiler, key: str, name: str, compile_into: Callable[[Path, tuple[str, ...]], None]
) -> list[Prebuilt]:
    """Compile one model for every level into ``folder``.

    Parameters
    ----------
    folder
        Where the libraries go; it exists.
    compiler
        What compiles.
    key, name
        Digest of everything the library is made from; beginning of the file's name.
    compile_into
        Compiles the model with the given flags to the given path.
    """
    made = []
    for level in levels_to_build():
        flags = compiler.flags(level=level)
        path = folder / f"{name}-{level}.so"
        compile_into(path, flags)
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        made.append(Prebuilt(path.name, key, level, digest, compiler.version, " ".join(flags)))
    return made


def write_manifest(folder: Path, made: list[Prebuilt]) -> None:
    """Write what ``find`` reads."""
    text = json.dumps([asdict(one) for one in made], indent=1) + "\n"
    (folder / "manifest.json").write_text(text, encoding="utf-8")


def find(key: str) -> tuple[Path, Prebuilt] | None:
    """The best library with that key that this processor can run; ``None`` when there is none, or it is damaged."""
    folder = _folder()
    usable = _usable_levels()
    if folder is None or not usable:
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


def _folder() -> Path | None:
    """Folder of the libraries in an installed wheel; a checkout has none."""
    folder = data_folder("tasks").parent / FOLDER
    return folder if folder.parent.name == "_data" and folder.is_dir() else None


@cache
def _usable_levels() -> tuple[str, ...]:
    """Levels that this processor has, the best first."""
    if not sys.platform.startswith("linux"):
        return ()
    if platform.machine() == "aarch64":
        return ("armv8-a",)
    features = _x86_features()
    return tuple(level for level, needed in _X86_LEVELS.items() if needed <= features)


def _x86_features() -> frozenset[str]:
    """Features of the processor as Linux names them."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return frozenset()
    for line in text.splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "flags":
            return frozenset(value.split())
    return frozenset()
