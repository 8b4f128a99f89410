"""From a trained model to a policy file that numpy alone can evaluate, and back: a training that begins with such a policy."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, FlattenExtractor
from stable_baselines3.common.vec_env import VecNormalize
from stable_baselines3.td3.policies import TD3Policy
from torch import nn

from glbench.agents.network_policy import ACTIVATIONS, NetworkPolicy, read_policy
from glbench.agents.saved_policies import DAMAGED
from glbench.errors import TrainingError, refuse
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, task_card
from glbench.training.algorithms import algorithm_class
from glbench.training.card import CARD, POLICY, policy_in, to_toml
from glbench.training.constant_columns import without_constant_columns
from glbench.training.vec_env import Normalizer
from glbench.untrusted import reason_of

Output = Literal["clip", "tanh"]
_UNLIMITED = 1e30  # Clip of observations that are not normalised: none comes near it
_WEIGHT = 1e6  # Observations that a policy's statistics count for: they follow what is new within a training of the usual length


def load_model(file: Path, algorithm: str, normalization: Path | None) -> tuple[BaseAlgorithm, VecNormalize | None]:
    """A saved model and its normalisation: pickles, so load only what you trust. Raises ``TrainingError`` when one cannot be read."""
    for path in filter(None, (file, normalization)):
        if not path.is_file():
            msg = f"Cannot read the model: {path} is not a file. Give the model.zip that was saved, or a folder of glbench train."
            raise TrainingError(msg)
    try:
        model = algorithm_class(algorithm).load(file, device="cpu")
        if normalization is None:
            return model, None
        with normalization.open("rb") as opened:
            content = pickle.load(opened)
    except DAMAGED as error:
        msg = f"Cannot read the model {file} ({algorithm}) and its normalisation {normalization}: {reason_of(error)}."
        raise TrainingError(msg) from error
    if not isinstance(content, VecNormalize):
        refuse(f"{normalization} holds {type(content).__name__}, expected the VecNormalize that was saved with the model.", TrainingError)
    return model, content


def export_policy(
    model: BaseAlgorithm, normalization: VecNormalize | None, task: TaskSpec, about: dict[str, str | int | float]
) -> NetworkPolicy:
    """The deterministic policy of ``model``: mean action, without the noise of exploration.

    Raises ``TrainingError`` when its actor is no plain multilayer perceptron (recurrent, with state-dependent exploration, an unknown
    activation, a features extractor of its own), or the model is of another task.
    """
    layers, activation, output = actor_of(model)
    card = task_card(task)
    columns = len(card.observation_names)
    if layers[0].in_features != columns or layers[-1].out_features != len(card.actions):
        msg = (
            f"The model takes {layers[0].in_features} observations and gives {layers[-1].out_features} actions; "
            f"{task.id} has {columns} and {len(card.actions)}. Name the task that it was trained on with --task."
        )
        raise TrainingError(msg)
    mean, scale, clip = _normalization(normalization, columns)
    policy = NetworkPolicy(
        task_id=task.id, delta=task.uncertainty.delta, observation_names=card.observation_names, action_names=card.action_names,
        low=np.array([action.low for action in card.actions]), high=np.array([action.high for action in card.actions]), mean=mean,
        scale=scale, clip=clip, weights=tuple(layer.weight.detach().numpy().T.copy() for layer in layers),
        biases=tuple(layer.bias.detach().numpy().copy() for layer in layers), activation=activation, output=output, about=about,
    )  # fmt: skip
    if isinstance(normalization, Normalizer) and normalization.norm_obs:
        return without_constant_columns(policy, normalization.columns.varying)
    return policy


def export_model(file: Path, algorithm: str, normalization: Path | None, task: TaskSpec, folder: Path) -> None:
    """Write the policy of a saved model to ``folder`` with a card, so that the folder can be evaluated as an agent.

    Raises ``TrainingError`` when the model cannot be read or exported, or the folder holds another agent's card.
    """
    if (folder / CARD).exists():
        refuse(f"{folder} has a {CARD} already. Choose another folder with --out.", TrainingError)
    model, statistics = load_model(file, algorithm, normalization)
    policy = export_policy(model, statistics, task, {"algorithm": algorithm, "steps": model.num_timesteps})
    write_atomically(folder / POLICY, policy.to_bytes())
    card = {
        "title": f"{type(model).__name__} trained on {task.id}",
        "controller": "network",
        "settings": POLICY,
        "description": f"The policy of {file.name}, without the noise of exploration.",
        "made": "glbench export",
        "sources": [],
    }
    write_atomically(folder / CARD, to_toml(card))


def actor_of(model: BaseAlgorithm) -> tuple[list[nn.Linear], str, Output]:
    """Layers of an actor, their activation, and what is made of the last. Raises ``TrainingError`` when it is no plain perceptron."""
    policy = model.policy
    if type(policy).__name__.startswith("Recurrent"):
        refuse(f"{type(model).__name__} has a memory; only policies without one can be exported.", TrainingError)
    extractors = [module for module in policy.modules() if isinstance(module, BaseFeaturesExtractor)]
    if any(type(extractor) is not FlattenExtractor for extractor in extractors):
        names = ", ".join(sorted({type(extractor).__name__ for extractor in extractors}))
        refuse(f"The policy of {type(model).__name__} looks at its observations with {names}, which cannot be exported.", TrainingError)
    if isinstance(policy, ActorCriticPolicy) and not policy.use_sde:
        parts: list[nn.Module] = [*policy.mlp_extractor.policy_net, policy.action_net]
        return (*_layers(parts), "clip")
    actor: Any = getattr(policy, "actor", None)
    if isinstance(policy, TD3Policy):
        return (*_layers(list(actor.mu)[:-1]), "tanh")  # the tanh comes last
    if hasattr(actor, "latent_pi") and not actor.use_sde:
        return (*_layers([*actor.latent_pi, actor.mu]), "tanh")
    msg = f"The policy of {type(model).__name__} ({type(policy).__name__}) cannot be exported: only those like PPO's, SAC's and TD3's can."
    raise TrainingError(msg)


def _layers(parts: list[nn.Module]) -> tuple[list[nn.Linear], str]:
    linear = [part for part in parts if isinstance(part, nn.Linear)]
    between = [type(part).__name__ for part in parts if not isinstance(part, nn.Linear)]
    if len(set(between)) > 1 or not set(between) <= ACTIVATIONS.keys() or len(between) != len(linear) - 1:
        msg = f"An actor of {', '.join(type(part).__name__ for part in parts)} cannot be exported. Activations: {', '.join(ACTIVATIONS)}."
        raise TrainingError(msg)
    return linear, between[0] if between else "ReLU"


def _normalization(normalization: VecNormalize | None, columns: int) -> tuple[np.ndarray, np.ndarray, float]:
    if normalization is None or not normalization.norm_obs:
        return np.zeros(columns), np.ones(columns), _UNLIMITED
    statistics = normalization.obs_rms
    if not isinstance(statistics, RunningMeanStd):
        refuse("The normalisation is for several kinds of observations; the tasks of glbench have one.", TrainingError)
    return statistics.mean, np.sqrt(statistics.var + normalization.epsilon), float(normalization.clip_obs)


def begin_with(file: Path, model: BaseAlgorithm, normalization: Normalizer, task: TaskSpec) -> None:
    """Give ``model`` and ``normalization``, which are untrained, the actor and the statistics of the policy in ``file``.

    Raises ``SubmissionError`` when there is no policy in ``file``, and ``TrainingError`` when it is damaged, of another task's kind, or its
    network or normalisation is another than the settings ask for.
    """
    policy_in(file, task)
    policy = read_policy(file)
    layers, activation, output = actor_of(model)
    shapes = [(layer.in_features, layer.out_features) for layer in layers]
    policy_shapes = [matrix.shape for matrix in policy.weights]
    if (policy_shapes, activation, output) != (shapes, policy.activation, policy.output):
        msg = (
            f"The training cannot start from {file}: its actor has layers {_sizes(policy_shapes)} with {policy.activation} and output "
            f"'{policy.output}', the settings ask for {_sizes(shapes)} with {activation} and '{output}'. Change policy_kwargs."
        )
        raise TrainingError(msg)
    clip = float(normalization.clip_obs) if normalization.norm_obs else _UNLIMITED
    if policy.clip != clip:
        its, ours = (f"clipped at {one:g}" if one < _UNLIMITED else "not normalised" for one in (policy.clip, clip))
        msg = f"The training cannot start from {file}: its observations are {its}; with these settings they are {ours}. Change 'normalize'."
        raise TrainingError(msg)
    ratio = np.ones(shapes[0][0])
    if normalization.norm_obs:
        normalization.columns.take(policy.mean, policy.scale, normalization.epsilon, _WEIGHT)
        narrow = policy.scale**2 < normalization.epsilon  # scales that VecNormalize cannot have: the first layer makes up for them
        ratio = np.where(narrow, normalization.scale / policy.scale, 1.0)
    with torch.no_grad():
        for layer, matrix, bias in zip(layers, policy.weights, policy.biases, strict=True):
            layer.weight.copy_(torch.from_numpy(matrix.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias.copy()))
        layers[0].weight.mul_(torch.from_numpy(ratio.astype(np.float32)))


def _sizes(shapes: list[Any]) -> str:
    return " - ".join(map(str, [shapes[0][0], *(shape[1] for shape in shapes)]))
