"""The differential equations of the climate: the balance of every compartment of the greenhouse, in the order of the state vector.

Every flux is positive from its first to its second name. Source: Vanthoor (2011) chapter 8, Katzin (2021) chapter 7.
"""

from __future__ import annotations

from typing import NamedTuple

from glbench.model.actuators import Actuators
from glbench.model.capacities import Capacities
from glbench.model.co2 import Co2Transport
from glbench.model.convection import Convection
from glbench.model.longwave import LongWave, Views
from glbench.model.optics import Optics
from glbench.model.parameters import ClimateParameters
from glbench.model.shortwave import ShortWave
from glbench.model.states import ClimateState
from glbench.model.surroundings import AirExchange, CropExchange
from glbench.model.transpiration import Transpiration
from glbench.model.vapour import Vapour
from glbench.model.ventilation import Ventilation

DAY = 86400.0
"""Seconds in a day; also the time constant of the 24-hour mean temperature."""


class ClimateFluxes(NamedTuple):
    """Everything that the balances of the greenhouse are made of, one record a process."""

    optics: Optics
    capacities: Capacities
    actuators: Actuators
    short_wave: ShortWave
    views: Views
    long_wave: LongWave
    ventilation: Ventilation
    convection: Convection
    transpiration: Transpiration
    vapour: Vapour
    co2: Co2Transport


