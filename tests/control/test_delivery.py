"""Plans through actuators that are not ideal: the linear map, its transpose, gradients, and plans that are found and replayed."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents.plans import PlanBook
from glbench.bounds.search import group_by_conditions, replay_plans
from glbench.control import Scenario, SeasonPlan, StageReward, StateEstimator, feasible, plan_season
from glbench.control.delivery import Delivery, ExpectedDelivery
from glbench.control.trust_region import trust_region_step
from glbench.env import Simulation
from glbench.env.program import info_columns
from glbench.kernel import Kernel
from glbench.tasks import TaskSpec, get_task
from tests.env.stepping import StillKernel

Floats = NDArray[np.float64]

SEED = 10_000_000_003
OFTEN = {"days_between": 0.4, "hours": 3.0}
ACTUATORS = {
    "uVent": {"lag_minutes": 20.0, "sticks": OFTEN, "wind": {
        "above": {"value": 2.0, "unit": "m s-1"}, "full": {"value": 8.0, "unit": "m s-1"}, "share": 0.3}},
    "uBoil": {"lag_minutes": 10.0, "fails": OFTEN},
    "uCo2": {"sticks": OFTEN, "fails": OFTEN},
    "uThScr": {"shortfall": 0.3},
}  # fmt: skip
START = [0.3, 0.3, 0.5, 0.1, 0.1, 0.0]


def with_actuators(actuators: dict[str, object]) -> TaskSpec:
    return get_task("Spring-v1").replace({"id": "tests/Actuators-v1", "weather.days": 2, "actuators": actuators})


@pytest.fixture(scope="module")
def task() -> TaskSpec:
    return with_actuators(ACTUATORS)


@pytest.fixture(scope="module")
def scenario(task: TaskSpec) -> Scenario:
    return Scenario.of(task, SEED)


def commands_of(scenario: Scenario, seed: int) -> Floats:
    drawn = np.random.default_rng(seed).uniform(-0.5, 1.5, (scenario.task.steps, 6))
    return feasible(drawn, scenario.u_before, scenario.high, scenario.max_change)


def test_the_map_gives_what_the_simulation_delivers(task: TaskSpec) -> None:
    for seed in (SEED, SEED + 1):
        scenario = Scenario.of(task, seed)
        commands, simulation = commands_of(scenario, 1), Simulation(task, 1, "fast")
        simulation.reset([seed])
        delivered = []
        for command in commands:
            simulation.step_controls(command[None])
            delivered.append(simulation.u[0])
        np.testing.assert_allclose(scenario.delivered(commands), delivered, atol=1e-14)
        batch = scenario.delivered(np.stack([np.zeros_like(commands), commands]))
        assert batch[1].tobytes() == scenario.delivered(commands).tobytes()
    assert np.abs(np.array(delivered) - commands).max(axis=0)[:4].min() > 0.05


def test_derivatives_come_back_through_the_transposed_map(scenario: Scenario) -> None:
    assert scenario.delivery is not None
    generator = np.random.default_rng(2)
    move, slopes = generator.normal(size=(2, scenario.task.steps, 6))
    there, back = (scenario.delivery(move) * slopes).sum(), (move * scenario.delivery.pull(slopes)).sum()
    assert there == pytest.approx(back, rel=1e-12)


def test_the_gradient_of_a_plan_is_that_of_finite_differences(task: TaskSpec, scenario: Scenario) -> None:
    stage, kernel = StageReward(task, smoothing=0.1), Kernel(task.model_value, task.step_seconds, preset="reference")
    commands = np.clip(commands_of(scenario, 3), 0.05, 0.9) * scenario.high
    assert scenario.delivery is not None

    def earned(told: Floats) -> float:
        controls = scenario.delivered(told)
        states = kernel.rollout(scenario.x0[None], controls[None], scenario.d, scenario.p)[0]
        return float(stage(states, controls, scenario.calendar).reward.sum())

    controls = scenario.delivered(commands)
    along = kernel.linearise_trajectory(scenario.x0, controls, scenario.d, scenario.p)
    _, slopes = stage.gradient(along.x, controls, scenario.calendar)
    gradient = scenario.delivery.pull(slopes.controls + along.pull(slopes.states).u)
    for number in range(4):
        direction = np.random.default_rng(number).normal(size=commands.shape) * scenario.high
        differences = (earned(commands + 1e-4 * direction) - earned(commands - 1e-4 * direction)) / 2e-4
        assert (gradient * direction).sum() == pytest.approx(differences, rel=2e-2, abs=2e-3)
    assert scenario.delivery.gain[:, 0].min() == 0.0
    assert (gradient[scenario.delivery.gain == 0.0] == 0.0).all()


def test_a_plan_earns_what_its_replay_does_and_more_than_one_that_ignores_the_actuators(task: TaskSpec, scenario: Scenario) -> None:
    start = np.tile(START, (task.steps, 1))
    plan, ignoring = plan_season(scenario, start, iterations=6), plan_season(Scenario.of(ideal(task), SEED), start, iterations=6)
    moves = np.diff(np.vstack([scenario.u_before, plan.commands]), axis=0)
    assert np.abs(moves).max() <= scenario.max_change + 1e-9
    assert plan.controls.tobytes() == scenario.delivered(plan.commands).tobytes()
    begun = plan_season(scenario, start, iterations=0)
    assert plan.reward > begun.reward + 0.5
    values = {}
    for name, one in (("plan", plan), ("ignoring", ignoring)):
        book = PlanBook.of(task, (SEED,), one.actions(), {})
        values[name] = replay_plans(task, book, [SEED])[SEED].reward
    assert values["plan"] == pytest.approx(plan.reward, abs=0.05)
    assert values["plan"] > values["ignoring"]


def ideal(task: TaskSpec) -> TaskSpec:
    return task.replace({"id": "tests/Ideal-v1"}, actuators=None)


def test_plans_of_ideal_actuators_have_no_map(task: TaskSpec) -> None:
    plain = Scenario.of(ideal(task), SEED)
    plan = plan_season(plain, np.tile(START, (task.steps, 1)), iterations=1)
    assert plain.delivery is None
    assert isinstance(plan, SeasonPlan)
    assert plan.controls is plan.commands or plan.controls.tobytes() == plan.commands.tobytes()


def test_an_actuator_that_was_far_off_is_expected_to_hang_and_to_be_repaired_in_time() -> None:
    delivered, commands = np.array([[0.0, 0.5, 0.30]]), np.array([[0.6, 0.5, 0.35]])
    ahead = Delivery.ahead(delivered, commands, 0.9 ** np.arange(1.0, 4.0)[:, None] * np.ones(3))
    chance = 0.36 / (0.36 + 0.0225)
    assert ahead.gain[0, :, 0].tolist() == pytest.approx([1.0 - chance * 0.9**k for k in (1, 2, 3)])
    told = np.full((1, 3, 3), 0.8)
    expected = (ahead(told) + ahead.rest)[0]
    assert expected[0].tolist() == pytest.approx([0.8 * (1.0 - 0.9 * chance), 0.8, 0.8 - 0.5 * 0.9 * 0.1])
    assert expected[2, 0] > expected[0, 0]
    two = Delivery.ahead(np.vstack([commands, delivered]), np.vstack([commands, commands]), np.full((3, 3), 0.9))
    assert two.of_rows(np.array([0])).gain.min() == 1.0
    assert two.of_rows(np.array([1])).gain.min() < 0.2


def test_only_actuators_that_are_not_ideal_are_expected_to_hang(task: TaskSpec) -> None:
    assert StateEstimator(ideal(task)).delivery(4) is None
    estimator = StateEstimator(task)
    ahead = estimator.delivery(4)
    assert ahead is not None
    assert ahead.gain.shape == (1, 4, len(task.model_value.controls))
    assert ahead.gain.min() == 1.0
    assert np.abs(ahead.rest).max() == 0.0


def test_runs_with_other_faults_are_planned_by_themselves(task: TaskSpec) -> None:
    nothing_drawn = task.replace({"id": "tests/Alike-v1"}, actuators=None)
    seasons = nothing_drawn.in_split("training").scenario.generated
    assert seasons is not None
    alike = [SEED, SEED + seasons.seasons]
    assert len(group_by_conditions(task, alike)) == 2


def test_a_trust_region_step_moves_nothing_that_is_not_delivered(task: TaskSpec, scenario: Scenario) -> None:
    kernel, stage = Kernel(task.model_value, task.step_seconds, preset="fast"), StageReward(task, smoothing=0.05)
    commands = np.tile(START, (task.steps, 1))
    along = kernel.linearise_trajectory(scenario.x0, scenario.delivered(commands), scenario.d, scenario.p)
    move = trust_region_step(
        stage, along, commands, scenario.calendar, np.full_like(commands, 0.1), lambda told: np.clip(told, 0.0, 1.0), steps=5,
        delivery=scenario.delivery,
    )  # fmt: skip
    assert scenario.delivery is not None
    assert np.abs(move[scenario.delivery.gain == 0.0]).max() == 0.0
    assert np.abs(move).max() > 0.0
    assert info_columns(task) > 0


def told_and_delivered(task: TaskSpec, seeds: list[int], commands: Floats) -> tuple[ExpectedDelivery, Floats, Floats]:
    """What was expected of ``commands`` ``(T, runs, c)``, and what the simulation delivered."""
    simulation, expected = Simulation(task, len(seeds), StillKernel()), ExpectedDelivery(task)
    simulation.reset(seeds)
    expected.reset(len(seeds))
    told, delivered = [], []
    for command in commands:
        told.append(expected(command, simulation.d))
        simulation.step_controls(command)
        delivered.append(simulation.u)
    return expected, np.array(told), np.array(delivered)


def test_what_is_expected_is_what_is_delivered_while_nothing_fails() -> None:
    sound = {"uVent": {"lag_minutes": 20.0, "wind": ACTUATORS["uVent"]["wind"]}, "uBoil": {"lag_minutes": 10.0}}
    windy = with_actuators(sound)
    commands = np.random.default_rng(1).uniform(0.0, 1.0, (windy.steps, 2, 6))
    expected, told, delivered = told_and_delivered(windy, [SEED, SEED + 1], commands)
    np.testing.assert_allclose(told, delivered, atol=1e-14)
    assert np.abs(told - commands).max(axis=(0, 1))[expected.places].min() > 0.2
    assert (expected.spread == 0.0).all()
    expected.reset(2)
    assert expected(commands[0], np.tile(Scenario.of(windy, SEED).d[0], (2, 1)))[0].tobytes() == told[0, 0].tobytes()

    _, told, _ = told_and_delivered(with_actuators({"uThScr": {"shortfall": 0.3}}), [SEED], commands[:5, :1])
    np.testing.assert_allclose(told[..., 2], 0.85 * commands[:5, :1, 2], rtol=1e-15)


def test_its_spread_is_that_of_many_runs_with_faults() -> None:
    """Commands are drawn evenly in each step, in 400 runs; faults need some hours to become as frequent as they stay."""
    actuators = {
        "uBoil": {"fails": OFTEN},
        "uCo2": {"sticks": {"days_between": 1.0, "hours": 2.0}, "fails": {"days_between": 2.0, "hours": 4.0}},
        "uThScr": {"shortfall": 0.3},
        "uVent": {"sticks": {"days_between": 0.6, "hours": 1.5}},
    }
    faulty = with_actuators(actuators)
    commands = np.random.default_rng(4).uniform(0.0, 1.0, (faulty.steps, 400, 6))
    expected, told, delivered = told_and_delivered(faulty, [SEED + run for run in range(400)], commands)
    off = (delivered - told)[60:, :, expected.places]
    assert np.sqrt(np.mean(off**2, axis=(0, 1))) == pytest.approx(expected.spread, rel=0.06)
    assert (expected.spread > 0.03).all()
    assert expected.hours == pytest.approx([3.0, 4.0, 48.0, 1.5])
