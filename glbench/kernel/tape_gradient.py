"""Derivatives of what a tape computes: back over its operations, for many rows at once.

    playback = Playback(tape, read)
    playback.value("table", 0)                        # the number itself, with the bits of Tape.play
    playback.gradient("table", 0, ("after",))         # {("after", 3): its derivative with respect to that input, ...}

Where an operation has a kink, the derivative is that of the branch taken: the operand that became the result has all of it. Of two equal
operands ``maximum`` and ``minimum`` take the second, so that ``np.maximum(value, 0.0)`` has the derivative 0 at 0; ``fmax`` and ``fmin``
take the first. ``sign`` has the derivative 0 everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from glbench.kernel.tape import OPERATORS, SOURCES, TARGETS, Source, Tape, Target


class Playback:
    """A tape played for some rows, which remembers its registers for the way back.

    Parameters
    ----------
    tape
        What is played.
    read
        Gives the values of an input from its source and index, arrays of one shape.
    """

    def __init__(self, tape: Tape, read: Callable[[Source, int], Any]) -> None:
        self._inputs = list(enumerate(tape.inputs.tolist(), len(tape.constants)))
        self._operations = list(enumerate(tape.operations.tolist(), len(tape.constants) + len(tape.inputs)))
        self._outputs = {(TARGETS[target], index): number for target, index, number in tape.outputs.tolist()}
        self._registers = tape.fill(read)

    def value(self, target: Target, index: int) -> Any:
        """Values of an output, in the shape of the inputs; a plain number where it depends on none."""
        return self._registers[self._outputs[target, index]]

    def gradient(self, target: Target, index: int, sources: Iterable[Source]) -> dict[tuple[Source, int], Any]:
        """Derivatives of an output with respect to the inputs from ``sources``, row by row.

        Returns
        -------
        dict
            By source and index, in the shape of the inputs; a plain number where all rows have the same. Inputs on which the output does
            not depend are left out.
        """
        numbers = {SOURCES.index(source) for source in sources}
        wanted = {number: (SOURCES[source], at) for number, (source, at) in self._inputs if source in numbers}
        leading = set(wanted)  # registers that depend on the wanted inputs
        for number, (_, a, b) in self._operations:
            if a in leading or b in leading:
                leading.add(number)
        slopes: dict[int, Any] = {self._outputs[target, index]: 1.0}
        with np.errstate(all="ignore"):
            for number, (operator, a, b) in reversed(self._operations):
                if number not in leading or number not in slopes:
                    continue
                slope, result = slopes.pop(number), self._registers[number]
                for operand, back in zip(
                    (a, b), _BACK[operator], strict=False
                ):  # an operation with one operand has one
                    if operand in leading:
                        found = back(slope, self._registers[a], self._registers[b], result)
                        slopes[operand] = slopes[operand] + found if operand in slopes else found
        return {name: slopes[number] for number, name in wanted.items() if number in slopes}


_Back = Callable[[Any, Any, Any, Any], Any]
"""Slope of an operand from that of the result, the two operands and the result."""


def _same(slope: Any, a: Any, b: Any, result: Any) -> Any:
    return slope


def _minus(slope: Any, a: Any, b: Any, result: Any) -> Any:
    return -slope


def _choice(takes_first: Callable[[Any, Any], Any]) -> tuple[_Back, _Back]:
    return (
        lambda slope, a, b, result: np.where(takes_first(a, b), slope, 0.0),
        lambda slope, a, b, result: np.where(takes_first(a, b), 0.0, slope),
    )


_RULES: dict[str, tuple[_Back, ...]] = {
    "add": (_same, _same),
    "subtract": (_same, _minus),
    "multiply": (lambda slope, a, b, result: slope * b, lambda slope, a, b, result: slope * a),
    "divide": (lambda slope, a, b, result: slope / b, lambda slope, a, b, result: -slope * result / b),
    "negative": (_minus,),
    "maximum": _choice(lambda a, b: a > b),
    "minimum": _choice(lambda a, b: a < b),
    "sign": (),
    "fmax": _choice(lambda a, b: a >= b),
    "fmin": _choice(lambda a, b: a <= b),
    "exp": (lambda slope, a, b, result: slope * result,),
}
_BACK = tuple(_RULES[name] for name in OPERATORS)
