"""The lettuce: against a second implementation, the figures of its growth, carbon, derivatives and limits."""

from __future__ import annotations

from itertools import product
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from glbench.model import AUXILIARIES, PARAMETER_NAMES, STATE_NAMES, co2_density
from glbench.model.crop.lettuce import (
    CARBOXYLATION_ROUNDING,
    LETTUCE_PARAMETERS,
    CropClimate,
    Growth,
    LettuceParameters,
    LettuceState,
    Photosynthesis,
    Respiration,
    carboxylation_conductance,
    climate_leaf_area_index,
    co2_uptake,
    dry_mass,
    fluxes,
    fresh_mass,
    head_mass,
    leaf_area_index,
    rates,
    start_state,
)
from glbench.model.parameter_checks import check_value
from glbench.model.quantities import states_of, table_of
from tests.model.lettuce_oracle import Lettuce

P = LettuceParameters(*(info.values["benchmark"] for info in LETTUCE_PARAMETERS))
PAPER = Lettuce()
Array = NDArray[np.float64]

climates = st.builds(CropClimate, st.floats(-10.0, 50.0), st.floats(0.0, 5000.0), st.floats(0.0, 500.0))
crops = st.builds(lambda structural, store: LettuceState(store * structural, structural), st.floats(1e-4, 1.0), st.floats(-0.06, 2.0))


def everything(z: Any) -> tuple[Any, ...]:
    """All that the crop gives to others, of a vector of its states, climate and parameters."""
    x, c, p = LettuceState(*z[:2]), CropClimate(*z[2:5]), LettuceParameters(*z[5:])
    f = fluxes(x, c, p)
    return (
        *rates(f, p), co2_uptake(f, p), leaf_area_index(x, p), climate_leaf_area_index(x, p),
        dry_mass(x), fresh_mass(x, p), head_mass(x, p), *f.photosynthesis, *f.growth, *f.respiration,
    )  # fmt: skip


def point(x: LettuceState, c: CropClimate, p: LettuceParameters = P) -> Array:
    return np.array([*x, *c, *p])


def random_points(n: int) -> Array:
    """Crops of 0.3 to 1000 g m-2 of dry matter, in light and darkness, from frost to heat; parameters within 10 %."""
    generator = np.random.default_rng(7)
    structural = 10 ** generator.uniform(-3.5, 0.0, n)
    store = structural * 10 ** generator.uniform(-2.0, 0.5, n)
    dark = generator.random(n) < 0.2
    climate = np.stack(
        [generator.uniform(-5.0, 45.0, n), generator.uniform(20.0, 3000.0, n), np.where(dark, 0.0, generator.uniform(0.0, 400.0, n))]
    )
    parameters = np.array(P)[:, None] * generator.uniform(0.9, 1.1, (len(P), n))
    return np.concatenate([[store, structural], climate, parameters])


def oracle_of(z: Array) -> Lettuce:
    p = LettuceParameters(*z[5:])
    return Lettuce(
        c_alpha=p.c_alpha, c_beta=p.c_beta, c_tau=p.c_tau, c_lar=p.c_lar / 1e3, c_k=p.c_k, c_gr_max=p.c_gr_max,
        c_gamma=p.c_gr_half, c_q10_gr=p.q10_gr, c_resp_sht=p.c_resp_sht, c_resp_rt=p.c_resp_rt, c_q10_resp=p.q10_resp,
        c_epsilon=p.c_eps * 1e3, c_capital_gamma=p.co2_comp20 * 1e6, c_q10_gamma=p.q10_comp, g_bnd=p.s_bnd, g_stm=p.s_stm,
        c_car=(p.s_car1, p.s_car2, p.s_car3), heads=p.n_head, dry_share=p.dm_sht,
    )  # fmt: skip


