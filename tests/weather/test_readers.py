"""Readers: what is taken from each format, at which time, and every way in which a file can be refused."""

from __future__ import annotations

import datetime as dt
import zipfile
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import UnknownNameError, WeatherError
from glbench.weather import WeatherRecord, disturbances, read_csv, read_epw, read_knmi, read_tmy, read_weather
from tests.weather.files import (
    CSV_COMMENTS,
    CSV_HEADER,
    KNMI_COMMENTS,
    KNMI_HEADER,
    csv_rows,
    csv_text,
    epw_line,
    knmi_days,
    knmi_line,
    knmi_text,
    write_epw,
    write_tmy3,
)

DAY = dt.date(2019, 6, 1)


def knmi_file(folder: Path, text: str) -> Path:
    path = folder / "uurgeg.txt"
    path.write_bytes(text.encode())
    return path


def csv_file(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text)
    return path


# --- KNMI ---------------------------------------------------------------------------------------------------------------------


def test_knmi_slots_lie_at_their_times_in_ut(tmp_path: Path) -> None:
    record = read_knmi(knmi_file(tmp_path, knmi_text(knmi_days(DAY, 2))))
    assert record.period == "2019-06-01 00:00 to 2019-06-03 00:00 UTC"
    assert record.name == "uurgeg"
    assert (record.station, record.latitude, record.longitude, record.altitude) == (
        "KNMI 240, Schiphol",
        52.318,
        4.79,
        -3.3,
    )
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
    "header",
    [
        KNMI_HEADER,
        KNMI_HEADER.replace("HH", " H"),
        KNMI_HEADER.removeprefix("# "),
        f'"{KNMI_HEADER}"',
        KNMI_HEADER + "\r\n",
    ],
)
def test_knmi_headers_of_every_make_are_read(tmp_path: Path, header: str) -> None:
    record = read_knmi(knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1), header=header)))
    assert record.hours == 24


@pytest.mark.parametrize(
    "comments", [(), KNMI_COMMENTS * 5, ("BRON: KNMI", "", "SOURCE: KNMI, without a hash", *KNMI_COMMENTS)]
)
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
    with pytest.raises(WeatherError, match="holds 2 text files instead of one"):
        read_knmi(path)


def test_one_station_of_several_is_chosen_by_number(tmp_path: Path) -> None:
    path = knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1, 209) + knmi_days(DAY, 1, 240)))
    with pytest.raises(WeatherError, match="holds the stations 209, 240: choose one with --station"):
        read_knmi(path)
    assert read_knmi(path, station=209).station == "KNMI 209, IJmond"
    with pytest.raises(WeatherError, match="holds 209, 240, not station 260"):
        read_knmi(path, station=260)


def test_a_station_without_coordinates_is_refused(tmp_path: Path) -> None:
    path = knmi_file(tmp_path, knmi_text(knmi_days(DAY, 1, 277), comments=("# no table",)))
    with pytest.raises(WeatherError, match="no coordinates for station 277"):
        read_knmi(path)


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
        ("U", 101, "relative humidity of 101 %"),
        ("U", -1, "relative humidity of -1 %"),
        ("FH", 751, "wind speed of 75.1 m/s"),
        ("FH", -1, "wind speed of -0.1 m/s"),
        ("Q", 541, "global radiation of 1502.78 W/m2"),
        ("Q", -1, "global radiation of -2.77778 W/m2"),
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
    with pytest.raises(WeatherError, match="the hour ending 2019-06-01 05:00 UTC appears twice"):
        read_knmi(knmi_file(tmp_path, knmi_text(rows)))


def test_hours_out_of_order_are_refused(tmp_path: Path) -> None:
    rows = knmi_days(DAY, 2)
    with pytest.raises(WeatherError, match="01:00 UTC follows 2019-06-03 00:00 UTC; rows must be hourly and in order"):
        read_knmi(knmi_file(tmp_path, knmi_text(rows[24:] + rows[:24])))


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("  240,20190230,    1,    0,   20,   80,   50,    4", "the date 20190230 does not exist"),
        ("  240,20190601,   25,    0,   20,   80,   50,    4", "the hour 25 is not one of 1 to 24"),
        ("  240,20190601,    1,    0,  2x0,   80,   50,    4", "'2x0' in column T is no whole number"),
        ("  240,20190601,     ,    0,   20,   80,   50,    4", "no value in column HH"),
        ("  240,20190601,    1,    0,   20", "5 fields instead of 8"),
    ],
)
def test_damaged_knmi_rows_are_named(tmp_path: Path, row: str, words: str) -> None:
    number = len(KNMI_COMMENTS) + 2
    with pytest.raises(WeatherError, match=rf"row {number}: {words}"):
        read_knmi(knmi_file(tmp_path, knmi_text([row])))


