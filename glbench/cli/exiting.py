"""How a command ends: by Ctrl-C, a signal, or with threads that an agent left behind."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import NoReturn

from glbench.cli.console import messages

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it: 128 and the signal's number."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PATIENCE_SECONDS = 2.0


_told: list[str] = []
"""What was said about interruptions, so that nothing is said twice, and none ends without a word."""


def tell_interrupted(what_follows: str = "") -> None:
    """Say that work was interrupted, and what that means for it."""
    _told.append(what_follows)
    messages().print(f"\n[bold yellow]Interrupted.[/bold yellow] {what_follows}".rstrip(), soft_wrap=True)


class Interruption:
    """While it is entered, the signals TERM and HUP interrupt as Ctrl-C does; ``exit_code`` tells which one it was."""

    def __init__(self) -> None:
        self._number = int(signal.SIGINT)
        self._told_before = len(_told)

    def tell(self) -> None:
        """Say that it was interrupted, unless the command has said so."""
        if len(_told) == self._told_before:
            tell_interrupted()

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal."""
        return 128 + self._number

    def interrupt(self, number: int, _frame: FrameType | None) -> NoReturn:
        """Handle a signal."""
        self._number = number
        raise KeyboardInterrupt


@contextlib.contextmanager
def interruptible() -> Iterator[Interruption]:
    """Signals interrupt, and what they did before comes back afterwards."""
    interruption = Interruption()
    with _handled_by(interruption.interrupt):
        yield interruption


@contextlib.contextmanager
def leaving_at_once() -> Iterator[None]:
    """Signals end the process at once: for imports, where an exception would come out of somebody's half-loaded module."""

    def leave_now(number: int, _frame: FrameType | None) -> NoReturn:
        os.write(2, b"\nInterrupted.\n")
        os._exit(128 + number)

    with _handled_by(leave_now):
        yield


@contextlib.contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], NoReturn]) -> Iterator[None]:
    if threading.current_thread() is not threading.main_thread():  # no other may ask for signals
        yield
        return
    # Ignored signals stay ignored (nohup), and handlers that were not set from Python cannot be put back.
    kept = {number: signal.getsignal(number) for number in _SIGNALS}
    kept = {number: before for number, before in kept.items() if before not in {signal.SIG_IGN, None}}
    for number in kept:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, before in kept.items():
            signal.signal(number, before)


def leave(code: int) -> NoReturn:
    """End the process with ``code``, also when somebody's threads are still at work: Python would wait for them forever."""
    deadline = time.monotonic() + _PATIENCE_SECONDS
    left = [thread for thread in threading.enumerate() if _keeps_python_alive(thread)]
    for thread in left:
        thread.join(max(0.0, deadline - time.monotonic()))
    left = [thread for thread in left if thread.is_alive()]
    if left:
        names = ", ".join(thread.name for thread in left)
        messages().print(f"An agent left threads at work ({names}); they are ended with this command.", markup=False)
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _keeps_python_alive(thread: threading.Thread) -> bool:
    """Whether Python would wait for ``thread``. Idle executors are not meant: Python itself ends those."""
    return (
        thread is not threading.main_thread() and not thread.daemon and not thread.name.startswith("ThreadPoolExecutor")
    )
