"""The mean days of a task's training years, how fast deviations from them fade, and how far forecasts can be trusted.

Of each time of the year and hour of the day (UTC) it has means: of the radiation as a share of that under a clear sky, of temperature,
humidity, CO2 and wind outside, and of how much colder than the air the sky is. Deviations from these means now, and those that forecasts
tell, are regressed on what came 1 to 24 hours later. All of it is made from the training years, and holds no weather of any one day.

A task without a training split is scored in years of which nothing may be known: its climatology is made of the years of its record
before them, or, where there are none, of the others.

The sun and a clear sky follow from formulas that need nothing but NumPy.
"""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.env.air import read_air
from glbench.env.forecast import HOUR, ForecastTable
from glbench.env.generated import CO2_PERSISTENCE
from glbench.env.spaces import the_task
from glbench.errors import TaskError, WeatherError, refuse
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec
from glbench.tasks.quantities import FORECAST
from glbench.untrusted import reason_of
from glbench.weather import WeatherRecord

QUANTITIES = ("clearness", "outdoor_temperature", "outdoor_relative_humidity", "outdoor_co2", "wind_speed", "sky_depression")
"""What has a mean: share of clear-sky radiation [-], [degC], [%], [ppm], [m s-1], air minus sky temperature [K]."""
CLEARNESS, TEMPERATURE, HUMIDITY, CO2, WIND, SKY = range(6)
LEADS = 25
"""Hours ahead that have a weight of their own, from 0; deviations then fade to nothing within a day."""
APART, REACH = 7, 10
"""Days between two mean days, and days before and after that count for each."""
BRIGHT = 50.0
"""Below this radiation of a clear sky [W m-2] a share of it says nothing."""
RECENT = 3.0
"""Hours of daylight in which the clearness that was seen is forgotten to 1/e."""
LATELY = 24.0
"""Hours in which other deviations are forgotten to 1/e."""
_DIGITS = 5
_RIDGE = 1e-6
_FORECAST = (CLEARNESS, TEMPERATURE, HUMIDITY, WIND)


