"""Cost of a step of ``glbench.training.make_vec_env``, and of Stable-Baselines3's own ``make_vec_env`` as a multiple of it.

``pytest benchmarks/test_vec_env.py --benchmark-json=vec_env.json`` keeps the figures under ``extra_info``: processor time a row of each,
and the ratio. The two take turns, so that what else the machine does meets both; a ratio below ``LEAST`` fails.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from glbench.kernel import why_not_compiled

pytest.importorskip("stable_baselines3", reason="Stable-Baselines3 is not installed (extra 'train')")

from stable_baselines3.common import env_util

from glbench.training import make_vec_env

TASK = "glbench:glbench/Spring-v1"
STEPS, ROUNDS = 32, 8
LEAST = {8: 5.0, 64: 10.0}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]


@pytest.mark.parametrize("rows", LEAST)
def test_the_native_environment_is_faster_than_one_after_another(rows: int, benchmark: Any) -> None:
    given = {"kernel": "fast"}
    both = {"native": make_vec_env(TASK, rows), "sb3": env_util.make_vec_env(TASK, rows, env_kwargs=given)}
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, rows, 6)).astype(np.float32)
    seconds: dict[str, list[float]] = {name: [] for name in both}
    for env in both.values():
        env.reset()

    def turn() -> None:
        for name, env in both.items():
            began = time.process_time()
            for action in actions:
                env.step(action)
            seconds[name].append(time.process_time() - began)

    benchmark.pedantic(turn, rounds=ROUNDS, warmup_rounds=1)
    ours, theirs = (1e6 * min(times) / (STEPS * rows) for times in seconds.values())
    benchmark.extra_info.update(native_us=ours, sb3_us=theirs, ratio=theirs / ours)
    assert theirs / ours > LEAST[rows]
