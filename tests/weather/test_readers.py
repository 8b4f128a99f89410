"""One door to all readers: the format is told from the content."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import UnknownNameError, WeatherError
from glbench.weather import WeatherRecord, disturbances, read_weather
from tests.weather.files import csv_rows, csv_text, knmi_days, knmi_text, write_epw, write_tmy3

DAY = dt.date(2019, 6, 1)


def knmi_file(folder: Path, text: str) -> Path:
    path = folder / "uurgeg.txt"
    path.write_bytes(text.encode())
    return path


def csv_file(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text)
    return path


def every_format(folder: Path) -> dict[str, Path]:
    tmy = write_tmy3(folder / "tmy.csv")
    epw = write_epw(folder / "file.txt", 2010)
    return {
        "knmi": knmi_file(folder, knmi_text(knmi_days(DAY, 1))),
        "csv": csv_file(folder, csv_text(csv_rows(24))),
        "tmy": tmy,
        "epw": epw,
    }


def test_formats_are_told_from_the_content(tmp_path: Path) -> None:
    sources = {name: read_weather(path).source for name, path in every_format(tmp_path).items()}
    assert "KNMI" in sources["knmi"]
    assert sources["csv"] == "made up for a test"
    assert "TMY3" in sources["tmy"]
    assert "EnergyPlus" in sources["epw"]


def test_an_unknown_content_is_refused(tmp_path: Path) -> None:
    path = csv_file(tmp_path, "a,b\n1,2\n")
    with pytest.raises(WeatherError, match=r"none of the known weather formats \(knmi, epw, tmy, pvgis, nsrdb, .*, csv, parquet\)"):
        read_weather(path)


@pytest.mark.parametrize("header", ["time,temp,rh", "# a remark\nDate,Temperature (C),Humidity (%)"])
def test_a_plain_table_is_told_what_its_titles_should_be(tmp_path: Path, header: str) -> None:
    path = csv_file(tmp_path, f"{header}\n2024-05-01T01:00Z,9.4,88\n")
    with pytest.raises(WeatherError) as refused:
        read_weather(path)
    words = str(refused.value)
    assert "expected: slot_end [UTC],air_temperature [degC],relative_humidity [%],wind_speed [m/s]," in words
    assert "Did you mean 'air_temperature [degC]'?" in words
    assert "Did you mean 'relative_humidity [%]'?" in words
    assert "Did you mean 'slot_end [UTC]'?" in words
    assert "missing: air_temperature [degC], relative_humidity [%], wind_speed [m/s]" in words
    assert f"titles:   {header.splitlines()[-1]}" in words


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"no weather format 'kmni'\. Did you mean 'knmi'"):
        read_weather(csv_file(tmp_path, ""), "kmni")


def test_options_of_another_format_are_refused(tmp_path: Path) -> None:
    path = csv_file(tmp_path, csv_text(csv_rows(1)))
    with pytest.raises(WeatherError, match="read as csv, which takes no --year"):
        read_weather(path, year=2001)
    with pytest.raises(WeatherError, match="takes no --station"):
        read_weather(path, station=240)


def test_every_format_gives_disturbances(tmp_path: Path) -> None:
    for path in every_format(tmp_path).values():
        record: WeatherRecord = read_weather(path)
        middle = record.first + (record.last - record.first) / 2
        start = middle.replace(minute=0)
        made = disturbances(record, start=start, steps=4, preprocessing="paper")
        assert np.isfinite(made.values).all()
