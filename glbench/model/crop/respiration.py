"""Growth and maintenance respiration of the organs. Source: Vanthoor (2011) eqs 9.43-9.45."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.crop.allocation import Allocation
from glbench.model.expressions import Expr, exp
from glbench.model.parameters import TomatoParameters
from glbench.model.quantities import Quantity
from glbench.model.states import TomatoState


class Respiration(NamedTuple):
    """Carbohydrates respired."""

    mc_buf_air: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, growth respiration of all organs, from the buffer")]
    mc_leaf_air: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, maintenance respiration of the leaves")]
    mc_stem_air: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, maintenance respiration of the stems")]
    mc_fruit_air: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, maintenance respiration of the fruit")]
    mc_org_air: Annotated[Expr, Quantity("mg m-2 s-1", "CH2O, maintenance respiration of all organs")]


def maintenance_level(x: TomatoState, p: TomatoParameters) -> Expr:
    """Maintenance relative to an old organ at 25 °C [-], doubling every 10 K for ``q10m = 2``. Vanthoor (2011) eq. 9.45."""
    return (1 - exp(-p.c_rgr * p.rgr)) * p.q10m ** (0.1 * (x.t_can24 - 25))


def respiration(grown: Allocation, x: TomatoState, p: TomatoParameters) -> Respiration:
    """Growth respiration (eqs 9.43-9.44) and maintenance respiration (eq. 9.45)."""
    level = maintenance_level(x, p)
    leaf = level * p.c_leaf_m * x.c_leaf
    stem = level * p.c_stem_m * x.c_stem
    fruit = level * p.c_fruit_m * x.c_fruit
    return Respiration(
        mc_buf_air=p.c_leaf_g * grown.mc_buf_leaf + p.c_stem_g * grown.mc_buf_stem + p.c_fruit_g * grown.mc_buf_fruit,
        mc_leaf_air=leaf,
        mc_stem_air=stem,
        mc_fruit_air=fruit,
        mc_org_air=leaf + stem + fruit,
    )
