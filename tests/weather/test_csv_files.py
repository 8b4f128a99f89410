"""The documented CSV: units, times, comments, and what is refused."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.weather import disturbances, read_csv
from tests.weather.files import CSV_COMMENTS, CSV_HEADER, csv_rows, csv_text


def csv_file(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text)
    return path


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
        (csv_text([]), "has titles but no values"),
        (csv_text(csv_rows(2), header=CSV_HEADER.replace("air_", "air")), r"unknown column 'airtemperature \[degC\]'. Did you mean"),
        (csv_text(csv_rows(2), header=CSV_HEADER.replace("[degC]", "[R]")), r"unknown column 'air_temperature \[R\]'"),
        (csv_text(csv_rows(2), header=CSV_HEADER.replace("slot_end [UTC]", "cloud_cover [tenths]")), "two columns for cloud_cover"),
        (csv_text(["2020-06-01T01:00,20"]), "2 fields instead of 6"),
        (csv_text(["yesterday,20,70,5,0,4"]), "row 9, column 'slot_end .UTC.': 'yesterday' is not a time such as"),
        (csv_text(["2020-06-01T01:00,20,wet,5,0,4"]), r"row 9, column 'relative_humidity \[%\]': 'wet' is not a number"),
        (csv_text(["2020-06-01T01:00,inf,70,5,0,4"]), "row 9, column 'air_temperature .degC.': 'inf' is not a number"),
        (csv_text(["2020-06-01T01:00,,70,5,0,4"]), "row 9: no value for air temperature"),
        (csv_text(["2020-06-01T01:00,20,70,5,-30,4"]), "row 9: global radiation of -30 W/m2 .* is impossible"),
        (csv_text(["2020-06-01T01:02,20,70,5,0,4"]), "covers no whole hour"),
        (csv_text([*csv_rows(1), "2020-06-01T03:00Z,20,70,5,0,4"]), "its rows are 2 h apart"),
        (csv_text([*csv_rows(2), *csv_rows(1)]), "row 11: the interval ending 2020-06-01 01:00 UTC follows 2020-06-01 02:00 UTC"),
        (csv_text([*csv_rows(1), "2020-06-01T02:00,20,70,5,0,4"]), "row 10.*lacks an offset from UTC"),
        (csv_text(csv_rows(2), comments=CSV_COMMENTS[1:4]), "do not give timezone"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timezon: UTC")), "unknown comment '# timezon: ...'. Did you mean 'timezone'"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# latitude: north,,")), "'north' for latitude is not a number"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# latitude: 152")), "latitude 152.0 deg is impossible"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# altitude: 9500")), "altitude 9500.0 m is impossible"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timezone: Mars/Crater")), "'Mars/Crater' is no time zone"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timing wind_speed: gusts")), "must be instant .* or mean"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timing global_radiation: instant")), "radiation must be a mean"),
        (csv_text(csv_rows(2), comments=(*CSV_COMMENTS, "# timing air_temperature: mean")), "both be instants or both be means"),
    ],
)
def test_csv_files_are_refused_in_words(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(WeatherError, match=rf"(table\.csv.*)?{words}"):
        read_csv(csv_file(tmp_path, text))


def test_a_place_may_have_decimal_commas_and_thousands(tmp_path: Path) -> None:
    comments = (*CSV_COMMENTS, "# latitude: 52,012,,,,,", "# altitude: 1,600")
    place = read_csv(csv_file(tmp_path, csv_text(csv_rows(2), comments=comments))).place
    assert (place.latitude, place.altitude) == (52.012, 1600.0)


@pytest.mark.parametrize(("gone", "words"), [("wind_speed [m/s]", r"missing: wind_speed \[m/s\]"), ("slot_end [UTC]", "no time column")])
def test_a_csv_without_a_needed_column_is_refused(tmp_path: Path, gone: str, words: str) -> None:
    titles = CSV_HEADER.split(",")
    keep = [i for i, title in enumerate(titles) if title != gone]
    rows = [",".join(row.split(",")[i] for i in keep) for row in csv_rows(2)]
    with pytest.raises(WeatherError, match=words):
        read_csv(csv_file(tmp_path, csv_text(rows, header=",".join(titles[i] for i in keep))))
