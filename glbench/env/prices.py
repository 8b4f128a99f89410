"""Prices of a task's runs by row of their calendar: what the ledger pays, and what is shown of them.

A market's prices belong to a season, because its sun and wind make them. What nothing explains is a path of the season's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.uncertainty import season_key
from glbench.env.wandering import wandering
from glbench.errors import TaskError
from glbench.tasks.prices import SeasonOfPrices, day_ahead, price_rows
from glbench.tasks.vocabulary import DAY_AHEAD, PRICES

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

HOUR = 3600
_RADIATION, _WIND = 0, 4  # their columns in ``WeatherTables.measured``


@dataclass(frozen=True, eq=False)
class SeasonPrices:
    """What fills the prices of a task's pool.

    Attributes
    ----------
    task
        The task.
    every
        Steps an hour.
    shown
        Width of the table of prices of now, and of that of coming hours: 0 for what nobody sees.
    by_season
        Whether each season has prices of its own.
    """

    task: TaskSpec
    every: int
    shown: tuple[int, int]
    by_season: bool

    @staticmethod
    def of(task: TaskSpec) -> SeasonPrices:
        """The prices of a task, which may be none.

        Raises
        ------
        TaskError
            When prices go by the hour and a control step does not divide an hour.
        """
        tables, ahead = task.price_tables, task.day_ahead
        seen = task.observation.modules
        markets = [name for name, table in tables.items() if table.market is not None]
        step = task.weather.step_seconds
        by_hour = [
            *(f"price_tables.{name}" for name in markets),
            *(["observation.day_ahead"] if ahead is not None else []),
        ]
        if by_hour and HOUR % step:
            msg = f"{task.source}: [{by_hour[0]}] is hourly; step_seconds = {step} does not divide an hour. Use 900."
            raise TaskError(msg)
        coming = 0 if ahead is None or DAY_AHEAD not in seen else len(ahead.prices) * len(ahead.hours)
        return SeasonPrices(task, max(HOUR // step, 1), (len(tables) if PRICES in seen else 0, coming), bool(markets))

    def room(self, rows: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Tables of the prices of now and of coming hours for so many rows of a calendar."""
        now, coming = (np.zeros((rows if width else 0, width), np.float32) for width in self.shown)
        return now, coming

    def rows(
        self, number: int, times: NDArray[np.datetime64], hour_of_day: Floats, measured: NDArray[np.floating]
    ) -> Floats:
        """Prices at each row of the calendar of the season ``number``, ``(rows, price tables)``.

        Parameters
        ----------
        number
            Of the season.
        times, hour_of_day
            Start [UTC] and hour of day of each row, ``(rows,)``.
        measured
            The season's weather as measured (``WeatherTables.measured``), ``(rows, 5)``.
        """
        tables, season = self.task.price_tables, None
        if self.by_season:
            hours = -(-len(times) // self.every)
            paths = {
                table.source or name: wandering(
                    season_key(self.task.scenario, f"price {table.source or name}", f"season {number}"),
                    hours,
                    np.array([table.market.persistence]),
                )[:, 0]
                for name, table in tables.items()
                if table.market is not None
            }
            weather = np.asarray(measured, np.float64)
            season = SeasonOfPrices(self.every, weather[:, _RADIATION], weather[:, _WIND], paths)
        return price_rows(tables, tables, times, hour_of_day, season)

    def show(
        self,
        tables: tuple[NDArray[np.float32], NDArray[np.float32]],
        at: slice,
        prices: Floats,
        times: NDArray[np.datetime64],
        hour_of_day: Floats,
    ) -> None:
        """Write what is seen of a season's prices into the rows ``at`` of the tables that ``room`` gave."""
        now, coming = tables
        if len(now):
            now[at] = prices
        if len(coming):
            ahead, names = self.task.day_ahead, list(self.task.price_tables)
            assert ahead is not None
            columns = [
                day_ahead(prices[:, names.index(name)], times, hour_of_day, self.every, ahead.hours)
                for name in ahead.prices
            ]
            coming[at] = np.concatenate(columns, axis=1)