def grow(days: int, x: LettuceState, day: CropClimate, step: float = 900.0) -> tuple[Array, Array]:
    """Fresh mass of a head [g] and CO2 taken up so far [kg m-2] at the end of every day of 12 h of light: columns of a batch."""

    def derivative(y: Array, c: CropClimate) -> Array:
        f = fluxes(LettuceState(y[0], y[1]), c, P)
        return np.array([*rates(f, P), 1e-6 * co2_uptake(f, P)])

    y = np.array([*np.broadcast_arrays(*x, day.par)[:2], np.zeros_like(day.par)])
    heads, taken = [head_mass(LettuceState(y[0], y[1]), P)], [y[2]]
    for _ in range(days):
        for climate in (day, day._replace(par=0 * day.par)):
            for _ in range(round(43200 / step)):
                k1 = derivative(y, climate)
                k2 = derivative(y + step / 2 * k1, climate)
                k3 = derivative(y + step / 2 * k2, climate)
                k4 = derivative(y + step * k3, climate)
                y = y + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        heads.append(head_mass(LettuceState(y[0], y[1]), P))
        taken.append(y[2])
    return np.array(heads), np.array(taken)


# 400 ppm, 1000 ppm, little light, frost, heat, at 12 h of light a day: temperature, ppm, PAR.
DAYS = np.array([[18.0, 400, 100], [18, 1000, 100], [20, 400, 60], [0, 400, 100], [41, 400, 100]]).T


@pytest.fixture(scope="module")
def grown() -> tuple[Array, Array]:
    temperature, ppm, par = DAYS
    return grow(45, start_state(P), CropClimate(temperature, co2_density(temperature, ppm), par))


# The table


def test_the_table_is_complete_and_possible() -> None:
    assert len(LETTUCE_PARAMETERS) == len(LettuceParameters._fields) == 22
    for info in LETTUCE_PARAMETERS:
        assert info.meaning
        assert info.source
        assert info.used == "yes"
        assert not info.is_derived
        assert info.unit
        check_value(info, info.values["benchmark"])


def test_the_names_are_not_those_of_the_climate_or_the_tomato() -> None:
    assert [entry.name for entry in states_of(LettuceState)] == ["xN", "xS"]
    assert set(PARAMETER_NAMES).isdisjoint(info.name for info in LETTUCE_PARAMETERS)
    assert set(STATE_NAMES).isdisjoint(entry.name for entry in states_of(LettuceState))
    fluxes_of_lettuce = [entry.name for record in (Photosynthesis, Growth, Respiration) for entry in table_of(record)]
    assert len(set(fluxes_of_lettuce)) == 9
    assert {entry.name for entry in AUXILIARIES}.isdisjoint(fluxes_of_lettuce)


def test_every_parameter_has_an_effect() -> None:
    z = point(LettuceState(0.03, 0.12), CropClimate(18.0, 900.0, 120.0))

    for k in range(5, len(z)):
        other = z.copy()
        other[k] *= 1.01
        assert everything(other) != everything(z), LettuceParameters._fields[k - 5]


# The oracle


def test_the_fluxes_are_those_of_a_second_implementation() -> None:
    z = random_points(200)
    batch = np.array(everything(z))

    for column, values in zip(z.T, batch.T, strict=True):
        paper = oracle_of(column)
        store, structural, temperature, co2, par = column[:5]
        dry = 1e3 * np.array([store, structural])
        x_n, x_s, respired = paper.derivative(dry, temperature, co2, par)
        photosynthesis = paper.gross_photosynthesis(dry[1], temperature, co2, par)
        # What the store gains is a difference of large terms: its error is relative to them.
        scale = 1e-3 * (paper.c_alpha * abs(photosynthesis) + x_s / paper.c_beta)
        # Near the ends of photosynthesis the model rounds, and the paper does not.
        close = 1e-9 + CARBOXYLATION_ROUNDING / np.polyval(paper.c_car, temperature) ** 2
        assert values[0] == pytest.approx(1e-3 * x_n, rel=close, abs=close * scale)
        assert values[1] == pytest.approx(1e-3 * x_s, rel=1e-9)
        assert values[2] == pytest.approx(1e3 * (photosynthesis - respired), rel=close, abs=close * 1e6 * scale)
        assert values[7] == pytest.approx(float(paper.head(dry)), rel=1e-12)
        assert values[8] == pytest.approx(1e-6 * paper.compensation_point(temperature), rel=1e-12)
        assert values[12] == pytest.approx(1e-3 * photosynthesis, rel=close)


