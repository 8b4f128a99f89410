from __future__ import annotations

import importlib.util
import json
import os
from pathlib import Path

import pytest

from glbench.tasks import DEFAULT_TASK
from tests.cli.command_line import Command


def test_a_new_submission_passes_its_check_and_is_evaluated(glbench: Command, here: Path) -> None:
    written = glbench("submit", "new", "anna")
    assert written.code == 0
    assert "Next: glbench submit check anna" in written.err
    checked = glbench("submit", "check", "anna", "--task", "day.toml")
    assert checked.code == 0, checked.out + checked.err
    assert "No problems found." in checked.out
    assert "Same decisions alone and in a batch" in checked.out
    assert "Next: glbench evaluate anna --task day.toml --runs 2, then without --runs." in checked.err  # it has no splits
    assert glbench("evaluate", "anna", "--task", "day.toml").code == 0
    result = json.loads(Path("reports/results/Day-v1/anna.json").read_text(encoding="utf-8"))
    assert result["agent"]["card"]["name"] == "anna"


def test_the_check_sends_trials_to_the_validation_split_where_the_task_has_one(glbench: Command, here: Path) -> None:
    checked = glbench("submit", "check", "steady.py")
    assert "Next: glbench evaluate steady.py --runs 2 --split validation, then without these options" in checked.err


def test_problems_make_the_check_leave_with_1(glbench: Command, here: Path) -> None:
    broken = (here / "steady.py").read_text(encoding="utf-8").replace("return np", "1 / 0; return np")
    (here / "broken.py").write_text(broken, encoding="utf-8")
    answer = glbench("submit", "check", "broken.py", "--task", "day.toml", "--json")
    assert answer.code == 1
    report = json.loads(answer.out)
    problems = [finding for finding in report["findings"] if finding["level"] == "problem"]
    assert [finding["subject"] for finding in problems] == ["decisions"]
    assert "ZeroDivisionError" in problems[0]["text"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("new", "steady.py"), "is there already"),
        (("new", "anna", "--kind", "rules"), "Did you mean 'rule'"),
        (("check", "rule_based"), "is a baseline of glbench and no submission"),
        (("check", "anna"), "'anna' is neither a file or folder here nor a baseline"),
    ],
)
def test_mistakes_are_told_in_words(glbench: Command, here: Path, arguments: tuple[str, ...], words: str) -> None:
    answer = glbench("submit", *arguments)
    assert answer.code == 1
    assert words in answer.err
    assert "Traceback" not in answer.err


@pytest.mark.parametrize("name", [b"caf\xe9", b"\x1b[2Jevil", "\u202eevil".encode(), b"x.proof"], ids=ascii)
@pytest.mark.parametrize("command", [("submit", "check"), ("evaluate",)], ids=" ".join)
def test_names_that_cannot_be_shown_are_refused_and_cannot_steer_a_terminal(
    glbench: Command, here: Path, name: bytes, command: tuple[str, ...]
) -> None:
    file = here / os.fsdecode(name + b".py")
    file.write_bytes((here / "steady.py").read_bytes())
    answer = glbench(*command, file.name, "--task", "day.toml")

    said = answer.out + answer.err
    assert answer.code == 1
    assert "cannot be the name of an agent" in said
    assert all(letter.isprintable() or letter == "\n" for letter in said)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("stable_baselines3") is None, reason="Stable-Baselines3 is not installed")
def test_the_template_of_a_model_comes_with_one_that_runs(glbench: Command, here: Path) -> None:
    written = glbench("submit", "new", "learner", "--kind", "sb3")
    assert "learner/model.zip" in written.err
    short = f'schema = 2\nbase = "{DEFAULT_TASK}"\nid = "test/Short-v1"\ntitle = "A day"\nweather.days = 1\nevaluation.runs = 3\n'
    (here / "short.toml").write_text(short, encoding="utf-8")
    answer = glbench("evaluate", "learner", "--task", "short.toml", "--json")
    assert answer.code == 0, answer.err
    assert json.loads(answer.out)["summary"]["ok"] == 3
