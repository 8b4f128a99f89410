"""Folders for copies that live as long as a piece of work, and are cleared away later where a kill left them behind."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import time
from pathlib import Path
from typing import Final

import filelock

_PREFIX: Final = "glbench-scratch-"
_LOCK: Final = ".in-use"
_OLD_SECONDS: Final = 60.0
"""Younger folders may be in the making: there is a moment between a folder and its lock."""


class Scratch:
    """A folder below the system's for temporary files, made when it is first asked for."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._lock: filelock.BaseFileLock | None = None

    def folder(self) -> Path:
        """The folder; nobody but this user can look into it."""
        if self._folder is None:
            _clear_away(Path(tempfile.gettempdir()))
            self._folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
            self._lock = filelock.FileLock(self._folder / _LOCK)
            self._lock.acquire()
        return self._folder

    def remove(self) -> None:
        """Remove the folder, if there is one."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
        if self._lock is not None:
            self._lock.release()
        self._folder = self._lock = None


def _clear_away(place: Path) -> None:
    """Remove folders of processes that were killed: their locks went with them."""
    for folder in place.glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError, filelock.Timeout):  # another user's, or in use
            if time.time() - folder.stat().st_mtime > _OLD_SECONDS and (folder / _LOCK).is_file():
                with filelock.FileLock(folder / _LOCK, blocking=False):
                    shutil.rmtree(folder, ignore_errors=True)