def test_a_second_implementation_grows_the_same_heads(grown: tuple[Array, Array]) -> None:
    for k, (temperature, ppm, par) in enumerate(DAYS.T):
        by_paper = PAPER.heads_by_day(20, temperature, co2_density(temperature, ppm), par)
        np.testing.assert_allclose(grown[0][:21, k], by_paper, rtol=2e-7)


def test_photosynthesis_by_hand() -> None:
    # 20 degC, 800 mg/m3, 100 W/m2, 0.1 kg/m2 of structural matter.
    # Parabola 20^2*-1.32e-5 + 20*5.94e-4 - 2.64e-3 = 3.96e-3; 1/s = 250 + 142.857 + 252.525 = 645.382, s = 1.549469e-3.
    # Limits: 17e-9*100*(726.8e-6/946.4e-6) = 1.305537e-6 and 1.549469e-3*726.8e-6 = 1.126154e-6; product over sum 6.046145e-7.
    # LAI 75*0.93*0.1 = 6.975, of the light 1 - exp(-0.9*6.975) = 0.9981219.
    f = fluxes(LettuceState(0.02, 0.1), CropClimate(20.0, 800.0, 100.0), P)

    assert f.photosynthesis.s_co2 == pytest.approx(1.549469e-3, rel=1e-6)
    assert f.photosynthesis.f_phot_max == pytest.approx(6.046145e-7, rel=1e-6)
    assert f.photosynthesis.f_phot == pytest.approx(6.046145e-7 * 0.9981219, rel=1e-6)


def test_growth_and_respiration_by_hand() -> None:
    # Store a quarter of the structural matter: 5e-6 * 0.2 at 20 degC; 30 degC multiplies by 1.6 and lets a quarter of it be respired.
    # Maintenance at 25 degC: 0.1*(0.93*3.47e-7 + 0.07*1.16e-7) = 3.3083e-8; at 30 degC times sqrt(2).
    f = fluxes(LettuceState(0.025, 0.1), CropClimate(30.0, 800.0, 0.0), P)

    assert f.growth.r_gr == pytest.approx(1.6e-6, rel=1e-12)
    assert f.growth.f_gr == pytest.approx(1.6e-7, rel=1e-12)
    assert f.respiration.f_resp_gr == pytest.approx(4e-8, rel=1e-12)
    assert f.respiration.f_resp_main == pytest.approx(3.3083e-8 * np.sqrt(2), rel=1e-12)
    assert rates(f, P).x_n == pytest.approx(-(1.6e-7 + 4e-8 + 3.3083e-8 * np.sqrt(2)), rel=1e-12)


# Growth


def test_a_head_of_3_grams_is_set() -> None:
    x = start_state(P)

    assert head_mass(x, P) == pytest.approx(3.0, rel=1e-15)
    assert fresh_mass(x, P) == pytest.approx(0.075, rel=1e-15)
    assert x.x_s == pytest.approx(3 * x.x_n, rel=1e-15)
    assert head_mass(start_state(P, 8.0), P) == pytest.approx(8.0, rel=1e-15)


def test_heads_grow_as_in_a_trial_integration(grown: tuple[Array, Array]) -> None:
    usual, rich, dim, frost, heat = grown[0].T

    assert usual[[20, 40]] == pytest.approx([156, 315], abs=0.5)
    assert int(np.argmax(usual >= 250)) == 32
    assert int(np.argmax(rich >= 250)) == 19
    assert int(np.argmax(dim >= 250)) == 45
    for dying in (frost, heat):
        assert (np.diff(dying) < 0).all()
        assert dying[-1] > 0


def test_heads_of_250_grams_take_five_to_eight_weeks_in_a_spring_of_15_to_20_degrees() -> None:
    temperature, par = np.array(list(product((15.0, 17.5, 20.0), (60.0, 90.0)))).T
    heads, _ = grow(56, start_state(P), CropClimate(temperature, co2_density(temperature, 400.0), par), step=1800.0)

    first = np.argmax(heads >= 250, axis=0)
    assert (first >= 32).all()
    assert (first <= 56).all()


def test_a_crop_in_long_darkness_lives_on_its_leaves() -> None:
    x = np.array(start_state(P, 200.0))
    for _ in range(40 * 24):
        f = fluxes(LettuceState(*x), CropClimate(35.0, 700.0, 0.0), P)
        x = x + 3600 * np.array(rates(f, P))

    assert -0.06 < x[0] / x[1] < -0.03
    assert 0 < x[1] < start_state(P, 200.0).x_s
    assert co2_uptake(f, P) < 0


