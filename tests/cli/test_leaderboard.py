"""``glbench leaderboard`` as a person meets it."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.cli import console
from glbench.cli.app import app
from glbench.errors import ResultError
from glbench.evaluation import load_result
from glbench.evaluation.files import result_path, save_result
from glbench.evaluation.records import results_digest, summarise
from glbench.resources import data_folder
from glbench.tasks import PAPER_TASK
from glbench.tasks.references import read_best_known
from tests.leaderboard.synthetic import make_result
from tests.support import write_day_task

RUNNER = CliRunner()


@pytest.fixture
def reports(tmp_path: Path, few_released: None) -> Path:
    """Reports folder with three made-up agents on a task that no one has published, beside few released results."""
    folder = tmp_path / "reports"
    save_result(make_result("better", [5.0, 6.0, 7.0, 8.0]), folder)
    save_result(make_result("worse", [-15.0, -14.0, -13.0, -12.0], privileged=True), folder)
    save_result(make_result("hasty", [9.0]), folder)
    return folder


@pytest.fixture(autouse=True)
def fresh_console():
    """A console remembers the width it was made at."""
    yield
    console.output.cache_clear()


def run(*arguments: str | Path):
    return RUNNER.invoke(app, ["leaderboard", *map(str, arguments)])


def test_the_table_fits_80_columns_and_names_units_and_remarks(reports, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    console.output.cache_clear()
    result = run("--out", reports, "--task", "Meadow-v1")
    assert result.exit_code == 0, result.output
    assert max(len(line) for line in result.stdout.splitlines()) <= 80
    for words in ("better", "worse †", "[EUR/m²]", "[kWh/m²]", "hasty is not ranked: 1 of 4 runs", "Source"):
        assert words in result.stdout
    assert result.stdout.index("better") < result.stdout.index("worse")


def test_regret_has_a_column_in_80_columns_and_who_is_ahead_is_told_what_to_do(reports, monkeypatch):
    theirs = load_result(result_path(data_folder("reports/released/results").parent, PAPER_TASK, "rule_based_fair"))
    runs = tuple(run.model_copy(update={"metrics": run.metrics | {"reward": 3930.0 if run.seed < 669 else 3700.0}}) for run in theirs.runs)
    known = read_best_known(PAPER_TASK)
    runs = (runs[0].model_copy(update={"metrics": runs[0].metrics | {"reward": known.runs[0].reward + 50.0}}), *runs[1:])
    agent = theirs.agent.model_copy(update={"name": "anna", "kind": "submission"})
    changes = {"runs": runs, "agent": agent, "summary": summarise(runs)}
    changes["results_digest"] = results_digest(theirs.task.digest, agent, runs)
    path = save_result(theirs.model_copy(update=changes), reports)
    monkeypatch.setenv("COLUMNS", "80")
    console.output.cache_clear()
    shown = run("--out", reports, "--task", PAPER_TASK).stdout
    assert max(len(line) for line in shown.splitlines()) <= 80
    regret = np.mean([one.reward for one in known.runs]) - np.mean([one.metrics["reward"] for one in runs])
    (line,) = [line for line in shown.splitlines() if re.search(r"\d +anna ", line)]
    assert f" {regret:.1f} " in line
    assert "Regret" in shown
    assert "It is no bound" in " ".join(shown.split())
    ahead = sum(one.metrics["reward"] > best.reward for one, best in zip(runs, known.runs, strict=True))
    words = " ".join(shown.split())
    assert f"anna is above the best known run in {ahead} of the 30 runs that have one: a better plan than the best known." in words
    assert "".join(f"glbench bound --submit {path}".split()) in "".join(shown.split()), "however it is wrapped"


def test_every_row_says_its_source(reports, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    console.output.cache_clear()
    lines = run("--out", reports, "--task", "Meadow-v1").stdout.splitlines()
    sources = {name: next(line.split()[-1] for line in lines if f" {name}" in line) for name in ("better", "hasty")}
    assert sources == {"better": "own", "hasty": "trial"}


def test_it_says_where_ones_result_is_the_released_one_and_marks_trials_in_both_tables(reports, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    console.output.cache_clear()
    released = load_result(result_path(data_folder("reports/released"), PAPER_TASK, "rule_based"))
    save_result(released, reports)
    told = " ".join(run("--out", reports, "--task", PAPER_TASK).stdout.split())
    assert f"Your own result of rule_based on {PAPER_TASK} is the same as the released one." in told
    shown = run("--out", reports, "--task", "Meadow-v1").stdout
    assert "is the same" not in shown
    assert "hasty (trial)" in shown.partition("Harvest, resources")[2]


def test_trainings_are_one_row_and_each_by_itself_on_request(reports, monkeypatch):
    for seed, name in enumerate(("mine", "mine_seed1", "mine_seed2")):
        save_result(make_result(name, [100.0 + 10 * seed] * 4, recipe=("mine", seed)), reports)
    monkeypatch.setenv("COLUMNS", "80")
    console.output.cache_clear()
    shown = run("--out", reports, "--task", "Meadow-v1").stdout
    assert re.search(r"mine \(3 trainings\) +110\.0 +100\.0 ↔ 120\.0 ", shown)
    assert "seed 0" not in shown
    members = run("--out", reports, "--task", "Meadow-v1", "--members").stdout
    assert max(len(line) for line in members.splitlines()) <= 80
    assert [members.index(f"· seed {seed}") for seed in range(3)] == sorted(members.index(f"· seed {seed}") for seed in range(3))


def test_a_hostile_name_steers_no_terminal(reports):
    for number, name in enumerate(("\x1b[31mred", "[bold red]big[/]")):
        text = make_result("evil", [9.0] * 4).to_json().replace('"name": "evil"', f'"name": {json.dumps(name)}')
        (reports / "results" / f"{number}.json").write_text(text, encoding="utf-8")
    shown = run("--out", reports, "--task", "Meadow-v1")
    assert "2 result files are left out" in shown.stderr
    assert "\x1b" not in shown.stdout + shown.stderr


@pytest.mark.parametrize("width", [30, 60, 120])
def test_numbers_are_never_cut_and_what_finds_no_room_is_named(reports, monkeypatch, width):
    long = "an_agent_with_a_name_that_nobody_can_remember"
    save_result(make_result(long, [123456.75, 123457.25, 123458.0, 123459.0]), reports)
    monkeypatch.setenv("COLUMNS", str(width))
    console.output.cache_clear()
    shown = run("--out", reports, "--task", "Meadow-v1").stdout
    assert max(len(line) for line in shown.splitlines()) <= width
    assert "123457.8" in shown
    assert "…" not in shown
    assert ("Hidden columns" in shown) == (width < 120)
    assert (long in shown) == (width == 120)


def test_nothing_is_written_unless_it_is_asked_for(reports):
    assert run("--out", reports).exit_code == 0
    assert not list(reports.glob("leaderboard.*"))


def test_the_tables_are_written_beside_the_results_when_asked_for(reports):
    run("--out", reports, "--write")
    assert {path.name for path in reports.glob("leaderboard.*")} == {
        "leaderboard.md",
        "leaderboard.csv",
        "leaderboard.parquet",
        "leaderboard.json",
        "leaderboard.tex",
        "leaderboard.suites.csv",
        "leaderboard.suites.parquet",
    }


def test_json_is_nothing_but_json(reports):
    rows = json.loads(run("--out", reports, "--task", "glbench/Meadow-v1", "--json").stdout)
    assert [(row["rank"], row["agent"]) for row in rows] == [(1, "better"), (2, "worse"), (None, "hasty")]
    assert rows[0]["reward_mean [-]"] == 6.5


@pytest.mark.slow
def test_json_says_that_it_leaves_out_suites():
    both = run("--task", "LettuceClassic-Delta05-v1", "--suite", "lettuce-classic", "--json")
    assert {row["task"] for row in json.loads(both.stdout)} == {"glbench/LettuceClassic-Delta05-v1"}
    assert "The JSON has tasks only. For suites" in " ".join(both.stderr.split())


def test_all_is_not_a_choice_of_tasks(reports):
    assert "--all shows every task and suite" in str(run("--out", reports, "--all", "--task", "Typo-v1").exception)


def test_members_are_shown_in_the_table_of_a_task(reports):
    assert "Add --task TASK" in str(run("--out", reports, "--members", "--suite", "control").exception)


def test_suggestions_stay_in_the_folder(reports, tmp_path):
    folder = Path(shutil.copytree(reports, tmp_path / "a b"))
    shown = " ".join(run("--out", folder, "--task", "glbench/Meadow-v1").output.split())
    assert f"glbench report --out '{folder}'" in shown


def test_without_a_wish_the_task_evaluated_last_is_shown(reports):
    save_result(make_result("late", [1.0], task_id="glbench/Zebra-v1", created="2999-01-01T00:00:00Z"), reports)
    shown = run("--out", reports).stdout
    assert "glbench/Zebra-v1" in shown
    assert "glbench/Meadow-v1" not in shown


def test_an_unknown_task_is_answered_with_the_nearest(reports):
    result = run("--out", reports, "--task", "glbench/Meadwo-v1")
    assert isinstance(result.exception, ResultError)
    assert "Did you mean 'glbench/Meadow-v1'?" in str(result.exception)


def test_results_of_a_task_of_ones_own_are_found_by_its_file(reports, tmp_path, monkeypatch):
    """As ``evaluate`` finds the task; in all commands that show results."""
    file = write_day_task(tmp_path)
    made = {name: make_result(name, [mean, mean + 1.0], task_id="test/Day-v1") for name, mean in (("fast", 5.0), ("slow", 1.0))}
    for one in made.values():
        save_result(one, reports)
    monkeypatch.setenv("COLUMNS", "200")
    console.output.cache_clear()
    shown = run("--out", reports, "--task", file)
    assert shown.exit_code == 0, shown.output
    assert "test/Day-v1" in shown.stdout
    assert "Meadow" not in shown.stdout
    for command in (("compare", "fast", "slow"), ("show", "fast"), ("badge", "fast", "--file", tmp_path / "badge.svg")):
        done = RUNNER.invoke(app, [str(part) for part in (*command, "--out", reports, "--task", file)])
        assert done.exit_code == 0, (command, done.output, done.exception)
    missing = run("--out", reports, "--task", tmp_path / "none.toml")
    assert "none.toml" in str(missing.exception)


def test_a_badge_is_an_svg(tmp_path):
    refused = CliRunner().invoke(app, ["badge", "rule_based", "--file", str(tmp_path / "badge.png")])
    assert "badge.png should end with .svg." in " ".join(str(refused.exception).split())
    assert not (tmp_path / "badge.png").exists()


def test_spoiled_result_files_are_listed_and_the_others_ranked(reports):
    cut, foreign, empty = next(reports.rglob("worse.json")), reports / "results" / "notes.json", reports / "results" / "empty.json"
    cut.write_text(cut.read_text()[:-50])
    foreign.write_text("{}")
    empty.write_text("")
    result = run("--out", reports, "--task", "Meadow-v1")
    assert result.exit_code == 0, result.output
    assert "3 result files are left out" in result.stderr
    assert f"{empty} is empty; evaluate again" in result.stderr
    assert f"{cut} is no valid JSON" in result.stderr
    assert f"{foreign} is not a result of glbench" in result.stderr
    assert "better" in result.stdout
    assert "worse" not in result.stdout
    assert run("--out", reports, "--strict").exit_code == 1
    for spoiled in (cut, foreign, empty):
        spoiled.unlink()
    assert run("--out", reports, "--strict").exit_code == 0


def test_a_folder_that_is_not_there_is_not_made(reports):
    result = run("--out", reports.with_name("report"))
    assert isinstance(result.exception, ResultError)
    assert "Did you mean 'reports'?" in str(result.exception)
    assert not reports.with_name("report").exists()


def test_rows_of_another_kernel_are_named(reports):
    assert "kernel builds" not in run("--out", reports, "--task", "Meadow-v1").stdout
    other = make_result("patient", [5.0, 6.0, 7.0, 8.5])
    kernel = {"backend": "casadi", "preset": "reference"}
    save_result(other.model_copy(update={"evaluation": other.evaluation.model_copy(update={"kernel": kernel})}), reports)
    shown = " ".join(run("--out", reports, "--task", "Meadow-v1").stdout.split())
    assert re.search(r"Two kernel builds: none \w{6} \(better, worse, hasty\), casadi/reference \w{6} \(patient\)\.", shown)
    run("--out", reports, "--write")
    assert "(patient)" in (reports / "leaderboard.md").read_text()
    rows = json.loads(run("--out", reports, "--task", "Meadow-v1", "--json").stdout)
    assert {row["agent"]: row["kernel"] for row in rows}["patient"] == "casadi/reference"


def test_another_folder_shows_its_own_agents_and_the_released_baselines_only(reports, tmp_path, monkeypatch):
    monkeypatch.setattr("glbench.resources.data_folder", lambda _name: reports / "results")
    save_result(make_result("elsewhere", [3.0] * 4), tmp_path / "other")
    shown = run("--out", tmp_path / "other", "--task", "Meadow-v1").stdout
    assert "elsewhere" in shown
    assert "better" not in shown


@pytest.mark.slow
def test_agents_over_a_suite_are_shown_with_scores_and_resources(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    console.output.cache_clear()
    result = run("--suite", "paper")
    assert result.exit_code == 0, result.output
    assert max(len(line) for line in result.stdout.splitlines()) <= 80
    assert "0.9999" not in result.stdout
    for words in ("Suite paper, 7 tasks", "ppo (1 to 3", "IQM", "rule_based_fair", "0 is the mean of do_nothing", "means over the tasks"):
        assert words in result.stdout


@pytest.mark.usefixtures("few_released")
def test_an_unknown_suite_is_answered_with_the_nearest():
    result = run("--suite", "papre")
    assert result.exit_code == 1
    assert "'paper'" in str(result.exception)


def test_a_name_that_two_tasks_of_users_share_is_refused_and_both_are_named(tmp_path: Path, few_released: None) -> None:
    for name in ("alice", "bob"):
        save_result(make_result(name, [1.0, 2.0], task_id=f"{name}/Own-v1"), tmp_path)
    refused = run("--out", tmp_path, "--task", "Own-v1").exception
    assert isinstance(refused, ResultError)
    assert str(refused) == "Several tasks here are called 'Own-v1'. Name one: alice/Own-v1, bob/Own-v1."
    shown = run("--out", tmp_path, "--task", "alice/Own-v1").stdout
    assert "alice" in shown
    assert "bob" not in shown
