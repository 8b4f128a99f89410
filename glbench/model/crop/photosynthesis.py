"""Photosynthesis of the canopy. Source: Vanthoor (2011) eqs 9.10-9.23, after Farquhar et al. (1980)."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.air import co2_ppm, kelvin
from glbench.model.expressions import Expr, exp, sigmoid, sqrt, square
from glbench.model.parameters import TomatoParameters
from glbench.model.quantities import Quantity
from glbench.model.states import TomatoState
from glbench.model.surroundings import Surroundings
from glbench.model.variants import Variant

JOULES_PER_MOL = 1e-3
"""Turns the gas constant from per kmol to per mol [kmol mol-1]."""

REFERENCE_TEMPERATURE = 20.0
"""Temperature at which the CO2 compensation point is that of a single leaf [°C]. Vanthoor (2011) eq. 9.23."""

BUFFER_FULL_SLOPE = 5e-4
"""Steepness of the stop of photosynthesis at a full buffer [m2 mg-1]. Vanthoor (2011) eq. B.1."""

SMOOTH_ELECTRONS = 1e-20
"""Added under the root of the electron transport [umol2 m-4 s-2]: finite slope without light or leaves."""


class Photosynthesis(NamedTuple):
    """Light use of the canopy."""

    par_can: Annotated[Expr, Quantity("umol m-2 s-1", "photons of PAR absorbed by the canopy")]
    j25_can_max: Annotated[Expr, Quantity("umol m-2 s-1", "maximum electron transport of the canopy at 25 °C")]
    gamma: Annotated[Expr, Quantity("ppm", "CO2 compensation point")]
    co2_in_ppm: Annotated[Expr, Quantity("ppm", "CO2 in the main air")]
    co2_stom: Annotated[Expr, Quantity("ppm", "CO2 in the stomata")]
    j_pot: Annotated[Expr, Quantity("umol m-2 s-1", "potential electron transport")]
    j: Annotated[Expr, Quantity("umol m-2 s-1", "electron transport")]
    photo_gross: Annotated[Expr, Quantity("umol m-2 s-1", "gross photosynthesis")]
    photo_resp: Annotated[Expr, Quantity("umol m-2 s-1", "photorespiration")]
    h_air_buf: Annotated[Expr, Quantity("-", "stop of photosynthesis at a full buffer, 1 = none")]
    mc_air_buf: Annotated[Expr, Quantity("mg m-2 s-1", "net photosynthesis: CH2O from air to buffer")]


def potential_electron_transport(at_25: Expr, t_can: Expr, molar: Expr, p: TomatoParameters) -> Expr:
    """Electron transport without limitation by light [umol m-2 s-1] at a canopy temperature [°C].

    ``molar`` is the gas constant [J kmol-1 K-1]. Arrhenius rise, and deactivation at high temperature. Vanthoor (2011) eq. 9.15.
    """
    gas_constant = JOULES_PER_MOL * molar
    t_can_k = kelvin(t_can)
    rise = exp(p.e_j * (t_can_k - p.t25k) / (gas_constant * t_can_k * p.t25k))
    at_reference = 1 + exp((p.S * p.t25k - p.H) / (gas_constant * p.t25k))
    at_canopy = 1 + exp((p.S * t_can_k - p.H) / (gas_constant * t_can_k))
    return at_25 * rise * at_reference / at_canopy


def electron_transport(potential: Expr, photons: Expr, p: TomatoParameters, variant: Variant) -> Expr:
    """Smaller root of ``theta j^2 - (potential + alpha photons) j + potential alpha photons = 0`` [umol m-2 s-1].

    Vanthoor (2011) eq. 9.14. Written as the product of the roots over the larger one, which does not cancel at low light.
    Row 9: the published code adds a guard under the root of the textbook form.
    """
    limit = p.alpha * photons
    total = potential + limit
    guard = variant.electron_transport_guard
    root = sqrt(square(total) - 4 * p.theta * potential * limit + (SMOOTH_ELECTRONS + guard))
    product = 2 * potential * limit
    if guard:
        product = product - guard / (2 * p.theta)
    return product / (total + root)


def photosynthesis(s: Surroundings, x: TomatoState, p: TomatoParameters, variant: Variant) -> Photosynthesis:
    """Photosynthesis of the canopy. Vanthoor (2011) eqs 9.10-9.23; photons of lamps: Katzin (2021) eq. 7.27.

    Needs leaves: the compensation point is proportional to ``1/lai``.
    """
    lai, r, air = s.lai, s.light, s.x
    par_can = p.par_jto_umol_sun * r.r_par_sun_can + s.p.zeta_lamp_par * r.r_par_lamp_can + s.p.zeta_int_lamp_par * r.r_par_int_lamp_can
    j25_can_max = lai * p.j25_leaf_max
    # Eq. 9.23 has j25LeafMax/j25CanMax, which is 1/lai.
    gamma = p.c_gamma * air.t_can / lai + REFERENCE_TEMPERATURE * p.c_gamma * (1 - 1 / lai)
    co2_in_ppm = co2_ppm(air.t_air, air.co2_air)
    co2_stom = p.eta_co2_air_stom * co2_in_ppm
    j_pot = potential_electron_transport(j25_can_max, air.t_can, s.p.R, p)
    j = electron_transport(j_pot, par_can, p, variant)
    photo_gross = j * (co2_stom - gamma) / (4 * (co2_stom + 2 * gamma))
    photo_resp = photo_gross * gamma / co2_stom
    h_air_buf = sigmoid(BUFFER_FULL_SLOPE * (p.c_buf_max - x.c_buf))
    return Photosynthesis(
        par_can=par_can,
        j25_can_max=j25_can_max,
        gamma=gamma,
        co2_in_ppm=co2_in_ppm,
        co2_stom=co2_stom,
        j_pot=j_pot,
        j=j,
        photo_gross=photo_gross,
        photo_resp=photo_resp,
        h_air_buf=h_air_buf,
        mc_air_buf=p.m_ch2o * h_air_buf * (photo_gross - photo_resp),
    )
