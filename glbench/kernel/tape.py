"""Formulas recorded with CasADi, and the list of instructions that the compiled kernel and NumPy read from them.

A formula is called once with CasADi's scalar symbols (``SX``) in place of arrays:

    with Recorder() as recorder:
        moved = np.minimum(recorder.input("controls", 0) + 0.1, 1.0)
        recorder.output("table", 3, moved)
    tape = recorder.tape()

It may use arithmetic, powers, comparisons (1 or 0), ``abs``, ``np.maximum``, ``np.minimum``, ``np.sign``, ``np.sqrt``, ``casadi.if_else``,
``exp`` and ``log``. During recording CasADi simplifies nothing: the tape holds the operations as they were written, so
they give the same bits as NumPy gives with arrays. There are two exceptions. ``exp``, ``log`` and powers come from the
C library; on some processors NumPy uses its own. A constant -0.0 becomes 0.0.

``fmax`` and ``fmin``, by whatever name, are ``np.maximum`` and ``np.minimum``: NaN stays NaN, and if the operands are
equal the result is the second, which decides the sign of a zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType, TracebackType
from typing import Any, Literal, Self, get_args

import casadi
import numpy as np
import numpy.typing as npt

from glbench.errors import GlbenchError, refuse
from glbench.model.expressions import simplification

Source = Literal[
    "given", "controls", "drawn", "before", "after", "calendar", "counter", "calendar_before", "weather", "noise", "trait", "memory",
    "controls_before", "weather_before",
]  # fmt: skip
Target = Literal["controls", "parameters", "table", "observation", "memory"]

SOURCES: tuple[str, ...] = get_args(Source)
"""In the order of ``glb::Source`` in native/environment.hpp."""
TARGETS: tuple[str, ...] = get_args(Target)
"""In the order of ``glb::Target``."""
Read = Callable[[Source, int], Any]
"""Gives the values of an input from its source and index."""


class RecordingError(GlbenchError):
    """A formula does something that a tape cannot hold."""


@dataclass(frozen=True, eq=False)
class Tape:
    """Operations on registers.

    ``constants`` are the values of the first registers, float64; ``inputs`` ``(inputs, 2)`` int32 are source and index of those after
    these. ``operations`` ``(operations, 3)`` int32 are operator and operands; the result of operation i is in register i, counted from the
    end of the inputs. ``outputs`` ``(outputs, 3)`` int32 are target, index and register.
    """

    constants: npt.NDArray[np.float64]
    inputs: npt.NDArray[np.int32]
    operations: npt.NDArray[np.int32]
    outputs: npt.NDArray[np.int32]

    @property
    def registers(self) -> int:
        """Number of registers."""
        return len(self.constants) + len(self.inputs) + len(self.operations)

    def reads(self, source: Source) -> bool:
        """Whether an input comes from ``source``."""
        return bool((self.inputs[:, 0] == SOURCES.index(source)).any())

    @cached_property
    def _steps(self) -> list[tuple[Callable[..., Any], int, int]]:
        return [(_IN_NUMPY[op], a, b) for op, a, b in self.operations.tolist()]

    def play(self, read: Read) -> list[tuple[str, int, Any]]:
        """Do the operations with NumPy, with the bits of the compiled kernel: target, index and values of each output.

        ``read`` gives the values of an input, ``(n,)`` or another shape, from its source and index. One without inputs is a plain number.
        """
        registers: list[Any] = self.constants.tolist()
        registers += [read(SOURCES[source], index) for source, index in self.inputs.tolist()]
        with np.errstate(all="ignore"):  # as silent as the compiled kernel; whoever uses a number judges it
            for operation, a, b in self._steps:
                registers.append(operation(registers[a], registers[b]))
        return [(TARGETS[target], index, registers[number]) for target, index, number in self.outputs.tolist()]


class Recorder:
    """Records formulas inside its ``with`` block. Only one thread records at a time; blocks may be nested.

    The end of the block raises ``RecordingError`` when a formula did something that a tape cannot hold.
    """

    def __init__(self) -> None:
        self._inputs: dict[tuple[Source, int], Any] = {}
        self._outputs: list[tuple[Target, int]] = []
        self._values: list[Any] = []
        self._open = ExitStack()
        self._recording = False

    def __enter__(self) -> Self:
        self._open.enter_context(simplification(on=False))
        self._recording = True
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._open.close()
        self._recording = False
        if isinstance(error, RuntimeError | TypeError | NotImplementedError) and not isinstance(error, GlbenchError):
            what = "decides by a number that is known only in the step" if "truth value" in str(error) else f"fails ({error})"
            refuse(f"A formula {what}, which cannot be recorded.", RecordingError, error)

    def input(self, source: Source, index: int) -> Any:
        """Number ``index`` of a row of ``source``, a symbol."""
        if not self._recording:
            refuse("A Recorder records inside its with block only.", RecordingError)
        key = source, index
        if key not in self._inputs:
            self._inputs[key] = casadi.SX.sym(f"{source}{index}")
        return self._inputs[key]

    def output(self, target: Target, index: int, value: Any) -> None:
        """Record ``value``, an expression or a plain number, as number ``index`` of a row of ``target``."""
        if not isinstance(value, casadi.SX | int | float | np.floating | np.integer) or isinstance(value, bool):
            refuse(f"A formula makes a {type(value).__name__}, which cannot be recorded.", RecordingError)
        number = casadi.SX(value)
        if number.shape != (1, 1):
            msg = f"A formula makes an array of shape {number.shape}, which cannot be recorded: a tape works on single numbers."
            raise RecordingError(msg)
        self._outputs.append((target, index))
        self._values.append(number)

    def tape(self) -> Tape:
        """The recorded operations that the outputs need. Raises ``RecordingError`` for an operation that tapes do not have."""
        return _read(list(self._inputs), list(self._inputs.values()), self._outputs, self._values)


def with_simplification(formula: Callable[..., Any], *values: Any) -> Any:
    """``formula`` of scalars, with one result or several, simplified by CasADi: it has the same operations as in a model's equations."""
    symbols = [casadi.SX.sym(f"value{place}") for place in range(len(values))]
    with simplification(on=True):
        value = formula(*symbols)
        function = casadi.Function("formula", symbols, list(value) if isinstance(value, tuple) else [value])
    return function(*values)


