"""The Gymnasium environment."""

from __future__ import annotations

import json
from collections.abc import Callable

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import glbench  # noqa: F401  # registers the ids
from glbench.env import GreenhouseEnv, info_quantities
from glbench.errors import ActionError, GlbenchError, UnknownNameError
from glbench.tasks import TaskSpec, get_task
from tests.env.checking import check_env_for_stable_baselines3
from tests.env.stepping import GOLDEN, StillKernel, walk
from tests.support import shipped_tasks

MakeTask = Callable[..., TaskSpec]
EVERY = shipped_tasks()
TASKS = [task.id for task in EVERY]
SPLITS = {task.id: None if task.splits is None or "training" in task.splits.names else task.splits.names[-1] for task in EVERY}
"""Where to make a task of which there is nothing to train on."""


@pytest.mark.parametrize("name", [name for name in TASKS if name in gymnasium.registry])
def test_gymnasiums_checker_has_nothing_to_say(name: str) -> None:
    check_env(gymnasium.make(name, render_mode="ansi", split=SPLITS[name]).unwrapped)


@pytest.mark.parametrize("render_mode", [None, "ansi", "rgb_array"])
def test_the_checkers_have_nothing_to_say_in_any_render_mode(day: TaskSpec, render_mode: str | None) -> None:
    made = gymnasium.make("glbench/Schiphol2010-Delta10-v1", task=day, render_mode=render_mode)
    check_env(made.unwrapped)
    check_env_for_stable_baselines3(made, warn=True)


@pytest.mark.parametrize("name", TASKS)
def test_stable_baselines3s_checker_has_nothing_to_say(name: str) -> None:
    check_env_for_stable_baselines3(GreenhouseEnv(name, split=SPLITS[name]), warn=True)


def test_an_id_with_the_package_in_front_needs_no_import() -> None:
    environment = gymnasium.make("glbench:glbench/Schiphol2010-Delta10-v1")
    assert isinstance(environment.unwrapped, GreenhouseEnv)
    assert environment.unwrapped.task.id == "glbench/Schiphol2010-Delta10-v1"


def test_the_action_space_is_symmetric_and_the_observation_space_finite() -> None:
    environment = GreenhouseEnv("Schiphol2010-Delta10-v1")
    assert environment.action_space == gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
    box = environment.observation_space
    assert isinstance(box, gymnasium.spaces.Box)
    assert box.shape == (22,)
    assert box.dtype == np.float32
    assert box.is_bounded()


def test_a_task_with_fewer_controls_has_fewer_actions(make_task: MakeTask) -> None:
    granted = ('controls = ["uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"]', 'controls = ["uVent"]')
    assert GreenhouseEnv(make_task(granted)).action_space.shape == (1,)


def episode(environment: GreenhouseEnv, seed: int, steps: int = 6) -> list[object]:
    observation, info = environment.reset(seed=seed)
    record: list[object] = [observation.tobytes(), info]
    for action in walk(1, steps, 1)[:, 0]:
        observation, *rest = environment.step(action)
        record += [observation.tobytes(), *rest]
    return record


def test_the_same_seed_gives_the_same_bits_and_another_one_others(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day)
    first = episode(environment, 666)
    assert episode(environment, 667) != first
    assert episode(environment, 666) == first
    assert episode(GreenhouseEnv(day), 666) == first


def test_episodes_without_a_seed_are_different_and_repeat_with_the_first_seed(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day)

    def seeds() -> list[int]:
        first = environment.reset(seed=5)[1]["seed"]
        return [first, *(environment.reset()[1]["seed"] for _ in range(3))]

    drawn = seeds()
    assert drawn[0] == 5
    assert len(set(drawn)) == 4
    assert seeds() == drawn
    # The seed that was drawn is a seed like any other.
    assert episode(environment, drawn[2])[0] == environment.reset(seed=drawn[2])[0].tobytes()


def test_without_any_seed_two_environments_differ(day: TaskSpec) -> None:
    assert GreenhouseEnv(day).reset()[1]["seed"] != GreenhouseEnv(day).reset()[1]["seed"]


