"""Plans of short seasons: better than where they began, possible, and worth what they say."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.control import Iteration, Scenario, SeasonPlan, feasible, plan_season
from glbench.env import Simulation
from glbench.errors import ShapeError, TaskError
from glbench.tasks import TaskSpec, get_task

TASKS = ("Schiphol2010-Delta10-v1", "Spring-v1", "Lettuce-v1")
SEED = 10_000_000_007  # no scenario of a shipped task


def short(task_id: str) -> TaskSpec:
    """Two days of a task in steps of half an hour."""
    weather = {"days": 2, "step_seconds": 1800}
    return get_task(task_id).replace(id=f"test/{task_id}", weather=weather)


def steady(scenario: Scenario) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """A little heat and air, and the screen half closed."""
    return np.tile([0.2, 0.1, 0.5, 0.05, 0.0, 0.0], (scenario.task.steps, 1))


def planned(task_id: str, iterations: int) -> tuple[SeasonPlan, list[Iteration]]:
    scenario = Scenario.of(short(task_id), SEED)
    told: list[Iteration] = []
    return plan_season(scenario, steady(scenario), iterations=iterations, watch=told.append), told


@pytest.mark.parametrize("task_id", TASKS)
def test_a_plan_earns_more_and_the_simulation_says_so(task_id: str) -> None:
    """Of scaled rewards, which begin near 1 a step, and of money; with parameters by step, meters, and hourly prices."""
    plan, told = planned(task_id, 6)
    start, _ = planned(task_id, 0)
    assert [one.number for one in told] == [1, 2, 3, 4, 5, 6]
    assert all(one.gained >= 0.0 for one in told)
    assert plan.reward == told[-1].reward == pytest.approx(start.reward + sum(one.gained for one in told))
    lost = lost_to_limits(start)
    assert plan.reward > start.reward + 0.5 * lost > start.reward

    task, given = plan.scenario.task, plan.scenario
    moves = np.diff(np.vstack([given.u_before, plan.controls]), axis=0)
    assert np.abs(moves).max() <= given.max_change + 1e-12
    assert (plan.controls >= 0.0).all()
    assert (plan.controls <= given.high).all()
    simulation = Simulation(task, 1)
    simulation.reset([SEED])
    rewards = [simulation.step(action[None]).rewards[0] for action in plan.actions()]
    assert sum(rewards) == pytest.approx(plan.reward, abs=2e-3 * max(1.0, abs(plan.reward)))


def lost_to_limits(plan: SeasonPlan) -> float:
    """What violations cost a plan."""
    return float(plan.values.penalty.sum())


def test_the_same_search_gives_the_same_bits() -> None:
    first, second = (planned("Spring-v1", 2)[0] for _ in range(2))
    assert first.controls.tobytes() == second.controls.tobytes()
    assert first.states.tobytes() == second.states.tobytes()


def test_what_is_wanted_is_brought_within_reach() -> None:
    rng = np.random.default_rng(1)
    high = np.array([1.0, 1.0, 0.0])
    wanted = rng.uniform(-0.5, 1.5, (200, 3))
    found = feasible(wanted, np.array([0.3, 0.0, 0.0]), high, 0.1)
    assert np.abs(np.diff(np.vstack([[0.3, 0.0, 0.0], found]), axis=0)).max() <= 0.1 + 1e-12
    assert (found >= 0.0).all()
    assert (found <= high).all()
    assert feasible(found, np.array([0.3, 0.0, 0.0]), high, 0.1) == pytest.approx(found, abs=1e-12)


def test_a_plan_of_set_points_of_controls_is_its_controls() -> None:
    task = short("Spring-v1").replace(id="test/Direct-v1", actuation={"kind": "set_point"})
    scenario = Scenario.of(task, SEED)
    plan = plan_season(scenario, steady(scenario), iterations=0)
    assert plan.actions() == pytest.approx(plan.controls)


def test_a_process_computer_takes_no_controls() -> None:
    task = short("Spring-v1").replace(id="test/Computer-v1", actuation={"kind": "process_computer"})
    scenario = Scenario.of(task, SEED)
    with pytest.raises(TaskError, match="of the kind 'process_computer'"):
        plan_season(scenario, steady(scenario), iterations=0).actions()


@pytest.mark.parametrize(("controls", "reason"), [(np.zeros((96, 5)), r"\(96, 5\)"), (np.full((96, 6), np.nan), "finite")])
def test_controls_that_are_none_are_refused(controls: np.ndarray[tuple[int, ...], np.dtype[np.float64]], reason: str) -> None:
    with pytest.raises(ShapeError, match=reason):
        plan_season(Scenario.of(short("Spring-v1"), SEED), controls)
