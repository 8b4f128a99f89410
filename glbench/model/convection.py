"""Sensible heat by convection and conduction, between air, surfaces, pipes, lamps and soil.

Every flux is ``coefficient * (T1 - T2)`` per floor area, positive from the first to the second.
Source: Vanthoor (2011) eqs 8.4, 8.19, 8.40, 8.78 and table 8.4; lamps and blackout screen: Katzin (2021) eqs 7.31-7.34.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from glbench.model.controls import Controls
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, if_else, magnitude_power
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity
from glbench.model.states import ClimateState
from glbench.model.variants import Variant
from glbench.model.ventilation import Ventilation

COEFFICIENT_UNSTABLE = 1.7
"""Convection at a horizontal surface with warm air below [W m-2 K-1.33]. Vanthoor (2011) table 8.4."""

COEFFICIENT_STABLE = 1.3
"""Convection at a floor colder than the air [W m-2 K-1.25]. Vanthoor (2011) table 8.4."""

EXPONENT_STABLE = 0.25
"""Exponent of the temperature difference at a floor colder than the air [-]. Vanthoor (2011) table 8.4."""

COEFFICIENT_PIPE = 1.99
"""Convection at a pipe [W m-2 K-1.32]. Vanthoor (2011) table 8.4."""

EXPONENT_PIPE = 0.32
"""Exponent of the temperature difference at a pipe [-]. Vanthoor (2011) table 8.4."""

WIND_FLOOR = 1e-15
"""Added to the wind speed [m s-1] under a power: finite slope in the exponent at calm."""


class Convection(NamedTuple):
    """Sensible heat fluxes per floor area, and the exchange coefficients that condensation shares with them."""

    hec_air_th_scr: Annotated[Expr, Quantity("W m-2 K-1", "heat exchange coefficient, main air to thermal screen")]
    hec_air_bl_scr: Annotated[Expr, Quantity("W m-2 K-1", "heat exchange coefficient, main air to blackout screen")]
    hec_top_cov_in: Annotated[Expr, Quantity("W m-2 K-1", "heat exchange coefficient, top air to inner cover")]
    h_can_air: Annotated[Expr, Quantity("W m-2", "sensible heat, canopy to main air")]
    h_air_flr: Annotated[Expr, Quantity("W m-2", "sensible heat, main air to floor")]
    h_air_th_scr: Annotated[Expr, Quantity("W m-2", "sensible heat, main air to thermal screen")]
    h_air_bl_scr: Annotated[Expr, Quantity("W m-2", "sensible heat, main air to blackout screen")]
    h_air_out: Annotated[Expr, Quantity("W m-2", "sensible heat, main air to outside")]
    h_air_top: Annotated[Expr, Quantity("W m-2", "sensible heat, main air to top air")]
    h_th_scr_top: Annotated[Expr, Quantity("W m-2", "sensible heat, thermal screen to top air")]
    h_bl_scr_top: Annotated[Expr, Quantity("W m-2", "sensible heat, blackout screen to top air")]
    h_top_cov_in: Annotated[Expr, Quantity("W m-2", "sensible heat, top air to inner cover")]
    h_top_out: Annotated[Expr, Quantity("W m-2", "sensible heat, top air to outside")]
    h_cov_in_cov_e: Annotated[Expr, Quantity("W m-2", "heat conducted through the cover, inner to outer face")]
    h_cov_e_out: Annotated[Expr, Quantity("W m-2", "sensible heat, outer cover to outside")]
    h_pipe_air: Annotated[Expr, Quantity("W m-2", "sensible heat, rail pipes to main air")]
    h_gro_pipe_air: Annotated[Expr, Quantity("W m-2", "sensible heat, grow pipes to main air")]
    h_lamp_air: Annotated[Expr, Quantity("W m-2", "sensible heat, top lamps to main air")]
    h_int_lamp_air: Annotated[Expr, Quantity("W m-2", "sensible heat, interlights to main air")]
    h_flr_so1: Annotated[Expr, Quantity("W m-2", "heat conducted, floor to soil layer 1")]
    h_so1_so2: Annotated[Expr, Quantity("W m-2", "heat conducted, soil layer 1 to 2")]
    h_so2_so3: Annotated[Expr, Quantity("W m-2", "heat conducted, soil layer 2 to 3")]
    h_so3_so4: Annotated[Expr, Quantity("W m-2", "heat conducted, soil layer 3 to 4")]
    h_so4_so5: Annotated[Expr, Quantity("W m-2", "heat conducted, soil layer 4 to 5")]
    h_so5_so_out: Annotated[Expr, Quantity("W m-2", "heat conducted, soil layer 5 to the outer soil")]


def difference_power(warm: Expr, cold: Expr, exponent: float, variant: Variant) -> Expr:
    """``|warm - cold|^exponent`` [K^exponent]; the published code guards the difference (row 8)."""
    return magnitude_power(warm - cold + variant.temperature_difference_guard, exponent)


def at_horizontal(warm: Expr, cold: Expr, variant: Variant) -> Expr:
    """Coefficient of free convection at a horizontal surface [W m-2 K-1]. Vanthoor (2011) table 8.4.

    Row 1: the exponent is 0.33 as printed; the published code has 1/3.
    """
    return COEFFICIENT_UNSTABLE * difference_power(warm, cold, variant.convection_exponent, variant)


def at_floor(air: Expr, floor: Expr, variant: Variant) -> Expr:
    """Coefficient at the floor [W m-2 K-1]: stronger when the floor is the warmer one. Vanthoor (2011) table 8.4."""
    stable = COEFFICIENT_STABLE * difference_power(air, floor, EXPONENT_STABLE, variant)
    return if_else(floor > air, at_horizontal(floor, air, variant), stable)


def at_pipe(pipe: Expr, air: Expr, length: Expr, diameter: Expr, variant: Variant) -> Expr:
    """Coefficient at pipes of a length [m m-2] and diameter [m], per floor area [W m-2 K-1]. Vanthoor (2011) table 8.4."""
    return COEFFICIENT_PIPE * math.pi * diameter * length * difference_power(pipe, air, EXPONENT_PIPE, variant)


def at_outer_cover(wind: Expr, p: ClimateParameters) -> Expr:
    """Coefficient at the outer face of the cover, per floor area [W m-2 K-1]. Vanthoor (2011) table 8.4."""
    return p.a_cov / p.a_flr * (p.c_hec_out1 + p.c_hec_out2 * (wind + WIND_FLOOR) ** p.c_hec_out3)


def between_layers(upper: Expr, lower: Expr, p: ClimateParameters) -> Expr:
    """Conductance between the middles of two soil layers of a thickness [m] [W m-2 K-1]. Vanthoor (2011) eq. 8.4."""
    return 2 * p.lambda_so / (upper + lower)


def convection(
    lai: Expr, x: ClimateState, v: Ventilation, u: Controls, d: Disturbances, p: ClimateParameters, variant: Variant
) -> Convection:
    """All sensible heat fluxes. Vanthoor (2011) eq. 8.40 and table 8.4, Katzin (2021) eqs 7.31-7.33."""
    hec_air_th_scr = u.u_th_scr * at_horizontal(x.t_air, x.t_th_scr, variant)
    hec_air_bl_scr = u.u_bl_scr * at_horizontal(x.t_air, x.t_bl_scr, variant)
    hec_th_scr_top = u.u_th_scr * at_horizontal(x.t_th_scr, x.t_top, variant)
    hec_bl_scr_top = u.u_bl_scr * at_horizontal(x.t_bl_scr, x.t_top, variant)
    cover_slope = difference_power(x.t_top, x.t_cov_in, variant.convection_exponent, variant)
    hec_top_cov_in = p.c_hec_in * cover_slope * p.a_cov / p.a_flr
    heat_of_air = p.rho_air_cap * p.c_p_air
    rail_pipes = at_pipe(x.t_pipe, x.t_air, p.l_pipe, p.phi_pipe_e, variant)
    grow_pipes = at_pipe(x.t_gro_pipe, x.t_air, p.l_gro_pipe, p.phi_gro_pipe_e, variant)
    floor_soil = 2 / (p.h_flr / p.lambda_flr + p.h_so1 / p.lambda_so)
    return Convection(
        hec_air_th_scr=hec_air_th_scr,
        hec_air_bl_scr=hec_air_bl_scr,
        hec_top_cov_in=hec_top_cov_in,
        h_can_air=2 * p.alfa_leaf_air * lai * (x.t_can - x.t_air),
        h_air_flr=at_floor(x.t_air, x.t_flr, variant) * (x.t_air - x.t_flr),
        h_air_th_scr=hec_air_th_scr * (x.t_air - x.t_th_scr),
        h_air_bl_scr=hec_air_bl_scr * (x.t_air - x.t_bl_scr),
        h_air_out=heat_of_air * v.f_vent_side * (x.t_air - d.t_out),
        h_air_top=heat_of_air * v.f_scr * (x.t_air - x.t_top),
        h_th_scr_top=hec_th_scr_top * (x.t_th_scr - x.t_top),
        h_bl_scr_top=hec_bl_scr_top * (x.t_bl_scr - x.t_top),
        h_top_cov_in=hec_top_cov_in * (x.t_top - x.t_cov_in),
        h_top_out=heat_of_air * v.f_vent_roof * (x.t_top - d.t_out),
        h_cov_in_cov_e=p.lambda_rf / p.h_rf * (x.t_cov_in - x.t_cov_e),
        h_cov_e_out=at_outer_cover(d.wind, p) * (x.t_cov_e - d.t_out),
        h_pipe_air=rail_pipes * (x.t_pipe - x.t_air),
        h_gro_pipe_air=grow_pipes * (x.t_gro_pipe - x.t_air),
        h_lamp_air=p.c_hec_lamp_air * (x.t_lamp - x.t_air),
        h_int_lamp_air=p.c_hec_int_lamp_air * (x.t_int_lamp - x.t_air),
        h_flr_so1=floor_soil * (x.t_flr - x.t_so1),
        h_so1_so2=between_layers(p.h_so1, p.h_so2, p) * (x.t_so1 - x.t_so2),
        h_so2_so3=between_layers(p.h_so2, p.h_so3, p) * (x.t_so2 - x.t_so3),
        h_so3_so4=between_layers(p.h_so3, p.h_so4, p) * (x.t_so3 - x.t_so4),
        h_so4_so5=between_layers(p.h_so4, p.h_so5, p) * (x.t_so4 - x.t_so5),
        h_so5_so_out=between_layers(p.h_so5, p.h_so_out, p) * (x.t_so5 - d.t_so_out),
    )
