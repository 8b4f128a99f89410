"""Reverse differentiation of the graph: adjoints of all inputs from adjoints of the outputs, in one sweep.

The gradient of one number with respect to 224 inputs costs about three times the number itself. Used for what a control step
computes once from parameters, controls and weather; see docs/sensitivities.md. Roots and powers are guarded as in derivative.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from glbench.kernel.compiled.derivative import slope_of_cosine, slope_of_exponent, slope_of_power, slope_of_root
from glbench.kernel.compiled.graph import CONDITIONS, Graph

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
    found = {}
    for number, adjoint in worker.adjoints.items():
        node = graph.nodes[number]
        if node.op == "input":
            found[node.source, node.index] = adjoint
    return found


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
        return [
            (yes, self.graph.make("select", condition, g, zero)),
            (no, self.graph.make("select", condition, zero, g)),
        ]
