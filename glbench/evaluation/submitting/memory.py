"""How much memory the probing process takes, and whether that grows from step to step."""

from __future__ import annotations

import os
import resource
import sys
from pathlib import Path

from glbench.evaluation.sandbox.limits import SandboxLimits

MEMORY_LIMIT = SandboxLimits().memory
"""What an agent may take, in bytes."""

_STATM = Path("/proc/self/statm")


class Memory:
    """Looks at this process's memory after every step; where the system does not tell, growth is 0."""

    def __init__(self) -> None:
        self._seen: list[int] = []

    def look(self) -> None:
        """Remember what is taken now."""
        self._seen.append(resident())

    @property
    def last(self) -> int:
        """Bytes at the last look."""
        return self._seen[-1] if self._seen else 0

    @property
    def peak(self) -> int:
        """Most bytes ever."""
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return most if sys.platform == "darwin" else most * 1024

    def growth_a_step(self) -> float:
        """Bytes a step over the second half of what was seen; the first half warms up."""
        half = self._seen[len(self._seen) // 2 :]
        return max(0.0, (half[-1] - half[0]) / (len(half) - 1)) if len(half) > 1 else 0.0

    @staticmethod
    def own() -> int:
        """Address space that was taken before the agent came [bytes]."""
        return _pages(0)


def resident() -> int:
    """Resident memory of this process [bytes]; 0 where the system does not tell."""
    return _pages(1)


def _pages(column: int) -> int:
    if not _STATM.is_file():
        return 0
    return int(_STATM.read_text(encoding="ascii").split()[column]) * os.sysconf("SC_PAGE_SIZE")
