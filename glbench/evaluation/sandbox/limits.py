"""How much of the machine a sandboxed agent may take. Time is the task's matter; see ``glbench.evaluation.limits``."""

from __future__ import annotations

from dataclasses import dataclass

MIB = 2**20
GIB = 2**30


@dataclass(frozen=True)
class SandboxLimits:
    """Sizes in bytes. The same on every machine, so that an agent that runs on one runs on the other."""

    memory: int = 4 * GIB
    """Address space of one process, and resident memory of all its processes together."""
    scratch: int = 256 * MIB
    """Size of its /tmp, and of the largest file in it."""
    shared: int = 64 * MIB
    """Size of its /dev/shm."""
    tasks: int = 128
    """Processes and threads together."""
    files: int = 256
    """Open files of one process."""
    open_files: int = 1024
    """Open files, pipes and sockets of all processes together: each may hold memory of the kernel."""
    made: int = 65536
    """Files and folders in /tmp and /dev/shm."""
    printed: int = 64 * 1024
    """What is kept of its output: the first half and the last."""
