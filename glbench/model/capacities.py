"""Leaf area, and heat and vapour capacities that depend on the state. The constant ones (air, floor, ...) are in derived.py."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from glbench.model.air import kelvin
from glbench.model.expressions import Expr, cos
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity
from glbench.model.states import ClimateState

COVER_FACE_SHARE = 0.1
"""Share of the cover's heat capacity that each of its two faces has [-]. Vanthoor (2011) eq. 8.21."""


class Capacities(NamedTuple):
    """Leaf area and capacities per floor area."""

    lai: Annotated[Expr, Quantity("m2 m-2", "leaf area index")]
    cap_cov: Annotated[Expr, Quantity("J K-1 m-2", "heat capacity of the cover")]
    cap_cov_e: Annotated[Expr, Quantity("J K-1 m-2", "heat capacity of the cover's outer face")]
    cap_cov_in: Annotated[Expr, Quantity("J K-1 m-2", "heat capacity of the cover's inner face")]
    cap_can: Annotated[Expr, Quantity("J K-1 m-2", "heat capacity of the canopy")]
    cap_vp_air: Annotated[Expr, Quantity("kg m-2 Pa-1", "vapour capacity of the main air")]
    cap_vp_top: Annotated[Expr, Quantity("kg m-2 Pa-1", "vapour capacity of the top air")]


def vapour_capacity(height: Expr, temperature: Expr, p: ClimateParameters) -> Expr:
    """Vapour held by air of a height [m] per pascal [kg m-2 Pa-1]. Vanthoor (2011) eq. 8.25."""
    return p.m_water * height / (p.R * kelvin(temperature))


def capacities(lai: Expr, x: ClimateState, p: ClimateParameters) -> Capacities:
    """Capacities at the leaf area index that the crop shows to the climate. Vanthoor (2011) eqs 8.18-8.25."""
    cover = cos(p.psi * math.pi / 180) * p.h_rf * p.rho_rf * p.c_p_rf
    return Capacities(
        lai=lai,
        cap_cov=cover,
        cap_cov_e=COVER_FACE_SHARE * cover,
        cap_cov_in=COVER_FACE_SHARE * cover,
        cap_can=p.cap_leaf * lai,
        cap_vp_air=vapour_capacity(p.h_air, x.t_air, p),
        cap_vp_top=vapour_capacity(p.h_gh - p.h_air, x.t_top, p),
    )
