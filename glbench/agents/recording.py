"""An agent that looks at nothing: it replays the actions that another agent took in one run.

What it earns beside the agent that was recorded tells what feedback is worth in a task. ``glbench episodes recording`` makes one of any
agent that acts through the task's actuation.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import ArrayFile, checked_facts
from glbench.errors import ShapeError, SubmissionError
from glbench.untrusted import reason_of

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

FORMAT = 1
_LARGEST = 256 * 2**20
"""Size of the unpacked arrays [bytes]: a year of minutes with six actions has 13 MB."""


@dataclass(frozen=True, eq=False)
class Recording:
    """Actions of one run, in the order in which they were taken.

    Attributes
    ----------
    actions
        ``(steps, actions)``, float32, all finite, at least one step.
    names, low, high
        Controls that the columns drive, and their bounds.
    actuation
        How the task turned them into controls.
    about
        Whose actions they are, for people: agent and its digest, task and its digest, seed.
    """

    actions: NDArray[np.float32]
    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    actuation: str
    about: dict[str, str | int]

    def __post_init__(self) -> None:
        if self.actions.ndim != 2 or not len(self.actions) or self.actions.shape[1] != len(self.names):
            msg = f"a recording of {len(self.names)} actions cannot have the shape {self.actions.shape}"
            raise ShapeError(msg)
        sides = list(zip(self.low, self.high, strict=False))
        if not len(self.low) == len(self.high) == len(self.names) or not all(low < high for low, high in sides):
            msg = "an action lacks a lower or an upper bound, or its lower bound is not below its upper bound"
            raise ShapeError(msg)
        if not np.isfinite(self.actions).all():
            msg = "it has actions that are not finite"
            raise ShapeError(msg)

    def why_not(self, task: TaskCard) -> str | None:
        """Why it cannot be replayed in ``task``, in words; ``None`` when it can."""
        mine, theirs = _words(self.names, self.actuation), _words(task.action_names, task.actuation)
        if mine != theirs:
            return f"it holds {mine}, and {task.id} takes {theirs}"
        bounds = tuple((action.low, action.high) for action in task.actions)
        if bounds != tuple(zip(self.low, self.high, strict=True)):
            return f"its actions have other bounds than those of {task.id}"
        return None

    def to_bytes(self) -> bytes:
        """The recording as the bytes of its file; equal recordings give equal bytes."""
        file = io.BytesIO()
        np.savez_compressed(
            file,
            allow_pickle=False,
            format=np.int64(FORMAT),
            actions=self.actions,
            names=np.array(self.names),
            low=np.array(self.low),
            high=np.array(self.high),
            actuation=np.array(self.actuation),
            about=np.array(json.dumps(self.about, sort_keys=True)),
        )
        return file.getvalue()


def read_recording(file: Path) -> Recording:
    """The recording in ``file``.

    Raises
    ------
    SubmissionError
        When it cannot be read or is not a recording.
    """
    advice = "`glbench episodes recording` writes one."
    try:
        arrays = ArrayFile.at(file, _LARGEST)
        if arrays.integer("format") != FORMAT:
            msg = f"The recording {file} has format {arrays.integer('format')}; this version of glbench reads format {FORMAT}."
            raise SubmissionError(msg)
        return Recording(
            actions=arrays.floats("actions", 2, np.float32),
            names=arrays.texts("names"),
            low=tuple(arrays.floats("low", 1).tolist()),
            high=tuple(arrays.floats("high", 1).tolist()),
            actuation=arrays.text("actuation"),
            about=checked_facts(arrays.table("about")),  # type: ignore[arg-type]
        )
    except (ValueError, OSError, ShapeError) as error:
        msg = f"{file} is not a recording of actions, or is damaged: {reason_of(error)}. {advice}"
        raise SubmissionError(msg) from error


class RecordingAgent:
    """Takes the recorded actions in their order in every run; past their end it holds the last one."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._runs = 0
        self._step = 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Begin again with the first action.

        Raises
        ------
        SubmissionError
            When ``task`` takes other actions than the recorded ones.
        """
        reason = self._recording.why_not(task)
        if reason is not None:
            msg = f"The recording does not fit this task: {reason}. Record an agent on a task with the same actions."
            raise SubmissionError(msg)
        self._runs, self._step = n_runs, 0

    def act(self, observations: NDArray[np.float32], /) -> NDArray[np.float64]:
        """The next action for every run, ``(n_runs, actions)``; of ``observations`` only the number of rows is looked at.

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != self._runs:
            msg = f"act got observations of {len(observations)} runs, reset was called with {self._runs}. Call reset first."
            raise ShapeError(msg)
        actions = self._recording.actions
        action = actions[min(self._step, len(actions) - 1)].astype(np.float64)
        self._step += 1
        return np.tile(action, (self._runs, 1))


def _words(names: tuple[str, ...], actuation: str) -> str:
    return f"{actuation} actions of {', '.join(names)}"
