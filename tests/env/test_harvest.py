"""The task in which the agent calls the crew: bits of every way to step it, the crew's day, the ledger, checkers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.control.scenario import Scenario
from glbench.control.stage import StageReward
from glbench.env import GreenhouseVectorEnv, Simulation
from glbench.env.actuation import actions_of
from glbench.errors import TaskError
from glbench.kernel import available
from glbench.model import HARVESTED_BUTTERHEAD
from glbench.model.crop.butterhead import FIFTHS
from glbench.model.crop.harvested import SIZES
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task
from tests.env.checking import check_that_both_are_silent
from tests.env.stepping import walk

TASK = get_task("LettuceHarvest-v1").in_split("validation")
MODEL = TASK.model_value
HEAD: Any = next(signal for signal in MODEL.signals() if signal.path == "crop/head").of
NAMES = [column.name for column in TASK.observed()]
CREW = [action.name for action in TASK.actions].index("uHarvest")
DAY = TASK.steps_per_day


@pytest.fixture(scope="module")
def early(tmp_path_factory: pytest.TempPathFactory) -> TaskSpec:
    """The task with a crew that also cuts plants of a few hours, so that short runs have harvests."""
    return written(tmp_path_factory.mktemp("early"), ("first = 20.0", "first = 0.1"))


def written(folder: Path, *changes: tuple[str, str]) -> TaskSpec:
    text = Path(data_folder("tasks") / "lettuceharvest-v1.toml").read_text(encoding="utf-8")
    for old, new in (('id = "glbench/LettuceHarvest-v1"', 'id = "tests/Harvest-v1"'), *changes):
        assert text.count(old) == 1
        text = text.replace(old, new)
    (folder / "task.toml").write_text(text, encoding="utf-8")
    return get_task(folder / "task.toml").in_split("validation")


def calls(seed: int, steps: int, n: int) -> Any:
    """Random actions of the climate; row r calls the crew for a while from step 40 (r + 1) on, and again two days later."""
    actions = walk(seed, steps, n, len(TASK.actions))
    actions[:, :, CREW] = -1.0
    for row in range(n):
        for start in (40 * (row + 1), 40 * (row + 1) + 2 * DAY + 30):
            actions[start : start + 20, row, CREW] = 1.0
    return actions


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_both_checkers_are_silent(recwarn: pytest.WarningsRecorder) -> None:
    check_that_both_are_silent(get_task("LettuceHarvest-v1"), recwarn)


def test_a_step_has_the_same_bits_compiled_with_the_environment_and_not_and_in_any_batch(early: TaskSpec) -> None:
    if "compiled" not in available(HARVESTED_BUTTERHEAD):
        pytest.skip("nothing compiled here")
    one, other, alone = (Simulation(early, n, "fast", fused=fused) for n, fused in ((3, True), (3, False), (1, True)))
    assert one.fused, "the program fits into the compiled step"
    first = one.reset([1, 2, 3])
    assert first.tobytes() == other.reset([1, 2, 3]).tobytes()
    assert first[1].tobytes() == alone.reset([2])[0].tobytes()
    for action in calls(4, 5 * DAY, 3):
        result, theirs, its = one.step(action), other.step(action), alone.step(action[1:2])
        assert result.observations.tobytes() == theirs.observations.tobytes()
        assert result.table.tobytes() == theirs.table.tobytes()
        assert result.table[:, 1].tobytes() == its.table[:, 0].tobytes()
    assert one.x.tobytes() == other.x.tobytes()
    assert one.x[1].tobytes() == alone.x[0].tobytes()


def test_the_vector_environment_and_jax_have_these_bits(early: TaskSpec) -> None:
    pytest.importorskip("jax")
    import jax

    from glbench.jax import Environment, Params

    if "compiled" not in available(HARVESTED_BUTTERHEAD):
        pytest.skip("nothing compiled here")
    seeds = (10_003, 10_001)
    environment = Environment(early, seeds=seeds, info=("epi",), split="validation")
    native = GreenhouseVectorEnv(early, 2, kernel="fast", split="validation")
    simulation = Simulation(early, 2, "fast")
    keys = jax.random.split(jax.random.key(0), 2)
    observed, state = jax.jit(jax.vmap(environment.reset))(keys, Params(np.arange(2), np.ones(2, np.int64)))
    assert np.asarray(observed).tobytes() == native.reset(seed=seeds)[0].tobytes() == simulation.reset(seeds).tobytes()
    step = jax.jit(jax.vmap(environment.step))
    for actions in calls(5, 100, 2):
        observed, state, reward, _, info = step(keys, state, actions)
        theirs, own = native.step(actions), simulation.step(actions)
        assert np.asarray(observed).tobytes() == theirs[0].tobytes() == own.observations.tobytes()
        assert np.asarray(reward).tobytes() == theirs[1].astype(np.float32).tobytes()
        assert np.asarray(info["epi"]).tobytes() == own.quantities["epi"].astype(np.float32).tobytes()


def test_a_crew_that_was_called_works_for_a_day_and_then_plants_grow(early: TaskSpec) -> None:
    simulation = Simulation(early, 1, "fast")
    simulation.reset([1])
    column, crew, ages = NAMES.index("days_since_planting"), [], []
    place = MODEL.control_names.index("uHarvest")
    for action in calls(6, 4 * DAY, 1):
        seen = simulation.step(action).observations
        crew.append(simulation.u[0, place])
        ages.append(seen[0, column])
    starts = np.flatnonzero(np.diff([0.0, *crew]) > 0)
    assert starts.tolist() == [40, 40 + 2 * DAY + 30]
    assert crew[40 : 40 + DAY] == [1.0] * DAY
    assert crew[40 + DAY] == 0.0
    assert max(ages[40 : 40 + DAY]) < 0.01
    assert ages[40 + 2 * DAY] == pytest.approx(1.0, abs=0.02)
    assert set(crew) == {0.0, 1.0}


@pytest.mark.parametrize(("action", "day"), [(1.0, 1.0), (0.0, 2.0), (-0.5, 2.5), (-1.0, 3.0)])
def test_the_action_says_from_which_age_on_the_crew_cuts(tmp_path: Path, action: float, day: float) -> None:
    task = written(tmp_path, ("first = 20.0, last = 65.0", "first = 1.0, last = 3.0"))
    simulation, place = Simulation(task, 40, "fast"), MODEL.control_names.index("uHarvest")
    simulation.reset(range(40))
    actions = np.zeros((40, len(task.actions)), dtype=np.float32)
    actions[:, CREW] = action
    crew = []
    for _ in range(4 * DAY):
        simulation.step(actions)
        crew.append(simulation.u[:, place].copy())
    assert [int(column.argmax()) for column in np.array(crew).T] == [day * DAY] * 40, "to the step, however the integrator rounds"
    assert (np.sum(crew, axis=0) == (DAY if day > 1.0 else 2 * DAY)).all()


def test_who_asks_for_nothing_asks_for_no_crew() -> None:
    *climate, crew = TASK.actions
    assert [action.idle for action in climate] == [0.0] * 4
    assert crew.idle == crew.low
    assert "plantingDays = 20 day on at 1, 65 day at -1" in crew.meaning


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('state = "plantingDays"', 'state = "plantingDay"', r"\[actuation.on_off.uHarvest\] .* no state 'plantingDay'. .*'plantingDays'"),
        ('unit = "day" }', 'unit = "h" }', r"the unit of plantingDays is day, not h"),
        ("first = 20.0, last = 65.0", "first = 65.0, last = 20.0", r"first = 65 must be below last = 20"),
        ("lowest = 1.0", "lowest = 0.5", r"a machine with due is off or fully on. Write lowest = 1.0"),
    ],
)
def test_what_is_wrong_with_a_state_that_decides_is_said_in_words(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(TaskError, match=message):
        assert written(tmp_path, (old, new)).due_places


def test_a_harvest_pays_what_the_heads_weigh_at_the_price_of_the_day_and_the_ledger_adds_up() -> None:
    simulation = Simulation(TASK, 4, "fast")
    simulation.reset(range(4))
    p, prices = MODEL.Parameters(*TASK.parameters()), NAMES.index("price_heads")
    sums: dict[str, Any] = {}
    action = np.full((4, len(TASK.actions)), 0.0, dtype=np.float32)
    action[:, CREW], cut = -1.0, 45 * DAY
    begin, price = HEAD(MODEL.State(*simulation.x.T), p), 0.0
    for step in range(TASK.steps):
        action[:, :4] = [0.8, 0.8, 0.0, 0.4] if step < 5 else 0.0
        action[:, CREW] = 1.0 if step == cut else -1.0
        heads = np.asarray(HEAD(MODEL.State(*simulation.x.T), p))
        if step == cut:
            price, weighed = simulation.observe()[:, prices].astype(float), heads
        result = simulation.step(action)
        for name, row in result.quantities.items():
            sums[name] = sums.get(name, 0.0) + row
    earned = [25 * np.mean([np.interp(head * (1 + 0.1 * z), list(SIZES), list(SIZES.values())) for z in FIFTHS]) for head in weighed]
    np.testing.assert_allclose(sums["revenue"], earned * price, rtol=1e-5)
    np.testing.assert_allclose(sums["cost_plants"], 25 * 0.06, rtol=0.01)
    profit = sums["revenue"] + sums["standing"] - sums["cost_heat"] - sums["cost_co2"] - sums["cost_plants"]
    np.testing.assert_allclose(sums["epi"], profit, atol=1e-9)
    np.testing.assert_allclose(sums["reward"], sums["epi"] - sums["penalty"], atol=1e-9)
    assert np.ptp(weighed) > 20.0
    assert (begin < 5.0).all()


def test_nobody_sees_how_heavy_the_crop_is_but_from_the_sample() -> None:
    assert {"registration", "planting", "prices"} <= set(TASK.observation.modules)
    assert not {"crop", "true_state"} & set(TASK.observation.modules)
    assert not {"head_fresh_mass", "dry_matter", "leaf_area_index"} & set(NAMES)


def test_a_plan_of_a_season_has_the_reward_of_its_simulation() -> None:
    """So that best known plans can be searched for: the reward of a step depends on states and controls of that step alone."""
    scenario, simulation, stage = Scenario.of(TASK, 10_000), Simulation(TASK, 1, "fast"), StageReward(TASK)
    simulation.reset([10_000])
    actions, cut = np.zeros((1, len(TASK.actions)), dtype=np.float32), 30 * DAY
    states, controls, rewards = [simulation.x[0].copy()], [], []
    for step in range(31 * DAY):
        actions[0, :2], actions[0, CREW] = (0.5 if step < 4 else 0.0), (1.0 if step >= cut else -1.0)
        rewards.append(simulation.step(actions).rewards[0])
        states.append(simulation.x[0].copy())
        controls.append(simulation.u[0].copy())
    values = stage(np.array(states), np.array(controls), scenario.calendar[: len(states)])
    np.testing.assert_allclose(values.reward, rewards, rtol=1e-9, atol=1e-12)
    before, working = np.zeros(len(controls[0])), controls[-1]
    assert actions_of(TASK, before, working)[CREW] == 1.0
    assert actions_of(TASK, working, working)[CREW] == 1.0
    assert actions_of(TASK, working, before)[CREW] == actions_of(TASK, before, before)[CREW] == -1.0
