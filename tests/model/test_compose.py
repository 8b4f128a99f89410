"""Models are values: composed of submodels, equal when these are, with everything above them to be asked for."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pytest

from glbench.errors import GlbenchError, ShapeError, UnknownNameError
from glbench.model import (
    BUTTERHEAD,
    COMPARTMENT,
    HARVESTED_BUTTERHEAD,
    LETTUCE,
    TOMATO,
    TOMATO_ENERGY,
    TOMATO_HEAT_PUMP,
    ChpBoilerBuffer,
    Horizon,
    Meter,
    compose,
    get_model,
    paper,
    register_model,
    registered_models,
    tomato,
)
from glbench.model.actuators import Actuators
from glbench.model.crop import lettuce as equations
from glbench.model.crop.tomato import VanthoorTomato
from glbench.model.expressions import Expr, sqrt
from glbench.model.greenlight import GreenLightClimate
from glbench.model.model import Capacity, Flow, Model, Step, Stock
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
        return (Flow("water", "kg m-2", "water from the tap", "Water", lambda s: s.controls.u_fill * (s.parameters.phi_fill * s.seconds)),)

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

    np.testing.assert_array_equal(np.delete(state, -2), TOMATO.start("mature_crop", first, 18.0, TOMATO.parameters.default()))
    assert state[-2] == 50.0
    with pytest.raises(UnknownNameError, match=r"no start 'mature'.*'mature_crop'"):
        model.start("mature", first, 18.0, model.parameters.default())


@pytest.mark.parametrize("model", [TOMATO, LETTUCE, compose(GreenLightClimate(), VanthoorTomato(), ChpBoilerBuffer())], ids=str)
def test_every_state_and_observed_column_has_finite_bounds_in_order(model: Model) -> None:
    bounds: Mapping[str, tuple[float, float]] = model.bounds(horizon(model))

    assert set(bounds) == set(model.state_names)
    assert all(np.isfinite([low, high]).all() and low < high for low, high in bounds.values())
    for module in model.observation_modules:
        columns = model.observed(module, horizon(model))
        assert columns
        assert all(np.isfinite([c.low, c.high]).all() and c.low < c.high for c in columns)
    assert model.observed("roots", horizon(model)) is None


class Entry:
    """An entry point, as installed packages have them."""

    name, value = "parts", "mylab.parts:register"

    class dist:  # noqa: N801 -- as importlib.metadata calls it
        name = "mylab"

    def __init__(self, register: Any) -> None:
        self.register = register

    def load(self) -> Any:
        return self.register


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Entry points of installed packages: call it with the functions that they name."""
    monkeypatch.setattr(paper, "_MODELS", {model_id: dict(known) for model_id, known in paper._MODELS.items()})

    def install(*functions: Any) -> None:
        entries = [Entry(function) for function in functions]
        monkeypatch.setattr(paper, "entry_points", lambda group: entries if group == "glbench.models" else [])
        paper._load_plugins.cache_clear()

    yield install
    paper._load_plugins.cache_clear()


def raising() -> None:
    msg = "my bug"
    raise RuntimeError(msg)


def test_an_installed_package_can_bring_a_model(installed: Any) -> None:
    installed(raising, lambda: register_model(with_water()))

    assert with_water() in registered_models()
    assert get_model("greenlight-tomato-water-1.0.0") == with_water()


def test_a_broken_entry_point_is_told_to_who_misses_a_model(installed: Any) -> None:
    installed(raising)

    assert get_model("greenlight-tomato-1.0.0") is TOMATO
    with pytest.raises(UnknownNameError, match=r"'parts = mylab.parts:register' of mylab failed: RuntimeError: my bug"):
        get_model("mylab-tomato-1.0.0")
    with pytest.raises(UnknownNameError, match=r"no version 2.0.0 of the model 'greenlight-tomato'. Known: 1.0.0.*my bug"):
        get_model("greenlight-tomato-2.0.0")


def test_an_unknown_model_points_to_entry_points(installed: Any) -> None:
    installed()

    with pytest.raises(UnknownNameError, match=r"no model 'mylab-tomato-1.0.0'.*entry point.*docs/extending.md"):
        get_model("mylab-tomato-1.0.0")


def again(**methods: Any) -> Model:
    """The model with the tank, of a class made anew: as from a cell that is run again."""
    return compose(GreenLightClimate(), VanthoorTomato(), dataclass(frozen=True)(type("Again", (WaterTank,), methods))())


def test_the_same_equations_registered_again_take_the_place_of_those_before(installed: Any) -> None:
    installed()
    first, second = again(), again()

    assert first != second
    register_model(first)
    assert register_model(second) is get_model(second.id)
    assert get_model(second.id) is second


