"""The state of a training on disk: what it takes to go on as if it had never stopped.

A checkpoint is a folder. A new one is written beside the old one and takes its place when it is complete, so that a kill
at any moment leaves a whole one. It holds Stable-Baselines3's own files, which are pickles: read only your own.
"""

from __future__ import annotations

import json
import pickle
import random
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from glbench.errors import TrainingError
from glbench.training.algorithms import algorithm_class
from glbench.training.normalization import Normalizer
from glbench.training.progress import TimeAccount
from glbench.training.vec_env import TrainingVecEnv

MODEL, NORMALIZATION, BUFFER = "model.zip", "vecnormalize.pkl", "replay_buffer.pkl"
_STATE, _ARRAYS = "state.json", "state.npz"
DAMAGED = (
    OSError, ValueError, KeyError, EOFError, AttributeError, TypeError, IndexError, AssertionError, RuntimeError, ImportError,
    pickle.UnpicklingError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading a damaged file of Stable-Baselines3 or numpy may end in."""


@dataclass
class History:
    """What a training has been through: its learning curve, its best evaluation, its time."""

    curve: list[dict[str, float]] = field(default_factory=list)
    best_reward: float = float("-inf")
    best_steps: int = 0
    next_evaluation: int = 0
    ends: list[int] = field(default_factory=list)
    """Steps at which the training was finished, the last end included."""
    sessions: list[str] = field(default_factory=list)
    """With which versions it went on, and from which step, wherever they changed."""
    time: TimeAccount = field(default_factory=TimeAccount)

    @property
    def last_reward(self) -> float:
        """Return of the last evaluation."""
        return self.curve[-1]["reward"]


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
        (new / _STATE).write_text(json.dumps(state), encoding="utf-8")


@contextmanager
def replaced(folder: Path) -> Iterator[Path]:
    """A new folder to fill, which takes the place of ``folder`` when it is complete; a kill in between leaves it as ``.old``."""
    new, old = _beside(folder)
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    yield new
    if folder.exists():
        shutil.rmtree(old, ignore_errors=True)
        folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def _beside(folder: Path) -> tuple[Path, Path]:
    return folder.with_name(folder.name + ".new"), folder.with_name(folder.name + ".old")


def find_checkpoint(folder: Path) -> Path | None:
    """The newest complete checkpoint of ``folder``, also when a kill came between the two renames."""
    for candidate in (folder, *_beside(folder)):  # its state is written last
        if (candidate / _STATE).is_file():
            return candidate
    return None


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
        state = json.loads((folder / _STATE).read_text(encoding="utf-8"))
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
        past = dict(state["history"])
        history = History(**{**past, "time": TimeAccount(**past["time"])})
    except DAMAGED as error:
        msg = f"The checkpoint {folder} cannot be read: {error}. Remove the folder to begin the training anew."
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


def altered(place: Path) -> TrainingError:
    """What to raise when the state in ``place`` is not as it was written."""
    msg = f"{place} is damaged or was changed: its content does not match its digest. Restore it from a copy, or remove it to begin anew."
    return TrainingError(msg)


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
