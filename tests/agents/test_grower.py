"""The grower at the process computer: a page of settings, and the set points that follow from it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.agents import read_baseline
from glbench.agents.daylight import sun_hours
from glbench.agents.grower import GrowerAgent, GrowerSettings, read_grower_settings
from glbench.env import Simulation
from glbench.errors import ShapeError, SubmissionError
from glbench.tasks import TaskCard, TaskSpec, get_task, task_card

SETTINGS = Path(__file__).resolve().parents[2] / "baselines" / "grower" / "settings.toml"


@pytest.fixture(scope="module")
def task() -> TaskSpec:
    """The paper's greenhouse and spring by local time, with a process computer and sensors that do not err."""
    changed = {"kind": "process_computer"}, {"preprocessing": "conserving"}
    return get_task("Schiphol2010-Delta10-v1").replace(schema=2, actuation=changed[0], weather=changed[1])


@pytest.fixture(scope="module")
def card(task: TaskSpec) -> TaskCard:
    return task_card(task)


@pytest.fixture(scope="module")
def settings() -> GrowerSettings:
    return read_grower_settings(SETTINGS)


def observed(card: TaskCard, hour: float, **values: float) -> NDArray[np.float32]:
    """One row of observations on day 80 (21 March) at an hour of the day, other columns 0 unless given."""
    turns = {"hour_of_day": hour / 24.0, "day_of_year": 80.0 / 365.0}
    clock = {
        f"{side}_{name}": wave(2.0 * np.pi * turn) for name, turn in turns.items() for side, wave in (("sin", np.sin), ("cos", np.cos))
    }
    row = [(clock | values).get(name, 0.0) for name in card.observation_names]
    return np.array([row], dtype=np.float32)


def entered(card: TaskCard, settings: GrowerSettings, hour: float, **values: float) -> dict[str, float]:
    agent = GrowerAgent(settings)
    agent.reset(card, 1)
    actions = agent.act(observed(card, hour, **values))[0].tolist()
    assert all(-1.0 <= given <= 1.0 for given in actions)
    return {one.name: round(one.value(given), 9) for one, given in zip(card.actions, actions, strict=True)}


def where(card: TaskCard) -> tuple[float, float, str, int]:
    """Place, clock and year, as ``sun_hours`` takes them."""
    return card.place.latitude, card.place.longitude, card.clock, card.start.year


def test_the_sun_rises_and_sets_when_it_does(card: TaskCard) -> None:
    """Schiphol, by the almanac: 1 March 7:24 to 18:18, 21 April 6:28 to 20:43 in summer time."""
    assert sun_hours(*where(card), 59) == pytest.approx((7.4, 18.3), abs=0.15)
    assert sun_hours(*where(card), 110) == pytest.approx((6.47, 20.72), abs=0.15)


def test_temperatures_follow_the_periods_of_the_day(card: TaskCard, settings: GrowerSettings) -> None:
    sunrise, sunset = sun_hours(*where(card), 80)
    heating = {hour: entered(card, settings, hour)["heating_temperature"] for hour in np.arange(0.0, 24.0, 0.25)}
    for hour, found in heating.items():
        if sunrise - 1.0 <= hour < sunset - 1.0:
            assert found == 19.5
        elif sunset - 1.0 < hour < sunset + 4.0:
            assert found == 16.0
        else:
            assert found == 17.0
    noon, midnight = entered(card, settings, 12.0), entered(card, settings, 0.0)
    assert noon["ventilation_temperature"] == 21.5
    assert midnight["ventilation_temperature"] == 19.5
    assert (noon["humidity_deficit"], midnight["humidity_deficit"]) == (3.0, 2.7)
    assert (noon["screen_outdoor_temperature"], midnight["screen_outdoor_temperature"]) == (8.0, 14.0)


def test_light_raises_temperatures_by_day_only(card: TaskCard, settings: GrowerSettings) -> None:
    half = entered(card, settings, 12.0, global_radiation=300.0)
    assert half["heating_temperature"] == pytest.approx(19.5 + 0.75)
    assert half["ventilation_temperature"] == pytest.approx(19.5 + 0.75 + 2.0 + 1.5)
    assert entered(card, settings, 12.0, global_radiation=900.0)["heating_temperature"] == 21.0
    assert entered(card, settings, 0.0, global_radiation=900.0)["heating_temperature"] == 17.0


def test_light_is_a_mean_of_the_last_hour(card: TaskCard, settings: GrowerSettings) -> None:
    agent = GrowerAgent(settings)
    agent.reset(card, 1)
    given = [agent.act(observed(card, 12.0, global_radiation=light))[0, 0] for light in [0.0] + [500.0] * 24]
    heating = [card.actions[0].value(one) for one in given]
    assert heating[0] == pytest.approx(19.5)
    assert 19.5 < heating[2] < heating[4] < 20.8
    assert heating[-1] == pytest.approx(21.0, abs=0.02)


def test_co2_follows_the_vents_and_the_light(card: TaskCard, settings: GrowerSettings) -> None:
    def co2(**values: float) -> float:
        return entered(card, settings, 12.0, **values)["co2_set_point"]

    assert co2(global_radiation=100.0) == 850.0
    assert co2(global_radiation=100.0, vents=0.15) == pytest.approx(650.0, abs=0.1)
    assert co2(global_radiation=100.0, vents=0.6) == 450.0
    assert co2(global_radiation=4.9) == 400.0


