"""Cost of an estimate and of an outlook, as multiples of a step of the kernel in the same run.

``pytest benchmarks/test_estimator.py --benchmark-json=estimator.json`` keeps the ratios under ``extra_info``. Nothing here passes or fails
by its time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from glbench.control import Climatology, Outlook, StateEstimator
from glbench.env import Simulation
from glbench.kernel import available
from glbench.tasks import get_task

pytestmark = [pytest.mark.slow, pytest.mark.skipif("compiled" not in available(), reason="no compiled kernel here")]


def seconds(call: Callable[[], object], times: int = 50) -> float:
    """Processor time of one of ``times`` calls."""
    call()
    began = time.process_time()
    for _ in range(times):
        call()
    return (time.process_time() - began) / times


@pytest.mark.parametrize("task_id", ["Spring-v1", "Schiphol2010-Delta10-v1"])
@pytest.mark.parametrize("runs", [1, 8])
def test_update(benchmark: Any, task_id: str, runs: int) -> None:
    task = get_task(task_id)
    simulation = Simulation(task, runs, kernel="fast")
    seen = simulation.reset([20000 + run for run in range(runs)])
    outlook, estimator = Outlook(task, Climatology.of(task)), StateEstimator(task)
    outlook.reset(runs)
    estimator.reset(runs)
    outlook.update(seen)
    estimator.update(seen, outlook.past)
    simulation.step(np.zeros((runs, 6)))
    seen = simulation.observe()
    outlook.update(seen)
    kernel, u, d, p = estimator.kernel, simulation.u, outlook.past, task.parameters()
    step = seconds(lambda: kernel.step(simulation.x, u, d, p), 500)
    benchmark(estimator.update, seen, d)
    of_update = seconds(lambda: estimator.update(seen, d))
    of_outlook = seconds(lambda: outlook.ahead(96))
    benchmark.extra_info.update(
        {"update_ms": 1e3 * of_update, "update_steps": of_update / step, "outlook_ms": 1e3 * of_outlook, "outlook_steps": of_outlook / step}
    )
