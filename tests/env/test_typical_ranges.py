"""Typical ranges of observed columns, and observations normalised by them."""

from __future__ import annotations

import hashlib
from importlib.resources import files

import gymnasium
import numpy as np
import pytest

from glbench.env import GreenhouseEnv, GreenhouseVectorEnv
from glbench.tasks import Normalisation, TaskSpec, get_task, list_drafts, list_tasks, task_card

PUBLISHED = "b73580e907db7d1d7c31b79bd2c394ea4244728d747cb507194cf428458eb9c9"


def test_published_ranges_do_not_change() -> None:
    """Policies were trained on them. New columns go to the end: extend ``lines`` then."""
    text = files("glbench.tasks").joinpath("typical_ranges.csv").read_text(encoding="utf-8")
    lines = text.splitlines(keepends=True)[:26]
    assert hashlib.sha256("".join(lines).encode()).hexdigest() == PUBLISHED


@pytest.mark.parametrize("task", [*list_tasks(), *list_drafts()], ids=lambda task: task.short_id)
def test_every_column_has_a_range_within_its_bounds(task: TaskSpec) -> None:
    for column in task.observed():
        low, high = column.typical
        assert column.low - 1e-3 <= low < high <= column.high, column.name


def test_a_forecast_has_the_range_of_what_it_forecasts_and_the_others_their_bounds() -> None:
    columns = {column.name: column for column in get_task("Spring-v1").observed()}
    assert columns["co2"].typical == (300.0, 1800.0)
    assert columns["air_temperature"].typical == (12.0, 32.0)
    assert columns["outdoor_temperature_in_24h"].typical == columns["outdoor_temperature"].typical == (-8.0, 28.0)
    for name in ("boiler", "sin_hour_of_day", "outdoor_relative_humidity"):
        assert columns[name].typical == (columns[name].low, columns[name].high)


def test_policies_of_a_task_see_the_same_scale_where_they_are_transferred() -> None:
    home, away = ({q.name: q.typical for q in get_task(name).observed()} for name in ("Spring-v1", "Transfer-House-LED2021-v1"))
    assert {name for name in home if home[name] != away[name]} == {"boiler", "co2_supply", "lamps"}, "shares of what is installed"


def test_normalised_observations_are_the_observations_on_another_scale(day: TaskSpec) -> None:
    plain, shown = GreenhouseEnv(day), GreenhouseEnv(day, normalise=True)
    rows = GreenhouseVectorEnv(day, 2, normalise=True, autoreset_mode="SameStep")
    scale = Normalisation.of(task_card(day).observations)
    observation, seen = plain.reset(seed=3)[0], shown.reset(seed=3)[0]
    assert rows.reset(seed=[3, 4])[0][0].tobytes() == seen.tobytes()
    for _ in range(day.steps):
        assert seen.dtype == np.float32
        assert seen in shown.observation_space
        assert np.array_equal(seen, scale(observation))
        last, before = shown.snapshot(), seen
        observation, reward, *_ = plain.step(np.zeros(6, np.float32))
        seen, same, *_ = shown.step(np.zeros(6, np.float32))
        assert same == reward
        both, _, _, _, info = rows.step(np.zeros((2, 6)))
    assert info["final_obs"][0].tobytes() == seen.tobytes()
    assert both[0] in rows.single_observation_space
    assert np.array_equal(shown.reset(options={"state": last})[0], before)


def test_what_happens_is_about_as_wide_as_the_range() -> None:
    env = gymnasium.make("glbench:glbench/Spring-v1", normalise=True, kernel="fast", overrides={"weather.days": 5})
    env.reset(seed=10_000_000_000)
    rng = np.random.default_rng(0)
    seen = np.stack([env.step(rng.uniform(-1.0, 1.0, 6).astype(np.float32))[0] for _ in range(480)])
    assert np.percentile(np.abs(seen), 99.0) < 3.0
    by_bounds = gymnasium.make("glbench:glbench/Spring-v1").observation_space
    co2 = [q.name for q in get_task("Spring-v1").observed()].index("co2")
    assert np.ptp(seen[:, co2]) > 0.5, "by the bounds it would be a thousandth"
    assert by_bounds.high[co2] > 4e6  # type: ignore[attr-defined]
