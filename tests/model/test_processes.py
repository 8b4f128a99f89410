"""Single processes: values by hand, limits, and what must have no effect."""

from __future__ import annotations

import math

import casadi
import numpy as np
import pytest
from hypothesis import given, settings

from glbench.model import (
    CONTROL_NAMES,
    DISTURBANCE_NAMES,
    PARAMETER_NAMES,
    PARAMETERS,
    STATE_NAMES,
    auxiliaries,
    co2_density,
    co2_ppm,
    default_parameters,
    jacobian,
    relative_humidity,
    rhs,
    saturation_vapour_pressure,
)
from tests.model.conditions import Inputs, a_day, conditions, with_entry


def test_saturated_air_of_20_degrees_has_a_vapour_pressure_of_2326_pascal() -> None:
    assert saturation_vapour_pressure(20.0) == pytest.approx(2325.9763651674925, rel=1e-15)
    assert relative_humidity(20.0, 2325.9763651674925 / 4) == pytest.approx(25.0, rel=1e-15)


def test_400_ppm_of_20_degrees_are_732_milligrams_a_cubic_metre() -> None:
    assert co2_density(20.0, 400.0) == pytest.approx(731.8195984832029, rel=1e-15)
    assert co2_ppm(20.0, 731.8195984832029) == pytest.approx(400.0, rel=1e-14)


def test_conversions_take_numbers_arrays_and_symbols() -> None:
    temperature = np.array([-5.0, 18.0, 35.0])
    symbol = casadi.MX.sym("t")
    for convert in (
        saturation_vapour_pressure,
        lambda t: co2_ppm(t, 700.0),
        lambda t: co2_density(t, 400.0),
        lambda t: relative_humidity(t, 1500.0),
    ):
        by_symbols = casadi.Function("convert", [symbol], [convert(symbol)])
        np.testing.assert_allclose(convert(temperature), [convert(float(t)) for t in temperature], rtol=1e-15)
        np.testing.assert_allclose(convert(temperature), np.array(by_symbols(temperature)).ravel(), rtol=1e-14)


def test_roof_vents_by_hand() -> None:
    # Air 20 degC, outside 10 degC, wind 3 m/s, half open vents of the benchmark:
    # buoyancy 9.81*0.87*10/(2*288.15) = 0.148095, wind 0.02*3^2 = 0.18, root of the sum 0.572796,
    # 0.5*52.2*0.35/(2*144) * 0.572796 = 0.0181682; leakage 3e-5*3, of which 0.9 from the top air.
    x, u, d, p = a_day()
    x = with_entry(x, STATE_NAMES, tAir=20.0)
    u = with_entry(u, CONTROL_NAMES, uVent=0.5)
    d = with_entry(d, DISTURBANCE_NAMES, tOut=10.0, wind=3.0)

    air = auxiliaries(x, u, d, p)

    assert air["fVentRoof2"] == pytest.approx(0.0181682, rel=1e-5)
    assert air["fVentRoof"] == pytest.approx(0.0181682 + 0.9 * 9e-5, rel=1e-5)
    assert air["fVentSide"] == pytest.approx(0.1 * 9e-5, rel=1e-12)


def test_far_infrared_from_outer_cover_to_sky_by_hand() -> None:
    # 0.85 * 5.67e-8 * (280^4 - 260^4) = 4.8195e-8 * (6.146560e9 - 4.569760e9) = 75.9939 W m-2
    x, u, d, p = a_day()
    x = with_entry(x, STATE_NAMES, tCovE=280 - 273.15)
    d = with_entry(d, DISTURBANCE_NAMES, tSky=260 - 273.15)

    assert auxiliaries(x, u, d, p)["rCovESky"] == pytest.approx(75.9939, rel=1e-6)


def test_actuators_deliver_the_benchmark_capacities() -> None:
    x, _, d, p = a_day()

    full = auxiliaries(x, np.ones(6), d, p)

    assert full["hBoilPipe"] == pytest.approx(130)
    assert full["mcExtAir"] == pytest.approx(5)
    assert full["qLampIn"] == pytest.approx(116)
    assert not any(auxiliaries(x, np.zeros(6), d, p)[name] for name in ("hBoilPipe", "mcExtAir", "qLampIn"))


@given(conditions)
@settings(max_examples=40, deadline=None)
def test_closed_vents_leave_only_leakage(inputs: Inputs) -> None:
    x, u, d, p = inputs
    closed = auxiliaries(x, with_entry(u, CONTROL_NAMES, uVent=0.0), d, p)
    by_hand = p[PARAMETER_NAMES.index("cLeakage")] * max(d[DISTURBANCE_NAMES.index("wind")], 0.25)

    assert closed["fVentRoof"] + closed["fVentSide"] == pytest.approx(by_hand, rel=1e-12)


