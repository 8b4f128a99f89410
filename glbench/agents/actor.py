"""The agent behind the compiled PPO's policies: a network with what stands before and behind it, in one file without code in it.

Before the network stand traces: running means of what sensors read, each with a time constant of its own. They are the policy's memory, and
average noise. A recurrent unit may stand there too: what it remembers, it has learnt. Behind it, what the network says is where a control
should stand, and the action brings it there as fast as the task lets it.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.agents.gru import Gru
from glbench.agents.network_policy import NetworkPolicy
from glbench.arrays import ArrayFile
from glbench.errors import ShapeError, SubmissionError
from glbench.untrusted import quoted, reason_of

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Actor:
    """A policy with a memory.

    Attributes
    ----------
    network
        From the observed columns and, after them, the traces and the recurrent unit's memory to one number an action. Its bounds are those
        of these numbers: 0 and 1 where it says where the control should stand, those of the action elsewhere.
    traced
        Columns that leave traces ``(t,)``.
    shares
        How far each trace goes towards the reading in a step ``(k,)``; there are ``k`` traces of every such column, those of the first
        share first.
    max_change
        How far an action of 1 moves its control in a step ``(m,)``, of its range; 0 where the network gives the action itself.
    low, high
        Bounds of the actions ``(m,)``.
    gru
        The recurrent unit, which sees columns and traces as the network sees them; ``None`` for none.
    """

    network: NetworkPolicy
    traced: NDArray[np.int64]
    shares: Floats
    max_change: Floats
    low: Floats
    high: Floats
    gru: Gru | None = None

    def __post_init__(self) -> None:
        columns = len(self.columns)
        actions = len(self.network.action_names)
        well = (
            self.traced.ndim == 1
            and all(0 <= column < columns for column in self.traced)
            and self.shares.ndim == 1
            and bool(((self.shares > 0) & (self.shares <= 1)).all())
            and {self.max_change.shape, self.low.shape, self.high.shape} == {(actions,)}
            and bool((np.isfinite(self.max_change) & (self.max_change >= 0) & (self.low < self.high)).all())
            and (self.gru is None or len(self.gru.weights) + self.gru.units == len(self.network.observation_names))
        )
        if not well or not np.isfinite([self.low, self.high]).all():
            traces = f"traces of the columns {quoted(self.traced.tolist())} with shares {quoted(self.shares.tolist())}"
            changes = (
                f"changes of {quoted(self.max_change.tolist())} a step, such bounds, or a recurrent unit of other sizes"
            )
            msg = f"A policy of {columns} columns and {actions} actions cannot have {traces}, {changes}."
            raise ShapeError(msg)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the observed columns."""
        units = 0 if self.gru is None else self.gru.units
        return self.network.observation_names[
            : len(self.network.observation_names) - units - len(self.traced) * len(self.shares)
        ]

    def why_not(self, task: TaskCard) -> str | None:
        """Why this policy cannot act in ``task``, in words; ``None`` when it can."""
        if task.observation_names != self.columns:
            return f"it was trained on {len(self.columns)} observations ({', '.join(self.columns[:3])}, ...), and {task.id} shows others"
        if (
            task.action_names != self.network.action_names
            or [action.low for action in task.actions] != self.low.tolist()
        ):
            return f"its actions are not those of {task.id}"
        return None

    def to_bytes(self) -> bytes:
        """The policy as the bytes of its file; equal policies give equal bytes."""
        file = io.BytesIO()
        own = {name: getattr(self, name) for name in _OWN}
        if self.gru is not None:
            own |= {f"gru_{name}": getattr(self.gru, name) for name in _GRU}
        np.savez_compressed(file, allow_pickle=False, network=np.frombuffer(self.network.to_bytes(), np.uint8), **own)
        return file.getvalue()

    @classmethod
    def at(cls, file: Path) -> Actor:
        """The policy in ``file``.

        Raises
        ------
        SubmissionError
            When it cannot be read.
        """
        try:
            arrays = ArrayFile.at(file)
            network = NetworkPolicy.from_bytes(arrays.integers("network", 1, np.uint8).tobytes(), str(file))
            traced, *numbers = _OWN
            unit = (
                [arrays.floats(f"gru_{name}", of, np.float32) for name, of in _GRU.items()]
                if "gru_bias" in arrays
                else None
            )
            own = {name: arrays.floats(name, 1) for name in numbers}
            gru = None if unit is None else Gru(*unit)
            return cls(network, arrays.integers(traced, 1, np.int64), **own, gru=gru)
        except (ValueError, OSError, ShapeError) as error:
            msg = f"{file} is not a policy of glbench train ppo, or is damaged: {reason_of(error)}. Train it again."
            raise SubmissionError(msg) from error


