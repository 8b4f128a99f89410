"""What an equation may be made of: numbers, NumPy arrays or CasADi symbols, and the few functions that take any of them.

Every function here has finite derivatives of first order wherever the model can be evaluated. Several literal forms of
the literature do not (an infinite slope of ``|z|^0.33`` at 0, an overflowing ``exp``); the forms below change the
right-hand side by less than 1e-10 of its usual size.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Any, TypeAlias

import casadi
import numpy as np

Expr: TypeAlias = Any
"""A float, a NumPy array (one entry a row of a batch) or a scalar CasADi ``SX``/``MX``/``DM``.

CasADi has no type information, so this is ``Any`` to a type checker; the *names* of all quantities are checked, because
they are fields of the records (``State``, ``Optics``, ...) that the equations hand on.
"""

_SYMBOLS = (casadi.SX, casadi.MX, casadi.DM)

SMOOTH_TEMPERATURE = 1e-14
"""Added to a squared temperature difference [K2] under a root: rounds the kink at 0 within 1e-7 K."""

EXPONENT_LIMIT = 300.0
"""Largest argument of ``exp`` in :func:`sigmoid`; the function is below 1e-130 there."""


_SIMPLIFYING = RLock()


@contextmanager
def simplification(*, on: bool) -> Iterator[None]:
    """CasADi simplifies expressions as they are made, or keeps every operation; also how it takes NumPy's functions is fixed.

    Both are settings of the process: other threads that ask for either wait. The former settings return at the end, also after an error.
    """
    options = casadi.GlobalOptions
    with _SIMPLIFYING:
        former, numpy_mode = options.getSimplificationOnTheFly(), options.getNumpyMode()
        options.setSimplificationOnTheFly(on)
        options.setNumpyMode(-1)
        try:
            yield
        finally:
            options.setSimplificationOnTheFly(former)
            options.setNumpyMode(numpy_mode)


def is_symbolic(*values: Expr) -> bool:
    """Whether one of the values belongs to CasADi."""
    return any(isinstance(value, _SYMBOLS) for value in values)


def exp(z: Expr) -> Expr:
    """Exponential function."""
    return casadi.exp(z) if is_symbolic(z) else np.exp(z)


def log(z: Expr) -> Expr:
    """Natural logarithm."""
    return casadi.log(z) if is_symbolic(z) else np.log(z)


def sqrt(z: Expr) -> Expr:
    """Square root."""
    return casadi.sqrt(z) if is_symbolic(z) else np.sqrt(z)


def cos(z: Expr) -> Expr:
    """Cosine of an angle in radians."""
    return casadi.cos(z) if is_symbolic(z) else np.cos(z)


def fmin(a: Expr, b: Expr) -> Expr:
    """Smaller of two values."""
    return casadi.fmin(a, b) if is_symbolic(a, b) else np.minimum(a, b)


def fmax(a: Expr, b: Expr) -> Expr:
    """Larger of two values."""
    return casadi.fmax(a, b) if is_symbolic(a, b) else np.maximum(a, b)


def if_else(condition: Expr, yes: Expr, no: Expr) -> Expr:
    """``yes`` where the condition holds, otherwise ``no``; both sides are evaluated."""
    return casadi.if_else(condition, yes, no) if is_symbolic(condition, yes, no) else np.where(condition, yes, no)


def square(z: Expr) -> Expr:
    """``z`` times itself."""
    return z * z


def sigmoid(z: Expr) -> Expr:
    """Smooth step ``1/(1 + exp(-z))`` from 0 (z far below 0) to 1 (z far above 0), without overflow."""
    return 1 / (1 + exp(fmin(-z, EXPONENT_LIMIT)))


def fourth_root(z: Expr) -> Expr:
    """``z^0.25`` of a positive value."""
    return sqrt(sqrt(z))


def magnitude_power(difference: Expr, exponent: float) -> Expr:
    """``|difference|^exponent`` of a temperature difference [K], with a finite slope at 0."""
    return (square(difference) + SMOOTH_TEMPERATURE) ** (exponent / 2)
