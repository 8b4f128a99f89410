"""The vector environment of glbench as Stable-Baselines3 wants it, and the normalisation of what it returns.

``VecNormalize`` divides a column by its standard deviation. Outdoor CO2 is 400 ppm throughout the shipped weather; its standard
deviation is 0.003 ppm, left over from how the running statistics begin, and a reading of 401 ppm is then 350 standard deviations off: more
than any policy has learnt to stand. Here a column is divided by 1, and shown as 0 whatever it reads, until it has varied.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from glbench.arrays import Floats
from glbench.env import GreenhouseVectorEnv, Snapshot
from glbench.env.kernels import check_kernel
from glbench.env.spaces import task_of_environment
from glbench.errors import GlbenchError, refuse, whole_number
from glbench.kernel import make_kernel
from glbench.tasks import TaskSpec
from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.training.constant_columns import Mask, varies
from glbench.training.settings import Accrual

_SEEDS, _SEEDS_APART = 10_000, 1_000_000
"""Upper limit of ``seed`` in ``make_vec_env``, below the seeds of evaluations during a training, and the distance of first episodes."""


class TrainingVecEnv(VecEnv):
    """``n_envs`` greenhouses of one task, stepped by one call of the kernel.

    The season's end is the end of the task, not a time limit: an episode ends with ``done`` and without
    ``TimeLimit.truncated``, so that algorithms do not bootstrap over it. The last observation of an episode is in
    ``info["terminal_observation"]``, its sums of reward, EPI and penalty in ``info["episode"]``.

    Episode j of row i has the seed ``first_seed + j n_envs + i``, both counted from 0. The algorithm's own seed has no part in it. Raises
    ``TrainingError`` when the model has no state of the name in ``accrual``.

    ``first_seed`` is that of row 0's first episode; from ``FIRST_TRAINING_SEED`` on, no task is scored with any of them. ``kernel_preset``
    is ``"fast"`` (for training) or ``"reference"`` (what scores are made with). ``workers`` cores share the rows, to the same bits.
    ``accrual`` is added to the rewards, but not to the sums of episodes; ``None`` for nothing.
    """

    def __init__(
        self,
        task: TaskSpec,
        n_envs: int,
        *,
        first_seed: int = FIRST_TRAINING_SEED,
        kernel_preset: str = "fast",
        workers: int = 1,
        accrual: Accrual | None = None,
    ) -> None:
        self._prices, self._stored = ((), []) if accrual is None else (accrual.prices, accrual.places(task))
        kernel = make_kernel(task.model_value, task.step_seconds, preset=kernel_preset, workers=workers)
        self.environment = GreenhouseVectorEnv(task, n_envs, kernel=kernel, autoreset_mode="Disabled")
        self.first_seed = first_seed
        self.simulator_seconds = 0.0
        """Wall time [s] spent in the simulation so far."""
        self._episodes = np.zeros(n_envs, dtype=np.int64)  # episodes of each row
        self._sums = np.zeros((3, n_envs))
        self._lengths = np.zeros(n_envs, dtype=np.int64)
        self._actions: NDArray[np.floating[Any]] = np.zeros(self.environment.action_space.shape or (), dtype=np.float32)
        super().__init__(n_envs, self.environment.single_observation_space, self.environment.single_action_space)

    def reset(self) -> NDArray[np.float32]:
        """First observations ``(n_envs, columns)`` of a new episode in every row."""
        return self._begin(np.ones(self.num_envs, dtype=np.bool_))

    def step_async(self, actions: NDArray[np.floating[Any]]) -> None:
        """Keep the actions for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Take the step: observations, rewards, whether episodes ended, infos."""
        began, before = time.perf_counter(), self.environment.simulation.x[:, self._stored]
        observations, rewards, terminated, _, info = self.environment.step(self._actions)
        self.simulator_seconds += time.perf_counter() - began
        paid = rewards
        if self._prices:
            paid = rewards + ((self.environment.simulation.x[:, self._stored] - before) * self._prices).sum(axis=1)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._sums += (rewards, info["epi"], info["penalty"])
        self._lengths += 1
        if terminated.any():
            for row in np.flatnonzero(terminated).tolist():
                reward, epi, penalty = self._sums[:, row].tolist()
                episode = {"r": reward, "l": int(self._lengths[row]), "epi": epi, "penalty": penalty}
                infos[row] = {"terminal_observation": observations[row].copy(), "TimeLimit.truncated": False, "episode": episode}
            observations = self._begin(terminated)
        return observations, paid.astype(np.float32), terminated, infos

    def _begin(self, rows: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Begin an episode in ``rows``, a mask; observations of all rows."""
        seeds = self.first_seed + self._episodes * self.num_envs + np.arange(self.num_envs)
        self._episodes[rows] += 1
        self._sums[:, rows] = 0.0
        self._lengths[rows] = 0
        observations, _ = self.environment.reset(seed=seeds.tolist(), options={"reset_mask": rows})
        return observations

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything that the rest of the episodes depends on, as arrays."""
        packed = np.frombuffer(self.environment.snapshot().to_bytes(), dtype=np.uint8)
        return {
            "snapshot": packed, "sums": self._sums.copy(), "lengths": self._lengths.copy(), "begun": self._episodes.copy(),
        }  # fmt: skip

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Continue from ``state()``, in this process or another."""
        self.environment.restore(Snapshot.from_bytes(state["snapshot"].tobytes()))
        self._sums[:] = state["sums"]
        self._lengths[:] = state["lengths"]
        self._episodes[:] = state["begun"]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seeds of the first episodes. They come from ``first_seed``, whatever the algorithm asks for."""
        return [self.first_seed + row for row in range(self.num_envs)]

    def close(self) -> None:
        """Release the environment."""
        self.environment.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute, once for each row asked for."""
        return [None if attr_name == "render_mode" else getattr(self.environment, attr_name)] * self._count(indices)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not possible: rows are no environments of their own."""
        msg = f"The greenhouses of a batch have no attributes of their own; {attr_name!r} cannot be set. Change the task instead."
        raise AttributeError(msg)

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **keywords: Any) -> list[Any]:
        """Not possible: rows are no environments of their own."""
        msg = f"The greenhouses of a batch have no methods of their own; {method_name!r} cannot be called. Use `environment`, the batch."
        raise AttributeError(msg)

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether the class is ``Monitor``, whose episode sums the infos contain; rows are not environments that anything could wrap."""
        return [wrapper_class is Monitor] * self._count(indices)

    def _count(self, indices: Any) -> int:
        return len(list(self._get_indices(indices)))


