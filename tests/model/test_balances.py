"""What goes in comes out: energy, vapour, CO2 and carbohydrates, under any conditions and in any house."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

from hypothesis import given, settings

from glbench.model import COMPARTMENT, Model, tomato
from tests.model.conditions import Inputs, compartments, conditions, in_compartment

ROUNDING = 1e-11
HOUSES = (tomato("author"), tomato("gl_gym2"), COMPARTMENT)


class Alone(NamedTuple):
    """What the tomato greenhouse exchanges with a mass and with neighbours."""

    h_air_wall: float = 0.0
    mv_air_wall: float = 0.0
    mc_air_wall: float = 0.0


def evaluate(inputs: Inputs, more: Mapping[str, float], model: Model) -> tuple[Any, Any, Any, Any, float]:
    """Rates, fluxes and parameters of a house, what it exchanges with neighbours, and the heat that its mass stores [W m-2]."""
    own = in_compartment(inputs, more) if model is COMPARTMENT else inputs
    x, u, d, p = (values.tolist() for values in own)
    parameters = model.Parameters(*p)
    result = model.equations(model.State(*x), model.Controls(*u), model.Disturbances(*d), parameters)
    if model is COMPARTMENT:
        stored = parameters.cap_mass * result.derivative.t_mass
        return result.derivative, result.fluxes, parameters, result.fluxes.mass_and_neighbours, stored
    return result.derivative, result.fluxes, parameters, Alone(), 0.0


def closes(stored: list[float], exchanged: list[float]) -> bool:
    """Whether two sums agree, up to the rounding of their largest terms; below the smallest normal number rounding is absolute."""
    return abs(sum(stored) - sum(exchanged)) <= ROUNDING * max(map(abs, stored + exchanged)) + sys.float_info.min


@given(conditions, compartments)
@settings(max_examples=60, deadline=None)
def test_stored_heat_equals_heat_exchanged_with_the_surroundings(inputs: Inputs, more: dict[str, float]) -> None:
    for model in HOUSES:
        rate, f, p, wall, in_mass = evaluate(inputs, more, model)
        cap, s, r, h, v = f.capacities, f.short_wave, f.long_wave, f.convection, f.vapour
        stored = [
            p.cap_air * rate.t_air,
            p.cap_top * rate.t_top,
            cap.cap_can * rate.t_can,
            cap.cap_cov_in * rate.t_cov_in,
            cap.cap_cov_e * rate.t_cov_e,
            p.cap_th_scr * rate.t_th_scr,
            p.cap_bl_scr * rate.t_bl_scr,
            p.cap_flr * rate.t_flr,
            p.cap_pipe * rate.t_pipe,
            p.cap_gro_pipe * rate.t_gro_pipe,
            p.cap_lamp * rate.t_lamp,
            p.cap_int_lamp * rate.t_int_lamp,
            p.cap_so1 * rate.t_so1,
            p.cap_so2 * rate.t_so2,
            p.cap_so3 * rate.t_so3,
            p.cap_so4 * rate.t_so4,
            p.cap_so5 * rate.t_so5,
            in_mass,
        ]
        sun = [s.r_par_sun_can, s.r_nir_sun_can, s.r_par_sun_flr, s.r_nir_sun_flr, s.r_glob_sun_air, s.r_glob_sun_cov_e]
        equipment = [f.actuators.q_lamp_in, -f.actuators.h_lamp_cool, f.actuators.h_boil_pipe]
        to_sky = [r.r_can_sky, r.r_pipe_sky, r.r_flr_sky, r.r_th_scr_sky, r.r_bl_scr_sky, r.r_cov_e_sky, r.r_lamp_sky, r.r_int_lamp_sky]
        to_outside = [h.h_air_out, h.h_top_out, h.h_cov_e_out, h.h_so5_so_out, wall.h_air_wall]
        into_vapour = [f.transpiration.l_can_air, -v.l_air_th_scr, -v.l_air_bl_scr, -v.l_top_cov_in]
        losses = [-flux for flux in to_sky + to_outside + into_vapour]
        assert closes(stored, sun + equipment + losses)


@given(conditions, compartments)
@settings(max_examples=40, deadline=None)
def test_stored_vapour_equals_transpiration_less_condensation_and_ventilation(inputs: Inputs, more: dict[str, float]) -> None:
    for model in HOUSES:
        rate, f, _, wall, _ = evaluate(inputs, more, model)
        v = f.vapour
        stored = [f.capacities.cap_vp_air * rate.vp_air, f.capacities.cap_vp_top * rate.vp_top]
        condensed = [v.mv_air_th_scr, v.mv_air_bl_scr, v.mv_top_cov_in]
        assert closes(stored, [f.transpiration.mv_can_air, -v.mv_air_out, -v.mv_top_out, -wall.mv_air_wall, *(-flux for flux in condensed)])


@given(conditions, compartments)
@settings(max_examples=40, deadline=None)
def test_carbon_is_dosed_ventilated_or_found_in_the_crop(inputs: Inputs, more: dict[str, float]) -> None:
    for model in HOUSES:
        rate, f, p, wall, _ = evaluate(inputs, more, model)
        in_air = [p.cap_co2_air * rate.co2_air, p.cap_co2_top * rate.co2_top]
        in_crop = [p.m_co2 / p.m_ch2o * organ for organ in (rate.c_buf, rate.c_leaf, rate.c_stem, rate.c_fruit)]
        removed = [p.m_co2 / p.m_ch2o * organ for organ in (f.harvest.mc_leaf_har, f.harvest.mc_fruit_har)]
        assert closes(in_air + in_crop + removed, [f.actuators.mc_ext_air, -f.co2.mc_air_out, -f.co2.mc_top_out, -wall.mc_air_wall])


@given(conditions)
@settings(max_examples=40, deadline=None)
def test_light_of_the_lamps_is_absorbed_by_canopy_floor_and_air(inputs: Inputs) -> None:
    _, f, *_ = evaluate(inputs, {}, HOUSES[0])
    s = f.short_wave
    parts = [s.r_par_lamp_can, s.r_nir_lamp_can, s.r_par_lamp_flr, s.r_nir_lamp_flr, s.r_lamp_air]
    assert min(parts) >= -1e-12
    assert closes([s.r_can_lamp], parts)
    assert s.r_can_lamp <= f.actuators.q_lamp_in
