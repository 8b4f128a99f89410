"""The state from which a training with Stable-Baselines3 continues: a folder in the training's own.

A new one is written beside the old one and takes its place when it is complete, so that a kill
at any moment leaves a whole one. It holds Stable-Baselines3's own files, which are pickles: read only your own.
"""

from __future__ import annotations

import json
import random
from dataclasses import asdict
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from glbench.errors import TrainingError
from glbench.training.algorithms import algorithm_class
from glbench.training.folder import DAMAGED, MODEL, STATE, altered, replaced
from glbench.training.probe import History
from glbench.training.vec_env import Normalizer, TrainingVecEnv

NORMALIZATION, BUFFER = "vecnormalize.pkl", "replay_buffer.pkl"
_ARRAYS = "state.npz"


def save_checkpoint(
    folder: Path,
    model: BaseAlgorithm,
    env: TrainingVecEnv,
    normalization: Normalizer,
    history: History,
    identity: dict[str, Any],
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

    Raises
    ------
    TrainingError
        When the checkpoint is of another training, cannot be read, or is not as it was written.
    """
    try:
        state = json.loads((folder / STATE).read_text(encoding="utf-8"))
        _same_training(folder, state["identity"], identity)
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
        _remember(model, [arrays[f"memory_{i}"] for i in range(len(_memory(model)))])
        normalization.returns = arrays["returns"]
        torch.set_rng_state(torch.from_numpy(arrays["torch"]))
        name, position, has_gauss, cached = state["numpy"]
        np.random.set_state((name, arrays["numpy_keys"], position, has_gauss, cached))  # noqa: NPY002
        version, internal, gauss = state["python"]
        random.setstate((version, tuple(internal), gauss))
        model.action_space.np_random.bit_generator.state = state["random_actions"]
        history = History.from_dict(state["history"])
    except DAMAGED as error:
        msg = f"The checkpoint {folder} cannot be read: {error}. Remove the folder to start the training over."
        raise TrainingError(msg) from error
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


def _remember(model: BaseAlgorithm, memory: list[Any]) -> None:
    for place, values in zip(_memory(model), memory, strict=True):
        place.copy_(torch.from_numpy(values))


def _same_training(folder: Path, found: dict[str, Any], wanted: dict[str, Any]) -> None:
    different = sorted(key for key in {*found, *wanted} if found.get(key) != wanted.get(key))
    if different:
        pairs = "; ".join(f"{key}: {found.get(key)!r} there, {wanted.get(key)!r} now" for key in different)
        msg = f"{folder.parent} holds another training ({pairs}). Choose another folder with --out, or the settings it was begun with."
        raise TrainingError(msg)
