"""Far-infrared exchange between all surfaces, the lamps, the pipes and the sky.

Every flux is ``area * emissivity_1 * emissivity_2 * view factor * sigma * (T1^4 - T2^4)`` per floor area, positive from
the first to the second surface. Source: Vanthoor (2011) eqs 8.38-8.39 and table 8.3, Katzin (2021) table 7.4.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

from glbench.model.air import kelvin
from glbench.model.controls import Controls
from glbench.model.disturbances import Disturbances
from glbench.model.expressions import Expr, exp, square
from glbench.model.optics import Optics
from glbench.model.parameters import ClimateParameters
from glbench.model.quantities import Quantity
from glbench.model.states import ClimateState
from glbench.model.variants import Variant

PIPE_HALF_SPACE = 0.49
"""Share of a rail pipe's surface that faces up, and equally down [-]. Vanthoor (2011) table 8.3."""


class LongWave(NamedTuple):
    """Far-infrared fluxes per floor area."""

    r_can_cov_in: Annotated[Expr, Quantity("W m-2", "far-infrared, canopy to inner cover")]
    r_can_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, canopy to sky")]
    r_can_th_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, canopy to thermal screen")]
    r_can_bl_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, canopy to blackout screen")]
    r_can_flr: Annotated[Expr, Quantity("W m-2", "far-infrared, canopy to floor")]
    r_pipe_cov_in: Annotated[Expr, Quantity("W m-2", "far-infrared, rail pipes to inner cover")]
    r_pipe_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, rail pipes to sky")]
    r_pipe_th_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, rail pipes to thermal screen")]
    r_pipe_bl_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, rail pipes to blackout screen")]
    r_pipe_flr: Annotated[Expr, Quantity("W m-2", "far-infrared, rail pipes to floor")]
    r_pipe_can: Annotated[Expr, Quantity("W m-2", "far-infrared, rail pipes to canopy")]
    r_flr_cov_in: Annotated[Expr, Quantity("W m-2", "far-infrared, floor to inner cover")]
    r_flr_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, floor to sky")]
    r_flr_th_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, floor to thermal screen")]
    r_flr_bl_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, floor to blackout screen")]
    r_th_scr_cov_in: Annotated[Expr, Quantity("W m-2", "far-infrared, thermal screen to inner cover")]
    r_th_scr_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, thermal screen to sky")]
    r_bl_scr_th_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, blackout screen to thermal screen")]
    r_bl_scr_cov_in: Annotated[Expr, Quantity("W m-2", "far-infrared, blackout screen to inner cover")]
    r_bl_scr_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, blackout screen to sky")]
    r_cov_e_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, outer cover to sky")]
    r_lamp_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, top lamps to sky")]
    r_lamp_cov_in: Annotated[Expr, Quantity("W m-2", "far-infrared, top lamps to inner cover")]
    r_lamp_th_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, top lamps to thermal screen")]
    r_lamp_bl_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, top lamps to blackout screen")]
    r_fir_lamp_can: Annotated[Expr, Quantity("W m-2", "far-infrared, top lamps to canopy")]
    r_lamp_pipe: Annotated[Expr, Quantity("W m-2", "far-infrared, top lamps to rail pipes")]
    r_fir_lamp_flr: Annotated[Expr, Quantity("W m-2", "far-infrared, top lamps to floor")]
    r_gro_pipe_can: Annotated[Expr, Quantity("W m-2", "far-infrared, grow pipes to canopy")]
    r_int_lamp_sky: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to sky")]
    r_int_lamp_cov_in: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to inner cover")]
    r_int_lamp_th_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to thermal screen")]
    r_int_lamp_bl_scr: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to blackout screen")]
    r_int_lamp_lamp: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to top lamps")]
    r_fir_int_lamp_can: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to canopy")]
    r_int_lamp_pipe: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to rail pipes")]
    r_fir_int_lamp_flr: Annotated[Expr, Quantity("W m-2", "far-infrared, interlights to floor")]


