"""The air along a trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.control import Scenario, air_of
from glbench.env import Simulation
from glbench.errors import GlbenchError, ShapeError
from tests.control.steps import VARIED, WildKernel, scored, wild_steps
from tests.tasks.toy import Toy


def test_the_air_has_the_bits_of_the_simulation() -> None:
    task = scored("Spring-v1")
    simulation = Simulation(task, 5, WildKernel(task, Scenario.of(task, 10000).x0, 1))
    simulation.reset(range(10000, 10005))
    simulation.step(np.zeros((5, 6)))
    assert air_of(task.model_value, simulation.x).values.T.tobytes() == simulation.air.tobytes()


@pytest.mark.parametrize("task_id", VARIED)
def test_its_gradient_is_that_of_differences(task_id: str) -> None:
    model, x = scored(task_id).model_value, wild_steps(scored(task_id), 30).x
    air = air_of(model, x[None])
    assert (air.values.shape, air.gradient.shape) == ((1, 31, 3), (1, 31, 3, x.shape[1]))
    for state in range(x.shape[1]):
        h = np.zeros_like(x)
        h[:, state] = 1e-6 * np.maximum(np.abs(x[:, state]), 0.1)
        difference = (air_of(model, x + h).values - air_of(model, x - h).values) / (2.0 * h[:, [state]])
        np.testing.assert_allclose(air.gradient[0, :, :, state], difference, rtol=1e-6, atol=1e-7)
    saturated = air.values[0, :, 2] == 100.0
    assert saturated.any()
    assert not air.gradient[0, saturated, 2].any()


def test_what_has_no_air_or_does_not_fit_is_refused() -> None:
    with pytest.raises(GlbenchError, match="has no air"):
        air_of(Toy(), np.zeros((2, 2)))
    with pytest.raises(ShapeError, match="the last axis must have the 28 states"):
        air_of(scored("Schiphol2010-Delta10-v1").model_value, np.zeros((4, 27)))