@dataclass(frozen=True, eq=False)
class Climatology:
    """The mean days of a task's training years, and how fast deviations from them fade."""

    task: str
    """Id of the task."""
    source: str
    preprocessing: str
    """``source`` and ``preprocessing``: weather record of the task, and how it is prepared."""
    years: tuple[int, ...]
    """The years that it was made of."""
    latitude: float
    longitude: float
    clock: str
    """``latitude``, ``longitude`` and ``clock``: of the place [deg], and the time zone of the task's clock, "UTC" or an IANA name."""
    middle: float
    """Seconds from the beginning of a row of weather to the moment whose sun it has."""
    first: int
    """Day of the year that the days are counted from."""
    days: Floats
    """Days since ``first`` that have a mean day ``(days,)``."""
    means: Floats
    """``(days, 24, quantities)`` in the order of ``QUANTITIES``, for the hours of the day in UTC."""
    weights: Floats
    """``(leads, quantities, 3)``: shares that are expected so many hours ahead of the deviation now, of that of late
    (``WeatherObservation``), and of the one that the forecast tells."""
    sky: Floats
    """Change of the sky's depression with the deviations of clearness of late (relative), temperature and humidity ``(3,)``."""
    forecast_hours: tuple[int, ...]
    """Hours of the forecast that the last weights are for."""

    @classmethod
    def of(cls, task: TaskSpec | str, years: tuple[int, ...] | None = None) -> Climatology:
        """The climatology of a task; needs the weather.

        Raises ``TaskError`` when there are no such years. ``years`` are those of its record to learn from; those of its training split
        unless given. Without one those before its seasons, or all others.
        """
        task = the_task(task)
        record = task.record()
        if years is None and task.splits is not None and task.splits.training is not None:
            years = task.splits.training.years
        elif years is None:
            scored = _scored(task)
            others = [year for year in range(record.first.year, record.last.year + 1) if year not in scored]
            years = tuple(year for year in others if year < min(scored)) or tuple(others)
        by_year = {year: _Season.of(task, record, year) for year in years}
        seasons = [season for season in by_year.values() if season is not None]
        years = tuple(year for year, season in by_year.items() if season is not None)
        if not seasons:
            refuse(f"The weather record of {task.id} has no year that a climatology could be made of. Name some: years=...", TaskError)
        weather = task.weather
        bare = cls(
            task.id, weather.source, weather.preprocessing, years, record.latitude, record.longitude,
            record.timezone if _conserving(task) else "UTC", _middle(task), _day_of_year(weather.start), np.zeros(0), np.zeros((0, 24, 6)),
            np.zeros((LEADS, len(QUANTITIES), 3)), np.zeros(3), task.observation.forecast_hours,
        )  # fmt: skip
        mean = bare._with(**_means(bare, task, seasons))
        deviations = _Deviations.of(mean, task, seasons)
        # How the sky's depression follows from recent clearness, temperature and humidity: least squares.
        causes = np.concatenate(
            [np.stack([one.lately[:, CLEARNESS], one.now[:, TEMPERATURE], one.now[:, HUMIDITY]], axis=1) for one in deviations]
        )
        depression = np.concatenate([one.true[:, SKY] for one in deviations])
        sky = np.linalg.solve(causes.T @ causes + _RIDGE * np.eye(3), causes.T @ depression)
        return mean._with(sky=np.round(sky, _DIGITS), weights=_weights(mean, task, seasons, deviations))

    @classmethod
    def of_settings(cls, settings: Mapping[str, Any]) -> Climatology:
        """The climatology of which ``settings`` gave plain values. Raises ``TaskError`` when they are none."""
        try:
            values = {field.name: settings[field.name] for field in fields(cls)}
            for name in ("days", "means", "weights", "sky"):
                values[name] = np.array(values[name], dtype=np.float64)
            values |= {name: tuple(values[name]) for name in ("years", "forecast_hours")}
            climatology = cls(**values)
        except (KeyError, TypeError, ValueError) as error:
            refuse(f"These settings are no climatology: {error}. `Climatology.of(task).write(...)` makes one.", TaskError, error)
        shapes = climatology.means.shape[1:], climatology.weights.shape, climatology.sky.shape
        expected = (24, len(QUANTITIES)), (LEADS, len(QUANTITIES), 3), (3,)
        if shapes != expected or len(climatology.means) != len(climatology.days):
            refuse(f"These settings are no climatology: its tables have the shapes {shapes} for {len(climatology.days)} days.", TaskError)
        return climatology

    def check_for(self, task: TaskSpec) -> None:
        """Refuse a task of other weather. It needs no weather to find out.

        Raises ``TaskError`` when the task's weather is of another record, prepared in another way or in steps of another length, when it is
        of another time of the year, or when the task scores a year that is in the climatology of another task.
        """
        weather, scored = task.weather, sorted(_scored(task) & set(self.years))
        begin = (_day_of_year(weather.start) - self.first + _BEFORE) % _YEAR - _BEFORE
        end = begin + weather.days + task.scenario.start_within_days
        reasons = []
        if weather.source != self.source:
            reasons.append(f"it is of the weather '{self.source}', and the task has '{weather.source}'")
        if weather.preprocessing != self.preprocessing:
            reasons.append(f"it is of weather prepared as '{self.preprocessing}', and the task has '{weather.preprocessing}'")
        elif _middle(task) != self.middle:
            reasons.append(f"its steps are {2.0 * self.middle:g} s long, and those of the task {task.step_seconds:g} s")
        if not (self.days[0] - REACH <= begin and end <= self.days[-1] + REACH):
            new_year = dt.date(2001, 1, 1)
            own, needed = (
                " to ".join(f"{date.day} {date:%B}" for date in (new_year + dt.timedelta(days=int(self.first + day)) for day in days))
                for days in (self.days[[0, -1]], (begin, end))
            )
            reasons.append(f"it has the days from {own}, and the task needs {needed}")
        if scored and self.task != task.id:
            reasons.append(f"it knows {', '.join(map(str, scored))}, which the task scores")
        if reasons:
            refuse(f"The climatology of {self.task} is not for {task.id}: {'; '.join(reasons)}. Make one: Climatology.of(task).", TaskError)

    def without_deviations(self) -> Climatology:
        """The mean days alone: nothing that is seen or forecast changes what is expected after the row of now."""
        return self._with(weights=np.zeros_like(self.weights))

    def settings(self) -> dict[str, Any]:
        """All of it as plain JSON values."""
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in plain.items()}

    def write(self, path: Path | str) -> None:
        """Write it as JSON, some 20 kB."""
        write_atomically(Path(path), json.dumps(self.settings()) + "\n")

    @classmethod
    def read(cls, path: Path | str) -> Climatology:
        """Read what ``write`` wrote. Raises ``TaskError`` when the file is missing, or no climatology."""
        try:
            return cls.of_settings(json.loads(Path(path).read_text(encoding="utf-8")))
        except (OSError, ValueError) as error:
            refuse(f"There is no climatology in {path}: {reason_of(error)}.", TaskError, error)

    def clear(self, times: Floats) -> Floats:
        """Radiation of a clear sky [W m-2] in rows of weather that begin at ``times``, seconds since 1970 UTC, of any shape."""
        return clear_sky(times + self.middle, self.latitude, self.longitude)

    def mean(self, times: Floats) -> Floats:
        """Means ``(..., quantities)`` at ``times``, seconds since 1970 UTC ``(...)``; between hours and days linear."""
        seconds = times + self.middle
        hour = seconds / HOUR % 24.0 - 0.5
        day = (day_of_year(seconds) - self.first + _BEFORE) % _YEAR - _BEFORE
        place = np.clip((day - self.days[0]) / APART, 0.0, len(self.days) - 1.0)
        early = np.minimum(place.astype(np.int64), max(len(self.days) - 2, 0))
        late = np.minimum(early + 1, len(self.days) - 1)
        whole = np.floor(hour).astype(np.int64)
        share, of_day = (hour - whole)[..., None], (place - early)[..., None]
        whole, following = whole % 24, (whole + 1) % 24

        def at(days: NDArray[np.int64]) -> Floats:
            return (1.0 - share) * self.means[days, whole] + share * self.means[days, following]

        means: Floats = (1.0 - of_day) * at(early) + of_day * at(late)
        return means

    def weight(self, hours: Floats) -> Floats:
        """Weights ``(..., quantities, 3)`` so many hours ahead; 0 from two days on."""
        place = np.clip(hours, 0.0, LEADS - 1.0)
        whole = np.minimum(place.astype(np.int64), LEADS - 2)
        share = (place - whole)[..., None, None]
        fading = np.clip(2.0 - hours / (LEADS - 1.0), 0.0, 1.0)[..., None, None]
        weights: Floats = ((1.0 - share) * self.weights[whole] + share * self.weights[whole + 1]) * fading
        return weights

    def depression(self, mean: Floats, deviations: Floats) -> Floats:
        """How much colder than the air the sky is [K], from means and deviations ``(..., quantities)``."""
        by = self.sky
        depression: Floats = (
            mean[..., SKY] + by[0] * deviations[..., CLEARNESS] + by[1] * deviations[..., TEMPERATURE] + by[2] * deviations[..., HUMIDITY]
        )
        return depression

    def forecast_deviations(self, forecast: Floats, issued: Floats, times: Floats, otherwise: Floats) -> Floats:
        """Deviations that a forecast tells of ``times``.

        ``forecast`` has radiation, temperature, humidity and wind of the hours ``(n, 4, hours)``, and NaN where it says nothing; ``issued``
        is when, seconds since 1970 UTC ``(n,)``, ``times`` those of the rows asked for ``(n, T)``, ``otherwise`` the deviations where the
        forecast says nothing ``(n, quantities)``. Returns ``(n, T, quantities)``, linear between the middles of the forecast hours.
        """
        n, rows = times.shape
        deviations = np.repeat(otherwise[:, None], rows, axis=1)
        hours = np.array(self.forecast_hours, dtype=np.float64)
        middles = issued[:, None] + HOUR * (hours - 0.5)
        mean = self.mean(middles - self.middle)
        bright = np.mean([self.clear(middles - self.middle + HOUR * part) for part in (-0.375, -0.125, 0.125, 0.375)], axis=0)
        at = times + self.middle
        for row, quantity in enumerate(_FORECAST):
            if quantity == CLEARNESS:
                says = bright > BRIGHT
                forecast_values = forecast[:, row] / np.maximum(bright * mean[..., CLEARNESS], 1.0) - 1.0
            else:
                says = np.ones_like(middles, dtype=bool)
                forecast_values = forecast[:, row] - mean[..., quantity]
            says = says & ~np.isnan(forecast_values)
            nearest = []
            for order, is_before in ((range(len(hours)), True), (reversed(range(len(hours))), False)):
                nearest_at, nearest_value = np.full((n, rows), -np.inf if is_before else np.inf), np.zeros((n, rows))
                for place in order:
                    there = middles[:, place, None]
                    here = says[:, place, None] & ((there <= at) == is_before)
                    nearest_at = np.where(here, there, nearest_at)
                    nearest_value = np.where(here, forecast_values[:, place, None], nearest_value)
                nearest.append((nearest_at, nearest_value))
            (earlier_at, earlier), (later_at, later) = nearest
            has_earlier, has_later = np.isfinite(earlier_at), np.isfinite(later_at)
            between = has_earlier & has_later
            share = np.where(between, at - earlier_at, 0.0) / np.where(between, later_at - earlier_at, 1.0)
            linear = earlier + share * (later - earlier)
            value = np.where(between, linear, np.where(has_earlier, earlier, later))
            deviations[..., quantity] = np.where(has_earlier | has_later, value, deviations[..., quantity])
        return deviations

    def _with(self, **changes: Any) -> Climatology:
        return Climatology(**({field.name: getattr(self, field.name) for field in fields(self)} | changes))


