"""KNMI files: every make of them, and every way in which one is refused, with file, row and value."""

from __future__ import annotations

import datetime as dt
import zipfile
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.weather import load_weather, read_csv, read_weather
from glbench.weather.knmi import known_stations
from tests.weather.files import KNMI_COMMENTS, KNMI_HEADER, knmi_days, knmi_line, knmi_text

read_epw = partial(read_weather, file_format="epw")
read_knmi = partial(read_weather, file_format="knmi")
read_tmy = partial(read_weather, file_format="tmy")

DAY = dt.date(2019, 6, 1)


def knmi_file(folder: Path, text: str) -> Path:
    path = folder / "uurgeg.txt"
    path.write_bytes(text.encode())
    return path


def test_knmi_slots_lie_at_their_times_in_ut(tmp_path: Path) -> None:
    record = read_knmi(knmi_file(tmp_path, knmi_text(knmi_days(DAY, 2))))
    assert record.period == "2019-06-01 00:00 to 2019-06-03 00:00 UTC"
    assert record.name == "uurgeg"
    assert (record.station, record.latitude, record.longitude, record.altitude) == ("KNMI 240, Schiphol", 52.318, 4.79, -3.3)
    assert record.timezone == "Europe/Amsterdam"
    frame = record.frame
    # HH 9: T 29 (0.1 degC), U 80, N 4, Q 50 J cm-2 = 138.89 W m-2, FH 50 (0.1 m/s).
    assert frame.iloc[8].to_dict() == {
        "air_temperature": 2.9,
        "relative_humidity": 80.0,
        "wind_speed": 5.0,
        "global_radiation": 50 / 0.36,
        "cloud_cover": 4.0,
    }


@pytest.mark.parametrize(
    "header", [KNMI_HEADER, KNMI_HEADER.replace("HH", " H"), KNMI_HEADER.removeprefix("# "), f'"{KNMI_HEADER}"', KNMI_HEADER + "\r\n"]
)
def test_knmi_headers_of_every_make_are_read(tmp_path: Path, header: str) -> None:
    record = read_knmi(knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1), header=header)))
    assert record.hours == 24


@pytest.mark.parametrize("comments", [(), KNMI_COMMENTS * 5, ("BRON: KNMI", "", "SOURCE: KNMI, without a hash", *KNMI_COMMENTS)])
def test_any_number_of_knmi_comments_is_read(tmp_path: Path, comments: tuple[str, ...]) -> None:
    assert read_knmi(knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1), comments=comments))).hours == 24


def test_knmi_columns_may_come_in_any_order_and_number(tmp_path: Path) -> None:
    rows = [f"  240,{DAY:%Y%m%d},{hour:5d},  270,   31,{hour:5d},    7,   90,    0,  123" for hour in range(1, 25)]
    header = "# STN,YYYYMMDD,   HH,   DD,   FH,    T,    N,    U,    Q,    P"
    record = read_knmi(knmi_file(tmp_path, knmi_text(rows, header=header)))
    assert record.frame.iloc[11].to_dict() == {
        "air_temperature": 1.2,
        "relative_humidity": 90.0,
        "wind_speed": 3.1,
        "global_radiation": 0.0,
        "cloud_cover": 7.0,
    }


def test_a_knmi_zip_archive_is_read(tmp_path: Path) -> None:
    path = tmp_path / "uurgeg_240_2011-2020.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("uurgeg_240_2011-2020.txt", knmi_text(knmi_days(DAY, 1)))
    assert read_weather(path).hours == 24


def test_an_archive_of_several_files_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.txt", "")
        archive.writestr("b.txt", "")
    with pytest.raises(WeatherError, match=r"holds 2 files. Unpack it"):
        read_knmi(path)


def test_one_station_of_several_is_chosen_by_number(tmp_path: Path) -> None:
    path = knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1, 209) + knmi_days(DAY, 1, 240)))
    with pytest.raises(WeatherError, match="holds the stations 209, 240: choose one with --station"):
        read_knmi(path)
    assert read_knmi(path, station=209).station == "KNMI 209, IJmond"
    with pytest.raises(WeatherError, match="holds 209, 240, not station 260"):
        read_knmi(path, station=260)


