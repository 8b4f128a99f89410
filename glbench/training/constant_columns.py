"""Columns of observations that do not vary in training: a policy cannot have learnt anything from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from glbench.agents.network_policy import NetworkPolicy
from glbench.arrays import Floats

Mask = NDArray[np.bool_]
_CONSTANT = 1e-3


def varies(low: Floats, high: Floats) -> Mask:
    """Which columns vary: those whose lowest and highest values are more than 0.001 of the larger magnitude apart."""
    return high - low > _CONSTANT * np.maximum(np.abs(low), np.abs(high))


def without_constant_columns(policy: NetworkPolicy, varying: Mask) -> NetworkPolicy:
    """``policy`` with scale 1 and weights 0 for the columns that do not vary: whatever they read, it acts the same."""
    first = np.where(varying[:, None], policy.weights[0], np.float32(0.0))
    return replace(policy, scale=np.where(varying, policy.scale, 1.0), weights=(first, *policy.weights[1:]))
