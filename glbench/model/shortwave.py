"""Short-wave radiation (PAR and NIR) of sun and lamps: what canopy, floor, air and cover absorb.

Source: Vanthoor (2011) section 8.4.2, eqs 8.26-8.37; lamps: Katzin (2020) eqs A14-A22, Katzin (2021) eqs 7.7-7.26.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.actuators import Actuators
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, exp
from glbench.model.optics import Layer, Optics, stack, symmetric
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity


class ShortWave(NamedTuple):
    """Short-wave fluxes per floor area."""

    r_par_gh_sun: Annotated[Expr, Quantity("W m-2", "solar PAR above the canopy")]
    r_par_gh_lamp: Annotated[Expr, Quantity("W m-2", "PAR of the top lamps")]
    r_par_gh_int_lamp: Annotated[Expr, Quantity("W m-2", "PAR of the interlights")]
    r_can_sun: Annotated[Expr, Quantity("W m-2", "solar radiation above the canopy")]
    r_can_lamp: Annotated[Expr, Quantity("W m-2", "PAR and NIR of the top lamps")]
    r_can_int_lamp: Annotated[Expr, Quantity("W m-2", "PAR and NIR of the interlights")]
    r_can: Annotated[Expr, Quantity("W m-2", "radiation above the canopy; opens the stomata")]
    r_par_sun_can: Annotated[Expr, Quantity("W m-2", "PAR, sun to canopy")]
    r_par_lamp_can: Annotated[Expr, Quantity("W m-2", "PAR, top lamps to canopy")]
    r_par_int_lamp_can: Annotated[Expr, Quantity("W m-2", "PAR, interlights to canopy")]
    r_par_sun_flr: Annotated[Expr, Quantity("W m-2", "PAR, sun to floor")]
    r_par_lamp_flr: Annotated[Expr, Quantity("W m-2", "PAR, top lamps to floor")]
    r_par_int_lamp_flr: Annotated[Expr, Quantity("W m-2", "PAR, interlights to floor")]
    a_can_nir: Annotated[Expr, Quantity("-", "share of solar NIR absorbed by the canopy")]
    a_flr_nir: Annotated[Expr, Quantity("-", "share of solar NIR absorbed by the floor")]
    r_nir_sun_can: Annotated[Expr, Quantity("W m-2", "NIR, sun to canopy")]
    r_nir_lamp_can: Annotated[Expr, Quantity("W m-2", "NIR, top lamps to canopy")]
    r_nir_int_lamp_can: Annotated[Expr, Quantity("W m-2", "NIR, interlights to canopy")]
    r_nir_sun_flr: Annotated[Expr, Quantity("W m-2", "NIR, sun to floor")]
    r_nir_lamp_flr: Annotated[Expr, Quantity("W m-2", "NIR, top lamps to floor")]
    r_nir_int_lamp_flr: Annotated[Expr, Quantity("W m-2", "NIR, interlights to floor")]
    r_lamp_air: Annotated[Expr, Quantity("W m-2", "light of the top lamps that ends in the air")]
    r_int_lamp_air: Annotated[Expr, Quantity("W m-2", "light of the interlights that ends in the air")]
    r_glob_sun_air: Annotated[Expr, Quantity("W m-2", "solar radiation absorbed by the construction, given to the air")]
    r_glob_sun_cov_e: Annotated[Expr, Quantity("W m-2", "solar radiation absorbed by the cover")]


SUN_PHOTONS = 4.6
"""Photons of solar PAR for each joule of it [umol J-1]. Vanthoor (2011) table 9.1."""


class Par(NamedTuple):
    """PAR above the canopy by its origin [W m-2]."""

    sun: Expr
    lamp: Expr
    int_lamp: Expr


class Intercepted(NamedTuple):
    """Share of the light of one kind of lamp that canopy and floor absorb [-]."""

    par_canopy: Expr
    par_floor: Expr
    nir_canopy: Expr
    nir_floor: Expr


def light_from_above(lai: Expr, p: ClimateParameters) -> Intercepted:
    """Interception of light that comes from above the canopy, no further reflection by cover and lamps.

    PAR in two passes, down and reflected up by the floor: Vanthoor (2011) eqs 8.26-8.29 and 8.35, Katzin (2021) eq. 7.9.
    NIR in one pass: Katzin (2021) eqs 7.10-7.11. The NIR shares are those of the lamps; for the sun see `solar_nir`.
    """
    par_gap = exp(-p.k1_par * lai)
    nir_gap = exp(-p.k_nir * lai)
    down = (1 - p.rho_can_par) * (1 - par_gap)
    up = par_gap * p.rho_flr_par * (1 - p.rho_can_par) * (1 - exp(-p.k2_par * lai))
    return Intercepted(
        par_canopy=down + up,
        par_floor=(1 - p.rho_flr_par) * par_gap,
        nir_canopy=(1 - p.rho_can_nir) * (1 - nir_gap),
        nir_floor=(1 - p.rho_flr_nir) * nir_gap,
    )


def light_from_within(lai: Expr, p: ClimateParameters) -> Intercepted:
    """Interception of light of the interlights, at a height within the canopy. Katzin (2021) eqs 7.13-7.21."""
    below, above = p.v_int_lamp_pos * lai, (1 - p.v_int_lamp_pos) * lai
    par_to_floor = p.f_int_lamp_down * exp(-p.k1_int_par * below)
    nir_to_floor = p.f_int_lamp_down * exp(-p.k_int_nir * below)
    par_first_pass = 1 - par_to_floor + (p.f_int_lamp_down - 1) * exp(-p.k1_int_par * above)
    nir_first_pass = 1 - nir_to_floor + (p.f_int_lamp_down - 1) * exp(-p.k_int_nir * above)
    par_second_pass = par_to_floor * p.rho_flr_par * (1 - exp(-p.k2_int_par * lai))
    return Intercepted(
        par_canopy=(1 - p.rho_can_par) * (par_first_pass + par_second_pass),
        par_floor=(1 - p.rho_flr_par) * par_to_floor,
        nir_canopy=(1 - p.rho_can_nir) * nir_first_pass,
        nir_floor=(1 - p.rho_flr_nir) * nir_to_floor,
    )


def solar_nir(lai: Expr, o: Optics, p: ClimateParameters) -> Layer:
    """Cover, canopy and floor as one stack for solar NIR. Vanthoor (2011) eqs 8.30-8.32 and p. 213.

    The stack's "transmittance" is what the floor absorbs. As in the source, the cover transmits all that it does not
    reflect: what it absorbs is counted once more in `ShortWave.r_glob_sun_cov_e`.
    """
    gap = exp(-p.k_nir * lai)
    canopy_reflectance = p.rho_can_nir * (1 - gap)
    cover = symmetric(1 - o.rho_cov_nir, o.rho_cov_nir)
    canopy = symmetric(gap, canopy_reflectance)
    floor = symmetric(1 - p.rho_flr_nir, p.rho_flr_nir)
    return stack(stack(cover, canopy), floor)


def par_above(o: Optics, a: Actuators, d: Disturbances, p: ClimateParameters) -> Par:
    """PAR of the sun under the screens, of the top lamps and of the interlights. Vanthoor (2011) eq. 8.26, Katzin (2021) eqs 7.7-7.8."""
    sun_inside = (1 - p.eta_glob_air) * d.i_glob
    return Par(o.tau_cov_par * p.eta_glob_par * sun_inside, p.eta_lamp_par * a.q_lamp_in, p.eta_int_lamp_par * a.q_int_lamp_in)


def photons_of(par: Par, p: ClimateParameters) -> Expr:
    """Photons of PAR that sun and lamps send to the canopy, before it reflects any [umol m-2 s-1]."""
    return SUN_PHOTONS * par.sun + p.zeta_lamp_par * par.lamp + p.zeta_int_lamp_par * par.int_lamp


def short_wave(lai: Expr, o: Optics, a: Actuators, d: Disturbances, p: ClimateParameters) -> ShortWave:
    """All short-wave fluxes. Vanthoor (2011) eqs 8.26-8.37, Katzin (2021) eqs 7.7-7.26."""
    sun_inside = (1 - p.eta_glob_air) * d.i_glob
    par_sun, par_lamp, par_int_lamp = par_above(o, a, d, p)
    nir_lamp = p.eta_lamp_nir * a.q_lamp_in
    nir_int_lamp = p.eta_int_lamp_nir * a.q_int_lamp_in

    top = light_from_above(lai, p)
    inter = light_from_within(lai, p)
    nir = solar_nir(lai, o, p)
    nir_canopy = 1 - nir.transmittance - nir.reflectance_up
    nir_floor = nir.transmittance

    sun = sun_inside * (p.eta_glob_par * o.tau_cov_par + p.eta_glob_nir * o.tau_cov_nir)
    lamp = par_lamp + nir_lamp
    int_lamp = par_int_lamp + nir_int_lamp
    return ShortWave(
        r_par_gh_sun=par_sun,
        r_par_gh_lamp=par_lamp,
        r_par_gh_int_lamp=par_int_lamp,
        r_can_sun=sun,
        r_can_lamp=lamp,
        r_can_int_lamp=int_lamp,
        r_can=sun + lamp + int_lamp,
        r_par_sun_can=par_sun * top.par_canopy,
        r_par_lamp_can=par_lamp * top.par_canopy,
        r_par_int_lamp_can=par_int_lamp * inter.par_canopy,
        r_par_sun_flr=par_sun * top.par_floor,
        r_par_lamp_flr=par_lamp * top.par_floor,
        r_par_int_lamp_flr=par_int_lamp * inter.par_floor,
        a_can_nir=nir_canopy,
        a_flr_nir=nir_floor,
        r_nir_sun_can=sun_inside * p.eta_glob_nir * nir_canopy,
        r_nir_lamp_can=nir_lamp * top.nir_canopy,
        r_nir_int_lamp_can=nir_int_lamp * inter.nir_canopy,
        r_nir_sun_flr=sun_inside * p.eta_glob_nir * nir_floor,
        r_nir_lamp_flr=nir_lamp * top.nir_floor,
        r_nir_int_lamp_flr=nir_int_lamp * inter.nir_floor,
        r_lamp_air=lamp - par_lamp * (top.par_canopy + top.par_floor) - nir_lamp * (top.nir_canopy + top.nir_floor),
        r_int_lamp_air=int_lamp - par_int_lamp * (inter.par_canopy + inter.par_floor) - nir_int_lamp * (inter.nir_canopy + inter.nir_floor),
        r_glob_sun_air=p.eta_glob_air * d.i_glob * (o.tau_cov_par * p.eta_glob_par + (nir_canopy + nir_floor) * p.eta_glob_nir),
        r_glob_sun_cov_e=(o.a_cov_par * p.eta_glob_par + o.a_cov_nir * p.eta_glob_nir) * d.i_glob,
    )
