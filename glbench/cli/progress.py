"""Progress of long work on standard error: a bar, shown on a terminal only."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Self

from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

from glbench.cli.console import messages

_REFRESH_SECONDS = 0.1
_PATIENCE_SECONDS = 10.0
"""A longer wait is reported; without a bar, again after three times as long, and so on."""


def wait_words(what: str, seconds: float, limit: float) -> str:
    """``waiting for reset, 120 of 300 s``."""
    return f"waiting for {what}, {seconds:.0f}{f' of {limit:.0f}' if limit else ''} s"


class Wait:
    """Context manager that reports a wait, from its own thread, because the calling thread may be blocked.

    On a terminal, ``show`` gets the message every second; elsewhere a line is printed at growing intervals.
    """

    def __init__(self, show: Callable[[str], None] | None = None, what: str = "") -> None:
        self._show = show if messages().is_terminal else None
        self._thread = threading.Thread(target=self._look, daemon=True, name="waiting")
        self._end = threading.Event()
        self._for = (what, 0.0, time.monotonic())

    def begin(self, what: str, limit: float = 0.0) -> None:
        """Start to report a wait for ``what``, at most ``limit`` seconds; stop if it is empty."""
        self._for = (what, limit, time.monotonic())

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()

    def _look(self) -> None:
        current, due = self._for, _PATIENCE_SECONDS
        while not self._end.wait(1.0):
            what, limit, since = now = self._for
            if now is not current:
                current, due = now, _PATIENCE_SECONDS
            seconds = time.monotonic() - since
            if not what or seconds < (_PATIENCE_SECONDS if self._show else due):
                continue
            if self._show is None:
                messages().print(wait_words(what, seconds, limit), soft_wrap=True, markup=False)
                due = 3.0 * due
            else:
                self._show(wait_words(what, seconds, limit))


class Bar:
    """A bar with words before it (``description``) and after it (``columns``, which show ``fields``); to be entered."""

    def __init__(self, description: str, total: float, *columns: str, time_left: bool = False, **fields: Any) -> None:
        self.on_terminal = messages().is_terminal
        left = (TimeRemainingColumn(), TextColumn("left")) if time_left else ()
        words = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), *map(TextColumn, columns), *left)
        self._bar = Progress(SpinnerColumn(), *words, console=messages(), transient=True, disable=not self.on_terminal)
        self._task = self._bar.add_task(description, total=total, **fields)
        self._shown = 0.0
        self.wait = Wait(lambda words: self._bar.update(self._task, description=escape(words)))

    def __enter__(self) -> Self:
        self._bar.start()
        self.wait.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.wait.__exit__()
        self._bar.stop()

    def is_time(self) -> bool:
        """Whether to draw again: at most ten times a second."""
        now = time.monotonic()
        if now - self._shown < _REFRESH_SECONDS:
            return False
        self._shown = now
        return True

    def move(self, completed: float, **fields: Any) -> None:
        """Show how far the work is."""
        self._bar.update(self._task, completed=completed, **fields)

    def reset(self, completed: int, description: str) -> None:
        """Begin to measure the time that is left from here."""
        self._bar.reset(self._task, completed=completed, description=description)