class TapeDerivatives:
    """Some outputs of a tape, with their derivatives, for many rows at once.

    Where an operation has a kink, the derivative is that of the branch taken: the operand that became the result gets
    the whole derivative. If the operands are equal, ``np.maximum`` and ``np.minimum`` take the second, so
    ``np.maximum(value, 0.0)`` has the derivative 0 at 0. ``np.sign`` has the derivative 0 everywhere.

    ``outputs`` has target and index of each; the derivatives are with respect to the inputs from ``sources``. Of ``count`` outputs, counted
    from the first, there are derivatives; of all by default. ``changes`` are formulas by output of the tape, whether or not it is in
    ``outputs``: the result of a formula replaces the value of its output, in the outputs and in all operations that use it.
    """

    def __init__(
        self,
        tape: Tape,
        outputs: Sequence[tuple[Target, int]],
        sources: Iterable[Source],
        *,
        count: int | None = None,
        changes: Mapping[tuple[Target, int], Callable[[Any], Any]] = MappingProxyType({}),
    ) -> None:
        place = {(TARGETS[target], index): register for target, index, register in tape.outputs.tolist()}
        self._count = len(outputs)
        with simplification(on=False):
            keys, symbols, registers = _expressions(tape, {place[output]: change for output, change in changes.items()})
            # CasADi sorts operations by the outputs, one after another: with all of them as outputs they stay in the tape's order,
            # and so do the sums of slopes.
            results = [place[output] for output in outputs]
            order = [number for number in _needed(tape, results) if number >= len(tape.constants) + len(tape.inputs)]
            hidden: list[tuple[Target, int]] = [("memory", 0)] * len(order)
            ordered = _read(keys, symbols, [*hidden, *outputs], [registers[number] for number in (*order, *results)])
            self._tape = replace(ordered, outputs=ordered.outputs[len(order) :])
            keys, symbols, registers = _expressions(self._tape)
            at = dict(enumerate(keys, len(self._tape.constants)))
            inputs = {number for number, (source, _) in at.items() if source in set(sources)}
            results = self._tape.outputs[:, 2].tolist()
            slopes = {
                (row, *at[number]): slope
                for row, result in enumerate(results[:count])
                for number, slope in _slopes(self._tape, registers, result, inputs).items()
            }
            self._entries = list(slopes)
            values = [*(registers[result] for result in results), *slopes.values()]
            self._with_slopes = _read(keys, symbols, [("table", row) for row in range(len(values))], values)

    def reads(self, source: Source) -> bool:
        """Whether an output or a derivative needs an input from ``source``."""
        return self._with_slopes.reads(source)

    def values(self, read: Read) -> list[Any]:
        """Values of the outputs, in the shape of the inputs, with the bits of the tape; plain numbers for outputs without inputs."""
        return [values for _, _, values in self._tape.play(read)]

    def __call__(self, read: Read, slopes: Mapping[Source, npt.NDArray[np.float64]]) -> list[Any]:
        """The same; ``slopes``, for each source zeros ``(..., outputs, n)`` with n its number of inputs, are filled with derivatives."""
        played = [values for _, _, values in self._with_slopes.play(read)]
        for (place, source, index), values in zip(self._entries, played[self._count :], strict=True):
            slopes[source][..., place, index] = values
        return played[: self._count]


