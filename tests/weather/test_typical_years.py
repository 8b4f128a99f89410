"""EPW and TMY files: real and typical years, clocks, missing values."""

from __future__ import annotations

import datetime as dt
import re
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from glbench.errors import WeatherError
from glbench.weather import disturbances, read_weather
from tests.weather.files import epw_line, write_epw, write_tmy3

read_epw = partial(read_weather, file_format="epw")
read_tmy = partial(read_weather, file_format="tmy")


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
    local_hour_9 = 8  # rows from 0
    assert frame.index[local_hour_9] == pd.Timestamp("2010-01-01 08:00", tz="UTC")
    assert frame["global_radiation"].tolist()[local_hour_9 - 1 : local_hour_9 + 1] == [0.0, 100.0]


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


def test_a_half_hour_clock_has_a_zone_and_whole_hours_in_utc(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "delhi.epw", 2010, offset=5.5)
    record = read_epw(path)
    assert record.timezone == "Asia/Kolkata"
    # The file runs from 31 December 18:30 UTC; hours of UTC that it covers whole, each half of two of its own.
    assert record.period == "2009-12-31 19:00 to 2010-12-31 18:00 UTC"
    np.testing.assert_allclose(record.values("air_temperature")[:3], [0.15, 0.25, 0.35])
    made = disturbances(record, start=dt.date(2010, 5, 1), steps=96, preprocessing="conserving")
    assert made.hour_of_day[0] == 0.0
    np.testing.assert_allclose(made.values[:, 7], 0.8 * 3.6, rtol=1e-13)  # 8 h of 100 W m-2 = 2.88 MJ m-2
    paper = disturbances(record, start=dt.date(2010, 5, 1), steps=96)
    assert np.isfinite(paper.values).all()


def test_a_typical_year_on_a_half_hour_clock_is_whole(tmp_path: Path) -> None:
    record = read_epw(write_epw(tmp_path / "delhi.epw", {month: 1990 + month for month in range(1, 13)}, offset=5.5))
    assert record.period == "2001-01-01 00:00 to 2002-01-01 00:00 UTC"
    # 00:00 to 01:00 UTC is 05:30 to 06:30 local: half of hour 6, half of hour 7. The last: half of hours 5 and 6.
    np.testing.assert_allclose(record.values("air_temperature")[[0, -1]], [0.65, 0.55])


def test_an_odd_clock_needs_a_zone_by_name(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "odd.epw", 2010, offset=-3.5)
    with pytest.raises(WeatherError, match=r"-3\.5 h from UTC, which has no fixed IANA zone. Give one with --timezone"):
        read_epw(path)
    assert read_epw(path, timezone="America/St_Johns").timezone == "America/St_Johns"


def typical_epw(folder: Path) -> Path:
    return write_epw(folder / "typical.epw", {month: 1990 + month for month in range(1, 13)})


