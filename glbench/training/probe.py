"""Evaluation between the steps of training: whole seasons with the policy as it is, without noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
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


class Probe:
    """Evaluates a model on seeds of its own; leaves its random numbers and its normalisation as they are."""

    def __init__(self, task: TaskSpec, plan: EvaluationPlan, kernel_preset: str) -> None:
        runs = plan.runs if task.uncertainty.delta else 1
        self.seeds = [plan.first_seed + run for run in range(runs)]
        kernel = make_kernel(task.step_seconds, variant=task.model.variant, preset=kernel_preset)
        self._simulation = Simulation(task, runs, kernel)
        self._steps = task.steps

    def run(self, model: BaseAlgorithm, normalization: VecNormalize) -> ProbeResult:
        """Mean sums over one season a seed; a run that fails counts what it had reached, and the task's charge for the rest."""
        simulation = self._simulation
        observations = simulation.reset(self.seeds)
        sums = {name: np.zeros(len(self.seeds)) for name in SUMS}
        memory, first = None, np.ones(len(self.seeds), dtype=np.bool_)
        charge = simulation.task.evaluation.failed_step
        while not simulation.ended.all():
            running = ~simulation.ended
            actions, memory = model.predict(
                normalization.normalize_obs(observations), state=memory, episode_start=first, deterministic=True
            )
            first = np.zeros(len(self.seeds), dtype=np.bool_)
            result = simulation.step(actions)
            observations = result.observations
            for name in SUMS:
                sums[name] += np.where(running, result.quantities[name], 0.0)
        missing = self._steps - simulation.k
        sums["reward"] += missing * charge.reward
        sums["penalty"] += missing * charge.penalty
        return ProbeResult({name: float(values.mean()) for name, values in sums.items()})