_OWN = ("traced", "shares", "max_change", "low", "high")
_GRU = {"weights": 2, "bias": 1, "recurrent": 2}
"""And how many dimensions they have."""


@dataclass(frozen=True)
class ActorFiles:
    """A policy file, or a folder of them, one a task."""

    files: tuple[Path, ...]

    @classmethod
    def at(cls, place: Path) -> ActorFiles:
        """The file ``place``, or all of the folder ``place``.

        Raises
        ------
        SubmissionError
            When there is none.
        """
        files = tuple(sorted(place.glob("*.npz"))) if place.is_dir() else (place,)
        if not files or not files[0].is_file():
            msg = f"There is no policy at {place}. glbench train writes one."
            raise SubmissionError(msg)
        return cls(files)


class ActorAgent:
    """An ``Agent`` that does what its policy says, and keeps the traces, memory and positions of every run.

    Of several policies the one acts that was trained on the task itself; for another task with the same observations and actions, the
    first that fits. A reading that is missing (not finite) leaves a trace as it is, and counts as the
    column's mean in training.
    """

    def __init__(self, policies: ActorFiles | Actor) -> None:
        self._policies = (
            (policies,) if isinstance(policies, Actor) else tuple(Actor.at(file) for file in policies.files)
        )

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Begin ``n_runs`` runs: all controls stand at 0, and there are no traces yet.

        Raises
        ------
        SubmissionError
            When no policy fits the task's observations and actions.
        """
        fitting = [policy for policy in self._policies if policy.why_not(task) is None]
        if not fitting:
            reasons = "; ".join(sorted({str(policy.why_not(task)) for policy in self._policies}))
            msg = f"The trained policy does not fit this task: {reasons}. Train one for it: glbench train ppo --task {task.id}."
            raise SubmissionError(msg)
        self.policy = min(fitting, key=lambda policy: policy.network.task_id != task.id)
        self._positions = np.zeros((n_runs, len(self.policy.max_change)))
        self._traces = np.full((n_runs, len(self.policy.shares), len(self.policy.traced)), np.nan)
        self._memory = np.zeros((n_runs, 0 if self.policy.gru is None else self.policy.gru.units))

    def act(self, observations: NDArray[np.float32], /) -> Floats:
        """Actions (n_runs, actions).

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        policy, traces = self.policy, self._traces
        if len(observations) != len(traces):
            msg = f"act got observations of {len(observations)} runs, reset was called with {len(traces)}. Call reset first."
            raise ShapeError(msg)
        given = observations.astype(np.float64)
        read = given[:, None, policy.traced]
        moved = traces + policy.shares[:, None] * (read - traces)
        traces = np.where(np.isnan(traces), read, np.where(np.isfinite(read), moved, traces))
        self._traces = traces
        seen = np.concatenate([given, traces.reshape(len(given), -1)], axis=1)
        seen = np.where(np.isfinite(seen), seen, policy.network.mean[: seen.shape[1]])
        if policy.gru is not None:
            self._memory = policy.gru(_normalised(policy.network, seen), self._memory)
        wanted = policy.network.act(np.concatenate([seen, self._memory], axis=1))
        steered = policy.max_change > 0
        change = np.where(steered, policy.max_change, 1.0)
        actions: Floats = np.where(steered, (wanted - self._positions) / change, wanted)
        actions = np.clip(actions, policy.low, policy.high)
        self._positions = np.clip(self._positions + change * actions, 0.0, 1.0)
        return actions


def _normalised(network: NetworkPolicy, seen: Floats) -> Floats:
    """The first columns of what a network sees, as its first layer gets them."""
    columns = seen.shape[1]
    x: Floats = np.clip((seen - network.mean[:columns]) / network.scale[:columns], -network.clip, network.clip)
    return x
