from __future__ import annotations

import numpy as np
import pytest

from glbench.evaluation.metrics import METRIC_NAMES, METRICS, StepMetrics, metrics_of, units_of, with_missing_steps
from glbench.tasks import TaskSpec, get_task
from tests.support import lettuce_task

PAPER = (
    "reward", "epi", "revenue", "cost_heat", "cost_electricity", "cost_co2", "penalty", "yield", "heat", "electricity", "co2",
    "hours_air_temperature_low", "hours_air_temperature_high", "hours_co2_low", "hours_co2_high", "hours_relative_humidity_low",
    "hours_relative_humidity_high", "hours_outside_limits",
)  # fmt: skip
"""In the order of released results."""


@pytest.fixture(params=["published", "lettuce"])
def task(request: pytest.FixtureRequest) -> TaskSpec:
    return get_task("glbench/Schiphol2010-Delta10-v1") if request.param == "published" else lettuce_task()


def test_a_metric_has_the_unit_of_the_quantity_it_sums(task: TaskSpec) -> None:
    units = {quantity.name: quantity.unit for quantity in task.quantities}

    assert [m.name for m in metrics_of(task) if m.quantity is None] == ["hours_outside_limits"]
    assert all(m.unit == units[m.quantity] for m in metrics_of(task) if m.quantity is not None)


def test_tasks_of_schema_1_have_the_metrics_of_released_results_in_their_order() -> None:
    assert metrics_of(get_task("glbench/Schiphol2010-Delta10-v1")) == METRICS
    assert METRIC_NAMES == PAPER


def test_the_metrics_of_another_task_follow_from_its_ledger_and_limits() -> None:
    assert tuple(units_of(lettuce_task()).items()) == (
        ("reward", "-"), ("epi", "EUR m-2"), ("revenue", "EUR m-2"), ("cost_co2", "EUR m-2"), ("cost_electricity", "EUR m-2"),
        ("cost_heat", "EUR m-2"), ("penalty", "-"), ("co2_dosed", "kg m-2"), ("electricity", "kWh m-2"), ("heat", "kWh m-2"),
        ("heads_gained", "m-2"), ("actuator_travel", "-"), *((name, "h") for name in PAPER[11:]),
    )  # fmt: skip


def test_two_limits_broken_at_once_are_one_hour_outside(task: TaskSpec) -> None:
    quantities = {quantity.name: np.zeros(2) for quantity in task.quantities} | {"reward": np.array([0.5, 0.25])}
    quantities["hours_outside_air_temperature_low"] = np.array([1.0, 0.0])
    quantities["hours_outside_relative_humidity_high"] = np.array([1.0, 0.0])
    of_step = StepMetrics(task)

    values = dict(zip(of_step.names, of_step(np.stack(list(quantities.values()))).tolist(), strict=True))

    assert values["hours_outside_limits"] == [1.0, 0.0]
    assert values["reward"] == [0.5, 0.25]
    assert values["hours_air_temperature_low"] == values["hours_relative_humidity_high"] == [1.0, 0.0]
    assert values["hours_co2_low"] == [0.0, 0.0]


def test_missing_steps_cost_what_the_task_says_and_use_nothing() -> None:
    metrics = with_missing_steps({"reward": 10.0, "epi": 1.0, "heat": 2.0}, 4, {"reward": -3.0, "epi": -0.5, "penalty": 3.0})

    assert metrics == {"reward": 10.0 - 12.0, "epi": 1.0 - 2.0, "heat": 2.0}
