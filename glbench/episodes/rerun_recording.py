"""Trajectories as a recording of the Rerun viewer: curves, limits, the card, what they were made from, and the layout of the pages.

Every curve is sent as whole columns, which is a thousand times faster than value by value.
"""

from __future__ import annotations

import datetime as dt
import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.episodes.episode import ACTING, Episode, weeks_of
from glbench.episodes.signals import SCENE, Curve, Page, Signals, signals_of
from glbench.errors import GlbenchError, refuse
from glbench.extras import missing
from glbench.model.crop.trusses import row_of
from glbench.quantities import MONEY, in_sentence, pretty_unit, raised_unit
from glbench.resources import lacks_pictures, write_atomically
from glbench.tasks import TaskSpec, task_card
from glbench.tasks.prices import local_times
from glbench.vision.library import Library

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

APPLICATION = "glbench"
TIME = "time"
LOCAL_TIME = "local_time"  # The greenhouse's clock, a time line of its own beside UTC
STEP = "step"
_PICTURES = "pictures"
_NOON = 12.0  # Hour at which the picture of a row of tomatoes changes
_LINE_WIDTH = 1.6
_MARGIN = 0.04
_LIVE_MARGIN = 0.35  # Room above and below limits and curves, as a share of their range; more where the curves are still to come
_NOISE = 1e-9
"""Curves that nowhere get this far from 0, in their unit, are drawn as 0: what is left of rounding does not get a scale of its own."""
_PLAYBACK_SPEED = 3600.0  # Played back, an hour passes in a second
_PLOTS_ABREAST = 2

Times = NDArray[np.datetime64]
HOURS_PER_DAY = 24
SHOWN_DAYS = 2
_NOTHING = "There is nothing to show: no run was chosen."
_LEAST = 0.005  # What is smaller in every week is 0.00 in the table, and left out


@dataclass(frozen=True)
class Colour:
    """A colour with its name in words and its red, green and blue (0 to 255)."""

    name: str
    rgb: tuple[int, int, int]


PALETTE: tuple[Colour, ...] = (
    Colour("orange", (230, 159, 0)),
    Colour("sky blue", (86, 180, 233)),
    Colour("bluish green", (0, 158, 115)),
    Colour("reddish purple", (204, 121, 167)),
    Colour("yellow", (240, 228, 66)),
    Colour("vermilion", (213, 94, 0)),
)
"""In the order in which controllers get them. Black is left out, and blue: they drown in the viewer's dark plots."""

