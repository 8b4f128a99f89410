"""Plans and predictions take a schedule as it is: nothing moves a scheduled control but the calendar."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents.baselines import read_baseline
from glbench.agents.predictive import PredictiveAgent, PredictiveSettings, TrueStateController
from glbench.control import (
    Climatology,
    Outlook,
    PredictiveController,
    Scenario,
    StageReward,
    StateEstimator,
    feasible,
    plan_season,
    with_schedule,
)  # fmt: skip
from glbench.control.season import money_in_reward
from glbench.control.trust_region import radius_shares
from glbench.env import Simulation
from glbench.errors import ShapeError
from glbench.kernel import Kernel
from glbench.tasks import TaskSpec, get_task, task_card

Floats = NDArray[np.float64]

SEEDS = [10_000_000_007, 10_000_000_011]
VENTS = 3
START = [0.2, 0.1, 0.5, 0.05, 0.0, 0.0]


@cache
def scheduled(base: str = "Spring-v1", days: int = 2, seconds: int = 1800) -> TaskSpec:
    """Vents that the calendar opens wide for a while: what a planner would not do."""
    task = get_task(base)
    controls = [name for name in task.actuation.controls if name != "uVent"]
    entries = [
        {"control": "uVent", "value": 0.05},
        {"control": "uVent", "value": 0.6, "hours": [6.0, 7.0]},
        {"control": "uVent", "value": 1.0, "weekdays": ["monday", "wednesday", "friday", "saturday"], "hours": [9.0, 11.0]},
        {"control": "uVent", "value": 0.3, "after_day": 1, "hours": [16.0, 18.0]},
    ]
    weather = {"days": days, "step_seconds": seconds}
    return task.replace({"schema": 2, "id": "test/Vents-v1", "actuation.controls": controls, "weather": weather, "schedule": entries})


def in_force(task: TaskSpec, seeds: list[int]) -> Floats:
    """The vents in every step of the simulation ``(T, n)``."""
    simulation, vents = Simulation(task, len(seeds), "fast"), []
    simulation.reset(seeds)
    for _ in range(task.steps):
        simulation.step(np.zeros((len(seeds), len(task.actions))))
        vents.append(simulation.u[:, VENTS])
    return np.array(vents)


def test_a_scenario_has_the_schedule_of_its_run() -> None:
    task = scheduled()
    vents = in_force(task, SEEDS)
    for seed, column in zip(SEEDS, vents.T, strict=True):
        scenario = Scenario.of(task, seed)
        assert scenario.calendar.shape == (task.steps + 1, 2 + len(task.price_tables) + 1)
        assert scenario.calendar[:-1, -1].tobytes() == np.ascontiguousarray(column).tobytes()
        assert scenario.high.tolist() == [1.0, 1.0, 1.0, 0.0, 1.0, 1.0]
        controls = with_schedule(task, np.full((task.steps, 6), 0.5), scenario.calendar)
        assert controls[:, VENTS].tobytes() == np.ascontiguousarray(column).tobytes()
        assert (np.delete(controls, VENTS, axis=1) == 0.5).all()
    assert {0.05, 0.3, 0.6} <= set(vents.ravel().tolist())


def test_a_plan_improves_the_others_and_leaves_the_schedule() -> None:
    task = scheduled()
    scenario = Scenario.of(task, SEEDS[0])
    start = np.tile(START, (task.steps, 1))
    begun, plan = (plan_season(scenario, start, iterations=count) for count in (0, 4))
    assert plan.reward > begun.reward + 0.1 * abs(begun.reward)
    assert plan.controls[:, VENTS].tobytes() == scenario.calendar[:-1, -1].tobytes() == begun.controls[:, VENTS].tobytes()
    others = np.diff(np.vstack([scenario.u_before, plan.controls]), axis=0)[:, [0, 1, 2, 4, 5]]
    assert np.abs(others).max() <= scenario.max_change + 1e-12
    simulation = Simulation(task, 1, "fast")
    simulation.reset([SEEDS[0]])
    rewards = [float(simulation.step(action[None]).rewards[0]) for action in plan.actions()]
    np.testing.assert_allclose(simulation.u[0], plan.controls[-1], atol=1e-9)
    assert sum(rewards) == pytest.approx(plan.reward, abs=1e-6)


def test_what_cannot_move_does_not_scale_the_gradient_of_what_can() -> None:
    task = scheduled()
    scenario = Scenario.of(task, SEEDS[0])
    kernel = Kernel(task.model_value, task.step_seconds, preset="fast")
    controls = with_schedule(task, feasible(np.tile(START, (24, 1)), scenario.u_before, scenario.high, 0.1), scenario.calendar[:25])
    along = kernel.linearise_trajectory(scenario.x0, controls, scenario.d[:24], scenario.p)
    shares = radius_shares(StageReward(task), along)
    assert (shares[:, VENTS] == 0.0).all()
    assert (np.delete(shares, VENTS, axis=1) > 0.0).all()


def test_predictive_control_plans_around_the_schedule_ahead() -> None:
    task = scheduled()
    vents, scenarios = in_force(task, SEEDS), [Scenario.of(task, seed) for seed in SEEDS]
    controller, simulation = PredictiveController(task, horizon=16, first_iterations=3), Simulation(task, 2)
    controller.reset(2)
    simulation.reset(SEEDS)
    for k in range(12):
        d, calendar = (np.stack(rows) for rows in zip(*((s.d[k : k + 16], s.calendar[k : k + 17]) for s in scenarios), strict=True))
        wanted = controller.decide(simulation.x, simulation.u, d, np.stack([s.p for s in scenarios]), calendar)
        assert wanted[:, VENTS].tolist() == vents[k].tolist()
        assert controller.plan[..., VENTS].tolist() == vents[k + 1 : k + 16].T.tolist()
        simulation.step_controls(wanted)
        assert simulation.u[:, VENTS].tolist() == vents[k].tolist()
    with pytest.raises(ShapeError, match=r"The calendar of test/Vents-v1 has 3 columns; got 2"):
        controller.decide(simulation.x, simulation.u, d, np.stack([s.p for s in scenarios]), calendar[..., :2])


def test_the_outlook_learns_the_weekdays_of_another_year_from_what_is_shown() -> None:
    """The file names the dates of 2010, and two of three runs are in years whose weekdays are others: within a week all are known."""
    task = scheduled("Schiphol2010-Delta00-v1", 9, 3600).replace({"scenario.years": [2009, 2010, 2011]})
    seeds = list(range(8))
    years = [Scenario.of(task, seed) for seed in seeds]
    outlook, simulation = Outlook(task, Climatology.of(task)), Simulation(task, len(seeds), "fast")
    outlook.reset(len(seeds))
    outlook.update(simulation.reset(seeds))
    assert {int(moment.astype("datetime64[Y]").astype(int)) + 1970 for moment in simulation.time} == {2009, 2010, 2011}
    wrong = []
    for k in range(task.steps - 24):
        expected = np.stack([one.calendar[k : k + 25] for one in years])
        wrong.append((outlook.ahead(24).calendar[..., -1] != expected[..., -1]).any(axis=1))
        outlook.update(simulation.step(np.zeros((len(seeds), len(task.actions)))).observations)
    assert np.array(wrong)[: 7 * 24].any()
    assert not np.array(wrong)[7 * 24 :].any()


def test_the_estimator_takes_scheduled_controls_from_the_calendar_where_they_are_not_shown() -> None:
    task = scheduled()
    hidden = task.replace({"observation.modules": [one for one in task.observation.modules if one != "controls"]})
    climate = Climatology.of(task)
    errors = []
    for one in (task, hidden):
        simulation, outlook, estimator = Simulation(one, 2, "fast"), Outlook(one, climate), StateEstimator(one)
        outlook.reset(2)
        estimator.reset(2)
        seen, controls = simulation.reset(SEEDS), None
        for _ in range(40):
            outlook.update(seen)
            states = estimator.update(seen, outlook.past, None if one is task else controls)
            others = np.zeros((2, 1, 6))
            controls = with_schedule(one, others, outlook.ahead(1).calendar)[:, 0]
            seen = simulation.step(-np.ones((2, len(one.actions)))).observations
            assert controls.tolist() == simulation.u.tolist()
        errors.append(states)
    np.testing.assert_allclose(errors[1], errors[0], rtol=1e-5)


@pytest.mark.parametrize("name", ["mpc", "mpc_true_state"])
def test_the_baselines_of_predictive_control_know_what_the_calendar_moves(name: str) -> None:
    task = scheduled("Spring-v1", 2, 900)
    found = read_baseline(name).settings
    assert isinstance(found, PredictiveSettings)
    settings = found.model_copy(update={"horizon_hours": 3.0, "first_iterations": 1})
    simulation = Simulation(task, 2, "fast")
    seen = simulation.reset(SEEDS)
    agent = PredictiveAgent(settings) if name == "mpc" else TrueStateController(settings)
    agent.reset(*((task_card(task), 2) if name == "mpc" else (task, SEEDS)))  # type: ignore[arg-type]
    for _ in range(30):
        actions = agent.act(seen if name == "mpc" else simulation.x)  # type: ignore[arg-type]
        seen = simulation.step(actions).observations
        np.testing.assert_allclose(agent._steering.controls, simulation.u, atol=1e-6)
    assert len(set(simulation.u[:, VENTS])) == 1


def test_money_counts_in_full_where_prices_change_and_controls_are_scheduled() -> None:
    """Its calendar has prices and scheduled controls."""
    assert money_in_reward(get_task("WinterLED-v2")) == 1.0
