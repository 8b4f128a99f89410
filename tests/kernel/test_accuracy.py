"""The kernel against steps computed by other integrators."""

from __future__ import annotations

import itertools

import casadi
import numpy as np
import pytest

from glbench.kernel import Kernel, state_scale
from glbench.model import CONTROL_NAMES, STATE_NAMES, TOMATO, build_rhs, initial_state, tomato
from tests.kernel.known_steps import Array, KnownSteps

STATE_SCALE = state_scale(TOMATO)


def scaled_error(got: Array, expected: Array) -> Array:
    return np.asarray(np.abs(got - expected) / STATE_SCALE)


@pytest.mark.parametrize(
    ("backend", "preset", "limit"),
    [
        ("casadi", "reference", 5e-7),
        ("casadi", "fast", 1e-3),
        ("casadi", "tight", 2e-8),
        ("cvodes", "reference", 3e-7),
        ("cvodes", "fast", 1e-3),
        ("cvodes", "tight", 1e-8),
    ],
)
@pytest.mark.parametrize("seconds", [300, 900])
def test_known_steps_are_met(seconds: int, backend: str, preset: str, limit: float, p: Array, request: pytest.FixtureRequest) -> None:
    steps: KnownSteps = request.getfixturevalue(f"steps_{seconds}")
    error = scaled_error(Kernel(TOMATO, seconds, backend=backend, preset=preset).step(steps.x, steps.u, steps.d, p), steps.after)
    row, state = np.unravel_index(error.argmax(), error.shape)
    assert error.max() <= limit, f"{steps.labels[int(row)]}, {STATE_NAMES[int(state)]}"


@pytest.mark.parametrize("seconds", [300, 900])
def test_no_state_is_less_accurate_than_with_cvodes_at_one_millionth(seconds: int, p: Array, request: pytest.FixtureRequest) -> None:
    steps: KnownSteps = request.getfixturevalue(f"steps_{seconds}")
    x, u, d = casadi.SX.sym("x", 28), casadi.SX.sym("u", 6), casadi.SX.sym("d", 10)
    problem = {"x": x, "u": casadi.vertcat(u, d), "ode": build_rhs()(x, u, d, p)}
    published = casadi.integrator("published", "cvodes", problem, 0, seconds, {"abstol": 1e-6, "reltol": 1e-6})
    inputs = np.hstack([steps.u, steps.d])
    theirs = np.array([published(x0=steps.x[k], u=inputs[k])["xf"].full().ravel() for k in range(len(inputs))])
    ours = Kernel(TOMATO, seconds, backend="casadi").step(steps.x, steps.u, steps.d, p)
    worst_of_ours = scaled_error(ours, steps.after).max(axis=0)
    worst_of_theirs = scaled_error(theirs, steps.after).max(axis=0)
    # What both solve to the last bit (the clock) may differ by its rounding.
    assert np.all(worst_of_ours <= worst_of_theirs + 1e-12), dict(zip(STATE_NAMES, worst_of_ours, strict=True))


def test_three_steps_of_300_s_make_one_of_900_s(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    short = Kernel(TOMATO, 300.0, backend="casadi")
    x = steps_900.x
    for _ in range(3):
        x = short.step(x, steps_900.u, steps_900.d, p)
    whole = kernel.step(steps_900.x, steps_900.u, steps_900.d, p)
    assert scaled_error(x, whole).max() < 1e-6


def test_the_clock_is_exact(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    after = kernel.step(steps_900.x, steps_900.u, steps_900.d, p)
    assert np.array_equal(after[:, 27], steps_900.x[:, 27] + 900.0 * (1.0 / 86400.0))


def test_soil_at_rest_stays_at_rest_by_hand(p: Array) -> None:
    # With all soil layers at the temperature of the outer soil, the deepest layers see no difference for 1 s.
    d = np.array([0.0, 10.0, 1000.0, 750.0, 2.0, 2.0, 12.0, 0.0, 0.0, 0.0])
    x = initial_state(d, 16.5, p)
    x[8:15] = 12.0
    after = Kernel(TOMATO, 1.0, backend="casadi").step(x, np.zeros(6), d, p)
    assert after[12:15] == pytest.approx([12.0, 12.0, 12.0], abs=1e-9)


@pytest.mark.parametrize(
    ("outside", "sun", "sky"), [(-22.0, 0.0, -40.0), (8.0, 150.0, -3.0), (42.0, 1050.0, 25.0)], ids=["frost", "mild", "heat"]
)
def test_every_corner_of_the_controls_is_met_from_the_benchmarks_start(outside: float, sun: float, sky: float, p: Array) -> None:
    vapour = 0.7 * 610.78 * np.exp(17.2694 * outside / (outside + 238.3))
    d = np.array([sun, outside, vapour, 750.0, 4.0, sky, 10.0, 0.0, 0.0, 0.0])
    u = np.array(list(itertools.product((0.0, 1.0), repeat=len(CONTROL_NAMES))))
    x = np.tile(initial_state(d, 16.5, p), (len(u), 1))
    got, failures = Kernel(TOMATO, 900.0, backend="casadi").try_step(x, u, d, p)
    assert not failures
    expected = Kernel(TOMATO, 900.0, backend="casadi", preset="tight").step(x, u, d, p)
    assert scaled_error(got, expected).max() < 1e-6


def test_the_published_variant_steps_to_another_state(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    published = Kernel(tomato("gl_gym2"), 900.0, backend="casadi").step(steps_900.x, steps_900.u, steps_900.d, p)
    difference = scaled_error(published, kernel.step(steps_900.x, steps_900.u, steps_900.d, p))
    assert 1e-5 < difference.max() < 0.1
