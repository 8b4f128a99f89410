"""A board of a task whose score is money: the page speaks of score, profit and violations, and of no points."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from glbench.evaluation import evaluate
from glbench.leaderboard import collect_results, rank
from glbench.report import build_report
from tests.report.conftest import Made, write_agent
from tests.report.test_browser import CHROMIUM, browser, column, draw_everything, visit

__all__ = ["browser", "visit"]
TASK = """
base = "glbench/Spring-v1"
id = "test/Money-v1"
title = "Two days of spring"
weather.days = 2
evaluation.runs = 3
"""
OF_POINTS = re.compile(r"\breward\b|\bpenalty\b|\bEPI\b", re.IGNORECASE)
SENTENCES = {
    "#/Money-v1": ("Score", "Violations"),
    "#/agent/lavish/Money-v1": (
        r"is \d+\.\d\d.EUR/m² higher .*, with .* profit and violations that cost \d+\.\d\d.EUR/m² (more|less)\.",
        r"got a score of .?\d+\.\d\d.EUR/m², \d+\.\d\d.EUR/m² below the mean of all runs:",
        r"with violations that cost \d+\.\d\d.EUR/m²\.",
    ),
    "#/compare/lavish/thrifty/Money-v1": (
        r"has a score \d+\.\d\d.EUR/m² (higher|lower) than .* it has violations that cost \d+\.\d\d.EUR/m² (more|less)",
        "Violations spared",
    ),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Two agents on two days of spring."""
    folder: Path = tmp_path_factory.mktemp("money")
    (folder / "money.toml").write_text(TASK, encoding="utf-8")
    for name in ("thrifty", "lavish"):
        evaluate(folder / "money.toml", write_agent(folder, name), out=folder)
    stored = collect_results([folder / "results"])
    report = build_report(stored)
    (folder / "index.html").write_text(report.html, encoding="utf-8")
    return Made(folder, stored, rank(stored, {}), report, folder / "index.html")


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with")
@pytest.mark.parametrize("view", SENTENCES)
def test_no_view_speaks_of_points(visit, view):
    page = visit(view)
    draw_everything(page)
    text = page.inner_text("main")
    assert OF_POINTS.findall(text) == []
    for sentence in SENTENCES[view]:
        assert re.search(sentence, text), text
    assert "undefined" not in text
    assert "NaN" not in text


@pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with")
def test_the_score_is_the_profit_minus_the_violations(visit):
    page = visit("#/Money-v1")
    score, profit, violations = (column(page, heading) for heading in ("Score", "Profit", "Violations"))
    assert score.keys() == {"thrifty", "lavish"}
    for agent, value in score.items():
        assert value == pytest.approx(profit[agent] - violations[agent], abs=0.016)
