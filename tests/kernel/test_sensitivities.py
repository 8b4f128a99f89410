"""Derivatives of a step as every backend gives them: shapes, errors in words, agreement with CasADi's own."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.errors import ShapeError, StepError, UnknownNameError
from glbench.kernel import Kernel, available, state_scale
from glbench.model import PARAMETER_NAMES, TOMATO
from tests.kernel.known_steps import Array, KnownSteps

STATE_SCALE = state_scale(TOMATO)


@pytest.fixture(scope="module")
def compiled() -> Kernel:
    if "compiled" not in available():
        pytest.skip("no compiled kernel here")
    return Kernel(TOMATO, 900.0, backend="compiled")


@pytest.fixture(scope="module")
def tight(compiled: Kernel) -> Kernel:
    return Kernel(TOMATO, 900.0, backend="compiled", preset="tight")


@pytest.fixture(scope="module")
def inner(steps_900: KnownSteps) -> tuple[Array, Array, Array]:
    """Three known steps, their controls moved off the kinks at the bounds and off each other."""
    rows = np.linspace(0, len(steps_900.x) - 1, 7).astype(int)[1:-1:2]
    offsets = np.array([0.03, 0.05, 0.02, 0.04, 0.05, 0.06])
    return steps_900.x[rows], 0.9 * steps_900.u[rows] + offsets, steps_900.d[rows]


def relative(found: Array, expected: Array) -> float:
    """Largest error of any element, relative to the largest of its column."""
    return float((np.abs(found - expected).max(axis=(0, 1)) / np.abs(expected).max(axis=(0, 1))).max())


@pytest.mark.slow
def test_matrices_agree_with_those_of_cvodes(tight: Kernel, kernel: Kernel, inner: tuple[Array, Array, Array], p: Array) -> None:
    """CVODES integrates the sensitivity equations, which know nothing of substeps held where they are."""
    names = PARAMETER_NAMES[::30]
    expected = kernel.linearise(*inner, p, parameters=names)
    found = tight.linearise(*inner, p, parameters=names)
    scale = STATE_SCALE[:, None]
    for key in ("dx", "du", "dd"):
        used = np.abs(getattr(expected, key)).max(axis=(0, 1)) > 0.0
        assert relative(*((getattr(of, key) / scale)[..., used] for of in (found, expected))) < 1e-4, key
    assert np.abs((found.dp - expected.dp) / scale).max() < 1e-4 * np.abs(expected.dp / scale).max()


@pytest.mark.parametrize("backend", ["casadi", "cvodes"])
def test_gradients_agree_with_those_of_cvodes(tight: Kernel, inner: tuple[Array, Array, Array], p: Array, backend: str) -> None:
    weights = np.random.default_rng(5).normal(size=(3, 28)) / STATE_SCALE
    reference = Kernel(TOMATO, 900.0, backend=backend)
    x_next, expected = reference.adjoint(*inner, p, weights, parameters=True)
    _, found = tight.adjoint(*inner, p, weights, parameters=True)
    assert x_next.tobytes() == reference.step(*inner, p).tobytes()
    assert found.p is not None
    assert expected.p is not None
    for key, unit in (("x", STATE_SCALE), ("u", 1.0), ("d", 1.0), ("p", np.abs(p))):
        ours, theirs = getattr(found, key) * unit, getattr(expected, key) * unit
        assert np.abs(ours - theirs).max() < 1e-4 * np.abs(theirs).max(), key


def test_shapes_of_one_state_and_of_a_batch(compiled: Kernel, inner: tuple[Array, Array, Array], p: Array) -> None:
    one = tuple(table[0] for table in inner)
    alone, batch = compiled.linearise(*one, p, parameters=["aPipe"]), compiled.linearise(*inner, p)
    assert [a.shape for a in (alone.x_next, alone.dx, alone.du, alone.dd, alone.dp)] == [
        (28,), (28, 28), (28, 6), (28, 10), (28, 1),
    ]  # fmt: skip
    assert [a.shape for a in (batch.dx, batch.du, batch.dd, batch.dp)] == [
        (3, 28, 28), (3, 28, 6), (3, 28, 10), (3, 28, 0),
    ]  # fmt: skip
    assert compiled.forward(*one, p, du=np.ones(6))[1].shape == (28,)
    assert compiled.forward(*one, p, du=np.eye(6), dx=np.zeros((6, 28)))[1].shape == (6, 28)
    assert compiled.forward(*inner, p, du=np.ones(6))[1].shape == (3, 28)
    assert compiled.forward(*inner, p, du=np.ones((3, 4, 6)))[1].shape == (3, 4, 28)
    gradient = compiled.adjoint(*inner, p, np.ones(28))[1]
    assert (gradient.x.shape, gradient.u.shape, gradient.d.shape, gradient.p) == ((3, 28), (3, 6), (3, 10), None)


def test_wrong_directions_are_explained(compiled: Kernel, inner: tuple[Array, Array, Array], p: Array) -> None:
    with pytest.raises(ShapeError, match=r"give at least one of dx, du, dd, dp"):
        compiled.forward(*inner, p)
    with pytest.raises(ShapeError, match=r"direction in u has the shape \(5,\); expected \(6,\), \(3, 6\) or \(3, m, 6\)"):
        compiled.forward(*inner, p, du=np.ones(5))
    with pytest.raises(ShapeError, match=r"numbers of directions differ \(dx 1, du 2\)"):
        compiled.forward(*inner, p, dx=np.ones(28), du=np.ones((3, 2, 6)))
    with pytest.raises(ShapeError, match="not finite"):
        compiled.forward(*inner, p, du=np.full(6, np.nan))
    with pytest.raises(ShapeError, match=r"cotangent in x has the shape \(6,\)"):
        compiled.adjoint(*inner, p, np.ones(6))
    with pytest.raises(ShapeError, match="must have that of x"):
        compiled.adjoint(*inner, p, np.ones((3, 2, 28)))
    with pytest.raises(UnknownNameError, match=r"no parameter 'aPip'.*aPipe"):
        compiled.linearise(*inner, p, parameters=["aPip"])


def test_a_row_that_fails_is_named_by_casadi_too(kernel: Kernel, inner: tuple[Array, Array, Array], leafless: Array, p: Array) -> None:
    x = np.stack([inner[0][0], leafless])
    with pytest.raises(StepError, match="row 1 of 2"):
        kernel.adjoint(x, inner[1][:2], inner[2][:2], p, np.ones(28))