def _read(keys: Sequence[tuple[Source, int]], symbols: Sequence[Any], outputs: Sequence[tuple[Target, int]], values: Sequence[Any]) -> Tape:
    """The tape of ``outputs`` with these ``values``; repeated operations on the same operands are done once."""
    if not values:
        return EMPTY
    function = casadi.Function("tape", list(symbols), [casadi.densify(casadi.vertcat(*values))])
    # Numbers of what was read, by kind: a constant by its bits, an input by its place, an operation by its operands' numbers.
    numbers: dict[tuple[Any, ...], int] = {}
    register: dict[int, int] = {}
    results = [0] * len(values)
    for k in range(function.n_instructions()):
        code, operands, to = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == casadi.OP_OUTPUT:
            results[to[1]] = register[operands[0]]
            continue
        if code == casadi.OP_INPUT:
            key: tuple[Any, ...] = ("input", operands[0])
        elif code == casadi.OP_CONST:
            constant = float(function.instruction_constant(k))
            if math.isnan(constant):  # what float() makes of a symbol
                msg = "A formula makes a number of what is known only in the step, which cannot be recorded. Use NumPy's functions."
                raise RecordingError(msg)
            key = ("constant", constant.hex())
        else:
            sources = [register[operand] for operand in operands]
            if code in _SHORT:  # CasADi has a word of its own for it
                code, factor = _SHORT[code]
                first = numbers.setdefault(("constant", factor.hex()), len(numbers)) if factor else sources[0]
                sources = [first, sources[0]]
            if code not in _PLACES:
                name = next((name for name in dir(casadi) if name.startswith("OP_") and getattr(casadi, name) == code), code)
                refuse(f"A formula uses CasADi's operation {name}, which cannot be recorded.", RecordingError)
            # An operation with one operand has it in both places.
            key = ("operation", _PLACES[code], sources[0], sources[-1])
        register[to[0]] = numbers.setdefault(key, len(numbers))
    needed = {*results, *(number for key in numbers if key[0] == "operation" for number in key[2:])}
    constants, inputs, operations = (
        [key for key, number in numbers.items() if key[0] == kind and (kind == "operation" or number in needed)]
        for kind in ("constant", "input", "operation")
    )
    place = {numbers[key]: at for at, key in enumerate((*constants, *inputs, *operations))}
    return Tape(
        np.array([float.fromhex(bits) for _, bits in constants], dtype=np.float64),
        _table([(SOURCES.index(keys[at][0]), keys[at][1]) for _, at in inputs], 2),
        _table([(op, place[a], place[b]) for _, op, a, b in operations], 3),
        _table([(TARGETS.index(target), index, place[at]) for (target, index), at in zip(outputs, results, strict=True)], 3),
    )  # fmt: skip


