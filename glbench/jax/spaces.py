"""Spaces as gymnax has them."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Box:
    """Vectors between two bounds, each ``(m,)`` float32."""

    low: NDArray[np.float32]
    high: NDArray[np.float32]

    @property
    def shape(self) -> tuple[int, ...]:
        """``(m,)``."""
        return self.low.shape

    @property
    def dtype(self) -> np.dtype[np.float32]:
        """float32."""
        return self.low.dtype

    def sample(self, key: jax.Array) -> jax.Array:
        """A vector, drawn evenly ``(m,)``."""
        return jax.random.uniform(key, self.shape, jnp.float32, self.low, self.high)

    def contains(self, x: jax.Array) -> jax.Array:
        """Whether all numbers of ``x`` ``(m,)`` lie within the bounds."""
        return jnp.all((x >= self.low) & (x <= self.high))
