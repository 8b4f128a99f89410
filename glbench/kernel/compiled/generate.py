"""The model as C++ text: from ``glbench.model`` through graph, regrouping, differentiation and elimination.

Two states need no integration: a clock, and whatever equipment that is not there would have done. A state with a constant
rate that no other rate reads is a *clock* here; its exact solution ``x + h rate`` is taken at the end of the step.
*Followers* are slow: they are held within the step like weather, behind which they stand in ``d``, and follow at its end
(native/followers.hpp). The others are called *moving* and are numbered anew in the generated code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from glbench.kernel.compiled import derivative, lu
from glbench.kernel.compiled.derivative import Gradient
from glbench.kernel.compiled.emit import function_in_two_orders, stored_inputs
from glbench.kernel.compiled.graph import Graph, Level, Source, read_function
from glbench.kernel.compiled.regroup import regroup, spell_out_logistic

INPUTS = ("x", "u", "d", "p")


@dataclass(frozen=True)
class Traits:
    """What is known of a model beyond its equations."""

    zeros: tuple[int, ...] = ()
    """Parameters that are zero in every row that the code will see (equipment that is not there)."""
    fast: tuple[int, ...] = ()
    """States that forget errors quickly; they come first in the generated code."""
    singular: tuple[int, int] | None = None
    """Two moving states whose difference the rates depend on like a root, if there are such."""
    followers: tuple[int, ...] = ()
    """States that are held within a step and follow at its end."""
    names: tuple[str, ...] = ()
    """Names of the states for messages, where there are followers."""


@dataclass(frozen=True)
class GeneratedModel:
    """C++ header of one model."""

    text: str
    """The header."""
    moving: tuple[int, ...]
    """The states that are integrated, in the order of the generated code."""
    operations: dict[str, int]
    """How often each operation occurs in one evaluation of the right-hand side, after hoisting."""


@dataclass(frozen=True)
class Followers:
    """Rates of the followers, regrouped."""

    graph: Graph
    rates: list[int]
    """``graph`` and ``rates``: their graph, in which ``("x", i)`` is a follower and ``("v", i)`` the mean rate of state i over the step,
    and their rates."""
    states: tuple[int, ...]
    drivers: list[int]
    """``states`` and ``drivers``: the followers, and the states whose rates they read."""
    reads: list[Source]
    """Elements of p, u and d that they read."""

    @property
    def places(self) -> dict[Source, Source]:
        """Where the generated code has the inputs: followers in x, mean rates in v, what they read in q."""
        places: dict[Source, Source] = {("x", state): ("x", k) for k, state in enumerate(self.states)}
        places |= {("v", state): ("v", k) for k, state in enumerate(self.drivers)}
        return places | {source: ("q", k) for k, source in enumerate(self.reads)}


@dataclass(frozen=True)
class Structure:
    """A model's graph after regrouping, and what follows from its Jacobian."""

    graph: Graph
    slopes: dict[int, int]
    """``graph`` and ``slopes``: the regrouped graph with its derivatives, and the time derivative of each state but followers."""
    rows: dict[int, Gradient]
    """Derivatives of each of these with respect to the state."""
    moving: list[int]
    clocks: list[int]
    """``moving`` and ``clocks``: states that are integrated, in the order of the generated code, and those that need not be."""
    plan: lu.Elimination
    """Elimination of the moving states' matrix."""
    followers: Followers | None
    """The others, if there are any."""

    @property
    def own(self) -> dict[int, int]:
        """Number of each moving state in the generated code."""
        return {state: k for k, state in enumerate(self.moving)}


def analyse(function: Any, traits: Traits) -> Structure:
    """Read, regroup and differentiate a model; arguments and errors as for ``generate``."""
    aliases = {("x", state): ("d", int(function.numel_in(2)) + k) for k, state in enumerate(traits.followers)}
    trace: dict[int, int] = {}
    graph, outputs = read_function(function, INPUTS, traits.zeros, aliases=aliases, trace=trace)
    followers = None
    if traits.followers:
        rates = {n: i for i, n in reversed([*enumerate(outputs)]) if graph.levels[n] == Level.STATE and i not in traits.followers}
        followers = _followers(function, traits, {k: ("v", rates[number]) for k, number in trace.items() if number in rates})
    others = [i for i in range(len(outputs)) if i not in traits.followers]
    graph, outputs = regroup(graph, [outputs[i] for i in others])
    slopes = dict(zip(others, outputs, strict=True))
    rows = dict(zip(others, derivative.jacobian(graph, outputs), strict=True))
    read = {j for row in rows.values() for j in row}
    integrated = [i for i, slope in slopes.items() if graph.levels[slope] == Level.STATE or i in read]
    moving = sorted(integrated, key=lambda state: (state not in traits.fast, state))
    if not moving:
        msg = "it has no state to integrate: each is a clock or a follower"
        raise ValueError(msg)
    clocks = [i for i in others if i not in moving]
    own = {state: k for k, state in enumerate(moving)}
    plan = lu.eliminate([sorted(own[j] for j in rows[i]) for i in moving])
    return Structure(graph, slopes, rows, moving, clocks, plan, followers)


