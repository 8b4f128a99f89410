"""The typical years that are shipped are those of pvlib's files, read by the package's own readers."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pvlib
import pytest

from glbench.errors import WeatherError
from glbench.weather import list_weather, load_weather, read_weather
from glbench.weather.summary import monthly

read_tmy = partial(read_weather, file_format="tmy")

FILES = Path(pvlib.__file__).parent / "data"
SOURCES = {
    "greensboro": ("723170TYA.CSV", "America/New_York"),
    "sand_point": ("703165TY.csv", "America/Anchorage"),
    "miami": ("12839.tm2", "America/New_York"),
}


@pytest.mark.parametrize("name", SOURCES)
def test_a_shipped_typical_year_is_what_the_reader_makes_of_its_file(name: str) -> None:
    file, zone = SOURCES[name]
    made, shipped = read_tmy(FILES / file, name=name, timezone=zone), load_weather(name)
    assert made.digest == shipped.digest
    assert (made.latitude, made.longitude, made.altitude) == (shipped.latitude, shipped.longitude, shipped.altitude)
    assert shipped.typical_year
    assert shipped.hours == 8760
    assert shipped.name == name
    assert file in shipped.source
    assert "NREL" in shipped.licence


def test_the_places_have_the_climate_they_are_known_for() -> None:
    means = {name: sum(m.air_temperature_mean for m in monthly(load_weather(name))) / 12 for name in SOURCES}
    sums = {name: sum(m.radiation_sum for m in monthly(load_weather(name))) for name in (*SOURCES, "schiphol")}
    assert 23.0 < means["miami"] < 25.5
    assert 13.0 < means["greensboro"] < 16.0
    assert 3.0 < means["sand_point"] < 6.0
    assert sums["sand_point"] < sums["schiphol"] / 5 < sums["greensboro"] < sums["miami"]  # Schiphol has five years


def test_the_list_says_where_they_come_from() -> None:
    infos = {info.name: info for info in list_weather()}
    for name in SOURCES:
        assert infos[name].origin == "shipped"
        assert infos[name].typical_year
        assert infos[name].place.station


def test_a_shipped_typical_year_that_was_changed_is_refused(tmp_path: Path) -> None:
    import shutil

    from glbench.resources import data_folder
    from glbench.weather import store

    shutil.copytree(data_folder("weather"), tmp_path / "weather")
    manifest = store._manifest(tmp_path / "weather")
    own, other = (tmp_path / "weather" / manifest[name]["file"] for name in ("miami", "greensboro"))
    shutil.copyfile(other, own)
    with pytest.raises(WeatherError, match=r"no longer holds the values that .*manifest\.toml locks .*398768255b3b"):
        store._load_shipped("miami", tmp_path / "weather")
    own.write_bytes(own.read_bytes()[:3000])
    with pytest.raises(WeatherError, match="restore the file or install glbench again"):
        store._load_shipped("miami", tmp_path / "weather")
