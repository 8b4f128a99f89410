"""CO2 carried by the air. Dosing is in actuators.py, uptake by the crop in crop/. Source: Vanthoor (2011) eq. 8.46 and p. 216."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr
from glbench.model.quantities import Quantity
from glbench.model.states import ClimateState
from glbench.model.ventilation import Ventilation


class Co2Transport(NamedTuple):
    """CO2 fluxes per floor area."""

    mc_air_top: Annotated[Expr, Quantity("mg m-2 s-1", "CO2 with the air, main air to top air")]
    mc_top_out: Annotated[Expr, Quantity("mg m-2 s-1", "CO2 with the air, top air to outside")]
    mc_air_out: Annotated[Expr, Quantity("mg m-2 s-1", "CO2 with the air, main air to outside")]


def co2_transport(x: ClimateState, v: Ventilation, d: Disturbances) -> Co2Transport:
    """CO2 carried by each air exchange. Vanthoor (2011) eq. 8.46."""
    return Co2Transport(
        mc_air_top=v.f_scr * (x.co2_air - x.co2_top),
        mc_top_out=v.f_vent_roof * (x.co2_top - d.co2_out),
        mc_air_out=v.f_vent_side * (x.co2_air - d.co2_out),
    )