def _followers(function: Any, traits: Traits, cuts: Mapping[int, Source]) -> Followers:
    """The rates of the followers, with the rates of other states cut off."""
    graph, outputs = read_function(function, INPUTS, traits.zeros, cuts=cuts)
    for follower in traits.followers:
        nodes = [graph.nodes[n] for n in graph.needed([outputs[follower]])]
        alien = next((node.index for node in nodes if node.source == "x" and node.index not in traits.followers), None)
        if alien is not None:
            name, other = (traits.names[i] if traits.names else f"state {i}" for i in (follower, alien))
            msg = (
                f"{name} is a follower, and its rate reads {other}, which is none. A follower may read followers, controls, disturbances, "
                f"parameters and the rates of other states. Add a state whose rate is what {name} needs of {other}; let it read that rate."
            )
            raise ValueError(msg)
    graph, rates = regroup(graph, [outputs[i] for i in traits.followers])
    sources = [(node.source, node.index) for node in (graph.nodes[n] for n in graph.needed(rates)) if node.op == "input"]
    drivers = sorted(index for source, index in sources if source == "v")
    return Followers(graph, rates, traits.followers, drivers, sorted(source for source in sources if source[0] in "pud"))


def generate(function: Any, traits: Traits | None = None) -> GeneratedModel:
    """C++ functions of ``function`` (CasADi SX, arguments x, u, d, p): the right-hand side, its Jacobian, elimination.

    Raises ``ValueError`` when the function has an operation that the generator does not know.

    Parameters
    ----------
    function
        ``glbench.model.build_rhs(...)``.
    traits
        What is known of the model beyond its equations.
    """
    traits = traits or Traits()
    model = analyse(function, traits)
    graph, slopes, rows, moving, clocks = model.graph, model.slopes, model.rows, model.moving, model.clocks
    entries = [(i, j) for i in moving for j in rows[i]]
    # One graph for all functions: what the right-hand side and its Jacobian share is stored once.
    results = [slopes[i] for i in moving] + [rows[i][j] for i, j in entries] + [slopes[i] for i in clocks]
    graph, outputs = spell_out_logistic(graph, results)
    at_state = outputs[: len(moving) + len(entries)]
    text = _Text(graph, moving, stored_inputs(graph, at_state))
    text.number_by_use([at_state[: len(moving)], at_state])
    own, plan = model.own, model.plan
    place, own_entries = lu.places(plan), [(own[i], own[j]) for i, j in entries]
    sizes = {
        "STATES": int(function.numel_in(0)),
        "CONTROLS": int(function.numel_in(1)),
        "DISTURBANCES": int(function.numel_in(2)),
        "PARAMETERS": int(function.numel_in(3)),
        "MOVING": len(moving),
        "FAST": sum(state in traits.fast for state in moving),
        "CLOCKS": len(clocks),
        "STORED": len(text.place),
        "NONZEROS": len(entries),
        "FACTORS": plan.stored,
        "ABSENT": len(traits.zeros),
    }
    lists = {"MOVING_STATE": moving, "CLOCK_STATE": clocks, "ABSENT_PARAMETER": sorted(traits.zeros)}
    lists["SINGULAR"] = [own[state] for state in traits.singular or moving[:1] * 2]
    parts = [
        '#pragma once\n#include "many.hpp"\n#define K(a) broadcast<V>(a)\nnamespace glb {\nnamespace model {\n',
        *(f"constexpr int {name} = {value};\n" for name, value in sizes.items()),
        *(f"constexpr int {name}[] = {{{', '.join(map(str, [*entries_, -1]))}}};\n" for name, entries_ in lists.items()),
        text.prepare(outputs[len(at_state) :]),
        text.slopes(at_state[: len(moving)]),
        text.slopes_and_jacobian(at_state, [place[entry] for entry in own_entries]),
        lu.factorise_text(plan, own_entries),
        lu.solve_text(plan),
        _followers_text(model.followers, own) if model.followers else "",
        "}  // namespace model\n}  // namespace glb\n#undef K\n",
    ]
    operations: dict[str, int] = {}
    for number in graph.needed(at_state[: len(moving)]):
        op = graph.nodes[number].op
        if graph.levels[number] == Level.STATE and op != "input":
            operations[op] = operations.get(op, 0) + 1
    return GeneratedModel("".join(parts), tuple(moving), sizes | operations)


