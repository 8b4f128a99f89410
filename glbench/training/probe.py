"""Evaluation between the steps of training: whole seasons with the policy as it is, without noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from glbench.env import Simulation
from glbench.kernel import make_kernel

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.training.settings import EvaluationPlan

SUMS = ("reward", "epi", "penalty", "revenue", "cost_heat", "cost_electricity", "cost_co2")
"""What is summed over a season: reward and penalty without unit, money in EUR/m2."""


@dataclass(frozen=True)
class ProbeResult:
    """Sums over a season, averaged over the runs; names in ``SUMS``."""

    sums: dict[str, float]

    @property
    def reward(self) -> float:
        """Cumulative reward, by which the best model is chosen."""
        return self.sums["reward"]


Act = Callable[[NDArray[np.float32]], NDArray[np.floating[Any]]]
"""Actions ``(n, m)`` for observations ``(n, columns)``, within their bounds."""


def season_sums(simulation: Simulation, seeds: Sequence[int], act: Act) -> dict[str, NDArray[np.float64]]:
    """Sums over one season of every run ``(n,)``; a run that fails counts what it had reached, and the task's charge for the rest."""
    observations = simulation.reset(seeds)
    sums = {name: np.zeros(len(seeds)) for name in SUMS}
    charge = simulation.task.evaluation.failed_step
    while simulation.over < simulation.n:
        running = ~simulation.ended
        result = simulation.step(act(observations))
        observations = result.observations
        for name in SUMS:
            sums[name] += np.where(running, result.quantities[name], 0.0)
    missing = simulation.task.steps - simulation.k
    sums["reward"] += missing * charge.reward
    sums["penalty"] += missing * charge.penalty
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
