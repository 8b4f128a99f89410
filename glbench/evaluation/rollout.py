"""The rollout: all runs of an evaluation, step by step together, with their running totals; and going on where one was interrupted."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation, Snapshot, StepResult, season_names
from glbench.episodes import Recorder
from glbench.evaluation.checkpoint import Checkpoint, Saved
from glbench.evaluation.limits import Failure, TimeLimits
from glbench.evaluation.metrics import StepMetrics, with_missing_steps
from glbench.evaluation.records import RunResult, Status
from glbench.evaluation.runners import AgentRunner
from glbench.fields import LONGEST_TEXT
from glbench.kernel.records import all_finite
from glbench.tasks import TaskSpec
from glbench.untrusted import as_one_line


class RunTotals:
    """Books of ``n`` runs of ``task``, one for each of ``seeds``, kept step by step.

    ``totals`` has shape ``(metrics, n)``; ``asked`` ``(n,)`` counts the decisions asked for, ``steps`` ``(n,)`` the simulated steps;
    ``seconds`` ``(n,)`` is the time of the decisions; ``alive`` ``(n,)`` is true for runs that have not failed,
    ``all_alive`` while that is all of them.
    """

    def __init__(self, task: TaskSpec, seeds: tuple[int, ...]) -> None:
        n = len(seeds)
        self.seeds = seeds
        self._task = task
        self._metrics = StepMetrics(task)
        self._seasons = season_names(task, seeds)
        self.totals = np.zeros((len(self._metrics.names), n))
        self.asked = np.zeros(n, dtype=np.int64)
        self.steps = np.zeros(n, dtype=np.int64)
        self.seconds = np.zeros(n)
        self.alive = np.ones(n, dtype=np.bool_)
        self.all_alive = True
        self._ends: dict[int, tuple[Status, str]] = {}

    def end(self, failures: Iterable[Failure]) -> list[int]:
        """End the runs that failed, all that still run where a failure names none; the rows that ended now."""
        ended = []
        for failure in failures:
            rows = range(len(self.seeds)) if failure.row is None else (failure.row,)
            for row in rows:
                if self.alive[row]:
                    self.alive[row] = self.all_alive = False
                    self._ends[row] = (failure.status, as_one_line(failure.reason[:LONGEST_TEXT]))
                    ended.append(row)
        return ended

    def add(self, outcome: StepResult) -> list[int]:
        """Book a simulated step; the rows that could not be simulated end and are returned."""
        values = self._metrics(outcome.table)
        failures = [Failure(failure.row, "simulation_failed", failure.reason) for failure in outcome.failed]
        if not all_finite(values):  # huge values only look broken
            broken = ~np.isfinite(values).all(axis=0)
            for row in np.flatnonzero(broken):
                name = self._metrics.names[int(np.flatnonzero(~np.isfinite(values[:, row]))[0])]
                failures.append(Failure(int(row), "simulation_failed", f"the step's {name} is not a finite number"))
        ended = self.end(failures) if failures else []
        if self.all_alive:
            self.totals += values
        else:
            np.add(self.totals, values, out=self.totals, where=self.alive)
        self.steps += self.alive
        return ended

    def results(self) -> tuple[RunResult, ...]:
        """Every run as a record, missing steps at the task's price."""
        charge = self._task.evaluation.failed_step
        prices = {"reward": charge.reward, "epi": charge.epi, "penalty": charge.penalty}
        failures = []
        for row, seed in enumerate(self.seeds):
            end: tuple[Status, str | None] = self._ends.get(row, ("ok", None))
            status, reason = end
            steps = int(self.steps[row])
            sums = dict(zip(self._metrics.names, self.totals[:, row].tolist(), strict=True))
            metrics = with_missing_steps(sums, self._task.steps - steps, prices)
            failures.append(RunResult(seed=seed, status=status, reason=reason, steps=steps, metrics=metrics, cluster=self._seasons[row]))
        return tuple(failures)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The numbers, for a checkpoint."""
        return {name: getattr(self, name) for name in ("totals", "asked", "steps", "seconds", "alive")}

    def ends(self) -> dict[str, list[str]]:
        """Status and reason by row, for a checkpoint."""
        return {str(row): [status, reason] for row, (status, reason) in self._ends.items()}

    def restore(self, arrays: Mapping[str, NDArray[Any]], ends: Mapping[str, tuple[Status, str]]) -> None:
        """Go back to what ``arrays`` and ``ends`` gave."""
        self.totals = arrays["totals"].copy()
        self.asked, self.steps = arrays["asked"].copy(), arrays["steps"].copy()
        self.seconds, self.alive = arrays["seconds"].copy(), arrays["alive"].copy()
        self.all_alive = bool(self.alive.all())
        self._ends = {int(row): (status, reason) for row, (status, reason) in ends.items()}


@dataclass(frozen=True)
class Progress:
    """Where an evaluation stands: ``step`` of ``steps``, ``alive`` of ``runs`` still running.

    While ``replaying``, an interrupted evaluation repeats the recorded observations to its agent. ``waiting`` is the call that the agent
    answers next (``"loading"``, ``"reset"``, ``"act"``; empty for none), and ``limit`` its time limit [s].
    """

    step: int
    steps: int
    alive: int
    runs: int
    replaying: bool = False
    waiting: str = ""
    limit: float = 0.0


ProgressCallback = Callable[[Progress], None]


class StepCallback(Protocol):
    """Something that looks on while an evaluation runs, such as a live view."""

    def add(self, simulation: Simulation, outcome: StepResult) -> None:
        """Called after every simulated step, before runs that failed in it are ended."""


class RolloutLoop:
    """One agent in one simulation, from the first step or from a checkpoint to the last."""

    def __init__(
        self,
        simulation: Simulation,
        runner: AgentRunner,
        totals: RunTotals,
        checkpoint: Checkpoint,
        recorder: Recorder,
        limits: TimeLimits,
        progress: ProgressCallback | None,
        callback: StepCallback | None = None,
    ) -> None:
        self._simulation = simulation
        self._runner = runner
        self._totals = totals
        self._checkpoint = checkpoint
        self._recorder = recorder
        self._limits = limits
        self._progress = progress
        self._callback = callback
        self._earlier_seconds = 0.0
        self._began = time.perf_counter()
        self._unbooked: tuple[NDArray[np.float64], StepResult] | None = None

    @property
    def wall_seconds(self) -> float:
        """Time of the evaluation, that before an interruption included."""
        return self._earlier_seconds + time.perf_counter() - self._began

    def start(self) -> None:
        """Make the agent ready; when that fails, all of its runs have failed before the first step."""
        limit = self._limits.start * (self._runner.n if self._runner.one_by_one else 1)
        self._report(0, waiting="reset", limit=limit)
        self._totals.end(self._runner.start())

    def replay(self, saved: Saved) -> bool:
        """Bring a fresh agent to where ``saved`` left it, and everything else too; false when it decides differently this time."""
        decisions = saved.arrays["asked"]
        if (self._totals.alive != (decisions > 0)).any():
            return False
        for step in range(saved.step):
            decision = self._runner.decide(step, saved.inputs[step], decisions > step)
            if decision.actions.tobytes() != saved.actions[step].tobytes():
                return False
            self._report(step + 1, replaying=True)
        self._simulation.restore(Snapshot.from_bytes(saved.arrays["simulation"].tobytes()))
        self._totals.restore(saved.arrays, saved.facts["ends"])
        self._recorder.restore(saved.arrays, saved.actions)
        self._earlier_seconds = float(saved.facts["wall_seconds"])
        self._began = time.perf_counter()
        self._checkpoint.continue_from(saved)
        return True

    def run(self, observations: NDArray[np.float32], first_step: int) -> None:
        """Take the steps from ``first_step`` on, until the horizon or until no run is left."""
        totals, steps = self._totals, self._simulation.task.steps
        if first_step == 0:
            self._simulation.end(~totals.alive)
            self._recorder.begin(self._simulation)
        self._report(first_step)
        for step in range(first_step, steps):
            if not (totals.all_alive or totals.alive.any()):
                break
            observations = self._step(step, observations)
            if self._checkpoint.due:
                self._keep_books()
                snapshot = np.frombuffer(self._simulation.snapshot().to_bytes(), dtype=np.uint8)
                facts = {"ends": self._totals.ends(), "wall_seconds": self.wall_seconds}
                arrays = {**self._totals.arrays(), **self._recorder.arrays(), "simulation": snapshot}
                self._checkpoint.save(step + 1, arrays, facts)
            self._report(step + 1)
        self._keep_books()

    def _step(self, step: int, observations: NDArray[np.float32]) -> NDArray[np.float32]:
        totals, simulation = self._totals, self._simulation
        inputs = self._runner.inputs(simulation, observations)
        self._runner.ask(step, inputs, totals.alive)
        self._keep_books()
        decision = self._runner.decide(step, inputs, totals.alive)
        totals.asked += totals.alive
        # Within its limit whatever the clock says: this process may have stood still while the agent answered.
        totals.seconds += np.minimum(decision.seconds, self._limits.step)
        limit, failures = self._limits.run, list(decision.failures)
        if np.maximum.reduce(totals.seconds) > limit:
            reason = f"the run's decisions together took longer than their limit of {limit:g} s"
            failures += [Failure(row, "timed_out", reason) for row in np.flatnonzero(totals.seconds > limit).tolist()]
        ended = totals.end(failures)
        self._checkpoint.record(inputs, decision.actions)
        if ended:
            simulation.end(ended)
            if not totals.alive.any():
                return observations
        outcome = self._runner.apply(simulation, decision.actions)
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
        ended = self._totals.add(outcome)
        self._recorder.add(actions, self._simulation, outcome)
        if self._callback is not None:
            self._callback.add(self._simulation, outcome)
        return ended

    def _report(self, step: int, *, replaying: bool = False, waiting: str = "act", limit: float | None = None) -> None:
        if self._progress is not None:
            alive, steps = int(np.count_nonzero(self._totals.alive)), self._simulation.task.steps
            waiting = waiting if alive and step < steps else ""
            limit = (self._limits.step * alive if limit is None else limit) if waiting else 0.0
            self._progress(Progress(step, steps, alive, len(self._totals.seeds), replaying, waiting, limit))
