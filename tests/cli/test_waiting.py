"""An agent that lets others wait is named while they wait, and one of whom all runs failed is no success."""

from __future__ import annotations

import os
import re
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from glbench.cli import progress
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from tests.cli.command_line import Command

TASK = ("--task", "day.toml")
GLBENCH = (sys.executable, "-c", "from glbench_command import main; main()")
SLEEP = "import time; time.sleep(3.5)"
PLACES = {
    "loading": ("import numpy as np\n", f"import numpy as np\n{SLEEP}\n"),
    "reset": ("        self.n = n_runs\n", f"        self.n = n_runs; {SLEEP}\n"),
    "act": ("        return np.full", f"        {SLEEP.replace('3.5', '3.5 if self.first() else 0')}\n        return np.full"),
}


def stalling(here: Path, place: str) -> str:
    text = (here / "steady.py").read_text(encoding="utf-8")
    old, new = PLACES[place]
    assert old in text
    once = "    def first(self):\n        self.asked = getattr(self, 'asked', 0) + 1\n        return self.asked == 24\n"
    (here / "stalls.py").write_text(text.replace(old, new).replace("    def act", f"{once}    def act"), encoding="utf-8")
    return "stalls.py"


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("sandbox", ["none", "bubblewrap"])
@pytest.mark.parametrize("others", [(), ("steady.py",)], ids=["alone", "of two"])
def test_where_there_is_no_terminal_a_line_says_who_is_waited_for(
    glbench: Command, here: Path, monkeypatch: pytest.MonkeyPatch, place: str, sandbox: str, others: tuple[str, ...]
) -> None:
    if sandbox == "bubblewrap" and why_no_sandbox() is not None:
        pytest.skip("no sandbox here")
    monkeypatch.setattr(progress, "_PATIENCE_SECONDS", 1.5)
    answer = glbench("evaluate", stalling(here, place), *others, *TASK, "--sandbox", sandbox)
    assert answer.code == 0, answer.err
    if place == "loading" and sandbox == "none":
        assert re.search(r"waiting for the agents to load, [23] s", answer.err)
    else:
        limit = 30 if place == "act" else 300
        assert re.search(rf"waiting for {place} of stalls( on Day-v1)?, [23] of {limit} s", answer.err)
    assert "of steady" not in "".join(line for line in answer.err.splitlines() if "waiting" in line)


def test_who_does_not_let_others_wait_is_not_named(glbench: Command, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "_PATIENCE_SECONDS", 30.0)
    assert "waiting for" not in glbench("evaluate", "steady.py", *TASK).err


@pytest.mark.slow
def test_on_a_terminal_the_seconds_count(here: Path) -> None:
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    text = "from glbench.cli import progress; progress._PATIENCE_SECONDS = 1.5; from glbench_command import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", text, "evaluate", stalling(here, "reset"), *TASK],
        stdout=subprocess.DEVNULL, stderr=theirs, env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "150"},
    )  # fmt: skip
    os.close(theirs)
    seen, until = b"", time.monotonic() + 120.0
    while time.monotonic() < until:
        if select.select([ours], [], [], 0.2)[0]:
            try:
                seen += os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
    assert process.wait(timeout=60) == 0
    os.close(ours)
    assert re.search(rb"waiting for reset of stalls, [23] of 300 s", seen)


@pytest.mark.parametrize("others", [(), ("steady.py",)], ids=["alone", "of two"])
@pytest.mark.parametrize("flag", [(), ("--json",)], ids=["words", "json"])
def test_an_agent_of_whom_all_runs_failed_is_no_success(
    glbench: Command, here: Path, others: tuple[str, ...], flag: tuple[str, ...]
) -> None:
    text = (here / "steady.py").read_text(encoding="utf-8")
    (here / "broken.py").write_text(text.replace("return np.full", "raise ValueError('x') or np.full"), encoding="utf-8")
    for _ in range(2):  # the second time, the result is there already
        answer = glbench("evaluate", "broken.py", *others, *TASK, *flag)
        assert answer.code == 1
        assert "All 3 runs of broken failed" in answer.err
    one = glbench("evaluate", "broken.py", *others, *TASK, *flag, "--runs", "1")
    assert one.code == 1
    assert "The only run of broken failed" in one.err


def test_an_agent_of_whom_some_runs_failed_is_one(glbench: Command, here: Path) -> None:
    text = (here / "steady.py").read_text(encoding="utf-8")
    some = "a = np.full((self.n, 6), 0.01); a[0] = 9.0; return a or np.full".replace("a or np.full", "a\n        return np.full")
    (here / "some.py").write_text(text.replace("return np.full", some), encoding="utf-8")
    answer = glbench("evaluate", "some.py", *TASK)
    assert answer.code == 0
    assert "1 of 3 runs failed." in answer.err
