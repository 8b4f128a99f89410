"""Generated seasons beside the real years that they are generated of: figures with the limits that a generator must keep, and a picture.

Everything is computed on the same days of the year: real seasons are the windows of the years that begin on each of the possible first
days; generated ones begin on the same days in turn. Days are those of the generator, midnight to midnight of solar time.

The picture needs matplotlib (the extra ``video``), and uses none of its global state.
"""

from __future__ import annotations

import datetime as dt
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from glbench.errors import WeatherError
from glbench.resources import write_atomically
from glbench.weather.generator import DAY_HOURS, MARGIN_DAYS, MATCHED, GeneratedSeason, SeasonGenerator, calendar_days
from glbench.weather.record import SKY, FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LAGS = 5
BASE_TEMPERATURE = 18.0  # degC
MOST_AT_JOINTS = 0.10  # Largest accepted Kolmogorov-Smirnov distance of changes at joints
SPLIT_KEY = 0x6A6F696E
SIZE = (11.0, 10.0)  # Width and height [inch], at 100 pixels an inch
INK, QUIET, EDGE = "#1f2933", "#52606d", "#b8c2cc"
YEAR_COLOURS = ("#1d5fa8", "#e2a23b", "#3a8f5c", "#a44a8c", "#7a6a58", "#4aa3a8")
ROOM_OF_A_DATE = 4  # days of a block that can carry its dates


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

    ``source`` and ``digest`` are name and SHA-256 of the record, ``years`` those drawn from, and compared with. ``start`` is the first
    possible first day, month and day (``02-15``), and ``within_days`` the further ones; ``days`` is the length of a season, ``seasons`` the
    number of generated ones, and ``seed`` that of their random numbers.
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
    """Figures of ``seasons`` generated seasons, at least 20, against the real years of ``generator``.

    ``start`` is the first possible first day (of any year), ``within_days`` how many later days are possible, ``days`` the length of a
    season, and ``seed`` that of their random numbers. Raises ``WeatherError`` when seasons are too few, or the years hold no whole one.
    """
    if seasons < 20 or within_days < 0:
        msg = f"Statistics need at least 20 seasons and no negative spread of first days; got {seasons} seasons, {within_days} days."
        raise WeatherError(msg)
    generated = generated_seasons(generator, start, within_days, days, seasons, seed)
    real = real_seasons(generator, start, within_days, days)
    figures = (*_daily(generated, real), *_midnights(generated, real), *_sums(generated, real), *_repeats(generated, seed))
    record, years = generator.record, generator.years
    return Resemblance(record.name, record.digest, years, f"{start:%m-%d}", within_days, days, seasons, seed, figures)


def _names(generator: SeasonGenerator) -> tuple[str, ...]:
    return (*MATCHED, "global_radiation", next(name for name in SKY if name in generator.record.counts))


def generated_seasons(generator: SeasonGenerator, start: dt.date, within_days: int, days: int, seasons: int, seed: int) -> Seasons:
    """``seasons`` generated seasons of so many days, their first days in turn from ``start`` to ``within_days`` later."""
    names, inner, rows = _names(generator), slice(MARGIN_DAYS, MARGIN_DAYS + days), []
    for number in range(seasons):
        first = start + dt.timedelta(days=number % (within_days + 1))
        season = generator.season(first, days, np.random.default_rng((seed, number)).random(generator.numbers(days)))
        hours = [season.record.values(name).reshape(-1, DAY_HOURS)[inner] for name in names]
        calendar = calendar_days((first - dt.date(1970, 1, 1)).days + np.arange(days))
        rows.append((calendar, season.sources[inner], season.joints[inner], *hours))
    calendar, sources, joints, *columns = (np.stack(part) for part in zip(*rows, strict=True))
    return Seasons(dict(zip(names, columns, strict=True)), calendar, sources, joints)


def real_seasons(generator: SeasonGenerator, start: dt.date, within_days: int, days: int) -> Seasons:
    """Every season of the generator's years that begins on one of these days. Raises ``WeatherError`` when none lies wholly inside."""
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


def _daily(generated: Seasons, real: Seasons) -> list[Figure]:
    """Means, standard deviations, autocorrelations and correlations of daily values, less the real years' trend over the season."""
    ours, theirs = daily_values(generated), daily_values(real)
    day = np.arange(generated.calendar.shape[1]) + 0.0
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
    crossed = {f"{names[i]} and {names[j]}": float(tables[0][i, j] - tables[1][i, j]) for i in range(len(names)) for j in range(i)}
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
    return {name: hours[:, 1:, 0] - hours[:, :-1, -1] for name, hours in seasons.hours.items() if name != "global_radiation"}


