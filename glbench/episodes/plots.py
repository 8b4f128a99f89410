"""Ready-made plots of recorded runs: the climate within its limits, the controls, the money, and a typical day.

Each function takes one or several episodes of one task and returns a matplotlib figure that can be changed, saved (``figure.savefig``) or
shown by a notebook. The task determines what is drawn, as in the viewer (``signals_of``). Needs matplotlib (the extra ``video``).
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.episodes.episode import Episode
from glbench.episodes.signals import Curve, Signals, signals_of
from glbench.errors import EpisodeError, GlbenchError, refuse

try:
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
    from matplotlib.figure import Figure
except ImportError as error:
    _msg = (
        "The plots need matplotlib, which is not installed: pip install 'glbench[video]', "
        "or `uv sync --inexact --extra video` in a checkout."
    )
    raise GlbenchError(_msg) from error

__all__ = ["Drawing", "climate", "controls", "money", "typical_day"]

COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#000000", "#f0e442")
"""Of Okabe and Ito (2008), which colour-blind readers can tell apart; the first is the first episode's."""
_BAND = "#009e73"
_WIDTH, _ROW = 9.0, 1.7  # inches
Days = tuple[float, float]


class Drawing(Figure):
    """A figure that a notebook shows by itself; it belongs to no window and to no ``pyplot``."""

    def __init__(self, **options: Any) -> None:
        super().__init__(dpi=80.0, layout="constrained", **options)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        png = io.BytesIO()
        self.savefig(png, format="png", metadata={"Software": None})
        return png.getvalue()


def climate(*episodes: Episode, days: Days | None = None) -> Drawing:
    """Temperature, humidity and CO2 of the air in runs of one task, with the band between the task's limits.

    ``days`` are the first and last moment to show [days from the start of the run]; by default the whole run. Raises ``EpisodeError``
    without an episode, with episodes of several tasks, or when there is nothing between ``days``.
    """
    signals = _of_one_task(episodes)
    limits = dict(episodes[0].task().constraints.items())

    def band(axes: Axes, curve: Curve) -> None:
        if curve.limits is not None:
            low, high = limits[curve.limits].low, limits[curve.limits].high
            axes.axhspan(low, high, color=_BAND, alpha=0.12, lw=0.0)

    return _over_time(episodes, [one for one in _page(signals, "Climate") if one.limits], days, band)


def controls(*episodes: Episode, days: Days | None = None) -> Drawing:
    """The controls that were applied, as steps. Arguments and errors as for ``climate``."""
    return _over_time(episodes, _controls(_of_one_task(episodes)), days)


def money(*episodes: Episode) -> Drawing:
    """Profit, revenues, costs and, where they have prices, score and violations [EUR m-2], summed; a panel for each episode.

    Raises ``EpisodeError`` without an episode, or with episodes of several tasks.
    """
    signals = _of_one_task(episodes)
    pages = (*_page(signals, "Money"), *_page(signals, "Violations"))
    curves = [one for one in pages if one.unit == pages[0].unit]
    figure = Drawing(figsize=(_WIDTH, 4.0))
    panels = figure.subplots(1, len(episodes), sharey=True, squeeze=False)[0]
    for axes, episode, name in zip(panels, episodes, _names(episodes), strict=True):
        for number, curve in enumerate(curves):
            label = curve.title.removesuffix(", summed")
            total = curve.columns[0] in (signals.total, signals.reward)
            style: dict[str, Any] = {"color": "black", "lw": 2.0} if total else {"color": f"C{number}", "lw": 1.2}
            dashed = curve.columns[0] == signals.reward or number > 10  # by then the colours repeat
            axes.plot(_days(episode)[1:], _values(episode, curve), label=label, ls="--" if dashed else "-", **style)
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("day of the run")
        _tidy(axes)
    panels[0].set_ylabel(f"[{curves[0].unit}]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center", fontsize=8, frameon=False)
    return figure


