"""Control steps spread over processes: the rows of a batch in contiguous chunks, one a worker.

Processes, not threads: CasADi's integrators are not made for threads. Workers are started as plain interpreters (no
fork of the parent's threads, no import of the parent's ``__main__``) and talk through one socket each. They ignore Ctrl-C
and leave when the socket closes, so nothing outlives the parent, however it ended.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import weakref
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from glbench.errors import GlbenchError, ShapeError, StepError
from glbench.kernel.backends import choose
from glbench.kernel.kernel import Kernel
from glbench.kernel.link import Link
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure
from glbench.kernel.stepping import Stepper, positive_seconds

_GRACE_SECONDS = 2.0


class KernelPool(Stepper):
    """Steps the rows of a batch with several processes; same interface and same bits as ``Kernel``.

    After an error in the exchange (a worker died, Ctrl-C during a step) the pool is closed: replies still under way would
    be taken for those of the next step. Failures of single rows leave it intact.

    Parameters
    ----------
    workers : int
        Number of processes, at least 1.
    step_seconds, variant, backend, preset
        As for ``Kernel``.

    Raises
    ------
    GlbenchError
        When a worker cannot be started, with its reason; the errors of ``Kernel`` for wrong names and numbers.
    """

    def __init__(
        self,
        workers: int,
        step_seconds: float = 900.0,
        *,
        variant: str = "author",
        backend: str = "auto",
        preset: str = "reference",
    ) -> None:
        if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
            msg = f"A kernel pool needs a whole number of workers, at least 1, not {workers!r}."
            raise ShapeError(msg)
        self.step_seconds = positive_seconds(step_seconds)
        # Chosen (and built, if need be) once, so that all workers step alike.
        self.backend = choose(backend)
        settings: dict[str, Any] = {
            "step_seconds": self.step_seconds,
            "variant": variant,
            "backend": self.backend,
            "preset": preset,
        }
        self._settings = settings
        self._workers: list[_Worker] = []
        # Also runs when the pool is forgotten, and at the end of the interpreter.
        self._dismissal = weakref.finalize(self, _dismiss, self._workers)
        with self._closing_on_error():
            for number in range(workers):
                self._workers.append(_Worker(number, settings))
            descriptions: list[Description] = [worker.receive() for worker in self._workers]
        self._description = descriptions[0]

    def __reduce__(self) -> tuple[partial[KernelPool], tuple[int]]:
        """A copied or pickled pool starts as many workers of its own, with the same settings."""
        return partial(type(self), **self._settings), (self.workers,)

    @property
    def workers(self) -> int:
        """Number of processes; 0 after ``close``."""
        return len(self._workers)

    def advance(self, rows: Rows) -> tuple[FloatArray, list[StepFailure]]:
        """Step checked rows; see ``Stepper.advance``. StepError when the pool is closed or a worker died."""
        if not self._workers:
            msg = "This kernel pool is closed. Make a new one to go on."
            raise StepError(msg)
        out = np.empty_like(rows.x)
        failures: list[StepFailure] = []
        chunks = self._chunks(rows.x.shape[0])
        with self._closing_on_error():
            for worker, first, last in chunks:
                worker.send(rows.part(first, last))
            for worker, first, last in chunks:
                out[first:last], failed = worker.receive()
                failures += [StepFailure(first + failure.row, failure.reason) for failure in failed]
        return out, failures

    def describe(self) -> Description:
        """What made the numbers; does not depend on the number of workers."""
        return dict(self._description)

    def close(self) -> None:
        """Let the workers leave and wait for them; those that do not within seconds are ended."""
        self._dismissal()

    def _chunks(self, count: int) -> list[tuple[_Worker, int, int]]:
        """Contiguous, nearly equal parts of ``count`` rows; workers without rows are left out."""
        share = len(self._workers)
        bounds = [(count * k // share, count * (k + 1) // share) for k in range(share)]
        return [(worker, a, b) for worker, (a, b) in zip(self._workers, bounds, strict=True) if b > a]

    @contextlib.contextmanager
    def _closing_on_error(self) -> Iterator[None]:
        try:
            yield
        except BaseException:
            for worker in self._workers:
                worker.process.terminate()
            self.close()
            raise


class _Worker:
    """One process and the socket to it."""

    def __init__(self, number: int, settings: dict[str, Any]) -> None:
        self.number = number
        ours, theirs = socket.socketpair()
        self.link = Link(ours)
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; from glbench.kernel.worker import serve; serve({theirs.fileno()})"
        )
        try:
            # One thread for linear algebra: the processes are the parallelism, and idle threads make timing calls slow.
            self.process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                env={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", **os.environ},
            )
        except OSError as error:
            self.link.close()
            msg = f"Kernel worker {number} could not be started with {sys.executable}: {error}. Use workers=1."
            raise GlbenchError(msg) from error
        finally:
            theirs.close()
        self.send(settings)

    def send(self, message: object) -> None:
        try:
            self.link.send(message)
        except OSError as error:
            raise self._death() from error

    def receive(self) -> Any:
        """Wait for the answer; raise what the worker raised, or say how it died."""
        try:
            answer = self.link.receive()
        except (EOFError, OSError) as error:
            raise self._death() from error
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def _death(self) -> StepError:
        try:
            code = self.process.wait(_GRACE_SECONDS)
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit status {code}"
        except subprocess.TimeoutExpired:
            how = "closed its connection"
        msg = (
            f"Kernel worker {self.number} (process {self.process.pid}) {how}. "
            "Make a new pool; if it happens again, look for a lack of memory, or use workers=1."
        )
        return StepError(msg)


def _dismiss(workers: list[_Worker]) -> None:
    """Hang up on all workers, then wait for each."""
    for worker in workers:
        worker.link.close()
    for worker in workers:
        try:
            worker.process.wait(_GRACE_SECONDS)
        except subprocess.TimeoutExpired:
            worker.process.kill()
            worker.process.wait()
    workers.clear()


def make_kernel(
    step_seconds: float = 900.0,
    *,
    workers: int = 1,
    variant: str = "author",
    backend: str = "auto",
    preset: str = "reference",
) -> Kernel | KernelPool:
    """Kernel whose rows ``workers`` cores share: threads of the compiled backend, processes of the others.

    Same interface and same bits for every number of workers. Errors as for ``Kernel`` and ``KernelPool``.
    """
    chosen = choose(backend)
    if chosen == "compiled" or workers == 1:
        return Kernel(step_seconds, variant=variant, backend=chosen, preset=preset, threads=workers)
    return KernelPool(workers, step_seconds, variant=variant, backend=chosen, preset=preset)
