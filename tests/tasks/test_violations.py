"""Violations as means over a step, their prices, and the travel of the actuators: keys, quantities, and what a step says."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from glbench.env import GreenhouseVectorEnv, Simulation, make_accounts
from glbench.episodes.header import definition_json, task_of
from glbench.episodes.signals import signals_of
from glbench.errors import TaskError
from glbench.evaluation.metrics import metrics_of, units_of
from glbench.kernel import Kernel
from glbench.leaderboard.catalogue import catalogue, charts_of
from glbench.model import NO_LIMIT, get_model, with_violation_meters
from glbench.report.task_words import definition_in_words, figures
from glbench.tasks import TaskSpec, get_task, task_card

Write = Callable[[str], Path]

PLAIN = """
base = "glbench/Schiphol2010-Delta10-v1"
schema = 2
id = "mylab/Plain-v1"
title = "Looked at after every step"

[weather]
days = 2
"""
MEAN = PLAIN + '\n[constraints]\njudged = "mean"\n'
MONEY = (
    MEAN
    + """
[reward]
modules = ["epi", "scaled_penalty"]

[reward.violation_price]
air_temperature = { value = 0.0054, unit = "EUR m-2 degC-1 h-1" }
co2 = { value = 3.2e-5, unit = "EUR m-2 ppm-1 h-1" }
relative_humidity = { value = 0.0054, unit = "EUR m-2 %-1 h-1" }
"""
)
PRICED = ("[reward.violation_price]", "air_temperature = { value = 0.0054")


@pytest.fixture
def plain(write: Write) -> TaskSpec:
    return get_task(write(PLAIN))


@pytest.fixture
def money(write: Write) -> TaskSpec:
    return get_task(write(MONEY))


def test_a_task_that_says_nothing_is_what_it_was(plain: TaskSpec, write: Write) -> None:
    said = get_task(write(PLAIN + '\n[constraints]\njudged = "end"\n'))
    assert said.digest == plain.digest
    assert "judged" not in json.dumps(plain.definition())
    assert plain.model_value is get_model("greenlight-tomato-1.0.0")
    assert not plain.judges_means
    assert not plain.violation_prices


def test_means_are_judged_by_a_model_with_meters_and_the_limits_of_the_task(write: Write, plain: TaskSpec) -> None:
    task = get_task(write(MEAN.replace("mean", "mean", 1) + "air_temperature.low = 14.0\n"))
    assert task.digest != plain.digest
    assert task.model_value == with_violation_meters(plain.model_value)
    assert task.model_id == plain.model_id
    own = task.parameters_by_name()
    assert [own[name] for name in ("lowestAirTemperature", "highestAirTemperature")] == [14.0, 34.0]
    assert (own["lowestCo2"], own["highestRelativeHumidity"]) == (300.0, 85.0)
    again = task_of(definition_json(task))
    assert again.digest == task.digest


def test_a_limit_that_is_not_stated_is_never_reached(write: Write) -> None:
    text = (Path(__file__).parents[2] / "tasks" / "lettuce-v1.toml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("co2 = {") or "ppm" not in line]
    task = get_task(write("\n".join(lines).replace('id = "glbench/', 'id = "mylab/')))
    own = task.parameters_by_name()
    assert (own["lowestCo2"], own["highestCo2"], own["lowestAirTemperature"]) == (-NO_LIMIT, NO_LIMIT, 5.0)
    assert not any("co2" in name for name in make_accounts(task).names if name.startswith("violation_"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('judged = "mean"', 'judged = "always"', 'judged = "always"'),
        ('"EUR m-2 degC-1 h-1"', '"EUR m-2 h-1"', 'Its unit is "EUR m-2 degC-1 h-1"'),
        ("0.0054", "0.0", "above 0"),
        ("co2 = { value = 3.2e-5, unit = \"EUR m-2 ppm-1 h-1\" }\n", "", r"\[constraints.co2\] needs what a violation costs: add co2"),
        (PRICED[0], '[reward.penalty_scale]\nco2 = { value = 1.0, unit = "ppm" }\n\n' + PRICED[0], "points or money, not both"),
        ("[reward]\n", '[model.overrides]\nhighestCo2 = { value = 1000.0, unit = "ppm" }\n\n[reward]\n', "state it in .constraints."),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(write: Write, old: str, new: str, message: str) -> None:
    assert old in MONEY
    with pytest.raises(TaskError, match=message):
        get_task(write(MONEY.replace(old, new, 1))).parameters()


def test_means_need_a_limit_and_an_air(write: Write) -> None:
    text = (Path(__file__).parents[2] / "tasks" / "lettuce-v1.toml").read_text(encoding="utf-8")
    limits = ("air_temperature = { low", "co2 = { low", "relative_humidity = { low")
    without = "\n".join(line for line in text.splitlines() if not line.startswith(limits))
    with pytest.raises(TaskError, match="no limit to judge by"):
        get_task(write(without.replace('id = "glbench/', 'id = "mylab/')))


def test_a_price_takes_the_place_of_the_scale_of_the_base(write: Write, money: TaskSpec) -> None:
    assert dict(money.reward.penalty_scale.items()) == {}
    assert dict(money.violation_prices) == {"air_temperature": 0.0054, "co2": 3.2e-5, "relative_humidity": 0.0054}
    assert money.penalty_scales["air_temperature"] == pytest.approx(1.0 / (0.0054 * 0.25))
    other = write(MONEY).with_name("other.toml")
    scales = (
        '[reward.penalty_scale]\nair_temperature = { value = 15.0, unit = "degC" }\nco2 = { value = 2500.0, unit = "ppm" }\n'
        'relative_humidity = { value = 15.0, unit = "%" }\n'
    )
    other.write_text(f'base = "mine.toml"\nid = "mylab/Other-v1"\ntitle = "points again"\n{scales}', encoding="utf-8")
    assert not get_task(other).violation_prices


def test_the_paper_s_balance_is_kept() -> None:
    """0.0202 EUR for a scaled unit of the paper's penalty: 15 degC, 2500 ppm or 15 % for a step of 15 minutes."""
    for scale, price in ((15.0, 0.0054), (2500.0, 3.2e-5)):
        assert 0.0202 / (scale * 0.25) == pytest.approx(price, rel=0.01)


