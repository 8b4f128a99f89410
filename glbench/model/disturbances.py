"""The 10 disturbances d, in the order of the vector: the weather and what is computed from it."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.expressions import Expr
from glbench.model.quantities import Quantity


class Disturbances(NamedTuple):
    """Conditions outside. The last three serve controllers only; no equation of the model reads them."""

    i_glob: Annotated[Expr, Quantity("W m-2", "global radiation on a horizontal surface")]
    t_out: Annotated[Expr, Quantity("°C", "outside air temperature")]
    vp_out: Annotated[Expr, Quantity("Pa", "outside vapour pressure")]
    co2_out: Annotated[Expr, Quantity("mg m-3", "outside CO2 density")]
    wind: Annotated[Expr, Quantity("m s-1", "wind speed")]
    t_sky: Annotated[Expr, Quantity("°C", "apparent temperature of the sky")]
    t_so_out: Annotated[Expr, Quantity("°C", "soil temperature at 1 to 2 m depth")]
    day_rad_sum: Annotated[Expr, Quantity("MJ m-2 day-1", "radiation sum of the whole calendar day")]
    is_day: Annotated[Expr, Quantity("-", "1 by day, 0 by night, linear in between")]
    is_day_smooth: Annotated[Expr, Quantity("-", "1 by day, 0 by night, sigmoid in between")]