def make_vec_env(
    task: TaskSpec | str,
    n_envs: int = 64,
    *,
    seed: int = 0,
    kernel: str = "fast",
    workers: int = 1,
    split: str | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> TrainingVecEnv:
    """``n_envs`` greenhouses of a task as one ``VecEnv``, for scripts of your own with Stable-Baselines3.

    It takes the place of Stable-Baselines3's own ``make_vec_env``, which steps its environments one after another; here one call of
    the kernel steps all of them. Infos of ended episodes contain what a ``Monitor`` adds, so that none is needed. Raises ``GlbenchError``
    for an unknown task, split or preset, for impossible numbers, and for a task without a training split where none is named.

    ``task`` is an id (with or without Gymnasium's ``glbench:`` before it), the path of a task file, or the task itself. ``seed`` selects
    the scenarios: episode j of greenhouse i, both counted from 0, has the seed 10,000,000,000 + 1,000,000 ``seed`` + j ``n_envs`` + i. No
    task is scored with any of them. The algorithm's own seed has no effect on this. ``kernel`` is ``"fast"`` or ``"standard"`` for
    training, or ``"reference"``, which scores are computed with. ``workers`` cores share the greenhouses, to the same bits. ``split`` and
    ``overrides`` are as for ``glbench.env.GreenhouseEnv``; the default is the training split.
    """
    if not 0 <= whole_number(seed, "The seed") < _SEEDS:
        refuse(f"The seed must be a whole number from 0 to {_SEEDS - 1:,}; got {seed}.", GlbenchError)
    named = task.removeprefix("glbench:") if isinstance(task, str) else task
    spec = task_of_environment(named, split, overrides)
    if split is None:
        spec.check_training()
    check_kernel(kernel, spec)
    first_seed = FIRST_TRAINING_SEED + _SEEDS_APART * seed
    return TrainingVecEnv(spec, n_envs, first_seed=first_seed, kernel_preset=kernel, workers=workers)


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
        return np.where(self.columns.varying, np.clip((obs - obs_rms.mean) / self.scale, -self.clip_obs, self.clip_obs), 0.0)

    def _unnormalize_obs(self, obs: NDArray[Any], obs_rms: RunningMeanStd) -> NDArray[Any]:
        unnormalized: NDArray[Any] = obs * self.scale + obs_rms.mean
        return unnormalized
