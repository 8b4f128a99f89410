"""The sandbox: the command line of bubblewrap, the system call filter, and why a machine cannot run it.

Which files are visible inside is decided in ``visible``.

Namespaces keep an agent away from files, network and other processes. The filter of system calls (seccomp) takes away what would weaken
them (new namespaces, mounts, handles of files), what escapes the limits of memory (memory that belongs to no process), ways to look into
other processes, kinds of sockets that no network namespace holds back, and parts of the kernel that no controller needs.
"""

from __future__ import annotations

import errno
import os
import platform
import shutil
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Final

from glbench import __version__
from glbench.agents import Identity
from glbench.errors import SandboxError
from glbench.evaluation.sandbox.frames import SandboxLimits
from glbench.evaluation.sandbox.visible import CODE, KERNELS, in_package, interpreter, libraries, visible_files

ENVIRONMENT_OF_BUBBLEWRAP = {"PATH": "/usr/bin:/bin"}  # bubblewrap itself gets no more: its process is visible inside

_NOBODY: Final = 65534
_FIRST_USER, _USERS = 61184, 4336  # User ids that nobody has: those that systemd sets aside for services
_PATIENCE_SECONDS = 20.0
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
_REMEDY = "or, for code that you wrote or have read, give --sandbox none: it then runs unprotected, and the result says so"
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW: Final = 0x7FFF0000
_KILL: Final = 0x80000000
_ERROR: Final = 0x00050000
_NUMBER, _ARCHITECTURE, _FIRST_ARGUMENT, _SECOND_ARGUMENT, _THIRD_ARGUMENT = 0, 4, 16, 24, 32
_NEW_NAMESPACES: Final = 0x7E020000  # Flags of ``clone`` that ask for a namespace of any kind
_OTHER_ABI: Final = 0x40000000  # System calls of x86-64 from here on are those of x32, with numbers of their own
_FAMILIES: Final = (socket.AF_UNIX,)
"""Sockets of other families reach past a network namespace (AF_VSOCK), deep into the kernel (AF_ALG, AF_PACKET), or hold memory that
all networks of the machine share (AF_INET, AF_INET6, of which there is none inside but the sandbox's own)."""
_LARGER_BUFFERS: Final = (7, 32)
"""Options of sockets (SO_SNDBUF, SO_SNDBUFFORCE) with which each could hold megabytes of the kernel's memory."""
_REFUSED: Final = {
    # name: (x86-64, AArch64)
    "ptrace": (101, 117), "process_vm_readv": (310, 270), "process_vm_writev": (311, 271), "kcmp": (312, 272),
    "pidfd_getfd": (438, 438), "perf_event_open": (298, 241), "bpf": (321, 280), "userfaultfd": (323, 282),
    "memfd_create": (319, 279), "memfd_secret": (447, 447), "shmget": (29, 194), "msgget": (68, 186), "semget": (64, 190),
    "io_setup": (206, 0), "fanotify_init": (300, 262),
    "io_uring_setup": (425, 425), "io_uring_enter": (426, 426), "io_uring_register": (427, 427),
    "add_key": (248, 217), "request_key": (249, 218), "keyctl": (250, 219),
    "unshare": (272, 97), "setns": (308, 268), "mount": (165, 40), "umount2": (166, 39), "pivot_root": (155, 41),
    "chroot": (161, 51), "open_tree": (428, 428), "move_mount": (429, 429), "fsopen": (430, 430), "fsconfig": (431, 431),
    "fsmount": (432, 432), "fspick": (433, 433), "mount_setattr": (442, 442),
    "name_to_handle_at": (303, 264), "open_by_handle_at": (304, 265), "quotactl": (179, 60), "acct": (163, 89),
    "init_module": (175, 105), "finit_module": (313, 273), "delete_module": (176, 106), "kexec_load": (246, 104),
    "kexec_file_load": (320, 294), "reboot": (169, 142), "swapon": (167, 224), "swapoff": (168, 225), "syslog": (103, 116),
    "settimeofday": (164, 170), "clock_settime": (227, 112), "clock_adjtime": (305, 266), "adjtimex": (159, 171),
    "sethostname": (170, 161), "setdomainname": (171, 162), "personality": (135, 92), "vhangup": (153, 58),
}  # fmt: skip
_CLONE, _CLONE3, _SOCKET, _LIMITS, _OPTION = (56, 220), (435, 435), (41, 198), (302, 261), (54, 208)


class Mode(Enum):
    """How the privileges of the agent are dropped to an unused uid."""

    USER_NAMESPACE = "user"
    """In a user namespace, in which the agent is nobody; what any user may do."""
    OTHER_USER = "root"
    """As another user of this machine with an id of its own, which counts its processes; what root may do."""


def command(
    submission: Identity,
    staging: Callable[[], Path],
    sizes: SandboxLimits,
    descriptors: tuple[int, int | None, int],
    kernels: Mapping[str, Path] | None = None,
) -> tuple[list[str], list[str]]:
    """The program to start inside, and the arguments that bubblewrap reads from the file that ``--args`` is to name.

    ``staging`` makes a folder for copies, where some are needed. ``descriptors`` are those of the agent's socket, of the filter of system
    calls (``None`` without one) and of the file for facts about the sandbox. ``kernels`` are compiled kernels by their names inside. Raises
    ``SandboxError`` when there can be no sandbox on this machine.
    """
    mode = usable_mode()
    sock, call_filter, facts = descriptors
    arguments = [
        *_separation(mode),
        *(["--seccomp", str(call_filter)] if call_filter is not None else []),
        "--info-fd", str(facts),
        *_environment(),
        "--proc", "/proc", "--dev", "/dev",
        # First, so that an interpreter or a library that is in /tmp shows up in it.
        *_scratch("/dev/shm", sizes.shared), *_scratch("/tmp", sizes.scratch),
        *visible_files(submission, staging, kernels),
        "--remount-ro", "/dev", "--remount-ro", "/proc", "--remount-ro", "/", "--chdir", "/tmp",
    ]  # fmt: skip
    worker = in_package(Path(__file__).with_name("worker.py"))
    python = [str(interpreter()), "-S", "-s", "-P", "-X", "faulthandler", str(worker), str(sock), __version__]
    return [*_becoming_another_user(mode), *python], arguments


