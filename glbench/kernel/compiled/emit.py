"""Writes C++ functions from the graph.

Every function is straight-line code over a value type ``V`` (see native/lanes.hpp). Products that nobody else reads are
fused with the addition or subtraction that uses them; which ones is decided here, never by the compiler. Slow
operations that do not depend on one another are written as one call (``many_exp(a, b, c)``): with one lane they share the
vector unit, with many lanes they are just a sequence, and the results are the same.

With many lanes every value takes a whole vector register, of which there are 32 at best, so an order is good when values
are used soon after they were computed; but a statement whose operands are not ready stalls the processor, which looks
only some hundred instructions ahead. The order here completes one output after the other, the cheapest next one first, and
then lets statements whose operands are ready overtake those that would wait, within a short window.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from glbench.kernel.compiled.graph import CONDITIONS, Graph, Level

WINDOW = 96
"""How many statements may be overtaken."""


@dataclass(frozen=True)
class Cost:
    """Cycles that a statement occupies the multiplier, and cycles until its result can be used."""

    occupied: float
    latency: float


_FAST = Cost(1.0, 4.0)
_COSTS = {
    "exp16": Cost(10.0, 55.0),
    "exp16_limited": Cost(9.0, 52.0),
    "pow16_root": Cost(19.0, 100.0),
    "pow_positive": Cost(20.0, 105.0),
    "pow": Cost(22.0, 110.0),
    "log": Cost(20.0, 80.0),
    "tanh": Cost(50.0, 150.0),
    "cos": Cost(30.0, 80.0),
    "inv": Cost(3.0, 14.0),
    "sqrt": Cost(3.0, 22.0),
}


def cost_of(kind: str) -> Cost:
    """Cost of a statement of that kind , measured for vectors of 512 bits on Zen 4; others are similar."""
    return _COSTS.get(kind, _FAST)


def order(reads: Mapping[int, Sequence[int]], kinds: Mapping[int, str], outputs: Sequence[int]) -> list[int]:
    """The statements that ``outputs`` need, each after those that it reads.

    Parameters
    ----------
    reads
        For each statement those that it reads.
    kinds
        What each statement does.
    outputs
        The statements that are stored.
    """
    sequence: dict[int, None] = {}
    remaining = list(dict.fromkeys(outputs))
    while remaining:
        costs = {output: _cost_of_missing(output, reads, kinds, sequence) for output in remaining}
        cheapest = min(remaining, key=lambda output: costs[output])
        remaining.remove(cheapest)
        # It comes after everything that it needs, of which the most expensive comes first.
        stack = [(cheapest, False)]
        while stack:
            number, ready = stack.pop()
            if number in sequence:
                continue
            if ready:
                sequence[number] = None
                continue
            stack.append((number, True))
            operands = [n for n in dict.fromkeys(reads[number]) if n not in sequence]
            size = {n: _cost_of_missing(n, reads, kinds, sequence) for n in operands}
            stack.extend((n, False) for n in sorted(operands, key=lambda n: size[n]))
    return _overtake(sequence, reads, kinds)


def _cost_of_missing(output: int, reads: Mapping[int, Sequence[int]], kinds: Mapping[int, str], sequence: Mapping[int, None]) -> float:
    """Cost of what a statement needs, itself included, and what is not in the sequence yet."""
    missing: set[int] = set()
    stack = [output]
    while stack:
        number = stack.pop()
        if number not in missing and number not in sequence:
            missing.add(number)
            stack.extend(reads[number])
    return sum(cost_of(kinds[n]).occupied for n in missing)


def _overtake(sequence: Iterable[int], reads: Mapping[int, Sequence[int]], kinds: Mapping[int, str]) -> list[int]:
    waiting = list(sequence)
    ready_at: dict[int, float] = {}
    now = 0.0
    result: list[int] = []
    while waiting:
        best, best_start = 0, float("inf")
        for place, number in enumerate(waiting[:WINDOW]):
            if any(n not in ready_at for n in reads[number]):
                continue
            start = max((ready_at[n] for n in reads[number]), default=0.0)
            if start < best_start:
                best, best_start = place, start
            if start <= now:
                best = place
                break
        number = waiting.pop(best)
        cost = cost_of(kinds[number])
        now = max(now, max((ready_at[n] for n in reads[number]), default=0.0))
        ready_at[number] = now + cost.latency
        now += cost.occupied
        result.append(number)
    return result


# Slow operations, packed in groups; "pow_positive" is pow with a base that cannot be zero or negative, "exp16_limited" is
# exp16 with an argument that cannot overflow.
_SLOW = frozenset({"exp16", "exp16_limited", "log", "pow", "pow_positive", "pow16_root", "inv", "sqrt", "tanh"})
_POWERS = frozenset({"pow", "pow_positive", "pow16_root"})
_FUNCTIONS = {"pow_positive": "pow_of_positive", "pow16_root": "pow16_of_root", "exp16_limited": "exp16_of_limited"}
_LARGEST_GROUP = 8
_LARGEST_EXPONENT = 16_000.0


class Emitter:
    """Code of one function that computes ``outputs`` of ``graph``.

    Parameters
    ----------
    graph, outputs
        What to compute.
    name_of_input
        C++ expression of a node that need not be computed (an input, a stored value), or None.
    """

    def __init__(self, graph: Graph, outputs: Sequence[int], name_of_input: Callable[[int], str | None], *, packed: bool = True) -> None:
        self.graph = graph
        self.lines: list[str] = []
        self.reads: dict[int, list[int]] = {}
        self._names: dict[int, str] = {}
        self._open: list[int] = []  # statements being written
        self._name_of_input = name_of_input
        self._uses = self._count_uses(outputs)
        if packed:
            self._emit_slow_groups(outputs)

    # -- what is needed --------------------------------------------------------------------------------------------
    def _count_uses(self, outputs: Sequence[int]) -> dict[int, int]:
        uses: dict[int, int] = {}
        visited: set[int] = set()
        stack = list(outputs)
        for number in outputs:
            uses[number] = uses.get(number, 0) + 1
        while stack:
            number = stack.pop()
            if number in visited or self._name_without_code(number) is not None:
                continue
            visited.add(number)
            for argument in self.graph.nodes[number].args:
                uses[argument] = uses.get(argument, 0) + 1
                stack.append(argument)
        return uses

    def _name_without_code(self, number: int) -> str | None:
        node = self.graph.nodes[number]
        if node.op != "const":
            return self._name_of_input(number)
        value = node.value  # exact to the bit
        if math.isfinite(value):
            return f"K({value.hex()})"
        return 'K(__builtin_nan(""))' if math.isnan(value) else f"K({'-' if value < 0.0 else ''}__builtin_inf())"

    def kind(self, number: int) -> str:
        """What the statement of a node does: its operation, or the form of a slow one."""
        node = self.graph.nodes[number]
        if node.op == "pow" and self.graph.is_positive(node.args[0]):
            return "pow_positive"
        if node.op == "pow16":
            return "pow16_root"
        if node.op == "exp16":
            argument = self.graph.nodes[node.args[0]]
            constants = [a for a in argument.args if argument.op == "min" and self.graph.is_constant(a)]
            if any(self.graph.value(a) <= _LARGEST_EXPONENT for a in constants):  # exp can take it
                return "exp16_limited"
        return node.op

    # -- order -----------------------------------------------------------------------------------------------------
    def _emit_slow_groups(self, outputs: Sequence[int]) -> None:
        """Emits the slow operations by rounds: those of one round do not depend on one another."""
        rounds: dict[int, int] = {}
        by_round: dict[tuple[int, str], list[int]] = {}
        for number in self.graph.needed(outputs):
            if number not in self._uses or self._name_without_code(number) is not None:
                continue
            node = self.graph.nodes[number]
            before = max((rounds.get(a, 0) for a in node.args), default=0)
            kind = self.kind(number)
            if kind in _SLOW:
                by_round.setdefault((before, kind), []).append(number)
                before += 1
            rounds[number] = before
        for (_, kind), numbers in sorted(by_round.items()):
            for start in range(0, len(numbers), _LARGEST_GROUP):
                members = numbers[start : start + _LARGEST_GROUP]
                places = (0, 1) if kind in _POWERS else (0,)
                arguments = [self.value(self.graph.nodes[n].args[place]) for place in places for n in members]
                group = f"g{members[0]}"
                self.lines.append(f"const auto {group} = many_{kind}<V>({', '.join(arguments)});")
                for k, number in enumerate(members):
                    self._names[number] = f"{group}.v[{k}]"

    # -- values ----------------------------------------------------------------------------------------------------
    def value(self, number: int) -> str:
        """C++ expression of a node's value, after emitting whatever it needs."""
        name = self._names.get(number)
        if name is None:
            name = self._name_without_code(number)
            if name is None:
                node = self.graph.nodes[number]
                if node.op in CONDITIONS:
                    name = f"select<V>({self._condition(number)}, K(1.0), K(0.0))"
                else:
                    name = f"v{number}"
                    self.reads[number] = []
                    self._open.append(number)
                    text = self._expression(number)
                    self._open.pop()
                    self.lines.append(f"const V {name} = {text};")
            self._names[number] = name
        if self._open and number in self.reads:
            self.reads[self._open[-1]].append(number)
        return name

    def _alone(self, number: int) -> bool:
        """A product that only its one reader needs, so that it can be fused."""
        return self.graph.nodes[number].op == "mul" and self._uses[number] == 1 and self._name_without_code(number) is None

    def _fused(self, function: str, product: int, other: int) -> str:
        a, b = self.graph.nodes[product].args
        return f"{function}<V>({self.value(a)}, {self.value(b)}, {self.value(other)})"

    def _expression(self, number: int) -> str:
        node = self.graph.nodes[number]
        if node.op == "select":
            condition, yes, no = node.args
            return f"select<V>({self._condition(condition)}, {self.value(yes)}, {self.value(no)})"
        a = node.args[0]
        b = node.args[-1]
        if node.op == "add":
            if self._alone(b):
                return self._fused("fma", b, a)
            return self._fused("fma", a, b) if self._alone(a) else f"{self.value(a)} + {self.value(b)}"
        if node.op == "sub":
            if self._alone(b):
                return self._fused("fnma", b, a)
            return self._fused("fms", a, b) if self._alone(a) else f"{self.value(a)} - {self.value(b)}"
        if node.op == "mul":
            return f"{self.value(a)} * {self.value(b)}"
        if node.op == "neg":
            return f"-{self.value(a)}"
        if node.op in ("min", "max"):
            return f"{node.op}_of<V>({self.value(a)}, {self.value(b)})"
        arguments = ", ".join(self.value(argument) for argument in node.args)
        return f"{_FUNCTIONS.get(self.kind(number), node.op + '_of')}<V>({arguments})"

    def _condition(self, number: int) -> str:
        node = self.graph.nodes[number]
        if self._name_without_code(number) is not None or node.op not in CONDITIONS:
            return f"({self.value(number)} != K(0.0))"
        if node.op == "not":
            return f"not_of<V>({self._condition(node.args[0])})"
        if node.op in ("and", "or"):
            sign = "&" if node.op == "and" else "|"
            return f"({self._condition(node.args[0])} {sign} {self._condition(node.args[1])})"
        sign = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}[node.op]
        return f"({self.value(node.args[0])} {sign} {self.value(node.args[1])})"


