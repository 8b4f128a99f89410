"""Matrix products and elementary functions that give the same bits everywhere: alone, in a batch, on any processor.

A matrix product sums many terms, and libraries choose the order of the sum, and fused operations, by processor and by batch
size. Here factors are cut into whole numbers so small that every product and every sum of them is exact in float64; what is
exact does not depend on the order. The rest are single additions, multiplications and divisions, which IEEE 754 fixes to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_WEIGHT_BITS = 25
_SLICE_BITS = 18
_TERMS = 2 ** (53 - _WEIGHT_BITS - _SLICE_BITS)
"""So many products of a weight and a slice can be added exactly."""

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""The natural logarithm of 2 in two parts; whole multiples of the first are exact."""
_LARGEST_EXPONENT = 700.0
"""exp(700) is near the largest number: beyond, 1 / (1 + exp) is 0 or 1 to the last bit."""


@dataclass(frozen=True, eq=False)
class ExactLinear:
    """``x @ weights + bias`` with the same bits for a row whatever stands beside it and whoever multiplies.

    Weights are rounded to ``2**-25`` of the power of two above the largest of them, finer than float32 resolves it; ``x`` is
    rounded to ``2**-37`` of the power of two above the largest entry of its row.
    """

    whole: Floats
    """Weights ``(inputs, outputs)`` as whole numbers of ``unit``."""
    unit: float
    bias: Floats

    @classmethod
    def of(cls, weights: NDArray[np.floating], bias: NDArray[np.floating]) -> ExactLinear:
        """From weights ``(inputs, outputs)`` and bias ``(outputs,)``."""
        wide = weights.astype(np.float64)
        _, exponent = np.frexp(np.abs(wide).max(initial=0.0))
        unit = float(np.ldexp(1.0, int(exponent) - _WEIGHT_BITS))
        return cls(np.rint(wide / unit), unit, bias.astype(np.float64))

    def __call__(self, x: Floats) -> Floats:
        """``(rows, outputs)`` for ``x`` of shape ``(rows, inputs)``."""
        _, exponents = np.frexp(np.abs(x).max(axis=1, keepdims=True))
        scaled = np.ldexp(x, _SLICE_BITS - exponents)
        first = np.rint(scaled)
        second = np.rint(np.ldexp(scaled - first, _SLICE_BITS + 1))
        total = np.zeros((len(x), self.whole.shape[1]))
        for begin in range(0, x.shape[1], _TERMS):
            part = slice(begin, begin + _TERMS)
            fine = second[:, part] @ self.whole[part]
            total += first[:, part] @ self.whole[part] + np.ldexp(fine, -_SLICE_BITS - 1)
        result: Floats = np.ldexp(total, exponents - _SLICE_BITS) * self.unit + self.bias
        return result


def exp(x: Floats) -> Floats:
    """Exponential function, to about one unit in the last place; arguments beyond ±700 count as ±700."""
    bounded = np.clip(x, -_LARGEST_EXPONENT, _LARGEST_EXPONENT)
    halvings = np.rint(bounded * _LOG2_E)
    rest = (bounded - halvings * _LN2_HIGH) - halvings * _LN2_LOW
    series = np.full_like(rest, _COEFFICIENTS[-1])
    for coefficient in _COEFFICIENTS[-2::-1]:
        series *= rest
        series += coefficient
    result: Floats = np.ldexp(series, halvings.astype(np.int32))
    return result


def silu(x: Floats) -> Floats:
    """``x / (1 + exp(-x))``, also called swish."""
    return x / (1.0 + exp(-x))


def tanh(x: Floats) -> Floats:
    """Hyperbolic tangent; absolute error below 1e-15."""
    return 1.0 - 2.0 / (exp(2.0 * x) + 1.0)


def relu(x: Floats) -> Floats:
    """``max(x, 0)``."""
    return np.maximum(x, 0.0)


def _inverse_factorials(n: int) -> tuple[float, ...]:
    values, factorial = [1.0], 1
    for k in range(1, n):
        factorial *= k
        values.append(1.0 / factorial)
    return tuple(values)


_COEFFICIENTS = _inverse_factorials(15)
"""1/k! of the series of exp, which on |x| < 0.35 errs by less than 1e-18 after these terms."""
