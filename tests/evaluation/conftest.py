"""A task of one day in hourly steps, and agents written into files, as a user has them."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.evaluation import Result, TimeLimits, evaluate
from glbench.tasks import TaskSpec, get_task
from tests.evaluation.agent_files import AgentWriter, agent_writer
from tests.support import write_day_task


@pytest.fixture(scope="session")
def day_task_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The default task, cut to one day of 24 steps and three runs, under an id of its own."""
    return write_day_task(tmp_path_factory.mktemp("task"))


@pytest.fixture(scope="session")
def day_task(day_task_file: Path) -> TaskSpec:
    return get_task(day_task_file)


@pytest.fixture(scope="session")
def good_result(day_task: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """What the agent ``GOOD`` earns when nothing interrupts it."""
    return evaluate(day_task, agent_writer(tmp_path_factory.mktemp("good"))())


@pytest.fixture
def write_agent(tmp_path: Path) -> AgentWriter:
    """Write a submission whose class has the methods given as text; ``single`` makes it an agent for one run."""
    return agent_writer(tmp_path)


@pytest.fixture
def hasty() -> TimeLimits:
    """Limits that a test can wait for, and that a good agent keeps on a busy machine."""
    return TimeLimits(start=4.0, step=1.5, run=600.0)
