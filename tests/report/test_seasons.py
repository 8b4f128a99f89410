"""Runs that start on different days, in weather of their own: what the page draws and dates of them."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from glbench.evaluation import evaluate
from glbench.evaluation.profiles import load_profile
from glbench.leaderboard import collect_results, rank
from glbench.leaderboard.collect import published_expectations
from glbench.report import build_report
from glbench.report.task_words import clock_changes
from glbench.resources import data_folder
from glbench.tasks import get_task
from tests.report.conftest import Made, small_task, write_agent
from tests.report.test_browser import CHROMIUM, browser, draw_everything, visit
from tests.report.test_data import blocks_of, embedded, unpacked

__all__ = ["browser", "visit"]
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with")
ALONE, REAL, PAPER = "Alone-v1", "GreenhouseReal-v1", "Schiphol2010-Delta10-v1"
SHOWN = {REAL: ("mpc_greenhouse", "rule_based"), PAPER: ("rule_based",)}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Released results with their profiles, two agents whose worst runs differ and one of a task with a single season; and a single run."""
    folder: Path = tmp_path_factory.mktemp("seasons")
    for task, agents in SHOWN.items():
        (folder / "results" / task).mkdir(parents=True)
        for agent in agents:
            for file in (data_folder("reports/released/results") / task).glob(f"{agent}.*"):
                shutil.copy(file, folder / "results" / task)
    task = small_task(folder, "Alone")
    task.write_text(task.read_text(encoding="utf-8").replace("runs = 3", "runs = 1"), encoding="utf-8")
    evaluate(task, write_agent(folder, "thrifty"), out=folder)
    stored = collect_results([folder / "results"])
    report = build_report(stored)
    (folder / "index.html").write_text(report.html, encoding="utf-8")
    return Made(folder, stored, rank(stored, published_expectations()), report, folder / "index.html")


def blocks_by_agent(made: Made, task: str) -> dict:
    """The profiles of the page by agent."""
    blocks = blocks_of(made.report.html)
    return {one["agent"]: json.loads(blocks[one["profile"]]) for one in embedded(made)["results"] if one["task"].endswith(task)}


def test_each_worst_run_has_the_weather_of_its_own_season(made):
    profiles = blocks_by_agent(made, REAL)
    assert len({profile["seeds"]["worst"] for profile in profiles.values()}) == 2
    for item in made.stored:
        if item.result.task.id.endswith(REAL):
            genuine = load_profile(item.result, item.path).document["weather"]["hours"]["outdoor_temperature"]
            packed = profiles[item.result.agent.name]["outside"]["outdoor_temperature"]
            kept = np.array(genuine["values"]) * genuine["resolution"]
            np.testing.assert_allclose(unpacked(packed), kept, rtol=0.0, atol=0.5001 * packed["resolution"])


DATE = re.compile(r"\d (January|February|March|April|May|Jan|Feb|Mar|Apr)\b")


def ticks(page, caption: str) -> list[str]:
    """What stands along the days of the chart with ``caption``."""
    return page.locator("figure", has_text=caption).first.locator(".xtick text").all_text_contents()


@needs_browser
def test_the_worst_run_is_dated_by_its_own_start_and_means_over_runs_by_numbers(visit, made):
    worst = blocks_by_agent(made, REAL)["mpc_greenhouse"]
    assert worst["start"] == "2010-03-09"
    page = visit(f"#/agent/mpc_greenhouse/{REAL}")
    draw_everything(page)
    assert "Its hardest day was 23 April" in page.inner_text("main")
    assert page.locator("#choose-week option").nth(1).inner_text() == "week 1, from 9 March"
    assert page.locator("#weeks tbody th").all_inner_texts()[::8] == ["1", "9 (4 days)"]
    assert ticks(page, "Air temperature °C, daily mean")[:2] == ["day 1", "day 16"]
    assert "Every column is a day since the start of each run" in page.inner_text("main")
    page = visit(f"#/task/{REAL}")
    draw_everything(page)
    assert ticks(page, "mean and range of the day")[:2] == ["day 1", "day 16"]


