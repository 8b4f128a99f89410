"""A picture of a generated season beside the real years that it is made of.

Needs matplotlib (the extra ``video``); uses none of its global state.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glbench.errors import WeatherError
from glbench.resources import write_atomically
from glbench.weather.generator import DAY_HOURS, MARGIN_DAYS, GeneratedSeason, SeasonGenerator, calendar_days
from glbench.weather.record import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE = (11.0, 10.0)
"""Width and height [inch], at 100 pixels an inch."""
INK, QUIET, EDGE = "#1f2933", "#52606d", "#b8c2cc"
YEAR_COLOURS = ("#1d5fa8", "#e2a23b", "#3a8f5c", "#a44a8c", "#7a6a58", "#4aa3a8")
ROOM_OF_A_DATE = 4  # days of a block that can carry its dates


def write_picture(generator: SeasonGenerator, season: GeneratedSeason, path: Path) -> None:
    """Write a PNG to ``path``: daily figures of ``season`` over those of the generator's years, and where each day was taken from.

    Raises
    ------
    WeatherError
        When matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        msg = "A picture of a season needs matplotlib, which is not installed: pip install 'glbench[video]'. Or leave out --picture."
        raise WeatherError(msg) from error
    figure = Figure(figsize=SIZE, dpi=100, layout="constrained", facecolor="white")
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
        _dress(axes, title)
    low, high = hours["air_temperature"].min(axis=-1), hours["air_temperature"].max(axis=-1)
    rows[0].fill_between(dates, low, high, color=INK, alpha=0.10, lw=0, label="generated, lowest to highest hour")
    for axes in (rows[1], rows[3]):
        axes.set_ylim(bottom=0.0)
    _blocks(rows[-1], generator, dates, season.sources[inner], season.joints[inner])
    figure.legend(
        *rows[0].get_legend_handles_labels(),
        loc="outside upper center",
        ncols=min(len(real), 6) + 2,
        frameon=False,
        fontsize=9,
    )
    years = ", ".join(str(year) for year in generator.years)
    rows[0].set_title(f"A season generated from {years} ({season.record.station})", loc="left", fontsize=12, color=INK)
    _axis_of_dates(rows[-1], dates)
    sink = io.BytesIO()
    canvas.print_png(sink)
    write_atomically(path, sink.getvalue())


def _real_years(generator: SeasonGenerator, calendar: IntArray) -> dict[int, dict[str, FloatArray]]:
    """Hours of the same calendar days in each year, (days, 24) of each quantity; NaN where a season runs out of the year."""
    numbers, values = generator.real_days()
    own_years = numbers.astype("datetime64[D]").astype("datetime64[Y]").astype(np.int64) + 1970
    own = calendar_days(numbers)
    turned = np.flatnonzero(np.diff(calendar) < 0)
    wanted_year = np.zeros(calendar.size, dtype=np.int64)
    if turned.size:
        wanted_year[turned[0] + 1 :] = 1
    found = {}
    for year in generator.years:
        rows = np.full(calendar.size, -1, dtype=np.int64)
        for i, (day, later) in enumerate(zip(calendar, wanted_year, strict=True)):
            here = np.flatnonzero((own == day) & (own_years == year + later))
            rows[i] = here[0] if here.size else -1
        found[year] = {name: np.where((rows >= 0)[:, None], column[rows], np.nan) for name, column in values.items()}
    return found


def _blocks(axes: Axes, generator: SeasonGenerator, dates: Any, sources: IntArray, joints: Any) -> None:
    """A strip that says where each block was taken from, and lines at the joints."""
    begins = np.flatnonzero(joints | (np.arange(joints.size) == 0))
    for begin, end in zip(begins, np.append(begins[1:], joints.size), strict=True):
        first = sources[begin].astype("datetime64[D]").item()
        colour = _colour(generator.years.index(first.year))
        axes.barh(
            0.0,
            float(end - begin),
            left=dates[begin] - np.timedelta64(12, "h"),
            height=1.0,
            color=colour,
            alpha=0.55,
            ec="white",
            lw=2,
        )
        if end - begin >= ROOM_OF_A_DATE:
            middle = dates[begin] - np.timedelta64(12, "h") + np.timedelta64(int(12 * (end - begin)), "h")
            axes.text(
                middle, 0.0, f"{first.day} {first:%b}\n{first.year}", ha="center", va="center", fontsize=7.5, color=INK
            )
    axes.set_yticks([])
    axes.set_ylabel("taken from", fontsize=9, color=INK)
    axes.set_ylim(-0.5, 0.5)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)


def _colour(number: int) -> str:
    return YEAR_COLOURS[number % len(YEAR_COLOURS)]


def _dress(axes: Axes, title: str) -> None:
    axes.set_ylabel(title, fontsize=9, color=INK)
    axes.tick_params(labelsize=8.5, colors=QUIET)
    axes.grid(color=EDGE, lw=0.5, alpha=0.6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _axis_of_dates(axes: Axes, dates: Any) -> None:
    from matplotlib import dates as of_dates

    library: Any = of_dates  # matplotlib does not say what its locators take

    axes.set_xlim(dates[0] - np.timedelta64(12, "h"), dates[-1] + np.timedelta64(12, "h"))
    axes.xaxis.set_major_locator(library.AutoDateLocator(minticks=5, maxticks=12))
    axes.xaxis.set_major_formatter(library.DateFormatter("%-d %b"))
    axes.tick_params(axis="x", labelsize=8.5, colors=QUIET)
    axes.set_xlabel("day of the season (dates are nominal)", fontsize=9, color=INK)
