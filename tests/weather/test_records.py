"""Shipped and stored records: what is in them, and that a changed file does not pass."""

from __future__ import annotations

import datetime as dt
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from glbench import resources
from glbench.errors import UnknownNameError, WeatherError
from glbench.weather import QUANTITIES, WeatherRecord, list_weather, load_weather, save_weather, store

SCHIPHOL_DIGEST = "c15b1f7b95c2b013af5cb05e7b37c641bdde6768c5fa8a2bbbc84b50a3c3cf2d"


@pytest.fixture(scope="module")
def schiphol() -> WeatherRecord:
    return load_weather("schiphol")


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))


def test_schiphol_covers_five_years_without_a_gap(schiphol: WeatherRecord) -> None:
    assert schiphol.first == dt.datetime(2008, 1, 1, tzinfo=dt.UTC)
    assert schiphol.last == dt.datetime(2013, 1, 1, tzinfo=dt.UTC)
    assert schiphol.hours == (366 + 365 + 365 + 365 + 366) * 24 == 43848
    assert (schiphol.latitude, schiphol.longitude, schiphol.altitude) == (52.318, 4.790, -3.3)
    assert schiphol.timezone == "Europe/Amsterdam"
    assert "Royal Netherlands Meteorological Institute" in schiphol.licence


def test_schiphol_has_the_locked_digest(schiphol: WeatherRecord) -> None:
    assert schiphol.digest == SCHIPHOL_DIGEST


def test_march_2010_has_knmis_published_radiation_sum_and_mean_wind(schiphol: WeatherRecord) -> None:
    begin = (dt.date(2010, 3, 1) - dt.date(2008, 1, 1)).days * 24
    march = schiphol.frame.iloc[begin : begin + 31 * 24]
    assert march.index[-1] == pd.Timestamp("2010-04-01", tz="UTC")
    # 27,722 J cm-2 and 5.16 m s-1, as in KNMI's table of daily values.
    assert march["global_radiation"].sum() * 0.36 == pytest.approx(27722, abs=1e-6)
    assert round(float(march["wind_speed"].mean()), 2) == 5.16


def test_frame_is_indexed_by_the_end_of_the_slot_in_utc(schiphol: WeatherRecord) -> None:
    frame = schiphol.frame
    assert frame.index[0] == pd.Timestamp("2008-01-01 01:00", tz="UTC")
    # First row of KNMI's file: T 50 (0.1 degC), U 99 %, N 8, Q 0, FH 20 (0.1 m/s).
    assert frame.iloc[0].to_dict() == {
        "air_temperature": 5.0,
        "relative_humidity": 99.0,
        "wind_speed": 2.0,
        "global_radiation": 0.0,
        "cloud_cover": 8.0,
    }


def test_changing_the_frame_does_not_change_the_record(schiphol: WeatherRecord) -> None:
    frame = schiphol.frame
    frame.loc[:, "air_temperature"] = 0.0
    assert schiphol.frame.iloc[0]["air_temperature"] == 5.0
    with pytest.raises(ValueError, match="read-only"):
        schiphol.counts["air_temperature"][0] = 1


def test_record_says_which_values_are_instants_and_which_are_means(schiphol: WeatherRecord) -> None:
    assert dict(schiphol.timing) == {
        "air_temperature": "instant",
        "relative_humidity": "instant",
        "cloud_cover": "instant",
        "wind_speed": "mean",
        "global_radiation": "mean",
    }


def test_unknown_record_points_to_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match=r"no weather record 'schipol'\. Did you mean 'schiphol'"):
        load_weather("schipol")


def test_a_name_cannot_leave_the_folder() -> None:
    with pytest.raises(UnknownNameError):
        load_weather("../../etc/passwd")


def test_manifest_agrees_with_the_record_it_locks(schiphol: WeatherRecord) -> None:
    entry = tomllib.loads((resources.data_folder("weather") / "manifest.toml").read_text())["record"]["schiphol"]
    assert entry["digest"] == schiphol.digest
    assert (entry["first"], entry["last"], entry["hours"]) == (schiphol.first, schiphol.last, schiphol.hours)
    assert "used freely provided that the following source is acknowledged" in entry["licence"]


def _copy_of_shipped(folder: Path) -> Path:
    shutil.copytree(resources.data_folder("weather"), folder)
    return folder / "knmi_240_schiphol_2008_2012.parquet"


def test_a_changed_value_in_the_shipped_file_is_refused(tmp_path: Path) -> None:
    path = _copy_of_shipped(tmp_path / "weather")
    frame = pd.read_parquet(path)
    frame["T"] = frame["T"].where(frame.index != 20000, 0)
    frame.to_parquet(path)
    with pytest.raises(WeatherError, match=r"no longer holds the values that .*manifest\.toml locks .*c15b1f7b95c2"):
        store._load_shipped("schiphol", tmp_path / "weather")