WEATHER = Colour("light grey", (190, 190, 190))
LIMITS = Colour("green", (96, 176, 96))


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One run of one controller.

    ``times`` is UTC at the start and at the end of every step, ``(steps + 1,)`` datetime64[ns]; ``columns`` holds the values of each step
    by column name, ``(steps,)`` float64 each. ``remark`` says why the run ended early, if it did. ``began`` is the day on which it began,
    where that is not the day from which its curves are drawn.
    """

    controller: str
    seed: int
    times: Times
    columns: Mapping[str, Floats]
    remark: str = ""
    began: dt.date | None = None

    @property
    def steps(self) -> int:
        """Number of steps."""
        return len(self.times) - 1


@dataclass(frozen=True, eq=False)
class RunSet:
    """Trajectories of one task to be shown together.

    ``labels`` are what the curves of each trajectory are called. ``signals`` are what is shown; every trajectory has the columns that it
    needs. ``first_day`` and ``days`` are what fast quantities show first; without a first day those with most violations.
    """

    task: TaskSpec
    trajectories: tuple[Trajectory, ...]
    labels: tuple[str, ...]
    signals: Signals
    first_day: dt.date | None = None
    days: int = SHOWN_DAYS

    def __post_init__(self) -> None:
        for trajectory in self.trajectories:
            lacking = [name for name in self.signals.needed if name not in trajectory.columns]
            if lacking:
                refuse(f"The record of '{trajectory.controller}' lacks {', '.join(lacking)}, which the viewer shows.", GlbenchError)

    @property
    def longest(self) -> Trajectory:
        """The trajectory with the most steps."""
        return max(self.trajectories, key=lambda trajectory: trajectory.steps)

    @property
    def times(self) -> Times:
        """UTC at the start and at the end of every step of the whole episode, ``(steps + 1,)``."""
        step = np.timedelta64(round(self.task.step_seconds * 1e9), "ns")
        times: Times = self.longest.times[0].astype("datetime64[ns]") + np.arange(self.task.steps + 1) * step
        return times

    def is_shared(self, curve: Curve) -> bool:
        """Whether a curve is the same for all trajectories: those of the weather are, when all have one season."""
        return curve.shared and all(trajectory.began is None for trajectory in self.trajectories)

    def pictures(self, trajectory: Trajectory) -> tuple[Library, NDArray[np.int64]] | None:
        """A library and its scene at the end of each step ``(steps,)``: what a camera saw, or the row of tomatoes nearest at noon.

        The seed chooses the plants of the row. ``None`` for other crops, and where the library or the package pillow is not installed.
        """
        columns, clock = trajectory.columns, self.signals.clock
        if self.task.picture_library is not None and SCENE in columns:
            return self.task.picture_library, columns[SCENE].astype(np.int64)
        row = row_of(columns, self.task.parameters_by_name())
        if row is None or clock not in columns or lacks_pictures() or missing("PIL"):
            return None
        states, hours, library = np.stack(row, axis=-1), columns[clock], Library.open("tomato")
        changes = np.append(0, np.flatnonzero((hours[1:] >= _NOON) & (hours[:-1] < _NOON)) + 1)[: len(hours)]
        return library, np.repeat(library.nearest(states[changes], trajectory.seed), np.diff(np.append(changes, len(hours))))

    def closeup(self) -> tuple[np.datetime64, np.datetime64]:
        """Start and end of the days that fast quantities show first, which are days of the greenhouse's clock where that is known.

        Without a chosen first day these are the whole days in which the shown runs together broke their limits most. Raises
        ``GlbenchError`` when the chosen day is none of the episode's.
        """
        times = self.longest.times
        per_day = round(HOURS_PER_DAY * 3600 / self.task.step_seconds)
        width = min(self.days * per_day, self.longest.steps)
        if self.first_day is not None:
            midnight, clock = np.datetime64(str(self.first_day), "ns"), local(self.longest, self.signals.clock)
            clock = times if clock is None else clock
            if not clock[0] - np.timedelta64(1, "D") < midnight < clock[-1]:
                msg = f"{self.first_day} is not a day of what is shown, which lasts from {str(clock[0])[:10]} to {str(clock[-1])[:10]}."
                raise GlbenchError(msg)
            first = int(np.argmax(clock >= midnight))
        else:
            penalty = np.zeros(self.longest.steps)
            for trajectory in self.trajectories:
                penalty[: trajectory.steps] += trajectory.columns[self.signals.worst]
            before, firsts = np.concatenate([[0.0], np.cumsum(penalty)]), np.arange(0, len(penalty) - width + 1, per_day)
            first = int(firsts[np.argmax(before[firsts + width] - before[firsts])])
        return times[first], times[min(first + width, self.longest.steps)]


def trajectory_of(episode: Episode) -> Trajectory:
    """The trajectory of a recorded episode."""
    run = episode.run
    columns = {name: np.asarray(episode[name], dtype=np.float64) for name in episode.names}
    remark = run.reason or episode.problem or ""
    return Trajectory(episode.provenance.agent.name, run.seed, episode.times, columns, remark)


def shown_of(episodes: Sequence[Episode]) -> RunSet:
    """Recorded episodes, to be shown together. Raises ``GlbenchError`` when they are not of the same task, and as ``show_together``."""
    if not episodes:
        raise GlbenchError(_NOTHING)
    facts = [episode.provenance.task for episode in episodes]
    for other in facts[1:]:
        if other.digest != facts[0].digest:
            what = "another version of it" if other.id == facts[0].id else other.id
            refuse(f"Only runs of one task can be shown together: the first is of {facts[0].id}, another of {what}.", GlbenchError)
    return show_together(episodes[0].task(), [trajectory_of(episode) for episode in episodes])


def provenance_words(episodes: Sequence[Episode]) -> dict[str, str]:
    """Where the shown runs come from, for the properties of the recording."""
    first = episodes[0].provenance
    words = {"task": first.task.id, "task_digest": first.task.digest, "glbench": first.versions["glbench"]}
    for number, episode in enumerate(episodes, 1):
        agent, run = episode.provenance.agent, episode.run
        words[f"run_{number}"] = f"{agent.name}, digest {agent.digest}, seed {run.seed}, {run.status}, {run.steps} steps"
    return words


def show_together(task: TaskSpec, trajectories: Sequence[Trajectory]) -> RunSet:
    """Trajectories with labels: the controller's name, with the seed where one controller is shown twice.

    Raises ``GlbenchError`` for no trajectory, an empty one, the same run twice, or more trajectories than there are colours.
    """
    if not trajectories:
        raise GlbenchError(_NOTHING)
    if len(trajectories) > len(PALETTE):
        msg = f"At most {len(PALETTE)} runs can be told apart by their colours; these are {len(trajectories)}. Choose fewer."
        raise GlbenchError(msg)
    for trajectory in trajectories:
        if trajectory.steps == 0:
            refuse(f"The run of '{trajectory.controller}' with seed {trajectory.seed} has no steps to show.", GlbenchError)
    names = [trajectory.controller for trajectory in trajectories]
    labels = tuple(
        name if names.count(name) == 1 else f"{name} (seed {trajectory.seed})" for name, trajectory in zip(names, trajectories, strict=True)
    )
    for label in labels:
        if labels.count(label) > 1:
            refuse(f"{label} is there twice. Give each run once, or rename one of the agents.", GlbenchError)
    signals = signals_of(task)
    derived = {one.name for one in signals.vector("derived")}  # records of earlier versions have fewer of them
    missing = {name for trajectory in trajectories for name in derived.difference(trajectory.columns)}
    first = trajectories[0].times[0]
    if any(one.times[0] != first for one in trajectories):  # runs of several seasons on the dates of the first
        trajectories = [replace(one, times=one.times - one.times[0] + first, began=_day(one.times[0])) for one in trajectories]
    return RunSet(task, tuple(trajectories), labels, signals.lacking(missing))


def _day(start: np.datetime64) -> dt.date:
    """The day that begins at ``start``, which is midnight on some clock [UTC]."""
    day: dt.date = (start.astype("datetime64[h]") + np.timedelta64(HOURS_PER_DAY // 2, "h")).astype("datetime64[D]").item()
    return day


def card(runs: RunSet) -> str:
    """The card beside the plots, as Markdown: the task in words, and who is shown in which colour."""
    task, signals, facts = runs.task, runs.signals, task_card(runs.task)
    limits = "; ".join(
        f"{signals.names.get(limit.name, limit.name)} **{limit.low:g} to {limit.high:g} {pretty_unit(limit.unit)}**"
        for limit in facts.constraints
    )
    several = any(trajectory.began for trajectory in runs.trajectories)
    start = _day(runs.trajectories[0].times[0])
    lines = [
        f"# {task.title}",
        "",
        " ".join(task.description.split()),
        "",
        f"**Where and when:** {facts.place.station}, from {start:%-d %B %Y}, {task.weather.days} days, "
        f"a decision every {task.step_seconds / 60:g} minutes."
        + (" The runs have seasons of their own, drawn on these dates." if several else ""),
        "",
        *([f"**Climate to stay within:** {limits}.", ""] if limits else []),
        f"**Prices:** {'; '.join(signals.prices)}.",
        "",
        f"Task `{task.id}`",
        "",
        "## Controllers",
        "",
    ]
    for colour, label, trajectory in zip(PALETTE, runs.labels, runs.trajectories, strict=False):
        began = f", from {trajectory.began:%-d %B %Y}" if trajectory.began else ""
        lines += [f"**{label}** ({colour.name}), seed {trajectory.seed}{began}", ""]
        lines += [f"- {line}" for line in _outcome(trajectory, signals)] if trajectory.steps else ["- running"]
        if trajectory.remark:
            lines.append(f"- **ended after step {trajectory.steps}: {trajectory.remark}**")
        lines.append("")
    lines += [
        "",
        "## Reading the plots",
        "",
        "Green: inside the limits. Slow quantities show the whole episode; the others show a few days, by default those in "
        "which limits were broken most. Ctrl + scroll zooms in and out, and the ? above a plot tells more. All amounts are "
        f"per m² of floor; times are UTC{_clock_words(runs)}.",
    ]
    return "\n".join(lines)


def weeks_card(runs: RunSet) -> str:
    """The accounts of every controller by week, as Markdown."""
    lines, signals, accounts = ["# By week", ""], runs.signals, runs.signals.accounts
    acting = (one.name for source in ACTING for one in signals.vector(source))
    needed = {*(line.column for line in accounts if line.column), *acting}
    for label, trajectory in zip(runs.labels, runs.trajectories, strict=True):
        clock = local(trajectory, runs.signals.clock)
        if clock is None or not needed <= trajectory.columns.keys():
            lines += [f"**{label}**: its record lacks what a table of weeks needs.", ""]
            continue
        weeks = weeks_of(trajectory.columns, runs.signals, clock)
        places = [place for place in range(len(accounts)) if abs(weeks.sums[:, place]).max() >= _LEAST]
        units = [raised_unit(line.unit) + (" d⁻¹" if line.kind == "light" else "") for line in accounts]
        heads = [f"{accounts[place].title} [{'–' if units[place] == '-' else units[place]}]" for place in places]
        lines += [f"**{label}**", "", f"| Week from | {' | '.join(heads)} |", f"|---|{'---:|' * len(heads)}"]
        for first, days, sums in zip(weeks.first, weeks.days, weeks.sums, strict=True):
            short = "" if days == weeks.days[0] else f" ({days} days)"
            lines.append(f"| {first}{short} | {' | '.join(f'{sums[place]:.2f}'.replace('-', '−') for place in places)} |")
        lines.append("")
    return "\n".join([*lines, "Light is the mean of a day. Natural gas by its lower heating value, 31.65 MJ m⁻³."])


def local(trajectory: Trajectory, clock: str) -> Times | None:
    """The moments of ``trajectory`` on the greenhouse's clock, whose hours are its column ``clock``; None where the record has none."""
    hours = trajectory.columns.get(clock)
    if hours is None or not trajectory.steps or not ((hours >= 0.0) & (hours <= 24.0)).all():
        return None
    ends = trajectory.times[1:]
    ahead = local_times(ends, hours) - ends.astype("datetime64[s]")
    runs: Times = trajectory.times + np.concatenate([ahead[:1], ahead])
    return runs


