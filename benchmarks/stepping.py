"""Two models stepped in turns: greenhouses under walking controls, and what a row of a step costs each."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from docs.accuracy_table import EXACT, make_inputs, run_compiled
from glbench.kernel import Kernel
from glbench.kernel.records import Rows
from glbench.model import get_model

ROWS, ROUNDS = 256, 40

Array = NDArray[np.float64]


def walking(generator: np.random.Generator) -> tuple[Array, Array, Array]:
    """States, controls and weather of ``ROWS`` tomato greenhouses on the way through two days of all months, under controls that walk."""
    inputs = make_inputs("walk", range(12), 2)
    exact, _ = run_compiled(inputs, EXACT)
    states = np.concatenate([inputs.initial[None], exact[:-1]])
    pick = generator.choice(states.shape[0] * 12, ROWS, replace=False)
    x, u, d = (a.reshape(-1, a.shape[2])[pick] for a in (states, inputs.controls, inputs.weather))
    return x, u, d


def ratio_of_costs(pair: Mapping[str, Rows], preset: str, benchmark: Any) -> float:
    """Processor time of a row's step of the second model over that of the first; both join ``extra_info`` [us].

    The two take turns, so that what else the machine does meets both. The best of all turns counts.
    """
    kernels = {model: Kernel(get_model(model), 900.0, preset=preset) for model in pair}
    seconds: dict[str, list[float]] = {model: [] for model in pair}

    def turn() -> None:
        for model, rows in pair.items():
            began = time.process_time()
            kernels[model].step(*rows)
            seconds[model].append(time.process_time() - began)

    benchmark.pedantic(turn, rounds=ROUNDS, warmup_rounds=2)
    first, second = (1e6 * min(times) / ROWS for times in seconds.values())
    benchmark.extra_info.update({f"{model} us": cost for model, cost in zip(pair, (first, second), strict=True)}, ratio=second / first)
    return second / first