_YEAR = 365.25
_BEFORE = 60.0
"""Days before the first day that still belong to its season."""


def day_of_year(seconds: Floats) -> Floats:
    """Days since the start of the year, UTC, at ``seconds`` since 1970."""
    moments = np.floor(seconds).astype(np.int64).astype("datetime64[s]")
    return (seconds - moments.astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64)) / 86400.0


class WeatherObservation:
    """Deviations of the observed weather from the mean, row after row.

    ``now`` are those of the last row ``(n, quantities)``; that of clearness is relative, and by night that of late. ``lately`` is the mean
    of the rows so far, the older the lighter: of clearness in daylight and by energy.
    """

    def __init__(self, climatology: Climatology, n: int, step_seconds: float) -> None:
        self._climatology, self._hours = climatology, step_seconds / HOUR
        # An hour or so of the usual sky before anything was observed.
        self._energy, self._usual = np.full(n, 300.0 / self._hours), np.full(n, 300.0 / self._hours)
        self._count = 0.0
        self.now = self.lately = np.zeros((n, len(QUANTITIES)))

    def add(self, times: Floats, weather: Floats) -> None:
        """Take in the rows that begin at ``times`` ``(n,)``: radiation, temperature, humidity, CO2, wind ``(n, 5)``."""
        mean, clear = self._climatology.mean(times), self._climatology.clear(times)
        usual, day = clear * mean[:, CLEARNESS], clear > BRIGHT
        memory = float(np.exp(-self._hours / RECENT))
        self._energy = np.where(day, memory * self._energy + weather[:, 0], self._energy)
        self._usual = np.where(day, memory * self._usual + usual, self._usual)
        self.now, lately = np.zeros_like(mean), self.lately.copy()
        self.now[:, TEMPERATURE:SKY] = weather[:, 1:] - mean[:, TEMPERATURE:SKY]
        faded = float(np.exp(-self._hours / LATELY)) * self._count
        self._count = faded + 1.0
        lately[:, TEMPERATURE:SKY] = (faded * lately[:, TEMPERATURE:SKY] + self.now[:, TEMPERATURE:SKY]) / self._count
        lately[:, CLEARNESS] = self._energy / self._usual - 1.0
        self.now[:, CLEARNESS] = np.where(day, weather[:, 0] / np.maximum(usual, 1.0) - 1.0, lately[:, CLEARNESS])
        self.lately = lately


