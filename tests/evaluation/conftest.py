"""A task of one day in hourly steps, and agents written into files, as a user has them."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

from glbench.evaluation import Result, TimeLimits, evaluate
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task

AgentWriter = Callable[..., Path]

GOOD = """
    def act(self, observations):
        wanted = np.tanh((observations[:, :6].astype(float) - 20.0) / 50.0)
        self.memory = 0.5 * self.memory + 0.5 * wanted  # remembers, so that resuming has something to get wrong
        self.calls += 1
        return self.memory
"""
"""A batched agent with memory whose rows do not depend on each other."""


@pytest.fixture(scope="session")
def day_task_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The default task, cut to one day of 24 steps and three runs, under an id of its own."""
    text = (data_folder("tasks") / "schiphol2010-delta10-v1.toml").read_text(encoding="utf-8")
    for pattern, replacement in {
        r'id = "glbench/.*"': 'id = "test/Day-v1"',
        r"days = 60": "days = 1",
        r"step_seconds = 900": "step_seconds = 3600",
        r"runs = 30": "runs = 3",
    }.items():
        text, count = re.subn(pattern, replacement, text, count=1)
        assert count == 1, pattern
    path = tmp_path_factory.mktemp("task") / "day.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def day_task(day_task_file: Path) -> TaskSpec:
    return get_task(day_task_file)


@pytest.fixture(scope="session")
def good_result(day_task: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """What the agent ``GOOD`` earns when nothing interrupts it."""
    return evaluate(day_task, _written(tmp_path_factory.mktemp("good"))())


@pytest.fixture
def write_agent(tmp_path: Path) -> AgentWriter:
    """Write a submission whose class has the methods given as text; ``single`` makes it an agent for one run."""
    return _written(tmp_path)


def _written(folder: Path) -> AgentWriter:
    def write(methods: str = GOOD, name: str = "agent_under_test", *, single: bool = False) -> Path:
        reset = "def reset(self, task):" if single else "def reset(self, task, n_runs):"
        n = "1" if single else "n_runs"
        body = textwrap.indent(textwrap.dedent(methods).strip("\n"), "    ")
        own_reset = (
            "" if "def reset" in methods else f"    {reset}\n        self.n, self.calls, self.memory = {n}, 0, 0.0\n"
        )
        path = folder / f"{name}.py"
        path.write_text(
            "import os, sys, time\nimport numpy as np\n"
            f"class Agent:\n    single_run = {single}\n{own_reset}{body}\n\n"
            "def make_agent(task):\n    return Agent()\n",
            encoding="utf-8",
        )
        return path

    return write


@pytest.fixture
def hasty() -> TimeLimits:
    """Limits that a test can wait for."""
    return TimeLimits(start=0.3, step=0.1, run=60.0)
