"""Expression graph of the code generator: hash-consed nodes, each with the level of inputs that it depends on.

A node is a number. ``Graph`` stores what it computes (operation, arguments, constant) and never stores the same thing
twice, so common subexpressions are shared by construction. Constructors fold constants and drop neutral elements; they do
nothing that would change a result by more than the rounding of the folded constants. ``read_function`` makes a graph of a CasADi function.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from types import MappingProxyType
from typing import Any

import casadi


class Level(IntEnum):
    """What a value depends on; everything below STATE is computed once a control step."""

    CONSTANT = 0
    INPUT = 1  # parameters, controls and disturbances: held within the step
    STATE = 2


ONE_ARGUMENT = ("neg", "inv", "exp", "log", "sqrt", "abs", "sign", "tanh", "logistic", "cos", "not", "exp16")
TWO_ARGUMENTS = ("add", "sub", "mul", "pow", "pow16", "min", "max", "lt", "le", "eq", "ne", "and", "or")
COMMUTATIVE = frozenset({"add", "mul", "min", "max", "eq", "ne", "and", "or"})
CONDITIONS = frozenset({"lt", "le", "eq", "ne", "and", "or", "not"})
STATE_SOURCES = frozenset({"x", "k"})
"""Inputs that change within a control step: the state, and a direction in which derivatives are taken along it."""


@dataclass(frozen=True, slots=True)
class Node:
    """One operation. ``source`` and ``index`` name an input ("x", 3); ``value`` is that of a constant."""

    op: str
    args: tuple[int, ...] = ()
    value: float = 0.0
    source: str = ""
    index: int = -1


def _key(node: Node) -> tuple[object, ...]:
    # The sign of zero and the bits of a constant matter, so constants are keyed by their hexadecimal form.
    return (node.op, node.args, node.value.hex(), node.source, node.index)


@dataclass
class Graph:
    """Nodes in an order in which every argument stands before its user."""

    nodes: list[Node] = field(default_factory=list)
    levels: list[Level] = field(default_factory=list)
    _numbers: dict[tuple[object, ...], int] = field(default_factory=dict)

    def _intern(self, node: Node, level: Level) -> int:
        key = _key(node)
        number = self._numbers.get(key)
        if number is None:
            number = len(self.nodes)
            self.nodes.append(node)
            self.levels.append(level)
            self._numbers[key] = number
        return number

    def constant(self, value: float) -> int:
        """Node of a constant."""
        return self._intern(Node("const", value=float(value)), Level.CONSTANT)

    def source(self, name: str, index: int) -> int:
        """Node of element ``index`` of input ``name`` ("x", "u", "d" or "p", and those of the sensitivities)."""
        return self._intern(Node("input", source=name, index=index), Level.STATE if name in STATE_SOURCES else Level.INPUT)

    def is_constant(self, number: int, value: float | None = None) -> bool:
        """Whether the node is a constant (of that value, when given)."""
        node = self.nodes[number]
        return node.op == "const" and (value is None or node.value == value)

    def value(self, number: int) -> float:
        """Value of a constant node."""
        return self.nodes[number].value

    def make(self, op: str, *args: int) -> int:
        """Node of ``op`` applied to ``args``, simplified where that is free.

        Raises ``ValueError`` when the operation is not one of the generator's.
        """
        if op in ("add", "sub", "mul", "neg", "inv"):
            simple = getattr(self, f"_{op}")(*args)
            if simple is not None:
                return int(simple)
        elif op == "select":
            condition, yes, no = args
            if yes == no:
                return yes
            if self.is_constant(condition):
                return yes if self.value(condition) != 0.0 else no
        elif op not in ONE_ARGUMENT and op not in TWO_ARGUMENTS:
            msg = f"The code generator has no operation '{op}'."
            raise ValueError(msg)
        if op in COMMUTATIVE:
            args = tuple(sorted(args))
        if op == "mul" and args[0] == args[1] and self.nodes[args[0]].op == "sub":
            # (a - b)^2 and (b - a)^2 are one.
            difference = self.make("sub", *sorted(self.nodes[args[0]].args))
            args = (difference, difference)
        return self._intern(Node(op, args), Level(max(self.levels[a] for a in args)))

    def is_positive(self, number: int) -> bool:
        """Whether a value is positive by its form: a positive constant, or the sum of one and squares."""
        node = self.nodes[number]
        if node.op == "add":
            first, second = node.args
            return (self.is_positive(first) and self._is_square(second)) or (self.is_positive(second) and self._is_square(first))
        return node.op == "const" and node.value > 0.0

    def _is_square(self, number: int) -> bool:
        node = self.nodes[number]
        return self.is_positive(number) or (node.op == "mul" and node.args[0] == node.args[1])

    def _add(self, a: int, b: int) -> int | None:
        if self.is_constant(a) and self.is_constant(b):
            return self.constant(self.value(a) + self.value(b))
        if self.is_constant(a, 0.0):
            return b
        if self.is_constant(b, 0.0):
            return a
        if self.nodes[b].op == "neg":
            return self.make("sub", a, self.nodes[b].args[0])
        if self.nodes[a].op == "neg":
            return self.make("sub", b, self.nodes[a].args[0])
        return None

    def _sub(self, a: int, b: int) -> int | None:
        if self.is_constant(a) and self.is_constant(b):
            return self.constant(self.value(a) - self.value(b))
        if self.is_constant(b, 0.0):
            return a
        if self.is_constant(a, 0.0):
            return self.make("neg", b)
        if a == b:
            return self.constant(0.0)
        if self.nodes[b].op == "neg":
            return self.make("add", a, self.nodes[b].args[0])
        if self.nodes[a].op == "neg":
            return self.make("neg", self.make("add", self.nodes[a].args[0], b))
        # a - b and b - a are one node and its negative, which products and sums take in for nothing.
        reverse = self._numbers.get(_key(Node("sub", (b, a))))
        return None if reverse is None else self.make("neg", reverse)

    def _mul(self, a: int, b: int) -> int | None:
        if self.is_constant(a) and self.is_constant(b):
            return self.constant(self.value(a) * self.value(b))
        for one, other in ((a, b), (b, a)):
            if self.is_constant(one, 0.0):
                return self.constant(0.0)
            if self.is_constant(one, 1.0):
                return other
            if self.is_constant(one, -1.0):
                return self.make("neg", other)
            if self.nodes[one].op == "neg":
                return self.make("neg", self.make("mul", self.nodes[one].args[0], other))
        # Constants come together, and go to the inputs or to the front: (2 a)(2 b) is 4 (a b), (2 x) p is (2 p) x.
        low, high = sorted((a, b), key=lambda number: self.levels[number])
        (c, rest_low), (d, rest_high) = self._without_constant(low), self._without_constant(high)
        if rest_low is None or self.levels[low] < self.levels[high]:
            return None if d is None or rest_high is None else self.make("mul", self.make("mul", d, low), rest_high)
        if (c is None and d is None) or rest_high is None:
            return None
        constant = self.constant((1.0 if c is None else self.value(c)) * (1.0 if d is None else self.value(d)))
        return self.make("mul", constant, self.make("mul", rest_low, rest_high))

    def _without_constant(self, number: int) -> tuple[int | None, int | None]:
        """(constant, rest) of a constant or of a product with one; the constant is None where there is none."""
        node = self.nodes[number]
        if node.op == "const":
            return number, None
        if node.op == "mul":
            for constant, rest in (node.args, node.args[::-1]):
                if self.nodes[constant].op == "const":
                    return constant, rest
        return None, number

    def _neg(self, a: int) -> int | None:
        node = self.nodes[a]
        if node.op == "const":
            return self.constant(-node.value)
        return node.args[0] if node.op == "neg" else None

    def _inv(self, a: int) -> int | None:
        node = self.nodes[a]
        if node.op == "const" and node.value != 0.0 and math.isfinite(node.value):
            return self.constant(1.0 / node.value)
        if node.op == "inv":
            return node.args[0]
        if node.op == "neg":
            return self.make("neg", self.make("inv", node.args[0]))
        return None

    def needed(self, outputs: Iterable[int]) -> list[int]:
        """Nodes that the outputs need, arguments before users."""
        marked: set[int] = set()
        stack = list(outputs)
        while stack:
            number = stack.pop()
            if number not in marked:
                marked.add(number)
                stack.extend(self.nodes[number].args)
        return sorted(marked)

    def uses(self, outputs: Iterable[int]) -> dict[int, int]:
        """How often each needed node is read: by other needed nodes and as an output."""
        outputs = list(outputs)
        count: dict[int, int] = {}
        for number in self.needed(outputs):
            for argument in self.nodes[number].args:
                count[argument] = count.get(argument, 0) + 1
        for number in outputs:
            count[number] = count.get(number, 0) + 1
        return count


# CasADi's operations that are one node of ours; the others are spelt out in `_combined`.
_DIRECT = {
    casadi.OP_ADD: "add",
    casadi.OP_SUB: "sub",
    casadi.OP_MUL: "mul",
    casadi.OP_NEG: "neg",
    casadi.OP_INV: "inv",
    casadi.OP_EXP: "exp",
    casadi.OP_LOG: "log",
    casadi.OP_SQRT: "sqrt",
    casadi.OP_FABS: "abs",
    casadi.OP_SIGN: "sign",
    casadi.OP_TANH: "tanh",
    casadi.OP_COS: "cos",
    casadi.OP_POW: "pow",
    casadi.OP_CONSTPOW: "pow",
    casadi.OP_FMIN: "min",
    casadi.OP_FMAX: "max",
    casadi.OP_LT: "lt",
    casadi.OP_LE: "le",
    casadi.OP_EQ: "eq",
    casadi.OP_NE: "ne",
    casadi.OP_NOT: "not",
    casadi.OP_AND: "and",
    casadi.OP_OR: "or",
    casadi.OP_ASSIGN: "assign",
}
_NAMES = {getattr(casadi, name): name for name in dir(casadi) if name.startswith("OP_")}


Source = tuple[str, int]
"""Element of an input: its name and place."""


def read_function(
    function: Any,
    input_names: Sequence[str],
    zeros: Collection[int] = (),
    *,
    aliases: Mapping[Source, Source] = MappingProxyType({}),
    cuts: Mapping[int, Source] = MappingProxyType({}),
    trace: dict[int, int] | None = None,
) -> tuple[Graph, list[int]]:
    """Graph of an SX function and the nodes of its first output, in order.

    Raises ``ValueError`` when the function has an operation that the generator does not know.

    Parameters
    ----------
    function
        ``casadi.Function`` of SX expressions with dense arguments.
    input_names
        Name of each argument, in order; ``"x"`` is the state.
    zeros
        Elements of ``"p"`` that are known to be zero: what they multiply is left out.
    aliases
        Elements of inputs by what the graph calls them.
    cuts
        Instructions whose result the graph reads as an element of an input instead of computing it.
    trace
        Gets the node of each instruction.
    """
    graph = Graph()
    work: dict[int, int] = {}
    outputs = [graph.constant(0.0)] * int(function.numel_out(0))
    rows = function.sparsity_out(0).row()
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        operands, results = function.instruction_input(k), function.instruction_output(k)
        if k in cuts:
            work[results[0]] = graph.source(*cuts[k])
        elif code == casadi.OP_INPUT:
            name = input_names[operands[0]]
            absent = name == "p" and operands[1] in zeros
            source = (name, operands[1])
            work[results[0]] = graph.constant(0.0) if absent else graph.source(*aliases.get(source, source))
        elif code == casadi.OP_CONST:
            work[results[0]] = graph.constant(function.instruction_constant(k))
        elif code == casadi.OP_OUTPUT:
            outputs[rows[results[1]]] = work[operands[0]]
        else:
            work[results[0]] = _node(graph, code, [work[i] for i in operands])
        if trace is not None and code != casadi.OP_OUTPUT:
            trace[k] = work[results[0]]
    return graph, outputs


def _node(graph: Graph, code: int, args: list[int]) -> int:
    name = _DIRECT.get(code)
    if name == "assign":
        return args[0]
    if name == "add":
        return _add_or_select(graph, args[0], args[1])
    if name is not None:
        # CasADi repeats the argument of one-argument operations.
        return graph.make(name, *(args if code in _BINARY else args[:1]))
    if code == casadi.OP_DIV:
        return graph.make("mul", args[0], graph.make("inv", args[1]))
    if code == casadi.OP_SQ:
        return graph.make("mul", args[0], args[0])
    if code == casadi.OP_TWICE:
        return graph.make("mul", graph.constant(2.0), args[0])
    if code == casadi.OP_IF_ELSE_ZERO:
        return graph.make("select", args[0], args[1], graph.constant(0.0))
    msg = f"The code generator does not know CasADi's operation {_NAMES.get(code, code)}."
    raise ValueError(msg)


def _add_or_select(graph: Graph, a: int, b: int) -> int:
    """``if_else(c, a, b)`` reaches us as ``(c ? a : 0) + (!c ? b : 0)``: put it together again."""
    first, second = graph.nodes[a], graph.nodes[b]
    if first.op == second.op == "select" and graph.is_constant(first.args[2], 0.0) and graph.is_constant(second.args[2], 0.0):
        if graph.make("not", first.args[0]) == second.args[0]:
            return graph.make("select", first.args[0], first.args[1], second.args[1])
        if graph.make("not", second.args[0]) == first.args[0]:
            return graph.make("select", second.args[0], second.args[1], first.args[1])
    return graph.make("add", a, b)


_BINARY = frozenset(
    code for code, name in _DIRECT.items() if name in {"add", "sub", "mul", "pow", "min", "max", "lt", "le", "eq", "ne", "and", "or"}
)