def function_in_two_orders(head: str, graph: Graph, stores: Mapping[str, int], name_of_input: Callable[[int], str | None]) -> str:
    """A C++ function template that computes and stores ``stores`` (left-hand side: node), with two bodies of the same statements.

    One lane packs slow operations; many lanes need an order in which few values are alive at a time, see ``order``.
    """
    packed = Emitter(graph, list(stores.values()), name_of_input)
    body = [f"{target} = {packed.value(number)};" for target, number in stores.items()]
    one = "\n        ".join(packed.lines + body)
    many = "\n        ".join(_in_order(graph, stores, name_of_input))
    return (
        f"template <class V> {head} {{\n    if constexpr (width_of<V> == 1) {{\n        {one}\n    }} else {{\n        {many}\n    }}\n}}\n"
    )


def _in_order(graph: Graph, stores: Mapping[str, int], name_of_input: Callable[[int], str | None]) -> list[str]:
    outputs = list(stores.values())
    trial = Emitter(graph, outputs, name_of_input, packed=False)
    for number in outputs:
        trial.value(number)
    kinds = {number: trial.kind(number) for number in trial.reads}
    targets: dict[int, list[str]] = {}
    for target, number in stores.items():
        targets.setdefault(number, []).append(target)
    emitter = Emitter(graph, outputs, name_of_input, packed=False)
    for number in order(trial.reads, kinds, [n for n in outputs if n in kinds]):
        value = emitter.value(number)
        emitter.lines += [f"{target} = {value};" for target in targets.pop(number, ())]
    for number, names in targets.items():
        emitter.lines += [f"{target} = {emitter.value(number)};" for target in names]
    return emitter.lines


def stored_inputs(graph: Graph, outputs: Sequence[int]) -> list[int]:
    """Nodes below the state's level that state-level code reads: to be computed once a step and stored."""
    inputs: set[int] = set()
    for number in graph.needed(outputs):
        node = graph.nodes[number]
        if graph.levels[number] == Level.STATE:
            inputs.update(a for a in node.args if graph.levels[a] == Level.INPUT)
    inputs.update(number for number in outputs if graph.levels[number] == Level.INPUT)
    return sorted(inputs)
