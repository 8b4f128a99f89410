"""The climate inside a compartment: which readings are taken out, on which clock, and with which words."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from glbench.errors import ArchiveError
from glbench.realism import INDOOR, Indoor, read_archive, read_indoor
from tests.realism.made import FIRST, Made


def climate_of(made: Made, table: pd.DataFrame, folder: Path) -> Indoor:
    made.climate["Anna"] = table
    anna, bert = read_archive(made.write(folder)).compartments
    assert anna.indoor is not None
    assert bert.indoor is None, "one compartment of two has a climate"
    return read_indoor(anna.indoor)


def test_a_clean_climate_is_read_as_it_is(tmp_path: Path) -> None:
    made = Made()
    table = made.indoors()
    indoor = climate_of(made, table, tmp_path)
    assert indoor.name == "Anna"
    assert tuple(indoor.columns) == tuple(INDOOR)
    begin = dt.datetime(2020, 2, 9, 23, tzinfo=dt.UTC).timestamp()
    assert np.array_equal(indoor.times, begin + 300.0 * np.arange(3 * 288)), "the row at the last midnight begins no day"
    assert indoor.columns["air_temperature"] == pytest.approx(table["Tair"][:-1])
    assert indoor.columns["co2_dose"] == pytest.approx(table["co2_dos"][:-1])
    off = table["PipeLow"][:-1] == 0.0
    assert np.array_equal(np.isnan(indoor.columns["rail_pipe"]), off)
    lit = table["AssimLight"][:-1] > 0.0
    assert indoor.columns["lamps"] == pytest.approx(np.where(lit, 81.0 + 25.3 + 0.5 * 7.27, 0.0)), "LEDs burn with the HPS lamps only"
    assert indoor.lamp_power == pytest.approx(142.52)
    assert len(indoor.notes) == 1
    assert indoor.notes[0].startswith("Anna: there is no ventilation_lee_set_point, ventilation_wind_set_point, ")


def test_the_published_form_says_the_same(tmp_path: Path) -> None:
    made = Made()
    table = made.indoors()
    flat = climate_of(made, table, tmp_path / "flat")
    folder = made.write_as_published(tmp_path / "published")
    path = folder / "Anna" / "GreenhouseClimate.csv"
    turned = table[[*reversed(table.columns)]].astype(object)
    lines = turned.to_csv(index=False, na_rep="NaN").replace(",", " ,\t")
    path.write_text("%" + lines)
    indoor = read_indoor(path)
    assert indoor.name == "Anna"
    for name, values in flat.columns.items():
        assert np.array_equal(values, indoor.columns[name], equal_nan=True), name


def test_bad_readings_are_taken_out_and_noted(tmp_path: Path) -> None:
    made = Made()
    table = made.indoors()
    table.loc[40, "CO2air"] = -499.0
    table.loc[[41, 42], "Rhair"] = [-22.2, 7.0]
    table.loc[[50, 51, 60, 61], "Tair"] = [-1.0, 0.0, 5.4, 31.0]
    table.loc[400:480, "CO2air"] = 612.0
    table.loc[[70, 71], "VentLee"] = [-3.0, 104.0]
    table.loc[100:, "Tair"] += np.where(np.arange(len(table) - 100) < 100, 0.05 * np.arange(len(table) - 100), 0.0)
    indoor = climate_of(made, table, tmp_path)
    bad = {name: np.flatnonzero(np.isnan(indoor.columns[name])).tolist() for name in ("air_temperature", "humidity", "co2", "vents_lee")}
    assert bad == {"air_temperature": [50, 51, 60, 61], "humidity": [41, 42], "co2": [40, *range(400, 481)], "vents_lee": [70, 71]}
    air, humidity, co2, vents, _ = indoor.notes
    assert air == (
        "Anna, air_temperature: 4 readings taken out (2 outside 1 to 60 degC, 2 impossible beside the readings around), "
        "the first -1 degC at 2020-02-10 04:10."
    )
    assert "2 readings taken out (1 outside 1 to 100 %, 1 impossible beside the readings around), the first -22.2 %" in humidity
    assert "82 readings taken out (1 outside 100 to 5000 ppm, 81 the same for 6 h or longer), the first -499 ppm at 2020-02-10 03:20" in co2
    assert "2 readings taken out (2 outside 0 to 100 %), the first -3 % at 2020-02-10 05:50" in vents


def test_a_fast_fall_is_believed_and_a_jump_is_not(tmp_path: Path) -> None:
    made = Made()
    table = made.indoors()
    table["Tair"] = 18.0
    table.loc[100:200, "Tair"] = 26.0 - np.minimum(np.arange(101) * 0.08, 8.0)
    table.loc[[216, 217, 218], "Tair"] = [24.0, 21.0, 18.1]  # vents wide open: 6 K in 10 min
    table.loc[300:400, "Tair"] = 28.0
    table["Tair"] += 0.01 * (np.arange(len(table)) % 2)
    bad = np.flatnonzero(np.isnan(climate_of(made, table, tmp_path).columns["air_temperature"]))
    assert bad.tolist() == [99, 100, 299, 300, 400, 401], "both sides of a jump of 8 and 10 K"


def test_the_last_reading_of_a_pipe_holds_for_an_hour(tmp_path: Path) -> None:
    made = Made()
    table = made.indoors()
    table.loc[4:9, "PipeLow"] = np.nan
    table.loc[20:60, "PipeLow"] = np.nan
    table.loc[250, "PipeLow"] = 300.0
    pipe = climate_of(made, table, tmp_path).columns["rail_pipe"]
    off = [*range(32, 61), *range(96, 216)]
    assert np.flatnonzero(np.isnan(pipe[:288])).tolist() == off
    assert np.nanmax(pipe) == 45.0


def test_the_hour_that_summer_time_skips_does_not_exist(tmp_path: Path) -> None:
    made = Made(first=dt.date(2020, 3, 28))
    table = made.indoors()
    table.loc[288 + 24 : 288 + 35, "Tair"] = np.nan
    indoor = climate_of(made, table, tmp_path)
    assert indoor.times.size == 3 * 288 - 12
    assert not np.isnan(indoor.columns["air_temperature"]).any()
    assert indoor.columns["air_temperature"][288 + 24] == table["Tair"][288 + 36]


def test_the_hour_that_comes_twice_is_read_twice(tmp_path: Path) -> None:
    made = Made(first=dt.date(2020, 10, 24))
    indoor = climate_of(made, table := made.indoors(), tmp_path)
    assert indoor.times.size == 3 * 288 + 12
    air = indoor.columns["air_temperature"][288 + 24 :]
    assert np.array_equal(air[:12], air[12:24])
    assert air[0] == table["Tair"][288 + 24]


def test_days_can_be_chosen(tmp_path: Path) -> None:
    made = Made()
    made.climate["Anna"] = made.indoors()[30:]
    path = read_archive(made.write(tmp_path)).compartments[0].indoor
    assert path is not None
    indoor = read_indoor(path, first=FIRST, days=2)
    assert indoor.times.size == 2 * 288
    assert np.flatnonzero(np.isnan(indoor.columns["humidity"])).tolist() == [*range(30)]
    assert "30 of 576 rows, the first at 2020-02-10 00:00, have no air_temperature, humidity, co2" in indoor.notes[0]


def test_what_is_needed_is_named(tmp_path: Path) -> None:
    made = Made()
    with pytest.raises(ArchiveError, match=r"no values in a column 'VentLee' \(lee vents, open, %\), which is needed"):
        climate_of(made, made.indoors().drop(columns="VentLee"), tmp_path)
    table = made.indoors().astype({"Tair": object})
    table.loc[3, "Tair"] = "warm"
    with pytest.raises(ArchiveError, match=r"Anna_GreenhouseClimate.csv, row 5: Tair is 'warm', which is not a number"):
        climate_of(made, table, tmp_path)
