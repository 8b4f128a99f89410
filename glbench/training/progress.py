"""What a training tells while it runs, and where its time goes."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from typing import Protocol

from glbench.training.probe import ProbeResult


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

    def as_dict(self) -> dict[str, float]:
        """Seconds by name."""
        return asdict(self)


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
        if self.steps_per_second <= 0:
            return None
        return max(0, self.total_steps - self.steps) / self.steps_per_second


class Listener(Protocol):
    """Whoever wants to know how a training goes."""

    def on_progress(self, progress: Progress) -> None:
        """Called about once a second."""

    def on_evaluation(self, point: CurvePoint) -> None:
        """Called after every evaluation."""

    def on_saved(self, steps: int) -> None:
        """Called after every checkpoint."""


@dataclass
class Pace:
    """Steps per second since it was made."""

    first_steps: int
    began: float = field(default_factory=time.perf_counter)

    def rate(self, steps: int) -> float:
        """Steps per second."""
        return (steps - self.first_steps) / max(time.perf_counter() - self.began, 1e-9)