def test_a_knmi_file_without_a_needed_column_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match="lacks the columns U, N"):
        read_knmi(knmi_file(tmp_path, knmi_text([], header="# STN,YYYYMMDD,   HH,    Q,    T,   FH")))


def test_a_web_page_is_no_knmi_file(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match=r"no header line 'STN,YYYYMMDD,HH,...' \(it begins with '<html>"):
        read_knmi(knmi_file(tmp_path, "<html>\n<body>Storing</body></html>"))


def test_a_header_without_rows_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match="holds no station at all|holds no hourly values"):
        read_knmi(knmi_file(tmp_path, knmi_text([])), station=240)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    for read in (read_knmi, read_csv, read_epw, read_tmy, read_weather):
        with pytest.raises(WeatherError, match=r"nowhere\.txt"):
            read(tmp_path / "nowhere.txt")


# --- EPW ----------------------------------------------------------------------------------------------------------------------


def test_epw_of_one_real_year_keeps_its_year_and_its_clock(tmp_path: Path) -> None:
    record = read_epw(write_epw(tmp_path / "real.epw", 2010))
    # Local hour 1 (00:00 to 01:00 at UTC+1) is the last hour of 2009 in UTC.
    assert record.period == "2009-12-31 23:00 to 2010-12-31 23:00 UTC"
    assert not record.typical_year
    assert record.timezone == "Etc/GMT-1"
    assert (record.latitude, record.longitude, record.altitude) == (52.3, 4.8, -3.0)
    frame = record.frame
    first = frame.iloc[0]
    assert first["air_temperature"] == 0.1
    assert first["cloud_cover"] == 4.0  # 5 tenths
    assert first["sky_infrared"] == 300.0
    # Local hour 9 (08:00 to 09:00) is the first with sun: 08:00 UTC is its end.
    assert frame.loc["2010-01-01 07:00", "global_radiation"].item() == 0.0
    assert frame.loc["2010-01-01 08:00", "global_radiation"].item() == 100.0


def test_epw_says_which_values_are_instants(tmp_path: Path) -> None:
    record = read_epw(write_epw(tmp_path / "real.epw", 2010))
    assert record.timing["wind_speed"] == record.timing["air_temperature"] == "instant"
    assert record.timing["global_radiation"] == record.timing["sky_infrared"] == "mean"


def test_epw_of_a_typical_year_gets_one_year_and_is_turned_to_utc(tmp_path: Path) -> None:
    years = {month: 1990 + month for month in range(1, 13)}
    record = read_epw(write_epw(tmp_path / "typical.epw", years), timezone="Europe/Amsterdam")
    assert record.period == "2001-01-01 00:00 to 2002-01-01 00:00 UTC"
    assert record.typical_year
    assert "typical year" in record.notes[0]
    assert record.timezone == "Europe/Amsterdam"
    # The first UTC hour is the second local one; the first local one has come round to the end.
    np.testing.assert_array_equal(record.values("air_temperature")[[0, -1]], [0.2, 0.1])
    other = read_epw(tmp_path / "typical.epw", year=2013)
    assert other.period == "2013-01-01 00:00 to 2014-01-01 00:00 UTC"
    assert other.digest != record.digest


def test_a_typical_year_cannot_be_a_leap_year(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "typical.epw", {month: 1990 + month for month in range(1, 13)})
    with pytest.raises(WeatherError, match="2012 is a leap year and a typical year has no 29 February"):
        read_epw(path, year=2012)


def test_a_real_year_takes_no_nominal_year(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match=r"one real year \(2010\): --year is only for typical years"):
        read_epw(write_epw(tmp_path / "real.epw", 2010), year=2001)


