"""The folder of a training or of a search: who may work in it, and what is left untouched."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from glbench.errors import TrainingError
from glbench.training.card import CARD, POLICY, read_card
from glbench.training.checkpoint import find_checkpoint

CHECKPOINT, SEARCH, SETTINGS = "checkpoint", "search.npz", "settings.yml"
"""State of a training, state of a search, and the settings of either."""
_LOCK = ".lock"


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep other processes out of ``folder`` meanwhile, which is made when there is none.

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


def finished_in(
    folder: Path, identity: Mapping[str, Any], state: Path | None, start: Path | None = None
) -> dict[str, Any] | None:
    """The card of this very training in ``folder``, if it was finished there, perhaps with fewer steps.

    Parameters
    ----------
    identity
        Digests of task and settings, and seed.
    state
        What the training would go on from; ``None`` when there is nothing.
    start
        Policy that it starts from, if any.

    Raises
    ------
    TrainingError
        When the folder holds something else that this training would overwrite.
    """
    if start is not None and start.resolve() == (folder / POLICY).resolve():
        msg = f"{folder} holds the policy that is to be started from, and would be overwritten. Choose another folder with --out."
        raise TrainingError(msg)
    states = {folder / SEARCH, find_checkpoint(folder / CHECKPOINT)}
    card = read_card(folder / CARD)
    ours = card is not None and _identity_of(card) == {key: identity[key] for key in _identity_of(card)}
    if any(other is not None and other != state and other.exists() for other in states) or (
        card is not None and not ours and state is None
    ):
        msg = f"{folder} holds another training. Choose another folder with --out."
        raise TrainingError(msg)
    return card if ours else None


def _identity_of(card: Mapping[str, Any]) -> dict[str, Any]:
    training = card["training"]
    return {
        "task_digest": card["task"]["digest"],
        "settings_digest": training["settings_digest"],
        "seed": training["seed"],
    }


def may_begin(folder: Path, card: Mapping[str, Any] | None, state: Path | None, resume: bool) -> None:
    """Whether a training may begin in ``folder``, or go on with more steps from ``state``.

    Raises
    ------
    TrainingError
        When there is something that is not to be resumed, or what it would go on from is gone.
    """
    if state is not None and not resume:
        msg = f"{folder} holds a training that was begun. Go on with --resume, or choose another folder with --out."
        raise TrainingError(msg)
    if card is not None and state is None:
        msg = (
            f"{folder} holds this training with {card['training']['steps']:,} steps, but not its last state, so that it cannot go on. "
            "Choose another folder with --out."
        )
        raise TrainingError(msg)