def typical_day(*episodes: Episode) -> Drawing:
    """Climate and controls over the hours of the greenhouse's clock: the mean of all days, and the range that holds four of five days.

    Raises ``EpisodeError`` without an episode, or with episodes of several tasks.
    """
    signals = _of_one_task(episodes)
    curves = [*(one for one in _page(signals, "Climate") if one.limits), *_controls(signals)]
    columns = 3
    rows = -(-len(curves) // columns)
    figure = Drawing(figsize=(_WIDTH, _ROW * rows + 0.6))
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
    for axes in panels[len(curves) :]:
        axes.set_visible(False)
    for axes, curve in zip(panels, curves, strict=False):
        for episode, colour, name in zip(episodes, _colours(episodes), _names(episodes), strict=True):
            hours = _clock(episode, signals, curve)
            values = _values(episode, curve)
            clock_hours = np.unique(hours)
            each = [values[hours == hour] for hour in clock_hours]
            low, high = np.array([np.quantile(one, (0.1, 0.9)) for one in each]).T
            axes.plot(clock_hours, [one.mean() for one in each], color=colour, lw=1.5, label=name)
            axes.fill_between(clock_hours, low, high, color=colour, alpha=0.15, lw=0.0)
        axes.set_title(curve.heading, fontsize=9)
        axes.set_xlim(0.0, 24.0)
        axes.set_xticks(range(0, 25, 6))
        _tidy(axes)
    _name(figure, panels[0])
    figure.supxlabel("hour of the day", fontsize=9)
    return figure


def _over_time(
    episodes: Sequence[Episode], curves: Sequence[Curve], days: Days | None, mark: Callable[[Axes, Curve], None] = lambda axes, curve: None
) -> Drawing:
    """A panel for each curve, one below the other; ``mark`` draws behind it."""
    first, last = days or (0.0, np.inf)
    windows = [(first <= _days(one)[:-1]) & (_days(one)[1:] <= last) for one in episodes]
    if not any(one.any() for one in windows):
        msg = f"The runs have no step between day {first:g} and day {last:g}; the first has {_days(episodes[0])[-1]:g} days."
        raise EpisodeError(msg)
    figure = Drawing(figsize=(_WIDTH, _ROW * len(curves) + 0.6))
    panels = figure.subplots(len(curves), 1, sharex=True, squeeze=False)[:, 0]
    same = all(np.array_equal(one.times, episodes[0].times) for one in episodes)  # else their seasons differ
    for axes, curve in zip(panels, curves, strict=True):
        mark(axes, curve)
        for episode, window, colour, name in zip(episodes, windows, _colours(episodes), _names(episodes), strict=True):
            moments: NDArray[Any] = episode.local_times if same else _days(episode)
            at = moments[:-1] if curve.moment == "start" else moments[1:]
            style = "steps-post" if curve.moment == "start" else "default"
            axes.plot(at[window], _values(episode, curve)[window], color=colour, lw=1.2, drawstyle=style, label=name)
        axes.set_ylabel(f"{curve.title}\n[{curve.unit}]", fontsize=8)
        _tidy(axes)
    _name(figure, panels[0])
    if same:
        locator = AutoDateLocator()  # type: ignore[no-untyped-call]
        panels[-1].xaxis.set_major_locator(locator)
        panels[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    ahead = np.unique((episodes[0].local_times - episodes[0].times) / np.timedelta64(1, "h")).tolist()  # of UTC [h]
    clock = " to ".join(f"UTC{hour:+g}" if hour else "UTC" for hour in ahead)
    panels[-1].set_xlabel(f"{'local time' if any(ahead) else 'time'} ({clock})" if same else "day of the run")
    return figure


def _of_one_task(episodes: Sequence[Episode]) -> Signals:
    """What to draw of these episodes: everything that all of them have."""
    if not episodes:
        refuse("There is no episode to draw. Read some with glbench.episodes.read_episode.", EpisodeError)
    tasks = sorted({one.provenance.task.id for one in episodes})
    if len(tasks) > 1:
        refuse(f"Only runs of the same task can be drawn together; these are of {', '.join(tasks)}.", EpisodeError)
    if not all(one.steps for one in episodes):
        refuse("A run that ended before its first step has nothing to draw.", EpisodeError)
    signals = signals_of(episodes[0].task())
    return signals.lacking(name for name in signals.needed if any(name not in one.names for one in episodes))


def _page(signals: Signals, title: str) -> tuple[Curve, ...]:
    return next((page.curves for page in signals.pages if page.title == title), ())


def _controls(signals: Signals) -> list[Curve]:
    """The controls themselves, without what is summed over them."""
    return [curve for curve in _page(signals, "Controls") if not curve.summed]


def _values(episode: Episode, curve: Curve) -> NDArray[np.float64]:
    return curve.values({name: np.asarray(episode[name], dtype=np.float64) for name in curve.columns})


def _days(episode: Episode) -> NDArray[np.float64]:
    """Days from the start of the run, at the start and at the end of every step, ``(steps + 1,)``."""
    return np.asarray((episode.times - episode.times[0]) / np.timedelta64(1, "D"), dtype=np.float64)


def _clock(episode: Episode, signals: Signals, curve: Curve) -> NDArray[np.float64]:
    """Hour of the greenhouse's clock to which the curve's value of each step belongs, ``(steps,)``."""
    ends = np.asarray(episode[signals.clock], dtype=np.float64)
    if curve.moment == "end":
        return np.round(ends, 6)
    return np.round((ends - float((episode.times[1] - episode.times[0]) / np.timedelta64(1, "h"))) % 24.0, 6)


def _names(episodes: Sequence[Episode]) -> list[str]:
    """The name of each in a legend: its agent, and its seed where needed to tell them apart."""
    agents = [one.provenance.agent.name for one in episodes]
    seeds = {one.run.seed for one in episodes}
    return [
        name if len(seeds) == 1 and agents.count(name) == 1 else f"{name}, run {one.run.seed}"
        for name, one in zip(agents, episodes, strict=True)
    ]


def _colours(episodes: Sequence[Episode]) -> list[str]:
    return [COLOURS[number % len(COLOURS)] for number in range(len(episodes))]


def _name(figure: Drawing, axes: Axes) -> None:
    """A legend above all panels, of what ``axes`` shows."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper right", ncols=4, fontsize=8, frameon=False)


def _tidy(axes: Axes) -> None:
    axes.grid(color="#dddddd", lw=0.6)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
