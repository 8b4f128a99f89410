"""A short task with parameters that differ from run to run, and a short one in which all runs are alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.agents.plans import PlanFolder
from glbench.tasks import TaskSpec, get_task

_SHORT = {"days": 1, "step_seconds": 1800}


@pytest.fixture
def drawn() -> TaskSpec:
    """48 half hours with crop parameters drawn at every step."""
    return get_task("Schiphol2010-Delta10-v1").replace(id="test/Drawn-v1", weather=_SHORT)


@pytest.fixture
def nominal() -> TaskSpec:
    """48 half hours in which nothing is drawn."""
    return get_task("Schiphol2010-Delta00-v1").replace(id="test/Nominal-v1", weather=_SHORT)


@pytest.fixture
def known(tmp_path: Path) -> PlanFolder:
    """A folder for best known plans, empty."""
    return PlanFolder(tmp_path / "known")
