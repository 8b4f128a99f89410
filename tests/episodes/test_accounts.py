"""What a run grew, used and earned by week, in a grower's units, and the clock of the greenhouse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from glbench.episodes import by_week, read_episode
from glbench.episodes.episode import line_values, local_days, weeks_of
from glbench.episodes.signals import KWH_A_CUBIC_METRE, signals_of
from glbench.errors import EpisodeError
from glbench.tasks import get_task


def at(start: str, *, hours: int) -> np.ndarray:
    return np.datetime64(start, "s") + np.arange(hours + 1) * np.timedelta64(3600, "s")


@pytest.fixture(scope="module")
def day(episode_file):
    return read_episode(episode_file)


def test_a_week_is_the_sum_of_its_steps(day):
    frame = by_week(day)
    assert frame["days"].tolist() == [1]
    for name in ("fruit_fresh", "heat", "co2_dosed", "cost_heat", "epi", "reward"):
        assert frame[name].sum() == pytest.approx(float(day[name].sum()), rel=1e-12), name


def test_a_run_without_steps_is_refused_in_words(day):
    none = replace(day, times=day.times[:1], tables={name: table[:0] for name, table in day.tables.items()})
    with pytest.raises(EpisodeError, match="no steps to show"):
        by_week(none)
    plots = pytest.importorskip("glbench.episodes.plots")
    with pytest.raises(EpisodeError, match="nothing to draw"):
        plots.typical_day(none)


def test_a_part_of_an_episode_says_of_how_many_steps(day):
    part = replace(day, times=day.times[:6], tables={name: table[:5] for name, table in day.tables.items()}).to_frame()
    assert (len(part), part.attrs["steps"]) == (5, day.steps)


def test_heat_is_told_as_gas_by_its_lower_heating_value(day):
    """31.65 MJ m-3 are 8.79 kWh m-3: 10 kWh of heat are 1.137 m3."""
    assert pytest.approx(1.1374, abs=1e-4) == 10.0 / KWH_A_CUBIC_METRE
    frame = by_week(day)
    assert frame["heat_cubic_metres"].sum() == pytest.approx(float(day["heat"].sum()) * 3.6 / 31.65)
    assert frame.attrs["units"]["heat_cubic_metres"] == "m3 m-2"


def test_light_of_a_day_is_that_since_midnight_at_its_end_and_outside_follows_from_radiation(day):
    frame, signals = by_week(day), signals_of(day.task())
    light = line_values(day, signals, next(line for line in signals.accounts if line.name == "par_today"))
    # The record counts anew from midnight, where the last step ends.
    assert light[:-1].sum() == pytest.approx(float(day["par_today"].max()), rel=1e-9)
    assert frame["par_today"].iloc[0] == pytest.approx(light.sum(), rel=1e-12)
    # 1 J cm-2 of global radiation is half PAR, 4.6 umol for each joule: 0.023 mol m-2.
    outside = float(day["iGlob"].sum()) * 3600.0 * 1e-4 * 0.023
    assert frame["radiation_today"].iloc[0] == pytest.approx(outside, rel=1e-9)
    assert frame.attrs["units"]["radiation_today"] == "mol m-2 d-1"


def test_local_times_show_the_hours_of_the_clock(day):
    local = day.local_times
    hours = (local[1:] - local[1:].astype("datetime64[D]")) / np.timedelta64(1, "h")
    assert np.allclose(hours % 24.0, day["hour_of_day"] % 24.0, atol=1e-6)
    assert len(local) == day.steps + 1


def test_the_hour_after_midnight_by_which_summer_time_lets_a_run_end_belongs_to_its_last_day():
    clock = at("2010-03-12", hours=8 * 24 + 1)
    days = local_days(clock)
    assert days[0] == 0
    assert days[-1] == days[-2] == 7
    assert local_days(at("2010-03-12", hours=36)).tolist() == [0] * 24 + [1] * 12


def test_weeks_begin_every_seventh_day_and_light_is_the_mean_of_their_days(day):
    signals, clock = signals_of(day.task()), at("2010-03-12", hours=9 * 24)
    steps = 9 * 24
    run = {name: np.resize(np.asarray(day[name], dtype=np.float64), steps) for name in day.names}
    weeks = weeks_of(run, signals, clock)
    assert weeks.first.astype(str).tolist() == ["2010-03-12", "2010-03-19"]
    assert weeks.days.tolist() == [7, 2]
    names = [line.name for line in signals.accounts]
    heat, light = names.index("heat"), names.index("par_today")
    assert weeks.sums[:, heat] == pytest.approx(np.array([7.0, 2.0]) * float(day["heat"].sum()))
    assert weeks.sums[0, light] == pytest.approx(weeks.sums[1, light])
    assert weeks.sums[0, light] == pytest.approx(float(line_values(day, signals, signals.accounts[light]).sum()))


@pytest.mark.parametrize(
    ("task", "expected"),
    [
        ("Schiphol2010-Delta10-v1", {"Fruit grown, fresh", "Heat as natural gas", "Lamp electricity"}),
        ("SpringEnergy-v1", {"Natural gas", "Power sold", "Running hours of the engine", "CO₂ bought"}),
        ("Lettuce-v1", {"Heads at full price, gained", "Heat as natural gas", "Lamp electricity"}),
    ],
)
def test_each_family_has_its_own_words(task, expected):
    titles = {line.title for line in signals_of(get_task(task)).accounts}
    assert expected <= titles
    assert not titles & {"Electricity", "Light"}


def test_power_is_no_harvest():
    signals = signals_of(get_task("SpringEnergy-v1"))
    crop = next(page for page in signals.pages if page.title == "Crop and harvest")
    assert not any("Power" in curve.title or "Heat" in curve.title for curve in crop.curves)
    assert [amount.column for amount in signals.harvest] == ["fruit_gained", "fruit_picked"]


def test_a_time_axis_names_the_clock_of_the_greenhouse(day):
    plots = pytest.importorskip("glbench.episodes.plots", reason="matplotlib is not installed")
    group = next(one for one in day.groups if "hour_of_day" in one.names)
    ahead = {**day.tables, group.name: (day.tables[group.name] + 1.0) % 24.0}
    start = {**day.start, group.name: (day.start[group.name] + 1.0) % 24.0}
    assert group.names == ("hour_of_day",)
    assert plots.climate(day).axes[-1].get_xlabel() == "time (UTC)"
    assert plots.climate(replace(day, tables=ahead, start=start)).axes[-1].get_xlabel() == "local time (UTC+1)"
