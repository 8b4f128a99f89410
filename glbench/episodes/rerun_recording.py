"""Trajectories as a recording of the Rerun viewer: curves, limits, the card, what they were made from, and the layout of the pages.

Every curve is sent as whole columns, which is a thousand times faster than value by value.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from glbench.episodes.rerun_course import (
    HOURS_PER_DAY,
    LIMITS,
    PALETTE,
    SHOWN_DAYS,
    WEATHER,
    Colour,
    Shown,
    Trajectory,
    card,
    local,
    weeks_card,
)
from glbench.episodes.rerun_viewer import load_blueprint, load_rerun
from glbench.episodes.signals import Curve, Page
from glbench.resources import write_atomically

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

APPLICATION = "glbench"
TIME = "time"
LOCAL_TIME = "local_time"
"""The greenhouse's clock, a time line of its own beside UTC."""
STEP = "step"
_LINE_WIDTH = 1.6
_MARGIN = 0.04
_LIVE_MARGIN = 0.35
"""Room above and below limits and curves, as a share of their range; more where the curves are still to come."""
_NOISE = 1e-9
"""Curves that nowhere get this far from 0, in their unit, are drawn as 0: what is left of rounding does not get a scale of its own."""
_PLAYBACK_SPEED = 3600.0
"""Played back, an hour passes in a second."""
_PLOTS_ABREAST = 2


def save_recording(
    shown: Shown, path: Path, properties: Mapping[str, str] | None = None, *, plain: bool = False
) -> None:
    """Write ``shown`` with its blueprint to ``path`` (.rrd), whole or not at all.

    Parameters
    ----------
    shown
        What is shown.
    path
        The file.
    properties
        Provenance in words, kept in the recording: digests, versions.
    plain
        Without the viewer's menu, for pictures.

    Raises
    ------
    GlbenchError
        Without the viewer's package, when the chosen days are none of the episode's, or when the file cannot be written.
    """
    rerun = load_rerun()
    shown.closeup()  # an impossible choice of days raises before anything is made
    # A name in the viewer: the same runs of the same task replace each other there.
    runs = "+".join(f"{trajectory.controller}-{trajectory.seed}" for trajectory in shown.trajectories)
    stream = rerun.RecordingStream(APPLICATION, recording_id=f"{shown.task.short_id}:{runs}")
    memory = stream.memory_recording()
    send_frame(stream, shown)
    if properties:
        stream.send_property("glbench", rerun.AnyValues(**properties))
    send_trajectories(stream, shown)
    stream.log("weeks", rerun.TextDocument(weeks_card(shown), media_type=rerun.MediaType.MARKDOWN), static=True)
    send_limits(stream, shown, [0, shown.task.steps])
    send_layout(stream, shown, plain=plain)
    write_atomically(path, memory.drain_as_bytes())


def send_frame(stream: rr.RecordingStream, shown: Shown) -> None:
    """Send what does not depend on the values: name, styles, card."""
    rerun = load_rerun()
    stream.send_recording_name(f"{shown.task.short_id}: {', '.join(shown.labels)}")
    for curve in shown.signals.curves:
        if curve.limits is not None:
            limit = dict(shown.task.constraints.items())[curve.limits]
            words = f"limits {limit.low:g} to {limit.high:g} [{curve.unit}]"
            style = rerun.Measurements.from_fields(names=words, colors=LIMITS.rgb, widths=0.0)
            stream.log(_entity(curve, "limits"), style, static=True)
        if shown.is_shared(curve):
            _send_style(stream, curve, None, WEATHER)
            continue
        for colour, label in zip(PALETTE, shown.labels, strict=False):
            _send_style(stream, curve, label, colour)
    send_card(stream, shown)


def send_card(stream: rr.RecordingStream, shown: Shown) -> None:
    """Send the card, or a new one in the place of an earlier one."""
    rerun = load_rerun()
    stream.log("card", rerun.TextDocument(card(shown), media_type=rerun.MediaType.MARKDOWN), static=True)