def test_stations_of_the_network_are_known_without_a_table(tmp_path: Path) -> None:
    path = knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1, 277), comments=("# no table",)))
    record = read_knmi(path)
    assert record.station == "KNMI 277, Lauwersoog"
    assert (record.latitude, record.longitude, record.altitude) == (53.413, 6.2, 2.9)


def test_the_shipped_stations_lie_in_the_netherlands_and_agree_with_the_shipped_record() -> None:
    stations = known_stations()
    assert len(stations) == 51
    for place in stations.values():
        assert 50.7 < place.latitude < 53.7
        assert 3.2 < place.longitude < 7.3
        assert -5.0 < place.altitude < 120.0
    schiphol = load_weather("schiphol")
    assert (schiphol.latitude, schiphol.longitude, schiphol.altitude) == (
        stations[240].latitude,
        stations[240].longitude,
        stations[240].altitude,
    )


def test_an_unknown_station_needs_a_place(tmp_path: Path) -> None:
    path = knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1, 999), comments=("# no table",)))
    with pytest.raises(WeatherError, match=r"no coordinates for station 999: .* --place LATITUDE,LONGITUDE"):
        read_knmi(path)
    record = read_weather(path, coordinates=(52.0, 5.0, 3.0), timezone="Etc/GMT-1")
    assert (record.station, record.latitude, record.timezone) == ("KNMI 999", 52.0, "Etc/GMT-1")


@pytest.mark.parametrize("empty", [True, False])
def test_a_knmi_file_without_clouds_gets_an_estimated_sky(tmp_path: Path, empty: bool) -> None:
    rows = [f"  240,{DAY:%Y%m%d},{hour:5d},   31,{hour:5d},   90,    0" for hour in range(1, 25)]
    header = "# STN,YYYYMMDD,   HH,   FH,    T,    U,    Q"
    if empty:
        header, rows = header + ",    N", [f"{row},     " for row in rows]
    record = read_knmi(knmi_file(tmp_path, knmi_text(rows, header=header)))
    assert "cloud_cover" not in record.counts
    assert any(note.startswith("sky_infrared estimated") for note in record.notes)


def test_a_blank_knmi_value_is_named_with_file_and_row(tmp_path: Path) -> None:
    rows = knmi_days(DAY, 1)
    rows[4] = knmi_line(DAY, 5, {"N": ""})
    row = len(KNMI_COMMENTS) + 1 + 5
    with pytest.raises(WeatherError, match=rf"uurgeg\.txt, row {row}: no value for cloud cover .*2019-06-01 05:00 UTC"):
        read_knmi(knmi_file(tmp_path, knmi_text(rows)))


def test_gaps_are_filled_linearly_only_when_asked_and_are_noted(tmp_path: Path) -> None:
    rows = knmi_days(DAY, 1)
    rows[4] = knmi_line(DAY, 5, {"T": ""})
    del rows[11:13]  # HH 12 and 13
    path = knmi_file(tmp_path, knmi_text(rows))
    with pytest.raises(WeatherError, match="2 h are missing between 2019-06-01 11:00 and 2019-06-01 14:00 UTC"):
        read_knmi(path)
    record = read_knmi(path, fill_gaps=2)
    assert record.hours == 24
    # HH 4 has 2.4 degC, HH 6 has 2.6; HH 11 has 3.1 and HH 14 has 3.4.
    np.testing.assert_allclose(record.values("air_temperature")[[4, 11, 12]], [2.5, 3.2, 3.3])
    assert "air_temperature: 3 h filled linearly, the first of them ending 2019-06-01 05:00 UTC" in record.notes
    with pytest.raises(WeatherError, match="no value for air temperature"):
        read_knmi(path, fill_gaps=1)


