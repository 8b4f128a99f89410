"""Series of prices: what they cover in words, and the hours of a task in their gaps, where an old price is charged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.tasks.prices import PriceTable

if TYPE_CHECKING:
    from glbench.tasks.spec import TaskSpec

_HOUR, _DAY_SECONDS = np.timedelta64(1, "h"), 86400
_USUAL = 4
"""A price may be this many times as old as the series' prices usually grow, and a day old at least: monthly prices are no gaps."""
Moments = NDArray[np.datetime64]


def series_in_words(task: TaskSpec) -> list[str]:
    """Of each series of prices: the dates that it covers, and its mean, lowest and highest price."""
    return [
        f"Price '{name}': {len(table.series):,} prices from {table.series[0][0]:%Y-%m-%d %H:%M} to {table.series[-1][0]:%Y-%m-%d %H:%M} "
        f"UTC{', repeated every year' if table.yearly else ''}; mean {_mean(table):.4g}, lowest {table.limits[0]:.4g}, highest "
        f"{table.limits[1]:.4g} {table.unit}."
        for name, table in task.price_tables.items()
        if table.series
    ]


def stale_prices(task: TaskSpec) -> list[str]:
    """What is missing in each series of prices for the hours that the task's runs may use; empty when nothing is."""
    tables = {name: table for name, table in task.price_tables.items() if table.series and not table.source}
    if not tables:
        return []
    hours = _hours_of(task)
    found = []
    for name, table in tables.items():
        stale = hours[_is_stale(table, hours)]
        if stale.size:
            found.append(
                f"{task.source}: [price_tables.{name}] has no price for {stale.size:,} of the {hours.size:,} hours that runs may use, "
                f"the first of them {stale[0].item():%Y-%m-%d %H:%M} UTC. The nearest price before them (or the first of all) is "
                "charged. List the missing hours."
            )
    return found


def _mean(table: PriceTable) -> float:
    return float(np.mean([price for _, price in table.series])) * table.times + table.plus


def _hours_of(task: TaskSpec) -> Moments:
    """Every hour [UTC] that a run may use, of all splits, in order."""
    splits = [task] if task.splits is None else [task.in_split(name) for name in task.splits.names]
    hours = set()
    for one in splits:
        scenario = one.scenario
        days = task.weather.days + scenario.start_within_days
        for season in scenario.seasons:
            begin = np.datetime64(season.start, "h")
            hours.update((begin + np.arange(24 * days) * _HOUR).tolist())
    return np.array(sorted(hours), dtype="datetime64[h]")


def _is_stale(table: PriceTable, hours: Moments) -> NDArray[np.bool_]:
    points = np.array([moment.replace(tzinfo=None) for moment, _ in table.series], dtype="datetime64[s]")
    if points.size < 2:
        return np.zeros(hours.size, dtype=bool) if table.yearly else np.asarray(hours < points[0])
    usual = int(np.median(np.diff(points).astype(np.int64)))
    longest = np.timedelta64(max(_DAY_SECONDS, _USUAL * usual), "s")
    moments = hours.astype("datetime64[s]")
    if table.yearly:
        year = points[0].astype("datetime64[Y]")
        length = (year + 1).astype("datetime64[s]") - year.astype("datetime64[s]")
        moments = year.astype("datetime64[s]") + (moments - moments.astype("datetime64[Y]").astype("datetime64[s]"))
        points = np.concatenate([points - length, points, points + length])
    place = np.searchsorted(points, moments, side="right") - 1
    return np.asarray((place < 0) | (moments - points[np.maximum(place, 0)] > longest))
