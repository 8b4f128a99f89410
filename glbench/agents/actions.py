"""What ``act`` returned: as an array of the evaluation's own, and what is wrong with it, in words and by run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import real_numbers

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
    with np.errstate(over="ignore"):  # of a longdouble
        return value_problems(np.asarray(returned, dtype=np.float64), task)


def value_problems(actions: NDArray[np.float64], task: TaskCard) -> dict[int, str]:
    """Reasons, by row, why ``actions`` (n, actions of the task) are not finite or not within the bounds of the task card."""
    low, high = task.action_bounds
    good = (actions >= low - ROUNDING) & (actions <= high + ROUNDING)  # False for nan too
    if good.all():
        return {}
    return {int(run): _problem_of_row(actions[run], good[run], task) for run in np.flatnonzero(~good.all(axis=1))}


def read_actions(returned: object, card: TaskCard, n: int) -> tuple[NDArray[np.float64], dict[int, str]]:
    """Own copy ``(n, m)`` float64 of what ``act`` returned, and the reasons, by row, why its shape or type is wrong; such rows are zero.

    Something of the wrong shape as a whole is wrong in every row; a list of rows of which one has another length is wrong in that row
    only. Values are not looked at: ``value_problems`` does that where the agent cannot reach.
    """
    once = _converted(returned)
    whole = _problem_of_the_whole(once, card, n)
    if whole is None:
        with np.errstate(over="ignore"):  # of a longdouble
            return np.array(once, dtype=np.float64), {}
    actions = np.zeros((n, len(card.actions)))
    if n == 1 or not isinstance(returned, list | tuple) or len(returned) != n:
        return actions, dict.fromkeys(range(n), whole)
    problems: dict[int, str] = {}
    for row, given in enumerate(returned):
        one, wrong = read_actions([given], card, 1)
        actions[row] = one[0]
        if wrong:
            problems[row] = wrong[0]
    return actions, problems


def _converted(returned: object) -> object:
    """``returned`` as an array of numbers, if it is one: what converts itself may look different every time."""
    if type(returned) is np.ndarray:
        return returned
    array = real_numbers(returned)
    return returned if array is None else array  # what is none is told in words by who looks at it


def _problem_of_the_whole(returned: object, task: TaskCard, n_runs: int) -> str | None:
    array = real_numbers(returned)
    if array is None:
        if isinstance(returned, list | tuple) and len({_length(row) for row in returned}) > 1:
            return f"act returned a {type(returned).__name__} of rows that differ in length; {_expected(task, n_runs)}"
        what = f"an array of {returned.dtype}" if type(returned) is np.ndarray else f"a {type(returned).__name__}"
        return f"act returned {what}, which are no plain numbers; {_expected(task, n_runs)}"
    if array.shape != (n_runs, len(task.actions)):
        return f"act returned an array of shape {array.shape}; {_expected(task, n_runs)}"
    return None


def _length(row: object) -> int:
    return len(row) if isinstance(row, list | tuple) or (isinstance(row, np.ndarray) and row.ndim > 0) else -1


def _expected(task: TaskCard, n_runs: int) -> str:
    return f"expected ({n_runs}, {len(task.actions)}): one row a run, in it {', '.join(task.action_names)}"


def _problem_of_row(action: NDArray[np.float64], good: NDArray[np.bool_], task: TaskCard) -> str:
    column = int(np.flatnonzero(~good)[0])
    value, allowed = float(action[column]), task.actions[column]
    if not np.isfinite(value):
        return f"the action for {allowed.name} is {value}, which is not a finite number"
    bounds = f"outside its bounds {allowed.low:g} to {allowed.high:g}"
    if allowed.stands_for is not None:
        bounds += f", which stand for {allowed.lowest:g} to {allowed.highest:g} {allowed.unit} (Action.of converts)"
    return f"the action for {allowed.name} is {value:.9g}, {bounds}"