@given(conditions)
@settings(max_examples=40, deadline=None)
def test_open_screens_have_no_effect(inputs: Inputs) -> None:
    x, u, d, _ = inputs
    u = with_entry(u, CONTROL_NAMES, uThScr=0.0, uBlScr=0.0)
    other_screens = {
        info.name: 0.5 if info.check == "fraction" else 2e-4
        for info in PARAMETERS
        if info.group in ("thermal_screen", "blackout_screen") and info.used == "yes"
    }
    p = default_parameters()
    warm_screens = with_entry(x, STATE_NAMES, tThScr=60.0, tBlScr=-30.0)

    before = rhs(x, u, d, p)
    after = rhs(warm_screens, u, d, with_entry(p, PARAMETER_NAMES, **other_screens))

    assert len(other_screens) == 14
    np.testing.assert_array_equal(before, after)
    assert not before[[STATE_NAMES.index("tThScr"), STATE_NAMES.index("tBlScr")]].any()


def test_flow_through_closed_screens_is_that_of_the_tighter_cloth() -> None:
    x, _, d, p = a_day()
    x = with_entry(x, STATE_NAMES, tAir=22.0, tTop=12.0)
    p = with_entry(p, PARAMETER_NAMES, kThScr=5e-4, kBlScr=1e-4)

    air = auxiliaries(x, np.ones(6), d, p)

    assert air["fScr"] == air["fBlScr"] == pytest.approx(1e-4 * 10**0.66, rel=1e-9)
    assert air["fThScr"] == pytest.approx(5e-4 * 10**0.66, rel=1e-9)


def test_a_screen_closed_beyond_1_by_rounding_has_no_gap() -> None:
    x, u, d, p = a_day()
    beyond = auxiliaries(x, with_entry(u, CONTROL_NAMES, uThScr=1 + 1e-8, uBlScr=0.0), d, p)
    closed = auxiliaries(x, with_entry(u, CONTROL_NAMES, uThScr=1.0, uBlScr=0.0), d, p)

    assert beyond["fThScr"] == pytest.approx(float(closed["fThScr"]), rel=1e-7)


def test_only_the_floor_of_condensation_on_the_blackout_screen_differs_from_the_thermal_screen() -> None:
    # Air 12.8 Pa below saturation at both screens: the lobe of the smooth function dries the thermal screen by
    # 6.4e-9 * 1.7 * 2^0.33 * 12.8/(1 + e^1.28) kg m-2 s-1, and not the blackout screen.
    x, u, d, p = a_day()
    x = with_entry(x, STATE_NAMES, tAir=20.0, tThScr=18.0, tBlScr=18.0, vpAir=saturation_vapour_pressure(18.0) - 12.8)
    u = with_entry(u, CONTROL_NAMES, uThScr=1.0, uBlScr=1.0)
    by_hand = -6.4e-9 * 1.7 * 2**0.33 * 12.8 / (1 + math.exp(1.28))

    author, code = (auxiliaries(x, u, d, p, variant=variant) for variant in ("author", "gl_gym2"))

    assert author["mvAirThScr"] == pytest.approx(by_hand, rel=1e-9)
    assert author["mvAirBlScr"] == 0
    assert code["mvAirBlScr"] == pytest.approx(by_hand * 2 ** (1 / 3 - 0.33), rel=1e-6)


def test_darkness_stops_photosynthesis_but_not_respiration() -> None:
    x, _, d, p = a_day()
    d = with_entry(d, DISTURBANCE_NAMES, iGlob=0.0)

    night = auxiliaries(x, np.zeros(6), d, p)

    assert night["photoGross"] == 0
    assert night["mcOrgAir"] > 0
    assert night["mcAirCan"] < 0


def test_light_response_is_the_smaller_root_of_its_quadratic() -> None:
    p = default_parameters()
    theta, alpha = p[PARAMETER_NAMES.index("theta")], p[PARAMETER_NAMES.index("alpha")]
    x, _, d, _ = a_day()
    values = auxiliaries(x, np.ones(6), d, p)
    j, potential, limit = values["j"], values["jPot"], alpha * values["parCan"]

    assert theta * j**2 - (potential + limit) * j + potential * limit == pytest.approx(0, abs=1e-8)
    assert 0 < j < min(potential, limit)


def test_half_the_largest_rate_is_harvested_at_the_limit() -> None:
    x, u, d, p = a_day()
    limits = {name: p[PARAMETER_NAMES.index(f"{name}Max")] for name in ("cLeaf", "cFruit")}
    at_limit = auxiliaries(with_entry(x, STATE_NAMES, **limits), u, d, p)
    below = auxiliaries(with_entry(x, STATE_NAMES, **{k: v - 1e4 for k, v in limits.items()}), u, d, p)

    assert at_limit["mcLeafHar"] == pytest.approx(5e4)
    assert at_limit["mcFruitHar"] == pytest.approx(2.5e4)
    # 1e4 mg m-2 below the limit it is 1/(1 + 100^2) of the largest rate.
    assert below["mcLeafHar"] == pytest.approx(1e5 / 10001, rel=1e-9)
    assert below["mcFruitHar"] == pytest.approx(5e4 / 10001, rel=1e-9)


def test_the_mean_temperature_follows_within_a_day() -> None:
    x, u, d, p = a_day()

    assert jacobian(x, u, d, p)[STATE_NAMES.index("tCan24"), STATE_NAMES.index("tCan24")] == pytest.approx(-1 / 86400)
