"""Least costs of an energy system: against hands, brute force and recorded runs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from glbench.bounds.dispatch import MJ_PER_KWH, Dispatch, EnergyDemand, _prices, cost, dispatch, equipment_of
from glbench.bounds.energy_costs import costs, costs_of_result, mean_costs
from glbench.episodes import Episode, replayed_episodes
from glbench.errors import EpisodeError, GlbenchError
from glbench.evaluation import evaluate, load_result
from glbench.evaluation.saving import recorded_actions, task_of_result
from glbench.model.equipment import Equipment
from glbench.tasks import PAPER_TASK, TaskSpec, get_task
from tests.cli.conftest import glbench
from tests.energy import dated_task, energy_task, write_rules

__all__ = ["glbench"]
PLAIN = Equipment(boiler=100.0, engine=40.0, eta_boiler=1.0, eta_engine=0.5, eta_engine_heat=0.5, buffer=0.144, tau=1e9, co2_of_gas=0.2)
"""Of an hour's heat: 100 Wh from the boiler, 40 Wh and as much electricity from 80 Wh of gas in the engine, 40 Wh in the buffer."""
HOUR = 3600.0


def asked_for(
    heat: Sequence[float],
    prices: dict[str, Sequence[float]],
    used: Sequence[float] | None = None,
    dosed: Sequence[float] | None = None,
    start: float = 0.0,
    end: float = 0.0,
) -> EnergyDemand:
    """Heat and electricity [kWh m-2] and CO2 [kg m-2] by the hour; heat in the buffer [MJ m-2]."""
    zero = np.zeros(len(heat))
    bought = zero if used is None else np.array(used)
    flows = dict.fromkeys(prices, zero) | {
        "heat_to_pipes": 3.6e6 * np.array(heat),
        "electricity": bought,
        "electricity_made": zero,
        "electricity_bought": bought,
        "electricity_sold": zero,
        "co2_dosed": zero if dosed is None else np.array(dosed),
    }
    return EnergyDemand(HOUR, flows, {name: np.array(price) for name, price in prices.items()}, start, end)


def of(equipment: Equipment, asked: EnergyDemand) -> Dispatch:
    found = dispatch(equipment, asked)
    assert found is not None
    return found


EVENING = asked_for([0.0, 0.04], {"gas": [0.04, 0.04], "electricity_sold": [-0.1, 0.0]})
"""Heat is wanted in the second hour, and power sells in the first."""


