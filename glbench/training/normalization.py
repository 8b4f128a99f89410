"""Normalisation of observations and rewards in training: ``VecNormalize``, but columns that do not vary keep their unit.

``VecNormalize`` divides a column by its standard deviation. Outdoor CO2 is 400 ppm throughout the shipped weather; its standard
deviation is 0.003 ppm, left over from how the running statistics begin, and with it a reading of 401 ppm is 350 standard deviations off.
Here a column is divided by its standard deviation once it has varied, and by 1 until then.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

Floats = NDArray[np.float64]
_STEADY = 1e-3


def varies(low: Floats, high: Floats) -> NDArray[np.bool_]:
    """Which columns vary: those whose values lie between ``low`` and ``high``, more than 0.001 of the larger magnitude apart."""
    mask: NDArray[np.bool_] = high - low > _STEADY * np.maximum(np.abs(low), np.abs(high))
    return mask


def steadied(mean: Floats, scale: Floats) -> Floats:
    """The ``scale`` of a policy's columns ``(columns,)``, with 1 where it is so small beside ``mean`` that they did not vary."""
    return np.where(varies(mean - scale, mean + scale), scale, 1.0)


class ColumnStatistics(RunningMeanStd):
    """Running mean and variance of the columns, and their lowest and highest values so far ``(columns,)``."""

    def __init__(self, columns: int) -> None:
        super().__init__(shape=(columns,))
        self.low: Floats = np.full(columns, np.inf)
        self.high: Floats = np.full(columns, -np.inf)

    def update(self, arr: NDArray[np.floating[Any]]) -> None:
        """Add observations ``(n, columns)``."""
        super().update(arr)
        self.low = np.minimum(self.low, arr.min(axis=0))
        self.high = np.maximum(self.high, arr.max(axis=0))

    def take(self, mean: Floats, scale: Floats, epsilon: float, count: float) -> None:
        """Go on from the mean and scale ``(columns,)`` of a policy as if they came from ``count`` observations."""
        scale = steadied(mean, scale)
        spread = np.where(scale == 1.0, 0.0, scale)  # 1 is what a column has that did not vary
        self.low, self.high = mean - spread, mean + spread
        self.mean, self.var, self.count = mean.copy(), np.maximum(scale**2 - epsilon, 0.0), count

    def scale(self, epsilon: float) -> Floats:
        """What the columns are divided by ``(columns,)``: standard deviation, or 1 where nothing has varied yet."""
        return np.where(varies(self.low, self.high), np.sqrt(self.var + epsilon), 1.0)


class Normalizer(VecNormalize):
    """``VecNormalize`` whose observations are divided by ``ColumnStatistics.scale``. Saved and loaded like it."""

    def __init__(self, env: VecEnv, **arguments: Any) -> None:
        super().__init__(env, **arguments)
        if self.norm_obs:
            assert env.observation_space.shape is not None
            self.obs_rms: ColumnStatistics = ColumnStatistics(env.observation_space.shape[0])

    @property
    def scale(self) -> Floats:
        """What the columns of observations are divided by ``(columns,)``."""
        return self.obs_rms.scale(self.epsilon)

    def _normalize_obs(self, obs: NDArray[Any], obs_rms: RunningMeanStd) -> NDArray[Any]:
        normalized: NDArray[Any] = np.clip((obs - obs_rms.mean) / self.scale, -self.clip_obs, self.clip_obs)
        return normalized

    def _unnormalize_obs(self, obs: NDArray[Any], obs_rms: RunningMeanStd) -> NDArray[Any]:
        unnormalized: NDArray[Any] = obs * self.scale + obs_rms.mean
        return unnormalized
