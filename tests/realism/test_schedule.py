"""Lamps, CO2 and set points: every day uses what was measured, at hours that a grower would choose."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.realism import Archive, read_archive, read_settings
from glbench.realism.inputs import DAY, NIGHT, PRE_NIGHT, Outdoors, co2_dose, lamp_shares, last_hour, outdoors, periods, schedule
from tests.realism.made import Made

SETTINGS = read_settings()
POWER = SETTINGS.lamps.power


@pytest.fixture
def archive(tmp_path: Path) -> Archive:
    return read_archive(Made().write(tmp_path))


@pytest.fixture
def outside(archive: Archive) -> Outdoors:
    return outdoors(archive, SETTINGS.place.clock, SETTINGS.place.co2)


def energy(shares: NDArray[np.float64], outside: Outdoors, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
    """kWh m-2 of each day in the chosen steps."""
    return np.bincount(outside.day[chosen], weights=shares[chosen], minlength=3) * POWER * 900 / 3.6e6


def test_each_day_uses_its_electricity_at_each_tariff(archive: Archive, outside: Outdoors) -> None:
    high = (outside.hour >= 7.0) & (outside.hour < 23.0)
    for one in archive.compartments:
        shares = lamp_shares(one, outside, SETTINGS.lamps)
        assert energy(shares, outside, high) == pytest.approx(one.high, rel=1e-12)
        assert energy(shares, outside, ~high) == pytest.approx(one.low, rel=1e-12)
        assert np.all((shares >= 0.0) & (shares <= 1.0))
        assert np.sum((shares > 0.0) & (shares < 1.0)) <= 2 * archive.days, "full power, but for a rest each"


def test_lamps_burn_before_the_morning_and_in_the_dim_hours_first(archive: Archive, outside: Outdoors) -> None:
    shares = lamp_shares(archive.compartments[0], outside, SETTINGS.lamps)
    lit = np.flatnonzero(shares[:96] > 0.0)
    hours = outside.hour[lit]
    assert 3.4 < hours.min() < 3.6, "0.5 kWh of 143 W are 3.5 h before 7"
    dim = outside.of("iGlob")[lit][hours >= 7.0]
    assert dim.max() < SETTINGS.lamps.radiation_limit
    assert hours.max() < 23.0


def test_more_light_than_dim_hours_takes_the_dimmest_of_the_bright(archive: Archive, outside: Outdoors) -> None:
    full = 16.0 * POWER / 1000.0
    most = dataclasses.replace(archive.compartments[0], high=np.full(3, full - 0.1), low=np.zeros(3))
    dark = np.flatnonzero(lamp_shares(most, outside, SETTINGS.lamps)[:96] == 0.0)
    high = dark[(outside.hour[dark] >= 7.0) & (outside.hour[dark] < 23.0)]
    bright = np.sort(outside.of("iGlob")[:96])[-high.size :]
    assert sorted(outside.of("iGlob")[high]) == pytest.approx(bright)


def test_a_day_that_asks_for_too_much_gets_all_lamps(archive: Archive, outside: Outdoors) -> None:
    most = dataclasses.replace(archive.compartments[0], high=np.full(3, 9.0), low=np.full(3, 9.0))
    assert lamp_shares(most, outside, SETTINGS.lamps).min() == 1.0


def test_each_day_doses_its_co2_evenly_in_the_light(archive: Archive, outside: Outdoors) -> None:
    lit = outside.of("iGlob") > 5.0
    daily = np.array([0.02, 0.0, 0.1])
    dose = co2_dose(daily, outside, lit)
    assert np.bincount(outside.day, weights=dose) * 900e-6 == pytest.approx(daily)
    assert np.all(dose[~lit] == 0.0)
    assert np.unique(dose[(outside.day == 2) & lit]).size == 1
    dark = co2_dose(daily, outside, np.zeros(outside.steps, dtype=bool))
    assert np.bincount(outside.day, weights=dark) * 900e-6 == pytest.approx(daily), "a day without light doses anyhow"


def test_periods_follow_light() -> None:
    lit = np.zeros((96, 1), dtype=bool)
    lit[20:40] = True
    found = periods(lit, 2.0)[:, 0]
    assert np.all(found[:20] == NIGHT)
    assert np.all(found[20:40] == DAY)
    assert np.all(found[40:48] == PRE_NIGHT)
    assert np.all(found[48:] == NIGHT)


def test_the_mean_of_the_last_hour() -> None:
    assert last_hour(np.arange(24.0))[[0, 1, 3, 4, 23]] == pytest.approx([0.0, 0.5, 1.5, 2.5, 21.5])


def test_set_points_are_those_of_the_page(archive: Archive, outside: Outdoors) -> None:
    given = schedule(archive.compartments, outside, SETTINGS, most_co2=5.0)
    heat, vents = SETTINGS.heating, SETTINGS.ventilation
    assert np.all(given.heating[given.period == NIGHT] == heat.night)
    assert np.all(given.heating[given.period == PRE_NIGHT] == heat.pre_night)
    by_day = given.heating[given.period == DAY]
    assert by_day.min() == heat.day
    assert heat.day < by_day.max() <= heat.day + heat.light_raise
    gap = given.ventilation - given.heating
    assert np.all(gap[given.period != DAY] == vents.night)
    assert gap[given.period == DAY].min() == pytest.approx(vents.day)
    assert given.dose.max() <= 5.0
    warmer = schedule(archive.compartments, outside, SETTINGS, most_co2=5.0, warmer=2.0)
    assert warmer.heating == pytest.approx(given.heating + 2.0)
    assert warmer.ventilation == pytest.approx(given.ventilation + 2.0)


def test_no_more_co2_than_is_installed(archive: Archive, outside: Outdoors) -> None:
    assert schedule(archive.compartments, outside, SETTINGS, most_co2=0.5).dose.max() == 0.5
