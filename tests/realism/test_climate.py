"""The free run against the measured climate: which steps count in which error, and pictures."""

from __future__ import annotations

import dataclasses
import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from glbench.realism import (
    ClimateComparison,
    ClimateRun,
    choose_houses,
    compare_climate,
    draw_errors,
    draw_mean_days,
    read_archive,
    read_settings,
)
from tests.realism.made import Made

SETTINGS = read_settings()


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[ClimateComparison, ClimateRun]:
    made = Made(days=9, first=dt.date(2020, 2, 25))
    table = made.indoors()
    table.loc[288:300, "Rhair"] = np.nan
    made.climate["Anna"] = table
    archive = read_archive(made.write(tmp_path_factory.mktemp("archive")))
    moves: list[tuple[int, int]] = []
    comparison, runs = compare_climate(
        archive, choose_houses(("mixed_2020", "paper")), SETTINGS, progress=lambda step, steps: moves.append((step, steps))
    )
    assert moves[-1][0] == moves[-1][1] == 9 * 288
    return comparison, runs[0]


def test_each_error_is_of_its_own_steps(compared: tuple[ClimateComparison, ClimateRun]) -> None:
    comparison, run = compared
    (anna,) = comparison.compartments
    assert [house.name for house in anna.houses] == ["mixed_2020", "paper"]
    for house in anna.houses:
        difference = run.simulated[house.name]["humidity"] - run.season.measured["humidity"]
        known = np.isfinite(difference)
        assert house.overall["humidity"].readings == known.sum() == 9 * 288 - 13
        assert house.overall["humidity"].bias == pytest.approx(difference[known].mean())
        assert house.overall["humidity"].rmse == pytest.approx(np.sqrt((difference[known] ** 2).mean()))
        chosen = known & (np.arange(known.size) % 288 // 36 == 2)
        assert house.hours["6-9"]["humidity"].bias == pytest.approx(difference[chosen].mean())
        march = known & (np.arange(known.size) >= 5 * 288)
        assert house.months["2020-03"]["humidity"].bias == pytest.approx(difference[march].mean())
        assert house.weeks["odd"]["air_temperature"].readings == 2 * 288
    assert ClimateComparison.model_validate_json(comparison.model_dump_json()) == comparison


def test_without_co2_the_rest_is_compared_and_drawn(compared: tuple[ClimateComparison, ClimateRun], tmp_path: Path) -> None:
    made = Made(days=1)
    made.climate["Anna"] = made.indoors().drop(columns="CO2air")
    comparison, runs = compare_climate(read_archive(made.write(tmp_path / "archive")), choose_houses(("paper",)), SETTINGS)
    house = comparison.compartments[0].houses[0]
    assert tuple(house.overall) == ("air_temperature", "humidity")
    draw_mean_days(runs[0], tmp_path / "days.png")
    draw_errors(comparison.compartments[0], tmp_path / "errors.png")
    for name in ("days", "errors"):
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_a_mean_day_is_drawn_from_what_was_measured(compared: tuple[ClimateComparison, ClimateRun], tmp_path: Path) -> None:
    run = compared[1]
    draw_mean_days(run, tmp_path / "one.png")
    season = run.season
    warm = {**season.measured, "air_temperature": season.measured["air_temperature"] + 5.0}
    draw_mean_days(dataclasses.replace(run, season=dataclasses.replace(season, measured=warm)), tmp_path / "other.png")
    assert (tmp_path / "one.png").read_bytes() != (tmp_path / "other.png").read_bytes()
