"""The door for outside tables: encodings, archives, delimiters, numbers, stamps and clocks as programs write them."""

from __future__ import annotations

import datetime as dt
import gzip
import zipfile
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from glbench.errors import WeatherError
from glbench.outside_tables import TextTable, parse_number, read_stamps, read_text, split_table, step_of, time_titles, utc_of_local

TEXT = "Ort;Wert\nZürich;1\nBelém;2\n"
AMSTERDAM = ZoneInfo("Europe/Amsterdam")


def table_of(text: str) -> TextTable:
    return split_table(text, "table.csv", WeatherError)


def stamps_of(*stamps: str) -> list[str]:
    """The moments of a column of stamps, as text in UTC or on their own clock."""
    table = TextTable("table.csv", WeatherError, (), ("time",), [[stamp] for stamp in stamps], range(2, len(stamps) + 2))
    seconds = read_stamps(table, ("time",)).seconds
    return [str(np.datetime64(int(moment), "s"))[:16] for moment in seconds]


@pytest.mark.parametrize(
    "data",
    [
        TEXT.encode(),
        TEXT.encode("utf-8-sig"),
        TEXT.encode("latin-1"),
        TEXT.encode("utf-16"),  # with a byte order mark
        TEXT.encode("utf-16-le"),
        TEXT.encode("utf-16-be"),
        TEXT.replace("\n", "\r\n").encode(),
        TEXT.replace("\n", "\r").encode(),
        TEXT.replace("\n", "\r\r\n").encode(),
        gzip.compress(TEXT.encode("latin-1"), mtime=0),
    ],
)
def test_every_encoding_and_line_end_gives_the_same_text(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(data)
    assert read_text(path, WeatherError) == TEXT


def test_an_archive_with_one_table_is_opened(tmp_path: Path) -> None:
    path = tmp_path / "table.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("folder/table.csv", TEXT.encode("utf-16"))
        archive.writestr("__MACOSX/._table.csv", b"\0\1")
    assert read_text(path, WeatherError) == TEXT


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\xd0\xcf\x11\xe0\xa1\xb1", "an old Excel workbook"),
        (b"%PDF-1.7 ...", "a PDF document"),
        (b"PAR1....", "a Parquet file"),
        (b"\x89HDF\r\n", "an HDF5 or NetCDF file"),
        (b"<!DOCTYPE html><html>", "a web page or an XML file"),
        (b'<?xml version="1.0"?><a/>', "a web page or an XML file"),
        (b" \r\n", "is empty"),
        (b"abc\0\0\1def" * 3, "not a text file"),
        (b"PK\3\4 damaged", "damaged archive"),
    ],
)
def test_what_is_no_table_is_refused_in_words(tmp_path: Path, data: bytes, words: str) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(data)
    with pytest.raises(WeatherError, match=words):
        read_text(path, WeatherError)


@pytest.mark.parametrize(("member", "words"), [("xl/workbook.xml", "a workbook"), ("content.xml", "a workbook")])
def test_a_workbook_is_refused(tmp_path: Path, member: str, words: str) -> None:
    path = tmp_path / "table.xlsx"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(member, "<a/>")
    with pytest.raises(WeatherError, match=words):
        read_text(path, WeatherError)


@pytest.mark.parametrize("path", ["missing.csv", "."])
def test_a_path_without_a_file_is_refused(tmp_path: Path, path: str) -> None:
    with pytest.raises(WeatherError, match=r"Cannot read .*Check the path"):
        read_text(tmp_path / path, WeatherError)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_delimiters_are_recognised_and_trailing_ones_left_out(delimiter: str) -> None:
    rows = [["time", "a", "b", ""], ["2024-01-01 00:00", "1.5", "x y", ""], ["2024-01-01 01:00", "2.5", "z", ""]]
    table = table_of("\n".join(delimiter.join(row) for row in rows))
    assert table.titles == ("time", "a", "b")
    assert table.numbers("a").tolist() == [1.5, 2.5]
    assert list(table.lines) == [2, 3]


