"""Normalisation of observations and rewards in training: ``VecNormalize``, without the columns that do not vary.

``VecNormalize`` divides a column by its standard deviation. Outdoor CO2 is 400 ppm throughout the shipped weather; its standard
deviation is 0.003 ppm, left over from how the running statistics begin, and a reading of 401 ppm is then 350 standard deviations off: more
than any policy has learnt to stand. Here a column is divided by 1, and shown as 0 whatever it reads, until it has varied.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from glbench.agents.network_policy import NetworkPolicy

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
_STEADY = 1e-3


def varies(low: Floats, high: Floats) -> Mask:
    """Which columns vary: those whose lowest and highest values are more than 0.001 of the larger magnitude apart."""
    mask: Mask = high - low > _STEADY * np.maximum(np.abs(low), np.abs(high))
    return mask


class ColumnStatistics(RunningMeanStd):
    """Running mean and variance of the columns, and their lowest and highest values so far ``(columns,)``."""

    def __init__(self, columns: int) -> None:
        super().__init__(shape=(columns,))
        self.low: Floats = np.full(columns, np.inf)
        self.high: Floats = np.full(columns, -np.inf)

    @property
    def varying(self) -> Mask:
        """Which columns have varied so far."""
        return varies(self.low, self.high)

    def update(self, arr: NDArray[np.floating[Any]]) -> None:
        """Add observations ``(n, columns)``."""
        super().update(arr)
        self.low = np.minimum(self.low, arr.min(axis=0))
        self.high = np.maximum(self.high, arr.max(axis=0))

    def take(self, mean: Floats, scale: Floats, epsilon: float, count: float) -> None:
        """Go on from the mean and scale ``(columns,)`` of a policy as if they came from ``count`` observations."""
        spread = np.where(scale == 1.0, 0.0, scale)  # 1: a column that did not vary
        self.low, self.high = mean - spread, mean + spread
        self.mean, self.count = mean.copy(), count
        self.var = np.where(self.varying, np.maximum(scale**2 - epsilon, 0.0), 1.0)


class Normalizer(VecNormalize):
    """``VecNormalize`` that shows a column as 0 until it has varied. Saved and loaded like it."""

    def __init__(self, env: VecEnv, **arguments: Any) -> None:
        super().__init__(env, **arguments)
        if self.norm_obs:
            assert env.observation_space.shape is not None
            self.obs_rms = ColumnStatistics(env.observation_space.shape[0])  # type: ignore[assignment]

    @property
    def columns(self) -> ColumnStatistics:
        """Statistics of the columns of observations."""
        assert isinstance(self.obs_rms, ColumnStatistics)
        return self.obs_rms

    @property
    def scale(self) -> Floats:
        """What the columns of observations are divided by ``(columns,)``: 1 where nothing has varied yet."""
        return np.where(self.columns.varying, np.sqrt(self.columns.var + self.epsilon), 1.0)

    def _normalize_obs(self, obs: NDArray[Any], obs_rms: RunningMeanStd) -> NDArray[Any]:
        normalized = np.clip((obs - obs_rms.mean) / self.scale, -self.clip_obs, self.clip_obs)
        return np.where(self.columns.varying, normalized, 0.0)

    def _unnormalize_obs(self, obs: NDArray[Any], obs_rms: RunningMeanStd) -> NDArray[Any]:
        unnormalized: NDArray[Any] = obs * self.scale + obs_rms.mean
        return unnormalized


def without_steady_columns(policy: NetworkPolicy, varying: Mask) -> NetworkPolicy:
    """``policy`` with scale 1 and weights 0 for the columns that do not vary: whatever they read, it acts the same."""
    first = np.where(varying[:, None], policy.weights[0], np.float32(0.0))
    return replace(policy, scale=np.where(varying, policy.scale, 1.0), weights=(first, *policy.weights[1:]))
