"""Prices of power markets in the hours to come: as they are known, and otherwise as predicted from sun, wind and the last price.

A market's price less what hour, weekday, sun and wind explain (``glbench.tasks.prices``) is an autocorrelated path. It is known in hours
whose price was shown, between them it is interpolated, and after them it fades. The weather of hours to come is that of an outlook.

The weekday of a run is learnt from its prices, because its year may be another than that of the task's dates: each of the seven is as
likely as the steps of the path that follow from it.
"""

from __future__ import annotations

import numpy as np

from glbench.arrays import Floats
from glbench.tasks import TaskSpec
from glbench.tasks.prices import RADIATION, SHAPE, WIND
from glbench.weather.preprocessing import utc_offsets

_HOUR, _DAY = 3600, 86400
_ERROR = 0.1
"""Standard deviation of what readings of sun and wind get wrong about an hour's share of the level."""


class PriceForecast:
    """Prices that follow a market, in n runs of a task that begin at the times ``begin`` ``(n,)`` [s since 1970]."""

    def __init__(self, task: TaskSpec, names: list[str], clock: str, begin: Floats) -> None:
        self.tables = {name: table for name, table in task.price_tables.items() if table.market is not None}
        self._clock, self._step, self._begin = clock, int(task.step_seconds), begin.astype(np.int64)
        self._days, self._hour_of_day = (np.zeros((len(begin), 0), np.int64) for _ in range(2))
        self._markets = {table.source or name: table.market for name, table in self.tables.items() if table.market is not None}
        own_last = sorted(self.tables.items(), key=lambda item: not item[1].source)  # a market's own table overrides those that follow it
        titles = ((name, ahead, f"price_{name}" + f"_in_{ahead}h" * (ahead > 0), table) for name, table in own_last for ahead in range(25))
        self._columns = [
            (table.source or name, ahead, names.index(title), table)
            for name, ahead, title, table in titles
            if title in names and table.times
        ]
        self._prices = {market: np.zeros((len(begin), 0)) for market in self._markets}
        self._weather = np.zeros((len(begin), 0, 2))  # mean radiation and wind of hours, as far as they were seen
        self._likely = {market: np.zeros((len(begin), 7)) for market in self._markets}  # log-likelihood of the weekdays

    def _make_room(self, hours: int) -> None:
        """Room for what is known of the first ``hours`` hours, as yet nothing."""
        if hours <= self._days.shape[1]:
            return
        times = self._begin[:, None] + _HOUR * np.arange(self._days.shape[1], 2 * hours)
        local = times + utc_offsets(times, self._clock)
        self._days = np.append(self._days, local // _DAY, axis=1)
        self._hour_of_day = np.append(self._hour_of_day, local % _DAY // _HOUR, axis=1)
        self._weather = np.append(self._weather, np.full((*times.shape, 2), np.nan), axis=1)
        self._prices = {market: np.append(prices, np.full(times.shape, np.nan), axis=1) for market, prices in self._prices.items()}

    def update(self, k: int, observed: Floats, weather: Floats) -> None:
        """Take in what is shown at the start of step ``k`` ``(n, columns)``, and its radiation and wind [W m-2, m s-1] ``(n, 2)``."""
        if not self.tables:
            return
        self._make_room(k * self._step // _HOUR + 25)
        runs = np.arange(len(observed))
        place = k * self._step // _HOUR + np.zeros(len(observed), np.int64)
        new = k == 0 or (k - 1) * self._step // _HOUR < place[0]
        count = (k * self._step % _HOUR) // self._step
        self._weather[runs, place] = weather if new else (self._weather[runs, place] * count + weather) / (count + 1)
        for market, ahead, column, table in self._columns:
            until_midnight = self._days[runs, place + ahead] == self._days[runs, place]
            rows = np.flatnonzero(until_midnight & np.isfinite(observed[:, column]))
            self._prices[market][rows, place[rows] + ahead] = (observed[rows, column] - table.plus) / table.times
        for market in self._markets if new and place[0] > 1 else ():
            self._learn_weekday(market, int(place[0]) - 1)

    def _learn_weekday(self, market: str, hour: int) -> None:
        """Weigh the seven weekdays by the step of the path to an hour that is over."""
        table = self._markets[market]
        there = slice(hour - 1, hour + 1)
        rest = self._prices[market][:, there] / table.level - self._explained(market, self._weather[:, there], there)
        rest = rest[..., None] - table.weekend * self._weekends(there)  # a share of the level; NaN where the price is not known
        step = rest[:, 1] - table.persistence * rest[:, 0]
        spread = table.spread**2 * (1.0 - table.persistence**2) + _ERROR**2
        self._likely[market] -= np.nan_to_num(step**2) / (2.0 * spread)

    def _weekends(self, hours: slice) -> Floats:
        """Whether hours are of a weekend, 1 or 0, if their dates are so many weekdays early ``(n, hours, 7)``."""
        return ((self._days[:, hours, None] + 3 + np.arange(7)) % 7 >= 5).astype(np.float64)

    def _explained(self, market: str, weather: Floats, hours: slice) -> Floats:
        table = self._markets[market]
        shape = np.array(table.shape or SHAPE)[self._hour_of_day[:, hours]]
        return shape - table.sun * (weather[..., 0] / RADIATION) - table.wind * ((weather[..., 1] - WIND) / WIND)

    def ahead(self, k: int, weather: Floats) -> dict[str, Floats]:
        """Prices of every table that follows a market, in the steps from ``k`` on and at the end of the last ``(n, T + 1)``.

        ``weather`` is the radiation and wind expected in these steps ``(n, T, 2)``.
        """
        n, steps = weather.shape[:2]
        first = k * self._step // _HOUR
        place = (k + np.arange(steps + 1)) * self._step // _HOUR - first
        hours = slice(first, first + int(place[-1]) + 1)
        self._make_room(hours.stop)
        mean = np.full((n, int(place[-1]) + 1, 2), np.nan)
        starts = np.flatnonzero(np.diff(place[:-1], prepend=-1))
        mean[:, : len(starts)] = np.add.reduceat(weather, starts, axis=1) / np.diff([*starts, steps])[:, None]
        mean[:, len(starts) :] = mean[:, [len(starts) - 1]]
        mean[:, 0] = np.where(np.isnan(self._weather[:, first]), mean[:, 0], self._weather[:, first])
        expected = {market: self._expected(market, mean, hours)[:, place] for market in self._markets}
        tables = self.tables.items()
        return {name: expected[table.source or name] * table.times + table.plus for name, table in tables}

    def _expected(self, market: str, weather: Floats, hours: slice) -> Floats:
        """Prices of hours, the first of which is now ``(n, hours)``."""
        table, prices, likely = self._markets[market], self._prices[market][:, hours], self._likely[market]
        share = np.exp(likely - likely.max(axis=1, keepdims=True))
        share /= share.sum(axis=1, keepdims=True)
        explained = self._explained(market, weather, hours) + table.weekend * (self._weekends(hours) * share[:, None]).sum(axis=-1)
        path = _faded(prices / table.level - explained, table.persistence)
        return np.where(np.isnan(prices), np.clip(table.level * (explained + path), table.lowest, table.highest), prices)


def _faded(path: Floats, persistence: float) -> Floats:
    """A path ``(n, hours)`` whose missing values are interpolated, fade after the last one, and are 0 where there is none."""
    hours = np.arange(path.shape[1])
    filled = np.zeros_like(path)
    for run, row in enumerate(path):
        there = np.flatnonzero(np.isfinite(row))
        if there.size:
            filled[run] = np.interp(hours, there, row[there]) * persistence ** np.maximum(hours - there[-1], 0)
    return filled
