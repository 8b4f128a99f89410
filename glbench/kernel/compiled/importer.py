"""Reads a CasADi SX function into the generator's graph."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import casadi

from glbench.kernel.compiled.graph import Graph

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


def read_function(function: Any, input_names: Sequence[str], zeros: Collection[int] = ()) -> tuple[Graph, list[int]]:
    """Graph of an SX function and the nodes of its first output, in order.

    Parameters
    ----------
    function
        ``casadi.Function`` of SX expressions with dense arguments.
    input_names
        Name of each argument, in order; ``"x"`` is the state.
    zeros
        Elements of ``"p"`` that are known to be zero: what they multiply is left out.

    Raises
    ------
    ValueError
        When the function has an operation that the generator does not know.
    """
    graph = Graph()
    work: dict[int, int] = {}
    outputs = [graph.constant(0.0)] * int(function.numel_out(0))
    rows = function.sparsity_out(0).row()
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        taken, given = function.instruction_input(k), function.instruction_output(k)
        if code == casadi.OP_INPUT:
            name = input_names[taken[0]]
            absent = name == "p" and taken[1] in zeros
            work[given[0]] = graph.constant(0.0) if absent else graph.source(name, taken[1])
        elif code == casadi.OP_CONST:
            work[given[0]] = graph.constant(function.instruction_constant(k))
        elif code == casadi.OP_OUTPUT:
            outputs[rows[given[1]]] = work[taken[0]]
        else:
            work[given[0]] = _node(graph, code, [work[i] for i in taken])
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
    if (
        first.op == second.op == "select"
        and graph.is_constant(first.args[2], 0.0)
        and graph.is_constant(second.args[2], 0.0)
    ):
        if graph.make("not", first.args[0]) == second.args[0]:
            return graph.make("select", first.args[0], first.args[1], second.args[1])
        if graph.make("not", second.args[0]) == first.args[0]:
            return graph.make("select", second.args[0], second.args[1], first.args[1])
    return graph.make("add", a, b)


_BINARY = frozenset(
    code
    for code, name in _DIRECT.items()
    if name in {"add", "sub", "mul", "pow", "min", "max", "lt", "le", "eq", "ne", "and", "or"}
)
