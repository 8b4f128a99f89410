"""The agent behind the trained baselines: a folder of policies, of which the one that fits the task acts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents.network_policy import NetworkPolicy, read_policy
from glbench.errors import ShapeError, SubmissionError

if TYPE_CHECKING:
    from glbench.tasks import TaskCard


@dataclass(frozen=True)
class PolicyFiles:
    """One policy, or several trained on different tasks."""

    files: tuple[Path, ...]

    @classmethod
    def at(cls, place: Path) -> PolicyFiles:
        """The policy file ``place``, or all of the folder ``place``.

        Raises
        ------
        SubmissionError
            When there is none.
        """
        files = tuple(sorted(place.glob("*.npz"))) if place.is_dir() else (place,)
        if not files or not files[0].is_file():
            msg = f"There is no policy at {place}. glbench train writes one, and glbench export makes one of a trained model."
            raise SubmissionError(msg)
        return cls(files)


class NetworkAgent:
    """Trained policies; an ``Agent`` without memory.

    Of several policies the one acts that was trained on the task itself; for another task with the same observations and
    actions, the one trained under the nearest uncertainty (the smaller of two equally near).
    """

    def __init__(self, policies: PolicyFiles) -> None:
        self._policies = tuple(read_policy(file) for file in policies.files)
        self._runs = 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Take the policy for ``task``.

        Raises
        ------
        SubmissionError
            When none fits its observations and actions.
        """
        self.policy = policy_for(task, self._policies)
        self._runs = n_runs

    def act(self, observations: NDArray[np.float32], /) -> NDArray[np.float64]:
        """Actions (n_runs, actions).

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != self._runs:
            msg = f"act got observations of {len(observations)} runs, reset was called with {self._runs}. Call reset first."
            raise ShapeError(msg)
        return self.policy.act(observations)


def policy_for(task: TaskCard, policies: tuple[NetworkPolicy, ...]) -> NetworkPolicy:
    """The policy that acts in ``task``.

    Raises
    ------
    SubmissionError
        When none fits its observations and actions.
    """
    fitting = [policy for policy in policies if policy.why_not(task) is None]
    if not fitting:
        reasons = sorted({str(policy.why_not(task)) for policy in policies})
        msg = f"The trained policy does not fit this task: {'; '.join(reasons)}. Train one for it: glbench train ppo --task {task.id}."
        raise SubmissionError(msg)

    def distance(policy: NetworkPolicy) -> tuple[Any, ...]:
        return policy.task_id != task.id, round(abs(policy.delta - task.delta), 9), policy.delta

    return min(fitting, key=distance)
