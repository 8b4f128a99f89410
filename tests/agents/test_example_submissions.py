"""The examples that newcomers copy: they load, act within bounds, read columns by name, and do what they say."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import Agent, action_problems, load_agent
from glbench.env import Simulation
from glbench.evaluation.sandbox import choosing
from glbench.resources import data_folder
from glbench.tasks import TaskCard, get_task, task_card

SUBMISSIONS = data_folder("submissions")
SET_POINTS = SUBMISSIONS / "setpoints.py"
ENERGY = SUBMISSIONS / "energy_agent.py"
EXAMPLES = [SUBMISSIONS / f"{name}.py" for name in sorted(choosing.EXAMPLES)]  # a public copy has those of others, too
FOR_ACTUATORS = [path for path in EXAMPLES if path != SET_POINTS]
TASKS = [
    *((path, id_) for path in FOR_ACTUATORS for id_ in ("Schiphol2010-Delta10-v1", "Spring-v1", "GreenhouseReal-v1")),
    *((ENERGY, id_) for id_ in ("WinterLED-v1", "SpringEnergy-v1", "FullSeasonEnergy-v1")),
    *((SET_POINTS, id_) for id_ in ("SpringSetpoints-v1", "GreenhouseSetpoints-v1")),
]
ON_A_TASK = pytest.mark.parametrize(("path", "task_id"), TASKS, ids=lambda one: getattr(one, "stem", one))


def made(path: Path, card: TaskCard, n: int) -> Agent:
    agent = load_agent(path).make(card)
    assert isinstance(agent, Agent)
    agent.reset(card, n)
    return agent


def synthetic(card: TaskCard) -> NDArray[np.float32]:
    """Observations anywhere within plausible climates, 200 runs."""
    plausible = {"air_temperature": (5, 40), "co2": (200, 5000), "global_radiation": (0, 1000), "outdoor_temperature": (-20, 40)}
    bounds = [plausible.get(q.name, (q.low, q.high)) for q in card.observations]
    low, high = np.array(bounds, dtype=np.float64).T
    return np.random.default_rng(7).uniform(low, high, (200, len(bounds))).astype(np.float32)


def test_the_template_and_the_examples_are_there() -> None:
    names = ["constant_setpoints", "do_nothing", "energy_agent", "my_agent", "pi_controller", "setpoints"]
    assert [path.stem for path in EXAMPLES if path.is_file()] == names


@ON_A_TASK
def test_an_example_acts_validly_on_anything_it_may_see(path: Path, task_id: str) -> None:
    card = task_card(get_task(task_id))
    seen = synthetic(card)
    agent = made(path, card, len(seen))
    for _ in range(20):
        assert action_problems(agent.act(seen), card, len(seen)) == {}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_needs_numpy_and_the_standard_library_only(path: Path) -> None:
    imported = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            imported |= {name.name.partition(".")[0] for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add((node.module or "").partition(".")[0])
    assert imported - {"numpy"} <= set(sys.stdlib_module_names)


@ON_A_TASK
def test_an_example_decides_for_a_run_alone_as_in_a_batch(path: Path, task_id: str) -> None:
    card = task_card(get_task(task_id))
    seen = synthetic(card)
    together, alone = made(path, card, 3), [made(path, card, 1) for _ in range(3)]
    for step in range(10):
        rows = seen[3 * step : 3 * step + 3]
        each = np.concatenate([agent.act(rows[i : i + 1]) for i, agent in enumerate(alone)])
        assert np.array_equal(together.act(rows), each)


@pytest.mark.parametrize("path", [path for path in FOR_ACTUATORS if path.stem != "do_nothing"], ids=lambda path: path.stem)
def test_an_example_keeps_a_spring_day_in_order(path: Path) -> None:
    # From the second day on; at the start all controls are 0 and the air is humid.
    task = get_task("Schiphol2010-Delta10-v1")
    simulation, agent = Simulation(task, 2), made(path, task_card(task), 2)
    observations = simulation.reset([666, 667])
    rewards = []
    for _ in range(192):
        result = simulation.step(agent.act(observations))
        observations = result.observations
        rewards.append(result.rewards)
    # Doing nothing at all without breaking a limit gives 0.641 a step.
    assert np.mean(rewards[96:]) > 0.5


def test_the_pi_controllers_integrator_does_not_wind_up(card: TaskCard, observe) -> None:  # type: ignore[no-untyped-def]
    agent = made(data_folder("submissions") / "pi_controller.py", card, 1)
    for _ in range(200):
        agent.act(observe(1, air_temperature=5.0))
    # After two days of hopeless cold, a little too warm is enough to switch the boiler off at once.
    assert agent.act(observe(1, air_temperature=21.0, boiler=130.0))[0, 0] == -1.0


def test_the_example_agent_warms_up_before_the_sun_that_is_forecast() -> None:
    card = task_card(get_task("Spring-v1"))
    column = {name: i for i, name in enumerate(card.observation_names)}
    night = np.zeros((3, len(card.observations)), dtype=np.float32)
    night[:, [column["air_temperature"], column["relative_humidity"], column["co2"]]] = 17.5, 75.0, 500.0
    night[1, column["global_radiation_in_2h"]] = 100.0
    night[2, column["global_radiation_in_3h"]] = 100.0
    heat = made(SUBMISSIONS / "my_agent.py", card, 3).act(night)[:, card.action_names.index("uBoil")]
    assert heat.tolist() == [0.0, 1.0, 0.0]


def test_a_page_of_set_points_says_on_which_tasks_it_means_anything(card: TaskCard) -> None:
    with pytest.raises(Exception, match=r"has no set point 'co2_set_point'; it has uBoil, .*such as SpringSetpoints-v1"):
        made(SET_POINTS, card, 1)


def test_the_energy_example_runs_lamps_and_engine_by_the_price_of_power() -> None:
    card = task_card(get_task("FullSeasonEnergy-v1"))
    column = {name: i for i, name in enumerate(card.observation_names)}
    night = np.zeros((4, len(card.observations)), dtype=np.float32)
    names = ["air_temperature", "relative_humidity", "co2", "price_fruit", "price_power", "buffer_share"]
    night[:, [column[name] for name in names]] = 18.0, 75.0, 500.0, 1.5, 0.1, 50.0
    night[1, column["price_power"]] = 0.2
    night[2, column["price_power"]] = 0.05
    night[3, column["buffer_share"]] = 95.0
    actions = made(ENERGY, card, 4).act(night)
    lamps, engine = actions[:, card.action_names.index("uLamp")], actions[:, card.action_names.index("uChp")]
    assert lamps.tolist() == [1.0, 0.0, 1.0, 1.0]
    assert engine.tolist() == [1.0, 1.0, 0.0, 0.0]
