"""Cost of a step of the greenhouse with cooler, heat pump and buffers, as a multiple of the step without, in the same run.

``pytest benchmarks/test_heat_harvesting.py --benchmark-json=heat.json`` keeps the figures under ``extra_info``: processor time a row of
each, and the ratio. The two take turns, so that what else the machine does meets both; a ratio above ``MOST`` fails.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.stepping import ROWS, ratio_of_costs, walking
from glbench.kernel import Kernel
from glbench.kernel.compiled import availability
from glbench.kernel.records import Rows
from glbench.model import TOMATO_HEAT_PUMP, get_model

MOST = 1.3

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def pair() -> dict[str, Rows]:
    """The same greenhouses, plain and with machines, an hour after the machines were started. Then all controls move by up to 0.1."""
    plain, model = get_model("greenlight-tomato-harvest-1.0.0"), TOMATO_HEAT_PUMP
    generator = np.random.default_rng(0)
    x, u, d = walking(generator)
    machines = np.column_stack([generator.uniform(0.0, 0.3, ROWS), generator.uniform(0.7, 1.0, ROWS), 0.4 * u[:, 0]])
    every = np.hstack([u, machines])
    moved = np.clip(every + generator.uniform(-0.1, 0.1, every.shape), 0.0, 1.0)
    rows = {}
    for one, added in ((plain, 1), (model, 6)):
        p, size = one.parameters.default(), len(one.controls)
        start = np.insert(x, 27, np.zeros((added, ROWS)), axis=1)
        if one is model:
            for name in ("eBufCold", "eBufHot"):
                start[:, one.state_index(name)] = 0.5 * p[one.parameter_names.index(f"{name}Max")]
        kernel = Kernel(one, 900.0)
        for _ in range(4):
            start = kernel.step(start, every[:, :size], d, p[None])
        rows[one.id] = Rows(start, moved[:, :size], d, p[None])
    return rows


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_heat_harvesting_costs_little(pair: dict[str, Rows], preset: str, benchmark: Any) -> None:
    assert ratio_of_costs(pair, preset, benchmark) < MOST
