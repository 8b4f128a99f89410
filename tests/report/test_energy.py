"""A board of a task with an energy system: a day of energy, and prices that change with the calendar, tried at other values."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from glbench.evaluation import Result, evaluate
from glbench.leaderboard import collect_results, rank
from glbench.report import build_report
from glbench.tasks import TaskSpec
from tests.energy import dated_task, energy_task, write_rules
from tests.report.conftest import Made
from tests.report.test_browser import CHROMIUM, PHONE, browser, change_price, column, draw_everything, visit
from tests.report.test_data import blocks_of, embedded, unpacked

__all__ = ["browser", "visit"]
pytestmark = pytest.mark.slow
HOURLY = energy_task().price_tables["power"].hourly
TIMES, PLUS = 1.5, 0.02
VIEW = "#/agent/engine/Energy-v1"
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on this machine to look at the page with")


SCALED = {"reward.modules": ["scaled_epi", "scaled_penalty"], "reward.epi_scale": {"low": -0.01, "high": 0.02, "unit": "EUR m-2"}}


def two_days(name: str, hourly: list[float] | None = None, changes: dict[str, object] | None = None) -> TaskSpec:
    """Two days, two runs, at other prices of power; reward is the profit minus the penalty."""
    prices = {} if hourly is None else {"price_tables.power.hourly": hourly}
    return energy_task({"id": f"test/{name}-v1", "weather.days": 2, "evaluation.runs": 2, **prices, **(changes or {})})


LIMIT = 0.2  # kWh m-2


def stepped(name: str, price: float) -> TaskSpec:
    """Heat to the pipes costs something, and twice as much as 0.05 beyond an amount that every run uses."""
    item = {
        "side": "paid", "flow": "heat_to_pipes", "amount": "pipe_heat_used", "unit": "kWh m-2", "factor": 1 / 3.6e6,
        "price": {"value": price, "unit": "EUR kWh-1"},
        "beyond": {
            "amount": {"value": LIMIT, "unit": "kWh m-2"}, "price": {"value": 0.1, "unit": "EUR kWh-1"},
        },
    }  # fmt: skip
    return two_days(name, None, {"ledger.cost_pipes": item})


TASKS = {
    "Stepped": stepped("Stepped", 0.05),
    "DearStepped": stepped("DearStepped", 0.08),
    "Energy": two_days("Energy"),
    "Dear": two_days("Dear", [TIMES * price + PLUS for price in HOURLY]),
    "Flat": two_days("Flat", [sum(HOURLY) / 24] * 24),
    "Scaled": two_days("Scaled", None, SCALED),
    "DearScaled": two_days("DearScaled", [TIMES * price + PLUS for price in HOURLY], SCALED),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    """Two agents that do not look at prices, on tasks that differ in price and reward, and one of them at prices by day."""
    folder: Path = tmp_path_factory.mktemp("energy")
    for task in TASKS.values():
        for name, engine in (("stores", False), ("engine", True)):
            evaluate(task, write_rules(folder, name, stores=True, engine=engine), out=folder)
    evaluate(dated_task(folder), write_rules(folder, "engine", stores=True, engine=True), out=folder)
    stored = collect_results([folder / "results"])
    report = build_report(stored)
    (folder / "index.html").write_text(report.html, encoding="utf-8")
    return Made(folder, stored, rank(stored, {}), report, folder / "index.html")


def results(made: Made, name: str) -> dict[str, Result]:
    found = (item.result for item in made.stored if item.result.task.id == f"test/{name}-v1")
    return {result.agent.name: result for result in found}


def test_the_page_holds_the_energy_of_a_profile_and_the_mean_of_a_price(made):
    data = embedded(made)
    (task,) = (task for task in data["tasks"] if task["short"] == "Energy-v1")
    assert task["mean_prices"] == {"revenue_power": pytest.approx(np.mean(HOURLY))}
    (result,) = (one for one in data["results"] if one["agent"] == "engine" and one["task"] == task["id"])
    held = json.loads(blocks_of(made.report.html)[result["profile"]])["energy"]
    sold = results(made, "Energy")["engine"].values("electricity_sold")
    assert unpacked(held["columns"]["electricity_sold"]).sum() == pytest.approx(np.mean(sold) / 2, rel=2e-3)
    assert held["prices"].keys() == {"revenue_power"}


@needs_browser
def test_a_price_table_times_and_plus_is_what_an_evaluation_at_these_prices_gives(visit, made):
    page = visit("#/Energy-v1")
    before = column(page, "Profit (EPI)")
    change_price(page, "revenue_power", TIMES)
    change_price(page, "revenue_power-plus", PLUS)
    shown, rewards = column(page, "Profit (EPI)"), column(page, "Reward")
    for name, result in results(made, "Dear").items():
        assert shown[name] == pytest.approx(result.summary.mean["epi"], abs=0.0051), name
        assert rewards[name] == pytest.approx(result.summary.mean["reward"], abs=0.51), name
    assert shown["engine"] > before["engine"] + 0.02
    assert "electricity sold × 1.5 + 0.02 EUR/kWh" in page.locator("#prices summary").inner_text()
    page.locator("#reset-prices").click()
    assert column(page, "Profit (EPI)") == before


@needs_browser
def test_a_price_that_steps_keeps_its_second_price_at_another_first_one(visit, made):
    truth = results(made, "DearStepped")
    assert min(truth["engine"].values("pipe_heat_used")) > 2 * LIMIT
    page = visit("#/Stepped-v1")
    before = column(page, "Profit (EPI)")["engine"]
    change_price(page, "cost_pipes", 0.08)
    shown = column(page, "Profit (EPI)")
    for name, result in truth.items():
        assert shown[name] == pytest.approx(result.summary.mean["epi"], abs=0.0051), name
    assert shown["engine"] == pytest.approx(before - 0.03 * LIMIT, abs=0.0101)
    change_price(page, "revenue_power", 2)
    earned = results(made, "Stepped")["engine"].summary.mean["revenue_power"]
    assert column(page, "Profit (EPI)")["engine"] == pytest.approx(truth["engine"].summary.mean["epi"] + earned, abs=0.0051)


@needs_browser
def test_a_reward_that_is_scaled_between_stated_profits_stays_so_at_other_prices(visit, made):
    (task,) = (task for task in embedded(made)["tasks"] if task["short"] == "Scaled-v1")
    assert task["stated_scale"] == [-0.01, 0.02]
    page = visit("#/Scaled-v1")
    change_price(page, "revenue_power", TIMES)
    change_price(page, "revenue_power-plus", PLUS)
    assert "The scale of the reward moves" not in page.locator("#prices").inner_text()
    shown = column(page, "Reward")
    for name, result in results(made, "DearScaled").items():
        assert shown[name] == pytest.approx(result.summary.mean["reward"], abs=0.51), name


@needs_browser
def test_a_flat_price_is_what_an_evaluation_at_the_mean_gives(visit, made):
    page = visit(VIEW)
    page.locator("#prices summary").click()
    page.select_option("#price-revenue_power-flat", "1")
    page.wait_for_selector("details.prices.changed")
    assert f"flat at {np.mean(HOURLY):.4f} EUR/kWh" in page.locator("#prices summary").inner_text()
    truth = results(made, "Flat")["engine"].summary.mean
    assert truth["revenue_power"] != pytest.approx(results(made, "Energy")["engine"].summary.mean["revenue_power"], abs=2e-3)
    told = page.evaluate("[...document.querySelectorAll('.chart')].map((one) => one.ariaLabel).join(' ')")
    assert f"Electricity sold {truth['revenue_power']:.2f}" in told
    page.evaluate("location.hash = '#/Energy-v1'")
    page.wait_for_selector("table.ranks")
    shown = column(page, "Profit (EPI)")
    for name, result in results(made, "Flat").items():
        assert shown[name] == pytest.approx(result.summary.mean["epi"], abs=0.0051), name
    page.evaluate("location.hash = '#/compare/engine/stores/Energy-v1'")
    page.wait_for_function("location.hash.includes('compare') && document.querySelector('.story')")
    draw_everything(page)
    gap = truth["epi"] - results(made, "Flat")["stores"].summary.mean["epi"]
    assert f"{abs(gap):.2f}" in page.locator(".story").inner_text()
    assert "NaN" not in page.locator("main").inner_text()


@needs_browser
def test_where_a_price_has_no_hours_flat_is_what_the_runs_met(visit, made):
    mean = results(made, "Dated")["engine"].summary.mean
    met = mean["revenue_power"] / mean["electricity_sold"]
    assert 0.051 < met < 0.079
    page = visit("#/Dated-v1")
    page.locator("#prices summary").click()
    assert "for electricity sold the mean price that the runs here met" in page.locator("#prices").inner_text()
    page.select_option("#price-revenue_power-flat", "1")
    page.wait_for_selector("details.prices.changed")
    assert f"flat at {met:.4f} EUR/kWh" in page.locator("#prices summary").inner_text()
    change_price(page, "revenue_power", 2)
    shown = column(page, "Profit (EPI)")["engine"]
    assert shown == pytest.approx(mean["epi"] + mean["revenue_power"], abs=0.0051)


@needs_browser
def test_a_day_of_energy_is_drawn_on_a_desk_and_on_a_phone(visit):
    for size in (None, PHONE):
        page = visit(VIEW) if size is None else visit(VIEW, size=size)
        draw_everything(page, 24_000)
        text = page.locator("#energy").inner_text()
        assert "glbench episodes dispatch" in text
        assert "NaN" not in text
        says = page.locator("#energy .chart").first.get_attribute("aria-label")
        assert "Gas to engine" in says
        assert "Buffer to pipes" in says
        assert page.locator("#energy .chart").count() == 5
        assert page.evaluate("document.documentElement.scrollWidth") <= page.viewport_size["width"]


@needs_browser
def test_what_comes_into_a_node_goes_out_of_it(visit):
    page = visit(VIEW)
    draw_everything(page)
    rows = page.locator("#energy table tbody tr").all_inner_texts()
    flows = [(*row.split("\t")[0].split(" → "), float(row.split("\t")[1])) for row in rows]
    for node in ("boiler", "engine", "buffer"):
        into = sum(amount for _, to, amount in flows if to == node)
        out = sum(amount for origin, _, amount in flows if origin.lower() == node)
        assert into == pytest.approx(out, rel=0.02), node
        assert into > 0.0
