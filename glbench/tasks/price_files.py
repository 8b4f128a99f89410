"""Files of prices as people have them: exports of ENTSO-E, EPEX, SMARD and others, and the plain two columns of docs/prices.md.

The column of times and that of prices are recognised, stamps on a local clock become UTC with the 23 and 25 hours of the days on which the
clock changes, and prices are converted to the unit of the table. Hours without one are left out with a note: the price before holds on.
"""

from __future__ import annotations

import datetime as dt
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from glbench import outside_tables as outside
from glbench.errors import TaskError, refuse
from glbench.untrusted import visible

MOST_PRICES: Final = 110_000
"""Rows of a file of prices: 12 years by the hour, 3 by the quarter of an hour."""
EXCHANGE_CLOCK: Final = "Europe/Brussels"
"""Clock of stamps that call themselves CET/CEST."""
USUAL_PRICES: Final = {"kwh": (0.004, 2.0), "m3": (0.03, 10.0)}
"""Range in which the mean of a price [EUR for each] usually is. Beyond it a factor of 1,000 is likely: EUR/MWh taken for EUR/kWh."""
_AMOUNTS: Final = {
    "MWh": ("kWh", 1e-3), "kWh": ("kWh", 1.0), "GJ": ("kWh", 0.0036), "MJ": ("kWh", 3.6),
    "m3": ("m3", 1.0), "kg": ("kg", 1.0), "t": ("kg", 1e-3), "mol": ("mol", 1.0),
}  # fmt: skip
"""Amounts that prices are for: the amount that a table may use, and the factor from this one to that."""
_UNIT: Final = re.compile(
    r"(?<![A-Za-z])(?:(?:EUR|€)(?=c))?(?P<money>EUR|[€$£]|Euro?s?|c€|ct|cent|cts|(?<=[€R])c|[A-Z]{3})(?:\s*(?:/|\bper\b|\bpro\b)\s*|\s+)"
    r"(?P<amount>MWh|kWh|GJ|MJ|m-?3|m³|kg|t|mol)\b(?:-1)?",
    re.IGNORECASE,
)
_PRICE: Final = re.compile(r"price|prijs|preis|prix|precio|day.?ahead|auction|spot|tari", re.IGNORECASE)
_EPEX_HOUR: Final = re.compile(r"(?:hour|stunde|heure|uur|h)\s*(\d{1,2})\s*([AB]?)(?:\s*\(.*\))?", re.IGNORECASE)
_PLAIN_TIMES: Final = ("time", "hour")
"""Titles of the times in a plain file."""
_PLAIN_FILE: Final = (
    "A plain file has the header time,price and lines such as 2010-03-01T00:00,0.09, or the header hour,EUR/MWh and "
    "lines such as 2023-03-01T00:00+01:00,87.5 for a table in EUR kWh-1."
)


@dataclass(frozen=True)
class PriceFile:
    """Prices of a file, in order of time."""

    seconds: outside.IntArray
    """Moments from which on each price holds [s since 1970-01-01 UTC] ``(prices,)``."""
    prices: outside.FloatArray
    """Prices in ``unit`` ``(prices,)``."""
    unit: str
    """Such as ``EUR kWh-1``."""
    notes: tuple[str, ...]
    """How the file was read."""
    doubts: tuple[str, ...] = ()
    """What it lacks."""

    def series(self) -> list[dict[str, object]]:
        """The ``series`` of a price table."""
        return [
            {"time": dt.datetime.fromtimestamp(moment, tz=dt.UTC), "price": price}
            for moment, price in zip(self.seconds.tolist(), self.prices.tolist(), strict=True)
        ]


