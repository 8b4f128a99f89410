"""Regroups sums and products so that everything that does not depend on the state is computed once a step.

``a*x*b*y`` becomes ``(a*b)*(x*y)`` with ``a*b`` outside of the substeps; ``x + a + y + b`` becomes ``(a + b) + x + y``. The
regrouping changes results by rounding only, and it happens when code is generated: the generated code always does
the same operations in the same order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from glbench.kernel.compiled.graph import Graph, Level, Node

LOGISTIC_LIMIT = 300.0
"""Largest argument of the exponential in ``1/(1 + exp(-z))``: the function is 5e-131 there, and squares stay finite."""

_SIXTEEN_LOG2_E = 16.0 / math.log(2.0)
_SMALL_EXPONENT = 0.9
_SUM = frozenset({"add", "sub"})
_PRODUCT = frozenset({"mul", "inv"})


def regroup(graph: Graph, outputs: Sequence[int]) -> tuple[Graph, list[int]]:
    """A new graph with the same outputs, regrouped."""
    worker = _Regroup(graph, outputs)
    return worker.new, [worker.node(number) for number in outputs]


def spell_out_logistic(graph: Graph, outputs: Sequence[int]) -> tuple[Graph, list[int]]:
    """A new graph in the operations of native/math.hpp; done after differentiation, which has better forms of the slopes.

    ``logistic(z)`` becomes ``1/(1 + exp(-z))``; ``exp(z)`` becomes ``exp16(k z) = 2^(k z/16)`` with the factor ``k`` taken into
    the constants and inputs of ``z``; a power of a positive base with a small fixed exponent becomes ``pow16``.

    Nothing is regrouped here: the derivatives would each pull their own products of inputs out of the substeps, and
    reading all of those back costs more than the multiplications saved.
    """
    new = Graph()
    numbers: dict[int, int] = {}
    for number in graph.needed(outputs):
        node = graph.nodes[number]
        args = [numbers[a] for a in node.args]
        if node.op == "const":
            numbers[number] = new.constant(node.value)
        elif node.op == "input":
            numbers[number] = new.source(node.source, node.index)
        elif node.op == "exp":
            numbers[number] = new.make("exp16", _scaled(new, args[0], _SIXTEEN_LOG2_E))
        elif node.op == "logistic":
            limited = new.make("min", new.constant(LOGISTIC_LIMIT), new.make("neg", args[0]))
            exponential = new.make("exp16", _scaled(new, limited, _SIXTEEN_LOG2_E))
            numbers[number] = new.make("inv", new.make("add", new.constant(1.0), exponential))
        elif node.op == "pow" and new.is_positive(args[0]) and _is_small_constant(new, args[1]):
            numbers[number] = new.make("pow16", args[0], _scaled(new, args[1], 16.0))
        else:
            numbers[number] = new.make(node.op, *args)
    return new, [numbers[number] for number in outputs]


def _is_small_constant(graph: Graph, number: int) -> bool:
    """Whether a value is a constant of size below 0.9, or one of two."""
    node = graph.nodes[number]
    if node.op == "select":
        return all(_is_small_constant(graph, a) for a in node.args[1:])
    return node.op == "const" and abs(node.value) < _SMALL_EXPONENT


def _scaled(graph: Graph, number: int, factor: float) -> int:
    """``factor`` times a value, with the factor taken into a constant or an input of the value where there is one."""
    node = graph.nodes[number]
    if node.op == "neg":
        return _scaled(graph, node.args[0], -factor)
    if node.op in ("min", "max") and any(graph.is_constant(a) for a in node.args):
        turned = {"min": "max", "max": "min"}[node.op] if factor < 0.0 else node.op
        return graph.make(turned, *(_scaled(graph, a, factor) for a in node.args))
    if node.op == "select":
        return graph.make("select", node.args[0], *(_scaled(graph, a, factor) for a in node.args[1:]))
    if node.op == "mul":
        first, second = sorted(node.args, key=lambda a: graph.levels[a])
        if graph.levels[first] < Level.STATE:
            return graph.make("mul", _scaled(graph, first, factor), second)
    return graph.make("mul", graph.constant(factor), number)


class _Regroup:
    def __init__(self, graph: Graph, outputs: Sequence[int]) -> None:
        self.old = graph
        self.new = Graph()
        self.uses = graph.uses(outputs)
        self._numbers: dict[int, int] = {}
        for number in graph.needed(outputs):  # arguments first: the recursion below stays shallow
            self.node(number)

    def node(self, number: int) -> int:
        """The node of the new graph that stands for ``number`` of the old one."""
        if number not in self._numbers:
            self._numbers[number] = self._translate(number)
        return self._numbers[number]

    def _translate(self, number: int) -> int:
        node = self.old.nodes[number]
        if node.op == "const":
            return self.new.constant(node.value)
        if node.op == "input":
            return self.new.source(node.source, node.index)
        if node.op in _SUM:
            return self._sum(number)
        if node.op in _PRODUCT:
            return self._product(number)
        if node.op == "neg":
            return self.new.make("neg", self.node(node.args[0]))
        args = [self.node(a) for a in node.args]
        if node.op == "pow":
            return self._power(args[0], args[1])
        if node.op == "select":
            return self._select(*args)
        return self.new.make(node.op, *args)

    def _select(self, condition: int, yes: int, no: int) -> int:
        """``c ? a z^m : b z^n`` is ``(c ? a : b) z^(c ? m : n)``: one power instead of two."""
        first, second = self._scaled_power(yes), self._scaled_power(no)
        if first is None or second is None or first[1] != second[1]:
            return self.new.make("select", condition, yes, no)
        factor = self.new.make("select", condition, first[0], second[0])
        exponent = self.new.make("select", condition, first[2], second[2])
        return self._times([factor, self.new.make("pow", first[1], exponent)])

    def _scaled_power(self, number: int) -> tuple[int, int, int] | None:
        """(factor, base, exponent) of ``factor base^exponent`` with both fixed, else None."""
        node = self.new.nodes[number]
        factor, power = node.args if node.op == "mul" else (self.new.constant(1.0), number)
        if self.new.nodes[factor].op == "pow":
            factor, power = power, factor
        fixed = self.new.levels[factor] < Level.STATE
        if self.new.nodes[power].op != "pow" or not fixed:
            return None
        base, exponent = self.new.nodes[power].args
        return (factor, base, exponent) if self.new.levels[exponent] < Level.STATE else None

    def _power(self, base: int, exponent: int) -> int:
        """Powers that have a cheaper form: square roots, and a fixed base with a varying exponent."""
        make, is_constant = self.new.make, self.new.is_constant
        if is_constant(exponent, 1.0):
            return base
        if is_constant(exponent, 2.0):
            return make("mul", base, base)
        if is_constant(exponent, 0.5):
            return make("sqrt", base)
        if is_constant(exponent, 0.25):
            return make("sqrt", make("sqrt", base))
        if is_constant(exponent, 1.5):
            return make("mul", base, make("sqrt", base))
        if self.new.levels[base] < Level.STATE and self.new.levels[exponent] == Level.STATE:
            return make("exp", self._times([make("log", base), exponent]))
        return make("pow", base, exponent)

    # -- sums ------------------------------------------------------------------------------------------------------
    def _terms(self, number: int, sign: int, parts: list[tuple[int, int]]) -> None:
        """Appends the terms (sign, old node) of a sum, looking into those parts that nobody else reads."""
        node = self.old.nodes[number]
        if node.op == "neg" and self.uses[number] == 1:
            self._terms(node.args[0], -sign, parts)
        elif node.op in _SUM and self.uses[number] == 1:
            self._terms(node.args[0], sign, parts)
            self._terms(node.args[1], sign if node.op == "add" else -sign, parts)
        else:
            parts.append((sign, number))

    def _sum(self, number: int) -> int:
        node = self.old.nodes[number]
        old_terms: list[tuple[int, int]] = []
        self._terms(node.args[0], 1, old_terms)
        self._terms(node.args[1], 1 if node.op == "add" else -1, old_terms)
        terms = [(sign, self.node(term)) for sign, term in old_terms]
        logistic = self._one_plus_tanh(terms)
        if logistic is not None:
            return logistic

        def rank(term: tuple[int, int]) -> tuple[Level, bool, bool]:
            """Constants, inputs, states; products last within a level, so that each can be fused with the addition."""
            sign, number = term
            node = self.new.nodes[number]
            product = node.op == "mul" or (node.op == "neg" and self.new.nodes[node.args[0]].op == "mul")
            return self.new.levels[number], product, sign < 0

        ordered = sorted(terms, key=rank)
        sign, total = ordered[0]
        if sign < 0:
            total = self.new.make("neg", total)
        for sign, term in ordered[1:]:
            total = self.new.make("add" if sign > 0 else "sub", total, term)
        return total

    def _one_plus_tanh(self, terms: list[tuple[int, int]]) -> int | None:
        """``1 + tanh(y)`` is ``2*logistic(2 y)``: cheaper, and accurate in the tail where the sum cancels."""
        if len(terms) != 2:
            return None
        for (sign_one, one), (sign, other) in (terms, terms[::-1]):
            node = self.new.nodes[other]
            flipped = -1
            if node.op == "neg":
                node, flipped = self.new.nodes[node.args[0]], 1
            if sign_one > 0 and self.new.is_constant(one, 1.0) and node.op == "tanh":
                twice = self._times([self.new.constant(2.0), node.args[0]])
                argument = twice if sign != flipped else self.new.make("neg", twice)
                return self.new.make("mul", self.new.constant(2.0), self.new.make("logistic", argument))
        return None

    # -- products --------------------------------------------------------------------------------------------------
    def _factors(self, number: int, power: int, parts: list[tuple[int, int]]) -> int:
        """Appends the factors (power +1 or -1, old node) of a product; returns its sign."""
        node = self.old.nodes[number]
        alone = self.uses[number] == 1
        if node.op == "neg":
            return -self._factors(node.args[0], power, parts)
        if node.op == "inv":
            return self._factors(node.args[0], -power, parts)
        # Reciprocals of the factors of a denominator can be shared, whoever else reads the product.
        if node.op == "mul" and (alone or power < 0):
            return self._factors(node.args[0], power, parts) * self._factors(node.args[1], power, parts)
        parts.append((power, number))
        return 1

    def _product(self, number: int) -> int:
        node = self.old.nodes[number]
        old_factors: list[tuple[int, int]] = []
        if node.op == "inv":
            sign = self._factors(node.args[0], -1, old_factors)
        else:
            sign = self._factors(node.args[0], 1, old_factors) * self._factors(node.args[1], 1, old_factors)
        factors = []
        for power, factor in old_factors:
            new = self.node(factor)
            factors.append(new if power > 0 else self._reciprocal(new))
        product = self._times(factors)
        return product if sign > 0 else self.new.make("neg", product)

    def _reciprocal(self, number: int) -> int:
        """Reciprocal, taken factor by factor where the node turned out to be a product."""
        node: Node = self.new.nodes[number]
        if node.op == "mul":
            return self._times([self._reciprocal(a) for a in node.args])
        argument = self._argument_of_one_plus_exp(node)
        if argument is not None:
            return self.new.make("logistic", self.new.make("neg", argument))
        return self.new.make("inv", number)

    def _argument_of_one_plus_exp(self, node: Node) -> int | None:
        """``a`` when the node is ``1 + exp(a)``; a limit on ``a`` that keeps exp finite is left to the logistic function."""
        if node.op != "add":
            return None
        for one, other in (node.args, node.args[::-1]):
            exponential = self.new.nodes[other]
            if self.new.is_constant(one, 1.0) and exponential.op == "exp":
                inner = self.new.nodes[exponential.args[0]]
                if inner.op == "min":
                    for limit, free in (inner.args, inner.args[::-1]):
                        if self.new.is_constant(limit) and self.new.value(limit) >= LOGISTIC_LIMIT:
                            return free
                return exponential.args[0]
        return None

    def _flatten(self, number: int) -> list[int]:
        """Factors of a product of the new graph as far as they separate the levels."""
        node = self.new.nodes[number]
        if node.op == "mul" and self.new.levels[node.args[0]] != self.new.levels[node.args[1]]:
            return self._flatten(node.args[0]) + self._flatten(node.args[1])
        return [number]

    def _times(self, factors: list[int]) -> int:
        """Product with the factors gathered by level."""
        parts = [part for factor in factors for part in self._flatten(factor)]
        sign = 1
        for k, part in enumerate(parts):
            if self.new.nodes[part].op == "neg":
                parts[k] = self.new.nodes[part].args[0]
                sign = -sign
        parts.sort(key=lambda part: (self.new.levels[part], part))
        product: int | None = None
        for level in Level:
            of_level = [part for part in parts if self.new.levels[part] == level]
            grouped: int | None = None
            for part in of_level:
                grouped = part if grouped is None else self.new.make("mul", grouped, part)
            if grouped is not None:
                product = grouped if product is None else self.new.make("mul", product, grouped)
        assert product is not None
        return product if sign > 0 else self.new.make("neg", product)
