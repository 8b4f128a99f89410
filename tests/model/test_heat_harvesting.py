"""Heat harvesting: what closes, its edges, its derivatives, what the author's code gives, and that it is nothing when it is off."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.errors import GlbenchError, ParameterError
from glbench.model import (
    HARVEST_METERS,
    LETTUCE,
    TOMATO,
    TOMATO_HEAT_PUMP,
    ChpBoilerBuffer,
    Climate,
    GreenLightClimate,
    HeatHarvesting,
    Horizon,
    Step,
    VanHentenLettuce,
    VanthoorTomato,
    compose,
    saturation_vapour_pressure,
)
from glbench.model.heat_harvesting import HARVEST_PARAMETERS, HarvestParameters, HarvestState, cooler, fluxes
from glbench.model.parameter_checks import check_value
from tests.model.conditions import Inputs, reference_points

MODEL = TOMATO_HEAT_PUMP
POINTS = reference_points()
P = HarvestParameters(*(info.values["benchmark"] for info in HARVEST_PARAMETERS))
LATENT = 2.45e6
SECONDS = 900.0
OWN = slice(6, 9)
BUFFERS = (MODEL.state_index("eBufCold"), MODEL.state_index("eBufHot"))
ADDED = [
    MODEL.state_index(name) for name in ("eBufCold", "eBufHot", "sumMcFruitHar", "sumQHeatPumpIn", "sumHMechBufCold", "sumHBufHotPipe")
]


def points() -> Inputs:
    """The reference points with buffers from empty to full, and controls of cooler, heat pump and valve."""
    x, u, d, p = POINTS.inputs
    n = len(x)
    generator = np.random.default_rng(4)
    full = np.array([P.e_buf_cold_max, P.e_buf_hot_max])
    stored = generator.uniform(0.0, full, (n, 2))
    stored[::5], stored[1::5] = 0.0, full
    stored[2::5] = full - P.e_mech_edge * generator.uniform(0.0, 3.0, (len(stored[2::5]), 2))
    states = np.hstack([x[:, :-1], stored, np.zeros((n, 4)), x[:, -1:]])
    more = generator.uniform(0.0, 1.0, (n, 3)) * (generator.random((n, 3)) > 0.2)
    parameters = np.array(P) * generator.uniform(0.9, 1.1, (n, len(P)))
    for name in ("e_buf_cold_max", "e_buf_hot_max"):
        parameters[:, HarvestParameters._fields.index(name)] = getattr(P, name)
    return Inputs(states, np.hstack([u, more]), d, np.hstack([p, parameters]))


AT = points()
FLUXES = MODEL.auxiliary_values(*AT)
CONTROLS = MODEL.Controls(*AT.u.T)
PARAMETERS = MODEL.Parameters(*AT.p.T)


def closes(one: Any, other: Any, size: Any = 1.0) -> None:
    np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * np.max(size))


# The parts


def test_the_table_is_complete_and_possible() -> None:
    assert [info.attribute for info in HARVEST_PARAMETERS] == list(HarvestParameters._fields)
    for info in HARVEST_PARAMETERS:
        assert info.meaning
        assert info.source
        check_value(info, info.values["benchmark"])
    assert pytest.approx(62.5) == P.cop_heat_pump * P.p_heat_pump
    water = 0.01 * 1e3 * 4184e-6  # MJ m-2 K-1: 0.01 m3 of water
    assert (P.e_buf_cold_max, P.e_buf_hot_max) == pytest.approx((10 * water, 20 * water))


def test_the_model_is_named_and_put_together_as_the_others() -> None:
    assert MODEL.id == "greenlight-tomato-harvest-heat-pump-1.0.0"
    assert MODEL.control_names == (*TOMATO.control_names, "uMech", "uHeatPump", "uBufHot")
    assert MODEL.state_names == (
        *TOMATO.state_names[:-1],
        *("eBufCold", "eBufHot", "sumMcFruitHar", "sumQHeatPumpIn", "sumHMechBufCold", "sumHBufHotPipe", "time"),
    )
    named = {c.name: c for c in MODEL.capacities(VALUES)}
    assert [named[name].capacity for name in ("uBoil", "uMech", "uHeatPump", "uBufHot")] == pytest.approx([130.0, 200.0, 62.5, 150.0])
    paths = [signal.path for signal in MODEL.signals()]
    assert len(set(paths)) == len(paths)
    assert {"controls/cooler", "controls/heat_pump", "energy/cold_buffer", "energy/hot_buffer_share"} <= set(paths)


VALUES = dict(zip(MODEL.parameter_names, MODEL.parameters.default().tolist(), strict=True))


def test_its_columns_have_its_bounds() -> None:
    horizon = Horizon(96, 900.0, VALUES)
    columns = {seen.name: seen for seen in MODEL.observed("heat_harvesting", horizon) or ()}
    assert list(columns) == ["cold_buffer_heat", "cold_buffer_share", "hot_buffer_heat", "hot_buffer_share"]
    bounds = MODEL.bounds(horizon)
    state, p = MODEL.State(*AT.x.T), MODEL.parameters.record(*MODEL.parameters.default())
    for word, name, full in (("cold", "eBufCold", P.e_buf_cold_max), ("hot", "eBufHot", P.e_buf_hot_max)):
        heat, share = columns[f"{word}_buffer_heat"], columns[f"{word}_buffer_share"]
        assert (heat.source, (heat.low, heat.high)) == (name, bounds[name])
        assert -0.02 * full < bounds[name][0] < 0.0
        assert full < bounds[name][1] < 1.05 * full
        assert share.of is not None
        closes(share.of(state, p), 100 * AT.x[:, MODEL.state_index(name)] / full, 100.0)


def test_it_composes_with_another_crop() -> None:
    model = compose(GreenLightClimate(), VanHentenLettuce(), HeatHarvesting(), meters=HARVEST_METERS)
    first, p = POINTS.inputs.d[0], model.parameters.default()

    state = model.start("young_lettuce", first, 18.0, p)

    meters = ("sumQHeatPumpIn", "sumHMechBufCold", "sumHBufHotPipe")
    assert model.state_names == (*LETTUCE.state_names[:-1], "eBufCold", "eBufHot", *meters, "time")
    assert state[model.state_index("eBufCold")] == 0.5 * P.e_buf_cold_max
    assert state[model.state_index("eBufHot")] == 0.5 * P.e_buf_hot_max
    assert np.isfinite(model.jacobian(state, np.ones(9), first, p)).all()


def test_after_the_energy_system_both_buffers_heat_the_pipes() -> None:
    model = compose(GreenLightClimate(), VanthoorTomato(), ChpBoilerBuffer(), HeatHarvesting())
    first, p = POINTS.inputs.d[0], model.parameters.default()
    state = model.start("mature_crop", first, 18.0, p)
    found = model.auxiliary_values(state, np.full(11, 0.5), first, p)

    closes(found["hBoilPipe"], found["hBufPipe"] + found["hBufHotPipe"], 100.0)
    assert min(found["hBufPipe"], found["hBufHotPipe"]) > 50.0


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ({"copHeatPump": 0.9}, "copHeatPump is 0.9: a heat pump gives its electricity as heat"),
        ({"eMechEdge": 0.5}, r"eMechEdge \(0.5\) must be below eBufColdMax \(0.4184\)"),
        ({"tMechEdge": 0.0}, "above 0"),
    ],
)
def test_impossible_machines_are_refused(override: dict[str, float], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        MODEL.parameters.default(overrides=override)


def test_a_climate_that_does_not_say_how_its_air_gives_heat_is_refused() -> None:
    class Sealed(GreenLightClimate):
        without = Climate.without

    with pytest.raises(GlbenchError, match="greenlight has no method `without`, so no addition can take heat"):
        _ = compose(Sealed(), VanthoorTomato(), HeatHarvesting()).digest


# What closes


def test_heat_and_vapour_that_the_air_loses_are_those_of_the_cooler() -> None:
    off = AT.u.copy()
    off[:, 6] = 0.0
    lost = MODEL.rhs(*AT._replace(u=off)) - MODEL.rhs(*AT)
    air, vapour = MODEL.state_index("tAir"), MODEL.state_index("vpAir")

    assert (FLUXES["hAirMech"] > 1.0).sum() > len(lost) / 2
    assert (FLUXES["mvAirMech"] > 1e-6).sum() > len(lost) / 2
    rates = np.abs(MODEL.rhs(*AT)).max(axis=0)
    closes(lost[:, air] * PARAMETERS.cap_air, FLUXES["hAirMech"], rates[air] * PARAMETERS.cap_air)
    closes(lost[:, vapour] * FLUXES["capVpAir"], FLUXES["mvAirMech"], rates[vapour] * FLUXES["capVpAir"])
    closes(FLUXES["lAirMech"], PARAMETERS.L * FLUXES["mvAirMech"], 200.0)
    closes(FLUXES["hMechBufCold"], FLUXES["hAirMech"] + FLUXES["lAirMech"], 200.0)
    others = [k for k in range(lost.shape[1]) if k not in (air, vapour, *ADDED)]
    assert not lost[:, others].any()


def test_heat_of_the_hot_buffer_is_that_of_the_cold_one_and_electricity() -> None:
    f = FLUXES
    closes(f["hHeatPumpBufHot"], f["hBufColdHeatPump"] + f["qHeatPumpIn"], 62.5)
    closes(f["hHeatPumpBufHot"], PARAMETERS.cop_heat_pump * f["qHeatPumpIn"], 62.5)
    assert (f["qHeatPumpIn"] > 1.0).sum() > len(AT.x) / 3


def test_heat_into_a_buffer_is_heat_out_of_it_and_heat_stored() -> None:
    rates, f = MODEL.rhs(*AT), FLUXES
    cold, hot = (1e6 * rates[:, place] for place in BUFFERS)
    closes(f["hMechBufCold"], cold + f["hBufColdHeatPump"], 200.0)
    closes(f["hHeatPumpBufHot"], hot + f["hBufHotPipe"], 200.0)
    for name in ("QHeatPumpIn", "HMechBufCold", "HBufHotPipe"):
        metered = rates[:, MODEL.state_index(f"sum{name}")]
        closes(metered, f[f"{name[0].lower()}{name[1:]}"], 200.0)
    closes(f["hBoilPipe"], CONTROLS.u_boil * PARAMETERS.p_boil / PARAMETERS.a_flr + f["hBufHotPipe"], 200.0)


def test_electricity_of_the_cooler_follows_its_control() -> None:
    (flow,) = (one for one in MODEL.flows() if one.name == "electricity_cooler")
    used = flow.amount(Step(None, None, CONTROLS, PARAMETERS, SECONDS, CONTROLS))

    closes(used * 3.6e6 / SECONDS, AT.u[:, 6] * PARAMETERS.eta_mech * PARAMETERS.p_mech, 12.5)
    assert flow.unit == "kWh m-2"


# The author's equations, and figures by hand


def author(t_air: float, vp_air: float, u: float) -> tuple[float, float]:
    """Sensible heat [W m-2] and condensation [kg m-2 s-1] as written in addHeatHarvesting.m."""
    excess = vp_air - float(saturation_vapour_pressure(P.t_mech))
    hec = u * P.cop_mech * P.p_mech / (t_air - P.t_mech + 6.4e-9 * LATENT * excess)
    return abs(hec) * (t_air - P.t_mech), 6.4e-9 * abs(hec) * excess / (1 + math.exp(-0.1 * excess))


@pytest.mark.parametrize("t_air", [16.0, 20.0, 28.0, 36.0])
@pytest.mark.parametrize("humidity", [0.75, 0.85, 1.0])
def test_in_air_that_is_warm_and_moist_the_cooler_is_the_author_s(t_air: float, humidity: float) -> None:
    vp_air = humidity * float(saturation_vapour_pressure(t_air))
    _, sensible, condensed, latent = cooler(t_air, vp_air, 0.7 * P.cop_mech * P.p_mech, LATENT, P)

    assert (sensible, condensed) == pytest.approx(author(t_air, vp_air, 0.7), rel=0.01)
    assert sensible + latent == pytest.approx(140.0, rel=0.01)


def test_figures_by_hand() -> None:
    # Air of 20 °C with 2000 Pa, surface of 10 °C with 1224.4 Pa: 10 K warmer, 775.6 Pa or 12.161 K moister, 22.161 K or, with the edge of
    # 1 K, 22.184 K together. 200 W m-2 / 22.184 K = 9.0157 W m-2 K-1.
    state, u = HarvestState(0.2, 0.4), MODEL.Controls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.5)
    assert saturation_vapour_pressure(10.0) == pytest.approx(1224.4, abs=0.1)
    f = fluxes(state, 20.0, 2000.0, u, LATENT, P)

    taken, given_cold, given_hot = 1 - math.exp(-0.2184 / 0.03), 1 - math.exp(-0.2 / 0.03), 1 - math.exp(-0.4 / 0.03)
    room = 1 - math.exp(-0.4368 / 0.03)
    assert f.hec_air_mech == pytest.approx(9.0157 * taken, abs=1e-3)
    assert f.h_air_mech == pytest.approx(90.157 * taken, abs=0.01)
    assert f.l_air_mech == pytest.approx(109.64 * taken, abs=0.01)
    assert f.mv_air_mech == pytest.approx(4.475e-5 * taken, abs=1e-8)  # 0.16 kg m-2 h-1
    assert f.q_heat_pump_in == pytest.approx(11.3636 * given_cold * room, abs=1e-3)
    assert f.h_buf_cold_heat_pump == pytest.approx(51.136 * given_cold * room, abs=1e-3)
    assert f.h_heat_pump_buf_hot == pytest.approx(62.5 * given_cold * room, abs=1e-3)
    assert f.h_buf_hot_pipe == pytest.approx(75.0 * given_hot, abs=1e-3)


# Off


def test_what_is_off_changes_nothing() -> None:
    off = AT.u.copy()
    off[:, OWN] = 0.0
    rates = MODEL.rhs(*AT._replace(u=off))
    plain = TOMATO.rhs(*POINTS.inputs)

    np.testing.assert_array_equal(np.delete(rates, ADDED, axis=1), plain)
    assert not rates[:, BUFFERS].any()


def test_the_greenhouse_of_the_hot_buffer_is_that_of_a_boiler_of_the_same_heat() -> None:
    x, u, d, p = AT
    only = u.copy()
    only[:, 6:8] = 0.0
    heated = u[:, :6].copy()
    heated[:, 0] += FLUXES["hBufHotPipe"] / (PARAMETERS.p_boil / PARAMETERS.a_flr)

    rates = np.delete(MODEL.rhs(x, only, d, p), ADDED, axis=1)
    expected = TOMATO.rhs(np.delete(x, ADDED, axis=1), heated, d, p[:, : len(TOMATO.table)])

    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(rates / size, expected / size, rtol=1e-11, atol=1e-11)


# Edges

loads = st.floats(0.0, 1.0)


@given(
    st.floats(0.0, P.e_buf_cold_max), st.floats(0.0, P.e_buf_hot_max), loads, loads, loads, st.floats(-5.0, 45.0),
    st.floats(100.0, 6000.0),
)  # fmt: skip
def test_no_flux_is_negative_and_no_edge_is_passed(
    cold: float, hot: float, cooling: float, pump: float, valve: float, t_air: float, vp_air: float
) -> None:
    u = MODEL.Controls(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, cooling, pump, valve)

    def at(cold: float, hot: float) -> Any:
        return fluxes(HarvestState(cold, hot), t_air, vp_air, u, LATENT, P)

    f = at(cold, hot)
    assert min(f) >= 0.0
    assert f.h_mech_buf_cold <= 200.0 * cooling * (1 + 1e-12)
    empty, full = at(0.0, 0.0), at(P.e_buf_cold_max, P.e_buf_hot_max)
    assert (empty.q_heat_pump_in, empty.h_buf_cold_heat_pump, empty.h_buf_hot_pipe) == (0.0, 0.0, 0.0)
    assert (full.h_mech_buf_cold, full.mv_air_mech, full.h_heat_pump_buf_hot) == (0.0, 0.0, 0.0)
    assert at(cold, P.e_buf_hot_max).q_heat_pump_in == 0.0


def test_buffers_that_start_beyond_their_limits_take_nothing() -> None:
    u = MODEL.Controls(*(0.0,) * 6, 1.0, 1.0, 0.0)
    f = fluxes(HarvestState(2 * P.e_buf_cold_max, 2 * P.e_buf_hot_max), 25.0, 2500.0, u, LATENT, P)

    assert (f.h_mech_buf_cold, f.h_heat_pump_buf_hot) == (0.0, 0.0)


def test_air_no_warmer_and_no_moister_than_the_cooler_gives_nothing() -> None:
    saturated = float(saturation_vapour_pressure(P.t_mech))
    for t_air, vp_air in ((10.0, saturated), (10.0, 500.0), (-3.0, 400.0), (5.0, saturated - 12.8)):
        assert cooler(t_air, vp_air, 200.0, LATENT, P)[1:] == (0.0, 0.0, 0.0)
    # Cold and moist, warm and dry: only the one that there is.
    _, sensible, condensed, _ = cooler(9.0, saturated + 100.0, 200.0, LATENT, P)
    assert (sensible, condensed > 0.0) == (0.0, True)
    _, sensible, condensed, _ = cooler(25.0, saturated - 400.0, 200.0, LATENT, P)
    assert condensed == 0.0
    assert sensible == pytest.approx(200.0, rel=0.01)


# Derivatives


def added(at: Inputs) -> Any:
    """What heat harvesting adds to the rates. The rates themselves have steep places, where main and top air are as warm as each other."""
    off = at.u.copy()
    off[:, OWN] = 0.0
    return MODEL.rhs(*at) - MODEL.rhs(*at._replace(u=off))


def slope(wrt: str) -> Any:
    off = AT.u.copy()
    off[:, OWN] = 0.0
    exact = MODEL.jacobian(*AT, wrt=wrt)
    return exact - MODEL.jacobian(*AT._replace(u=off), wrt=wrt) if wrt != "u" else exact


def stepwise(wrt: str, column: int, by: float) -> Any:
    rates = MODEL.rhs if wrt == "u" else lambda *inputs: added(Inputs(*inputs))
    up, down = (AT._replace(**{wrt: getattr(AT, wrt).copy()}) for _ in range(2))
    getattr(up, wrt)[:, column] += by
    getattr(down, wrt)[:, column] -= by
    return (rates(*up) - rates(*down)) / (2 * by)


@pytest.mark.parametrize(
    ("wrt", "names", "every"),
    [
        ("x", MODEL.state_names, ("eBufCold", "eBufHot", "tAir", "vpAir")),
        ("u", MODEL.control_names, ("uBoil", "uMech", "uHeatPump", "uBufHot")),
        ("p", MODEL.parameter_names, tuple(info.name for info in HARVEST_PARAMETERS)),
    ],
)
def test_derivatives_are_finite_and_those_of_differences(wrt: str, names: tuple[str, ...], every: tuple[str, ...]) -> None:
    assert np.isfinite(MODEL.jacobian(*AT, wrt=wrt)).all()
    exact = slope(wrt)
    # Where something ends, at the limit of a buffer or where the air is as the cooler, a slope has two sides; differences see their mean.
    x, t_mech = AT.x, PARAMETERS.t_mech
    excess = x[:, MODEL.state_index("vpAir")] - saturation_vapour_pressure(t_mech)
    inside = (x[:, BUFFERS[0]] < P.e_buf_cold_max) & (x[:, BUFFERS[1]] < P.e_buf_hot_max)
    inside &= (np.abs(x[:, MODEL.state_index("tAir")] - t_mech) > 0.01) & (np.abs(excess) > 1.0)
    assert inside.sum() > len(x) / 2
    for name in every:
        column = names.index(name)
        found = stepwise(wrt, column, 1e-5 * max(1e-2, float(np.abs(getattr(AT, wrt)[:, column]).mean())))
        size = np.abs(exact[:, :, column]).max(axis=0) + 1e-8
        np.testing.assert_allclose((found / size)[inside], (exact[:, :, column] / size)[inside], rtol=1e-5, atol=1e-5, err_msg=name)


def test_derivatives_are_finite_where_the_air_is_as_the_cooler() -> None:
    x = AT.x.copy()
    x[:, MODEL.state_index("tAir")] = PARAMETERS.t_mech
    x[:, MODEL.state_index("vpAir")] = saturation_vapour_pressure(PARAMETERS.t_mech)
    for wrt in MODEL.INPUTS:
        assert np.isfinite(MODEL.jacobian(x, *AT[1:], wrt=wrt)).all()


@pytest.mark.parametrize("kind", [casadi.SX, casadi.MX])
def test_symbols_numbers_and_arrays_give_the_same(kind: Callable[..., Any]) -> None:
    air = [AT.x[:, MODEL.state_index(name)] for name in ("tAir", "vpAir")]
    z = np.vstack([AT.x[:, BUFFERS].T, *air, AT.u.T, AT.p[:, -len(P) :].T])
    symbols = kind.sym("z", len(z))  # type: ignore[attr-defined]

    def everything(v: Any) -> tuple[Any, ...]:
        u = MODEL.Controls(*v[4:13])
        return tuple(fluxes(HarvestState(*v[:2]), v[2], v[3], u, LATENT, HarvestParameters(*v[13:])))

    function = casadi.Function("harvest", [symbols], [casadi.vertcat(*everything(casadi.vertsplit(symbols)))])
    by_symbols = function.map(z.shape[1])(z).full()
    by_arrays = np.array([np.broadcast_to(value, z.shape[1]) for value in everything(z)])

    np.testing.assert_allclose(by_symbols, by_arrays, rtol=1e-13, atol=1e-13)
