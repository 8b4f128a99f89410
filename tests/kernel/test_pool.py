"""The pool ends well, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from glbench.errors import StepError, UnknownNameError
from glbench.kernel import Kernel, KernelPool, available, make_kernel
from glbench.model import TOMATO
from tests.kernel.known_steps import Array, KnownSteps

# No ``if __name__ == "__main__"``: workers do not import the program that made them.
PROGRAM = """
import numpy as np
from glbench.kernel import KernelPool
from glbench.model import default_parameters, initial_state

d = np.array([0.0, 10.0, 1000.0, 750.0, 2.0, 2.0, 12.0, 0.0, 0.0, 0.0])
p = default_parameters()
x = np.tile(initial_state(d, 16.5, p), (8, 1))
pool = KernelPool(2, 900.0, backend="casadi")
print(*[worker.process.pid for worker in pool._workers], flush=True)
while True:
    x = pool.step(x, np.zeros(6), d, p)
"""


def _is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] != "Z"
    except FileNotFoundError:
        return False


def _all_gone_within(seconds: float, pids: list[int]) -> bool:
    end = time.monotonic() + seconds
    while any(_is_running(pid) for pid in pids) and time.monotonic() < end:
        time.sleep(0.02)
    return not any(_is_running(pid) for pid in pids)


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks for processes in /proc")


@needs_proc
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_workers_leave_with_the_program(number: signal.Signals) -> None:
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert program.stdout is not None
    pids = [int(word) for word in program.stdout.readline().split()]
    assert len(pids) == 2
    time.sleep(0.2)
    if number == signal.SIGINT:
        os.killpg(program.pid, number)  # as the terminal does: to the program and its workers
    else:
        program.kill()
    _, complaints = program.communicate(timeout=300)
    assert program.returncode == -number
    assert _all_gone_within(60.0, pids)
    # The program's own traceback and nothing of the workers.
    assert complaints.count("Traceback") == (1 if number == signal.SIGINT else 0)


def test_a_killed_worker_is_reported_and_the_pool_closes(steps_900: KnownSteps, p: Array) -> None:
    x, u, d = steps_900.x, steps_900.u, steps_900.d
    pool = KernelPool(2, 900.0, backend="casadi")
    pool.step(x, u, d, p)
    os.kill(pool._workers[1].process.pid, signal.SIGKILL)

    def step_on() -> None:
        for _ in range(2):  # the signal may arrive after a last answer
            pool.step(x, u, d, p)

    with pytest.raises(StepError, match=r"worker 1 \(process \d+\) was ended by SIGKILL.*Make a new pool"):
        step_on()
    assert pool.workers == 0
    with pytest.raises(StepError, match="closed"):
        pool.step(x, u, d, p)
    pool.close()  # closing twice is fine


def test_an_error_in_the_program_closes_the_pool() -> None:
    pool = KernelPool(1, 900.0, backend="casadi")
    process = pool._workers[0].process

    def use() -> None:
        with pool:
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        use()
    assert pool.workers == 0
    assert process.returncode == 0


def test_a_forgotten_pool_ends_its_workers() -> None:
    pool = KernelPool(1, 900.0, backend="casadi")
    process = pool._workers[0].process
    del pool
    assert process.returncode == 0


def test_a_worker_that_cannot_start_says_why() -> None:
    with pytest.raises(UnknownNameError, match=r"no backend 'casady'\. Did you mean 'casadi'"):
        KernelPool(2, 900.0, backend="casady")


def test_cores_are_threads_of_the_compiled_backend_and_processes_of_the_others() -> None:
    with make_kernel(TOMATO, 900.0, workers=2, backend="casadi") as kernel:
        assert isinstance(kernel, KernelPool)
    if "compiled" in available():
        with make_kernel(TOMATO, 900.0, workers=2, backend="compiled") as kernel:
            assert isinstance(kernel, Kernel)
    with make_kernel(TOMATO, 900.0, backend="casadi") as kernel:
        assert isinstance(kernel, Kernel)
