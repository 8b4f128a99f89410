"""Sensors that err: against the formulas written anew with NumPy, and against the sizes that the task states."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import ObservationInputs, Simulation, Snapshot, register_observation
from glbench.env.random import uniforms
from glbench.env.uncertainty import stream_key
from glbench.errors import TaskError
from glbench.kernel import Kernel, why_not_compiled
from glbench.model import TOMATO
from glbench.tasks import TaskSpec
from glbench.tasks.quantities import Quantity
from glbench.tasks.vocabulary import ObservationModule
from tests.env.spring import MODULES, SENSORS, spring
from tests.env.stepping import StillKernel, walk

Floats = NDArray[np.float64]

NOISE, BIAS, DRIFT = (0.3, 30.0, 2.0), (0.3, 30.0, 2.0), (0.6, 60.0, 4.0)
OUT, BACK = 0.25 / 48.0, 0.25 / 3.0
"""Chances in a step of 15 minutes: every 2 days, for 3 hours."""

ONLY_NOW = f"[observation]\nmodules = [{MODULES}]\n"
NO_DROPOUTS = SENSORS.replace("dropouts = { days_between = 2.0, hours = 3.0 }", "")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sensors")


@pytest.fixture(scope="module")
def task(folder: Path) -> TaskSpec:
    return spring(folder / "spring.toml", observation=ONLY_NOW)


@pytest.fixture(scope="module")
def always(folder: Path) -> TaskSpec:
    """Without drop-outs."""
    return spring(folder / "always.toml", observation=ONLY_NOW, sensors=NO_DROPOUTS)


def followed(task: TaskSpec, seeds: list[int], kernel: Any = None, steps: int | None = None) -> tuple[Floats, Floats]:
    """What sensors show and what is true of runs without actions, ``(steps + 1, seeds, 3)``."""
    simulation = Simulation(task, len(seeds), kernel or StillKernel())
    shown, true = [simulation.reset(seeds)[:, :3].astype(np.float64)], [simulation.air.T.copy()]
    for _ in range(steps or task.steps):
        result = simulation.step(np.zeros((len(seeds), 6)))
        shown.append(result.observations[:, :3].astype(np.float64))
        true.append(simulation.air.T.copy())
    return np.array(shown), np.array(true)


def expected(task: TaskSpec, seed: int, true: Floats, dropouts: bool) -> Floats:
    """Readings of one run ``(steps + 1, 3)``, number by number."""
    steps = len(true) - 1
    each = 4 if dropouts else 3

    def bell(numbers: Floats) -> float:
        return 2.0 * (float(numbers.sum()) - 1.5)

    def drawn(stream: str, step: int, count: int) -> Floats:
        key = np.array([stream_key(task.scenario, seed, stream)], np.uint64)
        return uniforms(key, np.array([[step]]), count)[0, 0]

    offsets = drawn("sensor offsets", 0, 12)
    shown = np.empty((steps + 1, 3))
    hangs = [False] * 3
    for k in range(steps + 1):
        numbers = drawn("sensors", k, 3 * each)
        for q in range(3):
            own = numbers[q * each : (q + 1) * each]
            bias, drift = bell(offsets[4 * q : 4 * q + 3]) * BIAS[q], (2.0 * offsets[4 * q + 3] - 1.0) * DRIFT[q]
            reading = true[k, q] + NOISE[q] * bell(own[:3]) + bias + drift * k / task.steps
            reading = min(max(reading, (-100.0, 0.0, 0.0)[q]), (200.0, 4.3e6, 100.0)[q])
            if dropouts and k > 1:
                hangs[q] = own[3] < (1.0 - BACK if hangs[q] else OUT)
            shown[k, q] = shown[k - 1, q] if hangs[q] else reading
    return shown


@pytest.mark.parametrize("dropouts", [True, False])
def test_readings_are_the_formula_number_by_number(task: TaskSpec, always: TaskSpec, dropouts: bool) -> None:
    chosen = task if dropouts else always
    seeds = [700, 3, 2**64 - 1]
    shown, true = followed(chosen, seeds)
    for row, seed in enumerate(seeds):
        wanted = expected(chosen, seed, true[:, row], dropouts)
        np.testing.assert_allclose(shown[:, row], wanted, rtol=2e-7, atol=1e-5)
        hung = (np.diff(wanted, axis=0) == 0.0).any()
        assert hung == dropouts


def test_noise_bias_and_drift_have_the_sizes_stated(always: TaskSpec) -> None:
    """2,000 runs of a greenhouse that stands still, 40 steps of each."""
    seeds = list(range(2000))
    shown, true = followed(always, seeds, steps=40)
    error = shown - true
    drifts = np.array(DRIFT) / always.steps  # a step, at most
    for q in range(3):
        if q == 2:  # 100 % cuts off next to nothing
            assert true[..., q].max() < 91.0
        noise = error[1:, :, q] - error[:-1, :, q]
        assert noise.std() == pytest.approx(np.sqrt(2.0) * NOISE[q], rel=0.02)
        assert error[:, :, q].mean(axis=0).std() == pytest.approx(np.hypot(BIAS[q], NOISE[q] / np.sqrt(41)), rel=0.05)
        assert abs(error[:, :, q].mean()) < 4.0 * BIAS[q] / np.sqrt(2000)
        assert abs(noise.mean()) < drifts[q]
    between = np.corrcoef(error[5].T)
    assert np.abs(between[~np.eye(3, dtype=bool)]).max() < 0.08
    one, next_ = (error[k, :, 0] - error[:, :, 0].mean(axis=0) for k in (10, 11))
    assert abs(np.corrcoef(one, next_)[0, 1]) < 0.1


def test_a_drift_grows_evenly_to_its_end_and_is_drawn_evenly(folder: Path) -> None:
    only = '[sensors.air_temperature]\ndrift = { value = 0.6, unit = "degC" }\n'
    drifting = spring(folder / "drift.toml", observation=ONLY_NOW, sensors=only, days=1)
    shown, true = followed(drifting, list(range(400)))
    error = (shown - true)[..., 0]
    assert np.abs(shown - true)[..., 1:].max() < 1e-4
    np.testing.assert_allclose(error, error[-1] * np.linspace(0.0, 1.0, 97)[:, None], atol=3e-6)
    assert np.abs(error[-1]).max() <= 0.6
    assert np.sort(error[-1])[[40, 200, 360]] == pytest.approx([-0.48, 0.0, 0.48], abs=0.06)


def test_drop_outs_come_as_often_and_stay_as_long_as_stated(task: TaskSpec) -> None:
    shown, _ = followed(task, list(range(400)))
    hangs = np.diff(shown, axis=0) == 0.0  # noise never repeats a reading
    assert not hangs[0].any()
    begins = (hangs[1:] & ~hangs[:-1]).sum()
    free = (~hangs[:-1]).sum()
    assert begins / free == pytest.approx(OUT, rel=0.08)
    assert hangs[2:].sum() / begins == pytest.approx(1.0 / BACK, rel=0.08)


def test_a_sensor_that_hangs_shows_what_it_showed_last_from_the_first_step_on(folder: Path) -> None:
    often = SENSORS.replace("days_between = 2.0, hours = 3.0", "days_between = 0.0001, hours = 240.0")
    hanging = spring(folder / "often.toml", observation=ONLY_NOW, sensors=often)
    shown, true = followed(hanging, [1, 2, 3], steps=10)
    assert (np.abs(shown[:2] - true[:2])[..., 0] < 3.0).all()
    assert (shown[0] != shown[1]).all()
    assert (shown[2] == shown[1]).all()


def test_readings_stay_within_their_columns(folder: Path) -> None:
    wild = SENSORS.replace("noise = { value = 2.0", "noise = { value = 90.0").replace("value = 30.0", "value = 900.0")
    wild = wild.replace("noise = { value = 0.3", "noise = { value = 300.0")
    task = spring(folder / "wild.toml", observation=ONLY_NOW, sensors=wild)
    shown, _ = followed(task, list(range(50)), steps=60)
    low, high = (np.array([getattr(q, end) for q in task.observed()[:3]]) for end in ("low", "high"))
    assert (shown >= low).all()
    assert (shown <= high).all()
    assert [(shown[..., q] == low[q]).any() for q in range(3)] == [True, True, True]
    assert [(shown[..., q] == high[q]).any() for q in range(3)] == [True, False, True]


def test_what_is_judged_and_told_is_the_truth(task: TaskSpec, folder: Path) -> None:
    exact = spring(folder / "exact.toml", observation=ONLY_NOW, sensors="")
    pair = [Simulation(one, 4, "fast") for one in (task, exact)]
    for simulation in pair:
        simulation.reset([0, 1, 2, 3])
    for action in walk(1, 40, 4):
        one, other = (simulation.step(action) for simulation in pair)
        assert one.table.tobytes() == other.table.tobytes()
        assert (one.observations[:, :3] != other.observations[:, :3]).any()
        assert one.observations[:, 3:].tobytes() == other.observations[:, 3:].tobytes()
    assert pair[0].air.tobytes() == pair[1].air.tobytes()


@pytest.mark.skipif(why_not_compiled() is not None, reason="needs the compiled kernel")
@pytest.mark.parametrize("threads", [1, 2])
def test_compiled_and_numpy_alone_and_in_a_batch_give_the_same_bits(folder: Path, threads: int) -> None:
    task = spring(folder / f"threads{threads}.toml")
    kernel = Kernel(TOMATO, 900.0, preset="fast", threads=threads)
    seeds = list(range(660, 697))
    fused, plain = Simulation(task, 37, kernel), Simulation(task, 37, kernel, fused=False)
    alone = Simulation(task, 1, kernel)
    assert (fused.fused, plain.fused) == (True, False)
    assert fused.reset(seeds).tobytes() == plain.reset(seeds).tobytes()
    assert fused.observe()[36:].tobytes() == alone.reset(seeds[36:]).tobytes()
    for number, action in enumerate(walk(2, 60, 37)):
        one, other, own = fused.step(action), plain.step(action), alone.step(action[36:])
        assert one.observations.tobytes() == other.observations.tobytes()
        assert one.table.tobytes() == other.table.tobytes()
        assert one.observations[36:].tobytes() == own.observations.tobytes()
        if number == 30:
            assert fused.reset([1, 2], rows=[0, 20]).tobytes() == plain.reset([1, 2], rows=[0, 20]).tobytes()


@pytest.mark.parametrize("fused", [True, False])
def test_copies_go_on_with_sensors_that_hang(task: TaskSpec, fused: bool) -> None:
    simulation = Simulation(task, 30, "fast", fused=fused)
    simulation.reset(range(30))
    shown = [simulation.step(action).observations[:, :3] for action in walk(1, 50, 30)]
    assert (shown[-1] == shown[-2]).any()  # some hang just now
    bytes_of = simulation.snapshot().to_bytes()
    others = [copy.deepcopy(simulation), pickle.loads(pickle.dumps(simulation)), Simulation(task, 30, "fast")]
    assert others[2].restore(Snapshot.from_bytes(bytes_of)).tobytes() == simulation.observe().tobytes()
    for action in walk(5, 20, 30):
        wanted = simulation.step(action).observations.tobytes()
        assert [other.step(action).observations.tobytes() for other in others] == [wanted] * 3


@pytest.mark.usefixtures("own_words")
def test_a_registered_part_is_handed_the_true_air(folder: Path) -> None:
    column = Quantity("felt", "degC", -100.0, 200.0, "air temperature, as it is")

    def make(task: TaskSpec, tables: object) -> Any:
        return lambda inputs: seen(inputs)

    def seen(inputs: ObservationInputs) -> Floats:
        return inputs.air[:1].T

    register_observation(ObservationModule("felt", "of a test", lambda context: (column,)), make)
    observation = f'[observation]\nmodules = [{MODULES}, "felt"]\n'
    simulation = Simulation(spring(folder / "felt.toml", observation=observation, sensors=NO_DROPOUTS), 2, StillKernel())
    shown = simulation.reset([1, 2])
    assert (shown[:, -1] == simulation.air[0].astype(np.float32)).all()
    assert (shown[:, 0] != shown[:, -1]).all()


def test_mistakes_are_named(folder: Path) -> None:
    for wrong, says in (
        ('[sensors.co2]\nnoise = { value = -1.0, unit = "ppm" }', "0 or more"),
        ('[sensors.co2]\nnoise = { value = 1.0, unit = "degC" }', "ppm"),
        ("[sensors]\ndropouts = { days_between = 2.0, hours = 3.0 }", "no sensor that could drop out"),
        ("[sensors.soil]\nnoise = 1.0", "soil"),
    ):
        with pytest.raises(TaskError, match=says):
            spring(folder / "wrong.toml", sensors=wrong)
