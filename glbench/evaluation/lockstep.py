"""All runs of an evaluation, step by step together; and going on where an interrupted one stopped."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation, Snapshot, StepResult
from glbench.episodes import Recorder
from glbench.evaluation.acting import Failure
from glbench.evaluation.checkpoint import Checkpoint, Saved
from glbench.evaluation.drivers import Driver
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.tally import Tally


@dataclass(frozen=True)
class Progress:
    """Where an evaluation stands: ``step`` of ``steps``, ``alive`` of ``runs`` still running.

    While ``replaying``, an interrupted evaluation shows its agent again what it had seen before.
    """

    step: int
    steps: int
    alive: int
    runs: int
    replaying: bool = False


ProgressCallback = Callable[[Progress], None]


class Watcher(Protocol):
    """Something that looks on while an evaluation runs, such as a live view."""

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Called after every simulated step, before runs that failed in it are ended."""


class Lockstep:
    """One agent in one simulation, from the first step or from a checkpoint to the last."""

    def __init__(
        self,
        simulation: Simulation,
        driver: Driver,
        tally: Tally,
        checkpoint: Checkpoint,
        recorder: Recorder,
        limits: TimeLimits,
        progress: ProgressCallback | None,
        watcher: Watcher | None = None,
    ) -> None:
        self._simulation = simulation
        self._driver = driver
        self._tally = tally
        self._checkpoint = checkpoint
        self._recorder = recorder
        self._limits = limits
        self._progress = progress
        self._watcher = watcher
        self._earlier_seconds = 0.0
        self._began = time.perf_counter()
        self._unbooked: tuple[NDArray[np.float64], StepResult] | None = None

    @property
    def wall_seconds(self) -> float:
        """Time of the evaluation, that before an interruption included."""
        return self._earlier_seconds + time.perf_counter() - self._began

    def start(self) -> None:
        """Make the agent ready; when that fails, all of its runs have failed before the first step."""
        self._tally.end(self._driver.start())

    def replay(self, saved: Saved) -> bool:
        """Bring a fresh agent to where ``saved`` left it, and everything else too; false when it decides differently this time."""
        asked = saved.arrays["asked"]
        if (self._tally.alive != (asked > 0)).any():
            return False
        for step in range(saved.step):
            decision = self._driver.decide(step, saved.inputs[step], asked > step)
            if decision.actions.tobytes() != saved.actions[step].tobytes():
                return False
            self._report(step + 1, replaying=True)
        self._simulation.restore(Snapshot.from_bytes(saved.arrays["simulation"].tobytes()))
        self._tally.restore(saved.arrays, saved.facts["ends"])
        self._recorder.restore(saved.arrays, saved.actions)
        self._earlier_seconds = float(saved.facts["wall_seconds"])
        self._began = time.perf_counter()
        self._checkpoint.continue_from(saved)
        return True

    def run(self, observations: NDArray[np.float32], first_step: int) -> None:
        """Take the steps from ``first_step`` on, until the horizon or until no run is left."""
        tally, steps = self._tally, self._simulation.task.steps
        if first_step == 0:
            self._simulation.end(~tally.alive)
            self._recorder.begin(self._simulation)
        self._report(first_step)
        for step in range(first_step, steps):
            if not (tally.all_alive or tally.alive.any()):
                break
            observations = self._step(step, observations)
            if self._checkpoint.due:
                self._keep_books()
                self._save(step + 1)
            self._report(step + 1)
        self._keep_books()

    def _step(self, step: int, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        tally, simulation = self._tally, self._simulation
        inputs = self._driver.inputs(simulation, observations)
        self._driver.ask(step, inputs, tally.alive)
        self._keep_books()
        decision = self._driver.decide(step, inputs, tally.alive)
        tally.asked += tally.alive
        tally.seconds += decision.seconds
        ended = tally.end((*decision.failures, *self._overdue()))
        self._checkpoint.record(inputs, decision.actions)
        if ended:
            simulation.end(ended)
            if not tally.alive.any():
                return observations
        outcome = self._driver.apply(simulation, decision.actions)
        self._unbooked = decision.actions, outcome
        if not outcome.whole:
            simulation.end(self._keep_books())
        return outcome.observations

    def _keep_books(self) -> list[int]:
        """Count, record and show the last step, if that was not done; the rows that could not be simulated end and are returned.

        A step in which none failed is booked when the next question has been put: an agent in a process of its own is thinking then.
        """
        if self._unbooked is None:
            return []
        actions, outcome = self._unbooked
        self._unbooked = None
        ended = self._tally.add(outcome)
        self._recorder.add(actions, self._simulation, outcome)
        if self._watcher is not None:
            self._watcher.add(self._simulation, outcome)
        return ended

    def _overdue(self) -> list[Failure]:
        """Runs whose decisions together took too long."""
        limit, seconds = self._limits.run, self._tally.seconds
        if np.maximum.reduce(seconds) <= limit:
            return []
        late = np.flatnonzero(seconds > limit)
        return [
            Failure(int(row), "timed_out", f"the run's decisions together took longer than their limit of {limit:g} s")
            for row in late
        ]

    def _save(self, step: int) -> None:
        snapshot = np.frombuffer(self._simulation.snapshot().to_bytes(), dtype=np.uint8)
        facts = {"ends": self._tally.ends(), "wall_seconds": self.wall_seconds}
        self._checkpoint.save(step, {**self._tally.arrays(), **self._recorder.arrays(), "simulation": snapshot}, facts)

    def _report(self, step: int, *, replaying: bool = False) -> None:
        if self._progress is not None:
            alive = int(np.count_nonzero(self._tally.alive))
            self._progress(Progress(step, self._simulation.task.steps, alive, len(self._tally.seeds), replaying))
