"""Vapour deficits, light of the day and local time: independent formulas, sums step by step, equal bits in both environments."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from glbench.env import GreenhouseEnv, Simulation
from glbench.env.air import AIR
from glbench.env.daily_sums import daily_sum, daily_sums
from glbench.env.observations import column_sources
from glbench.env.weather_pool import WeatherTables
from glbench.kernel import StepFailure
from glbench.kernel.tape import Recorder, RecordingError, with_simplification
from glbench.model import Air, ObservedColumn, humidity_deficit, vapour_pressure_deficit
from glbench.model.expressions import cos, exp, fmax
from glbench.resources import data_folder
from glbench.tasks import TaskSpec, get_task
from tests.env.stepping import Floats, StillKernel, walk
from tests.support import write_lettuce_task

MakeTask = Callable[..., TaskSpec]
MODULES = ("vapour_deficit", "light_today", "local_time")
NAMES = (*("vapour_pressure_deficit", "humidity_deficit", "radiation_today", "par_today"), *("hour_of_day", "day_of_year"))
OBSERVED = ('"controls", "weather"]', '"controls", "weather", "vapour_deficit", "light_today", "local_time"]')
PUBLISHED = ('timing = "current"', 'timing = "published"')


@pytest.fixture(scope="module")
def task(make_task: MakeTask) -> TaskSpec:
    """Two days on a clock that is UTC."""
    return make_task(OBSERVED, days=2)


def local_task(folder: Path, start: str, days: int = 2) -> TaskSpec:
    """A task on the Dutch clock, in one season that begins on a day."""
    path = write_lettuce_task(folder)
    text = path.read_text(encoding="utf-8")
    for old, new in (
        OBSERVED,
        ("start = 2010-03-01", f"start = {start}"),
        ("days = 2", f"days = {days}"),
        ("step_seconds = 3600", "step_seconds = 900"),
        ("years = [2010, 2011, 2012]\nstart_within_days = 14\n", ""),
    ):
        assert old in text, old
        text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    return get_task(str(path))


class Standing:
    """A kernel in which nothing moves, of any model."""

    def try_step(self, x: Floats, u: Floats, d: Floats, p: Floats) -> tuple[Floats, list[StepFailure]]:
        return x.copy(), []


def seen(simulation: Simulation, row: int = 0) -> dict[str, float]:
    names = [quantity.name for quantity in simulation.task.observed()]
    return dict(zip(names, simulation.observe()[row].tolist(), strict=True))


@pytest.mark.parametrize(
    ("temperature", "humidity", "pressure", "water"),
    [
        # Saturation over water by Wexler's tables (ASHRAE): 2.3388, 3.1690, 1.2282 kPa at 20, 25, 10 degC; vapour density p M / (R T).
        (20.0, 80.0, 0.46776, 3.457),
        (25.0, 60.0, 1.26760, 9.212),
        (10.0, 90.0, 0.12282, 0.9398),
    ],
)
def test_deficits_are_those_of_steam_tables_within_a_percent(temperature: float, humidity: float, pressure: float, water: float) -> None:
    assert vapour_pressure_deficit(temperature, humidity) == pytest.approx(pressure, rel=0.01)
    assert humidity_deficit(temperature, humidity) == pytest.approx(water, rel=0.01)


def test_deficits_are_those_of_the_models_own_saturation() -> None:
    saturation = 610.78 * math.exp(17.2694 * 22.5 / (22.5 + 238.3))
    assert vapour_pressure_deficit(22.5, 70.0) == pytest.approx(0.3 * saturation / 1000.0, rel=1e-14)
    assert humidity_deficit(22.5, 70.0) == pytest.approx(0.3 * saturation * 18.01528 / (8.3144598 * (22.5 + 273.15)), rel=1e-14)
    assert vapour_pressure_deficit(22.5, 100.0) == humidity_deficit(22.5, 100.0) == 0.0


def test_the_air_of_formulas_is_that_of_the_simulation() -> None:
    assert Air._fields == tuple(AIR)


def test_the_columns_have_units_and_finite_bounds_that_hold(task: TaskSpec) -> None:
    columns = {quantity.name: quantity for quantity in task.observed()}
    units = [columns[name].unit for name in NAMES]
    assert units == ["kPa", "g m-3", "J cm-2", "mol m-2", "h", "day"]
    assert all(np.isfinite([columns[name].low, columns[name].high]).all() for name in NAMES)
    simulation = Simulation(task, 1, "fast")
    simulation.reset([1])
    for _ in range(task.steps):
        simulation.step(np.array([[1.0, 1.0, -1.0, -1.0, 1.0, -1.0]]))  # all lamps, all heat, everything shut
        values = seen(simulation)
        assert all(columns[name].low <= values[name] <= columns[name].high for name in NAMES)


@pytest.mark.parametrize("timing", [(), (PUBLISHED,)], ids=["current", "published"])
def test_compiled_and_plain_have_the_same_bits_alone_and_in_a_batch(make_task: MakeTask, timing: tuple[tuple[str, str], ...]) -> None:
    task = make_task(OBSERVED, *timing, days=2)
    compiled, plain, alone = (Simulation(task, 3, "fast"), Simulation(task, 3, "fast", fused=False), Simulation(task, 1, "fast"))
    assert not plain.fused
    assert compiled.reset([1, 2, 3]).tobytes() == plain.reset([1, 2, 3]).tobytes()
    alone.reset([3])
    for number, action in enumerate(walk(4, 120, 3)):
        if number == 40:
            controls = np.full((3, 6), 0.4)
            results = [simulation.step_controls(controls[: simulation.n]) for simulation in (compiled, plain, alone)]
        else:
            results = [compiled.step(action), plain.step(action), alone.step(action[2:])]
        first, second, single = (result.observations for result in results)
        assert first.tobytes() == second.tobytes()
        assert first[2].tobytes() == single[0].tobytes()


@pytest.mark.parametrize("timing", [(), (PUBLISHED,)], ids=["current", "published"])
def test_light_is_the_sum_of_what_came_since_midnight_and_nothing_of_what_comes(
    make_task: MakeTask, timing: tuple[tuple[str, str], ...]
) -> None:
    task = make_task(OBSERVED, *timing, days=2)
    simulation = Simulation(task, 1, StillKernel())
    simulation.reset([1])
    weather = task.disturbances().values
    radiation = photons = 0.0
    for k, action in enumerate(walk(9, 150, 1)):
        assert seen(simulation)["radiation_today"] == pytest.approx(radiation, rel=1e-6, abs=1e-9)
        assert seen(simulation)["par_today"] == pytest.approx(photons, rel=1e-6, abs=1e-9)
        simulation.step(action)
        if k == 95:  # midnight: a new day begins
            radiation = photons = 0.0
            continue
        radiation += weather[k, 0] * 900.0 / 1e4
        photons += par(weather[k, 0], *simulation.u[0].tolist()) * 900.0 * 1e-6
    assert radiation > 10.0
    assert photons > 1.0


def par(sun: float, boiler: float, co2: float, thermal: float, vents: float, lamps: float, blackout: float) -> float:
    """Photons above the canopy [umol m-2 s-1] of the paper's greenhouse: roof, two screens and lamp layer as slabs that reflect."""
    layers = [(0.57, 0.13), (1.0 - 0.25 * thermal, 0.35 * thermal), (1.0 - 0.99 * blackout, 0.35 * blackout), (0.95, 0.0)]
    through, back = layers[0]
    for transmitted, reflected in layers[1:]:
        between = 1.0 - back * reflected
        through, back = through * transmitted / between, reflected + transmitted**2 * back / between
    return 4.6 * 0.5 * 0.9 * sun * through + 5.2 * 0.31 * 116.0 * lamps