def test_quantities_and_metrics_are_money(money: TaskSpec, plain: TaskSpec) -> None:
    units = {quantity.name: quantity.unit for quantity in money.quantities}
    assert (units["reward"], units["penalty"], units["actuator_travel"]) == ("EUR m-2", "EUR m-2", "-")
    assert (units_of(money)["reward"], units_of(money)["penalty"]) == ("EUR m-2", "EUR m-2")
    meanings = {metric.name: metric.meaning for metric in metrics_of(money)}
    assert meanings["penalty"] == "what the violations cost, each at its price"
    assert meanings["hours_co2_low"] == "time at which the CO2 of the indoor air is below its limit, in whole steps"
    shown = catalogue(money)
    assert [metric.headed for metric in shown.headlines] == ["Score [EUR/m²]", "Profit [EUR/m²]", "Violations [EUR/m²]"]
    assert shown.metrics["actuator_travel"].headed == "Travel"
    assert charts_of(money).series["penalty"]["unit"] == "ct/m² an hour"
    assert charts_of(money).panels[-1]["title"] == "Violations, EUR/m² an hour"
    curves = {curve.path: curve for page in signals_of(money).pages for curve in page.curves}
    assert (curves["money/reward"].title, curves["money/reward"].unit) == ("Score, summed", "EUR m⁻²")
    assert curves["violations/penalty"].title == "Violations, summed"
    assert [one.price for one in task_card(money).constraints] == [0.0054, 3.2e-5, 0.0054]
    section = next(part for part in definition_in_words(money) if part.heading.startswith("Limits"))
    assert section.heading.endswith("judged by the mean distance in every step")
    assert section.rows[0][-1] == "0.0054 EUR m-2 degC-1 h-1"
    for task, words in ((money, "each at its price [EUR m-2]"), (plain, "each divided by its penalty scale")):
        reward = next(part for part in definition_in_words(task) if part.heading == "Reward of a step")
        assert any(line.startswith("  scaled_penalty") and line.endswith(f"{words}.") for line in reward.lines)
    assert figures(money)["limits"][0]["scale"] == pytest.approx(740.74, abs=0.01)
    units = {quantity.name: quantity.unit for quantity in plain.quantities}
    assert (units["reward"], units["penalty"]) == ("-", "-")
    assert [metric.headed for metric in catalogue(plain).headlines] == ["Reward", "EPI [EUR/m²]", "Penalty"]


