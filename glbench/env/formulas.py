"""Formulas with an exponential function or a smaller and larger value, recorded from CasADi as tapes.

A tape's recorder takes numpy's arithmetic as it is (``glbench.kernel.tape``), but not numpy's ``exp``, which is not the C library's. Such
formulas are written once for numbers, arrays and CasADi's symbols; here they are evaluated with symbols, and CasADi's operations are
recorded in CasADi's order, as everywhere in the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi

from glbench.kernel.tape import Recorder, RecordingError, Value


def record_formula(formula: Callable[..., Any], given: Sequence[Value], recorder: Recorder) -> Value:
    """The value of ``formula`` of as many numbers as are ``given``, recorded.

    Raises
    ------
    RecordingError
        When it needs an operation that no tape has.
    """
    symbols = [casadi.SX.sym(f"given{place}") for place in range(len(given))]
    return record_function(casadi.Function("formula", symbols, [formula(*symbols)]), given, recorder)[0]


def record_function(function: Any, given: Sequence[Value], recorder: Recorder) -> tuple[Value, ...]:
    """The outputs of a CasADi function of scalars at values, recorded: CasADi's operations in CasADi's order.

    Raises
    ------
    RecordingError
        When it needs an operation that no tape has.
    """
    register: dict[int, Any] = {}
    results: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        operation, operands = function.instruction_id(k), function.instruction_input(k)
        to = function.instruction_output(k)
        if operation == casadi.OP_CONST:
            register[to[0]] = function.instruction_constant(k)
        elif operation == casadi.OP_INPUT:
            register[to[0]] = given[operands[0]]
        elif operation == casadi.OP_OUTPUT:
            results[to[0]] = register[operands[0]]
        elif operation in _OPERATORS:
            register[to[0]] = recorder.operation(_OPERATORS[operation], *(register[operand] for operand in operands))
        elif operation in _SPECIAL:
            register[to[0]] = _SPECIAL[operation](recorder, register[operands[0]])
        else:
            msg = f"A formula uses CasADi's operation {operation}, which cannot be recorded."
            raise RecordingError(msg)
    return tuple(results[place] for place in range(function.n_out()))


_OPERATORS = {
    casadi.OP_ADD: "add", casadi.OP_SUB: "subtract", casadi.OP_MUL: "multiply", casadi.OP_DIV: "divide", casadi.OP_NEG: "negative",
    casadi.OP_FMAX: "fmax", casadi.OP_FMIN: "fmin", casadi.OP_EXP: "exp",
}  # fmt: skip
_SPECIAL: dict[int, Callable[[Recorder, Any], Value]] = {
    casadi.OP_SQ: lambda recorder, a: recorder.operation("multiply", a, a),
    casadi.OP_TWICE: lambda recorder, a: recorder.operation("multiply", 2.0, a),
    casadi.OP_INV: lambda recorder, a: recorder.operation("divide", 1.0, a),
}
"""Operations that CasADi has a word of its own for."""
