"""Many policies that differ in their last layer, each for one run, evaluated together in single precision."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from glbench.agents.network_policy import NetworkPolicy

Singles = NDArray[np.float32]


class BatchedPolicy:
    """As fast as training asks for; ``NetworkPolicy`` gives the same to 1e-6 and the same bits everywhere.

    Attributes
    ----------
    seconds
        Time spent on actions so far [s].
    """

    def __init__(self, policy: NetworkPolicy) -> None:
        self._policy = policy
        self._shared = list(zip(policy.weights[:-1], policy.biases[:-1], strict=True))
        self._between = _ACTIVATIONS[policy.activation]
        self.take([(policy.weights[-1], policy.biases[-1])])
        self.seconds = 0.0

    def take(self, layers: Sequence[tuple[Singles, Singles]]) -> None:
        """Last layers, one a run: weights ``(hidden, actions)`` and biases ``(actions,)``."""
        self._weights = np.stack([weights for weights, _ in layers])
        self._biases = np.stack([biases for _, biases in layers])

    def hidden(self, observations: Singles) -> Singles:
        """The last hidden layer ``(n, hidden)``."""
        policy = self._policy
        x = np.clip((observations - policy.mean) / policy.scale, -policy.clip, policy.clip).astype(np.float32)
        for weights, biases in self._shared:
            x = self._between(x @ weights + biases)
        return x

    def act(self, observations: Singles) -> NDArray[np.float64]:
        """Actions ``(n, actions)`` for observations ``(n, columns)``, row i by the last layer i."""
        began = time.perf_counter()
        policy = self._policy
        last = (self.hidden(observations)[:, None, :] @ self._weights)[:, 0] + self._biases
        x: NDArray[np.float64] = last.astype(np.float64)
        if policy.output == "tanh":
            x = policy.low + 0.5 * (np.tanh(x) + 1.0) * (policy.high - policy.low)
        actions: NDArray[np.float64] = np.clip(x, policy.low, policy.high)
        self.seconds += time.perf_counter() - began
        return actions


def _silu(x: Singles) -> Singles:
    with np.errstate(over="ignore"):  # exp(-x) of a large negative x is infinite, and x / infinity is 0
        silu: Singles = np.divide(x, 1.0 + np.exp(-x))
    return silu


def _tanh(x: Singles) -> Singles:
    tanh: Singles = np.tanh(x)
    return tanh


def _relu(x: Singles) -> Singles:
    relu: Singles = np.maximum(x, 0.0)
    return relu


_ACTIVATIONS = {"SiLU": _silu, "Tanh": _tanh, "ReLU": _relu}
