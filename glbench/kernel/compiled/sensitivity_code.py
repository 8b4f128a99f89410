"""C++ text of the model's derivatives, from which native/sensitivity.hpp makes those of a control step.

The rates depend on the moving states x and on what is computed once a step from parameters, controls and weather, here called
the *inputs* c(p, u, d). Written are

- ``derivatives``: the structural nonzeros of df/dx and df/dc at a point;
- ``curvature``: the derivatives of both along a direction k of the state. As second derivatives are symmetric, the first is also
  the derivative of J(x) k with respect to x, the second that with respect to c: what differentiating the matrix of a Rosenbrock
  substep takes;
- products with these matrices and their transposes;
- the linear algebra of a substep's derivatives: factors of W, substitutions for many right-hand sides, transposed ones. By the plan of
  lu.py, but with factors of its own, so that those of the step may be laid out for the step's speed alone;
- ``inputs`` with its forward and reverse derivatives, and those of the followers' rates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from types import MappingProxyType
from typing import Any

from glbench.kernel.compiled import derivative
from glbench.kernel.compiled.emit import Emitter, stored_inputs
from glbench.kernel.compiled.generate import Followers, Structure, Traits, analyse
from glbench.kernel.compiled.graph import Graph, Node, Source
from glbench.kernel.compiled.lu import Elimination
from glbench.kernel.compiled.regroup import spell_out_logistic


def substitution_text(plan: Elimination, entries: Sequence[tuple[int, int]]) -> str:
    """All of them, for a Jacobian with those structural nonzeros."""
    factors = [(i, j) for i in plan.order for j in (*plan.lower[i], *plan.upper[i], i)]
    place = {entry: k for k, entry in enumerate(factors)}
    return "".join(
        [
            f"constexpr int OWN_FACTORS = {len(place)};\n",
            _factors_text(plan, place, {entry: k for k, entry in enumerate(entries)}),
            _directions_text(plan, place),
            _transposed_text(plan, place),
        ]
    )


def _factors_text(plan: Elimination, place: dict[tuple[int, int], int], entries: dict[tuple[int, int], int]) -> str:
    """``own_factors(jac, s, lu)`` of W = s I - J: the negated multipliers, the upper triangle of -W, the reciprocal pivots of W."""
    lines = []
    for i in plan.order:
        for j in (*plan.lower[i], *plan.upper[i], i):
            text = f"jac[{entries[i, j]} * Stride]" if (i, j) in entries else "0.0"
            for k in plan.lower[i]:
                if j in plan.upper[k]:
                    text = f"__builtin_fma(lu[{place[i, k]}], lu[{place[k, j]}], {text})"
            if j in plan.lower[i]:
                text = f"({text}) * lu[{place[j, j]}]"
            elif j == i:
                text = f"1.0 / (s - {text})"
            lines.append(f"lu[{place[i, j]}] = {text};")
    return _function("template <int Stride> void own_factors(const double* jac, const double s, double* lu)", lines)


def _directions_text(plan: Elimination, place: dict[tuple[int, int], int]) -> str:
    """``solve_directions(lu, b, k)``: right-hand sides in the lanes of V."""
    lines = []
    for i in plan.order:
        text = f"b[{i}]"
        for j in plan.lower[i]:
            text = f"fma<V>(broadcast<V>(lu[{place[i, j]}]), y{j}, {text})"
        lines.append(f"const V y{i} = {text};")
    for i in reversed(plan.order):
        text = f"y{i}"
        for j in reversed(plan.upper[i]):
            text = f"fma<V>(broadcast<V>(lu[{place[i, j]}]), k{j}, {text})"
        lines.append(f"const V k{i} = {text} * broadcast<V>(lu[{place[i, i]}]); k[{i}] = k{i};")
    return _function("template <class V> void solve_directions(const double* lu, const V* b, V* k)", lines)


def _transposed_text(plan: Elimination, place: dict[tuple[int, int], int]) -> str:
    """``solve_transposed(lu, b, s)``: one right-hand side for the transposed matrix."""
    lines = []
    for j in plan.order:
        text = f"b[{j}]"
        for i in plan.order:
            if j in plan.upper[i]:
                text = f"__builtin_fma(lu[{place[i, j]}], z{i}, {text})"
        lines.append(f"const double z{j} = {text} * lu[{place[j, j]}];")
    for j in reversed(plan.order):
        text = f"z{j}"
        for i in reversed(plan.order):
            if j in plan.lower[i]:
                text = f"__builtin_fma(lu[{place[i, j]}], s{i}, {text})"
        lines.append(f"const double s{j} = {text}; s[{j}] = s{j};")
    return _function("inline void solve_transposed(const double* lu, const double* b, double* s)", lines)


def _function(head: str, lines: list[str]) -> str:
    body = "\n    ".join(lines)
    return f"{head} {{\n    {body}\n}}\n"


Entries = list[tuple[int, int]]

_HELPERS = """
template <class V, class A> GLB_INLINE V in_lanes(A a) {
    if constexpr (width_of<A> == 1) return broadcast<V>(a);
    else return a;
}
template <class V, int... I> GLB_INLINE void add_multiples(const double* m, V v, V* a, std::integer_sequence<int, I...>) {
    ((a[I] = fma<V>(broadcast<V>(m[I]), v, a[I])), ...);
}
"""


def generate_sensitivities(function: Any, traits: Traits | None = None) -> str:
    """Header to be included after that of ``generate`` for the same function and traits; arguments and errors as there."""
    model = analyse(function, traits or Traits())
    slopes = [model.slopes[i] for i in model.moving]
    inputs = stored_inputs(model.graph, slopes)
    parts = [
        '#pragma once\n#include "model.hpp"\n#define K(a) broadcast<V>(a)\nnamespace glb {\nnamespace model {\n',
        f"constexpr int INPUTS = {len(inputs)};\n",
        _HELPERS,
        _rates_text(model, slopes, inputs),
        _inputs_text(model, inputs, function),
        _followers_text(model.followers) if model.followers else "",
        "}  // namespace model\n}  // namespace glb\n#undef K\n",
    ]
    return "".join(parts)


# -- rates as a function of x and c ------------------------------------------------------------------------------------
def _rates_text(model: Structure, slopes: list[int], inputs: list[int]) -> str:
    own = model.own
    graph, rates = _cut(model.graph, slopes, inputs)
    by_state = derivative.jacobian(graph, rates, "x", guarded=True)
    by_input = derivative.jacobian(graph, rates, "c", guarded=True)
    state_nodes = [node for row in by_state for node in row.values()]
    input_nodes = [node for row in by_input for node in row.values()]
    state_entries = [(i, own[j]) for i, row in enumerate(by_state) for j in row]
    input_entries = [(i, j) for i, row in enumerate(by_input) for j in row]

    def along(node: Node) -> int | None:
        return graph.source("k", node.index) if node.source == "x" else None

    bends = derivative.directional(graph, state_nodes + input_nodes, along)
    curved = [k for k in range(len(state_nodes)) if not graph.is_constant(bends[k], 0.0)]
    results = state_nodes + input_nodes + [bends[k] for k in curved] + bends[len(state_nodes) :]
    graph, results = spell_out_logistic(graph, results)
    first, second = results[: len(bends)], results[len(bends) :]
    place = {number: k for k, number in enumerate(stored_inputs(graph, results))}

    def name(number: int) -> str | None:
        node = graph.nodes[number]
        if node.op == "input" and node.source in ("x", "k"):
            return f"{node.source}[{own[node.index]}]"
        return f"s[{place[number]}]" if number in place else None

    states, count = len(state_nodes), len(input_nodes)
    derivatives = _targets("by_state", first[:states]) | _targets("by_input", first[states:])
    curvature = _targets("bend", second[: len(curved)])
    curvature |= {f"by_input[{k}] = by_input[{k}] +": node for k, node in enumerate(second[len(curved) :])}
    heads = (
        "void stored_inputs(const V* c, V* s)",
        "void derivatives(const V* x, const V* s, V* by_state, V* by_input)",
        "void curvature(const V* x, const V* k, const V* s, V* bend, V* by_input)",
    )
    parts = [
        f"constexpr int STORED_INPUTS = {len(place)};\nconstexpr int STATE_ENTRIES = {states};\n",
        f"constexpr int INPUT_ENTRIES = {count};\nconstexpr int BEND_ENTRIES = {len(curved)};\n",
        _function_text(heads[0], graph, _named("c", graph), _targets("s", list(place))),
        _function_text(heads[1], graph, name, derivatives),
        _function_text(heads[2], graph, name, curvature),
    ]
    patterns = {"state": state_entries, "input": input_entries, "bend": [state_entries[k] for k in curved]}
    for label, entries in patterns.items():
        parts += [_product_text(label, entries), _product_text(f"{label}_transposed", [(j, i) for i, j in entries])]
    parts += [_products_text(label, patterns[label]) for label in ("bend", "input")]
    parts.append(substitution_text(model.plan, state_entries))
    return "".join(parts)


def _cut(
    graph: Graph, outputs: list[int], inputs: Sequence[int], aliases: Mapping[Source, Source] = MappingProxyType({})
) -> tuple[Graph, list[int]]:
    """A new graph in which ``inputs`` are the elements of the input "c", and those with ``aliases`` are called by these."""
    new = Graph()
    numbers = {number: new.source("c", k) for k, number in enumerate(inputs)}
    for number in graph.needed(outputs):
        node = graph.nodes[number]
        if number in numbers:
            continue
        if node.op == "const":
            numbers[number] = new.constant(node.value)
        elif node.op == "input":
            numbers[number] = new.source(*aliases.get((node.source, node.index), (node.source, node.index)))
        elif all(a in numbers for a in node.args):  # else it only leads to one of the inputs
            numbers[number] = new.make(node.op, *(numbers[a] for a in node.args))
    return new, [numbers[number] for number in outputs]


def _product_text(label: str, entries: Entries) -> str:
    """C++ function that adds M v to ``sum``; entry e of M is ``m[e * Stride]``.

    Either the matrix is one and the vectors have lanes, or the matrices have lanes and the vector is one.
    """
    lines = []
    for row in sorted({i for i, _ in entries}):
        terms = [(e, j) for e, (i, j) in enumerate(entries) if i == row]
        steps = [f"a = fma<V>(in_lanes<V>(m[{e} * Stride]), in_lanes<V>(v[{j}]), a);" for e, j in terms]
        lines.append(f"{{ V a = sum[{row}]; {' '.join(steps)} sum[{row}] = a; }}")
    body = "\n    ".join(lines)
    head = f"template <int Stride, class V, class M, class X> void add_{label}_product(const M* m, const X* v, V* sum)"
    return f"{head} {{\n    {body}\n}}\n"


def _products_text(label: str, entries: Entries) -> str:
    """C++ function that adds M_i v to ``sum[i]`` for ``Count`` matrices in the lanes of M; the vector has lanes of its own."""
    lines = ["constexpr auto all = std::make_integer_sequence<int, Count>{};"]
    for row in sorted({i for i, _ in entries}):
        terms = [(e, j) for e, (i, j) in enumerate(entries) if i == row]
        steps = [f"add_multiples<V>(m + {e} * Stride, v[{j}], a, all);" for e, j in terms]
        before, after = f"a[i] = sum[i][{row}];", f"sum[i][{row}] = a[i];"
        loop = "for (int i = 0; i < Count; ++i)"
        lines.append(f"{{ V a[Count]; {loop} {before} {' '.join(steps)} {loop} {after} }}")
    body = "\n    ".join(lines)
    head = f"template <int Stride, int Count, class V, class S> void add_{label}_products(const double* m, const V* v, S* sum)"
    return f"{head} {{\n    {body}\n}}\n"


# -- inputs as a function of p, u and d ----------------------------------------------------------------------------------
def _inputs_text(model: Structure, inputs: list[int], function: Any) -> str:
    followers = 0 if model.followers is None else len(model.followers.states)
    sizes = {"p": int(function.numel_in(3)), "u": int(function.numel_in(1)), "d": int(function.numel_in(2)) + followers}
    return _both_ways("inputs", model.graph, sizes, {"c": inputs, "rate": [model.slopes[i] for i in model.clocks]})


def _both_ways(label: str, graph: Graph, sizes: Mapping[str, int], results: Mapping[str, list[int]]) -> str:
    """C++ of the first of ``results`` as a function of inputs of those sizes, and of the forward and reverse derivatives of all."""
    outputs = list(chain.from_iterable(results.values()))

    def tangent(node: Node) -> int | None:
        return graph.source(f"d{node.source}", node.index) if node.source in sizes else None

    tangents = derivative.directional(graph, outputs, tangent)
    seeds = [graph.source(f"{key}b", k) for key, nodes in results.items() for k in range(len(nodes))]
    adjoints = derivative.reverse(graph, outputs, seeds)
    places = [(source, index) for source, size in sizes.items() for index in range(size)]
    zero = graph.constant(0.0)
    backward = [adjoints.get(place, zero) for place in places]
    graph, nodes = spell_out_logistic(graph, outputs + tangents + backward)
    count, (first, *_) = len(outputs), results
    values, forward, backward = nodes[: len(results[first])], iter(nodes[count : 2 * count]), nodes[2 * count :]
    name = _named("", graph)

    def arrays(pattern: str, keys: Iterable[str]) -> str:
        return ", ".join(pattern.format(key) for key in keys)

    point, cotangents = arrays("const V* {}", sizes), arrays("const V* {}b", results)
    along = {f"d{key}[{k}]": next(forward) for key, nodes in results.items() for k in range(len(nodes))}
    targets = {f"{source}b[{index}]": node for (source, index), node in zip(places, backward, strict=True)}
    changes, effects = arrays("const V* d{}", sizes), arrays("V* d{}", results)
    return "".join(
        [
            _function_text(f"void {label}({point}, V* {first})", graph, name, _targets(first, values)),
            _function_text(f"void {label}_forward({point}, {changes}, {effects})", graph, name, along),
            _function_text(f"void {label}_reverse({point}, {cotangents}, {arrays('V* {}b', sizes)})", graph, name, targets),
        ]
    )


# -- followers ---------------------------------------------------------------------------------------------------------
def _followers_text(followers: Followers) -> str:
    """What is the same throughout a step as a function of q and v, and the rates as a function of that and of x."""
    inputs = stored_inputs(followers.graph, followers.rates)
    once, values = _cut(followers.graph, inputs, (), followers.places)
    rest, rates = _cut(followers.graph, followers.rates, inputs, followers.places)
    return "".join(
        [
            f"constexpr int HELD_FOR_FOLLOWERS = {len(inputs)};\n",
            _both_ways("follower_held", once, {"q": len(followers.reads), "v": len(followers.drivers)}, {"c": values}),
            _both_ways("follower_slopes", rest, {"x": len(rates), "c": len(inputs)}, {"f": rates}),
        ]
    )


# -- text --------------------------------------------------------------------------------------------------------------
def _targets(array: str, nodes: Sequence[int]) -> dict[str, int]:
    return {f"{array}[{k}]": node for k, node in enumerate(nodes)}


def _named(only: str, graph: Graph) -> Callable[[int], str | None]:
    """Names of inputs by their source; of one source only, if it is given."""

    def name(number: int) -> str | None:
        node = graph.nodes[number]
        return f"{node.source}[{node.index}]" if node.op == "input" and only in ("", node.source) else None

    return name


def _function_text(head: str, graph: Graph, name: Callable[[int], str | None], stores: Mapping[str, int]) -> str:
    """A function that stores every value as soon as it is there: hundreds of results do not fit the registers.

    A target that ends in "+" is the beginning of an assignment that adds the value.
    """
    emitter = Emitter(graph, list(stores.values()), name)
    for target, number in stores.items():
        value = emitter.value(number)
        emitter.lines.append(f"{target} {value};" if target.endswith("+") else f"{target} = {value};")
    body = "\n    ".join(emitter.lines)
    return f"template <class V> {head} {{\n    {body}\n}}\n"
