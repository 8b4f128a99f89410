"""Many steps in one call, as every backend takes them: shapes, agreement with single steps, errors in words."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest

from glbench.errors import ActionError, GlbenchError, ShapeError, StepError, UnknownNameError
from glbench.kernel import Kernel, RolloutError, Trajectory, available, state_scale, why_not_compiled
from glbench.kernel.trajectories import pull_by_steps, push_by_steps
from glbench.model import TOMATO, Model
from tests.kernel.known_steps import Array, KnownSteps
from tests.kernel.toy import DECAY, TANK, decay_rows

BACKENDS = ("compiled", "casadi", "cvodes")
N, STEPS = 3, 5


def kernel_of(model: Model, backend: str) -> Kernel:
    if backend not in available(model):
        pytest.skip(why_not_compiled(model))
    return Kernel(model, 900.0, backend=backend)


@pytest.fixture(scope="module")
def tanks() -> tuple[Array, Array, Array, Array]:
    """Three tanks, five steps, parameters of their own by step; the leak, which the benchmark's tank has not, opens in some."""
    generator = np.random.default_rng(4)
    p = TANK.parameters.default() * generator.uniform(0.8, 1.2, (N, STEPS, 4))
    p[1, 2:, 3] = 1e-4
    x0, u = generator.uniform(0.5, 3.0, (N, 2)), generator.uniform(0.0, 1.0, (N, STEPS, 1))
    return x0, u, generator.uniform(0.0, 1e-3, (N, STEPS, 1)), p


