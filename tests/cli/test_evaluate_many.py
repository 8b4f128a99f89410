"""Several agents on several tasks: nothing stops the others, nothing finished is done again or lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from glbench.evaluation import load_result
from glbench.evaluation.sandbox.bubblewrap import why_no_sandbox
from tests.cli.command_line import Command
from tests.support import wait_for_checkpoint

GLBENCH = (sys.executable, "-c", "from glbench.cli.app import main; main()")
PLACE = Path("reports/results/Day-v1")
MONEY = """
base = "glbench/Spring-v1"
id = "test/Money-v1"
title = "A day of spring"
weather.days = 1
evaluation.runs = 3
"""


def variant(here: Path, name: str, old: str = "0.01", new: str = "0.02") -> str:
    text = (here / "steady.py").read_text(encoding="utf-8")
    assert old in text
    (here / name).write_text(text.replace(old, new), encoding="utf-8")
    return name


def second_task(here: Path) -> str:
    text = (here / "day.toml").read_text(encoding="utf-8").replace("test/Day-v1", "test/Other-v1")
    (here / "other.toml").write_text(text, encoding="utf-8")
    return "other.toml"


def test_one_line_for_each_and_a_summary_with_all(glbench: Command, here: Path) -> None:
    arguments = ("evaluate", "steady.py", variant(here, "quick.py"), "-t", "day.toml", "-t", second_task(here))
    answer = glbench(*arguments)
    assert answer.code == 0, answer.err
    for line in ("1/4 steady on Day-v1: reward", "2/4 quick on Day-v1", "3/4 steady on Other-v1", "4/4 quick on Other-v1"):
        assert line in answer.err
    means = {agent: load_result(PLACE / f"{agent}.json").summary.mean["reward"] for agent in ("steady", "quick")}
    row = next(line for line in answer.out.splitlines() if "Day-v1" in line)
    assert [float(cell.replace(",", "")) for cell in row.split("│")[2:4]] == [pytest.approx(mean, abs=0.06) for mean in means.values()]
    again = glbench(*arguments)
    assert again.code == 0
    assert again.err.count("already there") == 4


def test_tasks_stand_side_by_side_each_with_what_ranks_on_it(glbench: Command, here: Path) -> None:
    day = (here / "day.toml").read_text(encoding="utf-8")
    rich = day.replace("test/Day-v1", "test/Rich-v1").replace('metric = "reward"', 'metric = "epi"')
    assert rich.count('metric = "epi"') == 1
    (here / "rich.toml").write_text(rich, encoding="utf-8")
    (here / "money.toml").write_text(MONEY, encoding="utf-8")
    answer = glbench("evaluate", "steady.py", "-t", "rich.toml", "-t", "money.toml")
    assert answer.code == 0, answer.err
    assert "EPI [EUR/m²] or Score [EUR/m²], mean over the runs" in " ".join(answer.out.split())
    for task, metric, words in (("Rich-v1", "epi", "EPI"), ("Money-v1", "reward", "score")):
        mean = load_result(Path("reports/results") / task / "steady.json").summary.mean[metric]
        row = next(line for line in answer.out.splitlines() if task in line)
        assert row.split("│")[2].strip() == f"{mean:,.3f}"
        assert f"steady on {task}: {words} {mean:,.3f} EUR/m²" in answer.err


@pytest.mark.usefixtures("few_released")
def test_where_the_score_is_money_people_read_of_score_profit_and_violations(glbench: Command, here: Path) -> None:
    (here / "money.toml").write_text(MONEY, encoding="utf-8")
    one = glbench("evaluate", "steady.py", "-t", "money.toml")
    board, shown = glbench("leaderboard"), glbench("show", "steady")
    assert (one.code, board.code, shown.code) == (0, 0, 0)
    for words in ("Score = profit - violations", "Profit = revenue - costs", "Violations"):
        assert words in one.out
    for words in ("Score", "Profit", "Violations", "Profit is "):
        assert words in board.out
    assert "worst tenth (CVaR10): score" in shown.out
    for text in (one.out, board.out, shown.out):
        assert "EPI" not in text


def test_what_changed_is_evaluated_again_and_nothing_else(glbench: Command, here: Path) -> None:
    other = variant(here, "quick.py")
    glbench("evaluate", "steady.py", other, "-t", "day.toml")
    variant(here, "quick.py", new="0.03")
    answer = glbench("evaluate", "steady.py", other, "-t", "day.toml")
    assert "steady on Day-v1" in answer.err
    assert answer.err.count("already there") == 1
    assert load_result(PLACE / "quick.json").evaluation.resumed_at_step is None


def test_failures_of_all_kinds_stop_no_other_and_stand_in_the_end_with_their_reasons(glbench: Command, here: Path) -> None:
    unmade = variant(here, "unmade.py", "return Steady()", "raise OSError('no weights')")
    syntax = variant(here, "wrong.py", "class Steady:", "class Steady")
    crash = variant(here, "crash.py", "return np", "1 / 0; return np")
    answer = glbench("evaluate", unmade, "nowhere.py", syntax, crash, "steady.py", "-t", "day.toml")
    assert answer.code == 1
    assert load_result(PLACE / "steady.json").summary.ok == 3
    assert "3 runs, 3 failed" in answer.err, "failed runs are a result"
    assert "4 failed:" in answer.err
    end = answer.err.rpartition("4 failed:")[2]
    for words in ("unmade on Day-v1", "no weights", "nowhere.py: There is no file", "wrong.py is no valid Python"):
        assert words in end


def test_json_holds_one_line_a_result_and_the_exit_code_tells_of_failures(glbench: Command, here: Path) -> None:
    unmade = variant(here, "unmade.py", "return Steady()", "print('hm'); raise OSError('no weights')")
    answer = glbench("evaluate", unmade, "steady.py", variant(here, "quick.py"), "-t", "day.toml", "--json")
    assert answer.code == 1
    assert [json.loads(line)["agent"]["name"] for line in answer.out.splitlines()] == ["steady", "quick"]
    assert "no weights" in answer.err


@pytest.mark.slow
@pytest.mark.parametrize("how", ["INT", "TERM", "KILL"])
def test_whatever_ends_it_the_same_command_goes_on_and_repeats_nothing(here: Path, how: str) -> None:
    slow = variant(here, "slow.py", "return np", "import os, time; time.sleep(0 if os.path.exists('hurry') else 0.3); return np")
    command = [*GLBENCH, "evaluate", "steady.py", slow, variant(here, "quick.py"), "--task", "day.toml"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    wait_for_checkpoint(here, process)
    os.killpg(process.pid, getattr(signal, f"SIG{how}"))
    _, err = process.communicate(timeout=300)
    assert process.returncode == {"INT": 130, "TERM": 143, "KILL": -9}[how]
    if how != "KILL":
        assert "1 of 3 evaluations are done and saved" in err
        assert "The same command (without --fresh) continues" in err
        assert "Traceback" not in err
    first = (PLACE / "steady.json").read_bytes()
    (here / "hurry").touch()
    rest = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert rest.returncode == 0, rest.stderr
    assert rest.stderr.count("already there") == 1
    assert (PLACE / "steady.json").read_bytes() == first
    resumed = load_result(PLACE / "slow.json").evaluation.resumed_at_step
    assert resumed is not None
    assert 0 < resumed < 24
    assert [path for path in here.rglob("*.partial") if path.is_file()] == []


def test_a_cluster_wants_its_engine_and_live_views_one_evaluation(glbench: Command, here: Path) -> None:
    assert "add --engine ray" in glbench("evaluate", "steady.py", "rule_based", "--address", "auto", "-t", "day.toml").err
    assert "--live shows one evaluation" in glbench("evaluate", "steady.py", "rule_based", "--live", "-t", "day.toml").err


def test_why_runs_failed_and_what_was_printed_is_shown_for_each(glbench: Command, here: Path) -> None:
    text = (here / "steady.py").read_text(encoding="utf-8")
    (here / "broken.py").write_text(text.replace("return np", "print('on my [bold]way\\x1b[2J'); 1 / 0; return np"), encoding="utf-8")
    sandbox = ("--sandbox", "none") if why_no_sandbox() is not None else ("--sandbox", "bubblewrap")
    answer = glbench("evaluate", "broken.py", "steady.py", "-t", "day.toml", *sandbox)

    assert answer.code == 1
    assert "crashed after 0 steps (3 runs: seeds 666, 667, 668): ZeroDivisionError: division by zero (broken.py:" in answer.err
    assert "\x1b" not in answer.out + answer.err
    if sandbox[1] == "bubblewrap":
        assert "    What broken printed:\n      on my [bold]way[2J\n" in answer.err


def test_names_that_would_steer_the_terminal_do_not(glbench: Command, here: Path) -> None:
    answer = glbench("evaluate", "\x1b[2J[/bold].py", "-t", "day.toml")
    assert answer.code == 1
    assert "\x1b" not in answer.err
    assert "?[2J[/bold].py" in answer.err
    assert "Traceback" not in answer.err
    checked = glbench("submit", "check", "[/nothing].py", "--task", "day.toml")
    assert checked.code == 1
    assert "There is no file or folder [/nothing].py" in checked.err
