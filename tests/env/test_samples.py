"""Samples taken by hand: against the formula written anew with NumPy, sizes, bits, and what refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import Simulation, register_observation
from glbench.env.random import uniforms
from glbench.env.uncertainty import stream_key
from glbench.errors import TaskError
from glbench.kernel import Kernel, why_not_compiled
from glbench.model import TOMATO
from glbench.report.task_words import definition_in_words, for_growers
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.tasks.quantities import Quantity
from glbench.tasks.vocabulary import ObservationModule
from tests.env.spring import MODULES, SENSORS, spring
from tests.env.stepping import StillKernel, walk

Floats = NDArray[np.float64]

SAMPLES = "\n[samples.crop]\nevery_days = 1\nnoise = 0.06\n"
NOW = '[observation]\nmodules = ["crop", "indoor_climate", "time", "controls", "weather"]\n'
NAMES = ("fruit_dry_mass", "canopy_temperature_24h", "temperature_sum")
STATES = [TOMATO.state_index(name) for name in ("cFruit", "tCan24", "tCanSum")]
FACTORS = [1e-6, 1.0, 1.0]
DAY = 96


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("samples")


@pytest.fixture(scope="module")
def task(folder: Path) -> TaskSpec:
    return spring(folder / "samples.toml", observation=NOW, sensors=SENSORS + SAMPLES)


def followed(task: TaskSpec, seeds: list[int], steps: int) -> tuple[NDArray[np.float32], Floats]:
    """What the sampled columns show and what is true of runs without actions, ``(steps + 1, seeds, 3)``."""
    simulation = Simulation(task, len(seeds), StillKernel())
    shown, true = [simulation.reset(seeds)[:, :3]], [simulation.x[:, STATES] * FACTORS]
    for _ in range(steps):
        shown.append(simulation.step(np.zeros((len(seeds), 6))).observations[:, :3])
        true.append(simulation.x[:, STATES] * FACTORS)
    return np.array(shown), np.array(true)


def test_samples_are_the_formula_number_by_number_and_are_held(task: TaskSpec) -> None:
    assert tuple(column.name for column in task.observed()[:3]) == NAMES
    seeds = [700, 3, 2**64 - 1]
    shown, true = followed(task, seeds, task.steps)
    for row, seed in enumerate(seeds):
        for k in range(0, task.steps + 1, DAY):
            stream, step = ("samples", k) if k else ("first samples", 0)
            numbers = uniforms(np.array([stream_key(task.scenario, seed, stream)], np.uint64), np.array([[step]]), 9)[0, 0]
            w = 2.0 * (numbers.reshape(3, 3).sum(axis=1) - 1.5)
            np.testing.assert_allclose(shown[k, row], true[k, row] * (1.0 + 0.06 * w), rtol=3e-7)
    for first in range(0, task.steps, DAY):
        assert (shown[first : first + DAY] == shown[first]).all(), "held to the bit, the first one too"
    assert (np.diff(shown[::DAY], axis=0) != 0.0).all()
    assert (np.diff(true[..., 0], axis=0) > 0.0).all()


def test_errors_have_the_size_stated_and_are_independent(task: TaskSpec) -> None:
    shown, true = followed(task, list(range(1500)), DAY)
    errors = (shown[[0, DAY]] / true[[0, DAY]] - 1.0).transpose(0, 2, 1).reshape(6, -1)
    np.testing.assert_allclose(errors.std(axis=1), 0.06, rtol=0.06)
    assert np.abs(errors.mean(axis=1)).max() < 4.0 * 0.06 / np.sqrt(1500.0)
    assert np.abs(errors).max() < 3.0 * 0.06 + 1e-6
    assert np.abs(np.corrcoef(errors) - np.eye(6)).max() < 0.1


def test_nothing_else_changes_and_without_noise_a_sample_is_the_truth(folder: Path, task: TaskSpec) -> None:
    exact = spring(folder / "exact.toml", observation=NOW, sensors=SENSORS + "[samples.crop]\nevery_days = 2\n")
    every_step = spring(folder / "plain.toml", observation=NOW)
    one, two, plain = (Simulation(task, 2, "fast") for task in (task, exact, every_step))
    seen = [simulation.reset([5, 6]) for simulation in (one, two, plain)]
    assert seen[1].tobytes() == seen[2].tobytes()
    for step, action in enumerate(walk(3, 2 * DAY + 1, 2), 1):
        results = [simulation.step(action) for simulation in (one, two, plain)]
        assert results[0].table.tobytes() == results[2].table.tobytes()
        seen = [result.observations for result in results]
        assert seen[0][:, 3:].tobytes() == seen[2][:, 3:].tobytes()
        if step == 2 * DAY:
            assert seen[1].tobytes() == seen[2].tobytes()
    assert (seen[1][:, :3] != seen[2][:, :3]).all()


@pytest.mark.skipif(why_not_compiled() is not None, reason="needs the compiled kernel")
@pytest.mark.parametrize("directly", [False, True])
def test_compiled_and_numpy_alone_and_in_a_batch_give_the_same_bits(task: TaskSpec, directly: bool) -> None:
    kernel, seeds = Kernel(TOMATO, 900.0, preset="fast"), list(range(660, 677))
    fused, plain, alone = Simulation(task, 17, kernel), Simulation(task, 17, kernel, fused=False), Simulation(task, 1, kernel)
    assert (fused.fused, plain.fused) == (True, False)
    assert fused.reset(seeds).tobytes() == plain.reset(seeds).tobytes()
    assert fused.observe()[16:].tobytes() == alone.reset(seeds[16:]).tobytes()
    for number, action in enumerate(walk(2, DAY + 34, 17)):
        given = np.abs(action).astype(np.float64) if directly else action
        one, other, own = (
            simulation.step_controls(rows) if directly else simulation.step(rows)
            for simulation, rows in ((fused, given), (plain, given), (alone, given[16:]))
        )
        assert one.observations.tobytes() == other.observations.tobytes()
        assert one.observations[16:].tobytes() == own.observations.tobytes()
        if number == 30:
            assert fused.reset([1, 2], rows=[0, 9]).tobytes() == plain.reset([1, 2], rows=[0, 9]).tobytes()
    assert fused.x.tobytes() == plain.x.tobytes()
    saved = fused.snapshot()
    assert plain.restore(saved).tobytes() == fused.observe().tobytes()


def test_an_episode_that_begins_in_the_midst_of_a_season_begins_with_a_sample(task: TaskSpec) -> None:
    simulation, start = Simulation(task, 3, StillKernel()), 40
    simulation.reset([1, 2, 3])
    simulation._environments.k[:] = start
    simulation._observe()
    seen = [simulation.observe()[:, :3]] + [simulation.step(np.zeros((3, 6))).observations[:, :3] for _ in range(DAY + 1)]
    assert (np.abs(seen[0] / (simulation.scenarios.draw([1, 2, 3]).states[:, STATES] * FACTORS) - 1.0) < 0.18).all()
    changed = np.flatnonzero((np.diff(np.array(seen), axis=0) != 0.0).any(axis=(1, 2))) + 1
    assert changed.tolist() == [DAY]


def test_a_sample_stays_within_its_column(folder: Path) -> None:
    wild = spring(folder / "wild.toml", observation=NOW, sensors=SAMPLES.replace("0.06", "0.3"))
    column, place = wild.observed()[1], STATES[1]
    simulation = Simulation(wild, 300, StillKernel())
    simulation.reset(range(300))
    simulation._environments.x[:, place] = column.high - 0.01
    seen = simulation.step(np.zeros((300, 6))).observations[:, 1]
    assert seen.max() == np.float32(column.high)
    assert (seen < column.high).mean() == pytest.approx(0.5, abs=0.15)


def test_the_tomato_is_registered_once_a_week() -> None:
    task = get_task("GreenhouseReal-v1").in_split("validation")
    assert {name: (one.every_days, one.noise) for name, one in task.samples.items()} == {"registration": (7, 0.06)}
    names = [column.name for column in task.observed()]
    columns = [names.index(column.name) for column in task.observed_by("registration")]
    simulation = Simulation(task, 2, StillKernel())
    seen = [simulation.reset([1, 2])[:, columns]]
    seen += [simulation.step(np.zeros((2, len(task.actions)))).observations[:, columns] for _ in range(8 * DAY)]
    changed = np.flatnonzero((np.diff(np.array(seen), axis=0) != 0.0).any(axis=(1, 2))) + 1
    assert changed.tolist() == [7 * DAY]


def test_a_task_without_them_keeps_its_digest_and_one_with_them_says_so(task: TaskSpec, folder: Path) -> None:
    plain = spring(folder / "without.toml", observation=NOW)
    assert "samples" not in plain.definition()
    assert plain.digest != task.digest
    assert task.definition()["samples"] == {"crop": {"every_days": 1, "noise": 0.06}}
    (section,) = (one for one in definition_in_words(task) if one.heading.startswith("Counted or weighed by hand"))
    assert section.lines == ["Crop: every day, first at the start; noise 6 % in each sample and column (standard deviation)."]
    assert any(one.heading == section.heading for one in for_growers(task))
    assert task_card(task).task().samples == task.samples  # an agent knows how far a sample is off


@pytest.mark.usefixtures("own_words")
def test_mistakes_are_named(folder: Path) -> None:
    def read(text: str, modules: str = MODULES) -> TaskSpec:
        return spring(folder / "wrong.toml", observation=f"[observation]\nmodules = [{modules}]\n", sensors=text)

    with pytest.raises(TaskError, match=r"\[samples.corp\] .* does not show. .*'crop'"):
        read(SAMPLES.replace("crop", "corp"))
    with pytest.raises(TaskError, match="a whole number of days, 1 to 366"):
        read(SAMPLES.replace("1\n", "0\n"))
    with pytest.raises(TaskError, match=r"from 0 to 0\.3"):
        read(SAMPLES.replace("0.06", "6.0"))
    with pytest.raises(TaskError, match=r"\[samples.weather\] only modules of greenlight-tomato-1.0.0 can be sampled: .*'crop'"):
        Simulation(read(SAMPLES.replace("crop", "weather")), 1, StillKernel())
    with pytest.raises(TaskError, match=r"\[samples.indoor_climate\] 'air_temperature' is measured by a sensor"):
        Simulation(read(SAMPLES.replace("crop", "indoor_climate")), 1, StillKernel())
    columns = (Quantity("leaf_colour", "-", 0.0, 1.0, "green"),)
    module = ObservationModule("leaf_colour", "of a test", lambda context: columns)
    register_observation(module, lambda task, tables: lambda inputs: np.ones((1, 1)))
    with pytest.raises(TaskError, match=r"\[samples.leaf_colour\] only modules of greenlight-tomato-1.0.0"):
        Simulation(read(SAMPLES.replace("crop", "leaf_colour"), f'{MODULES}, "leaf_colour"'), 1, StillKernel())
