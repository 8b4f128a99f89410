"""``tasks/lock.toml``: the digests of published tasks.

A published task never changes. The lock keeps the digest of every part, so that a message can tell an edited file from a changed model or
changed weather (``glbench.tasks.library``).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

from glbench.errors import TaskError
from glbench.resources import data_folder, write_atomically

LOCK_NAME = "lock.toml"
LOCK_WORDS = "tasks/lock.toml"

_HEADER = """\
# Digests of the published tasks, written by `glbench tasks lock`. A published task never changes: entries are added, never
# edited. `digest` covers the whole task; the other lines say which part of it differs when it no longer matches.
"""


@dataclass(frozen=True)
class Fingerprint:
    """The digest of a task [SHA-256, hex] and the digests of its parts."""

    digest: str
    definition: str
    parameters: str
    start: str
    observation: str
    weather: str
    model: str
    model_version: str

    PARTS: ClassVar[tuple[str, ...]] = ("definition", "parameters", "start", "observation", "weather", "model")


@dataclass(frozen=True)
class LockEntry:
    """A published task: its file in the tasks folder and its fingerprint."""

    id: str
    file: str
    fingerprint: Fingerprint

    @property
    def digest(self) -> str:
        """Digest of the task [SHA-256, hex]."""
        return self.fingerprint.digest


def lock_path() -> Path:
    """Where the lock is."""
    return data_folder("tasks") / LOCK_NAME


def read_lock(path: Path | None = None) -> Mapping[str, LockEntry]:
    """Entries of the lock by task id; empty when there is no lock yet.

    Raises
    ------
    TaskError
        When the file is damaged.
    """
    path = lock_path() if path is None else path
    try:
        state = path.stat()
    except FileNotFoundError:
        return MappingProxyType({})
    return _read(path, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=8)
def _read(path: Path, _modified: int, _size: int) -> Mapping[str, LockEntry]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        return MappingProxyType({task_id: _entry(task_id, entry) for task_id, entry in content.items()})
    except (OSError, ValueError) as error:
        msg = f"Cannot read {path}: {error}. Restore the file, or install glbench again."
        raise TaskError(msg) from error


def _entry(task_id: str, entry: object) -> LockEntry:
    names = {field.name for field in fields(Fingerprint)}
    if (
        not isinstance(entry, dict)
        or set(entry) != {"file", *names}
        or not all(isinstance(value, str) for value in entry.values())
    ):
        msg = f"the entry of '{task_id}' is not complete"
        raise ValueError(msg)
    return LockEntry(task_id, entry["file"], Fingerprint(**{name: entry[name] for name in names}))


def write_lock(entries: Mapping[str, LockEntry], path: Path) -> None:
    """Write ``entries`` in the order of their ids."""
    blocks = [_HEADER]
    for task_id in sorted(entries):
        entry = entries[task_id]
        lines = {"file": entry.file, **asdict(entry.fingerprint)}
        blocks.append(f'["{task_id}"]\n' + "".join(f'{key} = "{value}"\n' for key, value in lines.items()))
    write_atomically(path, "\n".join(blocks))