def test_the_day_begins_at_midnight_by_the_clock_of_the_place(tmp_path: Path) -> None:
    """In the Netherlands in summer, two hours before that of UTC; the day on which summer time begins has 23 hours."""
    task = local_task(tmp_path, "2010-03-27", days=3)
    simulation = Simulation(task, 1, Standing())
    simulation.reset([10000])
    lamps = np.zeros((1, 6))
    lamps[0, 4] = 1.0
    before, highest, fell = -1.0, [], []
    for _ in range(task.steps - 48):
        values, utc = seen(simulation), str(simulation.time[0])
        if values["par_today"] < before:
            fell.append(utc)
            highest.append(before)
            assert values["par_today"] == values["hour_of_day"] == 0.0
        before = values["par_today"]
        simulation.step_controls(lamps)
    assert [moment[:16] for moment in fell] == ["2010-03-27T23:00", "2010-03-28T22:00"]
    weather = task.disturbances()
    days = [weather.values[first:last, 0].sum() for first, last in ((0, 96), (96, 188))]
    sun = [par(1.0, 0, 0, 0, 0, 0, 0) * 900e-6 * total for total in days]
    lit = [900e-6 * par(0.0, 0, 0, 0, 0, 1.0, 0) * (steps - 1) for steps in (96, 92)]  # without the step before midnight
    assert highest == pytest.approx([a + b for a, b in zip(sun, lit, strict=True)], rel=1e-5)


