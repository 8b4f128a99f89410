"""The page over all tasks, ranks at other prices, and a full page of many agents, in a real browser. Needs Debian's chromium."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from glbench.evaluation.records import results_digest, summarise
from glbench.leaderboard import StoredResult, rank
from glbench.leaderboard.published import published_expectations
from glbench.report import build_report
from tests.report.test_browser import CHROMIUM, browser, change_price, draw_everything, order, visit

__all__ = ["browser", "visit"]
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="there is no chromium on this machine to look at the page with"
)
TASK = "Schiphol2010-Delta10-v1"
AGENTS = 11


@pytest.fixture(scope="module")
def crowd(made, tmp_path_factory):
    """A page of eleven agents on a task: some cannot be told apart, one is far off, and one is sometimes a failure."""
    base = next(item for item in made.stored if item.result.task.id.endswith(TASK))
    generator = np.random.default_rng(5)
    luck = generator.normal(0.0, 20.0, 30)
    stored = []
    for number in range(AGENTS):
        rewards = 3000.0 + luck + 3.0 * number + generator.normal(0.0, 3.0, 30)
        if number == 3:
            rewards -= 9000.0
        if number == 5:
            rewards[:3] -= 4000.0
        runs = tuple(
            run.model_copy(update={"metrics": {**run.metrics, "reward": float(reward)}})
            for run, reward in zip(base.result.runs, rewards, strict=True)
        )
        agent = base.result.agent.model_copy(update={"name": f"agent_with_a_name_{number}", "kind": "submission"})
        digest = results_digest(base.result.task.digest, agent, runs)
        changes = {"agent": agent, "runs": runs, "summary": summarise(runs), "results_digest": digest}
        stored.append(StoredResult(base.path.with_name(f"{agent.name}.json"), base.result.model_copy(update=changes)))
    file = tmp_path_factory.mktemp("crowd") / "index.html"
    file.write_text(build_report(stored).html, encoding="utf-8")
    (table,) = rank(stored, published_expectations())
    return dataclasses.make_dataclass("Crowd", ["file", "table"])(file, table)


def ranks(page) -> dict[str, str]:
    shown = page.locator("table.ranks tbody td.rank").all_inner_texts()
    return dict(zip((text.split()[0] for text in order(page)), shown, strict=True))


def test_ranks_at_other_prices_follow_the_tests_of_the_leaderboard(visit, crowd):
    page = visit(f"#/{TASK}", file=crowd.file)
    expected = {row.agent: str(row.rank) for row in crowd.table.rows}
    assert len(set(expected.values())) < AGENTS, "some share a rank, or this test shows nothing"
    assert ranks(page) == expected
    change_price(page, "fruit", 1.6000001)  # so little that only the computation is another
    assert page.locator("#prices").evaluate("one => one.classList.contains('changed')")
    assert ranks(page) == expected


@pytest.mark.parametrize("width", [1250, 1920])
def test_on_a_desk_no_table_scrolls_sideways(visit, crowd, width):
    page = visit(f"#/{TASK}", {"width": width, "height": 900}, file=crowd.file)
    assert page.evaluate("[...document.querySelectorAll('.scroll')].every((one) => one.scrollWidth <= one.clientWidth)")


def test_agents_far_off_the_others_get_an_arrow(visit, crowd):
    page = visit(f"#/{TASK}", file=crowd.file)
    off = page.locator("table.ranks tbody tr", has=page.locator(".bar.off.below")).locator("th").all_inner_texts()
    assert sorted(text.split()[0] for text in off) == ["agent_with_a_name_3", "agent_with_a_name_5"]
    assert page.locator("table.ranks .bar.off").count() == 2


def test_more_agents_than_colours_differ_by_their_marks(visit, crowd):
    page = visit(f"#/{TASK}", file=crowd.file)
    looks = page.locator("table.ranks tbody .swatch").evaluate_all(
        "all => all.map((one) => one.className + getComputedStyle(one).getPropertyValue('--colour'))"
    )
    assert len(set(looks)) == AGENTS


def test_the_overall_page_shows_scores_profiles_and_odds(visit):
    page = visit("#/overall")
    draw_everything(page)
    assert page.locator("table.scores tbody tr").count() == 2
    assert page.locator(".drawing path.line").count() == 2
    half = page.locator(".drawing path.line").first.get_attribute("d")
    page.locator("#close-up").click()
    assert page.locator(".drawing path.line").first.get_attribute("d") != half
    page.locator(".legend button").first.click()
    assert page.locator(".drawing path.line").count() == 1
    assert "> 99 %" in page.locator("table.odds tbody tr").first.inner_text().replace("\u00a0", " "), "never certain"
    page.locator("#choose-improver").focus()
    page.select_option("#choose-improver", "rule_based_fair")
    page.wait_for_function("location.hash.includes('rule_based_fair')")
    assert "worse" in page.locator("table.odds tbody tr").first.inner_text()
    assert page.evaluate("document.activeElement.id") == "choose-improver"
