"""How well generated seasons resemble the real years that they are made of, in figures beside the limits that a generator must keep.

Everything is computed on the same days of the year: real seasons are the windows of the years that begin on each of the possible first
days; generated ones begin on the same days in turn. Days are those of the generator, midnight to midnight of solar time.
"""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glbench.errors import WeatherError
from glbench.weather.generator import DAY_HOURS, MARGIN_DAYS, SeasonGenerator, calendar_days
from glbench.weather.record import SKY, FloatArray, IntArray

LAGS = 5
BASE_TEMPERATURE = 18.0  # degC
FOLLOWED = ("air_temperature", "relative_humidity", "wind_speed")
MOST_AT_JOINTS = 0.10
"""Largest accepted Kolmogorov-Smirnov distance of changes at joints."""
SPLIT_KEY = 0x6A6F696E


@dataclass(frozen=True)
class Figure:
    """One line of the page: a value, and the limits it must keep (``None``: shown only)."""

    name: str
    value: float
    low: float | None = None
    high: float | None = None
    worst: str = ""

    @property
    def text(self) -> str:
        """The value, rounded."""
        return f"{self.value:.1f}" if self.name.endswith(("[%]", "[d]", "mean]")) else f"{self.value:.3f}"

    @property
    def limits(self) -> str:
        """The limits in words; empty where there are none."""
        if self.low is None:
            return "" if self.high is None else f"at most {self.high:g}"
        return f"{self.low:g} to {self.high:g}"

    @property
    def within_limits(self) -> bool:
        """Whether the value lies within its limits."""
        return (self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high)


@dataclass(frozen=True)
class Resemblance:
    """What was compared, and the figures.

    Attributes
    ----------
    source, digest : str
        Name and SHA-256 of the record.
    years : tuple of int
        Years drawn from, and compared with.
    start : str
        First possible first day, month and day (``02-15``).
    within_days, days, seasons, seed : int
        Further possible first days, length of a season, number of generated seasons, seed of their random numbers.
    figures : tuple of Figure
        The page.
    """

    source: str
    digest: str
    years: tuple[int, ...]
    start: str
    within_days: int
    days: int
    seasons: int
    seed: int
    figures: tuple[Figure, ...]

    @property
    def accepted(self) -> bool:
        """Whether every figure keeps its limits."""
        return all(figure.within_limits for figure in self.figures)


@dataclass(frozen=True)
class Seasons:
    """Seasons as hours (n, days, 24) of each quantity, with the calendar day (n, days) of each day."""

    hours: dict[str, FloatArray]
    calendar: IntArray
    sources: IntArray
    joints: npt.NDArray[np.bool_]


def resemblance(
    generator: SeasonGenerator,
    *,
    start: dt.date = dt.date(2010, 2, 15),
    within_days: int = 28,
    days: int = 60,
    seasons: int = 1000,
    seed: int = 1,
) -> Resemblance:
    """Figures of ``seasons`` generated seasons against the real years.

    Parameters
    ----------
    generator : SeasonGenerator
        Its years are the real ones.
    start, within_days, days
        First possible first day (of any year), how many later days are possible, and the length of a season.
    seasons, seed : int
        Number of generated seasons, at least 20, and the seed of their random numbers.

    Raises
    ------
    WeatherError
        When there are too few seasons, or no real season lies wholly inside the years.
    """
    if seasons < 20 or within_days < 0:
        msg = f"Statistics need at least 20 seasons and no negative spread of first days; got {seasons} seasons, {within_days} days."
        raise WeatherError(msg)
    made = generated_seasons(generator, start, within_days, days, seasons, seed)
    real = real_seasons(generator, start, within_days, days)
    figures = (
        *_daily(made, real),
        *_midnights(made, real),
        *_sums(made, real),
        *_repeats(made, seed),
    )
    return Resemblance(
        source=generator.record.name,
        digest=generator.record.digest,
        years=generator.years,
        start=f"{start:%m-%d}",
        within_days=within_days,
        days=days,
        seasons=seasons,
        seed=seed,
        figures=figures,
    )


def _names(generator: SeasonGenerator) -> tuple[str, ...]:
    sky = next(name for name in SKY if name in generator.record.counts)
    return (*FOLLOWED, "global_radiation", sky)


