"""Cost of a step of the compartment as measured, as a multiple of the step of the greenhouse with metered harvest, in the same run.

``pytest benchmarks/test_compartment.py --benchmark-json=compartment.json`` keeps the figures under ``extra_info``: processor time a row of
each, and the ratio. The two take turns, so that what else the machine does meets both; a ratio above ``MOST`` fails. Every part of the
compartment is at work.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from docs.accuracy_table import EXACT, make_inputs, run_compiled
from glbench.kernel import Kernel
from glbench.kernel.compiled import availability
from glbench.kernel.records import Rows
from glbench.model import COMPARTMENT, get_model

ROWS, ROUNDS = 256, 40
MOST = 1.2
PARTS = {"hecAirMass": 4.0, "etaGlobMass": 0.3, "hecWall": 0.5, "fWall": 5e-4, "tSumTop": 3100.0, "laiTop": 0.6}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def pair() -> dict[str, Rows]:
    """The same greenhouses, published and as a compartment, an hour after they became one. Then all controls move by up to 0.1."""
    inputs, generator = make_inputs("walk", range(12), 2), np.random.default_rng(0)
    exact, _ = run_compiled(inputs, EXACT)
    states = np.concatenate([inputs.initial[None], exact[:-1]])
    pick = generator.choice(states.shape[0] * 12, ROWS, replace=False)
    x, u, d = (a.reshape(-1, a.shape[2])[pick] for a in (states, inputs.controls, inputs.weather))
    moved = np.clip(u + generator.uniform(-0.1, 0.1, u.shape), 0.0, 1.0)
    rows = {}
    for model, parts in ((get_model("greenlight-tomato-harvest-1.0.0"), {}), (COMPARTMENT, PARTS)):
        added, p = len(model.states) - x.shape[1], model.parameters.default(overrides=parts)[None]
        start = np.insert(x, 27, np.zeros((added, ROWS)), axis=1)
        if model is COMPARTMENT:
            start[:, model.state_index("tMass")] = start[:, model.state_index("tAir")]
        kernel = Kernel(model, 900.0)
        for _ in range(4):
            start = kernel.step(start, u, d, p)
        rows[model.id] = Rows(start, moved, d, p)
    return rows


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_a_compartment_costs_little(pair: dict[str, Rows], preset: str, benchmark: Any) -> None:
    kernels = {model: Kernel(get_model(model), 900.0, preset=preset) for model in pair}
    seconds: dict[str, list[float]] = {model: [] for model in pair}

    def turn() -> None:
        for model, rows in pair.items():
            began = time.process_time()
            kernels[model].step(*rows)
            seconds[model].append(time.process_time() - began)

    benchmark.pedantic(turn, rounds=ROUNDS, warmup_rounds=2)
    published, compartment = (1e6 * min(times) / ROWS for times in seconds.values())
    benchmark.extra_info.update(published_us=published, compartment_us=compartment, ratio=compartment / published)
    assert compartment / published < MOST
