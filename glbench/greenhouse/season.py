"""A first look at a season in your own greenhouse: a few runs with rules, and what they use and pick."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from glbench.agents.baselines import read_baseline
from glbench.agents.protocol import Agent
from glbench.env import Simulation
from glbench.tasks import TaskSpec, task_card
from glbench.tasks.record import PREVIEW

_FIRST_SEED = 0  # No evaluation uses these seeds


@dataclass(frozen=True)
class Outcome:
    """Means over ``runs`` runs of the split ``split``: the quantities of a run by name, summed over its steps."""

    runs: int
    split: str
    sums: dict[str, float]


def try_season(task: TaskSpec, rules: Path, runs: int = 4) -> Outcome:
    """Run the rules in the folder ``rules`` through validation seasons, or previews of a task without them; never through the test."""
    names = () if task.splits is None else task.splits.names
    split = "validation" if "validation" in names else None if task.preview is None else PREVIEW
    trial = task if split is None else task.in_split(split)
    card = task_card(trial)
    agent = cast(Agent, read_baseline(rules).make(card))  # rules see observations
    simulation = Simulation(trial, runs)
    agent.reset(card, runs)
    observations = simulation.reset(_FIRST_SEED + np.arange(runs))
    sums = np.zeros((len(trial.quantities), runs))
    while simulation.over < runs:
        result = simulation.step(agent.act(observations))
        observations, sums = result.observations, sums + result.table
    return Outcome(runs, split or "training", dict(zip(result.names, sums.mean(axis=1).tolist(), strict=True)))
