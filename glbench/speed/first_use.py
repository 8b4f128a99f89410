"""What happens once, and what it takes: the first use on an empty cache, and memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

from glbench.errors import GlbenchError
from glbench.speed.record import FirstUse, Memory

MANY = 4096
_TIMEOUT_SECONDS = 600.0

_FIRST_USE = """
import resource
from glbench.kernel import Kernel
from glbench.model import TOMATO
kernel = Kernel(TOMATO, 900.0)
peak = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
print(peak / 1024)
"""

# On Linux ru_maxrss also counts the memory that the parent held when it started this process; VmHWM is the process's own.
_PEAK = """
def peak():
    import pathlib, resource
    status = pathlib.Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    own = [float(line.split()[1]) for line in lines if line.startswith("VmHWM:")]
    return (own or [resource.getrusage(resource.RUSAGE_SELF).ru_maxrss])[0] / 1024
"""

_MEMORY = f"""
import sys
{_PEAK}
import numpy as np
from glbench.env import GreenhouseVectorEnv
envs = GreenhouseVectorEnv("glbench/Schiphol2010-Delta10-v1", int(sys.argv[1]))
envs.reset(seed=0)
for _ in range(4):
    envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
print(peak())
"""


def measure_first_use() -> FirstUse:
    """Start a process with an empty cache and make a kernel: everything is generated and compiled anew."""
    with tempfile.TemporaryDirectory(prefix="glbench-bench-") as cache:
        started = time.perf_counter()
        megabytes = _run(_FIRST_USE, GLBENCH_CACHE=cache)
        return FirstUse(seconds=time.perf_counter() - started, megabytes=megabytes)


def measure_memory() -> Memory:
    """Peak memory of a process that steps many environments, and of one that steps a single one."""
    return Memory(environments=MANY, megabytes=_run(_MEMORY, str(MANY)), megabytes_of_one=_run(_MEMORY, "1"))


def _run(code: str, *arguments: str, **environment: str) -> float:
    """The number that ``code`` prints in a process of its own.

    Raises
    ------
    GlbenchError
        When it fails or takes too long.
    """
    command = [sys.executable, "-c", code, *arguments]
    try:
        done = subprocess.run(
            command,
            env={**os.environ, **environment},
            capture_output=True,
            text=True,
            check=True,
            timeout=_TIMEOUT_SECONDS,
        )
    except subprocess.CalledProcessError as error:
        said = error.stderr.strip().splitlines()[-1:] or ["nothing"]
        msg = f"A process that was to be measured failed; it said: {said[0]}"
        raise GlbenchError(msg) from error
    except subprocess.TimeoutExpired as error:
        msg = f"A process that was to be measured took longer than {_TIMEOUT_SECONDS:g} s."
        raise GlbenchError(msg) from error
    return float(done.stdout)
