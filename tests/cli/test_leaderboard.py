"""``glbench leaderboard`` as a person meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from glbench.cli import console
from glbench.cli.app import app
from glbench.errors import ResultError
from glbench.evaluation.files import save_result
from tests.leaderboard.synthetic import make_result

RUNNER = CliRunner()


@pytest.fixture
def reports(tmp_path: Path) -> Path:
    """Reports folder with three made-up agents on a task that no one has published."""
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
    for words in ("better", "worse †", "[EUR/m²]", "[kWh/m²]", "hasty is not ranked: 1 of 4 runs"):
        assert words in result.stdout
    assert result.stdout.index("better") < result.stdout.index("worse")


def test_the_tables_are_written_beside_the_results(reports):
    run("--out", reports)
    assert {path.name for path in reports.glob("leaderboard.*")} == {
        "leaderboard.md",
        "leaderboard.csv",
        "leaderboard.parquet",
        "leaderboard.json",
        "leaderboard.tex",
    }


def test_json_is_nothing_but_json(reports):
    rows = json.loads(run("--out", reports, "--task", "glbench/Meadow-v1", "--json").stdout)
    assert [(row["rank"], row["agent"]) for row in rows] == [(1, "better"), (2, "worse"), (None, "hasty")]
    assert rows[0]["reward_mean [-]"] == 6.5


def test_without_a_wish_the_task_evaluated_last_is_shown(reports):
    save_result(make_result("late", [1.0], task_id="glbench/Zebra-v1", created="2999-01-01T00:00:00Z"), reports)
    shown = run("--out", reports).stdout
    assert "glbench/Zebra-v1" in shown
    assert "glbench/Meadow-v1" not in shown


def test_an_unknown_task_is_answered_with_the_nearest(reports):
    result = run("--out", reports, "--task", "glbench/Meadwo-v1")
    assert isinstance(result.exception, ResultError)
    assert "Did you mean 'glbench/Meadow-v1'?" in str(result.exception)


def test_a_spoiled_result_file_is_named(reports):
    spoiled = next(reports.rglob("worse.json"))
    spoiled.write_text(spoiled.read_text()[:-50])
    result = run("--out", reports)
    assert isinstance(result.exception, ResultError)
    assert str(spoiled) in str(result.exception)


def test_another_folder_shows_its_own_agents_and_the_released_baselines_only(reports, tmp_path, monkeypatch):
    monkeypatch.setattr("glbench.resources.data_folder", lambda _name: reports / "results")
    save_result(make_result("elsewhere", [3.0] * 4), tmp_path / "other")
    shown = run("--out", tmp_path / "other", "--task", "Meadow-v1").stdout
    assert "elsewhere" in shown
    assert "better" not in shown
