"""The tasks of docs/energy.md, for the tests of several rooms."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from glbench.tasks import TaskSpec, get_task

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "energy.md").read_text(encoding="utf-8")


def written(task: str = "mylab/Energy-v1") -> str:
    """The task file of the page with that id."""
    (text,) = (block for block in re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL) if f'id = "{task}"' in block)
    return text


@cache
def whole_task() -> TaskSpec:
    """The task of the page."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "energy.toml"
        path.write_text(written(), encoding="utf-8")
        return get_task(path)


def energy_task(changes: Mapping[str, Any] | None = None) -> TaskSpec:
    """The task of the page, cut to one day, with further changes."""
    return whole_task().replace({"weather.days": 1, **(changes or {})})
