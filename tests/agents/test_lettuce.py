"""Rules and predictive control of the suite lettuce-classic, on a day of weather that glbench ships."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import lettuce
from glbench.agents.baselines import read_baseline
from glbench.agents.lettuce import LettucePlanner, LettucePlanSettings, LettuceRules, _violations
from glbench.env import Simulation
from glbench.errors import SubmissionError
from glbench.tasks import TaskSpec, get_task, task_card

Floats = NDArray[np.float64]
SHORT = partial(LettucePlanSettings, horizon_hours=1.0)


TASK = """
base = "glbench/{name}"
schema = 2
id = "mylab/{name}"
title = "A day of weather that is here"

[weather]
source = "schiphol"
preprocessing = "conserving"
start = 2010-03-01
days = 1
"""


def shipped_weather(name: str) -> TaskSpec:
    """The task ``name`` in other weather."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "task.toml"
        file.write_text(TASK.format(name=name), encoding="utf-8")
        return get_task(file)


@pytest.fixture(scope="module")
def task() -> TaskSpec:
    return shipped_weather("LettuceClassic-Delta05-v1")


def played(agent: LettucePlanner | LettuceRules, task: TaskSpec, seeds: range, steps: int) -> tuple[Floats, Floats]:
    """Actions ``(steps, runs, 3)`` and rewards ``(runs,)`` of an agent from noon on."""
    simulation = Simulation(task, len(seeds))
    observations, rewards, actions = simulation.reset(seeds), np.zeros(len(seeds)), []
    agent.reset(task_card(task), len(seeds))
    for _ in range(steps):
        actions.append(agent.act(observations))
        result = simulation.step(actions[-1])
        observations, rewards = result.observations, rewards + result.rewards
    return np.array(actions), rewards


def observed(task: TaskSpec, **values: float) -> NDArray[np.float32]:
    """One row of observations, 0 but for ``values``."""
    return np.array([[values.get(column.name, 0.0) for column in task.observed()]], np.float32)


@pytest.mark.parametrize(
    ("values", "controls"),
    [  # of (CO2, vents, heat), in mg m-2 s-1, mm s-1, W m-2
        ({"global_radiation": 51.0, "air_temperature": 13.0, "co2": 650.0, "relative_humidity": 70.0}, (0.6, 0.0, 30.0)),
        ({"global_radiation": 49.0, "air_temperature": 13.0, "co2": 650.0, "relative_humidity": 70.0}, (0.0, 2.0, 0.0)),
        ({"global_radiation": 51.0, "air_temperature": 17.0, "co2": 500.0, "relative_humidity": 82.0}, (0.0, 3.0, 0.0)),
        ({"global_radiation": 51.0, "air_temperature": 14.0, "co2": 900.0, "relative_humidity": 99.0}, (0.0, 7.5, 0.0)),
    ],
)
def test_rules_are_the_published_ones(task: TaskSpec, values: dict[str, float], controls: tuple[float, ...]) -> None:
    rules, most = read_baseline("rule_based_lettuce").make(task_card(task)), np.array([1.2, 7.5, 150.0])
    assert isinstance(rules, LettuceRules)
    rules.reset(task_card(task), 1)
    now = {"co2_supply": 0.6, "ventilation": 2.0, "heating": 30.0}  # as far as they go in a step, actions say how far controls are away
    away = np.array(controls) / most - np.array([*now.values()]) / most
    np.testing.assert_allclose(rules.act(observed(task, **values, **now))[0], np.clip(away / 0.1, -1.0, 1.0), atol=1e-6)


def test_a_plan_earns_more_than_rules_and_a_row_has_the_same_bits_alone(task: TaskSpec) -> None:
    steps, seeds = 24, range(20000, 20002)
    actions, planned = played(LettucePlanner(LettucePlanSettings(horizon_hours=3.0)), task, seeds, steps)
    rules = read_baseline("rule_based_lettuce").make(task_card(task))
    assert isinstance(rules, LettuceRules)
    assert (planned > played(rules, task, seeds, steps)[1] + 0.01).all()
    alone, _ = played(LettucePlanner(LettucePlanSettings(horizon_hours=3.0)), task, seeds[1:], steps)
    assert np.array_equal(alone[:, 0], actions[:, 1])


def test_a_plan_is_what_the_simulation_does(task: TaskSpec) -> None:
    """The solver's next state is that of a step with nominal coefficients, and no other plan of a step earns more."""
    nominal = shipped_weather("LettuceClassic-Delta00-v1")
    agent, simulation = LettucePlanner(LettucePlanSettings(horizon_hours=0.5)), Simulation(nominal, 1)
    agent.reset(task_card(nominal), 1)
    observations = simulation.reset([1])
    best = agent.act(observations)
    state = simulation.snapshot()
    earned = simulation.step(best).rewards[0]
    for action in np.random.default_rng(1).uniform(-1.0, 1.0, (20, 1, 3)):
        simulation.restore(state)
        assert simulation.step(action).rewards[0] <= earned + 1e-5


def test_draws_change_plans_only_where_something_is_drawn(task: TaskSpec) -> None:
    nominal = shipped_weather("LettuceClassic-Delta00-v1")
    for of_task, same in ((nominal, True), (task, False)):
        one, other = (played(LettucePlanner(SHORT(draws=draws)), of_task, range(20000, 20001), 4)[0] for draws in (0, 2))
        assert np.array_equal(one, other) == same


