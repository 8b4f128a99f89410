"""A compartment stepped: accuracy, what the mass stores over time, bits, backends, what is off, and a crop that is topped."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi
import numpy as np
import pytest

from docs.accuracy_table import errors, make_inputs
from glbench.kernel import Kernel, Rows, available, state_scale, why_not_compiled
from glbench.kernel.compiled import absent_equipment
from glbench.model import COMPARTMENT, TOMATO, Meter, Model, compose, get_model
from glbench.model.compartment import MassAndNeighbours, RisingVents, ToppedTomato
from tests.kernel.known_steps import Array, KnownSteps

MODEL = COMPARTMENT
PUBLISHED = get_model("greenlight-tomato-harvest-1.0.0")
SCALE = state_scale(MODEL)
BACKENDS = ("compiled", "casadi", "cvodes")
ON = {"hecAirMass": 4.0, "etaGlobMass": 0.3, "hecWall": 0.5, "fWall": 5e-4, "co2Wall": 700.0, "tSumTop": 3050.0, "laiTop": 0.6}
"""Every part at work; the crop of the known steps is past half of its topping."""
VENT = MODEL.control_names.index("uVent")
MASS, AIR = MODEL.state_index("tMass"), MODEL.state_index("tAir")


@cache
def kernel_of(backend: str, preset: str = "reference", model: Model = MODEL, threads: int = 1) -> Kernel:
    if backend not in available(model):
        pytest.skip(why_not_compiled(model))
    return Kernel(model, 900.0, backend=backend, preset=preset, threads=threads)


def rows_of(steps: KnownSteps, n: int, **values: float) -> Rows:
    """Known steps in a compartment: the mass up to 5 K colder or warmer than the air, every third row with vents shut."""
    generator = np.random.default_rng(12)
    x = np.insert(steps.x[:n], 27, np.zeros((3, n)), axis=1)
    x[:, MASS] = x[:, AIR] + generator.uniform(-5.0, 5.0, n)
    u = steps.u[:n].copy()
    u[::3, VENT] = 0.0
    return Rows(x, u, steps.d[:n], MODEL.parameters.default(overrides=ON | values)[None])


def cvodes_of(p: Array, tolerance: float) -> Any:
    """CasADi's CVODES for a control step, with one tolerance, absolute and relative, on states as they are."""
    x, u, d = (casadi.SX.sym(key, MODEL.sizes[key]) for key in "xud")
    problem = {"x": x, "u": casadi.vertcat(u, d), "ode": MODEL.rhs_function()(x, u, d, p)}
    options = {"abstol": tolerance, "reltol": tolerance, "max_num_steps": 100_000}
    return casadi.integrator("step", "cvodes", problem, 0.0, 900.0, options)


def by_cvodes(rows: Rows, tolerance: float) -> Array:
    """States after a step of these rows."""
    integrator, inputs = cvodes_of(rows.p[0], tolerance), np.hstack([rows.u, rows.d])
    return np.array([integrator(x0=one, u=held)["xf"].full().ravel() for one, held in zip(rows.x, inputs, strict=True)])


@pytest.fixture(scope="module")
def rows(steps_900: KnownSteps) -> Rows:
    return rows_of(steps_900, len(steps_900.x))


@pytest.fixture(scope="module")
def exact(rows: Rows) -> Array:
    """What an independent integrator gives at a tolerance of 1e-11."""
    return by_cvodes(rows, 1e-11)


@pytest.mark.parametrize(
    ("backend", "preset", "limit"),
    [
        ("compiled", "reference", 1e-6),
        ("compiled", "standard", 2e-4),
        ("compiled", "fast", 2e-3),
        ("casadi", "reference", 1e-6),
        ("cvodes", "reference", 1e-6),
    ],
)
def test_a_control_step_is_as_exact_as_its_preset_says(rows: Rows, exact: Array, backend: str, preset: str, limit: float) -> None:
    error = np.abs(kernel_of(backend, preset).step(*rows) - exact) / SCALE
    row, state = np.unravel_index(error.argmax(), error.shape)
    assert error.max() <= limit, f"row {row}, {MODEL.state_names[int(state)]}"


