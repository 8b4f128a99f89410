"""Names, files and devices that nobody should give: each ends in words."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from glbench.resources import data_folder
from tests.cli.command_line import Command

TASK = ("--task", "day.toml")
LONG = "a" * 300
ODD = os.fsdecode(b"odd\xff")
RELEASED = data_folder("reports/released/results") / "Schiphol2010-Delta10-v1" / "rule_based.json"


@pytest.fixture
def odd(here: Path) -> Path:
    """The current folder with a pipe, a folder and changed tasks in the place of task files, and files with odd names."""
    os.mkfifo(here / "pipe.toml")
    (here / "folder.toml").mkdir()
    day = (here / "day.toml").read_text(encoding="utf-8")
    (here / "late.toml").write_text(day.replace("2010-03-01", "9999-12-31"), encoding="utf-8")
    (here / "early.toml").write_text(day.replace("2010-03-01", "0001-01-01"), encoding="utf-8")
    for key, begin in {"title": 'title = "', "description": 'description = """'}.items():
        assert begin in day
        (here / f"red-{key}.toml").write_text(day.replace(begin, f"{begin}\\u001b[31m", 1), encoding="utf-8")
    for name in ("x.proof.py", "Rule-Based.py", f"{ODD}.py"):
        (here / name).write_bytes((here / "steady.py").read_bytes())
    (here / "my files").mkdir()
    (here / "my files" / "odd.csv").write_text("nothing known\n", encoding="utf-8")
    return here


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("evaluate", "steady.py", *TASK, "--runs", "1000000000"), "at most 10,000 runs; got 1,000,000,000"),
        (("evaluate", "steady.py", *TASK, "--out", LONG), "File name too long"),
        (("evaluate", "steady.py", *TASK, "--late"), "--late is for a round that has closed: name its file with --round."),
        (("leaderboard", "--out", LONG), "File name too long"),
        (
            ("evaluate", "rule_based_fair", "--task", "Transfer-Miami-v1", "--split", "preview"),
            "--split preview is not evaluated: training and preview seasons are not scored. Use --split",
        ),
        (("bench", "step", "--quick"), "--quick chooses the measurements itself. Leave out --quick or step."),
        (("ladder", "Spring-v1", "--agents", "", "--agent-runs", "2"), "--agent-runs limits agents, and there are none for"),
        (("show", LONG), "File name too long"),
        (("evaluate", "steady.py", "--task", "pipe.toml"), "pipe.toml: it is a folder, a pipe or a device"),
        (("evaluate", "steady.py", "--task", "folder.toml"), "folder.toml: it is a folder, a pipe or a device"),
        (("tasks", "show", "late.toml"), "in the years 1900 to 2199"),
        (("tasks", "show", "early.toml"), "in the years 1900 to 2199"),
        (("tasks", "show", "red-title.toml"), "It holds the character U+001B"),
        (("tasks", "show", "red-description.toml"), "It holds the character U+001B"),
        (("evaluate", "x.proof.py", *TASK), "not ending in '.proof'"),
        (("evaluate", "Rule-Based.py", *TASK), "'Rule-Based' looks like 'rule_based', the name of a baseline"),
        (("evaluate", f"{ODD}.py", *TASK), "'odd?' cannot be the name of an agent"),
        (("evaluate", f"{ODD}s.py", *TASK), "There is no file or folder odd?s.py"),
        (("evaluate", "submissions/my_agent.py"), "`glbench submit new submissions --kind example` writes it"),
        (("evaluate", "my_agent.py"), "`glbench submit new . --kind example` writes it"),
        (("evaluate", "my files/my_agent.py"), "`glbench submit new 'my files' --kind example` writes it"),
        (("weather", "import", "my files/odd.csv", "--name", "odd"), "`glbench weather columns 'my files/odd.csv'` writes a column map"),
    ],
)
def test_odd_input_ends_in_words(glbench: Command, odd: Path, arguments: tuple[str, ...], words: str) -> None:
    answer = glbench(*arguments)
    assert answer.code == 1
    said = [line for line in answer.err.splitlines() if not line.startswith("waiting for ")]  # as on a busy machine
    assert said[0].startswith("Error: ")
    assert words in answer.err
    assert "Traceback" not in answer.err
    assert "\x1b" not in answer.err


