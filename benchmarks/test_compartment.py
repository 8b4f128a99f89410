"""Cost of a step of the compartment as measured, as a multiple of the step of the greenhouse with metered harvest, in the same run.

``pytest benchmarks/test_compartment.py --benchmark-json=compartment.json`` keeps the figures under ``extra_info``: processor time a row of
each, and the ratio. The two take turns, so that what else the machine does meets both; a ratio above ``MOST`` fails. Every part of the
compartment is at work.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.stepping import ROWS, ratio_of_costs, walking
from glbench.kernel import Kernel
from glbench.kernel.compiled import availability
from glbench.kernel.records import Rows
from glbench.model import COMPARTMENT, get_model

MOST = 1.2
PARTS = {"hecAirMass": 4.0, "etaGlobMass": 0.3, "hecWall": 0.5, "fWall": 5e-4, "tSumTop": 3100.0, "laiTop": 0.6}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def pair() -> dict[str, Rows]:
    """The same greenhouses, published and as a compartment, an hour after they became one. Then all controls move by up to 0.1."""
    generator = np.random.default_rng(0)
    x, u, d = walking(generator)
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
    assert ratio_of_costs(pair, preset, benchmark) < MOST
