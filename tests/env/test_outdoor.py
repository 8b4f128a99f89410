"""Sensors of the weather that err: against the formula written anew and the sizes that the task states; and nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.control import Climatology, Outlook
from glbench.env import Simulation
from glbench.env.air import read_air
from glbench.env.memory_layout import DrawPlaces
from glbench.env.outdoor import MEASURED, OutdoorSensors
from glbench.env.process_computer import MEMORY, Measured, work
from glbench.env.random import uniforms
from glbench.env.scenario import RunScenarios
from glbench.env.uncertainty import stream_key
from glbench.errors import TaskError
from glbench.kernel import Kernel, why_not_compiled
from glbench.model import TOMATO, humidity_deficit
from glbench.report.task_words import definition_in_words, for_growers
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.weather import COLUMNS
from tests.env.spring import HOURS, MODULES, SENSORS, spring
from tests.env.stepping import StillKernel, walk

Floats = NDArray[np.float64]

OUTDOOR = """
[outdoor_sensors.global_radiation]
scale = { low = 0.88, high = 1.0 }
noise = 0.02
[outdoor_sensors.outdoor_temperature]
noise = { value = 0.3, unit = "degC" }
bias = { value = 0.5, unit = "degC" }
[outdoor_sensors.outdoor_relative_humidity]
noise = { value = 1.0, unit = "%" }
bias = { value = 3.0, unit = "%" }
[outdoor_sensors.wind_speed]
scale = { low = 0.7, high = 1.3 }
noise = 0.1
"""
SCALE_ONLY = """
[outdoor_sensors.global_radiation]
scale = { low = 0.88, high = 1.0 }
[outdoor_sensors.wind_speed]
scale = { low = 0.7, high = 1.3 }
"""
NOW = '[observation]\nmodules = ["weather", "indoor_climate", "time", "controls", "light_today"]\n'
ALL = f"""
[observation]
modules = [{MODULES}, "light_today", "weather_forecast"]
[observation.forecast]
hours = {list(HOURS)}
error = "medium"
"""
RADIATION, TEMPERATURE, HUMIDITY, CO2, WIND = range(5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("outdoor")


@pytest.fixture(scope="module")
def task(folder: Path) -> TaskSpec:
    return spring(folder / "outdoor.toml", observation=NOW, sensors=SENSORS + OUTDOOR)


def acting(simulation: Simulation) -> Floats:
    """The weather that acts next, as right sensors would show it ``(n, 5)``."""
    radiation, temperature, pressure, co2, wind = (
        np.ascontiguousarray(simulation.d[:, COLUMNS.index(name)]) for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")
    )
    _, ppm, humidity = read_air(temperature, co2, pressure)
    return np.stack([radiation, temperature, humidity, ppm, wind], axis=1)


def followed(task: TaskSpec, seeds: list[int], steps: int) -> tuple[Floats, Floats]:
    """What the first five columns show and what is true of runs without actions, ``(steps + 1, seeds, 5)``."""
    simulation = Simulation(task, len(seeds), StillKernel())
    shown, true = [simulation.reset(seeds)[:, :5]], [acting(simulation)]
    for _ in range(steps):
        shown.append(simulation.step(np.zeros((len(seeds), 6))).observations[:, :5])
        true.append(acting(simulation))
    return np.array(shown, float), np.array(true)


def test_readings_are_the_formula_number_by_number(task: TaskSpec) -> None:
    seeds = [700, 3, 2**64 - 1]
    shown, true = followed(task, seeds, task.steps)
    assert (true[..., RADIATION] == 0.0).any()

    def bell(numbers: Floats) -> float:
        return 2.0 * (float(numbers.sum()) - 1.5)

    for row, seed in enumerate(seeds):
        keys = [np.array([stream_key(task.scenario, seed, name)], np.uint64) for name in ("outdoor sensor offsets", "outdoor sensors")]
        run = uniforms(keys[0], np.array([[0]]), 12)[0, 0]
        for k in range(task.steps + 1):
            w = [bell(numbers) for numbers in uniforms(keys[1], np.array([[k]]), 12)[0, 0].reshape(4, 3)]
            radiation, temperature, humidity, co2, wind = true[k, row]
            wanted = [
                radiation * (0.88 + 0.12 * run[0]) * (1.0 + 0.02 * w[0]),
                temperature + 0.5 * bell(run[3:6]) + 0.3 * w[1],
                min(max(humidity + 3.0 * bell(run[6:9]) + 1.0 * w[2], 0.0), 100.0),
                co2,
                wind * (0.7 + 0.6 * run[9]) * (1.0 + 0.1 * w[3]),
            ]
            np.testing.assert_allclose(shown[k, row], wanted, rtol=3e-7, atol=1e-5)


def test_a_scale_holds_for_the_run_and_is_drawn_evenly(folder: Path) -> None:
    scaled = spring(folder / "scaled.toml", observation=NOW, sensors=SCALE_ONLY)
    shown, true = followed(scaled, list(range(500)), 60)
    for place, low, high in ((RADIATION, 0.88, 1.0), (WIND, 0.7, 1.3)):
        share = np.where(true[..., place] > 0.1, shown[..., place] / np.maximum(true[..., place], 0.1), np.nan)
        held = np.nanmean(share, axis=0)
        assert np.nanmax(np.abs(share - held)) < 1e-5
        within = (held - low) / (high - low)
        assert np.nanquantile(within, [0.1, 0.5, 0.9]) == pytest.approx([0.1, 0.5, 0.9], abs=0.08)
        assert low <= np.nanmin(held) <= np.nanmax(held) <= high
    assert (shown[..., RADIATION][true[..., RADIATION] == 0.0] == 0.0).all()
    np.testing.assert_allclose(shown[..., [TEMPERATURE, HUMIDITY, CO2]], true[..., [TEMPERATURE, HUMIDITY, CO2]], rtol=3e-7, atol=1e-5)
    both = RunScenarios(scaled).draw(list(range(500))).traits
    assert abs(np.corrcoef(both.T)[0, 1]) < 0.15


def test_spreads_are_those_of_what_is_drawn(task: TaskSpec, folder: Path) -> None:
    """How far the truth is from a reading over the middle of its scale: of scales as a share, of the bias as a difference."""
    erring = OutdoorSensors.of(task, DrawPlaces())
    traits = erring.traits(np.random.default_rng(2).uniform(size=(20_000, erring.trait_numbers)))
    radiation, temperature, _, wind = traits.T  # in the order of the task's tables
    shares = (scale / middle - 1.0 for scale, middle in ((radiation, 0.94), (wind, 1.0)))
    measured = [*(float(share.std()) for share in shares), float(temperature.std())]
    spreads = erring.spreads
    assert [spreads[name][0] for name in ("iGlob", "wind", "tOut")] == pytest.approx(measured, rel=0.03)
    assert {name: scaled for name, (_, scaled) in spreads.items()} == {"iGlob": True, "tOut": False, "wind": True}
    assert OutdoorSensors.of(spring(folder / "none.toml", observation=NOW), DrawPlaces()).spreads == {}


def test_noise_and_bias_have_the_sizes_stated(task: TaskSpec) -> None:
    shown, true = followed(task, list(range(1000)), 40)
    temperature = (shown - true)[..., TEMPERATURE]
    assert np.diff(temperature, axis=0).std() == pytest.approx(np.sqrt(2.0) * 0.3, rel=0.02)
    assert temperature.mean(axis=0).std() == pytest.approx(np.hypot(0.5, 0.3 / np.sqrt(41.0)), rel=0.06)
    assert abs(temperature.mean()) < 4.0 * 0.5 / np.sqrt(1000.0)
    windy = (true[..., WIND] > 0.1).all(axis=0)
    share = shown[:, windy, WIND] / true[:, windy, WIND]
    assert (share / share.mean(axis=0)).std() == pytest.approx(0.1, rel=0.03)


def test_what_acts_and_what_is_forecast_is_the_truth(folder: Path) -> None:
    pair = [spring(folder / f"pair{len(text)}.toml", observation=ALL, sensors=SENSORS + text) for text in ("", OUTDOOR)]
    exact, erring = (Simulation(one, 4, "fast") for one in pair)
    names = [column.name for column in pair[0].observed()]
    seen = [place for place, name in enumerate(names) if name in MEASURED or name in ("radiation_today", "par_today")]
    others = np.setdiff1d(np.arange(len(names)), seen)
    assert exact.reset([0, 1, 2, 3])[:, others].tobytes() == erring.reset([0, 1, 2, 3])[:, others].tobytes()
    for action in walk(1, 60, 4):
        one, other = exact.step(action), erring.step(action)
        assert one.table.tobytes() == other.table.tobytes()
        assert one.observations[:, others].tobytes() == other.observations[:, others].tobytes()
        assert exact.x.tobytes() == erring.x.tobytes()
    differs = {names[place] for place in seen if (one.observations[:, place] != other.observations[:, place]).all()}
    assert differs == {*MEASURED, "radiation_today", "par_today"} - {"outdoor_co2"}


@pytest.mark.skipif(why_not_compiled() is not None, reason="needs the compiled kernel")
@pytest.mark.parametrize("kind", ["rate", "process_computer"])
@pytest.mark.parametrize("timing", ["current", "published"])
def test_compiled_and_numpy_alone_and_in_a_batch_give_the_same_bits(folder: Path, kind: str, timing: str) -> None:
    observation = ALL.replace("modules", f'timing = "{timing}"\nmodules', 1)
    given = f'{observation}[actuation]\nkind = "{kind}"\n'
    task = spring(folder / f"bits-{kind}-{timing}.toml", observation=given, sensors=SENSORS + OUTDOOR)
    kernel = Kernel(TOMATO, 900.0, preset="fast")
    seeds, m = list(range(660, 677)), len(task.actions)
    fused, plain, alone = Simulation(task, 17, kernel), Simulation(task, 17, kernel, fused=False), Simulation(task, 1, kernel)
    assert (fused.fused, plain.fused) == (True, False)
    assert fused.reset(seeds).tobytes() == plain.reset(seeds).tobytes()
    assert fused.observe()[16:].tobytes() == alone.reset(seeds[16:]).tobytes()
    for number, action in enumerate(walk(2, 110, 17, m)):
        one, other, own = fused.step(action), plain.step(action), alone.step(action[16:])
        assert one.observations.tobytes() == other.observations.tobytes()
        assert one.table.tobytes() == other.table.tobytes()
        assert one.observations[16:].tobytes() == own.observations.tobytes()
        if number == 30:
            assert fused.reset([1, 2], rows=[0, 9]).tobytes() == plain.reset([1, 2], rows=[0, 9]).tobytes()


def test_light_since_midnight_is_the_sum_of_what_the_pyranometer_shows(folder: Path) -> None:
    """With the timing "published" what is shown after a step is the reading of that step."""
    task = spring(folder / "light.toml", observation=NOW.replace("modules", 'timing = "published"\nmodules', 1), sensors=OUTDOOR)
    place = [column.name for column in task.observed()].index("radiation_today")
    simulation, total = Simulation(task, 3, StillKernel()), np.zeros(3)
    simulation.reset([4, 5, 6])
    for _ in range(task.steps_per_day * 2):
        before = simulation.hour_of_day[0]
        shown = simulation.step(np.zeros((3, 6))).observations
        total = np.where(simulation.hour_of_day[0] < before, 0.0, total + shown[:, 0] * 900.0 / 1e4)
        np.testing.assert_allclose(shown[:, place], total, rtol=1e-5, atol=1e-4)
    assert simulation.k[0] == 192


def test_the_process_computer_reads_what_is_shown(folder: Path) -> None:
    wild = OUTDOOR.replace("low = 0.88", "low = 0.3").replace("value = 0.5", "value = 8.0").replace("low = 0.7", "low = 0.1")
    given = f'{NOW}[actuation]\nkind = "process_computer"\n'
    task = spring(folder / "computer.toml", observation=given, sensors=wild, start="2010-05-15")
    simulation, names = Simulation(task, 1, "fast"), task.model_value.control_names
    seen, memory, differs = simulation.reset([8])[0].astype(float), dict(MEMORY), 0
    action = np.zeros((1, len(task.actions)))
    wanted = {one.name: one.value(0.0) for one in task.actions}
    for _ in range(150):
        air, hour = simulation.air[:, 0].copy(), float(simulation.hour_of_day[0])
        inside = float(air[0]), float(air[1]), float(humidity_deficit(air[0], air[2]))
        controls = {name: float(simulation.u[0, names.index(name)]) for name in task.actuation.controls}
        moved, after = work(task, wanted, controls, Measured(*inside, seen[RADIATION], seen[TEMPERATURE], seen[WIND], hour), memory)
        weather = simulation.d[0]
        true = (float(weather[COLUMNS.index(name)]) for name in ("iGlob", "tOut", "wind"))
        other, _ = work(task, wanted, controls, Measured(*inside, *true, hour), memory)
        seen, memory = simulation.step(action).observations[0].astype(float), after
        for name, value in moved.items():
            assert simulation.u[0, names.index(name)] == pytest.approx(float(value), abs=2e-5)
            differs += abs(float(value) - float(other[name])) > 1e-3
    assert differs > 20


def test_readings_stay_within_their_columns(folder: Path) -> None:
    wild = OUTDOOR.replace("value = 3.0", "value = 60.0").replace("value = 0.5", "value = 90.0").replace("noise = 0.1", "noise = 0.3")
    wild = wild.replace("low = 0.7, high = 1.3", "low = 10.0, high = 10.0")
    task = spring(folder / "wild.toml", observation=NOW, sensors=wild)
    shown, true = followed(task, list(range(60)), 60)
    for place, column in enumerate(task.observed()[:5]):
        assert column.low <= shown[..., place].min()
        assert shown[..., place].max() <= column.high
    assert (shown[..., HUMIDITY] == 0.0).any() or (shown[..., HUMIDITY] == 100.0).any()
    assert (shown[..., TEMPERATURE] == -90.0).any()
    assert true[..., HUMIDITY].max() <= 100.0


def test_a_task_without_them_keeps_its_digest_and_one_with_them_says_how_far_they_are_off(task: TaskSpec, folder: Path) -> None:
    plain = spring(folder / "plain.toml", observation=NOW)
    assert "outdoor_sensors" not in plain.definition()
    assert plain.digest != task.digest
    assert task.definition()["outdoor_sensors"]["wind_speed"] == {"scale": {"low": 0.7, "high": 1.3}, "noise": 0.1}
    (section,) = (one for one in definition_in_words(task) if one.heading.startswith("Sensors of the weather"))
    assert section.lines == [
        "Global radiation: reads 0.88 to 1 times the truth, drawn evenly for a run; noise 2 % at every step (standard deviation).",
        "Outdoor temperature: bias 0.5 degC for a run, noise 0.3 degC at every step (both standard deviations).",
        "Outdoor relative humidity: bias 3 % for a run, noise 1 % at every step (both standard deviations).",
        "Wind speed: reads 0.7 to 1.3 times the truth, drawn evenly for a run; noise 10 % at every step (standard deviation).",
    ]
    assert any("weather station" in one.heading for one in for_growers(task))
    known = task_card(task).task()  # an agent knows the sizes
    assert known.outdoor_sensors == task.outdoor_sensors


def test_mistakes_are_named(folder: Path) -> None:
    def read(text: str, observation: str = NOW) -> TaskSpec:
        return spring(folder / "wrong.toml", observation=observation, sensors=text)

    with pytest.raises(TaskError, match="must not be above high"):
        read("[outdoor_sensors.wind_speed]\nscale = { low = 1.3, high = 0.7 }\n")
    with pytest.raises(TaskError, match="a fraction of the reading"):
        read("[outdoor_sensors.wind_speed]\nnoise = 2.0\n")
    with pytest.raises(TaskError, match='Its unit is "degC"'):
        read('[outdoor_sensors.outdoor_temperature]\nbias = { value = 1.0, unit = "K" }\n')
    with pytest.raises(TaskError, match="air_temperature"):
        read('[outdoor_sensors.air_temperature]\nbias = { value = 1.0, unit = "degC" }\n')
    blind = read(OUTDOOR, '[observation]\nmodules = ["indoor_climate", "time"]\n')
    with pytest.raises(TaskError, match="nobody reads them"):
        OutdoorSensors.of(blind, DrawPlaces())


def test_an_outlook_divides_by_the_middle_of_the_scale(folder: Path) -> None:
    """Of the reading it makes what acts on average, and takes it for the weather of now."""
    short = get_task("Spring-v1").replace({"id": "tests/Scaled-v1", "weather.days": 2})
    scaled = short.replace({"outdoor_sensors": {"global_radiation": {"scale": {"low": 0.8, "high": 0.8}}}})
    climatology = Climatology.of(short)
    pair = [(Outlook(one, climatology), Simulation(one, 1, StillKernel())) for one in (short, scaled)]
    for outlook, simulation in pair:
        outlook.update(simulation.reset([3]))
    brightest = 0.0
    for _ in range(60):
        for outlook, simulation in pair:
            outlook.update(simulation.step(np.zeros((1, 6))).observations)
        one, other = (outlook.ahead(8).d for outlook, _ in pair)
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-4)
        brightest = max(brightest, float(one[..., 0].max()))
    assert brightest > 50.0
