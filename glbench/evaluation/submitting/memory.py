"""How much memory an agent takes, and whether that grows from step to step."""

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
    """What was taken after every step [bytes]; where the system does not tell, growth is 0."""

    def __init__(self) -> None:
        self._seen: list[int] = []
        self.peak = 0

    def add(self, now: int, most: int) -> None:
        """Remember what is taken now, and the most that ever was."""
        self._seen.append(now)
        self.peak = most

    @property
    def last(self) -> int:
        """Bytes at the last look."""
        return self._seen[-1] if self._seen else 0

    def growth_a_step(self) -> float:
        """Bytes a step over the second half of what was seen; the first half warms up."""
        half = self._seen[len(self._seen) // 2 :]
        return max(0.0, (half[-1] - half[0]) / (len(half) - 1)) if len(half) > 1 else 0.0


def address_space() -> int:
    """Address space of this process [bytes]; 0 where the system does not tell."""
    return _pages(0)


def peak() -> int:
    """Most resident memory that this process ever had [bytes]."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def resident() -> int:
    """Resident memory of this process [bytes]; 0 where the system does not tell."""
    return _pages(1)


def _pages(column: int) -> int:
    if not _STATM.is_file():
        return 0
    return int(_STATM.read_text(encoding="ascii").split()[column]) * os.sysconf("SC_PAGE_SIZE")
