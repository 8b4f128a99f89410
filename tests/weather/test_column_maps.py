"""Exports of climate computers: a column map is proposed, and read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.errors import WeatherError
from glbench.outside_tables import stamp_in
from glbench.weather import guess_column_map, load_weather, read_columns, read_weather, write_column_map
from glbench.weather.column_map import guess_quantity
from glbench.weather.store import write_csv

MAP = """
time = ["Datum", "Tijd"]
clock = "Europe/Amsterdam"
[place]
latitude = 52.0
longitude = 4.5
altitude = 0.0
[columns]
air_temperature = { column = "Buiten temp", unit = "°C" }
relative_humidity = { column = "RV", unit = "%" }
wind_speed = { column = "Wind", unit = "km/h" }
global_radiation = { column = "Straling", unit = "W/m2" }
"""


def export(folder: Path, titles: str, rows: list[str], encoding: str = "utf-8") -> Path:
    path = folder / "export.csv"
    path.write_bytes("\r\n".join([titles, *rows, ""]).encode(encoding))
    return path


def half_hours(day: str, values: str, count: int = 48) -> list[str]:
    return [f"{day};{i // 2:02d}:{30 * (i % 2):02d};{values}" for i in range(count)]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1", "utf-16"])
def test_an_export_comes_in_through_its_map(tmp_path: Path, encoding: str) -> None:
    path = export(tmp_path, "Datum;Tijd;Buiten temp;RV;Wind;Straling;Kas °C", half_hours("13-02-2024", "-4,5;91,0;18,0;0,0;20,0"), encoding)
    columns = tmp_path / "map.toml"
    columns.write_text(MAP)
    record = read_weather(path, name="kas", columns=columns)
    assert record.period == "2024-02-12 23:00 to 2024-02-13 23:00 UTC"
    assert record.timezone == "Europe/Amsterdam"
    assert (record.values("air_temperature")[0], record.values("wind_speed")[0]) == (-4.5, 5.0)
    elsewhere = read_weather(path, columns=columns, coordinates=(51.0, 4.0, 2.0), timezone="Etc/GMT-1")
    assert (elsewhere.latitude, elsewhere.altitude, elsewhere.timezone) == (51.0, 2.0, "Etc/GMT-1")
    with pytest.raises(WeatherError, match="A column map says how the file is read: no --format, --year"):
        read_weather(path, columns=columns, year=2015)


@pytest.mark.parametrize(
    ("title", "clock"),
    [
        ("Zeit (UTC)", "UTC"),
        ("Zeit (UTC+1)", "Etc/GMT-1"),
        ("Zeit (Etc/GMT-1)", "Etc/GMT-1"),
        ("Zeit UTC (+1)", "Etc/GMT-1"),
        ("Zeit (UTC-5)", "Etc/GMT+5"),
        ("Zeit (UTC\u22125)", "Etc/GMT+5"),
        ("Zeit (UTC\u20135)", "Etc/GMT+5"),
        ("Zeit (UTC+1/+2)", "Europe/Amsterdam"),
        ("Zeit +/-1 min", "Europe/Amsterdam"),
    ],
)
def test_a_title_may_name_the_clock(tmp_path: Path, title: str, clock: str) -> None:
    rows = [f"2024-02-13 {i // 2:02d}:{30 * (i % 2):02d};3.0;80;2;0" for i in range(48)]
    path = export(tmp_path, f"{title};Temperature out [degC];Humidity out [%];Wind speed [m/s];Radiation [W/m2]", rows)
    assert guess_column_map(path)[0].clock == clock


@pytest.mark.parametrize(("unit", "sums"), [("J/cm2", (6.0, 3.0)), ("W/m2", (100.0, 100.0))])
def test_sums_over_rows_of_different_length_are_refused(tmp_path: Path, unit: str, sums: tuple[float, float]) -> None:
    rows = [f"2024-02-13 {i // 6:02d}:{i % 6 * 10:02d};3.0;80;2;{sums[0]}" for i in range(72)]
    rows += [f"2024-02-13 {12 + i // 12:02d}:{i % 12 * 5:02d};3.0;80;2;{sums[1]}" for i in range(36)]
    path = export(tmp_path, f"time (UTC);Temperature out [degC];Humidity out [%];Wind speed [m/s];Radiation [{unit}]", rows)
    columns = guess_column_map(path)[0]
    if unit == "W/m2":
        assert read_columns(path, columns, coordinates=(52.0, 4.4, 0.0)).period.startswith("2024-02-13 00:00")
        return
    with pytest.raises(WeatherError, match=r"row 75.*its step changes: most rows are 10 min apart, .*, and radiation is a sum over each"):
        read_columns(path, columns, coordinates=(52.0, 4.4, 0.0))


@pytest.mark.parametrize(
    "titles",
    [
        "Wetterstation Temp;Wetterstation Feuchte;Wetterstation Wind;Wetterstation Strahlung;Abt. 1 Temp;Abt. 1 Feuchte",
        "Outside temperature;Outside humidity;Outside wind speed;Outside radiation;Temp. Gew\u00e4chshaus;Humedad invernadero",
        "Temp. ambiente;Humedad relativa;Viento;Radiaci\u00f3n global;Temp. invernadero;Humedad invernadero",
        "Temperatur;Luftfeuchtigkeit;Windgeschwindigkeit;Globalstrahlung;Temp. Haus;Feuchte Haus",
    ],
)
def test_titles_of_other_countries_are_those_outside(tmp_path: Path, titles: str) -> None:
    units = ("\u00b0C", "%", "m/s", "W/m2", "\u00b0C", "%")
    named = [f"{title} [{unit}]" for title, unit in zip(titles.split(";"), units, strict=True)]
    rows = [f"2024-02-13 {i // 2:02d}:{30 * (i % 2):02d};3.0;80;2;0;20;70" for i in range(48)]
    columns = guess_column_map(export(tmp_path, ";".join(["Datum", *named]), rows))[0].columns
    assert [columns[one].column for one in ("air_temperature", "relative_humidity", "wind_speed", "global_radiation")] == named[:4]


def test_the_clock_goes_back_and_forward(tmp_path: Path) -> None:
    columns = tmp_path / "map.toml"
    columns.write_text(MAP)
    titles, values = "Datum;Tijd;Buiten temp;RV;Wind;Straling", "10,0;90,0;18,0;0,0"
    autumn = [f"27-10-2024;{hour:02d}:00;{values}" for hour in (0, 1, 2, 2, 3, 4)]
    record = read_columns(export(tmp_path, titles, autumn), columns)
    assert record.period == "2024-10-26 22:00 to 2024-10-27 04:00 UTC"
    spring = [f"31-03-2024;{hour:02d}:00;{values}" for hour in (0, 1, 3, 4)]
    assert read_columns(export(tmp_path, titles, spring), columns).period == "2024-03-30 23:00 to 2024-03-31 03:00 UTC"
    winter_time = [f"31-03-2024;{hour:02d}:00;{values}" for hour in (0, 1, 2, 3)]
    with pytest.raises(WeatherError, match=r"row 4, column 'Datum': 2024-03-31 02:00 does not exist on the clock of Europe/Amsterdam"):
        read_columns(export(tmp_path, titles, winter_time), columns)


def test_sums_of_radiation_over_the_interval_and_over_the_day(tmp_path: Path) -> None:
    rows = [f"2024-06-01 {hour:02d}:00,15,80,2,{36 * hour}" for hour in range(12)]
    path = export(tmp_path, "stamp,temp,rh,wind,radiation sum [J/cm2]", rows)
    columns, _, _ = guess_column_map(path)
    assert columns.columns["global_radiation"].total == "day"
    running = read_columns(path, columns, coordinates=(52.0, 5.0, 0.0))
    assert running.period == "2024-05-31 23:00 to 2024-06-01 10:00 UTC"
    np.testing.assert_allclose(running.values("global_radiation"), 100.0)
    entry = columns.columns["global_radiation"].model_copy(update={"total": "interval"})
    of_interval = columns.model_copy(update={"columns": {**columns.columns, "global_radiation": entry}})
    np.testing.assert_allclose(
        read_columns(path, of_interval, coordinates=(52.0, 5.0, 0.0)).values("global_radiation"), 100.0 * np.arange(12)
    )


def test_a_running_sum_over_missing_rows_counts_no_energy_twice(tmp_path: Path) -> None:
    # 100 W/m2 all the time: 3 J/cm2 in 5 minutes. Rows 130 to 136 and the sum of row 150 are missing.
    sums = [3 * (i + 1) for i in range(288)]
    rows = [
        f"2024-06-0{day} {i // 12:02d}:{5 * (i % 12):02d},15,80,2,{'---' if i == 150 else sums[i]}"
        for day in (1, 2)
        for i in range(288)
        if not 130 <= i <= 136
    ]
    path = export(tmp_path, "stamp (UTC),outside temp,outside rh,wind,radiation [J/cm2]", rows)
    columns, _, _ = guess_column_map(path)
    assert (columns.columns["global_radiation"].total, columns.clock) == ("day", "UTC")
    running = read_columns(path, columns, coordinates=(52.0, 5.0, 0.0), fill_gaps=2)
    np.testing.assert_allclose(running.values("global_radiation"), 100.0)


def test_what_a_running_sum_gains_over_blank_fields_is_spread_over_them(tmp_path: Path) -> None:
    radiation = np.array([0, 0, 0, 0, 50, 100, 200, 300, 400, 500, 600, 700])
    sums = np.cumsum(radiation * 0.36)
    rows = [f"2024-06-01 {hour:02d}:00,15,80,2,{'' if hour in (7, 8) else f'{sums[hour]:.2f}'}" for hour in range(12)]
    path = export(tmp_path, "stamp (UTC),outside temp,outside rh,wind,radiation sum [J/cm2]", rows)
    columns, _, _ = guess_column_map(path)
    read = read_columns(path, columns, coordinates=(52.0, 5.0, 0.0)).values("global_radiation")
    np.testing.assert_allclose(read, [0, 0, 0, 50, 100, 200, 400, 400, 400, 600, 700])


def test_the_newest_row_may_be_on_top_also_when_the_clock_goes_back(tmp_path: Path) -> None:
    hours = [(31, hour) for hour in (0, 1, 2, 2, 3, *range(4, 24))]
    rows = [f"{day}-10-2010;{hour:02d}:00;{10 + i},5;80;2;0" for i, (day, hour) in enumerate(hours)]
    titles = "Datum;Tijd;Buitentemp [°C];RV buiten [%];Wind [m/s];Straling [W/m2]"
    oldest = export(tmp_path, titles, rows)
    columns, _, _ = guess_column_map(oldest)
    expected = read_columns(oldest, columns, coordinates=(52.0, 5.0, 0.0))
    with pytest.raises(WeatherError, match="twice in autumn, the clock of the stamps is one with summer time"):
        read_columns(oldest, columns.model_copy(update={"clock": "Etc/GMT-1"}), coordinates=(52.0, 5.0, 0.0))
    newest = export(tmp_path, titles, [*rows[::-1], "Gemiddeld;;22,5;80;2;0"])
    record = read_columns(newest, columns, coordinates=(52.0, 5.0, 0.0))
    assert (record.hours, record.digest) == (25, expected.digest)
    assert "the newest row is on top: read from the last row to the first" in record.notes
    assert any("row 27 below the values is left out: 'Gemiddeld 22,5" in note for note in record.notes)


@pytest.mark.parametrize(
    ("titles", "values", "expected"),
    [
        # units without brackets, a rate in J/cm2 an hour, the inside first
        ("Meteo temp °C;Kas RV %;Meteo RV %;Meteo wind km/h;Straling J/cm2/uur", "5;80;90;18;36", (5.0, 90.0, 5.0, 100.0)),
        # the position of windows is no wind, whatever its place
        ("T bui °C;RV buiten %;Raamstand windzijde %;Wind m/s;Straling W/m2", "5;90;40;5;100", (5.0, 90.0, 5.0, 100.0)),
        ("Temp buiten K;RV buiten;Wind [%];Windsnelheid [m/s];Straling W/m2", "278,15;90;40;5;100", (5.0, 90.0, 5.0, 100.0)),
        # groups above the titles
        (";;Afd 1;;Meteo;;;\nDatum;Tijd;Temp;RV;Temp;RV;Wind;Straling", "20;80;5;90;5;100", (5.0, 90.0, 5.0, 100.0)),
    ],
)  # fmt: skip
def test_a_column_is_taken_with_its_unit_and_from_outside(tmp_path: Path, titles: str, values: str, expected: tuple[float, ...]) -> None:
    titles = titles if "\n" in titles else f"Datum;Tijd;{titles}"
    path = export(tmp_path, titles, half_hours("13-02-2024", values))
    columns, _, _ = guess_column_map(path)
    record = read_columns(path, columns, coordinates=(52.0, 4.5, 0.0))
    first = [record.values(name)[0] for name in ("air_temperature", "relative_humidity", "wind_speed", "global_radiation")]
    np.testing.assert_allclose(first, expected)


@pytest.mark.parametrize("title", ["T_out [degC]", "T_air", "T out [degC]", "T.out", "t_buiten", "Tout", "Tair", "Buitentemp [°C]"])
def test_a_temperature_is_recognised_however_its_title_is_cut(title: str) -> None:
    assert guess_quantity(title) == "air_temperature"
    assert guess_quantity("T_in_out_set") is None


def test_titles_that_do_not_say_outside_are_to_be_checked(tmp_path: Path) -> None:
    path = export(tmp_path, "Datum;Tijd;Temperatuur [°C];RV [%];Wind [m/s];Straling [W/m2]", half_hours("13-02-2024", "20,5;80;2;0"))
    _, checks, _ = guess_column_map(path)
    asked = "is it measured outside, not in the greenhouse?"
    assert checks == {"air_temperature": asked, "relative_humidity": asked}


@pytest.mark.parametrize(
    ("stamp", "begin"),
    [
        (lambda hour: f"13-02-2024;{hour + 1}", "2024-02-12 23:00"),
        (lambda hour: f"13-02-2024;{hour + 1:02d}:00", "2024-02-12 23:00"),
        (lambda hour: f"13-feb-24;{hour}:00", "2024-02-12 23:00"),
        (lambda hour: f"13 februari 2024;{hour}:00", "2024-02-12 23:00"),
        (lambda hour: f"13-02-2024;{hour:02d}00", "2024-02-12 23:00"),
    ],
)
def test_hours_may_be_numbered_or_end_at_24_and_months_be_words(tmp_path: Path, stamp: Callable[[int], str], begin: str) -> None:
    rows = [f"{stamp(hour)};{hour};90;2;0" for hour in range(24)]
    path = export(tmp_path, "Datum;Uur;Buitentemp [°C];RV buiten [%];Wind [m/s];Straling [W/m2]", rows)
    columns, _, _ = guess_column_map(path)
    record = read_columns(path, columns, coordinates=(52.0, 4.5, 0.0))
    assert record.period == f"{begin} to 2024-02-13 23:00 UTC"
    np.testing.assert_allclose(record.values("air_temperature"), np.arange(24.0))


@pytest.mark.parametrize("month", ["ene", "enero", "1-ene-24 00:00", "ENE", "1. Mrz 2024 0:00"])
def test_months_in_words_of_more_languages(month: str) -> None:
    match = stamp_in(month if "24" in month else f"1 {month} 2024")
    assert match is not None
    assert match["date"] == ("2024-3-1" if "Mrz" in month else "2024-1-1")


def test_hours_of_a_spanish_export_are_numbered(tmp_path: Path) -> None:
    rows = [f"13/02/2024;{hour + 1};{hour};90;2;0" for hour in range(24)]
    path = export(tmp_path, "Fecha;Hora;Temp exterior [°C];HR exterior [%];Viento [m/s];Radiación exterior [W/m2]", rows)
    columns, _, _ = guess_column_map(path)
    assert columns.time == ("Fecha", "Hora")
    np.testing.assert_allclose(read_columns(path, columns, coordinates=(37.0, -2.4, 150.0)).values("air_temperature"), np.arange(24.0))


@pytest.mark.parametrize("quote", ['"', ""])
def test_the_file_of_a_campbell_logger_has_units_below_its_titles_and_what_is_averaged_below_them(tmp_path: Path, quote: str) -> None:
    def line(*fields: str) -> str:
        return ",".join(f"{quote}{field}{quote}" for field in fields)

    names = line("TIMESTAMP", "RECORD", "AirTC_Avg", "RH", "SlrW_Avg", "WS_ms_Avg")
    above = [names, line("TS", "RN", "Deg C", "%", "W/m^2", "meters/second"), line("", "", "Avg", "Smp", "Avg", "Avg")]
    rows = [f"{line(f'2024-02-13 {hour:02d}:00:00')},{hour},{hour},90,100,5" for hour in range(24)]
    path = export(tmp_path, line("TOA5", "Kas1", "CR1000X", "1234", "CR1000X.Std.03.02", "CPU:kas.CR1X", "4711", "Hour"), [*above, *rows])
    columns, _, unused = guess_column_map(path)
    assert (columns.stamps, unused) == ("end", ["RECORD [RN]"])
    record = read_columns(path, columns, coordinates=(52.0, 4.5, 0.0))
    assert record.period == "2024-02-12 22:00 to 2024-02-13 22:00 UTC"
    np.testing.assert_allclose(record.values("air_temperature"), np.arange(24.0))
    np.testing.assert_allclose([record.values(name)[5] for name in ("global_radiation", "wind_speed")], [100.0, 5.0])
    kept = path.read_text().splitlines()
    path.write_text("\n".join(kept[:3] + kept[4:]))  # somebody deleted the line of what is averaged: no row of values goes with it
    np.testing.assert_array_equal(read_columns(path, columns, coordinates=(52.0, 4.5, 0.0)).values("air_temperature"), np.arange(24.0))


def test_errors_in_cells_are_missing_values(tmp_path: Path) -> None:
    rows = half_hours("13-02-2024", "5,0;90;2;0")
    for i, text in ((3, "#####"), (8, "---"), (13, "#DIV/0!"), (18, "Fout"), (22, "***")):
        rows[i] = rows[i].replace("5,0", text)
    path = export(tmp_path, "Datum;Tijd;Buitentemp [°C];RV buiten [%];Wind [m/s];Straling [W/m2]", rows)
    columns, _, _ = guess_column_map(path)
    record = read_columns(path, columns, coordinates=(52.0, 4.5, 0.0))
    np.testing.assert_allclose(record.values("air_temperature"), 5.0)
    assert any(note.startswith("5 h are means of an hour with missing rows") for note in record.notes)


def test_a_map_is_proposed_written_and_read_again(tmp_path: Path) -> None:
    titles = "Datum;Tijd;Temp kas [°C];Buitentemp [°C];RV kas [%];RV buiten;Windrichting;Windsnelheid [km/h];Straling [W/m²];CO2 [ppm]"
    path = export(tmp_path, titles, half_hours("13-02-2024", "20,5;-4,5;80,0;91,0;220;18,0;0,0;800"))
    columns, checks, unused = guess_column_map(path)
    assert columns.time == ("Datum", "Tijd")
    assert (columns.dates, columns.decimal) == ("day first", ",")
    assert {name: (entry.column, entry.unit) for name, entry in columns.columns.items()} == {
        "air_temperature": ("Buitentemp [°C]", "degC"),
        "relative_humidity": ("RV buiten", "%"),
        "wind_speed": ("Windsnelheid [km/h]", "km/h"),
        "global_radiation": ("Straling [W/m²]", "W/m2"),
    }
    assert checks == {"relative_humidity": "the title has no unit"}
    assert unused == ["Temp kas [°C]", "RV kas [%]", "Windrichting", "CO2 [ppm]"]
    written = tmp_path / "map.toml"
    write_column_map(columns, checks, unused, path, written)
    record = read_columns(path, written, coordinates=(52.0, 4.5, 0.0))
    assert (record.hours, record.values("wind_speed")[0]) == (24, 5.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('unit = "km/h"', 'unit = "bft"'), "wind_speed cannot come in 'bft'. Use one of m/s, km/h, mph, kn"),
        (("wind_speed =", "windspeed ="), "there is no quantity 'windspeed'. Did you mean 'wind_speed'"),
        (('column = "RV"', 'column = "RH"'), "there is no column 'RH'. Known: "),
        (("altitude = 0.0\n", ""), "place.altitude' is missing"),
        (("[place]\nlatitude = 52.0\nlongitude = 4.5\naltitude = 0.0\n", ""), "--place LAT,LON,ALT"),
        (("Europe/Amsterdam", "Europe/Amsterdm"), "'Europe/Amsterdm' is no time zone"),
        (('time = ["Datum", "Tijd"]', 'time = "Tijd"'), "'00:00' is not a time such as"),
        (("relative_humidity = {", "# relative_humidity = {"), "no column is named for relative_humidity"),
    ],
)
def test_maps_that_do_not_fit_are_refused_in_words(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    path = export(tmp_path, "Datum;Tijd;Buiten temp;RV;Wind;Straling", half_hours("13-02-2024", "-4,5;91,0;18,0;0,0"))
    columns = tmp_path / "map.toml"
    columns.write_text(MAP.replace(*change))
    with pytest.raises(WeatherError) as error:
        read_columns(path, columns)
    assert words in str(error.value)


def test_a_table_without_a_needed_column_is_refused_with_its_titles(tmp_path: Path) -> None:
    path = export(tmp_path, "Datum;Tijd;Buiten temp;RV", half_hours("13-02-2024", "-4,5;91,0"))
    with pytest.raises(WeatherError, match=r"no column looks like wind_speed .m/s., global_radiation .W/m2.. Its columns are: Datum, Tijd"):
        guess_column_map(path)


def test_the_commands_of_a_column_map_and_the_export(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))
    path = export(tmp_path, "Datum;Tijd;Buiten temp;RV;Wind;Straling", half_hours("13-02-2024", "-4,5;91,0;3,0;0,0"))
    run = CliRunner().invoke
    proposed = run(app, ["weather", "columns", str(path)])
    assert proposed.exit_code == 0, proposed.output
    again = run(app, ["weather", "columns", str(path)])
    assert again.exit_code != 0
    arguments = ["weather", "import", str(path), "--name", "kas", "--columns", str(tmp_path / "export.columns.toml")]
    for place in ("52,north", "52.0,4.5"):  # an altitude that is left out would be taken for 0 m, even if the file has one
        assert run(app, [*arguments, "--place", place]).exit_code != 0
    outcome = run(app, [*arguments, "--place", "52.0,4.5,-4"])
    assert outcome.exit_code == 0, outcome.output
    assert "Note: rows of 30 min averaged to hours; 24 h" in outcome.output
    exported = tmp_path / "kas.csv"
    assert run(app, ["weather", "export", "kas", "-o", str(exported)]).exit_code == 0
    assert read_weather(exported).digest == load_weather("kas").digest


@pytest.mark.parametrize("name", ["miami", "schiphol"])
def test_an_exported_record_is_read_again_with_its_digest_notes_and_mark_of_a_typical_year(tmp_path: Path, name: str) -> None:
    record = load_weather(name)
    write_csv(record, tmp_path / "exported.csv")
    again = read_weather(tmp_path / "exported.csv")
    assert (again.digest, again.notes, again.typical_year) == (record.digest, record.notes, record.typical_year)
    assert record.typical_year == (name == "miami")
    assert record.notes or name == "schiphol"


def test_the_mark_of_a_typical_year_is_yes_or_no(tmp_path: Path) -> None:
    write_csv(load_weather("miami"), tmp_path / "miami.csv")
    text = (tmp_path / "miami.csv").read_text(encoding="utf-8")
    (tmp_path / "miami.csv").write_text(text.replace("# typical year: yes", "# typical year: maybe"), encoding="utf-8")
    with pytest.raises(WeatherError, match=r"'# typical year: maybe' must be yes .* or no"):
        read_weather(tmp_path / "miami.csv")
