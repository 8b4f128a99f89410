"""Inputs for tests of the model: stored points with reference values, and random physical conditions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from glbench.model import COMPARTMENT, CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES, default_parameters

Array = NDArray[np.float64]


class Inputs(NamedTuple):
    x: Array
    u: Array
    d: Array
    p: Array


@dataclass(frozen=True)
class Points:
    """Rows of inputs, and what the two published definitions of the model give there."""

    inputs: Inputs
    derivative: MappingProxyType[str, Array]
    rate_scale: Array
    auxiliaries: MappingProxyType[str, Array]
    auxiliary_scale: MappingProxyType[str, float]
    category: NDArray[np.str_]

    def of(self, category: str) -> Inputs:
        return Inputs(*(rows[self.category == category] for rows in self.inputs))


@cache
def reference_points() -> Points:
    with np.load(Path(__file__).parents[1] / "golden" / "model_points.npz") as stored:
        names = [str(name) for name in stored["aux_names"]]
        return Points(
            inputs=Inputs(*(stored[name] for name in "xudp")),
            derivative=MappingProxyType({v: stored[f"dxdt_{v}"] for v in ("author", "gl_gym2")}),
            rate_scale=stored["rate_scale"],
            auxiliaries=MappingProxyType(dict(zip(names, stored["aux"].T, strict=True))),
            auxiliary_scale=MappingProxyType(dict(zip(names, stored["aux_scale"].tolist(), strict=True))),
            category=stored["category"],
        )


def a_day() -> Inputs:
    """One stored point in daylight, with the benchmark's parameters."""
    return Inputs(*(rows[0].copy() for rows in reference_points().of("day")))


COMPARTMENT_RANGES = MappingProxyType(
    {
        "tMass": (0.0, 60.0),
        "capMass": (5e3, 5e5),
        "hecAirMass": (0.0, 20.0),
        "etaGlobMass": (0.0, 1.0),
        "hecWall": (0.0, 3.0),
        "fWall": (0.0, 5e-3),
        "tWall": (5.0, 35.0),
        "rhWall": (20.0, 100.0),
        "co2Wall": (350.0, 1500.0),
        "tSumTop": (500.0, 4000.0),
        "tSumTopWidth": (50.0, 500.0),
        "laiTop": (0.0, 1.0),
    }
)
"""State and parameters that a compartment has besides the tomato greenhouse."""


def in_compartment(inputs: Inputs, more: Mapping[str, Any]) -> Inputs:
    """The same conditions in a compartment: rows of inputs, or one, with numbers or columns of ``COMPARTMENT_RANGES``; the meters at 0."""
    states = dict(zip(STATE_NAMES, inputs.x.T, strict=True)) | {"sumMcFruitHar": 0.0, "sumMcExtAir": 0.0, **more}
    values = dict(zip(PARAMETER_NAMES, inputs.p.T, strict=True)) | {**more}
    x, p = (
        np.stack([np.broadcast_to(columns[name], inputs.x.shape[:-1]) for name in names], axis=-1)
        for columns, names in ((states, COMPARTMENT.state_names), (values, COMPARTMENT.parameter_names))
    )
    return Inputs(x, inputs.u, inputs.d, p)


def with_entry(vector: Array, names: tuple[str, ...], **entries: float) -> Array:
    """Copy of a vector with some entries set by name."""
    changed = vector.copy()
    for name, value in entries.items():
        changed[..., names.index(name)] = value
    return changed


_AIR = (5.0, 40.0)
_RANGES = MappingProxyType(
    {
        "co2Air": (200.0, 4000.0),
        "co2Top": (200.0, 4000.0),
        "tCovIn": (-15.0, 40.0),
        "tCovE": (-20.0, 40.0),
        "tPipe": (5.0, 80.0),
        "tLamp": (5.0, 90.0),
        "vpAir": (300.0, 4000.0),
        "vpTop": (300.0, 4000.0),
        "cBuf": (-50.0, 30000.0),
        "cLeaf": (4000.0, 130000.0),
        "cStem": (1000.0, 400000.0),
        "cFruit": (0.0, 3200000.0),
        "tCanSum": (-100.0, 4000.0),
        "time": (0.0, 365.0),
        "iGlob": (0.0, 1100.0),
        "tOut": (-20.0, 38.0),
        "vpOut": (50.0, 3000.0),
        "co2Out": (600.0, 900.0),
        "wind": (0.0, 25.0),
        "tSky": (-50.0, 25.0),
        "tSoOut": (0.0, 18.0),
        "dayRadSum": (0.0, 35.0),
        "isDay": (0.0, 1.0),
        "isDaySmooth": (0.0, 1.0),
    }
)


def _vectors(names: tuple[str, ...], ranges: dict[str, tuple[float, float]]) -> st.SearchStrategy[Array]:
    return st.tuples(*(st.floats(*ranges[name]) for name in names)).map(lambda values: np.array(values))


states = _vectors(STATE_NAMES, {name: _RANGES.get(name, _AIR) for name in STATE_NAMES})
controls = _vectors(CONTROL_NAMES, dict.fromkeys(CONTROL_NAMES, (0.0, 1.0)))
disturbances = _vectors(DISTURBANCE_NAMES, dict(_RANGES))

parameters = st.sampled_from(("benchmark", "hps_2020", "led_2020", "hps_2021", "led_2021", "bleiswijk_2020")).map(default_parameters)
"""Named houses: other lamps, roof, crop limits, radiating grow pipes, convective interlights."""

conditions = st.builds(Inputs, states, controls, disturbances, parameters)

compartments = st.fixed_dictionaries({name: st.floats(*limits) for name, limits in COMPARTMENT_RANGES.items()})
"""Heat stored, neighbours and topping."""