def test_the_buffer_carries_the_engine_s_heat_from_the_hour_that_pays():
    found = of(PLAIN, EVENING)
    np.testing.assert_allclose(found.flows["electricity_made"], [0.04, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.stored, [0.144, 0.0], atol=1e-9)
    assert found.cost(EVENING.prices) == pytest.approx(0.08 * 0.04 - 0.04 * 0.1)


def test_without_a_buffer_the_engine_still_sells_and_the_boiler_heats():
    found = of(replace(PLAIN, buffer=0.0), EVENING)
    np.testing.assert_allclose(found.flows["heat_dumped"], [0.04 * 3.6e6, 0.0], atol=1e-3)
    assert found.cost(EVENING.prices) == pytest.approx(0.08 * 0.04 - 0.04 * 0.1 + 0.04 * 0.04)


def test_without_an_engine_the_boiler_heats():
    assert of(replace(PLAIN, engine=0.0), EVENING).cost(EVENING.prices) == pytest.approx(0.04 * 0.04)


def test_all_costs_of_an_evening_and_what_each_thing_earns():
    found = costs(PLAIN, EVENING)
    assert found.least == pytest.approx(-0.0008)
    assert (found.without_buffer, found.without_engine, found.boiler_alone) == pytest.approx((0.0008, 0.0016, 0.0016))
    assert (found.buffer_earns, found.engine_earns) == pytest.approx((0.0016, 0.0024))


def test_who_is_blind_to_prices_makes_heat_when_it_is_wanted():
    lossy = replace(PLAIN, tau=20.0)  # what is stored is lost: at flat prices nothing speaks for the first hour
    assert costs(lossy, EVENING).blind == pytest.approx(0.0032)
    assert costs(lossy, EVENING).looking_earns == pytest.approx(0.0032 + 0.0008, abs=2e-5)


def test_heat_that_is_stored_is_lost_as_in_the_model():
    asked = asked_for([0.0, 0.0, 0.0], {"gas": [0.04] * 3}, start=0.1, end=0.1)
    found = of(replace(PLAIN, tau=1.0), asked)
    rate = (found.flows["heat"] - found.flows["heat_dumped"] / 3.6e6) * MJ_PER_KWH
    level = 0.1
    for hour in range(3):  # d e / dt = rate - e / tau, from the start to the end of an hour
        level = level * np.exp(-1 / 24) + rate[hour] * 24 * (1 - np.exp(-1 / 24))
        assert found.stored[hour] == pytest.approx(level, abs=1e-9)
    assert level == pytest.approx(0.1, abs=1e-9)


def test_flue_gas_is_dosed_first_and_the_rest_is_bought():
    # 0.02 kg are wanted in the first hour, heat in the second: gas for the heat, burnt in the first, gives 0.008 of them. To burn more
    # for the rest and let the heat off costs 0.04 / 0.2 = 0.2 EUR kg-1.
    asked = asked_for([0.0, 0.04], {"gas": [0.04] * 2, "co2_bought": [0.15] * 2}, dosed=[0.02, 0.0])
    found = of(replace(PLAIN, engine=0.0), asked)
    np.testing.assert_allclose(found.flows["co2_from_flue"], [0.008, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.flows["co2_bought"], [0.012, 0.0], atol=1e-9)
    assert found.cost(asked.prices) == pytest.approx(0.04 * 0.04 + 0.012 * 0.15)


def test_nothing_that_is_bought_is_sold_on_where_selling_pays_more():
    asked = asked_for([0.0], {"gas": [0.04], "electricity_bought": [0.1], "electricity_sold": [-0.2]}, used=[0.02])
    found = of(PLAIN, asked)
    assert found.cost(asked.prices) == pytest.approx(0.08 * 0.04 - 0.02 * 0.2)
    assert of(replace(PLAIN, engine=0.0), asked).cost(asked.prices) == pytest.approx(0.02 * 0.1)


def test_equipment_that_cannot_give_what_is_asked_for_has_no_cost():
    asked = asked_for([0.0, 0.12], {"gas": [0.04] * 2})
    assert dispatch(replace(PLAIN, engine=0.0, buffer=0.0), asked) is None
    found = costs(PLAIN, asked)
    assert found.boiler_alone is None
    assert found.least == pytest.approx(0.12 * 0.04)
    assert mean_costs([found, found]).boiler_alone is None
    assert mean_costs([found, found]).least == found.least


def test_heat_taken_from_the_buffer_counts_at_the_boiler_s_gas():
    asked = asked_for([0.02, 0.0], {"gas": [0.03, 0.05]}, start=0.072)
    found = of(PLAIN, asked)
    assert found.flows["gas"].sum() == pytest.approx(0.0, abs=1e-12)
    assert found.cost(asked.prices) == pytest.approx(0.02 * 0.04)


def brute_force(equipment: Equipment, asked: EnergyDemand, grid: float) -> float:
    """The least cost where heat of the boiler and electricity of the engine are multiples of ``grid`` [kWh m-2], tried one by one."""
    hours, heat, used, dosed = len(asked.heat), asked.heat, asked.electricity, asked.flows["co2_dosed"]
    boiler, engine = (np.arange(0.0, most / 1000 + grid / 2, grid) for most in (equipment.boiler, equipment.engine))
    choices = np.array(list(product(boiler, engine)))
    plans = np.stack(np.meshgrid(*[np.arange(len(choices))] * hours, indexing="ij")).reshape(hours, -1)
    level, total = np.full(plans.shape[1], asked.start / MJ_PER_KWH), np.zeros(plans.shape[1])
    for hour in range(hours):
        burnt, made = choices[plans[hour]].T
        gas = burnt / equipment.eta_boiler + made / equipment.eta_engine
        level = level + burnt + made * equipment.eta_engine_heat / equipment.eta_engine - heat[hour]
        total[level < -1e-12] = np.inf
        level = np.minimum(level, equipment.buffer / MJ_PER_KWH)
        amounts = {
            "gas": gas,
            "electricity_bought": np.maximum(used[hour] - made, 0),
            "electricity_sold": np.maximum(made - used[hour], 0),
            "co2_bought": np.maximum(dosed[hour] - equipment.co2_of_gas * gas, 0),
            "engine_hours": made / (equipment.engine / 1000),
        }
        total = total + sum(price[hour] * amounts[name] for name, price in asked.prices.items())
    total[level < asked.end / MJ_PER_KWH - 1e-12] = np.inf
    return float(total.min()) + asked.worth(equipment) * (asked.start - asked.end) / MJ_PER_KWH


def four_hours(seed: int, most_co2: int = 0, most_stored: int = 2) -> EnergyDemand:
    """Demands in whole parts of 20 Wh, with prices at random; selling never pays more than buying."""
    rng = np.random.default_rng(seed)
    sold = rng.uniform(-0.02, 0.15, 4)
    return asked_for(
        0.02 * rng.integers(0, 4, 4),
        {
            "gas": rng.uniform(0.02, 0.06, 4).tolist(),
            "electricity_bought": (sold + rng.uniform(0, 0.05, 4)).tolist(),
            "electricity_sold": (-sold).tolist(),
            "co2_bought": [0.3] * 4,
            "engine_hours": [0.0005] * 4,
        },
        used=0.02 * rng.integers(0, 3, 4),
        dosed=0.004 * rng.integers(0, most_co2 + 1, 4),
        start=0.072 * rng.integers(0, most_stored + 1),
        end=0.072 * rng.integers(0, most_stored + 1),
    )


@pytest.mark.parametrize("seed", range(12))
def test_four_hours_cost_what_trying_everything_finds(seed):
    # Without CO2 this is a flow through a network with whole demands: the least cost is at whole parts of 20 Wh.
    asked = four_hours(seed)
    equipment = replace(PLAIN, boiler=60.0)
    assert of(equipment, asked).cost(asked.prices) == pytest.approx(brute_force(equipment, asked, 0.02), abs=1e-10)


@pytest.mark.parametrize("seed", range(6))
def test_with_co2_trying_everything_on_a_grid_finds_nothing_cheaper(seed):
    asked = four_hours(seed, most_co2=4)
    equipment = replace(PLAIN, boiler=60.0)
    least, tried = of(equipment, asked).cost(asked.prices), brute_force(equipment, asked, 0.02)
    assert tried - 2e-3 < least <= tried + 1e-10


@pytest.mark.parametrize("seed", range(8))
def test_less_equipment_never_costs_less_nor_does_it_to_be_blind(seed):
    found = costs(replace(PLAIN, tau=5.0), four_hours(seed, most_co2=4, most_stored=0))
    assert found.least is not None
    assert found.boiler_alone is not None
    for less in (found.without_buffer, found.without_engine):
        assert less is not None
        assert found.least - 1e-9 <= less <= found.boiler_alone + 1e-9
    assert found.blind is not None
    assert found.blind >= found.least - 1e-9


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Two days of the page's rules, with two runs."""
    folder = tmp_path_factory.mktemp("energy")
    task = energy_task({"id": "test/Energy-v1", "weather.days": 2, "evaluation.runs": 2})
    for name, engine in (("stores", False), ("engine", True)):
        evaluate(task, write_rules(folder, name, stores=True, engine=engine), out=folder)
    return {name: folder / "results" / "Energy-v1" / f"{name}.json" for name in ("stores", "engine")}


ENERGY_ITEMS = ("cost_power", "cost_gas", "cost_co2", "cost_hours", "cost_starts")


@pytest.mark.parametrize("name", ["stores", "engine"])
def test_a_recorded_run_costs_what_it_paid_and_never_less_than_the_least(results, name):
    loaded = load_result(results[name])
    found = dict(costs_of_result(results[name]))
    assert list(found) == [run.seed for run in loaded.runs]
    assert (sum(loaded.values("engine_starts")) > 0) == (name == "engine")
    for seed, episode in recorded(results[name]).items():
        asked, one = EnergyDemand.of(episode, episode.task()), found[seed]
        paid = sum(episode[item].sum() for item in ENERGY_ITEMS) - episode["revenue_power"].sum()
        assert cost(asked.flows, asked.prices) == pytest.approx(paid, abs=1e-12)
        lent = (asked.start - asked.end) / MJ_PER_KWH / 0.95 * 0.0355
        assert one.run == pytest.approx(paid + lent, abs=1e-12)
        assert one.least is not None
        assert one.least < one.run
        assert one.buffer_earns is not None
        assert one.buffer_earns > 0.0
        assert one.left == pytest.approx(one.run - one.least)


def recorded(result: Path) -> dict[int, Episode]:
    loaded = load_result(result)
    task, log = task_of_result(loaded, result), recorded_actions(loaded, result)
    return {one.run.seed: one for one in replayed_episodes(task, log, range(len(log.runs)))}


def test_the_run_itself_is_a_way_to_run_the_equipment(results):
    # What the run did, put into the relaxed equations: its levels follow from its flows, its demands are met, its limits are kept.
    episode = recorded(results["engine"])[1000]
    asked, equipment = EnergyDemand.of(episode, episode.task()), equipment_of(episode.task())
    flows, hours = asked.flows, asked.seconds / HOUR
    made = flows["heat"] + flows["engine_heat"] - flows["heat_dumped"] / 3.6e6
    slow = 24 * equipment.tau / hours
    level, levels = asked.start, episode["eBuf"]
    for step in range(episode.steps):
        level = level * np.exp(-1 / slow) + MJ_PER_KWH * (made - asked.heat)[step] * slow * (1 - np.exp(-1 / slow))
        assert level == pytest.approx(levels[step], abs=2e-4)
    assert (flows["electricity_made"] <= equipment.engine * hours / 1000 + 1e-12).all()
    assert (flows["heat"] <= equipment.boiler * hours / 1000 + 1e-12).all()
    assert levels.max() < equipment.buffer
    gas = equipment.makes()["gas"]
    np.testing.assert_allclose(
        flows["gas"], flows["heat"] * gas["boiler"] + flows["electricity_made"] * gas["engine"], rtol=1e-12, atol=1e-15
    )
    co2 = equipment.makes()["co2_made"]
    np.testing.assert_allclose(
        flows["co2_dosed"] - flows["co2_bought"],
        np.minimum(flows["co2_dosed"], flows["heat"] * co2["boiler"] + flows["electricity_made"] * co2["engine"]),
        rtol=1e-12,
        atol=1e-15,
    )
    running = flows["electricity_made"] / (equipment.engine / 1000)
    assert (flows["engine_hours"] >= running - 1e-12).all()


def test_one_run_or_another_buffer_can_be_asked_for(results):
    every = dict(costs_of_result(results["engine"]))
    ((seed, one),) = costs_of_result(results["engine"], [1001])
    assert (seed, one) == (1001, every[1001])
    ((_, none),) = costs_of_result(results["engine"], [1001], buffer=0.0)
    assert none.run == one.run
    assert none.least == one.without_buffer == none.without_buffer
    with pytest.raises(GlbenchError, match=r"no run with seed 7. Its seeds: 1000, 1001"):
        next(costs_of_result(results["engine"], [7]))


def test_prices_by_day_are_those_of_the_run_s_days(tmp_path):
    evaluate(dated_task(tmp_path), write_rules(tmp_path, "engine", stores=True, engine=True), out=tmp_path)
    for episode in recorded(tmp_path / "results" / "Dated-v1" / "engine.json").values():
        prices = EnergyDemand.of(episode, episode.task()).prices
        assert prices["electricity_sold"].tolist() == [-0.05] * 96 + [-0.08] * 96


def test_other_prices_than_those_paid_are_refused(results):
    episode = recorded(results["engine"])[1000]
    dear = episode.task().replace({"price_tables.power.hourly": [0.2] * 24})
    with pytest.raises(EpisodeError, match=r"paid .* EUR m-2 for its energy and CO2; at the prices"):
        EnergyDemand.of(episode, dear)


def test_a_ledger_that_prices_no_energy_has_no_cost_to_compare(results):
    episode = recorded(results["engine"])[1000]
    free = replace_ledger(episode.task())
    with pytest.raises(GlbenchError, match=r"prices neither energy nor CO2"):
        EnergyDemand.of(episode, free)


def replace_ledger(task: TaskSpec) -> TaskSpec:
    """The task with fruit alone in its ledger."""
    gone = [item.name for item in task.ledger.items if item.name != "revenue"]
    return task.replace({f"ledger.{name}": None for name in gone})


def test_failed_runs_are_left_out_and_named(glbench, tmp_path):
    task = energy_task({"id": "test/Energy-v1", "evaluation.runs": 2})
    (tmp_path / "fails.py").write_text(FAILS, encoding="utf-8")
    evaluate(task, tmp_path / "fails.py", out=tmp_path)
    path = tmp_path / "results" / "Energy-v1" / "fails.json"
    answer = glbench("episodes", "dispatch", path)
    assert answer.code == 0
    assert "Failed runs are left out: 1001." in answer.err
    assert "one run" in answer.out
    answer = glbench("episodes", "dispatch", path, "--run", "1001")
    assert answer.code == 1
    assert "there is no whole run to dispatch" in answer.err


FAILS = """
import numpy as np

class Agent:
    def reset(self, card, n_runs):
        self.step, self.actions = 0, np.zeros((n_runs, len(card.actions)))

    def act(self, observations):
        self.step += 1
        if self.step == 5:
            self.actions[1] = np.nan
        return self.actions

def make_agent(card):
    return Agent()
"""


def test_a_task_without_an_energy_system_says_so():
    with pytest.raises(GlbenchError, match=r"no boiler, engine and buffer to dispatch: its model greenlight-tomato-1.0.0"):
        equipment_of(get_task(PAPER_TASK))


def test_a_price_that_changes_beyond_an_amount_is_refused():
    item = {"side": "paid", "flow": "heat_to_pipes", "amount": "pipe_heat", "unit": "kWh m-2", "factor": 1.0 / 3.6e6, "label": "Network"}
    item |= {"price": {"value": 0.001, "unit": "EUR kWh-1"}}
    item |= {"beyond": {"amount": {"value": 0.5, "unit": "kWh m-2"}, "price": {"value": 0.01, "unit": "EUR kWh-1"}}}
    with pytest.raises(GlbenchError, match=r"The price of 'cost_pipe' of .* changes beyond an amount: no dispatch knows that"):
        _prices(energy_task({"ledger.cost_pipe": item}), np.zeros((1, 9)))


def test_the_command_shows_the_costs(results, glbench):
    answer = glbench("episodes", "dispatch", results["engine"])
    assert answer.code == 0
    (mean,) = (mean_costs([one for _, one in costs_of_result(results["engine"])]),)
    (least,) = (line for line in answer.out.splitlines() if "Least cost  " in line)
    assert f"{mean.least:.3f}" in least
    assert f"{mean.left:+.3f}" in least
    assert f"the buffer {mean.buffer_earns:.3f}" in answer.out
    assert f"Missed by the runs: {mean.left:.3f}" in answer.out
    assert "Missed by the runs" not in glbench("episodes", "dispatch", results["engine"], "--buffer", "0.1").out  # it is of other equipment
    assert glbench("episodes", "dispatch", results["engine"], "--buffer", "inf").code == 2
    plain = json.loads(glbench("episodes", "dispatch", results["engine"], "--json", "--run", "1000").out)
    ((_, one),) = costs_of_result(results["engine"], [1000])
    assert plain == {"unit": "EUR m-2", "runs": {"1000": asdict(one)}}
