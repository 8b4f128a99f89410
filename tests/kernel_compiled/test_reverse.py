"""Reverse and directional differentiation of the generator's graph."""

from __future__ import annotations

import casadi
import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel.compiled.derivative import directional, jacobian, reverse
from glbench.kernel.compiled.graph import Graph, read_function
from glbench.kernel.compiled.regroup import regroup
from glbench.model import build_rhs
from tests.kernel_compiled.test_generator import evaluate, points, scaled_difference

Array = NDArray[np.float64]

__all__ = ["points"]  # a fixture of the generator's tests


def gradient(expression: casadi.SX, x: casadi.SX, at: Array) -> tuple[Array, Array]:
    """Gradient of a number with respect to x (n, size) by the graph and by CasADi."""
    held = [casadi.SX.sym(name, 1) for name in "udp"]
    graph, outputs = regroup(*read_function(casadi.Function("f", [x, *held], [expression]), "xudp"))
    adjoints = reverse(graph, outputs, [graph.constant(1.0)])
    zero = graph.constant(0.0)
    nodes = [adjoints.get(("x", index), zero) for index in range(x.numel())]
    other = np.ones((len(at), 1))
    found = evaluate(graph, nodes, {"x": at, "u": other, "d": other, "p": other})
    exact = casadi.Function("g", [x], [casadi.gradient(expression, x)])
    return found, np.stack([np.asarray(exact(row)).ravel() for row in at])


@pytest.mark.parametrize(
    "make",
    [
        lambda a, b: a * b + a / b - b,
        lambda a, b: casadi.exp(a) * casadi.log(b) + casadi.sqrt(a + b),
        lambda a, b: a**2.5 + 1.7**b + a**b,
        lambda a, b: casadi.tanh(a) + casadi.cos(a * b) + 1 / (1 + casadi.exp(-a)),
        lambda a, b: casadi.fmin(a, b) + casadi.fmax(2 * a, b) + casadi.fabs(a - b),
        lambda a, b: casadi.if_else(a < b, a * b, a - b) + casadi.sign(a),
        lambda a, b: a * a * a + (-a) * (-b),
    ],
)
def test_every_operation_has_the_gradient_of_casadi(make) -> None:
    x = casadi.SX.sym("x", 2)
    found, expected = gradient(make(x[0], x[1]), x, np.random.default_rng(4).uniform(0.2, 3.0, (50, 2)))
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_the_whole_model_has_the_adjoint_of_its_jacobian(points: dict[str, Array]) -> None:
    some = {name: values[::7] for name, values in points.items()}
    graph, slopes = regroup(*read_function(build_rhs("author"), "xudp"))
    seeds = [graph.source("cb", k) for k in range(28)]
    some["cb"] = np.random.default_rng(1).normal(size=(len(some["x"]), 28))
    adjoints = reverse(graph, slopes, seeds)
    rows = jacobian(graph, slopes, guarded=True)
    dense = np.zeros((len(some["x"]), 28, 28))
    for i, row in enumerate(rows):
        if row:
            dense[:, i, list(row)] = evaluate(graph, list(row.values()), some)
    zero = graph.constant(0.0)
    found = evaluate(graph, [adjoints.get(("x", j), zero) for j in range(28)], some)
    expected = np.einsum("ni,nij->nj", some["cb"], dense)
    scale = np.einsum("ni,nij->nj", np.abs(some["cb"]), np.abs(dense)) + 1e-300
    assert np.max(np.abs(found - expected) / scale) < 1e-9


def test_a_direction_is_the_jacobian_times_a_vector(points: dict[str, Array]) -> None:
    some = {name: values[::7] for name, values in points.items()}
    some["k"] = np.random.default_rng(2).normal(size=some["x"].shape)
    graph, slopes = regroup(*read_function(build_rhs("author"), "xudp"))
    along = directional(graph, slopes, lambda node: graph.source("k", node.index) if node.source == "x" else None)
    rows = jacobian(graph, slopes, guarded=True)
    expected = np.zeros_like(some["x"])
    for i, row in enumerate(rows):
        if row:
            expected[:, i] = (evaluate(graph, list(row.values()), some) * some["k"][:, list(row)]).sum(axis=1)
    assert scaled_difference(evaluate(graph, along, some), expected) < 1e-8


def test_a_root_on_the_flat_side_of_a_maximum_has_no_slope() -> None:
    """(1 - x) sqrt(max(0, 1 - x)), the gap of a closing screen: its slope at x = 1 is 0, not 0 times infinity."""
    x = casadi.SX.sym("x", 1)
    gap = casadi.fmax(0, 1 - x)
    at = np.array([[0.75], [1.0], [1.5]])
    other = np.ones((3, 1))
    held = [casadi.SX.sym(name, 1) for name in "udp"]
    graph, outputs = regroup(*read_function(casadi.Function("f", [x, *held], [gap * casadi.sqrt(gap)]), "xudp"))
    adjoint = reverse(graph, outputs, [graph.constant(1.0)])["x", 0]
    (along,) = directional(graph, outputs, lambda node: graph.constant(1.0) if node.source == "x" else None)
    found = evaluate(graph, [adjoint, along], {"x": at, "u": other, "d": other, "p": other})
    np.testing.assert_allclose(found, [[-0.75, -0.75], [0.0, 0.0], [0.0, 0.0]])


def test_constants_have_no_adjoint() -> None:
    graph = Graph()
    five = graph.constant(5.0)
    assert reverse(graph, [five], [graph.constant(1.0)]) == {}
