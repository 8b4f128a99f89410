"""The page over all tasks, ranks at other prices, and a full page of many agents, in a real browser. Needs Debian's chromium."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from glbench.evaluation.records import TrainingRecord, results_digest, summarise
from glbench.leaderboard import StoredResult, rank
from glbench.leaderboard.collect import published_expectations
from glbench.report import build_report
from tests.leaderboard.synthetic import of_another_version
from tests.report.test_browser import CHROMIUM, browser, change_price, draw_everything, order, visit

__all__ = ["browser", "visit"]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with"),
]
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
    change_price(page, "revenue", 1.6000001)  # so little that only the computation is another
    assert page.locator("#prices").evaluate("one => one.classList.contains('changed')")
    assert ranks(page) == expected


@pytest.fixture(scope="module")
def trained(made, tmp_path_factory):
    """A page with three trainings of one recipe, a trial, and an agent whose name is HTML."""
    base = next(item for item in made.stored if item.result.task.id.endswith(TASK))
    stored = []
    for name, gain, runs in (
        ("ppo", 0.0, 30),
        ("ppo_seed1", 60.0, 30),
        ("ppo_seed2", 30.0, 30),
        ("trial", 500.0, 2),
        ("<img src=x onerror=alert(1)>", -500.0, 30),
    ):
        changed = tuple(
            run.model_copy(update={"metrics": {**run.metrics, "reward": run.metrics["reward"] + gain}}) for run in base.result.runs[:runs]
        )
        seed = {"ppo": 0, "ppo_seed1": 1, "ppo_seed2": 2}.get(name)
        training = None if seed is None else TrainingRecord(recipe="ppo", seed=seed, form="sb3", policy=f"{seed:064x}")
        of_recipe = {} if training is None else {"training": training, "digest": training.policy}
        agent = base.result.agent.model_copy(update={"name": name, "kind": "submission", **of_recipe})
        evaluation = base.result.evaluation.model_copy(update={"runs": runs, "seeds": base.result.evaluation.seeds[:runs]})
        changes = {
            "agent": agent,
            "runs": changed,
            "evaluation": evaluation,
            "summary": summarise(changed),
            "results_digest": results_digest(base.result.task.digest, agent, changed),
        }
        stored.append(StoredResult(base.path.with_name(f"{name[:8]}.json"), base.result.model_copy(update=changes)))
    report = build_report(stored)
    file = tmp_path_factory.mktemp("trained") / "index.html"
    file.write_text(report.html, encoding="utf-8")
    return dataclasses.make_dataclass("Trained", ["file", "data", "base"])(file, report.data, base.result)


def test_trainings_are_one_row_that_unfolds_in_the_order_of_the_seeds(visit, trained):
    page = visit(f"#/{TASK}", file=trained.file)
    assert [text.split()[0] for text in order(page)] == ["ppo", "<img", "trial"]
    reward = trained.base.summary.mean["reward"]
    (entry,) = [one for one in trained.data["results"] if one["agent"] == "ppo"]
    assert entry["estimates"]["reward"][:3] == pytest.approx([reward + 30.0, reward, reward + 60.0], rel=1e-6)
    page.locator("[data-unfold=ppo]").click()
    assert [text.strip() for text in order(page)][1:4] == ["seed 0", "seed 1", "seed 2"]
    assert page.evaluate("document.activeElement.getAttribute('aria-expanded')") == "true"
    page.locator("tr.member a").nth(1).click()
    page.wait_for_function("document.documentElement.dataset.shown === 'agent'")
    assert "The training of ppo with seed 1" in page.locator("main").inner_text()


def test_an_entry_has_a_page_with_its_trainings_and_their_range(visit, trained):
    page = visit(f"#/agent/ppo/{TASK}", file=trained.file)
    words = page.locator("main").inner_text()
    assert page.locator("h1").inner_text().startswith("ppo (3 trainings)")
    assert "↔" in words
    assert "those of the training with the lowest seed, 0" in words
    page = visit("#/agent/constructor", file=trained.file)
    assert "Not found" in page.locator("h1").inner_text()


def test_rows_say_their_source_and_no_name_is_markup(visit, trained):
    page = visit(f"#/{TASK}", file=trained.file)
    rows = page.locator("table.about tbody tr")
    assert [rows.nth(i).locator("td").last.inner_text() for i in range(3)] == ["own", "own", "trial"]
    assert "not ranked: 2 of 30 runs" in page.locator("table.ranks tbody tr").nth(2).inner_text()
    assert page.locator("main img").count() == 0


def test_at_other_prices_the_range_is_that_of_the_trainings(visit, trained):
    page = visit(f"#/{TASK}", file=trained.file)
    before = page.locator("table.ranks tbody tr").first.locator("td").nth(1).get_attribute("title")
    change_price(page, "revenue", 1.6000001)
    after = page.locator("table.ranks tbody tr").first.locator("td").nth(1).get_attribute("title")
    assert before is not None
    assert before.startswith("lowest to highest of 3 trainings")
    assert after == before


@pytest.mark.parametrize("width", [1250, 1920])
def test_on_a_desk_no_table_scrolls_sideways(visit, crowd, width):
    page = visit(f"#/{TASK}", {"width": width, "height": 900}, file=crowd.file)
    assert page.evaluate("[...document.querySelectorAll('.scroll')].every((one) => one.scrollWidth <= one.clientWidth)")


def test_agents_far_off_the_others_get_an_arrow(visit, crowd):
    page = visit(f"#/{TASK}", file=crowd.file)
    off = page.locator("table.ranks tbody tr", has=page.locator(".bar.off.below")).locator("th").all_inner_texts()
    assert sorted(text.split()[0] for text in off) == ["agent_with_a_name_3", "agent_with_a_name_5"]
    assert page.locator("table.ranks .bar.off").all_inner_texts() == ["off scale"] * 2


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


@pytest.mark.parametrize("view", [f"#/{TASK}", f"#/agent/other/{TASK}", f"#/compare/other/usual/{TASK}", "#/overall", "#/guide"])
def test_a_result_of_another_version_has_its_place(visit, made, tmp_path, view):
    """One that lacks metrics of this version and has others: a dash for what is missing, the others by their names."""
    base = next(item for item in made.stored if item.result.task.id.endswith(TASK))
    usual = base.result.model_copy(update={"agent": base.result.agent.model_copy(update={"name": "usual", "kind": "submission"})})
    other = usual.model_copy(update={"agent": usual.agent.model_copy(update={"name": "other"})})
    other = of_another_version(other, ("epi", "heat", "cost_heat", "hours_co2_low"), {"gas": ("m3 m-2", 1.5)})
    stored = [StoredResult(base.path.with_name(f"{one.agent.name}.json"), one) for one in (usual, other)]
    file = tmp_path / "index.html"
    file.write_text(build_report(stored).html, encoding="utf-8")
    page = visit(view, file=file)
    draw_everything(page)
    words = page.locator("main").inner_text()
    assert "NaN" not in words
    assert "undefined" not in words
    if view == f"#/{TASK}":
        row = page.locator("table.ranks tbody tr").filter(has_text="other")
        assert [row.locator("td").nth(i).inner_text().split("\n")[0] for i in (3, 6)] == ["–", "–"], "profit and heat"
        change_price(page, "revenue", 2.0)
        assert page.locator("table.ranks tbody tr").count() == 2
    if "compare" in view:
        assert "gas" in words
