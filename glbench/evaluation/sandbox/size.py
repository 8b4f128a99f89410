"""How large the processes of a sandbox have grown.

The kernel limits each process by itself (``guest.limit_this_process``); what many of them take together is found out by looking. So is
what stands in nobody's account: the kernel's own memory behind sockets and empty files.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from glbench.evaluation.sandbox.limits import GIB, SandboxLimits

_LOOK_SECONDS = 0.2
_SOME_MORE = 8
"""Tasks that do not belong to the agent: bubblewrap's own, and those that are just coming or going."""
_KIB = 1024


class Watch:
    """Looks at the processes below ``root``, a process id, not more often than is useful."""

    def __init__(self, root: int, sizes: SandboxLimits) -> None:
        self._root = root
        self._sizes = sizes
        self._next = 0.0

    def complaint(self) -> str | None:
        """What has grown too large, in words; ``None`` while nothing has, and between two looks."""
        now = time.monotonic()
        if now < self._next:
            return None
        self._next = now + _LOOK_SECONDS
        return self._look()

    def memory(self) -> int:
        """Memory of all processes now [bytes]."""
        return self._taken().memory

    def _look(self) -> str | None:
        taken, sizes = self._taken(), self._sizes
        if taken.tasks > sizes.tasks + _SOME_MORE:
            return f"the agent started more than {sizes.tasks} processes and threads, which is its limit"
        if taken.memory > sizes.memory:
            return f"the agent's processes took more than {sizes.memory / GIB:.3g} GiB of memory together, which is their limit"
        if taken.open_files > sizes.open_files:
            return f"the agent's processes opened more than {sizes.open_files:,} files, pipes and sockets together, which is their limit"
        if sum(map(self._made, ("tmp", "dev/shm"))) > sizes.made:
            return f"the agent made more than {sizes.made:,} files in /tmp and /dev/shm, which is its limit"
        return None

    def _taken(self) -> _Taken:
        """What all processes take; not counted on where there are too many already."""
        waiting, taken = [self._root], _Taken()
        while waiting and taken.tasks <= self._sizes.tasks + _SOME_MORE:
            place = Path("/proc") / str(waiting.pop())
            threads: list[Path] = []
            try:
                threads = list((place / "task").iterdir())
                taken.memory += _memory(place)
                waiting += [int(child) for thread in threads for child in _children(thread)]
                taken.open_files += sum(1 for _ in (place / "fd").iterdir())
            except OSError:  # it ended while we looked
                continue
            finally:
                taken.tasks += len(threads)
        return taken

    def _made(self, place: str) -> int:
        """Files in a folder of the sandbox that lies in memory: each takes some of it, which no size limits."""
        try:
            told = os.statvfs(f"/proc/{self._root}/root/{place}")
        except OSError:  # it has ended
            return 0
        return told.f_files - told.f_ffree


@dataclass
class _Taken:
    """What the processes of a sandbox take together; ``memory`` in bytes."""

    tasks: int = 0
    memory: int = 0
    open_files: int = 0


def _memory(place: Path) -> int:
    """Memory of a process that is not the content of files [bytes]."""
    numbers = [
        int(line.split()[1]) * _KIB
        for line in (place / "status").read_text(encoding="utf-8", errors="replace").splitlines()
        if line.startswith(("RssAnon:", "RssShmem:"))
    ]
    return sum(numbers)


def _children(thread: Path) -> list[str]:
    """Ids of the processes that a thread started; none where the kernel keeps no such list."""
    try:
        return (thread / "children").read_text(encoding="ascii").split()
    except FileNotFoundError:
        return []
