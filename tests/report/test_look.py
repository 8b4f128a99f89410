"""What the page looks like on a desk, on a phone and on paper, and the first words of every view. Needs Debian's chromium."""

from __future__ import annotations

import itertools
import re
import subprocess
import zlib
from pathlib import Path

import pytest

from glbench.leaderboard import collect_results, rank
from glbench.leaderboard.collect import published_expectations
from glbench.report import build_report
from glbench.resources import data_folder
from tests.report.test_browser import CHROMIUM, PHONE, browser, visit

__all__ = ["browser", "visit"]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with"),
]
RELEASED = {
    "SpringEnergy-v1": ("rule_based_energy", "energy_agent", "do_nothing"),
    "Spring-v1": ("best_known", "mpc", "ppo_memory", "ppo_fast", "sac_fast", "rule_based_tuned", "pi_controller", "do_nothing"),
}
DESK = {"width": 1400, "height": 900}
VIEWS = (
    "#/",
    "#/SpringEnergy-v1",
    "#/overall/energy",
    "#/overall/control",
    "#/agents",
    "#/agent/rule_based_energy/SpringEnergy-v1",
    "#/compare/rule_based_energy/energy_agent/SpringEnergy-v1",
    "#/tasks",
    "#/task/SpringEnergy-v1",
    "#/guide",
)
OVERLAPS = """[...document.querySelectorAll('thead tr')].flatMap((row) => {
    const textOf = (cell) => { const range = document.createRange(); range.selectNodeContents(cell); return range; };
    const boxes = [...row.cells].map((cell) => textOf(cell).getBoundingClientRect());
    return [...row.cells].slice(1).filter((_, i) => boxes[i].width && boxes[i + 1].width && boxes[i].right > boxes[i + 1].left + 0.5)
        .map((cell) => cell.innerText);
})"""
"""Headings whose text reaches into that of the next."""
CUT = "[...document.querySelectorAll('.scroll')].filter((one) => one.scrollWidth > one.clientWidth).map((one) => one.ariaLabel)"
"""Tables that are wider than their place."""


@pytest.fixture(scope="module")
def wild(tmp_path_factory):
    """A page of released results with many columns, ties, a privileged agent, and one that lies far below all others."""
    folder = tmp_path_factory.mktemp("wild")
    for task, agents in RELEASED.items():
        (folder / "results" / task).mkdir(parents=True)
        for file in (data_folder("reports/released/results") / task).iterdir():
            if re.sub(r"(_seed\d)?\..*", "", file.name) in agents:
                (folder / "results" / task / file.name).symlink_to(file)
    stored = collect_results([folder / "results"])
    file = folder / "index.html"
    file.write_text(build_report(stored).html, encoding="utf-8")
    return file, {table.task_id: table for table in rank(stored, published_expectations())}


def go(page, view: str) -> None:
    page.evaluate("(view) => { location.hash = view; }", view)
    page.wait_for_function("document.querySelector('main h1') && !document.querySelector('[aria-busy]')")


def test_on_a_desk_every_table_shows_all_its_columns(visit, wild):
    page = visit(size=DESK, file=wild[0])
    for view in VIEWS:
        go(page, view)
        page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert page.evaluate("document.documentElement.scrollWidth") <= DESK["width"], view
        assert page.evaluate(CUT) == [], view
        assert page.evaluate(OVERLAPS) == [], view


def test_on_a_phone_tables_scroll_inside_and_keep_the_first_column(visit, wild):
    page = visit(size=PHONE, file=wild[0])
    for view in VIEWS:
        go(page, view)
        page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], view
        assert page.evaluate(OVERLAPS) == [], view
    go(page, "#/SpringEnergy-v1")
    table = page.locator(".scroll").first
    table.evaluate("(one) => { one.scrollLeft = 300; }")
    left = table.evaluate("(one) => one.getBoundingClientRect().left")
    names = table.locator("tbody th.agent").evaluate_all("all => all.map((one) => one.getBoundingClientRect().left)")
    assert all(abs(name - left) < 3 for name in names)
    assert "gradient" in table.evaluate("(one) => getComputedStyle(one).backgroundImage")
    caption = table.locator("caption span").evaluate("(one) => [one.getBoundingClientRect().left, one.getBoundingClientRect().right]")
    assert left <= caption[0] < caption[1] <= PHONE["width"]


