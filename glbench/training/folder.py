"""The folder of a training or of a search: who may work in it, what stays untouched, and where its state is."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from glbench.errors import TrainingError, refuse
from glbench.resources import write_atomically
from glbench.training.card import CARD, POLICY, read_card

CHECKPOINT, SEARCH, LEARNER, SETTINGS = "checkpoint", "search.npz", "learner.npz", "settings.yml"
"""State of a training, of a search, of a training with the compiled PPO, and the settings of any of them."""
_LOCK = ".lock"
BEST, MODEL = "best", "model.zip"  # The best model of a training with Stable-Baselines3: a folder, and the file in it
STATE = "state.json"  # Of a checkpoint, written last


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Make ``folder`` where it is missing, and keep other processes out of it until the block is left.

    Raises ``TrainingError`` when another process is at work there, or the disk cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / _LOCK).open("w", encoding="utf-8") as lock:
            _take(lock.fileno(), folder)
            yield
    except OSError as error:
        msg = f"The work in {folder} stopped: {error}. Once this is fixed, --resume continues from the last saved state."
        raise TrainingError(msg) from error


def _take(lock: int, folder: Path) -> None:
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        refuse(f"Another process is at work in {folder}. Wait for it to end, or choose another folder with --out.", TrainingError, error)


def claim(
    folder: Path, identity: Mapping[str, Any], state: Path | None, *, start: Path | None, target: Mapping[str, int], resume: bool
) -> dict[str, Any] | None:
    """The card of this very training if ``folder`` holds it, finished as far as ``target``; ``None`` when there is work to do.

    Raises ``TrainingError`` when the folder holds something else that this training would overwrite, an unfinished training without
    ``resume``, or when the state to resume from is gone.

    ``identity`` has the digests of task and settings, and the seed; ``state`` is what the training would resume from, ``None`` when there
    is nothing, and ``resume`` whether it may; ``start`` is the policy to start from, if any; ``target`` is how far, in the card's terms,
    such as ``{"steps": 100_000}``.
    """
    if start is not None and start.resolve() == (folder / POLICY).resolve():
        refuse(f"{folder} holds the policy to start from, which would be overwritten. Choose another folder with --out.", TrainingError)
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
    if any(other is not None and other.exists() for other in others) or (card is not None and not ours and state is None):
        refuse(f"{folder} holds another training. Choose another folder with --out.", TrainingError)
    if card is not None and ours and all(card["training"][name] >= count for name, count in target.items()):
        return card
    if state is not None and not resume:
        refuse(f"{folder} holds an unfinished training. Continue with --resume, or choose another folder with --out.", TrainingError)
    if card is not None and state is None:
        msg = (
            f"{folder} holds this training with {card['training']['steps']:,} steps, but not its last state, so that it cannot continue. "
            "Choose another folder with --out."
        )
        raise TrainingError(msg)
    return None


def open_folder(folder: Path, settings: Mapping[str, Any]) -> None:
    """Write the settings of a training that begins or continues. Until it finishes, the folder has no card and cannot be evaluated."""
    (folder / CARD).unlink(missing_ok=True)
    write_atomically(folder / SETTINGS, yaml.safe_dump({"default": dict(settings)}, sort_keys=False))


def find_checkpoint(folder: Path) -> Path | None:
    """The newest complete checkpoint of ``folder``, even if the process was killed between the two renames."""
    for candidate in (folder, *_beside(folder)):  # its state is written last
        if (candidate / STATE).is_file():
            return candidate
    return None


@contextmanager
def replaced(folder: Path) -> Iterator[Path]:
    """A new folder to fill, which replaces ``folder`` when it is complete; if killed in between, the old one is left as ``.old``."""
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


def altered(place: Path) -> TrainingError:
    """What to raise when the state in ``place`` is not as it was written."""
    msg = f"{place} is damaged or was changed: its content does not match its digest. Restore it from a copy, or remove it to start over."
    return TrainingError(msg)


@dataclass(frozen=True)
class Trained:
    """A finished training."""

    folder: Path
    steps: int
    best_reward: float
    best_steps: int
    last_reward: float
    """Evaluation return of the last policy."""
    already_done: bool
    """Whether it was already finished, so that nothing was done."""
    not_exported: str | None = None
    """Why its policy could not be exported to a file for numpy; ``None`` when it was."""

    @classmethod
    def of(cls, folder: Path, card: dict[str, Any], *, already_done: bool, not_exported: str | None = None) -> Trained:
        """What ``folder`` holds, as its card says."""
        steps, best = card["training"]["steps"], card["best"]
        return cls(folder, steps, best["reward"], best["steps"], best["last_reward"], already_done, not_exported)

    @property
    def learnt(self) -> bool:
        """Whether any evaluation was better than the first one, of the policy that the training began with."""
        return self.best_steps > 0

    @property
    def model(self) -> Path:
        """The best policy as Stable-Baselines3 saves it."""
        return self.folder / BEST / MODEL
