"""The page in a real browser: every view without an error, sorting, themes, prices, a phone. Needs Debian's chromium."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from glbench.report.page import packed_data
from tests.report.conftest import OTHER_PRICES

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed: no browser test")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with"),
]

PATIENCE = 120_000
"""Milliseconds to wait for what a busy machine may be slow to show."""
TALL = 12_000
"""Height of a window in which every chart is in view [pixels]."""
PHONE, DESK = {"width": 390, "height": 844}, {"width": 1280, "height": 900}
VIEWS = (
    "#/",
    "#/Days-v1",
    "#/overall",
    "#/agents",
    "#/agent/thrifty/Days-v1",
    "#/agent/doomed/Days-v1",
    "#/agent/rule_based/Schiphol2010-Delta10-v1",
    "#/compare/thrifty/lavish/Days-v1",
    "#/compare/thrifty/doomed/Days-v1",
    "#/compare/rule_based/rule_based_fair/Schiphol2010-Delta10-v1",
    "#/tasks",
    "#/task/Days-v1",
    "#/task/Schiphol2010-Delta10-v1",
    "#/guide",
    "#/agent/nobody",
    "#/task/nothing",
)
NAMELESS = """[...document.querySelectorAll('.chart')]
    .filter((one) => one._fullLayout.xaxis && !one.layout.annotations)
    .flatMap((one) => ['xaxis', 'yaxis']
        .filter((axis) => one._fullLayout[axis].type !== 'category' && !one.layout[axis].title?.text)
        .map((axis) => `${one.parentElement.innerText}: ${axis}`))"""
"""Charts with an axis of numbers that has no title."""
Page = Any
Open = Callable[..., Page]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture
def visit(browser: Any, made: Any) -> Iterator[Open]:
    """Open a view of the page; at the end nothing may have gone wrong in the console or been asked of the network."""
    problems: list[str] = []
    contexts = []

    def open_view(view: str = "#/", size: dict[str, int] = DESK, scheme: str = "light", file: Path | None = None) -> Page:
        context = browser.new_context(viewport=size, color_scheme=scheme, reduced_motion="reduce", offline=True)
        context.set_default_timeout(PATIENCE)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: problems.append(message.text) if message.type in ("error", "warning") else None)
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("requestfailed", lambda request: problems.append(f"asked for {request.url[:80]}"))
        page.goto((file or made.file).as_uri() + view)
        page.wait_for_selector("main h1")
        return page

    yield open_view
    for context in contexts:
        context.close()
    assert problems == []


@pytest.fixture(scope="module")
def narrow(browser: Any, made: Any) -> Iterator[Page]:
    """One page on a phone, which goes from view to view as a visitor does."""
    context = browser.new_context(viewport=PHONE, color_scheme="dark", reduced_motion="reduce", offline=True)
    context.set_default_timeout(PATIENCE)
    page = context.new_page()
    page.goto(made.file.as_uri())
    yield page
    context.close()


def draw_everything(page: Page, tall: int = TALL) -> None:
    """Scroll through the page until every chart that came into view is drawn."""
    page.wait_for_function("!document.querySelector('[aria-busy]')")
    page.set_viewport_size({"width": page.viewport_size["width"], "height": tall})
    page.wait_for_function("""() => {
        document.querySelectorAll('details').forEach((one) => { one.open = true; });  // also those of a view that comes late
        return [...document.querySelectorAll('.chart')].every((one) => one.dataset.drawn === 'yes');
    }""")


def test_a_malformed_address_is_not_found(visit):
    page = visit("#/%E0%A4%A")
    assert page.locator("main h1").inner_text() == "Not found"
    assert "%E0%A4%A" in page.inner_text("main")
    page.evaluate("location.hash = '#/guide'")
    page.wait_for_function("document.documentElement.dataset.shown === 'guide'")


def order(page: Page) -> list[str]:
    return [text.split("\n")[0] for text in page.locator("table.ranks tbody th").all_inner_texts()]


def figure(text: str) -> float:
    return float(text.split("(")[0].split()[0].replace(",", "").replace("−", "-"))


def column(page: Page, heading: str) -> dict[str, float]:
    """A column of the leaderboard by agent."""
    heads = [text.split("\n")[0] for text in page.locator("table.ranks thead th").all_inner_texts()]
    place = heads.index(heading) + 1
    cells = page.locator(f"table.ranks tbody tr > :nth-child({place})").all_inner_texts()
    return {agent: figure(cell) for agent, cell in zip(order(page), cells, strict=True)}


@pytest.mark.parametrize("view", VIEWS)
def test_a_view_shows_itself_without_an_error(visit, view):
    page = visit(view)
    draw_everything(page)
    assert page.locator("main h1").count() == 1
    assert page.title().endswith("· glbench")
    for table in page.locator("table").all():
        assert table.locator("caption").inner_text().strip()
    assert all(says for says in page.locator(".chart").evaluate_all("all => all.map((one) => one.ariaLabel)"))
    assert "NaN" not in page.locator("main").inner_text()
    assert "undefined" not in page.locator("main").inner_text()


@pytest.mark.parametrize("view", VIEWS)
def test_on_a_phone_a_view_does_not_scroll_sideways(narrow, view):
    narrow.evaluate("(view) => { location.hash = view; }", view)
    narrow.wait_for_function("(view) => document.querySelector('nav [aria-current]') && location.hash === view", arg=view)
    draw_everything(narrow)
    narrow.wait_for_function("(width) => document.documentElement.scrollWidth <= width", arg=PHONE["width"])  # once charts have settled


def test_the_leaderboard_shows_what_the_leaderboard_says(visit, made):
    page = visit("#/Schiphol2010-Delta10-v1")
    (table,) = [table for table in made.tables if table.task_id.endswith("Schiphol2010-Delta10-v1")]
    assert order(page) == [row.agent for row in table.rows]
    for heading, metric, decimals in (("Reward", "reward", 0), ("Profit (EPI)", "epi", 2), ("Lamp electricity", "electricity", 1)):
        shown = column(page, heading)
        for row in table.rows:
            assert shown[row.agent] == pytest.approx(row.estimates[metric].mean, abs=0.5 * 10**-decimals + 1e-9)


def test_regret_is_a_column_and_a_figure_of_its_parts_where_best_known_runs_are_known(visit, made):
    page = visit("#/Schiphol2010-Delta10-v1")
    (table,) = [table for table in made.tables if table.task_id.endswith("Schiphol2010-Delta10-v1")]
    shown = column(page, "Regret")
    for row in table.rows:
        assert shown[row.agent] == pytest.approx(row.regret.total.mean, abs=0.5)
    says = page.locator(".chart").first.get_attribute("aria-label")
    for row in table.rows:
        total, violations = row.regret.total.mean, row.regret.violations.mean
        assert f"{row.agent}: regret {total:,.1f}, of it profit {total - violations:,.1f}" in says
    change_price(page, "cost_heat", 0.05)
    page.wait_for_selector("details.prices.changed")
    assert "How far from the best known?" not in page.locator("main").inner_text()
    assert "–" in page.locator("table.ranks tbody tr").first.inner_text()


def test_a_task_without_best_known_runs_has_no_regret(visit):
    page = visit("#/Days-v1")
    assert page.locator("button[data-sort=regret]").count() == 0
    assert "best known" not in page.locator("main").inner_text()


def test_columns_sort_with_the_keyboard_and_say_so(visit):
    page = visit("#/Days-v1")
    assert page.locator("th[aria-sort]").count() == 1
    button = page.locator("button[data-sort=electricity]")
    button.focus()
    page.keyboard.press("Enter")
    light = list(column(page, "Lamp electricity").values())
    assert light == sorted(light)
    assert page.locator("th[aria-sort=ascending] button").get_attribute("data-sort") == "electricity"
    assert "lamps used" in page.locator(".explain").first.inner_text()
    page.keyboard.press("Enter")
    assert list(column(page, "Lamp electricity").values()) == sorted(light, reverse=True)
    assert page.locator("th[aria-sort]").count() == 1
    assert page.evaluate("document.activeElement.dataset.sort") == "electricity"


def ground(page: Page) -> str:
    return page.evaluate("getComputedStyle(document.body).backgroundColor")


def test_the_theme_follows_the_system_until_it_is_switched(visit):
    page = visit(scheme="dark")
    dark = ground(page)
    page.emulate_media(color_scheme="light")
    light = ground(page)
    assert dark != light
    page.locator("#theme").click()
    assert ground(page) == dark
    draw_everything(page)
    assert page.locator("#theme").get_attribute("aria-label") == "Switch to light colours"
    page.reload()
    assert ground(page) == dark, "the choice is remembered"


def change_price(page: Page, name: str, value: float) -> None:
    if not page.locator("#prices").get_attribute("open") is not None:
        page.locator("#prices summary").click()
    page.fill(f"#price-{name}", str(value))
    page.keyboard.press("Tab")


def test_other_prices_give_what_an_evaluation_at_these_prices_gives(visit, made):
    # The agents do not look at prices, and the crop is known: the task with other prices is the same but for its money.
    truth = {item.result.agent.name: item.result for item in made.stored if item.result.task.id == "test/CheapDays-v1"}
    page = visit("#/Days-v1")
    before = column(page, "Reward")
    for name, value in OTHER_PRICES.items():
        change_price(page, name, value)
    expected = sorted(truth, key=lambda name: -truth[name].summary.mean["reward"])
    assert order(page) == expected
    for heading, metric, decimals in (("Reward", "reward", 0), ("Profit (EPI)", "epi", 2)):
        shown = column(page, heading)
        for name, result in truth.items():
            assert shown[name] == pytest.approx(result.summary.mean[metric], abs=0.5 * 10**-decimals + 1e-4), name
    assert column(page, "Reward") != before
    page.locator("#reset-prices").click()
    assert column(page, "Reward") == before


def test_a_price_changes_the_order(visit, made):
    page = visit("#/Schiphol2010-Delta10-v1")
    first = order(page)
    items = {item.result.agent.name: item.result for item in made.stored if item.result.task.id.endswith("Schiphol2010-Delta10-v1")}

    def profit(name: str) -> float:
        mean = items[name].summary.mean
        return 8.0 * mean["yield"] - 0.09 * mean["heat"] - 0.3 * mean["co2"]

    change_price(page, "revenue", 8.0)
    change_price(page, "cost_electricity", 0.0)
    shown = column(page, "Profit (EPI)")
    for name in items:
        assert shown[name] == pytest.approx(profit(name), abs=0.006)
    assert order(page) == sorted(first, key=lambda name: -column(page, "Reward")[name])
    assert order(page) != first
    assert "Other prices" in page.locator("#prices summary").inner_text()


def test_an_impossible_price_is_refused_and_nothing_changes(visit):
    page = visit("#/Days-v1")
    before = column(page, "Profit (EPI)")
    change_price(page, "cost_heat", -1)
    assert column(page, "Profit (EPI)") == before


def test_the_comparison_says_who_earns_more(visit, made):
    results = {item.result.agent.name: item.result for item in made.stored if item.result.task.id == "test/Days-v1"}
    gap = results["thrifty"].summary.mean["epi"] - results["lavish"].summary.mean["epi"]
    assert not math.isclose(gap, 0.0, abs_tol=0.01)
    page = visit("#/compare/thrifty/lavish/Days-v1")
    words = page.locator(".story").inner_text()
    assert f"{abs(gap):.2f}" in words
    assert ("more than" if gap > 0 else "less than") in words
    page.select_option("#choose-b", "doomed")
    page.wait_for_function("location.hash.includes('doomed')")
    assert "doomed" in page.locator(".story").inner_text()
    page.go_back()
    page.wait_for_function("!location.hash.includes('doomed')")
    assert "lavish" in page.locator(".story").inner_text()


def test_failed_runs_are_told_with_their_reason(visit):
    page = visit("#/agent/doomed/Days-v1")
    assert "3 of 3 runs failed" in page.locator("main").inner_text()
    assert "nan, which is not a finite number" in page.locator(".missing").first.inner_text()


def test_a_result_without_a_profile_says_how_to_get_one(visit):
    page = visit("#/agent/rule_based/Schiphol2010-Delta10-v1")
    assert "glbench report --complete" in page.locator(".missing").inner_text()


def test_sandbox_training_and_card_are_columns_and_words_where_results_hold_them(visit, made, tmp_path):
    training = {"steps": 2_000_000, "wall_hours": 1.5, "hardware": "2 cores"}
    card = {"authors": ["A. Nother"], "description": "Heats little.", "link": "javascript:alert(1)", "training": training}
    told = {"thrifty": {"sandbox": "bubblewrap", "card": card, "training": training}, "lavish": {"sandbox": "unsandboxed"}}
    data = {**made.report.data, "results": [{**one, **told.get(one["agent"], {})} for one in made.report.data["results"]]}
    before, _, rest = made.report.html.partition('id="block-data">')
    file = tmp_path / "told.html"
    file.write_text(before + 'id="block-data">' + packed_data(data) + rest[rest.index("</script>") :], encoding="utf-8")
    page = visit("#/Days-v1", file=file)
    rows = page.locator("table.about tbody tr")
    assert "2.00\u00a0M" in rows.filter(has_text="thrifty").inner_text()
    assert rows.filter(has_text="lavish").locator(".tag.bad").inner_text() == "no"
    page.goto(file.as_uri() + "#/agent/thrifty/Days-v1")
    words = page.locator("main").inner_text()
    assert "Heats little." in words
    assert "trained for 2,000,000 control steps, 1.5 hours, on 2 cores" in words
    assert page.locator("main a[href^='javascript']").count() == 0


@pytest.mark.parametrize(
    "view", ["#/agent/rule_based/Schiphol2010-Delta10-v1", "#/compare/thrifty/lavish/Days-v1", "#/task/Schiphol2010-Delta10-v1"]
)
def test_axes_say_what_they_show(visit, view):
    """But for those of names, and for the worst run, whose panels have titles with units."""
    page = visit(view)
    draw_everything(page)
    nameless = page.evaluate(NAMELESS)
    assert nameless == []


def test_settings_of_a_baseline_are_a_table(visit):
    page = visit("#/agent/rule_based/Schiphol2010-Delta10-v1")
    assert "Heating day 19.5 °C" in " ".join(page.inner_text("#settings").split())


def test_weeks_are_a_table(visit):
    page = visit("#/agent/thrifty/Days-v1")
    draw_everything(page)
    assert "Heat as natural gas" in page.inner_text("#weeks")
    assert page.locator("#weeks tbody tr").count() == 1  # two days


def test_a_released_result_that_is_ones_own_too_says_so(visit, made, tmp_path):
    results = [{**one, "confirmed": one["agent"] == "thrifty"} for one in made.report.data["results"]]
    before, _, rest = made.report.html.partition('id="block-data">')
    packed = packed_data({**made.report.data, "results": results})
    file = tmp_path / "confirmed.html"
    file.write_text(before + 'id="block-data">' + packed + rest[rest.index("</script>") :], encoding="utf-8")
    rows = visit("#/Days-v1", file=file).locator("table.about tbody tr")
    assert "yours is the same" in rows.filter(has_text="thrifty").inner_text()
    assert "yours is the same" not in rows.filter(has_text="lavish").inner_text()


def test_the_skip_link_and_the_names_of_fields_are_there(visit):
    page = visit("#/Days-v1")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    unnamed = page.evaluate("[...document.querySelectorAll('input,select')].filter((one) => !one.labels.length).length")
    assert unnamed == 0
    assert page.locator("nav a[aria-current=page]").inner_text() == "Leaderboard"
