"""A task with the crop with trusses: spaces, observation modules, the crew as actions, bounds in hostile runs."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from glbench.env import GreenhouseEnv, Simulation
from glbench.episodes.signals import signals_of
from glbench.kernel import Kernel, available
from glbench.model import Horizon, saturation_vapour_pressure
from glbench.model.paper import TOMATO_2, TOMATO_2_COMPARTMENT, TOMATO_2_COMPARTMENT_ENERGY, TOMATO_2_ENERGY, TOMATO_2_HEAT_PUMP
from glbench.tasks import TaskSpec, get_task
from tests.env.checking import check_that_both_are_silent
from tests.env.stepping import walk

MODELS = (TOMATO_2, TOMATO_2_COMPARTMENT, TOMATO_2_COMPARTMENT_ENERGY, TOMATO_2_ENERGY, TOMATO_2_HEAT_PUMP)
NEW = ("registration", "crop_health")
CLIMATES = ("Spring-v1", "Transfer-SandPoint-v1", "Transfer-Miami-v1")


@cache
def task_of(base: str = "Spring-v1", days: int = 2, model: Any = TOMATO_2) -> TaskSpec:
    """A published task with another crop, all that can be seen of it, and a crew that the agent directs."""
    task = get_task(base)
    return task.replace(
        id="test/Trusses-v1",
        model={"id": model.id},
        observation={"modules": [*task.observation.modules, *NEW]},
        actuation={"controls": list(model.control_names)},
        weather={"days": days},
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_both_checkers_are_silent(recwarn: pytest.WarningsRecorder) -> None:
    check_that_both_are_silent(task_of(), recwarn)


@pytest.mark.parametrize("model", [TOMATO_2, *(pytest.param(model, marks=pytest.mark.slow) for model in MODELS[1:])], ids=str)
def test_every_model_with_this_crop_can_be_stepped_and_seen(model: Any) -> None:
    task = task_of(model=model)
    simulation = Simulation(task, 2, "fast")
    seen = simulation.reset([3, 4])
    for action in walk(2, 8, 2, len(model.controls)):
        seen = simulation.step(action).observations
    own = seen[:, [quantity.name for quantity in task.observed()].index("trusses") :]
    assert seen.shape == (2, len(task.observed()))
    assert own.shape[1] == 10
    assert np.isfinite(seen).all()
    assert (own[:, 1] > 50).all()  # fruits m-2
    assert GreenhouseEnv(task, split="training").action_space.shape == (len(model.controls),)


def test_with_the_engine_off_the_whole_seasons_of_cherry_tomatoes_have_one_climate() -> None:
    """The boiler heats the buffer as much as the buffer the pipes, so both drafts are one greenhouse."""
    days, states = [], ("tAir", "tPipe", "vpAir", "co2Air", "cLeaf", "cBuf", "tMass")
    for name in ("FullSeason-v2", "FullSeasonEnergy-v2"):
        task = get_task(name).replace({"weather.days": 2, "scenario.family": "test/Same"}, actuators=None).in_split("training")
        simulation = Simulation(task, 2, "fast")
        simulation.reset([20001, 20002])
        for action in walk(2, 96, 2, 6):
            climate = dict(zip(("uBoil", "uCo2", "uThScr", "uVent", "uLamp", "uBlScr"), action.T, strict=True))
            climate |= {"uPipe": climate["uBoil"], "uChp": np.full(2, -1.0)}
            simulation.step(np.stack([climate[control] for control in task.actuation.controls], axis=1))
        days.append([simulation.x[:, task.model_value.state_names.index(state)] for state in states])
    assert days[0] == [pytest.approx(values, rel=1e-7) for values in days[1]]


def test_what_is_seen_is_the_same_compiled_with_the_environment_and_not() -> None:
    if "compiled" not in available(TOMATO_2):
        pytest.skip("nothing compiled here")
    one, other = Simulation(task_of(), 3, "fast"), Simulation(task_of(), 3, "fast", fused=False)
    assert one.fused
    assert one.reset([1, 2, 3]).tobytes() == other.reset([1, 2, 3]).tobytes()
    for action in walk(4, 24, 3, 10):
        assert one.step(action).observations.tobytes() == other.step(action).observations.tobytes()
    assert one.x.tobytes() == other.x.tobytes()


@pytest.mark.parametrize("base", CLIMATES)
def test_observations_and_states_stay_in_their_bounds_whatever_an_agent_does(base: str) -> None:
    """A random walk, everything at one end and at the other, for ten days."""
    task = task_of(base, 10)
    names = [quantity.name for quantity in task.observed()]
    low, high = (np.array([getattr(quantity, end) for quantity in task.observed()], dtype=np.float32) for end in ("low", "high"))
    simulation = Simulation(task, 4, "fast")
    observations = simulation.reset(range(4))
    actions = walk(8, task.steps, 4, 10)
    actions[:, 1], actions[:, 2] = 1.0, -1.0
    for action in actions:
        outside = (observations < low) | (observations > high)
        assert not outside.any(), [names[k] for k in np.flatnonzero(outside.any(axis=0))]
        observations = simulation.step(action).observations
    for name, (least, most) in TOMATO_2.bounds(horizon(task.steps)).items():
        values = simulation.x[:, TOMATO_2.state_index(name)]
        assert ((least <= values) & (values <= most)).all(), name


def horizon(steps: int) -> Horizon:
    values = dict(zip(TOMATO_2.parameter_names, TOMATO_2.parameters.default().tolist(), strict=True))
    return Horizon(steps, 900.0, values)


@pytest.mark.parametrize("climate", ["desert", "polar night"])
@pytest.mark.parametrize("start", ["mature_crop", "young_crop"])
def test_states_stay_in_their_bounds_in_a_desert_and_in_a_polar_night_with_controls_that_jump(climate: str, start: str) -> None:
    generator, steps, rows = np.random.default_rng(5), 20 * 96, 6
    kernel, p = Kernel(TOMATO_2, 900.0, preset="fast"), TOMATO_2.parameters.default()
    d = dict.fromkeys(TOMATO_2.disturbance_names, 0.0) | {"co2Out": 730.0, "tSoOut": 12.0}
    bounds = TOMATO_2.bounds(horizon(steps))
    endless = (-np.inf, np.inf)  # meters
    low, high = (np.array([bounds.get(name, endless)[end] for name in TOMATO_2.state_names]) for end in (0, 1))
    x = None
    for step in range(steps):
        sun = max(0.0, np.sin(np.pi * (step % 96 / 4 - 6) / 12))
        if climate == "desert":
            d |= {"tOut": 28 + 20 * sun, "iGlob": 1150 * sun, "tSky": 5 + 20 * sun, "wind": 0.5, "vpOut": 900.0, "tSoOut": 28.0}
            d |= {"isDay": float(sun > 0), "isDaySmooth": sun, "dayRadSum": 31.6}
        else:
            d |= {"tOut": -35.0, "tSky": -60.0, "wind": 12.0, "vpOut": 0.9 * saturation_vapour_pressure(-35.0)}
        weather = np.tile(list(d.values()), (rows, 1))
        if x is None:
            x = np.tile(TOMATO_2.start(start, weather[0], 18.0, p), (rows, 1))
        u = generator.integers(0, 2, (rows, 10)).astype(float)
        u[0], u[1] = 1.0, 0.0
        u[2] = [1, 1, 1, 0, 1, 1, 0, 0, 0, 0]  # all heat and light in a house that is shut
        u[3] = [0, 0, 0, 1, 0, 0, 1, 0, 0, 0]  # cold, vents open, and nobody picks
        u[4] = [1, 0, 1, 0, 0, 1, 0, 0, 1, 1]  # few leaves, topped, warm and wet
        x = kernel.step(x, u, weather, p[None])
        outside = (x < low) | (x > high)
        assert not outside.any(), (step, [(TOMATO_2.state_names[k], x[:, k]) for k in np.flatnonzero(outside.any(axis=0))])
    assert x is not None
    assert (x[:, TOMATO_2.state_index("nRipe")] >= 0).all()


@pytest.mark.parametrize("draft", ["SpringTrusses-v1", "SpringCrew-v1", "WinterTrusses-v1"])
def test_every_column_of_a_record_has_a_name_of_its_own(draft: str) -> None:
    assert "mould" in {one.name for one in signals_of(get_task(draft)).recorded}
