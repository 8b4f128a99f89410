"""Prices in runs: what is seen is what the ledger pays, and a season's prices are its own."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import Simulation, StepResult, run_weather
from glbench.env.scenario import RunScenarios
from glbench.env.weather_pool import WeatherPool
from glbench.errors import TaskError
from glbench.tasks import TaskSpec, get_task
from glbench.tasks.prices import SHAPE

MODULES = ("prices", "day_ahead_prices")

SEEDS = [10_003, 10_001, 10_002]
"""Of three seasons of the training split."""
SHORT = {"weather.days": 2, "splits.training.seasons": 4, "splits.validation.seasons": 2, "splits.test.seasons": 2}
MARKET = "price_tables.power.market"
AHEAD = (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 18, 21)


@pytest.fixture(scope="module")
def task() -> TaskSpec:
    """Two days of WinterLED."""
    return get_task("WinterLED-v1").replace(SHORT)


def walk(task: TaskSpec, seeds: list[int], *, fused: bool = True) -> tuple[NDArray[np.float32], list[StepResult]]:
    """A whole run with the lamps and the CO2 on: observations before each step, and the steps."""
    simulation = Simulation(task, len(seeds), fused=fused)
    seen, results = [simulation.reset(seeds)], []
    for _ in range(task.steps):
        results.append(simulation.step_controls(np.full((len(seeds), len(task.model_value.control_names)), 0.3)))
        seen.append(results[-1].observations)
    return np.stack(seen[:-1]), results


def paid(results: list[StepResult]) -> NDArray[np.float64]:
    """EUR for a kWh of power in each step ``(steps, runs)``."""
    return np.stack([one.quantities["cost_electricity"] / one.quantities["electricity"] for one in results])


def by_name(task: TaskSpec, seen: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    return {one.name: seen[..., column] for column, one in enumerate(task.observed())}


def season_prices(task: TaskSpec, seeds: list[int], name: str = "power") -> NDArray[np.float64]:
    """Prices of the runs of ``seeds`` ``(runs, rows)``."""
    scenarios = RunScenarios(task)
    pool, first = scenarios.pool, scenarios.draw(seeds).first
    return np.stack([pool.calendar[at : at + task.steps, pool.price_column(name)] for at in first])


def check_what_is_seen(task: TaskSpec, seeds: list[int]) -> None:
    seen, results = walk(task, seeds)
    shown, price = by_name(task, seen), paid(results)
    assert shown["price_power"] == pytest.approx(price, rel=1e-6)
    assert len(np.unique(price[:, 0])) > 40  # a price for every hour
    for now in range(task.steps):
        hour, day = now // 4, now // 96  # the days begin at midnight
        for ahead in AHEAD:
            then = hour + ahead if (hour + ahead) // 24 == day else hour + ahead - 24
            assert shown[f"price_power_in_{ahead}h"][now] == pytest.approx(price[4 * then], rel=1e-6), (now, ahead)


def test_what_is_seen_is_what_the_ledger_pays_until_midnight(task: TaskSpec) -> None:
    check_what_is_seen(task, SEEDS)


def test_prices_of_real_years_are_seen_and_paid_as_well() -> None:
    real = get_task("WinterLED-v1").replace(
        {
            "weather.days": 2,
            "scenario.generated": None,
            "scenario.co2_range": None,
            "scenario.start_within_days": None,
            "splits.training.seasons": None,
            "splits.validation.seasons": None,
            "splits.test.seasons": None,
        }
    )
    assert real.scenario.generated is None
    check_what_is_seen(real, SEEDS)
    years = {run_weather(real, seed).times[0]: season_prices(real, [seed]).tobytes() for seed in range(10_000, 10_020)}
    assert len(years) == len(set(years.values())) == 3  # each year has prices of its own


def test_fruit_is_paid_at_the_price_of_the_day_and_so_is_it_shown(task: TaskSpec) -> None:
    later = task.replace({"weather.start": "2010-10-14", "scenario.start_within_days": None, "weather.days": 3})
    seen, _ = walk(later, [10_000])
    assert by_name(later, seen)["price_fruit"][:, 0] == pytest.approx([1.2] * 96 + [1.4] * 192)


def test_a_seasons_prices_depend_on_the_seed_through_the_season_alone(task: TaskSpec) -> None:
    first = task.evaluation.first_seed
    prices = season_prices(task, [first, first + 1, first + 2, first + 3, first + 4, first + 4004])
    assert (prices[0] == prices[4]).all()
    assert (prices[0] == prices[5]).all()
    assert len({row.tobytes() for row in prices}) == 4
    unexplained = {f"{MARKET}.sun": 0.0, f"{MARKET}.wind": 0.0}
    paths = season_prices(task.replace(unexplained), [first, first + 1, first + 2, first + 3])
    assert len({row.tobytes() for row in paths}) == 4
    assert (season_prices(task.in_split("validation"), [first]) != prices[:1]).any()


def test_prices_follow_the_sun_and_the_wind_of_their_season(task: TaskSpec) -> None:
    explained = task.replace({f"{MARKET}.spread": 0.0, f"{MARKET}.lowest": -10.0, f"{MARKET}.highest": 10.0})
    for seed, prices in zip(SEEDS, season_prices(explained, SEEDS), strict=True):
        weather = run_weather(explained, seed)
        rows = weather.values[: task.steps]
        sun, wind = rows[:, 0].reshape(-1, 4).mean(axis=1), rows[:, 4].reshape(-1, 4).mean(axis=1)
        hour = weather.hour_of_day[: task.steps : 4].astype(int)
        local = weather.times[: task.steps : 4].astype("datetime64[s]") + np.timedelta64(7200, "s")  # summer time
        weekend = np.isin([at.astype(object).weekday() for at in local], [5, 6])
        share = np.array(SHAPE)[hour] - 0.1 * weekend - 0.8 * sun / 1000.0 - 0.25 * (wind - 5.0) / 5.0
        assert prices == pytest.approx(np.repeat(0.2 * share, 4), rel=1e-6)
        assert sun.max() > 100.0


def test_the_unexplained_part_has_its_spread_and_hangs_together() -> None:
    long = get_task("WinterLED-v1").replace(
        {"splits.training.seasons": 8, f"{MARKET}.sun": 0.0, f"{MARKET}.wind": 0.0, f"{MARKET}.weekend": 0.0,
         f"{MARKET}.shape": [1.0] * 24, f"{MARKET}.lowest": -10.0, f"{MARKET}.highest": 10.0}
    )  # fmt: skip
    paths = (season_prices(long, list(range(8)))[:, ::4] / 0.2 - 1.0) / 0.2
    assert paths.mean() == pytest.approx(0.0, abs=0.3)
    assert paths.std() == pytest.approx(1.0, abs=0.15)
    assert np.corrcoef(paths[:, 1:].ravel(), paths[:, :-1].ravel())[0, 1] == pytest.approx(0.97, abs=0.02)


def test_a_table_that_follows_a_market_has_its_path() -> None:
    energy = get_task("SpringEnergy-v1").replace(SHORT)
    power, bought = (season_prices(energy, SEEDS, name) for name in ("power", "power_bought"))
    assert bought == pytest.approx(power + 0.03, abs=1e-15)
    assert len(np.unique(power)) > 100


@pytest.mark.parametrize("name", ["WinterLED-v1", "SpringEnergy-v1"])
def test_the_same_bits_alone_in_a_batch_and_unfused(name: str) -> None:
    task = get_task(name).replace(SHORT)
    seen, results = walk(task, SEEDS)
    tables = np.stack([one.table for one in results])
    unfused, steps = walk(task, SEEDS, fused=False)
    assert seen.tobytes() == unfused.tobytes()
    assert tables.tobytes() == np.stack([one.table for one in steps]).tobytes()
    for run, seed in enumerate(SEEDS):
        alone, steps = walk(task, [seed])
        assert alone[:, 0].tobytes() == seen[:, run].tobytes()
        assert np.stack([one.table for one in steps])[:, :, 0].tobytes() == tables[:, :, run].tobytes()


def test_seasons_are_priced_alike_whoever_asks_first(task: TaskSpec) -> None:
    other = task.replace({"description": "another pool"})
    assert WeatherPool.of(other) is not WeatherPool.of(task)
    together = season_prices(task, SEEDS)
    for run, seed in reversed(list(enumerate(SEEDS))):
        assert (season_prices(other, [seed])[0] == together[run]).all()


def test_prices_by_the_hour_need_steps_that_divide_it(task: TaskSpec) -> None:
    odd = task.replace({"weather.step_seconds": 2400, "observation.modules": ["prices", "day_ahead_prices"], "observation.forecast": None})
    words = "[price_tables.power] is hourly; step_seconds = 2400 does not divide an hour. Use 900."
    with pytest.raises(TaskError, match=re.escape(words)):
        WeatherPool.of(odd)


def with_limit(task: TaskSpec, amount: float) -> TaskSpec:
    beyond: dict[str, Any] = {"value": amount, "unit": "kg m-2"}
    return task.replace({"ledger.cost_co2.beyond.amount": beyond})


@pytest.mark.parametrize("fused", [True, False])
def test_the_costs_of_all_steps_are_those_of_the_total(task: TaskSpec, fused: bool) -> None:
    _, results = walk(task, SEEDS, fused=fused)
    total = np.sum([one.quantities["co2_dosed"] for one in results], axis=0)
    cheap = np.sum([one.quantities["cost_co2"] for one in results], axis=0)
    assert cheap == pytest.approx(0.08 * total)
    assert (total > 0.01).all()
    limit = 0.4001 * float(total[0])  # within a step
    _, dear = walk(with_limit(task, limit), SEEDS, fused=fused)
    costs = np.stack([one.quantities["cost_co2"] for one in dear])
    assert costs.sum(axis=0) == pytest.approx(0.08 * limit + 0.20 * (total - limit), rel=1e-9)
    amounts = np.stack([one.quantities["co2_dosed"] for one in dear])
    rates = costs / amounts
    assert rates[0] == pytest.approx(0.08)
    assert rates[-1] == pytest.approx(0.20)
    between = (rates > 0.0801) & (rates < 0.1999)
    assert between[:, 0].sum() == 1  # the step in which the price changes
    profit = np.stack([one.quantities["epi"] for one in dear]) - np.stack([one.quantities["epi"] for one in results])
    assert profit.sum(axis=0) == pytest.approx(-0.12 * (total - limit), rel=1e-6)


def test_the_step_of_the_price_is_told(task: TaskSpec) -> None:
    line = next(words for words in task.ledger.lines() if "cost_co2" in words)
    assert "x 0.08 EUR kg-1, 0.2 EUR kg-1 beyond 12 kg m-2" in line
