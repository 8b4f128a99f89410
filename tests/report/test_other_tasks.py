"""A board of tomatoes and lettuce: each task has its own words, items and prices, in files, in the terminal and on the page."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from glbench.cli.results import money_lines, summary_table
from glbench.evaluation import evaluate
from glbench.leaderboard import collect_results, rank, to_markdown, write_leaderboard
from glbench.leaderboard.catalogue import catalogue, charts_of
from glbench.leaderboard.entries import entry_of
from glbench.leaderboard.pairs import compare_entries
from glbench.leaderboard.tables import to_json
from glbench.report import build_report
from glbench.report.task_words import definition_in_words
from glbench.tasks import PAPER_TASK, get_task
from tests.report.conftest import Made, small_task, write_agent
from tests.report.test_browser import CHROMIUM, browser, change_price, column, draw_everything, visit
from tests.report.test_data import embedded
from tests.support import lettuce_task, write_lettuce_task

__all__ = ["browser", "visit"]
OF_TOMATOES = re.compile("tomato|fruit", re.IGNORECASE)
LETTUCE_ID, DAYS_ID = "test/Salad-v1", "test/Days-v1"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Two agents on two days of tomatoes and two of lettuce."""
    folder = tmp_path_factory.mktemp("mixed")
    for task in (write_lettuce_task(folder), small_task(folder, "Days")):
        for name in ("thrifty", "lavish"):
            evaluate(task, write_agent(folder, name), out=folder)
    stored = collect_results([folder / "results"])
    report = build_report(stored)
    (folder / "index.html").write_text(report.html, encoding="utf-8")
    return Made(folder, stored, rank(stored, {}), report, folder / "index.html")


def stored_of(made: Made, task_id: str) -> dict[str, Any]:
    return {item.result.agent.name: item for item in made.stored if item.result.task.id == task_id}


def test_the_words_of_lettuce_come_from_its_ledger_and_its_model():
    told, shown = catalogue(lettuce_task()), charts_of(lettuce_task())
    assert [item.label for item in told.items] == ["Heads at full price", "Heat", "Lamp electricity", "CO₂"]
    assert [item.table for item in told.items] == [False, False, True, False]
    assert told.lead.startswith("Controllers run a greenhouse through the same seasons: they earn with heads at full price and pay")
    assert "heads at full price minus heat, lamp electricity and CO₂" in told.profit.explanation
    assert not OF_TOMATOES.search(repr(told))
    assert "heads_gained" in shown.charts["compared"]
    assert shown.controls == charts_of(None).controls


def test_the_paper_s_tasks_keep_their_words():
    told = catalogue(get_task(PAPER_TASK))
    assert told == catalogue()
    assert [metric.label for metric in told.columns][:4] == ["Reward", "Profit (EPI)", "Penalty", "Yield"]
    assert "to grow tomatoes at a profit" in told.lead
    assert told.metrics["yield"].headed == "Yield, fresh [kg/m²]"


def test_both_together_have_the_columns_of_both():
    told = catalogue(get_task(PAPER_TASK), lettuce_task())
    assert {"yield", "heads_gained", "co2", "co2_dosed"} <= set(told.metrics)
    assert [metric.kind for metric in told.metrics.values()][:3] == ["score", "profit", "earned"]


def test_a_definition_in_words_says_what_a_tariff_is():
    (prices,) = [part for part in definition_in_words(lettuce_task()) if part.heading == "Prices"]
    assert prices.rows[0][:3] == ("Heads at full price", "earned", "0.4 EUR per piece")
    assert any("by hour of the day" in price for _, _, price, _ in prices.rows)


def test_a_user_s_task_is_ranked_by_the_metric_that_it_names(made):
    assert {table.task_id: table.metric for table in made.tables} == {LETTUCE_ID: "epi", DAYS_ID: "reward"}


def test_each_table_has_the_columns_of_its_task(made, tmp_path):
    heads, fruit = (to_markdown([table], {}).splitlines() for table in sorted(made.tables, key=lambda one: one.task_id)[::-1])
    assert any("Heads at full price [/m²]" in line and "Yield" not in line for line in heads)
    assert any("Yield, fresh [kg/m²]" in line and "Heads" not in line for line in fruit)
    assert any("EPI is revenue minus the costs of heat, electricity and CO2." in line for line in fruit)
    assert not any("revenue minus the costs" in line for line in heads)
    assert json.loads(to_json(made.tables))["units"].keys() >= {"yield", "heads_gained", "co2", "co2_dosed"}
    assert write_leaderboard(made.tables, {}, tmp_path)


def test_the_terminal_speaks_of_heads(made):
    thrifty, lavish = (stored_of(made, LETTUCE_ID)[name] for name in ("thrifty", "lavish"))
    known = catalogue(thrifty.task)
    assert [line.split()[0] for line in money_lines(thrifty.result, known)] == ["heads", "heat", "lamps", "CO2", "[bold]EPI"]
    table = summary_table(thrifty.result, known)
    names = [row.cells[0] for row in table.rows]
    assert "  cost of heat" in names
    assert "  heads" not in names, "there are none yet"
    assert str(table.caption).endswith("Zero in all runs: heads at full price, cost of electricity, lamp electricity.")
    pair = compare_entries(entry_of(lavish), entry_of(thrifty))
    assert pair.money["cost_electricity"] == pytest.approx(-pair.gap("cost_electricity"))
    assert pair.money.keys() == {item.name for item in lettuce_task().ledger.items}


def test_the_page_has_the_words_of_each_task_once(made):
    data = embedded(made)
    tasks = {task["id"]: task for task in data["tasks"]}
    words = {task_id: data["words"][task["words_of"]] for task_id, task in tasks.items()}
    assert len(data["words"]) == 2
    assert "tomatoes" in words[DAYS_ID]["lead"]
    assert not OF_TOMATOES.search(json.dumps({key: words[LETTUCE_ID][key] for key in ("lead", "items", "metrics")}))
    assert tasks[LETTUCE_ID]["prices"]["cost_electricity"] == 1.0
    assert len(tasks[LETTUCE_ID]["hourly_prices"]["cost_electricity"]) == 24
    assert "full_use" not in tasks[LETTUCE_ID]
    assert tasks[DAYS_ID]["hourly_prices"] == {}


VIEWS = ("#/Salad-v1", "#/agent/lavish/Salad-v1", "#/compare/lavish/thrifty/Salad-v1", "#/task/Salad-v1")


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with")
@pytest.mark.parametrize("view", VIEWS)
def test_no_view_of_lettuce_speaks_of_tomatoes(visit, view):
    page = visit(view)
    draw_everything(page)
    text = page.inner_text("main")
    assert re.search("heads", text, re.IGNORECASE)
    assert not OF_TOMATOES.search(text)
    assert "undefined" not in text
    assert "NaN" not in text


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with")
def test_a_tariff_is_tried_as_a_whole_and_other_tasks_keep_their_prices(visit, made):
    page = visit("#/Days-v1")
    tomatoes = column(page, "Profit (EPI)")
    page = visit("#/Salad-v1")
    results = {name: item.result.summary.mean for name, item in stored_of(made, LETTUCE_ID).items()}
    assert results["lavish"]["cost_electricity"] > 0.0
    change_price(page, "cost_electricity", 3)
    shown = column(page, "Profit (EPI)")
    for name, mean in results.items():
        assert shown[name] == pytest.approx(mean["epi"] - 2.0 * mean["cost_electricity"], abs=0.006), name
    page.evaluate("location.hash = '#/Days-v1'")
    page.wait_for_selector("text=Yield")
    assert column(page, "Profit (EPI)") == tomatoes