@pytest.mark.parametrize(
    ("place", "station", "encoding"),
    [
        ('"Den Helder, NH"', "Den Helder, NH, NLD", "utf-8-sig"),
        ("Den Helder, NH", "Den Helder", "utf-8"),  # the comma shifts what follows, not the numbers at the end
        ("Belém", "Belém, NLD", "latin-1"),
        ("Belém", "Belém, NLD", "utf-16"),
        ("http_site", "http_site, NLD", "utf-8-sig"),
    ],
)
def test_names_of_places_in_every_encoding_are_read(
    tmp_path: Path, place: str, station: str, encoding: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = typical_epw(tmp_path)
    text = "\r\n".join(path.read_text().replace("Testdam", place).splitlines())
    monkeypatch.chdir(tmp_path)
    Path("http_site.epw").write_bytes(text.encode(encoding))
    record = read_weather("http_site.epw")
    assert (record.latitude, record.longitude, record.altitude) == (52.3, 4.8, -3.0)
    assert record.station.startswith(station)


@pytest.mark.parametrize("lines", [2, 8, 11])
def test_an_epw_may_have_any_number_of_header_lines(tmp_path: Path, lines: int) -> None:
    path = typical_epw(tmp_path)
    text = path.read_text().splitlines()
    header = (text[:1] + text[5:8] * 4)[:lines]
    expected = read_epw(path).digest
    path.write_text("\n".join([*header, *text[8:], ""]))
    assert read_epw(path).digest == expected
    text[8 + 2] = text[8 + 2].replace(",0.3,", ",oops,", 1)
    path.write_text("\n".join([*header, *text[8:], ""]))
    with pytest.raises(WeatherError, match=rf"row {lines + 3}, column 'dry-bulb temperature': 'oops' is not a number"):
        read_epw(path)


def test_hours_from_0_to_23_come_in_with_a_note(tmp_path: Path) -> None:
    path = typical_epw(tmp_path)
    expected = read_epw(path).digest
    path.write_text(re.sub(r"(?m)^(\d+,\d+,\d+),(\d+),", lambda m: f"{m[1]},{int(m[2]) - 1},", path.read_text()))
    record = read_epw(path)
    assert record.digest == expected
    assert record.notes[0].startswith("hours run from 0 to 23 instead of 1 to 24 (row 9)")


def test_an_hour_0_among_hours_to_24_is_refused(tmp_path: Path) -> None:
    line = epw_line(dt.datetime(2010, 1, 1, 4), 2010).replace("2010,1,1,5,", "2010,1,1,0,", 1)
    with pytest.raises(WeatherError, match=r"row 13, column 'hour': hour 0 does not exist|row 13: hour 0 does not exist"):
        read_epw(write_epw(tmp_path / "bad.epw", 2010, edits={4: line}))


def test_sky_infrared_of_0_everywhere_is_missing(tmp_path: Path) -> None:
    path = typical_epw(tmp_path)
    path.write_text(path.read_text().replace(",300.0,", ",0,"))
    record = read_epw(path)
    assert set(record.counts) == {"air_temperature", "relative_humidity", "wind_speed", "global_radiation", "cloud_cover"}
    assert "infrared radiation is 0 or missing in every row" in record.notes[0]
    path.write_text(path.read_text().replace(",5,5,10,7777,", ",0,0,10,7777,"))
    record = read_epw(path)
    assert any("cloud cover is 0 in every row" in note for note in record.notes)
    assert any(note.startswith("sky_infrared estimated") for note in record.notes)


@pytest.mark.parametrize("code", ["99.9", "999", "-9999", ""])
def test_other_codes_for_missing_are_gaps(tmp_path: Path, code: str) -> None:
    path = write_epw(tmp_path / "gap.epw", 2010)
    path.write_text(path.read_text().replace("?9?9?9,0.5,", f"?9?9?9,{code},", 1))
    with pytest.raises(WeatherError, match=r"gap\.epw, row 13: no value for air temperature"):
        read_epw(path)


def test_an_epw_without_humidity_takes_the_dew_point(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "dew.epw", 2010)
    path.write_text(path.read_text().replace(",2.0,75,", ",-3.0,999,"))
    record = read_epw(path)
    assert "relative humidity from the dew point" in record.notes
    assert 70.0 < record.values("relative_humidity")[0] < 85.0


@pytest.mark.parametrize("minutes", [("15", "30", "45", "60"), ("0", "15", "30", "45"), ("0", "0", "0", "0")])
def test_an_epw_of_quarter_hours_is_averaged(tmp_path: Path, minutes: tuple[str, ...]) -> None:
    path = write_epw(tmp_path / "quarters.epw", 2010)
    hourly = read_epw(path)
    text = path.read_text().splitlines()
    header = [line.replace("DATA PERIODS,1,1", "DATA PERIODS,1,4") for line in text[:8]]
    rows = [re.sub(r"^(\d+,\d+,\d+,\d+),60", rf"\1,{minute}", line) for line in text[8:] for minute in minutes]
    path.write_text("\n".join([*header, *rows, ""]))
    record = read_epw(path)
    assert record.period == hourly.period
    np.testing.assert_array_equal(record.counts["global_radiation"], hourly.counts["global_radiation"])
    assert record.notes[0] == "rows of 15 min averaged to hours; 8,760 h"
    path.write_text("\n".join([*header, *rows[:10], *rows[11:], ""]))
    with pytest.raises(WeatherError, match="row 17: this hour has 3 rows, most have 4"):
        read_epw(path)


def test_a_leap_year_without_its_29_february_is_a_typical_year(tmp_path: Path) -> None:
    record = read_epw(write_epw(tmp_path / "leap.epw", 2012))
    assert record.typical_year
    assert record.period == "2001-01-01 00:00 to 2002-01-01 00:00 UTC"


def test_the_29_february_of_a_typical_year_is_left_out(tmp_path: Path) -> None:
    path = typical_epw(tmp_path)
    expected = read_epw(path).digest
    lines = path.read_text().splitlines()
    day = [epw_line(dt.datetime(1992, 2, 29, hour), 1992) for hour in range(24)]
    march = 8 + (31 + 28) * 24
    path.write_text("\n".join([*lines[:march], *day, *lines[march:], ""]))
    record = read_epw(path)
    assert record.digest == expected
    assert "29 February left out (24 rows): a typical year is a common year" in record.notes


def test_rows_that_are_none_or_too_short_are_named(tmp_path: Path) -> None:
    path = typical_epw(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:12], "made up", *lines[12:], ""]))
    with pytest.raises(WeatherError, match=r"typical\.epw, row 13: 'made up' is no row of an EPW"):
        read_epw(path)
    path.write_text("\n".join([*lines[:12], lines[12][:40], *lines[13:], ""]))
    with pytest.raises(WeatherError, match=r"typical\.epw, row 13: \d+ fields instead of at least 23"):
        read_epw(path)


