from __future__ import annotations

import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from glbench.errors import GlbenchError
from glbench.evaluation import METRICS, load_result
from tests.cli.command_line import Command
from tests.support import wait_for_checkpoint

ARGUMENTS = ("--task", "day.toml", "--workers", "1")
GLBENCH = (sys.executable, "-c", "from glbench.cli.app import main; main()")
PATIENT = "import os, time; time.sleep(0 if os.path.exists('hurry') else 0.3); return np"
PLACE = Path("reports/results/Day-v1")


def test_the_table_has_a_unit_for_every_number_and_says_what_comes_next(glbench: Command, here: Path) -> None:
    answer = glbench("evaluate", "steady.py", *ARGUMENTS)

    assert answer.code == 0
    assert "steady on test/Day-v1" in answer.err
    assert "3 runs (seeds 666 to 668) of 1 day, 24 steps of 3600 s; 1 worker" in answer.err
    rows = [line.split("│") for line in answer.out.splitlines() if line.count("│") == 6]
    assert len(rows) == len(METRICS) + 2
    assert all(row[2].strip() in {"–", "EUR/m²", "kWh/m²", "kg/m²", "h", "ms", "s"} for row in rows)
    result = load_result(PLACE / "steady.json")
    reward = next(row for row in rows if row[1].strip() == "Reward")
    assert float(reward[3]) == pytest.approx(result.summary.mean["reward"], abs=0.006)
    low, high = (float(end) for end in reward[5].split("to"))
    assert low <= float(reward[3]) <= high
    assert f"Saved: {PLACE / 'steady.json'}" in answer.err
    assert "glbench leaderboard" in answer.err


def test_json_is_one_line_a_result_whatever_the_agent_prints(glbench: Command, here: Path) -> None:
    talking = (
        (here / "steady.py")
        .read_text(encoding="utf-8")
        .replace("return np.full", "print('hm'); import os; os.write(1, b'ho'); return np.full")
    )
    talking = talking.replace("def make_agent(task):", "print('loaded')\ndef make_agent(task):\n    print('made')")
    (here / "talking.py").write_text(talking, encoding="utf-8")
    answer = glbench("evaluate", "talking.py", "steady.py", *ARGUMENTS, "--json")

    documents = [json.loads(line) for line in answer.out.splitlines()]
    assert [document["agent"]["name"] for document in documents] == ["talking", "steady"]
    assert documents[0] == json.loads((PLACE / "talking.json").read_text(encoding="utf-8"))
    assert answer.err.count("hm") == 24
    assert "loaded" in answer.err
    assert "made" in answer.err


def test_what_is_finished_is_shown_and_not_done_again(glbench: Command, here: Path) -> None:
    glbench("evaluate", "steady.py", *ARGUMENTS)
    before = (PLACE / "steady.json").read_bytes()
    again = glbench("evaluate", "steady.py", *ARGUMENTS)

    assert again.code == 0
    assert "Already evaluated on" in again.err
    assert "Reward" in again.out
    assert (PLACE / "steady.json").read_bytes() == before
    assert "Already evaluated" not in glbench("evaluate", "steady.py", *ARGUMENTS, "--fresh").err


def test_failed_runs_are_said_loudly_and_are_a_result_nevertheless(glbench: Command, here: Path) -> None:
    broken = (here / "steady.py").read_text(encoding="utf-8").replace("return np", "1 / 0; return np")
    (here / "broken.py").write_text(broken, encoding="utf-8")
    answer = glbench("evaluate", "broken.py", *ARGUMENTS)

    assert answer.code == 1
    assert "3 of 3 runs failed." in answer.err
    assert "crashed after 0 steps (3 runs: seeds 666, 667, 668): ZeroDivisionError: division by zero (broken.py:6 in act)" in answer.err
    assert "Decision, each step" not in answer.out, "a table of nothing"
    assert "Next: glbench submit check broken.py" in answer.err
    assert load_result(PLACE / "broken.json").summary.failed == 3


def test_one_agent_that_cannot_be_made_does_not_stop_the_next(glbench: Command, here: Path) -> None:
    unmade = (here / "steady.py").read_text(encoding="utf-8").replace("return Steady()", "raise OSError('no weights')")
    (here / "unmade.py").write_text(unmade, encoding="utf-8")
    answer = glbench("evaluate", "unmade.py", "steady.py", *ARGUMENTS)

    assert answer.code == 1
    assert "no weights" in answer.err
    assert (PLACE / "steady.json").is_file()
    assert not (PLACE / "unmade.json").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("http://127.0.0.1:8000", *ARGUMENTS), "an agent behind an address gets no score: the sandbox has no network"),
        (("nowhere.py", *ARGUMENTS), "There is no file or folder nowhere.py"),
        (("rule_base", *ARGUMENTS), "Did you mean 'rule_based'"),
        (("steady.py", "--task", "Schiphol2010-Delta1-v1"), "Did you mean 'Schiphol2010-Delta1"),
        (("steady.py", "--task", "nowhere.toml"), "nowhere.toml"),
        (("steady.py", "--suite", "papers"), "Did you mean 'paper'"),
        (("steady.py", *ARGUMENTS, "--out", "day.toml"), "Cannot write into"),
        (("steady.py", *ARGUMENTS, "--seed", "9007199254740993"), "2^53 - 1"),
        (("steady.py", "other/steady.py", *ARGUMENTS), "Two different agents are called 'steady'"),
    ],
)
def test_mistakes_are_told_in_words_without_a_traceback(glbench: Command, here: Path, arguments: tuple[str, ...], words: str) -> None:
    (here / "other").mkdir()
    (here / "other" / "steady.py").write_text((here / "steady.py").read_text(encoding="utf-8") + "\n", encoding="utf-8")
    answer = glbench("evaluate", *arguments)

    assert answer.code == 1
    assert answer.err.startswith("Error: ")
    assert words in answer.err
    assert "Traceback" not in answer.err
    assert answer.out == ""


