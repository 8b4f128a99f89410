"""``glbench weather``: what a person sees, and what a script reads."""

from __future__ import annotations

import datetime as dt
import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from glbench.cli.console import messages, output
from glbench.cli.weather import app, description
from glbench.errors import GlbenchError, UnknownNameError, WeatherError
from glbench.model import PARAMETER_NAMES, default_parameters
from glbench.weather import SeasonGenerator, load_weather, read_weather
from glbench.weather.record import LONGEST_FILL
from glbench.weather.summary import PHOTONS_PER_JOULE, monthly
from tests.weather.files import csv_rows, csv_text, knmi_days, knmi_line, knmi_text, write_epw


@pytest.fixture(autouse=True)
def _own_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("GLBENCH_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("GLBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("COLUMNS", "160")
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.delenv("GLBENCH_KNMI_URL", raising=False)
    # The consoles are made once a process; each test brings its own standard output.
    for console in (output, messages):
        console.cache_clear()
    yield
    for console in (output, messages):
        console.cache_clear()


def run(*arguments: str | Path) -> str:
    """Standard output of a command that succeeds."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def refused(*arguments: str | Path) -> str:
    """Message of a command that fails with one of our errors."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert isinstance(result.exception, GlbenchError), result.output
    return str(result.exception)


def test_list_shows_the_shipped_record_with_its_period() -> None:
    shown = run("list")
    for words in ("schiphol", "Amsterdam Schiphol", "2008-01-01 to 2013-01-01", "43,848", "shipped", "[UTC]", "[h]"):
        assert words in shown


def test_list_as_json_is_whole() -> None:
    records = json.loads(run("list", "--json"))["records"]
    assert [one["name"] for one in records] == ["greensboro", "miami", "sand_point", "schiphol"]
    assert [one["typical_year"] for one in records] == [True, True, True, False]
    record = records[-1]
    assert record["digest"] == load_weather("schiphol").digest
    assert (record["latitude_deg"], record["longitude_deg"], record["altitude_m"]) == (52.318, 4.79, -3.3)
    assert (record["first"], record["last"], record["hours"]) == ("2008-01-01T00:00:00+00:00", "2013-01-01T00:00:00+00:00", 43848)
    assert "acknowledged" in record["licence"]


def test_show_gives_period_licence_digest_and_monthly_figures_with_units() -> None:
    shown = run("show", "schiphol", "--month", "2010-03")
    for words in (
        "2008-01-01 00:00 to 2013-01-01 00:00 UTC",
        "Royal Netherlands Meteorological Institute",
        load_weather("schiphol").digest,
        "52.318 deg N, 4.790 deg E, -3.3 m",
        "UTC; the local clock (Europe/Amsterdam) is 1 h or 2 h ahead, with summer time",
    ):
        assert words in shown
    for unit in ("[degC]", "[%]", "[m/s]", "[MJ/m2]", "[octants]", "[kPa]", "[mol/m2/d]"):
        assert unit in shown
    # KNMI's own sums for March 2010: 27,722 J cm-2 and 5.16 m/s.
    assert "277.22" in shown
    assert "5.16" in shown


def test_a_month_that_is_not_there_is_answered_with_one_that_is() -> None:
    with pytest.raises(WeatherError, match=r"has no month '2007-03'. Use a month such as 2008-01\."):
        monthly(load_weather("schiphol"), "2007-03")


def test_show_lists_every_month() -> None:
    shown = run("show", "schiphol")
    assert all(f"{year}-{month:02d}" in shown for year in range(2008, 2013) for month in range(1, 13))


def test_show_as_json_has_a_unit_for_every_number() -> None:
    described = json.loads(run("show", "schiphol", "--month", "3", "--json"))
    assert [month["month"] for month in described["months"]] == [f"{year}-03" for year in range(2008, 2013)]
    march = described["months"][2]
    assert march["radiation_sum"] == pytest.approx(277.22, abs=1e-9)
    assert march["wind_speed_mean"] == pytest.approx(5.16, abs=0.005)
    assert march["hours"] == 744
    # 277.22 MJ m-2 in 31 days, 2.3 umol of photons a joule, as in the model.
    assert march["daily_light_integral_mean"] == pytest.approx(2.3 * 277.22 / 31, rel=1e-9)
    nominal = dict(zip(PARAMETER_NAMES, default_parameters("benchmark"), strict=True))
    assert nominal["etaGlobPar"] * nominal["parJtoUmolSun"] == PHOTONS_PER_JOULE
    numbers = {key for key, value in march.items() if isinstance(value, int | float)}
    assert numbers <= set(described["units"])


def test_the_deficit_of_a_month_is_the_mean_of_its_hours(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(csv_text(["2020-06-01T01:00,20,50,5,0,4", "2020-06-01T02:00,30,100,5,0,4"]))
    run("import", path, "--name", "two")
    # 20 degC at 50 %: half of 2.326 kPa; 30 degC at 100 %: nothing.
    assert monthly(load_weather("two"))[0].vapour_pressure_deficit_mean == pytest.approx(0.5 * 0.5 * 2.326, abs=5e-4)


def test_the_months_fit_a_terminal_of_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    table = run("show", "schiphol", "--month", "2010-03").partition("Months (UTC)")[2]
    assert "…" not in table
    assert all(figure in table for figure in ("2010-03", "277.22", "0.20", "20.6", "[mol/m2/d]", "[octants]"))


def test_show_of_an_unknown_record_points_to_the_nearest() -> None:
    assert "Did you mean 'schiphol'" in refused("show", "schipol")


@pytest.mark.parametrize("month", ["13", "0", "2013-01", "March"])
def test_show_of_a_month_that_is_not_there_is_refused(month: str) -> None:
    assert f"no month '{month}'" in refused("show", "schiphol", "--month", month)


def test_a_csv_is_imported_under_a_name(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(csv_text(csv_rows(48)))
    shown = run("import", path, "--name", "veld")
    assert "Weather 'veld': 2020-06-01 00:00 to 2020-06-03 00:00 UTC, 48 h" in shown
    assert load_weather("veld").station == "Testveld"
    assert "veld" in run("list")
    assert "CC0" in run("show", "veld")


def test_an_import_prints_what_a_person_can_check_and_warns_of_a_wrong_clock(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(csv_text(csv_rows(240)))
    right = CliRunner().invoke(app, ["import", str(path), "--name", "right"], catch_exceptions=False)
    assert "lowest 15.5 degC, mean 15.5 degC, highest 15.5 degC" in right.stdout
    assert "1152 J/cm2" in right.stdout
    assert "mean 3.2 m/s" in right.stdout
    assert "sun at night" not in right.output
    assert "usable, but" in right.output  # its values never change
    path.write_text(csv_text(csv_rows(240, dt.datetime(2020, 6, 1, 9))))
    path.write_text(path.read_text().replace("# longitude: 5.0", "# longitude: -100"))
    wrong = CliRunner().invoke(app, ["import", str(path), "--name", "wrong"], catch_exceptions=False)
    assert "Warning: sun at night in" in " ".join(wrong.stderr.split())
    assert load_weather("wrong").hours == 240


def test_an_epw_is_imported_with_its_zone_and_year(tmp_path: Path) -> None:
    path = write_epw(tmp_path / "typical.epw", {month: 1990 + month for month in range(1, 13)})
    shown = run("import", path, "--name", "epw", "--timezone", "Europe/Amsterdam", "--year", "2014")
    assert "Note: typical year" in shown
    assert load_weather("epw").timezone == "Europe/Amsterdam"
    assert load_weather("epw").first == dt.datetime(2014, 1, 1, tzinfo=dt.UTC)
    assert "yours, typical year" in run("list")
    assert "infrared" in run("show", "epw")


def test_a_gap_is_filled_only_when_asked(tmp_path: Path) -> None:
    rows = knmi_days(dt.date(2019, 6, 1), 2)
    rows[30] = knmi_line(dt.date(2019, 6, 2), 7, {"T": ""})
    path = tmp_path / "knmi.txt"
    path.write_text(knmi_text(rows))
    assert "--fill-gaps" in refused("import", path, "--name", "june")
    assert "air_temperature: 1 h filled linearly" in run("import", path, "--name", "june", "--fill-gaps", "1")
    assert "air_temperature: 1 h filled linearly" in run("show", "june")


def test_an_import_that_fails_keeps_nothing(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(csv_text([*csv_rows(5), "2020-06-01T06:00Z,99,70,3,0,6"]))
    assert "air temperature of 99 degC" in refused("import", path, "--name", "veld")
    assert list((tmp_path / "data").rglob("*")) == []


def test_a_record_is_replaced_only_when_asked(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(csv_text(csv_rows(24)))
    run("import", path, "--name", "veld")
    path.write_text(csv_text(csv_rows(48)))
    assert "already" in refused("import", path, "--name", "veld")
    assert load_weather("veld").hours == 24
    run("import", path, "--name", "veld", "--replace")
    assert load_weather("veld").hours == 48


def test_an_unknown_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text(csv_text(csv_rows(24)))
    assert "Did you mean 'csv'" in refused("import", path, "--name", "veld", "--format", "csw")


@pytest.fixture
def service() -> Iterator[str]:
    """Address of a loopback service that has station 240 in 2013 and is out of order for any other."""
    year = knmi_text(knmi_days(dt.date(2013, 1, 1), 365)).encode()

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            form = self.rfile.read(int(self.headers["Content-Length"]))
            body = year if b"stns=240" in form else b"<html>Storing</html>"
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            return

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/uurgegevens"
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_year_is_fetched_and_listed(service: str) -> None:
    shown = run("fetch", "--station", "240", "--year", "2013", "--url", service)
    assert "Weather 'knmi-240-2013': 2013-01-01 00:00 to 2014-01-01 00:00 UTC, 8,760 h" in shown
    assert load_weather("knmi-240-2013").hours == 8760
    names = [record["name"] for record in json.loads(run("list", "--json"))["records"]]
    assert names[-2:] == ["schiphol", "knmi-240-2013"]


def test_the_service_can_be_named_in_the_environment(service: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLBENCH_KNMI_URL", service)
    run("fetch", "--station", "240", "--year", "2013", "--name", "next")
    assert load_weather("next").hours == 8760


def test_a_fetch_that_fails_keeps_nothing(service: str, tmp_path: Path) -> None:
    assert "out of order" in refused("fetch", "--station", "260", "--year", "2013", "--url", service)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_taken_name_is_refused_before_anything_is_fetched() -> None:
    with pytest.raises(WeatherError, match="shipped weather record"):
        CliRunner().invoke(
            app,
            ["fetch", "--station", "240", "--year", "2013", "--name", "schiphol", "--url", "http://127.0.0.1:9/"],
            catch_exceptions=False,
        )


def test_errors_are_ours_so_that_the_command_line_can_say_them() -> None:
    result = CliRunner().invoke(app, ["show", "nowhere"])
    assert isinstance(result.exception, UnknownNameError)


def test_a_gap_too_long_to_fill_is_not_advised_to_be_filled(tmp_path: Path) -> None:
    rows = knmi_days(dt.date(2019, 6, 1), 5)
    path = tmp_path / "knmi.txt"
    path.write_text(knmi_text(rows[:20] + rows[80:]))
    said = refused("import", path, "--name", "june")
    assert "60 h are missing" in said
    assert "more than the 48 h in a row that --fill-gaps may fill" in said
    assert "--fill-gaps 60" not in said


def test_the_command_takes_what_the_library_fills() -> None:
    assert f"<={LONGEST_FILL}" in " ".join(run("import", "--help").split())


SEASON = ("--years", "2008-2010", "--start", "2010-03-01", "--days", "20")


def test_a_generated_season_is_written_and_can_be_imported(tmp_path: Path) -> None:
    out, picture = tmp_path / "season.parquet", tmp_path / "season.png"
    shown = run("generate", *SEASON, "--seed", 3, "--out", out, "--picture", picture)
    assert "Season of 20 days from 2010-03-01, seed 3: 2010-02-27 00:00 to 2010-03-23 00:00 UTC" in shown
    assert "years 2008, 2009, 2010 of weather 'schiphol'" in shown
    assert picture.read_bytes().startswith(b"\x89PNG")
    run("import", out, "--name", "season-3")
    record = load_weather("season-3")
    generator = SeasonGenerator(load_weather("schiphol"), (2008, 2009, 2010))
    numbers = np.random.default_rng(3).random(generator.numbers(20))
    assert record.digest == generator.season(dt.date(2010, 3, 1), 20, numbers).record.digest
    assert "generated from the years 2008, 2009, 2010 of weather 'schiphol'" in record.source
    assert any("seed 3, 20 days from 2010-03-01" in note for note in record.notes)
    assert "acknowledged" in record.licence


def test_a_seed_names_a_season(tmp_path: Path) -> None:
    files = [tmp_path / f"{name}.parquet" for name in ("one", "same", "other")]
    for file, seed in zip(files, (1, 1, 2), strict=True):
        run("generate", *SEASON, "--seed", seed, "--out", file)
    digests = [read_weather(file).digest for file in files]
    assert digests[0] == digests[1] != digests[2]


def test_a_file_is_not_replaced_unasked_and_nothing_is_written_on_a_mistake(tmp_path: Path) -> None:
    out = tmp_path / "season.parquet"
    assert "The year 2007 is not wholly in" in refused("generate", "--years", "2007", "--out", out)
    assert "'2010-2008' names no years" in refused("generate", "--years", "2010-2008", "--out", out)
    assert "'March' is no date" in refused("generate", "--start", "March", "--out", out)
    assert "should end with .png" in refused("generate", "--out", out, "--picture", tmp_path / "season.jpg")
    assert "no weather record 'shiphol'" in refused("generate", "--source", "shiphol", "--out", out)
    assert "should end with .json" in refused("statistics", "--out", tmp_path), "before the seasons are generated"
    assert not list(tmp_path.glob("season.*"))
    run("generate", *SEASON, "--out", out)
    before = out.read_bytes()
    assert "exists already" in refused("generate", *SEASON, "--seed", 2, "--out", out)
    assert out.read_bytes() == before
    run("generate", *SEASON, "--seed", 2, "--out", out, "--replace")
    assert out.read_bytes() != before


def test_a_damaged_season_is_not_imported(tmp_path: Path) -> None:
    out = tmp_path / "season.parquet"
    run("generate", *SEASON, "--out", out)
    table = pq.ParquetFile(out).read()
    wind = pa.array(np.zeros(table.num_rows, dtype=np.int64))
    pq.write_table(table.set_column(table.column_names.index("wind_speed"), "wind_speed", wind), out)
    assert "its digest should be" in refused("import", out, "--name", "changed")
    assert "takes no --station" in refused("import", out, "--name", "changed", "--station", 240)
    assert "takes no --fill-gaps" in refused("import", out, "--name", "changed", "--fill-gaps", 3)


def test_statistics_are_shown_with_their_limits_and_written(tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    arguments = ("--years", "2008,2010", "--seasons", 24, "--within-days", 5, "--days", 30)
    shown = run("statistics", *arguments, "--out", out)
    for words in ("24 seasons of 30 days generated from 2008, 2010 of schiphol", "at most 0.1", "0.93 to 1.07", "Kolmogorov"):
        assert words in shown
    written = json.loads(out.read_text())
    assert written["years"] == [2008, 2010]
    assert written == json.loads(run("statistics", *arguments, "--json"))
    assert written["accepted"] == ("Every limit is kept." in shown)
    other = json.loads(run("statistics", *arguments, "--shortest", 2, "--longest", 3, "--json"))
    assert other["figures"] != written["figures"]


@pytest.mark.parametrize(("zone", "words"), [("Atlantic/Azores", "1 h or 0 h behind"), ("Europe/Lisbon", "0 h or 1 h ahead")])
def test_the_local_clock_is_behind_or_ahead_of_utc(zone: str, words: str) -> None:
    record = load_weather("schiphol")
    there = replace(record, place=replace(record.place, timezone=zone))
    assert f"({zone}) is {words}, with summer time" in repr(list(description(there)))
