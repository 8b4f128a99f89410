"""Beginning with a trained policy instead of random weights.

The policy file gives the actor and the statistics of the observations; what judges actions (critics) and explores begins anew.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from stable_baselines3.common.base_class import BaseAlgorithm

from glbench.agents.network_policy import NetworkPolicy, read_policy
from glbench.errors import TrainingError
from glbench.tasks import task_card
from glbench.training.card import CARD, read_card
from glbench.training.checkpoint import DAMAGED
from glbench.training.export import actor_of
from glbench.training.normalization import Normalizer

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

_WEIGHT = 1e6
"""Observations that a policy's statistics count for: they follow what is new within a training of the usual length."""


def begin_with(file: Path, model: BaseAlgorithm, normalization: Normalizer, task: TaskSpec) -> None:
    """Give ``model`` and ``normalization``, which are untrained, the actor and the statistics of the policy in ``file``.

    Raises
    ------
    SubmissionError
        When there is no policy in ``file``.
    TrainingError
        When it is damaged, of another task's kind, or its network is another than the settings ask for.
    """
    policy = policy_in(file, task)
    layers, activation, output = actor_of(model)
    shapes = [(layer.in_features, layer.out_features) for layer in layers]
    found = [matrix.shape for matrix in policy.weights]
    if (shapes, activation, output) != (found, policy.activation, policy.output):
        msg = (
            f"The training cannot start from {file}: its actor has layers {_sizes(found)} with {policy.activation} and output "
            f"'{policy.output}', the settings ask for {_sizes(shapes)} with {activation} and '{output}'. Change policy_kwargs."
        )
        raise TrainingError(msg)
    with torch.no_grad():
        for layer, matrix, bias in zip(layers, policy.weights, policy.biases, strict=True):
            layer.weight.copy_(torch.from_numpy(matrix.T.copy()))
            layer.bias.copy_(torch.from_numpy(bias.copy()))
    if normalization.norm_obs:
        normalization.columns.take(policy.mean, policy.scale, normalization.epsilon, _WEIGHT)


def policy_in(file: Path, task: TaskSpec) -> NetworkPolicy:
    """The policy in ``file``, which is to begin with on ``task``. Errors as for ``begin_with``."""
    try:
        policy = read_policy(file)
    except DAMAGED as error:
        msg = f"The policy {file} cannot be read: {error}. Export it again."
        raise TrainingError(msg) from error
    reason = policy.why_not(task_card(task))
    if reason is not None:
        msg = f"There is no starting from {file}: {reason}."
        raise TrainingError(msg)
    return policy


def start_of(file: Path) -> dict[str, Any]:
    """What a card says of the policy that a training starts from: file, digest, and the steps and seconds spent on it, if known.

    What it started from itself counts as well.
    """
    content: dict[str, Any] = {"file": file.name, "digest": sha256(file.read_bytes()).hexdigest()}
    # A training's own folder, or a baseline's, which keeps policies and cards apart.
    for place in (file.with_name(CARD), file.parent.parent / "training" / f"{file.stem}.toml"):
        try:
            card = read_card(place)
        except TrainingError:  # the card of something else, such as an exported model
            continue
        if card is not None and "wall_seconds" in card:
            before = card.get("start", {})
            steps = card["training"]["steps"] + before.get("steps", 0)
            seconds = card["wall_seconds"]["total"] + before.get("wall_seconds", 0.0)
            return content | {"steps": steps, "wall_seconds": round(seconds, 1)}
    return content


def _sizes(shapes: list[Any]) -> str:
    return " - ".join(map(str, [shapes[0][0], *(shape[1] for shape in shapes)]))
