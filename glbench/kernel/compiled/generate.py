"""The model as C++ text: from ``glbench.model`` through graph, regrouping and differentiation."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from glbench.kernel.compiled import derivative, importer, lu
from glbench.kernel.compiled.emit import Emitter, function_text, stored_inputs
from glbench.kernel.compiled.graph import Graph, Level
from glbench.kernel.compiled.regroup import regroup


@dataclass(frozen=True)
class GeneratedModel:
    """C++ header of one model, and what it is made of (for reports)."""

    text: str
    operations: dict[str, int]


def generate(function: Any, zeros: Collection[int] = ()) -> GeneratedModel:
    """C++ functions of ``function`` (CasADi SX, arguments x, u, d, p): the right-hand side, its Jacobian, elimination.

    Raises
    ------
    ValueError
        When the function has an operation that the generator does not know.
    """
    graph, slopes = importer.read_function(function, ("x", "u", "d", "p"), zeros)
    graph, slopes = regroup(graph, slopes, lower_logistic=False)
    rows = derivative.jacobian(graph, slopes)
    entries = [(i, j) for i, row in enumerate(rows) for j in row]
    derivatives = [rows[i][j] for i, j in entries]
    count = len(slopes)
    # One graph for all functions: what the right-hand side and its Jacobian share is stored once.
    both, outputs = regroup(graph, slopes + derivatives, lower_logistic=True)
    plan = lu.eliminate([sorted(row) for row in rows])
    index = {entry: k for k, entry in enumerate(entries)}
    stored = stored_inputs(both, outputs)
    place = {number: k for k, number in enumerate(stored)}

    def state_level(number: int) -> str | None:
        node = both.nodes[number]
        if node.op == "input" and node.source == "x":
            return f"x[{node.index}]"
        return f"c[{place[number]}]" if number in place else None

    def input_level(number: int) -> str | None:
        node = both.nodes[number]
        return f"{node.source}[{node.index}]" if node.op == "input" else None

    slope_stores = {f"f[{i}]": number for i, number in enumerate(outputs[:count])}
    jacobian_stores = {f"jac[{k}]": number for k, number in enumerate(outputs[count:])}
    sizes = {
        "STATES": count,
        "CONTROLS": int(function.numel_in(1)),
        "DISTURBANCES": int(function.numel_in(2)),
        "STORED": len(stored),
        "NONZEROS": len(entries),
        "FACTORS": plan.stored,
    }
    parts = [
        "#pragma once\n#include \"many.hpp\"\n#define K(a) broadcast<V>(a)\nnamespace glb {\nnamespace model {\n",
        "".join(f"constexpr int {name} = {value};\n" for name, value in sizes.items()),
        "// Everything that depends on parameters, controls and disturbances only.\n",
        "inline void prepare(const double* p, const double* u, const double* d, double* c) {\n    using V = double;\n",
        _body(both, stored, input_level, {f"c[{k}]": number for k, number in enumerate(stored)}),
        "// Time derivatives of the states.\n",
        function_text("void rhs(const V* x, const V* c, V* f)", Emitter(both, outputs[:count], state_level), slope_stores),
        "// The same with the structural nonzeros of the Jacobian.\n",
        function_text(
            "void rhs_and_jacobian(const V* x, const V* c, V* f, V* jac)",
            Emitter(both, outputs, state_level),
            slope_stores | jacobian_stores,
        ),
        lu.factorise_text(plan, index),
        lu.solve_text(plan),
        "}  // namespace model\n}  // namespace glb\n#undef K\n",
    ]
    return GeneratedModel("".join(parts), sizes | _operations(both, outputs[:count]))


def _body(graph: Graph, outputs: list[int], names: Any, stores: dict[str, int]) -> str:
    emitter = Emitter(graph, outputs, names)
    lines = [f"{target} = {emitter.value(number)};" for target, number in stores.items()]
    return "    " + "\n    ".join(emitter.lines + lines) + "\n}\n"


def _operations(graph: Graph, slopes: list[int]) -> dict[str, int]:
    """Counts of the operations of one right-hand side that depend on the state."""
    counts: dict[str, int] = {}
    for number in graph.needed(slopes):
        op = graph.nodes[number].op
        if graph.levels[number] == Level.STATE and op != "input":
            counts[op] = counts.get(op, 0) + 1
    return counts