def read_prices(path: Path, unit: object, *, clock: object = None, column: object = None, file_unit: object = None) -> PriceFile:
    """Prices of a file in the ``unit`` of a price table.

    Raises ``TaskError`` when the file is not one of prices; names row, column and value.
    ``path`` may also be a ``.zip`` or ``.gz`` with one table inside. ``unit`` is that of the table, such as ``EUR kWh-1``; ``None``, of a
    table without one, is refused. ``clock`` is the IANA zone of stamps without an offset; by default UTC, or that of an exchange where the
    title says CET/CEST. ``column`` is the title of the column of prices, where there are several, ``file_unit`` the unit of the file's
    prices, such as ``EUR/MWh``, where its title has none.
    """
    text = outside.read_text(path, TaskError)
    table = outside.split_table(text, str(path), TaskError)
    if len(table.rows) > MOST_PRICES:
        table.refuse(f"it has {len(table.rows):,} prices, and a task may have {MOST_PRICES:,}. Keep the years that the runs use.")
    doubts: list[str] = []
    hours = {title: match for title in table.titles if (match := _EPEX_HOUR.fullmatch(title))}
    times = (
        outside.time_titles(table)
        or tuple(title for title in table.titles if re.search("time|hour|date|datum|tijd|zeit|uur|mtu|maand", title, re.IGNORECASE))[:1]
    )
    zone, named_clock = _clock_of(table, " ".join(times), clock)
    if len(hours) >= 24:
        if column is not None:
            doubts.append(f"column = '{visible(str(column))}' is ignored: the file has a column for each hour, and all are read")
        seconds, prices = _days_of_hours(table, [*hours], zone or ZoneInfo("UTC" if outside.says_utc(_titles(table)) else EXCHANGE_CLOCK))
        lines, price_title = np.zeros(seconds.size, dtype=np.int64), table.titles[0]
    else:
        price_title = _price_column(table, column)
        if not times:
            table.refuse(f"no column holds times; its columns are {visible(', '.join(table.titles)[:300])}. {_PLAIN_FILE}")
        table, stamps = outside.oldest_first(table, outside.read_stamps(table, times))
        seconds = stamps.seconds
        if stamps.zoned:
            named_clock = ""
        elif zone is not None:
            seconds = outside.utc_of_local(table, seconds, zone, times[0])
        elif not (table.titles[0] in _PLAIN_TIMES or outside.says_utc(_titles(table)) or outside.step_of(seconds) >= outside.DAY):
            doubts.append(
                "its times have no offset and are read as UTC. If they are on a local clock, all prices are an hour or two late: name it, "
                'clock = "Europe/Amsterdam" in the price table (or --clock)'
            )
        if stamps.ends:
            seconds = seconds - outside.step_of(seconds)
            doubts.append("midnight is 24:00, so each time is taken for the end of the hour that its price is for")
        prices = table.numbers(price_title)
        lines = np.array(table.lines, dtype=np.int64)
        for i, (before, here) in enumerate(pairwise(seconds.tolist()), start=1):
            if here <= before:
                problem = (
                    f"{visible(table.texts(times[0])[i])} {'comes again' if here == before else 'is earlier than the row above'}. Times "
                    "rise, and each comes once. On a local clock, whose autumn has an hour twice, name it: clock = "
                    '"Europe/Amsterdam" in the price table (or --clock). Of several series below each other, keep one.'
                )
                table.refuse(problem, i, times[0])
    factor, own_unit, unit_note = _conversion(table, price_title, unit, file_unit)
    notes = [*table.notes, *([named_clock] if named_clock else []), *([unit_note] if unit_note else [])]
    missing = np.isnan(prices)
    if missing.all():
        table.refuse("it has no price at all.", None, price_title)
    if missing.any():
        i = int(np.argmax(missing))
        where = f"row {lines[i]}, " if lines[i] else ""
        first = dt.datetime.fromtimestamp(int(seconds[i]), tz=dt.UTC)
        count = f"{int(missing.sum()):,} of {missing.size:,} hours have no price"
        doubts.append(f"{count} (the first: {where}{first:%Y-%m-%d %H:%M} UTC); the price before them holds")
    return PriceFile(seconds[~missing], prices[~missing] * factor, own_unit, tuple(notes), tuple(doubts))


