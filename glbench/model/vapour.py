"""Water vapour: condensation on screens and cover, transport with the air. Vanthoor (2011) eqs 8.42-8.45, Katzin (2021) eqs 7.39-7.41."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.air import saturation_vapour_pressure
from glbench.model.convection import Convection
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, fmax, sigmoid
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity
from glbench.model.states import ClimateState
from glbench.model.variants import Variant
from glbench.model.ventilation import Ventilation

LEWIS_FACTOR = 6.4e-9
"""Vapour exchange per heat exchange [kg J-1 K Pa-1]. Vanthoor (2011) eq. 8.43."""

CONDENSATION_SLOPE = 0.1
"""Steepness of the smooth switch between no condensation and condensation [Pa-1]. Vanthoor (2011) eq. 8.44."""


class Vapour(NamedTuple):
    """Vapour fluxes per floor area, and the heat that condensation sets free."""

    mv_air_th_scr: Annotated[Expr, Quantity("kg m-2 s-1", "condensation, main air to thermal screen")]
    mv_air_bl_scr: Annotated[Expr, Quantity("kg m-2 s-1", "condensation, main air to blackout screen")]
    mv_top_cov_in: Annotated[Expr, Quantity("kg m-2 s-1", "condensation, top air to inner cover")]
    mv_air_top: Annotated[Expr, Quantity("kg m-2 s-1", "vapour with the air, main air to top air")]
    mv_top_out: Annotated[Expr, Quantity("kg m-2 s-1", "vapour with the air, top air to outside")]
    mv_air_out: Annotated[Expr, Quantity("kg m-2 s-1", "vapour with the air, main air to outside")]
    l_air_th_scr: Annotated[Expr, Quantity("W m-2", "latent heat, main air to thermal screen")]
    l_air_bl_scr: Annotated[Expr, Quantity("W m-2", "latent heat, main air to blackout screen")]
    l_top_cov_in: Annotated[Expr, Quantity("W m-2", "latent heat, top air to inner cover")]


def condensing_pressure(vapour_pressure: Expr, surface_temperature: Expr) -> Expr:
    """Smooth positive part of the vapour pressure above saturation at a surface [Pa]. Vanthoor (2011) eq. 8.44.

    Linear when the surface is below the dew point, almost 0 otherwise, with a small negative lobe: its minimum, -2.8 Pa,
    is at 12.8 Pa below saturation.
    """
    excess = vapour_pressure - saturation_vapour_pressure(surface_temperature)
    return excess * sigmoid(CONDENSATION_SLOPE * excess)


def condensation(hec: Expr, pressure: Expr) -> Expr:
    """Condensation [kg m-2 s-1] at a heat exchange coefficient [W m-2 K-1] and pressure [Pa]. Vanthoor (2011) eq. 8.43."""
    return LEWIS_FACTOR * hec * pressure


def carried_vapour(flow: Expr, vp_from: Expr, vp_to: Expr, t_from: Expr, t_to: Expr, p: ClimateParameters, variant: Variant) -> Expr:
    """Vapour in an air exchange [m3 m-2 s-1] [kg m-2 s-1], eq. 8.45. Rows 4, 5: the published code rounds ``mWater/R`` and 273.15."""
    factor = p.m_water / p.R if variant.vapour_flow_factor is None else variant.vapour_flow_factor
    zero = variant.vapour_flow_celsius_zero
    return factor * flow * (vp_from / (t_from + zero) - vp_to / (t_to + zero))


def vapour(x: ClimateState, v: Ventilation, h: Convection, d: Disturbances, p: ClimateParameters, variant: Variant) -> Vapour:
    """All vapour fluxes apart from transpiration. Vanthoor (2011) eqs 8.42-8.45, Katzin (2021) eqs 7.39-7.41.

    Nothing evaporates from screens and cover to the top air, apart from the small negative lobe of `condensing_pressure`;
    the author's definition removes that lobe at the blackout screen only (row 3).
    """
    at_bl_scr = condensing_pressure(x.vp_air, x.t_bl_scr)
    if not variant.blackout_screen_dries:
        at_bl_scr = fmax(0, at_bl_scr)
    mv_air_th_scr = condensation(h.hec_air_th_scr, condensing_pressure(x.vp_air, x.t_th_scr))
    mv_air_bl_scr = condensation(h.hec_air_bl_scr, at_bl_scr)
    mv_top_cov_in = condensation(h.hec_top_cov_in, condensing_pressure(x.vp_top, x.t_cov_in))
    return Vapour(
        mv_air_th_scr=mv_air_th_scr,
        mv_air_bl_scr=mv_air_bl_scr,
        mv_top_cov_in=mv_top_cov_in,
        mv_air_top=carried_vapour(v.f_scr, x.vp_air, x.vp_top, x.t_air, x.t_top, p, variant),
        mv_top_out=carried_vapour(v.f_vent_roof, x.vp_top, d.vp_out, x.t_top, d.t_out, p, variant),
        mv_air_out=carried_vapour(v.f_vent_side, x.vp_air, d.vp_out, x.t_air, d.t_out, p, variant),
        l_air_th_scr=p.L * mv_air_th_scr,
        l_air_bl_scr=p.L * mv_air_bl_scr,
        l_top_cov_in=p.L * mv_top_cov_in,
    )
