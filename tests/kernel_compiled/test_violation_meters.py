"""Meters on violations: the same model with six more states, which change nothing and add up the truth."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.errors import GlbenchError
from glbench.kernel import Kernel
from glbench.model import (
    NO_LIMIT,
    SIDES,
    TOMATO,
    Model,
    co2_ppm,
    limit_parameter,
    registered_models,
    relative_humidity,
    violation_meter,
    with_violation_meters,
)
from glbench.speed.subjects import points
from tests.tasks.toy import Toy

Array = NDArray[np.float64]

LIMITS = {
    "lowestAirTemperature": 18.0,
    "highestAirTemperature": 24.0,
    "lowestCo2": 400.0,
    "highestCo2": 900.0,
    "lowestRelativeHumidity": 60.0,
    "highestRelativeHumidity": 85.0,
}
METERS = ("belowAirTemperature", "aboveAirTemperature", "belowCo2", "aboveCo2", "belowRelativeHumidity", "aboveRelativeHumidity")
WITH_AIR = [model for model in registered_models() if model.air is not None and model.step_map is None]


@pytest.fixture(scope="module")
def some() -> tuple[Array, Array, Array]:
    """States, controls and weather of 64 steps out of all months."""
    found = points("walk", 900.0, 64)
    return found.x, found.u, found.d


def violations(x: Array) -> Array:
    """Distances ``(n, 6)`` from LIMITS in the states ``(n, 28)`` of the tomato greenhouse."""
    temperature, density, pressure = (x[:, TOMATO.state_index(name)] for name in TOMATO.air or ())
    air = (temperature, co2_ppm(temperature, density), relative_humidity(temperature, pressure))
    low, high = list(LIMITS.values())[::2], list(LIMITS.values())[1::2]
    sides = [(np.maximum(a - v, 0.0), np.maximum(v - b, 0.0)) for v, a, b in zip(air, low, high, strict=True)]
    return np.stack([side for pair in sides for side in pair], axis=-1)


@pytest.mark.parametrize("model", WITH_AIR, ids=str)
def test_every_model_with_an_air_can_be_judged(model: Model) -> None:
    made = with_violation_meters(model)
    assert made == with_violation_meters(model) == with_violation_meters(made)
    assert pickle.loads(pickle.dumps(made)) == made
    assert made.state_names == (*model.state_names, *METERS)
    assert made.parameter_names == (*model.parameter_names, *LIMITS)
    assert made.parameters.default()[-6:].tolist() == [-NO_LIMIT, NO_LIMIT] * 3
    assert (made.id, made.variant) == (f"{model.name}-judged-{model.version}", model.variant)
    assert made.digest != model.digest
    assert [one.name for one in made.flows()] == [one.name for one in model.flows()]
    assert [one.name for one in made.stocks()] == [one.name for one in model.stocks()]
    first, p = np.array([100.0, 8.0, 800.0, 730.0, 3.0, 0.0, 10.0, 0.0, 0.0, 0.0]), made.parameters.default()
    for start in made.starts():
        state = made.start(start, first, 17.0, p)
        assert state[:-6].tolist() == model.start(start, first, 17.0, model.parameters.default()).tolist()
        assert not state[-6:].any()


def test_names_of_limits_and_meters() -> None:
    names = ("air_temperature", "co2", "relative_humidity")
    assert tuple(violation_meter(name, side) for name in names for side in SIDES) == METERS
    assert [limit_parameter(name, side) for name in names for side in SIDES] == list(LIMITS)


def test_the_rates_are_the_distances_and_the_others_stay(some: tuple[Array, Array, Array]) -> None:
    x, u, d = some
    made = with_violation_meters(TOMATO)
    humid = x.copy()
    humid[:, TOMATO.state_index("vpAir")] *= 1.5  # some of it above saturation
    rates = made.rhs(np.hstack([humid, np.zeros((len(x), 6))]), u, d, made.parameters.default("benchmark", LIMITS))
    np.testing.assert_array_equal(rates[:, :-6], TOMATO.rhs(humid, u, d, TOMATO.parameters.default()))
    np.testing.assert_allclose(rates[:, -6:], violations(humid), rtol=1e-12, atol=1e-9)
    assert rates[:, -1].max() > 15.0  # more than 100 % - 85 %
    assert (rates[:, -6:].max(axis=0) > 0.0).sum() >= 5


@pytest.mark.parametrize("preset", ["fast", "standard", "reference"])
def test_no_bit_of_the_others_changes(some: tuple[Array, Array, Array], preset: str, compiled: None) -> None:
    x, u, d = some
    made = with_violation_meters(TOMATO)
    plain = Kernel(TOMATO, 900.0, preset=preset).step(x, u, d, TOMATO.parameters.default())
    p = made.parameters.default("benchmark", LIMITS)
    metered = Kernel(made, 900.0, preset=preset).step(np.hstack([x, np.full((len(x), 6), 1e4)]), u, d, p)
    np.testing.assert_array_equal(metered[:, :-6], plain)


def test_limits_that_are_not_stated_are_never_reached(some: tuple[Array, Array, Array], compiled: None) -> None:
    x, u, d = some
    made = with_violation_meters(TOMATO)
    after = Kernel(made, 900.0, preset="fast").step(np.hstack([x, np.zeros((len(x), 6))]), u, d, made.parameters.default())
    assert not after[:, -6:].any()


@pytest.mark.parametrize(("preset", "most"), [("fast", (0.005, 0.4, 0.02)), ("reference", (3e-4, 0.05, 1e-3))])
def test_the_meters_give_the_time_mean(
    some: tuple[Array, Array, Array], preset: str, most: tuple[float, float, float], compiled: None
) -> None:
    """Against 900 single seconds of the plain model and the trapezoidal rule; ``most`` in degC, ppm and %."""
    x, u, d = some
    made, p = with_violation_meters(TOMATO), TOMATO.parameters.default()
    second = Kernel(TOMATO, 1.0, preset="tight")
    total, now, seen = np.zeros((len(x), 6)), x, violations(x)
    for _ in range(900):
        now = second.step(now, u, d, p)
        total, seen = total + 0.5 * (seen + violations(now)), violations(now)
    kernel = Kernel(made, 900.0, preset=preset)
    after = kernel.step(np.hstack([x, np.zeros((len(x), 6))]), u, d, made.parameters.default("benchmark", LIMITS))
    error = np.abs(after[:, -6:] - total).max(axis=0) / 900.0
    assert (error <= np.repeat(most, 2)).all(), error
    assert (total.max(axis=0) / 900.0 > 0.1).sum() >= 5  # there was something to measure


def test_cvodes_gives_the_same_within_its_tolerance(some: tuple[Array, Array, Array], compiled: None) -> None:
    x, u, d = (part[:6] for part in some)
    made = with_violation_meters(TOMATO)
    p, given = made.parameters.default("benchmark", LIMITS), np.hstack([x, np.zeros((6, 6))])
    one, other = (Kernel(made, 900.0, backend=name).step(given, u, d, p) for name in ("compiled", "casadi"))
    np.testing.assert_allclose(one[:, :-6], other[:, :-6], rtol=1e-5, atol=1e-3)
    assert (np.abs(one - other)[:, -6:].max(axis=0) / 900.0 <= np.repeat((1e-3, 0.1, 5e-3), 2)).all()


def test_derivatives_of_the_rates(some: tuple[Array, Array, Array]) -> None:
    """Away from kinks the meters follow air and limits as differences say."""
    made = with_violation_meters(TOMATO)
    x, u, d = np.append(some[0][0], np.zeros(6)), some[1][0], some[2][0]
    t, c, v = (made.state_index(name) for name in made.air or ())
    x[[t, c, v]] = 30.0, 1000.0, 3900.0
    p = made.parameters.default("benchmark", LIMITS)
    for wrt, vector, places in (("x", x, (t, c, v)), ("p", p, range(len(p) - 6, len(p)))):
        exact = made.jacobian(x, u, d, p, wrt)[-6:]
        for place in places:
            step = 1e-5 * max(1.0, abs(vector[place]))
            moved = [vector.copy(), vector.copy()]
            moved[0][place] += step
            moved[1][place] -= step
            up, down = (made.rhs(x if wrt == "p" else one, u, d, one if wrt == "p" else p)[-6:] for one in moved)
            np.testing.assert_allclose(exact[:, place], (up - down) / (2 * step), rtol=1e-6, atol=1e-9)
    assert not made.jacobian(x, u, d, p, "x")[:, -6:].any()  # nothing reads a meter


@pytest.mark.slow
def test_derivatives_of_a_step(some: tuple[Array, Array, Array], compiled: None) -> None:
    """A meter's derivative to heating, against differences, where the air is too cold all the time."""
    made = with_violation_meters(TOMATO)
    kernel = Kernel(made, 900.0, preset="tight")
    x, u, d = np.append(some[0][0], np.zeros(6)), np.full(6, 0.3), some[2][0]
    p = made.parameters.default("benchmark", LIMITS | {"lowestAirTemperature": 60.0, "highestAirTemperature": 70.0})
    below = made.state_index("belowAirTemperature")
    up, down = u.copy(), u.copy()
    up[0], down[0] = 0.3 + 1e-4, 0.3 - 1e-4
    difference = (kernel.step(x, up, d, p) - kernel.step(x, down, d, p)) / 2e-4
    exact = kernel.linearise(x, u, d, p).du
    assert exact[below, 0] == pytest.approx(difference[below], rel=1e-5)
    assert exact[below, 0] < -100.0


def test_a_model_without_air_cannot_be_judged() -> None:
    with pytest.raises(GlbenchError, match="has no air"):
        with_violation_meters(Toy())
