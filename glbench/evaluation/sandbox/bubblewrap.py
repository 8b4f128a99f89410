"""The sandbox itself: how bubblewrap is called, and why it cannot be where it cannot."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Final

from glbench import __version__
from glbench.agents import Identity
from glbench.errors import SandboxError
from glbench.evaluation.sandbox import visible
from glbench.evaluation.sandbox.limits import SandboxLimits

ENVIRONMENT_OF_BUBBLEWRAP = {"PATH": "/usr/bin:/bin"}
"""bubblewrap itself gets no more: its process is visible inside."""

_NOBODY: Final = 65534
_FIRST_USER, _USERS = 61184, 4336
"""User ids that nobody has: those that systemd sets aside for services."""
_PATIENCE_SECONDS = 20.0
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_REMEDY = (
    "or, for code that you wrote or have read, give --sandbox none: it then runs unprotected, and the result says so"
)


class Mode(Enum):
    """How the agent becomes nobody."""

    USER_NAMESPACE = "user"
    """In a user namespace, in which the agent is nobody; what any user may do."""
    OTHER_USER = "root"
    """As another user of this machine with an id of its own, which counts its processes; what root may do."""


def command(
    submission: Identity, staging: Callable[[], Path], sizes: SandboxLimits, descriptors: tuple[int, int | None, int]
) -> tuple[list[str], list[str]]:
    """The program to start inside, and the arguments that bubblewrap reads from the file that ``--args`` is to name.

    ``staging`` makes a folder for copies, where some are needed. ``descriptors`` are those of the agent's socket, of the filter of system
    calls (``None`` where there is none) and of the file for facts about the sandbox.

    Raises
    ------
    SandboxError
        When there can be no sandbox on this machine.
    """
    mode = usable_mode()
    sock, call_filter, facts = descriptors
    arguments = [
        *_separation(mode),
        *(["--seccomp", str(call_filter)] if call_filter is not None else []),
        "--info-fd", str(facts),
        *_environment(),
        "--proc", "/proc", "--dev", "/dev",
        # First, so that an interpreter or a library that lies in /tmp shows up in it.
        *_scratch("/dev/shm", sizes.shared), *_scratch("/tmp", sizes.scratch),
        *visible.arguments(submission, staging),
        "--remount-ro", "/dev", "--remount-ro", "/proc", "--remount-ro", "/", "--chdir", "/tmp",
    ]  # fmt: skip
    guest = visible.in_package(Path(__file__).with_name("guest.py"))
    python = [str(visible.interpreter()), "-S", "-s", "-P", "-X", "faulthandler", str(guest), str(sock), __version__]
    return [*_becoming_another_user(mode), *python], arguments


def usable_mode() -> Mode:
    """How agents become nobody on this machine.

    Raises
    ------
    SandboxError
        When there can be no sandbox here; it says why and what to do.
    """
    reason, mode = _tried()
    if mode is None:
        raise SandboxError(reason)
    return mode


def program() -> list[str]:
    """Bubblewrap, started so that it and its sandbox are the first to go when the machine runs out of memory.

    Nothing inside can take that back: ``/proc`` is read-only there.
    """
    return ["/bin/sh", "-c", '{ echo 1000 >/proc/self/oom_score_adj; } 2>/dev/null; exec "$@"', "sh", _path()]


def _path() -> str:
    """Path of bubblewrap, which need not lie where its own environment would look for it."""
    return shutil.which("bwrap") or "bwrap"


def why_no_sandbox() -> str | None:
    """Why there can be no sandbox on this machine, and what to do; ``None`` where there can be one."""
    reason, mode = _tried()
    return reason if mode is None else None


@cache
def _tried() -> tuple[str, Mode | None]:
    """Reason and mode, tried out once in the life of this process."""
    if sys.platform != "linux":
        return (
            f"Code of others runs under bubblewrap, which exists on Linux only, and this is {platform.system()}. "
            f"Evaluate it there, {_REMEDY}."
        ), None
    if shutil.which("bwrap") is None:
        return (
            "Code of others runs under bubblewrap, and the program 'bwrap' is not installed. Install it (`apt-get install bubblewrap`, "
            f"`dnf install bubblewrap`, `pacman -S bubblewrap`), {_REMEDY}."
        ), None
    modes = [Mode.USER_NAMESPACE]
    if os.geteuid() == 0 and shutil.which("setpriv") is not None:
        modes.insert(0, Mode.OTHER_USER)
    said = ""
    for mode in modes:
        said = _complaint(mode)
        if not said:
            return "", mode
    return (
        f"Code of others runs under bubblewrap, and bubblewrap cannot build a sandbox here: {said} Many containers and some systems "
        f"(Ubuntu 24.04) forbid it until they are told otherwise; docs/threat-model.md has what to set. Do that, {_REMEDY}."
    ), None


def _complaint(mode: Mode) -> str:
    """What bubblewrap says against building an empty sandbox; nothing when it works."""
    bare = [
        _path(),
        *_separation(mode),
        "--ro-bind",
        "/",
        "/",
        *_scratch("/tmp", 4096),
        "--proc",
        "/proc",
        "--dev",
        "/dev",
        "--remount-ro",
        "/proc",
    ]
    try:
        done = subprocess.run(
            [*bare, *_becoming_another_user(mode), "true"],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False,
            timeout=_PATIENCE_SECONDS, env=ENVIRONMENT_OF_BUBBLEWRAP,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{error}."
    if done.returncode == 0:
        return ""
    return (
        " ".join(done.stderr.split())[-300:].rstrip(".") + "."
        if done.stderr.strip()
        else f"exit code {done.returncode}."
    )


def _separation(mode: Mode) -> list[str]:
    words = ["--unshare-ipc", "--unshare-pid", "--unshare-net", "--unshare-uts", "--unshare-cgroup-try"]
    words += ["--die-with-parent", "--new-session", "--hostname", "sandbox", "--cap-drop", "ALL"]
    if mode is Mode.OTHER_USER:
        return [*words, "--cap-add", "CAP_SETUID", "--cap-add", "CAP_SETGID"]
    return [*words, "--unshare-user", "--uid", str(_NOBODY), "--gid", str(_NOBODY)]


def _becoming_another_user(mode: Mode) -> list[str]:
    """The program that gives up being root; a user id for each process, so that limits of one do not count the processes of another."""
    if mode is Mode.USER_NAMESPACE:
        return []
    user = str(_FIRST_USER + os.getpid() % _USERS)
    return ["setpriv", "--reuid", user, "--regid", user, "--clear-groups", "--inh-caps=-all", "--"]


def _environment() -> list[str]:
    # Pydantic looks for plugins by reading the descriptions of all installed packages, which an agent would wait for.
    path = os.pathsep.join(map(str, [visible.CODE, *visible.libraries()]))
    variables = {
        "PATH": "/usr/bin:/bin", "HOME": "/tmp", "TMPDIR": "/tmp", "USER": "agent", "LOGNAME": "agent", "LANG": "C.UTF-8",
        "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1", "PYTHONHASHSEED": "0",
        "PYDANTIC_DISABLE_PLUGINS": "1",
        **dict.fromkeys(_THREAD_VARIABLES, "1"),
    }  # fmt: skip
    return ["--clearenv", *(word for name, value in variables.items() for word in ("--setenv", name, value))]


def _scratch(place: str, size: int) -> list[str]:
    return ["--perms", "1777", "--size", str(size), "--tmpfs", place]
