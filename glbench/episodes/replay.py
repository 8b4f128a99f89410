"""Runs again, from the recorded actions alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from glbench.env import Simulation, StepResult
from glbench.episodes.action_log import ActionLog
from glbench.episodes.episode import Episode
from glbench.episodes.trace import Trace

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.tasks import TaskSpec


class Replay:
    """The runs ``rows`` of ``log`` (by default all), taken again step by step.

    The simulation is that of the evaluation: the same code, the same seeds, the same actions.
    """

    def __init__(
        self, task: TaskSpec, log: ActionLog, rows: Sequence[int] | None = None, kernel: Stepper | None = None
    ) -> None:
        self.rows = tuple(range(len(log.runs)) if rows is None else rows)
        self._log = log
        self._counts = np.array([log.runs[row].actions for row in self.rows])
        self._actions = log.actions[:, list(self.rows)].astype(np.float64)
        self.simulation = Simulation(task, len(self.rows), kernel=kernel)
        self.simulation.reset([log.runs[row].seed for row in self.rows])

    def steps(self) -> Iterator[StepResult]:
        """Take the steps. Before each, the runs that have no further action end where they stand."""
        simulation = self.simulation
        controls = self._log.provenance.agent.acts == "controls"
        for step in range(int(self._counts.max(initial=0))):
            over = self._counts <= step
            if over.any():
                simulation.end(over | simulation.ended)
            if simulation.ended.all():
                return
            take = simulation.step_controls if controls else simulation.step
            yield take(self._actions[step])


def replayed_episodes(
    task: TaskSpec, log: ActionLog, rows: Sequence[int], kernel: Stepper | None = None
) -> Iterator[Episode]:
    """Full episodes of the runs ``rows`` of ``log``, by simulating them again.

    Raises
    ------
    ActionError
        When a recorded action is none of the task's.
    """
    replay = Replay(task, log, rows, kernel)
    trace = Trace(replay.simulation)
    for outcome in replay.steps():
        trace.add(replay.simulation, outcome)
    for place, row in enumerate(rows):
        run = log.runs[row]
        yield trace.episode(task, place, log.provenance, run, log.actions[: run.steps, row])
