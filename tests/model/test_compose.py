"""Models are values: composed of submodels, equal when these are, with everything above them to be asked for."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pytest

from glbench.errors import GlbenchError, UnknownNameError
from glbench.model import LETTUCE, TOMATO, Horizon, Meter, compose, get_model, paper, register_model, tomato
from glbench.model.actuators import Actuators
from glbench.model.crop import lettuce as equations
from glbench.model.crop.tomato import VanthoorTomato
from glbench.model.expressions import Expr
from glbench.model.greenlight import GreenLightClimate
from glbench.model.model import Flow, Model, Step
from glbench.model.parameter_table import Parameter
from glbench.model.quantities import Quantity, Variable
from glbench.model.submodels import Addition, Around
from tests.model.conditions import reference_points

POINTS = reference_points()
HARVEST = Meter("mc_fruit_har", "fruit_harvested", "mg m-2", "fruit harvested", "Harvest")


class WaterState(NamedTuple):
    m_tank: Annotated[Expr, Variable("kg m-2", "water in the tank", scale=100.0, small=1.0)]


class WaterControls(NamedTuple):
    u_fill: Annotated[Expr, Quantity("-", "tap of the tank, 1 = phiFill")]


class WaterParameters(NamedTuple):
    phi_fill: Annotated[Expr, Parameter("kg m-2 s-1", "flow of the tap", 1e-3, check="nonnegative")]


class WaterFluxes(NamedTuple):
    mw_tap_tank: Annotated[Expr, Quantity("kg m-2 s-1", "water, tap to tank")]
    mw_tank_can: Annotated[Expr, Quantity("kg m-2 s-1", "water, tank to canopy")]


@dataclass(frozen=True)
class WaterTank(Addition):
    """Rain water that the crop transpires."""

    name: ClassVar[str] = "water"
    State: ClassVar[type[Any]] = WaterState
    Controls: ClassVar[type[Any]] = WaterControls
    Parameters: ClassVar[type[Any]] = WaterParameters

    def processes(self, x: WaterState, around: Around, p: WaterParameters) -> WaterFluxes:
        return WaterFluxes(around.controls.u_fill * p.phi_fill, around.climate.transpiration.mv_can_air)

    def rates(self, x: WaterState, around: Around, fluxes: WaterFluxes, p: WaterParameters) -> WaterState:
        return WaterState(fluxes.mw_tap_tank - fluxes.mw_tank_can)

    def flows(self) -> tuple[Flow, ...]:
        return (
            Flow(
                "water",
                "kg m-2",
                "water from the tap",
                "Water",
                lambda s: s.controls.u_fill * (s.parameters.phi_fill * s.seconds),
            ),
        )

    def start(self, d: Any, air_temperature: float, p: WaterParameters) -> WaterState:
        return WaterState(50.0)


@dataclass(frozen=True)
class HalfTheHeat(Addition):
    """A broken boiler."""

    name: ClassVar[str] = "broken"

    def supply(self, act: Actuators, x: Any, u: Any, p: Any) -> Actuators:
        return act._replace(h_boil_pipe=0.5 * act.h_boil_pipe)


def horizon(model: Model) -> Horizon:
    return Horizon(5760, 900.0, dict(zip(model.parameter_names, model.parameters.default(), strict=True)))


def with_water() -> Any:
    return compose(GreenLightClimate(), VanthoorTomato(), WaterTank())


def inputs(model: Any) -> tuple[np.ndarray, ...]:
    """The points of the tomato model, with what another model has more of: tank at 50 kg m-2, tap half open."""
    x, u, d, p = POINTS.inputs
    n = len(x)
    more = len(model.states) - x.shape[1]
    x = np.hstack([x[:, :-1], np.full((n, more), 50.0), x[:, -1:]])
    u = np.hstack([u, np.full((n, len(model.controls) - u.shape[1]), 0.5)])
    p = np.hstack([p, np.full((n, len(model.table) - p.shape[1]), 1e-3)])
    return x, u, d, p


def test_an_addition_changes_nothing_of_the_greenhouse_that_it_only_reads() -> None:
    model = with_water()

    derivative = model.rhs(*inputs(model))
    plain = TOMATO.rhs(*POINTS.inputs)

    assert model.id == "greenlight-tomato-water-1.0.0"
    assert model.state_names == (*TOMATO.state_names[:-1], "mTank", "time")
    assert model.control_names == (*TOMATO.control_names, "uFill")
    np.testing.assert_array_equal(np.delete(derivative, -2, axis=1), plain)
    transpired = TOMATO.auxiliary_values(*POINTS.inputs)["mvCanAir"]
    np.testing.assert_allclose(derivative[:, -2], 0.5e-3 - transpired, rtol=1e-12)


def test_an_addition_stands_between_the_actuators_and_the_climate() -> None:
    x, u, d, p = POINTS.inputs
    halved = u.copy()
    halved[:, 0] *= 0.5

    broken = compose(GreenLightClimate(), VanthoorTomato(), HalfTheHeat()).rhs(x, u, d, p)

    np.testing.assert_allclose(broken, TOMATO.rhs(x, halved, d, p), rtol=1e-12, atol=1e-15)


def test_a_meter_adds_up_its_flux_and_prices_can_be_put_on_it() -> None:
    model = compose(GreenLightClimate(), VanthoorTomato(), meters=(HARVEST,), name="metered")
    x, u, d, p = inputs(model)

    rates = model.rhs(x, u, d, p)

    assert model.state_names[-2:] == ("sumMcFruitHar", "time")
    np.testing.assert_array_equal(rates[:, -2], TOMATO.auxiliary_values(*POINTS.inputs)["mcFruitHar"])
    np.testing.assert_array_equal(np.delete(rates, -2, axis=1), TOMATO.rhs(*POINTS.inputs))
    (flow,) = (flow for flow in model.flows() if flow.name == "fruit_harvested")
    before, after = model.State(*x[0]), model.State(*x[0])._replace(sum_mc_fruit_har=57.0)
    assert flow.amount(Step(before, after, None, None, 900.0)) == 7.0


def test_a_meter_of_a_flux_that_nobody_has_is_refused() -> None:
    model = compose(GreenLightClimate(), VanthoorTomato(), meters=(replace(HARVEST, flux="mc_fruit"),))

    with pytest.raises(GlbenchError, match="No process has a flux 'mc_fruit'"):
        model.rhs_function()


def test_two_submodels_cannot_have_one_name_twice() -> None:
    @dataclass(frozen=True)
    class Second(WaterTank):
        name: ClassVar[str] = "second"

    with pytest.raises(GlbenchError, match="second and water both have a state called 'mTank'"):
        compose(GreenLightClimate(), VanthoorTomato(), WaterTank(), Second())


def test_equal_models_are_one_key_and_survive_pickling() -> None:
    assert compose(GreenLightClimate(), VanthoorTomato()) == TOMATO
    assert with_water() != TOMATO
    assert {TOMATO: 1}[compose(GreenLightClimate(), VanthoorTomato())] == 1
    assert pickle.loads(pickle.dumps(with_water())) == with_water()
    assert tomato("gl_gym2") != TOMATO
    assert tomato("gl_gym2").digest != TOMATO.digest


def test_the_start_of_a_composed_model_is_that_of_its_submodels() -> None:
    model = with_water()
    first = POINTS.inputs.d[0]

    state = model.start("mature_crop", first, 18.0, model.parameters.default())

    np.testing.assert_array_equal(
        np.delete(state, -2), TOMATO.start("mature_crop", first, 18.0, TOMATO.parameters.default())
    )
    assert state[-2] == 50.0
    with pytest.raises(UnknownNameError, match=r"no start 'mature'.*'mature_crop'"):
        model.start("mature", first, 18.0, model.parameters.default())


@pytest.mark.parametrize("model", [TOMATO, LETTUCE], ids=str)
def test_every_state_and_observed_column_has_finite_bounds_in_order(model: Model) -> None:
    bounds: Mapping[str, tuple[float, float]] = model.bounds(horizon(model))

    assert set(bounds) == set(model.state_names)
    assert all(np.isfinite([low, high]).all() and low < high for low, high in bounds.values())
    for module in model.observation_modules:
        columns = model.observed(module, horizon(model))
        assert columns
        assert all(np.isfinite([c.low, c.high]).all() and c.low < c.high for c in columns)
    assert model.observed("roots", horizon(model)) is None


def test_an_installed_package_can_bring_a_model(monkeypatch: pytest.MonkeyPatch) -> None:
    class Entry:
        def load(self) -> Any:
            return lambda: register_model(with_water())

    monkeypatch.setattr(paper, "_MODELS", dict(paper._MODELS))
    monkeypatch.setattr(paper, "entry_points", lambda group: [Entry()] if group == "glbench.models" else [])
    paper._load_plugins.cache_clear()

    assert get_model("greenlight-tomato-water-1.0.0") == with_water()
    paper._load_plugins.cache_clear()


def test_models_are_known_by_id_and_variant_and_an_id_means_one_model() -> None:
    assert get_model("greenlight-tomato-1.0.0") is TOMATO
    assert get_model("greenlight-tomato-1.0.0", "gl_gym2") == tomato("gl_gym2")
    with pytest.raises(UnknownNameError, match=r"no model 'greenlight-tomatoes-1.0.0'.*'greenlight-tomato-1.0.0'"):
        get_model("greenlight-tomatoes-1.0.0")
    with pytest.raises(UnknownNameError, match=r"another model 'greenlight-tomato-1.0.0'"):
        register_model(compose(GreenLightClimate(), VanthoorTomato(), WaterTank(), name="greenlight-tomato"))


@pytest.mark.parametrize("model", [TOMATO, LETTUCE], ids=str)
def test_what_is_drawn_exists(model: Model) -> None:
    known = {*model.state_names, *model.control_names, *model.disturbance_names}
    assert {signal.source for signal in model.signals() if signal.of is None} <= known
    assert {f"controls/{name}" for name in ("boiler", "lamps")} <= {signal.path for signal in model.signals()}


def test_lettuce_grows_in_the_same_greenhouse() -> None:
    p = LETTUCE.parameters.default()
    d = POINTS.inputs.d[0]
    state = LETTUCE.start("young_lettuce", d, 18.0, p)

    rates = dict(zip(LETTUCE.state_names, LETTUCE.rhs(state, np.full(6, 0.3), d, p), strict=True))

    assert LETTUCE.id == "greenlight-lettuce-1.0.0"
    assert LETTUCE.control_names == TOMATO.control_names
    assert not set(LETTUCE.state_names) & {"cFruit", "tCan24"}
    assert "sla" not in LETTUCE.parameter_names
    assert all(np.isfinite(rate) for rate in rates.values())
    assert rates["xS"] > 0
    assert np.isfinite(LETTUCE.jacobian(state, np.full(6, 0.3), d, p)).all()
    record, values = LETTUCE.State(*state), LETTUCE.Parameters(*p)
    (head,) = (seen for seen in LETTUCE.observed("crop", horizon(LETTUCE)) or () if seen.name == "head_fresh_mass")
    assert head.of is not None
    assert head.of(record, values) == pytest.approx(3.0)


@pytest.mark.parametrize(("head", "share"), [(179.0, 0.0), (180.0, 0.0), (215.0, 0.5), (250.0, 1.0), (400.0, 1.0)])
def test_a_head_earns_its_full_price_from_250_g_and_nothing_below_180(head: float, share: float) -> None:
    p = LETTUCE.Parameters(*LETTUCE.parameters.default())
    start = equations.start_state(p, head)
    record = LETTUCE.State(*np.zeros(len(LETTUCE.states)))._replace(x_n=start.x_n, x_s=start.x_s)
    (heads,) = (stock for stock in LETTUCE.stocks() if stock.name == "heads")

    assert heads.amount(record, p) == pytest.approx(25.0 * share)