def usable_mode() -> Mode:
    """How agents become nobody on this machine. Raises ``SandboxError`` when there can be no sandbox here; it says why and what to do."""
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
    complaint = ""
    for mode in modes:
        complaint = _complaint(mode)
        if not complaint:
            return "", mode
    return (
        f"Code of others runs under bubblewrap, and bubblewrap cannot build a sandbox here: {complaint} Many containers and some systems "
        f"(Ubuntu 24.04) forbid it until they are told otherwise; docs/threat-model.md has what to set. Do that, {_REMEDY}."
    ), None


def _complaint(mode: Mode) -> str:
    """What bubblewrap says against building an empty sandbox; nothing when it works."""
    mounts = ["--ro-bind", "/", "/", *_scratch("/tmp", 4096), "--proc", "/proc", "--dev", "/dev", "--remount-ro", "/proc"]
    try:
        process = subprocess.run(
            [_path(), *_separation(mode), *mounts, *_becoming_another_user(mode), "true"],
            stdin=subprocess.DEVNULL, capture_output=True, text=True, errors="replace", check=False,
            timeout=_PATIENCE_SECONDS, env=ENVIRONMENT_OF_BUBBLEWRAP,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{error}."
    if process.returncode == 0:
        return ""
    return " ".join(process.stderr.split())[-300:].rstrip(".") + "." if process.stderr.strip() else f"exit code {process.returncode}."


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
    path = os.pathsep.join(map(str, [CODE, *libraries()]))
    variables = {
        "PATH": "/usr/bin:/bin", "HOME": "/tmp", "TMPDIR": "/tmp", "USER": "agent", "LOGNAME": "agent", "LANG": "C.UTF-8",
        "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONUNBUFFERED": "1", "PYTHONHASHSEED": "0",
        "PYDANTIC_DISABLE_PLUGINS": "1", "GLBENCH_KERNELS": str(KERNELS),
        **dict.fromkeys(THREAD_VARIABLES, "1"),
    }  # fmt: skip
    return ["--clearenv", *(word for name, value in variables.items() for word in ("--setenv", name, value))]


def _scratch(place: str, size: int) -> list[str]:
    return ["--perms", "1777", "--size", str(size), "--tmpfs", place]


_MACHINES = {"x86_64": (0, 0xC000003E), "aarch64": (1, 0xC00000B7)}  # column of ``_REFUSED``, and the name in audits


def system_call_filter() -> bytes | None:
    """The filter as a program of the kernel's BPF machine; ``None`` for processors whose numbers are not known here."""
    machine = _MACHINES.get(platform.machine())
    if machine is None:
        return None
    column, audit = machine
    program = [
        _load(_ARCHITECTURE), _unless(_EQUAL, audit, _KILL),
        _load(_NUMBER), _if(_AT_LEAST, _OTHER_ABI, _KILL),
    ]  # fmt: skip
    program += [_if(_EQUAL, numbers[column], _ERROR | errno.EPERM) for numbers in _REFUSED.values()]
    # The C library asks for clone3 first, whose flags no filter can read, and takes clone when there is none.
    program.append(_if(_EQUAL, _CLONE3[column], _ERROR | errno.ENOSYS))
    clone = _load(_FIRST_ARGUMENT) + _if(_ANY_BIT, _NEW_NAMESPACES, _ERROR | errno.EPERM) + _return(_ALLOW)
    program.append(_block(_CLONE[column], clone))
    families = b"".join(_if(_EQUAL, family, _ALLOW) for family in _FAMILIES)
    program.append(_block(_SOCKET[column], _load(_FIRST_ARGUMENT) + families + _return(_ERROR | errno.EAFNOSUPPORT)))
    # Limits of other processes: bubblewrap's own may belong to the same user. Process 0 is whoever asks.
    own = _if(_EQUAL, 0, _ALLOW) + _return(_ERROR | errno.EPERM)
    program.append(_block(_LIMITS[column], _load(_FIRST_ARGUMENT) + own))
    larger = b"".join(_if(_EQUAL, option, _ERROR | errno.EPERM) for option in _LARGER_BUFFERS) + _return(_ALLOW)
    buffers = _load(_SECOND_ARGUMENT) + _unless(_EQUAL, socket.SOL_SOCKET, _ALLOW) + _load(_THIRD_ARGUMENT) + larger
    program.append(_block(_OPTION[column], buffers))
    return b"".join(program) + _return(_ALLOW)


def _instruction(code: int, value: int, yes: int = 0, no: int = 0) -> bytes:
    return struct.pack("=HBBI", code, yes, no, value)


def _load(offset: int) -> bytes:
    return _instruction(_LOAD, offset)


def _return(value: int) -> bytes:
    return _instruction(_RETURN, value)


def _if(test: int, value: int, then: int) -> bytes:
    return _instruction(test, value, yes=0, no=1) + _return(then)


def _unless(test: int, value: int, then: int) -> bytes:
    return _instruction(test, value, yes=1, no=0) + _return(then)


def _block(number: int, instructions: bytes) -> bytes:
    """Do ``instructions`` for one system call, and skip them for the others."""
    return _instruction(_EQUAL, number, yes=0, no=len(instructions) // 8) + instructions
