"""Prices that change with time: markets, yearly series, tables that follow others, prices beyond an amount, coming hours."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from glbench.errors import GlbenchError, TaskError
from glbench.report.task_words import definition_in_words
from glbench.tasks import PriceTable, TaskSpec, get_task
from glbench.tasks.library import series_in_words
from glbench.tasks.prices import SHAPE, Market, SeasonOfPrices, day_ahead, price_rows

Write = Callable[[str], Path]

MARKET = Market(level=0.2, shape=SHAPE, weekend=-0.1, sun=0.8, wind=0.25, spread=0.2, persistence=0.97, lowest=0.0, highest=0.8)
TABLE = PriceTable("EUR kWh-1", market=MARKET)


def hours_from(start: str, count: int, ahead: float = 1.0) -> tuple[NDArray[np.datetime64], NDArray[np.float64]]:
    """So many full hours from a moment [UTC], and what a clock shows that is ``ahead`` hours before UTC."""
    times = np.datetime64(start, "s") + np.arange(count) * np.timedelta64(3600, "s")
    return times, (times - times.astype("datetime64[D]")).astype(np.int64) / 3600.0 + ahead


def one_hour(start: str, sun: float = 0.0, wind: float = 5.0, path: float = 0.0, table: PriceTable = TABLE) -> float:
    """The price of an hour of its own, in UTC."""
    times, hours = hours_from(start, 1, 0.0)
    season = SeasonOfPrices(1, np.array([sun]), np.array([wind]), {"power": np.array([path])})
    return float(table.values(times, hours, season, "power")[0])


@pytest.mark.parametrize(
    ("start", "sun", "wind", "path", "price"),
    [
        ("2010-12-03T08:00", 0.0, 5.0, 0.0, 0.2 * 1.18),  # a Friday
        ("2010-12-04T08:00", 0.0, 5.0, 0.0, 0.2 * 1.08),  # a Saturday
        ("2010-12-05T23:00", 0.0, 5.0, 0.0, 0.2 * 0.82),  # a Sunday
        ("2010-12-06T00:00", 0.0, 5.0, 0.0, 0.2 * 0.84),  # a Monday
        ("2010-12-03T12:00", 500.0, 5.0, 0.0, 0.2 * (0.99 - 0.4)),
        ("2010-12-03T12:00", 0.0, 9.0, 0.0, 0.2 * (0.99 - 0.2)),
        ("2010-12-03T12:00", 0.0, 0.0, 0.0, 0.2 * (0.99 + 0.25)),
        ("2010-12-03T12:00", 0.0, 5.0, -1.5, 0.2 * (0.99 - 0.3)),
        ("2010-12-04T19:00", 200.0, 10.0, 2.0, 0.2 * (1.28 - 0.1 - 0.16 - 0.25 + 0.4)),
        ("2010-12-03T12:00", 1000.0, 25.0, 0.0, 0.0),  # lowest
        ("2010-12-03T19:00", 0.0, 0.0, 14.0, 0.8),  # highest
    ],
)
def test_a_market_follows_its_formula(start: str, sun: float, wind: float, path: float, price: float) -> None:
    assert one_hour(start, sun, wind, path) == pytest.approx(price, abs=1e-12)


def test_the_shape_has_the_mean_1_and_the_level_is_that_of_a_working_day() -> None:
    assert sum(SHAPE) / 24 == pytest.approx(1.0, abs=0.002)
    times, hours = hours_from("2010-12-06T00:00", 24, 0.0)
    assert TABLE.values(times, hours).mean() == pytest.approx(0.2, abs=0.0005)


def test_the_weekend_begins_at_midnight_of_the_clock() -> None:
    times, hours = hours_from("2010-12-03T22:00", 2)  # 23:00 on Friday and 0:00 on Saturday
    assert TABLE.values(times, hours) == pytest.approx([0.2 * 0.92, 0.2 * (0.84 - 0.1)])


def test_a_market_takes_the_means_of_an_hour_and_holds_for_all_of_it() -> None:
    times = np.datetime64("2010-12-03T12:00", "s") + np.arange(6) * np.timedelta64(900, "s")
    hours = 12.0 + np.arange(6) / 4
    sun = np.array([100.0, 200.0, 300.0, 400.0, 40.0, 60.0])  # the last hour has two rows
    season = SeasonOfPrices(4, sun, np.full(6, 5.0), {"power": np.array([0.5, -0.5, 9.0])})
    expected = [0.2 * (0.99 - 0.2 + 0.1)] * 4 + [0.2 * (0.96 - 0.04 - 0.1)] * 2
    assert TABLE.values(times, hours, season, "power") == pytest.approx(expected)


def test_without_a_season_a_market_is_what_the_clock_leads_to_expect() -> None:
    times, hours = hours_from("2010-12-02T23:00", 72)
    calm = SeasonOfPrices(1, np.zeros(72), np.full(72, 5.0), {"power": np.zeros(72)})
    expected = TABLE.values(times, hours)
    assert (expected == TABLE.values(times, hours, calm, "power")).all()
    assert len(set(expected)) > 24


def test_a_table_follows_another_with_its_factor_and_its_surcharge() -> None:
    bought = TABLE.following("power", unit="EUR kWh-1", times=2.0, plus=0.03)
    assert one_hour("2010-12-03T12:00", 100.0, 6.0, 1.0, bought) == pytest.approx(
        2.0 * one_hour("2010-12-03T12:00", 100.0, 6.0, 1.0) + 0.03
    )
    assert bought.limits == pytest.approx((0.03, 1.63))
    taxed = PriceTable("EUR kWh-1", hourly=(0.1,) * 23 + (0.4,), times=2.0, plus=0.1)
    again = taxed.following("taxed", unit="EUR kWh-1", times=-0.5, plus=1.0)
    times, hours = hours_from("2010-12-02T23:00", 24)
    tables = {"taxed": taxed, "again": again}
    first, second = price_rows(tables, tables, times, hours % 24).T
    assert first == pytest.approx([0.3] * 23 + [0.9])
    assert second == pytest.approx(1.0 - 0.5 * first)
    assert taxed.limits == pytest.approx((0.3, 0.9))
    assert again.limits == pytest.approx((0.55, 0.85))  # in order, though the factor turns them round


def moment(text: str) -> dt.datetime:
    return dt.datetime.fromisoformat(text).replace(tzinfo=dt.UTC)


YEARLY = PriceTable(
    "EUR kWh-1",
    series=tuple((moment(at), price) for at, price in (
        ("2012-01-01T06:00", 1.0), ("2012-02-28T12:00", 2.0), ("2012-02-29T00:00", 3.0), ("2012-03-01T00:00", 4.0),
        ("2012-10-01T00:00", 5.0),
    )),
    yearly=True,
)  # fmt: skip


@pytest.mark.parametrize(
    ("at", "price"),
    [
        ("2010-01-01T05:59", 5.0),  # before the first: the last of the year before
        ("2010-01-01T06:00", 1.0),
        ("2010-02-28T11:59", 1.0),
        ("2010-02-28T12:00", 2.0),
        ("2010-02-28T23:59", 2.0),
        ("2010-03-01T00:00", 4.0),  # a year without 29 February
        ("2008-02-29T00:00", 3.0),
        ("2008-12-31T23:59", 5.0),
        ("2009-01-01T00:00", 5.0),
    ],
)
def test_a_yearly_series_holds_for_every_year(at: str, price: float) -> None:
    times = np.array([at], "datetime64[s]")
    assert YEARLY.values(times, np.array([0.0])).tolist() == [price]


def test_a_series_of_a_year_without_29_february_goes_on_over_it() -> None:
    series = ((moment("2011-02-28T00:00"), 2.0), (moment("2011-03-01T00:00"), 4.0))
    times = np.array(["2012-02-29T18:00", "2012-03-01T00:00"], "datetime64[s]")
    assert PriceTable("EUR kWh-1", series=series, yearly=True).values(times, np.zeros(2)).tolist() == [2.0, 4.0]


def test_a_yearly_series_is_told_in_utc_whatever_the_clock_shows() -> None:
    times = np.array(["2010-09-30T23:00", "2010-10-01T00:00"], "datetime64[s]")
    assert YEARLY.values(times, np.array([1.0, 2.0])).tolist() == [4.0, 5.0]
    assert YEARLY.values(times, np.array([23.0, 0.0])).tolist() == [4.0, 5.0]


# Coming hours.


def test_coming_hours_are_known_until_midnight_and_then_those_of_24_h_before() -> None:
    times, hours = hours_from("2010-12-02T23:00", 72)
    prices = np.arange(72.0)
    seen = day_ahead(prices, times, hours % 24, 1, [1, 3, 24])
    assert seen.shape == (72, 3)
    assert seen[0].tolist() == [1.0, 3.0, 0.0]  # 0:00: the next midnight is not known
    assert seen[20].tolist() == [21.0, 23.0, 20.0]
    assert seen[21].tolist() == [22.0, 0.0, 21.0]  # 21:00: in 3 h it is midnight
    assert seen[23].tolist() == [0.0, 2.0, 23.0]
    assert seen[24].tolist() == [25.0, 27.0, 24.0]
    assert seen[71].tolist() == [48.0, 50.0, 71.0]  # past the end of the calendar


def test_coming_hours_of_quarters_belong_to_full_hours() -> None:
    times = np.datetime64("2010-12-02T23:00", "s") + np.arange(96 * 2) * np.timedelta64(900, "s")
    hours = np.arange(96 * 2) / 4 % 24
    prices = np.repeat(np.arange(48.0), 4)
    seen = day_ahead(prices, times, hours, 4, [1])[:, 0]
    assert seen[:8].tolist() == [1.0] * 4 + [2.0] * 4
    assert seen[92:100].tolist() == [0.0] * 4 + [25.0] * 4


@pytest.mark.parametrize(("day", "length"), [("2010-03-28", 23), ("2010-10-31", 25)])
def test_a_day_on_which_the_clock_changes_is_known_to_its_own_midnight(day: str, length: int) -> None:
    begin = 23 if length == 23 else 22  # of the day before, UTC
    midnight = np.datetime64(day, "s") - np.timedelta64((24 - begin) * 3600, "s")
    times = midnight + (np.arange(24 + length + 24) - 24) * np.timedelta64(3600, "s")
    utc = (times - times.astype("datetime64[D]")).astype(np.int64) / 3600
    changed = times >= np.datetime64(f"{day}T01:00", "s")
    summer = changed if length == 23 else ~changed
    seen = day_ahead(np.arange(len(times), dtype=float), times, (utc + 1 + summer) % 24, 1, range(1, 25))
    first, last = 24, 24 + length - 1
    for now in range(first, last + 1):
        for ahead in range(1, 25):
            target = now + ahead
            assert seen[now, ahead - 1] == (target if target <= last else target - 24), (now, ahead)
    assert (seen[first:] <= np.arange(first, len(times))[:, None] + length).all()


# Files of prices, and what is refused.

PRICES = """
base = "glbench/WinterLED-v1"
id = "mylab/Own-v1"
title = "A winter at prices of one's own"
without = ["price_tables.power"]

