"""The tasks of docs/energy.md and its two sisters, for the tests of several rooms."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from glbench.tasks import TaskSpec, get_task

DOCS = Path(__file__).resolve().parents[1] / "docs"
ENGINE, DISPATCH, HARVESTING = (
    (DOCS / name).read_text(encoding="utf-8") for name in ("energy.md", "energy-dispatch.md", "heat-harvesting.md")
)
PAGE = "\n".join((ENGINE, DISPATCH, HARVESTING))


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


def dated_task(folder: Path) -> Path:
    """A file with the task of the page, cut to two days and two runs, with power at 0.05 on the first day and at 0.08 on the second."""
    text = re.sub(r"hourly = \[[^]]*\]", 'from_day = { "04-01" = 0.05, "04-16" = 0.08 }', written())
    for old, new in {"mylab/Energy-v1": "test/Dated-v1", "days = 10": "days = 2", "runs = 4": "runs = 2"}.items():
        assert old in text, old
        text = text.replace(old, new)
    path = folder / "dated.toml"
    path.write_text(text, encoding="utf-8")
    return path


_AGENT = """
import numpy as np

{flue}

{rules}

class Agent:
    def reset(self, card, n_runs):
        global task, columns
        task, columns = card, [column.name for column in card.observations]

    def act(self, observations):
        return rules(observations, stores={stores}, engine={engine})


def make_agent(card):
    return Agent()
"""


def write_rules(folder: Path, name: str, *, stores: bool, engine: bool) -> Path:
    """The rules of the page as an agent, in the file ``name.py``."""
    (flue,) = re.findall(r"^flue = .*$", PAGE, flags=re.MULTILINE)
    (rules,) = re.findall(r"^def rules\(seen, stores, engine.*?\n\n\n", PAGE, flags=re.DOTALL | re.MULTILINE)
    path = folder / f"{name}.py"
    path.write_text(_AGENT.format(flue=flue, rules=rules, stores=stores, engine=engine), encoding="utf-8")
    return path
