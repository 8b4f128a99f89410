"""The camera above the crop: which scenes it shows, against the draws taken anew; bits of every way to step it; what refuses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents.views import left_out_views, visible_columns
from glbench.env import GreenhouseVectorEnv, Simulation, run_weather
from glbench.env.camera import run_scenes
from glbench.env.random import uniforms
from glbench.env.uncertainty import stream_key
from glbench.errors import GlbenchError, TaskError
from glbench.kernel import available
from glbench.model import HARVESTED_BUTTERHEAD
from glbench.report.task_words import definition_in_words, for_growers
from glbench.tasks import TaskSpec, get_task, resolver
from glbench.vision.library import Library
from tests.env.checking import check_that_both_are_silent
from tests.env.spring import spring
from tests.env.stepping import StillKernel, walk
from tests.scenes import HIDDEN, MASSES, lettuce_seen, small_library

MODULES = ("camera",)
CAMERA = '[observation]\nmodules = ["camera", "time"]\n'
HEAD: Any = next(signal for signal in HARVESTED_BUTTERHEAD.signals() if signal.path == "crop/head").of
DAY = 96


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = Library.open
    monkeypatch.setattr(Library, "open", lambda crop, version: (small_library if crop == "toys" else shipped)(crop, version))
    resolver._library.cache_clear()


@pytest.fixture
def task(tmp_path: Path) -> TaskSpec:
    return lettuce_seen(tmp_path)


def columns(task: TaskSpec) -> slice:
    first = [column.name for column in task.observed()].index("camera_1")
    return slice(first, first + 4)


def calls(task: TaskSpec, seed: int, steps: int, n: int) -> NDArray[np.float32]:
    """Random actions of the climate; row r calls the crew for a while from step 100 + 70 r on, and again two days later."""
    actions = walk(seed, steps, n, len(task.actions))
    crew = [action.name for action in task.actions].index("uHarvest")
    actions[:, :, crew] = -1.0
    for row in range(n):
        for start in (100 + 70 * row, 330 + 70 * row):
            actions[start : start + 20, row, crew] = 1.0
    return actions


def drawn(task: TaskSpec, seed: int, stream: str, step: int) -> NDArray[np.float64]:
    numbers: NDArray[np.float64] = uniforms(np.array([stream_key(task.scenario, seed, stream)], np.uint64), np.array([[step]]), 2)[0, 0]
    return numbers


@pytest.mark.parametrize(("split", "first", "plantings_shown"), [("training", 0, HIDDEN), ("validation", 0, HIDDEN), ("test", 7, 3)])
def test_it_shows_plants_of_the_heads_mass_that_change_with_the_planting_in_a_light_that_changes_at_noon(
    task: TaskSpec, split: str, first: int, plantings_shown: int
) -> None:
    task = task.in_split(split)
    seeds, steps, library = [3, 2**64 - 1], 6 * DAY, small_library("toys", "1")
    simulation = Simulation(task, 2, "fast")
    simulation.reset(seeds)
    start = simulation.snapshot()
    heavy = start.states.copy()
    heavy[:, [task.model_value.state_index(name) for name in ("xN", "xS")]] *= 40.0
    seen, states = [simulation.restore(replace(start, states=heavy))[:, columns(task)]], [heavy]
    for action in calls(task, 1, steps, 2):
        seen.append(simulation.step(action).observations[:, columns(task)])
        states.append(simulation.x)
    features, x = library.features.astype(np.float32), np.array(states)
    nominal = task.model_value.Parameters(*task.parameters().tolist())
    for row, seed in enumerate(seeds):
        hours = run_weather(task, seed).hour_of_day[: steps + 1]
        scenes = [int(np.flatnonzero((features == one[row]).all(axis=1))[0]) for one in seen]
        heads = HEAD(task.model_value.State(*x[:, row].T), nominal)
        plants, light = drawn(task, seed, "first picture", 0)
        taken, plantings = heads[0], 1
        for k, scene in enumerate(scenes):
            if k > 0 and hours[k] >= 12.0 > hours[k - 1]:
                later, light = drawn(task, seed, "camera", k)
                if heads[k] < 0.5 * taken:
                    plants, plantings = later, plantings + 1
                taken = heads[k]
            assert library.seeds[scene] == first + int(plants * plantings_shown), "of plants of the split"
            assert library.lights[scene] == int(light * 3)
            assert abs(library.truth["mass"][scene] - max(taken, 0.0)) <= (MASSES[1] + 700.0 / 1023) / 2.0
        assert (run_scenes(task, seed, x[:, row], hours) == scenes).all(), "what records say of it"
        assert library.truth["mass"][scenes].max() > 90.0
        assert plantings > 1


def test_other_runs_show_other_plants_and_an_episode_may_begin_anywhere(task: TaskSpec) -> None:
    library, n, start = small_library("toys", "1"), 300, 40
    simulation = Simulation(task, n, StillKernel())
    simulation.reset(range(n))
    features = library.features.astype(np.float32)

    def scenes() -> NDArray[np.intp]:
        return np.array([np.flatnonzero((features == one).all(axis=1))[0] for one in simulation.observe()[:, columns(task)]])

    counts = np.bincount(library.seeds[scenes()] * 3 + library.lights[scenes()], minlength=HIDDEN * 3)
    assert counts.min() > 5
    assert len(counts) == HIDDEN * 3
    simulation._environments.k[:] = start
    simulation._observe()
    first, hours = scenes(), np.array([run_weather(task, seed).hour_of_day[start + 20] for seed in range(3)])
    assert (hours > 12.0).all()
    for _ in range(8):
        simulation.step(np.zeros((n, len(task.actions))))
    assert (scenes()[:3] != first[:3]).any(), "noon of the first day"
    assert (library.seeds[scenes()] == library.seeds[first]).all(), "still the same plants"


def test_compiled_and_numpy_alone_and_in_a_batch_give_the_same_bits(task: TaskSpec) -> None:
    if "compiled" not in available(HARVESTED_BUTTERHEAD):
        pytest.skip("nothing compiled here")
    one, other, alone = (Simulation(task, n, "fast", fused=fused) for n, fused in ((3, True), (3, False), (1, True)))
    assert one.fused, "the program fits into the compiled step"
    first = one.reset([1, 2, 3])
    assert first.tobytes() == other.reset([1, 2, 3]).tobytes()
    assert first[1].tobytes() == alone.reset([2])[0].tobytes()
    for action in calls(task, 4, 2 * DAY, 3):
        result, theirs, its = one.step(action), other.step(action), alone.step(action[1:2])
        assert result.observations.tobytes() == theirs.observations.tobytes()
        assert result.observations[1:2].tobytes() == its.observations.tobytes()
    saved = one.snapshot()
    assert one.observe().tobytes() == other.restore(saved).tobytes()


def test_the_vector_environment_and_jax_have_these_bits(task: TaskSpec) -> None:
    pytest.importorskip("jax")
    import jax

    from glbench.jax import Environment, Params

    if "compiled" not in available(HARVESTED_BUTTERHEAD):
        pytest.skip("nothing compiled here")
    seeds = (10_003, 10_001)
    environment = Environment(task, seeds=seeds, split="validation")
    native = GreenhouseVectorEnv(task, 2, kernel="fast", split="validation")
    keys = jax.random.split(jax.random.key(0), 2)
    observed, state = jax.jit(jax.vmap(environment.reset))(keys, Params(np.arange(2), np.ones(2, np.int64)))
    assert np.asarray(observed).tobytes() == native.reset(seed=seeds)[0].tobytes()
    step = jax.jit(jax.vmap(environment.step))
    for actions in calls(task, 5, 60, 2):
        observed, state, *_ = step(keys, state, actions)
        assert np.asarray(observed).tobytes() == native.step(actions)[0].tobytes()


def test_the_digest_of_a_task_is_also_that_of_its_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = [tmp_path / name for name in "abc"]
    for folder in folders:
        folder.mkdir()
    digest = lettuce_seen(folders[0]).digest
    assert digest == lettuce_seen(folders[1]).digest
    monkeypatch.setattr(Library, "open", lambda crop, version: small_library(crop, "2"))
    resolver._library.cache_clear()
    assert digest != lettuce_seen(folders[2]).digest


def test_a_view_keeps_it_or_leaves_it_out(task: TaskSpec) -> None:
    names = np.array([column.name for column in task.observed()])
    of_camera = {f"camera_{number}" for number in range(1, 5)}
    assert of_camera <= {*names[visible_columns(task, ["sensors"])]}
    assert {*names} - {*names[visible_columns(task, ["sensors", "-camera"])]} == of_camera
    assert {*names[visible_columns(task, ["camera"])]} == of_camera
    assert of_camera.isdisjoint(names[visible_columns(task, ["blind"])])
    assert "without_camera" in left_out_views(task)


def test_words_say_when_and_of_which_library(task: TaskSpec) -> None:
    (section,) = (one for one in definition_in_words(task) if one.heading.startswith("A camera above the crop"))
    assert section.lines[0].startswith("Every day at 12 h, first at the start")
    assert "toys-1" in section.lines[1]
    assert any(one.heading == section.heading for one in for_growers(task))


def test_mistakes_are_named(tmp_path: Path) -> None:
    def lettuce(more: str, base: str = "LettuceHarvestImages") -> TaskSpec:
        (tmp_path / "wrong.toml").write_text(
            f'base = "glbench/{base}-v1"\nid = "tests/Wrong-v1"\ntitle = "Wrong"\n{more}', encoding="utf-8"
        )
        return get_task(tmp_path / "wrong.toml")

    with pytest.raises(TaskError, match=r"\[observation\] 'camera' shows heads, and greenlight-tomato-1.0.0 has none. Choose a model with"):
        spring(tmp_path / "tomatoes.toml", observation=CAMERA, sensors='\n[camera]\nlibrary = "toys-1"\n')
    with pytest.raises(TaskError, match=r"none is named: add \[camera\] library"):
        spring(tmp_path / "nameless.toml", observation=CAMERA)
    with pytest.raises(
        TaskError, match=r"\[camera\] takes pictures that the task does not show: add \"camera\" to \[observation\] modules"
    ):
        lettuce('[camera]\nlibrary = "toys-1"\n', "LettuceHarvest")
    with pytest.raises(TaskError, match="a whole hour of the day, 1 to 23"):
        lettuce("[camera]\nhour = 24\n")
    with pytest.raises(TaskError, match="a library of pictures with its version in quotes"):
        lettuce('[camera]\nlibrary = "lettuce"\n')
    with pytest.raises(GlbenchError, match=r"wrong.toml: \[camera\]"):
        lettuce('[camera]\nlibrary = "cabbage-1"\n')


@pytest.mark.slow
@pytest.mark.filterwarnings("error")
def test_both_checkers_are_silent(task: TaskSpec, recwarn: pytest.WarningsRecorder) -> None:
    check_that_both_are_silent(task, recwarn)