def _followers_text(followers: Followers, own: dict[int, int]) -> str:
    """C++ of the followers' rates, in two parts: what is the same throughout a step, and the rest."""
    graph, rates = spell_out_logistic(followers.graph, followers.rates)
    place = {number: k for k, number in enumerate(stored_inputs(graph, rates))}
    places = followers.places

    def of_input(number: int) -> str | None:
        node = graph.nodes[number]
        return "{}[{}]".format(*places[node.source, node.index]) if node.op == "input" else None

    def of_state(number: int) -> str | None:
        return f"s[{place[number]}]" if number in place else of_input(number)

    lists = {"FOLLOWER_STATE": followers.states, "DRIVER": [own[state] for state in followers.drivers]}
    lists |= {f"READ_{key.upper()}": [index for source, index in followers.reads if source == key] for key in "dpu"}
    sizes = {"FOLLOWERS": len(rates), "DRIVERS": len(followers.drivers), "READS": len(followers.reads), "STORED_FOR_FOLLOWERS": len(place)}
    stores = {f"s[{k}]": number for number, k in place.items()}
    slopes = {f"f[{k}]": number for k, number in enumerate(rates)}
    return "".join(
        [
            "#define GLB_FOLLOWERS\n",
            *(f"constexpr int {name} = {value};\n" for name, value in sizes.items()),
            *(f"constexpr int {name}[] = {{{', '.join(map(str, [*entries, -1]))}}};\n" for name, entries in lists.items()),
            function_in_two_orders("void follower_inputs(const V* q, const V* v, V* s)", graph, stores, of_input),
            function_in_two_orders("void follower_rates(const V* x, const V* s, V* f)", graph, slopes, of_state),
        ]
    )


class _Text:
    """The functions that come from the graph; ``place`` says where each stored value stands."""

    def __init__(self, graph: Graph, moving: list[int], inputs: list[int]) -> None:
        self.graph = graph
        self.own = {state: k for k, state in enumerate(moving)}
        self.place = {number: k for k, number in enumerate(inputs)}

    def number_by_use(self, functions: list[list[int]]) -> None:
        """Gives the stored values the places in which the functions of these outputs read them: memory is read in sequence."""
        order: dict[int, None] = {}

        def name(number: int) -> str | None:
            if number in self.place:
                order.setdefault(number)
            return self._of_state(number)

        for outputs in functions:
            function_in_two_orders("", self.graph, {str(k): number for k, number in enumerate(outputs)}, name)
        self.place = {number: k for k, number in enumerate(order)}

    def _of_state(self, number: int) -> str | None:
        node = self.graph.nodes[number]
        if node.op == "input" and node.source == "x":
            return f"x[{self.own[node.index]}]"
        return f"c[{self.place[number]}]" if number in self.place else None

    def prepare(self, clock_rates: list[int]) -> str:
        """Everything that depends on parameters, controls and disturbances only, and the rates of the clocks."""
        stores = {f"c[{k}]": number for number, k in self.place.items()}
        stores |= {f"rate[{k}]": number for k, number in enumerate(clock_rates)}
        head = "void prepare(const double* p, const double* u, const double* d, double* c, double* rate)"

        def name(number: int) -> str | None:
            node = self.graph.nodes[number]
            return f"{node.source}[{node.index}]" if node.op == "input" else None

        return function_in_two_orders(head, self.graph, stores, name)

    def slopes(self, outputs: list[int]) -> str:
        """Time derivatives of the moving states."""
        stores = {f"f[{k}]": number for k, number in enumerate(outputs)}
        return function_in_two_orders("void rhs(const V* x, const V* c, V* f)", self.graph, stores, self._of_state)

    def slopes_and_jacobian(self, outputs: list[int], places: list[int]) -> str:
        """The same with the structural nonzeros of the Jacobian, which are stored where their factors will stand."""
        count = len(self.own)
        stores = {f"f[{k}]": number for k, number in enumerate(outputs[:count])}
        stores |= {f"jac[{k}]": number for k, number in zip(places, outputs[count:], strict=True)}
        head = "void rhs_and_jacobian(const V* x, const V* c, V* f, V* jac)"
        return function_in_two_orders(head, self.graph, stores, self._of_state)
