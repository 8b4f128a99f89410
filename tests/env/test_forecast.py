"""Forecasts by the hour: how far they err, how issues hang together, and that they are aligned with the weather that comes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.env import Simulation, run_weather
from glbench.env.air import read_air
from glbench.env.forecast import LEVELS, PERSISTENCE, SPREAD, ForecastTable
from glbench.env.random import ar1_paths, key_of, uniforms
from glbench.env.weather_pool import WeatherPool
from glbench.errors import TaskError
from glbench.report.task_words import definition_in_words
from glbench.tasks import TaskSpec
from glbench.weather import COLUMNS, Place
from glbench.weather.generator import clear_sky
from tests.env.spring import HOURS, SCENARIO, SPLITS, forecast, spring
from tests.env.stepping import StillKernel

Floats = NDArray[np.float64]

MODULES = ("weather_forecast",)
QUANTITIES = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("forecast")


@pytest.fixture(scope="module")
def levels(folder: Path) -> dict[str, TaskSpec]:
    return {name: spring(folder / f"{name}.toml", observation=forecast(name), sensors="") for name in LEVELS}


def shown(task: TaskSpec, seeds: list[int]) -> Floats:
    """Forecasts that runs see, ``(steps + 1, seeds, quantities, hours)``."""
    simulation = Simulation(task, len(seeds), StillKernel())
    seen = [simulation.reset(seeds)]
    seen += [simulation.step(np.zeros((len(seeds), 6))).observations for _ in range(task.steps)]
    return np.array(seen)[..., -QUANTITIES * len(HOURS) :].reshape(-1, len(seeds), QUANTITIES, len(HOURS)).astype(float)


def coming(task: TaskSpec, season: int) -> Floats:
    """Hourly means of the weather of a generated season from its first row on ``(hours, quantities)``, by the pool's own rows."""
    pool = WeatherPool.of(task)
    pool.starts([season])
    rows = pool.day * pool.days
    values = pool.values[season * rows : (season + 1) * rows]
    radiation, temperature, pressure, wind = (values[:, COLUMNS.index(name)] for name in ("iGlob", "tOut", "vpOut", "wind"))
    humidity = read_air(temperature, values[:, COLUMNS.index("co2Out")], pressure)[2]
    return np.stack([radiation, temperature, humidity, wind], axis=1).reshape(-1, 4, QUANTITIES).mean(axis=1)


def test_a_perfect_forecast_is_the_mean_of_the_hour_that_comes(levels: dict[str, TaskSpec]) -> None:
    task = levels["perfect"]
    seen, hourly = shown(task, [666, 667]), [coming(task, season) for season in (0, 1)]
    checked = 0
    for k in range(task.steps + 1):
        for row in range(2):
            for column, ahead in enumerate(HOURS):
                hour = k // 4 + ahead - 1  # it ends ``ahead`` hours after the last full hour
                if hour < len(hourly[row]):
                    np.testing.assert_allclose(seen[k, row, :, column], hourly[row][hour], rtol=3e-7, atol=1e-5)
                    checked += 1
    assert checked > 3000


@pytest.mark.parametrize("start", ["2010-03-26", "2010-10-29"])
def test_hours_are_aligned_where_the_clock_changes(folder: Path, start: str) -> None:
    """Seasons start before and after the change; all rows are steps of UTC."""
    within = SCENARIO.replace("start_within_days = 28", "start_within_days = 5")
    task = spring(folder / f"clock{start}.toml", start=start, scenario=within, observation=forecast("perfect"), sensors="")
    seeds = list(range(666, 675))
    simulation = Simulation(task, 9, StillKernel())
    simulation.reset(seeds)
    assert len(set(simulation.time.tolist())) > 3
    seen = shown(task, seeds)
    for row, seed in enumerate(seeds):
        weather = run_weather(task, seed)
        assert (np.diff(weather.times) == np.timedelta64(15, "m")).all()
        temperature = weather.values[: task.steps, COLUMNS.index("tOut")].reshape(-1, 4).mean(axis=1)
        for hour in range(len(temperature) - 3):
            assert seen[4 * hour, row, 1, 2] == pytest.approx(temperature[hour + 2], abs=1e-5)
        sun = weather.values[:, COLUMNS.index("iGlob")]
        utc = (weather.times - weather.times.astype("datetime64[D]")) / np.timedelta64(1, "h")
        centre = (sun * utc).sum() / sun.sum()
        assert centre == pytest.approx(12.0 - 4.79 / 15.0, abs=0.75)  # the sun keeps UTC, whatever clocks do


