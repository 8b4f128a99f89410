"""Build hook: a wheel carries data for its main job, and the compiled kernel where the machine that builds it has a C++ compiler.

Without a compiler the wheel is pure Python, and the kernel is compiled on the user's machine. An editable installation
carries nothing either: a checkout compiles what its sources say at that moment. Large data are in a second package (``glbench-data``).
"""

from __future__ import annotations

import importlib.util
import json
import platform
import shutil
import sys
import tempfile
import tomllib
import types
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelHook(BuildHookInterface[Any]):
    """Adds the data, and the libraries of the models of the shipped tasks, to the wheel."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before the wheel is put together; ``version`` is ``"standard"`` or ``"editable"``."""
        self._folder: Path | None = None
        if version != "standard":
            return
        folder = Path(tempfile.mkdtemp(prefix="glbench-kernel-"))
        self._folder = folder
        build_data["force_include"] |= self._data(folder)
        libraries = folder / "kernel"
        libraries.mkdir()
        if not self._compile(libraries):
            return
        build_data["force_include"] |= {str(path): f"glbench/_data/kernel/{path.name}" for path in sorted(libraries.iterdir())}
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-linux_{platform.machine()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Called when the wheel is finished."""
        if self._folder is not None:
            shutil.rmtree(self._folder)

    def _data(self, folder: Path) -> dict[str, str]:
        """Baselines and results of this wheel, and what it says of the package that holds all of them; by their names in the wheel."""
        kept, facts = _contents(Path(self.root)).part(Path(self.root))
        manifest = folder / "data.json"
        manifest.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        return {**{str(file): f"glbench/_data/{name}" for name, file in kept.items()}, str(manifest): "glbench/_data/data.json"}

    def _compile(self, folder: Path) -> bool:
        """Whether there are libraries in ``folder`` now."""
        _open_package(Path(self.root) / "glbench")
        from glbench.kernel.compiled.compiler import CompiledUnavailable
        from glbench.kernel.compiled.library import absent_equipment, levels_to_build, prebuild, traits_of, write_manifest
        from glbench.model import registered_models, with_violation_meters

        if not levels_to_build():
            return False
        asked = _asked_by_tasks(Path(self.root) / "tasks")
        models = [
            with_violation_meters(model) if metered else model
            for model in registered_models()
            for metered in (False, True)
            if (model.id, model.variant, metered) in asked
        ]
        try:
            made = [one for model in models for one in prebuild(folder, model, traits_of(model, absent_equipment(model)))]
        except CompiledUnavailable as reason:
            self.app.display_warning(f"The wheel carries no compiled kernel. {reason}")
            return False
        write_manifest(folder, made)
        return True


def _asked_by_tasks(folder: Path) -> set[tuple[str, str, bool]]:
    """Id and variant of the models of the published tasks in ``folder``, and whether their limits are judged by meters.

    Drafts compile at their first use: their libraries would make the wheel too large.
    """
    tasks = {task["id"]: task for task in map(_toml, folder.glob("*.toml")) if "id" in task}

    def asked(task: dict[str, Any]) -> tuple[str, str, bool]:
        base = tasks.get(task.get("base", ""))
        model, variant, metered = ("greenlight-tomato-1.0.0", "author", False) if base is None else asked(base)
        given = task.get("model", {})
        judged = task.get("constraints", {}).get("judged")
        return (given.get("id", model), given.get("variant", variant), metered if judged is None else judged == "mean")

    return {asked(task) for task in tasks.values()}


def _contents(root: Path) -> types.ModuleType:
    """The module that both wheels share."""
    spec = importlib.util.spec_from_file_location("contents", root / "glbench-data" / "contents.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _toml(file: Path) -> dict[str, Any]:
    return tomllib.loads(file.read_text(encoding="utf-8"))


def _open_package(folder: Path) -> None:
    """Let ``import glbench.kernel`` work without the package's front door, which needs metadata that does not exist yet."""
    package = types.ModuleType("glbench")
    package.__path__ = [str(folder)]
    package.__version__ = "0"  # type: ignore[attr-defined]
    sys.modules["glbench"] = package
