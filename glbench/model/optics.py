"""Light through the roof, the two screens and the lamp layer; far-infrared transmittance of the screens.

A stack of layers is reduced to one from the top down: the light that bounces between two layers is a geometric series.
Source: Vanthoor (2011) eqs 8.14-8.17 and p. 208-209, Katzin (2020) eqs A4-A13, Katzin (2021) eqs 7.5-7.6.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

from glbench.model.controls import Controls
from glbench.model.expressions import Expr, square
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity


class Layer(NamedTuple):
    """Transmittance and the two reflectances of a layer or of a stack of layers [-]."""

    transmittance: Expr
    reflectance_up: Expr
    """Reflectance seen from above."""
    reflectance_down: Expr
    """Reflectance seen from below."""


class Optics(NamedTuple):
    """Optical properties of everything above the canopy: roof, screens in their present position, and lamps."""

    tau_cov_par: Annotated[Expr, Quantity("-", "PAR transmittance of roof, screens and lamps together")]
    rho_cov_par: Annotated[Expr, Quantity("-", "PAR reflectance of roof, screens and lamps, seen from above")]
    a_cov_par: Annotated[Expr, Quantity("-", "PAR absorptance of roof, screens and lamps")]
    tau_cov_nir: Annotated[Expr, Quantity("-", "NIR transmittance of roof, screens and lamps together")]
    rho_cov_nir: Annotated[Expr, Quantity("-", "NIR reflectance of roof, screens and lamps, seen from above")]
    a_cov_nir: Annotated[Expr, Quantity("-", "NIR absorptance of roof, screens and lamps")]
    tau_cov_fir: Annotated[Expr, Quantity("-", "far-infrared transmittance of the roof")]
    rho_cov_fir: Annotated[Expr, Quantity("-", "far-infrared reflectance of the roof")]
    eps_cov_fir: Annotated[Expr, Quantity("-", "far-infrared emissivity of the roof")]
    tau_th_scr_fir_u: Annotated[Expr, Quantity("-", "far-infrared transmittance at the thermal screen's position")]
    tau_bl_scr_fir_u: Annotated[Expr, Quantity("-", "far-infrared transmittance at the blackout screen's position")]


def stack(upper: Layer, lower: Layer) -> Layer:
    """Two layers seen as one. Vanthoor (2011) eqs 8.14-8.15; from below: Katzin (2020) eq. A6."""
    bounces = 1 / (1 - upper.reflectance_down * lower.reflectance_up)
    return Layer(
        transmittance=upper.transmittance * lower.transmittance * bounces,
        reflectance_up=upper.reflectance_up + square(upper.transmittance) * lower.reflectance_up * bounces,
        reflectance_down=lower.reflectance_down + square(lower.transmittance) * upper.reflectance_down * bounces,
    )


def screen_transmittance(closure: Expr, transmittance: Expr) -> Expr:
    """Transmittance [-] of a partly closed screen. Vanthoor (2011) p. 208 and eq. 8.39."""
    return 1 - closure * (1 - transmittance)


def symmetric(transmittance: Expr, reflectance: Expr) -> Layer:
    """Layer that reflects alike on both sides."""
    return Layer(transmittance, reflectance, reflectance)


def screen(closure: Expr, transmittance: Expr, reflectance: Expr) -> Layer:
    """Partly closed screen: light meets the cloth with the closed share only. Katzin (2021) eq. 7.5."""
    return symmetric(screen_transmittance(closure, transmittance), closure * reflectance)


def cover_optics(u: Controls, p: ClimateParameters) -> Optics:
    """Optical properties at the present screen positions. Vanthoor (2011) eqs 8.14-8.17, Katzin (2021) eqs 7.5-7.6.

    For far-infrared the cover is the roof alone: screens and lamps stand in the single exchanges (longwave.py).
    The roof's emissivity is what it neither transmits nor reflects; the parameter ``epsRfFir`` is not used.
    """
    par = stack(
        stack(
            stack(symmetric(p.tau_rf_par, p.rho_rf_par), screen(u.u_th_scr, p.tau_th_scr_par, p.rho_th_scr_par)),
            screen(u.u_bl_scr, p.tau_bl_scr_par, p.rho_bl_scr_par),
        ),
        symmetric(p.tau_lamp_par, p.rho_lamp_par),
    )
    nir = stack(
        stack(
            stack(symmetric(p.tau_rf_nir, p.rho_rf_nir), screen(u.u_th_scr, p.tau_th_scr_nir, p.rho_th_scr_nir)),
            screen(u.u_bl_scr, p.tau_bl_scr_nir, p.rho_bl_scr_nir),
        ),
        symmetric(p.tau_lamp_nir, p.rho_lamp_nir),
    )
    return Optics(
        tau_cov_par=par.transmittance,
        rho_cov_par=par.reflectance_up,
        a_cov_par=1 - par.transmittance - par.reflectance_up,
        tau_cov_nir=nir.transmittance,
        rho_cov_nir=nir.reflectance_up,
        a_cov_nir=1 - nir.transmittance - nir.reflectance_up,
        tau_cov_fir=p.tau_rf_fir,
        rho_cov_fir=p.rho_rf_fir,
        eps_cov_fir=1 - p.tau_rf_fir - p.rho_rf_fir,
        tau_th_scr_fir_u=screen_transmittance(u.u_th_scr, p.tau_th_scr_fir),
        tau_bl_scr_fir_u=screen_transmittance(u.u_bl_scr, p.tau_bl_scr_fir),
    )
