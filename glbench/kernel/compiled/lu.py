"""Sparse elimination without pivoting, worked out when code is generated.

Solved is ``W k = b`` with ``W = s I - J`` and ``s = 1/(gamma h)``. The model's Jacobian has a negative diagonal that
dominates its fast rows, so diagonal pivots in a fixed order are stable; a step that went wrong would show in the error
estimate. The order is chosen greedily for the least fill-in (Markowitz), ties by the lowest state.
"""

from __future__ import annotations

from collections.abc import Sequence
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
    while remaining:

        def cost(i: int) -> tuple[int, int]:
            column = sum(1 for r in remaining if i in rows[r])
            return (len(rows[i] & remaining) - 1) * (column - 1), i

        pivot = min(remaining, key=cost)
        remaining.discard(pivot)
        order.append(pivot)
        later = rows[pivot] & remaining
        for row in sorted(remaining):
            if pivot in rows[row]:
                lower[row].append(pivot)
                if row in later:
                    touched.add(row)
                rows[row] |= later
    place = {pivot: k for k, pivot in enumerate(order)}
    upper = [tuple(sorted((j for j in rows[i] if place[j] > place[i]), key=place.__getitem__)) for i in range(size)]
    return Elimination(tuple(order), tuple(map(tuple, lower)), tuple(upper), frozenset(set(range(size)) - touched))


def factorise_text(plan: Elimination, jacobian_index: dict[tuple[int, int], int]) -> str:
    """C++ function ``factorise(jac, s, gamma_h, lu)``.

    Stored are the negated multipliers m = -l, the entries u of the upper triangle of -W, and the reciprocal pivots of W:
    with these signs elimination and substitution are fused multiply-adds only.
    """
    place = _places(plan)
    lines = []
    for i in plan.order:
        for j in plan.lower[i]:
            terms = [k for k in plan.lower[i] if j in plan.upper[k]]
            lines += _entry(f"t{i}_{j}", i, j, [(f"m{i}_{k}", f"u{k}_{j}") for k in terms], jacobian_index)
            lines.append(f"const V m{i}_{j} = t{i}_{j} * r{j}; lu[{place[i, j]}] = m{i}_{j};")
        for j in plan.upper[i]:
            terms = [k for k in plan.lower[i] if j in plan.upper[k]]
            lines += _entry(f"u{i}_{j}", i, j, [(f"m{i}_{k}", f"u{k}_{j}") for k in terms], jacobian_index)
            lines.append(f"lu[{place[i, j]}] = u{i}_{j};")
        if i in plan.trivial:
            lines.append(f"const V r{i} = gamma_h; lu[{place[i, i]}] = r{i};")
        else:
            terms = [k for k in plan.lower[i] if i in plan.upper[k]]
            lines += _entry(f"d{i}", i, i, [(f"m{i}_{k}", f"u{k}_{i}") for k in terms], jacobian_index)
            lines.append(f"const V r{i} = inv_of<V>(s - d{i}); lu[{place[i, i]}] = r{i};")
    body = "\n    ".join(lines)
    return "template <class V> void factorise(const V* jac, const V s, const V gamma_h, V* lu) {\n    " + body + "\n}\n"


def solve_text(plan: Elimination) -> str:
    """C++ function ``solve<Two>(lu, a, b, k)``: forward and back substitution for ``a + b`` (or ``a`` alone)."""
    place = _places(plan)
    lines = []
    for i in plan.order:
        text = f"(Two ? a[{i}] + b[{i}] : a[{i}])"
        for j in plan.lower[i]:
            text = f"fma<V>(lu[{place[i, j]}], y{j}, {text})"
        lines.append(f"const V y{i} = {text};")
    for i in reversed(plan.order):
        text = f"y{i}"
        for j in reversed(plan.upper[i]):
            text = f"fma<V>(lu[{place[i, j]}], k{j}, {text})"
        lines.append(f"const V k{i} = {text} * lu[{place[i, i]}]; k[{i}] = k{i};")
    body = "\n    ".join(lines)
    return "template <bool Two, class V> void solve(const V* lu, const V* a, const V* b, V* k) {\n    " + body + "\n}\n"


def _entry(
    name: str, i: int, j: int, terms: list[tuple[str, str]], jacobian_index: dict[tuple[int, int], int]
) -> list[str]:
    """Lines that compute one entry of J plus the elimination's sum."""
    known = jacobian_index.get((i, j))
    text = f"jac[{known}]" if known is not None else ""
    for m, u in terms:
        text = f"fma<V>({m}, {u}, {text})" if text else f"{m} * {u}"
    return [f"const V {name} = {text};"]


def _places(plan: Elimination) -> dict[tuple[int, int], int]:
    """Where each value of the factors is stored, in the order of use."""
    entries = [(i, j) for i in plan.order for j in (*plan.lower[i], *plan.upper[i], i)]
    return {entry: k for k, entry in enumerate(entries)}