def _clock_words(runs: RunSet) -> str:
    """How far the greenhouse's clock is ahead of UTC, where it is."""
    first = runs.trajectories[0]
    clock = local(first, runs.signals.clock)
    if clock is None:
        return ""
    ahead = ((clock - first.times) / np.timedelta64(1, "h")).tolist()
    changes = [step for step in range(1, len(ahead)) if ahead[step] != ahead[step - 1]]
    if not any(ahead):
        return ""
    later = "".join(f", from {_day(first.times[step]):%-d %B} on UTC{ahead[step]:+g} h" for step in changes)
    return f", the greenhouse's clock is UTC{ahead[0]:+g} h{later}"


def _outcome(trajectory: Trajectory, signals: Signals) -> list[str]:
    def total(*names: str) -> float:
        return sum(float(trajectory.columns[name].sum()) for name in names)

    result = f"{total(signals.total):.2f}".replace("-", "−")
    harvest = (f"{total(amount.column):.2f} {amount.words}" for amount in signals.harvest)
    (score,) = (line for line in signals.accounts if line.kind == "score")
    decimals = 2 if score.unit == MONEY else 1
    score_words = f"{in_sentence(score.title)} {total(signals.reward):.{decimals}f} {pretty_unit(score.unit)}".rstrip()
    return [
        f"EPI {result} EUR/m² = revenue {total(*signals.income):.2f} − costs {total(*signals.costs):.2f}",
        "; ".join([*harvest, score_words]),
    ]


