"""Speed of whole evaluations with the rule-based controllers; single environments and batches of them are in ``test_speed.py``.

``uv run --group dev pytest benchmarks/test_environment_step.py --benchmark-json=speed.json`` keeps the figures under
``extra_info``: processor time of an evaluation and of a step. Nothing here passes or fails by its time.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import load_agent
from glbench.env import Simulation
from glbench.episodes import Recorder
from glbench.evaluation.checkpoint import Checkpoint
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.rollout import RolloutLoop, RunTotals
from glbench.evaluation.runners import make_runner
from glbench.kernel import Kernel
from glbench.kernel.compiled import availability
from glbench.model import TOMATO
from glbench.tasks import TaskSpec, get_task, task_card

Array = NDArray[np.float64]

STEPS = 1000

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def task() -> TaskSpec:
    return get_task("Schiphol2010-Delta10-v1")


@pytest.mark.parametrize("agent", ["rule_based", "rule_based_fair"])
def test_thirty_runs_of_sixty_days(task: TaskSpec, agent: str, benchmark: Any) -> None:
    """The evaluation's rollout, with the preset ``standard`` instead of the one that scores are made with."""
    seeds, limits, seconds = tuple(range(666, 696)), TimeLimits(), []

    def run() -> None:
        simulation = Simulation(task, 30, Kernel(TOMATO, 900.0, preset="standard"))
        runner = make_runner(load_agent(agent), task, task_card(task), 30, limits)
        recorder = Recorder(simulation, 6, traced=False)
        rollout = RolloutLoop(simulation, runner, RunTotals(task, seeds), Checkpoint(None, 2.0), recorder, limits, None)
        observations = simulation.reset(seeds)
        rollout.start()
        began = time.process_time()
        rollout.run(observations, 0)
        seconds.append(time.process_time() - began)

    benchmark.pedantic(run, rounds=3)
    benchmark.extra_info.update(processor_seconds=min(seconds), us_per_step=min(seconds) / (30 * task.steps) * 1e6)
