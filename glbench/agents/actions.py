"""What ``act`` returned: as an array of the evaluation's own, and what is wrong with it, in words and by run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from glbench.tasks import TaskCard


ROUNDING = 1e-6
"""How far an action may lie outside its bounds: what float32 arithmetic loses."""


def action_problems(returned: object, task: TaskCard, n_runs: int) -> dict[int, str]:
    """Reasons, by run, why what ``act`` returned cannot be used; empty when all is well.

    Expected is an array of shape (n_runs, actions of the task) of numbers, finite and within the bounds of the task card. A
    wrong shape or type is reported for every run, a bad value for its own run only.
    """
    whole = _problem_of_the_whole(returned, task, n_runs)
    if whole is not None:
        return dict.fromkeys(range(n_runs), whole)
    actions = np.asarray(returned, dtype=np.float64)
    low, high = task.action_bounds
    good = (actions >= low - ROUNDING) & (actions <= high + ROUNDING)  # False for nan too
    if good.all():
        return {}
    return {int(run): _problem_of_row(actions[run], good[run], task) for run in np.flatnonzero(~good.all(axis=1))}


def _problem_of_the_whole(returned: object, task: TaskCard, n_runs: int) -> str | None:
    try:
        array = np.asarray(returned)
    except (TypeError, ValueError):
        return f"act returned a {type(returned).__name__} of rows that differ in length; {_expected(task, n_runs)}"
    if array.dtype.kind not in "fiu":
        what = f"an array of {array.dtype}" if isinstance(returned, np.ndarray) else f"a {type(returned).__name__}"
        return f"act returned {what}, which are no plain numbers; {_expected(task, n_runs)}"
    if array.shape != (n_runs, len(task.actions)):
        return f"act returned an array of shape {array.shape}; {_expected(task, n_runs)}"
    return None


def _expected(task: TaskCard, n_runs: int) -> str:
    return f"expected ({n_runs}, {len(task.actions)}): one row a run, in it {', '.join(task.action_names)}"


def _problem_of_row(action: NDArray[np.float64], good: NDArray[np.bool_], task: TaskCard) -> str:
    column = int(np.flatnonzero(~good)[0])
    value, allowed = float(action[column]), task.actions[column]
    if not np.isfinite(value):
        return f"the action for {allowed.name} is {value}, which is not a finite number"
    return f"the action for {allowed.name} is {value:.9g}, outside its bounds {allowed.low:g} to {allowed.high:g}"


def read_actions(returned: object, card: TaskCard, n: int) -> tuple[NDArray[np.float64], dict[int, str]]:
    """Own copy ``(n, m)`` float64 of what ``act`` returned, and the reasons, by row, why it cannot be used.

    Rows with a problem are zero in the copy. Something of the wrong shape as a whole is wrong in every row; a list of rows of which one
    has another length is wrong in that row only.
    """
    once = _converted(returned)
    problems = action_problems(once, card, n)
    if len(problems) < n:
        actions = np.array(once, dtype=np.float64)
        if problems:
            actions[list(problems)] = 0.0
        return actions, problems
    actions = np.zeros((n, len(card.actions)))
    if n == 1 or not isinstance(returned, list | tuple) or len(returned) != n:
        return actions, problems
    by_row: dict[int, str] = {}
    for row, given in enumerate(returned):
        once = _converted([given])
        reason = action_problems(once, card, 1).get(0)
        if reason is None:
            actions[row] = np.asarray(once, dtype=np.float64)[0]
        else:
            by_row[row] = reason
    return actions, by_row


def _converted(returned: object) -> object:
    """``returned`` as an array of numbers, if it is one: what converts itself may look different every time."""
    if isinstance(returned, np.ndarray):
        return returned
    try:
        array = np.asarray(returned)
    except (TypeError, ValueError):  # told in words by who looks at it
        return returned
    return array if array.dtype.kind in "fiu" else returned
