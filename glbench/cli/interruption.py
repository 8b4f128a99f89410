"""TERM and HUP end long work as Ctrl-C does: with words about what is kept."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def stopping_on_signals() -> Iterator[None]:
    """Raise ``KeyboardInterrupt`` with the exit code (128 + number) when the process is told to end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    names = [name for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {name: signal.signal(getattr(signal, name), _stop) for name in names}
    try:
        yield
    finally:
        for name, handler in before.items():
            signal.signal(getattr(signal, name), handler)


def _stop(number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt(128 + number)


def exit_code(interruption: KeyboardInterrupt) -> int:
    """130 after Ctrl-C, else 128 and the number of the signal."""
    return int(interruption.args[0]) if interruption.args else 130
