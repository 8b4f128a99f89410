"""From whatever an agent returns to an array of the evaluation's own, and what is wrong with it by run."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.agents import action_problems

if TYPE_CHECKING:
    from glbench.tasks import TaskCard


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
