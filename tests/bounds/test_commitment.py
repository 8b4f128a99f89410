"""Unit commitment: ways to run boiler and engine keep the task's rules, give what is asked for, and cost little more than the least."""

from __future__ import annotations

import os
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize
from scipy.optimize import linprog

from glbench.bounds.commitment import commit, redispatched
from glbench.bounds.dispatch import FINE, MJ_PER_KWH, VARIABLES, Dispatch, EnergyDemand, dispatch, programme
from glbench.bounds.energy_costs import costs
from glbench.control import Scenario, plan_season
from glbench.env import Simulation
from glbench.model.equipment import Equipment
from glbench.tasks import TaskSpec, get_task
from tests.control.test_machines import ENGINE, TASK, broken
from tests.energy import energy_task

PLAIN = Equipment(boiler=130.0, engine=50.0, eta_boiler=0.95, eta_engine=0.4, eta_engine_heat=0.5, buffer=3.3, tau=20.0, co2_of_gas=0.2)
QUARTER = 900.0
Floats = NDArray[np.float64]


def asked_for(steps: int, seed: int, *, starts: float = 0.0) -> EnergyDemand:
    """Heat, electricity and CO2 at random, in quarters of an hour, at prices that change by the hour; ``starts`` is a start's price."""
    rng = np.random.default_rng(seed)
    hours = -(-steps // 4)

    def by_hour(low: float, high: float) -> Floats:
        return np.repeat(rng.uniform(low, high, hours), 4)[:steps]

    sold, used, zero = by_hour(-0.02, 0.2), by_hour(0.0, 0.006) * (by_hour(0.0, 1.0) > 0.5), np.zeros(steps)
    flows = {
        "heat_to_pipes": 3.6e6 * by_hour(0.0, 0.015),
        "co2_dosed": by_hour(0.0, 0.004) * (by_hour(0.0, 1.0) > 0.5),
        "electricity": used,
        "electricity_made": zero,
        "electricity_bought": used,
        "electricity_sold": zero,
    }
    prices = {
        "gas": zero + 0.04,
        "electricity_bought": sold + 0.03,
        "electricity_sold": -sold,
        "co2_bought": zero + 0.2,
        "engine_hours": zero + 0.0003,
        "engine_starts": zero + starts,
    }
    return EnergyDemand(QUARTER, dict.fromkeys(prices, zero) | flows, prices, 1.6, 1.0)


def loads_of(way: Dispatch, flow: str, power: float) -> Floats:
    """Loads of a machine of so much power [W m-2]."""
    loads: Floats = way.flows[flow] * 1000.0 / (power * QUARTER / 3600.0)
    return np.where(loads > 1e-6, loads, 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_a_way_keeps_the_rules_gives_what_is_asked_for_and_costs_at_least_the_least(seed: int) -> None:
    asked, task = asked_for(230, seed), get_task(TASK)
    way, least = commit(PLAIN, asked, task), dispatch(PLAIN, asked)
    assert way is not None
    assert least is not None
    assert least.cost(asked.prices) - 1e-9 <= way.cost(asked.prices) < least.cost(asked.prices) + 0.04
    engine, boiler = loads_of(way, "electricity_made", PLAIN.engine), loads_of(way, "heat", PLAIN.boiler)
    assert broken(engine) == []
    assert 0.1 < (engine > 0.0).mean() < 1.0
    np.testing.assert_array_equal(way.flows["engine_hours"], 0.25 * (engine > 0.0))
    assert np.abs(np.diff(boiler, prepend=0.0)).max() < task.actuation.max_change + 1e-6
    made = way.flows["electricity_made"] + way.flows["electricity_bought"] - way.flows["electricity_sold"]
    np.testing.assert_allclose(made, asked.electricity, atol=1e-9)
    assert (way.flows["co2_made"] + way.flows["co2_bought"] >= asked.flows["co2_dosed"] - 1e-9).all()
    into = (way.flows["heat"] + way.flows["engine_heat"] - way.flows["heat_dumped"] / 3.6e6 - asked.heat) * MJ_PER_KWH
    np.testing.assert_allclose(np.diff(way.stored, prepend=asked.start), into - way.stored / (20.0 * 96), atol=2e-3)


def brute_force(asked: EnergyDemand, task: TaskSpec, hold: int, lowest: float) -> float:
    """The least cost of all series of off and on that keep the hold time, each by linear programming; loads may jump."""
    steps, found = len(asked.heat), []
    hours, most = QUARTER / 3600.0, PLAIN.engine * QUARTER / 3600.0 / 1000.0
    for on in product([False, True], repeat=steps):
        if broken(np.array(on, dtype=np.float64) * lowest):
            continue
        linear, runs = programme(PLAIN, asked), np.array(on)
        place = VARIABLES.index("engine")
        linear["bounds"].reshape(len(VARIABLES), steps, 2)[place] = FINE * most * runs[:, None] * [lowest, 1.0]
        linear["c"].reshape(len(VARIABLES), steps)[place] -= asked.prices["engine_hours"] * 1000.0 / PLAIN.engine
        solution = linprog(**linear)
        if solution.status == 0:
            starts = runs & ~np.concatenate([[False], runs[:-1]])
            fixed = hours * asked.prices["engine_hours"] @ runs + asked.prices["engine_starts"] @ starts
            found.append(solution.fun / FINE + fixed)
    return float(min(found)) + asked.worth(PLAIN) * (asked.start - asked.end) / MJ_PER_KWH


@pytest.mark.parametrize(("seed", "starts"), [(0, 0.0), (1, 0.0), (2, 0.002), (3, 0.002)])
def test_three_hours_cost_what_trying_every_series_finds(seed: int, starts: float) -> None:
    # Its loads may jump from 0 to 1: what is left of the rules are hold time, lowest load and starts.
    task, asked = energy_task(), replace(asked_for(12, seed, starts=starts), end=0.5)
    way, best = commit(PLAIN, asked, task), brute_force(asked, task, 4, 0.7)
    assert way is not None
    assert way.cost(asked.prices) == pytest.approx(best, abs=2e-5)


def test_an_engine_that_ran_before_midnight_keeps_its_hours_off() -> None:
    """Making power is expensive for an hour after midnight: an engine that stops then must stay off for its minimum time."""
    task = energy_task({"actuation.on_off.uChp.hold_minutes": 120})
    for seed in (0, 1, 2, 3):
        asked, rng = asked_for(288, seed), np.random.default_rng(seed)
        sold = np.repeat(rng.uniform(0.02, 0.2, 72), 4)
        sold[96:100] = -0.2
        prices = {**asked.prices, "electricity_bought": sold + 0.03, "electricity_sold": -sold}
        way = commit(PLAIN, replace(asked, prices=prices), task)
        assert way is not None
        runs = np.flatnonzero(np.diff(loads_of(way, "electricity_made", PLAIN.engine) > 0.0))
        assert np.diff(runs).min() >= 8


def test_what_the_solver_prints_from_c_is_not_seen(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
    solve = optimize.milp

    def chatty(*arguments: Any, **options: Any) -> Any:
        os.write(1, b"HighsMipSolverData")
        return solve(*arguments, **options)

    monkeypatch.setattr(optimize, "milp", chatty)
    assert commit(PLAIN, asked_for(12, 0), get_task(TASK)) is not None
    os.write(1, b"after")
    assert capfd.readouterr().out == "after"


def test_what_the_equipment_cannot_give_has_no_way_and_other_tasks_have_none() -> None:
    asked = asked_for(100, 0)
    flows = {**asked.flows, "heat_to_pipes": asked.flows["heat_to_pipes"] + 3.6e6}
    assert commit(PLAIN, replace(asked, flows=flows), get_task(TASK)) is None
    assert [commit(PLAIN, asked, get_task(name)) for name in ("WinterLED-v1", "Spring-v1")] == [None, None]
    assert costs(PLAIN, asked, task=get_task("Spring-v1")).ruled is None
    found = costs(PLAIN, asked, task=get_task(TASK))
    assert found.ruled is not None
    assert found.least is not None
    assert found.ruled > found.least


def test_a_plan_that_is_dispatched_earns_more_and_comes_about() -> None:
    task = get_task(TASK).replace({"id": "my/Energy-v1", "weather.days": 4}).in_split("validation")
    scenario, start = Scenario.of(task, 10000), np.zeros((task.steps, 8))
    plain, better = (plan_season(scenario, start, iterations=9, dispatch=way) for way in (None, redispatched))
    assert better.reward > plain.reward + 0.005  # EUR m-2
    assert broken(better.controls[:, ENGINE]) == []
    first, second = redispatched(better), redispatched(better)
    assert first is not None
    np.testing.assert_array_equal(first, second)
    assert plan_season(scenario, start, iterations=9, dispatch=lambda plan: None).reward < better.reward
    simulation, controls = Simulation(task, 1), []
    simulation.reset([10000])
    for action in better.actions():
        simulation.step(action[None])
        controls.append(simulation.u[0].copy())
    np.testing.assert_allclose(np.array(controls), better.controls, atol=1e-9)
