"""Cost of a step under JAX, as a multiple of the native vector environment's, in the same run.

``pytest benchmarks/test_jax.py --benchmark-json=jax.json`` keeps the figures under ``extra_info``: processor time a row of each, and the
ratio. The two take turns, so that what else the machine does meets both; a ratio above ``MOST`` fails.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from glbench.env import GreenhouseVectorEnv
from glbench.kernel import why_not_compiled

jax = pytest.importorskip("jax", reason="JAX is not installed (extra 'jax')")

from glbench.jax import Environment  # noqa: E402

TASKS = ("glbench/Schiphol2010-Delta10-v1", "glbench/Spring-v1")
STEPS, ROUNDS = 32, 12
MOST = {512: 1.1, 64: 1.3}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]


@pytest.mark.parametrize("rows", MOST)
@pytest.mark.parametrize("task", TASKS)
def test_a_scan_costs_what_the_vector_environment_does(task: str, rows: int, benchmark: Any) -> None:
    environment = Environment(task, seeds=range(10_000, 10_008))
    native = GreenhouseVectorEnv(environment.task, rows, kernel="fast")
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, rows, environment.num_actions)).astype(np.float32)

    def step(state: Any, given: tuple[Any, Any]) -> Any:
        observed, state, reward, done, _ = jax.vmap(environment.step)(jax.random.split(given[0], rows), state, given[1])
        return state, (observed, reward, done)

    scan = jax.jit(lambda state, keys, actions: jax.lax.scan(step, state, (keys, actions)))
    keys = jax.random.split(jax.random.key(0), STEPS)
    _, state = jax.vmap(environment.reset)(jax.random.split(jax.random.key(1), rows))
    native.reset(seed=[environment.seeds[scenario] for scenario in np.asarray(state.scenario)])
    seconds: dict[str, list[float]] = {"jax": [], "native": []}
    given = jax.device_put(actions)

    def turn() -> None:
        nonlocal state
        began = time.process_time()
        state, told = jax.block_until_ready(scan(state, keys, given))
        seconds["jax"].append(time.process_time() - began)
        began = time.process_time()
        for action in actions:
            observed, *_ = native.step(action)
        seconds["native"].append(time.process_time() - began)
        assert np.asarray(told[0][-1]).tobytes() == observed.tobytes()

    benchmark.pedantic(turn, rounds=ROUNDS, warmup_rounds=2)
    ours, theirs = (1e6 * min(times) / (STEPS * rows) for times in seconds.values())
    benchmark.extra_info.update(jax_us=ours, native_us=theirs, ratio=ours / theirs)
    assert ours / theirs < MOST[rows]