def test_a_line_of_units_joins_the_titles() -> None:
    table = table_of("exported by X\n\ntime;Temp;RH\n;°C;%\n2024-01-01 00:00;1,5;80\n2024-01-01 01:00;2,5;81\n")
    assert table.titles == ("time", "Temp [°C]", "RH [%]")
    assert table.numbers("Temp [°C]").tolist() == [1.5, 2.5]
    assert table.preamble == ("exported by X",)
    assert list(table.lines) == [5, 6]


def test_a_short_row_is_named() -> None:
    with pytest.raises(WeatherError, match=r"table\.csv, row 3: 2 fields instead of 3"):
        table_of("a,b,c\n1,2,3\n1,2\n4,5,6\n4,5,7\n")


def test_a_text_among_numbers_is_named_with_row_column_and_value() -> None:
    table = table_of("time,a\n2024-01-01,1\n2024-01-02,oops\n")
    with pytest.raises(WeatherError, match=r"table\.csv, row 3, column 'a': 'oops' is not a number"):
        table.numbers("a")
    with pytest.raises(WeatherError, match="there is no column 'b'"):
        table.numbers("b")


@pytest.mark.parametrize("missing", ["", "-", "n/e", "N/A", "NaN", "null", "#N/A"])
def test_words_for_missing_become_nan(missing: str) -> None:
    values = table_of(f"time,a\n2024-01-01,{missing}\n2024-01-02,2\n2024-01-03,-999\n").numbers("a", (-999,))
    assert np.isnan(values[[0, 2]]).all()
    assert values[1] == 2.0


@pytest.mark.parametrize(
    ("text", "decimal", "value"),
    [
        ("1.5", ".", 1.5),
        ("1,5", ",", 1.5),
        ("1.234,5", ",", 1234.5),
        ("1,234.5", ".", 1234.5),
        ("1 234,5", ",", 1234.5),
        ("-0,5", ",", -0.5),
        ("\u22123", ".", -3.0),
        ("1e3", ".", 1000.0),
        ("1,2,3", ".", None),
        ("1_000", ".", None),
        ("12 degC", ".", None),
    ],
)
def test_numbers_are_read_with_either_decimal_sign(text: str, decimal: str, value: float | None) -> None:
    assert parse_number(text, decimal) == value


def test_decimal_signs_that_are_unclear_or_mixed_are_refused() -> None:
    with pytest.raises(WeatherError, match=r"row 2, column 'a': it is unclear whether 1,234 is 1\.234 or 1234"):
        table_of('time,a\n2024-01-01,"1,234"\n2024-01-02,"2,345"\n')
    with pytest.raises(WeatherError, match=r"row 3, column 'a': 2\.5 has another decimal sign than 1,5 in row 2"):
        table_of("time;a\n2024-01-01;1,5\n2024-01-02;2.5\n")


