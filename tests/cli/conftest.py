"""A small task and an agent in a folder of their own, and the command line as a function."""

from __future__ import annotations

from pathlib import Path

import pytest

from glbench.cli.app import main
from tests.cli.command_line import Answer, Command
from tests.support import write_day_task


@pytest.fixture
def glbench(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Command:
    """Run a command line: ``glbench("tasks", "list")``."""
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("GLBENCH_DEBUG", raising=False)

    def run(*arguments: str | Path) -> Answer:
        with pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
        captured = capfd.readouterr()
        return Answer(int(left.value.code or 0), captured.out, captured.err)

    return run


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder: empty but for ``day.toml`` (24 steps, three runs) and ``steady.py``, which runs unsandboxed."""
    monkeypatch.setenv("GLBENCH_SANDBOX", "none")
    write_day_task(tmp_path)
    (tmp_path / "steady.py").write_text(
        "import numpy as np\n"
        "class Steady:\n"
        "    def reset(self, task, n_runs):\n        self.n = n_runs\n"
        "    def act(self, observations):\n        return np.full((self.n, 6), 0.01)\n"
        "def make_agent(task):\n    return Steady()\n",
        encoding="utf-8",
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path
