"""One evaluated agent with all of its episodes, shared by the tests of the room."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.episodes import episode_path, episodes_folder
from glbench.evaluation import Result, evaluate, result_path
from glbench.tasks import TaskSpec, get_task
from tests.episodes.day import RANDOM
from tests.evaluation.agent_files import AgentWriter, agent_writer
from tests.support import write_day_task


@pytest.fixture(scope="session")
def day_task(tmp_path_factory: pytest.TempPathFactory) -> TaskSpec:
    return get_task(write_day_task(tmp_path_factory.mktemp("task")))


@pytest.fixture(scope="session")
def day_result(day_task: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    """A result with all episodes, and its path."""
    folder = tmp_path_factory.mktemp("evaluated")
    agent = agent_writer(folder)(RANDOM, "wavy")
    result = evaluate(day_task, agent, out=folder, episodes="all")
    return result, result_path(folder, day_task.id, "wavy")


@pytest.fixture(scope="session")
def episode_file(day_result: tuple[Result, Path]) -> Path:
    """The full episode of the first run."""
    result, path = day_result
    return episode_path(episodes_folder(path), result.runs[0].seed)


@pytest.fixture
def write_agent(tmp_path: Path) -> AgentWriter:
    return agent_writer(tmp_path)
