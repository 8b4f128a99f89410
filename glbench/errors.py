"""The few error types of glbench, and helpers for their messages.

Every message says what happened, with which value, and what to do next. The command line prints the message and leaves;
programs catch ``GlbenchError``.
"""

from __future__ import annotations

import difflib
import operator
import traceback
from collections.abc import Iterable
from typing import NoReturn


class GlbenchError(Exception):
    """Base of every error that glbench raises on purpose."""


class UnknownNameError(GlbenchError):
    """A task, parameter, control, weather record, ... of that name does not exist."""


class ParameterError(GlbenchError):
    """A model parameter has an impossible value or unit."""


class ShapeError(GlbenchError):
    """An array has the wrong shape, type, or values that are not finite."""


class WeatherError(GlbenchError):
    """A weather file or record cannot be used: gaps, impossible values, a period that it does not cover."""


class TaskError(GlbenchError):
    """A task definition is invalid, or a published one was changed."""


class ActionError(GlbenchError):
    """An action is not finite, has the wrong shape, or lies outside its bounds."""


class StepError(GlbenchError):
    """A control step could not be integrated to its tolerance."""


class SubmissionError(GlbenchError):
    """A submission cannot be loaded or does not follow the agent protocol."""


class SandboxError(GlbenchError):
    """There can be no sandbox for an agent on this machine, and none was not asked for."""


class TrainingError(GlbenchError):
    """A training cannot be set up, continued or exported as asked."""


class ResultError(GlbenchError):
    """A stored result is unreadable, inconsistent, or cannot be compared with another."""


class EpisodeError(GlbenchError):
    """An episode record is missing, damaged, or of another kind than expected."""


class ArchiveError(GlbenchError):
    """A published archive of measurements cannot be used: files, columns or days are missing."""


def whole_number(value: object, what: str) -> int:
    """``value`` as an int. Raises ``GlbenchError`` when it is none, with ``what`` it is of: ``"The number of runs"``."""
    if isinstance(value, bool) or not hasattr(type(value), "__index__"):
        refuse(f"{what} is a whole number; got {value!r}.", GlbenchError)
    return operator.index(value)  # type: ignore[arg-type]


def refuse(reason: str, error: type[Exception] = ValueError, cause: BaseException | None = None) -> NoReturn:
    """Raise ``error`` with ``reason``, from ``cause``; a validator of pydantic or a reader of untrusted data does it by ``ValueError``."""
    if cause is None:
        raise error(reason)  # in an ``except`` its context stays
    raise error(reason) from cause


def did_you_mean(name: str, choices: Iterable[str], *, list_few: bool = True) -> str:
    """Sentence that points to the names of ``choices`` nearest to ``name``; without one, and with ``list_few``, lists all if they are few.

    Text such as ``" Did you mean 'tAir'?"`` with a leading space, or the list of all names, or an empty string.
    """
    names = [str(k) for k in choices]
    by_lower = {k.lower(): k for k in names}
    near = [by_lower[m] for m in difflib.get_close_matches(str(name).lower(), list(by_lower), n=3, cutoff=0.6)]
    if near:
        return " Did you mean " + " or ".join(f"'{k}'" for k in near) + "?"
    return " Known: " + ", ".join(names) + "." if list_few and 0 < len(names) <= 12 else ""


def last_line(error: BaseException) -> str:
    """Type and message of an error on one line."""
    lines = [line.strip() for line in "".join(traceback.format_exception_only(error)).splitlines() if line.strip()]
    return lines[-1].rstrip(".") if lines else type(error).__name__
