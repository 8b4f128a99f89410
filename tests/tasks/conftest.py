"""A task file to vary, and a tasks folder of one's own with a lock."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from glbench import registration
from glbench.env import program, weather_pool
from glbench.env.behaviour import lock_behaviour
from glbench.registration import task_files
from glbench.tasks import digest, inheritance, library, list_tasks, lock_new_tasks, resolver, spec
from tests.tasks.names import FILE


@pytest.fixture(scope="session")
def shipped_text() -> str:
    """Text of the default task's file."""
    return next(path for path in task_files() if path.name == FILE).read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def shipped_words() -> dict[str, list[str]]:
    """Words of the vocabulary by kind, without what other tests of this process may have registered."""
    program = (
        "import json; from glbench.tasks import vocabulary as v; "
        "print(json.dumps({r.kind: r.names for r in vars(v).values() if isinstance(r, v.Registry)}))"
    )
    printed = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    words: dict[str, list[str]] = json.loads(printed.stdout)
    return words


@pytest.fixture
def own_text(shipped_text: str) -> str:
    """The same task under an id of one's own."""
    return shipped_text.replace('id = "glbench/', 'id = "mylab/')


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a task file and returns its path."""

    def write_text(text: str) -> Path:
        path = tmp_path / "mine.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write_text


@pytest.fixture
def vary(own_text: str, write: Callable[[str], Path]) -> Callable[..., Path]:
    """Writes the task with pieces of its text replaced, given as pairs of old and new."""

    def varied(*pieces: str) -> Path:
        text = own_text
        for old, new in zip(pieces[::2], pieces[1::2], strict=True):
            assert old in text
            text = text.replace(old, new)
        return write(text)

    return varied


@pytest.fixture
def forget() -> Iterator[Callable[[], None]]:
    """Forgets what is remembered of tasks in this process, as a new process would; also afterwards."""

    def forget_all() -> None:
        resolver._disturbances.cache_clear()
        for remembered in (program._shipped, weather_pool._shared_pool, spec._changed_task):
            remembered.cache_clear()
        weather_pool._ALIVE.clear()
        library._checked.cache_clear()
        library._REMEMBERED.clear()

    yield forget_all
    forget_all()


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forget: Callable[[], None]) -> Path:
    """A tasks folder with two published tasks and their lock, in the place of the shipped one."""
    folder = tmp_path / "tasks"
    folder.mkdir()
    for path in task_files():
        if path.name in {FILE, "schiphol2010code-delta30-v1.toml"}:
            shutil.copy(path, folder)
    for module in (registration, digest, inheritance):
        monkeypatch.setattr(module, "data_folder", lambda _name: folder)
    lock_new_tasks()
    lock_behaviour(list_tasks())
    forget()
    return folder
