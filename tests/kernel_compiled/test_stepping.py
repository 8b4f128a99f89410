"""Accuracy against the reference trajectories, failures in words, and greenhouses with other equipment."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from docs.accuracy_table import EXACT, compare, errors, make_inputs
from glbench.errors import ShapeError, UnknownNameError
from glbench.kernel import Rows, state_scale
from glbench.kernel.compiled import PRESETS, CompiledStepper, Failure, failed_with
from glbench.kernel.compiled.stepper import METHODS, Method
from glbench.kernel.cvodes import paper_cvodes
from glbench.model import PARAMETER_NAMES, STATE_NAMES, TOMATO, VARIANTS, default_parameters, rhs, tomato

STATE_SCALE = state_scale(TOMATO)

Array = NDArray[np.float64]
RowArrays = tuple[Array, Array, Array]

pytestmark = pytest.mark.usefixtures("compiled")


def step(stepper: CompiledStepper, x: Array, u: Array, d: Array, p: Array) -> Array:
    out = np.empty_like(x)
    status = stepper.step_rows(x, u, d, p, out)
    assert not status.any()
    return out


@pytest.mark.parametrize("season", ["winter", "summer"])
@pytest.mark.parametrize(("preset", "limit"), [("tight", 2e-8), ("reference", 2e-7), ("standard", 2e-5), ("fast", 2e-4)])
def test_golden_steps_are_met(golden_steps: dict[str, Array], parameters: Array, season: str, preset: str, limit: float) -> None:
    x, u, d, after = (golden_steps[f"{season}_{name}"] for name in ("x", "u", "d", "next"))
    found = step(CompiledStepper(TOMATO, 300.0, preset=preset), x, u, d, parameters)
    assert np.max(np.abs(found - after) / STATE_SCALE) < limit


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["walk", "jump"])
def test_standard_is_at_least_as_accurate_as_cvodes(kind: str) -> None:
    cvodes, found = compare(kind, seeds=range(0, 20, 3), days=3, presets=["standard"])
    largest, mean_square = found["standard"][0].ratio(cvodes)
    assert dict(zip(STATE_NAMES, mean_square, strict=True)) == pytest.approx(dict.fromkeys(STATE_NAMES, 0.0), abs=1.0)
    assert dict(zip(STATE_NAMES, largest, strict=True)) == pytest.approx(dict.fromkeys(STATE_NAMES, 0.0), abs=1.0)


@pytest.mark.parametrize("method", METHODS)
def test_both_methods_have_order_four(rows: RowArrays, parameters: Array, method: Method) -> None:
    x, u, d = (a[:12] for a in rows)
    exact = step(CompiledStepper(TOMATO, 900.0, preset="tight"), x, u, d, parameters)
    substeps, found = [], []
    for relative in (1e-4, 1e-8):
        preset = replace(PRESETS["standard"], method=method, relative=relative, fast_error_floor=1.0)
        stepper = CompiledStepper(TOMATO, 900.0, preset=preset)
        found.append(float(np.sqrt(np.mean(((step(stepper, x, u, d, parameters) - exact) / STATE_SCALE) ** 2))))
        substeps.append(float(stepper.substeps.mean()))
    assert np.log(found[0] / found[1]) / np.log(substeps[1] / substeps[0]) > 2.8  # kinks cost some of the four


def test_condensation_at_the_end_of_a_step_is_seen() -> None:
    """Water begins to condense on the blackout screen in what GRK4T does not look at of a last substep without the last stretch."""
    inputs = make_inputs("jump", [8], days=5)
    before, screen = 418, STATE_NAMES.index("tBlScr")
    p, exact, x = default_parameters(), CompiledStepper(TOMATO, 900.0, preset=EXACT), inputs.initial
    for k in range(before):
        x = step(exact, x, inputs.controls[k], inputs.weather[k], p)
    point = x, inputs.controls[before], inputs.weather[before], p
    truth = step(exact, *point)[0, screen]
    standard = PRESETS["standard"]
    without = replace(standard, last_stretch=math.inf)
    assert abs(step(CompiledStepper(TOMATO, 900.0, preset=without), *point)[0, screen] - truth) > 1e-3  # K
    assert abs(step(CompiledStepper(TOMATO, 900.0, preset=standard), *point)[0, screen] - truth) < 1e-5


@pytest.mark.parametrize("variant", VARIANTS)
def test_both_variants_agree_with_cvodes(rows: RowArrays, parameters: Array, variant: str) -> None:
    x, u, d = (a[:3] for a in rows)
    found = step(CompiledStepper(tomato(variant), 900.0, preset="tight"), x, u, d, parameters)
    cvodes = paper_cvodes(tomato(variant), 1e-10, 900.0)
    exact = np.stack([cvodes(x0=x[i], p=np.concatenate([u[i], d[i]]))["xf"].full().ravel() for i in range(3)])
    assert np.max(np.abs(found - exact) / STATE_SCALE) < 1e-6


def test_a_short_step_follows_the_right_hand_side(rows: RowArrays, parameters: Array) -> None:
    x, u, d = (a[:8] for a in rows)
    found = (step(CompiledStepper(TOMATO, 1e-3, preset="tight"), x, u, d, parameters) - x) / 1e-3
    expected = rhs(x, u, d, np.tile(parameters, (8, 1)))
    np.testing.assert_allclose(found / STATE_SCALE, expected / STATE_SCALE, rtol=5e-3, atol=1e-7)


def test_the_clock_is_exact(rows: RowArrays, parameters: Array) -> None:
    x, u, d = (a[:8] for a in rows)
    clock = STATE_NAMES.index("time")
    found = step(CompiledStepper(TOMATO, 900.0), x, u, d, parameters)[:, clock]
    np.testing.assert_array_equal(found, x[:, clock] + 900.0 / 86400.0)


def test_interlights_are_stepped_by_the_full_model(rows: RowArrays, parameters: Array) -> None:
    x, u, d = (a[:4].copy() for a in rows)
    x[:, STATE_NAMES.index("tIntLamp")] = 40.0
    p = np.tile(parameters, (4, 1))
    changed = {"aIntLamp": 0.02, "epsIntLamp": 0.9, "cHecIntLampAir": 2.3}
    for name, value in changed.items():
        p[1, PARAMETER_NAMES.index(name)] = value
    stepper = CompiledStepper(TOMATO, 900.0, preset="tight")
    found = step(stepper, x, u, d, p)
    lamp = STATE_NAMES.index("tIntLamp")
    assert found[0, lamp] == 40.0
    assert found[1, lamp] < 39.0
    np.testing.assert_allclose(found[[0, 2, 3]], step(stepper, x, u, d, parameters)[[0, 2, 3]], rtol=0.0)
    alone = step(stepper, x[1:2], u[1:2], d[1:2], p[1:2])
    assert alone.tobytes() == found[1:2].tobytes()


def test_a_bound_step_with_interlights_is_stepped_by_the_full_model(rows: RowArrays, parameters: Array) -> None:
    x, u, d = (a[:4].copy() for a in rows)
    p = np.tile(parameters, (4, 1))
    for name, value in {"aIntLamp": 0.02, "epsIntLamp": 0.9, "cHecIntLampAir": 2.3}.items():
        p[1, PARAMETER_NAMES.index(name)] = value
    stepper = CompiledStepper(TOMATO, 900.0, preset="fast")
    expected = step(stepper, x, u, d, p)
    bound = stepper.bind(Rows(x, u, d, p), x)
    bound()
    assert x.tobytes() == expected.tobytes()
    assert not bound.status.any()


def test_a_state_that_is_not_finite_is_named(rows: RowArrays, parameters: Array) -> None:
    x, u, d = (a[:3].copy() for a in rows)
    x[1, STATE_NAMES.index("vpAir")] = np.inf
    stepper = CompiledStepper(TOMATO, 900.0)
    out = np.zeros_like(x)
    status = stepper.step_rows(x, u, d, parameters, out)
    assert failed_with(status, Failure.INPUT_NOT_FINITE).tolist() == [1]
    assert "vpAir" in stepper.explain(1)
    np.testing.assert_array_equal(out[1], x[1])


def test_inputs_that_are_not_finite_are_reported(rows: RowArrays, parameters: Array) -> None:
    x, u, d = (a[:3].copy() for a in rows)
    d[2, 1] = np.nan
    stepper = CompiledStepper(TOMATO, 900.0)
    status = stepper.step_rows(x, u, d, parameters, np.empty_like(x))
    assert np.flatnonzero(status).tolist() == [2]
    assert "weather" in stepper.explain(2)


def test_too_many_substeps_are_reported_with_state_and_time(rows: RowArrays, parameters: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.kernel.compiled.stepper.LARGEST_SUBSTEPS", 5)
    x, u, d = (a[:20] for a in rows)
    backend = CompiledStepper(TOMATO, 900.0, preset="standard")
    out = np.empty_like(x)
    failures = backend.advance(Rows(x, u, d, parameters[None]), out)
    assert len(failures) == 20
    assert any(name in failures[0].reason for name in STATE_NAMES)
    assert "more than 5 substeps" in failures[0].reason
    assert "s into the step" in failures[0].reason
    assert "controls uBoil" in failures[0].reason
    np.testing.assert_array_equal(out, x)
    assert (backend.reached > 0.0).all()


def test_substeps_that_become_too_small_are_reported(rows: RowArrays, parameters: Array, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.kernel.compiled.stepper.SMALLEST_SUBSTEP", 100.0)
    x, u, d = (a[:4] for a in rows)
    stepper = CompiledStepper(TOMATO, 900.0)
    status = stepper.step_rows(x, u, d, parameters, np.empty_like(x))
    assert failed_with(status, Failure.SUBSTEP_TOO_SMALL).size
    assert "substeps below 100 s" in stepper.explain(int(np.flatnonzero(status)[0]))


def test_extreme_weather_and_corner_controls_are_stepped(golden_steps: dict[str, Array]) -> None:
    generator = np.random.default_rng(11)
    n = 400
    x = np.tile(golden_steps["winter_x"][0], (n, 1))
    d = np.tile(golden_steps["winter_d"][0], (n, 1))
    d[:, 0] = generator.uniform(0.0, 1100.0, n)
    d[:, 1] = generator.uniform(-30.0, 45.0, n)
    d[:, 2] = generator.uniform(0.1, 1.0, n) * 610.78 * np.exp(17.2694 * d[:, 1] / (d[:, 1] + 238.3))
    d[:, 4] = generator.uniform(0.0, 25.0, n)
    d[:, 5] = d[:, 1] - generator.uniform(0.0, 25.0, n)
    p = default_parameters() * np.ones((n, 1))
    p[:, 129:132] *= generator.uniform(0.7, 1.3, (n, 3))
    stepper = CompiledStepper(TOMATO, 900.0)
    for _ in range(8):
        u = generator.integers(0, 2, (n, 6)).astype(np.float64)
        x = step(stepper, x, u, d, p)
    assert np.isfinite(x).all()


def test_wrong_shapes_and_types_are_refused(rows: RowArrays, parameters: Array) -> None:
    x, u, d = (a[:3] for a in rows)
    stepper = CompiledStepper(TOMATO, 900.0)
    with pytest.raises(ShapeError, match="float64"):
        stepper.step_rows(x, u[:2], d, parameters, np.empty_like(x))
    with pytest.raises(ShapeError):
        stepper.step_rows(x, u, d, parameters[:100], np.empty_like(x))
    with pytest.raises(ShapeError):
        stepper.step_rows(x.astype(np.float32), u, d, parameters, np.empty_like(x))
    many = [np.tile(a, (30, 1)) for a in (x, u, d)]
    with pytest.raises(ShapeError):
        stepper.step_rows(np.asfortranarray(many[0]), many[1], many[2], parameters, np.empty_like(many[0]))


def test_unknown_presets_are_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownNameError, match="reference"):
        CompiledStepper(TOMATO, 900.0, preset="referense")


def test_describe_names_method_tolerance_and_compiler() -> None:
    facts = CompiledStepper(TOMATO, 900.0).describe()
    assert facts["method"] == "Rodas4P2"
    assert facts["relative_tolerance"] == PRESETS["reference"].relative
    assert "-ffp-contract=off" in str(facts["compiler_flags"])


def test_errors_of_the_size_of_rounding_do_not_count() -> None:
    exact = np.full((1, 1, 28), 733_834.0)
    assert errors(exact * (1.0 + 2e-16), exact).largest.max() == 0.0
    assert errors(exact * (1.0 + 1e-11), exact).largest.min() > 0.0
