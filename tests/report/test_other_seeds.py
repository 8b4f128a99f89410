"""A result beside one of other runs: a comparison is over the runs that both have, and says so."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pytest

from glbench.evaluation import evaluate
from glbench.leaderboard import collect_results, rank
from glbench.report import build_report
from tests.report.conftest import Made, write_agent
from tests.report.test_browser import CHROMIUM, PHONE, browser, draw_everything, figure, visit
from tests.report.test_money import TASK

__all__ = ["browser", "visit"]
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with")
TITLE = "Money-v1: Two days of spring"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Three runs of one agent, and a trial of another with the first two of their seeds."""
    folder: Path = tmp_path_factory.mktemp("seeds")
    (folder / "money.toml").write_text(TASK, encoding="utf-8")
    evaluate(folder / "money.toml", write_agent(folder, "thrifty"), out=folder)
    evaluate(folder / "money.toml", write_agent(folder, "lavish"), runs=2, out=folder)
    stored = collect_results([folder / "results", folder / "trials" / "results"])
    report = build_report(stored)
    (folder / "index.html").write_text(report.html, encoding="utf-8")
    return Made(folder, stored, rank(stored, {}), report, folder / "index.html")


def test_means_and_differences_are_over_the_shared_runs(visit, made):
    page = visit("#/compare/thrifty/lavish/Money-v1")
    draw_everything(page)
    values = {item.result.agent.name: item.result.values("reward") for item in made.stored}
    first, second = (sum(values[name][:2]) / 2 for name in ("thrifty", "lavish"))
    assert abs(sum(values["thrifty"]) / 3 - first) > 0.01, "the third run tells"
    row = page.locator("tbody tr", has_text="Score").first.locator("td").all_inner_texts()
    assert [figure(text) for text in row[:2]] == pytest.approx([first, second], abs=0.006)
    for cells in page.locator("main tbody tr").all():
        a, b, gap = (figure(text) for text in cells.locator("td").all_inner_texts()[:3])
        assert a - b == pytest.approx(gap, abs=1.01 if abs(gap) > 9 else 0.11)
    text = page.inner_text("main")
    assert "thrifty has 3 runs, lavish has 2. Everything here is over the 2 seeds that they share" in text
    assert "over 2 shared seeds of Money-v1" in text


def test_typical_days_of_other_runs_are_not_drawn_side_by_side(visit):
    page = visit("#/compare/thrifty/lavish/Money-v1")
    draw_everything(page)
    assert "Not drawn side by side" in page.inner_text("main")
    assert "Air temperature" not in page.inner_text("main")


@pytest.mark.parametrize("view", ["#/Money-v1", "#/compare/thrifty/lavish/Money-v1", "#/task/Money-v1", "#/tasks"])
def test_views_name_the_task_by_its_id(visit, view):
    assert TITLE in visit(view).locator("main").text_content()


def test_a_table_that_goes_on_beyond_the_edge_has_a_shadow_there(visit):
    image = pytest.importorskip("PIL.Image", reason="Pillow is not installed: no look at pixels")
    page = visit("#/Money-v1", size=PHONE)
    table = page.locator("main .scroll").first
    table.evaluate("(one) => one.querySelectorAll('*').forEach((part) => { part.style.visibility = 'hidden'; })")

    def edges() -> tuple[bool, bool]:
        """Whether the left and the right edge are darker than the middle."""
        picture = image.open(BytesIO(table.screenshot())).convert("L")
        left, middle, right = (picture.getpixel((x, picture.height // 2)) for x in (4, picture.width // 2, picture.width - 4))
        return left < middle, right < middle

    assert edges() == (False, True)
    table.evaluate("(one) => { one.scrollLeft = one.scrollWidth; }")
    assert edges() == (True, False)


def test_a_calendar_says_what_its_colours_mean(visit):
    page = visit("#/agent/thrifty/Money-v1")
    draw_everything(page)
    assert "60 min of the hour outside the limit" in page.inner_text("main .ramp")