def doubts_of_prices(unit: str, mean: float, name: str) -> list[str]:
    """A doubt about the factor of the prices of the table ``name``, whose mean over time is ``mean`` [``unit``]; empty if there is none."""
    match = _UNIT.search(unit)
    if match is None and not re.match(r"[A-Z]{3}( |$)", unit):
        return [f"the unit of '{name}', '{visible(unit)}', is not a unit of prices such as EUR kWh-1"]
    low, high = USUAL_PRICES.get(_amount(match) if match else "", (0.0, np.inf))
    if low <= abs(mean) <= high:
        return []
    return [
        f"the prices of '{name}' are {mean:.3g} {unit} on average, where {low:g} to {high:g} is usual. Is the unit of the file right? "
        "EUR/kWh under a title EUR/MWh makes them a thousandth, the reverse a thousand times as high."
    ]


def _amount(unit: re.Match[str]) -> str:
    """The amount that a price is for, in lower case: ``kwh``, ``m3``."""
    return unit["amount"].lower().replace("³", "3").replace("-", "")


def _clock_of(table: outside.TextTable, time: str, clock: object) -> tuple[ZoneInfo | None, str]:
    """The clock of stamps without an offset, and a note on it; ``None`` is UTC."""
    if clock is not None:
        try:
            return ZoneInfo(str(clock)), f"times read on the clock of {clock}"
        except (ZoneInfoNotFoundError, ValueError, OSError) as error:
            msg = f"{table.file}: clock = '{visible(str(clock))}' is no time zone of the IANA database. Write a name such as Europe/Paris."
            raise TaskError(msg) from error
    for titles in (time, _titles(table)):  # what the title of the times says counts first
        if outside.says_utc(titles):
            return None, ""
        if re.search(r"\b(CET|MEZ|CEST|MESZ)\b", titles):
            return ZoneInfo(EXCHANGE_CLOCK), f"times read on the clock of {EXCHANGE_CLOCK}, as the titles say CET"
        if (ahead := outside.hours_ahead(titles)) is not None:
            return ZoneInfo(f"Etc/GMT{-ahead:+d}"), f"times read as UTC{ahead:+d} all year, as the titles say"
    return None, ""


def _titles(table: outside.TextTable) -> str:
    """All titles and the lines above them, except lines with a date, such as that of the download."""
    return " ".join((*table.titles, *(line for line in table.preamble if not outside.STAMP.search(line))))


def _price_column(table: outside.TextTable, column: object) -> str:
    """Title of the column of prices. Raises ``TaskError`` when there is none, or several and ``column`` does not say which."""
    if column is not None:
        table.texts(str(column))
        return str(column)
    numeric = []
    for title in table.titles:
        first = next(filter(None, table.texts(title)), "")
        if outside.stamp_in(first) is not None or re.match(r"\d.*\d\s+[-\u2013]\s+\d", first) is not None:
            continue
        values = [outside.parse_number(text, table.decimal) for text in table.texts(title)[:200]]
        if any(value is not None and value == value for value in values) and sum(value is None for value in values) <= 1:
            numeric.append(title)
    by_rank = (
        [title for title in numeric if re.search(r"day.?ahead", title, re.IGNORECASE)],
        [title for title in numeric if _UNIT.search(title)],
        [title for title in numeric if _PRICE.search(title)],
        [title for title in numeric if not re.search(r"sequence|period|volume|mw\b", title, re.IGNORECASE)],
    )
    candidates = next((titles for titles in by_rank if titles), [])
    if len(candidates) != 1:
        what = "no column holds prices" if not candidates else "it is unclear which column holds the prices"
        titles = visible(", ".join(table.titles)[:400])
        table.refuse(f'{what}; its columns are {titles}. Name it: column = "..." in the price table (or --column). {_PLAIN_FILE}')
    return candidates[0]


