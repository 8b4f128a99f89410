"""The C++ compiler of this machine, and the flags that keep every bit where IEEE 754 puts it."""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from glbench import children
from glbench.errors import GlbenchError, refuse

# No fused multiply-add but the written ones; no -ffast-math in any form. The two "no-" flags give up errno and
# floating-point exceptions, neither of which has a value.
_EXACT = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math")
# The generator has put the statements into a good order; gcc would move each to where its value is used.
_IN_ORDER = ("-fno-tree-ter", "-fschedule-insns", "-fsched-pressure", "-fno-gcse")
# gcc 12 takes Zen 4 for Zen 3, which has no 512-bit vectors. With its choices for Haswell, batches are 5 % faster there.
_TUNED = ("-mtune=haswell",)
_TIMEOUT_SECONDS = 1200.0


class CompiledUnavailable(GlbenchError):  # noqa: N818  a state of the machine, answered with another backend
    """There is no compiled kernel on this machine; the message says why and what to do. CasADi steps in, more slowly."""


@dataclass(frozen=True)
class Compiler:
    """Command that compiles C++, and its version in words."""

    command: tuple[str, ...]
    version: str

    def flags(self, width: int | None = None, level: str | None = None) -> tuple[str, ...]:
        """Flags for a library of this machine, or of all machines of a ``level`` (``"x86-64-v3"``); ``width`` forces the lanes.

        A library for a level brings what it needs of the C++ runtime, so that it loads on systems with an older one.
        """
        x86 = platform.machine() in {"x86_64", "AMD64"}
        native = "-march=native" if x86 else "-mcpu=native"
        tune = native if level is None else f"-march={level}"
        runtime = () if level is None else ("-static-libstdc++", "-static-libgcc", "-s", "-Wl,--exclude-libs,ALL", "-Wl,--gc-sections")
        lanes = () if width is None else (f"-DGLB_WIDTH={width}",)
        of_gcc = () if "clang" in self.version else _IN_ORDER + (_TUNED if x86 else ())
        return (
            "-std=c++17", "-O2", tune, *of_gcc, *_EXACT, "-Wno-psabi", "-fPIC", "-shared", "-pthread", *runtime, *lanes,
        )  # fmt: skip

    def compile(self, source: Path, library: Path, include: tuple[Path, ...], flags: tuple[str, ...]) -> None:
        """Compile one source file into a shared library.

        Raises ``CompiledUnavailable`` when the compiler fails or takes too long; the message has the end of what it said.
        """
        folders = [word for folder in include for word in ("-I", str(folder))]
        command = [*self.command, *flags, *folders, str(source), "-o", str(library)]
        try:
            result = children.run(command, timeout=_TIMEOUT_SECONDS)
        except subprocess.TimeoutExpired as error:
            slow = f"The compiler '{' '.join(self.command)}' was stopped after {_TIMEOUT_SECONDS:g} s. Is the machine busy? Try again."
            refuse(slow, CompiledUnavailable, error)
        except OSError as error:
            refuse(f"The compiler '{' '.join(self.command)}' could not build the kernel: {error}.", CompiledUnavailable, error)
        if result.returncode != 0:
            lines = (result.stderr or result.stdout).strip().splitlines()
            reason = " | ".join(([line for line in lines if "error" in line.lower()] or lines)[:4])
            msg = (
                f"The compiler '{' '.join(self.command)}' ({self.version}) failed on the kernel with exit status "
                f"{result.returncode}: {reason or 'it gave no reason'}. Set CXX to another C++17 compiler (gcc or clang)."
            )
            raise CompiledUnavailable(msg)


def find_compiler() -> Compiler:
    """The compiler named by CXX, else the C++ companion of CC, else the first of c++, g++, clang++ that runs.

    Raises ``CompiledUnavailable`` when there is none, or the one that CXX or CC names does not run, or ``CXX=none`` asks for none.
    """
    return _find(os.environ.get("CXX", ""), os.environ.get("CC", ""), os.environ.get("PATH", ""))


@cache
def _find(cxx: str, cc: str, path: str) -> Compiler:
    if cxx.strip():
        candidates, wish = [tuple(shlex.split(cxx))], f"CXX={cxx}"
    elif cc.strip():
        candidates, wish = [_companion(tuple(shlex.split(cc)))], f"CC={cc}"
    else:
        candidates, wish = [("c++",), ("g++",), ("clang++",)], ""
    broken = []
    for command in candidates:
        version = _version(command)
        if version is not None:
            return Compiler(command, version)
        place = shutil.which(command[0])
        if place is not None:
            broken.append(place)
    if cxx.strip() == "none":
        msg = "CXX=none asks for no compiler. Unset it to use c++, g++ or clang++."
    elif wish:
        msg = f"The compiler that {wish} asks for does not run. Correct the variable, or unset it to use c++, g++ or clang++."
    elif broken:
        msg = (
            f"The C++ compiler here does not run ({', '.join(broken)}: `--version` fails). "
            "Install gcc or clang anew, or set CXX to one that works."
        )
    else:
        msg = "There is no C++ compiler here (looked for c++, g++, clang++). Install gcc or clang, or set CXX."
    raise CompiledUnavailable(msg)


def _companion(command: tuple[str, ...]) -> tuple[str, ...]:
    """The C++ driver beside a C one: gcc-12 -> g++-12, clang -> clang++, cc -> c++."""
    path = Path(command[0])
    name = path.name
    for c_name, cxx_name in (("clang", "clang++"), ("gcc", "g++"), ("cc", "c++")):
        if name.startswith(c_name):
            name = cxx_name + name[len(c_name) :]
            break
    return (str(path.with_name(name)) if path.parent != Path() else name, *command[1:])


def _version(command: tuple[str, ...]) -> str | None:
    if shutil.which(command[0]) is None:
        return None
    try:
        result = subprocess.run([*command, "--version"], capture_output=True, text=True, timeout=30.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.splitlines()[0].strip() if result.returncode == 0 and result.stdout else None


@cache
def machine_digest() -> str:
    """Digest of what ``-march=native`` depends on: a cache may be shared by machines with different processors."""
    facts = [sys.platform, platform.machine(), platform.processor()]
    processor = Path("/proc/cpuinfo")
    if processor.is_file():
        keys = ("flags", "model name", "features", "cpu part")
        lines = processor.read_text(encoding="utf-8", errors="replace").splitlines()
        facts += sorted({line for line in lines if line.lower().startswith(keys)})
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()
