"""Measured weather as disturbances: clock, gaps, sky."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import ArchiveError
from glbench.realism import Archive, read_archive
from glbench.realism.inputs import outdoors
from tests.realism.made import Made

CLOCK = "Europe/Amsterdam"


def archive_of(made: Made, folder: Path) -> Archive:
    return read_archive(made.write(folder))


def quarters(values: object) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Means of three rows each."""
    return np.asarray(values, dtype=np.float64).reshape(-1, 3).mean(axis=1)


def test_a_step_has_the_means_of_its_rows(tmp_path: Path) -> None:
    made = Made()
    outside = outdoors(archive_of(made, tmp_path), CLOCK, 410.0)
    assert outside.steps == 3 * 96
    assert outside.of("iGlob") == pytest.approx(quarters(made.weather["Iglob"][:-1]))
    assert outside.of("tOut") == pytest.approx(quarters(made.weather["Tout"][:-1]))
    assert outside.hour[:3] == pytest.approx([0.0, 0.25, 0.5])
    assert np.bincount(outside.day).tolist() == [96, 96, 96]
    assert outside.of("dayRadSum")[0] == pytest.approx(made.weather["Iglob"][:288].sum() * 3e-4)
    assert outside.notes == ()


def test_steps_of_five_minutes_have_the_rows_themselves(tmp_path: Path) -> None:
    made = Made()
    archive = archive_of(made, tmp_path)
    fine, usual = outdoors(archive, CLOCK, 410.0, step_seconds=300), outdoors(archive, CLOCK, 410.0)
    assert fine.of("iGlob") == pytest.approx(made.weather["Iglob"][:-1])
    assert fine.hour[:3] == pytest.approx([0.0, 1 / 12, 1 / 6])
    for name in ("vpOut", "wind"):
        assert quarters(fine.of(name)) == pytest.approx(usual.of(name)), name
    assert fine.of("dayRadSum")[::3] == pytest.approx(usual.of("dayRadSum"))


def test_the_sky_is_as_warm_as_its_net_radiation_says(tmp_path: Path) -> None:
    made = Made()
    made.weather["Tout"], made.weather["Pyrgeo"] = 10.0, -80.0
    outside = outdoors(archive_of(made, tmp_path), CLOCK, 410.0)
    kelvin = (283.15**4 - 80.0 / 5.67e-8) ** 0.25
    assert outside.of("tSky") == pytest.approx(kelvin - 273.15)
    made.weather["Pyrgeo"] = 0.0
    assert outdoors(archive_of(made, tmp_path), CLOCK, 410.0).of("tSky") == pytest.approx(10.0)


def test_gaps_are_filled_linearly_and_said(tmp_path: Path) -> None:
    made = Made()
    made.weather["Tout"] = np.arange(len(made.weather)) * 0.01
    made.weather.loc[100:123, "Tout"] = np.nan
    made.weather = made.weather.drop(index=[200, 201])
    outside = outdoors(archive_of(made, tmp_path), CLOCK, 410.0)
    assert outside.of("tOut") == pytest.approx(quarters(np.arange(864) * 0.01))
    (note,) = outside.notes
    assert note.endswith("26 of 864 rows filled linearly; the longest gap, 120 min, begins 2020-02-10 08:20.")


def test_long_gaps_and_missing_days_are_refused(tmp_path: Path) -> None:
    made = Made()
    made.weather.loc[100:140, "Windsp"] = np.nan
    with pytest.raises(ArchiveError, match=r"weather of 3.4 h is missing from 2020-02-10 08:20; at most 3 h are filled"):
        outdoors(archive_of(made, tmp_path), CLOCK, 410.0)
    made = Made()
    made.weather = made.weather[:600]
    with pytest.raises(ArchiveError, match=r"weather of 22.0 h is missing from 2020-02-12 02:00"):
        outdoors(archive_of(made, tmp_path), CLOCK, 410.0)


def test_the_day_that_summer_time_begins_has_23_hours(tmp_path: Path) -> None:
    made = Made(first=dt.date(2020, 3, 28))
    made.weather.loc[288 + 24 : 288 + 35, "Tout"] = 55.0  # the hour from 02:00, which never was
    outside = outdoors(archive_of(made, tmp_path), CLOCK, 410.0)
    assert np.bincount(outside.day).tolist() == [96, 92, 96]
    assert outside.of("tOut").max() < 10.0
    assert outside.hour[96 + 7 : 96 + 9] == pytest.approx([1.75, 3.0])
    assert outside.notes == ()
