"""The outlook knows what is shown, is better than persistence and the mean day, and goes with an agent as a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from glbench.control import Climatology, Outlook, Scenario
from glbench.control.climatology import sine_of_elevation
from glbench.control.price_forecast import PriceForecast
from glbench.env import Simulation
from glbench.errors import TaskError
from glbench.tasks import get_task
from glbench.weather import conserving, load_weather
from tests.control.watched import Floats, climatology, short, watch, watched

SEEN = (0, 1, 2, 3, 4)
"""Disturbances that follow from what is shown: radiation, temperature, vapour pressure, CO2, wind."""
SOIL = 6
AHEAD = (4, 12, 24, 48)
"""A day ahead persistence wins now and then."""


def ahead_of(task_id: str, climate: Climatology, every: int = 7) -> tuple[Floats, Floats]:
    """Errors ``(rows, n, 96, d)`` of the outlook and of persistence."""
    given = watched(task_id)
    outlook = Outlook(given.task, climate)
    outlook.reset(2)
    ours, kept = [], []
    for k, seen in enumerate(given.seen[: given.task.steps - 96]):
        outlook.update(seen)
        if k % every == 0:
            true = given.d[:, k : k + 96]
            ours.append(outlook.ahead(96).d - true)
            kept.append(given.d[:, k, None] - true)
    return np.array(ours), np.array(kept)


def rms(errors: Floats) -> Floats:
    """By steps ahead and disturbance."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=(0, 1))))


