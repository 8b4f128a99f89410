"""Scenarios: each run its own season, start and parameters, as functions of family, salt and seed."""

from __future__ import annotations

import copy
import datetime as dt
import io
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from glbench.env import (
    GreenhouseEnv,
    ObservationInputs,
    Simulation,
    Snapshot,
    StepResult,
    WeatherTables,
    register_distribution,
    register_observation,
    run_weather,
)
from glbench.env.scenario import RunScenarios, first_day
from glbench.env.uncertainty import stream_key
from glbench.env.weather_pool import WeatherPool
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.runners import PrivilegedRunner
from glbench.kernel import Kernel, why_not_compiled
from glbench.model import TOMATO, paper
from glbench.tasks import TaskSpec, get_task, task_card
from glbench.tasks.prices import local_times
from glbench.tasks.quantities import Quantity
from glbench.tasks.resolver import ParameterGroup, Scenario, Season, StartGroup
from glbench.tasks.vocabulary import ObservationModule
from tests.env.stepping import StillKernel, walk
from tests.tasks import toy

SEEDS = list(range(20, 31))
N = len(SEEDS)

CROP = ParameterGroup("crop", ("sla", "rgFruit"), "uniform", 0.1, "step")
COVER = ParameterGroup("cover", ("cLeakage",), "uniform", 0.3, "day")
HOUSE = ParameterGroup("house", ("hAir", "lPipe", "laiMax"), "uniform", 0.05, "episode")
SEASONS = (Season("schiphol", dt.date(2009, 2, 10)), Season("schiphol", dt.date(2011, 7, 1)))
VARIED = Scenario("tests/Varied", "salt", (CROP, COVER, HOUSE), (StartGroup("mass", ("cFruit", "cLeaf"), "uniform", 0.2),), SEASONS, 5)


MakeOwn = Callable[..., TaskSpec]


def written(scenario: Scenario) -> str:
    """``[scenario]`` of a task file."""
    lines = ["[scenario]", f'family = "{scenario.family}"', f'salt = "{scenario.salt}"']
    seasons = ", ".join(f'{{ start = {season.start}, source = "{season.source}" }}' for season in scenario.seasons)
    lines += [f"seasons = [{seasons}]", f"start_within_days = {scenario.start_within_days}"]
    for key, groups in (("parameters", scenario.groups), ("start", scenario.start_groups)):
        for group in groups:
            names = group.parameters if isinstance(group, ParameterGroup) else group.states
            listed = ", ".join(f'"{name}"' for name in names)
            lines += [
                f"[[scenario.{key}]]",
                f'name = "{group.name}"',
                f"{'parameters' if key == 'parameters' else 'states'} = [{listed}]",
                f'distribution = "{group.distribution}"',
                f"half_width = {group.half_width}",
            ]
            if isinstance(group, ParameterGroup):
                lines.append(f'redraw = "{group.redraw}"')
    return "\n".join(lines)


@pytest.fixture(scope="module")
def make_own(tmp_path_factory: pytest.TempPathFactory) -> MakeOwn:
    """A task of two days, of schema 2, with a scenario of a test."""
    folder = tmp_path_factory.mktemp("own")
    made: dict[tuple[Scenario, str], TaskSpec] = {}

    def make(scenario: Scenario = VARIED, more: str = "") -> TaskSpec:
        if (scenario, more) not in made:
            path = folder / f"task{len(made)}.toml"
            head = f'base = "glbench/Schiphol2010-Delta10-v1"\nschema = 2\nid = "tests/Own{len(made)}-v1"\ntitle = "Of a test"\n'
            path.write_text(f"{head}[weather]\ndays = 2\n{more}\n{written(scenario)}\n")
            made[scenario, more] = get_task(str(path))
            assert made[scenario, more].scenario == scenario
        return made[scenario, more]

    return make


FORECAST = """
[observation]
modules = ["indoor_climate", "crop", "time", "controls", "weather", "forecast"]
forecast = { steps = 100 }
"""


@pytest.fixture(scope="module")
def kernel() -> Kernel:
    return Kernel(TOMATO, 900.0, preset="fast")


