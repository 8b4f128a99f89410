"""The suite lettuce-classic beside the package with which its published returns were made, which need not be installed."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench import extras
from glbench.cli.tasks import check_command
from glbench.control import Scenario, StageReward, StateEstimator
from glbench.env import Simulation, make_accounts
from glbench.errors import GlbenchError, TaskError, WeatherError
from glbench.evaluation.sandbox import visible
from glbench.kernel import Kernel
from glbench.model import LETTUCE_CLASSIC, vapour_density
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.weather import disturbances, load_weather, trace, user_file

Floats = NDArray[np.float64]
Write = Callable[[str], Path]
MOST = np.array([1.2, 7.5, 150.0])  # mg m-2 s-1, mm s-1, W m-2

needs_weather = pytest.mark.skipif(trace.lacks_package(trace.TRACE), reason="the extra lettuce-classic is not installed")


@pytest.fixture(scope="module")
def package() -> Any:
    return pytest.importorskip(trace.PACKAGE)


@pytest.fixture
def task() -> TaskSpec:
    return get_task("LettuceClassic-Delta00-v1")


def off(states: Floats, radiation: Floats) -> Floats:
    return np.zeros((len(states), 3))


def hold(states: Floats, radiation: Floats) -> Floats:
    return np.tile([0.0, 0.0, 1.0 / 3.0], (len(states), 1))


def grower(states: Floats, radiation: Floats) -> Floats:
    """The package's rules of a grower, on what it shows of the air in single precision, as fractions of what is installed."""
    _, co2, temperature, vapour = states.T
    kelvin = temperature + 273.15
    saturated = 610.78 * np.exp(17.2694 * temperature / (temperature + 238.3))
    ppm = 1e6 * 8.3144598 * kelvin * co2 / (101325.0 * 44.01e-3)
    humidity = np.minimum(100.0, 100.0 * 8.3144598 * kelvin / (18.01528e-3 * saturated) * vapour)
    warm, ppm, humidity = (column.astype(np.float32) for column in (temperature, ppm, humidity))
    day = radiation > 50.0
    set_point = np.where(day, 14.0, 10.0)
    vents = np.clip(2.0 * np.maximum(0.0, warm - set_point - 2.0) + 0.5 * np.maximum(0.0, humidity - np.float32(80.0)), 0.0, 7.5)
    dose = np.where(day & (vents <= 2.0), np.clip(0.006 * (750.0 - ppm), 0.0, 1.2), 0.0)
    return np.stack([dose, vents, np.clip(30.0 * (set_point - warm), 0.0, 150.0)], axis=1) / MOST


def returns(task: TaskSpec, seeds: range, rules: Callable[[Floats, Floats], Floats]) -> Floats:
    """Sum of the rewards of each run under rules that ask for controls, each moved by a tenth in a step."""
    simulation = Simulation(task, len(seeds))
    simulation.reset(seeds)
    total = np.zeros(len(seeds))
    while simulation.over < len(seeds):
        wanted = rules(simulation.x, simulation.d[:, 0])
        total += simulation.step(np.clip((wanted - simulation.u) / 0.1, -1.0, 1.0)).rewards
    assert (simulation.k == 1920).all()
    return total


@needs_weather
@pytest.mark.slow
@pytest.mark.parametrize(("rules", "published"), [(off, -64.534725), (hold, -73.571576), (grower, -4.351605)])
def test_nominal_returns_are_the_published_ones(task: TaskSpec, rules: Callable[[Floats, Floats], Floats], published: float) -> None:
    assert returns(task, range(1, 2), rules)[0] == pytest.approx(published, abs=1e-6)


@needs_weather
@pytest.mark.slow
def test_the_mean_with_redrawn_coefficients_is_that_of_the_package() -> None:
    """Of 40 seasons with the package: mean -5.3018, standard deviation 0.1440."""
    ours = returns(get_task("LettuceClassic-Delta05-v1"), range(40), grower)
    error = np.hypot(0.1440, ours.std(ddof=1)) / np.sqrt(40)
    assert ours.mean() == pytest.approx(-5.3018, abs=3.0 * error)
    assert ours.std(ddof=1) == pytest.approx(0.1440, rel=0.4)