def test_the_scale_shows_the_others_and_marks_what_is_off_it(visit, wild):
    page = visit("#/SpringEnergy-v1", DESK, file=wild[0])
    rows = page.locator("table.ranks tbody tr")
    nothing = rows.filter(has_text="do_nothing").locator("td").nth(1)
    assert "−54.66" in nothing.inner_text()
    assert nothing.locator(".bar.off.below").inner_text() == "off scale"
    dots = page.locator("table.ranks tbody tr > :nth-child(3) .bar:not(.off) b").evaluate_all(
        "all => all.map((one) => parseFloat(one.style.left))"
    )
    assert len(dots) == 2
    assert abs(dots[0] - dots[1]) > 40
    go(page, "#/overall/control")
    assert "Off the scale to the left: do_nothing" in page.locator("main").inner_text()
    page.locator("#close-up").click()
    assert "Off the scale to the left" not in page.locator("main").inner_text()


def test_tiles_leave_no_gap_and_labels_of_the_waterfall_stand_apart(visit, wild):
    page = visit("#/agent/rule_based_energy/SpringEnergy-v1", DESK, file=wild[0])
    for width in (1400, 820, 390):
        page.set_viewport_size({"width": width, "height": 900})
        area = page.evaluate(
            """(() => {
                const size = ({ offsetWidth, offsetHeight }) => offsetWidth * offsetHeight, whole = document.querySelector('.tiles');
                return [...whole.children].reduce((total, one) => total + size(one), 0) / size(whole);
            })()"""
        )
        assert area > 0.97, width
    page.set_viewport_size(DESK)
    for width in (1400, 390):
        page.set_viewport_size({"width": width, "height": 900})
        page.locator(".tiles").scroll_into_view_if_needed()
        page.wait_for_function("[...document.querySelectorAll('.chart')].some((one) => one._fullData?.[0].type === 'waterfall')")
        page.wait_for_timeout(700)
        boxes = page.evaluate(
            """(() => {
                const drawing = [...document.querySelectorAll('.chart')].find((one) => one._fullData?.[0].type === 'waterfall');
                const boxOf = ({ left, right, top, bottom }) => [left, right, top, bottom];
                return [...drawing.querySelectorAll('.bartext, .ytick text')].map((one) => boxOf(one.getBoundingClientRect()));
            })()"""
        )
        assert len(boxes) >= 16
        for i, (left, right, top, bottom) in enumerate(boxes):
            for other in boxes[i + 1 :]:
                apart = right <= other[0] + 1 or other[1] <= left + 1 or bottom <= other[2] + 1 or other[3] <= top + 1
                assert apart, (width, boxes[i], other)


def test_a_task_is_told_without_its_keys(visit, wild):
    page = visit("#/task/SpringEnergy-v1", DESK, file=wild[0])
    page.evaluate("document.querySelectorAll('#definition details').forEach((one) => { one.open = true; })")
    words = page.locator("#definition").inner_text()
    raw = set(re.findall(r"\b[a-z]+_[a-z_]+\b|\b[a-z]+\.[a-z]+\b|\b[a-z]+[A-Z]\w*|\w+ \w+-\d\b|degC", words)) - {"kWh"}
    assert raw == set()
    for told in (
        "180 kg/ha an hour",
        "0.0032 EUR/m² for every 100 ppm and hour",
        "Power sold",
        "CO₂ bought",
        "The engine runs at 70 to 100 %",
    ):
        assert told in words
    assert page.locator("#keys").get_attribute("open") is None
    assert "ledger.cost_gas.flow" in page.locator("#keys").text_content()


