"""Gymnasium ids of the shipped tasks, registered without loading anything heavy.

``import glbench`` must be quick, and Gymnasium alone takes longer than the rest. So its import is waited for: the ids are
registered at once if Gymnasium is loaded already, else at the moment it is. Both orders of the two imports work, and so
does ``gymnasium.make("glbench:glbench/...")``.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from contextlib import suppress
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

from glbench.resources import data_folder

LOCK_NAME = "lock.toml"
ENTRY_POINT = "glbench.env:GreenhouseEnv"
VECTOR_ENTRY_POINT = "glbench.env:GreenhouseVectorEnv"
_GYMNASIUM = "gymnasium"


def task_files() -> list[Path]:
    """Files of the shipped tasks, in the order of their names."""
    return sorted(path for path in data_folder("tasks").glob("*.toml") if path.name != LOCK_NAME)


def task_ids() -> dict[str, Path]:
    """Ids of the shipped tasks and their files, read without checking anything else.

    Files that are no TOML or have no id are left out: one that is being edited must not keep the package from loading.
    ``get_task`` and ``glbench tasks check`` say what is wrong with them.
    """
    ids: dict[str, Path] = {}
    for path in task_files():
        with suppress(OSError, UnicodeDecodeError, tomllib.TOMLDecodeError):
            task_id = tomllib.loads(path.read_text(encoding="utf-8")).get("id")
            if isinstance(task_id, str):
                ids[task_id] = path
    return ids


def register_tasks() -> None:
    """Make every shipped task known to Gymnasium, for ``make`` and ``make_vec``; a second call changes nothing.

    Loads Gymnasium. The environment itself is loaded when one is made.
    """
    import gymnasium

    for task_id in task_ids():
        if task_id not in gymnasium.registry:
            gymnasium.register(
                id=task_id,
                entry_point=ENTRY_POINT,
                vector_entry_point=VECTOR_ENTRY_POINT,
                max_episode_steps=None,
                kwargs={"task": task_id},
            )


def register_tasks_with_gymnasium() -> None:
    """Call ``register_tasks`` now if Gymnasium is loaded, else as soon as it is."""
    if _GYMNASIUM in sys.modules:
        register_tasks()
    elif not any(isinstance(finder, _GymnasiumFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _GymnasiumFinder())


class _GymnasiumFinder(MetaPathFinder):
    """Lets the other finders find Gymnasium, once, and has the ids registered after it is loaded."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _GYMNASIUM:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            spec.loader = _RegisteringLoader(spec.loader)
        return spec


class _RegisteringLoader(Loader):
    """Loads Gymnasium with its own loader, then registers the ids."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        if module.__spec__ is not None:
            module.__spec__.loader = self._loader  # nothing but this import sees the stand-in
        module.__loader__ = self._loader
        self._loader.exec_module(module)
        register_tasks()
