"""What the actuators bring in: lamp power, boiler heat and CO2."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.controls import Controls
from glbench.model.expressions import Expr
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity


class Actuators(NamedTuple):
    """Power and mass flow per floor area at the present control position."""

    q_lamp_in: Annotated[Expr, Quantity("W m-2", "electric power of the top lamps")]
    q_int_lamp_in: Annotated[Expr, Quantity("W m-2", "electric power of the interlights, always 0")]
    h_lamp_cool: Annotated[Expr, Quantity("W m-2", "lamp heat carried out of the greenhouse by active cooling")]
    h_boil_pipe: Annotated[Expr, Quantity("W m-2", "boiler heat to the rail pipes")]
    h_boil_gro_pipe: Annotated[Expr, Quantity("W m-2", "boiler heat to the grow pipes, always 0")]
    mc_ext_air: Annotated[Expr, Quantity("mg m-2 s-1", "CO2 dosed into the main air")]


def actuators(u: Controls, p: ClimateParameters) -> Actuators:
    """Actuator output.

    Lamps: Katzin (2021) eqs 7.8 and 7.34. Boiler: Vanthoor (2011) eq. 8.56. CO2: eq. 8.77. The model has no control for
    interlights (Katzin 2021, eq. 7.15) and grow-pipe heating, so both are 0; their states remain.
    """
    lamp_power = p.theta_lamp_max * u.u_lamp
    return Actuators(
        q_lamp_in=lamp_power,
        q_int_lamp_in=0.0,
        h_lamp_cool=p.eta_lamp_cool * lamp_power,
        h_boil_pipe=u.u_boil * p.p_boil / p.a_flr,
        h_boil_gro_pipe=0.0,
        mc_ext_air=u.u_co2 * p.phi_ext_co2 / p.a_flr,
    )