def bits(simulation: Simulation, result: StepResult, row: slice = slice(None)) -> list[bytes]:
    arrays: tuple[np.ndarray[Any, Any], ...] = (
        simulation.x, simulation.u, simulation.k, result.observations, result.table.T, simulation.d, simulation.time,
        simulation.hour_of_day, simulation.day_of_year,
    )  # fmt: skip
    return [np.ascontiguousarray(array[row]).tobytes() for array in arrays]


@pytest.mark.skipif(why_not_compiled() is not None, reason="needs the compiled kernel")
def test_both_ways_of_stepping_give_the_same_bits_also_after_resets(make_own: MakeOwn, kernel: Kernel) -> None:
    task = make_own(VARIED, FORECAST)
    pair = Simulation(task, N, kernel), Simulation(task, N, kernel, fused=False)
    assert [simulation.fused for simulation in pair] == [True, False]
    assert pair[0].reset(SEEDS).tobytes() == pair[1].reset(SEEDS).tobytes()
    for number, action in enumerate(walk(3, 110, N)):
        results = [simulation.step(action) for simulation in pair]
        assert bits(pair[0], results[0]) == bits(pair[1], results[1])
        if number == 50:
            seen = [simulation.reset([5, 2**64 - 1], rows=[1, 8]).tobytes() for simulation in pair]
            assert seen[0] == seen[1]
    assert pair[0].k.tolist() == [59 if row in (1, 8) else 110 for row in range(N)]


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_run_has_the_bits_it_has_alone(make_own: MakeOwn, fused: bool, threads: int) -> None:
    task = make_own()
    kernel = Kernel(TOMATO, 900.0, preset="fast", threads=threads)
    many, alone = Simulation(task, 40, kernel, fused=fused), Simulation(task, 1, kernel, fused=fused)
    many.reset(range(40))
    alone.reset([39])
    for action in walk(3, 5, 40):
        first, second = many.step(action), alone.step(action[39:])
        assert bits(many, first, slice(39, 40)) == bits(alone, second)


@pytest.mark.parametrize("fused", [True, False])
def test_snapshots_and_copies_go_on_with_the_same_bits(make_own: MakeOwn, kernel: Kernel, fused: bool) -> None:
    task = make_own()
    simulation = Simulation(task, N, "fast", fused=fused)
    simulation.reset(SEEDS)
    for action in walk(1, 4, N):
        simulation.step(action)
    restored = Simulation(task, 3, kernel, fused=not fused)
    restored.restore(Snapshot.from_bytes(simulation.snapshot().to_bytes()).take([7, 7, 2]))
    others = copy.deepcopy(simulation), pickle.loads(pickle.dumps(simulation))
    action = walk(2, 1, N)[0]
    result = simulation.step(action)
    for other in others:
        assert bits(other, other.step(action)) == bits(simulation, result)
    found = restored.step(action[[7, 7, 2]])
    for row, of in enumerate((7, 7, 2)):
        assert bits(restored, found, slice(row, row + 1)) == bits(simulation, result, slice(of, of + 1))