# Carbon


@given(crops, climates)
@settings(deadline=None)
def test_carbon_taken_up_is_in_the_dry_matter_or_respired(x: LettuceState, c: CropClimate) -> None:
    f = fluxes(x, c, P)
    # As CO2 [kg m-2 s-1]: dry matter is CH2O, made of 1/cAlpha of CO2.
    stored = sum(rates(f, P)) / P.c_alpha
    respired = (f.respiration.f_resp_main + f.respiration.f_resp_gr) / P.c_alpha
    largest = abs(f.photosynthesis.f_phot) + abs(respired) + 2 * abs(f.growth.f_gr) / P.c_alpha

    assert stored + respired == pytest.approx(f.photosynthesis.f_phot, rel=0, abs=1e-12 * largest)
    assert 1e6 * stored == pytest.approx(co2_uptake(f, P), rel=0, abs=1e6 * 1e-12 * largest)


def test_carbon_taken_up_in_a_planting_is_the_harvest_and_the_roots(grown: tuple[Array, Array]) -> None:
    heads, taken = grown
    dry = 1e-3 * P.n_head * P.dm_sht * (heads - heads[0]) / (1 - P.c_tau)

    np.testing.assert_allclose(P.c_alpha * taken, dry, rtol=1e-11, atol=1e-15)


# Derivatives

EDGES = [
    point(LettuceState(store * structural, structural), CropClimate(temperature, co2, par))
    for structural, store in product((0.0, 1e-12, 3e-3, 0.3), (-0.05, 0.0, 1.0))
    for temperature, co2, par in product((-10.0, 5.0 - 1e-9, 5.0, 5.0 + 1e-5, 18.0, 40.0, 45.0), (0.0, 73.2, 700.0), (0.0, 1e-9, 100.0))
]
"""Empty beds, exhausted stores, darkness, the compensation point of 20 °C, no CO2, and the ends of photosynthesis."""


def symbolic(kind: Any) -> tuple[casadi.Function, casadi.Function]:
    """The crop, and its Jacobian with respect to states, climate and parameters."""
    z = kind.sym("z", 5 + len(P))
    out = casadi.vertcat(*everything(casadi.vertsplit(z)))
    return casadi.Function("crop", [z], [out]), casadi.Function("slopes", [z], [casadi.jacobian(out, z)])


@pytest.mark.parametrize("kind", [casadi.SX, casadi.MX])
def test_symbols_numbers_and_arrays_give_the_same(kind: Any) -> None:
    z = np.concatenate([random_points(50), np.array(EDGES).T], axis=1)
    crop, _ = symbolic(kind)

    batch = np.array(everything(z))
    single = np.array([everything(column.tolist()) for column in z.T]).T
    by_symbols = crop.map(z.shape[1])(z).full()

    np.testing.assert_allclose(single, batch, rtol=1e-13, atol=1e-30)
    np.testing.assert_allclose(by_symbols, batch, rtol=1e-13, atol=1e-30)


def test_values_and_slopes_are_finite_wherever_the_crop_can_be() -> None:
    crop, slopes = symbolic(casadi.SX)

    for z in EDGES:
        assert np.isfinite(crop(z).full()).all(), z[:5]
        assert np.isfinite(slopes(z).full()).all(), z[:5]


