from __future__ import annotations

import numpy as np
import pytest

from glbench.env import QUANTITIES
from glbench.evaluation.metrics import HOURS_OUTSIDE, METRIC_NAMES, METRICS, Metric, step_values, with_missing_steps

UNITS_OF_QUANTITIES = {quantity.name: quantity.unit for quantity in QUANTITIES}


@pytest.mark.parametrize("metric", [m for m in METRICS if m.quantity is not None], ids=lambda m: m.name)
def test_a_metric_has_the_unit_of_the_quantity_it_sums(metric: Metric) -> None:
    assert metric.quantity is not None
    assert metric.unit == UNITS_OF_QUANTITIES[metric.quantity]


def test_two_limits_broken_at_once_are_one_hour_outside() -> None:
    quantities = {quantity.name: np.zeros(2) for quantity in QUANTITIES} | {"reward": np.array([0.5, 0.25])}
    quantities["hours_outside_air_temperature_low"] = np.array([1.0, 0.0])
    quantities["hours_outside_relative_humidity_high"] = np.array([1.0, 0.0])

    values = step_values(np.stack(list(quantities.values())))

    assert values[METRIC_NAMES.index("hours_outside_limits")].tolist() == [1.0, 0.0]
    assert values[METRIC_NAMES.index("reward")].tolist() == [0.5, 0.25]
    assert sum(values[METRIC_NAMES.index(metric.name)][0] for metric in HOURS_OUTSIDE) == 2.0


def test_missing_steps_cost_what_the_task_says_and_use_nothing() -> None:
    metrics = with_missing_steps(
        {"reward": 10.0, "epi": 1.0, "heat": 2.0}, 4, {"reward": -3.0, "epi": -0.5, "penalty": 3.0}
    )

    assert metrics == {"reward": 10.0 - 12.0, "epi": 1.0 - 2.0, "heat": 2.0}
