"""How large the processes of a sandbox have grown.

The kernel limits each process by itself (``guest.limit_this_process``); what many of them take together is found out by looking.
"""

from __future__ import annotations

import time
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
        return self._taken()[1]

    def _look(self) -> str | None:
        tasks, memory = self._taken()
        if tasks > self._sizes.tasks + _SOME_MORE:
            return f"the agent started more than {self._sizes.tasks} processes and threads, which is its limit"
        if memory > self._sizes.memory:
            return f"the agent's processes took more than {self._sizes.memory / GIB:.3g} GiB of memory together, which is their limit"
        return None

    def _taken(self) -> tuple[int, int]:
        """Processes and threads, and the memory of all [bytes]; not counted on where there are too many already."""
        waiting, tasks, memory = [self._root], 0, 0
        while waiting and tasks <= self._sizes.tasks + _SOME_MORE:
            place = Path("/proc") / str(waiting.pop())
            try:
                threads = list((place / "task").iterdir())
                memory += _memory(place)
                waiting += [int(child) for thread in threads for child in _children(thread)]
            except OSError:  # it ended while we looked
                continue
            tasks += len(threads)
        return tasks, memory


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
