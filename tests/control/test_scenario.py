"""A scenario is what the simulation meets, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from glbench.control import Scenario, StageReward
from glbench.env import Simulation
from glbench.errors import GlbenchError
from glbench.kernel import Kernel
from tests.control.steps import scored

CASES = [("Schiphol2010-Delta10-v1", 667), ("Spring-v1", 10003), ("Lettuce-v1", 10002)]


@pytest.mark.parametrize("days", [2, pytest.param(60, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("task_id", "seed"), CASES)
def test_stepping_a_scenario_gives_the_simulation(task_id: str, seed: int, days: int) -> None:
    """The states of every step, and the reward of all of them, under random actions of the task's own actuation."""
    task = scored(task_id)
    scenario, simulation = Scenario.of(task, seed), Simulation(task, 1)
    kernel = Kernel(task.model_value, task.step_seconds)
    rng, steps = np.random.default_rng(seed), min(days * task.steps_per_day, task.steps)
    simulation.reset([seed])
    x, u, rewards = [scenario.x0], [scenario.u_before], []
    assert simulation.x[0].tobytes() == scenario.x0.tobytes()
    assert simulation.u[0].tobytes() == scenario.u_before.tobytes()
    for k in range(steps):
        assert simulation.hour_of_day[0] == scenario.calendar[k, 0]
        rewards.append(simulation.step(rng.uniform(-1.0, 1.0, (1, len(task.actions)))).rewards[0])
        u.append(simulation.u[0])
        x.append(kernel.step(x[k], u[-1], scenario.d[k], scenario.p if scenario.p.ndim == 1 else scenario.p[k]))
        assert x[-1].tobytes() == simulation.x[0].tobytes(), k
    controls = np.array(u)
    assert np.abs(np.diff(controls, axis=0)).max() <= scenario.max_change + 1e-12
    assert ((controls >= scenario.low) & (controls <= scenario.high)).all()
    given = StageReward(task)(x, controls[1:], scenario.calendar[: steps + 1])
    assert given.reward.tobytes() == np.array(rewards).tobytes()


def test_a_horizon_may_begin_anywhere() -> None:
    task = scored("Lettuce-v1")
    scenario, stage = Scenario.of(task, 10000), StageReward(task)
    rng = np.random.default_rng(5)
    x = scenario.x0 * rng.uniform(1.0, 2.0, (task.steps + 1, len(scenario.x0)))
    u = rng.uniform(0.0, 1.0, (task.steps, len(scenario.high)))
    whole, part = stage(x, u, scenario.calendar), stage(x[700:797], u[700:796], scenario.calendar[700:797])
    assert part.reward.tobytes() == whole.reward[700:796].tobytes()


def test_shapes_and_what_is_drawn() -> None:
    drawn, nominal = (Scenario.of(f"Schiphol2010-{delta}-v1", 666) for delta in ("Delta10", "Delta00"))
    assert (drawn.p.shape, nominal.p.shape) == ((5760, 208), (208,))
    assert (drawn.d.shape, drawn.calendar.shape) == ((5760, 10), (5761, 2))
    np.testing.assert_array_equal(nominal.p, nominal.task.parameters())
    varied = np.ptp(drawn.p, axis=0) > 0.0
    assert varied.sum() == 29  # 28 properties of the crop, and the leaf mass that follows from two of them
    deviations = drawn.p[:, varied] / nominal.p[varied] - 1.0
    assert 0.0999 < np.sort(np.abs(deviations).max(axis=0))[-2] <= 0.1
    one, other = Scenario.of(scored("Spring-v1"), 10000), Scenario.of(scored("Spring-v1"), 10001)
    assert one.p.shape == (214,)
    assert (one.p != other.p).any()
    assert (one.d != other.d).any()
    for array in (one.x0, one.u_before, one.d, one.p, one.calendar, one.low, one.high):
        assert not array.flags.writeable


def test_controls_that_a_task_does_not_grant_stay_shut() -> None:
    task = scored("Schiphol2010-Delta00-v1").replace({"actuation.controls": ["uBoil", "uVent"]})
    assert Scenario.of(task, 1).high.tolist() == [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]


def test_a_seed_is_a_whole_number() -> None:
    with pytest.raises(GlbenchError, match="is not a whole number"):
        Scenario.of("Spring-v1", -1)