def test_no_state_of_known_steps_is_less_accurate_than_with_cvodes_at_one_millionth(rows: Rows, exact: Array) -> None:
    ours = (np.abs(kernel_of("compiled").step(*rows) - exact) / SCALE).max(axis=0)
    theirs = (np.abs(by_cvodes(rows, 1e-6) - exact) / SCALE).max(axis=0)
    assert {name: (ours[k], theirs[k]) for k, name in enumerate(MODEL.state_names) if ours[k] > theirs[k] + 1e-12} == {}
    assert theirs[MASS] > 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["walk", "jump"])
def test_standard_is_at_least_as_accurate_as_cvodes_over_days(kind: str) -> None:
    """As tests/kernel_compiled/test_stepping.py has it for the tomato greenhouse."""
    inputs = make_inputs(kind, range(0, 20, 5), days=2)
    held = np.concatenate([inputs.controls, inputs.weather], axis=2)
    p = MODEL.parameters.default(overrides=ON)
    start = np.stack([MODEL.start("mature_crop", first, 16.5, p) for first in inputs.weather[0]])
    cvodes = cvodes_of(p, 1e-6)
    states = {preset: np.empty((len(held), *start.shape)) for preset in ("tight", "standard", "cvodes")}
    for name, after in states.items():
        x = start
        for step in range(len(held)):
            if name == "cvodes":
                x = np.array([cvodes(x0=one, u=inputs)["xf"].full().ravel() for one, inputs in zip(x, held[step], strict=True)])
            else:
                x = kernel_of("compiled", name).step(x, inputs.controls[step], inputs.weather[step], p[None])
            after[step] = x
    ours, theirs = (errors(states[name], states["tight"]) for name in ("standard", "cvodes"))
    largest, mean_square = ours.ratio(theirs)
    # Hardly any fruit is ripe within two days: CVODES is exact to 1e-6 mg m-2 there, and this kernel to a millionth of a harvest.
    harvest = MODEL.state_index("sumMcFruitHar")
    assert ours.largest[harvest] < 1e-6 * SCALE[harvest]
    largest[harvest] = mean_square[harvest] = 0.0
    assert (largest.max(), mean_square.max()) < (1.0, 1.0), dict(zip(MODEL.state_names, largest, strict=True))
    assert largest[MASS] > 0.01


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("preset", ["reference", "standard", "fast"])
def test_a_row_has_the_same_bits_alone_and_in_a_batch(steps_900: KnownSteps, backend: str, preset: str) -> None:
    """Also beside rows whose compartment has no mass, no neighbours or an untopped crop."""
    rows = rows_of(steps_900, 9 if backend == "compiled" else 3)
    p = np.tile(rows.p, (len(rows.x), 1))
    for k, (name, value) in enumerate({"hecAirMass": 0.0, "fWall": 0.0, "laiTop": 1.0}.items()):
        p[k::4, MODEL.parameter_names.index(name)] = value
    rows = rows._replace(p=p)
    whole = kernel_of(backend, preset).step(*rows)
    alone = [kernel_of(backend, preset).step(*one) for one in zip(*rows, strict=True)]
    assert np.stack(alone).tobytes() == whole.tobytes()
    assert kernel_of(backend, preset, threads=2).step(*rows).tobytes() == whole.tobytes()


def test_the_compiled_kernel_leaves_out_no_part_of_a_compartment_but_the_equipment_that_the_tomato_greenhouse_lacks() -> None:
    absent, plain = ({model.parameter_names[k] for k in absent_equipment(model)} for model in (MODEL, TOMATO))
    assert absent == plain
    assert "aIntLamp" in absent


@pytest.mark.slow
def test_what_the_mass_gains_over_hours_is_stored_in_it(steps_900: KnownSteps) -> None:
    meters = (Meter("h_air_mass", "to_mass", "J m-2", "heat", "Heat"), Meter("r_sun_mass", "sun_to_mass", "J m-2", "sun", "Sun"))
    model = compose(RisingVents(), ToppedTomato(), MassAndNeighbours(), meters=meters, name="metered-compartment")
    x, u, d, p = rows_of(steps_900, 8)
    kernel, start = kernel_of("casadi", model=model), x.copy()
    for _ in range(12):
        x = kernel.step(x, u, d, p)
    stored = (x - start)[:, MASS] * p[0, MODEL.parameter_names.index("capMass")]
    gained = x[:, model.state_index("sumHAirMass")] + x[:, model.state_index("sumRSunMass")]
    np.testing.assert_allclose(stored, gained, rtol=1e-6, atol=1.0)
    assert (np.abs(stored) > 1e4).sum() >= 4