def load_rerun() -> Any:
    """The module ``rerun``. Raises ``GlbenchError`` when it is not installed; it says how to install it."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        msg = (
            "The viewer is not installed: it needs the package rerun-sdk. "
            'Install it with `pip install "glbench[view]"`, or in a checkout with `uv sync --inexact --extra view`.'
        )
        raise GlbenchError(msg) from error


def save_recording(runs: RunSet, path: Path, properties: Mapping[str, str] | None = None, *, plain: bool = False) -> None:
    """Write ``runs`` with their blueprint to ``path`` (.rrd), whole or not at all.

    ``properties`` are the provenance in words, kept in the recording. A ``plain`` one has no menu of the viewer, for pictures. Raises
    ``GlbenchError`` without the viewer's package, when the chosen days are none of the episode's, or when the file cannot be written.
    """
    rerun = load_rerun()
    runs.closeup()  # an impossible choice of days raises before anything is made
    # A name in the viewer: the same runs of the same task replace each other there.
    names = "+".join(f"{trajectory.controller}-{trajectory.seed}" for trajectory in runs.trajectories)
    stream = rerun.RecordingStream(APPLICATION, recording_id=f"{runs.task.short_id}:{names}")
    memory = stream.memory_recording()
    send_frame(stream, runs)
    if properties:
        stream.send_property("glbench", rerun.AnyValues(**properties))
    send_trajectories(stream, runs)
    send_text(stream, "weeks", weeks_card(runs))
    send_limits(stream, runs, [0, runs.task.steps])
    stream.send_blueprint(blueprint(runs, plain=plain), make_active=True, make_default=True)
    write_atomically(path, memory.drain_as_bytes())


def send_frame(stream: rr.RecordingStream, runs: RunSet) -> None:
    """Send what does not depend on the values: name, styles, card."""
    rerun = load_rerun()
    stream.send_recording_name(f"{runs.task.short_id}: {', '.join(runs.labels)}")
    for curve in runs.signals.curves:
        if curve.limits is not None:
            limit = dict(runs.task.constraints.items())[curve.limits]
            words = f"limits {limit.low:g} to {limit.high:g} [{curve.unit}]"
            style = rerun.Measurements.from_fields(names=words, colors=LIMITS.rgb, widths=0.0)
            stream.log(_entity(curve, "limits"), style, static=True)
        if runs.is_shared(curve):
            _send_style(stream, curve, None, WEATHER)
            continue
        for colour, label in zip(PALETTE, runs.labels, strict=False):
            _send_style(stream, curve, label, colour)
    send_text(stream, "card", card(runs))


def send_text(stream: rr.RecordingStream, place: str, text: str) -> None:
    """Send a document in Markdown, or a new one in the place of an earlier one."""
    rerun = load_rerun()
    stream.log(place, rerun.TextDocument(text, media_type=rerun.MediaType.MARKDOWN), static=True)


def send_trajectories(stream: rr.RecordingStream, runs: RunSet, first: int = 0) -> None:
    """Send the curves of all controllers from step ``first`` on; those that are the same for all once, from the longest trajectory."""
    for curve in runs.signals.curves:
        if runs.is_shared(curve):
            _send_curve(stream, _entity(curve, None), curve, runs.longest, first, runs.signals.clock)
            continue
        for label, trajectory in zip(runs.labels, runs.trajectories, strict=True):
            _send_curve(stream, _entity(curve, label), curve, trajectory, first, runs.signals.clock)
    for label, trajectory in zip(runs.labels, runs.trajectories, strict=True):
        if (pictures := runs.pictures(trajectory)) is not None:
            _send_pictures(stream, label, trajectory, *pictures, local(trajectory, runs.signals.clock))


def _send_pictures(
    stream: rr.RecordingStream, label: str, trajectory: Trajectory, library: Library, scenes: NDArray[np.int64], clock: Times | None
) -> None:
    """Send each picture at the end of the step after which the agent saw it; the first one at the start."""
    for step in [0, *(np.flatnonzero(np.diff(scenes)) + 2).tolist()] if len(scenes) else []:
        stream.set_time(STEP, sequence=step)
        for name, times in ((TIME, trajectory.times), (LOCAL_TIME, clock)):
            if times is not None:
                stream.set_time(name, timestamp=times[step].astype("datetime64[ns]"))
        stream.log([_PICTURES, label], load_rerun().Image(library.image(scenes[max(step - 1, 0)])))
    stream.reset_time()


def send_limits(stream: rr.RecordingStream, runs: RunSet, steps: Sequence[int]) -> None:
    """Send the bands between the limits at the ends of ``steps``; the viewer draws them from one to the next.

    A band is a measurement in its middle whose deviation is half its width; its own line has no width.
    """
    rerun, places, clock = load_rerun(), list(steps), local(runs.longest, runs.signals.clock)
    indexes = _indexes(places, runs.times[places], None if clock is None or max(steps) >= len(clock) else clock[places])
    for curve in runs.signals.curves:
        if curve.limits is None:
            continue
        limit = dict(runs.task.constraints.items())[curve.limits]
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


def _send_curve(stream: rr.RecordingStream, path: str, curve: Curve, trajectory: Trajectory, first: int, hours: str) -> None:
    moments, clock = slice(first, -1) if curve.moment == "start" else slice(first + 1, None), local(trajectory, hours)
    steps = np.arange(first, trajectory.steps) + 1
    indexes = _indexes(steps, trajectory.times[moments], None if clock is None else clock[moments])
    values = curve.values(trajectory.columns)[first:]
    stream.send_columns(path, indexes=indexes, columns=load_rerun().Scalars.columns(scalars=values))


def _indexes(steps: Any, times: Times, clock: Times | None) -> list[Any]:
    """The time lines of values: step, UTC, and the greenhouse's clock where it is known."""
    rerun, moments = load_rerun(), {TIME: times} | ({} if clock is None else {LOCAL_TIME: clock})
    lines = [rerun.TimeColumn(name, timestamp=values.astype("datetime64[ns]")) for name, values in moments.items()]
    return [rerun.TimeColumn(STEP, sequence=steps), *lines]


