"""Build hook: the wheel carries the checkout's baselines and released results, and the digest by which glbench knows them."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class DataHook(BuildHookInterface[Any]):
    """Adds the data that stand beside this folder in a checkout."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called before the wheel is put together; ``version`` is ``"standard"`` or ``"editable"``."""
        sys.path.insert(0, self.root)
        import contents

        self._folder = Path(tempfile.mkdtemp(prefix="glbench-data-"))
        if version != "standard":
            return
        checkout = Path(self.root).parent
        files = contents.whole(checkout)
        build_data["force_include"] |= {str(file): f"glbench_data/{name}" for name, file in files.items()}
        build_data["force_include"][str(checkout / "LICENSE")] = "glbench_data/LICENSE"
        manifest = self._folder / "manifest.json"
        facts = {"version": self.metadata.version, "sha256": contents.digest(files)}
        manifest.write_text(json.dumps(facts) + "\n", encoding="utf-8")
        build_data["force_include"][str(manifest)] = "glbench_data/manifest.json"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Called when the wheel is finished."""
        shutil.rmtree(self._folder)