def by_steps(kernel: Kernel, x0: Array, u: Array, d: Array, p: Array) -> Array:
    """States of a batch (n, T + 1, states), by a loop of steps; inputs all with horizons and steps."""
    states = [x0]
    for step in range(u.shape[1]):
        states.append(kernel.step(states[-1], u[:, step], d[:, step], p[:, step]))
    return np.stack(states, axis=1)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_rollout_has_the_bits_of_its_steps(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    expected = by_steps(kernel, x0, u, d, p)
    assert kernel.rollout(x0, u, d, p).tobytes() == expected.tobytes()
    alone = [kernel.rollout(*(table[k] for table in tanks)) for k in range(N)]
    assert np.stack(alone).tobytes() == expected.tobytes()


@pytest.mark.parametrize("backend", BACKENDS)
def test_inputs_are_shared_as_their_shapes_say(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    shape = (N, STEPS)
    for own, spread in [
        (p[0, 0], np.broadcast_to(p[0, 0], (*shape, 4))),  # one for all
        (p[:, 0], np.broadcast_to(p[:, :1], (*shape, 4))),  # one row a horizon
        (p[:1], np.broadcast_to(p[:1], (*shape, 4))),  # one row a step
    ]:
        found = kernel.rollout(x0, u[0], d[1], own)
        expected = by_steps(kernel, x0, *(np.broadcast_to(a, (*shape, 1)) for a in (u[0], d[1])), spread)
        assert found.tobytes() == expected.tobytes()
    # As many horizons as steps: two axes of parameters are horizons.
    square = kernel.rollout(x0, u[0, :N], d[0, :N], p[:, 0])
    assert square[1].tobytes() == kernel.rollout(x0[1], u[0, :N], d[0, :N], p[1, 0]).tobytes()
    # One horizon: two axes of parameters are steps.
    assert kernel.rollout(x0[0], u[0], d[0], p[0]).tobytes() == kernel.rollout(*tanks)[0].tobytes()


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_jacobians_are_those_of_the_steps(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    whole = kernel.linearise_trajectory(x0, u, d, p, inputs=("x", "u", "d"))
    some = kernel.linearise_trajectory(x0, u, d, p)
    assert whole.x.tobytes() == some.x.tobytes() == kernel.rollout(x0, u, d, p).tobytes()
    for step in range(STEPS):
        lines = kernel.linearise(whole.x[:, step], u[:, step], d[:, step], p[:, step])
        assert (whole.dx[:, step] == lines.dx).all()
        assert (whole.du[:, step] == lines.du).all()
        assert (whole.dd[:, step] == lines.dd).all()
    assert some.dd.shape == (N, STEPS, 2, 0)
    np.testing.assert_allclose(some.du, whole.du, rtol=1e-6)
    np.testing.assert_allclose(some.dx, whole.dx, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_pushing_is_the_product_of_the_jacobians_and_pulling_its_transpose(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    path = kernel_of(TANK, backend).linearise_trajectory(*tanks, inputs=("x", "u", "d"))
    generator = np.random.default_rng(6)
    du, dd, dx0, weights = (generator.normal(size=shape) for shape in ((N, STEPS, 1), (N, STEPS, 1), (N, 2), (N, 6, 2)))
    changes = [dx0]
    for step in range(STEPS):
        parts = ((path.dx, changes[-1]), (path.du, du[:, step]), (path.dd, dd[:, step]))
        changes.append(sum(np.einsum("nij,nj->ni", jacobian[:, step], by) for jacobian, by in parts))
    pushed, pulled = path.push(du, dx0, dd), path.pull(weights)
    np.testing.assert_allclose(pushed, np.stack(changes, axis=1), rtol=1e-12, atol=1e-14)
    terms = [pulled.x0 * dx0, pulled.u * du, pulled.d * dd]
    assert (weights * pushed).sum() == pytest.approx(sum(term.sum() for term in terms), rel=1e-12)
    assert (pulled.costates[:, 0] == pulled.x0).all()
    assert (pulled.costates[:, -1] == weights[:, -1]).all()
    numpy_form = push_by_steps(path.jacobians, np.concatenate([du, dd], axis=2), dx0)
    np.testing.assert_allclose(pushed, numpy_form, rtol=1e-13, atol=1e-14)
    costates, along = pull_by_steps(path.jacobians, weights)
    np.testing.assert_allclose(pulled.costates, costates, rtol=1e-13, atol=1e-14)
    np.testing.assert_allclose(pulled.u, along[..., :1], rtol=1e-13, atol=1e-14)
    assert (path.push() == 0.0).all()


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_gradient_of_a_rollout_is_that_of_its_steps(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    """In the second tank, which begins to leak, the two libraries of the compiled kernel take turns."""
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    weights = np.random.default_rng(7).normal(size=(N, STEPS + 1, 2))
    x, found = kernel.rollout_adjoint(x0, u, d, p, weights, parameters=True)
    assert x.tobytes() == kernel.rollout(x0, u, d, p).tobytes()
    assert found.p is not None
    costate = weights[:, -1]
    for step in reversed(range(STEPS)):
        _, one = kernel.adjoint(x[:, step], u[:, step], d[:, step], p[:, step], costate, parameters=True)
        costate = weights[:, step] + one.x
        for ours, theirs in ((found.u, one.u), (found.d, one.d), (found.p, one.p), (found.costates, costate)):
            np.testing.assert_allclose(ours[:, step], theirs, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(found.x0, found.costates[:, 0])
    shared = kernel.rollout_adjoint(x0[0], u[0], d[0], p[0, 0], weights[0], parameters=True)[1]
    by_step = kernel.rollout_adjoint(x0[0], u[0], d[0], np.tile(p[0, 0], (STEPS, 1)), weights[0], parameters=True)[1]
    assert shared.p is not None
    assert by_step.p is not None
    np.testing.assert_allclose(shared.p, by_step.p.sum(axis=0), rtol=1e-12)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_model_without_inputs_has_trajectories_too(backend: str) -> None:
    kernel, rows, none = kernel_of(DECAY, backend), decay_rows(4), np.zeros((6, 0))
    path = kernel.linearise_trajectory(rows.x, none, none, rows.p[0])
    fading = np.exp(-0.9 * np.arange(7))
    np.testing.assert_allclose(path.x, rows.x[:, None] * fading[:, None], rtol=1e-5)
    np.testing.assert_allclose(path.push(dx0=np.ones(1))[..., 0], np.broadcast_to(fading, (4, 7)), rtol=1e-4)
    _, gradient = kernel.rollout_adjoint(rows.x, none, none, rows.p[0], np.eye(7)[:, 6:])
    np.testing.assert_allclose(gradient.x0, np.full((4, 1), fading[-1]), rtol=1e-4)
    assert gradient.u.shape == (4, 6, 0)
    assert path.pull(np.zeros((7, 1))).d.shape == (4, 6, 0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_horizons_without_steps_end_where_they_start(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    assert (kernel.rollout(x0, u[:, :0], d[:, :0], p[0, 0]) == x0[:, None]).all()
    assert kernel.linearise_trajectory(x0[0], u[0, :0], d[0, :0], p[0, 0]).dx.shape == (0, 2, 2)
    weights = np.ones((N, 1, 2))
    assert (kernel.rollout_adjoint(x0, u[:, :0], d[:, :0], p[0, 0], weights)[1].x0 == 1.0).all()
    assert kernel.rollout(x0[:0], u[:0], d[:0], p[0, 0]).shape == (0, STEPS + 1, 2)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_step_that_fails_is_named_with_its_horizon(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    expected = by_steps(kernel, x0, u, d, p)
    d = d.copy()
    d[2, 3] = -1e-2  # drains the tank far below its floor, where the outflow divides by zero
    with pytest.raises(RolloutError, match=r"failed in horizon 2 of 3, step 3 of 5 of 900 s: .*controls uTap") as caught:
        kernel.rollout(x0, u, d, p)
    assert (caught.value.horizon, caught.value.step) == (2, 3)
    assert caught.value.states.tobytes() == np.ascontiguousarray(expected[:, :4]).tobytes()
    for call in (kernel.linearise_trajectory, lambda *inputs: kernel.rollout_adjoint(*inputs, np.zeros((6, 2)))):
        with pytest.raises(StepError, match="horizon 0 of 1, step 3 of 5"):
            call(x0[2], u[2], d[2], p[2])
    assert isinstance(pickle.loads(pickle.dumps(caught.value)).states, np.ndarray)


def test_wrong_inputs_are_explained(tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = Kernel(TANK, 900.0, backend="casadi"), tanks
    path = kernel.linearise_trajectory(x0, u, d, p)
    wrong: list[tuple[type[GlbenchError], str, Callable[[], object]]] = [
        (ShapeError, r"states x0 of a rollout have the shape \(3,\)", lambda: kernel.rollout(x0[:, 0], u, d, p)),
        (ShapeError, r"controls u .*\(5,\); expected \(steps, 1\) or \(3, steps, 1\)", lambda: kernel.rollout(x0, u[0, :, 0], d, p)),
        (ShapeError, r"controls u .*\(3, 5, 1\); expected \(5, 1\)\.", lambda: kernel.rollout(x0[0], u, d[0], p[0])),
        (ShapeError, r"disturbances d .*\(4, 1\); expected \(5, 1\)\.", lambda: kernel.rollout(x0[0], u[0], d[0, :4], p[0])),
        (ShapeError, r"parameters p .*\(5, 4\); expected .*one row a horizon", lambda: kernel.rollout(x0, u, d, p[0])),
        (ShapeError, "state level of horizon 1 is nan", lambda: kernel.rollout(x0 * [[1.0], [np.nan], [1.0]], u, d, p)),
        (ShapeError, "disturbance rain of horizon 0, step 0 is inf", lambda: kernel.rollout(x0, u, d + np.inf, p)),
        (ShapeError, "not a table of numbers", lambda: kernel.rollout(x0, "open", d, p)),
        (ActionError, r"Control uTap of horizon 0, step 0 is .*within 0\.\.1", lambda: kernel.rollout(x0, u + 2.0, d, p)),
        (ShapeError, r'add "x" to the inputs', lambda: kernel.linearise_trajectory(x0, u, d, p, inputs=("u",))),
        (UnknownNameError, "no input 'v'", lambda: kernel.linearise_trajectory(x0, u, d, p, inputs=("x", "v"))),
        (UnknownNameError, "no input 'p'.*by name", lambda: kernel.linearise(x0, u[:, 0], d[:, 0], p[:, 0], inputs=("p",))),
        (ShapeError, r"changes du .*\(6, 1\); expected \(5, 1\)", lambda: path.push(np.zeros((6, 1)))),
        (ShapeError, r"changes dx0 .*\(3,\); expected \(2,\)", lambda: path.push(dx0=np.zeros(3))),
        (ShapeError, r"no derivatives with respect to d: .*\('x', 'u', 'd'\)", lambda: path.push(dd=np.zeros((5, 1)))),
        (ShapeError, r"cotangents .*\(5, 2\); expected \(6, 2\)", lambda: path.pull(np.zeros((5, 2)))),
        (ShapeError, r"cotangents .*\(2,\); expected \(6, 2\)", lambda: kernel.rollout_adjoint(x0, u, d, p, np.zeros(2))),
        (ShapeError, "changes du .*not finite", lambda: path.push(np.full((5, 1), np.nan))),
        (ShapeError, "cotangents .*not finite", lambda: path.pull(np.full((6, 2), np.inf))),
        (ShapeError, "not finite", lambda: kernel.rollout_adjoint(x0, u, d, p, np.full((6, 2), np.nan))),
    ]  # fmt: skip
    for kind, words, call in wrong:
        with pytest.raises(kind, match=words):
            call()


@pytest.mark.parametrize("backend", BACKENDS)
def test_only_what_is_asked_for_is_differentiated(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    rows = x0, u[:, 0], d[:, 0], p[:, 0]
    whole = kernel.linearise(*rows, parameters=["inflow"])
    some = kernel.linearise(*rows, inputs=("u",), parameters=["inflow"])
    assert (some.dx.shape, some.dd.shape) == ((N, 2, 0), (N, 2, 0))
    np.testing.assert_allclose(some.du, whole.du, rtol=1e-6)
    np.testing.assert_allclose(some.dp, whole.dp, rtol=1e-6)
    nothing = kernel.linearise(*rows, inputs=())
    assert nothing.x_next.tobytes() == whole.x_next.tobytes()
    assert nothing.dx.shape == (N, 2, 0)


@pytest.mark.parametrize("backend", BACKENDS)
def test_directions_may_be_shared_by_a_batch(backend: str, tanks: tuple[Array, Array, Array, Array]) -> None:
    kernel, (x0, u, d, p) = kernel_of(TANK, backend), tanks
    rows = x0, u[:, 0], d[:, 0], p[:, 0]
    seeds = np.random.default_rng(3).normal(size=(1, 4, 2))
    shared = kernel.forward(*rows, dx=seeds)[1]
    assert shared.tobytes() == kernel.forward(*rows, dx=np.repeat(seeds, N, axis=0))[1].tobytes()
    assert shared.shape == (N, 4, 2)


def test_a_trajectory_is_copied_with_its_kernel(tanks: tuple[Array, Array, Array, Array]) -> None:
    path = kernel_of(TANK, "compiled").linearise_trajectory(*(table[0] for table in tanks))
    twin: Trajectory = pickle.loads(pickle.dumps(path))
    du = np.ones((STEPS, 1))
    assert twin.push(du).tobytes() == path.push(du).tobytes()


def test_the_tomatos_gradient_agrees_with_that_of_cvodes(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    """Two steps of 900 s, by CVODES' own adjoint equations."""
    if "compiled" not in available():
        pytest.skip("no compiled kernel here")
    tight, scale = Kernel(TOMATO, 900.0, backend="compiled", preset="tight"), state_scale(TOMATO)
    inputs = steps_900.x[20], 0.9 * steps_900.u[20:22] + [0.03, 0.05, 0.02, 0.04, 0.05, 0.06], steps_900.d[20:22], p
    weights = np.random.default_rng(5).normal(size=(3, 28)) / scale
    x, found = tight.rollout_adjoint(*inputs, weights)
    reference, expected = kernel.rollout_adjoint(*inputs, weights)
    assert np.abs((x - reference) / scale).max() < 1e-5
    assert np.abs(found.u - expected.u).max() < 1e-4 * np.abs(expected.u).max()
    assert np.abs((found.x0 - expected.x0) * scale).max() < 1e-4 * np.abs(expected.x0 * scale).max()
