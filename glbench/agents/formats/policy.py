"""The agent around a saved policy: normalise, ask evenly, hand the state of each run on, clip where the card says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.agents.formats.normalising import Normalise
from glbench.agents.formats.rows import EvenRows
from glbench.errors import ShapeError, SubmissionError

if TYPE_CHECKING:
    from glbench.agents.protocol import Actions, Observations
    from glbench.tasks import TaskCard


class PolicyAgent:
    """An agent that asks a policy. Its rows do not know of each other, and a row has the same bits in every batch.

    Parameters
    ----------
    ask
        The policy: answers ``(n, actions + state)`` for ``(n, columns + state)``.
    normalise
        What is done to the observations first.
    actions
        Number of actions.
    state
        Numbers that a recurrent policy hands from one step of a run to the next, 0 at the run's start.
    clip
        Whether answers are clipped to the bounds of the actions.
    """

    def __init__(
        self, ask: EvenRows, normalise: Normalise, actions: int, state: int = 0, *, clip: bool = False
    ) -> None:
        self._ask, self._normalise, self._clip = ask, normalise, clip
        self._actions, self._state_width = actions, state
        self._state: NDArray[np.float32] = np.zeros((0, state), dtype=np.float32)
        self._low: NDArray[np.float64] = np.zeros(0)
        self._high: NDArray[np.float64] = np.zeros(0)

    @property
    def rows_at_once(self) -> int:
        """Rows that the policy is asked for at once; 1 where more would change bits."""
        return self._ask.block

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """All runs begin with a state of zeros."""
        self._state = np.zeros((n_runs, self._state_width), dtype=np.float32)
        self._low = np.array([action.low for action in task.actions])
        self._high = np.array([action.high for action in task.actions])

    def act(self, observations: Observations, /) -> Actions:
        """Actions (n_runs, actions) for ``observations`` (n_runs, columns).

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != len(self._state):
            msg = f"act got observations of {len(observations)} runs, reset was told of {len(self._state)}. Call reset first."
            raise ShapeError(msg)
        rows = np.ascontiguousarray(self._normalise(observations), dtype=np.float32)
        answer = self._ask(np.concatenate([rows, self._state], axis=1) if self._state_width else rows)
        actions, self._state = (
            answer[:, : self._actions].astype(np.float64),
            answer[:, self._actions :].astype(np.float32),
        )
        return np.clip(actions, self._low, self._high) if self._clip else actions


def check_answer(ask: EvenRows, columns: int, actions: int, name: str) -> None:
    """Try the policy on zeros: it must answer with as many actions as the task has.

    Raises
    ------
    SubmissionError
        When it answers with something else.
    """
    shape = ask(np.zeros((1, columns), dtype=np.float32)).shape
    if shape != (1, actions):
        msg = f"{name} answers a row of {columns} observations with {shape[1]} numbers, the task has {actions} actions."
        raise SubmissionError(msg)
