"""A season driven by a compartment's own set points, beside one driven by the page of settings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
import pytest

from glbench.errors import ArchiveError
from glbench.realism import HOUSES, Archive, Indoor, Season, compare, read_archive, read_indoor, read_settings, simulate
from glbench.realism.inputs import outdoors
from tests.realism.made import Made

SETTINGS = read_settings()
HOUSE = HOUSES["mixed_2020"]


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Archive:
    made = Made(days=2)
    table = made.indoors()
    for name, value in (("t_ventlee_vip", 22.0), ("t_ventwind_vip", 24.0), ("dx_vip", 2.0), ("co2_vip", 800.0), ("t_rail_min_vip", 0.0)):
        table[name] = value
    made.climate["Anna"] = table
    return read_archive(made.write(tmp_path_factory.mktemp("archive")))


@pytest.fixture(scope="module")
def indoor(archive: Archive) -> Indoor:
    path = archive.compartments[0].indoor
    assert path is not None
    return read_indoor(path, first=archive.first, days=archive.days)


def season(archive: Archive, indoor: Indoor | None, **changes: float) -> Season:
    """Anna's with these set points at all times, or with the page of settings; Bert's always with the page."""
    indoors: Mapping[str, Indoor] = {}
    if indoor is not None:
        constant = {name: np.full(indoor.times.size, value) for name, value in changes.items()}
        indoors = {"Anna": dataclasses.replace(indoor, columns=MappingProxyType({**indoor.columns, **constant}))}
    outside = outdoors(archive, SETTINGS.place.clock, SETTINGS.place.co2)
    return simulate(archive, outside, HOUSE, SETTINGS, indoors=indoors)


@pytest.fixture(scope="module")
def by_page(archive: Archive) -> Season:
    return season(archive, None)


@pytest.fixture(scope="module")
def by_set_points(archive: Archive, indoor: Indoor) -> Season:
    return season(archive, indoor)


def test_the_others_keep_the_page_of_settings(by_page: Season, by_set_points: Season) -> None:
    for name in ("heat", "pipe_heat", "lamps", "co2", "harvest", "air_temperature", "humidity", "co2_air"):
        page, own = getattr(by_page, name), getattr(by_set_points, name)
        assert np.array_equal(page[:, 1], own[:, 1]), name
    assert not np.any(by_page.heat[:, 0] == by_set_points.heat[:, 0])


def test_lamps_burn_as_they_did(by_set_points: Season) -> None:
    power = 81.0 + 25.3 + 0.5 * 7.27
    assert by_set_points.lamps[:, 0] == pytest.approx([12.0 * power / 1000.0] * 2, rel=1e-9)


def test_warmer_set_points_take_more_heat(archive: Archive, indoor: Indoor, by_set_points: Season) -> None:
    warm = season(archive, indoor, heating_set_point=21.0)
    assert np.all(warm.pipe_heat[:, 0] > by_set_points.pipe_heat[:, 0])
    assert np.all(warm.air_temperature[:, 0] > by_set_points.air_temperature[:, 0])


def test_pipes_give_off_what_their_least_temperatures_ask_for(archive: Archive, indoor: Indoor) -> None:
    cold = {
        "heating_set_point": 5.0,
        "ventilation_lee_set_point": 40.0,
        "ventilation_wind_set_point": 40.0,
        "humidity_deficit_set_point": 0.0,
    }
    off, rail, both = (
        season(archive, indoor, **cold, minimum_rail_pipe=pipes[0], minimum_grow_pipe=pipes[1]) for pipes in ((0, 0), (45, 0), (45, 40))
    )
    assert off.heat[:, 0] == pytest.approx([0.0, 0.0])
    for one, slopes in ((rail, ((2.1, 45.0),)), (both, ((2.1, 45.0), (0.62, 40.0)))):
        wanted = 86400e-6 * sum(slope * (pipe - one.air_temperature[1, 0]) for slope, pipe in slopes)
        assert one.heat[1, 0] == pytest.approx(wanted, rel=0.02), "the air of the day's steps is near its mean"


def test_both_sides_of_vents_count(archive: Archive, indoor: Indoor) -> None:
    at = {"ventilation_lee_set_point": 19.0}
    one, both = (season(archive, indoor, **at, ventilation_wind_set_point=wind) for wind in (50.0, 19.0))
    shut = season(archive, indoor, ventilation_lee_set_point=50.0, ventilation_wind_set_point=50.0)
    ajar = season(archive, indoor, ventilation_lee_set_point=50.0, ventilation_wind_set_point=50.0, minimum_vents=60.0)
    for cooler, warmer in ((both, one), (one, shut), (ajar, shut)):
        assert np.all(cooler.air_temperature[:, 0] < warmer.air_temperature[:, 0])


def test_co2_is_dosed_to_its_set_point(archive: Archive, indoor: Indoor, by_set_points: Season) -> None:
    none = season(archive, indoor, co2_set_point=300.0)
    assert none.co2[:, 0] == pytest.approx([0.0, 0.0])
    assert np.all(by_set_points.co2[:, 0] > 0.0)
    without = season(archive, indoor, co2_set_point=np.nan)
    assert without.co2[:, 0] == pytest.approx(archive.compartments[0].co2, rel=1e-9), "as measured"


def test_a_comparison_by_own_set_points_says_whose(archive: Archive, by_set_points: Season) -> None:
    comparison, (own,) = compare(archive, [HOUSE], SETTINGS, own_set_points=True)
    assert np.array_equal(own.heat, by_set_points.heat)
    assert [note for note in comparison.notes if "driven" in note] == ["Anna is driven by its own set points."]


def test_what_cannot_drive_a_season_is_refused(archive: Archive, indoor: Indoor) -> None:
    with pytest.raises(ArchiveError, match=r"Anna cannot be driven by its own set points: it has 0 of 576 readings of heating_set_point"):
        season(archive, indoor, heating_set_point=np.nan)
    short = dataclasses.replace(indoor, columns=MappingProxyType({name: values[:288] for name, values in indoor.columns.items()}))
    with pytest.raises(ArchiveError, match=r"it has 288 of 576 readings of heating_set_point. Read its indoor climate over the days"):
        season(archive, short)