@pytest.mark.parametrize("opening", [0.0, 1.0])
def test_what_is_off_steps_as_the_published_greenhouse(steps_900: KnownSteps, opening: float) -> None:
    """The rates are the same to the bit (tests/model/test_compartment.py), the substeps may differ: two more states are judged."""
    x, u, d, p = rows_of(steps_900, 24, **dict.fromkeys(("hecAirMass", "etaGlobMass", "hecWall", "fWall"), 0.0), laiTop=1.0)
    u[:, VENT] = opening
    keep = [MODEL.state_index(name) for name in PUBLISHED.state_names]
    ours = kernel_of("compiled").step(x, u, d, p)
    theirs = kernel_of("compiled", model=PUBLISHED).step(x[:, keep], u, d, PUBLISHED.parameters.default()[None])
    assert (np.abs(ours[:, keep] - theirs) / state_scale(PUBLISHED)).max() < 2e-6
    assert (ours[:, MASS] == x[:, MASS]).all()


@pytest.mark.slow
def test_derivatives_of_a_step_are_those_of_differences(steps_900: KnownSteps) -> None:
    """CasADi's derivatives, because compiling those of a whole greenhouse takes minutes."""
    rows = rows_of(steps_900, 2)
    rows.u[:, VENT] = 0.0, 0.3
    rows.d[:, MODEL.disturbance_names.index("wind")] = 4.0
    lines, kernel = kernel_of("casadi", "tight").linearise(*rows), kernel_of("cvodes", "tight")
    for jacobian, key, place, by in ((lines.dx, "x", MASS, 1e-2), (lines.du, "u", VENT, 1e-4)):
        moved = []
        for sign in (1.0, -1.0):
            table = getattr(rows, key).copy()
            table[:, place] += sign * by
            if key == "u":
                table = np.clip(table, 0.0, 1.0)
            moved.append(kernel.step(*rows._replace(**{key: table})))
        width = np.where(rows.u[:, VENT] == 0.0, by, 2 * by) if key == "u" else np.full(2, 2 * by)
        expected = (moved[0] - moved[1]) / width[:, None] / SCALE
        found = jacobian[:, :, place] / SCALE
        limit = 2e-2 if key == "u" else 1e-4  # from a shut vent only upwards
        assert np.abs(found - expected).max() < limit * np.abs(expected).max(), key
        assert np.abs(expected).max() > 1e-4


# Topping


def leaf_area(days: int, **values: float) -> Array:
    """Leaf area index at the end of each day of a mature crop in days of 12 h of sun."""
    kernel = kernel_of("compiled", "fast")
    p = MODEL.parameters.default(overrides=values)
    night = np.array([0.0, 12.0, 1000.0, 750.0, 3.0, 5.0, 12.0, 10.0, 0.0, 0.0])
    noon = night.copy()
    noon[[0, 1, 8, 9]] = 450.0, 18.0, 1.0, 1.0
    x = MODEL.start("mature_crop", night, 18.0, p)
    areas = []
    for _ in range(days):
        for step in range(96):
            sun = 24 <= step < 72
            u = np.array([0.1, 0.0, 0.0, 0.4, 0.0, 0.0]) if sun else np.array([0.3, 0.0, 0.9, 0.0, 0.0, 0.0])
            x = kernel.step(x, u, noon if sun else night, p)
        areas.append(x[MODEL.state_index("cLeaf")] * p[MODEL.parameter_names.index("sla")])
    return np.array(areas)


def test_a_topped_crop_loses_leaf_area_to_its_share_and_an_untopped_one_keeps_it() -> None:
    untopped, topped = leaf_area(45), leaf_area(45, tSumTop=3400.0, tSumTopWidth=150.0, laiTop=0.5)
    most = MODEL.parameters.default()[MODEL.parameter_names.index("laiMax")]
    # Topped about 15 days after the start. Both crops are picked down to a little below their largest leaf area.
    np.testing.assert_allclose(topped[:5], untopped[:5], rtol=0.02)
    assert 0.8 * most < untopped[-1] < most
    assert np.ptp(untopped[5:]) < 0.05 * most
    assert topped[-1] < 0.5 * most
    assert untopped[-1] - topped[-1] == pytest.approx(0.5 * most, rel=0.01)
    assert np.abs(np.diff(topped[-10:])).max() < 1e-3
