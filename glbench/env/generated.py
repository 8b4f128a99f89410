"""Generated seasons of a task: the weather of each by its number, and the days on which they start.

A season belongs to its number: every run in it has the same weather, the same first day and the same forecasts. It is a function of
the task's family, split, salt and that number.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.forecast import ForecastTable
from glbench.env.random import ar1_paths, uniforms
from glbench.env.uncertainty import season_key
from glbench.errors import GlbenchError, TaskError, refuse
from glbench.tasks import TaskSpec
from glbench.weather import COLUMNS, GeneratedSeason, SeasonGenerator, disturbances
from glbench.weather.preprocessing import co2_density

GOLDEN = 0.6180339887498949
"""Steps of this size, modulo 1, spread any number of points evenly over an interval."""

CO2_PERSISTENCE = 0.979
"""Of the CO2 outside from one hour to the next: it forgets within two days."""

_TEMPERATURE, _CO2 = COLUMNS.index("tOut"), COLUMNS.index("co2Out")


@dataclass(frozen=True, eq=False)
class MadeSeason:
    """Disturbances of a season ``(rows, d)``, the nominal start of each row [UTC], and the days that it was made of."""

    values: Floats
    times: NDArray[np.datetime64]
    days: GeneratedSeason


class SeasonMaker:
    """Makes the generated seasons of ``task`` in its split.

    Raises ``TaskError`` when the weather record does not have the years of the split. ``begin`` is when the first possible day begins, UTC.
    Seasons begin whole days of 24 hours later: its rows are those of the task's calendar also where the clock changes in between.
    """

    def __init__(self, task: TaskSpec, begin: np.datetime64) -> None:
        generated = task.scenario.generated
        assert generated is not None
        self._begin = begin.astype("datetime64[s]").astype(dt.datetime).replace(tzinfo=dt.UTC)
        self._task, self._generated = task, generated
        self._forecast = ForecastTable.of(task)
        self._late = task.scenario.start_within_days
        try:
            self._generator = SeasonGenerator(task.season_record(), generated.years)
        except GlbenchError as error:
            refuse(f"{task.source}: [splits.{task.split}] {error}", TaskError, error)

    def start_days(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Days from the first possible day to the first day of each season; the first m of them are spread evenly, for every m."""
        shift = self._uniforms("start days", 1, "all seasons")[0]
        share = (shift + numbers * GOLDEN) % 1.0
        late: NDArray[np.int64] = np.floor(share * (self._late + 1)).astype(np.int64)
        return late

    def season(self, number: int, rows: int) -> MadeSeason:
        """The season ``number``: ``rows`` rows from its first day on, and those that a forecast reaches after them."""
        task, weather = self._task, self._task.weather
        late = dt.timedelta(days=int(self.start_days(np.array([number]))[0]))
        total = rows + (self._forecast.reach if self._forecast is not None else 0)
        days = -(-total // task.steps_per_day)
        source = self._generator.season(
            weather.start + late, days, self._uniforms("weather", self._generator.numbers(days), f"season {number}")
        )
        record = disturbances(
            source.record,
            start=self._begin + late,
            steps=total,
            step_seconds=float(weather.step_seconds),
            preprocessing=weather.preprocessing,
            co2_ppm=weather.co2_ppm,
        )
        values = np.array(record.values)
        if self._generated.co2_range is not None:
            low, high = self._generated.co2_range
            every = max(3600 // weather.step_seconds, 1)
            key = season_key(task.scenario, "CO2 outside", f"season {number}")
            path = ar1_paths(key, -(-total // every), np.array([CO2_PERSISTENCE]))[:, 0]
            middle, half = (low + high) / 2.0, (high - low) / 2.0
            ppm = np.repeat(middle + half * np.clip(path / 2.0, -1.0, 1.0), every)[:total]  # never leaves its range
            values[:, _CO2] = co2_density(values[:, _TEMPERATURE], ppm)
        return MadeSeason(values, record.times, source)

    def year(self, number: int) -> int:
        """The year with the most days in the season ``number``; if two have equally many, the earlier."""
        days = self._task.weather.days
        late = dt.timedelta(days=int(self.start_days(np.array([number]))[0]))
        numbers = self._uniforms("weather", self._generator.numbers(days), f"season {number}")
        return int(np.bincount(self._generator.source_years(self._task.weather.start + late, days, numbers)).argmax())

    def _uniforms(self, stream: str, count: int, which: str) -> Floats:
        key = season_key(self._task.scenario, stream, which)
        numbers: Floats = uniforms(key, np.zeros((1, 1), np.int64), count)[0, 0]
        return numbers
