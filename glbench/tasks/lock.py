"""``tasks/lock.toml``: the digests of published tasks, and what to say when a task no longer has its own.

A published task never changes. The lock keeps the digest of every part, so that the message can tell an edited file from a
changed model or changed weather.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

from glbench.errors import TaskError
from glbench.resources import data_folder, write_atomically
from glbench.tasks.digest import Fingerprint, definition_digest
from glbench.tasks.spec import TaskSpec

LOCK_NAME = "lock.toml"
LOCK_WORDS = "tasks/lock.toml"

_HEADER = """\
# Digests of the published tasks, written by `glbench tasks lock`. A published task never changes: entries are added, never
# edited. `digest` covers the whole task; the other lines say which part of it differs when it no longer matches.
"""


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


def check_against_lock(task: TaskSpec, entry: LockEntry) -> None:
    """Refuse ``task`` if it is not the one that ``entry`` locks, and say what differs.

    Raises
    ------
    TaskError
        With what differs (the file, the model, parameters, weather, start, observed columns) and what to do.
    """
    check_file_against_lock(task, entry)
    found, locked = task.fingerprint(), entry.fingerprint
    if found.digest == locked.digest:
        return
    reasons = []
    if found.model != locked.model:
        reasons.append(
            f"the model is another one (version {locked.model_version} {_change(locked.model, found.model)}, "
            f"here version {found.model_version})"
        )
    if found.parameters != locked.parameters:
        reasons.append(
            f"the parameter set '{task.model.parameters}' has other values ({_change(locked.parameters, found.parameters)})"
        )
    if found.weather != locked.weather:
        reasons.append(
            f"the weather '{task.weather.source}' has other values, or is prepared in another way "
            f"({_change(locked.weather, found.weather)})"
        )
    if found.start != locked.start:
        reasons.append(f"the start '{task.initial.kind}' is another one ({_change(locked.start, found.start)})")
    if found.observation != locked.observation:
        reasons.append(
            f"the observed columns have other names, units or bounds ({_change(locked.observation, found.observation)})"
        )
    if not reasons:
        msg = (
            f"{LOCK_WORDS} contradicts itself about {task.id}: its parts are as locked, the digest over them is not "
            f"({_change(locked.digest, found.digest)}). The entry was edited: restore the file, or install glbench again."
        )
        raise TaskError(msg)
    msg = (
        f"{task.source} is as it was published, but {'; '.join(reasons)}. Results would not be comparable with published "
        "ones: install the glbench version that the task was locked with, or, if the change is meant, publish new "
        "versions of the tasks and run `glbench tasks lock`."
    )
    raise TaskError(msg)


def check_file_against_lock(task: TaskSpec, entry: LockEntry) -> None:
    """As ``check_against_lock``, for the definition alone; needs neither model nor weather."""
    found, locked = definition_digest(task), entry.fingerprint.definition
    if found != locked:
        msg = (
            f"{task.source} no longer matches {LOCK_WORDS} ({_change(locked, found)}).\n"
            "Published tasks never change: restore the file, or add your change as a new version and run "
            "`glbench tasks lock`."
        )
        raise TaskError(msg)


def _change(locked: str, found: str) -> str:
    return f"locked {locked[:8]}..., found {found[:8]}..."