def test_an_issue_holds_for_its_hour(levels: dict[str, TaskSpec]) -> None:
    seen = shown(levels["medium"], [666, 670])
    for k in range(len(seen) - 1):
        assert (seen[k + 1] == seen[k]).all() == (k % 4 < 3)


def test_without_a_forecast_the_weather_of_now_is_shown(levels: dict[str, TaskSpec]) -> None:
    task = levels["none"]
    simulation = Simulation(task, 1, StillKernel())
    observation = simulation.reset([668])[0]
    names = [quantity.name for quantity in task.observed()]
    for k in range(30):
        if k % 4 == 0:
            for name in ("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "wind_speed"):
                now = observation[names.index(name)]
                assert [observation[names.index(f"{name}_in_{hour}h")] for hour in HOURS] == [now] * len(HOURS)
        observation = simulation.step(np.zeros((1, 6))).observations[0]


def many_errors(level: str, seasons: int, issues: int = 240) -> Floats:
    """Errors of forecasts of steady weather, temperature 10 degC, humidity 50 %, wind 50 m/s: ``(seasons, issues, quantities, hours)``.

    Radiation is half of that under a clear sky, which it is given in units of.
    """

    class Of:
        class scenario:  # noqa: N801
            family, salt = "tests/Errors", ""

    place = Place(latitude=0.0, longitude=0.0, altitude=0.0, timezone="UTC", station="")
    table = ForecastTable(HOURS, level, 1, 24, QUANTITIES * len(HOURS), Of(), place)  # type: ignore[arg-type]
    times = np.datetime64("2011-04-01T00:00:00") + np.arange(issues + 24) * np.timedelta64(3600, "s")
    clear = np.tile(clear_sky(place, 0)[90], 1)
    day = np.array([clear_sky(place, 0)[90 + hour // 24, hour % 24] for hour in range(issues + 24)])
    assert clear.max() > 900.0
    measured = np.stack(
        [day / 2.0, np.full(issues + 24, 10.0), np.full(issues + 24, 50.0), np.zeros(issues + 24), np.full(issues + 24, 50.0)], axis=1
    )
    found = np.zeros((seasons, issues, QUANTITIES, len(HOURS)))
    rows = np.zeros((issues, QUANTITIES * len(HOURS)), np.float32)
    for season in range(seasons):
        table.fill(rows, 0, issues, measured, times, season)
        found[season] = rows.reshape(issues, QUANTITIES, len(HOURS))
    for column, hour in enumerate(HOURS):
        ahead = day[hour - 1 : hour - 1 + issues]
        with np.errstate(invalid="ignore", divide="ignore"):
            found[:, :, 0, column] = np.where(ahead > 50.0, (found[:, :, 0, column] - ahead / 2.0) / ahead, np.nan)
    found[:, :, 1:] -= np.array([10.0, 50.0, 50.0])[:, None]
    return found


@pytest.mark.parametrize(("level", "factor"), [("low", 0.5), ("medium", 1.0), ("high", 2.0)])
def test_errors_grow_with_the_hours_ahead_as_stated(level: str, factor: float) -> None:
    errors = many_errors(level, 300)
    for quantity in range(1, QUANTITIES):  # radiation is cut by a clear sky
        for column, hour in enumerate(HOURS):
            wanted = factor * SPREAD[quantity] * np.sqrt(1.0 - PERSISTENCE[quantity] ** (2 * hour))
            assert errors[:, :, quantity, column].std() == pytest.approx(wanted, rel=0.04)
            assert abs(errors[:, :, quantity, column].mean()) < 0.06 * wanted
    if level == "low":  # 0.09 of a clear sky reaches neither end, being bell-shaped
        for column, hour in enumerate(HOURS):
            wanted = factor * SPREAD[0] * np.sqrt(1.0 - PERSISTENCE[0] ** (2 * hour))
            assert np.nanstd(errors[:, :, 0, column]) == pytest.approx(wanted, rel=0.04)


def test_the_sizes_are_those_that_the_page_states() -> None:
    """Temperature 0.6 K an hour ahead and 1.9 K a day ahead."""
    errors = many_errors("medium", 200)[:, :, 1]
    assert [round(float(errors[..., column].std()), 1) for column in (0, 6)] == [0.6, 1.9]


def test_errors_are_those_of_the_formula() -> None:
    """e(i, h) = a(i + h) - phi^h a(i), path by path, from the uniform numbers on."""
    errors = many_errors("medium", 2, issues=60)
    for season in range(2):
        key = np.array([key_of(f"glbench\ntests/Errors\n\nseason {season}\nforecast errors")], np.uint64)
        numbers = uniforms(key, np.arange(85)[None], 12)[0].reshape(85, 4, 3)
        shocks = 2.0 * (numbers.sum(axis=2) - 1.5)
        for quantity in range(1, 4):
            phi, path = PERSISTENCE[quantity], [shocks[0, quantity]]
            for k in range(1, 85):
                path.append(phi * path[-1] + np.sqrt(1.0 - phi**2) * shocks[k, quantity])
            a = SPREAD[quantity] * np.array(path)
            for column, hour in enumerate(HOURS):
                wanted = a[hour : hour + 60] - phi**hour * a[:60]
                np.testing.assert_allclose(errors[season, :, quantity, column], wanted, atol=2e-5)


def test_issues_after_each_other_agree_about_the_same_hour() -> None:
    """Forecasts of one hour, 3 and 2 hours before it, err alike; a day apart they would not."""
    errors = many_errors("medium", 300)[:, :, 1]
    three, two, one = errors[:, :-2, 2], errors[:, 1:-1, 1], errors[:, 2:, 0]
    phi = PERSISTENCE[1]
    # cov(e(i, 3), e(i + 1, 2)) = variance of the shocks that both still have to come: s^2 (1 - phi^4)
    wanted = np.sqrt((1.0 - phi**4) / (1.0 - phi**6))
    assert np.corrcoef(three.ravel(), two.ravel())[0, 1] == pytest.approx(wanted, abs=0.02)
    assert np.corrcoef(two.ravel(), one.ravel())[0, 1] == pytest.approx(np.sqrt((1.0 - phi**2) / (1.0 - phi**4)), abs=0.02)
    # One issue errs alike in hours that follow each other.
    assert np.corrcoef(errors[:, :, 5].ravel(), errors[:, :, 6].ravel())[0, 1] > 0.6


def test_quantities_err_on_their_own() -> None:
    errors = many_errors("medium", 300)[:, ::24, 1:, 4].reshape(-1, 3)
    assert np.abs(np.corrcoef(errors.T)[~np.eye(3, dtype=bool)]).max() < 0.05


def test_levels_stand_in_their_order(levels: dict[str, TaskSpec]) -> None:
    perfect = shown(levels["perfect"], [666])
    sizes = {name: np.abs(shown(task, [666]) - perfect).mean(axis=(0, 1, 3)) for name, task in levels.items()}
    assert (sizes["perfect"] == 0.0).all()
    for weaker, stronger in (("perfect", "low"), ("low", "medium"), ("medium", "high")):
        assert (sizes[weaker] < sizes[stronger]).all()
    assert (sizes["none"] > 0.0).all()
    low, medium = (shown(levels[name], [666])[:, :, 1] - perfect[:, :, 1] for name in ("low", "medium"))
    np.testing.assert_allclose(2.0 * low, medium, atol=2e-5)  # the same paths


def test_radiation_stays_between_nothing_and_a_clear_sky(levels: dict[str, TaskSpec]) -> None:
    task = levels["high"]
    seen = shown(task, [666, 669])
    place = task.record().place
    for row, seed in enumerate((666, 669)):
        times, hourly = run_weather(task, seed).times, coming(task, seed - 666)[:, 0]
        assert (seen[:, row, 0] >= 0.0).all()
        for k in range(0, task.steps, 4):
            for column, ahead in enumerate(HOURS):
                hour = times[k] + np.timedelta64(ahead - 1, "h")
                day = (hour.astype("datetime64[D]") - np.datetime64("2010-01-01")).astype(int)
                most = clear_sky(place, 0)[day, int((hour - hour.astype("datetime64[D]")) / np.timedelta64(1, "h"))]
                at = k // 4 + ahead - 1
                if at < len(hourly):
                    assert seen[k, row, 0, column] <= max(most, hourly[at]) + 1e-4
                if most == 0.0 and at < len(hourly) and hourly[at] == 0.0:
                    assert seen[k, row, 0, column] == 0.0


def test_values_stay_within_their_columns(folder: Path) -> None:
    task = spring(folder / "high.toml", observation=forecast("high"))
    table = WeatherPool.of(task).tables.forecast
    WeatherPool.of(task).starts(range(9))
    bounds = task.observed()[-QUANTITIES * len(HOURS) :]
    assert (table >= np.array([q.low for q in bounds], np.float32)).all()
    assert (table <= np.array([q.high for q in bounds], np.float32)).all()
    assert np.isfinite(table).all()


def of_many_paths(task: TaskSpec, unbiased: bool, sign: float = 1.0) -> tuple[Floats, Floats]:
    """Forecasts of one season with 400 paths of errors ``(paths, issues, quantities, hours)``, and what comes."""
    found = ForecastTable.of(task)
    assert found is not None
    found = replace(found, unbiased=unbiased)
    errors = type(found)._errors
    season, hours = task.season(task.scenario.seasons[0], found.reach), task.weather.days * 24
    measured = measured_weather(season.values)[: 4 * hours + found.reach]
    truth = measured[:, [0, 1, 2, 4]].reshape(-1, 4, QUANTITIES).mean(axis=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(found), "_errors", lambda self, *of: sign * errors(self, *of))
        tables = np.zeros((400, hours, found.columns), np.float32)
        for path, table in enumerate(tables):
            found.fill(table, 0, 4 * hours, measured, season.times, path)
    came = np.stack([truth[ahead - 1 : ahead - 1 + hours] for ahead in HOURS], axis=-1)
    return tables.reshape(400, hours, QUANTITIES, len(HOURS)).astype(float), came


def measured_weather(values: Floats) -> Floats:
    radiation, temperature, pressure, co2, wind = (
        np.ascontiguousarray(values[:, COLUMNS.index(name)]) for name in ("iGlob", "tOut", "vpOut", "co2Out", "wind")
    )
    _, ppm, humidity = read_air(temperature, co2, pressure)
    return np.stack([radiation, temperature, humidity, ppm, wind], axis=1)


@pytest.fixture(scope="module")
def real(folder: Path) -> TaskSpec:
    scenario = SCENARIO.replace("generated = true\n", "").replace('co2_range = { low = 390.0, high = 420.0, unit = "ppm" }\n', "")
    splits = "\n".join(line for line in SPLITS.splitlines() if not line.startswith("seasons"))
    return spring(folder / "of-a-year.toml", days=12, scenario=scenario, splits=splits, observation=forecast("high"), sensors="")


def test_an_unbiased_forecast_is_right_on_average_and_the_other_is_not(real: TaskSpec) -> None:
    """By quantity over 400 paths of errors: the mean error in standard errors, paths being independent."""
    for unbiased in (True, False):
        issued, came = of_many_paths(real, unbiased)
        error = (issued - came).mean(axis=(1, 3))  # of a path
        off = error.mean(axis=0) / (error.std(axis=0) / np.sqrt(len(error)))
        if unbiased:
            assert np.abs(off).max() < 4.0
        else:
            assert off[0] < -8.0
            assert off[2] < -8.0
            assert off[3] > 4.0
            assert abs(off[1]) < 4.0


def test_errors_of_an_unbiased_forecast_are_alike_on_both_sides_and_within_limits(real: TaskSpec) -> None:
    (up, came), (down, _) = (of_many_paths(real, unbiased=True, sign=sign) for sign in (1.0, -1.0))
    np.testing.assert_allclose((up + down) / 2.0, np.broadcast_to(came, up.shape), rtol=1e-6, atol=1e-4)
    assert up.min(axis=(0, 1, 3))[[0, 2, 3]] == pytest.approx(0.0, abs=60.0)
    assert (up[:, :, [0, 2, 3]] >= 0.0).all()
    assert (up[:, :, 2] <= 100.0).all()
    dark = came[:, 0] == 0.0
    assert (up[:, :, 0][:, dark] == 0.0).all()
    limited = np.isclose(up[:, :, 3], 2.0 * came[:, 3]) | (up[:, :, 3] < 1e-6)  # the wind doubles, or goes down
    assert 0.01 < limited.mean() < 0.6


def test_temperature_and_far_limits_are_the_same_biased_or_not(real: TaskSpec) -> None:
    (free, came), (cut, _) = (of_many_paths(real, unbiased) for unbiased in (True, False))
    assert free[:, :, 1].tobytes() == cut[:, :, 1].tobytes()
    calm = came[:, 3] > 15.0  # m s-1: further from 0 than any error goes
    assert (free[:, :, 3][:, calm] == cut[:, :, 3][:, calm]).all()
    assert (free != cut).any()


def test_a_task_file_says_whether_its_forecast_is_unbiased(folder: Path) -> None:
    text = forecast("medium")
    plain, unbiased = (spring(folder / "said.toml", observation=text + more) for more in ("", "unbiased = true\n"))
    assert "unbiased" not in plain.definition()["observation"]["forecast"]
    assert unbiased.definition()["observation"]["forecast"]["unbiased"] is True
    assert plain.digest != unbiased.digest
    made = ForecastTable.of(plain), ForecastTable.of(unbiased)
    assert [one.unbiased for one in made if one is not None] == [False, True]
    (section,) = (one for one in definition_in_words(unbiased) if one.heading.startswith("What the agent sees"))
    assert "zero on average" in section.lines[0]


def test_real_years_have_forecasts_too(folder: Path) -> None:
    scenario = SCENARIO.replace("generated = true\n", "").replace('co2_range = { low = 390.0, high = 420.0, unit = "ppm" }\n', "")
    splits = "\n".join(line for line in SPLITS.splitlines() if not line.startswith("seasons"))
    task = spring(folder / "real.toml", scenario=scenario, splits=splits, observation=forecast("perfect"), sensors="")
    for split in ("training", "test"):
        chosen = task.in_split(split)
        seeds = list(range(6))
        seen = shown(chosen, seeds)
        for row, seed in enumerate(seeds):
            weather = run_weather(chosen, seed)
            temperature = weather.values[: task.steps, COLUMNS.index("tOut")].reshape(-1, 4).mean(axis=1)
            wind = weather.values[: task.steps, COLUMNS.index("wind")].reshape(-1, 4).mean(axis=1)
            for hour in range(len(temperature) - 24):
                for column, ahead in enumerate(HOURS):
                    assert seen[4 * hour, row, 1, column] == pytest.approx(temperature[hour + ahead - 1], abs=1e-5)
                    assert seen[4 * hour, row, 3, column] == pytest.approx(wind[hour + ahead - 1], abs=1e-5)
            assert weather.times[0].astype("datetime64[Y]").astype(int) + 1970 in getattr(task.splits, split).years


def test_a_place_with_half_hours_has_its_own_clear_sky(levels: dict[str, TaskSpec]) -> None:
    """Rows that begin half an hour into UTC: the hour's mean lies between those of its two halves' hours."""
    found = ForecastTable.of(levels["medium"])
    assert found is not None
    times = np.datetime64("2011-04-01T00:30:00") + np.arange(24) * np.timedelta64(3600, "s")
    half, full = found._clear_sky(times), clear_sky(found.place, 0)[90]
    between = (full[:-1] + full[1:]) / 2.0
    assert np.abs(half[:-1] - between)[between > 100.0].max() < 8.0
    leap = np.array([np.datetime64("2012-12-31T12:00:00")])
    assert found._clear_sky(leap)[0] == clear_sky(found.place, 0)[364, 12]


def test_wandering_paths_keep_their_size_and_persistence() -> None:
    key = np.array([[1, 2]], np.uint64)
    paths = ar1_paths(key, 60_000, np.array([0.9, 0.979]))
    assert paths.std(axis=0) == pytest.approx([1.0, 1.0], abs=0.08)
    for path, phi in zip(paths.T, (0.9, 0.979), strict=True):
        assert np.corrcoef(path[:-1], path[1:])[0, 1] == pytest.approx(phi, abs=0.006)
    many = np.array([ar1_paths(np.array([[k, 5]], np.uint64), 1, np.array([0.9]))[0, 0] for k in range(4000)])
    assert many.std() == pytest.approx(1.0, abs=0.04)
    assert np.abs(many).max() <= 3.0
    assert (ar1_paths(key, 50, np.array([0.9, 0.979])) == paths[:50]).all()


def test_mistakes_are_named(folder: Path) -> None:
    with pytest.raises(TaskError, match="nearest first"):
        spring(folder / "wrong.toml", observation=forecast(hours=(3, 1)))
    with pytest.raises(TaskError, match="medium"):
        spring(folder / "wrong.toml", observation=forecast("medum"))
    slow = spring(folder / "slow.toml", weather="step_seconds = 2400")
    with pytest.raises(TaskError, match="does not divide"):
        Simulation(slow, 1, StillKernel())