[price_tables.power]
unit = "EUR kWh-1"
file = "power.csv"
"""


def with_file(write: Write, text: str, *pieces: str) -> TaskSpec:
    task = PRICES
    for old, new in zip(pieces[::2], pieces[1::2], strict=True):
        task = task.replace(old, new)
    path = write(task)
    (path.parent / "power.csv").write_text(text, encoding="utf-8")
    return get_task(path)


@pytest.mark.parametrize(
    ("header", "first", "then"),
    [("hour,EUR/MWh", "87.5", "-12.5"), ("EUR/MWh,hour", "87.5", "-12.5"), ("hour,EUR/kWh", "0.0875", "-0.0125")],
)
def test_a_file_of_an_exchange_is_read_in_its_unit(write: Write, header: str, first: str, then: str) -> None:
    lines = [("2010-10-01T00:00+02:00", first), ("2010-10-01T01:00+02:00", then)]
    turned = header.endswith("hour")
    rows = [",".join(reversed(line) if turned else line) for line in lines]
    table = with_file(write, "\n".join([header, *rows, ""])).price_tables["power"]
    assert [at.isoformat() for at, _ in table.series] == ["2010-09-30T22:00:00+00:00", "2010-09-30T23:00:00+00:00"]
    assert [price for _, price in table.series] == pytest.approx([0.0875, -0.0125])
    assert table.limits == pytest.approx((-0.0125, 0.0875))


@pytest.mark.parametrize(
    ("header", "unit"),
    [("hour,EUR/MWh", "EUR kg-1"), ("hour,GBP/MWh", "EUR kWh-1"), ("hour,power", "EUR kWh-1"), ("hour,temperature", "EUR kWh-1")],
)
def test_a_file_in_another_unit_or_with_another_header_is_refused(write: Write, header: str, unit: str) -> None:
    with pytest.raises(TaskError, match=r"\[price_tables.power\] file: .*power.csv.*hour,EUR/MWh.*for a table in EUR kWh-1"):
        with_file(write, f"{header}\n2010-10-01T00:00,87.5\n", '"EUR kWh-1"', f'"{unit}"')


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hour,EUR/MWh\n2010-10-01T00:00,87,5\n", "power.csv, row 2: 3 fields instead of 2. Is the file whole?"),
        ("hour,EUR/MWh\nyesterday,87.5\n", "power.csv, row 2, column 'hour': 'yesterday' is not a time such as"),
        ("hour,EUR/MWh\n2010-10-01T00:00,cheap\n2010-10-01T01:00,1\n", "power.csv, row 2, column 'EUR/MWh': 'cheap' is not a number"),
        ("hour,EUR/MWh\n2010-10-01T01:00,87.5\n2010-10-01T01:00,87.5\n", "row 3, column 'hour': 2010-10-01T01:00 comes again."),
        ("", "power.csv is empty"),
    ],
)  # fmt: skip
def test_a_file_that_is_written_otherwise_is_refused_in_words(write: Write, text: str, words: str) -> None:
    with pytest.raises(TaskError) as caught:
        with_file(write, text)
    assert words in str(caught.value)


def test_a_table_has_the_unit_of_its_base_or_is_refused_for_lack_of_one(write: Write) -> None:
    text, no_unit = "hour,EUR/MWh\n2010-10-01T00:00,87.5\n", ('unit = "EUR kWh-1"\n', "")
    task = with_file(write, text, *no_unit, 'without = ["price_tables.power"]', 'without = ["price_tables.power.market"]')
    assert task.price_tables["power"].series[0][1] == pytest.approx(0.0875)
    own = ("[price_tables.power]", "[price_tables.gas]")
    with pytest.raises(TaskError) as caught:
        with_file(write, text, *no_unit, *own)
    assert 'the file is in EUR/MWh, and the price table has no unit: write unit = "EUR kWh-1" in it.' in str(caught.value)


def hourly_file(first: str, hours: int) -> str:
    times, _ = hours_from(first, hours)
    return "hour,EUR/MWh\n" + "".join(f"{at},{50 + at.astype(int) // 3600 % 24}\n" for at in times)


def test_hours_that_a_file_does_not_have_are_told(write: Write, caplog: pytest.LogCaptureFixture) -> None:
    yearly = ('file = "power.csv"', 'file = "power.csv"\nyearly = true')
    with_file(write, hourly_file("2023-01-01T00:00", 199), *yearly)
    (warning,) = caplog.messages
    assert "[price_tables.power] has no price for" in warning
    assert "hours that runs may use" in warning
    caplog.clear()
    task = with_file(write, hourly_file("2023-01-01T00:00", 8760), *yearly)
    assert caplog.messages == []
    assert series_in_words(task)[0] == (
        "Price 'power': 8,760 prices from 2023-01-01 00:00 to 2023-12-31 23:00 UTC, repeated every year; mean 0.0615, lowest 0.05, "
        "highest 0.073 EUR kWh-1."
    )


def test_a_price_of_every_month_has_no_gaps(write: Write, caplog: pytest.LogCaptureFixture) -> None:
    rows = "".join(f"2023-{month:02d}-01T00:00,{40 + month}\n" for month in range(1, 13))
    with_file(write, f"hour,EUR/MWh\n{rows}", 'file = "power.csv"', 'file = "power.csv"\nyearly = true')
    assert caplog.messages == []


POWER = "price_tables.power"
MARKET_KEYS = f"{POWER}.market"
BEYOND = {"amount": {"value": 1.0, "unit": "kg m-2"}, "price": {"value": 0.2, "unit": "EUR kg-1"}}


def series(*moments: str) -> dict[str, Any]:
    return {"unit": "EUR kWh-1", "yearly": True, "series": [{"time": at, "price": 0.1} for at in moments]}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({POWER + ".hourly": [0.1] * 24}, "It must have exactly one of hourly (24 prices), from_day (prices by day), series"),
        ({MARKET_KEYS + ".shape": [1.0] * 23}, "There must be 24 numbers, one an hour; there are 23."),
        ({MARKET_KEYS + ".lowest": 0.8}, "lowest = 0.8 must be below highest = 0.8."),
        ({MARKET_KEYS + ".level": 0.0}, "level = 0.0 is not allowed. It must be a price above 0"),
        ({MARKET_KEYS + ".weekend": -1.5}, "a share of the level, -1 to 1"),
        ({MARKET_KEYS + ".sun": -0.1}, "a share of the level, 0 to 10"),
        ({MARKET_KEYS + ".wind": 11.0}, "a share of the level, 0 to 10"),
        ({MARKET_KEYS + ".spread": -1.0}, "a share of the level, 0 to 10"),
        ({MARKET_KEYS + ".persistence": 1.0}, "a fraction from 0 to below 1"),
        ({POWER + ".yearly": True}, "yearly = true belongs to a series"),
        ({"price_tables.dear": {"unit": "EUR kWh-1", "of": "powr"}}, "of = 'powr': there is no such table. Did you mean 'power'?"),
        ({"price_tables.dear": {"unit": "EUR kg-1", "of": "power"}}, "is in EUR kg-1, and 'power', which it follows, in EUR kWh-1."),
        (
            {"price_tables.dear": {"unit": "EUR kWh-1", "of": "power"}, "price_tables.dearer": {"unit": "EUR kWh-1", "of": "dear"}},
            "[price_tables.dearer] of = 'dear', which follows 'power' itself. Name that one.",
        ),
        ({"price_tables.gas": series("2010-01-01T00:00", "2011-01-01T00:00")}, "from 2010-01-01 to 2011-01-01. Keep one year of it."),
        ({"observation.day_ahead.prices": ["powr"]}, "[observation.day_ahead] prices: there is no price table 'powr'. Did"),
        ({"observation.day_ahead.hours": [1, 25]}, "hours = [1, 25] must be different whole hours from 1 to 24, the nearest first."),
        ({"observation.day_ahead.hours": [2, 2]}, "hours = [2, 2] must be different whole hours"),
        ({"observation.day_ahead": None}, "add [observation.day_ahead] with prices"),
        ({"observation.modules": ["indoor_climate", "prices"], "observation.forecast": None}, 'add "day_ahead_prices" to the modules'),
        ({"ledger.cost_heat.price.value": "0.15"}, 'price is "0.15": a number is written without quotes, price = { value = 0.15, unit'),
        ({"ledger.cost_heat.price": "0,15"}, 'price is "0,15": a number is written without quotes, price = { value = 0.15, unit'),
        ({"ledger.cost_gas.price.value": 0.15}, "has no ledger.cost_gas. Did you mean 'cost_heat'"),
        ({"price_tables.pwr.times": 2.0}, "has no price_tables.pwr. Did you mean 'power'? It has fruit, power."),
        ({"ledger.cost_electricity.beyond": BEYOND}, "beyond needs a price that is a number, and this one is the table 'power'."),
        ({"ledger.cost_heat.beyond": BEYOND}, "season-1.0.0 has no meter on 'heat'. It has fruit_harvested, co2_metered."),
        (
            {"ledger.cost_co2.beyond.amount": {"value": 1.0, "unit": "g m-2"}},
            "beyond: its amount is in g m-2, that of the item in kg m-2. Write both in one unit.",
        ),
        ({"ledger.cost_co2.beyond.price": {"value": 1.0, "unit": "EUR g-1"}}, "its price is in EUR g-1, that of the item in EUR kg-1."),
        ({"ledger.cost_co2.beyond": {"amount": 1.0, "price": 0.2}}, "Write amount and price with their units: beyond = "),
        ({"ledger.cost_co2.beyond.amount": {"value": 0.0, "unit": "kg m-2"}}, "amount = 0.0 is not allowed"),
    ],
)  # fmt: skip
def test_a_mistake_is_told(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(GlbenchError) as caught:
        _ = get_task("WinterLED-v1").replace(changes).ledger
    assert words in str(caught.value)


def test_prices_shown_must_be_there() -> None:
    with pytest.raises(GlbenchError, match=r"'prices' shows prices that change with time, and there is none"):
        get_task("Spring-v1").replace({"observation.modules": ["prices"], "observation.forecast": None}).observed()


def test_what_is_seen_of_prices_has_the_bounds_of_their_tables() -> None:
    seen = {one.name: one for one in get_task("SpringEnergy-v1").observed()}
    assert (seen["price_power"].unit, seen["price_power"].low, seen["price_power"].high) == ("EUR kWh-1", -0.05, 0.4)
    bought = seen["price_power_bought"]
    assert (bought.low, bought.high) == pytest.approx((-0.02, 0.43))
    assert (seen["price_power_in_21h"].low, seen["price_power_in_21h"].high) == (-0.05, 0.4)
    assert "price_power_bought_in_1h" not in seen


def test_a_price_that_steps_is_told_with_both_prices() -> None:
    rows = [row for section in definition_in_words(get_task("WinterLED-v1")) for row in section.rows]
    assert "0.08 EUR per kg, 0.2 beyond 12 kg m-2" in [row[2] for row in rows if row[0] == "CO2"]