def send_trajectories(stream: rr.RecordingStream, shown: Shown, first: int = 0) -> None:
    """Send the curves of all controllers from step ``first`` on; those that are the same for all once, from the longest trajectory."""
    for curve in shown.signals.curves:
        if shown.is_shared(curve):
            _send_curve(stream, _entity(curve, None), curve, shown.longest, first, shown.signals.clock)
            continue
        for label, trajectory in zip(shown.labels, shown.trajectories, strict=True):
            _send_curve(stream, _entity(curve, label), curve, trajectory, first, shown.signals.clock)


def send_limits(stream: rr.RecordingStream, shown: Shown, steps: Sequence[int]) -> None:
    """Send the bands between the limits at the ends of ``steps``; the viewer draws them from one to the next.

    A band is a measurement in its middle whose deviation is half its width; its own line has no width.
    """
    rerun = load_rerun()
    indexes = [
        rerun.TimeColumn(STEP, sequence=list(steps)),
        rerun.TimeColumn(TIME, timestamp=shown.times[list(steps)]),
    ]
    clock = local(shown.longest, shown.signals.clock)
    if clock is not None and max(steps) < len(clock):
        indexes.append(rerun.TimeColumn(LOCAL_TIME, timestamp=clock[list(steps)].astype("datetime64[ns]")))
    for curve in shown.signals.curves:
        if curve.limits is None:
            continue
        limit = dict(shown.task.constraints.items())[curve.limits]
        middle, half = (limit.high + limit.low) / 2.0, (limit.high - limit.low) / 2.0
        stream.send_columns(
            _entity(curve, "limits"),
            indexes=indexes,
            columns=rerun.Measurements.columns(values=[middle] * len(steps), variances=[half**2] * len(steps)),
        )


def _entity(curve: Curve, label: str | None) -> str:
    """Path of a curve in the recording."""
    parts = curve.path.split("/")
    path: str = load_rerun().new_entity_path(parts if label is None else [*parts, label])
    return path


def _send_curve(
    stream: rr.RecordingStream, path: str, curve: Curve, trajectory: Trajectory, first: int, hours: str
) -> None:
    rerun = load_rerun()
    moments = slice(first, -1) if curve.moment == "start" else slice(first + 1, None)
    indexes = [
        rerun.TimeColumn(STEP, sequence=np.arange(first, trajectory.steps) + 1),
        rerun.TimeColumn(TIME, timestamp=trajectory.times[moments].astype("datetime64[ns]")),
    ]
    clock = local(trajectory, hours)
    if clock is not None:
        indexes.append(rerun.TimeColumn(LOCAL_TIME, timestamp=clock[moments].astype("datetime64[ns]")))
    stream.send_columns(
        path,
        indexes=indexes,
        columns=rerun.Scalars.columns(scalars=curve.values(trajectory.columns)[first:]),
    )


def _send_style(stream: rr.RecordingStream, curve: Curve, label: str | None, colour: Colour) -> None:
    rerun = load_rerun()
    drawn = rerun.components.InterpolationMode
    style = rerun.SeriesLines(
        names=f"{label or curve.title} [{curve.unit}]",
        colors=colour.rgb,
        widths=_LINE_WIDTH,
        interpolation_mode=drawn.StepAfter if curve.moment == "start" else drawn.Linear,
        # Many steps share a pixel when days are squeezed: the mean of the extremes hides no excursion.
        aggregation_policy=rerun.components.AggregationPolicy.MinMaxAverage,
    )
    stream.log(_entity(curve, label), style, static=True)


def send_layout(stream: rr.RecordingStream, shown: Shown, *, live: bool = False, plain: bool = False) -> None:
    """Send the blueprint; see ``blueprint``."""
    stream.send_blueprint(blueprint(shown, live=live, plain=plain), make_active=True, make_default=True)