def generated_seasons(
    generator: SeasonGenerator, start: dt.date, within_days: int, days: int, seasons: int, seed: int
) -> Seasons:
    """``seasons`` generated seasons of so many days, their first days in turn from ``start`` to ``within_days`` later."""
    inner = slice(MARGIN_DAYS, MARGIN_DAYS + days)
    hours: dict[str, list[FloatArray]] = {name: [] for name in _names(generator)}
    calendar, sources, joints = [], [], []
    for number in range(seasons):
        first = start + dt.timedelta(days=number % (within_days + 1))
        numbers = np.random.default_rng((seed, number)).random(generator.numbers(days))
        season = generator.season(first, days, numbers)
        for name, column in hours.items():
            column.append(season.record.values(name).reshape(-1, DAY_HOURS)[inner])
        calendar.append(calendar_days((first - dt.date(1970, 1, 1)).days + np.arange(days)))
        sources.append(season.sources[inner])
        joints.append(season.joints[inner])
    stacked = {name: np.stack(column) for name, column in hours.items()}
    return Seasons(stacked, np.stack(calendar), np.stack(sources), np.stack(joints))


def real_seasons(generator: SeasonGenerator, start: dt.date, within_days: int, days: int) -> Seasons:
    """Every season of the generator's years that begins on one of these first days.

    Raises
    ------
    WeatherError
        When no such season lies wholly inside the years.
    """
    numbers, values = generator.real_days()
    first = calendar_days(np.array([(start - dt.date(1970, 1, 1)).days]))[0]
    calendar = calendar_days(numbers)
    begins = np.flatnonzero((calendar - first) % 365 <= within_days)
    begins = begins[begins + days <= numbers.size]
    begins = begins[numbers[begins + days - 1] - numbers[begins] == days - 1]
    if not begins.size:
        years = ", ".join(str(year) for year in generator.years)
        msg = f"None of the years {years} holds {days} days in a row from {start:%d %B}: there is no real season to compare with."
        raise WeatherError(msg)
    rows = begins[:, None] + np.arange(days)
    hours = {name: values[name][rows] for name in _names(generator)}
    return Seasons(hours, calendar[rows], numbers[rows], np.zeros(rows.shape, dtype=np.bool_))


def daily_values(seasons: Seasons) -> dict[str, FloatArray]:
    """Daily means of every quantity and the daily range of temperature, (n, days) each."""
    daily = {name.replace("_", " "): hours.mean(axis=-1) for name, hours in seasons.hours.items()}
    return {**daily, "daily range": np.ptp(seasons.hours["air_temperature"], axis=-1)}


def _worst(name: str, values: dict[str, float], *, limit: float) -> Figure:
    which = max(values, key=lambda key: abs(values[key]))
    return Figure(name, abs(values[which]), None, limit, which)


def _daily(made: Seasons, real: Seasons) -> list[Figure]:
    """Means, standard deviations, autocorrelations and correlations of daily values, less the real years' trend over the season."""
    ours, theirs = daily_values(made), daily_values(real)
    day = np.arange(made.calendar.shape[1]) + 0.0
    bias, ratio, lagged = {}, {}, {}
    anomalies: list[list[FloatArray]] = [[], []]
    for name, values in theirs.items():
        trend = np.polyval(np.polyfit(np.tile(day, len(values)), values.ravel(), 1), day)
        apart = [one - trend for one in (ours[name], values)]
        centred = [one - one.mean() for one in apart]
        spread = [float(one.std()) for one in centred]
        bias[name] = float(apart[0].mean()) / spread[1]
        ratio[name] = spread[0] / spread[1]
        for lag in range(1, LAGS + 1):
            both = [float((x[:, lag:] * x[:, :-lag]).mean() / x.var()) for x in centred]
            lagged[f"{name}, lag {lag}"] = both[0] - both[1]
        for rows, one in zip(anomalies, centred, strict=True):
            rows.append(one.ravel())
    tables: list[FloatArray] = [np.asarray(np.corrcoef(np.stack(rows))) for rows in anomalies]
    names = list(theirs)
    crossed = {
        f"{names[i]} and {names[j]}": float(tables[0][i, j] - tables[1][i, j])
        for i in range(len(names))
        for j in range(i)
    }
    low, high = min(ratio, key=ratio.__getitem__), max(ratio, key=ratio.__getitem__)
    return [
        _worst("bias of daily values [sd]", bias, limit=0.1),
        Figure("smallest ratio of sd [-]", ratio[low], 0.93, 1.07, low),
        Figure("largest ratio of sd [-]", ratio[high], 0.93, 1.07, high),
        _worst(f"autocorrelation, lags 1 to {LAGS}, off by [-]", lagged, limit=0.15),
        _worst("correlation of two quantities, off by [-]", crossed, limit=0.06),
    ]