def test_the_digest_is_over_values_not_over_parquet_bytes(tmp_path: Path) -> None:
    path = _copy_of_shipped(tmp_path / "weather")
    before = path.read_bytes()
    pd.read_parquet(path).to_parquet(path, compression="gzip")
    assert path.read_bytes() != before
    assert store._load_shipped("schiphol", tmp_path / "weather").digest == SCHIPHOL_DIGEST


def test_a_damaged_shipped_file_is_refused(tmp_path: Path) -> None:
    path = _copy_of_shipped(tmp_path / "weather")
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(WeatherError, match="restore the file or install glbench again") as refused:
        store._load_shipped("schiphol", tmp_path / "weather")
    assert "Delete it" not in str(refused.value)  # advice for a record of one's own


def test_a_missing_column_in_the_shipped_file_is_refused(tmp_path: Path) -> None:
    path = _copy_of_shipped(tmp_path / "weather")
    pd.read_parquet(path).drop(columns="FH").to_parquet(path)
    with pytest.raises(WeatherError, match="lacks the column FH"):
        store._load_shipped("schiphol", tmp_path / "weather")


def test_an_unreadable_manifest_is_refused(tmp_path: Path) -> None:
    (tmp_path / "manifest.toml").write_text("[record")
    with pytest.raises(WeatherError, match=r"Cannot read .*manifest\.toml"):
        store._manifest(tmp_path)


def test_a_saved_record_comes_back_with_every_value_and_its_digest(schiphol: WeatherRecord) -> None:
    path = save_weather(schiphol, "mine")
    again = load_weather("mine")
    assert path == store.user_folder() / "mine.parquet"
    assert again.name == "mine"
    assert again.digest == schiphol.digest
    assert again.place == schiphol.place
    assert dict(again.timing) == dict(schiphol.timing)
    for name, counts in schiphol.counts.items():
        np.testing.assert_array_equal(again.counts[name], counts)


def test_list_shows_shipped_and_own_records(schiphol: WeatherRecord) -> None:
    save_weather(schiphol, "mine")
    infos = {info.name: info for info in list_weather()}
    assert set(infos) == {"greensboro", "miami", "sand_point", "schiphol", "mine"}
    assert (infos["schiphol"].origin, infos["mine"].origin) == ("shipped", "yours")
    assert infos["mine"].digest == infos["schiphol"].digest == SCHIPHOL_DIGEST
    assert (infos["mine"].first, infos["mine"].last) == (schiphol.first, schiphol.last)


def test_a_saved_record_is_not_replaced_unasked(schiphol: WeatherRecord) -> None:
    save_weather(schiphol, "mine")
    with pytest.raises(WeatherError, match="record 'mine' already"):
        save_weather(schiphol, "mine")
    save_weather(schiphol, "mine", overwrite=True)


@pytest.mark.parametrize("name", ["Mine", "../mine", "", "a b", ".hidden", "x" * 65])
def test_unusable_names_are_refused(schiphol: WeatherRecord, name: str) -> None:
    with pytest.raises(WeatherError, match="cannot name a weather record"):
        save_weather(schiphol, name)


def test_shipped_names_cannot_be_taken(schiphol: WeatherRecord) -> None:
    with pytest.raises(WeatherError, match="shipped weather record"):
        save_weather(schiphol, "schiphol", overwrite=True)


def test_a_changed_stored_record_is_refused(schiphol: WeatherRecord) -> None:
    path = save_weather(schiphol, "mine")
    table = pq.ParquetFile(path).read()
    changed = table.set_column(table.column_names.index("wind_speed"), "wind_speed", [np.asarray(schiphol.counts["wind_speed"]) + 1])
    pq.write_table(changed, path)
    with pytest.raises(WeatherError, match="its digest should be"):
        load_weather("mine")


def test_a_foreign_parquet_among_the_own_records_is_refused(tmp_path: Path) -> None:
    store.user_folder().mkdir(parents=True)
    pd.DataFrame({"a": [1]}).to_parquet(store.user_folder() / "foreign.parquet")
    with pytest.raises(WeatherError, match=r"foreign\.parquet is not a usable weather record"):
        list_weather()


def test_every_quantity_has_a_unit_and_limits() -> None:
    for quantity in QUANTITIES.values():
        assert quantity.unit
        assert quantity.low < quantity.high


def test_a_record_is_asked_for_by_name() -> None:
    with pytest.raises(UnknownNameError, match="by its name, such as 'schiphol'; got None"):
        load_weather(None)  # type: ignore[arg-type]