@pytest.mark.parametrize(
    ("written", "meant", "refusal"),
    [
        ("0,05", 0.05, ""),
        ("0.05", 0.05, ""),
        (" 12,5 ", 12.5, ""),
        (",5", 0.5, ""),
        ("1.234", 1.234, ""),
        ("1.234,5", None, "more than one point or comma"),
        ("1,234.5", None, "more than one point or comma"),
        ("1.2.3", None, "more than one point or comma"),
        ("0,05 EUR", None, "is not a number"),
        ("5e-2", None, "is not a number"),
        ("", None, "Empty"),
        ("-1", None, "-1 is outside 0 to 100"),
        ("1000", None, "1000 is outside 0 to 100"),
    ],
)
def test_prices_are_read_with_a_decimal_comma_or_point(visit, wild, written, meant, refusal):
    page = visit("#/Spring-v1", DESK, file=wild[0])
    page.locator("#prices summary").click()
    page.fill("#price-cost_heat", written)
    said = page.locator("#understood-cost_heat").inner_text()
    page.keyboard.press("Tab")
    changed = page.locator("details.prices.changed").count()
    if meant is None:
        assert refusal in said
        assert changed == 0
        assert page.locator("#price-cost_heat").get_attribute("aria-invalid") == "true"
    else:
        decimals = max(2, len(str(meant).partition(".")[2]))
        assert said == f"= {meant:.{decimals}f}\u00a0EUR/kWh"
        assert changed == 1
        assert f"heat {meant} instead of 0.09 EUR/kWh" in page.locator("#prices summary").inner_text()


def pages_of(file: Path) -> int:
    return len(re.findall(rb"/Type\s*/Page\b", file.read_bytes()))


@pytest.mark.parametrize("view", ["#/agent/rule_based_energy/SpringEnergy-v1", "#/SpringEnergy-v1"])
def test_before_printing_every_chart_is_drawn_in_light_colours_and_tables_fit(visit, wild, view):
    page = visit(view, DESK, scheme="dark", file=wild[0])
    page.wait_for_function("!document.querySelector('[aria-busy]') && document.readyState === 'complete'")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print", color_scheme="dark")
    charts = page.locator(".chart:visible")
    assert charts.count() >= (1 if view == "#/SpringEnergy-v1" else 30)
    assert charts.evaluate_all("all => all.filter((one) => !one.querySelector('.main-svg, .gl-container')).length") == 0
    assert charts.evaluate_all("all => all.filter((one) => one.dataset.drawn !== 'yes').length") == 0
    assert charts.evaluate_all("all => Math.max(...all.map((one) => one.querySelector('.main-svg').getBoundingClientRect().right))") <= 703
    assert page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--paper')").strip() == "#ffffff"
    assert (
        page.locator("table:visible").evaluate_all(
            "all => all.filter((one) => one.getBoundingClientRect().right > 704).map((one) => one.caption.innerText)"
        )
        == []
    )
    page.emulate_media(media="screen", color_scheme="dark")
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--paper')").strip() == "#101512"
    assert page.evaluate("document.documentElement.style.width") == ""


def test_chromium_prints_the_whole_page_unasked(wild, tmp_path):
    out = tmp_path / "page.pdf"
    subprocess.run(
        [
            CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'chrome'}", "--no-pdf-header-footer",
            f"--print-to-pdf={out}", f"{wild[0].as_uri()}#/agent/rule_based_energy/SpringEnergy-v1",
        ],
        check=True, capture_output=True, timeout=240,
    )  # fmt: skip
    assert pages_of(out) >= 6
    drawn = b"".join(zlib.decompress(part) for part in streams(out.read_bytes()))
    assert len(re.findall(rb"\b(?:l|c)\r?\n", drawn)) > 5_000, "lines of charts"


def streams(document: bytes) -> list[bytes]:
    """Compressed streams of a PDF file."""
    found = []
    for match in re.finditer(rb"stream\r?\n", document):
        part = document[match.end() : document.find(b"endstream", match.end())]
        if part[:1] == b"x":
            found.append(part.rstrip(b"\r\n"))
    return found


def test_every_view_begins_with_what_to_conclude(visit, wild):
    page = visit(size=DESK, file=wild[0])
    for view in VIEWS:
        if view == "#/guide":
            continue
        go(page, view)
        words = page.locator("main p.story").first
        box = words.bounding_box()
        assert box["y"] + box["height"] < DESK["height"], view
        assert len(words.inner_text()) > 60, view


def test_first_words_say_who_leads_by_how_much_and_who_cannot_be_told_apart(visit, wild):
    page = visit("#/Spring-v1", DESK, file=wild[0])
    told = page.locator("main p.story").inner_text()
    rows = {row.agent: row for row in wild[1]["glbench/Spring-v1"].rows}
    assert told.startswith(
        "mpc leads with a mean score of 3.69 EUR/m² among the agents that see no more than observations.".replace(" EUR", "\u00a0EUR")
    )
    assert "told apart" in told
    assert "The privileged best_known reaches 5.34" in told
    assert rows["mpc"].rank == 2
    go(page, "#/agent/sac_fast/Spring-v1")
    words = page.locator("main p.story").inner_text()
    assert "It is a single training; another one of the same recipe may do better or worse." in words
    go(page, "#/agent/ppo_memory/Spring-v1")
    assert "It is the mean of 5 trainings." in page.locator("main p.story").inner_text()


