"""Cost of a served step besides the simulation itself: over HTTP on this machine, with a connection that stays open.

``pytest benchmarks/test_serve.py --benchmark-json=serve.json`` keeps the figures under ``extra_info``: median and 99th percentile of a
served step, the median of the environment's own step, and their difference. The two take turns, so that what else the machine does meets
both; nothing here passes or fails by its time, and that both give the same is tested in ``tests/serve``.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from glbench.env import GreenhouseEnv
from glbench.kernel import why_not_compiled
from glbench.tasks import get_task
from tests.serve.conftest import Client, process_of

pytestmark = [pytest.mark.slow, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]

STEPS, ROUNDS = 200, 10
SEED = 10_000_000_000


def test_a_served_step(benchmark: Any) -> None:
    task = get_task("Spring-v1")
    env = GreenhouseEnv(task)
    env.reset(seed=SEED)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, 6)).astype(np.float32)
    seconds: dict[str, list[float]] = {"served": [], "env": []}
    with process_of("Spring-v1") as (_, address):
        client = Client(int(address.rpartition(":")[2]))
        path = f"/sessions/{client.ok('POST', '/sessions', {'seed': SEED})['session']}/step"

        def turn() -> None:
            for action in actions:
                body = {"action": action.tolist()}
                began = time.perf_counter()
                client.ok("POST", path, body)
                middle = time.perf_counter()
                env.step(action)
                seconds["served"].append(middle - began)
                seconds["env"].append(time.perf_counter() - middle)

        benchmark.pedantic(turn, rounds=ROUNDS, warmup_rounds=1)
        client.connection.close()
    median, late = np.percentile(seconds["served"], [50.0, 99.0]) * 1e3
    own = float(np.median(seconds["env"])) * 1e3
    benchmark.extra_info.update(
        served_median_ms=median,
        served_99th_percentile_ms=late,
        env_median_ms=own,
        overhead_median_ms=median - own,
        overhead_99th_percentile_ms=late - own,
    )
