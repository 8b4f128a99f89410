"""What is kept on disk while runs are under way, so that an interruption costs seconds and not hours.

Two kinds of files are in the folder of one evaluation: pieces of the dialogue with the agent (what it was shown and what it answered,
step after step) and one snapshot of the simulation and of the sums so far. A piece is written before the snapshot that needs it, and
every file appears whole or not at all, so a kill at any moment leaves a folder that can be used.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import shutil
import time
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.errors import GlbenchError, refuse
from glbench.resources import write_atomically

logger = logging.getLogger(__name__)

_SNAPSHOT = "snapshot.npz"
_FACTS = "facts"
_DIGEST_BYTES = hashlib.sha256().digest_size
_SHARE = 0.02  # Largest share of the time that may go into checkpoints


@dataclass(frozen=True)
class Saved:
    """A checkpoint read back: the step reached, arrays and facts of the snapshot, and the dialogue up to that step.

    ``inputs`` has shape ``(step, n, ...)`` and ``actions`` ``(step, n, m)``.
    """

    step: int
    arrays: dict[str, NDArray[Any]]
    facts: dict[str, Any]
    inputs: NDArray[Any]
    actions: NDArray[np.float64]


class Checkpoint:
    """Writer of one evaluation's checkpoint. With ``folder=None`` nothing is kept."""

    def __init__(self, folder: Path | None, every_seconds: float) -> None:
        self._folder = folder
        self._every = every_seconds
        self._wait = every_seconds
        self._last = time.monotonic()
        self._inputs: list[NDArray[Any]] = []
        self._actions: list[NDArray[np.float64]] = []
        self._from = 0

    def record(self, inputs: NDArray[Any], actions: NDArray[np.float64]) -> None:
        """Remember one step of the dialogue; the arrays are not copied and must not change any more."""
        if self._folder is not None:
            self._inputs.append(inputs)
            self._actions.append(actions)

    @property
    def due(self) -> bool:
        """Whether the last checkpoint is long enough ago."""
        return self._folder is not None and time.monotonic() - self._last >= self._wait

    def save(self, step: int, arrays: Mapping[str, NDArray[Any]], facts: Mapping[str, Any]) -> None:
        """Write the dialogue since the last checkpoint, then the snapshot after ``step`` steps.

        A disk that is full stops the checkpoints and not the evaluation, which continues and says so.
        """
        if self._folder is None:
            return
        began = time.monotonic()
        piece = {"inputs": np.stack(self._inputs), "actions": np.stack(self._actions)} if self._inputs else None
        try:
            if piece is not None:
                write_atomically(self._folder / f"dialogue-{self._from:08d}-{step:08d}.npz", _packed(piece))
            snapshot = {**arrays, _FACTS: np.array(json.dumps({**facts, "step": step}))}
            write_atomically(self._folder / _SNAPSHOT, _packed(snapshot))
        except GlbenchError as error:
            logger.warning("No further checkpoints, the evaluation continues without: %s", error)
            self._folder = None
            return
        self._inputs, self._actions, self._from = [], [], step
        self._last = time.monotonic()
        self._wait = max(self._every, (self._last - began) / _SHARE) if self._every > 0 else 0.0

    def continue_from(self, saved: Saved) -> None:
        """Go on after ``saved``; pieces beyond its snapshot belong to a run that was cut off and are removed."""
        self._from = saved.step
        if self._folder is not None:
            for start, _, path in _pieces(self._folder):
                if start >= saved.step:
                    path.unlink(missing_ok=True)


def read_checkpoint(folder: Path) -> Saved | None:
    """The checkpoint in ``folder``, or ``None`` when there is none that can be used."""
    try:
        arrays = _unpacked(folder / _SNAPSHOT)
        facts = json.loads(str(arrays.pop(_FACTS)))
        step = int(facts["step"])
        parts = [_unpacked(path) for start, stop, path in _pieces(folder) if stop <= step]
        inputs = np.concatenate([part["inputs"] for part in parts])
        actions = np.concatenate([part["actions"] for part in parts])
    except FileNotFoundError:
        return None
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        logger.warning("The checkpoint in %s cannot be read (%s); starting from the beginning.", folder, error)
        return None
    if len(inputs) != step or len(actions) != step:
        logger.warning("The checkpoint in %s lacks steps; starting from the beginning.", folder)
        return None
    return Saved(step, arrays, facts, inputs, actions)


def holds_checkpoint(folder: Path) -> bool:
    """Whether a checkpoint was finished in ``folder``; one that found no room on the disk was not."""
    return (folder / _SNAPSHOT).is_file()


def discard(folder: Path) -> None:
    """Remove a checkpoint; one that is not there is no error."""
    shutil.rmtree(folder, ignore_errors=True)


def take_over(folder: Path, files: Mapping[str, bytes]) -> None:
    """Make ``files``, a checkpoint from another machine, the one in ``folder``; if killed midway, it is either complete or not used.

    A full disk stops the checkpoints, not the evaluation.
    """
    try:
        for name in sorted(files, key=lambda name: name == _SNAPSHOT):  # which needs the others
            file = folder / name
            if not file.is_file() or file.read_bytes() != files[name]:
                write_atomically(file, files[name])
        for _, _, path in _pieces(folder):
            if path.name not in files:
                path.unlink(missing_ok=True)
    except (GlbenchError, OSError) as error:
        logger.warning("The checkpoint of a worker was not kept: %s", error)


def _pieces(folder: Path) -> list[tuple[int, int, Path]]:
    """First step, step after the last, and path of every piece of the dialogue, in order."""
    pieces = []
    for path in sorted(folder.glob("dialogue-*-*.npz")):
        _, start, stop = path.stem.split("-")
        pieces.append((int(start), int(stop), path))
    return pieces


def _packed(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The arrays as bytes, behind the SHA-256 digest of these bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **arrays)
    content = buffer.getvalue()
    return hashlib.sha256(content).digest() + content


def _unpacked(path: Path) -> dict[str, NDArray[Any]]:
    data = path.read_bytes()
    digest, content = data[:_DIGEST_BYTES], data[_DIGEST_BYTES:]
    if hashlib.sha256(content).digest() != digest:
        refuse(f"{path.name} is not as it was written: its content does not match its digest")
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}