class Views(NamedTuple):
    """How much of the surroundings one surface sees through the others [-]."""

    a_can: Annotated[Expr, Quantity("-", "radiating area of the canopy per floor area")]
    f_fir_gap: Annotated[Expr, Quantity("-", "gaps in the canopy")]
    f_flr_up: Annotated[Expr, Quantity("-", "floor not hidden by rail pipes, seen from above")]
    f_int_lamp_up: Annotated[Expr, Quantity("-", "canopy above the interlights")]
    f_int_lamp_dn: Annotated[Expr, Quantity("-", "canopy below the interlights")]
    tau_top_fir: Annotated[Expr, Quantity("-", "far-infrared transmittance of both screens")]
    tau_i_l: Annotated[Expr, Quantity("-", "far-infrared transmittance of interlight layer and lamp layer")]


def views(lai: Expr, o: Optics, p: ClimateParameters) -> Views:
    """View factors and transmittances. Vanthoor (2011) table 8.3, Katzin (2021) eqs 7.29-7.30.

    The floor's share uses the pipes' own surface, not the derived parameter ``fCanFlr``, which may be set apart from it.
    """
    gap = exp(-p.k_fir * lai)
    return Views(
        a_can=1 - gap,
        f_fir_gap=gap,
        f_flr_up=1 - PIPE_HALF_SPACE * math.pi * p.l_pipe * p.phi_pipe_e,
        f_int_lamp_up=1 - exp(-p.k_int_fir * (1 - p.v_int_lamp_pos) * lai),
        f_int_lamp_dn=1 - exp(-p.k_int_fir * p.v_int_lamp_pos * lai),
        tau_top_fir=o.tau_th_scr_fir_u * o.tau_bl_scr_fir_u,
        tau_i_l=p.tau_int_lamp_fir * p.tau_lamp_fir,
    )


def black_body(temperature: Expr, p: ClimateParameters) -> Expr:
    """Radiation of a black body [W m-2] at a temperature [°C]."""
    return p.sigma * square(square(kelvin(temperature)))


