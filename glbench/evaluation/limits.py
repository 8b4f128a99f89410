"""Time limits for an agent, and guarded calls: what an agent does in one is a value or a failure in words, and never raises.

Python code that loops forever is stopped by the alarm signal. Code that hangs inside a compiled library is not: the signal is handled
when the library returns, and the call is then counted as timed out.

Time in which the whole process stood still (Ctrl-Z, a paused container) does not count: when it goes on, a call has its whole time again.
"""

from __future__ import annotations

import re
import signal
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from glbench.errors import ActionError

if TYPE_CHECKING:
    from glbench.evaluation.records import Status
    from glbench.tasks.tables import TimeLimitsTable


_DOUBT_SECONDS = 0.01  # After the alarm rang, the signal that the process continues after a stop is waited for so long
_AGAIN_SECONDS = 1.0  # Interval at which the alarm repeats, for an agent that swallows the first one in a bare ``except``
# ``signal.signal`` itself turns numbers into enumerations and back, which takes ten times as long as what it does.
_set_handler: Callable[[int, Any], Any] = getattr(signal.signal, "__wrapped__", signal.signal)
_ALARM, _GOES_ON = int(getattr(signal, "SIGALRM", 0)), int(getattr(signal, "SIGCONT", 0))
T = TypeVar("T")
_LONGEST_REASON = 400
_ADDRESS = re.compile(r"0x[0-9a-fA-F]{6,}")
_OWN_FOLDER = Path(__file__).resolve().parents[1]


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


class TimeUp(BaseException):
    """The alarm rang inside an agent's call. No ``Exception``, so that an agent does not catch it by catching errors."""


class Alarm:
    """Raises ``TimeUp`` in the main thread some seconds after ``start``, or after the process went on, until ``stop``.

    It raises nothing in other threads and on systems without alarms. The alarm may ring on the way out of a call; who catches ``TimeUp``
    calls ``stop`` once more, and the next ring is a second away.
    """

    __slots__ = ("_before", "_began", "_doubted", "_limit", "_running", "_since", "_timer")

    def __init__(self) -> None:
        self._running = self._doubted = False
        self._limit = self._began = self._since = 0.0
        self._before: tuple[Any, Any] = (None, None)
        self._timer = (0.0, 0.0)

    def start(self, seconds: float) -> None:
        """Set the alarm."""
        self._began = self._since = time.perf_counter()
        self._limit = seconds
        if hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread():
            self._running = True
            self._before = _set_handler(_ALARM, self._ring), _set_handler(_GOES_ON, self._go_on)
            self._timer = signal.setitimer(signal.ITIMER_REAL, seconds, _AGAIN_SECONDS)

    def seconds(self) -> float:
        """Seconds since ``start``, or since the process went on after a stop."""
        return time.perf_counter() - self._since

    def stop(self) -> None:
        """Cancel the timer; a timer that was running before (a test runner's time-out) continues with its remaining time."""
        if not self._running:
            return
        self._running = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in zip((_ALARM, _GOES_ON), self._before, strict=True):
            _set_handler(number, handler)
        delay, interval = self._timer
        if delay > 0.0:
            signal.setitimer(signal.ITIMER_REAL, max(delay - (time.perf_counter() - self._began), 1e-3), interval)

    def _ring(self, _signal: int, _frame: FrameType | None) -> None:
        if not self._running:
            return
        if self.seconds() >= self._limit and not self._doubted:
            # The signal that the process continues after a stop is handled after this one.
            self._doubted = True
            signal.setitimer(signal.ITIMER_REAL, _DOUBT_SECONDS, _AGAIN_SECONDS)
            return
        raise TimeUp

    def _go_on(self, _signal: int, _frame: FrameType | None) -> None:
        if self._running:
            self._since, self._doubted = time.perf_counter(), False
            signal.setitimer(signal.ITIMER_REAL, self._limit, _AGAIN_SECONDS)


@dataclass(frozen=True)
class Failure:
    """Why a run, or all runs (``row`` is ``None``), ended."""

    row: int | None
    status: Status
    reason: str


@dataclass(frozen=True)
class Answer(Generic[T]):
    """What a guarded call gave: a value or a failure, and the seconds that it took."""

    value: T | None
    failure: Failure | None
    seconds: float


def guarded(call: Callable[[], T], seconds: float, what: str, through: tuple[type[BaseException], ...] = (KeyboardInterrupt,)) -> Answer[T]:
    """Run an agent's code with a time limit; ``what`` names the call in the failure's reason, ``through`` is not caught."""
    value: T | None = None
    failure: Failure | None = None
    alarm = Alarm()
    try:
        try:
            alarm.start(seconds)
            value = call()
        finally:
            alarm.stop()
    except TimeUp as error:
        alarm.stop()
        # Before its time it was raised by the agent itself, or rung by a signal that it sent.
        early = alarm.seconds() < seconds
        failure = Failure(None, "crashed", in_words(error)) if early else _too_slow(seconds, what)
    except through:
        raise
    except ActionError as error:  # of the adapter for single-run agents, which checks the shape of what they return
        failure = Failure(None, "invalid_action", str(error).rstrip("."))
    except BaseException as error:  # an agent may raise anything, SystemExit included; it is recorded, not swallowed
        failure = Failure(None, "crashed", in_words(error))
    took = alarm.seconds()
    if failure is None and took > seconds:
        failure = _too_slow(seconds, what)
    return Answer(value if failure is None else None, failure, took)


def _too_slow(seconds: float, what: str) -> Failure:
    return Failure(None, "timed_out", f"{what} took longer than its limit of {seconds:g} s")


def in_words(error: BaseException) -> str:
    """``ValueError: message (my_agent.py:42 in act)``: the last line of a traceback and the place in the agent's own code.

    Free of folders and memory addresses, so that the same failure has the same words on every machine. Where the words of the error
    themselves fail, as they may in a stranger's class or without memory, its kind alone.
    """
    try:
        text = " ".join("".join(traceback.format_exception_only(error)).split())
        text = _ADDRESS.sub("0x...", text)
        if len(text) > _LONGEST_REASON:
            text = text[: _LONGEST_REASON - 4] + " ..."
        place = _place(error)
    except Exception:  # whatever the words of a stranger's error raise; past what a metaclass makes of looking at its name
        return str(type.__getattribute__(type(error), "__name__"))
    return f"{text} ({place})" if place else text


def _place(error: BaseException) -> str:
    """The deepest frame that is neither glbench's nor an installed library's, which is the agent's own line."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return ""
    files = [Path(frame.filename) for frame in frames]
    own = [
        frame
        for frame, file in zip(frames, files, strict=True)
        if not (file.is_relative_to(_OWN_FOLDER) or "site-packages" in file.parts or file.name.startswith("<frozen"))
    ]
    frame = own[-1] if own else frames[-1]
    return f"{Path(frame.filename).name}:{frame.lineno} in {frame.name}"
