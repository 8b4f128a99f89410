"""Generated seasons: functions of family, split, salt and number, whoever asks for them and when."""

from __future__ import annotations

import hashlib
import pickle
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv, Simulation, program, run_weather, weather_pool
from glbench.env.generated import SeasonMaker
from glbench.env.program import make_program
from glbench.env.scenario import RunScenarios
from glbench.env.weather_pool import WeatherPool
from glbench.errors import TaskError
from glbench.kernel import Kernel
from glbench.model import TOMATO
from glbench.tasks import TaskSpec, get_task
from glbench.weather import COLUMNS
from tests.env.checking import check_that_both_are_silent
from tests.env.spring import MODULES, SCENARIO, SPLITS, everything, spring
from tests.env.stepping import StillKernel, walk

FIRST = 666
"""First seed of the tasks."""
SPLIT_NAMES = ("training", "validation", "test")
NO_FORECAST = f"[observation]\nmodules = [{MODULES}]\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("generated")


@pytest.fixture(scope="module")
def task(folder: Path) -> TaskSpec:
    return spring(folder / "spring.toml")


@pytest.fixture
def forgotten(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Pools and programs of before are out of reach in this test, and its own after it."""

    def forget() -> None:
        weather_pool._shared_pool.cache_clear()
        program._shipped.cache_clear()

    forget()
    with monkeypatch.context() as patch:
        patch.setattr(weather_pool, "_ALIVE", type(weather_pool._ALIVE)())
        yield
        forget()


@pytest.mark.parametrize("split", SPLIT_NAMES)
def test_a_season_does_not_depend_on_the_order_in_which_it_is_asked_for(task: TaskSpec, split: str, forgotten: None) -> None:
    chosen = task.in_split(split)
    seasons = range(getattr(task.splits, split).seasons)
    one_by_one = {number: everything(chosen, number) for number in seasons}
    assert len(set(one_by_one.values())) == len(seasons)
    pool = WeatherPool.of(chosen)
    weather_pool._shared_pool.cache_clear()
    del weather_pool._ALIVE[chosen]
    other = WeatherPool.of(chosen)
    assert other is not pool
    other.starts([*reversed(seasons), 0, 1])  # all at once, from the last
    assert {number: everything(chosen, number) for number in seasons} == one_by_one


@pytest.mark.slow
def test_another_process_makes_the_same_seasons(task: TaskSpec) -> None:
    script = (
        "import hashlib; from glbench.tasks import get_task; from tests.env.spring import everything; "
        f"print(hashlib.sha256(everything(get_task({task.source!r}).in_split('test'), 5)).hexdigest())"
    )
    folder = Path(__file__).resolve().parents[2]
    done = subprocess.run([sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == hashlib.sha256(everything(task.in_split("test"), 5)).hexdigest()


def test_seeds_share_the_weather_of_their_season_and_wrap(task: TaskSpec) -> None:
    one, wrapped, before, other = (run_weather(task, seed) for seed in (FIRST + 3, FIRST + 3 + 9 * 10**9, FIRST + 3 - 9, FIRST + 4))
    assert one.values.tobytes() == wrapped.values.tobytes() == before.values.tobytes() != other.values.tobytes()
    assert (one.times == wrapped.times).all()
    assert (one.times != other.times).any()
    drawn = RunScenarios(task).draw([FIRST + 3, FIRST + 12])
    assert drawn.parameters is not None
    assert (drawn.parameters[0] != drawn.parameters[1]).any()  # the crop belongs to the seed
    assert (drawn.traits[0] != drawn.traits[1]).all()
    assert (drawn.keys[0] != drawn.keys[1]).any()
    assert drawn.first[0] == drawn.first[1]
    assert run_weather(task, 2**64 - 1).values.tobytes() == run_weather(task, (2**64 - 1 - FIRST) % 9 + FIRST).values.tobytes()


def test_the_weather_that_acts_is_that_of_the_season(task: TaskSpec) -> None:
    kernel = StillKernel()
    seeds = [FIRST + 8, FIRST, FIRST + 8]
    simulation = Simulation(task, 3, kernel)
    simulation.reset(seeds)
    for _ in range(task.steps):
        simulation.step(np.zeros((3, 6)))
    for row, seed in enumerate(seeds):
        acted = np.array([call[2][row] for call in kernel.calls])
        assert acted.tobytes() == run_weather(task, seed).values[: task.steps].tobytes()


@pytest.mark.parametrize("start", ["2010-02-15", "2010-03-10", "2010-10-10"])
def test_the_sun_keeps_the_clock_of_the_calendar(folder: Path, start: str) -> None:
    """Seasons that start before and after the change of the clock: noon stays where the calendar has it."""
    task = spring(folder / f"sun{start}.toml", start=start, days=10)
    for seed in range(FIRST, FIRST + 9):
        weather = run_weather(task, seed)
        sun = weather.values[:, COLUMNS.index("iGlob")]
        day = weather.values[:, COLUMNS.index("isDay")]
        utc = ((weather.times - weather.times.astype("datetime64[D]")) / np.timedelta64(1, "h")).astype(float)
        assert (day * utc).sum() / day.sum() == pytest.approx(12.0 - 4.79 / 15.0 - (0.0 if start[5:7] != "10" else 0.22), abs=0.3)
        assert sun[day == 0.0].max() < 15.0
        hours = weather.hour_of_day - utc
        assert set(np.round(hours % 24.0, 6).tolist()) <= {1.0, 2.0}


def test_first_days_are_spread_evenly_for_every_number_of_seasons(folder: Path) -> None:
    splits = SPLITS.replace("seasons = 7", "seasons = 300")
    task = spring(folder / "many.toml", splits=splits).in_split("test")
    maker = SeasonMaker(task, np.datetime64("2010-02-14T23:00:00"))
    late = maker.start_days(np.arange(300))
    assert (late.min(), late.max()) == (0, 28)
    for m in range(1, 301):
        found = np.bincount(late[:m], minlength=29)
        assert np.abs(np.cumsum(found) - m * np.arange(1, 30) / 29.0).max() < 3.0
    assert found.min() >= 9  # of 300 / 29 = 10.3
    assert (maker.start_days(np.array([250, 3])) == late[[250, 3]]).all()


@pytest.mark.parametrize("split", SPLIT_NAMES)
def test_seasons_are_made_of_the_years_of_their_split_only(task: TaskSpec, split: str) -> None:
    maker = SeasonMaker(task.in_split(split), np.datetime64("2010-02-14T23:00:00"))
    days = np.concatenate([maker.season(number, 400).days.sources for number in range(8)])
    years = days.astype("datetime64[D]").astype("datetime64[Y]").astype(int) + 1970
    assert set(years.tolist()) == set(getattr(task.splits, split).years)


def test_validation_draws_other_seasons_and_crops_of_the_same_years(task: TaskSpec) -> None:
    training, validation, test = (task.in_split(split) for split in SPLIT_NAMES)
    drawn = [RunScenarios(one).draw([FIRST, FIRST + 1]) for one in (training, validation, test)]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        first, second = drawn[one], drawn[other]
        assert first.parameters is not None
        assert second.parameters is not None
        assert (first.parameters != second.parameters).any(axis=1).all()
        assert (first.traits != second.traits).all()
        assert (first.keys != second.keys).any()
    seasons = [{everything(one, number) for number in range(4)} for one in (training, validation, test)]
    assert len(set.union(*seasons)) == 12


def test_salts_make_other_seasons_and_a_secret_one_those_of_the_test_only(task: TaskSpec, folder: Path) -> None:
    salted = spring(folder / "salted.toml", scenario=SCENARIO.replace('family = "tests/Spring"', 'family = "tests/Spring"\nsalt = "x"'))
    sealed = task.in_split("test", "secret")
    assert everything(salted, 0) != everything(task, 0)
    assert everything(sealed, 0) != everything(task.in_split("test"), 0)
    assert (task.digest, sealed.digest) == (task.digest, task.digest)
    assert everything(sealed.in_split("training"), 0) == everything(task, 0)
    with pytest.raises(TaskError, match="belongs to the test"):
        task.in_split("training", "secret")


def test_tasks_of_a_family_see_the_same_seasons_and_crops(task: TaskSpec, folder: Path) -> None:
    """One without sensors and forecasts, and one with more groups and more steps, as SpringYears and Spring differ."""
    plain = spring(folder / "plain.toml", name="Plain", sensors="", observation=NO_FORECAST)
    more = SCENARIO + '[[scenario.parameters]]\nname = "house"\nparameters = ["cLeakage"]\nhalf_width = 0.2\nredraw = "episode"\n'
    wider = spring(folder / "wider.toml", name="Wider", days=6, scenario=more)
    seeds = [FIRST, FIRST + 5, FIRST + 20]
    draws = [RunScenarios(one).draw(seeds) for one in (task, plain, wider)]
    crop = [TOMATO.parameter_names.index(name) for name in ("sla", "rgFruit")]
    for seed in seeds:
        weather = [run_weather(one, seed).values[: task.steps].tobytes() for one in (task, plain, wider)]
        assert len(set(weather)) == 1
    for other in draws[1:]:
        assert (other.first == draws[0].first).all()
        assert other.parameters is not None
        assert draws[0].parameters is not None
        assert (other.parameters[:, crop] == draws[0].parameters[:, crop]).all()
    assert (draws[0].traits == draws[2].traits).all()
    tables = [WeatherPool.of(one).tables.forecast for one in (task, wider)]
    hours = task.steps // 4
    assert tables[0][:hours].tobytes() == tables[1][:hours].tobytes()


def test_co2_outside_wanders_in_its_range_where_the_model_feels_it(task: TaskSpec, folder: Path) -> None:
    long = spring(folder / "long.toml", days=60)
    pool = WeatherPool.of(long)
    _, rows = pool.starts(range(9))
    length = pool.day * pool.days
    ppm = np.stack([pool.tables.measured[row : row + length, 3] for row in rows])
    density = np.stack([pool.values[row : row + length, COLUMNS.index("co2Out")] for row in rows])
    temperature = np.stack([pool.values[row : row + length, COLUMNS.index("tOut")] for row in rows])
    assert ppm.min() >= 390.0 - 1e-3
    assert ppm.max() <= 420.0 + 1e-3
    assert ppm.mean() == pytest.approx(405.0, abs=1.5)
    assert ppm.std() == pytest.approx(7.3, abs=1.0)
    np.testing.assert_allclose(density, ppm * 1e-6 * 101325.0 * 44.01e-3 / (8.3144598 * (temperature + 273.15)) * 1e6, rtol=2e-3)
    steps = np.diff(ppm, axis=1)
    assert (np.abs(steps[:, [k for k in range(length - 1) if k % 4 != 3]]) < 1e-3).all()  # a value an hour
    hourly = ppm[:, ::4] - 405.0
    assert np.mean(hourly[:, 1:] * hourly[:, :-1]) / hourly.var() == pytest.approx(0.979, abs=0.01)
    still = spring(folder / "still.toml", scenario=SCENARIO.replace("co2_range", "# co2_range"))
    assert run_weather(still, FIRST).values[:, 0].tobytes() == run_weather(task, FIRST).values[:, 0].tobytes()
    WeatherPool.of(still).starts([0])
    assert np.abs(WeatherPool.of(still).tables.measured[: 3 * 96, 3] - 405.0).max() < 0.01


@pytest.mark.parametrize("split", SPLIT_NAMES)
def test_both_checkers_are_silent(task: TaskSpec, split: str, recwarn: pytest.WarningsRecorder) -> None:
    check_that_both_are_silent(task, recwarn, split)


@pytest.mark.parametrize("split", SPLIT_NAMES)
def test_observations_of_whole_runs_stay_in_their_space(task: TaskSpec, split: str) -> None:
    seasons = getattr(task.splits, split).seasons
    simulation = Simulation(task.in_split(split), seasons, "fast")
    space = GreenhouseEnv(task, split=split).observation_space
    seen = [simulation.reset(range(seasons))]
    seen += [simulation.step(action).observations for action in walk(3, task.steps, seasons)]
    assert all(space.contains(row) for rows in seen for row in rows)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_autoresets_bring_new_seasons(folder: Path, mode: str) -> None:
    task = spring(folder / f"day{mode}.toml", days=1)
    envs = GreenhouseVectorEnv(task, 4, kernel="fast", autoreset_mode=mode)
    _, info = envs.reset(seed=5)
    seasons = [(info["seed"] - FIRST) % 9]
    action = np.zeros((4, 6), np.float32)
    for _ in range(2 * (task.steps + 1)):
        *_, info = envs.step(action)
        seasons.append((info["seed"] - FIRST) % 9)
        row = int(seasons[-1][0])
        assert envs.simulation.d[0].tobytes() in WeatherPool.of(task).values[row * 192 : (row + 1) * 192].tobytes()
    assert all(len(set(np.array(seasons)[:, row].tolist())) > 1 for row in range(4))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_row_of_the_vector_environment_is_the_single_one(task: TaskSpec, workers: int) -> None:
    envs = GreenhouseVectorEnv(task, 20, kernel="fast", workers=workers, split="validation")
    alone = GreenhouseEnv(task, kernel="fast", split="validation")
    first, _ = envs.reset(seed=100)
    seen, _ = alone.reset(seed=117)
    assert first[17].tobytes() == seen.tobytes()
    for action in walk(4, 30, 20):
        rows, rewards, *_ = envs.step(action)
        one, reward, *_ = alone.step(action[17])
        assert (rows[17].tobytes(), rewards[17]) == (one.tobytes(), reward)
    envs.close()


def test_a_program_and_the_runs_of_it_share_one_pool(task: TaskSpec, forgotten: None, folder: Path) -> None:
    """Whatever was forgotten in between: a season that runs make is the one that the program reads."""
    made, _ = make_program(task)
    for number in range(20):
        WeatherPool.of(task.in_split("test", f"other {number}"))
    assert make_program(task)[0] is made
    simulation = Simulation(task, 1, Kernel(TOMATO, 900.0, preset="fast"))
    assert simulation.scenarios.pool.values is made.weather
    assert (WeatherPool.of(task) is WeatherPool.of(pickle.loads(pickle.dumps(task)))) is True
    assert WeatherPool.of(task) is not WeatherPool.of(task.in_split("test"))
    assert WeatherPool.of(get_task(task.source)) is WeatherPool.of(task)


def test_threads_that_ask_at_once_get_one_pool(task: TaskSpec, forgotten: None) -> None:
    with ThreadPoolExecutor(6) as threads:
        pools = list(threads.map(lambda _: WeatherPool.of(task), range(6)))
        starts = list(threads.map(lambda pool: pool.starts([3, 4])[1].tolist(), pools))
    assert len({id(pool) for pool in pools}) == 1
    assert len({tuple(found) for found in starts}) == 1


def test_a_split_without_its_years_is_an_error_that_names_it(folder: Path) -> None:
    with pytest.raises(TaskError, match=r"\[splits.test\].*2031"):
        spring(folder / "absent.toml", splits=SPLITS.replace("[2011, 2012]", "[2011, 2031]"))
