"""Matrix products and elementary functions that give the same bits everywhere: alone, in a batch, on any processor.

A matrix product sums many terms, and libraries choose the order of the sum, and fused operations, by processor and by batch
size. Here factors are cut into whole numbers so small that every product and every sum of them is exact in float64; what is
exact does not depend on the order. The rest are single additions, multiplications and divisions, which IEEE 754 fixes to the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats

_WEIGHT_BITS = 25
_SLICE_BITS = 18
_TERMS = 2 ** (53 - _WEIGHT_BITS - _SLICE_BITS)  # So many products of a weight and a slice can be added exactly

_UNTHREADED = 2**18  # OpenBLAS multiplies on one thread below so many multiplications

_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""The natural logarithm of 2 in two parts; whole multiples of the first are exact."""
_LARGEST_EXPONENT = 700.0  # exp(700) is near the largest number: beyond, 1 / (1 + exp) is 0 or 1 to the last bit


@dataclass(frozen=True, eq=False)
class ExactLinear:
    """``x @ weights + bias``, bitwise identical for any batch composition and BLAS.

    Both factors are split into a coarse and a fine part of whole numbers. The product of the fine parts is left out: the result
    is within about ``1e-12`` of the largest weight times the largest entry of the row, far closer than float32 comes.
    """

    coarse: Floats
    """Weights ``(inputs, outputs)``, whole numbers of ``unit``."""
    fine: Floats
    """What remains of them, whole numbers of ``unit * 2**-26``."""
    unit: float
    bias: Floats

    @classmethod
    def of(cls, weights: NDArray[np.floating], bias: NDArray[np.floating]) -> ExactLinear:
        """From weights ``(inputs, outputs)`` and bias ``(outputs,)``."""
        wide = weights.astype(np.float64)
        _, exponent = np.frexp(np.abs(wide).max(initial=0.0))
        unit = float(np.ldexp(1.0, int(exponent) - _WEIGHT_BITS))
        scaled = wide / unit
        coarse = np.rint(scaled)
        return cls(coarse, np.rint(np.ldexp(scaled - coarse, _WEIGHT_BITS + 1)), unit, bias.astype(np.float64))

    def __call__(self, x: Floats) -> Floats:
        """``(rows, outputs)`` for ``x`` of shape ``(rows, inputs)``."""
        _, exponents = np.frexp(np.abs(x).max(axis=1, keepdims=True))
        scaled = np.ldexp(x, _SLICE_BITS - exponents)
        coarse = np.rint(scaled)
        fine = np.rint(np.ldexp(scaled - coarse, _SLICE_BITS + 1))
        total = np.zeros((len(x), self.coarse.shape[1]))
        for begin in range(0, x.shape[1], _TERMS):
            part = slice(begin, begin + _TERMS)
            total += _product(coarse[:, part], self.coarse[part])
            total += np.ldexp(_product(fine[:, part], self.coarse[part]), -_SLICE_BITS - 1)
            total += np.ldexp(_product(coarse[:, part], self.fine[part]), -_WEIGHT_BITS - 1)
        result: Floats = np.ldexp(total, exponents - _SLICE_BITS) * self.unit + self.bias
        return result


def _product(a: Floats, b: Floats) -> Floats:
    """``a @ b`` of whole numbers, in pieces for which no library starts threads: on a busy machine they wait for each other."""
    width = max(1, _UNTHREADED // (max(1, len(a)) * b.shape[1]))
    total: Floats = a[:, :width] @ b[:width]
    for begin in range(width, a.shape[1], width):
        total += a[:, begin : begin + width] @ b[begin : begin + width]
    return total


def exp(x: Floats) -> Floats:
    """Exponential function, to about one unit in the last place; arguments beyond ±700 count as ±700."""
    bounded = np.clip(x, -_LARGEST_EXPONENT, _LARGEST_EXPONENT)
    halvings = np.rint(bounded * _LOG2_E)
    rest = (bounded - halvings * _LN2_HIGH) - halvings * _LN2_LOW
    series = np.full_like(rest, _COEFFICIENTS[-1])
    for coefficient in _COEFFICIENTS[-2::-1]:
        series *= rest
        series += coefficient
    return np.ldexp(series, halvings.astype(np.int32))


def silu(x: Floats) -> Floats:
    """``x / (1 + exp(-x))``, also called swish."""
    return x / (1.0 + exp(-x))


def tanh(x: Floats) -> Floats:
    """Hyperbolic tangent; absolute error below 1e-15."""
    return 1.0 - 2.0 / (exp(2.0 * x) + 1.0)


def sigmoid(x: Floats) -> Floats:
    """``1 / (1 + exp(-x))``."""
    return 1.0 / (1.0 + exp(-x))


def relu(x: Floats) -> Floats:
    """``max(x, 0)``."""
    return np.maximum(x, 0.0)


_COEFFICIENTS = tuple(1.0 / math.factorial(k) for k in range(15))
"""1/k! of the series of exp, which on |x| < 0.35 errs by less than 1e-18 after these terms."""