def _send_style(stream: rr.RecordingStream, curve: Curve, label: str | None, colour: Colour) -> None:
    rerun = load_rerun()
    modes = rerun.components.InterpolationMode
    style = rerun.SeriesLines(
        names=f"{label or curve.title} [{curve.unit}]",
        colors=colour.rgb,
        widths=_LINE_WIDTH,
        interpolation_mode=modes.StepAfter if curve.moment == "start" else modes.Linear,
        # Many steps share a pixel when days are squeezed: the mean of the extremes hides no excursion.
        aggregation_policy=rerun.components.AggregationPolicy.MinMaxAverage,
    )
    stream.log(_entity(curve, label), style, static=True)


def blueprint(runs: RunSet, *, live: bool = False, plain: bool = False) -> rrb.Blueprint:
    """The layout for ``runs``: an overview that a grower reads at a glance, a page a group, and the panels for experts folded away.

    A ``live`` one follows the newest values and keeps the last days before them in view. A ``plain`` one, for pictures, has no menu either.
    """
    layout = _Layout(runs, live=live)
    views = layout.views
    page: rrb.Blueprint = views.Blueprint(
        views.Tabs(
            layout.overview(),
            *map(layout.page, runs.signals.pages),
            *([] if live else [views.TextDocumentView(origin="weeks", name="By week")]),
            active_tab=0,
            name="Episode",
        ),
        views.TopPanel(state="hidden" if plain else "expanded"),
        views.BlueprintPanel(state="hidden"),
        views.SelectionPanel(state="hidden"),
        views.TimePanel(state="collapsed", timeline=TIME, playback_speed=_PLAYBACK_SPEED, play_state="following" if live else "paused"),
        auto_views=False,
        auto_layout=False,
    )
    return page


