"""Processes that end when the process that started them ends, however it ends: ``kill -9`` leaves nothing behind.

Only the parent holds the writing end of a pipe, so the kernel closes it when the parent ends. The kernel then sends SIGIO to the child
(signal-driven input, ``O_ASYNC``), which ends it even while it computes in compiled code. Unlike ``PR_SET_PDEATHSIG``, this does not
depend on the thread that started the child.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import subprocess
import threading
from collections.abc import Callable, Sequence
from multiprocessing import connection, parent_process
from multiprocessing.context import SpawnProcess
from typing import Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def end_with_parent() -> None:
    """End this process when its parent ends. Call it first in a process of ``multiprocessing``; in others it does nothing."""
    parent = parent_process()
    if parent is None:
        return
    _signal_on_end(parent.sentinel, os.getpid())
    # For systems that send no signal, and a parent that has already ended: a thread watches the pipe. It needs the GIL to be free.
    threading.Thread(target=_end_after, args=(parent.sentinel,), daemon=True, name="end with parent").start()


def worker(target: Callable[..., object], *arguments: Any, connections: Sequence[Any] = ()) -> SpawnProcess:
    """A process, not yet started, that calls ``target(*connections, *arguments)`` and ends with its parent.

    Slow imports, such as PyTorch, happen after the process is tied to its parent: all arguments except ``connections`` are unpickled then.
    """
    return multiprocessing.get_context("spawn").Process(target=_call, args=(pickle.dumps((target, arguments)), *connections))


def _call(call: bytes, *connections: Any) -> None:
    end_with_parent()
    target, arguments = pickle.loads(call)
    target(*connections, *arguments)


class Child(subprocess.Popen[Any]):
    """A program in its own session, which ends with all that it started when this process ends or releases it. Arguments: see ``Popen``."""

    def __init__(self, command: Sequence[str], *, pass_fds: Sequence[int] = (), **options: Any) -> None:
        reading, self._until_we_end = os.pipe()
        try:
            super().__init__(command, pass_fds=(reading, *pass_fds), start_new_session=True, **options)
            _signal_on_end(reading, -self.pid)
        finally:
            os.close(reading)

    def __del__(self, *arguments: Any) -> None:
        """Close the pipe."""
        os.close(self._until_we_end)
        super().__del__(*arguments)

    def kill(self) -> None:
        """End the program and what it started in its session."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)


def run(command: Sequence[str], *, timeout: float, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run ``command`` to its end and return its output; it is ended if this process ends.

    Raises ``OSError`` when it cannot be started, and ``subprocess.TimeoutExpired`` after ``timeout`` seconds, when it has been ended.
    """
    with Child(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace", **options
    ) as child:
        try:
            out, err = child.communicate(timeout=timeout)
        except BaseException:
            child.kill()
            raise
    return subprocess.CompletedProcess(command, child.returncode, out, err)


def _signal_on_end(reading: int, whom: int) -> None:
    """Let the kernel send SIGIO to a process (to a group, by its negative id) when the writing end of the pipe ``reading`` is closed."""
    if fcntl is not None and hasattr(os, "O_ASYNC"):
        fcntl.fcntl(reading, fcntl.F_SETOWN, whom)
        fcntl.fcntl(reading, fcntl.F_SETFL, fcntl.fcntl(reading, fcntl.F_GETFL) | os.O_ASYNC)


def _end_after(sentinel: int) -> None:
    connection.wait([sentinel])
    os._exit(1)
