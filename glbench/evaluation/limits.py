"""Time limits for an agent, and the alarm that enforces them inside this process.

Python code that loops for ever is stopped by the alarm signal. Code that hangs inside a compiled library is not: the signal is handled
when the library returns, and the call is then counted as timed out.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from glbench.tasks.tables import TimeLimitsTable

_AGAIN_SECONDS = 1.0
"""Interval at which the alarm repeats, for an agent that swallows the first one in a bare ``except``."""


@dataclass(frozen=True)
class TimeLimits:
    """Seconds that an agent may take.

    The limits of a run are those of one run; a call that decides for n runs may take n times as long, so that neither the number of runs
    nor the fact that they run together changes what an agent may do.
    """

    start: float = 300.0
    """For ``make_agent`` and ``reset`` together, all runs (loading of networks, building of solvers)."""
    step: float = 10.0
    """For one decision of one run."""
    run: float = 7200.0
    """For all decisions of one run."""

    @classmethod
    def of_table(cls, table: TimeLimitsTable | None) -> TimeLimits:
        """The limits that a task states; those of glbench where it states none."""
        return cls() if table is None else cls(start=table.start, step=table.step, run=table.run)

    def as_dict(self) -> dict[str, float]:
        """The limits in seconds, as recorded in results."""
        return {f"{name}_seconds": value for name, value in asdict(self).items()}


# ``signal.signal`` itself turns numbers into enumerations and back, which takes ten times as long as what it does.
_set_handler: Callable[[int, Any], Any] = getattr(signal.signal, "__wrapped__", signal.signal)
_ALARM = int(getattr(signal, "SIGALRM", 0))


class TimeUp(BaseException):
    """The alarm rang inside an agent's call. No ``Exception``, so that an agent does not catch it by catching errors."""


class Alarm:
    """Raises ``TimeUp`` in the main thread some seconds after ``start``, until ``stop``.

    Without effect in other threads and on systems without alarms. The alarm may ring on the way out of a call, even inside ``stop``;
    who catches ``TimeUp`` calls ``stop`` once more, and the next ring is a second away.
    """

    __slots__ = ("_before", "_began", "_running", "_timer")

    def __init__(self) -> None:
        self._running = False
        self._began = 0.0
        self._before: Any = None
        self._timer = (0.0, 0.0)

    def start(self, seconds: float) -> None:
        """Set the alarm."""
        if hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread():
            self._began = time.monotonic()
            self._running = True
            self._before = _set_handler(_ALARM, _ring)
            self._timer = signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN_SECONDS)

    def stop(self) -> None:
        """Cancel the timer; a timer that was running before (a test runner's time-out) continues with its remaining time."""
        if not self._running:
            return
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        _set_handler(_ALARM, self._before)
        self._running = False
        delay, interval = self._timer
        if delay > 0.0:
            signal.setitimer(signal.ITIMER_REAL, max(delay - (time.monotonic() - self._began), 1e-3), interval)


def _ring(_signal: int, _frame: FrameType | None) -> None:
    raise TimeUp
