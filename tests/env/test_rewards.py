"""Accounts and rewards, against hand calculations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from glbench.env import QUANTITIES, REWARDS, Accounts, Simulation, StepOutcome, make_accounts, register_reward
from glbench.env.accounts import QUANTITY_NAMES
from glbench.env.rewards import make_reward
from glbench.errors import TaskError, UnknownNameError
from glbench.model import STATE_NAMES, relative_humidity
from glbench.tasks import TaskSpec, get_task
from tests.env.stepping import StillKernel

MakeTask = Callable[..., TaskSpec]
COMFORT = (20.0, 800.0, 70.0)


@pytest.fixture(scope="module")
def task() -> TaskSpec:
    return get_task("Schiphol2010-Delta00-v1")


@pytest.fixture(scope="module")
def accounts(task: TaskSpec) -> Accounts:
    return make_accounts(task)


def outcome(accounts: Accounts, growth: float, controls: list[float], air: tuple[float, float, float]) -> StepOutcome:
    """A step of one row: fruit grows by ``growth`` mg m-2, controls in the model's order, climate at its end."""
    before = np.zeros((1, 28))
    after = before.copy()
    before[0, 25], after[0, 25] = 55338.0, 55338.0 + growth
    u, climate = np.array([controls]), np.array(air).reshape(3, 1)
    return StepOutcome(accounts.quantities(before, after, u, climate), before, after, u, climate, accounts.names)


def test_the_worked_example_of_the_benchmark(task: TaskSpec, accounts: Accounts) -> None:
    step = outcome(accounts, 180.0, [0.5, 0.2, 0.3, 0.4, 1.0, 0.6], (14.0, 1700.0, 91.0))
    # gain 1.6 * 180e-6/0.065; boiler 0.5*130 W, lamps 116 W, CO2 0.2*5 mg m-2 s-1, each for 900 s.
    assert step["revenue"][0] == pytest.approx(0.00443077, abs=5e-9)
    assert step["cost_heat"][0] == pytest.approx(0.0014625, rel=1e-12)
    assert step["cost_electricity"][0] == pytest.approx(0.0087, rel=1e-12)
    assert step["cost_co2"][0] == pytest.approx(0.00027, rel=1e-12)
    assert step["epi"][0] == pytest.approx(-0.00600173, abs=5e-9)
    assert step["penalty"][0] == pytest.approx(1 / 15 + 100 / 2500 + 6 / 15, rel=1e-12)
    assert REWARDS["scaled_epi"](task, accounts)(step)[0] == pytest.approx(0.34450424, abs=5e-9)
    assert make_reward(task, accounts)(step)[0] == pytest.approx(-0.16216243, abs=5e-9)


def test_the_amounts_behind_the_costs(accounts: Accounts) -> None:
    step = outcome(accounts, 180.0, [0.5, 0.2, 0.0, 0.0, 1.0, 0.0], COMFORT)
    assert step["heat"][0] == pytest.approx(0.5 * 130 * 900 / 3.6e6, rel=1e-12)  # kWh m-2
    assert step["electricity"][0] == pytest.approx(116 * 900 / 3.6e6, rel=1e-12)
    assert step["co2_dosed"][0] == pytest.approx(0.2 * 5.0 * 900 * 1e-6, rel=1e-12)  # kg m-2
    assert step["fruit_fresh"][0] == pytest.approx(180e-6 / 0.065, rel=1e-9)


def test_the_bounds_of_the_epi(accounts: Accounts) -> None:
    assert accounts.lowest_epi == pytest.approx(-(0.002925 + 0.0087 + 0.00135), rel=1e-12)
    assert accounts.highest_epi == pytest.approx(0.00726646, abs=5e-9)


def test_doing_nothing_in_a_comfortable_house_gives_0641(task: TaskSpec, accounts: Accounts) -> None:
    step = outcome(accounts, 0.0, [0.0] * 6, COMFORT)
    assert make_reward(task, accounts)(step)[0] == pytest.approx(0.6410, abs=5e-5)


def test_full_use_without_growth_gives_0(task: TaskSpec, accounts: Accounts) -> None:
    step = outcome(accounts, 0.0, [1.0] * 6, COMFORT)
    assert make_reward(task, accounts)(step)[0] == pytest.approx(0.0, abs=1e-15)


def test_screens_and_vents_are_free(accounts: Accounts) -> None:
    assert outcome(accounts, 0.0, [0.0, 0.0, 1.0, 1.0, 0.0, 1.0], COMFORT)["epi"][0] == 0.0


def test_nothing_is_clipped(task: TaskSpec, accounts: Accounts) -> None:
    fast = outcome(accounts, 1000.0, [0.0] * 6, COMFORT)
    assert make_reward(task, accounts)(fast)[0] > 1.0
    awful = outcome(accounts, 0.0, [0.0] * 6, (64.0, 20000.0, 100.0))
    assert awful["penalty"][0] == pytest.approx(30 / 15 + 18400 / 2500 + 1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("air", "name", "distance"),
    [
        ((12.5, 800.0, 70.0), "air_temperature_low", 2.5),
        ((36.0, 800.0, 70.0), "air_temperature_high", 2.0),
        ((20.0, 290.0, 70.0), "co2_low", 10.0),
        ((20.0, 1650.0, 70.0), "co2_high", 50.0),
        ((20.0, 800.0, 45.0), "relative_humidity_low", 5.0),
        ((20.0, 800.0, 88.5), "relative_humidity_high", 3.5),
    ],
)
def test_a_violation_is_measured_at_its_own_limit_only(
    accounts: Accounts, air: tuple[float, float, float], name: str, distance: float
) -> None:
    step = outcome(accounts, 0.0, [0.0] * 6, air)
    for quantity in QUANTITY_NAMES:
        if quantity.startswith("violation_"):
            assert step[quantity][0] == (distance if quantity == f"violation_{name}" else 0.0)
        if quantity.startswith("hours_outside_"):
            assert step[quantity][0] == (0.25 if quantity == f"hours_outside_{name}" else 0.0)
    assert step["penalty"][0] == pytest.approx(distance / (2500.0 if "co2" in name else 15.0), rel=1e-12)