def _midnights(generated: Seasons, real: Seasons) -> list[Figure]:
    """Compare changes over midnight at joints with those of the real years: with signs the worst quantity, without signs each.

    Signs hide the effect of rounding on small changes: as many of them vanish upward as downward.
    """
    from scipy.stats import ks_2samp

    ours, theirs = midnight_changes(generated), midnight_changes(real)
    joined = generated.joints[:, 1:]
    signed, sizes = (
        {
            name.replace("_", " "): float(ks_2samp(of(ours[name][joined]), of(theirs[name].ravel()), method="asymp").statistic)
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


def _sums(generated: Seasons, real: Seasons) -> list[Figure]:
    """Sums over a season of radiation and of degree-hours below 18 degC: their mean over that of the real ones, and their spread."""
    figures = []
    days = generated.calendar.shape[1]
    radiation, below = (
        [one.hours["global_radiation"] for one in (generated, real)],
        [np.maximum(BASE_TEMPERATURE - one.hours["air_temperature"], 0.0) for one in (generated, real)],
    )
    for name, hours, low, high in (
        (f"radiation sum of {days} days", radiation, 0.98, 1.02),
        (f"degree-hours of {days} days", below, None, None),
    ):
        ours, theirs = (one.sum(axis=(1, 2)) for one in hours)
        figures.append(Figure(f"{name}, generated over real [-]", float(ours.mean() / theirs.mean()), low, high))
        figures += [
            Figure(f"{name}, sd {kind} [% of mean]", 100.0 * float(one.std() / one.mean()))
            for kind, one in (("generated", ours), ("real", theirs))
        ]
    return figures


def _repeats(generated: Seasons, seed: int) -> list[Figure]:
    """How much of their days two seasons share, how much a season repeats, and how far its days are from their place."""
    rng = np.random.default_rng((seed, SPLIT_KEY, 1))
    first, second = (rng.integers(len(generated.sources), size=1000) for _ in range(2))
    pairs = [(generated.sources[i], generated.sources[j]) for i, j in zip(first, second, strict=True) if i != j]
    shared = np.mean([np.isin(one, other).mean() for one, other in pairs])
    same = np.mean([(one == other).mean() for one, other in pairs])
    again = np.mean([1.0 - np.unique(one).size / one.size for one in generated.sources])
    drift = (calendar_days(generated.sources) - generated.calendar + 182) % 365 - 182
    return [
        Figure("days that two seasons share [%]", 100.0 * float(shared)),
        Figure("the same at the same place [%]", 100.0 * float(same)),
        Figure("days that a season repeats [%]", 100.0 * float(again)),
        Figure("mean distance from their place in the year [d]", float(drift.mean())),
    ]


def tidy(axes: Any) -> None:
    """The look of all pictures: a quiet grid, no frame above and at the right."""
    axes.tick_params(labelsize=8.5, colors=QUIET)
    axes.grid(color=EDGE, lw=0.5, alpha=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def write_picture(generator: SeasonGenerator, season: GeneratedSeason, path: Path) -> None:
    """Write a PNG to ``path``: daily figures of ``season`` over those of the generator's years, and where each day was taken from.

    Raises ``WeatherError`` when matplotlib is not installed.
    """
    try:
        from matplotlib import dates as matplotlib_dates
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure as Canvas
    except ImportError as error:
        msg = "A picture of a season needs matplotlib, which is not installed: pip install 'glbench[video]'. Or leave out --picture."
        raise WeatherError(msg) from error
    figure = Canvas(figsize=SIZE, dpi=100, layout="constrained", facecolor="white")
    canvas: Any = FigureCanvasAgg(figure)
    rows: Any = figure.subplots(5, 1, sharex=True, height_ratios=[3, 3, 2.4, 2.4, 1.1])
    inner = slice(MARGIN_DAYS, season.sources.size - MARGIN_DAYS)
    hours = {name: season.record.values(name).reshape(-1, DAY_HOURS)[inner] for name in season.record.counts}
    dates = np.datetime64(season.start, "D") + np.arange(len(hours["air_temperature"]))
    real = _real_years(generator, calendar_days(dates.astype(np.int64)))
    panels = (
        ("air_temperature", "air temperature\n[°C], daily mean", 1.0),
        ("global_radiation", "global radiation\n[MJ m⁻² d⁻¹]", 0.0864),  # a day of 1 W m-2
        ("relative_humidity", "relative humidity\n[%], daily mean", 1.0),
        ("wind_speed", "wind speed\n[m s⁻¹], daily mean", 1.0),
    )
    for axes, (name, title, factor) in zip(rows[:-1], panels, strict=True):
        for i, (year, values) in enumerate(real.items()):
            axes.plot(dates, factor * values[name].mean(axis=-1), color=_colour(i), lw=1.0, alpha=0.75, label=f"{year}")
        axes.plot(dates, factor * hours[name].mean(axis=-1), color=INK, lw=2.2, label="generated")
        axes.set_ylabel(title, fontsize=9, color=INK)
        tidy(axes)
    low, high = hours["air_temperature"].min(axis=-1), hours["air_temperature"].max(axis=-1)
    rows[0].fill_between(dates, low, high, color=INK, alpha=0.10, lw=0, label="generated, lowest to highest hour")
    for axes in (rows[1], rows[3]):
        axes.set_ylim(bottom=0.0)
    _blocks(rows[-1], generator, dates, season.sources[inner], season.joints[inner])
    legend = rows[0].get_legend_handles_labels()
    figure.legend(*legend, loc="outside upper center", ncols=min(len(real), 6) + 2, frameon=False, fontsize=9)
    years = ", ".join(str(year) for year in generator.years)
    rows[0].set_title(f"A season generated from {years} ({season.record.station})", loc="left", fontsize=12, color=INK)
    library: Any = matplotlib_dates  # matplotlib does not say what its locators take
    rows[-1].set_xlim(dates[0] - np.timedelta64(12, "h"), dates[-1] + np.timedelta64(12, "h"))
    rows[-1].xaxis.set_major_locator(library.AutoDateLocator(minticks=5, maxticks=12))
    rows[-1].xaxis.set_major_formatter(library.DateFormatter("%-d %b"))
    rows[-1].tick_params(axis="x", labelsize=8.5, colors=QUIET)
    rows[-1].set_xlabel("day of the season (dates are nominal)", fontsize=9, color=INK)
    sink = io.BytesIO()
    canvas.print_png(sink)
    write_atomically(path, sink.getvalue())


def _real_years(generator: SeasonGenerator, calendar: IntArray) -> dict[int, dict[str, FloatArray]]:
    """Hours of the same calendar days in each year, (days, 24) of each quantity; NaN where a season runs out of the year."""
    numbers, values = generator.real_days()
    years = numbers.astype("datetime64[D]").astype("datetime64[Y]").astype(np.int64) + 1970
    # The last row of a key that occurs twice is taken: a leap year has 28 February and then 29 February, which counts as that day.
    row_of = dict(zip(zip(years.tolist(), calendar_days(numbers).tolist(), strict=True), range(numbers.size), strict=True))
    later = np.cumsum(np.diff(calendar, prepend=calendar[:1]) < 0)
    by_year = {}
    for year in generator.years:
        rows = np.array([row_of.get((year + turn, day), -1) for day, turn in zip(calendar.tolist(), later.tolist(), strict=True)])
        by_year[year] = {name: np.where((rows >= 0)[:, None], column[rows], np.nan) for name, column in values.items()}
    return by_year


def _blocks(axes: Axes, generator: SeasonGenerator, dates: Any, sources: IntArray, joints: Any) -> None:
    """A strip that says where each block was taken from, and lines at the joints."""
    begins = np.flatnonzero(joints | (np.arange(joints.size) == 0))
    lengths, edges = np.diff(begins, append=joints.size), dates[begins] - np.timedelta64(12, "h")
    first_days = sources[begins].astype("datetime64[D]").tolist()
    colours = [_colour(generator.years.index(first.year)) for first in first_days]
    axes.barh(np.zeros(begins.size), lengths.astype("timedelta64[D]"), left=edges, height=1.0, color=colours, alpha=0.55, ec="white", lw=2)
    for first, length, edge in zip(first_days, lengths.tolist(), edges, strict=True):
        if length >= ROOM_OF_A_DATE:
            text = f"{first.day} {first:%b}\n{first.year}"
            axes.text(edge + np.timedelta64(12 * length, "h"), 0.0, text, ha="center", va="center", fontsize=7.5, color=INK)
    axes.set_yticks([])
    axes.set_ylabel("taken from", fontsize=9, color=INK)
    axes.set_ylim(-0.5, 0.5)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def _colour(number: int) -> str:
    return YEAR_COLOURS[number % len(YEAR_COLOURS)]