def test_a_snapshot_of_the_first_format_is_read(make_own: MakeOwn, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(make_own(), 2, "fast")
    simulation.reset([1, 2])
    snapshot = simulation.snapshot()
    saved: dict[str, Any] = {}
    monkeypatch.setattr(np, "savez", lambda file, **arrays: saved.update(arrays))
    snapshot.to_bytes()
    monkeypatch.undo()
    file = io.BytesIO()
    np.savez(file, **{name: value for name, value in saved.items() if name not in ("memory", "allow_pickle")} | {"format": np.int64(1)})
    read = Snapshot.from_bytes(file.getvalue())
    assert read.memory.shape == (2, 0)
    assert simulation.restore(read).tobytes() == simulation.observe().tobytes()


def test_runs_start_on_their_own_day_of_their_own_season(make_own: MakeOwn) -> None:
    task = make_own()
    simulation = Simulation(task, 300, "fast")
    simulation.reset(range(300))
    days = [str(day) for day in simulation.time.astype("datetime64[D]")]
    assert [str(first_day(task, seed)) for seed in range(300)] == days
    allowed = {str(np.datetime64(season.start) + late) for season in SEASONS for late in range(6)}
    assert set(days) == allowed
    assert 100 < sum(day.startswith("2009") for day in days) < 200
    pool = WeatherPool.of(task)
    for row in (0, 100, 299):
        season = next(season for season in SEASONS if days[row].startswith(str(season.start.year)))
        alone = task.weather.model_copy(update={"source": season.source, "start": dt.date.fromisoformat(days[row])})
        own = task.model_copy(update={"weather": alone}).disturbances()
        first = int(np.flatnonzero(pool.times == simulation.time[row])[0])
        assert (pool.values[first : first + len(own.values), :2] == own.values[:, :2]).all()
        assert simulation.d[row, :2].tolist() == own.values[0, :2].tolist()
        assert simulation.day_of_year[row] == own.day_of_year[0]


def test_the_weather_of_a_run_is_what_its_simulation_meets(make_own: MakeOwn) -> None:
    for task in (make_own(VARIED, FORECAST), get_task("Schiphol2010-Delta10-v1")):
        weather = run_weather(task, 77)
        simulation = Simulation(task, 1, StillKernel())
        simulation.reset([77])
        for step in range(5):
            assert simulation.d[0].tolist() == weather.values[step].tolist()
            found = simulation.time[0], simulation.hour_of_day[0], simulation.day_of_year[0]
            assert found == (weather.times[step], weather.hour_of_day[step], weather.day_of_year[step])
            simulation.step(np.zeros((1, 6)))
        assert len(weather.values) == task.steps + 1 + task.observation.forecast_steps
    nominal = task.disturbances()
    assert weather.values.tobytes() == nominal.values.tobytes()
    assert weather.times.tobytes() == nominal.times.tobytes()


def test_a_privileged_controller_sees_each_runs_own_weather_and_clock(make_own: MakeOwn) -> None:
    seen: list[tuple[Any, ...]] = []

    class Spy:
        def reset(self, card: Any, n: int) -> None:
            pass

        def controls(self, x: Any, d: Any, hour_of_day: Any, day_of_year: Any) -> Any:
            seen.append((d, hour_of_day, day_of_year))
            return np.zeros((N, 6))

    task = make_own()
    runner = PrivilegedRunner(Spy(), task, task_card(task), N, TimeLimits())
    simulation = Simulation(task, N, StillKernel())
    observations = simulation.reset(SEEDS)
    for step in range(2):
        inputs, met = (runner.inputs(simulation, observations), (simulation.d, simulation.hour_of_day, simulation.day_of_year))
        runner.decide(step, inputs, np.ones(N, np.bool_))
        assert all(np.array_equal(one, other) for one, other in zip(seen[-1], met, strict=True))
        assert np.unique(seen[-1][2]).size > 2
        observations = simulation.step(np.zeros((N, 6))).observations


@pytest.mark.usefixtures("own_words")
def test_parts_of_ones_own_are_called_with_the_rows_of_each_run(make_own: MakeOwn) -> None:
    register_distribution("test_sides", "minus or plus the half width", lambda u, h: np.where(u < 0.5, -h, h))
    rows: list[Any] = []

    def sun(task: TaskSpec, tables: WeatherTables) -> Callable[[ObservationInputs], Any]:
        def columns(inputs: ObservationInputs) -> Any:
            rows.append((inputs.weather_rows, inputs.clock_rows))
            return tables.measured[inputs.weather_rows, :1]

        return columns

    column = Quantity("test_sun", "W m-2", 0.0, 2000.0, "sun")
    register_observation(ObservationModule("test_sun", "sun", lambda context: (column,)), sun)
    own = replace(VARIED, groups=(replace(CROP, distribution="test_sides"), replace(HOUSE, distribution="test_sides")))
    task = make_own(own, '[observation]\nmodules = ["test_sun", "weather"]')
    simulation = Simulation(task, N, StillKernel())
    observations = simulation.reset(SEEDS)
    for _ in range(3):
        assert observations[:, 0].tolist() == observations[:, 1].tolist() == simulation.d[:, 0].astype(np.float32).tolist()
        assert (WeatherPool.of(task).times[rows[-1][0]] == simulation.time).all()
        assert rows[-1][0].tolist() == rows[-1][1].tolist()
        observations = simulation.step(np.zeros((N, 6))).observations
    parameters = seen_parameters(task, [1, 2, 3], 20)
    for name, half_width, values in (("sla", 0.1, 2), ("hAir", 0.05, 1)):
        place = TOMATO.parameter_names.index(name)
        found = parameters[:, 0, place] / task.parameters()[place]
        assert np.allclose(np.abs(found - 1.0), half_width, rtol=1e-9), name
        assert np.unique(found.round(9)).size == values, name


@pytest.mark.skipif(why_not_compiled() is not None, reason="needs the compiled kernel")
@pytest.mark.usefixtures("own_words")
def test_a_distribution_of_ones_own_for_the_episode_is_stepped_in_one_call(make_own: MakeOwn, kernel: Kernel) -> None:
    register_distribution("test_thirds", "in three parts", lambda u, h: np.floor(3.0 * u - 1.0) * h)
    task = make_own(replace(VARIED, groups=(CROP, replace(HOUSE, distribution="test_thirds"))))
    pair = Simulation(task, N, kernel), Simulation(task, N, kernel, fused=False)
    assert [simulation.fused for simulation in pair] == [True, False]
    for simulation in pair:
        simulation.reset(SEEDS)
    for action in walk(3, 3, N):
        results = [simulation.step(action) for simulation in pair]
        assert bits(pair[0], results[0]) == bits(pair[1], results[1])


@pytest.mark.parametrize("split", ["test", "validation"])
@pytest.mark.parametrize("task", ["GreenhouseReal-v1", "WinterLED-v1", "Schiphol2010-Delta10-v1"])
def test_the_first_day_of_a_run_is_that_of_its_weather(task: str, split: str) -> None:
    chosen = get_task(task) if get_task(task).splits is None else get_task(task).in_split(split)
    for seed in (10067, 3):
        weather = run_weather(chosen, seed)
        local = local_times(weather.times[:1], weather.hour_of_day[:1])[0]
        assert local == np.datetime64(first_day(chosen, seed), "s")


def test_each_run_starts_from_its_own_weather_and_factors(make_own: MakeOwn) -> None:
    task = make_own()
    simulation = Simulation(task, 40, "fast")
    simulation.reset(range(40))
    fruit, soil = TOMATO.state_index("cFruit"), TOMATO.state_index("tSo5")
    plain = TOMATO.start(task.initial.kind, simulation.d[3], task.initial.air_temperature, task.parameters())
    share = simulation.x[:, fruit] / plain[fruit]
    assert share.min() > 0.8
    assert share.max() < 1.2
    assert np.unique(share).size == 40
    assert simulation.x[3, soil] == plain[soil]
    assert (
        simulation.x[:, fruit] / plain[fruit] != simulation.x[:, TOMATO.state_index("cLeaf")] / plain[TOMATO.state_index("cLeaf")]
    ).all()


def seen_parameters(task: TaskSpec, seeds: list[int], steps: int) -> np.ndarray[Any, Any]:
    """Parameters that reach the kernel, ``(steps, n, 208)``."""
    kernel = StillKernel()
    simulation = Simulation(task, len(seeds), kernel)
    simulation.reset(seeds)
    for _ in range(steps):
        simulation.step(np.zeros((len(seeds), 6)))
    return np.stack([call[3] for call in kernel.calls])


def test_groups_are_drawn_each_step_each_day_and_each_episode(make_own: MakeOwn) -> None:
    task = make_own()
    p, nominal = seen_parameters(task, [1, 2], 192), task.parameters()
    place = TOMATO.parameter_names.index
    for name, values in (("sla", 192), ("cLeakage", 2), ("lPipe", 1)):
        for row in (0, 1):
            assert np.unique(p[:, row, place(name)]).size == values, name
    assert np.unique(p[:96, 0, place("cLeakage")]).size == 1
    for name, half_width in (("sla", 0.1), ("cLeakage", 0.3), ("hAir", 0.05)):
        share = p[:, :, place(name)] / nominal[place(name)]
        assert 0.0 < np.abs(share - 1.0).max() <= half_width, name
    # The pruning mass follows from one parameter of the episode and one of the step.
    assert (p[..., place("cLeafMax")] == p[..., place("laiMax")] / p[..., place("sla")]).all()
    assert np.allclose(TOMATO.parameters.complete(p.reshape(-1, p.shape[-1])), p.reshape(-1, p.shape[-1]), rtol=1e-14, atol=0.0)


def test_tasks_of_a_family_share_numbers_and_another_salt_does_not(make_own: MakeOwn) -> None:
    sla = TOMATO.parameter_names.index("sla")
    wider = replace(VARIED, groups=(replace(CROP, half_width=0.2), HOUSE))
    deviations = [
        seen_parameters(make_own(scenario), [4], 3)[:, 0, sla] / task_sla - 1.0
        for scenario in (VARIED, wider, replace(VARIED, salt="another"))
        for task_sla in (make_own(scenario).parameters()[sla],)
    ]
    assert np.allclose(2.0 * deviations[0], deviations[1], rtol=1e-12)
    assert not np.isclose(deviations[0], deviations[2]).any()
    starts = [RunScenarios(make_own(scenario)).draw([4]).first.tolist() for scenario in (VARIED, wider)]
    assert starts[0] == starts[1]


def test_streams_never_meet() -> None:
    streams = ("season", "start day", "start mass", "parameters crop", "parameters cover", "parameters house")
    scenarios = VARIED, replace(VARIED, salt="another"), replace(VARIED, family="tests/Another")
    keys = {stream_key(scenario, seed, stream) for scenario in scenarios for seed in (0, 1, 2**64 - 1) for stream in streams}
    assert len(keys) == len(scenarios) * 3 * len(streams)


@pytest.fixture
def toy_task(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> TaskSpec:
    """A model of two states without an air, with prices that change by the hour."""
    monkeypatch.setattr(paper, "_MODELS", {**paper._MODELS, "toy-1.0.0": {"author": toy.Toy()}})
    drawn = '''[scenario]
family = "toys"
years = [2009, 2011]
[[scenario.parameters]]
parameters = ["tap"]
half_width = 0.5
redraw = "day"'''
    path = tmp_path / "toy.toml"
    path.write_text(toy.TASK.replace('[scenario]\nfamily = "toys"', drawn))
    return get_task(str(path))


@pytest.mark.skipif(why_not_compiled() is not None, reason="needs the compiled kernel")
def test_a_model_of_two_states_is_stepped_both_ways_and_valued_at_the_price_of_each_moment(toy_task: TaskSpec) -> None:
    kernel = Kernel(toy_task.model_value, 3600.0, backend="compiled")
    pair = Simulation(toy_task, N, kernel), Simulation(toy_task, N, kernel, fused=False)
    assert [simulation.fused for simulation in pair] == [True, False]
    for simulation in pair:
        simulation.reset(SEEDS)
    assert pair[0].air.shape == (0, N)
    prices = np.array(toy_task.price_tables["market"].hourly)
    mass = toy_task.model_value.state_index("mass")
    for action in np.random.default_rng(1).uniform(0.0, 1.0, (72, N, 1)):
        before, now = pair[0].x[:, mass], prices[pair[0].hour_of_day.astype(int)]
        results = [simulation.step(action) for simulation in pair]
        assert bits(pair[0], results[0]) == bits(pair[1], results[1])
        later = prices[pair[0].hour_of_day.astype(int)]
        assert np.allclose(results[0].quantities["growth"], pair[0].x[:, mass] * later - before * now, rtol=0.0, atol=1e-12)
    assert pair[0].ended.all()
    assert len({str(day)[:4] for day in pair[0].time}) == 2


def test_a_model_of_two_states_is_a_gymnasium_environment(toy_task: TaskSpec) -> None:
    environment = GreenhouseEnv(toy_task, StillToy(), render_mode="ansi")
    observation, info = environment.reset(seed=1)
    assert environment.observation_space.contains(observation)
    assert "air_temperature" not in info
    *_, info = environment.step(np.ones(1, np.float32))
    assert {"growth", "cost_water", "epi", "tap"} <= set(info)
    assert "mass 100 g m-2" in str(environment.render())


class StillToy:
    """Nothing moves."""

    def try_step(self, x: Any, u: Any, d: Any, p: Any) -> tuple[Any, list[Any]]:
        return x.copy(), []
