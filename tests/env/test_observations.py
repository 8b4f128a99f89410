"""What is observed: every column against its definition, and of which moment it is."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from glbench.env import ObservationInputs, Simulation, WeatherTables, register_observation
from glbench.errors import TaskError, UnknownNameError
from glbench.model import STATE_NAMES, co2_ppm, relative_humidity
from glbench.tasks import TaskSpec, get_suite, get_task
from glbench.tasks.quantities import Quantity
from glbench.tasks.vocabulary import OBSERVATION_MODULES, ObservationModule
from tests.env import test_camera, test_forecast, test_growers_quantities, test_on_off, test_prices, test_schedule
from tests.env.stepping import StillKernel, walk

MakeTask = Callable[..., TaskSpec]
PAPER = 'modules = ["indoor_climate", "crop", "time", "controls", "weather"]'
PUBLISHED_TIMING = ('timing = "current"', 'timing = "published"')


def modules(*names: str, forecast: int = 0) -> tuple[str, str]:
    listed = ", ".join(f'"{name}"' for name in names)
    table = f"\nforecast = {{ steps = {forecast} }}" if forecast else ""
    return PAPER, f"modules = [{listed}]{table}"


def observed(simulation: Simulation, row: int = 0) -> dict[str, float]:
    """Observation of a row by column name."""
    names = [quantity.name for quantity in simulation.task.observed()]
    return dict(zip(names, simulation.observe()[row].tolist(), strict=True))


def by_definition(simulation: Simulation, shown: int, row: int = 0) -> dict[str, float]:
    """Every quantity there is, from states, controls and weather row ``shown``, by its plain definition."""
    task = simulation.task
    x = dict(zip(STATE_NAMES, simulation.x[row].tolist(), strict=True))
    k = int(simulation.k[row])
    weather = task.disturbances(extra_rows=task.observation.forecast_steps)
    values = dict(x)
    values |= {
        "air_temperature": x["tAir"],
        "co2": float(co2_ppm(x["tAir"], x["co2Air"])),
        "relative_humidity": min(100.0, float(relative_humidity(x["tAir"], x["vpAir"]))),
        "pipe_temperature": x["tPipe"],
        "fruit_dry_mass": x["cFruit"] * 1e-6,
        "fruit_carbohydrate": x["cFruit"],
        "canopy_temperature_24h": x["tCan24"],
        "temperature_sum": x["tCanSum"],
        "step_counter": float(shown),
        "sin_hour_of_day": math.sin(2 * math.pi * ((k * 0.25) % 24) / 24),
        "cos_hour_of_day": math.cos(2 * math.pi * ((k * 0.25) % 24) / 24),
        "sin_day_of_year": math.sin(2 * math.pi * (59 + k / 96) / 365),
        "cos_day_of_year": math.cos(2 * math.pi * (59 + k / 96) / 365),
    }
    at_one = (130.0, 5.0, 1.0, 1.0, 116.0, 1.0)
    for capacity, full, fraction in zip(task.capacities(), at_one, simulation.u[row].tolist(), strict=True):
        values |= {capacity.quantity: fraction * full, f"{capacity.quantity}_fraction": fraction}
    for ahead in range(task.observation.forecast_steps + 1):
        suffix = f"_ahead_{ahead}" if ahead else ""
        radiation, temperature, pressure, density, wind = weather.values[shown + ahead, :5].tolist()
        values |= {
            f"global_radiation{suffix}": radiation,
            f"outdoor_temperature{suffix}": temperature,
            f"outdoor_relative_humidity{suffix}": min(100.0, float(relative_humidity(temperature, pressure))),
            f"outdoor_co2{suffix}": float(co2_ppm(temperature, density)),
            f"wind_speed{suffix}": wind,
            f"outdoor_vapour_pressure{suffix}": pressure,
            f"outdoor_co2_density{suffix}": density,
        }
    return values


EVERYTHING = (
    ("indoor_climate", "crop", "time", "controls", "weather", "forecast", "step_counter"),
    ("full_state", "control_fractions", "step_counter", "time"),
    ("published_indoor_climate", "published_crop", "control_fractions", "weather", "published_time", "published_forecast"),
)


@pytest.mark.parametrize("timing", ["current", "published"])
@pytest.mark.parametrize("names", EVERYTHING, ids=lambda names: names[0])
def test_every_column_of_every_module_has_the_value_of_its_definition(make_task: MakeTask, names: tuple[str, ...], timing: str) -> None:
    forecast = 48 if any("forecast" in name for name in names) else 0
    task = make_task(modules(*names, forecast=forecast), ('timing = "current"', f'timing = "{timing}"'))
    simulation = Simulation(task, 2, StillKernel())
    simulation.reset([1, 2])
    actions = walk(3, 60, 2)
    for k in range(60):
        if k in (0, 1, 2, 41, 59):
            shown = max(k - 1, 0) if timing == "published" else k
            definition = by_definition(simulation, shown, row=1)
            seen = observed(simulation, row=1)
            assert seen == pytest.approx({name: definition[name] for name in seen}, rel=2e-7, abs=1e-6)
        simulation.step(actions[k])


def test_the_tested_modules_are_all_there_are() -> None:
    """Those of growers, the camera, the forecast by the hour, machines that are switched and prices have files of their own, the window of
    weather is compared in tests/tasks/test_lettuce_classic.py."""
    files = (test_camera, test_growers_quantities, test_forecast, test_on_off, test_prices, test_schedule)
    elsewhere = {"weather_window", *(name for file in files for name in file.MODULES)}
    assert {name for names in EVERYTHING for name in names} | elsewhere == set(OBSERVATION_MODULES.names)


def test_the_papers_22_columns_stand_in_the_papers_order() -> None:
    names = [quantity.name for quantity in get_suite("paper")[0].observed()]
    assert names == [
        *("air_temperature", "co2", "relative_humidity", "pipe_temperature"),
        *("fruit_dry_mass", "canopy_temperature_24h", "temperature_sum"),
        *("sin_hour_of_day", "cos_hour_of_day", "sin_day_of_year", "cos_day_of_year"),
        *("boiler", "co2_supply", "thermal_screen", "vents", "lamps", "blackout_screen"),
        *("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "outdoor_co2", "wind_speed"),
    ]


def test_the_published_codes_263_columns_can_be_asked_for(make_task: MakeTask) -> None:
    names = ("published_indoor_climate", "published_crop", "control_fractions", "weather", "step_counter")
    task = make_task(modules(*names, "published_time", "published_forecast", forecast=48), PUBLISHED_TIMING)
    simulation = Simulation(task, 1, StillKernel())
    assert simulation.reset([1]).shape == (1, 263)


def test_an_observation_never_shows_weather_that_the_task_does_not_grant(make_task: MakeTask, still: StillKernel) -> None:
    task = make_task()
    simulation = Simulation(task, 1, still)
    simulation.reset([1])
    while not simulation.ended[0]:
        simulation.step(np.zeros((1, 6)))
        seen, k = observed(simulation), int(simulation.k[0])
        # After step k - 1, which row k - 1 acted on, the next row stands in the observation.
        assert seen["outdoor_temperature"] == np.float32(task.disturbances().values[k, 1])
        assert still.calls[-1][2][0, 1] == task.disturbances().values[k - 1, 1]
    assert k == 96


def test_the_last_forecast_reaches_beyond_the_horizon(make_task: MakeTask, still: StillKernel) -> None:
    task = make_task(modules("forecast", forecast=48))
    simulation = Simulation(task, 1, still)
    simulation.reset([1])
    for _ in range(96):
        last = simulation.step(np.zeros((1, 6)))
    assert last.observations[0, -4] == np.float32(task.disturbances(extra_rows=48).values[96 + 48, 1])


@pytest.mark.parametrize("name", ["Schiphol2010-Delta30-v1", "Schiphol2010Code-Delta30-v1"])
def test_observations_stay_within_their_bounds(name: str) -> None:
    """A random walk, everything opened, and everything shut, at the largest uncertainty."""
    task = get_task(name)
    simulation = Simulation(task, 3)
    observations = simulation.reset([1, 2, 3])
    low = np.array([quantity.low for quantity in task.observed()], dtype=np.float32)
    high = np.array([quantity.high for quantity in task.observed()], dtype=np.float32)
    actions = walk(8, 60, 3)
    actions[:, 1], actions[:, 2] = 1.0, -1.0
    for action in actions:
        assert observations.dtype == np.float32
        assert (observations >= low).all()
        assert (observations <= high).all()
        observations = simulation.step(action).observations


@pytest.mark.usefixtures("own_words")
def test_a_module_of_ones_own_works_from_a_task_file(make_task: MakeTask, still: StillKernel) -> None:
    def columns(context: object) -> tuple[Quantity, ...]:
        return (Quantity("test_canopy", "degC", -100.0, 150.0, "canopy temperature"),)

    def make(task: TaskSpec, tables: WeatherTables) -> Callable[[ObservationInputs], np.ndarray]:
        return lambda inputs: inputs.states[:, 4:5]

    module = ObservationModule("test_canopy", "canopy temperature", columns)
    register_observation(module, make)
    simulation = Simulation(make_task(modules("test_canopy", "time")), 2, still)
    assert simulation.reset([1, 2]).tolist()[0] == [20.5, 0.0, 1.0, *simulation.observe()[0, 3:].tolist()]
    with pytest.raises(TaskError, match="test_canopy"):
        register_observation(module, make)


@pytest.mark.usefixtures("own_words")
@pytest.mark.parametrize(
    ("values", "said"),
    [
        (np.zeros((2, 1)), r"'test_own' of .* shape \(2, 1\); it must be \(2, 2\).*test_a, test_b"),
        (np.zeros(2), r"shape \(2,\); it must be \(2, 2\)"),
        (np.array([[0.0, 0.0], [0.0, np.nan]]), "'test_own' of .* returned nan for 'test_b'; it must be a finite number"),
    ],
)
def test_a_module_that_returns_what_its_columns_cannot_be_is_refused(
    values: np.ndarray, said: str, make_task: MakeTask, still: StillKernel
) -> None:
    columns = tuple(Quantity(name, "-", 0.0, 1.0, "a number") for name in ("test_a", "test_b"))
    register_observation(ObservationModule("test_own", "numbers", lambda context: columns), lambda task, tables: lambda inputs: values)
    with pytest.raises(TaskError, match=said):
        Simulation(make_task(modules("test_own", "time")), 2, still).reset([1, 2])


@pytest.mark.usefixtures("own_words")
def test_columns_without_a_part_are_refused(make_task: MakeTask) -> None:
    OBSERVATION_MODULES.add(ObservationModule("test_wether", "nothing computes it", lambda context: ()))
    with pytest.raises(UnknownNameError, match="Did you mean 'weather'"):
        Simulation(make_task(modules("test_wether", "time")), 1)
