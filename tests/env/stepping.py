"""What several tests of the environment do alike."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.env import Simulation, StepResult
from glbench.kernel import StepFailure

GOLDEN = Path(__file__).resolve().parents[1] / "golden"


Floats = NDArray[np.float64]


class StillKernel:
    """Nothing moves, but fruit grows by 100 mg m-2 a step; rows for which ``failing`` of their states is true fail."""

    def __init__(self, failing: Callable[[Floats], NDArray[np.bool_]] | None = None) -> None:
        self.failing = failing
        self.calls: list[tuple[Floats, Floats, Floats, Floats]] = []

    def try_step(self, x: Floats, u: Floats, d: Floats, p: Floats) -> tuple[Floats, list[StepFailure]]:
        self.calls.append((x.copy(), u.copy(), d.copy(), p.copy()))
        after = x.copy()
        after[:, 25] += 100.0
        failed = [] if self.failing is None else np.flatnonzero(self.failing(x)).tolist()
        after[failed] = x[failed]
        return after, [StepFailure(row, "the test wanted it") for row in failed]


def walk(seed: int, steps: int, n: int, m: int = 6) -> NDArray[np.float32]:
    """Actions of a random walk, ``(steps, n, m)``; column i is the same for every n."""
    columns = [np.random.default_rng([seed, row]).uniform(-1, 1, (steps, m)) for row in range(n)]
    return np.stack(columns, axis=1).astype(np.float32)


def run(simulation: Simulation, actions: NDArray[np.floating[Any]]) -> list[StepResult]:
    """One step for each entry of ``actions``."""
    return [simulation.step(action) for action in actions]
