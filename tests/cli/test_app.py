from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from glbench import __version__
from glbench.cli.console import say
from glbench.errors import GlbenchError
from tests.cli.command_line import Command

HEAVY = ("casadi", "pandas", "pyarrow", "pvlib", "scipy", "torch", "pydantic")


def test_help_names_every_command_and_where_to_start(glbench: Command) -> None:
    answer = glbench("--help")

    assert answer.code == 0
    for command in ("evaluate", "leaderboard", "tasks", "weather"):
        assert command in answer.out
    assert "glbench evaluate submissions/my_agent.py" in answer.out


def test_help_of_evaluate_tells_the_defaults(glbench: Command) -> None:
    answer = glbench("evaluate", "--help")

    for option in ("--task", "--suite", "--runs", "--seed", "--workers", "--out", "--json", "--fresh"):
        assert option in answer.out


def test_the_version_is_printed(glbench: Command) -> None:
    assert glbench("--version").out == f"glbench {__version__}\n"


def test_help_loads_nothing_heavy() -> None:
    code = f"import sys, glbench.cli.app; print([name for name in {HEAVY!r} if name in sys.modules])"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)

    assert loaded.stdout.strip() == "[]"


def test_a_paragraph_ends_its_lines_between_words_in_a_terminal_only() -> None:
    text = "30 runs of 60 days, 5760 steps of 900 s; 2 workers, [bold]compiled[/bold] kernel, in a sandbox"
    path = "/a/folder/with/a/name/that/is/longer/than/the/line.json"

    def printed(text: str, *, terminal: bool) -> list[str]:
        console = Console(file=io.StringIO(), width=30, force_terminal=terminal, color_system=None, highlight=False)
        say(console, text)
        assert isinstance(console.file, io.StringIO)
        return console.file.getvalue().splitlines()

    plain = text.replace("[bold]", "").replace("[/bold]", "")
    assert printed(text, terminal=False) == [plain]
    lines = printed(text, terminal=True)
    assert len(lines) > 1
    assert [word for line in lines for word in line.split()] == plain.split()
    assert printed(f"Saved: {path}", terminal=True) == [f"Saved: {path}"]


def test_wrong_usage_leaves_with_2(glbench: Command) -> None:
    assert glbench("evaluate").code == 2
    assert glbench("evaluat").code == 2


def test_debug_shows_the_traceback(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from glbench.cli.app import main

    monkeypatch.setenv("GLBENCH_DEBUG", "0")
    with pytest.raises(GlbenchError, match=r"nowhere\.py"):
        main(["--debug", "evaluate", str(tmp_path / "nowhere.py")])
