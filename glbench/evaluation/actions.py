"""From whatever an agent returns to checked actions: one row a run, finite, within bounds, or a sentence for the row that is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_NUMBERS = "fiub"
"""Kinds of numpy numbers that are actions: floats, integers, booleans. Text and complex numbers are not."""


@dataclass(frozen=True)
class ActionBounds:
    """Names and bounds of the controls an agent acts on, in their order; ``low`` and ``high`` have shape ``(m,)``."""

    names: tuple[str, ...]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def read_actions(returned: object, n: int, bounds: ActionBounds) -> tuple[NDArray[np.float64], dict[int, str]]:
    """Own copy ``(n, m)`` float64 of what ``act`` returned, and what is wrong by row. Rows with a problem are zero in the copy.

    Something of the wrong shape as a whole is wrong in every row; a list of rows of which one is broken is wrong in that row only.
    """
    m = len(bounds.names)
    whole = _numbers(returned)
    if whole is not None and whole.shape == (n, m):
        actions, problems = whole, {}
    elif whole is None and isinstance(returned, list | tuple) and len(returned) == n:
        actions, problems = _row_by_row(returned, m)
    else:
        reason = f"act returned {_kind(returned, whole)}; expected shape ({n}, {m}): one row a run, one value a control"
        return np.zeros((n, m)), dict.fromkeys(range(n), reason)
    inside = (actions >= bounds.low) & (actions <= bounds.high)  # False for NaN
    for row in np.flatnonzero(~inside.all(axis=1)):
        problems.setdefault(int(row), _outside(actions[row], inside[row], bounds))
    actions[list(problems)] = 0.0
    return actions, problems


def _row_by_row(returned: Sequence[object], m: int) -> tuple[NDArray[np.float64], dict[int, str]]:
    actions = np.zeros((len(returned), m))
    problems: dict[int, str] = {}
    for row, given in enumerate(returned):
        numbers = _numbers(given)
        if numbers is not None and numbers.shape == (m,):
            actions[row] = numbers
        else:
            problems[row] = f"act returned {_kind(given, numbers)} for this run; expected {m} numbers, one a control"
    return actions, problems


def _numbers(given: object) -> NDArray[np.float64] | None:
    """``given`` as a float64 array of its own, or ``None`` when it is no regular array of numbers."""
    try:
        array = np.asarray(given)
    except (TypeError, ValueError):
        return None
    return np.array(array, dtype=np.float64) if array.dtype.kind in _NUMBERS else None


def _kind(given: object, numbers: NDArray[np.float64] | None) -> str:
    return f"{type(given).__name__}" if numbers is None else f"an array of shape {numbers.shape}"


def _outside(action: NDArray[np.float64], inside: NDArray[np.bool_], bounds: ActionBounds) -> str:
    """Sentence about the first value that is not within its bounds."""
    column = int(np.flatnonzero(~inside)[0])
    name, value = bounds.names[column], float(action[column])
    if not np.isfinite(value):
        return f"the action of '{name}' is {value}, not a finite number"
    return f"the action of '{name}' is {value:g}, outside its bounds {bounds.low[column]:g} to {bounds.high[column]:g}"
