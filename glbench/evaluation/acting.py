"""Calling an agent: its answers are checked, and its errors become reasons in words.

Nothing that an agent does in a call raises out of this module, except Ctrl-C.
"""

from __future__ import annotations

import re
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from glbench.errors import ActionError
from glbench.evaluation.limits import Alarm, TimeUp

if TYPE_CHECKING:
    from glbench.evaluation.records import Status

T = TypeVar("T")

_LONGEST_REASON = 400
_ADDRESS = re.compile(r"0x[0-9a-fA-F]{6,}")
_OWN_FOLDER = Path(__file__).resolve().parents[1]


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


def guarded(
    call: Callable[[], T], seconds: float, what: str, through: tuple[type[BaseException], ...] = (KeyboardInterrupt,)
) -> Answer[T]:
    """Run an agent's code with a time limit; ``what`` names the call in the failure's reason, ``through`` is not caught."""
    began = time.perf_counter()
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
        early = time.perf_counter() - began < seconds
        failure = Failure(None, "crashed", in_words(error)) if early else _too_slow(seconds, what)
    except through:
        raise
    except ActionError as error:  # of the adapter for single-run agents, which checks the shape of what they return
        failure = Failure(None, "invalid_action", str(error).rstrip("."))
    except BaseException as error:  # an agent may raise anything, SystemExit included; it is recorded, not swallowed
        failure = Failure(None, "crashed", in_words(error))
    took = time.perf_counter() - began
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
        return _in_words(error)
    except Exception:
        # Past whatever a metaclass makes of looking at its name.
        return str(type.__getattribute__(type(error), "__name__"))


def _in_words(error: BaseException) -> str:
    said = "".join(traceback.format_exception_only(error)).strip()
    said = _ADDRESS.sub("0x...", " ".join(said.split()))
    if len(said) > _LONGEST_REASON:
        said = said[: _LONGEST_REASON - 4] + " ..."
    place = _place(error)
    return f"{said} ({place})" if place else said


def _place(error: BaseException) -> str:
    """The deepest frame that is neither glbench's nor an installed library's, which is the agent's own line."""
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return ""
    own = [frame for frame in frames if not _is_library(Path(frame.filename))]
    frame = own[-1] if own else frames[-1]
    return f"{Path(frame.filename).name}:{frame.lineno} in {frame.name}"


def _is_library(file: Path) -> bool:
    return file.is_relative_to(_OWN_FOLDER) or "site-packages" in file.parts or file.name.startswith("<frozen")
