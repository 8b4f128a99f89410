"""A digest of equations."""

from __future__ import annotations

import hashlib
from functools import cache

import casadi


def digest_of(function: casadi.Function) -> str:
    """SHA-256 of the expression graph of an ``SX`` function.

    Every intermediate result is named by the digest of its operation and of the names of its operands, constants by their
    exact bits, inputs by their position; the outputs' names in their order are the function.
    """
    names = _operation_names()
    register: dict[int, str] = {}
    outputs: list[str] = []
    for k in range(function.n_instructions()):
        operation = names[function.instruction_id(k)]
        operands = function.instruction_input(k)
        results = function.instruction_output(k)
        if operation == "OP_CONST":
            register[results[0]] = _digest(operation, float(function.instruction_constant(k)).hex())
        elif operation == "OP_INPUT":
            register[results[0]] = _digest(operation, *map(str, operands))
        elif operation == "OP_OUTPUT":
            outputs.append(_digest(operation, *map(str, results), register[operands[0]]))
        else:
            register[results[0]] = _digest(operation, *(register[operand] for operand in operands))
    return _digest("function", *sorted(outputs))


def _digest(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode("ascii")).hexdigest()


@cache
def _operation_names() -> dict[int, str]:
    """Names of CasADi's operations; the numbers may differ between its versions."""
    return {getattr(casadi, name): name for name in dir(casadi) if name.startswith("OP_")}