def test_reward_is_money_with_these_modules_alone(write: Write) -> None:
    task = get_task(write(MONEY.replace('["epi", "scaled_penalty"]', '["scaled_epi", "scaled_penalty"]')))
    units = {quantity.name: quantity.unit for quantity in task.quantities}
    assert (units["reward"], units["penalty"]) == ("-", "EUR m-2")


def test_schema_1_keeps_its_quantities() -> None:
    task = get_task("glbench/Schiphol2010-Delta10-v1")
    assert "actuator_travel" not in make_accounts(task).names
    assert len(task.quantities) == 23


def test_a_step_says_means_prices_and_travel(money: TaskSpec) -> None:
    """Against the difference of the meters, and by hand."""
    accounts, model = make_accounts(money), money.model_value
    before, after = np.zeros((1, len(model.states))), np.zeros((1, len(model.states)))
    before[0, model.state_index("aboveRelativeHumidity")] = 100.0
    after[0, model.state_index("aboveRelativeHumidity")] = 100.0 + 900.0 * 4.0
    after[0, model.state_index("belowAirTemperature")] = 900.0 * 0.5
    after[0, model.state_index("belowCo2")] = -1e-6  # an integrator's error
    held, now = np.array([[0.0, 0.5, 1.0, 0.2, 0.0, 0.0]]), np.array([[0.1, 0.2, 1.0, 0.2, 0.0, 0.05]])
    table = accounts.quantities(before, after, now, np.full((3, 1), np.nan), controls_before=held)
    step = dict(zip(accounts.names, table[:, 0].tolist(), strict=True))
    assert step["violation_relative_humidity_high"] == pytest.approx(4.0)
    assert step["violation_air_temperature_low"] == pytest.approx(0.5)
    assert (step["violation_co2_low"], step["hours_outside_co2_low"]) == (0.0, 0.0)
    assert step["hours_outside_relative_humidity_high"] == 0.25
    assert step["penalty"] == pytest.approx(4.0 * 0.0054 * 0.25 + 0.5 * 0.0054 * 0.25)
    assert step["actuator_travel"] == pytest.approx(0.1 + 0.3 + 0.05)


def test_fused_and_reference_give_the_same_bits_alone_and_in_a_batch(money: TaskSpec) -> None:
    kernel = Kernel(money.model_value, money.step_seconds, preset="fast")
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (12, 5, 6))
    tables = []
    for fused, rows in ((True, range(5)), (False, range(5)), (True, [3])):
        simulation = Simulation(money, len(rows), kernel=kernel, fused=fused)
        assert simulation.fused == fused
        simulation.reset([7 + row for row in rows])
        tables.append(np.stack([_quantities(simulation, action[list(rows)]) for action in actions]))
    np.testing.assert_array_equal(tables[0], tables[1])
    np.testing.assert_array_equal(tables[0][:, :, 3], tables[2][:, :, 0])
    names = make_accounts(money).names
    travel, penalty = (tables[0][:, names.index(name)] for name in ("actuator_travel", "penalty"))
    assert (travel[1:] > 0.0).all()
    assert penalty.max() > 0.0
    reward, epi = (tables[0][:, names.index(name)] for name in ("reward", "epi"))
    np.testing.assert_array_equal(reward, epi - penalty)


def _quantities(simulation: Simulation, actions: np.ndarray) -> np.ndarray:
    result = simulation.step(actions)
    return np.stack([*result.quantities.values()])


def test_travel_is_that_of_the_controls(plain: TaskSpec) -> None:
    envs = GreenhouseVectorEnv(plain, 3, kernel="fast")
    envs.reset(seed=1)
    held = np.zeros((3, 6))
    generator = np.random.default_rng(2)
    for _ in range(5):
        *_, info = envs.step(generator.uniform(-1.0, 1.0, (3, 6)).astype(np.float32))
        now = np.asarray(envs.simulation.u)
        np.testing.assert_allclose(info["actuator_travel"], np.abs(now - held).sum(axis=1), rtol=1e-12, atol=1e-15)
        held = now.copy()


def test_meters_can_be_observed(write: Write) -> None:
    task = get_task(write(MEAN + '\n[observation]\nmodules = ["full_state", "time"]\n'))
    columns = {column.name: column for column in task.observed()}
    assert columns["belowAirTemperature"].unit == "degC s"
    assert all(np.isfinite([column.low, column.high]).all() for column in columns.values())
    envs = GreenhouseVectorEnv(task, 2)
    observations, _ = envs.reset(seed=1)
    assert observations in envs.observation_space