def _days_of_hours(table: outside.TextTable, titles: list[str], zone: ZoneInfo) -> tuple[outside.IntArray, outside.FloatArray]:
    """Moments and prices of a table with a row a day and a column an hour, in which the hour that comes twice has columns A and B."""
    dates = outside.read_stamps(table, table.titles[:1]).seconds
    days, first = np.unique(dates, return_index=True)
    if days.size < dates.size:
        again = int(np.setdiff1d(np.arange(dates.size), first)[0])
        table.refuse(f"{visible(table.texts(table.titles[0])[again])} appears twice. Keep one row for each day.", again, table.titles[0])
    columns, hours = {title: table.numbers(title) for title in titles}, [_EPEX_HOUR.fullmatch(title).groups() for title in titles]  # type: ignore[union-attr]
    lowest, numbered = min(int(hour) for hour, _ in hours), len(titles) == 25 and not any(part for _, part in hours)
    rows: list[tuple[int, float]] = []
    for row in np.argsort(dates, kind="stable").tolist():
        begin, end = (int(outside.utc_of_local(table, dates[row : row + 1] + day, zone, table.titles[0])[0]) for day in (0, outside.DAY))
        moments, prices = range(begin, end, outside.HOUR), [float(columns[title][row]) for title in titles]
        by_clock = {(int(hour) - lowest, part.upper()): price for (hour, part), price in zip(hours, prices, strict=True)}
        local = [dt.datetime.fromtimestamp(moment, zone).hour for moment in moments]
        parts = ["B" if hour in local[:place] else "A" for place, hour in enumerate(local)]  # B: the hour comes again
        present = [by_clock.get((hour, part), by_clock.get((hour, ""), np.nan)) for hour, part in zip(local, parts, strict=True)]
        skipped = [price for hour, price in by_clock.items() if hour[0] not in local and not np.isnan(price)]
        if numbered or (len(local) == len(titles) - 1 and skipped and np.isnan(prices[-1])):  # numbers, whatever the clock does
            present = prices[: len(local)]
        rows += zip(moments, present, strict=True)
    return np.array([moment for moment, _ in rows], dtype=np.int64), np.array([price for _, price in rows])


def _conversion(table: outside.TextTable, title: str, unit: object, file_unit: object) -> tuple[float, str, str]:
    """Factor from the file's prices to those of the table, the table's unit, and a note on it."""
    match = (
        _UNIT.search(str(file_unit))
        if file_unit is not None
        else _UNIT.search(title) or next((above for line in table.preamble if (above := _UNIT.search(line))), None)
    )
    target = None if unit is None else _UNIT.search(str(unit))
    if match is None:
        if file_unit is not None:
            refuse(f"{table.file}: '{visible(str(file_unit))}' is not a unit of prices such as EUR/MWh, ct/kWh or EUR/m3.", TaskError)
        if unit is None:
            table.refuse('neither the file nor the price table has a unit: write unit = "EUR kWh-1" in the table.')
        if len(table.titles) > 2 or title.lower() != "price":
            table.refuse(
                f"the title '{visible(title)}' has no unit of prices. Name it: file_unit = \"EUR/MWh\" in the price table (or "
                f"--file-unit). {_PLAIN_FILE}"
            )
        return 1.0, str(unit), ""
    if unit is None:
        table.refuse(f'the file is in {visible(match[0])}, and the price table has no unit: write unit = "EUR kWh-1" in it.')
    cents = ("C", "C€", "CT", "CTS", "CENT")
    money = {"€": "EUR", "EURO": "EUR", "EUROS": "EUR", "$": "USD", "£": "GBP", **dict.fromkeys(cents, "EUR")}
    currency = money.get(match["money"].upper(), match["money"].upper())
    amounts = {name.lower(): entry for name, entry in _AMOUNTS.items()}
    amount, factor = amounts[_amount(match)]
    table_amount, table_factor = amounts[_amount(target)] if target else ("", 1.0)
    if target is None or money.get(target["money"].upper(), target["money"].upper()) != currency or table_amount != amount:
        table.refuse(f"its prices are in {visible(match[0])}, which cannot become {visible(str(unit))}. {_PLAIN_FILE}")
    hundredths = (match["money"].upper() in cents) - (target["money"].upper() in cents)
    total = factor / table_factor * 0.01**hundredths
    return total, str(unit), "" if total == 1.0 else f"{visible(match[0])} converted to {unit}"
