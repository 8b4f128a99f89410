"""Parameters that follow from others. They are entries of the vector, so a changed base entry must be carried through."""

from __future__ import annotations

import math

from glbench.model.expressions import Expr, exp, square
from glbench.model.parameters import ClimateParameters, TomatoParameters

BAROMETRIC_TEMPERATURE = 293.15
"""Temperature of the air column in the density at altitude [K]."""

SEA_LEVEL_PRESSURE = 101325.0
"""Air pressure at sea level [Pa]."""

PIPE_HALF_SPACE = 0.49
"""Share of a rail pipe's surface that faces down [-]. Vanthoor (2011) table 8.3."""

QUARTER_PI = 0.25 * math.pi


def pipe_capacity(length: Expr, outer: Expr, inner: Expr, p: ClimateParameters) -> Expr:
    """Heat capacity of water-filled pipes [J K-1 m-2] of a length [m m-2] and diameters [m]. Vanthoor (2011) eq. 8.22."""
    steel = (square(outer) - square(inner)) * p.rho_steel * p.c_p_steel
    water = square(inner) * p.rho_water * p.c_p_water
    return QUARTER_PI * length * (steel + water)


def derived_climate(p: ClimateParameters) -> ClimateParameters:
    """Parameters with every derived entry computed from the base entries.

    Vanthoor (2011) eqs 8.22-8.24 and table 8.3; grow pipes: Katzin (2021) eq. 7.35. The density at altitude rises
    with altitude: the sign in the exponent is that of the source (Vanthoor 2011, eq. 8.24). At sea level it has no effect.
    """
    rho_air_cap = p.rho_air0 * exp(p.g * p.m_air * p.h_elevation / (BAROMETRIC_TEMPERATURE * p.R))
    top_height = p.h_gh - p.h_air
    a_pipe = math.pi * p.l_pipe * p.phi_pipe_e
    return p._replace(
        cap_pipe=pipe_capacity(p.l_pipe, p.phi_pipe_e, p.phi_pipe_i, p),
        rho_air_cap=rho_air_cap,
        cap_air=p.h_air * rho_air_cap * p.c_p_air,
        cap_flr=p.h_flr * p.rho_flr * p.c_p_flr,
        cap_so1=p.h_so1 * p.rho_cp_so,
        cap_so2=p.h_so2 * p.rho_cp_so,
        cap_so3=p.h_so3 * p.rho_cp_so,
        cap_so4=p.h_so4 * p.rho_cp_so,
        cap_so5=p.h_so5 * p.rho_cp_so,
        cap_th_scr=p.h_th_scr * p.rho_th_scr * p.c_p_th_scr,
        cap_top=top_height * rho_air_cap * p.c_p_air,
        cap_bl_scr=p.h_bl_scr * p.rho_bl_scr * p.c_p_bl_scr,
        cap_co2_air=p.h_air,
        cap_co2_top=top_height,
        a_pipe=a_pipe,
        f_can_flr=1 - PIPE_HALF_SPACE * a_pipe,
        pressure=SEA_LEVEL_PRESSURE * (1 - 2.5577e-5 * p.h_elevation) ** 5.25588,
        a_gro_pipe=math.pi * p.l_gro_pipe * p.phi_gro_pipe_e,
        cap_gro_pipe=pipe_capacity(p.l_gro_pipe, p.phi_gro_pipe_e, p.phi_gro_pipe_i, p),
    )


def derived_tomato(p: TomatoParameters) -> TomatoParameters:
    """Parameters of the tomato crop with the derived one, the leaf mass at which leaves are pruned. Vanthoor (2011) eq. 9.46."""
    return p._replace(c_leaf_max=p.lai_max / p.sla)