@pytest.mark.parametrize("task_id", ["Spring-v1", "Lettuce-v1", "Schiphol2010-Delta10-v1"])
def test_what_is_shown_is_what_acts_next_and_what_has_acted(task_id: str) -> None:
    given = watched(task_id)
    outlook = Outlook(given.task, climatology(task_id))
    outlook.reset(2)
    outlook.update(given.seen[0])
    assert outlook.past.tobytes() == outlook.ahead(1).d[:, 0].tobytes()
    for k in range(1, 50):
        outlook.update(given.seen[k])
        shown = [*SEEN, SOIL]
        np.testing.assert_allclose(outlook.ahead(2).d[:, 0, shown], given.d[:, k, shown], rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(outlook.past[:, shown], given.d[:, k - 1, shown], rtol=1e-3, atol=1e-3)


def test_where_weather_is_shown_late_the_row_that_acts_next_is_expected() -> None:
    given = watched("Schiphol2010Code-Delta10-v1")
    outlook = Outlook(given.task, climatology("Schiphol2010Code-Delta10-v1"))
    outlook.reset(2)
    for k, seen in enumerate(given.seen[:60]):
        outlook.update(seen)
        expected = given.d[:, max(k - 1, 0)]
        np.testing.assert_allclose(outlook.past[:, SEEN], expected[:, SEEN], rtol=1e-3, atol=1e-3)
        temperature = outlook.ahead(3).d[:, :, 1]
        assert np.abs(temperature - given.d[:, k : k + 3, 1]).max() < 2.5


@pytest.mark.parametrize("task_id", ["Spring-v1", "Lettuce-v1", "Schiphol2010-Delta10-v1"])
def test_the_calendar_is_that_of_the_run(task_id: str) -> None:
    given = watched(task_id)
    outlook = Outlook(given.task, climatology(task_id))
    outlook.reset(2)
    calendars = [Scenario.of(given.task, seed).calendar for seed in given.seeds]
    for k in range(30):
        outlook.update(given.seen[k])
        found = outlook.ahead(96).calendar
        for run in range(2):
            np.testing.assert_allclose(found[run], calendars[run][k : k + 97], rtol=0, atol=1e-9)


def test_summer_time_begins_in_the_calendar_too() -> None:
    task = get_task("SpringMismatch-v1").replace(
        {"id": "my/March-v1", "weather.start": "2010-03-26", "weather.days": 4, "scenario.start_within_days": 0}
    )
    given = watch(task, 1)
    outlook = Outlook(task, climatology("SpringMismatch-v1"))
    expected = Scenario.of(task, given.seeds[0]).calendar
    for k in range(200):
        outlook.update(given.seen[k])
        np.testing.assert_allclose(outlook.ahead(96).calendar[0], expected[k : k + 97], rtol=0, atol=1e-9)


@pytest.mark.parametrize("task_id", ["Spring-v1", "Schiphol2010-Delta10-v1"])
def test_it_is_better_than_persistence_and_the_mean_day(task_id: str) -> None:
    climate = climatology(task_id)
    ours, kept = (rms(part) for part in ahead_of(task_id, climate))
    mean, _ = (rms(part) for part in ahead_of(task_id, climate.without_deviations()))
    for lead in AHEAD:
        better = (ours[lead] <= 1.05 * kept[lead]) & (ours[lead] <= 1.05 * mean[lead])
        assert better[list(SEEN)].sum() >= 4, f"{lead} steps ahead"
    assert ours[48, 0] < 0.5 * kept[48, 0]  # the sun sets


def test_a_forecast_is_used() -> None:
    task_id = "Spring-v1"
    climate = climatology(task_id)
    weights = climate.weights.copy()
    weights[..., 2] = 0.0
    blind = climate.of_settings({**climate.settings(), "weights": weights.tolist()})
    with_it, without = (rms(ahead_of(task_id, one)[0]) for one in (climate, blind))
    assert (with_it[[12, 24, 48, 95]][:, [0, 1, 4]] < without[[12, 24, 48, 95]][:, [0, 1, 4]]).all()


def test_rows_that_are_shown_ahead_are_taken_as_they_are() -> None:
    task = short("Schiphol2010-Delta10-v1").replace(
        {"id": "my/Ahead-v1", "weather.days": 2, "observation.forecast": {"steps": 8},
         "observation.modules": ["indoor_climate", "time", "controls", "weather", "forecast"]}
    )  # fmt: skip
    given = watch(task, 1)
    outlook = Outlook(task, climatology("Schiphol2010-Delta10-v1"))
    for k in range(20):
        outlook.update(given.seen[k])
    found = outlook.ahead(9).d[0]
    np.testing.assert_allclose(found[:, SEEN], given.d[0, 19:28][:, SEEN], rtol=1e-3, atol=1e-3)


def test_a_run_has_the_same_bits_alone_and_in_a_batch() -> None:
    given, climate = watched("Spring-v1"), climatology("Spring-v1")
    both = Outlook(given.task, climate)
    alone = [Outlook(given.task, climate) for _ in given.seeds]
    both.reset(2)
    for k in range(60):
        both.update(given.seen[k])
        for run, one in enumerate(alone):
            one.update(given.seen[k, run : run + 1])
    for run, one in enumerate(alone):
        assert one.ahead(96).d[0].tobytes() == both.ahead(96).d[run].tobytes()


def test_a_climatology_is_a_small_file(tmp_path: Path) -> None:
    made, file = climatology("Spring-v1"), tmp_path / "climatology.json"
    made.write(file)
    read = Climatology.read(file)
    assert file.stat().st_size < 50_000
    assert read.settings() == made.settings()
    file.write_text("{}", encoding="utf-8")
    with pytest.raises(TaskError, match="no climatology"):
        Climatology.read(file)
    with pytest.raises(TaskError, match="no climatology in"):
        Climatology.read(tmp_path / "none.json")
    with pytest.raises(TaskError, match="have the shapes"):
        Climatology.of_settings({**made.settings(), "sky": [1.0]})


def test_a_climatology_is_of_the_training_years_or_of_years_before() -> None:
    assert climatology("Spring-v1").years == (2008, 2009, 2010)
    assert climatology("Schiphol2010-Delta10-v1").years == (2008, 2009)


def test_a_year_that_is_not_named_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """No hour of another year than the training's is in it."""
    from glbench import weather

    asked: list[int] = []
    disturbances = weather.disturbances

    def watching(record: object, **options: object) -> object:
        asked.append(options["start"].year)  # type: ignore[attr-defined]
        return disturbances(record, **options)  # type: ignore[arg-type]

    task = short("Spring-v1").replace({"id": "my/Two-v1", "scenario.start_within_days": 0})
    Climatology.of(task)  # the task's own weather is kept from here on, whatever ran before
    monkeypatch.setattr(weather, "disturbances", watching)
    Climatology.of(task)
    assert sorted(asked) == [2008, 2009, 2010]


def test_the_sun_stands_where_a_better_formula_has_it() -> None:
    place = load_weather("schiphol").place
    times = 1.26e9 + 3600.0 * np.arange(8760.0)
    expected = conserving.sine_of_elevation(times, place)
    assert np.abs(sine_of_elevation(times, place.latitude, place.longitude) - expected).max() < 0.01


def test_what_does_not_fit_is_refused() -> None:
    task, climate = short("Spring-v1"), climatology("Spring-v1")
    with pytest.raises(TaskError, match="needs the weather of now"):
        Outlook(task.replace({"id": "my/A-v1", "observation": {"modules": ["indoor_climate", "time"], "forecast": None}}), climate)
    with pytest.raises(TaskError, match="hour of day"):
        Outlook(task.replace({"id": "my/B-v1", "observation": {"modules": ["indoor_climate", "weather"], "forecast": None}}), climate)
    with pytest.raises(TaskError, match="forecasts of the hours"):
        Outlook(task, climatology("SpringMismatch-v1"))
    outlook = Outlook(task, climate)
    with pytest.raises(TaskError, match="Nothing was observed"):
        outlook.ahead(4)
    with pytest.raises(TaskError, match=r"shape of the observations of my/Short-v1: expected \(1, 50\), .* got \(2, 3\)"):
        outlook.update(np.zeros((2, 3)))
    with pytest.raises(TaskError, match=r"got PosixPath.*Climatology\.of\(task\).*Climatology\.read\(path\)"):
        Outlook(task, Path("climatology.json"))  # type: ignore[arg-type]


def test_a_climatology_of_other_weather_is_refused() -> None:
    spring, paper = climatology("Spring-v1"), short("Schiphol2010-Delta10-v1").replace(id="my/Paper-v1")
    with pytest.raises(TaskError, match=r"prepared as 'conserving', and the task has 'paper'; it knows 2010, which the"):
        Outlook(paper, spring)
    with pytest.raises(TaskError, match="it is of the weather 'schiphol', and the task has 'miami'"):
        Outlook("Transfer-Miami-v1", spring)
    for changes, reason in (
        ({"weather.start": "2010-07-01"}, "days from 15 February to 22 March, and the task needs 1 July to 4 August"),
        ({"weather.start": "2010-02-01"}, "the task needs 1 February to 7 March"),
        ({"weather.step_seconds": 1800}, "its steps are 900 s long, and those of the task 1800 s"),
    ):
        other = short("Spring-v1").replace({"id": "my/Other-v1", **changes})
        with pytest.raises(TaskError, match=f"of my/Short-v1 is not for my/Other-v1: .*{reason}"):
            Outlook(other, spring)
    knowing = Climatology.of_settings({**spring.settings(), "years": [2008, 2012], "task": "my/Knowing-v1"})
    with pytest.raises(TaskError, match="it knows 2012, which the task scores"):
        Outlook(short("Spring-v1"), knowing)


def test_a_climatology_serves_other_tasks_with_its_weather() -> None:
    spring = climatology("Spring-v1")
    for task_id in ("Lettuce-v1", "SpringMismatch-v1", "Transfer-House-LED2021-v1"):
        Outlook(get_task(task_id).replace({"id": "my/Variant-v1", "weather.days": 6}), spring)
    Outlook(short("Spring-v1").replace({"id": "my/Later-v1", "weather.start": "2010-03-01", "weather.days": 1}), spring)


LATE = "Schiphol2010Code-Delta10-v1"
WEATHER = ("global_radiation", "outdoor_temperature", "outdoor_relative_humidity", "outdoor_co2", "wind_speed")


def with_gaps(task_id: str, rows: slice, ending: str = "", run: int = 1) -> Floats:
    """Observations without the outdoor columns of a run, or without their forecast."""
    given = watched(task_id)
    columns = [i for i, column in enumerate(given.task.observed()) if column.name.startswith(WEATHER)]
    kept = [i for i in columns if ("_in_" in given.task.observed()[i].name) == bool(ending)]
    seen = given.seen.astype(np.float64)
    seen[rows, run, np.array(kept)[:, None]] = np.nan
    return seen


@pytest.mark.parametrize("task_id", ["Spring-v1", "Schiphol2010-Delta10-v1", LATE])
def test_missing_weather_is_what_was_expected(task_id: str) -> None:
    given, gaps = watched(task_id), with_gaps(task_id, slice(30, 40))
    outlook, whole = (Outlook(given.task, climatology(task_id)) for _ in range(2))
    outlook.reset(2)
    whole.reset(2)
    for k in range(45):
        expected = outlook.ahead(2).d[1, 1, SEEN] if k else None
        outlook.update(gaps[k])
        whole.update(given.seen[k])
        assert outlook.past[0].tobytes() == whole.past[0].tobytes()
        assert outlook.ahead(9).d[0].tobytes() == whole.ahead(9).d[0].tobytes()
        if 30 <= k < 40:
            assert expected is not None
            if task_id != LATE:  # what is shown there acted in the step before
                np.testing.assert_allclose(outlook.ahead(1).d[1, 0, SEEN], expected, rtol=1e-12)
            assert np.isfinite(outlook.ahead(96).d).all()
            assert np.abs(outlook.past[1, 1] - given.d[1, k - 1, 1]) < 3.0
    assert outlook.past[1, SEEN].tobytes() == whole.past[1, SEEN].tobytes()


def test_before_anything_is_seen_missing_weather_is_the_mean_day() -> None:
    task_id = "Spring-v1"
    for other in (task_id, LATE):
        given = watched(other)
        outlook = Outlook(given.task, climatology(other))
        outlook.reset(2)
        outlook.update(with_gaps(other, slice(0, 1))[0])
        mean = climatology(other).mean(outlook._begin)[1]
        assert outlook.ahead(1).d[1, 0, [1, 4]] == pytest.approx(mean[[1, 4]], abs=1e-9)
        assert outlook.past[1, 1] == pytest.approx(mean[1], abs=1e-9)


def test_a_forecast_that_is_missing_says_nothing() -> None:
    task_id = "Spring-v1"
    given, gaps = watched(task_id), with_gaps(task_id, slice(None), "_in_")
    weights = climatology(task_id).weights
    outlook, told = (Outlook(given.task, climatology(task_id)) for _ in range(2))
    outlook.reset(2)
    told.reset(2)
    for k in range(40):
        outlook.update(gaps[k])
        told.update(given.seen[k])
    assert outlook.ahead(96).d[0].tobytes() == told.ahead(96).d[0].tobytes()
    # In its place stands what was seen of late.
    lead, lately, now = 12, outlook._deviations.lately[1, 1], outlook._deviations.now[1, 1]
    shares = weights[3, 1]  # three hours
    mean = climatology(task_id).mean(outlook._begin + (39 + lead) * 900.0)[1, 1]
    expected = mean + shares[0] * now + (shares[1] + shares[2]) * lately
    assert outlook.ahead(96).d[1, lead, 1] == pytest.approx(expected, abs=1e-9)


def test_a_reading_that_cannot_be_missing_is_named() -> None:
    given, climate = watched("Spring-v1"), climatology("Spring-v1")
    names = [column.name for column in given.task.observed()]
    outlook, seen = Outlook(given.task, climate), given.seen[:2].copy()
    outlook.reset(2)
    seen[:, 1, names.index("cos_hour_of_day")] = np.nan
    with pytest.raises(TaskError, match=r"'cos_hour_of_day' in row 1 .* is missing \(NaN\)\. .* the time in the first"):
        outlook.update(seen[0])
    outlook.update(given.seen[0])
    outlook.update(seen[1])  # known by then
    seen[1, 0, names.index("wind_speed")] = np.inf
    with pytest.raises(TaskError, match=r"'wind_speed' in row 0 of the observations of my/Short-v1 is infinite"):
        outlook.update(seen[1])


def test_prices_of_a_market_are_known_until_midnight_and_then_follow_sun_wind_and_the_last_price() -> None:
    given = watch(short("WinterLED-v1", 5).chosen_on, 2)
    outlook = Outlook(given.task, climatology("WinterLED-v1"))
    outlook.reset(2)
    column = 2 + list(given.task.price_tables).index("power")
    prices = np.stack([Scenario.of(given.task, seed).calendar[:, column] for seed in given.seeds])
    ours, clock = [], []
    for k, shown in enumerate(given.seen[: given.task.steps - 96]):
        outlook.update(shown)
        ahead, true = outlook.ahead(96).calendar[:, :, column], prices[:, k : k + 97]
        np.testing.assert_allclose(ahead[:, 0], true[:, 0], rtol=1e-6)
        if k % 96 == 0:  # at midnight the hours 1 to 6 of the day are shown
            np.testing.assert_allclose(ahead[:, :28], true[:, :28], rtol=1e-6)
        ours.append(ahead - true)
        clock.append(true - true.mean())
    assert np.mean(np.array(ours)[:, :, 48] ** 2) < 0.5 * np.mean(np.array(clock)[:, :, 48] ** 2)
    assert outlook.ahead(960).calendar.shape == (2, 961, 2 + len(given.task.price_tables))  # as far beyond the season as is asked


@pytest.mark.parametrize(
    "changes",
    [
        {"price_tables.power.plus": 0.05},
        {"price_tables.power.times": 2.0},
        {"observation.day_ahead.prices": ["power_bought"]},
        {"observation.modules": "no prices"},
    ],
)
def test_shown_prices_are_used_in_whatever_table_they_are(changes: dict[str, object]) -> None:
    """A market with a surcharge of its own, hours ahead of the table that follows it, and hours ahead without the price of now."""
    base = get_task("SpringEnergy-v1")
    if "observation.modules" in changes:
        changes = {"observation.modules": [module for module in base.observation.modules if module != "prices"]}
    task = base.replace({"id": "my/Short-v1", "weather.days": 2, **changes}).in_split("training")
    outlook, simulation = Outlook(task, Climatology.of(base.in_split("training"))), Simulation(task, 1, kernel="fast")
    outlook.reset(1)
    outlook.update(simulation.reset([3]))
    expected, true = outlook.ahead(24).calendar[0, :, 2:], Scenario.of(task, 3).calendar[:25, 2:]
    np.testing.assert_allclose(expected[4:], true[4:], rtol=1e-6)  # the price of now is shown by the module prices alone


def test_prices_begin_with_the_day_where_clocks_differ_by_half_hours() -> None:
    task, begin = short("WinterLED-v1"), np.array([1284661800.0])  # midnight in Kolkata
    forecast = PriceForecast(task, ["price_power"], "Asia/Kolkata", begin)
    forecast.update(0, np.array([[0.2]]), np.array([[0.0, 5.0]]))
    prices = forecast.ahead(0, np.tile([0.0, 5.0], (1, 96, 1)))["power"][0]
    market = task.price_tables["power"].market
    assert market is not None
    shape = np.array(market.shape)
    assert prices[0] == pytest.approx(0.2)
    changes = np.diff(prices[:-1:4] / market.level - shape)  # what is left of the unexplained part of the first price fades
    assert np.abs(changes).max() < 0.05
