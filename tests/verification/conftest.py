"""Results that were honestly made, to be tampered with in copies."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from glbench.evaluation import evaluate, result_path
from glbench.tasks import TaskSpec, get_task
from tests.episodes.day import FAILING, NARROW, RANDOM
from tests.evaluation.agent_files import AgentWriter, agent_writer
from tests.support import write_day_task


@pytest.fixture(scope="session")
def day_task(tmp_path_factory: pytest.TempPathFactory) -> TaskSpec:
    return get_task(write_day_task(tmp_path_factory.mktemp("task")))


@pytest.fixture(scope="session")
def evaluated(day_task: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Reports folder with honest results, full episodes included: wavy, narrow, failing, and the privileged rule_based."""
    folder = tmp_path_factory.mktemp("evaluated")
    write = agent_writer(folder)
    for agent in (write(RANDOM, "wavy"), write(NARROW, "narrow"), write(FAILING, "failing"), "rule_based"):
        evaluate(day_task, agent, out=folder / "reports", episodes="all")
    return folder / "reports"


@pytest.fixture
def reports(evaluated: Path, tmp_path: Path) -> Path:
    """A copy of them."""
    return Path(shutil.copytree(evaluated, tmp_path / "reports"))


@pytest.fixture
def wavy(reports: Path, day_task: TaskSpec) -> Path:
    """The result of the agent ``wavy`` in the copy."""
    return result_path(reports, day_task.id, "wavy")


@pytest.fixture
def write_agent(tmp_path: Path) -> AgentWriter:
    return agent_writer(tmp_path)
