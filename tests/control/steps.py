"""Steps of any task with states all over the place, without a kernel, and what an environment reports of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from glbench.control import Scenario
from glbench.env import Simulation, make_accounts
from glbench.kernel import StepFailure
from glbench.tasks import TaskSpec, get_task
from tests.support import shipped_tasks

Floats = NDArray[np.float64]

TASKS = [task.id for task in shipped_tasks()]
VARIED = ("Schiphol2010-Delta10-v1", "Schiphol2010Code-Delta00-v1", "Spring-v1", "Lettuce-v1")
"""A task of each kind of reward."""


def scored(task_id: str) -> TaskSpec:
    """A shipped task, in the split that scores where it has any."""
    task = get_task(task_id)
    return task if task.split is None else task.in_split("test")


class Steps(NamedTuple):
    """Trajectory ``(T + 1, s)`` and ``(T, c)``, the calendar along it, and the environment's quantities ``(quantities, T)``."""

    x: Floats
    u: Floats
    calendar: Floats
    table: Floats


class WildKernel:
    """Steps to states around the start: too cold and too warm, with heads of any weight, meters up and down."""

    def __init__(self, task: TaskSpec, start: Floats, seed: int) -> None:
        self._rng, self._start = np.random.default_rng(seed), start
        accounts = make_accounts(task)
        self._stocks = [place for place in accounts.ledger_states() if start[place] != 0.0]

    def try_step(self, x: Floats, u: Floats, d: Floats, p: Floats) -> tuple[Floats, list[StepFailure]]:
        after = self._start * np.exp(self._rng.normal(0.0, 0.6, x.shape))
        after[:, self._stocks] *= np.exp(self._rng.uniform(0.0, 5.0, (len(x), 1)))
        still = self._start == 0.0
        after[:, still] = x[:, still] + self._rng.normal(0.0, 900.0, (len(x), still.sum()))
        return after, []


def wild_steps(task: TaskSpec, steps: int, seed: int = 3) -> Steps:
    """Steps of the first run of the task with random controls."""
    scenario = Scenario.of(task, task.evaluation.first_seed)
    simulation = Simulation(task, 1, WildKernel(task, scenario.x0, seed))
    simulation.reset([scenario.seed])
    rng = np.random.default_rng(seed)
    x, u, table = [simulation.x[0]], [], []
    for _ in range(steps):
        result = simulation.step_controls(rng.uniform(0.0, 1.0, (1, len(task.model_value.controls))))
        x.append(simulation.x[0])
        u.append(simulation.u[0])
        table.append(result.table[:, 0])
    return Steps(np.array(x), np.array(u), scenario.calendar[: steps + 1], np.array(table).T)
