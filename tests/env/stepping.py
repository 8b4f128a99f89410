"""What several tests of the environment do alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation, StepResult

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


def walk(seed: int, steps: int, n: int, m: int = 6) -> NDArray[np.float32]:
    """Actions of a random walk, ``(steps, n, m)``; column i is the same for every n."""
    columns = [np.random.default_rng([seed, row]).uniform(-1, 1, (steps, m)) for row in range(n)]
    return np.stack(columns, axis=1).astype(np.float32)


def run(simulation: Simulation, actions: NDArray[np.float32]) -> list[StepResult]:
    """One step for each entry of ``actions``."""
    return [simulation.step(action) for action in actions]
