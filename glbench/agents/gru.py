"""A gated recurrent unit (Cho et al., 2014), by which a policy remembers what it has seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.agents.exact_math import ExactLinear, exp, tanh
from glbench.errors import ShapeError

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gru:
    """From what is seen ``(rows, inputs)`` and the memory ``(rows, units)`` to the next memory: each row the same bits in any batch.

    Attributes
    ----------
    weights, bias
        Of what is seen, ``(inputs, 3 * units)`` and ``(3 * units,)``, float32: of the gates that keep and that reset, and of what is new.
    recurrent
        Of the memory, ``(units, 3 * units)``.
    """

    weights: NDArray[np.float32]
    bias: NDArray[np.float32]
    recurrent: NDArray[np.float32]

    def __post_init__(self) -> None:
        wide = 3 * self.units
        if self.weights.shape[1:] != (wide,) or self.bias.shape != (wide,) or self.recurrent.shape[1:] != (wide,):
            msg = f"A memory cannot have weights of shapes {self.weights.shape}, {self.bias.shape} and {self.recurrent.shape}."
            raise ShapeError(msg)
        if not all(np.isfinite(array).all() for array in (self.weights, self.bias, self.recurrent)):
            msg = "A memory has weights that are not finite."
            raise ShapeError(msg)
        seen = ExactLinear.of(self.weights, self.bias), ExactLinear.of(self.recurrent, np.zeros(wide))
        object.__setattr__(self, "_layers", seen)

    @property
    def units(self) -> int:
        """Numbers that it remembers."""
        return len(self.recurrent)

    def __call__(self, seen: Floats, memory: Floats) -> Floats:
        """The memory after ``seen``."""
        of_seen, of_memory = self._layers  # type: ignore[attr-defined]
        keep, reset, new = np.split(of_seen(seen), 3, axis=1)
        keep_too, reset_too, new_too = np.split(of_memory(memory), 3, axis=1)
        new = tanh(new + _sigmoid(reset + reset_too) * new_too)
        result: Floats = new + _sigmoid(keep + keep_too) * (memory - new)
        return result


def _sigmoid(x: Floats) -> Floats:
    return 1.0 / (1.0 + exp(-x))
