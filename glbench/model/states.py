"""The states x of the submodels, in the order of their vectors; also used for their time derivatives [unit of the state s-1].

What the integrator needs to know of a state stands beside it: see :class:`glbench.model.quantities.Variable`.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.expressions import Expr
from glbench.model.quantities import Variable


class ClimateState(NamedTuple):
    """The greenhouse: air, canopy, cover, screens, floor, soil, pipes and lamps."""

    co2_air: Annotated[Expr, Variable("mg m-3", "CO2 density of the main air", scale=1000.0, small=1.0)]
    co2_top: Annotated[
        Expr, Variable("mg m-3", "CO2 density of the top air, above the screens", scale=1000.0, small=1.0, balance=0.5, fast=True)
    ]
    t_air: Annotated[Expr, Variable("°C", "temperature of the main air", balance=2.0)]
    t_top: Annotated[Expr, Variable("°C", "temperature of the top air", balance=0.4, fast=True)]
    t_can: Annotated[Expr, Variable("°C", "temperature of the canopy")]
    t_cov_in: Annotated[Expr, Variable("°C", "temperature of the cover's inner face", fast=True)]
    t_cov_e: Annotated[Expr, Variable("°C", "temperature of the cover's outer face", fast=True)]
    t_th_scr: Annotated[Expr, Variable("°C", "temperature of the thermal screen", sharper=0.3, balance=0.3, fast=True)]
    t_flr: Annotated[Expr, Variable("°C", "temperature of the floor")]
    t_pipe: Annotated[Expr, Variable("°C", "temperature of the rail pipes", balance=0.6)]
    t_so1: Annotated[Expr, Variable("°C", "temperature of soil layer 1, the uppermost")]
    t_so2: Annotated[Expr, Variable("°C", "temperature of soil layer 2")]
    t_so3: Annotated[Expr, Variable("°C", "temperature of soil layer 3")]
    t_so4: Annotated[Expr, Variable("°C", "temperature of soil layer 4")]
    t_so5: Annotated[Expr, Variable("°C", "temperature of soil layer 5, the deepest")]
    vp_air: Annotated[Expr, Variable("Pa", "vapour pressure of the main air", scale=1000.0, small=10.0, balance=0.4)]
    vp_top: Annotated[Expr, Variable("Pa", "vapour pressure of the top air", scale=1000.0, small=10.0, balance=0.5, fast=True)]
    t_lamp: Annotated[Expr, Variable("°C", "temperature of the top lamps", fast=True)]
    t_int_lamp: Annotated[Expr, Variable("°C", "temperature of the interlights, the lamps within the canopy")]
    t_gro_pipe: Annotated[Expr, Variable("°C", "temperature of the grow pipes, the pipes within the canopy")]
    t_bl_scr: Annotated[Expr, Variable("°C", "temperature of the blackout screen", sharper=0.3, balance=0.15, fast=True)]


class TomatoState(NamedTuple):
    """The tomato crop."""

    t_can24: Annotated[Expr, Variable("°C", "canopy temperature averaged over about 24 h (first-order low-pass)", balance=1e-3)]
    c_buf: Annotated[
        Expr,
        Variable("mg m-2", "carbohydrates (CH2O) in the buffer; may be slightly negative at night", scale=1e4, small=100.0, balance=0.2),
    ]
    c_leaf: Annotated[Expr, Variable("mg m-2", "carbohydrates (CH2O) in the leaves", scale=1e5, small=100.0)]
    c_stem: Annotated[Expr, Variable("mg m-2", "carbohydrates (CH2O) in stems and roots", scale=1e5, small=100.0)]
    c_fruit: Annotated[Expr, Variable("mg m-2", "carbohydrates (CH2O) in the fruit", scale=1e5, small=100.0)]
    t_can_sum: Annotated[Expr, Variable("°C day", "temperature sum of the canopy", scale=1000.0, balance=1e-3)]


class Clock(NamedTuple):
    """The last state of every greenhouse."""

    time: Annotated[Expr, Variable("day", "clock; no equation depends on it", scale=1000.0)]