def test_a_folder_need_not_be_called_by_text(glbench: Command, here: Path) -> None:
    answer = glbench("evaluate", "steady.py", *TASK, "--out", ODD)
    assert answer.code == 0
    assert "Next: glbench leaderboard --out odd\\udcff" in answer.err
    assert (here / ODD / "results" / "Day-v1" / "steady.json").is_file()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device here")
@pytest.mark.parametrize("arguments", [("tasks", "list", "--json"), ("show", str(RELEASED)), ("--help",)])
def test_a_full_device_is_said(here: Path, arguments: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "glbench", *arguments],
            stdout=full, stderr=subprocess.PIPE, text=True, check=False, timeout=300,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("Error: No space left on device")
    assert "Traceback" not in done.stderr


def test_examples_are_written_where_there_are_none(glbench: Command, here: Path) -> None:
    answer = glbench("submit", "new", "submissions", "--kind", "example")
    assert answer.code == 0
    assert f"Next: glbench evaluate {Path('submissions') / 'my_agent.py'}" in answer.err
    written = {path.name for path in (here / "submissions").iterdir()}
    assert {"my_agent.py", "constant_setpoints.py", "pi_controller.py", "do_nothing.py", "energy_agent.py"} <= written
    assert glbench("submit", "new", "submissions", "--kind", "example").code == 0, "the examples themselves are no obstacle"
    (here / "submissions" / "my_agent.py").write_text("# mine\n", encoding="utf-8")
    again = glbench("submit", "new", "submissions", "--kind", "example")
    assert again.code == 1
    assert "is there already, and nothing is overwritten" in again.err
    assert (here / "submissions" / "my_agent.py").read_text(encoding="utf-8") == "# mine\n"


@pytest.mark.slow
def test_commands_leave_the_released_results_alone(glbench: Command, here: Path) -> None:
    def state() -> dict[Path, tuple[int, int]]:
        folder = data_folder("reports/released/results").parent
        return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*")}

    before = state()
    for arguments in (
        ("evaluate", "rule_based", *TASK),
        ("badge", "rule_based"),
        ("verify", str(RELEASED)),
        ("show", str(RELEASED)),
        ("show", "rule_based"),
    ):
        assert glbench(*arguments).code == (2 if arguments[0] == "verify" else 0), arguments
    assert state() == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("verify", "loop"),
        ("verify", "results"),
        ("evaluate", "loop", *TASK),
        ("evaluate", "loop.py", *TASK),
        ("evaluate", "steady.py", "--task", "loop.toml"),
        ("evaluate", "steady.py", *TASK, "--out", "loop"),
        ("evaluate", "steady.py", *TASK, "--round", "loop.toml"),
        ("tasks", "check", "loop.toml"),
        ("round", "check", "loop.toml"),
        ("leaderboard", "--out", "loop"),
        ("bound", "--submit", "loop.npz"),
        ("episodes", "info", "loop.mcap"),
        ("submit", "check", "loop"),
    ],
    ids=" ".join,
)
def test_a_link_that_leads_back_to_itself_ends_in_words(glbench: Command, here: Path, arguments: tuple[str, ...]) -> None:
    for name in ("loop", "loop.py", "loop.toml", "loop.npz", "loop.mcap"):
        (here / name).symlink_to(name)
    (here / "results").mkdir()
    (here / "results" / "x.json").symlink_to("x.json")
    (here / "results" / "again").symlink_to(".")
    answer = glbench(*arguments)
    assert answer.code in (1, 2)
    assert "Traceback" not in answer.err
    assert any(words in answer.err + answer.out for words in ("symbolic links", "neither a file or folder", "There is no"))
