"""A tiny task whose draws can be sealed, a round, and honest results of both kinds."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from glbench.cli.app import main
from glbench.evaluation import evaluate, result_path
from glbench.evaluation.evaluation import results_folder
from glbench.tasks import Round, TaskSpec
from tests.cli.command_line import Answer, Command
from tests.evaluation.agent_files import AgentWriter, agent_writer
from tests.rounds.tiny import tiny_task

SECRET = Round("5" * 64)
OTHER = Round("7" * 64)


@pytest.fixture
def glbench(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Command:
    """Run a command line."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("GLBENCH_DEBUG", raising=False)

    def run(*arguments: str | Path) -> Answer:
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        captured = capfd.readouterr()
        return Answer(int(left.value.code or 0), captured.out, captured.err)

    return run


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> TaskSpec:
    return tiny_task(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="session")
def evaluated(tiny: TaskSpec, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Reports folder with honest results of rule_based: public draws, and two rounds."""
    out = tmp_path_factory.mktemp("evaluated") / "reports"
    for task in (tiny, tiny.in_split("test", SECRET.secret), tiny.in_split("test", OTHER.secret)):
        evaluate(task, "rule_based", out=out, episodes="best")
    return out


@pytest.fixture
def reports(evaluated: Path, tmp_path: Path) -> Path:
    """A copy of them."""
    return Path(shutil.copytree(evaluated, tmp_path / "reports"))


@pytest.fixture
def public(reports: Path, tiny: TaskSpec) -> Path:
    """The result with public draws."""
    return result_path(reports, tiny.id, "rule_based")


@pytest.fixture
def sealed(reports: Path, tiny: TaskSpec) -> Path:
    """The result of the round ``SECRET``."""
    return result_path(results_folder(reports, tiny.in_split("test", SECRET.secret)), tiny.id, "rule_based")


@pytest.fixture
def write_agent(tmp_path: Path) -> AgentWriter:
    return agent_writer(tmp_path)