@pytest.mark.slow
def test_ctrl_c_leaves_with_130_and_the_same_command_goes_on(here: Path) -> None:
    slow = (here / "steady.py").read_text(encoding="utf-8").replace("return np", PATIENT)
    (here / "slow.py").write_text(slow, encoding="utf-8")
    command = [*GLBENCH, "evaluate", "slow.py", "--task", "day.toml", "--workers", "2"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    wait_for_checkpoint(here, process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all processes of the group
    out, err = process.communicate(timeout=300)

    assert process.returncode == 130
    assert "Interrupted." in err
    assert "the same command (without --fresh) continues from the last checkpoint" in err
    assert "Traceback" not in err
    assert out == ""
    (here / "hurry").touch()
    rest = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert rest.returncode == 0, rest.stderr
    resumed_at = load_result(PLACE / "slow.json").evaluation.resumed_at_step
    assert resumed_at is not None
    assert 0 < resumed_at < 24


@pytest.mark.slow
def test_on_a_terminal_a_bar_shows_step_speed_and_time_left(here: Path) -> None:
    pty = pytest.importorskip("pty")
    slow = (here / "steady.py").read_text(encoding="utf-8").replace("return np", "import time; time.sleep(0.02); return np")
    (here / "slow.py").write_text(slow, encoding="utf-8")
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*GLBENCH, "evaluate", "slow.py", *ARGUMENTS],
        stdout=subprocess.DEVNULL, stderr=theirs, env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "150"},
    )  # fmt: skip
    os.close(theirs)
    seen = b""
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline:
        ready, _, _ = select.select([ours], [], [], 0.2)
        if ready:
            try:
                seen += os.read(ours, 65536)
            except OSError:  # the other end is closed
                break
        elif process.poll() is not None:
            break
    assert process.wait(timeout=300) == 0
    os.close(ours)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen.decode("utf-8", errors="replace"))
    assert re.search(r"running .*%.* step \d+ of 24 .* steps/s .*left", text)


@pytest.mark.parametrize(
    ("full", "words"),
    [
        ("glbench.evaluation.files.write_atomically", "Nothing of this evaluation is saved"),
        ("glbench.evaluation.saving.write_atomically", "The result is saved, and not the recorded actions"),
        ("glbench.episodes.episode.write_atomically", "are saved, and not all of profile and full episodes"),
    ],
)
def test_a_full_disk_takes_nobody_the_table(glbench: Command, here: Path, monkeypatch: pytest.MonkeyPatch, full: str, words: str) -> None:
    def no_room(path: Path, _data: bytes | str) -> None:
        msg = f"Cannot write {path}: No space left on device."
        raise GlbenchError(msg)

    with monkeypatch.context() as patch:
        patch.setattr(full, no_room)
        # No checkpoint found room either, so that none may be promised.
        patch.setattr("glbench.evaluation.checkpoint.write_atomically", no_room)
        answer = glbench("evaluate", "steady.py", *ARGUMENTS)
    assert answer.code == 1
    assert "Reward" in answer.out
    assert "No space left on device" in answer.err
    assert words in answer.err
    assert "checkpoint" not in answer.err.replace("No further checkpoints", "")
    assert "Saved:" not in answer.err
    again = glbench("evaluate", "steady.py", *ARGUMENTS)
    assert again.code == 0
    assert len(list(here.rglob("seed-*.mcap"))) == 3


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can make a small disk")
def test_on_a_disk_that_is_really_full_the_table_is_shown(glbench: Command, here: Path) -> None:
    disk = here / "disk"
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", disk], check=False).returncode != 0:
        pytest.skip("no small disk can be mounted here")
    try:
        answer = glbench("evaluate", "steady.py", *ARGUMENTS, "--out", disk)
        assert answer.code == 1
        assert "Reward" in answer.out
        assert "No space left on device" in answer.err
        assert load_result(disk / "results" / "Day-v1" / "steady.json").summary.ok == 3
    finally:
        subprocess.run(["umount", disk], check=True)


def test_a_changed_example_is_told_that_its_name_is_taken(glbench: Command, here: Path) -> None:
    (here / "my_agent.py").write_bytes((here / "steady.py").read_bytes())
    answer = glbench("evaluate", "my_agent.py", *ARGUMENTS)
    assert answer.code == 0
    assert "'my_agent' is the name of an example of glbench, and this one is changed" in " ".join(answer.err.split())
