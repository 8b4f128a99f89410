"""Sparse elimination without pivoting, worked out when code is generated.

Solved is ``W k = b`` with ``W = s I - J`` and ``s = 1/(gamma h)``. The model's Jacobian has a negative diagonal that
dominates its fast rows, so diagonal pivots in a fixed order are stable; a step that went wrong would show in the error
estimate. The order is chosen greedily for the least fill-in (Markowitz), ties by the lowest state.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

Pattern = Sequence[Sequence[int]]  # for each row its columns


@dataclass(frozen=True)
class Elimination:
    """Order of the pivots and the filled pattern: for each row the columns before and after its pivot, in pivot order."""

    order: tuple[int, ...]
    lower: tuple[tuple[int, ...], ...]
    upper: tuple[tuple[int, ...], ...]
    trivial: frozenset[int]  # rows whose pivot is s itself

    @property
    def stored(self) -> int:
        """Number of values that the factors take: both triangles and the reciprocal pivots."""
        return sum(map(len, self.lower)) + sum(map(len, self.upper)) + len(self.order)


def eliminate(pattern: Pattern) -> Elimination:
    """Symbolic elimination of a square matrix with that pattern and a full diagonal."""
    size = len(pattern)
    rows = [{*columns, i} for i, columns in enumerate(pattern)]
    touched = {i for i, columns in enumerate(pattern) if i in columns}
    remaining = set(range(size))
    order: list[int] = []
    lower: list[list[int]] = [[] for _ in range(size)]
    depth = [0] * size  # pivots that have to be known one after the other before this one
    while remaining:

        def cost(i: int) -> tuple[int, int, int]:
            column = sum(1 for r in remaining if i in rows[r])
            return (len(rows[i] & remaining) - 1) * (column - 1), depth[i], i

        pivot = min(remaining, key=cost)
        remaining.discard(pivot)
        order.append(pivot)
        later = rows[pivot] & remaining
        for row in sorted(remaining):
            if pivot in rows[row]:
                lower[row].append(pivot)
                depth[row] = max(depth[row], depth[pivot] + 1)
                if row in later:
                    touched.add(row)
                rows[row] |= later
    place = {pivot: k for k, pivot in enumerate(order)}
    upper = [tuple(sorted((j for j in rows[i] if place[j] > place[i]), key=place.__getitem__)) for i in range(size)]
    return Elimination(tuple(order), tuple(map(tuple, lower)), tuple(upper), frozenset(set(range(size)) - touched))


def factorise_text(plan: Elimination, entries: Iterable[tuple[int, int]]) -> str:
    """C++ function ``factorise(jac, s, gamma_h, lu)`` for a Jacobian with those structural nonzeros; ``lu`` may be ``jac``.

    ``W = L D U`` with ones on the diagonals of L and U. Stored are the negated entries of L and U and the reciprocal
    pivots: with these signs elimination and substitution are fused multiply-adds only, and scaling the rows of U here
    shortens the chain of operations in each of the six substitutions. The Jacobian's entries stand where the factors will
    stand, see ``places``.
    """
    place = places(plan)
    nonzeros = set(entries)
    lines = []
    for i in plan.order:
        for j in plan.lower[i]:
            terms = [k for k in plan.lower[i] if j in plan.upper[k]]
            lines.append(_entry(f"t{i}_{j}", (i, j), [(f"m{i}_{k}", f"u{k}_{j}") for k in terms], nonzeros, place))
            lines.append(f"const V m{i}_{j} = t{i}_{j} * r{j}; lu[{place[i, j]}] = m{i}_{j};")
        if i in plan.trivial:
            lines.append(f"const V r{i} = gamma_h; lu[{place[i, i]}] = r{i};")
        else:
            terms = [k for k in plan.lower[i] if i in plan.upper[k]]
            lines.append(_entry(f"d{i}", (i, i), [(f"m{i}_{k}", f"u{k}_{i}") for k in terms], nonzeros, place))
            lines.append(f"const V r{i} = inv_of<V>(s - d{i}); lu[{place[i, i]}] = r{i};")
        for j in plan.upper[i]:
            terms = [k for k in plan.lower[i] if j in plan.upper[k]]
            lines.append(_entry(f"u{i}_{j}", (i, j), [(f"m{i}_{k}", f"u{k}_{j}") for k in terms], nonzeros, place))
            lines.append(f"lu[{place[i, j]}] = u{i}_{j} * r{i};")
    return _function("template <class V> void factorise(const V* jac, const V s, const V gamma_h, V* lu)", lines)


def solve_text(plan: Elimination) -> str:
    """C++ function ``solve<Two>(lu, a, b, k)``: forward and back substitution for ``a + b`` (or ``a`` alone)."""
    place = places(plan)
    ready: dict[int, int] = {}
    lines = []
    for i in plan.order:
        text = f"(Two ? a[{i}] + b[{i}] : a[{i}])"
        for j in sorted(plan.lower[i], key=ready.__getitem__):  # what is known last comes last
            text = f"fma<V>(lu[{place[i, j]}], y{j}, {text})"
        ready[i] = _ready(ready[j] for j in plan.lower[i])
        lines.append(f"const V y{i} = {text};")
    ready_k: dict[int, int] = {}
    for i in reversed(plan.order):
        text = f"y{i} * lu[{place[i, i]}]"
        for j in sorted(plan.upper[i], key=ready_k.__getitem__):
            text = f"fma<V>(lu[{place[i, j]}], k{j}, {text})"
        ready_k[i] = max(_ready(ready_k[j] for j in plan.upper[i]), ready[i] + 1)
        lines.append(f"const V k{i} = {text}; k[{i}] = k{i};")
    return _function("template <bool Two, class V> void solve(const V* lu, const V* a, const V* b, V* k)", lines)


def _ready(terms: Iterable[int]) -> int:
    """When a chain of multiply-adds is done, in multiply-adds, if its terms come in the order in which they are ready."""
    time = 0
    for term in sorted(terms):
        time = max(time, term) + 1
    return time


def _function(head: str, lines: list[str]) -> str:
    body = "\n    ".join(lines)
    return f"{head} {{\n    {body}\n}}\n"


def _entry(
    name: str, entry: tuple[int, int], terms: list[tuple[str, str]], nonzeros: set[tuple[int, int]], place: dict[tuple[int, int], int]
) -> str:
    """Line that computes one entry of J plus the elimination's sum."""
    text = f"jac[{place[entry]}]" if entry in nonzeros else ""
    for m, u in terms:
        text = f"fma<V>({m}, {u}, {text})" if text else f"{m} * {u}"
    return f"const V {name} = {text};"


def places(plan: Elimination) -> dict[tuple[int, int], int]:
    """Where each value of the factors is stored, in the order in which a substitution reads them."""
    entries = [(i, j) for i in plan.order for j in plan.lower[i]]
    entries += [(i, j) for i in reversed(plan.order) for j in (*reversed(plan.upper[i]), i)]
    return {entry: k for k, entry in enumerate(entries)}