def test_an_end_value_replaces_the_price_of_dry_weight(task: TaskSpec) -> None:
    """By day the air is short of CO2, so it is dosed; not where dry weight is worth nothing after the horizon."""
    worth = {"days_left": [0.0, 60.0], "gross": True, "states": {"xD": {"by_days_left": [0.0, 0.0], "by_hour": [1.0] * 8}}}
    sunny = {"co2": 600.0, "air_temperature": 15.0, "relative_humidity": 60.0, "dry_weight": 0.1, "co2_supply": 0.6}
    outside = {f"{name}{f'_ahead_{k}' if k else ''}": value for k in range(13) for name, value in {
        "global_radiation": 300.0, "outdoor_temperature": 10.0, "outdoor_vapour_density": 0.006, "outdoor_co2_density": 8e-4,
    }.items()}  # fmt: skip
    doses = []
    for settings in (SHORT(), SHORT(end_value=worth), SHORT(end_value=worth | {"gross": False})):
        agent = LettucePlanner(settings)
        agent.reset(task_card(task), 1)
        doses.append(float(agent.act(observed(task, **outside, **sunny))[0, 0]))
    assert doses[1] < doses[0] - 0.5
    assert doses[2] == doses[0]  # not gross: what dry weight is worth besides its price


def test_saturated_air_continues_with_the_vapour_that_was_predicted(task: TaskSpec) -> None:
    agent = LettucePlanner(SHORT())
    agent.reset(task_card(task), 1)
    wet = observed(task, co2=600.0, air_temperature=10.0, relative_humidity=100.0, dry_weight=0.1)
    first = agent.act(wet)
    agent._vapour[:] = 0.03  # three times saturation
    assert not np.array_equal(agent.act(wet), first)


@pytest.mark.parametrize(
    ("name", "words"), [("Schiphol2010-Delta10-v1", "plans for lettuce-classic-1.0.0"), ("LettuceClassic-Delta00-v1", "does not show")]
)
def test_a_task_that_cannot_be_planned_for_is_refused(name: str, words: str) -> None:
    task = get_task(name) if name.startswith("Schiphol") else shipped_weather(name)
    with pytest.raises(SubmissionError, match=words):
        LettucePlanner(SHORT(horizon_hours=8.0)).reset(task_card(task), 1)


@pytest.mark.parametrize(
    "change",
    [
        'ledger = { cost_heat = { price = "heat" } }\nprice_tables = { heat = { unit = "EUR kWh-1", hourly = %s } }' % ([0.1, 0.2] * 12),
        'without = ["reward.violation_price"]\nreward = { penalty_scale = { co2 = { value = 100.0, unit = "ppm" }, '
        'air_temperature = { value = 1.0, unit = "degC" }, relative_humidity = { value = 10.0, unit = "%" } } }',
    ],
)
def test_a_task_with_other_prices_is_refused(tmp_path: Path, change: str) -> None:
    head, weather, rest = TASK.format(name="LettuceClassic-Delta00-v1").partition("[weather]")
    (tmp_path / "task.toml").write_text(f"{head}{change}\n{weather}{rest}", encoding="utf-8")
    with pytest.raises(SubmissionError, match="violations must have prices, and all other prices must be constant"):
        LettucePlanner(SHORT()).reset(task_card(get_task(tmp_path / "task.toml")), 1)


def test_a_temperature_limit_below_freezing_counts(task: TaskSpec) -> None:
    frost = task.replace({"id": "mylab/Frost-v1", "constraints.air_temperature.low": -2.0})
    cold = np.array([0.0035, 0.001, -4.0, 0.003])
    colder = [np.array(_violations(one, cold)[0], dtype=float) for one in (task, frost)]
    assert [distances.size for distances in colder] == [5, 5]
    assert colder[1].max() == pytest.approx(2.0 / (0.1 * 22.0))


def test_the_end_value_of_the_baseline_fits_its_model() -> None:
    settings = read_baseline("mpc_value_lettuce").settings
    value = lettuce.EndValue.read(settings.end_value)
    worth = value(shipped_weather("LettuceClassic-Delta00-v1"), 0.0, [0.0, 40.0])
    assert worth[0, 0] == pytest.approx(22.285125, rel=0.05)  # the price of dry weight
    assert worth[1, 0] > worth[0, 0]


@pytest.mark.parametrize("column", ["dry_weight", "heating", "global_radiation_ahead_1"])
def test_a_planner_keeps_its_plan_if_a_reading_is_missing(task: TaskSpec, column: str) -> None:
    place, seeds = [one.name for one in task.observed()].index(column), range(2)
    simulation, agent, twin = Simulation(task, 2), LettucePlanner(SHORT()), LettucePlanner(SHORT())
    observations = simulation.reset(seeds)
    for one in (agent, twin):
        one.reset(task_card(task), 2)
    first, expected = agent.act(observations), twin.act(observations)
    assert np.array_equal(first, expected)
    observations, planned = simulation.step(first).observations, agent._plans[0, 0].copy()
    lost = observations.copy()
    lost[0, place] = np.nan
    second, unharmed = agent.act(lost), twin.act(observations)
    assert np.isfinite(second).all()
    assert np.array_equal(second[1], unharmed[1])
    names = [one.name for one in task.observed()]
    now = observations[0, [names.index(name) for name in lettuce._CONTROLS]] / agent._most
    wanted = np.clip((planned - now) / agent._max_change, -1.0, 1.0)
    wanted[np.array(lettuce._CONTROLS) == column] = 0.0  # its position is unknown, so it does not move
    assert second[0] == pytest.approx(wanted, abs=1e-6)
    assert np.isfinite(agent.act(simulation.step(second).observations)).all()