def test_another_model_of_one_id_is_refused_with_what_differs(installed: Any) -> None:
    installed()
    first = register_model(again())
    leaking = again(rates=lambda self, x, around, fluxes, p: WaterState(fluxes.mw_tap_tank - 2 * fluxes.mw_tank_can))
    with pytest.raises(UnknownNameError, match=f"digest {first.digest[:8]} there, {leaking.digest[:8]} in yours"):
        register_model(leaking)
    with pytest.raises(UnknownNameError, match="states: mTank only there; controls: uFill only there; parameters: phiFill"):
        register_model(compose(GreenLightClimate(), VanthoorTomato(), name="greenlight-tomato-water"))
    assert get_model(first.id) is first


def test_what_came_with_glbench_is_never_replaced(installed: Any) -> None:
    installed()
    tomatoes = dataclass(frozen=True)(type("Tomatoes", (VanthoorTomato,), {}))()

    with pytest.raises(UnknownNameError, match="the names and equations are the same, the classes are not"):
        register_model(compose(GreenLightClimate(), tomatoes))


def test_models_are_known_by_id_and_variant_and_an_id_means_one_model() -> None:
    assert get_model("greenlight-tomato-1.0.0") is TOMATO
    assert get_model("greenlight-tomato-1.0.0", "gl_gym2") == tomato("gl_gym2")
    with pytest.raises(UnknownNameError, match=r"no model 'greenlight-tomatoes-1.0.0'.*'greenlight-tomato-1.0.0'"):
        get_model("greenlight-tomatoes-1.0.0")
    with pytest.raises(UnknownNameError, match=r"another model 'greenlight-tomato-1.0.0'"):
        register_model(compose(GreenLightClimate(), VanthoorTomato(), WaterTank(), name="greenlight-tomato"))


@pytest.mark.parametrize(
    "model", [TOMATO, LETTUCE, BUTTERHEAD, HARVESTED_BUTTERHEAD, TOMATO_ENERGY, TOMATO_HEAT_PUMP, COMPARTMENT], ids=str
)
def test_what_is_drawn_exists(model: Model) -> None:
    known = {*model.state_names, *model.control_names, *model.disturbance_names}
    assert {signal.source for signal in model.signals() if signal.of is None and signal.today is None} <= known
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


# What a part can get wrong.


def part(name: str = "part", **entries: Any) -> Addition:
    """An addition with these methods and records, and no others."""
    return dataclass(frozen=True)(type("Part", (Addition,), {"name": name, **entries}))()


def greenhouse(*additions: Addition, meters: tuple[Meter, ...] = ()) -> Model:
    return compose(GreenLightClimate(), VanthoorTomato(), *additions, meters=meters)


class Filter(NamedTuple):
    q_filter: Annotated[Expr, Variable("g m-2", "dirt in a filter")]


class Dirt(NamedTuple):
    mg_dirt: Annotated[Expr, Quantity("g m-2 s-1", "dirt caught")]


class NoUnit(NamedTuple):
    mg_dirt: float


class Scrubber(NamedTuple):
    u_scrub: Annotated[Expr, Quantity("-", "scrubber")]


class CanopyHeat(NamedTuple):
    h_can_air: Annotated[Expr, Quantity("W m-2", "what the climate has as well")]


@pytest.mark.parametrize(
    ("flux", "unit", "expected"),
    [("mc_fruit_har", "kg m-2", "mg m-2"), ("mc_fruit_har", "mg m-2 s-1", "mg m-2"), ("h_boil_pipe", "W m-2", "J m-2")],
)
def test_a_meter_is_in_the_unit_of_its_flux_times_seconds(flux: str, unit: str, expected: str) -> None:
    with pytest.raises(GlbenchError, match=f"The meter of '{flux}' is in {unit}, .* its unit is "):
        greenhouse(meters=(Meter(flux, "picked", unit, "picked", "Picked"),)).rhs_function()
    for spelling in (expected, expected.replace(" m-2", "/m²")):
        greenhouse(meters=(Meter(flux, "picked", spelling, "picked", "Picked"),)).rhs_function()


