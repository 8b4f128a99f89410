"""Transpiration of the canopy, limited by stomata and boundary layer: Vanthoor (2011) eqs 8.47-8.52, after Stanghellini (1987)."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.air import saturation_vapour_pressure
from glbench.model.expressions import Expr, fmin, sigmoid, square
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity
from glbench.model.states import ClimateState

CO2_REFERENCE = 200.0
"""CO2 concentration without an effect on the stomata [ppm]. Vanthoor (2011) eq. 8.50."""

CO2_FACTOR_LIMIT = 1.5
"""Largest factor of CO2 on the stomatal resistance [-]. Stanghellini (1987)."""

VAPOUR_FACTOR_LIMIT = 5.8
"""Largest factor of the vapour deficit on the stomatal resistance [-]. Stanghellini (1987)."""


class Transpiration(NamedTuple):
    """Stomatal resistance and the vapour that the canopy gives to the main air."""

    s_rs: Annotated[Expr, Quantity("-", "stomata in daylight (1) or darkness (0)")]
    c_evap3: Annotated[Expr, Quantity("ppm-2", "response of the stomata to CO2")]
    c_evap4: Annotated[Expr, Quantity("Pa-2", "response of the stomata to the vapour deficit")]
    rf_r_can: Annotated[Expr, Quantity("-", "factor of radiation on the stomatal resistance")]
    rf_co2: Annotated[Expr, Quantity("-", "factor of CO2 on the stomatal resistance")]
    vpd_can: Annotated[Expr, Quantity("Pa", "vapour deficit from leaf to main air; negative when leaves get wet")]
    rf_vp: Annotated[Expr, Quantity("-", "factor of the vapour deficit on the stomatal resistance")]
    r_s: Annotated[Expr, Quantity("s m-1", "stomatal resistance")]
    vec_can_air: Annotated[Expr, Quantity("kg m-2 Pa-1 s-1", "vapour exchange coefficient, canopy to main air")]
    mv_can_air: Annotated[Expr, Quantity("kg m-2 s-1", "transpiration, canopy to main air")]
    l_can_air: Annotated[Expr, Quantity("W m-2", "latent heat of the transpiration")]


def transpiration(lai: Expr, r_can: Expr, x: ClimateState, p: ClimateParameters) -> Transpiration:
    """Transpiration at a leaf area index and a radiation above the canopy ``r_can`` [W m-2]. Eqs 8.47-8.52.

    Here, and only here, CO2 is converted to ppm by the fixed factor ``etaMgPpm``.
    """
    s_rs = sigmoid(-p.s_rs_slope * (r_can - p.r_can_sp))
    c_evap3 = p.c_evap3_night * (1 - s_rs) + p.c_evap3_day * s_rs
    c_evap4 = p.c_evap4_night * (1 - s_rs) + p.c_evap4_day * s_rs
    rf_r_can = (r_can + p.c_evap1) / (r_can + p.c_evap2)
    rf_co2 = fmin(CO2_FACTOR_LIMIT, 1 + c_evap3 * square(p.eta_mg_ppm * x.co2_air - CO2_REFERENCE))
    vpd_can = saturation_vapour_pressure(x.t_can) - x.vp_air
    rf_vp = fmin(VAPOUR_FACTOR_LIMIT, 1 + c_evap4 * square(vpd_can))
    r_s = p.r_s_min * rf_r_can * rf_co2 * rf_vp
    vec_can_air = 2 * p.rho_air_cap * p.c_p_air * lai / (p.L * p.gamma_psych * (p.r_b + r_s))
    mv_can_air = vec_can_air * vpd_can
    return Transpiration(
        s_rs=s_rs,
        c_evap3=c_evap3,
        c_evap4=c_evap4,
        rf_r_can=rf_r_can,
        rf_co2=rf_co2,
        vpd_can=vpd_can,
        rf_vp=rf_vp,
        r_s=r_s,
        vec_can_air=vec_can_air,
        mv_can_air=mv_can_air,
        l_can_air=p.L * mv_can_air,
    )