def test_epw_codes_for_missing_are_gaps(tmp_path: Path) -> None:
    start = dt.datetime(2010, 1, 1, 4)
    path = write_epw(tmp_path / "gap.epw", 2010, edits={4: epw_line(start, 2010, temperature=99.9)})
    with pytest.raises(WeatherError, match=r"gap\.epw, row 13: no value for air temperature"):
        read_epw(path)
    assert read_epw(path, fill_gaps=1).values("air_temperature")[4] == 0.5


def test_incomplete_sky_infrared_is_left_out_with_a_note(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "sky.epw", 2010, edits={4: epw_line(dt.datetime(2010, 1, 1, 4), 2010, infrared=9999)})
    record = read_epw(path)
    assert "sky_infrared" not in record.counts
    assert "cloud_cover" in record.counts
    assert record.notes == ("sky_infrared left out: 1 h without a value",)


def test_measured_infrared_gives_the_sky_temperature_in_both_preprocessings(tmp_path: Path) -> None:
    record = read_epw(write_epw(tmp_path / "real.epw", 2010))
    expected = (300.0 / 5.6697e-8) ** 0.25 - 273.15
    for preprocessing in ("paper", "conserving"):
        made = disturbances(record, start=dt.datetime(2010, 5, 1), steps=4, preprocessing=preprocessing)
        np.testing.assert_allclose(made.values[:, 5], expected, rtol=1e-13)


def test_wind_that_is_an_instant_runs_linearly(tmp_path: Path) -> None:
    calm = {4: epw_line(dt.datetime(2010, 1, 1, 4), 2010, wind=0.0)}
    record = read_epw(write_epw(tmp_path / "wind.epw", 2010, edits=calm))
    start = dt.datetime(2010, 1, 1, 3, tzinfo=dt.UTC)  # the slot that ends calm, in UTC
    made = disturbances(record, start=start, steps=8, preprocessing="conserving")
    expected = 4.5 * np.array([0.875, 0.625, 0.375, 0.125, 0.125, 0.375, 0.625, 0.875])
    np.testing.assert_allclose(made.values[:, 4], expected, rtol=1e-13)


def test_half_hour_clocks_need_a_zone_by_name(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "delhi.epw", 2010, offset=5.5)
    with pytest.raises(
        WeatherError, match=r"\+5\.5 h from UTC, which has no fixed IANA zone. Give one with --timezone"
    ):
        read_epw(path)
    record = read_epw(path, timezone="Asia/Kolkata")
    assert record.period == "2009-12-31 18:30 to 2010-12-31 18:30 UTC"
    made = disturbances(record, start=dt.date(2010, 5, 1), steps=96, preprocessing="conserving")
    assert made.hour_of_day[0] == 0.0
    np.testing.assert_allclose(made.values[:, 7], 0.8 * 3.6, rtol=1e-13)  # 8 h of 100 W m-2 = 2.88 MJ m-2
    paper = disturbances(record, start=dt.date(2010, 5, 1), steps=96)
    assert np.isfinite(paper.values).all()


def test_a_cut_off_epw_is_refused(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "cut.epw", {month: 1990 + month for month in range(1, 13)})
    path.write_text("\n".join(path.read_text().splitlines()[:5000]) + "\n")
    with pytest.raises(WeatherError, match="holds 4992 hours instead of the 8760 of a typical year"):
        read_epw(path)


def test_something_else_is_no_epw(tmp_path: Path) -> None:
    path = tmp_path / "other.epw"
    path.write_text("hello\n")
    with pytest.raises(WeatherError, match="cannot be read as an EnergyPlus weather file"):
        read_epw(path)


def test_an_epw_hour_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    line = epw_line(dt.datetime(2010, 1, 1, 4), 2010).replace("2010,1,1,5,", "2010,2,30,5,", 1)
    path = write_epw(tmp_path / "bad.epw", 2010, edits={4: line})
    with pytest.raises(
        WeatherError, match=r"cannot be read as an EnergyPlus weather file|2010-02-30, hour 5 does not exist"
    ):
        read_epw(path)


# --- TMY ----------------------------------------------------------------------------------------------------------------------


