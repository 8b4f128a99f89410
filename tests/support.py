"""What the tests of several rooms work with."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from glbench.resources import data_folder


def write_day_task(folder: Path) -> Path:
    """The default task, cut to one day of 24 steps and three runs, under an id of its own."""
    return write_short_task(folder, "Day", days=1)


def write_short_task(folder: Path, name: str, *, days: int) -> Path:
    """The default task, cut to some days of 24 steps and three runs, as ``test/NAME-v1`` in the file ``name.toml``."""
    text = (data_folder("tasks") / "schiphol2010-delta10-v1.toml").read_text(encoding="utf-8")
    for pattern, replacement in {
        r'id = "glbench/.*"': f'id = "test/{name}-v1"',
        r"days = 60": f"days = {days}",
        r"step_seconds = 900": "step_seconds = 3600",
        r"runs = 30": "runs = 3",
    }.items():
        text, count = re.subn(pattern, replacement, text, count=1)
        assert count == 1, pattern
    path = folder / f"{name.lower()}.toml"
    path.write_text(text, encoding="utf-8")
    return path


FEW = ("do_nothing", "ppo", "ppo_seed1", "ppo_seed2", "rule_based", "rule_based_fair")
"""Agents whose results ``checkout_with_few_results`` keeps."""


def checkout_with_few_results(folder: Path) -> Path:
    """A package folder beside the data of this checkout, but with the released results of few agents on two tasks alone."""
    (folder / "pyproject.toml").touch()
    for name in ("tasks", "baselines", "weather", "submissions"):
        (folder / name).symlink_to(data_folder(name), target_is_directory=True)
    released = data_folder("reports/released/results")
    for task in ("Schiphol2010-Delta10-v1", "Schiphol2010Code-Delta00-v1"):
        here = folder / "reports" / "released" / "results" / task
        here.mkdir(parents=True)
        for agent in FEW:
            for file in (released / task).glob(f"{agent}.*"):
                shutil.copy(file, here)
    return folder / "glbench"
