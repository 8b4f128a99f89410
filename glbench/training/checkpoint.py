"""The folder of a training or of a search: who may work in it, what is left untouched, and the state from which a training goes on.

A checkpoint is a folder in it. A new one is written beside the old one and takes its place when it is complete, so that a kill
at any moment leaves a whole one. It holds Stable-Baselines3's own files, which are pickles: read only your own.
"""

from __future__ import annotations

import json
import pickle
import random
import shutil
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

from glbench.errors import TrainingError
from glbench.resources import write_atomically
from glbench.training.algorithms import algorithm_class
from glbench.training.card import CARD, POLICY, read_card
from glbench.training.probe import History
from glbench.training.vec_env import Normalizer, TrainingVecEnv

CHECKPOINT, SEARCH, LEARNER, SETTINGS = "checkpoint", "search.npz", "learner.npz", "settings.yml"
"""State of a training, of a search, of a training with the compiled PPO, and the settings of any of them."""
_LOCK = ".lock"
MODEL, NORMALIZATION, BUFFER = "model.zip", "vecnormalize.pkl", "replay_buffer.pkl"
_STATE, _ARRAYS = "state.json", "state.npz"
DAMAGED = (
    OSError, ValueError, KeyError, EOFError, AttributeError, TypeError, IndexError, AssertionError, RuntimeError, ImportError,
    pickle.UnpicklingError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What reading a damaged file of Stable-Baselines3 or numpy may end in."""


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Make ``folder`` where it is missing, and keep other processes out of it until the block is left.

    Raises
    ------
    TrainingError
        When one is at work there, or the disk refuses to be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / _LOCK).open("w", encoding="utf-8") as lock:
            _take(lock.fileno(), folder)
            yield
    except OSError as error:
        msg = f"The work in {folder} stopped: {error}. Once that is mended, --resume goes on from what was kept last."
        raise TrainingError(msg) from error


def _take(lock: int, folder: Path) -> None:
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        msg = f"Another process is at work in {folder}. Wait for it to end, or choose another folder with --out."
        raise TrainingError(msg) from error


def claim(
    folder: Path,
    identity: Mapping[str, Any],
    state: Path | None,
    *,
    start: Path | None,
    wanted: Mapping[str, int],
    resume: bool,
) -> dict[str, Any] | None:
    """The card of this very training if ``folder`` holds it, finished as far as is wanted; ``None`` when there is work to do.

    Parameters
    ----------
    identity
        Digests of task and settings, and seed.
    state
        What the training would go on from; ``None`` when there is nothing.
    start
        Policy that it starts from, if any.
    wanted
        How far, in the card's terms, such as ``{"steps": 100_000}``.
    resume
        Whether it may go on from ``state``.

    Raises
    ------
    TrainingError
        When the folder holds something else that this training would overwrite, something that is not to be resumed, or what it
        would go on from is gone.
    """
    if start is not None and start.resolve() == (folder / POLICY).resolve():
        msg = f"{folder} holds the policy that is to be started from, and would be overwritten. Choose another folder with --out."
        raise TrainingError(msg)
    card = read_card(folder / CARD)
    others = {folder / SEARCH, folder / LEARNER, find_checkpoint(folder / CHECKPOINT)} - {state, None}
    ours = (
        card is not None
        and {
            "task_digest": card["task"]["digest"],
            "settings_digest": card["training"]["settings_digest"],
            "seed": card["training"]["seed"],
        }.items()
        <= identity.items()
    )
    if any(other is not None and other.exists() for other in others) or (
        card is not None and not ours and state is None
    ):
        msg = f"{folder} holds another training. Choose another folder with --out."
        raise TrainingError(msg)
    if card is not None and ours and all(card["training"][name] >= count for name, count in wanted.items()):
        return card
    if state is not None and not resume:
        msg = f"{folder} holds a training that was begun. Go on with --resume, or choose another folder with --out."
        raise TrainingError(msg)
    if card is not None and state is None:
        msg = (
            f"{folder} holds this training with {card['training']['steps']:,} steps, but not its last state, so that it cannot go on. "
            "Choose another folder with --out."
        )
        raise TrainingError(msg)
    return None


def open_folder(folder: Path, settings: Mapping[str, Any]) -> None:
    """Write the settings of a training that begins or goes on. Until it finishes, the folder has no card and cannot be evaluated."""
    (folder / CARD).unlink(missing_ok=True)
    write_atomically(folder / SETTINGS, yaml.safe_dump({"default": dict(settings)}, sort_keys=False))


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
        history = History.from_dict(state["history"])
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