@dataclass(frozen=True, eq=False)
class _Season:
    """Rows of one year: disturbances as measured, times, and forecasts ``(hours, 4, hours ahead)`` where the task has them."""

    times: Floats
    quantities: Floats  # radiation in the place of the clearness
    forecast: Floats | None

    @staticmethod
    def of(task: TaskSpec, record: WeatherRecord, year: int) -> _Season | None:
        from glbench.weather import disturbances

        weather, day = task.weather, dt.timedelta(days=1)
        forecast = ForecastTable.of(task)
        start = weather.start.replace(year=year, day=min(weather.start.day, 28)) - REACH * day
        days = weather.days + task.scenario.start_within_days + 2 * REACH + 2
        first, last = record.first.date() + 2 * day, record.last.date() - 2 * day
        begin, end = max(start, first), min(start + days * day, last)
        if (end - begin).days < 2 * REACH:
            return None
        rows = (end - begin).days * task.steps_per_day
        try:
            prepared = disturbances(
                record, start=begin, steps=rows, step_seconds=task.step_seconds, preprocessing=weather.preprocessing,
                co2_ppm=weather.co2_ppm,
            )  # fmt: skip
        except WeatherError:
            return None
        values = prepared.values
        air = read_air(*(np.ascontiguousarray(values[:, place]) for place in (1, 3, 2)))
        quantities = np.stack([values[:, 0], air[0], air[2], air[1], values[:, 4], values[:, 1] - values[:, 5]], axis=1)
        table: Floats | None = None
        if forecast is not None:
            covered = rows - forecast.reach
            table_rows = np.zeros((covered // forecast.every, forecast.columns), np.float32)
            measured = np.stack([values[:, 0], air[0], air[2], air[1], values[:, 4]], axis=1)
            forecast.fill(table_rows, 0, covered, measured, prepared.times, year)
            table = table_rows.astype(np.float64).reshape(len(table_rows), len(FORECAST), len(forecast.hours))
        return _Season(prepared.times.astype("datetime64[s]").astype(np.float64), quantities, table)


def _conserving(task: TaskSpec) -> bool:
    return task.weather.preprocessing != "paper"


def _middle(task: TaskSpec) -> float:
    return task.step_seconds / 2.0 if _conserving(task) else HOUR / 2.0


def _scored(task: TaskSpec) -> set[int]:
    """Years of which nothing may be known."""
    if task.splits is not None:
        return set(task.splits.test.years)
    return {season.start.year for season in task.scenario.seasons}


def _day_of_year(day: dt.date) -> int:
    return day.timetuple().tm_yday - 1


def _means(bare: Climatology, task: TaskSpec, seasons: list[_Season]) -> dict[str, Floats]:
    """Mean days of the season, a week apart."""
    count = -(-(task.weather.days + task.scenario.start_within_days) // APART) + 1
    days = APART * np.arange(min(count, -(-365 // APART)), dtype=np.float64)
    times = np.concatenate([season.times for season in seasons])
    values = np.concatenate([season.quantities for season in seasons])
    clear = bare.clear(times)
    middle = times + bare.middle
    hour = (middle / HOUR % 24.0).astype(np.int64)
    day = (day_of_year(middle) - bare.first + _BEFORE) % _YEAR - _BEFORE
    means = np.zeros((len(days), 24, len(QUANTITIES)))
    for place, centre in enumerate(days):
        near = np.abs(day - centre) <= REACH
        if not near.any():
            refuse(f"The years {bare.years} have no weather {centre:.0f} days into the season of {task.id}. Name others.", TaskError)
        light = near & (clear > BRIGHT)
        share = values[light, 0].sum() / max(clear[light].sum(), 1.0)
        for of_day in range(24):
            rows = near & (hour == of_day)
            means[place, of_day, 1:] = values[rows, 1:].mean(axis=0)
            bright = rows & light
            means[place, of_day, CLEARNESS] = values[bright, 0].sum() / clear[bright].sum() if bright.any() else share
    between = getattr(task.scenario.generated, "co2_range", None)
    means[..., CO2] = task.weather.co2_ppm if between is None else (between[0] + between[1]) / 2.0
    return {"days": days, "means": np.round(means, _DIGITS)}


@dataclass(frozen=True, eq=False)
class _Deviations:
    """Of the rows of a season: the usual radiation, true deviations, and those known then: now, of late."""

    usual: Floats
    true: Floats
    now: Floats
    lately: Floats

    @staticmethod
    def of(climatology: Climatology, task: TaskSpec, seasons: list[_Season]) -> list[_Deviations]:
        lengths = [len(season.times) for season in seasons]
        observed, now, lately = WeatherObservation(climatology, len(seasons), task.step_seconds), [], []
        for row in range(max(lengths)):  # a season that is over repeats its last row, which is cut off below
            rows = [min(row, length - 1) for length in lengths]
            times = np.array([season.times[at] for season, at in zip(seasons, rows, strict=True)])
            weather = np.array([season.quantities[at, :SKY] for season, at in zip(seasons, rows, strict=True)])
            observed.add(times, weather)
            now.append(observed.now)
            lately.append(observed.lately)
        deviations = []
        for place, season in enumerate(seasons):
            clear, mean = climatology.clear(season.times), climatology.mean(season.times)
            usual, true = clear * mean[:, CLEARNESS], season.quantities - mean
            relative = season.quantities[:, 0] / np.maximum(usual, 1.0) - 1.0
            true[:, CLEARNESS] = np.where(clear > BRIGHT, relative, 0.0)
            parts = (np.array([row[place] for row in part[: len(season.times)]]) for part in (now, lately))
            deviations.append(_Deviations(usual, true, *parts))
        return deviations


def _weights(climatology: Climatology, task: TaskSpec, seasons: list[_Season], of: list[_Deviations]) -> Floats:
    """Least squares of what came on what was known, by hours ahead."""
    weights = np.zeros((LEADS, len(QUANTITIES), 3))
    weights[0, :, 0] = 1.0
    every = max(int(HOUR // task.step_seconds), 1)
    ahead = (LEADS - 1) * every
    begins, forecasts = [], []
    for season, one in zip(seasons, of, strict=True):
        begin = np.arange(0, len(season.times) - ahead, every)
        forecast = np.zeros((len(begin), LEADS, len(QUANTITIES)))
        if season.forecast is not None:
            begin = begin[: len(season.forecast)]
            times = season.times[begin, None] + HOUR * np.arange(LEADS)
            forecast = climatology.forecast_deviations(season.forecast[: len(begin)], season.times[begin], times, one.lately[begin])
        begins.append(begin)
        forecasts.append(forecast)
    for quantity in range(SKY):
        for lead in range(1, LEADS):
            normal, right = _RIDGE * np.eye(3), np.zeros(3)
            for begin, forecast, one in zip(begins, forecasts, of, strict=True):
                then = begin + lead * every
                says = forecast[:, lead, quantity] if quantity in _FORECAST else np.zeros(len(begin))
                # An error of clearness counts as one of radiation.
                size = one.usual[then] if quantity == CLEARNESS else np.ones(len(begin))
                causes = np.stack([one.now[begin, quantity], one.lately[begin, quantity], says], axis=1) * size[:, None]
                normal, right = normal + causes.T @ causes, right + causes.T @ (one.true[then, quantity] * size)
            weights[lead, quantity] = np.linalg.solve(normal, right)
    weights[1:, CO2] = 0.0
    weights[1:, CO2, 0] = CO2_PERSISTENCE ** np.arange(1, LEADS)
    return np.round(weights, _DIGITS)


YEAR_DAYS = 365.2425


def sine_of_elevation(seconds: Floats, latitude: float, longitude: float) -> Floats:
    """Sine of the sun's elevation at ``seconds`` since 1970 UTC, at a place [degrees north and east].

    Declination and equation of time by Spencer (1971), to some tenths of a degree.
    """
    moments = np.floor(seconds).astype(np.int64).astype("datetime64[s]")
    begin = moments.astype("datetime64[Y]").astype("datetime64[s]").astype(np.int64)
    a = 2.0 * np.pi * (seconds - begin) / (86400.0 * YEAR_DAYS)
    declination = (
        0.006918 - 0.399912 * np.cos(a) + 0.070257 * np.sin(a) - 0.006758 * np.cos(2 * a) + 0.000907 * np.sin(2 * a)
        - 0.002697 * np.cos(3 * a) + 0.00148 * np.sin(3 * a)
    )  # fmt: skip
    minutes = 229.18 * (0.000075 + 0.001868 * np.cos(a) - 0.032077 * np.sin(a) - 0.014615 * np.cos(2 * a) - 0.04089 * np.sin(2 * a))
    solar_hour = seconds % 86400.0 / 3600.0 + longitude / 15.0 + minutes / 60.0
    angle, north = np.radians(15.0 * (solar_hour - 12.0)), np.radians(latitude)
    sine: Floats = np.sin(north) * np.sin(declination) + np.cos(north) * np.cos(declination) * np.cos(angle)
    return sine


def clear_sky(seconds: Floats, latitude: float, longitude: float) -> Floats:
    """Global radiation under a clear sky [W m-2] at ``seconds`` since 1970 UTC: Haurwitz (1945)."""
    sine = sine_of_elevation(seconds, latitude, longitude)
    return np.where(sine > 0.0, 1098.0 * sine * np.exp(-0.057 / np.maximum(sine, 1e-3)), 0.0)
