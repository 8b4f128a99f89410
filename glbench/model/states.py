"""The 28 states x, in the order of the vector."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.expressions import Expr
from glbench.model.quantities import Quantity, table_of


class State(NamedTuple):
    """State of greenhouse and crop; also used for its time derivative (the unit then gains s-1)."""

    co2_air: Annotated[Expr, Quantity("mg m-3", "CO2 density of the main air")]
    co2_top: Annotated[Expr, Quantity("mg m-3", "CO2 density of the top air, above the screens")]
    t_air: Annotated[Expr, Quantity("°C", "temperature of the main air")]
    t_top: Annotated[Expr, Quantity("°C", "temperature of the top air")]
    t_can: Annotated[Expr, Quantity("°C", "temperature of the canopy")]
    t_cov_in: Annotated[Expr, Quantity("°C", "temperature of the cover's inner face")]
    t_cov_e: Annotated[Expr, Quantity("°C", "temperature of the cover's outer face")]
    t_th_scr: Annotated[Expr, Quantity("°C", "temperature of the thermal screen")]
    t_flr: Annotated[Expr, Quantity("°C", "temperature of the floor")]
    t_pipe: Annotated[Expr, Quantity("°C", "temperature of the rail pipes")]
    t_so1: Annotated[Expr, Quantity("°C", "temperature of soil layer 1, the uppermost")]
    t_so2: Annotated[Expr, Quantity("°C", "temperature of soil layer 2")]
    t_so3: Annotated[Expr, Quantity("°C", "temperature of soil layer 3")]
    t_so4: Annotated[Expr, Quantity("°C", "temperature of soil layer 4")]
    t_so5: Annotated[Expr, Quantity("°C", "temperature of soil layer 5, the deepest")]
    vp_air: Annotated[Expr, Quantity("Pa", "vapour pressure of the main air")]
    vp_top: Annotated[Expr, Quantity("Pa", "vapour pressure of the top air")]
    t_lamp: Annotated[Expr, Quantity("°C", "temperature of the top lamps")]
    t_int_lamp: Annotated[Expr, Quantity("°C", "temperature of the interlights, the lamps within the canopy")]
    t_gro_pipe: Annotated[Expr, Quantity("°C", "temperature of the grow pipes, the pipes within the canopy")]
    t_bl_scr: Annotated[Expr, Quantity("°C", "temperature of the blackout screen")]
    t_can24: Annotated[Expr, Quantity("°C", "canopy temperature averaged over about 24 h (first-order low-pass)")]
    c_buf: Annotated[Expr, Quantity("mg m-2", "carbohydrates (CH2O) in the buffer; may be slightly negative at night")]
    c_leaf: Annotated[Expr, Quantity("mg m-2", "carbohydrates (CH2O) in the leaves")]
    c_stem: Annotated[Expr, Quantity("mg m-2", "carbohydrates (CH2O) in stems and roots")]
    c_fruit: Annotated[Expr, Quantity("mg m-2", "carbohydrates (CH2O) in the fruit")]
    t_can_sum: Annotated[Expr, Quantity("°C day", "temperature sum of the canopy")]
    time: Annotated[Expr, Quantity("day", "clock; no equation depends on it")]


STATES = table_of(State)
"""Name, unit and meaning of every state, in the order of the vector."""

STATE_NAMES: tuple[str, ...] = tuple(entry.name for entry in STATES)
