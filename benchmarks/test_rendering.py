"""Cost of a picture of a video in steps of the same environment without pictures.

``pytest benchmarks/test_rendering.py -m slow --benchmark-json=rendering.json`` keeps the figures under ``extra_info``: processor time of
a step and of a picture, and their ratio; one above ``MOST`` fails.
"""

from __future__ import annotations

import time
from typing import Any

import gymnasium
import numpy as np
import pytest

from glbench.kernel import why_not_compiled

pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra 'video')")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(why_not_compiled() is not None, reason=str(why_not_compiled()))]

DAY, ROUNDS, MOST = 96, 8, 50


def test_a_picture_costs_at_most_fifty_steps(benchmark: Any) -> None:
    environment = gymnasium.make("glbench:glbench/Spring-v1", render_mode="rgb_array")
    environment.reset(seed=10_000_000_000)
    actions = iter(np.random.default_rng(0).uniform(-1.0, 1.0, (2 * (ROUNDS + 2) * DAY, 6)).astype(np.float32))
    seconds: dict[str, list[float]] = {"step": [], "picture": []}

    def two_days() -> None:
        began = time.process_time()
        for _ in range(DAY):
            environment.step(next(actions))
        seconds["step"].append((time.process_time() - began) / DAY)
        spent = 0.0
        for _ in range(DAY):
            environment.step(next(actions))
            began = time.process_time()
            environment.render()
            spent += time.process_time() - began
        seconds["picture"].append(spent / DAY)

    benchmark.pedantic(two_days, rounds=ROUNDS, warmup_rounds=2)
    step, picture = (min(spent[2:]) for spent in seconds.values())
    benchmark.extra_info.update(step_us=1e6 * step, picture_ms=1e3 * picture, ratio=picture / step)
    assert picture / step <= MOST
