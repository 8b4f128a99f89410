"""The examples of docs/control.md run as they stand, and what it says of limits holds."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest

from glbench.control import StageReward
from glbench.env import Simulation
from glbench.kernel import available
from glbench.model import limit_parameter, violation_meter
from glbench.tasks import task_card
from tests.support import examples_of, run_examples

EXAMPLES = examples_of("control.md")


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the page's examples define."""
    if "compiled" not in available():
        pytest.skip("no compiled kernel here")
    folder = tmp_path_factory.mktemp("page")
    with contextlib.chdir(folder):
        return run_examples("control.md", EXAMPLES, {"__file__": str(folder / "planner" / "agent.py")})


def test_the_gradient_of_a_day_is_that_of_differences(names: dict[str, Any]) -> None:
    assert names["slope"] == pytest.approx(names["expected"], rel=1e-3)
    assert f"# {names['reward']:.4f} EUR m-2" in EXAMPLES[0]
    assert f"# {names['slope']:.3f} both" in EXAMPLES[0]


def test_a_step_within_limits_has_no_derivative_for_them_but_for_tighter_ones(names: dict[str, Any]) -> None:
    kernel, scenario, x, u = (names[name] for name in ("kernel", "scenario", "x", "u"))
    model, place = kernel.model, "relative_humidity"
    meter, limit = model.state_index(violation_meter(place, "high")), limit_parameter(place, "high")
    humid = names["air"].values[:-1, 2]
    calm = int((humid * (humid < 84.0) * (x[1:, meter] == x[:-1, meter])).argmax())
    given, tighter = x[calm], scenario.p.copy()
    tighter[model.parameter_names.index(limit)] = humid[calm] - 5.0
    slopes = [kernel.linearise(given, u[calm], scenario.d[calm], p).dx[meter, :meter] for p in (scenario.p, tighter)]
    assert not slopes[0].any()
    assert slopes[1].any()


def test_an_exact_and_a_smoothed_reward_agree_far_from_limits(names: dict[str, Any]) -> None:
    exact, smoothed = (StageReward(names["scenario"].task, smoothing=share)(names["x"], names["u"]) for share in (0.0, 0.03))
    kept = exact.penalty == 0.0
    assert kept.any()
    assert exact.reward[kept].tobytes() == smoothed.reward[kept].tobytes()


def test_the_agent_of_the_page_plays_a_task(names: dict[str, Any]) -> None:
    """Better than doing nothing, in two runs."""
    task = names["short"].replace(id="my/OneDay-v1", weather={"days": 1})
    card, rewards = task_card(task), []
    for acts in (True, False):
        agent, simulation = names["make_agent"](card), Simulation(task, 2)
        observations, earned = simulation.reset([7, 8]), np.zeros(2)
        agent.reset(card, 2)
        for _ in range(task.steps):
            result = simulation.step(agent.act(observations) if acts else np.zeros((2, 6)))
            observations, earned = result.observations, earned + result.rewards
        rewards.append(earned)
        assert not acts or simulation.u == pytest.approx(agent.controls, abs=1e-12)
    assert (rewards[0] > rewards[1]).all()
    assert names["wanted"].shape == (1, 6)


def test_the_shapes_of_the_estimator_and_the_outlook_are_those_of_the_page(names: dict[str, Any]) -> None:
    estimator, coming = names["estimator"], names["coming"]
    assert names["states"].shape == estimator.deviations.shape == (2, 118)
    assert (estimator.controls.shape, estimator.parameters.shape) == ((2, 10), (2, 249))
    assert (coming.d.shape, coming.calendar.shape) == ((2, 96, 10), (2, 97, 3))
    assert estimator.delivery(96) is not None
