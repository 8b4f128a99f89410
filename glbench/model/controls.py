"""The 6 controls u, in the order of the vector. Each is a fraction 0..1 of an installed capacity."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.expressions import Expr
from glbench.model.quantities import Quantity


class Controls(NamedTuple):
    """Position of the actuators. Interlights, grow-pipe heating, side vents, fans and fogging do not exist here."""

    u_boil: Annotated[Expr, Quantity("-", "boiler valve: heat to the rail pipes, 1 = pBoil")]
    u_co2: Annotated[Expr, Quantity("-", "CO2 valve: dosing into the main air, 1 = phiExtCo2")]
    u_th_scr: Annotated[Expr, Quantity("-", "thermal screen, 0 = open, 1 = closed")]
    u_vent: Annotated[Expr, Quantity("-", "roof vents, 0 = closed, 1 = open")]
    u_lamp: Annotated[Expr, Quantity("-", "top lamps, 1 = thetaLampMax")]
    u_bl_scr: Annotated[Expr, Quantity("-", "blackout screen, 0 = open, 1 = closed")]