@pytest.mark.parametrize("air", [(15.0, 300.0, 50.0), (34.0, 1600.0, 85.0)])
def test_a_limit_itself_is_no_violation(accounts: Accounts, air: tuple[float, float, float]) -> None:
    assert outcome(accounts, 0.0, [0.0] * 6, air)["penalty"][0] == 0.0


def test_humidity_is_judged_at_100_percent_at_most(task: TaskSpec) -> None:
    """Air can be supersaturated in the model; the limit is 85 %, so a violation is 15 % at most."""
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    snapshot = simulation.snapshot()
    states = snapshot.states.copy()
    states[0, STATE_NAMES.index("vpAir")] *= 3.0
    simulation.restore(replace(snapshot, states=states))
    result = simulation.step(np.zeros((1, 6)))
    assert relative_humidity(states[0, STATE_NAMES.index("tAir")], states[0, STATE_NAMES.index("vpAir")]) > 200.0
    assert result.quantities["violation_relative_humidity_high"][0] == 15.0


def test_limits_are_judged_at_the_end_of_a_step_only(accounts: Accounts) -> None:
    before, after = np.full((1, 28), 40.0), np.full((1, 28), 20.0)
    fine = np.array([[20.0], [800.0], [70.0]])
    table = accounts.quantities(before, after, np.zeros((1, 6)), fine)
    assert not any(row.any() for name, row in zip(QUANTITY_NAMES, table, strict=True) if name.startswith("violation_"))


def test_the_unscaled_parts(task: TaskSpec, accounts: Accounts) -> None:
    step = outcome(accounts, 180.0, [0.5, 0.2, 0.0, 0.0, 1.0, 0.0], (14.0, 1700.0, 91.0))
    assert REWARDS["epi"](task, accounts)(step)[0] == step["epi"][0]
    assert REWARDS["penalties"](task, accounts)(step)[0] == -(1.0 + 100.0 + 6.0)


def test_every_quantity_has_a_unit_and_a_name_of_its_own() -> None:
    assert len(set(QUANTITY_NAMES)) == len(QUANTITIES)
    assert {quantity.unit for quantity in QUANTITIES} == {"-", "EUR m-2", "kWh m-2", "kg m-2", "degC", "ppm", "%", "h"}


def test_an_unknown_quantity_or_part_is_refused_with_the_nearest(accounts: Accounts) -> None:
    step = outcome(accounts, 0.0, [0.0] * 6, COMFORT)
    with pytest.raises(UnknownNameError, match="Did you mean 'cost_heat'"):
        step["cost_heet"]
    with pytest.raises(UnknownNameError, match="Did you mean 'scaled_epi'"):
        REWARDS["scaled_epy"]


@pytest.mark.usefixtures("own_words")
def test_a_part_of_ones_own_works_from_a_task_file(make_task: MakeTask) -> None:
    register_reward("test_fresh_fruit", "fresh fruit grown", lambda task, accounts: lambda step: step["fruit_fresh"])
    task = make_task(('modules = ["scaled_epi", "scaled_penalty"]', 'modules = ["test_fresh_fruit", "scaled_penalty"]'))
    accounts = make_accounts(task)
    step = outcome(accounts, 65.0, [0.0] * 6, (14.0, 800.0, 70.0))
    assert make_reward(task, accounts)(step)[0] == pytest.approx(0.001 - 1 / 15, rel=1e-9)
    with pytest.raises(TaskError, match="test_fresh_fruit"):
        register_reward("test_fresh_fruit", "again", lambda task, accounts: lambda step: step["epi"])


@pytest.mark.usefixtures("own_words")
@pytest.mark.parametrize(
    ("reward", "said"),
    [
        (lambda step: np.zeros((2, 1)), r"'test_own' of .* shape \(2, 1\); it must be \(2,\)"),
        (lambda step: 0.5, r"'test_own' of .* shape \(\); it must be \(2,\)"),
        (lambda step: step["epi"] * np.nan, "no finite number"),
    ],
)
def test_a_part_that_returns_no_reward_of_each_run_is_refused(
    reward: Callable[[StepOutcome], Any], said: str, make_task: MakeTask, still: StillKernel
) -> None:
    register_reward("test_own", "numbers", lambda task, accounts: reward)
    task = make_task(('modules = ["scaled_epi", "scaled_penalty"]', 'modules = ["test_own"]'))
    simulation = Simulation(task, 2, still)
    simulation.reset([1, 2])
    with pytest.raises(TaskError, match=said):
        simulation.step(np.zeros((2, 6)))


def test_a_scaled_epi_needs_prices(make_task: MakeTask) -> None:
    prices = ("fruit = { value = 1.6", "co2 = { value = 0.3", "heat = { value = 0.09", "electricity = { value = 0.3")
    task = make_task(*((price, price.split("value")[0] + "value = 0.0") for price in prices))
    with pytest.raises(TaskError, match="all its prices are 0"):
        make_reward(task, make_accounts(task))