@pytest.mark.parametrize(
    ("stamps", "moments"),
    [
        (("2024-02-13 23:00", "2024-02-14 00:00"), ["2024-02-13T23:00", "2024-02-14T00:00"]),
        (("2024-02-13T23:00:00+01:00",), ["2024-02-13T22:00"]),
        (("2024-02-13T23:00Z",), ["2024-02-13T23:00"]),
        (("20240213 2300",), ["2024-02-13T23:00"]),
        (("13-02-2024 23:00",), ["2024-02-13T23:00"]),
        (("13.02.2024 24:00",), ["2024-02-14T00:00"]),
        (("02/13/2024 11:00 PM",), ["2024-02-13T23:00"]),
        (("02/13/2024 12:30 AM",), ["2024-02-13T00:30"]),
        (("01.02.2024 00:00",), ["2024-02-01T00:00"]),  # with points, the day is first
        (("01/02/2024", "02/02/2024", "03/02/2024"), ["2024-02-01T00:00", "2024-02-02T00:00", "2024-02-03T00:00"]),
        (("02/01/2024", "02/02/2024", "02/03/2024"), ["2024-02-01T00:00", "2024-02-02T00:00", "2024-02-03T00:00"]),
        (("01-01-2024", "01-02-2024", "01-03-2024"), ["2024-01-01T00:00", "2024-02-01T00:00", "2024-03-01T00:00"]),  # prices of months
        (("01.01.2024 00:00 - 01.01.2024 01:00",), ["2024-01-01T00:00"]),  # ENTSO-E's ranges
        (("45334.5", "45334.75"), ["2024-02-12T12:00", "2024-02-12T18:00"]),  # Excel's days
        (("45334.5", "45335"), ["2024-02-12T12:00", "2024-02-13T00:00"]),  # the same over midnight
        (("2024-07-01 00:00 EEST",), ["2024-06-30T21:00"]),
        (("2024-07-01 00:00 (UTC)", "2024-07-01 01:00 (UTC)"), ["2024-07-01T00:00", "2024-07-01T01:00"]),
        (("2024-07-01 00:00 +0000 UTC", "2024-07-01 00:00-08:00 PST"), ["2024-07-01T00:00", "2024-07-01T08:00"]),
        (("2024-07-01 00:00 WEST", "2024-07-01 03:00 EEST"), ["2024-06-30T23:00", "2024-07-01T00:00"]),
        (("1707865200",), ["2024-02-13T23:00"]),  # Unix seconds
        (("1707865200000",), ["2024-02-13T23:00"]),  # milliseconds
    ],
)
def test_stamps_of_every_make_are_read(stamps: tuple[str, ...], moments: list[str]) -> None:
    assert stamps_of(*stamps) == moments


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (("01/02/2024",), "unclear whether 01/02/2024 has the day or the month first"),
        (("13/02/2024", "02/13/2024"), "some dates have the day first and some the month"),
        (("2024-02-30 01:00",), r"row 2, column 'time': the time '2024-02-30 01:00' does not exist"),
        (("2024-02-28 25:00",), "does not exist"),
        (("2024-02-28 13:00 PM",), "does not exist"),
        (("2024-02-28 01:00", "soon"), "row 3, column 'time': 'soon' is not a time such as"),
        (("2024-02-28 01:00Z", "2024-02-28 02:00"), "row 3, .*lacks an offset from UTC"),
        (("2024-02-28 01:00 CET", "2024-02-28 02:00 PDT"), "row 3, column 'time': the zone in '2024-02-28 02:00 PDT' is not known"),
    ],
)
def test_stamps_that_cannot_be_are_named(stamps: tuple[str, ...], words: str) -> None:
    with pytest.raises(WeatherError, match=words):
        stamps_of(*stamps)


def test_days_of_excel_are_recognised_over_midnight_and_counts_are_not() -> None:
    days = [f"{45352 + hour / 24:.10g}" for hour in range(72)]
    assert time_titles(table_of("\n".join(["count;when", *(f"{10000 + i};{day}" for i, day in enumerate(days))]))) == ("when",)
    days[40] = "soon"
    assert time_titles(table_of("\n".join(["when;count", *(f"{day};{i}" for i, day in enumerate(days))]))) == ("when",)  # its row is named
    assert time_titles(table_of("\n".join(["count;number", *(f"{10000 + i};{i}" for i in range(72))]))) == ()


def test_local_days_of_23_and_25_hours_become_utc() -> None:
    """Of the clock's hours as a program writes them, every one an hour after the one before in UTC."""
    for day, hours in ((dt.date(2024, 3, 31), 23), (dt.date(2024, 10, 27), 25)):
        begin = dt.datetime(day.year, day.month, day.day, tzinfo=AMSTERDAM).astimezone(dt.UTC)
        moments = [begin + dt.timedelta(hours=i) for i in range(hours)]
        stamps = [moment.astimezone(AMSTERDAM).strftime("%Y-%m-%d %H:%M") for moment in moments]
        table = TextTable("t.csv", WeatherError, (), ("time",), [[stamp] for stamp in stamps], range(2, hours + 2))
        utc = utc_of_local(table, read_stamps(table, ("time",)).seconds, AMSTERDAM, "time")
        assert utc.tolist() == [int(moment.timestamp()) for moment in moments]
        assert step_of(utc) == 3600


def test_an_hour_that_the_clock_skips_is_refused() -> None:
    table = TextTable("t.csv", WeatherError, (), ("time",), [["2024-03-31 02:30"]], [7])
    with pytest.raises(WeatherError, match=r"t\.csv, row 7, column 'time': 2024-03-31 02:30 does not exist on the clock"):
        utc_of_local(table, read_stamps(table, ("time",)).seconds, AMSTERDAM, "time")
