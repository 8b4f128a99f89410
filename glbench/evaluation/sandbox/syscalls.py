"""System calls that an agent may not make: a filter for the kernel (seccomp), as bubblewrap takes it.

Namespaces keep an agent away from files, network and other processes. The filter takes away what would weaken them (new namespaces,
mounts, handles of files), what escapes the limits of memory (memory that belongs to no process), ways to look into other processes,
kinds of sockets that no network namespace holds back, and parts of the kernel that no controller needs.
"""

from __future__ import annotations

import errno
import platform
import socket
import struct
from dataclasses import dataclass
from typing import Final

_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW: Final = 0x7FFF0000
_KILL: Final = 0x80000000
_ERROR: Final = 0x00050000
_NUMBER, _ARCHITECTURE, _FIRST_ARGUMENT, _SECOND_ARGUMENT, _THIRD_ARGUMENT = 0, 4, 16, 24, 32
_NEW_NAMESPACES: Final = 0x7E020000
"""Flags of ``clone`` that ask for a namespace of any kind."""
_OTHER_ABI: Final = 0x40000000
"""System calls of x86-64 from here on are those of x32, with numbers of their own."""
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


@dataclass(frozen=True)
class _Machine:
    column: int
    audit: int


_MACHINES = {"x86_64": _Machine(0, 0xC000003E), "aarch64": _Machine(1, 0xC00000B7)}


def system_call_filter() -> bytes | None:
    """The filter as a program of the kernel's BPF machine; ``None`` for processors whose numbers are not known here."""
    machine = _MACHINES.get(platform.machine())
    if machine is None:
        return None
    column = machine.column
    program = [
        _load(_ARCHITECTURE), _unless(_EQUAL, machine.audit, _KILL),
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