def test_agents_that_share_a_rank_are_never_called_better(visit, wild):
    page = visit("#/Spring-v1", DESK, file=wild[0])
    rows = [row for row in wild[1]["glbench/Spring-v1"].rows if row.rank is not None]
    pairs = [(one.agent, two.agent) for i, one in enumerate(rows) for two in rows[i + 1 :] if one.rank == two.rank]
    assert pairs
    for one, two in pairs:
        go(page, f"#/compare/{one}/{two}/Spring-v1")
        told = page.locator("main p.story").inner_text()
        assert f"{one} and {two} cannot be told apart" in told
        assert "higher" not in told.partition(".")[0]
        go(page, f"#/agent/{two}/Spring-v1")
        assert re.search(rf"\b{one}\b[^.]*cannot be told apart from it", page.locator("main p.story").inner_text())
    apart = next((one.agent, two.agent) for one, two in itertools.pairwise(rows) if one.rank != two.rank)
    go(page, f"#/compare/{apart[0]}/{apart[1]}/Spring-v1")
    assert "the two are told apart" in page.locator("main p.story").inner_text()


def test_terms_are_explained_where_they_are_met_and_listed_at_the_end(visit, wild):
    page = visit("#/Spring-v1", PHONE, file=wild[0])
    terms = page.locator("main .term").all_inner_texts()
    assert "told apart" in terms
    assert len(terms) == len(set(terms))
    page.locator("main .term", has_text="told apart").click()
    box = page.locator("#meaning").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= PHONE["width"]
    assert "beyond chance" in page.locator("#meaning").inner_text()
    page.keyboard.press("Escape")
    assert page.locator("#meaning").is_hidden()
    listed = page.locator("#terms dt").all_inner_texts()
    assert {"Told apart", "Regret", "Privileged", "Travel of actuators", "Worst tenth (CVaR10)", "95 % interval"} <= set(listed)
    go(page, "#/overall/control")
    assert {"IQM", "Optimality gap", "Performance profile"} <= set(page.locator("#terms dt").all_inner_texts())


def test_terms_flow_with_the_text_and_open_from_the_keyboard(visit, wild):
    page = visit("#/Spring-v1", PHONE, file=wild[0])
    term = page.locator("main .term", has_text="told apart")
    assert term.evaluate("one => getComputedStyle(one).display") == "inline", "a box of its own breaks after a bracket"
    for key in ("Enter", " "):
        term.focus()
        page.keyboard.press(key)
        assert "beyond chance" in page.locator("#meaning").inner_text()
        page.keyboard.press("Escape")
        assert page.locator("#meaning").is_hidden()


REACHES_OUT = """(chart) => [...chart.querySelectorAll('text')].filter((one) => one.textContent.trim()).filter((one) => {
    const [here, all] = [one.getBoundingClientRect(), chart.getBoundingClientRect()];
    return here.right > all.right + 1 || here.left < all.left - 1;
}).map((one) => one.textContent)"""


def test_on_a_phone_labels_of_charts_stay_inside_and_legends_above(visit, wild):
    page = visit("#/Spring-v1", PHONE, file=wild[0])
    regret = page.locator("figure", has_text="Regret").locator(".chart")
    regret.scroll_into_view_if_needed()
    page.wait_for_function("(chart) => chart.dataset.drawn === 'yes'", arg=regret.element_handle())
    assert "▶" in regret.inner_text()
    assert regret.evaluate(REACHES_OUT) == []
    go(page, "#/compare/ppo_memory/rule_based_tuned/Spring-v1")
    hours = page.locator("figure", has_text="Profit, A minus B").locator(".chart")
    hours.scroll_into_view_if_needed()
    page.wait_for_function("(chart) => chart.dataset.drawn === 'yes'", arg=hours.element_handle())
    legend, plot = (hours.locator(part).first.bounding_box() for part in (".legend", ".nsewdrag"))
    assert legend["height"] > 20
    assert legend["y"] + legend["height"] <= plot["y"]
