"""Order of the statements of a function for many lanes.

With many lanes every value takes a whole vector register, of which there are 32 at best, so an order is good when values
are used soon after they were computed; but a statement whose operands are not ready stalls the processor, which looks
only some hundred instructions ahead. The order here completes one output after the other, the cheapest next one first, and
then lets statements whose operands are ready overtake those that would wait, within a short window.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

WINDOW = 96
"""How many statements may be overtaken."""


@dataclass(frozen=True)
class Cost:
    """Cycles that a statement occupies the multiplier, and cycles until its result can be used."""

    occupied: float
    latency: float


_FAST = Cost(1.0, 4.0)
_SLOW = {
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
    """Cost of a statement of that kind (see ``emit``), measured for vectors of 512 bits on Zen 4; others are similar."""
    return _SLOW.get(kind, _FAST)


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
    return _overtake(_output_by_output(reads, kinds, outputs), reads, kinds)


def _output_by_output(
    reads: Mapping[int, Sequence[int]], kinds: Mapping[int, str], outputs: Sequence[int]
) -> list[int]:
    done: dict[int, None] = {}
    left = list(dict.fromkeys(outputs))
    while left:
        missing = {output: _missing(output, reads, done) for output in left}
        costs = {output: sum(cost_of(kinds[n]).occupied for n in missing[output]) for output in left}
        chosen = min(left, key=lambda output: costs[output])
        left.remove(chosen)
        _descend(chosen, reads, kinds, done)
    return list(done)


def _missing(output: int, reads: Mapping[int, Sequence[int]], done: Mapping[int, None]) -> set[int]:
    found: set[int] = set()
    stack = [output]
    while stack:
        number = stack.pop()
        if number not in found and number not in done:
            found.add(number)
            stack.extend(reads[number])
    return found


def _descend(output: int, reads: Mapping[int, Sequence[int]], kinds: Mapping[int, str], done: dict[int, None]) -> None:
    """Appends a statement after everything it needs, the most expensive operand first."""
    stack = [(output, False)]
    while stack:
        number, ready = stack.pop()
        if number in done:
            continue
        if ready:
            done[number] = None
            continue
        stack.append((number, True))
        wanted = [n for n in dict.fromkeys(reads[number]) if n not in done]
        size = {n: sum(cost_of(kinds[m]).occupied for m in _missing(n, reads, done)) for n in wanted}
        stack.extend((n, False) for n in sorted(wanted, key=lambda n: size[n]))


def _overtake(sequence: Sequence[int], reads: Mapping[int, Sequence[int]], kinds: Mapping[int, str]) -> list[int]:
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