def test_a_step_is_that_of_the_package(package: Any) -> None:
    rng, n = np.random.default_rng(1), 100
    x = np.array([0.0021, 3e-4, 5.0, 1e-3]) + np.array([0.3, 3.5e-3, 35.0, 0.03]) * rng.random((n, 4))
    p = LETTUCE_CLASSIC.parameters.default() * (1.0 + 0.05 * rng.uniform(-1.0, 1.0, (n, 23)))
    u, d = rng.random((n, 3)), np.zeros((n, 10))
    d[:, :4] = np.array([-200.0, -5.0, 300.0, 600.0]) + np.array([1200.0, 35.0, 2500.0, 400.0]) * rng.random((n, 4))
    d[:, 0] = np.maximum(d[:, 0], 0.0)
    weather = np.stack([d[:, 0], d[:, 3] * 1e-6, d[:, 1], vapour_density(d[:, 1], d[:, 2])], axis=1)
    integrator = package.VanHentenLettuce().build_integrator(1800.0)
    theirs = [np.asarray(integrator(*row)).ravel() for row in zip(x, u * MOST, weather, p, strict=True)]
    np.testing.assert_allclose(Kernel(LETTUCE_CLASSIC, 1800.0).step(x, u, d, p), theirs, rtol=1e-12)


def test_coefficients_are_those_of_the_package(package: Any) -> None:
    assert LETTUCE_CLASSIC.parameters.default().tolist() == [one.default for one in package.MODEL_COEFFS]


@pytest.mark.slow
def test_observations_and_rewards_are_those_of_the_package(package: Any, task: TaskSpec) -> None:
    """With the window of weather of now and two steps ahead."""
    ahead = task.replace({"observation.forecast.steps": 2})
    config = package.EnvConfig(
        weather_window=3, timestep_encoding=importlib.import_module(f"{trace.PACKAGE}.config").TimestepEncoding.INDEX
    )
    theirs, ours = package.LettuceGreenhouseEnv(config), Simulation(ahead, 1)
    rng, (shown, _) = np.random.default_rng(2), theirs.reset(seed=1)
    np.testing.assert_allclose(ours.reset([1])[0], shown, rtol=1e-6)
    for _ in range(300):
        action = rng.uniform(-1.0, 1.0, 3).astype(np.float32)
        shown, reward, *_ = theirs.step(action)
        result = ours.step(action[None])
        np.testing.assert_allclose(result.observations[0], shown, rtol=1e-6, atol=1e-9)
        assert result.rewards[0] == pytest.approx(reward, abs=1e-12)


@needs_weather
def test_states_are_estimated_and_plans_improve(task: TaskSpec) -> None:
    """The estimator begins with the controls of the task, and a gradient of the season's return is that of the map."""
    estimator, scenario, stage = StateEstimator(task), Scenario.of(task, 1), StageReward(task)
    assert estimator.controls[0].tolist() == task.initial_controls.tolist() == scenario.u_before.tolist()
    kernel, u = Kernel(LETTUCE_CLASSIC, 1800.0), np.tile(task.initial_controls, (48, 1))

    def earned(u: Floats) -> float:
        return float(stage(kernel.rollout(scenario.x0, u, scenario.d[:48], scenario.p), u).reward.sum())

    trajectory = kernel.linearise_trajectory(scenario.x0, u, scenario.d[:48], scenario.p)
    _, slopes = stage.gradient(trajectory.x, u)
    gradient = slopes.controls + trajectory.pull(slopes.states).u
    change = np.zeros_like(u)
    change[10:20, 2] = 1e-6
    assert earned(u + change) - earned(u - change) == pytest.approx(2.0 * (gradient * change).sum(), rel=1e-3)
    simulation = Simulation(task, 1)
    observed = simulation.reset([1])
    estimator.update(observed, simulation.d)
    for _ in range(3):
        weather = simulation.d
        observed = simulation.step(np.full((1, 3), -0.5)).observations
        states = estimator.update(observed, weather)
    np.testing.assert_allclose(states, simulation.x, rtol=1e-4)


@needs_weather
def test_rows_are_the_nearest_samples() -> None:
    record = load_weather(trace.TRACE)
    assert isinstance(record, trace.WeatherTrace)
    rows = disturbances(record, start=np.datetime64("2014-02-09").item(), steps=3, step_seconds=1800.0, preprocessing="sampled")
    samples = record.samples[[30 * 288, 30 * 288 + 6, 30 * 288 + 12]]
    assert np.array_equal(rows.values[:, [1, 4]], samples[:, [1, 3]])
    assert (rows.hour_of_day.tolist(), str(rows.times[0])) == ([0.0, 0.5, 1.0], "2014-02-08T23:00:00")
    with pytest.raises(WeatherError, match="choose 'sampled'"):
        disturbances(record, start=np.datetime64("2014-02-09").item(), steps=3)
    with pytest.raises(WeatherError, match="choose 'paper' or 'conserving'"):
        disturbances(load_weather("schiphol"), start=np.datetime64("2010-03-01").item(), steps=3, preprocessing="sampled")
    assert user_file(trace.TRACE) is None