@pytest.mark.parametrize(
    ("additions", "meters", "said"),
    [
        ((part(), part(State=Filter)), (), "Two parts of the model are called 'part'"),
        ((part("greenlight"),), (), "Two parts of the model are called 'greenlight'"),
        ((part("heat-buffer"),), (), "'heat-buffer', which cannot be the name of a field"),
        ((part(name=""),), (), "Part has no name"),
        (
            (part(flows=lambda self: (Flow("heat", "kWh m-2", "heat", "Heat", lambda step: 0.0),)),),
            (),
            "part and greenlight both have a flow called 'heat'",
        ),
        (
            (part(stocks=lambda self: (Stock("fruit", "kg m-2", "fruit", "Fruit", lambda x, p: 0.0),)),),
            (),
            "part and tomato both have a stock called 'fruit'",
        ),
        ((), (HARVEST, replace(HARVEST, flow="again")), "The meter of 'mc_fruit_har' has twice a state called"),
        ((), (replace(HARVEST, flow="heat"),), "The meter of 'mc_fruit_har' and greenlight both have a flow called 'heat'"),
    ],
)
def test_names_are_given_once(additions: tuple[Addition, ...], meters: tuple[Meter, ...], said: str) -> None:
    with pytest.raises(GlbenchError, match=said):
        greenhouse(*additions, meters=meters)


@pytest.mark.parametrize(
    ("addition", "said"),
    [
        (part(processes=lambda self, x, around, p: CanopyHeat(0.0)), "part and convection both have a flux called 'h_can_air'"),
        (part("optics"), "Two records of fluxes are called 'optics'"),
        (part(processes=lambda self, x, around, p: 0.0), "'part' is a bare value. Put it into a NamedTuple"),
        (part(processes=lambda self, x, around, p: NoUnit(0.0)), "The flux 'mg_dirt' of part has no unit"),
        (part(State=Filter), r"part has states \(qFilter\) and no method `rates`"),
        (part(State=Filter, rates=lambda self, x, around, f, p: (0.0, 0.0)), "`rates` of part returns tuple of 2 values"),
        (part(State=Filter, rates=lambda self, x, around, f, p: Dirt(0.0)), "expected Filter of 1"),
        (part(State=Filter, rates=lambda self, x, around, f, p: None), "`rates` of part returns None"),
    ],
)
def test_equations_that_cannot_be_put_together_are_refused_in_words(addition: Addition, said: str) -> None:
    with pytest.raises(GlbenchError, match=said):
        greenhouse(addition).rhs_function()


@pytest.mark.parametrize(
    ("start", "said"),
    [
        (None, r"part has states \(qFilter\) and no method `start`"),
        (lambda self, d, t, p: (1.0, 2.0), "`start` of part returns tuple of 2 values"),
        (lambda self, d, t, p: Filter(float("nan")), "start 'mature_crop' of greenlight-tomato-part-1.0.0 gives qFilter = nan"),
    ],
)
def test_a_start_that_is_none_is_refused_in_words(start: Any, said: str) -> None:
    model = greenhouse(part(State=Filter, **({"start": start} if start else {})))

    with pytest.raises(GlbenchError, match=said):
        model.start("mature_crop", POINTS.inputs.d[0], 18.0, model.parameters.default())


def test_rates_that_are_not_finite_at_the_start_are_named() -> None:
    model = greenhouse(
        part(
            State=Filter,
            rates=lambda self, x, around, fluxes, p: Filter(sqrt(x.q_filter - 1)),
            start=lambda self, d, t, p: Filter(d.t_out * 0),
        )
    )
    first, p = POINTS.inputs.d[0], model.parameters.default()
    state = model.start("mature_crop", first, 18.0, p)

    with pytest.raises(ShapeError, match=r"equations of greenlight-tomato-part-1.0.0 give as rate of qFilter = -?nan"):
        model.check_rates(state, first, p)
    TOMATO.check_rates(np.delete(state, -2), first, p)


def test_a_control_delivers_a_fraction_unless_its_part_says_more() -> None:
    given = dict(zip(TOMATO.parameter_names, TOMATO.parameters.default().tolist(), strict=True))
    behind = Capacity("uBoil", "into_tank", "W m-2", 130.0, "heat of the boiler to the tank", "Boiler")
    silent = greenhouse(part(Controls=Scrubber)).capacities(given)
    said = greenhouse(part(capacities=lambda self, p: (behind,))).capacities(given)

    assert silent == (*TOMATO.capacities(given), Capacity("uScrub", "scrub", "-", 1.0, "scrubber"))
    assert said == (behind, *TOMATO.capacities(given)[1:])
    with pytest.raises(GlbenchError, match=r"`capacities` of part speaks of a control 'uBoyl'.*'uBoil'"):
        greenhouse(part(capacities=lambda self, p: (replace(behind, name="uBoyl"),))).capacities(given)
    with pytest.raises(GlbenchError, match="uCo2 and uBoil both have a capacity called 'co2_supply'"):
        greenhouse(part(capacities=lambda self, p: (replace(behind, quantity="co2_supply"),))).capacities(given)