def midnight_changes(seasons: Seasons) -> dict[str, FloatArray]:
    """Change over each midnight inside the season (n, days - 1), of what runs on through the night."""
    return {
        name: hours[:, 1:, 0] - hours[:, :-1, -1] for name, hours in seasons.hours.items() if name != "global_radiation"
    }


def _midnights(made: Seasons, real: Seasons) -> list[Figure]:
    """Compare changes over midnight at joints with those of the real years: with signs the worst quantity, without signs each.

    Signs hide the effect of rounding on small changes: as many of them vanish upward as downward.
    """
    from scipy.stats import ks_2samp

    ours, theirs = midnight_changes(made), midnight_changes(real)
    joined = made.joints[:, 1:]
    signed, sizes = (
        {
            name.replace("_", " "): float(
                ks_2samp(of(ours[name][joined]), of(theirs[name].ravel()), method="asymp").statistic
            )
            for name in ours
        }
        for of in (np.positive, np.abs)
    )
    return [
        _worst("changes at joints, Kolmogorov-Smirnov distance [-]", signed, limit=MOST_AT_JOINTS),
        *(
            Figure(f"size of changes at joints, {name}, Kolmogorov-Smirnov distance [-]", value, None, MOST_AT_JOINTS)
            for name, value in sizes.items()
        ),
    ]


def _sums(made: Seasons, real: Seasons) -> list[Figure]:
    """Sums of a season: radiation [MJ m-2] and degree-hours [K h] below 18 degC; their mean over the real one, and their spread."""
    figures = []
    days = made.calendar.shape[1]
    radiation, below = (
        [one.hours["global_radiation"].sum(axis=(1, 2)) * 3600e-6 for one in (made, real)],
        [np.maximum(BASE_TEMPERATURE - one.hours["air_temperature"], 0.0).sum(axis=(1, 2)) for one in (made, real)],
    )
    for name, (ours, theirs) in ((f"radiation sum of {days} days", radiation), (f"degree-hours of {days} days", below)):
        limits = (0.98, 1.02) if name.startswith("radiation") else (None, None)
        figures.append(Figure(f"{name}, generated over real [-]", float(ours.mean() / theirs.mean()), *limits))
        figures.append(Figure(f"{name}, sd generated [% of mean]", 100.0 * float(ours.std() / ours.mean())))
        figures.append(Figure(f"{name}, sd real [% of mean]", 100.0 * float(theirs.std() / theirs.mean())))
    return figures


def _repeats(made: Seasons, seed: int) -> list[Figure]:
    """How much of their days two seasons share, how much a season repeats, and how far its days are from their place."""
    rng = np.random.default_rng((seed, SPLIT_KEY, 1))
    first, second = (rng.integers(len(made.sources), size=1000) for _ in range(2))
    pairs = [(made.sources[i], made.sources[j]) for i, j in zip(first, second, strict=True) if i != j]
    shared = np.mean([np.isin(one, other).mean() for one, other in pairs])
    same = np.mean([(one == other).mean() for one, other in pairs])
    again = np.mean([1.0 - np.unique(one).size / one.size for one in made.sources])
    drift = (calendar_days(made.sources) - made.calendar + 182) % 365 - 182
    return [
        Figure("days that two seasons share [%]", 100.0 * float(shared)),
        Figure("the same at the same place [%]", 100.0 * float(same)),
        Figure("days that a season repeats [%]", 100.0 * float(again)),
        Figure("mean distance from their place in the year [d]", float(drift.mean())),
    ]
