"""Exports of exchanges: clocks, units, missing prices, doubts, and the command that writes a plain file."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from glbench.cli.app import app
from glbench.errors import TaskError
from glbench.tasks import get_task
from glbench.tasks.price_files import PriceFile, doubts_of_prices, read_prices
from glbench.tasks.prices import PriceTable

KWH = "EUR kWh-1"


def prices_of(folder: Path, text: str, *, encoding: str = "utf-8", unit: object = KWH, **how: object) -> PriceFile:
    path = folder / "prices.csv"
    path.write_bytes(text.encode(encoding))
    return read_prices(path, unit, **how)


def utc(prices: PriceFile) -> list[str]:
    return [f"{dt.datetime.fromtimestamp(second, tz=dt.UTC):%m-%d %H:%M}" for second in prices.seconds.tolist()]


def entsoe(day: str, begin_and_end: list[tuple[str, str]]) -> str:
    rows = [f'"{day} {begin} - {day} {end}","{10 * i}.5","EUR",""' for i, (begin, end) in enumerate(begin_and_end, start=1)]
    return "\r\n".join(['"MTU (CET/CEST)","Day-ahead Price [EUR/MWh]","Currency","BZN|NL"', *rows])


def test_an_export_of_entso_e_has_an_hour_twice_in_autumn_and_none_in_spring(tmp_path: Path) -> None:
    autumn = entsoe("31.10.2010", [("01:00", "02:00"), ("02:00", "02:00"), ("02:00", "03:00"), ("03:00", "04:00")])
    prices = prices_of(tmp_path, autumn)
    assert utc(prices) == ["10-30 23:00", "10-31 00:00", "10-31 01:00", "10-31 02:00"]
    np.testing.assert_allclose(prices.prices, [0.0105, 0.0205, 0.0305, 0.0405])
    spring = entsoe("28.03.2010", [("01:00", "03:00"), ("03:00", "04:00")])
    assert utc(prices_of(tmp_path, spring)) == ["03-28 00:00", "03-28 01:00"]
    in_utc = spring.replace("CET/CEST", "UTC").replace("03:00 - 28.03.2010 04", "02:00 - 28.03.2010 03")
    assert utc(prices_of(tmp_path, in_utc)) == ["03-28 01:00", "03-28 02:00"]


def test_times_come_in_two_columns_in_utc_beside_local_and_with_the_newest_on_top(tmp_path: Path) -> None:
    expected = ["10-30 22:00", "10-30 23:00", "10-31 00:00", "10-31 01:00", "10-31 02:00"]
    local = [("31-10-2010", f"{hour:02d}:00") for hour in (0, 1, 2, 2, 3)]
    rows = [f"{day};{hour};{i},125" for i, (day, hour) in enumerate(local)]
    prices = prices_of(tmp_path, "\n".join(["Datum;Tijd;Prijs (ct/kWh)", *rows]), clock="Europe/Amsterdam")
    assert utc(prices) == expected
    np.testing.assert_allclose(prices.prices, [0.00125, 0.01125, 0.02125, 0.03125, 0.04125])
    turned = prices_of(tmp_path, "\n".join(["Datum;Tijd;Prijs (ct/kWh)", *rows[::-1]]), clock="Europe/Amsterdam")
    assert utc(turned) == expected
    np.testing.assert_allclose(turned.prices, prices.prices)
    two_clocks = [f"{day} {hour},2010-{stamp},{i}.5" for i, ((day, hour), stamp) in enumerate(zip(local, expected, strict=True))]
    both = prices_of(tmp_path, "\n".join(["datum_nl,datum_utc,prijs", *two_clocks]), file_unit="EUR/MWh")
    assert (utc(both), both.doubts) == (expected, ())
    names = [f"{day} {hour} {'CET' if i > 2 else 'CEST'},{i}.5" for i, (day, hour) in enumerate(local)]
    assert utc(prices_of(tmp_path, "\n".join(["Tijd,Prijs (EUR/MWh)", *names]))) == expected
    numbers = "\n".join(["Datum;Uur;Prijs (EUR/MWh)", *(f"30-10-2010;{hour};{hour},5" for hour in range(1, 25))])
    numbered = prices_of(tmp_path, numbers, clock="Europe/Amsterdam")
    assert (utc(numbered)[0], utc(numbered)[-1], numbered.prices[0]) == ("10-29 22:00", "10-30 21:00", 0.0015)


def test_names_of_zones_in_the_hour_that_comes_twice_are_understood(tmp_path: Path) -> None:
    autumn = entsoe("31.10.2010", [("01:00", "02:00"), ("02:00 (CEST)", "02:00 (CET)"), ("02:00 (CET)", "03:00"), ("03:00", "04:00")])
    assert utc(prices_of(tmp_path, autumn)) == ["10-30 23:00", "10-31 00:00", "10-31 01:00", "10-31 02:00"]


@pytest.mark.parametrize("above", ["", "# Downloaded 2024-07-01 08:12 UTC\n", "Downloaded 2024-07-01 08:12 UTC;\n"])
def test_the_title_of_the_times_counts_before_what_stands_above(tmp_path: Path, above: str) -> None:
    rows = "".join(f"01.06.2010 {hour:02d}:00;{hour}.5\n" for hour in range(24))
    assert utc(prices_of(tmp_path, f"{above}MTU (CET/CEST);Day-ahead Price [EUR/MWh]\n{rows}"))[0] == "05-31 22:00"
    assert utc(prices_of(tmp_path, f"# on CET\n{above}MTU (UTC);Day-ahead Price [EUR/MWh]\n{rows}"))[0] == "06-01 00:00"
    in_winter_time = prices_of(tmp_path, f"{above}MTU (UTC+1);Day-ahead Price [EUR/MWh]\n{rows}")
    assert (utc(in_winter_time)[0], in_winter_time.doubts) == ("05-31 23:00", ())
    assert "times read as UTC+1 all year, as the titles say" in in_winter_time.notes
    (doubt,) = prices_of(tmp_path, f"{above}MTU;Day-ahead Price [EUR/MWh]\n{rows}").doubts
    assert "its times have no offset" in doubt


@pytest.mark.parametrize("title", ["time;Price [EUR/MWh] +/-5 %", "Accuracy: +/-2 EUR\ntime;Price [EUR/MWh]"])
def test_a_tolerance_is_no_clock(tmp_path: Path, title: str) -> None:
    rows = "".join(f"2010-06-01 {hour:02d}:00;{hour}.5\n" for hour in range(24))
    assert utc(prices_of(tmp_path, f"{title}\n{rows}"))[0] == "06-01 00:00"


def test_a_clock_of_the_zone_base_is_ahead(tmp_path: Path) -> None:
    rows = "".join(f"2010-06-01 {hour:02d}:00;{hour}.5\n" for hour in range(24))
    assert utc(prices_of(tmp_path, f"Zeit (Etc/GMT-1);Preis [EUR/MWh]\n{rows}"))[0] == "05-31 23:00"


def test_stamps_of_digits_alone_are_no_milliseconds(tmp_path: Path) -> None:
    for stamp, hours in (("2010060{day}0000", 24), ("201006010{day}", 1), ("201006010{day}30", 1)):
        rows = "".join(f"{stamp.format(day=day)};{day}.5\n" for day in range(1, 5))
        moments = prices_of(tmp_path, f"Tag (UTC);Gas [EUR/MWh]\n{rows}").seconds
        assert (np.diff(moments) == hours * 3600).all()
        assert str(np.datetime64(int(moments[0]), "s")).startswith("2010-06-01T0")


@pytest.mark.parametrize(
    ("titles", "day", "empty", "expected"),
    [
        (range(1, 26), "2010-10-31", (), range(25)),  # numbered: the 25th is the last
        (range(1, 26), "2010-06-01", (24,), range(24)),
        (range(1, 26), "2010-03-28", (23, 24), range(23)),
        (range(1, 25), "2010-03-28", (23,), range(23)),  # the last is empty, not the third
        (range(1, 25), "2010-03-28", (2,), (0, 1, *range(3, 24))),  # by the clock, as EPEX writes them
        (range(24), "2010-03-28", (2,), (0, 1, *range(3, 24))),
        (range(1, 25), "2010-10-31", (), (0, 1, 2, *range(2, 24))),
    ],
)
def test_hours_in_columns_on_days_of_23_and_25(
    tmp_path: Path, titles: range, day: str, empty: tuple[int, ...], expected: tuple[int, ...] | range
) -> None:
    cells = ["" if place in empty else f"{place}.0" for place in range(len(titles))]
    text = "\n".join([";".join(["Fecha", *(f"H{hour}" for hour in titles)]), ";".join([day, *cells])])
    path = tmp_path / "p.csv"
    path.write_text(text)
    prices = read_prices(path, "EUR MWh-1", clock="Europe/Madrid", file_unit="EUR/MWh")
    assert prices.prices.tolist() == [float(one) for one in expected]
    assert (np.diff(prices.seconds) == 3600).all()
    assert not prices.doubts


@pytest.mark.parametrize(("zone", "place"), [("Europe/London", 1), ("Europe/Madrid", 2), ("Europe/Helsinki", 3)])
def test_the_hour_that_a_clock_skips_or_repeats_is_its_own(tmp_path: Path, zone: str, place: int) -> None:
    path = tmp_path / "p.csv"
    titles, spring = ";".join(["Date", *(f"Hour {hour}" for hour in range(1, 25))]), ["" if i == place else f"{i}.0" for i in range(24)]
    path.write_text("\n".join([titles, ";".join(["2010-03-28", *spring]), ";".join(["2010-10-31", *(f"{i}.0" for i in range(24))])]))
    prices = read_prices(path, "EUR MWh-1", clock=zone, file_unit="EUR/MWh")
    assert prices.prices.tolist()[:23] == [float(i) for i in range(24) if i != place]
    assert prices.prices.tolist()[23:] == [float(i) for i in sorted([*range(24), place])]


def test_the_second_of_two_hours_may_have_a_column(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    titles = ["Date", "H1", "H2", "H3", "H3B", *(f"H{hour}" for hour in range(4, 25))]
    days = {"2010-10-31": range(25), "2010-11-01": [0, 1, 2, "", *range(4, 25)]}
    path.write_text("\n".join([";".join(titles), *(";".join([day, *map(str, cells)]) for day, cells in days.items())]))
    prices = read_prices(path, "EUR MWh-1", clock="Europe/Madrid", file_unit="EUR/MWh")
    assert prices.prices.tolist() == [*map(float, range(25)), 0.0, 1.0, 2.0, *map(float, range(4, 25))]
    assert (np.diff(prices.seconds) == 3600).all()


def test_times_that_may_be_local_are_doubted(tmp_path: Path) -> None:
    rows = [f"13-03-2010 {hour:02d}:00;{hour},5" for hour in range(24)]
    text = "\n".join(["Tijdstip;Prijs (EUR/MWh)", *rows])
    (doubt,) = prices_of(tmp_path, text).doubts
    assert "its times have no offset and are read as UTC" in doubt
    assert prices_of(tmp_path, text, clock="Europe/Amsterdam").doubts == ()
    assert prices_of(tmp_path, text.replace("Tijdstip", "Tijdstip UTC")).doubts == ()


@pytest.mark.parametrize("months", ["2010-{0:02d}", "01-{0:02d}-2010", "{0:02d}/2010", "{1} 2010", "{1}-10"])
def test_a_contract_has_a_price_for_each_month(tmp_path: Path, months: str) -> None:
    names = ["jan", "feb", "mrt", "apr", "mei", "juni", "juli", "aug", "sept", "oktober", "november", "dec"]
    rows = [f"{months.format(month, name)};0,{250 + month}" for month, name in enumerate(names, start=1)]
    prices = prices_of(tmp_path, "\n".join(["Maand;Gasprijs (€/m3)", *rows]), unit="EUR m-3")
    assert utc(prices) == [f"{month:02d}-01 00:00" for month in range(1, 13)]
    assert (prices.prices[2], prices.doubts) == (0.253, ())


def test_a_list_of_records_in_json_is_a_table(tmp_path: Path) -> None:
    hours = [{"price": price, "readingDate": f"2010-03-01T0{hour}:00:00Z"} for hour, price in enumerate([0.12, None])]
    text = json.dumps({"Prices": hours, "average": 1})
    prices = prices_of(tmp_path, text)
    assert (utc(prices), prices.prices.tolist()) == (["03-01 00:00"], [0.12])
    with pytest.raises(TaskError, match="looks like JSON, but is damaged or has no list of records"):
        prices_of(tmp_path, text[:60])


def test_an_export_of_epex_has_a_row_a_day_and_a_column_an_hour(tmp_path: Path) -> None:
    titles = ["Delivery day", *(f"Hour {hour}" if hour != 3 else "Hour 3A;Hour 3B" for hour in range(1, 25))]
    days = {
        "26/03/2011": ["1", "2", "3", "", *map(str, range(4, 25))],
        "27/03/2011": ["1", "2", "", "", *map(str, range(4, 25))],
        "30/10/2011": ["1", "2", "3", "3,5", *map(str, range(4, 25))],
    }
    text = "\n".join([";".join(titles), *(";".join([day, *cells]) for day, cells in days.items())])
    prices = prices_of(tmp_path, text, file_unit="EUR/MWh")
    assert prices.prices.size == 24 + 23 + 25
    assert (
        "column = 'Hour 7' is ignored: the file has a column for each hour"
        in prices_of(tmp_path, text, file_unit="EUR/MWh", column="Hour 7").doubts[-1]
    )
    assert utc(prices)[:1] == ["03-25 23:00"]
    spring, autumn = prices.prices[24:47] * 1e3, prices.prices[47:] * 1e3
    np.testing.assert_allclose(spring[:4], [1, 2, 4, 5])
    np.testing.assert_allclose(autumn[:5], [1, 2, 3, 3.5, 4])
    assert utc(prices)[47] == "10-29 22:00"
    in_utc = prices_of(tmp_path, text.replace("Delivery day", "Date (UTC)").replace(";1;2;;;", ";1;2;3;;"), file_unit="EUR/MWh")
    assert utc(in_utc)[::24] == ["03-26 00:00", "03-27 00:00", "10-30 00:00"]
    np.testing.assert_allclose(in_utc.prices * 1e3, [*range(1, 25)] * 3)
    assert (np.diff(prices.seconds[47:]) == 3600).all()


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_an_export_with_decimal_commas_and_a_currency_sign(tmp_path: Path, encoding: str) -> None:
    text = (
        "Datum von;Datum bis;Deutschland/Luxemburg [€/MWh] Originalauflösungen\r\n"
        "13.02.2024 00:00;13.02.2024 00:15;1.064,50\r\n13.02.2024 00:15;13.02.2024 00:30;-3,50\r\n"
    )
    prices = prices_of(tmp_path, text, encoding=encoding, clock="Europe/Berlin")
    np.testing.assert_allclose(prices.prices, [1.0645, -0.0035])
    assert utc(prices) == ["02-12 23:00", "02-12 23:15"]


@pytest.mark.parametrize(
    ("title", "unit", "expected"),
    [
        ("EUR/MWh", KWH, 0.04),
        ("ct/kWh", KWH, 0.4),
        ("Preis (EUR/kWh)", KWH, 40.0),
        ("€/GJ", KWH, 0.144),
        ("EURct/kWh", KWH, 0.4),
        ("€ct per kWh", KWH, 0.4),
        *((f"{cents}/kWh", KWH, 0.4) for cents in ("c€", "€c", "EURc")),
        ("ct/kWh", "ct kWh-1", 40.0),
        ("EUR/MWh", "ct kWh-1", 4.0),
        ("$/MWh", "USD kWh-1", 0.04),
        ("Price [£/MWh]", "GBP kWh-1", 0.04),
        ("EUR kWh-1", KWH, 40.0),
        *((f"{words} EUR/MWh", KWH, 0.04) for words in ("Spot price", "Market price", "Export", "Prijs import", "Unit price")),
        ("gas EUR/m3", "EUR m-3", 40.0),
        ("EUR/t", "EUR kg-1", 0.04),
        ("EUR/MWh", "EUR MJ-1", 0.04 / 3.6),
    ],
)
def test_units_are_converted_to_that_of_the_table(tmp_path: Path, title: str, unit: str, expected: float) -> None:
    prices = prices_of(tmp_path, f"time,{title}\n2010-01-01T00:00Z,40\n2010-01-01T01:00Z,40\n", unit=unit)
    np.testing.assert_allclose(prices.prices, expected)


def test_cents_of_an_unnamed_currency_are_not_taken_for_euros(tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="has no unit of prices"):
        prices_of(tmp_path, "time,Price c/kWh,mean\n2010-01-01T00:00Z,40,1\n2010-01-01T01:00Z,40,1\n", column="Price c/kWh")


def test_hours_without_a_price_are_named(tmp_path: Path) -> None:
    prices = prices_of(tmp_path, "hour,EUR/MWh\n2010-01-01T00:00Z,40\n2010-01-01T01:00Z,n/e\n2010-01-01T02:00Z,42\n")
    assert prices.doubts == ("1 of 3 hours have no price (the first: row 3, 2010-01-01 01:00 UTC); the price before them holds",)
    assert utc(prices) == ["01-01 00:00", "01-01 02:00"]
    with pytest.raises(TaskError, match="it has no price at all"):
        prices_of(tmp_path, "hour,EUR/MWh\n2010-01-01T00:00Z,n/e\n2010-01-01T01:00Z,\n", column="EUR/MWh")


@pytest.mark.parametrize(
    ("text", "how", "words"),
    [
        ("time,EUR/MWh\n2010-10-31T02:00,1\n2010-10-31T02:00,2\n", {}, "row 3, column 'time': 2010-10-31T02:00 comes again.*clock = \"Eur"),
        ("time,EUR/MWh\n2010-03-28T02:30,1\n", {"clock": "Europe/Amsterdam"}, "row 2.*does not exist on the clock of Europe/Amsterdam"),
        ("time,EUR/MWh\n2010-03-28T02:30,1\n", {"clock": "Europe/Amsterdm"}, "clock = 'Europe/Amsterdm' is no time zone"),
        ("time,NL EUR/MWh,BE EUR/MWh\n2010-01-01T00:00,1,2\n", {}, "it is unclear which column holds the prices"),
        ("time,NL,BE\n2010-01-01T00:00,1,2\n", {"column": "NL"}, "the title 'NL' has no unit of prices. Name it: file_unit"),
        ("time,EUR/MWh\n2010-01-01T00:00,1\n", {"column": "NL"}, "there is no column 'NL'"),
        ("time,EUR/MWh\n2010-01-01T00:00,1\n", {"file_unit": "parsec"}, "'parsec' is not a unit of prices"),
        (
            "Delivery day;" + ";".join(f"Hour {hour}" for hour in range(1, 25)) + "\n" + ("2010-03-01" + ";1" * 24 + "\n") * 2,
            {"file_unit": "EUR/MWh"},
            "row 3, column 'Delivery day': 2010-03-01 appears twice. Keep one row for each day",
        ),
        ("time,EUR/MWh\n" + "2010-01-01T00:00,1\n" * 110_001, {}, "it has 110,001 prices, and a task may have 110,000"),
    ],
)
def test_files_that_cannot_be_used_are_refused_in_words(tmp_path: Path, text: str, how: dict[str, str], words: str) -> None:
    with pytest.raises(TaskError, match=f"prices.csv.*{words}"):
        prices_of(tmp_path, text, **how)


def test_the_mean_is_one_of_time_and_a_factor_of_a_thousand_is_doubted() -> None:
    begin = dt.datetime(2010, 1, 1, tzinfo=dt.UTC)
    months = [(begin + dt.timedelta(days=30 * i), 0.04) for i in range(12)]
    day = [(begin + dt.timedelta(days=330, minutes=15 * (i + 1)), 0.4 if i < 96 else 0.04) for i in range(97)]
    table = PriceTable(KWH, series=(*months, *day))
    assert table.mean == pytest.approx((330 * 0.04 + 1 * 0.4 + 2 * 0.04 / 96) / (331 + 2 / 96), rel=1e-9)
    assert doubts_of_prices(KWH, 0.05, "power") == []
    assert doubts_of_prices("EUR kg-1", 50.0, "fruit") == doubts_of_prices("EUR", 1.0, "heads") == []
    (low,), (high,) = doubts_of_prices(KWH, 4.7e-5, "power"), doubts_of_prices(KWH, 45.0, "power")
    assert "4.7e-05 EUR kWh-1 on average" in low
    assert "45 EUR kWh-1 on average" in high


TASK = """
base = "glbench/SpringEnergy-v1"
id = "mylab/Own-v1"
title = "own prices"
{without}
weather.days = 2
[price_tables.power]
unit = "EUR kWh-1"
file = "power.csv"
"""


def own_task(folder: Path, year: int, scale: float = 1.0, without: str = 'without = ["price_tables.power.market"]') -> Path:
    begin = dt.datetime(year, 1, 1)
    rows = [f"{begin + dt.timedelta(hours=i):%Y-%m-%dT%H:%M},{scale * (40 + i % 24)}" for i in range(8760)]
    (folder / "power.csv").write_text("\n".join(["hour,EUR/MWh", *rows]))
    path = folder / "own.toml"
    path.write_text(TASK.format(without=without))
    return path


def test_a_market_of_the_base_is_replaced_or_the_error_says_how(tmp_path: Path) -> None:
    assert len(get_task(own_task(tmp_path, 2010)).price_tables["power"].series) == 8760
    with pytest.raises(TaskError, match=r'has a market, which the file must replace. Add without = \["price_tables.power.market"\]'):
        get_task(own_task(tmp_path, 2010, without=""))


def test_the_check_of_a_task_says_what_is_doubtful_and_refuses_prices_of_other_years(tmp_path: Path) -> None:
    run = CliRunner().invoke
    right = run(app, ["tasks", "check", str(own_task(tmp_path, 2010))])
    assert (right.exit_code, "nothing wrong" in right.output) == (0, True)
    thousandth = run(app, ["tasks", "check", str(own_task(tmp_path, 2010, 1e-3))])
    assert (thousandth.exit_code, "usable, but 1 doubt above" in thousandth.output) == (0, True)
    other = run(app, ["tasks", "check", str(own_task(tmp_path, 2024))])
    assert other.exit_code == 1
    words = " ".join(other.output.split())
    assert "has no price for 720 of the 720 hours that runs may use" in words
    assert "nothing wrong" not in words


def test_moments_with_and_without_an_offset_are_refused_in_words(tmp_path: Path) -> None:
    path = own_task(tmp_path, 2010)
    text = path.read_text(encoding="utf-8")
    series = "series = [{ time = 2010-03-01T00:00:00Z, price = 0.1 }, { time = 2010-03-01T01:00:00, price = 0.2 }]"
    path.write_text("\n".join(series if line.startswith("file =") else line for line in text.splitlines()), encoding="utf-8")
    with pytest.raises(TaskError, match="series: 2010-03-01 01:00 has no offset from UTC, unlike the first moment"):
        get_task(path)


def test_the_command_writes_a_plain_file_and_the_lines_of_a_task(tmp_path: Path) -> None:
    export = tmp_path / "export.csv"
    export.write_text(entsoe("01.04.2010", [(f"{hour:02d}:00", f"{hour + 1:02d}:00") for hour in range(23)]))
    out = tmp_path / "power.csv"
    arguments = ["prices", "import", str(export), "--out", str(out), "--base", "SpringEnergy-v1"]
    outcome = CliRunner().invoke(app, arguments)
    assert outcome.exit_code == 0, outcome.output
    assert "The prices are usable." in outcome.output
    for line in ('base = "glbench/SpringEnergy-v1"', 'without = ["price_tables.power"]', "[price_tables.power]", 'file = "power.csv"'):
        assert line in outcome.output
    again = read_prices(out, KWH)
    np.testing.assert_array_equal(again.prices, read_prices(export, KWH).prices)
    np.testing.assert_array_equal(again.seconds, read_prices(export, KWH).seconds)
    assert CliRunner().invoke(app, arguments).exit_code != 0
    table = CliRunner().invoke(app, [*arguments, "--replace", "--table", "my table"])
    assert "--table my table cannot be the name of a price table" in str(table.exception)
    furlongs = CliRunner().invoke(app, ["prices", "import", str(out), "--out", str(tmp_path / "far.csv"), "--unit", "furlongs"])
    assert "'furlongs', is not a unit of prices such as EUR kWh-1" in " ".join(furlongs.output.split())


def test_the_lines_for_a_task_of_ones_own_make_another_task(tmp_path: Path) -> None:
    own = own_task(tmp_path, 2010)
    own.write_text(own.read_text().replace('"own prices"', r'"My \"own\" prices"'))
    (tmp_path / "new").mkdir()
    out = tmp_path / "new" / "dear.csv"
    told = CliRunner().invoke(app, ["prices", "import", str(tmp_path / "power.csv"), "--out", str(out), "--base", str(own), "--json"])
    assert told.exit_code == 0, told.output
    (tmp_path / "new" / "dear.toml").write_text(json.loads(told.stdout)["task"])
    task = get_task(tmp_path / "new" / "dear.toml")
    assert (task.id, task.title) == ("mylab/Prices-Own-v1", 'My "own" prices, own prices')
    assert len(task.price_tables["power"].series) == 8760
