"""Keeping the record of an evaluation while it runs: a few array copies a step, everything else is done afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation, StepResult
from glbench.episodes.action_log import ActionLog, exactly
from glbench.episodes.definition import definition_json
from glbench.episodes.header import Provenance, RunFacts
from glbench.episodes.trace import Trace

LARGEST_TRACE = 512 * 2**20
"""Bytes of memory above which no trace is kept: the episodes are then made by replaying."""
BYTES_A_STEP = 8 * (28 + 6 + 3 + 23)
"""Bytes of memory that a trace takes for a step of a run."""


class Recorder:
    """The record of runs in lockstep.

    ``actions`` ``(steps, n, m)`` and ``rewards`` ``(steps, n)`` fill up step by step. ``trace`` holds everything else that full
    episodes show; it is ``None`` when nobody wants them, when they would not fit into memory, and after an interruption.
    """

    def __init__(self, simulation: Simulation, columns: int, *, traced: bool) -> None:
        steps, n = simulation.task.steps, simulation.n
        self.actions = np.zeros((steps, n, columns))
        self.rewards = np.zeros((steps, n))
        self._steps = 0
        self._wanted = traced and steps * n * BYTES_A_STEP <= LARGEST_TRACE
        self.trace: Trace | None = None

    def begin(self, simulation: Simulation) -> None:
        """Begin at the start of all runs."""
        if self._wanted:
            self.trace = Trace(simulation)

    def add(self, actions: NDArray[np.float64], simulation: Simulation, outcome: StepResult) -> None:
        """Keep the step that was just taken with ``actions`` ``(n, m)``."""
        self.actions[self._steps], self.rewards[self._steps] = actions, outcome.rewards
        self._steps += 1
        if self.trace is not None:
            self.trace.add(simulation, outcome)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """What a checkpoint has to hold besides the actions, which it holds anyway."""
        return {"step_rewards": self.rewards[: self._steps]}

    def restore(self, arrays: Mapping[str, NDArray[Any]], actions: NDArray[np.float64]) -> None:
        """Go on after an interruption, with what the checkpoint holds."""
        self._steps = len(actions)
        self.actions[: self._steps], self.rewards[: self._steps] = actions, arrays["step_rewards"]
        self.trace = None

    def log(self, simulation: Simulation, provenance: Provenance, runs: tuple[RunFacts, ...]) -> ActionLog:
        """The record, once all runs have ended."""
        actions, rewards = self.actions, self.rewards
        for row, run in enumerate(runs):
            actions[run.actions :, row], rewards[run.steps :, row] = 0.0, 0.0
        return ActionLog(
            provenance, definition_json(simulation.task), runs, exactly(actions), rewards, np.array(simulation.x)
        )
