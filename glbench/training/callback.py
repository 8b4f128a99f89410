"""What happens beside the learning: clocks, evaluations, checkpoints, progress."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback

from glbench.training.checkpoint import MODEL, NORMALIZATION, History, replaced, save_checkpoint
from glbench.training.curve import add_point, write_curve
from glbench.training.folder import CHECKPOINT
from glbench.training.normalization import Normalizer
from glbench.training.probe import Probe
from glbench.training.progress import Listener, Pace, Progress
from glbench.training.vec_env import TrainingVecEnv

BEST = "best"
_PROGRESS_SECONDS = 1.0


class TrainingCallback(BaseCallback):
    """Called by the algorithm. Everything is done between two rollouts, where a checkpoint can be continued to the bit."""

    def __init__(
        self,
        folder: Path,
        env: TrainingVecEnv,
        normalization: Normalizer,
        probe: Probe,
        history: History,
        *,
        identity: dict[str, Any],
        evaluate_every: int,
        total_steps: int,
        save_seconds: float,
        listeners: Sequence[Listener],
    ) -> None:
        super().__init__()
        self.folder, self.env, self.normalization, self.probe, self.history = folder, env, normalization, probe, history
        self._identity = identity
        self._evaluate_every = evaluate_every
        self._total_steps = total_steps
        self._save_seconds = save_seconds
        self._listeners = listeners
        self._mark = time.perf_counter()
        self._simulator = env.simulator_seconds
        self._saved = time.perf_counter()
        self._told = 0.0
        self._pace: Pace | None = None

    def _on_rollout_start(self) -> None:
        self.history.time.learning += self._lap()
        if self.num_timesteps >= self.history.next_evaluation:
            self._evaluate()
        if time.perf_counter() - self._saved > self._save_seconds:
            self._save()
        if self._pace is None:
            self._pace = Pace(self.num_timesteps)
        self._lap()
        self._simulator = self.env.simulator_seconds

    def _on_rollout_end(self) -> None:
        simulator = self.env.simulator_seconds - self._simulator
        self.history.time.simulator += simulator
        self.history.time.policy += self._lap() - simulator

    def _on_training_start(self) -> None:
        self._lap()

    def _on_step(self) -> bool:
        now = time.perf_counter()
        if now - self._told > _PROGRESS_SECONDS:
            self._told = now
            self._tell()
        return True

    def finish(self) -> None:
        """The evaluation of the last policy, and the last checkpoint."""
        self.history.time.learning += self._lap()
        if not self.history.curve or self.history.curve[-1]["steps"] < self.num_timesteps:
            self._evaluate()
        if self.history.ends[-1:] != [
            self.num_timesteps
        ]:  # a kill may have come between the last checkpoint and the card
            self.history.ends.append(self.num_timesteps)
        self._save()
        self._tell()

    def _lap(self) -> float:
        now = time.perf_counter()
        passed, self._mark = now - self._mark, now
        return passed

    def _evaluate(self) -> None:
        history = self.history
        result = self.probe.run(self.model, self.normalization)
        history.time.evaluation += self._lap()
        if self.num_timesteps >= history.next_evaluation:  # an end between two evaluations moves none
            history.next_evaluation = self.num_timesteps + self._evaluate_every
        point = add_point(history, self.num_timesteps, result)
        if point.is_best:
            self._keep_best()
        write_curve(self.folder, history)
        for name, value in result.sums.items():
            self.logger.record(f"evaluation/{name}", value)
        for listener in self._listeners:
            listener.on_evaluation(point)

    def _keep_best(self) -> None:
        with replaced(self.folder / BEST) as folder:
            self.model.save(folder / MODEL)
            self.normalization.save(str(folder / NORMALIZATION))

    def _save(self) -> None:
        save_checkpoint(
            self.folder / CHECKPOINT, self.model, self.env, self.normalization, self.history, self._identity
        )
        self.history.time.saving += self._lap()
        self._saved = time.perf_counter()
        for listener in self._listeners:
            listener.on_saved(self.num_timesteps)

    def _tell(self) -> None:
        rate = self._pace.rate(self.num_timesteps) if self._pace else 0.0
        seasons = [float(episode["r"]) for episode in self.model.ep_info_buffer or ()]
        mean = sum(seasons) / len(seasons) if seasons else None
        for listener in self._listeners:
            # an algorithm that is neither on-policy nor off-policy may make more steps than it announced
            total = max(self._total_steps, self.num_timesteps)
            listener.on_progress(Progress(self.num_timesteps, total, rate, mean))