def test_local_time_is_the_clock_of_info(tmp_path: Path) -> None:
    task = local_task(tmp_path, "2010-03-27")
    environment = GreenhouseEnv(task, kernel="fast")
    observation, info = environment.reset(seed=1)
    for _ in range(5):
        names = [quantity.name for quantity in task.observed()]
        values = dict(zip(names, observation.tolist(), strict=True))
        for name in ("hour_of_day", "day_of_year"):
            assert values[name] == np.float32(info[name])
        observation, *_, info = environment.step(np.zeros(6, np.float32))
    assert values["hour_of_day"] == 1.0
    assert values["day_of_year"] == pytest.approx(85.0 + 1.0 / 24.0)
    assert str(environment.simulation.time[0])[:16] == "2010-03-27T00:15"


def test_deficits_follow_the_air_that_is_handed_in_and_never_the_state(task: TaskSpec) -> None:
    """The tape is recorded from given values: a sensor that errs errs there, too."""
    deficits = column_sources("vapour_deficit", task, WeatherTables.of(task))
    assert len(deficits) == 2
    with Recorder() as recorder:
        air = [recorder.input("given", place) for place in range(3)]
        for column, shown in enumerate(deficits):
            assert isinstance(shown, ObservedColumn)
            recorder.output("observation", column, with_simplification(lambda *air, of=shown.of_air: of(Air(*air)), *air))
    tape = recorder.tape()
    assert not tape.reads("after")
    assert not tape.reads("before")
    given = {0: np.array([20.0, 31.0]), 1: np.array([400.0, 500.0]), 2: np.array([80.0, 45.0])}
    found = [values for _, _, values in tape.play(lambda source, index: given[index])]
    assert found[0] == pytest.approx(vapour_pressure_deficit(given[0], given[2]), rel=1e-14)
    assert found[1] == pytest.approx(humidity_deficit(given[0], given[2]), rel=1e-14)


def test_a_snapshot_keeps_the_light_of_the_day(task: TaskSpec) -> None:
    first, second = Simulation(task, 2, "fast"), Simulation(task, 2, "fast")
    first.reset([1, 2])
    actions = walk(3, 60, 2)
    for action in actions[:50]:
        first.step(action)
    assert second.restore(first.snapshot()).tobytes() == first.observe().tobytes()
    assert seen(first)["radiation_today"] > 0.0
    for action in actions[50:]:
        assert first.step(action).observations.tobytes() == second.step(action).observations.tobytes()


def test_a_new_episode_begins_without_light(task: TaskSpec) -> None:
    simulation = Simulation(task, 2, "fast")
    simulation.reset([1, 2])
    for action in walk(3, 50, 2):
        simulation.step(action)
    simulation.reset([3], rows=[1])
    assert seen(simulation, row=1)["radiation_today"] == 0.0
    assert seen(simulation, row=0)["radiation_today"] > 0.0


