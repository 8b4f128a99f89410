"""A compartment as measured: what closes, figures by hand, vents, topping, and that without its parts it is the published greenhouse."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from glbench.errors import ParameterError
from glbench.model import COMPARTMENT, TOMATO, Horizon, get_model, registered_models
from glbench.model.compartment import CompartmentParameters, MassAndNeighbours, MassState, RisingVents, ToppedTomato
from glbench.model.parameter_checks import check_value
from tests.model.conditions import COMPARTMENT_RANGES, Array, Inputs, in_compartment, reference_points

MODEL = COMPARTMENT
PUBLISHED = get_model("greenlight-tomato-harvest-1.0.0")
POINTS = reference_points()
OWN = tuple(name for name in COMPARTMENT_RANGES if name != "tMass")
OFF = {"hecAirMass": 0.0, "etaGlobMass": 0.0, "hecWall": 0.0, "fWall": 0.0}
VENT = MODEL.control_names.index("uVent")


def drawn(**fixed: Any) -> Inputs:
    """The reference points in compartments of all kinds, some values the same in all."""
    generator = np.random.default_rng(8)
    n = len(POINTS.inputs.x)
    more = {name: generator.uniform(*limits, n) for name, limits in COMPARTMENT_RANGES.items()}
    return in_compartment(POINTS.inputs, more | fixed)


def column(values: Array, name: str) -> Array:
    """Column of a table of states or of parameters."""
    names = MODEL.state_names if values.shape[-1] == len(MODEL.states) else MODEL.parameter_names
    return values[..., names.index(name)]


AT = drawn(laiTop=1.0)
FLUXES = MODEL.auxiliary_values(*AT)


def closes(one: Any, other: Any, size: Any) -> None:
    np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * np.max(np.abs(size)))


# The parts


def test_the_model_is_named_and_put_together_as_the_others() -> None:
    assert MODEL.id == "greenlight-tomato-compartment-1.0.0"
    assert MODEL.parts == (RisingVents(), ToppedTomato(), MassAndNeighbours())
    assert MODEL.control_names == TOMATO.control_names
    assert MODEL.disturbance_names == TOMATO.disturbance_names
    assert MODEL.state_names == (*TOMATO.state_names[:-1], "tMass", "sumMcFruitHar", "sumMcExtAir", "time")
    assert set(MODEL.parameter_names) - set(TOMATO.parameter_names) == set(OWN)
    values = dict(zip(MODEL.parameter_names, MODEL.parameters.default().tolist(), strict=True))
    low, high = MODEL.bounds(Horizon(96, 900.0, values))["tMass"]
    assert low < 0.0 < 100.0 < high


def test_the_table_is_complete_and_possible_and_the_benchmark_leaves_every_part_out() -> None:
    own = {info.name: info for info in MODEL.table if info.group == "compartment"}
    assert set(own) == set(OWN)
    for info in own.values():
        assert info.meaning
        assert info.source
        for value in info.values.values():
            check_value(info, value)
    benchmark = MODEL.parameters.record(*MODEL.parameters.default())
    assert (benchmark.hec_air_mass, benchmark.eta_glob_mass, benchmark.hec_wall, benchmark.f_wall, benchmark.lai_top) == (0, 0, 0, 0, 1)


@pytest.mark.parametrize(
    ("name", "value"), [("capMass", 0.0), ("etaGlobMass", 1.1), ("fWall", -1e-4), ("laiTop", 1.2), ("tSumTopWidth", 0.0)]
)
def test_impossible_compartments_are_refused(name: str, value: float) -> None:
    with pytest.raises(ParameterError, match=name):
        MODEL.parameters.default(overrides={name: value})


def test_a_season_starts_as_the_published_one_with_a_mass_as_warm_as_the_air() -> None:
    first, p = POINTS.inputs.d[0], MODEL.parameters.default()
    for start in PUBLISHED.starts():
        state = dict(zip(MODEL.state_names, MODEL.start(start, first, 18.0, p).tolist(), strict=True))
        expected = dict(
            zip(PUBLISHED.state_names, PUBLISHED.start(start, first, 18.0, PUBLISHED.parameters.default()).tolist(), strict=True)
        )
        assert state == expected | {"tMass": 18.0, "sumMcExtAir": 0.0}


# Published models stay as they are

DIGESTS = {
    ("greenlight-tomato-1.0.0", "author"): "2f5e96fbd590e25a4184fbe79e23fa48c24cf93c101fff52aecdeb535b4836e0",
    ("greenlight-tomato-1.0.0", "gl_gym2"): "f059909cefb0ac9b14126af84d8508985aa4419f983ffb29ec02897969c164e7",
    ("greenlight-tomato-harvest-1.0.0", "author"): "6573fd7076b42dc0dc3d539a311550cb34605d9dd1f248adb27a89649a584c30",
    ("greenlight-tomato-harvest-1.0.0", "gl_gym2"): "dd27a924fd1a2d2bea8b6380ef13c0d2ce6c7c41da675a589ecbf75adc13aef9",
    ("greenlight-tomato-season-1.0.0", "author"): "dce1d703783dc66e0cc69b0635f0da89ca811895546323ff2caaf8333831a160",
    ("greenlight-tomato-harvest-energy-1.0.0", "author"): "a6c5dd62dd62f9acf62b0403d3a39aebcdc910ae608749eae4570eef952e4089",
    ("greenlight-tomato-harvest-heat-pump-1.0.0", "author"): "51afe96caa0f9ccd8cf1e089153155f8a99626b8722e29eb85617f85747d9d33",
    ("greenlight-lettuce-1.0.0", "author"): "8e90e56e64570241ac25d24149ee6891253a3920b58e0319d500cac9eaa1e810",
}
"""SHA-256 of the equations of each published model and variant."""


def test_the_equations_of_published_models_are_what_they_were() -> None:
    assert {key: get_model(*key).digest for key in DIGESTS} == DIGESTS
    # No published task has the crop with trusses, the lettuce sold by weight class or the one that a crew cuts yet.
    shipped = {(model.id, model.variant) for model in registered_models() if model.id.startswith("greenlight-")}
    drafts = ("greenlight-tomato-2-", "greenlight-lettuce-2-", "greenlight-lettuce-harvest-")
    published = {(name, variant) for name, variant in shipped if not name.startswith(drafts)}
    assert len(shipped - published) == 7
    assert DIGESTS.keys() | {(MODEL.id, MODEL.variant)} == published


# Off


@pytest.mark.parametrize("opening", [0.0, 1.0])
def test_with_its_parts_off_and_vents_shut_or_fully_open_it_is_the_published_greenhouse_bit_for_bit(opening: float) -> None:
    x, u, d, p = drawn(laiTop=1.0, **OFF)
    at = Inputs(x, u.copy(), d, p)
    at.u[:, VENT] = opening
    rates = dict(zip(MODEL.state_names, MODEL.rhs(*at).T, strict=True))
    plain = np.insert(POINTS.inputs.x, 27, 0.0, axis=1)
    expected = dict(zip(PUBLISHED.state_names, PUBLISHED.rhs(plain, at.u, d, POINTS.inputs.p).T, strict=True))

    assert not rates.pop("tMass").any()
    np.testing.assert_array_equal(rates.pop("sumMcExtAir"), MODEL.auxiliary_values(*at)["mcExtAir"])
    assert rates.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(rates[name], values, err_msg=name)


def test_the_benchmark_s_values_are_those_that_leave_all_parts_out() -> None:
    x, u, d, _ = POINTS.of("day")
    at = in_compartment(Inputs(x, u, d, np.tile(TOMATO.parameters.default(), (len(x), 1))), {"tMass": 20.0, **dict.fromkeys(OWN, 0.0)})
    at = at._replace(p=np.tile(MODEL.parameters.default(), (len(x), 1)), u=u.copy())
    at.u[:, VENT] = 1.0
    rates = MODEL.rhs(*at)
    expected = TOMATO.rhs(x, at.u, d, TOMATO.parameters.default())
    keep = [MODEL.state_index(name) for name in TOMATO.state_names]
    np.testing.assert_array_equal(rates[:, keep], expected)


# What closes


def test_what_the_air_loses_is_what_mass_and_neighbours_gain() -> None:
    off = AT._replace(p=AT.p.copy())
    for name, value in OFF.items():
        column(off.p, name)[:] = value
    rates = MODEL.rhs(*AT)
    lost, size = MODEL.rhs(*off) - rates, np.abs(rates).max(axis=0)
    f = FLUXES
    for state, capacity, expected in (
        ("tAir", column(AT.p, "capAir"), f["hAirMass"] + f["rSunMass"] + f["hAirWall"]),
        ("vpAir", f["capVpAir"], f["mvAirWall"]),
        ("co2Air", column(AT.p, "capCo2Air"), f["mcAirWall"]),
    ):
        place = MODEL.state_index(state)
        assert (np.abs(expected) > 0.0).all()
        closes(lost[:, place] * capacity, expected, size[place] * capacity)
    closes(column(rates, "tMass") * column(AT.p, "capMass"), f["hAirMass"] + f["rSunMass"], 500.0)
    others = [k for k, name in enumerate(MODEL.state_names) if name not in {"tAir", "vpAir", "co2Air", "tMass"}]
    assert not lost[:, others].any()


def test_sun_that_the_mass_keeps_is_sun_that_the_air_does_not_get() -> None:
    """With a mass as warm as the air and no neighbours, air and mass together gain what the air gains without the mass."""
    at = drawn(laiTop=1.0, hecWall=0.0, fWall=0.0, tMass=POINTS.inputs.x[:, TOMATO.state_index("tAir")])
    bare = at._replace(p=at.p.copy())
    column(bare.p, "etaGlobMass")[:] = 0.0
    sun = MODEL.auxiliary_values(*at)["rGlobSunAir"]
    air, plain = (column(MODEL.rhs(*one), "tAir") * column(one.p, "capAir") for one in (at, bare))
    mass = column(MODEL.rhs(*at), "tMass") * column(at.p, "capMass")
    assert (sun > 10.0).sum() > len(sun) / 4
    closes(plain - air, column(at.p, "etaGlobMass") * sun, plain)
    closes(air + mass, plain, plain)


# Figures by hand


def test_figures_by_hand() -> None:
    # Air of 20 °C, 1800 Pa and 1500 mg m-3 of CO2 beside neighbours of 18 °C, 80 % and 600 ppm, with a mass of 25 °C and 40 W m-2 of sun.
    p = CompartmentParameters(
        cap_mass=50e3, hec_air_mass=5.0, eta_glob_mass=0.35, hec_wall=0.3, f_wall=4e-4, t_wall=18.0, rh_wall=80.0, co2_wall=600.0
    )
    surroundings = SimpleNamespace(
        x=SimpleNamespace(t_air=20.0, vp_air=1800.0, co2_air=1500.0),
        p=SimpleNamespace(rho_air_cap=1.2, c_p_air=1000.0, m_water=18.0, R=8314.0),
        light=SimpleNamespace(r_glob_sun_air=40.0),
    )
    around: Any = SimpleNamespace(surroundings=surroundings)
    part, state = MassAndNeighbours(), MassState(25.0)
    f = part.processes(state, around, p)

    assert f.h_air_mass == pytest.approx(-25.0)  # 5 W m-2 K-1 times -5 K
    assert f.r_sun_mass == pytest.approx(14.0)
    assert f.h_air_wall == pytest.approx(1.56)  # 0.3 W m-2 K-1 through walls and 0.48 with the air, times 2 K
    # 2054.1 Pa at saturation of 18 °C, 1643.3 Pa at 80 %: 18/8314 * 4e-4 * (1800/293.15 - 1643.3/291.15)
    assert f.mv_air_wall == pytest.approx(4.296e-7, rel=1e-3)
    assert f.mc_air_wall == pytest.approx(4e-4 * (1500.0 - 1105.27), rel=1e-4)  # 600 ppm are 1105.27 mg m-3 at 18 °C
    assert part.rates(state, around, f, p).t_mass == pytest.approx(-11.0 / 50e3)
    taken = part.exchange(state, around, f, p)
    assert (taken.heat, taken.vapour, taken.co2) == (pytest.approx(-9.44), f.mv_air_wall, f.mc_air_wall)


# Vents


def through_vents(opening: float, **weather: Any) -> Array:
    """Flow of the roof vents alone [m3 m-2 s-1] at the reference points."""
    x, u, d, p = AT
    u, d = u.copy(), d.copy()
    u[:, VENT] = opening
    for name, value in weather.items():
        d[:, MODEL.disturbance_names.index(name)] = value
    return MODEL.auxiliary_values(x, u, d, p)["fVentRoof2"]


@pytest.mark.parametrize("opening", [0.01, 0.1, 0.25, 0.5, 0.9])
def test_flow_by_buoyancy_alone_grows_with_the_opening_to_the_power_of_one_and_a_half(opening: float) -> None:
    # 8 K colder outside than inside; at no difference at all there is no buoyancy.
    outside = column(AT.x, "tAir") - 8.0
    flow, most = through_vents(opening, wind=0.0, tOut=outside), through_vents(1.0, wind=0.0, tOut=outside)
    assert (most > 1e-3).all()
    np.testing.assert_allclose(flow / most, opening**1.5, rtol=1e-9)


def test_flow_by_wind_alone_grows_with_the_opening() -> None:
    outside = column(AT.x, "tAir")
    flow, most = through_vents(0.3, wind=5.0, tOut=outside), through_vents(1.0, wind=5.0, tOut=outside)
    np.testing.assert_allclose(flow / most, 0.3, rtol=1e-9)


def test_flow_by_buoyancy_is_six_percent_more_than_de_jong_s() -> None:
    """De Jong (1990) eq. 6.10 for a vent of width ``l`` and height ``h`` of its opening: Cd l / 3 sqrt(g dT / T) h^1.5."""
    opening, difference = 0.4, 8.0
    outside = column(AT.x, "tAir") - difference
    area, full, discharge, floor, g = (column(AT.p, name) for name in ("aRoof", "hVent", "cDgh", "aFlr", "g"))
    mean = column(AT.x, "tAir") - difference / 2 + 273.15
    width, height = area / full, full * opening
    expected = discharge * width / 3 * np.sqrt(g * difference / mean) * height**1.5 / floor
    flow = through_vents(opening, wind=0.0, tOut=outside)
    np.testing.assert_allclose(flow / expected, 3 / (2 * math.sqrt(2)), rtol=1e-9)
    assert pytest.approx(1.06, abs=0.005) == 3 / (2 * math.sqrt(2))


def test_a_vent_that_is_partly_open_is_a_lower_vent_of_the_published_greenhouse() -> None:
    at = drawn(laiTop=1.0, **OFF)
    p = POINTS.inputs.p.copy()
    p[:, TOMATO.parameter_names.index("hVent")] *= at.u[:, VENT]
    keep = [MODEL.state_index(name) for name in TOMATO.state_names]
    partly = (at.u[:, VENT] > 0.0) & (at.u[:, VENT] < 1.0)
    assert partly.sum() > len(partly) / 4
    np.testing.assert_array_equal(MODEL.rhs(*at)[:, keep], TOMATO.rhs(POINTS.inputs.x, at.u, at.d, p))


# Topping


@pytest.mark.parametrize(("after", "lost"), [(-1500.0, 0.0), (-150.0, 0.1192), (0.0, 0.5), (150.0, 0.8808), (1500.0, 1.0)])
def test_the_largest_leaf_area_of_a_topped_crop_falls_to_its_share(after: float, lost: float) -> None:
    """A crop past its topping by so many degree days, half of the width of 300 among them, is picked as one of a lower largest area."""
    top = column(AT.x, "tCanSum") - after
    at = drawn(laiTop=0.4, tSumTop=top, tSumTopWidth=300.0, **OFF)
    picked = MODEL.auxiliary_values(*at)["mcLeafHar"]
    largest = column(at.p, "cLeafMax") * (1.0 - 0.6 * lost)
    excess = (column(at.x, "cLeaf") - largest) / 1e4
    expected = 1e5 / (1.0 + np.exp(np.minimum(-2.0 * math.log(100.0) * excess, 300.0)))
    np.testing.assert_allclose(picked, expected, rtol=0.02)
    rates, plain = MODEL.rhs(*at), MODEL.rhs(*drawn(laiTop=1.0, **OFF))
    assert (np.flatnonzero((rates != plain).any(axis=0)) == MODEL.state_index("cLeaf")).all()


# Derivatives


@pytest.mark.parametrize("wrt", ["x", "u", "d", "p"])
@pytest.mark.parametrize("wind", [0.0, 3.0])
@pytest.mark.parametrize("opening", [0.0, 1.0])
def test_derivatives_are_finite_with_vents_shut_in_calm_and_at_the_topping(wrt: str, wind: float, opening: float) -> None:
    at = drawn(tSumTop=POINTS.inputs.x[:, TOMATO.state_index("tCanSum")])
    u, d = at.u.copy(), at.d.copy()
    u[:, VENT] = opening
    d[:, MODEL.disturbance_names.index("wind")] = wind
    assert np.isfinite(MODEL.jacobian(at.x, u, d, at.p, wrt=wrt)).all()


@pytest.mark.parametrize(
    ("wrt", "names", "some"),
    [
        ("x", MODEL.state_names, ("tMass", "tAir", "vpAir", "co2Air", "cLeaf", "tCanSum")),
        ("u", MODEL.control_names, ("uVent", "uBoil", "uCo2", "uLamp")),
        ("d", MODEL.disturbance_names, ("iGlob", "tOut", "wind")),
        ("p", MODEL.parameter_names, (*OWN, "hVent", "cLeafMax")),
    ],
)
def test_derivatives_are_those_of_differences_also_with_vents_shut(wrt: str, names: tuple[str, ...], some: tuple[str, ...]) -> None:
    """In wind, by night and by day; tests/model/test_derivatives.py has every column by complex steps."""
    day = [k for k, kind in enumerate(POINTS.category) if kind in {"day", "night"}][:12]
    at = Inputs(*(rows[day].copy() for rows in drawn()))
    column(at.p, "tSumTop")[:] = column(at.x, "tCanSum") + np.linspace(-200.0, 200.0, len(day))
    at.u[::2, VENT] = 0.0
    at.d[:, MODEL.disturbance_names.index("wind")] = 4.0
    exact = MODEL.jacobian(*at, wrt=wrt)
    values = getattr(at, wrt)
    for name in some:
        place = names.index(name)
        by = 1e-6 * max(1e-2, float(np.abs(values[:, place]).mean()))
        sides = []
        for sign in (1.0, -1.0):
            table = values.copy()
            table[:, place] += sign * by
            sides.append(MODEL.rhs(*at._replace(**{wrt: table})))
        size = np.abs(exact).max(axis=(0, 2)) * (1e-9 if wrt == "p" else 1e-7) + np.abs(exact[:, :, place]).max(axis=0) + 1e-30
        np.testing.assert_allclose((sides[0] - sides[1]) / (2 * by) / size, exact[:, :, place] / size, rtol=1e-5, atol=2e-5, err_msg=name)