@needs_browser
def test_runs_that_start_on_one_day_are_dated(visit):
    page = visit(f"#/agent/rule_based/{PAPER}")
    draw_everything(page)
    assert page.locator("#choose-week option").nth(1).inner_text() == "week 1, from 1 March"
    assert page.locator("#weeks tbody th").first.inner_text() == "1 Mar"
    assert ticks(page, "Air temperature °C, daily mean")[:2] == ["1 Mar", "16 Mar"]


@needs_browser
def test_a_worst_run_with_secret_draws_has_no_dates(visit, made, tmp_path, monkeypatch):
    items = [item for item in made.stored if item.result.task.id.endswith(REAL)]
    secret = items[0].result.task.model_copy(update={"salt_commitment": "ab" * 32})
    monkeypatch.setattr("glbench.report.page.load_profile", lambda result, path: load_profile(items[0].result, path))
    report = build_report([replace(items[0], result=items[0].result.model_copy(update={"task": secret}))])
    (tmp_path / "index.html").write_text(report.html, encoding="utf-8")
    (result,) = report.data["results"]
    page = visit(f"#/agent/{result['agent']}/{report.data['tasks'][0]['short']}", file=tmp_path / "index.html")
    draw_everything(page)
    text = page.inner_text("main")
    assert "Its hardest day was day 46" in text
    assert not DATE.findall(text)


@needs_browser
def test_the_weather_says_which_of_its_numbers_are_over_many_runs(visit):
    page = visit(f"#/task/{REAL}")
    draw_everything(page)
    text = page.inner_text("main")
    assert re.search(r"on \d+ days of 60 at least one of the 100 runs had frost", text)
    assert re.search(r"mean over the runs: \d+\.\d MJ/m² on the darkest and \d+\.\d MJ/m² on the brightest day", text)
    assert "Runs start on different days" in text
    page = visit(f"#/task/{PAPER}")
    draw_everything(page)
    text = page.inner_text("main")
    assert re.search(r"; frost on \d+ days; .* MJ/m² on the brightest\.", text)
    assert "Runs start on different days" not in text


WITH_CHANGE, WITHOUT_CHANGE = (REAL, "FullSeason-v1", "WinterLED-v1"), ("SpringEnergy-v1", PAPER, "LettuceClassic-Delta00-v1")


@pytest.mark.parametrize("task", [*WITH_CHANGE, *WITHOUT_CHANGE])
def test_it_is_known_whether_the_clock_can_change_within_a_run(task):
    assert clock_changes(get_task(task)) == (task in WITH_CHANGE)


@needs_browser
@pytest.mark.parametrize("view", [f"#/agent/mpc_greenhouse/{REAL}", f"#/task/{REAL}", f"#/compare/mpc_greenhouse/rule_based/{REAL}"])
def test_hours_after_a_clock_change_are_said_to_be_an_hour_off(visit, view):
    page = visit(view)
    draw_everything(page)
    words = (
        "Europe/Amsterdam, by the clock at the start of the run; after a clock change within the run they are an hour off the local clock"
    )
    assert words in page.inner_text("main")


@needs_browser
def test_hours_of_a_clock_that_never_changes_are_those_of_the_clock(visit):
    page = visit(f"#/agent/rule_based/{PAPER}")
    draw_everything(page)
    assert "Hours are UTC." in page.inner_text("main")


@needs_browser
def test_one_run_is_called_one_run(visit):
    page = visit(f"#/agent/thrifty/{ALONE}")
    draw_everything(page)
    text = page.inner_text("main")
    assert "There is 1 run, that of seed 666." in text
    assert "1 run" in page.locator("dl.tiles dd").all_inner_texts()[0]
    assert "alike" not in text
