"""Machines that are off or on in plans: schedules keep hold times and ramps, follow relaxed plans, and come about as planned."""

from __future__ import annotations

from itertools import groupby, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.control import PredictiveController, Scenario, actions_of, plan_season
from glbench.control.machines import Machines
from glbench.env import Simulation
from glbench.tasks import get_task

TASK = "SpringEnergy-v1"
HOLD, LOWEST, CHANGE = 4, 0.7, 0.1  # steps and loads of its engine
ENGINE = get_task(TASK).model_value.control_names.index("uChp")


def broken(loads: NDArray[np.float64], before: float = 0.0, since: int = HOLD) -> list[str]:
    """What a series of loads of the engine does that it cannot do, by a check of its own."""
    faults = []
    positions = [load if load > 0.0 else LOWEST - CHANGE for load in (before, *loads)]
    faults += [f"{here:g} to {there:g}" for here, there in pairwise(positions) if abs(there - here) > CHANGE + 1e-9]
    faults += [f"load {load:g}" for load in loads if 0.0 < load < LOWEST - 1e-9 or load > 1.0]
    periods = [(key, len([*group])) for key, group in groupby([before > 0.0, *(loads > 0.0)])]
    lengths = [length for _, length in periods]
    lengths[0] += since - 1
    faults += [f"{length} steps" for length in lengths[:-1] if length < HOLD]
    return faults


@pytest.mark.parametrize("before", [0.0, 0.7, 0.85, 1.0])
@pytest.mark.parametrize("since", [1, 2, 3, 4])
def test_schedules_keep_hold_times_and_ramps_and_follow_the_relaxed_plan(before: float, since: int) -> None:
    machines, rng = Machines(get_task(TASK), 6), np.random.default_rng(since)
    wanted = np.zeros((6, 200, 8))
    wanted[..., ENGINE] = np.clip(np.repeat(rng.random((6, 25)) * 1.4 - 0.2, 8, axis=1) + rng.normal(0.0, 0.1, (6, 200)), 0.0, 1.0)
    in_force = np.zeros((6, 8))
    in_force[:, ENGINE] = before
    schedule = machines.near(wanted, in_force, np.full((6, 1), float(since)))
    for loads_wanted in (machines.at_full_load(wanted), wanted, wanted * rng.random(wanted.shape)):
        loads = machines.within(wanted, loads_wanted, in_force, schedule)[..., ENGINE]
        assert [broken(row, before, since) for row in loads] == [[]] * 6
    full = machines.within(wanted, machines.at_full_load(wanted), in_force, schedule)[..., ENGINE]
    apart = np.abs(np.cumsum(full - wanted[..., ENGINE], axis=1)).max()
    assert apart < 2.0 * HOLD  # steps of full load, of about 100


def test_a_machine_at_full_load_all_the_time_is_scheduled_so() -> None:
    machines = Machines(get_task(TASK))
    wanted = np.ones((1, 50, 8))
    schedule = machines.near(wanted, np.zeros((1, 8)), machines.since)
    np.testing.assert_allclose(schedule.high[0, :5, 0], [0.7, 0.8, 0.9, 1.0, 1.0])
    assert (schedule.low[0, :, 0] == LOWEST).all()


def test_a_plan_for_a_season_comes_about_and_keeps_hold_times() -> None:
    task = get_task(TASK).replace({"id": "my/Energy-v1", "weather.days": 4}).in_split("validation")
    scenario = Scenario.of(task, 10000)
    start = np.zeros((task.steps, 8))
    first = plan_season(scenario, start, iterations=0)
    plan = plan_season(scenario, start, iterations=10)
    assert plan.reward > first.reward + 0.05  # EUR m-2
    assert broken(plan.controls[:, ENGINE]) == []
    assert 0.0 < (plan.controls[:, ENGINE] > 0.0).mean() < 1.0
    simulation, controls = Simulation(task, 1), []
    simulation.reset([10000])
    for action in plan.actions():
        simulation.step(action[None])
        controls.append(simulation.u[0].copy())
    np.testing.assert_allclose(np.array(controls), plan.controls, atol=1e-9)


def test_predictive_control_switches_as_the_task_lets_it() -> None:
    task = get_task(TASK).replace({"id": "my/Energy-v1", "weather.days": 3}).in_split("validation")
    scenario, controller = Scenario.of(task, 10001), PredictiveController(task, horizon=48, renew_every=8, ascent_steps=12)
    simulation, wanted = Simulation(task, 1), []
    simulation.reset([10001])
    controls = [scenario.u_before]
    for k in range(192):
        ahead = slice(k, k + 48)
        if k % 2:
            wanted.append(controller.follow()[0])
        else:
            weather, calendar = scenario.d[ahead], scenario.calendar[k : k + 49]
            wanted.append(controller.decide(simulation.x, controls[-1][None], weather, scenario.p, calendar)[0])
        simulation.step(actions_of(task, controls[-1], wanted[-1])[None])
        controls.append(simulation.u[0].copy())
    loads = np.array(controls)[1:, ENGINE]
    assert broken(loads) == []
    assert 0.1 < np.mean(loads > 0.0) < 1.0
    np.testing.assert_allclose(np.array(controls)[1:], np.array(wanted), atol=1e-9)
