"""Cost of a decision of predictive control, as a multiple of linearising its 24 hours in the same run.

``pytest benchmarks/test_predictive_control.py --benchmark-json=mpc.json`` keeps the figures under ``extra_info``. Nothing here passes or
fails by its time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from glbench.control import PredictiveController, Scenario
from glbench.kernel.compiled import availability
from glbench.tasks import get_task

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]

HORIZON = 96


def best(run: Callable[[], object]) -> float:
    """Processor time of the fastest of five runs [s]."""
    found = []
    for _ in range(5):
        started = time.process_time()
        run()
        found.append(time.process_time() - started)
    return min(found)


@pytest.mark.parametrize("runs", [1, 8])
@pytest.mark.parametrize("task_id", ["Spring-v1", "Schiphol2010-Delta10-v1"])
def test_a_decision(task_id: str, runs: int, benchmark: Any) -> None:
    task = get_task(task_id)
    scenario = Scenario.of(task, 10_000_000_007)
    states = np.tile(scenario.x0, (runs, 1))
    p = scenario.p if scenario.p.ndim == 1 else scenario.p[0]
    given = (
        states,
        np.zeros((runs, len(scenario.high))),
        scenario.d[:HORIZON],
        p,
        scenario.calendar[: HORIZON + 1],
        task.steps / task.steps_per_day,
    )
    controller = PredictiveController(task, horizon=HORIZON)
    controller.reset(runs, np.tile([0.2, 0.1, 0.5, 0.05, 0.0, 0.0], (HORIZON, 1)))
    controller.decide(*given)
    kernel, s = controller._kernel, controller._states
    plan, own = controller._plan.copy(), p[: controller._parameters]
    linearising = best(lambda: kernel.linearise_trajectory(states[:, :s], plan, scenario.d[:HORIZON], own)) / runs
    benchmark.pedantic(lambda: controller.decide(*given), rounds=5, warmup_rounds=1)
    seconds = best(lambda: controller.decide(*given)) / runs
    benchmark.extra_info.update(ms_per_decision=seconds * 1e3, ms_linearising=linearising * 1e3, ratio_to_linearising=seconds / linearising)
