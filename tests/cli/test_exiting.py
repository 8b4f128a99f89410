"""How commands end when they are interrupted, and when an agent leaves threads at work."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from glbench.evaluation import load_result
from tests.support import wait_for_checkpoint

pytestmark = pytest.mark.slow

GLBENCH = (sys.executable, "-c", "from glbench_command import main; main()")
ARGUMENTS = ("--task", "day.toml", "--workers", "1")
PATIENT = "import os, time; time.sleep(0 if os.path.exists('hurry') else 1.0); return np"


def started(*arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen([*GLBENCH, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.fixture
def slow(here: Path) -> Path:
    text = (here / "steady.py").read_text(encoding="utf-8").replace("return np", PATIENT)
    (here / "slow.py").write_text(text, encoding="utf-8")
    return here


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_being_ended_from_outside_is_told_and_the_same_command_goes_on(slow: Path, number: int, code: int) -> None:
    process = started("evaluate", "slow.py", *ARGUMENTS)
    wait_for_checkpoint(slow, process)
    process.send_signal(number)
    _, err = process.communicate(timeout=300)

    assert process.returncode == code, err
    assert "Interrupted." in err
    assert "continues from the last checkpoint" in err
    assert "Traceback" not in err
    (slow / "hurry").touch()
    rest = subprocess.run([*GLBENCH, "evaluate", "slow.py", *ARGUMENTS], capture_output=True, text=True, check=False)
    assert rest.returncode == 0, rest.stderr
    at = load_result(Path("reports/results/Day-v1/slow.json")).evaluation.resumed_at_step
    assert f"Going on at step {at} of 24, where it was interrupted." in rest.stderr
    assert not list(Path("reports").rglob("*.lock"))
    assert not (Path("reports") / ".partial").exists()


def test_signals_that_are_ignored_stay_ignored_and_it_can_still_be_ended(slow: Path) -> None:
    """As nohup ignores HUP, and a script ignores INT for what it starts in the background."""
    process = subprocess.Popen(
        ["sh", "-c", """trap '' INT HUP; exec "$@" """, "sh", *GLBENCH, "evaluate", "slow.py", *ARGUMENTS],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    wait_for_checkpoint(slow, process)
    for number in (signal.SIGINT, signal.SIGHUP):
        process.send_signal(number)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=300)

    assert process.returncode == 143
    assert "continues from the last checkpoint" in err


WITHOUT_PROBLEMS = """
import os, signal, sys, threading, time
threading.Thread(target=lambda: (time.sleep(float(sys.argv.pop())), os.kill(os.getpid(), signal.SIGINT)), daemon=True).start()
from glbench_command import main
main()
"""


@pytest.mark.parametrize("seconds", ["0.1", "0.3", "0.6", "1.0"])
def test_ctrl_c_while_everything_is_still_being_loaded_shows_no_traceback(slow: Path, seconds: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_PROBLEMS, "evaluate", "slow.py", *ARGUMENTS, seconds],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 130
    assert "Interrupted." in done.stderr
    assert "Traceback" not in done.stderr


def test_threads_that_an_agent_leaves_do_not_keep_the_command_alive(here: Path) -> None:
    text = (here / "steady.py").read_text(encoding="utf-8")
    thread = "import threading, time; threading.Thread(target=time.sleep, args=(600,), name='pump').start(); self.n"
    (here / "busy.py").write_text(text.replace("self.n =", f"{thread} =", 1), encoding="utf-8")
    done = subprocess.run([*GLBENCH, "evaluate", "busy.py", *ARGUMENTS], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "Reward" in done.stdout
    assert "An agent left threads at work (pump)" in done.stderr


def test_without_a_terminal_a_line_says_now_and_then_how_far_it_is(here: Path) -> None:
    text = (here / "steady.py").read_text(encoding="utf-8").replace("return np", "import time; time.sleep(0.5); return np")
    (here / "lazy.py").write_text(text, encoding="utf-8")
    done = subprocess.run([*GLBENCH, "evaluate", "lazy.py", *ARGUMENTS], capture_output=True, text=True, check=False)
    lines = [line for line in done.stderr.splitlines() if line.startswith("running: step ")]
    assert len(lines) >= 2
    assert all("of 24 (" in line and "steps/s" in line for line in lines)
