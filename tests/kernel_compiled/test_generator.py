"""The generator: graph, regrouping, derivatives and elimination keep the model's numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import casadi
import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.kernel.compiled.derivative import jacobian
from glbench.kernel.compiled.generate import Traits, generate
from glbench.kernel.compiled.graph import Graph, Level, read_function
from glbench.kernel.compiled.library import absent_equipment
from glbench.kernel.compiled.lu import eliminate
from glbench.kernel.compiled.regroup import regroup, spell_out_logistic
from glbench.model import TOMATO, VARIANTS, build_rhs
from glbench.model import jacobian as model_jacobian

Array = NDArray[np.float64]
GOLDEN = Path(__file__).parent.parent / "golden"

_MEANING: dict[str, Callable[..., Array]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "inv": np.reciprocal, "exp": np.exp,
    "log": np.log, "sqrt": np.sqrt, "abs": np.abs, "sign": np.sign, "tanh": np.tanh, "cos": np.cos, "pow": np.power,
    "min": np.minimum, "max": np.maximum, "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal,
    "and": np.logical_and, "or": np.logical_or, "not": np.logical_not, "select": np.where,
    "exp16": lambda t: np.exp2(t / 16.0), "pow16": lambda x, y: np.power(x, y / 16.0),
    "logistic": lambda z: 1.0 / (1.0 + np.exp(np.minimum(-z, 300.0))),
}  # fmt: skip


def evaluate(graph: Graph, outputs: list[int], inputs: dict[str, Array]) -> Array:
    """Values of nodes at rows of inputs (n, size): an interpreter that owes nothing to the code emitter."""
    values: dict[int, Array] = {}
    for number in graph.needed(outputs):
        node = graph.nodes[number]
        if node.op == "const":
            values[number] = np.full(len(inputs["x"]), node.value)
        elif node.op == "input":
            values[number] = inputs[node.source][:, node.index]
        else:
            with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
                values[number] = np.asarray(_MEANING[node.op](*(values[a] for a in node.args)), dtype=np.float64)
    return np.stack([values[number] for number in outputs], axis=1)


@pytest.fixture(scope="module")
def points() -> dict[str, Array]:
    with np.load(GOLDEN / "model_points.npz") as file:
        return {name: np.ascontiguousarray(file[name]) for name in ("x", "u", "d", "p")}


def scaled_difference(found: Array, expected: Array) -> float:
    scale = np.abs(expected) + 1e-6 * np.abs(expected).max(axis=0) + 1e-12
    return float(np.max(np.abs(found - expected) / scale))


@pytest.mark.parametrize("variant", VARIANTS)
def test_regrouping_changes_the_right_hand_side_by_rounding_only(points: dict[str, Array], variant: str) -> None:
    function = build_rhs(variant)
    graph, outputs = read_function(function, "xudp")
    expected = np.asarray(function.map(len(points["x"]))(*(points[k].T for k in "xudp"))).T
    assert scaled_difference(evaluate(graph, outputs, points), expected) < 1e-9
    grouped, outputs = regroup(graph, outputs)
    assert scaled_difference(evaluate(grouped, outputs, points), expected) < 1e-9
    spelt, outputs = spell_out_logistic(grouped, outputs)
    assert scaled_difference(evaluate(spelt, outputs, points), expected) < 1e-9


def test_derivatives_are_those_of_casadi(points: dict[str, Array]) -> None:
    some = {name: values[::7] for name, values in points.items()}
    graph, slopes = regroup(*read_function(build_rhs("author"), "xudp"))
    rows = jacobian(graph, slopes)
    expected = model_jacobian(some["x"], some["u"], some["d"], some["p"], wrt="x", variant="author")
    found = np.zeros_like(expected)
    for i, row in enumerate(rows):
        if row:
            found[:, i, list(row)] = evaluate(graph, list(row.values()), some)
    scale = np.abs(expected).max(axis=0) + 1e-15
    assert np.max(np.abs(found - expected) / scale) < 1e-8


def test_inputs_are_gathered_out_of_products_and_sums() -> None:
    x, u, d, p = (casadi.SX.sym(name, 2) for name in "xudp")
    product, total = p[0] * x[0] * u[0] * x[1] / d[0], p[1] + x[0] + u[1] + x[1] + d[1]
    function = casadi.Function("f", [x, u, d, p], [casadi.vertcat(product, total)])
    graph, outputs = regroup(*read_function(function, "xudp"))
    at_state = [graph.nodes[n].op for n in graph.needed(outputs) if graph.levels[n] == Level.STATE]
    assert sorted(at_state) == ["add", "add", "input", "input", "mul", "mul"]


def test_parameters_that_are_zero_take_their_terms_along() -> None:
    full, lean = generate(build_rhs("author")), generate(build_rhs("author"), Traits(zeros=absent_equipment(TOMATO)))
    assert lean.operations["NONZEROS"] < full.operations["NONZEROS"]
    assert len(lean.moving) < len(full.moving)


def test_the_clock_is_not_integrated() -> None:
    assert 27 not in generate(build_rhs("author")).moving


def test_generated_text_is_the_same_every_time() -> None:
    assert generate(build_rhs("author")).text == generate(build_rhs("author")).text


def test_equal_expressions_are_one_node() -> None:
    graph = Graph()
    a, b = graph.source("x", 0), graph.source("x", 1)
    assert graph.make("mul", a, b) == graph.make("mul", b, a)
    square = graph.make("mul", graph.make("sub", a, b), graph.make("sub", a, b))
    assert square == graph.make("mul", graph.make("sub", b, a), graph.make("sub", b, a))


def test_signed_zeros_are_different_constants() -> None:
    graph = Graph()
    assert graph.constant(0.0) != graph.constant(-0.0)


def test_one_plus_tanh_becomes_a_logistic_that_keeps_its_tail() -> None:
    x, u, d, p = (casadi.SX.sym(name, 1) for name in "xudp")
    function = casadi.Function("f", [x, u, d, p], [0.5 * (1 + casadi.tanh(x / 2))])
    graph, outputs = spell_out_logistic(*regroup(*read_function(function, "xudp")))
    z = np.array([[-60.0], [-1.0], [3.0]])
    found = evaluate(graph, outputs, {"x": z, "u": z, "d": z, "p": z})[:, 0]
    expected = [math.exp(v) / (1.0 + math.exp(v)) for v in z[:, 0]]
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_if_else_is_one_selection_again() -> None:
    x, u, d, p = (casadi.SX.sym(name, 1) for name in "xudp")
    function = casadi.Function("f", [x, u, d, p], [casadi.if_else(x < u, x * d, x * p)])
    graph, outputs = read_function(function, "xudp")
    assert graph.nodes[outputs[0]].op == "select"


def test_an_unknown_operation_is_named() -> None:
    x, u, d, p = (casadi.SX.sym(name, 1) for name in "xudp")
    with pytest.raises(ValueError, match="OP_ASINH"):
        read_function(casadi.Function("f", [x, u, d, p], [casadi.asinh(x)]), "xudp")


def test_elimination_by_the_plan_solves_the_system() -> None:
    generator = np.random.default_rng(3)
    pattern = [sorted({i, *generator.integers(0, 28, 5).tolist()}) for i in range(28)]
    dense = np.zeros((28, 28))
    for i, columns in enumerate(pattern):
        dense[i, columns] = generator.normal(size=len(columns))
        dense[i, i] = 10.0
    plan = eliminate(pattern)
    factors, expected = dense.copy(), generator.normal(size=28)
    right = dense @ expected
    for i in plan.order:  # what the generated code does, in dense storage
        for j in plan.lower[i]:
            factors[i, j] = (factors[i, j] - sum(factors[i, k] * factors[k, j] for k in plan.lower[i] if j in plan.upper[k])) / factors[
                j, j
            ]
        for j in (*plan.upper[i], i):
            factors[i, j] -= sum(factors[i, k] * factors[k, j] for k in plan.lower[i] if j in (*plan.upper[k], k))
        right[i] -= sum(factors[i, k] * right[k] for k in plan.lower[i])
    found = np.zeros(28)
    for i in reversed(plan.order):
        found[i] = (right[i] - sum(factors[i, j] * found[j] for j in plan.upper[i])) / factors[i, i]
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_elimination_of_an_arrow_fills_nothing_in() -> None:
    arrow = [[0, *range(1, 10)]] + [[0, i] for i in range(1, 10)]
    assert eliminate(arrow).stored == 10 + 9 + 9