def test_an_episode_terminates_at_the_horizon_and_is_never_truncated(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseEnv(day, still)
    environment.reset(seed=1)
    flags = [environment.step(action)[2:4] for action in walk(1, 96, 1)[:, 0]]
    assert flags == [(False, False)] * 95 + [(True, False)]
    with pytest.raises(GlbenchError, match="Call reset"):
        environment.step(np.zeros(6, dtype=np.float32))
    assert environment.reset(seed=2)[1]["step"] == 0


def test_info_is_flat_plain_and_complete(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day)
    names = [quantity.name for quantity in info_quantities(day)]
    _, info = environment.reset(seed=4)
    assert list(info) == names[: len(info)]
    observation, reward, _, _, info = environment.step(np.ones(6, dtype=np.float32))
    assert list(info) == names
    assert all(type(value) in (int, float) for value in info.values())
    assert (info["seed"], info["step"], info["hour_of_day"]) == (4, 1, 0.25)
    assert info["step_reward"] == reward
    assert (info["boiler"], info["co2_supply"], info["lamps"], info["vents"]) == pytest.approx((13.0, 0.5, 11.6, 0.1))
    assert info["air_temperature"] == pytest.approx(float(observation[0]), rel=1e-6)
    costs = info["cost_heat"] + info["cost_electricity"] + info["cost_co2"]
    assert info["epi"] == pytest.approx(info["revenue"] - costs, abs=1e-15)


def test_every_number_in_info_has_a_unit(day: TaskSpec) -> None:
    quantities = info_quantities(day)
    assert len({quantity.name for quantity in quantities}) == len(quantities)
    assert all(quantity.unit and quantity.meaning for quantity in quantities)
    units = {quantity.name: quantity.unit for quantity in quantities}
    assert (units["boiler"], units["co2_supply"], units["epi"]) == ("W m-2", "mg m-2 s-1", "EUR m-2")


def test_a_failed_step_terminates_with_the_tasks_reward_and_the_reason(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, StillKernel(lambda x: x[:, 25] > 55400.0))
    environment.reset(seed=1)
    assert "failure" not in environment.step(np.zeros(6, dtype=np.float32))[4]
    _, reward, terminated, truncated, info = environment.step(np.zeros(6, dtype=np.float32))
    assert (reward, terminated, truncated) == (day.evaluation.failed_step.reward, True, False)
    assert info["failure"] == "the test wanted it"
    assert info["step"] == 1


def test_a_bad_action_is_refused_in_words(day: TaskSpec, still: StillKernel) -> None:
    environment = GreenhouseEnv(day, still)
    environment.reset(seed=1)
    with pytest.raises(ActionError, match=r"action 4 \('uLamp'\) of row 0 is nan"):
        environment.step(np.array([0, 0, 0, 0, np.nan, 0], dtype=np.float32))
    with pytest.raises(ActionError, match=r"shape \(5,\). Expected shape \(6,\): uBoil, uCo2"):
        environment.step(np.zeros(5, dtype=np.float32))
    with pytest.raises(ActionError, match=r"is 2\.0, outside its bounds -1 to 1"):
        environment.step(np.full(6, 2.0, dtype=np.float32))


def test_the_panel_speaks_of_climate_controls_and_money(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, render_mode="ansi")
    environment.reset(seed=1)
    start = environment.render()
    assert start is not None
    assert "2010-03-01 00:00 UTC, step 0 of 96" in start
    assert "air temperature 16.5 degC" in start
    environment.step(np.ones(6, dtype=np.float32))
    text = environment.render()
    assert text is not None
    assert "boiler 13 W m-2, CO2 supply 0.5 mg m-2 s-1, thermal screen 10%" in text
    assert "too humid by" in text
    assert "heat 0.029" in text
    assert max(len(line) for line in text.splitlines()) < 160


def test_the_panel_says_why_an_episode_stopped(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day, StillKernel(lambda x: x[:, 25] > 0), render_mode="ansi")
    environment.reset(seed=1)
    environment.step(np.zeros(6, dtype=np.float32))
    assert "stopped   the test wanted it" in str(environment.render())


def test_without_a_render_mode_nothing_is_drawn_and_an_unknown_one_is_refused(day: TaskSpec) -> None:
    environment = GreenhouseEnv(day)
    environment.reset(seed=1)
    assert environment.render() is None
    with pytest.raises(UnknownNameError, match=r"no render mode 'human'\. Use 'ansi', 'rgb_array' or None"):
        GreenhouseEnv(day, render_mode="human")


def test_a_task_is_given_as_id_file_or_itself(day: TaskSpec) -> None:
    assert GreenhouseEnv(day.source).task == day
    assert GreenhouseEnv("Schiphol2010-Delta30-v1").task == get_task("glbench/Schiphol2010-Delta30-v1")
    with pytest.raises(UnknownNameError, match="Delta30"):
        GreenhouseEnv("Schiphol2010-Delta3-v1")


def test_an_episode_agrees_with_a_second_implementation() -> None:
    """Draws, actuation, physics, observation and reward together; tests/golden/env_episode.py shares no code with them."""
    golden = json.loads((GOLDEN / "env_episode.json").read_text(encoding="utf-8"))
    environment = GreenhouseEnv(golden["task"])
    environment.reset(seed=golden["seed"])
    for step in golden["record"]:
        observation, reward, _, _, info = environment.step(np.array(step["action"], dtype=np.float32))
        assert observation.tolist() == pytest.approx(step["observation"], rel=1e-5, abs=1e-6)
        assert reward == pytest.approx(step["reward"], abs=2e-5)
        assert info["epi"] == pytest.approx(step["epi"], abs=1e-8)
