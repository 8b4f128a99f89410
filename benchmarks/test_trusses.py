"""Cost of a step of the greenhouse with trusses in stages, as a multiple of the step with the published crop, in the same run.

``pytest benchmarks/test_trusses.py --benchmark-json=trusses.json`` keeps the figures under ``extra_info``: processor time a row of each,
and the ratio. A ratio above ``MOST`` fails.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.stepping import ROWS, ratio_of_costs, walking
from glbench.kernel import Kernel
from glbench.kernel.compiled import availability
from glbench.kernel.records import Rows
from glbench.model import TOMATO, get_model
from glbench.model.paper import TOMATO_2

MOST = 1.6

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def pair() -> dict[str, Rows]:
    """The same greenhouses an hour after their crop was counted by trusses, or was not. Then all controls move by up to 0.1."""
    generator = np.random.default_rng(0)
    x, u, d = walking(generator)
    moved = np.clip(u + generator.uniform(-0.1, 0.1, u.shape), 0.0, 1.0)
    rows = {}
    for model in (get_model("greenlight-tomato-season-1.0.0"), TOMATO_2):
        p = model.parameters.default()
        start = np.tile(model.start("mature_crop", d[0], 18.0, p), (ROWS, 1))
        for place, name in enumerate(TOMATO.state_names):
            if name != "cFruit":  # that of the stages
                start[:, model.state_index(name)] = x[:, place]
        hands = np.zeros((ROWS, len(model.controls) - u.shape[1]))
        kernel = Kernel(model, 900.0)
        for _ in range(4):
            start = kernel.step(start, np.hstack([u, hands]), d, p[None])
        rows[model.id] = Rows(start, np.hstack([moved, hands]), d, p[None])
    return rows


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_trusses_cost_little(pair: dict[str, Rows], preset: str, benchmark: Any) -> None:
    assert ratio_of_costs(pair, preset, benchmark) < MOST
