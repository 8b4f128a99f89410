"""Arithmetic recorded as a tape: what a formula does to numbers, to be done again by the compiled kernel, row by row.

A formula that uses only arithmetic and a few of numpy's functions is called once with recorded values in the place of arrays:

    recorder = Recorder()
    moved = np.minimum(recorder.input("controls", 0) + 0.1, 1.0)
    recorder.output("table", 3, moved)
    tape = recorder.tape()

The tape holds the operations in the order in which the formula did them, each of them one IEEE 754 operation. It therefore
gives the same bits as the formula gives with arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from glbench.errors import GlbenchError

Source = Literal[
    "given", "controls", "drawn", "before", "after", "calendar", "counter", "calendar_before", "weather", "noise", "trait", "memory",
    "controls_before", "weather_before",
]  # fmt: skip
Target = Literal["controls", "parameters", "table", "observation", "memory"]

SOURCES: tuple[str, ...] = get_args(Source)
"""In the order of ``glb::Source`` in native/environment.hpp."""
TARGETS: tuple[str, ...] = get_args(Target)
"""In the order of ``glb::Target``."""
OPERATORS = (
    "add", "subtract", "multiply", "divide", "negative", "maximum", "minimum", "sign", "fmax", "fmin", "exp",
)  # fmt: skip
"""In the order of ``glb::Operator`` in native/tape.hpp. ``exp`` is the C library's, which numpy's is not: never recorded from numpy."""


class RecordingError(GlbenchError):
    """A formula does something that a tape cannot hold."""


@dataclass(frozen=True, eq=False)
class Tape:
    """Operations on registers.

    Attributes
    ----------
    constants
        Values of the first registers, float64.
    inputs
        Source and index of the registers after these, ``(inputs, 2)`` int32.
    operations
        Operator and operands; the result of operation i is the register after the inputs and i more, ``(operations, 3)`` int32.
    outputs
        Target, index and register, ``(outputs, 3)`` int32.
    """

    constants: npt.NDArray[np.float64]
    inputs: npt.NDArray[np.int32]
    operations: npt.NDArray[np.int32]
    outputs: npt.NDArray[np.int32]

    @property
    def registers(self) -> int:
        """How many numbers it works with."""
        return len(self.constants) + len(self.inputs) + len(self.operations)

    def reads(self, source: Source) -> bool:
        """Whether an input comes from ``source``."""
        return bool((self.inputs[:, 0] == SOURCES.index(source)).any())

    @cached_property
    def _steps(self) -> list[tuple[Callable[..., Any], int, int]]:
        return [(_IN_NUMPY[op], a, b) for op, a, b in self.operations.tolist()]

    def play(self, read: Callable[[Source, int], Any]) -> list[tuple[str, int, Any]]:
        """Do the operations with numpy, with the bits of the compiled kernel.

        Parameters
        ----------
        read
            Gives the values of an input, ``(n,)``, from its source and index.

        Returns
        -------
        list
            Target, index and values of each output; what depends on no input is a plain number.
        """
        registers = self.fill(read)
        return [(TARGETS[target], index, registers[number]) for target, index, number in self.outputs.tolist()]

    def fill(self, read: Callable[[Source, int], Any]) -> list[Any]:
        """The values of all registers, as ``play`` finds them."""
        registers: list[Any] = self.constants.tolist()
        registers += [read(SOURCES[source], index) for source, index in self.inputs.tolist()]
        with np.errstate(all="ignore"):  # as silent as the compiled kernel; whoever uses a number judges it
            for operator, a, b in self._steps:
                registers.append(operator(registers[a], registers[b]))
        return registers

    def part(
        self,
        outputs: Sequence[tuple[Target, int]],
        change: Mapping[tuple[Target, int], Callable[[Value], Value]] = MappingProxyType({}),
    ) -> Tape:
        """The tape of some outputs, with no more than they need; the same bits.

        Parameters
        ----------
        outputs
            Target and index of each.
        change
            Formulas by output of this tape, chosen or not: what a formula makes of the output's value takes its place, in the
            outputs and in all operations that use it.
        """
        places = {(TARGETS[target], index): number for target, index, number in self.outputs.tolist()}
        formulas = {places[output]: formula for output, formula in change.items()}
        recorder = Recorder()
        values: list[Any] = self.constants.tolist()
        values += [recorder.input(SOURCES[source], index) for source, index in self.inputs.tolist()]
        for number, (operator, a, b) in enumerate(self.operations.tolist(), len(values)):
            value = recorder.operation(OPERATORS[operator], values[a], values[b])
            values.append(formulas[number](value) if number in formulas else value)
        for target, index in outputs:
            recorder.output(target, index, values[places[target, index]])
        return recorder.tape()


class Value:
    """A number that is known only when the tape runs; ``number`` is its place in the record."""

    __slots__ = ("_recorder", "number")

    def __init__(self, recorder: Recorder, number: int) -> None:
        self._recorder = recorder
        self.number = number

    def __array_ufunc__(self, ufunc: Callable[..., Any], method: str, *operands: Any, **options: Any) -> Value:
        name = _UFUNCS.get(ufunc)
        if name is None or method != "__call__" or options:
            msg = f"A formula uses {getattr(ufunc, '__name__', ufunc)}, which cannot be recorded."
            raise RecordingError(msg)
        return self._recorder.operation(name, *operands)

    def __add__(self, other: Any) -> Value:
        return self._recorder.operation("add", self, other)

    def __radd__(self, other: Any) -> Value:
        return self._recorder.operation("add", other, self)

    def __sub__(self, other: Any) -> Value:
        return self._recorder.operation("subtract", self, other)

    def __rsub__(self, other: Any) -> Value:
        return self._recorder.operation("subtract", other, self)

    def __mul__(self, other: Any) -> Value:
        return self._recorder.operation("multiply", self, other)

    def __rmul__(self, other: Any) -> Value:
        return self._recorder.operation("multiply", other, self)

    def __truediv__(self, other: Any) -> Value:
        return self._recorder.operation("divide", self, other)

    def __rtruediv__(self, other: Any) -> Value:
        return self._recorder.operation("divide", other, self)

    def __neg__(self) -> Value:
        return self._recorder.operation("negative", self)

    def __pow__(self, other: Any) -> Value:
        msg = "A formula raises to a power, which cannot be recorded."
        raise RecordingError(msg)

    __rpow__ = __pow__

    def __bool__(self) -> bool:
        msg = "A formula decides by a number that is known only in the step, which cannot be recorded."
        raise RecordingError(msg)


_UFUNCS: dict[Any, str] = {
    np.add: "add",
    np.subtract: "subtract",
    np.multiply: "multiply",
    np.true_divide: "divide",
    np.negative: "negative",
    np.maximum: "maximum",
    np.minimum: "minimum",
    np.sign: "sign",
}


class Recorder:
    """Records what formulas do. The same operation on the same operands is kept once."""

    def __init__(self) -> None:
        # What was recorded, by kind: a constant by its bits, an input by source and index, an operation by its operands' numbers.
        self._numbers: dict[tuple[Any, ...], int] = {}
        self._outputs: list[tuple[int, int, int]] = []

    def input(self, source: Source, index: int) -> Value:
        """Number ``index`` of a row of ``source``."""
        return Value(self, self._number("input", SOURCES.index(source), index))

    def operation(self, name: str, *operands: Any) -> Value:
        """The result of one operation on values and plain numbers."""
        numbers = [self._operand(operand) for operand in operands]
        # An operation with one operand has it in both places.
        return Value(self, self._number("operation", OPERATORS.index(name), numbers[0], numbers[-1]))

    def output(self, target: Target, index: int, value: Any) -> None:
        """Let ``value`` be number ``index`` of a row of ``target``."""
        self._outputs.append((TARGETS.index(target), index, self._operand(value)))

    def tape(self) -> Tape:
        """What was recorded, as far as the outputs need it."""
        needed = self._needed()
        kinds = ("constant", "input", "operation")
        constants, inputs, operations = (
            [key for key, number in self._numbers.items() if key[0] == kind and number in needed] for kind in kinds
        )
        place = {self._numbers[key]: register for register, key in enumerate((*constants, *inputs, *operations))}
        return Tape(
            np.array([float.fromhex(bits) for _, bits in constants], dtype=np.float64),
            _table([key[1:] for key in inputs], 2),
            _table([(operator, place[a], place[b]) for _, operator, a, b in operations], 3),
            _table([(target, index, place[number]) for target, index, number in self._outputs], 3),
        )

    def _needed(self) -> set[int]:
        needed = {number for _, _, number in self._outputs}
        for key, number in reversed(self._numbers.items()):  # operands were recorded before what is made of them
            if number in needed and key[0] == "operation":
                needed.update(key[2:])
        return needed

    def _operand(self, operand: Any) -> int:
        if isinstance(operand, Value):
            return operand.number
        if isinstance(operand, int | float | np.floating | np.integer) and not isinstance(operand, bool):
            return self._number("constant", float(operand).hex())  # 0.0 and -0.0 are two constants
        msg = f"A formula mixes a recorded value with a {type(operand).__name__}, which cannot be recorded."
        raise RecordingError(msg)

    def _number(self, *key: Any) -> int:
        return self._numbers.setdefault(key, len(self._numbers))


def _exp(values: Any, _: Any) -> Any:
    """The C library's ``exp``, number by number: numpy's is another one on some processors."""
    array = np.asarray(values, dtype=np.float64)
    values = array.ravel().tolist()
    try:
        found = list(map(math.exp, values))
    except OverflowError:
        found = [_exp_of(value) for value in values]
    return np.array(found, dtype=np.float64).reshape(array.shape)


def _exp_of(value: float) -> float:
    try:
        return math.exp(value)
    except OverflowError:
        return math.inf


_IN_NUMPY: tuple[Callable[[Any, Any], Any], ...] = (
    np.add,
    np.subtract,
    np.multiply,
    np.true_divide,
    lambda a, _: np.negative(a),
    # Which of two zeros, or of two that are no numbers, is the larger: as native/tape.hpp has it.
    lambda a, b: np.where((a > b) | (a != a), a, b),
    lambda a, b: np.where((a < b) | (a != a), a, b),
    lambda a, _: np.sign(a),
    lambda a, b: np.where((b > a) | (a != a), b, a),
    lambda a, b: np.where((b < a) | (a != a), b, a),
    _exp,
)
"""In the order of ``OPERATORS``."""


def _table(rows: list[tuple[int, ...]], width: int) -> npt.NDArray[np.int32]:
    return np.array(rows, dtype=np.int32).reshape(len(rows), width)


EMPTY = Recorder().tape()
"""A tape that does nothing."""