@needs_weather
def test_another_file_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace, "FILE_DIGEST", "0" * 64)
    trace._read.cache_clear()
    with pytest.raises(WeatherError, match=r"is not the file of the weather 'bleiswijk_2014'.*Install lettuce-greenhouse-gym 0\.1\.3"):
        load_weather(trace.TRACE)


def test_without_the_extra_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda module: None)
    with pytest.raises(GlbenchError, match=r'needs packages.*lettuce_greenhouse_gym.*pip install "glbench\[lettuce-classic\]"'):
        load_weather(trace.TRACE)
    monkeypatch.setattr("glbench.cli.tasks.check_all", dict)
    monkeypatch.setattr("glbench.registration.draft_files", list)
    files = [data_folder("tasks") / f"lettuceclassic-delta{level}-v1.toml" for level in ("00", "05")]
    monkeypatch.setattr("glbench.registration.task_files", lambda: files)
    check_command(None)
    names = ", ".join(file.stem for file in files)
    assert f"an extra with their weather, or glbench-data with their pictures, is missing: {names}." in capsys.readouterr().err


def test_the_sandbox_hides_the_weather() -> None:
    assert f"{trace.PACKAGE}/data" in visible._DATA_OF_PACKAGES


HEATED = """
base = "glbench/Schiphol2010-Delta10-v1"
schema = 2
id = "mylab/Heated-v1"
title = "The boiler runs before the first step"

[weather]
days = 2

[initial_state.controls]
uBoil = { value = 65.0, unit = "W m-2" }
"""


def test_controls_before_the_first_step_are_in_force_everywhere(write: Write) -> None:
    task, plain = get_task(write(HEATED)), get_task(write(HEATED.partition("[initial_state")[0]))
    share = 65.0 / task.capacities()[0].at_one
    assert task.initial_controls.tolist() == [share, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert not plain.initial_controls.any()
    assert task.digest != plain.digest
    simulation = Simulation(task, 2)
    simulation.reset([1, 2])
    assert simulation.u[1].tolist() == task.initial_controls.tolist()
    simulation.step(np.zeros((2, 6)))
    assert simulation.u[0, 0] == share
    assert simulation.result.quantities["actuator_travel"].tolist() == [0.0, 0.0]
    assert Scenario.of(task, 1).u_before[0] == share


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('uBoil = { value = 65.0, unit = "kW m-2" }', r"controls\.uBoil = 65 kW m-2 is not allowed\. It must be 0 to 130 W m-2"),
        ('uBoil = { value = 650.0, unit = "W m-2" }', r"controls\.uBoil = 650 W m-2 is not allowed"),
        ('uBoiler = { value = 65.0, unit = "W m-2" }', r"moves no control 'uBoiler'.*uBoil"),
        ("uBoil = 65.0", "Write uBoil with its unit"),
    ],
)
def test_controls_that_cannot_be_are_refused(write: Write, line: str, words: str) -> None:
    with pytest.raises(TaskError, match=words):
        get_task(write(f"{HEATED.rpartition('uBoil')[0]}{line}\n"))


PRICED = """
base = "glbench/Schiphol2010-Delta10-v1"
schema = 2
id = "mylab/Priced-v1"
title = "Too cold costs more than too hot"

[weather]
days = 2

[reward]
modules = ["epi", "scaled_penalty"]

[reward.violation_price]
air_temperature = { low = 0.02, high = 0.01, unit = "EUR m-2 degC-1 h-1" }
co2 = { value = 1e-4, unit = "EUR m-2 ppm-1 h-1" }
relative_humidity = { low = 1.4e-3, high = 1.4e-3, unit = "EUR m-2 %-1 h-1" }
"""


def test_violations_have_a_price_for_each_side(write: Write) -> None:
    task = get_task(write(PRICED))
    states = np.zeros((2, 28))
    air = np.array([[5.0, 44.0], [1000.0, 1000.0], [70.0, 70.0]])  # 10 K below the lowest, 10 K above the highest
    rows = make_accounts(task).quantities(states, states, np.zeros((2, 6)), air)
    penalty = rows[[quantity.name for quantity in task.quantities].index("penalty")]
    assert penalty == pytest.approx([10 * 0.02 / 4, 10 * 0.01 / 4])
    limit = task_card(task).constraints[0]
    assert (limit.price, limit.lower_price) == (0.01, 0.02)
    equal = PRICED.replace("low = 1.4e-3, high = 1.4e-3", "value = 1.4e-3")
    assert get_task(write(equal)).digest == task.digest
    with pytest.raises(TaskError, match="It must be a price above 0"):
        get_task(write(PRICED.replace("high = 0.01", "high = 0.0")))
