"""The Jacobians: finite everywhere, and equal to derivatives obtained without automatic differentiation."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.model import (
    COMPARTMENT,
    CONTROL_NAMES,
    PARAMETER_NAMES,
    STATE_NAMES,
    VARIANTS,
    default_parameters,
    initial_state,
    jacobian,
    rhs,
    tomato,
)
from glbench.model.model import Model
from glbench.model.paper import Disturbances
from tests.model.conditions import COMPARTMENT_RANGES, Array, Inputs, in_compartment, reference_points, with_entry

POINTS = reference_points()
MODELS = (*map(tomato, VARIANTS), COMPARTMENT)


def points_of(model: Model) -> Inputs:
    """The reference points as inputs of a model; compartments of all kinds, their crops on the way from untopped to topped."""
    if model is not COMPARTMENT:
        return POINTS.inputs
    generator = np.random.default_rng(6)
    more = {name: generator.uniform(*limits, len(POINTS.inputs.x)) for name, limits in COMPARTMENT_RANGES.items()}
    more["tSumTop"] = POINTS.inputs.x[:, STATE_NAMES.index("tCanSum")] + generator.uniform(-200.0, 200.0, len(POINTS.inputs.x))
    return in_compartment(POINTS.inputs, more)


def the_start() -> Inputs:
    """Start of the benchmark's season: all air, screens, floor and pipes at one temperature, everything shut, in calm and darkness."""
    _, _, d, p = (rows[0] for rows in POINTS.of("initial_state"))
    calm = with_entry(d, Disturbances._fields, i_glob=0.0, wind=0.0)
    return Inputs(initial_state(calm), np.zeros(6), calm, p)


@pytest.mark.parametrize("model", MODELS, ids=str)
@pytest.mark.parametrize("wrt", ["x", "u", "d", "p"])
def test_derivatives_are_finite_at_all_reference_points(wrt: str, model: Model) -> None:
    assert np.isfinite(model.jacobian(*points_of(model), wrt=wrt)).all()


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("wrt", ["x", "u", "d", "p"])
@pytest.mark.parametrize("closure", [0.0, 1.0])
def test_derivatives_are_finite_at_the_start_of_the_season(wrt: str, variant: str, closure: float) -> None:
    x, u, d, p = the_start()

    assert np.isfinite(jacobian(x, u + closure, d, p, wrt=wrt, variant=variant)).all()


@pytest.mark.parametrize(
    "entries",
    [{"cWgh": 0.0}, {"aSide": 50.0, "cWgh": 0.0}, {"cHecOut3": 0.5}, {"tauRfFir": 0.1}, {"theta": 1.0}, {"lPipe": 0.0, "lGroPipe": 0.0}],
)
def test_derivatives_are_finite_for_unusual_houses(entries: dict[str, float]) -> None:
    x, u, d, _ = the_start()
    # Without pipes their capacity is 0; the other parameters stay as they are.
    p = with_entry(default_parameters(), PARAMETER_NAMES, **entries)

    for wrt in ("x", "u", "d", "p"):
        assert np.isfinite(jacobian(x, u, d, p, wrt=wrt)).all()


@pytest.mark.parametrize("model", MODELS, ids=str)
@pytest.mark.parametrize("wrt", ["x", "u", "d", "p"])
def test_derivatives_equal_those_by_a_complex_step(wrt: str, model: Model) -> None:
    # f(z + ih) = f(z) + ih f'(z) for a real function: exact to rounding, unlike differences of real numbers.
    step = 1e-30
    # Where a derivative has two sides (equal flows through both screens, a closed screen, a floor as warm as the air), the
    # two methods may choose different ones.
    x, u, _, _ = points_of(model)
    screens = u[:, [CONTROL_NAMES.index("uThScr"), CONTROL_NAMES.index("uBlScr")]]
    floor_and_air = x[:, [STATE_NAMES.index("tFlr"), STATE_NAMES.index("tAir")]]
    one_sided = (np.diff(screens)[:, 0] == 0) | (screens == 1).any(axis=1) | (np.diff(floor_and_air)[:, 0] == 0)
    inputs = Inputs(*(values[~one_sided][::2] for values in points_of(model)))
    assert len(inputs.x) > 50
    computed = model.jacobian(*inputs, wrt=wrt)

    for column in range(computed.shape[-1]):
        shifted = {name: values.astype(complex) for name, values in zip("xudp", inputs, strict=True)}
        shifted[wrt][:, column] += 1j * step
        reference = _derivative(**shifted, model=model).imag / step
        size = np.abs(computed[:, :, column]) + np.abs(computed).max(axis=(0, 2)) * 1e-9
        assert (np.abs(computed[:, :, column] - reference) / (size + 1e-300)).max() < 1e-6


def test_derivatives_to_the_state_equal_differences() -> None:
    # A coarser check that needs nothing but the public functions: central differences of a millionth of each state.
    for category in ("day", "night"):
        x, u, d, p = (rows[0] for rows in POINTS.of(category))
        step = 1e-6 * np.maximum(1, np.abs(x))
        steps = np.diag(step)
        differences = (rhs(x + steps, u, d, p) - rhs(x - steps, u, d, p)).T / (2 * step)
        computed = jacobian(x, u, d, p)
        largest = np.abs(computed).max(axis=1, keepdims=True)
        assert (np.abs(differences - computed) <= 1e-5 * largest + 1e-12).all()


def test_nothing_depends_on_the_clock() -> None:
    assert not jacobian(*POINTS.inputs)[:, :, STATE_NAMES.index("time")].any()


def _derivative(x: Array, u: Array, d: Array, p: Array, model: Model) -> Array:
    evaluation = model.equations(model.State(*x.T), model.Controls(*u.T), model.Disturbances(*d.T), model.Parameters(*p.T))
    return np.array([np.broadcast_to(row, len(x)) for row in evaluation.derivative]).T