def test_slopes_equal_those_by_a_complex_step_and_by_differences() -> None:
    _, slopes = symbolic(casadi.SX)

    for z in random_points(60).T:
        units = np.eye(len(z))
        exact = slopes(z).full()
        # f(z + ih) = f(z) + ih f'(z): exact to rounding.
        by_complex_step = np.array([np.imag(everything(z + 1e-30j * unit)) / 1e-30 for unit in units]).T
        # Changes by the whole of an input, against the largest of them.
        whole = np.where(z == 0, 1.0, np.abs(z))
        by_differences = np.array(
            [
                (np.array(everything(z + h * unit)) - np.array(everything(z - h * unit))) / (2 * h)
                for h, unit in zip(1e-6 * whole, units, strict=True)
            ]
        ).T
        size = np.abs(exact * whole).max(axis=1, keepdims=True, initial=1e-300)

        np.testing.assert_allclose(by_complex_step * whole / size, exact * whole / size, rtol=1e-11, atol=1e-14)
        np.testing.assert_allclose(by_differences * whole / size, exact * whole / size, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("limit", [5.0, 40.0])
def test_photosynthesis_begins_without_a_jump_or_a_kink(limit: float) -> None:
    t = casadi.SX.sym("t")
    conductance = carboxylation_conductance(t, P)
    slope = casadi.Function("slope", [t], [casadi.jacobian(conductance, t)])
    inside = np.sign(22.5 - limit)

    assert carboxylation_conductance(limit - inside * 1e-6, P) == 0
    assert float(slope(limit - inside * 1e-6)) == 0
    assert abs(float(slope(limit + inside * 1e-7))) < 1e-5
    literal = np.polyval([P.s_car1, P.s_car2, P.s_car3], limit + inside * 1e-3)
    assert carboxylation_conductance(limit + inside * 1e-3, P) == pytest.approx(literal, rel=1e-3)
    assert carboxylation_conductance(18.0, P) == pytest.approx(np.polyval(PAPER.c_car, 18.0), rel=1e-11)


# Plausibility


def photosynthesis_of(x: LettuceState, c: CropClimate) -> float:
    return float(fluxes(x, c, P).photosynthesis.f_phot)


@given(crops, st.floats(5.5, 39.5), st.floats(1e-3, 500.0), st.floats(1e-3, 500.0), st.floats(400.0, 4000.0))
@settings(deadline=None)
def test_more_light_gives_more_photosynthesis_but_less_for_each_watt(
    x: LettuceState, t_can: float, one: float, other: float, co2: float
) -> None:
    low, high = sorted((one, other))
    a, b = (photosynthesis_of(x, CropClimate(t_can, co2, par)) for par in (low, high))

    assert a <= b * (1 + 1e-12)
    assert a * high >= b * low * (1 - 1e-9)


@given(crops, st.floats(5.5, 39.5), st.floats(1.0, 500.0), st.floats(0.0, 4000.0), st.floats(1.0, 1000.0))
@settings(deadline=None)
def test_more_co2_gives_more_photosynthesis_and_ever_less_more(x: LettuceState, t_can: float, par: float, co2: float, step: float) -> None:
    a, b, c = (photosynthesis_of(x, CropClimate(t_can, co2 + k * step, par)) for k in range(3))

    assert a < b < c
    assert c - b < (b - a) * (1 + 1e-9) + 1e-15 * abs(a)


def test_photosynthesis_gains_little_beyond_1000_ppm() -> None:
    x, t = LettuceState(0.05, 0.1), 18.0
    at = [photosynthesis_of(x, CropClimate(t, co2_density(t, ppm), 100.0)) for ppm in (400.0, 700.0, 1000.0, 1300.0)]

    gains = np.diff(at) / at[:-1]
    assert gains[0] > 0.35
    assert gains[1] < gains[0] / 2
    assert gains[2] < 0.12


@given(crops, climates)
@settings(deadline=None)
def test_signs(x: LettuceState, c: CropClimate) -> None:
    f = fluxes(x, c, P)

    assert f.respiration.f_resp_main > 0
    assert f.growth.f_gr * x.x_n >= 0
    assert f.photosynthesis.f_phot * (1e-6 * c.co2_air - f.photosynthesis.co2_comp) >= 0
    if c.par == 0 or not 5 < c.t_can < 40:
        assert f.photosynthesis.f_phot == 0


@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0))
@settings(deadline=None)
def test_the_climate_sees_the_leaves_of_small_plants_and_three_layers_at_most(one: float, other: float) -> None:
    small, large = (LettuceState(0.0, x_s) for x_s in sorted((one, other)))

    assert climate_leaf_area_index(small, P) <= climate_leaf_area_index(large, P) <= P.lai_sat
    assert climate_leaf_area_index(large, P) <= leaf_area_index(large, P) + 1e-14
    young = start_state(P)
    assert climate_leaf_area_index(young, P) == pytest.approx(leaf_area_index(young, P), rel=0.04)
