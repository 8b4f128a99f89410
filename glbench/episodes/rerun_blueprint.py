"""The layout of the viewer: an overview that a grower reads at a glance, and a page for each part of the house."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from glbench.episodes import rerun_signals as signals
from glbench.episodes.rerun_course import HOURS_PER_DAY, SHOWN_DAYS, Shown
from glbench.episodes.rerun_package import load_blueprint, load_rerun
from glbench.episodes.rerun_signals import CLIMATE, CONTROLS, CROP, MONEY, VIOLATIONS, WEATHER, Signal

if TYPE_CHECKING:
    import rerun.blueprint as rrb

_BY_PATH = {signal.path: signal for signal in signals.SIGNALS}
_MARGIN = 0.04
_LIVE_MARGIN = 0.35
"""Room above and below limits and curves, as a share of their range; more where the curves are still to come."""
_SHUT_TO_OPEN = (-5.0, 105.0)
"""Range of the controls [%], with room for lines at its ends."""
_PLAYBACK_SPEED = 3600.0
"""Played back, an hour passes in a second."""

OVERVIEW: tuple[tuple[str, ...], ...] = (
    ("money/epi", "crop/fruit_fresh", "money/cost_electricity", "violations/hours"),
    ("climate/air_temperature", "climate/relative_humidity", "climate/co2", "weather/global_radiation"),
    ("controls/boiler", "controls/vents", "controls/lamps", "controls/co2_dosing"),
)
"""Columns of the overview: what came of it, the climate and its cause outside, what the controllers did."""


@dataclass(frozen=True)
class Page:
    """A page of plots, ``columns`` side by side."""

    title: str
    signals: Sequence[Signal]
    columns: int


PAGES = (
    Page("Climate", CLIMATE, 2),
    Page("Crop and harvest", CROP, 2),
    Page("Controls", CONTROLS, 2),
    Page("Weather", WEATHER, 2),
    Page("Money", MONEY, 2),
    Page("Violations", VIOLATIONS, 2),
)


def blueprint(shown: Shown, *, live: bool = False, plain: bool = False) -> rrb.Blueprint:
    """The layout for ``shown``: an overview and a page a group, with the panels for experts folded away.

    A ``live`` one follows the newest values and keeps the last days before them in view. A ``plain`` one, for pictures, has no
    menu either.
    """
    views = load_blueprint()
    layout = _Layout(shown, live=live)
    made: rrb.Blueprint = views.Blueprint(
        views.Tabs(layout.overview(), *(layout.page(page) for page in PAGES), active_tab=0, name="Episode"),
        views.TopPanel(state="hidden" if plain else "expanded"),
        views.BlueprintPanel(state="hidden"),
        views.SelectionPanel(state="hidden"),
        views.TimePanel(
            state="collapsed", timeline="time", playback_speed=_PLAYBACK_SPEED, play_state=layout.play_state
        ),
        auto_views=False,
        auto_layout=False,
    )
    return made


class _Layout:
    """Makes the views of one blueprint."""

    def __init__(self, shown: Shown, *, live: bool) -> None:
        self._rr, self._rrb = load_rerun(), load_blueprint()
        self._shown = shown
        self._limits = dict(shown.task.constraints.items())
        times = shown.task.disturbances().times
        self._episode = self._absolute(times[0], times[shown.task.steps])
        self._days = self._last_days() if live else self._absolute(*shown.closeup())
        self._live = live
        self._margin = _LIVE_MARGIN if live else _MARGIN
        self.play_state = "following" if live else "paused"

    def overview(self) -> Any:
        rrb = self._rrb
        columns = [
            rrb.Vertical(*(self._small_plot(_BY_PATH[path]) for path in paths), name=f"Overview {number}")
            for number, paths in enumerate(OVERVIEW, 1)
        ]
        card = rrb.TextDocumentView(origin="card", name="Task and controllers")
        return rrb.Horizontal(card, *columns, column_shares=[0.8, 1.0, 1.0, 1.0], name="Overview")

    def page(self, page: Page) -> Any:
        plots = (self._plot(signal) for signal in page.signals)
        return self._rrb.Grid(*plots, grid_columns=page.columns, name=page.title)

    def _small_plot(self, signal: Signal) -> Any:
        """A plot of the overview: the sums, which leave their corner free, bear the legend for all."""
        return self._plot(signal, legend=signal.whole)

    def _plot(self, signal: Signal, *, legend: bool = True) -> Any:
        rrb = self._rrb
        values = self._values(signal)
        days = self._episode if signal.whole else self._days
        return rrb.TimeSeriesView(
            origin=signal.path,
            name=self._heading(signal),
            axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=days),
            axis_y=None if values is None else rrb.ScalarAxis(range=values),
            plot_legend=rrb.PlotLegend(self._free_corner(values), visible=legend),
        )

    def _free_corner(self, values: tuple[float, float] | None) -> Any:
        """Where sums, which start at 0 on the left, leave room: below where they mostly fall, else above."""
        corners = self._rrb.Corner2D
        return corners.LeftBottom if values is not None and -values[0] > values[1] else corners.LeftTop

    def _heading(self, signal: Signal) -> str:
        if signal.limits is None:
            return signal.heading
        limit = self._limits[signal.limits]
        return f"{signal.heading}, limits {limit.low:g} to {limit.high:g}"

    def _absolute(self, start: np.datetime64, end: np.datetime64) -> Any:
        rr = self._rr
        ends = [int(moment.astype("datetime64[ns]").astype(np.int64)) for moment in (start, end)]
        boundaries = [rr.TimeRangeBoundary.absolute(nanos=nanos) for nanos in ends]
        return rr.TimeRange(start=boundaries[0], end=boundaries[1])

    def _last_days(self) -> Any:
        boundary = self._rr.TimeRangeBoundary
        return self._rr.TimeRange(
            start=boundary.cursor_relative(seconds=-SHOWN_DAYS * HOURS_PER_DAY * 3600.0), end=boundary.cursor_relative()
        )

    def _values(self, signal: Signal) -> tuple[float, float] | None:
        """Range of values shown first; ``None`` leaves it to the viewer."""
        if signal in CONTROLS:
            return _SHUT_TO_OPEN
        seen = [signal.values(course.columns) for course in self._shown.courses if course.steps]
        bounds = [bound for values in seen for bound in (float(values.min()), float(values.max()))]
        if signal.limits is not None:
            limit = self._limits[signal.limits]
            bounds += [limit.low, limit.high]
        elif signal.whole and seen and not self._live:
            bounds += [0.0] if signal.from_zero else []
        else:
            return None
        return with_two_ticks(min(bounds), max(bounds), self._margin)


def with_two_ticks(low: float, high: float, margin: float) -> tuple[float, float]:
    """A range with ``low`` and ``high``, a share ``margin`` of room around them, and two ticks at least.

    The viewer labels powers of ten and their multiples; with only one of them in view nobody could read the scale.
    """
    room = margin * (high - low) or 1.0
    decade = 10.0 ** math.floor(math.log10(high - low)) if high > low else 1.0
    first, last = math.ceil((low - room) / decade) * decade, math.floor((high + room) / decade) * decade
    if first < last:
        return low - room, high + room
    below, above = last - (0 if last < first else decade), first + (0 if last < first else decade)
    if low - below <= above - high:
        return min(low - room, below - room), high + room
    return low - room, max(high + room, above + room)