def test_tmy3_is_a_typical_year_turned_to_utc(tmp_path: Path) -> None:
    record = read_tmy(write_tmy3(tmp_path / "tmy3.csv"), timezone="America/Los_Angeles")
    assert record.period == "2001-01-01 00:00 to 2002-01-01 00:00 UTC"
    assert record.typical_year
    assert (record.station, record.latitude, record.longitude) == ("TESTFIELD", 37.617, -122.4)
    # UTC-8: the first UTC hour is local hour 17 of 31 December, come round; local hour 1 of 1 January is the 9th.
    temperature = record.values("air_temperature")
    np.testing.assert_allclose(temperature[[0, 7, 8]], [1.7, 2.4, 0.1])
    assert set(record.values("cloud_cover")) == {8.0}
    # Sun from 08:00 to 16:00 local is 16:00 to 24:00 UTC.
    assert record.values("global_radiation")[:24].tolist() == [0.0] * 16 + [200.0] * 8


def test_tmy3_hours_around_the_end_of_a_leap_years_february_stay_in_place(tmp_path: Path) -> None:
    record = read_tmy(write_tmy3(tmp_path / "tmy3.csv"))
    # Local 28 February 24:00 is 1 March 08:00 UTC; local hours keep their order 0.1 ... 2.4.
    february_end = (31 + 28) * 24 + 8
    np.testing.assert_allclose(record.values("air_temperature")[february_end - 1 : february_end + 1], [2.4, 0.1])


def test_a_cut_off_tmy3_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WeatherError, match="holds 8660 hours instead of the 8760"):
        read_tmy(write_tmy3(tmp_path / "tmy3.csv", drop=100))


def test_something_else_is_no_tmy(tmp_path: Path) -> None:
    for name, words in (("other.csv", "a TMY3 file"), ("other.tm2", "a TMY2 file")):
        path = tmp_path / name
        path.write_text("hello\nworld\n")
        with pytest.raises(WeatherError, match=f"cannot be read as {words}"):
            read_tmy(path)


def test_tmy3_with_half_hour_stamps_is_refused(tmp_path: Path) -> None:
    path = write_tmy3(tmp_path / "tmy3.csv")
    path.write_text(path.read_text().replace(":00,", ":30,"))
    with pytest.raises(WeatherError, match="its stamps are not whole hours"):
        read_tmy(path)


# --- CSV ----------------------------------------------------------------------------------------------------------------------


def test_the_documented_csv_is_read(tmp_path: Path) -> None:
    record = read_csv(csv_file(tmp_path, csv_text(csv_rows(48))), name="veld")
    assert record.period == "2020-06-01 00:00 to 2020-06-03 00:00 UTC"
    assert record.name == "veld"
    assert (record.station, record.latitude, record.longitude, record.altitude) == ("Testveld", 52.0, 5.0, 10.0)
    assert (record.source, record.licence) == ("made up for a test", "CC0")
    assert record.values("wind_speed")[0] == 3.25
    assert record.values("global_radiation").sum() == 2 * 8 * 400


def test_the_example_in_the_documentation_is_read(tmp_path: Path) -> None:
    document = (Path(__file__).parents[2] / "docs" / "weather.md").read_text()
    example = document.split("```csv\n", 1)[1].split("```", 1)[0]
    record = read_csv(csv_file(tmp_path, example))
    assert record.hours == 3


def test_csv_units_and_slot_starts_are_converted(tmp_path: Path) -> None:
    header = "slot_start [UTC],air_temperature [K],relative_humidity [%],wind_speed [km/h],global_radiation [J/cm2],cloud_cover [%]"
    path = csv_file(tmp_path, csv_text(["2020-06-01T00:00,293.15,70,18,36,50"], header=header))
    record = read_csv(path)
    assert record.period == "2020-06-01 00:00 to 2020-06-01 01:00 UTC"
    assert record.frame.iloc[0].to_dict() == {
        "air_temperature": 20.0,
        "relative_humidity": 70.0,
        "wind_speed": 5.0,
        "global_radiation": 100.0,
        "cloud_cover": 4.0,
    }


def test_csv_times_with_an_offset_are_turned_to_utc(tmp_path: Path) -> None:
    path = csv_file(tmp_path, csv_text(["2020-06-01T03:00+02:00,20,70,5,0,4"]))
    assert read_csv(path).period == "2020-06-01 00:00 to 2020-06-01 01:00 UTC"


def test_csv_timing_comments_say_what_a_value_is(tmp_path: Path) -> None:
    path = csv_file(tmp_path, csv_text(csv_rows(1), comments=(*CSV_COMMENTS, "# timing wind_speed: instant")))
    assert read_csv(path).timing["wind_speed"] == "instant"


