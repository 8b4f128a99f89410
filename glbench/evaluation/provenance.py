"""Where and with what a result was computed: versions, machine, state of the checkout.

None of it decides a score, and none of it enters the digest of a result; it is there for the person who finds two results that
differ. Nothing personal is recorded: no host name, no user name, no folder.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from importlib.metadata import version
from pathlib import Path

from glbench import __version__
from glbench.evaluation.records import GitState, Machine, Versions

# What decides a number, besides task and agent (those have digests of their own). Reports and a user's submissions change all the
# time and do not make a checkout "dirty".
_DECISIVE = ("glbench", "tasks", "weather", "baselines", "pyproject.toml", "uv.lock")
_GIT_SECONDS = 10


def versions(model: str) -> Versions:
    """Versions of everything that computes a number; ``model`` is that of the model."""
    return Versions(
        glbench=__version__,
        model=model,
        python=platform.python_version(),
        numpy=version("numpy"),
        casadi=version("casadi"),
        gymnasium=version("gymnasium"),
    )


def machine() -> Machine:
    """Processor, cores that this process may use, operating system."""
    return Machine(
        processor=_processor(), architecture=platform.machine(), cores=usable_cores(), system=platform.platform()
    )


def usable_cores() -> int:
    """Processor cores that this process may use: fewer than the machine has inside many containers and batch systems."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def git_state() -> GitState | None:
    """Commit of the checkout that glbench runs from; ``None`` for an installed package or where git cannot tell."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists() or not (root / "pyproject.toml").is_file():
        return None
    commit = _git(root, "rev-parse", "--verify", "HEAD")
    changes = _git(root, "status", "--porcelain", "--", *[name for name in _DECISIVE if (root / name).exists()])
    if commit is None or changes is None:
        return None
    return GitState(commit=commit, dirty=bool(changes))


def _git(root: Path, *arguments: str) -> str | None:
    program = shutil.which("git")
    if program is None:
        return None
    # Without the optional locks a status in the background never disturbs a commit that the user makes at the same time.
    environment = {**os.environ, "GIT_OPTIONAL_LOCKS": "0"}
    try:
        answer = subprocess.run(
            [program, "-C", str(root), *arguments],
            capture_output=True, text=True, check=False, timeout=_GIT_SECONDS, env=environment,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return None
    return answer.stdout.strip() if answer.returncode == 0 else None


def _processor() -> str:
    """Name of the processor as its maker writes it; the architecture where the system does not tell."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine() or "unknown"
