"""Runs of a task as an agent sees them, and what was true meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glbench.control import Climatology, Outlook, StateEstimator
from glbench.env import Simulation, run_weather
from glbench.tasks import TaskSpec, get_task

Floats = NDArray[np.float64]

SHORT = {
    "Spring-v1": 6,
    "SpringMismatch-v1": 8,
    "Lettuce-v1": 5,
    "Schiphol2010-Delta10-v1": 12,
    "Schiphol2010Code-Delta10-v1": 2,
    "WinterLED-v1": 2,
}
"""Days of the runs."""


class Watched(NamedTuple):
    """Observations ``(T + 1, n, columns)``; states and controls ``(T, n, ...)`` after and in each step; weather ``(n, rows, d)``."""

    task: TaskSpec
    seeds: list[int]
    seen: NDArray[np.float32]
    x: Floats
    u: Floats
    d: Floats
    parameters: Floats


@cache
def short(task_id: str, days: int = 0) -> TaskSpec:
    """A short copy of a shipped task."""
    return get_task(task_id).replace({"id": "my/Short-v1", "weather.days": days or SHORT[task_id]})


@cache
def climatology(task_id: str) -> Climatology:
    """Of ``short``."""
    return Climatology.of(short(task_id))


@cache
def watched(task_id: str, runs: int = 2) -> Watched:
    """Runs of ``short`` in its validation split, whose controls wander."""
    return watch(short(task_id).chosen_on, runs)


def watch(task: TaskSpec, runs: int, shut: tuple[int, ...] = (), seeds: Sequence[int] = ()) -> Watched:
    """Runs of a task, of ``seeds`` or the first: controls wander, but for those in the places ``shut``; ``u`` is what is delivered."""
    seeds = [*seeds] or [10000 + run for run in range(runs)]
    simulation, rng = Simulation(task, runs, kernel="fast"), np.random.default_rng(5)
    seen, x, u = [simulation.reset(seeds)], [], []
    usual = wanted = np.array([0.3, 0.2, 0.5, 0.15, 0.3, 0.2])
    for step in range(task.steps):
        if step % 24 == 0:
            wanted = np.clip(usual + rng.normal(0.0, 0.15, 6), 0.0, 1.0)
            wanted[[*shut]] = 0.0
        near = np.clip((wanted - simulation.commands) / task.actuation.max_change, -1.0, 1.0)
        simulation.step(near)
        seen.append(simulation.observe())
        x.append(simulation.x)
        u.append(simulation.u)
    weather = np.array([run_weather(task, seed).values for seed in seeds])
    return Watched(task, seeds, np.array(seen), np.array(x), np.array(u), weather, task.parameters())


def estimates(given: Watched, climate: Climatology, rows: slice = slice(None)) -> tuple[Floats, Floats]:
    """Estimated states ``(T, n, s)``, and the disturbances that were taken for those of each step ``(T, n, d)``."""
    outlook, estimator = Outlook(given.task, climate), StateEstimator(given.task)
    n = given.seen[0, rows].shape[0]
    outlook.reset(n)
    estimator.reset(n)
    found, past = [], []
    for seen in given.seen[:, rows]:
        outlook.update(seen)
        found.append(estimator.update(seen, outlook.past))
        past.append(outlook.past)
    return np.array(found[1:]), np.array(past[1:])
