"""Algorithms by name or class path, and their arguments checked before anything is started."""

from __future__ import annotations

import importlib
import inspect
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.utils import LinearSchedule

from glbench.errors import TrainingError, UnknownNameError, did_you_mean
from glbench.training.settings import LINEAR, OWN

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

    from glbench.training.settings import TrainingSettings

SHORT = {"ppo": "stable_baselines3.PPO", "sac": "stable_baselines3.SAC"}
_SET_BY_GLBENCH = {
    "env": "it is the task's",
    "seed": "it is given with --seed, and in a search with its own 'seed:'",
    "device": "agents are trained on the processor",
    "verbose": "glbench shows the progress",
    "tensorboard_log": "it is given with --tensorboard",
    "action_noise": "it is made from 'action_noise_std'",
}
"""Arguments of algorithms that glbench gives, and why."""
_NO_SETTINGS = ("self", "policy", "policy_kwargs", "_init_setup_model", *_SET_BY_GLBENCH)


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """Class of ``ppo``, ``sac`` or a class path such as ``sb3_contrib.RecurrentPPO``.

    Raises
    ------
    UnknownNameError
        When there is no such algorithm.
    TrainingError
        When the class is not an algorithm of Stable-Baselines3's kind.
    """
    path = SHORT.get(name.lower(), name)
    module, _, attribute = path.rpartition(".")
    if not module:
        known = [*SHORT, "sb3_contrib.RecurrentPPO", "stable_baselines3.TD3"]
        msg = f"There is no algorithm '{name}'.{did_you_mean(name, known)} Others are given by class path, as sb3_contrib.TQC."
        raise UnknownNameError(msg)
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        msg = f"The algorithm '{name}' cannot be imported: {error}. Is its package installed, and the path written as package.Class?"
        raise UnknownNameError(msg) from error
    if not (isinstance(found, type) and issubclass(found, BaseAlgorithm)):
        msg = f"'{name}' is not an algorithm of Stable-Baselines3's kind (a subclass of BaseAlgorithm)."
        raise TrainingError(msg)
    return found


def short_name(algorithm: str) -> str:
    """``ppo`` for ``PPO`` and ``stable_baselines3.PPO``, ``RecurrentPPO`` for ``sb3_contrib.RecurrentPPO``."""
    name = algorithm.rpartition(".")[2]
    return name.lower() if name.lower() in SHORT else name


def make_model(settings: TrainingSettings, env: VecEnv, seed: int, tensorboard: str | None) -> BaseAlgorithm:
    """An untrained model of the settings, on the processor, seeded.

    Raises
    ------
    TrainingError
        When an argument is unknown to the algorithm, or refused by it.
    """
    check_settings(settings)
    kind = algorithm_class(settings.algorithm)
    try:
        return kind(
            settings.policy,
            env,
            seed=seed,
            device="cpu",
            verbose=0,
            tensorboard_log=tensorboard,
            policy_kwargs=policy_arguments(settings.policy_kwargs),
            **_noise(settings, env),
            **_arguments(settings),
        )
    except (TypeError, ValueError, AssertionError) as error:
        msg = f"{kind.__name__} refuses its settings: {error}"
        raise TrainingError(msg) from error


def policy_arguments(given: dict[str, Any]) -> dict[str, Any]:
    """Arguments of the policy with classes in the place of their names.

    Raises
    ------
    UnknownNameError
        When PyTorch has no activation function or optimiser of that name.
    """
    arguments = dict(given)
    for key, home in (("activation_fn", torch.nn), ("optimizer_class", torch.optim)):
        name = arguments.get(key)
        if isinstance(name, str):
            if not hasattr(home, name):
                near = did_you_mean(name, [item for item in vars(home) if item[0].isupper()])
                msg = f"'{key}: {name}': {home.__name__} has no {name}.{near}"
                raise UnknownNameError(msg)
            arguments[key] = getattr(home, name)
    return arguments


def check_settings(settings: TrainingSettings) -> None:
    """Check what can be checked without an environment: the algorithm, names and schedules of its arguments, its policy's classes.

    Raises
    ------
    UnknownNameError
        When there is no such algorithm, activation function or optimiser.
    TrainingError
        When an argument is unknown to the algorithm, is set by glbench, or is no schedule.
    """
    kind = algorithm_class(settings.algorithm)
    known = [name for name in inspect.signature(kind.__init__).parameters if name not in _NO_SETTINGS]
    for name in settings.hyperparameters:
        if name in _SET_BY_GLBENCH:
            msg = f"glbench sets '{name}' of {kind.__name__}: {_SET_BY_GLBENCH[name]}. Remove it from the settings."
            raise TrainingError(msg)
        if name not in known:
            msg = f"{kind.__name__} has no setting '{name}'.{did_you_mean(name, [*known, *sorted(OWN)])}"
            raise TrainingError(msg)
    if settings.action_noise_std is not None and not issubclass(kind, OffPolicyAlgorithm):
        msg = f"{kind.__name__} takes no action noise; remove 'action_noise_std'."
        raise TrainingError(msg)
    policy_arguments(settings.policy_kwargs)
    _arguments(settings)


def _arguments(settings: TrainingSettings) -> dict[str, Any]:
    arguments = {name: _schedule(value) for name, value in settings.hyperparameters.items()}
    if isinstance(arguments.get("train_freq"), list):
        arguments["train_freq"] = tuple(arguments["train_freq"])  # [1, episode], as Stable-Baselines3 wants it
    return arguments


def _noise(settings: TrainingSettings, env: VecEnv) -> dict[str, Any]:
    if settings.action_noise_std is None:
        return {}
    mean = np.zeros(env.action_space.shape or ())
    return {"action_noise": NormalActionNoise(mean, np.full_like(mean, settings.action_noise_std))}


def rollout_steps(settings: TrainingSettings, season: int) -> int:
    """Environment steps between two looks at whether a training has made enough: it ends after a whole number of these.

    ``season`` is the number of steps of an episode. 1 for algorithms that are neither on-policy nor off-policy.
    """
    kind = algorithm_class(settings.algorithm)
    parameters = inspect.signature(kind.__init__).parameters

    def argument(name: str) -> Any:
        default = parameters[name].default if name in parameters else 1
        return settings.hyperparameters.get(name, default)

    if issubclass(kind, OnPolicyAlgorithm):
        return int(argument("n_steps")) * settings.n_envs
    if issubclass(kind, OffPolicyAlgorithm):
        frequency = argument("train_freq")
        many, unit = frequency if isinstance(frequency, list | tuple) else (frequency, "step")
        return int(many) * settings.n_envs * (season if unit == "episode" else 1)
    return 1


def steps_to_make(settings: TrainingSettings, season: int) -> int:
    """Environment steps after which a training ends: ``n_timesteps``, rounded up to whole rollouts."""
    rollout = rollout_steps(settings, season)
    return -(-settings.n_timesteps // rollout) * rollout


def _schedule(value: Any) -> Any:
    """``lin_3e-4`` as a schedule: from that number at the start linearly to 0 at the end."""
    if not (isinstance(value, str) and value.startswith(LINEAR)):
        return value
    try:
        return LinearSchedule(float(value.removeprefix(LINEAR)), 0.0, 1.0)
    except ValueError as error:
        msg = f"'{value}' is no schedule: write {LINEAR}3e-4 for one from 3e-4 linearly to 0."
        raise TrainingError(msg) from error