def test_csv_with_measured_sky_temperature_uses_it(tmp_path: Path) -> None:
    header = CSV_HEADER.replace("cloud_cover [octants]", "sky_temperature [degC]")
    record = read_csv(csv_file(tmp_path, csv_text(csv_rows(72), header=header)))
    for preprocessing in ("paper", "conserving"):
        made = disturbances(record, start=dt.datetime(2020, 6, 2), steps=4, preprocessing=preprocessing)
        np.testing.assert_allclose(made.values[:, 5], 6.0, rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (csv_text([]), "holds no hourly values"),
        (
            csv_text(csv_rows(2), header=CSV_HEADER.replace("air_", "air")),
            r"unknown column 'airtemperature \[degC\]'. Did you mean",
        ),
        (csv_text(csv_rows(2), header=CSV_HEADER.replace("[degC]", "[F]")), r"unknown column 'air_temperature \[F\]'"),
        (
            csv_text(csv_rows(2), header=CSV_HEADER.replace("slot_end [UTC]", "cloud_cover [tenths]")),
            "two columns for cloud_cover",
        ),
        (csv_text(["2020-06-01T01:00,20"]), "2 fields instead of 6"),
        (csv_text(["yesterday,20,70,5,0,4"]), "'yesterday' is no time such as"),
        (csv_text(["2020-06-01T01:00,20,wet,5,0,4"]), r"row 9: 'wet' for relative_humidity \[%\] is no number"),
        (csv_text(["2020-06-01T01:00,inf,70,5,0,4"]), "'inf' for .* is not finite"),
        (csv_text(["2020-06-01T01:00,,70,5,0,4"]), "row 9: no value for air temperature"),
        (csv_text(["2020-06-01T01:00,20,70,5,-3,4"]), "row 9: global radiation of -3 W/m2 .* is impossible"),
        (csv_text(["2020-06-01T01:02,20,70,5,0,4"]), "off the 5-minute grid"),
        (csv_text([*csv_rows(1), "2020-06-01T01:30,20,70,5,0,4"]), "rows must be hourly"),
        (csv_text(csv_rows(2), comments=CSV_COMMENTS[1:4]), "do not give timezone"),
        (
            csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timezon: UTC")),
            "unknown comment '# timezon: ...'. Did you mean 'timezone'",
        ),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# latitude: north")), "'north' for latitude is no number"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# latitude: 152")), "latitude 152.0 deg is impossible"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# altitude: 9500")), "altitude 9500.0 m is impossible"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timezone: Mars/Crater")), "'Mars/Crater' is no time zone"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timing wind_speed: gusts")), "must be instant .* or mean"),
        (
            csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timing global_radiation: instant")),
            "radiation must be a mean",
        ),
        (
            csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timing air_temperature: mean")),
            "both be instants or both be means",
        ),
    ],
)
def test_csv_files_are_refused_in_words(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(WeatherError, match=rf"(table\.csv.*)?{words}"):
        read_csv(csv_file(tmp_path, text))


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("cloud_cover [octants]", "says nothing about the sky"),
        ("wind_speed [m/s]", r"no column for wind speed \[m/s\]"),
        ("slot_end [UTC]", "no time column"),
    ],
)
def test_a_csv_without_a_needed_column_is_refused(tmp_path: Path, gone: str, words: str) -> None:
    titles = CSV_HEADER.split(",")
    keep = [i for i, title in enumerate(titles) if title != gone]
    rows = [",".join(row.split(",")[i] for i in keep) for row in csv_rows(2)]
    with pytest.raises(WeatherError, match=words):
        read_csv(csv_file(tmp_path, csv_text(rows, header=",".join(titles[i] for i in keep))))


# --- the one door -------------------------------------------------------------------------------------------------------------


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
    with pytest.raises(WeatherError, match=r"none of the known weather formats \(knmi, epw, tmy, csv\)"):
        read_weather(path)


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="no weather format 'kmni'. Did you mean 'knmi'"):
        read_weather(csv_file(tmp_path, ""), "kmni")


def test_options_of_another_format_are_refused(tmp_path: Path) -> None:
    path = csv_file(tmp_path, csv_text(csv_rows(1)))
    with pytest.raises(WeatherError, match="read as csv, which takes no --timezone"):
        read_weather(path, timezone="UTC")
    with pytest.raises(WeatherError, match="takes no --year"):
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
