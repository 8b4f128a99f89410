"""``glbench evaluate --sandbox`` as a person meets it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from glbench.evaluation import load_result
from glbench.evaluation.sandbox import bubblewrap
from tests.cli.command_line import Command

ARGUMENTS = ("--task", "day.toml", "--workers", "1")
PLACE = Path("reports/results/Day-v1")


@pytest.fixture
def with_bubblewrap(here: Path) -> None:
    reason = bubblewrap.why_no_sandbox()
    if reason is not None:
        pytest.skip(reason)


@pytest.fixture
def without_bubblewrap(here: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    # Only bubblewrap: without a compiler, this process would keep the slow kernel for all tests to come.
    which = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name, *rest: None if name == "bwrap" else which(name, *rest))
    bubblewrap._tried.cache_clear()
    yield
    bubblewrap._tried.cache_clear()


@pytest.mark.usefixtures("with_bubblewrap")
def test_what_an_agent_prints_is_shown_when_it_fails(glbench: Command, here: Path) -> None:
    broken = (here / "steady.py").read_text(encoding="utf-8").replace("return np", "print('on my way'); 1 / 0; return np")
    (here / "broken.py").write_text(broken, encoding="utf-8")
    answer = glbench("evaluate", "broken.py", *ARGUMENTS, "--sandbox", "bubblewrap")

    assert answer.code == 1
    assert "in a sandbox (bubblewrap)" in answer.err
    assert "ZeroDivisionError: division by zero (broken.py:6 in act)" in answer.err
    assert "What broken printed:\n  on my way\n" in answer.err
    assert load_result(PLACE / "broken.json").evaluation.sandbox == "bubblewrap"


@pytest.mark.usefixtures("with_bubblewrap")
def test_what_an_agent_prints_is_shown_on_demand_only(glbench: Command, here: Path) -> None:
    talking = (here / "steady.py").read_text(encoding="utf-8").replace("return np", "print('hm'); return np")
    (here / "talking.py").write_text(talking, encoding="utf-8")
    quiet = glbench("evaluate", "talking.py", *ARGUMENTS, "--sandbox", "auto")
    shown = glbench("evaluate", "talking.py", *ARGUMENTS, "--sandbox", "auto", "--show-prints", "--fresh")

    assert "hm" not in quiet.out + quiet.err
    assert shown.err.count("  hm\n") == 24


@pytest.mark.usefixtures("with_bubblewrap")
def test_a_file_that_cannot_be_loaded_does_not_stop_the_next(glbench: Command, here: Path) -> None:
    (here / "gone.py").write_text("import os; print('bye'); os._exit(3)", encoding="utf-8")
    answer = glbench("evaluate", "gone.py", "steady.py", *ARGUMENTS, "--sandbox", "bubblewrap")

    assert answer.code == 1
    said = " ".join(answer.err.split())
    assert "The agent 'gone' cannot be made: the agent's process ended with exit code 3. It printed: bye" in said
    assert (PLACE / "steady.json").is_file()


@pytest.mark.usefixtures("without_bubblewrap")
def test_without_bubblewrap_it_says_what_to_install_and_what_else_can_be_done(
    glbench: Command, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GLBENCH_SANDBOX")
    answer = glbench("evaluate", "steady.py", *ARGUMENTS)

    assert answer.code == 1
    assert answer.err.startswith("Error: 'steady' was not run.")
    assert "apt-get install bubblewrap" in answer.err
    assert "--sandbox none" in answer.err
    assert glbench("evaluate", "steady.py", *ARGUMENTS, "--sandbox", "none").code == 0
    assert load_result(PLACE / "steady.json").evaluation.sandbox == "unsandboxed"