def _table(rows: list[tuple[int, ...]], width: int) -> npt.NDArray[np.int32]:
    return np.array(rows, dtype=np.int32).reshape(len(rows), width)


def _by_number(function: Callable[..., float], otherwise: Callable[..., Any]) -> Callable[..., Any]:
    """A C library function, number by number, as NumPy uses its own on some processors. It still reports what is not finite."""

    def of_one(*numbers: float) -> float:
        try:
            return function(*numbers)
        except (OverflowError, ValueError):
            return float(otherwise(*numbers))

    def of_all(*values: Any) -> Any:
        arrays = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in values))
        lists = [array.ravel().tolist() for array in arrays]
        try:
            results = list(map(function, *lists))
        except (OverflowError, ValueError):
            results = list(map(of_one, *lists))
        return np.array(results, dtype=np.float64).reshape(arrays[0].shape)

    return of_all


_exp, _log, _power = _by_number(math.exp, np.exp), _by_number(math.log, np.log), _by_number(math.pow, np.power)

_OPERATIONS: tuple[tuple[str, int, int, Callable[[Any, Any], Any]], ...] = (
    ("add", casadi.OP_ADD, 2, np.add),
    ("subtract", casadi.OP_SUB, 2, np.subtract),
    ("multiply", casadi.OP_MUL, 2, np.multiply),
    ("divide", casadi.OP_DIV, 2, np.true_divide),
    ("negative", casadi.OP_NEG, 1, lambda a, _: np.negative(a)),
    # Which of two zeros, or of two that are no numbers, is the larger: as native/tape.hpp has it.
    ("maximum", casadi.OP_FMAX, 2, lambda a, b: np.where((a > b) | (a != a), a, b)),
    ("minimum", casadi.OP_FMIN, 2, lambda a, b: np.where((a < b) | (a != a), a, b)),
    ("sign", casadi.OP_SIGN, 1, lambda a, _: np.sign(a)),
    ("exp", casadi.OP_EXP, 1, lambda a, _: _exp(a)),
    ("log", casadi.OP_LOG, 1, lambda a, _: _log(a)),
    ("power", casadi.OP_POW, 2, _power),
    ("square_root", casadi.OP_SQRT, 1, lambda a, _: np.sqrt(a)),
    ("magnitude", casadi.OP_FABS, 1, lambda a, _: np.abs(a)),
    ("less", casadi.OP_LT, 2, lambda a, b: np.where(a < b, 1.0, 0.0)),
    ("less_or_equal", casadi.OP_LE, 2, lambda a, b: np.where(a <= b, 1.0, 0.0)),
    ("equal", casadi.OP_EQ, 2, lambda a, b: np.where(a == b, 1.0, 0.0)),
    ("not_equal", casadi.OP_NE, 2, lambda a, b: np.where(a != b, 1.0, 0.0)),
    ("not", casadi.OP_NOT, 1, lambda a, _: np.where(a == 0.0, 1.0, 0.0)),
    ("and", casadi.OP_AND, 2, lambda a, b: np.where((a != 0.0) & (b != 0.0), 1.0, 0.0)),
    ("or", casadi.OP_OR, 2, lambda a, b: np.where((a != 0.0) | (b != 0.0), 1.0, 0.0)),
    ("if_else_zero", casadi.OP_IF_ELSE_ZERO, 2, lambda a, b: np.where(a != 0.0, b, 0.0)),
)
"""Name, CasADi code, number of operands and NumPy function of each operator, in the order of ``glb::Operator`` in native/tape.hpp."""
OPERATORS = tuple(name for name, *_ in _OPERATIONS)
_IN_NUMPY = tuple(function for *_, function in _OPERATIONS)
_PLACES = {code: place for place, (_, code, _, _) in enumerate(_OPERATIONS)} | {casadi.OP_CONSTPOW: OPERATORS.index("power")}
_SHORT = {casadi.OP_SQ: (casadi.OP_MUL, 0.0), casadi.OP_TWICE: (casadi.OP_MUL, 2.0), casadi.OP_INV: (casadi.OP_DIV, 1.0)}
"""CasADi's one-operand operations written with two operands: the constant first; 0.0 stands for the operand itself."""


