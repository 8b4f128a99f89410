"""Forecasts with errors: the coming weather plus an autocorrelated error.

A forecast is issued at every full hour and holds until the next one. Its column for h hours ahead is the mean over the hour that ends h
hours after the issue, plus the error

    e(i, h) = a(i + h) - phi**h a(i),      a(i) = phi a(i - 1) + s sqrt(1 - phi**2) w(i)

with one path a for each quantity and season. Forecasts of one hour that are issued after each other therefore agree the better the nearer
that hour is, as those of a weather service do, and the error has the standard deviation s sqrt(1 - phi**(2 h)). Radiation errs in units of
that under a clear sky. Sizes are round numbers, chosen; they define the task and claim no more.

A forecast stays within limits: radiation between 0 and a clear sky, humidity between 0 and 100 %, wind not below 0. Cut off there, it is
off on average (docs/uncertainty.md has by how much, and pictures). An unbiased one limits the error instead, to the distance m of the
truth q from the nearer limit: q + min(max(e, -m), m). Errors e and -e are equally likely, so the mean error is 0 whatever comes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.random import ar1_paths
from glbench.env.uncertainty import season_key
from glbench.errors import TaskError, refuse
from glbench.tasks import TaskSpec
from glbench.tasks.quantities import FORECAST
from glbench.weather import Place
from glbench.weather.generator import calendar_days, clear_sky

HOUR = 3600

LEVELS = {"none": 0.0, "low": 0.5, "medium": 1.0, "high": 2.0, "perfect": 0.0}
"""Factor on all errors. "none" shows the weather of now instead."""

SPREAD = (0.18, 2.0, 8.5, 1.25)
"""Standard deviation s at the level medium: radiation [of a clear sky's], temperature [K], relative humidity [%], wind [m s-1]."""

PERSISTENCE = (0.90, 0.955, 0.95, 0.94)
"""phi from one hour to the next, in the same order."""

_RADIATION, _TEMPERATURE, _HUMIDITY, _WIND = range(4)
_MEASURED = [0, 1, 2, 4]  # their columns in ``WeatherTables.measured``


@dataclass(frozen=True, eq=False)
class ForecastTable:
    """What fills the forecast's rows of a task's pool."""

    hours: tuple[int, ...]
    """Hours ahead."""
    level: str
    """One of ``LEVELS``."""
    every: int
    """Steps an hour."""
    reach: int
    """Rows after a season that the forecast at its end needs, whole days."""
    columns: int
    """Of a row of the table."""
    task: TaskSpec
    place: Place
    unbiased: bool = False
    """Whether the error is limited alike on both sides."""

    @staticmethod
    def of(task: TaskSpec) -> ForecastTable | None:
        """The task's forecast; ``None`` where it grants none by the hour. Raises ``TaskError`` unless its step divides an hour."""
        hours = task.observation.forecast_hours
        if not hours:
            return None
        step = task.weather.step_seconds
        if HOUR % step:
            refuse(f"{task.source}: [observation.forecast] goes by the hour; step_seconds = {step} does not divide it. Use 900.", TaskError)
        reach = -(-hours[-1] // 24) * task.steps_per_day
        table = task.observation.forecast
        assert table is not None  # tasks with hours have it
        columns, place = len(FORECAST) * len(hours), task.season_record().place
        return ForecastTable(hours, table.error, HOUR // step, reach, columns, task, place, table.unbiased)

    def _clear_sky(self, times: NDArray[np.datetime64]) -> Floats:
        """Global radiation under a clear sky [W m-2] in the hours that ``times`` begin, which may be half hours of UTC."""
        past = int((times[0] - times[0].astype("datetime64[h]")).astype("timedelta64[s]").astype(np.int64))
        clock = times - np.timedelta64(past, "s")
        days = clock.astype("datetime64[D]")
        hours = (clock - days).astype("timedelta64[h]").astype(np.int64)
        clear: Floats = clear_sky(self.place, -past)[calendar_days(days.astype(np.int64)), hours]
        return clear

    def fill(self, table: NDArray[np.float32], first: int, rows: int, measured: Floats, times: NDArray[np.datetime64], season: int) -> None:
        """Write the forecasts of a season into ``table``.

        The table is ``(rows of the pool // every, columns)``. ``first`` is the season's first row in the pool, and ``rows`` how many it has
        there, whole hours; ``measured`` its weather as measured (``WeatherTables.measured``) ``(rows + reach, 5)``, ``times`` the start of
        each of these rows, UTC, and ``season`` its number.
        """
        issues = rows // self.every
        weather = measured[: len(measured) // self.every * self.every, _MEASURED]
        hourly = weather.reshape(-1, self.every, len(FORECAST)).mean(axis=1)
        clear = self._clear_sky(times[: len(hourly) * self.every : self.every])
        forecasts = np.empty((issues, len(FORECAST), len(self.hours)))
        errors = self._errors(issues, len(hourly), season)
        now = weather[: issues * self.every : self.every]
        least, most = np.array([0.0, -np.inf, 0.0, 0.0]), np.full(hourly.shape, np.inf)
        most[:, _RADIATION], most[:, _HUMIDITY] = np.maximum(clear, hourly[:, _RADIATION]), 100.0
        for column, hour in enumerate(self.hours):
            if self.level == "none":
                forecasts[:, :, column] = now
                continue
            ahead = slice(hour - 1, hour - 1 + issues)  # the hour that ends ``hour`` hours after the issue
            true, error = hourly[ahead], errors[:, :, column].copy()
            error[:, _RADIATION] *= clear[ahead]
            if self.unbiased:
                room = np.minimum(true - least, most[ahead] - true)
                error = np.clip(error, -room, room)
            forecasts[:, :, column] = np.clip(true + error, least, most[ahead])
        at = first // self.every
        table[at : at + issues] = forecasts.reshape(issues, self.columns)

    def _errors(self, issues: int, hours: int, season: int) -> Floats:
        """Errors ``(issues, 4, hours ahead)``; those of radiation in units of that under a clear sky."""
        factor = LEVELS[self.level]
        errors = np.zeros((issues, len(FORECAST), len(self.hours)))
        if factor == 0.0:
            return errors
        key = season_key(self.task.scenario, "forecast errors", f"season {season}")
        path = ar1_paths(key, hours + 1, np.array(PERSISTENCE)) * (np.array(SPREAD) * factor)
        for quantity, phi in enumerate(PERSISTENCE):
            a = path[:, quantity]
            faded, hour = 1.0, 0
            for column, ahead in enumerate(self.hours):
                while hour < ahead:
                    faded, hour = faded * phi, hour + 1
                errors[:, quantity, column] = a[ahead : ahead + issues] - faded * a[:issues]
        return errors
