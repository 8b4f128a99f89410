"""Differentiation of the graph: forward, with respect to the elements of an input or along one direction, and reverse.

Forward derivatives are sparse: every intermediate of the model depends on few states (a flux on two or three), so carrying one
derivative for each of them costs little more than the structural nonzeros of the Jacobian.

Reverse derivatives are adjoints of all inputs from adjoints of the outputs, in one sweep. The gradient of one number with respect to 224
inputs costs about three times the number itself. They serve what a control step computes once from parameters, controls and weather;
see docs/sensitivities.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from glbench.kernel.compiled.graph import CONDITIONS, Graph, Node

Gradient = dict[int, int]  # state -> node of the derivative


def jacobian(graph: Graph, outputs: Sequence[int], source: str = "x", *, guarded: bool = False) -> list[Gradient]:
    """Adds the derivatives of ``outputs`` to ``graph``: one {state: node} for each output, structural nonzeros only.

    ``guarded`` derivatives of roots and powers are 0 where their base is 0, instead of infinite or not a number: there the base
    is the flat side of a maximum (the gap of a closed screen), which the chain rule cannot know.
    """
    return _differentiate(graph, outputs, lambda node: {node.index: graph.constant(1.0)} if node.source == source else {}, guarded=guarded)


def directional(graph: Graph, outputs: Sequence[int], direction: Callable[[Node], int | None]) -> list[int]:
    """Adds the guarded derivatives of ``outputs`` along one direction: a node for each, the constant 0 where there is none.

    ``direction`` gives the node of the direction's component for an input, or None for an input that is held.
    """

    def seed(node: Node) -> Gradient:
        component = direction(node)
        return {} if component is None else {0: component}

    zero = graph.constant(0.0)
    return [gradient.get(0, zero) for gradient in _differentiate(graph, outputs, seed, guarded=True)]


def _differentiate(graph: Graph, outputs: Sequence[int], seed: Callable[[Node], Gradient], *, guarded: bool) -> list[Gradient]:
    worker = _Forward(graph, seed, guarded=guarded)
    for number in graph.needed(outputs):
        worker.visit(number)
    return [worker.of(number) for number in outputs]


class _Forward:
    def __init__(self, graph: Graph, seed: Callable[[Node], Gradient], *, guarded: bool) -> None:
        self.graph = graph
        self.seed = seed
        self.guarded = guarded
        self._gradients: dict[int, Gradient] = {}

    def of(self, number: int) -> Gradient:
        return self._gradients.get(number, {})

    def visit(self, number: int) -> None:
        """Records the gradient of a node whose arguments have been visited."""
        node = self.graph.nodes[number]
        if node.op == "input":
            gradient = self.seed(node)
            if gradient:
                self._gradients[number] = gradient
            return
        reads = node.args[1:] if node.op == "select" else node.args  # a condition is flat
        if not any(self.of(a) for a in reads) or node.op in CONDITIONS or node.op == "sign":
            return
        rule: Callable[[int], Gradient] = getattr(self, f"_{node.op}")
        gradient = {state: part for state, part in rule(number).items() if not self.graph.is_constant(part, 0.0)}
        self._gradients[number] = gradient

    # -- helpers ---------------------------------------------------------------------------------------------------
    def _scaled(self, gradient: Gradient, factor: int) -> Gradient:
        return {state: self.graph.make("mul", factor, part) for state, part in gradient.items()}

    def _plus(self, a: Gradient, b: Gradient, op: str = "add") -> Gradient:
        zero = self.graph.constant(0.0)
        return {s: self.graph.make(op, a.get(s, zero), b.get(s, zero)) for s in sorted({*a, *b})}

    def _args(self, number: int) -> tuple[int, ...]:
        return self.graph.nodes[number].args

    # -- rules -----------------------------------------------------------------------------------------------------
    def _add(self, number: int) -> Gradient:
        a, b = self._args(number)
        return self._plus(self.of(a), self.of(b))

    def _sub(self, number: int) -> Gradient:
        a, b = self._args(number)
        return self._plus(self.of(a), self.of(b), "sub")

    def _neg(self, number: int) -> Gradient:
        return {s: self.graph.make("neg", part) for s, part in self.of(self._args(number)[0]).items()}

    def _mul(self, number: int) -> Gradient:
        a, b = self._args(number)
        if a == b:
            return self._scaled(self.of(a), self.graph.make("mul", self.graph.constant(2.0), a))
        return self._plus(self._scaled(self.of(b), a), self._scaled(self.of(a), b))

    def _inv(self, number: int) -> Gradient:
        return self._scaled(self.of(self._args(number)[0]), self.graph.make("neg", self.graph.make("mul", number, number)))

    def _exp(self, number: int) -> Gradient:
        return self._scaled(self.of(self._args(number)[0]), number)

    def _log(self, number: int) -> Gradient:
        (a,) = self._args(number)
        return self._scaled(self.of(a), self.graph.make("inv", a))

    def _sqrt(self, number: int) -> Gradient:
        (a,) = self._args(number)
        return self._scaled(self.of(a), slope_of_root(self.graph, number, guarded=self.guarded))

    def _pow(self, number: int) -> Gradient:
        base, exponent = self._args(number)
        by_base = self._scaled(self.of(base), slope_of_power(self.graph, number, guarded=self.guarded))
        if not self.of(exponent):
            return by_base
        return self._plus(by_base, self._scaled(self.of(exponent), slope_of_exponent(self.graph, number)))

    def _cos(self, number: int) -> Gradient:
        (a,) = self._args(number)
        return self._scaled(self.of(a), slope_of_cosine(self.graph, a))

    def _logistic(self, number: int) -> Gradient:
        slope = self.graph.make("mul", number, self.graph.make("sub", self.graph.constant(1.0), number))
        return self._scaled(self.of(self._args(number)[0]), slope)

    def _tanh(self, number: int) -> Gradient:
        square = self.graph.make("mul", number, number)
        return self._scaled(self.of(self._args(number)[0]), self.graph.make("sub", self.graph.constant(1.0), square))

    def _abs(self, number: int) -> Gradient:
        (a,) = self._args(number)
        return self._scaled(self.of(a), self.graph.make("sign", a))

    def _min(self, number: int) -> Gradient:
        a, b = self._args(number)
        return self._either(self.graph.make("le", a, b), a, b)

    def _max(self, number: int) -> Gradient:
        a, b = self._args(number)
        return self._either(self.graph.make("le", b, a), a, b)

    def _select(self, number: int) -> Gradient:
        condition, yes, no = self._args(number)
        return self._either(condition, yes, no)

    def _either(self, condition: int, yes: int, no: int) -> Gradient:
        zero = self.graph.constant(0.0)
        states = sorted({*self.of(yes), *self.of(no)})
        return {s: self.graph.make("select", condition, self.of(yes).get(s, zero), self.of(no).get(s, zero)) for s in states}


def slope_of_root(graph: Graph, root: int, *, guarded: bool) -> int:
    """Slope of sqrt(a): sqrt(a)/(2 a), not 1/(2 sqrt(a)): the reciprocal of ``a`` is often needed anyway."""
    (a,) = graph.nodes[root].args
    half = graph.make("mul", graph.constant(0.5), root)
    slope = graph.make("mul", half, graph.make("inv", a))
    return _where_positive(graph, a, slope) if guarded else slope


def slope_of_power(graph: Graph, power: int, *, guarded: bool) -> int:
    """Slope of b^e in b: e b^e/b."""
    base, exponent = graph.nodes[power].args
    slope = graph.make("mul", graph.make("mul", exponent, power), graph.make("inv", base))
    return _where_positive(graph, base, slope) if guarded else slope


def slope_of_exponent(graph: Graph, power: int) -> int:
    """Slope of b^e in e: b^e log b; 0 where b is 0, as for every positive exponent."""
    base, _ = graph.nodes[power].args
    return _where_positive(graph, base, graph.make("mul", power, graph.make("log", base)))


def slope_of_cosine(graph: Graph, angle: int) -> int:
    """-sin(a), written as a cosine."""
    return graph.make("cos", graph.make("add", angle, graph.constant(0.5 * math.pi)))


def _where_positive(graph: Graph, number: int, value: int) -> int:
    zero = graph.constant(0.0)
    return graph.make("select", graph.make("lt", zero, number), value, zero)


Parts = list[tuple[int, int]]  # (argument, what the result's adjoint adds to the argument's)


def reverse(graph: Graph, outputs: Sequence[int], adjoints: Sequence[int]) -> dict[tuple[str, int], int]:
    """Adds the adjoints of the inputs to ``graph``.

    Parameters
    ----------
    graph
        Graph of the outputs.
    outputs, adjoints
        Nodes, and for each the node of its adjoint.

    Returns
    -------
    dict
        Node of the adjoint of each input (name, index) that the outputs depend on.
    """
    worker = _Reverse(graph)
    for output, adjoint in zip(outputs, adjoints, strict=True):
        worker.add(output, adjoint)
    for number in reversed(graph.needed(outputs)):
        worker.visit(number)
    inputs = {number: graph.nodes[number] for number in worker.adjoints if graph.nodes[number].op == "input"}
    return {(node.source, node.index): worker.adjoints[number] for number, node in inputs.items()}


class _Reverse:
    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.adjoints: dict[int, int] = {}

    def add(self, number: int, part: int) -> None:
        """Adds to the adjoint of a node; constants have none."""
        if self.graph.is_constant(number) or self.graph.is_constant(part, 0.0):
            return
        before = self.adjoints.get(number)
        self.adjoints[number] = part if before is None else self.graph.make("add", before, part)

    def visit(self, number: int) -> None:
        """Hands the adjoint of a node, complete by now, to its arguments."""
        node = self.graph.nodes[number]
        adjoint = self.adjoints.get(number)
        if adjoint is None or node.op in CONDITIONS or node.op in ("input", "const", "sign"):
            return
        rule: Callable[[int, int], Parts] = getattr(self, f"_{node.op}")
        for argument, part in rule(number, adjoint):
            self.add(argument, part)

    def _args(self, number: int) -> tuple[int, ...]:
        return self.graph.nodes[number].args

    def _times(self, a: int, b: int) -> int:
        return self.graph.make("mul", a, b)

    # -- rules: result and its adjoint -> parts ----------------------------------------------------------------------
    def _add(self, number: int, g: int) -> Parts:
        a, b = self._args(number)
        return [(a, g), (b, g)]

    def _sub(self, number: int, g: int) -> Parts:
        a, b = self._args(number)
        return [(a, g), (b, self.graph.make("neg", g))]

    def _neg(self, number: int, g: int) -> Parts:
        return [(self._args(number)[0], self.graph.make("neg", g))]

    def _mul(self, number: int, g: int) -> Parts:
        a, b = self._args(number)
        return [(a, self._times(g, b)), (b, self._times(g, a))]

    def _inv(self, number: int, g: int) -> Parts:
        return [(self._args(number)[0], self.graph.make("neg", self._times(g, self._times(number, number))))]

    def _exp(self, number: int, g: int) -> Parts:
        return [(self._args(number)[0], self._times(g, number))]

    def _log(self, number: int, g: int) -> Parts:
        (a,) = self._args(number)
        return [(a, self._times(g, self.graph.make("inv", a)))]

    def _sqrt(self, number: int, g: int) -> Parts:
        return [(self._args(number)[0], self._times(g, slope_of_root(self.graph, number, guarded=True)))]

    def _pow(self, number: int, g: int) -> Parts:
        base, exponent = self._args(number)
        parts = [(base, self._times(g, slope_of_power(self.graph, number, guarded=True)))]
        if not self.graph.is_constant(exponent):
            parts.append((exponent, self._times(g, slope_of_exponent(self.graph, number))))
        return parts

    def _logistic(self, number: int, g: int) -> Parts:
        rest = self.graph.make("sub", self.graph.constant(1.0), number)
        return [(self._args(number)[0], self._times(g, self._times(number, rest)))]

    def _tanh(self, number: int, g: int) -> Parts:
        slope = self.graph.make("sub", self.graph.constant(1.0), self._times(number, number))
        return [(self._args(number)[0], self._times(g, slope))]

    def _cos(self, number: int, g: int) -> Parts:
        (a,) = self._args(number)
        return [(a, self._times(g, slope_of_cosine(self.graph, a)))]

    def _abs(self, number: int, g: int) -> Parts:
        (a,) = self._args(number)
        return [(a, self._times(g, self.graph.make("sign", a)))]

    def _min(self, number: int, g: int) -> Parts:
        a, b = self._args(number)
        return self._either(self.graph.make("le", a, b), a, b, g)

    def _max(self, number: int, g: int) -> Parts:
        a, b = self._args(number)
        return self._either(self.graph.make("le", b, a), a, b, g)

    def _select(self, number: int, g: int) -> Parts:
        condition, yes, no = self._args(number)
        return self._either(condition, yes, no, g)

    def _either(self, condition: int, yes: int, no: int, g: int) -> Parts:
        """The active branch takes the adjoint whole; at a tie it is the one that the value came from."""
        zero = self.graph.constant(0.0)
        return [(yes, self.graph.make("select", condition, g, zero)), (no, self.graph.make("select", condition, zero, g))]