def test_values_at_the_ends_are_never_filled(tmp_path: Path) -> None:
    rows = knmi_days(DAY, 1)
    rows[0] = knmi_line(DAY, 1, {"T": ""})
    with pytest.raises(WeatherError, match="no value for air temperature in the hour ending 2019-06-01 01:00"):
        read_knmi(knmi_file(tmp_path, knmi_text(rows)), fill_gaps=5)


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("T", 700, "air temperature of 70 degC"),
        ("T", -999, "air temperature of -99.9 degC"),
        ("U", 106, "relative humidity of 106 %"),
        ("U", -1, "relative humidity of -1 %"),
        ("FH", 751, "wind speed of 75.1 m/s"),
        ("FH", -1, "wind speed of -0.1 m/s"),
        ("Q", 541, "global radiation of 1502.78 W/m2"),
        ("Q", -10, "global radiation of -27.7778 W/m2"),
        ("N", 10, "cloud cover of 10 octants"),
    ],
)
def test_impossible_values_are_named_with_file_and_row(tmp_path: Path, column: str, value: int, words: str) -> None:
    rows = knmi_days(DAY, 1)
    rows[6] = knmi_line(DAY, 7, {column: value})
    row = len(KNMI_COMMENTS) + 1 + 7
    with pytest.raises(WeatherError, match=rf"uurgeg\.txt, row {row}: {words} .*is impossible"):
        read_knmi(knmi_file(tmp_path, knmi_text(rows)))


def test_a_duplicate_hour_is_refused(tmp_path: Path) -> None:
    rows = knmi_days(DAY, 1)
    rows.insert(5, rows[4])
    with pytest.raises(WeatherError, match="the interval ending 2019-06-01 05:00 UTC appears twice"):
        read_knmi(knmi_file(tmp_path, knmi_text(rows)))


def test_hours_out_of_order_are_refused(tmp_path: Path) -> None:
    rows = knmi_days(DAY, 2)
    with pytest.raises(WeatherError, match=r"01:00 UTC follows 2019-06-03 00:00 UTC. Sort the rows by time"):
        read_knmi(knmi_file(tmp_path, knmi_text(rows[24:] + rows[:24])))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("  240,20190230,    1,    0,   20,   80,   50,    4", "the date 2019-02-30 does not exist"),
        ("  240,20190601,   25,    0,   20,   80,   50,    4", "hour 25 does not exist: hours run from 1 to 24"),
        ("  240,20190601,    1,    0,  2x0,   80,   50,    4", "'2x0' is not a number"),
        ("  240,20190601,    1,    0,  2.5,   80,   50,    4", "'2.5' is not a whole number"),
        ("  240,20190601,     ,    0,   20,   80,   50,    4", "'' is not a whole number"),
        ("  240,20190601,    1,    0,   20", "5 fields instead of 8"),
    ],
)
def test_damaged_knmi_rows_are_named(tmp_path: Path, row: str, words: str) -> None:
    number = len(KNMI_COMMENTS) + 2
    with pytest.raises(WeatherError, match=rf"row {number}(, column '(T|HH)')?: {words}"):
        read_knmi(knmi_file(tmp_path, knmi_text([row])))


def test_a_knmi_file_without_a_needed_column_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match=r"lacks the column U. It has"):
        read_knmi(knmi_file(tmp_path, knmi_text([], header="# STN,YYYYMMDD,   HH,    Q,    T,   FH")))


def test_a_web_page_is_no_knmi_file(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match=r"uurgeg\.txt is a web page"):
        read_knmi(knmi_file(tmp_path, "<html>\n<body>Storing</body></html>"))


def test_a_header_without_rows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match="holds no station at all, not station 240"):
        read_knmi(knmi_file(tmp_path, knmi_text([])), station=240)
    with pytest.raises(WeatherError, match="holds no hourly values"):
        read_knmi(knmi_file(tmp_path, knmi_text([])))


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    for read in (read_knmi, read_csv, read_epw, read_tmy, read_weather):
        with pytest.raises(WeatherError, match=r"nowhere\.txt"):
            read(tmp_path / "nowhere.txt")
