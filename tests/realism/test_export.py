"""A greenhouse's own export: units, steps, clocks, what is estimated, and what is refused with which words."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from glbench.errors import ArchiveError, GlbenchError
from glbench.realism import Indoor, read_archive, read_indoor, read_settings
from glbench.realism.export import WEATHER_UNITS, read_export
from glbench.realism.identify import SHIPPED_PAGE, read_page, read_problem
from glbench.realism.inputs import outdoors
from tests.realism.made import Made, own_export

CLOCK = "Europe/Amsterdam"


def climate_of(folder: Path, lamp_power: float | None = None) -> Indoor:
    archive = read_archive(folder, CLOCK)
    (own,) = archive.compartments
    assert own.indoor is not None
    return read_indoor(own.indoor, CLOCK, first=archive.first, days=archive.days, lamp_power=lamp_power)


def test_an_export_says_the_same_as_the_archive(tmp_path: Path) -> None:
    made = Made()
    made.climate["Anna"] = made.indoors()
    published = read_archive(made.write(tmp_path / "archive"))
    path = published.compartments[0].indoor
    assert path is not None
    theirs = read_indoor(path)
    folder = own_export(made, tmp_path / "house")
    archive, mine = read_archive(folder, CLOCK), climate_of(folder)
    assert (archive.first, archive.days, archive.own) == (published.first, published.days, True)
    assert mine.name == "house"
    assert np.array_equal(mine.times, theirs.times)
    for name in ("air_temperature", "humidity", "co2", "vents_lee", "vents_wind", "rail_pipe", "thermal_screen", "lamps", "co2_dose"):
        assert mine.columns[name] == pytest.approx(theirs.columns[name], nan_ok=True), name
    one, other = (outdoors(each, CLOCK, 410.0, step_seconds=300) for each in (archive, published))
    for name in ("iGlob", "tOut", "vpOut", "wind"):
        assert one.of(name) == pytest.approx(other.of(name)), name
    assert any("estimated" in note for note in archive.notes)
    assert np.all(one.of("tSky") < one.of("tOut")), "the estimated sky is colder than the air"


def test_other_units_commas_and_orders_are_read(tmp_path: Path) -> None:
    made = Made()
    usual, other = own_export(made, tmp_path / "usual"), own_export(made, tmp_path / "other")
    table = pd.read_csv(usual / "indoor.csv", index_col="time")
    table["air_temperature [K]"] = table.pop("air_temperature [degC]") + 273.15
    table["thermal_screen [fraction]"] = table.pop("thermal_screen [%]") / 100.0
    table["co2_dose [kg/ha/h]"] = table.pop("co2_dose [kg/m2/h]") * 1e4
    table["lamps [%]"] = table.pop("lamps [W/m2]") / 110.0 * 100.0
    table["mood"] = "good"
    table[::-1].to_csv(other / "indoor.csv", sep=";", decimal=",")
    mine, theirs = climate_of(other, lamp_power=110.0), climate_of(usual)
    for name, values in theirs.columns.items():
        assert mine.columns[name] == pytest.approx(values, nan_ok=True), name
    assert mine.lamp_power == 110.0
    assert any("columns that are not read: 'mood'" in note for note in mine.notes)


def test_finer_steps_are_averaged_and_coarser_ones_held(tmp_path: Path) -> None:
    usual = pd.read_csv(own_export(Made(), tmp_path) / "indoor.csv", index_col="time", parse_dates=True)
    air = "air_temperature [degC]"
    minutes = usual.resample("1min").ffill()
    minutes[air] += np.tile([-0.2, -0.1, 0.0, 0.1, 0.2], len(minutes) // 5 + 1)[: len(minutes)]
    minutes.to_csv(tmp_path / "indoor.csv")
    expected = usual[air].to_numpy()[:-1]
    assert climate_of(tmp_path).columns["air_temperature"] == pytest.approx(expected)
    usual[::3].to_csv(tmp_path / "indoor.csv")
    assert climate_of(tmp_path).columns["air_temperature"] == pytest.approx(np.repeat(expected[::3], 3))


def test_one_file_may_have_both_and_one_kind_of_vents(tmp_path: Path) -> None:
    folder = own_export(Made(), tmp_path)
    inside, outside = (pd.read_csv(folder / f"{name}.csv", index_col="time", comment="#") for name in ("indoor", "weather"))
    both = inside.join(outside.assign(**{"sky_temperature [degC]": -4.0})).drop(columns="vents_wind [%]")
    both.to_csv(folder / "indoor.csv")
    (folder / "weather.csv").unlink()
    archive, indoor = read_archive(folder, CLOCK), climate_of(folder)
    assert outdoors(archive, CLOCK, 410.0).of("tSky") == pytest.approx(-4.0)
    assert np.array_equal(indoor.columns["vents_wind"], indoor.columns["vents_lee"])
    assert any("vents_lee counts for both sides" in note for note in indoor.notes)


def test_only_whole_days_of_both_are_used(tmp_path: Path) -> None:
    folder = own_export(Made(days=4), tmp_path)
    lines = (folder / "indoor.csv").read_text().splitlines(keepends=True)
    (folder / "indoor.csv").write_text("".join([lines[0], *lines[100:900]]))
    archive = read_archive(folder, CLOCK)
    assert (archive.first, archive.days) == (dt.date(2020, 2, 11), 2)


def test_a_clock_without_offset_follows_summer_time(tmp_path: Path) -> None:
    folder = own_export(Made(first=dt.date(2020, 3, 28)), tmp_path)
    with pytest.raises(ArchiveError, match=r"row \d+, column 'time': 2020-03-29 02:00 does not exist on the clock of Europe/Amsterdam"):
        read_archive(folder, CLOCK)
    for name in ("indoor", "weather"):
        path = folder / f"{name}.csv"
        path.write_text("".join(line for line in path.read_text().splitlines(keepends=True) if not line.startswith("2020-03-29 02")))
    indoor = climate_of(folder)
    assert indoor.times.size == 3 * 288 - 12
    assert not np.isnan(indoor.columns["air_temperature"]).any()


def test_times_whose_title_says_utc_are_utc(tmp_path: Path) -> None:
    path = tmp_path / "weather.csv"
    rows = [f"2020-03-29 {i // 12:02d}:{i % 12 * 5:02d},{i}" for i in range(60)]
    for title in ("time (UTC)", "datum_utc", "time", "time (UTC+1)", "time [GMT+01:00]"):
        path.write_text("\n".join([f"{title},outdoor_temperature [degC]", *(row for row in rows if title != "time" or " 02" not in row)]))
        first = read_export(path, WEATHER_UNITS, "Europe/Amsterdam").seconds[0]
        is_utc = title in ("time (UTC)", "datum_utc")
        assert str(np.datetime64(int(first), "s")) == ("2020-03-29T00:00:00" if is_utc else "2020-03-28T23:00:00")


@pytest.mark.parametrize(
    ("title", "begin"),
    [
        *(
            (title, "23:00")
            for title in ("time [UTC+1]", "time (UTC + 1)", "time (UTC+01:00)", "time GMT+0100", "time (Etc/GMT-1)", "time UTC (+1)")
        ),
        *((title, "22:00") for title in ("time", "time (CET = UTC+1, summer UTC+2)", "time (UTC+1/+2)", "time (UTC+5:30)", "time (UTC+2)")),
        *((title, "22:00") for title in ("time +/-1 min", "time, utc_offset+1", "time UTC+1 DST", "time UTC - 10 min")),
        *((title, "22:00") for title in ("(UTC+01:00) Amsterdam, Berlin, Bern", "time (UTC+1, +2 in summer)", "time (UTC+1|+2)")),
    ],
)
def test_an_offset_in_the_title_holds_all_year(tmp_path: Path, title: str, begin: str) -> None:
    """One that names two, or half hours, says nothing: the clock of the settings counts."""
    path = tmp_path / "weather.csv"
    path.write_text("\n".join([f'"{title}",outdoor_temperature [degC]', "2020-07-01 00:00,1", "2020-07-01 00:05,2"]))
    export = read_export(path, WEATHER_UNITS, "Europe/Amsterdam")
    assert str(np.datetime64(int(export.seconds[0]), "s")) == f"2020-06-30T{begin}:00"
    assert any("all year, as their title says" in note for note in export.notes) == (begin == "23:00" or title == "time (UTC+2)")


@pytest.mark.parametrize(("step", "other"), [(5, 10), (10, 5), (10, 15), (5, 15), (5, 30), (5, 60)])
def test_an_export_whose_step_changes_says_so(tmp_path: Path, step: int, other: int) -> None:
    """A sum over each row is refused: it would be divided by the length of another."""
    path = tmp_path / "weather.csv"
    minutes = [*range(0, 40 * step, step), *range(40 * step, 40 * step + 12 * other, other)]
    rows = [f"2020-07-0{1 + minute // 1440} {minute % 1440 // 60:02d}:{minute % 60:02d},1" for minute in minutes]
    path.write_text("\n".join(["time,outdoor_temperature [degC]", *rows]))
    (note,) = read_export(path, WEATHER_UNITS, "Europe/Amsterdam").notes
    assert f"its step changes: most rows are {step} min apart, but not those around line 43" in note
    path.write_text("\n".join(["time,global_radiation [J/cm2]", *rows]))
    with pytest.raises(
        ArchiveError, match=r"its step changes: .*, and global_radiation is a sum over each row\. Export one step throughout"
    ):
        read_export(path, WEATHER_UNITS, "Europe/Amsterdam")


def test_lost_rows_are_no_change_of_step(tmp_path: Path) -> None:
    path = tmp_path / "weather.csv"
    rows = [f"2020-07-01 {i // 12:02d}:{i % 12 * 5:02d},{i}" for i in range(200) if i % 7 and i not in range(90, 97)]
    path.write_text("\n".join(["time,global_radiation [J/cm2]", *rows]))
    assert read_export(path, WEATHER_UNITS, "Europe/Amsterdam").notes == ()


def test_a_place_may_be_west_or_south(tmp_path: Path) -> None:
    path = tmp_path / "weather.csv"
    rows = [f"2020-07-01 00:{5 * i:02d},{i}" for i in range(9)]
    path.write_text("\n".join(["# latitude: 36.8 S", "# longitude: 123,1° W", "# altitude: 5 m", "time,outdoor_temperature [degC]", *rows]))
    assert read_export(path, WEATHER_UNITS, "UTC").place == {"latitude": -36.8, "longitude": -123.1, "altitude": 5.0}


def test_an_unknown_clock_is_refused(tmp_path: Path) -> None:
    folder = own_export(Made(), tmp_path)
    with pytest.raises(GlbenchError, match="'Europe/Amsterdm' is no time zone of the IANA database"):
        read_archive(folder, "Europe/Amsterdm")


@pytest.mark.parametrize("written", ["52.012", "52,012", "52.012;;;", "52.012,,"])
def test_a_place_is_read_as_it_is_written(tmp_path: Path, written: str) -> None:
    """In a table with decimal commas, and in one that a spreadsheet saved again, with a separator for each column."""
    folder = own_export(Made(), tmp_path)
    table = pd.read_csv(folder / "weather.csv", index_col="time", comment="#")
    (folder / "weather.csv").write_text(f"# latitude: {written}\n# longitude: 4.5\n" + table.to_csv(sep=";", decimal=","))
    assert read_export(folder / "weather.csv", WEATHER_UNITS, CLOCK).place == {"latitude": 52.012, "longitude": 4.5}


def test_columns_of_the_weather_beside_the_climate(tmp_path: Path) -> None:
    """One column of the weather in indoor.csv leaves weather.csv in use; with all of them there, none is reported as not read."""
    folder = own_export(Made(), tmp_path)
    inside, outside = (pd.read_csv(folder / f"{name}.csv", index_col="time", comment="#") for name in ("indoor", "weather"))
    inside.join(outside[["outdoor_temperature [degC]"]]).to_csv(folder / "indoor.csv")
    assert read_archive(folder, CLOCK).weather.source.name == "weather.csv"
    inside.join(outside.assign(**{"sky_temperature [degC]": -4.0})).to_csv(folder / "indoor.csv")
    assert read_archive(folder, CLOCK).weather.source.name == "indoor.csv"
    assert not any("not read" in note for note in (*read_archive(folder, CLOCK).notes, *climate_of(folder).notes))


def test_lamps_at_full_power_and_error_codes(tmp_path: Path) -> None:
    """Rounding never makes lamps stronger than the settings say, nor does a reading that no lamp can have."""
    folder = own_export(Made(), tmp_path)
    table = pd.read_csv(folder / "indoor.csv", index_col="time")
    table["lamps [%]"] = np.where(table.pop("lamps [W/m2]") > 0.0, 100.0, 0.0)
    table.to_csv(folder / "indoor.csv")
    for power in (62.0, 81.0, 110.0):
        assert np.nanmax(climate_of(folder, lamp_power=power).columns["lamps"]) == pytest.approx(power)
    table["lamps [W/m2]"] = table.pop("lamps [%]")
    table.iloc[7, table.columns.get_loc("lamps [W/m2]")] = 6553.5
    table.to_csv(folder / "indoor.csv")
    assert np.nanmax(climate_of(folder, lamp_power=110.0).columns["lamps"]) == pytest.approx(100.0)
    table.iloc[7, table.columns.get_loc("lamps [W/m2]")] = 140.0
    table.to_csv(folder / "indoor.csv")
    with pytest.raises(ArchiveError, match="the lamps take up to 140 W/m2, the settings have 110 W/m2"):
        climate_of(folder, lamp_power=110.0)


def test_both_hours_that_the_clock_repeats_have_their_own_weather(tmp_path: Path) -> None:
    folder = own_export(Made(first=dt.date(2020, 10, 24)), tmp_path)
    for name in ("indoor", "weather"):
        path = folder / f"{name}.csv"
        comments = [line for line in path.read_text().splitlines() if line.startswith("#")]
        table = pd.read_csv(path, index_col="time", comment="#")
        cut = list(table.index).index("2020-10-25 03:00:00")
        table = pd.concat([table[:cut], table[cut - 12 : cut], table[cut:]])
        if name == "weather":
            table.iloc[cut : cut + 12, table.columns.get_loc("outdoor_temperature [degC]")] = 20.0
        path.write_text("\n".join([*comments, table.to_csv()]))
    outside = outdoors(read_archive(folder, CLOCK), CLOCK, 410.0, step_seconds=300).of("tOut")
    warm = np.flatnonzero(np.isclose(outside, 20.0))
    assert (warm.size, warm[0]) == (12, 288 + 36)


def test_weather_that_is_never_whole_is_refused_in_words(tmp_path: Path) -> None:
    folder = own_export(Made(), tmp_path)
    table = pd.read_csv(folder / "weather.csv", index_col="time", comment="#")
    table.loc[table.index[::2], "outdoor_humidity [%]"] = np.nan
    table.loc[table.index[1::2], "outdoor_temperature [degC]"] = np.nan
    (folder / "weather.csv").write_text("# latitude: 52.0\n# longitude: 4.5\n" + table.to_csv())
    with pytest.raises(ArchiveError, match=r"weather.csv: none of the 3 days from 2020-02-10 has a row with global_radiation"):
        read_archive(folder, CLOCK)


def test_a_bad_sensor_and_few_days_are_doubts(tmp_path: Path) -> None:
    folder = own_export(Made(), tmp_path)
    table = pd.read_csv(folder / "indoor.csv", index_col="time").drop(columns="co2 [ppm]")
    table.loc[table.index[300:400], "humidity [%]"] = 0.0
    table.to_csv(folder / "indoor.csv")
    sensor, co2, few = climate_of(folder).doubts
    assert sensor == "12% of the readings of humidity were taken out: check the sensor"
    assert "co2 was not measured" in co2
    assert few.startswith("3 whole days are few")
    *_, notes = read_problem(folder, read_page(SHIPPED_PAGE), read_settings(), None)
    assert notes[-3:] == (sensor, co2, few), "the fit tells them, too"


@pytest.mark.parametrize(
    ("name", "before", "after", "words"),
    [
        ("indoor", "humidity [%]", "humidity", r"column 'humidity': its title has no unit. Write one of humidity \[%\], hum"),
        ("indoor", "humidity [%]", "humidity [g/kg]", r"the unit 'g/kg' is unknown"),
        ("indoor", "humidity [%]", "humidty [%]", r"indoor.csv has no values of humidity \[%\] \(relative humidity\), which is needed"),
        ("indoor", "vents_wind [%]", "vents_lee [fraction]", r"there are two columns vents_lee. Keep one"),
        ("indoor", "2020-02-10 00:05:00,", "2020-02-10 00:00:00,", r"row 3, column 'time': '2020-02-10 00:00:00' is not later"),
        ("indoor", "2020-02-10 00:05:00,", "soon,", r"row 3, column 'time': 'soon' is not a time"),
        ("weather", "# latitude: 52.0\n", "", r"weather.csv has no sky_temperature \[degC\]; to estimate it, add '# latitude: 52.0'"),
        ("weather", "# latitude: 52.0", "# latitude: 5200", r"weather.csv: the latitude 5200.0 deg is impossible"),
        ("weather", "wind_speed [m/s]", "wind [m/s]", r"weather.csv has no values of wind_speed \[m/s\]"),
        ("weather", ",80.0,4.0", ",80.0,400.0", r"row 4: wind_speed is 400 m/s, outside 0 to 75. Correct or empty it"),
        ("weather", ",80.0,4.0", ",80.0,much", r"row 4, column 'wind_speed \[m/s\]': 'much' is not a number"),
    ],
)
def test_what_is_wrong_is_said_with_row_column_and_value(tmp_path: Path, name: str, before: str, after: str, words: str) -> None:
    path = own_export(Made(), tmp_path) / f"{name}.csv"
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after, 1))
    with pytest.raises(ArchiveError, match=words):
        climate_of(tmp_path)


def test_steps_and_files_that_cannot_be_read(tmp_path: Path) -> None:
    folder = own_export(Made(), tmp_path)
    table = pd.read_csv(folder / "indoor.csv", index_col="time")
    table[::6].to_csv(folder / "indoor.csv")
    with pytest.raises(ArchiveError, match=r"its step is 30 min. Export means of 1 to 15 min"):
        read_archive(folder, CLOCK)
    table[:1].to_csv(folder / "indoor.csv")
    with pytest.raises(ArchiveError, match=r"it has one row. Export means of 1 to 15 min"):
        read_archive(folder, CLOCK)
    table[:100].to_csv(folder / "indoor.csv")
    with pytest.raises(ArchiveError, match=r"covers no whole day from midnight to midnight"):
        read_archive(folder, CLOCK)
    table.to_csv(folder / "indoor.csv")
    with pytest.raises(ArchiveError, match=r"the lamps take up to 109.935 W/m2, the settings have 90 W/m2"):
        climate_of(folder, lamp_power=90.0)
    (folder / "weather.csv").unlink()
    with pytest.raises(ArchiveError, match=r"has no weather.csv, and indoor.csv no columns of the weather: global_radiation"):
        read_archive(folder, CLOCK)
