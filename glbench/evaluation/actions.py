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
    problems = action_problems(returned, card, n)
    if len(problems) < n:
        actions = np.array(returned, dtype=np.float64)
        if problems:
            actions[list(problems)] = 0.0
        return actions, problems
    actions = np.zeros((n, len(card.actions)))
    if n == 1 or not isinstance(returned, list | tuple) or len(returned) != n:
        return actions, problems
    by_row: dict[int, str] = {}
    for row, given in enumerate(returned):
        reason = action_problems([given], card, 1).get(0)
        if reason is None:
            actions[row] = given
        else:
            by_row[row] = reason
    return actions, by_row
