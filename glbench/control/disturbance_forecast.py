"""Predicts the disturbances of the next steps from past observations.

What is observed now acts in the next step. From there on the outlook is the mean day of the time of the year (``Climatology``), plus a
share of the deviation from it that is observed now, plus a share of the one that the forecast tells where the task shows one; the
shares are those that served best in the training years, by quantity and hours ahead. Rows of coming weather that a task shows as they are
(``forecast``) are taken as they are. Radiation deviates as a share of what a clear sky gives.

Nobody observes the temperature of the sky. It follows from the means, the clearness of the recent daylight, temperature and humidity. The
soil's is a sine of the time of the year. Columns that no equation of the model reads are 0.

A reading that is missing (NaN) is taken to be what the outlook expected it to be. Where the task says that a sensor of the weather is off
by a factor, its readings are divided by the middle of the factors.

A run may be in another year than that of the task's dates, with other weekdays. They are learnt from the scheduled controls that are shown.
"""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.arrays import Floats
from glbench.control.climatology import CLEARNESS, CO2, HUMIDITY, TEMPERATURE, WIND, Climatology, WeatherObservation
from glbench.control.observation_model import ObservationModel, checked_observations, refuse_missing
from glbench.control.price_forecast import PriceForecast
from glbench.control.scenario import with_schedule
from glbench.env.actuation import run_calendar
from glbench.env.forecast import HOUR
from glbench.env.memory_layout import DrawPlaces
from glbench.env.outdoor import MEASURED, OutdoorSensors
from glbench.env.spaces import the_task
from glbench.env.weather_pool import DAYS_A_YEAR, HOURS_A_DAY
from glbench.errors import TaskError, refuse, whole_number
from glbench.tasks import TaskSpec
from glbench.tasks.quantities import FORECAST
from glbench.tasks.schedule import schedule_rows
from glbench.tasks.vocabulary import WEEKDAYS
from glbench.untrusted import quoted
from glbench.weather.preprocessing import co2_density, seconds_into_year, soil_temperature, to_utc_seconds, utc_offsets, vapour_pressure

_UNUSED = ("dayRadSum", "isDay", "isDaySmooth")
_BRIGHTEST = 1.1
"""Radiation is at most so much of that under a clear sky."""
_DRIEST = 5.0
_SUN_AND_WIND = [MEASURED.index("global_radiation"), MEASURED.index("wind_speed")]


@dataclass(frozen=True, eq=False)
class Ahead:
    """The coming T steps of n runs."""

    d: Floats
    """Disturbances of each step as the kernel takes them ``(n, T, d)``; ``d[:, 0]`` act next."""
    calendar: Floats
    """Hour of day, day of year, prices and scheduled controls at the start of each step and at the end of the last ``(n, T + 1, columns)``:
    what ``StageReward`` and ``PredictiveController`` take."""


