"""The energy submodel: what closes, its edges, its derivatives, and that it is the plain boiler where it should be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from glbench.errors import ParameterError
from glbench.model import LETTUCE, TOMATO, TOMATO_ENERGY, ChpBoilerBuffer, GreenLightClimate, Step, VanHentenLettuce, compose
from glbench.model.energy import ENERGY_PARAMETERS, EnergyParameters, EnergyState, fluxes, plant
from glbench.model.parameter_checks import check_value
from tests.model.conditions import Inputs, reference_points

POINTS = reference_points()
P = EnergyParameters(*(info.values["benchmark"] for info in ENERGY_PARAMETERS))
SECONDS = 900.0
KWH = 3.6e6


def places(*names: str) -> list[int]:
    return [TOMATO_ENERGY.state_index(name) for name in names]


ADDED = places("eBuf", "sumMcFruitHar", "sumHBufPipe", "sumHDumpOut")


def points() -> Inputs:
    """The reference points with a buffer from empty to full, and controls of the engine and the valve."""
    x, u, d, p = POINTS.inputs
    n = len(x)
    generator = np.random.default_rng(3)
    full = P.e_buf_max
    stored = generator.uniform(0.0, full, n)
    stored[::5], stored[1::5] = 0.0, full
    stored[2::5] = full - P.e_buf_edge * generator.uniform(0.0, 3.0, len(stored[2::5]))
    states = np.hstack([x[:, :-1], stored[:, None], np.zeros((n, 3)), x[:, -1:]])
    more = generator.uniform(0.0, 1.0, (n, 2)) * (generator.random((n, 2)) > 0.2)
    parameters = np.array(P) * generator.uniform(0.9, 1.1, (n, len(P)))
    parameters[:, EnergyParameters._fields.index("e_buf_max")] = full
    return Inputs(states, np.hstack([u, more]), d, np.hstack([p, parameters]))


AT = points()
FLUXES = TOMATO_ENERGY.auxiliary_values(*AT)
CONTROLS = TOMATO_ENERGY.Controls(*AT.u.T)
PARAMETERS = TOMATO_ENERGY.Parameters(*AT.p.T)


def amounts() -> dict[str, Any]:
    """What flows in a step at the points, by name; meters aside, which need its end."""
    states = TOMATO_ENERGY.State(*AT.x.T)
    step = Step(states, states, CONTROLS, PARAMETERS, SECONDS, CONTROLS)
    metered = {meter.flow for meter in TOMATO_ENERGY.meters}
    return {flow.name: flow.amount(step) for flow in TOMATO_ENERGY.flows() if flow.name not in metered and flow.name != "fruit_growth"}


def closes(one: Any, other: Any, size: Any = 1.0) -> None:
    np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * np.max(size))


# The parts


def test_the_table_is_complete_and_possible() -> None:
    assert [info.attribute for info in ENERGY_PARAMETERS] == list(EnergyParameters._fields)
    for info in ENERGY_PARAMETERS:
        assert info.meaning
        assert info.source
        check_value(info, info.values["benchmark"])


def test_the_model_is_named_and_put_together_as_the_others() -> None:
    assert TOMATO_ENERGY.id == "greenlight-tomato-harvest-energy-1.0.0"
    assert TOMATO_ENERGY.control_names == (*TOMATO.control_names, "uChp", "uPipe")
    assert TOMATO_ENERGY.state_names == (
        *TOMATO.state_names[:-1], "eBuf", "sumMcFruitHar", "sumHBufPipe", "sumHDumpOut", "time",
    )  # fmt: skip
    named = {c.name: c for c in TOMATO_ENERGY.capacities(TOMATO_ENERGY_VALUES)}
    assert [named[name].capacity for name in ("uBoil", "uChp", "uPipe")] == pytest.approx([130.0, 50.0, 130.0])
    paths = [signal.path for signal in TOMATO_ENERGY.signals()]
    assert len(set(paths)) == len(paths)
    assert {"controls/engine", "energy/buffer", "energy/buffer_share", "energy/gas_today"} <= set(paths)
    assert next(s for s in TOMATO_ENERGY.signals() if s.path == "controls/boiler").label == "Boiler"


TOMATO_ENERGY_VALUES = dict(zip(TOMATO_ENERGY.parameter_names, TOMATO_ENERGY.parameters.default().tolist(), strict=True))


def test_it_composes_with_another_crop() -> None:
    model = compose(GreenLightClimate(), VanHentenLettuce(), ChpBoilerBuffer())
    first, p = POINTS.inputs.d[0], model.parameters.default()

    state = model.start("young_lettuce", first, 18.0, p)

    assert model.state_names == (*LETTUCE.state_names[:-1], "eBuf", "time")
    assert state[model.state_index("eBuf")] == 0.5 * P.e_buf_max
    assert np.isfinite(model.jacobian(state, np.ones(8), first, p)).all()


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ({"etaChpHeat": 0.7}, "More than all of the engine's gas"),
        ({"eBufEdge": 4.0}, r"eBufEdge \(4\) must be below eBufMax \(3.3\)"),
        ({"etaBoil": 0.0}, "above 0"),
    ],
)
def test_an_impossible_plant_is_refused(override: dict[str, float], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        TOMATO_ENERGY.parameters.default(overrides=override)


# Energy and carbon


def test_gas_is_electricity_heat_and_losses() -> None:
    p, u, flows = PARAMETERS, CONTROLS, amounts()
    gas = flows["gas"] * KWH / SECONDS
    boiler = u.u_boil * p.p_boil / p.a_flr * (1 / p.eta_boil - 1)
    engine = u.u_chp * p.p_chp_el / p.eta_chp_el * (1 - p.eta_chp_el - p.eta_chp_heat)
    electricity = flows["electricity_made"] * KWH / SECONDS
    buffered = FLUXES["hBoilBuf"] + FLUXES["hChpBuf"]

    closes(gas, electricity + buffered + FLUXES["hDumpOut"] + boiler + engine, gas)
    closes((flows["heat"] + flows["engine_heat"]) * KWH / SECONDS, buffered + FLUXES["hDumpOut"], gas)
    assert (gas > 0).sum() > len(gas) / 2


def test_heat_into_the_buffer_is_heat_out_of_it_and_heat_stored() -> None:
    stored = TOMATO_ENERGY.rhs(*AT)[:, TOMATO_ENERGY.state_index("eBuf")]
    given, lost = FLUXES["hBufPipe"], FLUXES["hBufOut"]

    closes(FLUXES["hBoilBuf"] + FLUXES["hChpBuf"], 1e6 * stored + given + lost, 200.0)
    closes(lost, 1e6 * AT.x[:, TOMATO_ENERGY.state_index("eBuf")] / (86400 * PARAMETERS.tau_buf))
    rates = TOMATO_ENERGY.rhs(*AT)
    closes(rates[:, TOMATO_ENERGY.state_index("sumHBufPipe")], given)
    closes(rates[:, TOMATO_ENERGY.state_index("sumHDumpOut")], FLUXES["hDumpOut"])


def test_electricity_made_and_bought_is_used_and_sold() -> None:
    flows = amounts()

    closes(flows["electricity_made"] + flows["electricity_bought"], flows["electricity"] + flows["electricity_sold"], 0.03)
    assert (flows["electricity_bought"] * flows["electricity_sold"] == 0.0).all()
    for name in ("electricity_bought", "electricity_sold"):
        assert (flows[name] >= 0).all()
        assert (flows[name] > 0).any()


def test_lamp_electricity_counts_whole_where_water_cools_the_lamps() -> None:
    p = PARAMETERS._replace(eta_lamp_cool=0.5)
    climate = TOMATO_ENERGY.climate.actuators(CONTROLS, p)

    assert (plant(CONTROLS, p).q_used == climate.q_lamp_in).all()
    assert (climate.h_lamp_cool > 0).any()
    assert (plant(CONTROLS, p).h_boil == plant(CONTROLS, PARAMETERS).h_boil).all()  # what the water takes heats no buffer


def test_carbon_of_the_gas_is_dosed_or_vented_and_what_is_dosed_is_of_gas_or_bought() -> None:
    flows = amounts()

    closes(flows["co2_made"], flows["gas"] * KWH * PARAMETERS.co2_gas * 1e-6)
    closes(flows["co2_made"], flows["co2_from_flue"] + flows["co2_vented"], 1e-2)
    closes(flows["co2_dosed"], flows["co2_from_flue"] + flows["co2_bought"], 1e-2)
    dosed = FLUXES["mcExtAir"] * SECONDS * 1e-6
    closes(flows["co2_dosed"], dosed)
    for name in ("co2_vented", "co2_bought"):
        assert (flows[name] >= 0).all()
        assert (flows[name] > 0).any()


def test_the_engine_s_hours_and_starts_are_counted() -> None:
    known = {flow.name: flow for flow in TOMATO_ENERGY.flows()}

    def counted(name: str, now: list[float], before: list[float]) -> list[float]:
        u, held = (CONTROLS._replace(u_chp=np.array(load)) for load in (now, before))
        return known[name].amount(Step(None, None, u, PARAMETERS, SECONDS, held)).tolist()

    off, on = [0.0] * 4, [0.0, 0.7, 1.0, 0.0]
    assert counted("engine_starts", on, off) == [0.0, 1.0, 1.0, 0.0]
    assert counted("engine_starts", on, on) == [0.0] * 4
    assert counted("engine_starts", off, on) == [0.0] * 4
    assert counted("engine_hours", on, off) == [0.0, 0.25, 0.25, 0.0]


def test_figures_by_hand() -> None:
    # Boiler and engine at 1, buffer at 1 MJ, valve half open: 130/0.95 + 50/0.4 = 261.842 W of gas, 0.0561 of that 14.6893 mg of CO2.
    values = TOMATO_ENERGY.parameters.default()
    u = TOMATO_ENERGY.Controls(1.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.5)
    now = plant(u, TOMATO_ENERGY.Parameters(*values))
    f = fluxes(EnergyState(1.0), u, 130.0, P)

    assert now.gas == pytest.approx(261.8421, abs=1e-4)
    assert (now.h_boil, now.h_chp) == pytest.approx((130.0, 62.5))
    assert (now.q_made, now.q_used) == pytest.approx((50.0, 116.0))
    assert (now.mc_flue, now.mc_dosed) == pytest.approx((14.68934, 5.0), abs=1e-5)
    assert f.h_boil_buf + f.h_chp_buf == pytest.approx(192.5)
    assert f.h_buf_pipe == pytest.approx(65.0)
    assert f.h_buf_out == pytest.approx(0.578704, abs=1e-6)  # 1e6 J / (20 * 86400 s)


# The plain boiler


def test_the_greenhouse_is_that_of_a_plain_boiler_of_the_same_pipe_heat() -> None:
    x, u, d, p = AT
    plain = np.delete(x, ADDED, axis=1)
    heated = u[:, :6].copy()
    heated[:, 0] = FLUXES["hBufPipe"] / (PARAMETERS.p_boil / PARAMETERS.a_flr)

    rates = np.delete(TOMATO_ENERGY.rhs(*AT), ADDED, axis=1)
    expected = TOMATO.rhs(plain, heated, d, p[:, : len(TOMATO.table)])

    size = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(rates / size, expected / size, rtol=1e-11, atol=1e-11)


# Edges

stores = st.floats(0.0, P.e_buf_max)
loads = st.floats(0.0, 1.0)


@given(stores, loads, loads, loads)
def test_no_flux_is_negative_and_no_edge_is_passed(stored: float, boiler: float, engine: float, valve: float) -> None:
    u = TOMATO_ENERGY.Controls(boiler, 0.0, 0.0, 0.0, 0.0, 0.0, engine, valve)
    f = fluxes(EnergyState(stored), u, 130.0, P)

    assert min(f) >= 0.0
    empty, full = (fluxes(EnergyState(edge), u, 130.0, P) for edge in (0.0, P.e_buf_max))
    assert (empty.h_buf_pipe, empty.h_buf_out) == (0.0, 0.0)
    assert (full.h_boil_buf, full.h_chp_buf) == (0.0, 0.0)
    assert full.h_dump_out == pytest.approx(130.0 * boiler + 62.5 * engine)


def test_a_buffer_that_starts_beyond_its_limit_takes_nothing() -> None:
    u = TOMATO_ENERGY.Controls(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
    f = fluxes(EnergyState(2 * P.e_buf_max), u, 130.0, P)

    assert (f.h_boil_buf, f.h_chp_buf, f.h_dump_out) == (0.0, 0.0, 192.5)


# Derivatives


def stepwise(wrt: str, column: int, by: float) -> Any:
    up, down = (AT._replace(**{wrt: getattr(AT, wrt).copy()}) for _ in range(2))
    getattr(up, wrt)[:, column] += by
    getattr(down, wrt)[:, column] -= by
    return (TOMATO_ENERGY.rhs(*up) - TOMATO_ENERGY.rhs(*down)) / (2 * by)


@pytest.mark.parametrize(
    ("wrt", "names", "every"),
    [
        ("x", TOMATO_ENERGY.state_names, ("eBuf",)),
        ("u", TOMATO_ENERGY.control_names, ("uBoil", "uChp", "uPipe")),
        ("p", TOMATO_ENERGY.parameter_names, tuple(info.name for info in ENERGY_PARAMETERS)),
    ],
)
def test_derivatives_are_finite_and_those_of_differences(wrt: str, names: tuple[str, ...], every: tuple[str, ...]) -> None:
    exact = TOMATO_ENERGY.jacobian(*AT, wrt=wrt)
    assert np.isfinite(exact).all()
    # At the very limit the slope of what is refused has two sides; differences see their mean.
    inside = AT.x[:, TOMATO_ENERGY.state_index("eBuf")] < P.e_buf_max
    for name in every:
        column = names.index(name)
        found = stepwise(wrt, column, 1e-5 * max(1e-2, float(np.abs(getattr(AT, wrt)[:, column]).mean())))
        size = np.abs(exact[:, :, column]).max(axis=0) + 1e-12
        np.testing.assert_allclose((found / size)[inside], (exact[:, :, column] / size)[inside], rtol=1e-5, atol=1e-5, err_msg=name)


@pytest.mark.parametrize("kind", [casadi.SX, casadi.MX])
def test_symbols_numbers_and_arrays_give_the_same(kind: Callable[..., Any]) -> None:
    z = np.vstack([AT.x[:, TOMATO_ENERGY.state_index("eBuf")], AT.u.T, AT.p.T])
    symbols = kind.sym("z", len(z))  # type: ignore[attr-defined]

    def everything(values: Any) -> tuple[Any, ...]:
        u = TOMATO_ENERGY.Controls(*values[1:9])
        p = TOMATO_ENERGY.Parameters(*values[9:])
        own = EnergyParameters(*(getattr(p, name) for name in EnergyParameters._fields))
        return (*fluxes(EnergyState(values[0]), u, p.p_boil / p.a_flr, own), *plant(u, p))

    function = casadi.Function("energy", [symbols], [casadi.vertcat(*everything(casadi.vertsplit(symbols)))])
    by_symbols = function.map(z.shape[1])(z).full()
    by_arrays = np.array([np.broadcast_to(value, z.shape[1]) for value in everything(z)])

    np.testing.assert_allclose(by_symbols, by_arrays, rtol=1e-13, atol=1e-13)