def climate_balances(p: ClimateParameters, f: ClimateFluxes, uptake: CropExchange) -> ClimateState:
    """Time derivative of the states of the greenhouse, in the unit of the state per second; ``uptake`` is what the crop takes.

    The vapour capacities depend on temperature, but as in the source no derivative of them is taken.
    """
    a, cap, s, r, h = f.actuators, f.capacities, f.short_wave, f.long_wave, f.convection
    tr, v, c = f.transpiration, f.vapour, f.co2
    return ClimateState(
        # Vanthoor (2011) eqs 8.12-8.13
        co2_air=(a.mc_ext_air - uptake.mc_air_can - c.mc_air_top - c.mc_air_out) / p.cap_co2_air,
        co2_top=(c.mc_air_top - c.mc_top_out) / p.cap_co2_top,
        # eq. 8.2 and Katzin (2021) eq. 7.1
        t_air=(
            h.h_can_air + h.h_pipe_air + h.h_gro_pipe_air + h.h_lamp_air + h.h_int_lamp_air
            + s.r_glob_sun_air + s.r_lamp_air + s.r_int_lamp_air
            - h.h_air_flr - h.h_air_th_scr - h.h_air_bl_scr - h.h_air_out - h.h_air_top
        ) / p.cap_air,
        # eq. 8.6
        t_top=(h.h_air_top + h.h_th_scr_top + h.h_bl_scr_top - h.h_top_cov_in - h.h_top_out) / p.cap_top,
        # eq. 8.1
        t_can=(
            s.r_par_sun_can + s.r_nir_sun_can + s.r_par_lamp_can + s.r_nir_lamp_can
            + s.r_par_int_lamp_can + s.r_nir_int_lamp_can
            + r.r_fir_lamp_can + r.r_fir_int_lamp_can + r.r_pipe_can + r.r_gro_pipe_can
            - r.r_can_cov_in - r.r_can_flr - r.r_can_sky - r.r_can_th_scr - r.r_can_bl_scr
            - h.h_can_air - tr.l_can_air
        ) / cap.cap_can,
        # eq. 8.7
        t_cov_in=(
            h.h_top_cov_in + v.l_top_cov_in
            + r.r_can_cov_in + r.r_flr_cov_in + r.r_pipe_cov_in + r.r_th_scr_cov_in + r.r_bl_scr_cov_in
            + r.r_lamp_cov_in + r.r_int_lamp_cov_in
            - h.h_cov_in_cov_e
        ) / cap.cap_cov_in,
        # eq. 8.8
        t_cov_e=(s.r_glob_sun_cov_e + h.h_cov_in_cov_e - h.h_cov_e_out - r.r_cov_e_sky) / cap.cap_cov_e,
        # eq. 8.5
        t_th_scr=(
            h.h_air_th_scr + v.l_air_th_scr
            + r.r_can_th_scr + r.r_flr_th_scr + r.r_pipe_th_scr + r.r_bl_scr_th_scr
            + r.r_lamp_th_scr + r.r_int_lamp_th_scr
            - h.h_th_scr_top - r.r_th_scr_cov_in - r.r_th_scr_sky
        ) / p.cap_th_scr,
        # eq. 8.3
        t_flr=(
            h.h_air_flr + s.r_par_sun_flr + s.r_nir_sun_flr + s.r_par_lamp_flr + s.r_nir_lamp_flr
            + s.r_par_int_lamp_flr + s.r_nir_int_lamp_flr
            + r.r_can_flr + r.r_pipe_flr + r.r_fir_lamp_flr + r.r_fir_int_lamp_flr
            - h.h_flr_so1 - r.r_flr_cov_in - r.r_flr_sky - r.r_flr_th_scr - r.r_flr_bl_scr
        ) / p.cap_flr,
        # eq. 8.9
        t_pipe=(
            a.h_boil_pipe + r.r_lamp_pipe + r.r_int_lamp_pipe
            - r.r_pipe_sky - r.r_pipe_cov_in - r.r_pipe_can - r.r_pipe_flr - r.r_pipe_th_scr - r.r_pipe_bl_scr
            - h.h_pipe_air
        ) / p.cap_pipe,
        # eq. 8.4
        t_so1=(h.h_flr_so1 - h.h_so1_so2) / p.cap_so1,
        t_so2=(h.h_so1_so2 - h.h_so2_so3) / p.cap_so2,
        t_so3=(h.h_so2_so3 - h.h_so3_so4) / p.cap_so3,
        t_so4=(h.h_so3_so4 - h.h_so4_so5) / p.cap_so4,
        t_so5=(h.h_so4_so5 - h.h_so5_so_out) / p.cap_so5,
        # eqs 8.10-8.11 and Katzin (2021) eq. 7.40
        vp_air=(tr.mv_can_air - v.mv_air_th_scr - v.mv_air_bl_scr - v.mv_air_top - v.mv_air_out) / cap.cap_vp_air,
        vp_top=(v.mv_air_top - v.mv_top_cov_in - v.mv_top_out) / cap.cap_vp_top,
        # Katzin (2020) eq. A1
        t_lamp=(
            a.q_lamp_in + r.r_int_lamp_lamp
            - h.h_lamp_air - a.h_lamp_cool - s.r_lamp_air
            - s.r_par_lamp_can - s.r_nir_lamp_can - r.r_fir_lamp_can
            - s.r_par_lamp_flr - s.r_nir_lamp_flr - r.r_fir_lamp_flr
            - r.r_lamp_pipe - r.r_lamp_sky - r.r_lamp_cov_in - r.r_lamp_th_scr - r.r_lamp_bl_scr
        ) / p.cap_lamp,
        # Katzin (2021) eq. 7.1
        t_int_lamp=(
            a.q_int_lamp_in - h.h_int_lamp_air - s.r_int_lamp_air
            - s.r_par_int_lamp_can - s.r_nir_int_lamp_can - r.r_fir_int_lamp_can
            - s.r_par_int_lamp_flr - s.r_nir_int_lamp_flr - r.r_fir_int_lamp_flr
            - r.r_int_lamp_pipe - r.r_int_lamp_sky - r.r_int_lamp_cov_in
            - r.r_int_lamp_th_scr - r.r_int_lamp_bl_scr - r.r_int_lamp_lamp
        ) / p.cap_int_lamp,
        t_gro_pipe=(a.h_boil_gro_pipe - r.r_gro_pipe_can - h.h_gro_pipe_air) / p.cap_gro_pipe,
        t_bl_scr=(
            h.h_air_bl_scr + v.l_air_bl_scr
            + r.r_can_bl_scr + r.r_flr_bl_scr + r.r_pipe_bl_scr + r.r_lamp_bl_scr + r.r_int_lamp_bl_scr
            - h.h_bl_scr_top - r.r_bl_scr_cov_in - r.r_bl_scr_sky - r.r_bl_scr_th_scr
        ) / p.cap_bl_scr,
    )  # fmt: skip


def without(rates: ClimateState, p: ClimateParameters, f: ClimateFluxes, extraction: AirExchange) -> ClimateState:
    """``rates`` of the greenhouse less what an addition takes from the main air.

    Katzin (2021) eqs 7.1 and 7.50 have such terms, ``hAirMech`` and ``mvAirMech``. They stand here, and not in the balances above, so
    that the equations of a greenhouse without such an addition do not change.
    """
    return rates._replace(
        t_air=rates.t_air - extraction.heat / p.cap_air,
        vp_air=rates.vp_air - extraction.vapour / f.capacities.cap_vp_air,
        co2_air=rates.co2_air - extraction.co2 / p.cap_co2_air,
    )