class Outlook:
    """What comes in runs of a task, from their observations.

    It knows what its agent does: task, observations and climatology. It works inside the sandbox. A new one is as after ``reset(1)``.

    Raises ``TaskError`` when the task does not show weather and time, the climatology is for other weather or other forecasts, or the model
    has disturbances of its own. ``climatology`` is that of its training years, or of another task with the same weather.

    ``past`` are the disturbances of the step just past ``(n, d)``; before the first step those of the step to come.
    """

    def __init__(self, task: TaskSpec | str, climatology: Climatology) -> None:
        self.task, self.climatology = the_task(task), climatology
        task = self.task
        if not isinstance(climatology, Climatology):
            msg = (
                f"The climatology of an Outlook is a Climatology; got {quoted(climatology)}. Make one, Climatology.of(task), or read one "
                "from a file, Climatology.read(path)."
            )
            raise TaskError(msg)
        self._names = names = [column.name for column in task.observed()]
        missing = [name for name in MEASURED if name not in names]
        if missing:
            refuse(f"{task.id} does not show {', '.join(missing)}: an outlook needs the weather of now.", TaskError)
        self._weather = [names.index(name) for name in MEASURED]
        by_module = (("hour_of_day", "day_of_year"), ("sin_hour_of_day", "cos_hour_of_day", "sin_day_of_year", "cos_day_of_year"))
        clock = next((columns for columns in by_module if all(name in names for name in columns)), None)
        if clock is None:
            refuse(f"{task.id} shows neither the hour of day nor the day of year: an outlook needs them. Add the module 'time'.", TaskError)
        self._clock_columns = [names.index(name) for name in clock]
        climatology.check_for(task)
        hours = task.observation.forecast_hours
        if hours and hours != climatology.forecast_hours:
            msg = (
                f"The climatology of {climatology.task} knows forecasts of the hours {climatology.forecast_hours}, "
                f"and {task.id} has those of {hours}. Make one: Climatology.of(task)."
            )
            raise TaskError(msg)
        self._forecast = np.array([[names.index(f"{one.name}_in_{hour}h") for hour in hours] for one in FORECAST] if hours else [], np.intp)
        self._rows_ahead = [
            (ahead, quantity, names.index(f"{name}_ahead_{ahead}"))
            for ahead in range(1, task.observation.forecast_steps + 1)
            for quantity, name in enumerate(MEASURED)
            if f"{name}_ahead_{ahead}" in names
        ]
        predictable = ("iGlob", "tOut", "vpOut", "co2Out", "wind", "tSky", "tSoOut", *_UNUSED)
        odd = [name for name in task.model_value.disturbance_names if name not in predictable]
        if odd:
            refuse(f"The outlook knows nothing of {', '.join(odd)}, which acts on {task.model_id}.", TaskError)
        model = ObservationModel(task)
        self._controls = model if model.control_columns is not None and any(entry.weekdays for entry in task.schedule) else None
        self._late, self._middles = task.observation.timing == "published", OutdoorSensors.of(task, DrawPlaces()).middles
        self._step = task.step_seconds
        self.reset(1)

    def reset(self, n: int) -> None:
        """Begin with ``n`` new runs."""
        self._n = whole_number(n, "The number of runs")
        self._k, self._lag = -1, 0
        self._observed = np.zeros((self._n, 0))
        self._now = np.zeros((self._n, 0))
        self._begin = np.zeros(self._n)
        self._weekdays = np.ones((self._n, len(WEEKDAYS)), np.bool_)
        self._deviations = WeatherObservation(self.climatology, self._n, self._step)
        self.past = np.zeros((self._n, 0))

    def update(self, observations: ArrayLike) -> None:
        """Take in what is observed now: once before the first action, and once after every step.

        Weather that is missing (NaN) is taken to be as expected: at first the mean day, then what the outlook said one step ahead. Hours of
        a forecast that are missing say nothing. The time has to be in the first observation, and is not looked at again.

        Raises ``TaskError`` when the observations have the wrong shape, a reading is infinite, or the first ones lack the time.
        """
        observed = checked_observations(self.task, observations, self._n, self._names)
        first = self._k < 0
        if first:
            self._begin = self._start_times(observed)
            self._k, self._observed = 0, observed
            self._prices = PriceForecast(self.task, self._names, self.climatology.clock, self._begin)
        # With the timing "published" the weather shown is that of the step just past.
        lag = 1 if self._late and not first else 0
        observed[:, self._weather] /= self._middles
        if np.isnan(observed[:, self._weather]).any():
            since = 0 if first else 1 + self._lag - lag
            observed[:, self._weather] = _with_expected(observed[:, self._weather], self._values(np.array([since]))[0][:, 0])
        self._k, self._lag, self._observed = self._k + (not first), lag, observed
        if not (self._late and self._k == 1):  # with "published" the first row is shown twice
            self._deviations.add(self._begin + (self._k - self._lag) * self._step, observed[:, self._weather])
        if self._controls is not None and not first and (self._weekdays.sum(axis=1) > 1).any():
            controls = self._controls.controls(observed)
            for later in range(len(WEEKDAYS)):
                expected = with_schedule(self.task, controls[:, None], self._calendar(np.array([-1, 0]), np.full(self._n, later), {}))[:, 0]
                self._weekdays[:, later] &= ~(np.abs(controls - expected) > 1e-3).any(axis=1)  # NaN says nothing
        self._prices.update(self._k, observed, observed[:, self._weather][:, _SUN_AND_WIND])
        before = self._now
        self._now = self._rows(1 - self._lag)[:, 0]
        self.past = self._now if self._late or self._k == 0 else before

    def ahead(self, steps: int) -> Ahead:
        """The coming ``steps`` steps, as expected now. Raises ``TaskError`` before the first update."""
        steps = whole_number(steps, "The number of steps ahead")
        if self._k < 0:
            refuse("Nothing was observed yet: call update(observations) first.", TaskError)
        prices = {}
        if self._prices.tables and steps > 0:
            prices = self._prices.ahead(self._k, self._values(np.arange(steps) + self._lag)[0][..., _SUN_AND_WIND])
        return Ahead(self._rows(steps), self._calendar(np.arange(steps + 1), self._weekdays.argmax(axis=1), prices))

    def _calendar(self, lags: NDArray[np.int64], later: NDArray[np.intp], expected: Mapping[str, Floats]) -> Floats:
        """Calendar so many steps from now ``(n, lags, columns)``, with weekdays that are ``later`` ``(n,)`` than the dates'.

        Prices of tables that follow a market are ``expected``; without, those of a day without sun.
        """
        k = self._k + lags
        utc = (self._begin[:, None] + k * self._step).astype(np.int64)
        clock = self.climatology.clock
        local = utc if clock == "UTC" else utc + utc_offsets(utc, clock)
        hour = (local % 86400) / 3600.0
        begin = local.astype("datetime64[s]").astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64)
        moments = utc.astype("datetime64[s]").ravel()
        prices = [
            expected[name] if name in expected else table.values(moments, hour.ravel()).reshape(hour.shape)
            for name, table in self.task.price_tables.items()
        ]
        applies = schedule_rows(self.task.schedule, local.astype("datetime64[s]").ravel(), later.repeat(len(lags)))
        columns = np.stack([hour, (local - begin) / 86400.0, *prices, *applies.T.reshape(-1, *hour.shape)], axis=-1)
        return run_calendar(self.task, columns, k)

    def _rows(self, steps: int) -> Floats:
        """Disturbances of ``steps`` steps from now on, with the row shown where that is one of them, or of that row if there are none."""
        lags = np.arange(steps) + self._lag if steps > 0 else np.zeros(1, np.int64)
        values, times, sky = self._values(lags)
        radiation, temperature, humidity, co2, wind = np.moveaxis(values, -1, 0)
        columns = {
            "iGlob": radiation,
            "tOut": temperature,
            "vpOut": vapour_pressure(temperature, humidity),
            "co2Out": co2_density(temperature, co2),
            "wind": wind,
            "tSky": temperature - sky,
            "tSoOut": soil_temperature(seconds_into_year(times + self._step / 2.0)),
        }
        d = np.zeros((self._n, len(lags), len(self.task.model_value.disturbance_names)))
        for place, name in enumerate(self.task.model_value.disturbance_names):
            if name in columns:
                d[..., place] = columns[name]
        return d

    def _values(self, lags: NDArray[np.int64]) -> tuple[Floats, Floats, Floats]:
        """Weather in the columns that are shown, so many steps after the last row shown; its times, and the sky's depression.

        Shapes are ``(n, lags, columns)`` and ``(n, lags)``.
        """
        climate, n = self.climatology, self._n
        last_row = self._begin + (self._k - self._lag) * self._step
        times = last_row[:, None] + lags * self._step
        mean, weights = climate.mean(times), climate.weight(lags * self._step / HOUR)
        now, lately = self._deviations.now[:, None], self._deviations.lately[:, None]
        deviations = weights[..., 0] * now + weights[..., 1] * lately
        if self._forecast.size and lags[-1] > 0:
            issued = np.floor(last_row / HOUR) * HOUR
            forecast = climate.forecast_deviations(self._observed[:, self._forecast], issued, times, lately[:, 0])
            deviations = deviations + weights[..., 2] * forecast
        clear = climate.clear(times)
        values = np.empty((n, len(lags), len(MEASURED)))
        share = np.maximum(1.0 + deviations[..., CLEARNESS], 0.0) * mean[..., CLEARNESS]
        values[..., 0] = np.minimum(clear * share, _BRIGHTEST * clear)
        values[..., 1:] = mean[..., TEMPERATURE : WIND + 1] + deviations[..., TEMPERATURE : WIND + 1]
        values[..., HUMIDITY] = np.clip(values[..., HUMIDITY], _DRIEST, 100.0)
        values[..., CO2:] = np.maximum(values[..., CO2:], 0.0)
        if lags[0] == 0:
            values[:, 0] = _with_expected(self._observed[:, self._weather], values[:, 0])
        for ahead, quantity, column in self._rows_ahead:
            if lags[0] <= ahead <= lags[-1]:
                at = ahead - lags[0]
                values[:, at, quantity] = _with_expected(self._observed[:, column], values[:, at, quantity])
        return values, times, climate.depression(mean, deviations)

    def _start_times(self, observations: Floats) -> Floats:
        """When the runs begin, seconds since 1970 UTC ``(n,)``, in the year that names the task's dates."""
        why = "An outlook needs the time in the first observation of each run: fill it in."
        refuse_missing(observations, self._clock_columns, self.task, self._names, why)
        clock = observations[:, self._clock_columns].T
        if len(clock) == 4:  # sines and cosines
            shares = np.arctan2(clock[::2], clock[1::2]) / (2.0 * np.pi) % 1.0
            clock = np.stack([shares[0] * HOURS_A_DAY, shares[1] * DAYS_A_YEAR])
        hours, days = clock
        step, begin = int(self.task.step_seconds), dt.datetime(self.task.weather.start.year, 1, 1)
        times = []
        for hour, day in zip(hours.tolist(), days.tolist(), strict=True):
            seconds = round(hour * 3600.0 / step) * step
            # The day of year may be rounded down from its beginning.
            moment = begin + dt.timedelta(days=round(day - seconds / 86400.0), seconds=seconds)
            times.append(float(to_utc_seconds(moment, self.climatology.clock)))
        return np.array(times)


def _with_expected(readings: Floats, expected: Floats) -> Floats:
    """Readings, and what is expected where they are missing."""
    return np.where(np.isnan(readings), expected, readings)
