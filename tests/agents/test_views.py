"""Views of observations: what each has of a task, and what it refuses."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from glbench.agents.views import VIEWS, left_out_views, visible_columns
from glbench.errors import UnknownNameError
from glbench.tasks import TaskSpec, get_task


@pytest.fixture(scope="module")
def spring() -> TaskSpec:
    return get_task("Spring-v1")


def columns(task: TaskSpec, *view: str) -> set[str]:
    return {column.name for column, seen in zip(task.observed(), visible_columns(task, view), strict=True) if seen}


def test_views_grow_and_the_last_has_everything(spring: TaskSpec) -> None:
    rungs = [columns(spring, name) for name in ("clock", "outdoor", "two_sensors", "sensors")]
    assert rungs[0] == {"sin_hour_of_day", "cos_hour_of_day", "sin_day_of_year", "cos_day_of_year"}
    assert all(small < large for small, large in pairwise(rungs))
    assert rungs[2] - rungs[1] == {"air_temperature", "relative_humidity"}
    assert rungs[3] == {column.name for column in spring.observed()}
    assert not rungs[1] & {"air_temperature", "co2", "pipe_temperature", "fruit_dry_mass", "canopy_temperature_24h"}
    assert columns(spring, "blind") == rungs[1]
    assert columns(spring, "memory") == rungs[3]


def test_every_named_view_is_one_of_every_published_task() -> None:
    for name in ("SpringYears-v1", "Lettuce-v1", "WinterLED-v1", "FullSeasonEnergy-v1", "Schiphol2010-Delta10-v1"):
        task = get_task(name)
        for view in VIEWS:
            assert visible_columns(task, (view,)).any()


def test_what_is_taken_away_goes_with_what_follows_from_it(spring: TaskSpec) -> None:
    assert columns(spring, "sensors") - columns(spring, "no_forecast") == {c.name for c in spring.observed_by("weather_forecast")}
    assert columns(spring, "sensors") - columns(spring, "without_co2") == {"co2"}
    assert columns(spring, "sensors", "-crop", "fruit_dry_mass") == columns(spring, "without_crop") | {"fruit_dry_mass"}
    growers = get_task("SpringSetpoints-v1")
    lost = columns(growers, "sensors") - columns(growers, "without_relative_humidity")
    assert lost == {"relative_humidity", *(column.name for column in growers.observed_by("vapour_deficit"))}


def test_energy_tasks_show_the_buffer_and_can_hide_all_prices() -> None:
    """Prices to come are hidden with those of now."""
    energy = get_task("SpringEnergy-v1")
    prices = {column.name for module in ("prices", "day_ahead_prices") for column in energy.observed_by(module)}
    assert columns(energy, "sensors") - columns(energy, "without_prices") == prices
    assert columns(energy, "sensors") - columns(energy, "without_energy") == {"buffer_heat", "buffer_share"}
    assert {"without_prices", "without_energy"} < {*left_out_views(energy)}
    assert not {"without_prices", "without_energy"} & {*left_out_views(get_task("Spring-v1"))}


def test_positions_that_a_process_computer_moves_are_not_outdoors() -> None:
    """It moves them by what it measures inside."""
    growers = get_task("SpringSetpoints-v1")
    positions = {column.name for column in growers.observed_by("controls")}
    assert not columns(growers, "blind") & positions
    assert columns(growers, "two_sensors") >= positions


def test_unknown_names_and_empty_views_are_refused(spring: TaskSpec) -> None:
    with pytest.raises(UnknownNameError, match=r"no view, observation module or column 'outdor'\. Did you mean 'outdoor'"):
        visible_columns(spring, ("outdor",))
    with pytest.raises(UnknownNameError, match="column 'co3'"):
        visible_columns(spring, ("without_co3",))
    with pytest.raises(UnknownNameError, match="has no column that glbench/Spring-v1 shows"):
        visible_columns(spring, ("prices", "registration"))
    assert np.array_equal(visible_columns(spring, ("sensors", "registration")), visible_columns(spring, ("sensors",)))