def long_wave(f: Views, x: ClimateState, o: Optics, u: Controls, d: Disturbances, p: ClimateParameters, variant: Variant) -> LongWave:
    """All far-infrared fluxes, in the order of Vanthoor's table 8.3 and Katzin's table 7.4."""
    can, cov_in, cov_e = black_body(x.t_can, p), black_body(x.t_cov_in, p), black_body(x.t_cov_e, p)
    th_scr, bl_scr = black_body(x.t_th_scr, p), black_body(x.t_bl_scr, p)
    flr, pipe, gro_pipe = black_body(x.t_flr, p), black_body(x.t_pipe, p), black_body(x.t_gro_pipe, p)
    lamp, int_lamp, sky = black_body(x.t_lamp, p), black_body(x.t_int_lamp, p), black_body(d.t_sky, p)

    # What a surface below the screens sees of each target above it.
    to_th_scr = p.eps_th_scr_fir * u.u_th_scr * o.tau_bl_scr_fir_u
    to_bl_scr = p.eps_bl_scr_fir * u.u_bl_scr
    to_cov_in = o.eps_cov_fir * f.tau_top_fir
    to_sky = p.eps_sky * o.tau_cov_fir * f.tau_top_fir

    from_can = f.a_can * p.eps_can
    can_up = from_can * p.tau_lamp_fir

    from_pipe = p.a_pipe * p.eps_pipe * PIPE_HALF_SPACE
    pipe_up = from_pipe * f.tau_i_l * f.f_fir_gap
    # Row 10: the published code leaves the blackout screen out between pipe and sky.
    pipe_screens = f.tau_top_fir if variant.blackout_screen_hides_sky_from_pipe else o.tau_th_scr_fir_u

    flr_up = p.eps_flr * f.tau_i_l * f.f_flr_up * f.f_fir_gap
    from_bl_scr = u.u_bl_scr * p.eps_bl_scr_fir
    from_lamp_up = p.a_lamp * p.eps_lamp_top
    from_lamp_dn = p.a_lamp * p.eps_lamp_bottom
    lamp_below_canopy = from_lamp_dn * p.tau_int_lamp_fir * f.f_fir_gap
    from_int_lamp = p.a_int_lamp * p.eps_int_lamp
    int_lamp_up = from_int_lamp * p.tau_lamp_fir * (1 - f.f_int_lamp_up)
    int_lamp_dn = from_int_lamp * (1 - f.f_int_lamp_dn)
    return LongWave(
        r_can_cov_in=can_up * to_cov_in * (can - cov_in),
        r_can_sky=can_up * to_sky * (can - sky),
        r_can_th_scr=can_up * to_th_scr * (can - th_scr),
        r_can_bl_scr=can_up * to_bl_scr * (can - bl_scr),
        r_can_flr=from_can * p.eps_flr * p.f_can_flr * (can - flr),
        r_pipe_cov_in=pipe_up * to_cov_in * (pipe - cov_in),
        r_pipe_sky=pipe_up * p.eps_sky * o.tau_cov_fir * pipe_screens * (pipe - sky),
        r_pipe_th_scr=pipe_up * to_th_scr * (pipe - th_scr),
        r_pipe_bl_scr=pipe_up * to_bl_scr * (pipe - bl_scr),
        r_pipe_flr=from_pipe * p.eps_flr * (pipe - flr),
        r_pipe_can=from_pipe * p.eps_can * (1 - f.f_fir_gap) * (pipe - can),
        r_flr_cov_in=flr_up * to_cov_in * (flr - cov_in),
        r_flr_sky=flr_up * to_sky * (flr - sky),
        r_flr_th_scr=flr_up * to_th_scr * (flr - th_scr),
        r_flr_bl_scr=flr_up * to_bl_scr * (flr - bl_scr),
        r_th_scr_cov_in=p.eps_th_scr_fir * o.eps_cov_fir * u.u_th_scr * (th_scr - cov_in),
        r_th_scr_sky=p.eps_th_scr_fir * p.eps_sky * o.tau_cov_fir * u.u_th_scr * (th_scr - sky),
        r_bl_scr_th_scr=from_bl_scr * p.eps_th_scr_fir * u.u_th_scr * (bl_scr - th_scr),
        r_bl_scr_cov_in=from_bl_scr * o.eps_cov_fir * o.tau_th_scr_fir_u * (bl_scr - cov_in),
        r_bl_scr_sky=from_bl_scr * p.eps_sky * o.tau_cov_fir * o.tau_th_scr_fir_u * (bl_scr - sky),
        r_cov_e_sky=o.eps_cov_fir * p.eps_sky * (cov_e - sky),
        r_lamp_sky=from_lamp_up * to_sky * (lamp - sky),
        r_lamp_cov_in=from_lamp_up * to_cov_in * (lamp - cov_in),
        r_lamp_th_scr=from_lamp_up * to_th_scr * (lamp - th_scr),
        r_lamp_bl_scr=from_lamp_up * to_bl_scr * (lamp - bl_scr),
        r_fir_lamp_can=from_lamp_dn * p.eps_can * f.a_can * (lamp - can),
        r_lamp_pipe=lamp_below_canopy * p.eps_pipe * (1 - f.f_flr_up) * (lamp - pipe),
        r_fir_lamp_flr=lamp_below_canopy * p.eps_flr * f.f_flr_up * (lamp - flr),
        r_gro_pipe_can=p.a_gro_pipe * p.eps_gro_pipe * p.eps_can * (gro_pipe - can),
        r_int_lamp_sky=int_lamp_up * to_sky * (int_lamp - sky),
        r_int_lamp_cov_in=int_lamp_up * to_cov_in * (int_lamp - cov_in),
        r_int_lamp_th_scr=int_lamp_up * to_th_scr * (int_lamp - th_scr),
        r_int_lamp_bl_scr=int_lamp_up * to_bl_scr * (int_lamp - bl_scr),
        r_int_lamp_lamp=from_int_lamp * from_lamp_dn * (1 - f.f_int_lamp_up) * (int_lamp - lamp),
        r_fir_int_lamp_can=from_int_lamp * p.eps_can * (f.f_int_lamp_dn + f.f_int_lamp_up) * (int_lamp - can),
        r_int_lamp_pipe=int_lamp_dn * p.eps_pipe * (1 - f.f_flr_up) * (int_lamp - pipe),
        r_fir_int_lamp_flr=int_lamp_dn * p.eps_flr * f.f_flr_up * (int_lamp - flr),
    )