def test_lamps_stay_off_unless_they_are_used(card: TaskCard, settings: GrowerSettings) -> None:
    page = entered(card, settings, 4.0)
    assert (page["lamps_from"], page["lamps_until"], page["lamp_radiation_limit"]) == (0.0, 0.0, 0.0)
    lit = settings.model_copy(update={"lamps": settings.lamps.model_copy(update={"used": True})})
    page = entered(card, lit, 4.0)
    assert (page["lamps_from"], page["lamps_until"], page["lamp_radiation_limit"]) == (2.0, 18.0, 250.0)


def test_the_highest_set_point_is_entered_as_it_is(card: TaskCard, settings: GrowerSettings) -> None:
    heating = settings.heating.model_copy(update={"day": 28.5})
    page = entered(card, settings.model_copy(update={"heating": heating}), 12.0, global_radiation=900.0)
    assert page["heating_temperature"] == 30.0  # 1.5 K more in full light
    assert page["ventilation_temperature"] == 35.0


def test_a_run_gets_the_same_set_points_alone_and_in_a_batch(task: TaskSpec, settings: GrowerSettings) -> None:
    card, n = task_card(task), 3
    agents = [GrowerAgent(settings) for _ in range(n + 1)]
    for agent, rows in zip(agents, (n, 1, 1, 1), strict=True):
        agent.reset(card, rows)
    simulation = Simulation(task, n, "fast")
    observations = simulation.reset([1, 2, 3])
    for _ in range(100):
        actions = agents[0].act(observations)
        for row in range(n):
            assert agents[row + 1].act(observations[row : row + 1]).tobytes() == actions[row : row + 1].tobytes()
        observations = simulation.step(actions).observations


def test_a_week_of_spring_stays_within_sensible_bounds(task: TaskSpec) -> None:
    agent = read_baseline("grower").make(task_card(task))
    assert isinstance(agent, GrowerAgent)
    agent.reset(task_card(task), 2)
    simulation = Simulation(task, 2, "fast")
    observations, air = simulation.reset([1, 2]), []
    for _ in range(7 * 96):
        observations = simulation.step(agent.act(observations)).observations
        air.append(simulation.air)
    temperature, co2, _ = np.stack(air)[96:].transpose(1, 0, 2)
    assert temperature.min() > 12.0
    assert temperature.max() < 34.0
    assert 15.5 < temperature.mean() < 20.0
    assert co2.max() < 1600.0


def test_a_task_without_a_computer_or_without_a_clock_is_refused(card: TaskCard, settings: GrowerSettings) -> None:
    with pytest.raises(SubmissionError, match=r"works at a process computer, and .* has the actuation 'rate'"):
        GrowerAgent(settings).reset(task_card(get_task("Schiphol2010-Delta00-v1")), 1)
    blind = dataclasses.replace(card, observations=tuple(q for q in card.observations if "hour" not in q.name))
    with pytest.raises(SubmissionError, match="sin_hour_of_day, cos_hour_of_day"):
        GrowerAgent(settings).reset(blind, 1)


def test_as_many_rows_as_runs_are_needed(card: TaskCard, settings: GrowerSettings) -> None:
    agent = GrowerAgent(settings)
    agent.reset(card, 2)
    with pytest.raises(ShapeError, match="of 1 runs, reset was called with 2"):
        agent.act(observed(card, 12.0))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("day = 19.5", "day = 195.0", r"'heating.day'"),
        ("day = 19.5", "day = 48.0", r"'heating.day' is 48 degC; it must be from 0 to 30 degC"),
        ("day = 19.5", "day = 29.0", r"heating.day \+ heating.light_raise is 30.5 degC, .* heating temperature from 0 to 30 degC"),
        ("light_raise = 3.0", "light_raise = 19.0", r"is 42 degC, .* ventilation temperature from 5 to 40 degC"),
        ("shut = 850.0", "shut = 1700", r"'co2.shut' is 1700 ppm; it must be from 0 to 1600 ppm"),
        ("day = 3.0", "day = 9.0", r"'humidity_deficit.day' is 9 g m-3; it must be from 0 to 8 g m-3"),
        ("outdoor_day = 8.0", "outdoor_day = 31", r"'screen.outdoor_day' is 31 degC; it must be from -10 to 30 degC"),
        ("day = 19.5", "day = 19,5", r"line 18, 'day = 19,5': write 19.5, not 19,5"),
        ("used = false", "", r"'lamps.used'"),
        ("shut = 850.0", "shutt = 850.0", r"'co2.shutt'"),
        ("light_full = 500.0", "light_full = 50.0", "light_from = 100 must be below light_full = 50"),
        ("[co2]", "[co2", "no valid TOML"),
    ],
)
def test_settings_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = SETTINGS.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "settings.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(SubmissionError, match=said):
        read_grower_settings(path)


def test_it_plays_the_task_of_the_suite() -> None:
    task = get_task("SpringSetpoints-v1")
    agent, simulation = read_baseline("grower").make(task_card(task)), Simulation(task, 2, "fast")
    assert isinstance(agent, GrowerAgent)
    agent.reset(task_card(task), 2)
    observations = simulation.reset([1, 2])
    for _ in range(96):
        observations = simulation.step(agent.act(observations)).observations
    assert simulation.air[0].min() > 10.0
