"""Algorithms by name or class path, their arguments checked before anything starts, and checkpoints of trainings with Stable-Baselines3.

A checkpoint is a folder in the training's own. A new one is written beside the old one and takes its place when it is complete, so that a
kill at any moment leaves a whole one. It holds Stable-Baselines3's own files, which are pickles: read only your own.
"""

from __future__ import annotations

import importlib
import inspect
import json
import random
from dataclasses import asdict
from hashlib import file_digest, sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.utils import LinearSchedule

from glbench.agents.saved_policies import DAMAGED
from glbench.errors import TrainingError, UnknownNameError, did_you_mean, refuse
from glbench.training.folder import MODEL, STATE, altered, replaced
from glbench.training.periodic_evaluation import History
from glbench.training.settings import LINEAR, OWN
from glbench.training.vec_env import Normalizer, TrainingVecEnv

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

    Raises ``UnknownNameError`` when there is no such algorithm, and ``TrainingError`` for a class of another kind.
    """
    path = SHORT.get(name.lower(), name)
    module, _, attribute = path.rpartition(".")
    if not module:
        names = [*SHORT, "sb3_contrib.RecurrentPPO", "stable_baselines3.TD3"]
        msg = f"There is no algorithm '{name}'.{did_you_mean(name, names)} Others are given by class path, as sb3_contrib.TQC."
        raise UnknownNameError(msg)
    try:
        kind = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        msg = f"The algorithm '{name}' cannot be imported: {error}. Is its package installed, and the path written as package.Class?"
        raise UnknownNameError(msg) from error
    if not (isinstance(kind, type) and issubclass(kind, BaseAlgorithm)):
        refuse(f"'{name}' is not an algorithm of Stable-Baselines3's kind (a subclass of BaseAlgorithm).", TrainingError)
    return kind


def make_model(settings: TrainingSettings, env: VecEnv, seed: int) -> BaseAlgorithm:
    """An untrained model, on the processor, seeded. Raises ``TrainingError`` for an argument that the algorithm lacks or refuses."""
    check_settings(settings)
    kind = algorithm_class(settings.algorithm)
    noise: dict[str, Any] = {}
    if settings.action_noise_std is not None:
        mean = np.zeros(env.action_space.shape or ())
        noise = {"action_noise": NormalActionNoise(mean, np.full_like(mean, settings.action_noise_std))}
    try:
        policy = policy_arguments(settings.policy_kwargs)
        return kind(settings.policy, env, seed=seed, device="cpu", verbose=0, policy_kwargs=policy, **noise, **_arguments(settings))
    except (TypeError, ValueError, AssertionError) as error:
        refuse(f"{kind.__name__} refuses its settings: {error}", TrainingError, error)


def policy_arguments(settings: dict[str, Any]) -> dict[str, Any]:
    """Arguments of the policy, with classes for names. Raises ``UnknownNameError`` when PyTorch has no such function or optimiser."""
    arguments = dict(settings)
    for key, home in (("activation_fn", torch.nn), ("optimizer_class", torch.optim)):
        name = arguments.get(key)
        if isinstance(name, str):
            if not hasattr(home, name):
                near = did_you_mean(name, [item for item in vars(home) if item[0].isupper()])
                refuse(f"'{key}: {name}': {home.__name__} has no {name}.{near}", UnknownNameError)
            arguments[key] = getattr(home, name)
    return arguments


def check_settings(settings: TrainingSettings) -> None:
    """Check what can be checked without an environment: the algorithm, names and schedules of its arguments, its policy's classes.

    Raises ``UnknownNameError`` when there is no such algorithm, activation function or optimiser, and ``TrainingError`` when an argument is
    unknown to the algorithm, is set by glbench, or is no schedule.
    """
    kind = algorithm_class(settings.algorithm)
    names = [name for name in inspect.signature(kind.__init__).parameters if name not in _NO_SETTINGS]
    for name in settings.hyperparameters:
        if name in _SET_BY_GLBENCH:
            refuse(f"glbench sets '{name}' of {kind.__name__}: {_SET_BY_GLBENCH[name]}. Remove it from the settings.", TrainingError)
        if name not in names:
            refuse(f"{kind.__name__} has no setting '{name}'.{did_you_mean(name, [*names, *sorted(OWN)])}", TrainingError)
    if settings.action_noise_std is not None and not issubclass(kind, OffPolicyAlgorithm):
        refuse(f"{kind.__name__} takes no action noise; remove 'action_noise_std'.", TrainingError)
    policy_arguments(settings.policy_kwargs)
    _arguments(settings)


def _arguments(settings: TrainingSettings) -> dict[str, Any]:
    arguments = {name: _schedule(value) for name, value in settings.hyperparameters.items()}
    if isinstance(arguments.get("train_freq"), list):
        arguments["train_freq"] = tuple(arguments["train_freq"])  # [1, episode], as Stable-Baselines3 wants it
    return arguments


def rollout_steps(settings: TrainingSettings, season: int) -> int:
    """Environment steps between two looks at whether a training has made enough: it ends after a whole number of these.

    ``season`` is the number of steps of an episode. 1 for algorithms that are neither on-policy nor off-policy.
    """
    kind = algorithm_class(settings.algorithm)
    parameters = inspect.signature(kind.__init__).parameters

    def argument(name: str) -> Any:
        return settings.hyperparameters.get(name, parameters[name].default if name in parameters else 1)

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
        refuse(f"'{value}' is no schedule: write {LINEAR}3e-4 for one from 3e-4 linearly to 0.", TrainingError, error)


NORMALIZATION, BUFFER = "vecnormalize.pkl", "replay_buffer.pkl"
_ARRAYS = "state.npz"


def save_checkpoint(
    folder: Path, model: BaseAlgorithm, env: TrainingVecEnv, normalization: Normalizer, history: History, identity: dict[str, Any]
) -> None:
    """Replace the checkpoint in ``folder`` by one of this moment, which must be the start of a rollout."""
    with replaced(folder) as new:
        model.save(new / MODEL)
        normalization.save(str(new / NORMALIZATION))
        if isinstance(model, OffPolicyAlgorithm):
            model.save_replay_buffer(new / BUFFER)
        name, keys, position, has_gauss, cached = np.random.get_state()  # noqa: NPY002 - Stable-Baselines3 draws from it
        arrays: dict[str, Any] = {
            **{f"env_{key}": value for key, value in env.state().items()},
            **{f"memory_{i}": part.numpy() for i, part in enumerate(_memory(model))},
            "returns": normalization.returns,
            "torch": torch.get_rng_state().numpy(),
            "numpy_keys": keys,
        }
        with (new / _ARRAYS).open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        version, internal, gauss = random.getstate()
        state: dict[str, Any] = {
            "identity": identity,
            "history": asdict(history),
            "numpy": [name, position, has_gauss, cached],
            "python": [version, list(internal), gauss],
            "random_actions": model.action_space.np_random.bit_generator.state,
        }
        state["digest"] = _digest(new, state)
        (new / STATE).write_text(json.dumps(state), encoding="utf-8")


def load_checkpoint(
    folder: Path, algorithm: str, env: TrainingVecEnv, identity: dict[str, Any]
) -> tuple[BaseAlgorithm, Normalizer, History]:
    """Model, normalisation and history of a checkpoint, with environment and generators set back to its moment.

    Raises ``TrainingError`` when the checkpoint is of another training, cannot be read, or is not as it was written.
    """
    try:
        state = json.loads((folder / STATE).read_text(encoding="utf-8"))
        stored = state["identity"]
        different = sorted(key for key in {*stored, *identity} if stored.get(key) != identity.get(key))
        if different:
            pairs = "; ".join(f"{key}: {stored.get(key)!r} there, {identity.get(key)!r} now" for key in different)
            msg = f"{folder.parent} holds another training ({pairs}). Choose another folder with --out, or the settings it was begun with."
            raise TrainingError(msg)
        if state.pop("digest", None) != _digest(folder, state):
            raise altered(folder)
        with np.load(folder / _ARRAYS, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        normalization = Normalizer.load(str(folder / NORMALIZATION), env)
        assert isinstance(normalization, Normalizer)
        model = algorithm_class(algorithm).load(folder / MODEL, env=normalization, device="cpu", force_reset=False)
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(folder / BUFFER, truncate_last_traj=False)
        env.restore({name.removeprefix("env_"): value for name, value in arrays.items() if name.startswith("env_")})
        for number, place in enumerate(_memory(model)):
            place.copy_(torch.from_numpy(arrays[f"memory_{number}"]))
        normalization.returns = arrays["returns"]
        torch.set_rng_state(torch.from_numpy(arrays["torch"]))
        name, position, has_gauss, cached = state["numpy"]
        np.random.set_state((name, arrays["numpy_keys"], position, has_gauss, cached))  # noqa: NPY002
        version, internal, gauss = state["python"]
        random.setstate((version, tuple(internal), gauss))
        model.action_space.np_random.bit_generator.state = state["random_actions"]
        history = History.from_dict(state["history"])
    except DAMAGED as error:
        refuse(f"The checkpoint {folder} cannot be read: {error}. Remove the folder to start the training over.", TrainingError, error)
    return model, normalization, history


def _digest(folder: Path, state: dict[str, Any]) -> str:
    """SHA-256 (hex) over the files of a checkpoint and its state, without the digest."""
    digest = sha256(json.dumps(state, sort_keys=True).encode())
    for file in (folder / name for name in (MODEL, NORMALIZATION, BUFFER, _ARRAYS)):
        if file.exists():  # the replay buffer is there only for algorithms that have one
            with file.open("rb") as opened:
                digest.update(f"{file.name} {file_digest(opened, 'sha256').hexdigest()}\n".encode())
    return digest.hexdigest()


def _memory(model: BaseAlgorithm) -> list[torch.Tensor]:
    """What a recurrent policy remembers between two rollouts; Stable-Baselines3 does not save it."""
    states = getattr(model, "_last_lstm_states", None)
    return [] if states is None else [*states.pi, *states.vf]
