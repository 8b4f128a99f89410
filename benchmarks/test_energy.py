"""Cost of a step of the greenhouse with boiler, engine and buffer, as a multiple of the step without, in the same run.

``pytest benchmarks/test_energy.py --benchmark-json=energy.json`` keeps the figures under ``extra_info``: processor time a row of each, and
the ratio. The two take turns, so that what else the machine does meets both; a ratio above ``MOST`` fails.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.stepping import ROWS, ratio_of_costs, walking
from glbench.kernel.compiled import availability
from glbench.kernel.records import Rows
from glbench.model import TOMATO_ENERGY, get_model

MOST = 1.3

pytestmark = [pytest.mark.slow, pytest.mark.skipif(availability() is not None, reason=str(availability()))]


@pytest.fixture(scope="module")
def pair() -> dict[str, Rows]:
    """The same greenhouses under walking controls, plain and with half-full buffers that give the heat of the plain boiler."""
    plain, model = get_model("greenlight-tomato-harvest-1.0.0"), TOMATO_ENERGY
    generator = np.random.default_rng(0)
    x, u, d = walking(generator)
    metered, buffered = (np.insert(x, 27, np.zeros((more, ROWS)), axis=1) for more in (1, 4))
    buffered[:, model.state_index("eBuf")] = 1.65
    engine = generator.uniform(0.7, 1.0, (ROWS, 1))
    return {
        plain.id: Rows(metered, u, d, plain.parameters.default()[None]),
        model.id: Rows(buffered, np.hstack([u, engine, u[:, :1]]), d, model.parameters.default()[None]),
    }


@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_the_energy_system_costs_little(pair: dict[str, Rows], preset: str, benchmark: Any) -> None:
    assert ratio_of_costs(pair, preset, benchmark) < MOST