def test_sums_of_a_run_have_the_bits_of_its_steps() -> None:
    rng = np.random.default_rng(2)
    hours = (np.arange(601) * 0.25 + 0.1) % 24.0
    rates = rng.uniform(0.0, 1.0, 600)
    sums = daily_sums(rates, hours, 900.0)
    so_far = 0.0
    for k in range(600):
        so_far = float(daily_sum(so_far, rates[k], hours[k], hours[k + 1], 900.0))
        assert sums[k + 1] == so_far
    (midnight,) = np.flatnonzero(hours[1:200] < hours[:199] - 12.0)[:1]
    assert sums[midnight + 1] == pytest.approx(rates[midnight] * 0.1 * 3600.0)  # the part of the step after midnight


def test_summer_time_ends_without_a_new_day() -> None:
    hours = np.array([1.75, 2.0, 2.25, 2.5, 2.75, 2.0, 2.25])
    assert daily_sums(np.ones(6), hours, 900.0).tolist() == [900.0 * k for k in range(7)]


def test_a_formula_is_recorded_with_the_bits_of_the_models_function() -> None:
    def formula(a: object, b: object) -> object:
        return fmax(exp(a * a) / (1 + b), 2 * b) - 1 / a  # type: ignore[operator]

    with Recorder() as recorder:
        recorder.output("table", 0, with_simplification(formula, *(recorder.input("given", k) for k in range(2))))
    given = {0: np.array([0.3, -1.2, 2.5]), 1: np.array([0.0, 7.0, 1.5])}
    ((_, _, values),) = recorder.tape().play(lambda source, index: given[index])
    assert values.tolist() == pytest.approx(np.asarray(formula(given[0], given[1])).tolist(), rel=1e-15)
    with Recorder() as recorder:
        recorder.output("table", 0, with_simplification(cos, recorder.input("given", 0)))
    with pytest.raises(RecordingError, match="OP_COS, which cannot be recorded"):
        recorder.tape()


@pytest.mark.filterwarnings("error")
def test_both_checkers_are_silent(task: TaskSpec) -> None:
    environment = gymnasium.make("glbench:glbench/Schiphol2010-Delta10-v1", task=task, kernel="fast")
    check_env(environment.unwrapped, skip_render_check=True)
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="Stable-Baselines3 is not installed")
    checker.check_env(environment.unwrapped, warn=True)


def test_deficits_err_with_the_sensors_and_the_light_of_unseen_seasons_is_summed(tmp_path: Path) -> None:
    text = (data_folder("tasks") / "spring-v1.toml").read_text(encoding="utf-8")
    for old, new in (
        ('id = "glbench/Spring-v1"', 'id = "test/Spring-v1"'),
        ('"weather", ', '"weather", "vapour_deficit", "light_today", '),
    ):
        assert old in text, old
        text = text.replace(old, new, 1)
    (tmp_path / "spring.toml").write_text(text, encoding="utf-8")
    task = get_task(str(tmp_path / "spring.toml"))
    compiled, plain = Simulation(task, 2, "fast"), Simulation(task, 2, "fast", fused=False)
    assert compiled.fused
    assert compiled.reset([1, 2]).tobytes() == plain.reset([1, 2]).tobytes()
    off, radiation = [], 0.0
    for action in walk(5, 60, 2):
        acting, hour = float(compiled.d[0, 0]), float(compiled.hour_of_day[0])
        first = compiled.step(action)
        assert first.observations.tobytes() == plain.step(action).observations.tobytes()
        values = seen(compiled)
        shown = vapour_pressure_deficit(values["air_temperature"], values["relative_humidity"])
        assert values["vapour_pressure_deficit"] == pytest.approx(shown, rel=1e-5, abs=1e-6)
        temperature, _, humidity = compiled.air[:, 0].tolist()
        off.append(abs(values["vapour_pressure_deficit"] - vapour_pressure_deficit(temperature, humidity)))
        radiation = 0.0 if compiled.hour_of_day[0] < hour else radiation + acting * 900.0 / 1e4
        assert values["radiation_today"] == pytest.approx(radiation, rel=1e-6, abs=1e-9)
    assert np.mean(off) > 1e-3
    assert radiation > 10.0
