"""Greenhouses of several tasks as one batch for Stable-Baselines3, and what a policy that learnt in it does in one of the tasks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv

from glbench.agents.network_policy import Actor, NetworkPolicy
from glbench.errors import TrainingError, refuse
from glbench.tasks import TaskSpec, task_card
from glbench.training.constant_columns import without_constant_columns
from glbench.training.export import actor_of
from glbench.training.settings import TrainingSettings
from glbench.training.vec_env import Normalizer, TrainingVecEnv

CROP = "crop"  # Name of the column that says which crop grows
Reals = NDArray[np.floating[Any]]


class Greenhouses(TrainingVecEnv):
    """Greenhouses of a task whose actions are positions of controls, as ``Actor`` has them: 0 to 1, reached as fast as the task allows.

    The first episode of every row but the last is cut short, each at a different step, so that rollouts then cover all of the season.
    """

    def __init__(self, task: TaskSpec, settings: TrainingSettings) -> None:
        super().__init__(
            task, settings.n_envs, first_seed=settings.first_env_seed, kernel_preset=settings.kernel_preset, accrual=settings.accrual
        )
        self.change = largest_change(task)
        self.action_space = Box(0.0, 1.0, self.action_space.shape, np.float32)
        self._positions = np.zeros((self.num_envs, self.change.size))
        self._first_ends = task.steps * np.arange(1, self.num_envs) // self.num_envs
        self._step = 0

    def step_async(self, actions: Reals) -> None:
        moves = np.clip((np.clip(actions, 0.0, 1.0) - self._positions) / self.change, -1.0, 1.0)
        self._positions = np.clip(self._positions + self.change * moves, 0.0, 1.0)
        super().step_async(moves)

    def step_wait(self) -> Any:
        observations, rewards, ended, infos = super().step_wait()
        self._step += 1
        cut = np.append(self._first_ends == self._step, False) & ~ended
        for row in np.flatnonzero(cut).tolist():
            infos[row] = {"terminal_observation": observations[row].copy(), "TimeLimit.truncated": True}
        if cut.any():
            observations = self._begin(cut)
        self._positions[ended | cut] = 0.0
        return observations, rewards, ended | cut, infos


def largest_change(task: TaskSpec) -> NDArray[np.float64]:
    """How far each control moves in a step, of its range. Raises ``TrainingError`` where actions do not move controls."""
    if task.actuation.kind != "rate" or task.on_off:
        refuse(f"The actions of {task.id} do not move all controls by a share of their range.", TrainingError)
    return np.full(len(task.actions), task.actuation.max_change)


class Mixed(VecEnv):
    """Greenhouses of several tasks as one batch: columns by name, each task's normalised by its own statistics, 0 where it has none."""

    def __init__(self, parts: Sequence[Normalizer], columns: Sequence[tuple[str, ...]]) -> None:
        self.parts, self.names = parts, (*dict.fromkeys(name for names in columns for name in names), CROP)
        self.places = [[self.names.index(name) for name in names] for names in columns]
        ends = np.cumsum([part.num_envs for part in parts]).tolist()
        self.rows = [slice(end - part.num_envs, end) for part, end in zip(parts, ends, strict=True)]
        super().__init__(ends[-1], Box(-np.inf, np.inf, (len(self.names),), np.float32), parts[0].action_space)

    def union(self, number: int, observations: Reals) -> Reals:
        """Normalised observations of a task in the columns of all."""
        wide = np.zeros((len(observations), len(self.names)), np.float32)
        wide[:, self.places[number]], wide[:, -1] = observations, crop(number)
        return wide

    def reset(self) -> Any:
        return np.concatenate([self.union(number, np.asarray(part.reset())) for number, part in enumerate(self.parts)])

    def step_async(self, actions: Reals) -> None:
        for part, rows in zip(self.parts, self.rows, strict=True):
            part.step_async(actions[rows])

    def step_wait(self) -> Any:
        steps, infos = [part.step_wait() for part in self.parts], list[dict[str, Any]]()
        for number, step in enumerate(steps):
            for info in step[3]:
                if "terminal_observation" in info:
                    info["terminal_observation"] = self.union(number, info["terminal_observation"][None])[0]
                infos.append(info)
        seen = [self.union(number, np.asarray(step[0])) for number, step in enumerate(steps)]
        return np.concatenate(seen), *(np.concatenate([step[part] for step in steps]) for part in (1, 2)), infos

    def close(self) -> None:
        for part in self.parts:
            part.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [value for part in self.parts for value in part.get_attr(attr_name)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Not possible, as in ``TrainingVecEnv``, which says why."""
        self.parts[0].set_attr(attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Not possible, as in ``TrainingVecEnv``, which says why."""
        return self.parts[0].env_method(method_name)

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [value for part in self.parts for value in part.env_is_wrapped(wrapper_class)]

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        return [first for part in self.parts for first in part.seed(seed)]


def crop(number: int) -> float:
    """What the column of the crop reads in the task of that number; a policy for one crop sees that of the first."""
    return (-1.0, 1.0)[number]


def restricted(model: BaseAlgorithm, env: Mixed, number: int, task: TaskSpec, about: dict[str, str | int | float]) -> Actor:
    """What the model does in one task, as a policy of that task's columns alone."""
    layers, activation, output = actor_of(model)
    weights, biases = ([part.detach().numpy() for part in parts] for parts in zip(*((one.weight, one.bias) for one in layers), strict=True))
    first, statistics, card = weights[0].T, env.parts[number], task_card(task)
    network = NetworkPolicy(
        task_id=task.id, delta=task.uncertainty.delta, observation_names=card.observation_names, action_names=card.action_names,
        low=np.zeros(len(card.actions)), high=np.ones(len(card.actions)), mean=statistics.columns.mean.copy(), scale=statistics.scale,
        clip=float(statistics.clip_obs), weights=(first[env.places[number]].copy(), *(one.T.copy() for one in weights[1:])),
        biases=(biases[0] + np.float32(crop(number)) * first[-1], *(one.copy() for one in biases[1:])),
        activation=activation, output=output, about=about,
    )  # fmt: skip
    network = without_constant_columns(network, statistics.columns.varying)
    low, high = card.action_bounds
    return Actor(network, np.zeros(0, np.int64), np.zeros(0), largest_change(task), low, high)