def test_typical_rows_out_of_order_or_twice_are_named(tmp_path: Path) -> None:
    path = typical_epw(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:12], lines[11], *lines[13:], ""]))
    with pytest.raises(WeatherError, match=r"row 13: 01-01 04:00 appears twice"):
        read_epw(path)


def test_coordinates_of_the_command_line_go_first(tmp_path: Path) -> None:
    record = read_epw(typical_epw(tmp_path), coordinates=(51.0, 4.0, 7.0))
    assert (record.latitude, record.longitude, record.altitude) == (51.0, 4.0, 7.0)


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
    with pytest.raises(WeatherError, match=r"bad\.epw, row 13: the date 2010-02-30 does not exist"):
        read_epw(path)


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
    path = tmp_path / "other.tm2"
    path.write_text("hello\nworld\n")
    with pytest.raises(WeatherError, match=r"cannot be read as a TMY2 file: its first line"):
        read_tmy(path)
    path = tmp_path / "other.csv"
    path.write_text("hello\nworld\n")
    with pytest.raises(WeatherError, match=r"other\.csv has no line of titles above rows of values"):
        read_tmy(path)


def test_tmy3_with_half_hour_stamps_is_refused(tmp_path: Path) -> None:
    path = write_tmy3(tmp_path / "tmy3.csv")
    path.write_text(path.read_text().replace(":00,", ":30,"))
    with pytest.raises(WeatherError, match=r"row 26, column 'Date .*: the time '01/01/1989 24:30' does not exist"):
        read_tmy(path)
    path.write_text(path.read_text().replace(",24:30,", ",24:00,"))
    with pytest.raises(WeatherError, match="its stamps are not whole hours"):
        read_tmy(path)


def test_a_tmy3_without_cloud_gets_an_estimated_sky(tmp_path: Path) -> None:
    path = write_tmy3(tmp_path / "tmy3.csv")
    path.write_text(path.read_text().replace("TotCld (tenths)", "Cloud"))
    record = read_tmy(path)
    assert "sky_infrared" in record.counts
    assert any(note.startswith("sky_infrared estimated") for note in record.notes)


def test_a_tmy3_without_temperature_is_refused(tmp_path: Path) -> None:
    path = write_tmy3(tmp_path / "tmy3.csv")
    path.write_text(path.read_text().replace("Dry-bulb (C)", "Tdry"))
    with pytest.raises(WeatherError, match=r"there is no column 'Dry-bulb \(C\)', which is needed. It has: Date"):
        read_tmy(path)