class _Layout:
    """Makes the views of one blueprint."""

    def __init__(self, runs: RunSet, *, live: bool) -> None:
        self._rr = load_rerun()
        self.views = self._rrb = importlib.import_module("rerun.blueprint")
        self._run_set, self._live = runs, live
        self._limits = dict(runs.task.constraints.items())
        times = runs.times
        self._episode = self._absolute(times[0], times[runs.task.steps])
        if live:
            boundary = self._rr.TimeRangeBoundary
            self._days = self._rr.TimeRange(
                start=boundary.cursor_relative(seconds=-SHOWN_DAYS * HOURS_PER_DAY * 3600.0), end=boundary.cursor_relative()
            )
        else:
            self._days = self._absolute(*runs.closeup())

    def overview(self) -> Any:
        rrb, by_path = self._rrb, {curve.path: curve for curve in self._run_set.signals.curves}
        # The sums, which leave their corner free, bear the legend for all.
        columns = [
            rrb.Vertical(*(self._plot(by_path[path], legend=by_path[path].whole) for path in paths), name=f"Overview {number}")
            for number, paths in enumerate(self._run_set.signals.overview, 1)
        ]
        card = rrb.TextDocumentView(origin="card", name="Task and controllers")
        runs = zip(self._run_set.labels, self._run_set.trajectories, strict=True)
        path = self._rr.new_entity_path
        if pictures := [
            rrb.Spatial2DView(origin=path([_PICTURES, label]), name=label) for label, one in runs if self._run_set.pictures(one)
        ]:
            card = rrb.Vertical(card, rrb.Tabs(*pictures, name="Crop"), row_shares=[3, 2])
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
            axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=self._episode if curve.whole else self._days),
            axis_y=None if values is None else rrb.ScalarAxis(range=values),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftBottom if falls else rrb.Corner2D.LeftTop, visible=legend),
        )

    def _absolute(self, start: np.datetime64, end: np.datetime64) -> Any:
        rr = self._rr
        ends = [int(moment.astype("datetime64[ns]").astype(np.int64)) for moment in (start, end)]
        boundaries = [rr.TimeRangeBoundary.absolute(nanos=nanos) for nanos in ends]
        return rr.TimeRange(start=boundaries[0], end=boundaries[1])

    def _values(self, curve: Curve) -> tuple[float, float] | None:
        """Range of values shown first; ``None`` leaves it to the viewer."""
        if curve.span is not None:
            return curve.span
        curves = [curve.values(trajectory.columns) for trajectory in self._run_set.trajectories if trajectory.steps]
        bounds = [bound for values in curves for bound in (float(values.min()), float(values.max()))]
        if curves and not self._live and max(map(abs, bounds)) < _NOISE:
            bounds = [0.0]
        if curve.limits is not None:
            limit = self._limits[curve.limits]
            bounds += [limit.low, limit.high]
        elif curve.whole and curves and not self._live:
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
