"""Carbohydrates from the buffer to the organs. Source: Vanthoor (2011) eqs 9.24-9.26 and B.1."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.crop.temperature import GrowthInhibition
from glbench.model.expressions import Expr, sigmoid
from glbench.model.parameters import TomatoParameters
from glbench.model.quantities import Quantity
from glbench.model.states import TomatoState

BUFFER_EMPTY_SLOPE = 5e-3
"""Steepness of the stop of growth at an empty buffer [m2 mg-1]. Vanthoor (2011) eq. B.1."""


class Allocation(NamedTuple):
    """Growth of the organs."""

    h_buf_org: Annotated[Expr, Quantity("-", "stop of growth at an empty buffer, 1 = none")]
    mc_buf_leaf: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, buffer to leaves")]
    mc_buf_stem: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, buffer to stems")]
    mc_buf_fruit: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, buffer to fruit")]


def allocation(g: GrowthInhibition, x: TomatoState, p: TomatoParameters) -> Allocation:
    """Growth of leaves, stems (eq. 9.25), fruit (9.24). At an empty buffer ``h_buf_org`` is 0.0067: it may be negative in the dark."""
    h_buf_org = sigmoid(BUFFER_EMPTY_SLOPE * (x.c_buf - p.c_buf_min))
    vegetative = h_buf_org * g.h_t_can24 * g.g_t_can24
    return Allocation(
        h_buf_org=h_buf_org,
        mc_buf_leaf=vegetative * p.rg_leaf,
        mc_buf_stem=vegetative * p.rg_stem,
        mc_buf_fruit=vegetative * g.h_t_can * g.h_t_can_sum * p.rg_fruit,
    )
