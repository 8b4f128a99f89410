"""Progress of long work on standard error: a bar, shown on a terminal only."""

from __future__ import annotations

import time
from typing import Any, Self

from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

from glbench.cli.console import messages

_REFRESH_SECONDS = 0.1


class Bar:
    """A bar with words before it (``description``) and after it (``columns``, which show ``fields``); to be entered."""

    def __init__(self, description: str, total: float, *columns: str, time_left: bool = False, **fields: Any) -> None:
        self.on_terminal = messages().is_terminal
        left = (TimeRemainingColumn(), TextColumn("left")) if time_left else ()
        words = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), *map(TextColumn, columns), *left)
        self._bar = Progress(SpinnerColumn(), *words, console=messages(), transient=True, disable=not self.on_terminal)
        self._task = self._bar.add_task(description, total=total, **fields)
        self._shown = 0.0

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
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