def _expressions(tape: Tape, changes: Mapping[int, Callable[[Any], Any]] = MappingProxyType({})) -> tuple[list[Any], list[Any], list[Any]]:
    """Source and index of the inputs, their symbols, and all registers as expressions; some of them changed."""
    keys = [(SOURCES[source], index) for source, index in tape.inputs.tolist()]
    symbols = [casadi.SX.sym(f"{source}{index}") for source, index in keys]
    registers: list[Any] = [*map(casadi.SX, tape.constants.tolist()), *symbols]
    for number, (place, a, b) in enumerate(tape.operations.tolist(), len(registers)):
        _, code, operands, _ = _OPERATIONS[place]
        x, y = registers[a], registers[b]
        value = casadi.SX.unary(code, x) if operands == 1 else casadi.SX.binary(code, x, y)
        registers.append(changes[number](value) if number in changes else value)
    return keys, symbols, registers


def _needed(tape: Tape, registers: Sequence[int]) -> list[int]:
    """The registers and all registers that they depend on, in order."""
    needed = set(registers)
    for number, (_, a, b) in reversed(list(enumerate(tape.operations.tolist(), len(tape.constants) + len(tape.inputs)))):
        if number in needed:
            needed.update((a, b))
    return sorted(needed)


def _slopes(tape: Tape, registers: Sequence[Any], output: int, inputs: set[int]) -> dict[int, Any]:
    """Derivatives of a register with respect to the ``inputs`` on which it depends: back over the operations."""
    operations = list(enumerate(tape.operations.tolist(), len(tape.constants) + len(tape.inputs)))
    leading = set(inputs)
    for number, (_, a, b) in operations:
        if a in leading or b in leading:
            leading.add(number)
    slopes: dict[int, Any] = {output: casadi.SX(1.0)}
    for number, (operation, a, b) in reversed(operations):
        if number in leading and number in slopes:
            back = _BACK[operation]
            if back is None:
                continue
            parts = back(slopes.pop(number), registers[a], registers[b], registers[number])
            for operand, part in zip((a, b), parts, strict=False):  # an operation with one operand has one
                if operand in leading:
                    slopes[operand] = slopes[operand] + part if operand in slopes else part
    return {number: slopes[number] for number in inputs if number in slopes}


def _if(condition: Any, slope: Any) -> Any:
    """The slope where the condition holds, else 0."""
    return casadi.SX.binary(casadi.OP_IF_ELSE_ZERO, condition, slope)


_RULES: dict[str, Callable[[Any, Any, Any, Any], tuple[Any, ...]]] = {
    "add": lambda slope, x, y, result: (slope, slope),
    "subtract": lambda slope, x, y, result: (slope, -slope),
    "multiply": lambda slope, x, y, result: (slope * y, slope * x),
    "divide": lambda slope, x, y, result: (slope / y, -slope * result / y),
    "negative": lambda slope, x, y, result: (-slope,),
    "maximum": lambda slope, x, y, result: (_if(x > y, slope), _if(casadi.logic_not(x > y), slope)),
    "minimum": lambda slope, x, y, result: (_if(x < y, slope), _if(casadi.logic_not(x < y), slope)),
    "exp": lambda slope, x, y, result: (slope * result,),
    "log": lambda slope, x, y, result: (slope / x,),
    "power": lambda slope, x, y, result: (slope * y * x ** (y - 1.0), slope * result * casadi.log(x)),
    "square_root": lambda slope, x, y, result: (slope / (2.0 * result),),
    "magnitude": lambda slope, x, y, result: (slope * casadi.sign(x),),
    "if_else_zero": lambda slope, x, y, result: (casadi.SX(0.0), _if(x, slope)),
}
"""Derivatives of the operands from the derivative of the result; 0 for all other operators.

They are CasADi's rules except for maxima and minima, where CasADi divides the derivative evenly between equal operands, and for quotients,
where it multiplies by 1 / y. A difference in the last bit can change the plans of predictive control.
"""
_BACK = tuple(_RULES.get(name) for name in OPERATORS)


EMPTY = Tape(np.zeros(0), _table([], 2), _table([], 3), _table([], 3))
"""A tape that does nothing."""
