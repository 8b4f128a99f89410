"""What a salt changes: every draw of the test, and nothing else. Weather of the round's own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from glbench.env import run_weather
from glbench.env.scenario import RunScenarios
from glbench.errors import GlbenchError, TaskError
from glbench.tasks import Round, SealedWeather, TaskSpec, task_card
from glbench.tasks.sealed import round_weather
from glbench.weather import find_weather, load_weather, save_weather
from tests.rounds.conftest import OTHER, SECRET
from tests.rounds.tiny import REAL_YEARS, tiny_task

SEEDS = list(range(10000, 10006))


def forecast(task: TaskSpec) -> np.ndarray:
    scenarios = RunScenarios(task)
    scenarios.draw(SEEDS)
    return scenarios.pool.tables.forecast.copy()


def test_a_salt_changes_crop_start_sensors_weather_first_days_and_forecasts(tiny: TaskSpec) -> None:
    drawn = [
        RunScenarios(task).draw(SEEDS) for task in (tiny.scored, tiny.in_split("test", SECRET.secret), tiny.in_split("test", OTHER.secret))
    ]
    for one, other in ((0, 1), (0, 2), (1, 2)):
        a, b = drawn[one], drawn[other]
        assert a.parameters is not None
        assert b.parameters is not None
        assert not np.isclose(a.parameters, b.parameters, rtol=1e-6).all(axis=1).any()
        assert (a.traits != b.traits).all(axis=0).any()
        assert (a.states != b.states).any(axis=1).all()
        assert (a.keys != b.keys).all(axis=(1, 2)).all()
        assert (a.first != b.first).any()
    weather = [run_weather(task, 10000).values for task in (tiny.scored, tiny.in_split("test", SECRET.secret))]
    assert (weather[0][:, 1] != weather[1][:, 1]).any()
    assert (forecast(tiny.scored) != forecast(tiny.in_split("test", SECRET.secret))).any()


def test_the_same_secret_gives_the_same_draws(tiny: TaskSpec, tmp_path: Path) -> None:
    one, other = (RunScenarios(task.in_split("test", SECRET.secret)).draw(SEEDS) for task in (tiny, tiny_task(tmp_path)))
    for field in dataclasses.fields(one):
        assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name


# Weather of the round's own


@pytest.fixture
def own_weather(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SealedWeather:
    """A record that nobody else has: that of Schiphol, twenty degrees warmer."""
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))
    record = load_weather("schiphol")
    counts = dict(record.counts)
    counts["air_temperature"] = counts["air_temperature"] + 20_000
    place = dataclasses.replace(record.place, station="Nowhere", latitude=51.9, longitude=4.4)
    save_weather(dataclasses.replace(record, name="secret", counts=counts, place=place), "secret")
    return round_weather("secret", [2009, 2010])


@pytest.mark.parametrize("generated", [True, False], ids=["generated", "real years"])
def test_weather_of_a_round_takes_the_place_of_the_tasks(own_weather: SealedWeather, tmp_path: Path, generated: bool) -> None:
    tiny = tiny_task(tmp_path) if generated else tiny_task(tmp_path, REAL_YEARS)
    sealed = Round("5" * 64, own_weather)
    task = tiny.in_split("test", sealed.secret)
    assert task.season_record().name == "secret"
    assert task.digest == tiny.digest
    outside = [np.concatenate([run_weather(one, seed).values[:, 1] for seed in SEEDS]).mean() for one in (task, tiny.scored)]
    assert outside[0] > 18.0
    assert outside[1] < 13.0
    if not generated:
        assert {season.source for season in task.scenario.seasons} == {"secret"}
        assert [season.start.year for season in task.scenario.seasons] == [2009, 2010]
        return
    assert task.scenario.generated is not None
    assert task.scenario.generated.years == (2009, 2010)


def test_agents_are_told_nothing_of_the_place_of_the_rounds_weather(own_weather: SealedWeather, tiny: TaskSpec) -> None:
    assert task_card(tiny.in_split("test", Round("5" * 64, own_weather).secret)) == task_card(tiny.scored)


def test_another_record_or_other_years_open_another_commitment(own_weather: SealedWeather) -> None:
    commitments = {
        Round("5" * 64, weather).commitment
        for weather in (None, own_weather, dataclasses.replace(own_weather, years=(2009,)), SealedWeather("ab" * 32, own_weather.years))
    }
    assert len(commitments) == 4


def test_a_record_that_is_not_here_is_named(tiny: TaskSpec) -> None:
    task = tiny.in_split("test", Round("5" * 64, SealedWeather("ab" * 32, (2010,))).secret)
    with pytest.raises(TaskError, match="no weather record with the SHA-256 abab"):
        task.season_record()


def test_a_record_is_found_by_its_digest_beside_a_damaged_one(own_weather: SealedWeather, tmp_path: Path) -> None:
    (tmp_path / "data" / "weather" / "broken.parquet").write_bytes(b"no table")
    assert find_weather(own_weather.digest) == "secret"
    assert find_weather(load_weather("schiphol").digest) == "schiphol"


def test_weather_of_another_clock_is_refused(tiny: TaskSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))
    record = load_weather("schiphol")
    place = dataclasses.replace(record.place, timezone="Asia/Tokyo")
    save_weather(dataclasses.replace(record, name="far", place=place), "far")
    task = tiny.in_split("test", Round("5" * 64, round_weather("far", [2010])).secret)
    with pytest.raises(TaskError, match="Asia/Tokyo"):
        task.season_record()


def test_a_year_that_is_not_whole_is_refused() -> None:
    with pytest.raises(GlbenchError):
        round_weather("schiphol", [1800])
