"""The outcome of a training or a search."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from glbench.training.folder import BEST, MODEL


@dataclass(frozen=True)
class Trained:
    """A finished training."""

    folder: Path
    steps: int
    best_reward: float
    best_steps: int
    last_reward: float
    """Evaluation return of the last policy."""
    already_done: bool
    """Whether it was already finished, so that nothing was done."""
    not_exported: str | None = None
    """Why its policy could not be exported to a file for numpy; ``None`` when it was."""

    @classmethod
    def of(cls, folder: Path, card: dict[str, Any], *, already_done: bool, not_exported: str | None = None) -> Trained:
        """What ``folder`` holds, as its card says."""
        steps, best = card["training"]["steps"], card["best"]
        return cls(folder, steps, best["reward"], best["steps"], best["last_reward"], already_done, not_exported)

    @property
    def learnt(self) -> bool:
        """Whether any evaluation was better than the first one, of the policy that the training began with."""
        return self.best_steps > 0

    @property
    def model(self) -> Path:
        """The best policy as Stable-Baselines3 saves it."""
        return self.folder / BEST / MODEL
