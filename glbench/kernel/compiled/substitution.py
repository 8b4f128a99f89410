"""C++ text of the linear algebra of a substep's derivatives: factors of W, substitutions for many right-hand sides, transposed ones.

By the plan of lu.py, but with factors of its own, so that those of the step may be laid out for the step's speed alone.
"""

from __future__ import annotations

from collections.abc import Sequence

from glbench.kernel.compiled.lu import Elimination


def substitution_text(plan: Elimination, entries: Sequence[tuple[int, int]]) -> str:
    """All of them, for a Jacobian with those structural nonzeros."""
    place = {entry: k for k, entry in enumerate(_stored(plan))}
    return "".join(
        [
            f"constexpr int OWN_FACTORS = {len(place)};\n",
            _factors_text(plan, place, {entry: k for k, entry in enumerate(entries)}),
            _directions_text(plan, place),
            _transposed_text(plan, place),
        ]
    )


def _stored(plan: Elimination) -> list[tuple[int, int]]:
    return [(i, j) for i in plan.order for j in (*plan.lower[i], *plan.upper[i], i)]


def _factors_text(plan: Elimination, place: dict[tuple[int, int], int], known: dict[tuple[int, int], int]) -> str:
    """``own_factors(jac, s, lu)`` of W = s I - J: the negated multipliers, the upper triangle of -W, the reciprocal pivots of W."""
    lines = []
    for i in plan.order:
        for j in (*plan.lower[i], *plan.upper[i], i):
            text = f"jac[{known[i, j]} * Stride]" if (i, j) in known else "0.0"
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