def blueprint(shown: Shown, *, live: bool = False, plain: bool = False) -> rrb.Blueprint:
    """The layout for ``shown``: an overview that a grower reads at a glance, a page a group, and the panels for experts folded away.

    A ``live`` one follows the newest values and keeps the last days before them in view. A ``plain`` one, for pictures, has no
    menu either.
    """
    views = load_blueprint()
    layout = _Layout(shown, live=live)
    made: rrb.Blueprint = views.Blueprint(
        views.Tabs(
            layout.overview(),
            *map(layout.page, shown.signals.pages),
            *([] if live else [views.TextDocumentView(origin="weeks", name="By week")]),
            active_tab=0,
            name="Episode",
        ),
        views.TopPanel(state="hidden" if plain else "expanded"),
        views.BlueprintPanel(state="hidden"),
        views.SelectionPanel(state="hidden"),
        views.TimePanel(
            state="collapsed",
            timeline=TIME,
            playback_speed=_PLAYBACK_SPEED,
            play_state="following" if live else "paused",
        ),
        auto_views=False,
        auto_layout=False,
    )
    return made


class _Layout:
    """Makes the views of one blueprint."""

    def __init__(self, shown: Shown, *, live: bool) -> None:
        self._rr, self._rrb = load_rerun(), load_blueprint()
        self._shown, self._live = shown, live
        self._limits = dict(shown.task.constraints.items())
        times = shown.times
        self._episode = self._absolute(times[0], times[shown.task.steps])
        self._days = self._last_days() if live else self._absolute(*shown.closeup())

    def overview(self) -> Any:
        rrb, by_path = self._rrb, {curve.path: curve for curve in self._shown.signals.curves}
        # The sums, which leave their corner free, bear the legend for all.
        columns = [
            rrb.Vertical(
                *(self._plot(by_path[path], legend=by_path[path].whole) for path in paths), name=f"Overview {number}"
            )
            for number, paths in enumerate(self._shown.signals.overview, 1)
        ]
        card = rrb.TextDocumentView(origin="card", name="Task and controllers")
        return rrb.Horizontal(card, *columns, column_shares=[0.8, *(1.0 for _ in columns)], name="Overview")

    def page(self, page: Page) -> Any:
        return self._rrb.Grid(*map(self._plot, page.curves), grid_columns=_PLOTS_ABREAST, name=page.title)

    def _plot(self, curve: Curve, *, legend: bool = True) -> Any:
        rrb = self._rrb
        values = self._values(curve)
        limit = None if curve.limits is None else self._limits[curve.limits]
        # Sums, which start at 0 on the left, leave room below where they mostly fall, else above.
        falls = values is not None and -values[0] > values[1]
        return rrb.TimeSeriesView(
            origin=curve.path,
            name=curve.heading if limit is None else f"{curve.heading}, limits {limit.low:g} to {limit.high:g}",
            axis_x=rrb.TimeAxis(
                link=rrb.components.LinkAxis.Independent, view_range=self._episode if curve.whole else self._days
            ),
            axis_y=None if values is None else rrb.ScalarAxis(range=values),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftBottom if falls else rrb.Corner2D.LeftTop, visible=legend),
        )

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

    def _values(self, curve: Curve) -> tuple[float, float] | None:
        """Range of values shown first; ``None`` leaves it to the viewer."""
        if curve.span is not None:
            return curve.span
        seen = [curve.values(trajectory.columns) for trajectory in self._shown.trajectories if trajectory.steps]
        bounds = [bound for values in seen for bound in (float(values.min()), float(values.max()))]
        if seen and not self._live and max(map(abs, bounds)) < _NOISE:
            bounds = [0.0]
        if curve.limits is not None:
            limit = self._limits[curve.limits]
            bounds += [limit.low, limit.high]
        elif curve.whole and seen and not self._live:
            bounds += [0.0] if curve.summed else []
        elif bounds != [0.0]:
            return None
        return with_two_ticks(min(bounds), max(bounds), _LIVE_MARGIN if self._live else _MARGIN)


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
