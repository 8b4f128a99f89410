"""Evaluations between the steps of training, the learning curve that they make, and what a training tells while it runs."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation
from glbench.kernel import make_kernel
from glbench.resources import write_atomically

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize

    from glbench.tasks import TaskSpec
    from glbench.training.settings import EvaluationPlan


CURVE = "learning_curve.csv"
Act = Callable[[NDArray[np.float32]], NDArray[np.floating[Any]]]
"""Actions ``(n, m)`` for observations ``(n, columns)``, within their bounds."""


@dataclass
class TimeAccount:
    """Wall time [s] of a training by what it was spent on, over all its sessions."""

    simulator: float = 0.0
    policy: float = 0.0
    learning: float = 0.0
    evaluation: float = 0.0
    saving: float = 0.0

    @property
    def total(self) -> float:
        """All of it [s]."""
        return self.simulator + self.policy + self.learning + self.evaluation + self.saving

    @property
    def training(self) -> float:
        """Simulator, policy and learning [s]: what every training pays, however often it is evaluated and saved."""
        return self.simulator + self.policy + self.learning

    @contextmanager
    def spend(self, on: str) -> Iterator[None]:
        """Add the time of a block to what was spent ``on`` something."""
        began = time.perf_counter()
        yield
        setattr(self, on, getattr(self, on) + time.perf_counter() - began)


@dataclass(frozen=True)
class CurvePoint:
    """One point of the learning curve."""

    steps: int
    seconds: float
    """Wall time spent so far [s]."""
    result: ProbeResult
    is_best: bool


@dataclass(frozen=True)
class Progress:
    """Where a training stands."""

    steps: int
    total_steps: int
    """Steps that will be made: those asked for, rounded up to whole rollouts."""
    steps_per_second: float
    """Since this session began; 0 before anything was timed."""
    season_reward: float | None
    """Mean reward of the last seasons of training, with exploration; ``None`` before one has ended."""

    @property
    def seconds_left(self) -> float | None:
        """Time left [s] at this speed, ``None`` when it is not known yet."""
        return None if self.steps_per_second <= 0 else max(0, self.total_steps - self.steps) / self.steps_per_second


class Listener(Protocol):
    """Receives the news of a training; what it does not override, it ignores."""

    def on_progress(self, progress: Progress) -> None:
        """Called about once a second."""
        return

    def on_evaluation(self, point: CurvePoint) -> None:
        """Called after every evaluation."""
        return

    def on_saved(self, steps: int) -> None:
        """Called after every checkpoint."""
        return


@dataclass
class Pace:
    """Steps per second since it was made."""

    first_steps: int
    began: float = field(default_factory=time.perf_counter)

    def rate(self, steps: int) -> float:
        """Steps per second."""
        return (steps - self.first_steps) / max(time.perf_counter() - self.began, 1e-9)


@dataclass(frozen=True)
class ProbeResult:
    """Sums over a season, averaged over the runs; names in ``summed_over``."""

    sums: dict[str, float]

    @property
    def reward(self) -> float:
        """Cumulative reward, by which the best model is chosen."""
        return self.sums["reward"]


def summed_over(task: TaskSpec) -> tuple[str, ...]:
    """What is summed over a season of ``task``: reward and penalty without unit, profit and every line of its ledger in EUR/m2."""
    return ("reward", "epi", "penalty", *(item.name for item in (*task.ledger.earned, *task.ledger.paid)))


def season_sums(simulation: Simulation, seeds: Sequence[int], act: Act) -> dict[str, NDArray[np.float64]]:
    """Sums over one season of every run ``(n,)``; a run that fails counts what it had reached, and the task's charge for the rest."""
    observations = simulation.reset(seeds)
    sums = {name: np.zeros(len(seeds)) for name in summed_over(simulation.task)}
    charge = simulation.task.evaluation.failed_step
    while simulation.over < simulation.n:
        running = ~simulation.ended
        result = simulation.step(act(observations))
        observations = result.observations
        running[[failure.row for failure in result.failed]] = False  # a step that fails is one of the missing
        for name in sums:
            sums[name] += np.where(running, result.quantities[name], 0.0)
    missing = simulation.task.steps - simulation.k
    for name in ("reward", "epi", "penalty"):
        sums[name] += missing * getattr(charge, name)
    return sums


class Probe:
    """Evaluates a model on seeds of its own; leaves its random numbers and its normalisation as they are."""

    def __init__(self, task: TaskSpec, plan: EvaluationPlan, kernel_preset: str) -> None:
        self.seeds = plan.seeds(task)
        kernel = make_kernel(task.model_value, task.step_seconds, preset=kernel_preset)
        self._simulation = Simulation(task, len(self.seeds), kernel)

    def run(self, model: BaseAlgorithm, normalization: VecNormalize) -> ProbeResult:
        """Mean sums over one season a seed."""
        memory, first = None, np.ones(len(self.seeds), dtype=np.bool_)

        def act(observations: NDArray[np.float32]) -> NDArray[np.floating[Any]]:
            nonlocal memory, first
            actions, memory = model.predict(
                normalization.normalize_obs(observations), state=memory, episode_start=first, deterministic=True
            )
            first = np.zeros(len(self.seeds), dtype=np.bool_)
            return actions

        return self.of(act)

    def of(self, act: Act) -> ProbeResult:
        """The same of whatever acts."""
        sums = season_sums(self._simulation, self.seeds, act)
        return ProbeResult({name: float(values.mean()) for name, values in sums.items()})


@dataclass
class History:
    """What a training has been through: its learning curve, its best evaluation, its time."""

    curve: list[dict[str, float]] = field(default_factory=list)
    best_reward: float = float("-inf")
    best_steps: int = 0
    next_evaluation: int = 0
    ends: list[int] = field(default_factory=list)
    """Steps at which the training was finished, the last end included."""
    sessions: list[str] = field(default_factory=list)
    """With which versions it went on, and from which step, wherever they changed."""
    time: TimeAccount = field(default_factory=TimeAccount)

    @property
    def last_reward(self) -> float:
        """Return of the last evaluation."""
        return self.curve[-1]["reward"]

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> History:
        """What ``asdict`` made of a history."""
        return cls(**{**content, "time": TimeAccount(**content["time"])})

    def add(self, steps: int, result: ProbeResult, every: int) -> CurvePoint:
        """Book an evaluation after ``steps``, the best so far or not; the next one is due ``every`` steps later."""
        if steps >= self.next_evaluation:  # an end between two evaluations does not shift them
            self.next_evaluation = steps + every
        is_best = result.reward > self.best_reward
        if is_best:
            self.best_reward, self.best_steps = result.reward, steps
        seconds = self.time.total
        self.curve.append({"steps": steps, "seconds": round(seconds, 1), "best": int(is_best), **result.sums})
        return CurvePoint(steps, seconds, result, is_best)

    def write_curve(self, folder: Path) -> None:
        """Write the learning curve to ``folder``."""
        text = io.StringIO()
        writer = csv.DictWriter(text, list(self.curve[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows({key: f"{value:.10g}" for key, value in point.items()} for point in self.curve)
        write_atomically(folder / CURVE, text.getvalue())
