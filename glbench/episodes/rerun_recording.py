"""Courses as a recording of the Rerun viewer: curves, limits, the card, and what they were made from.

Every curve is sent as whole columns, which is a thousand times faster than value by value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from glbench.episodes.rerun_blueprint import blueprint
from glbench.episodes.rerun_card import card
from glbench.episodes.rerun_colours import LIMITS, PALETTE, WEATHER, Colour
from glbench.episodes.rerun_course import Course, Shown
from glbench.episodes.rerun_package import load_rerun
from glbench.episodes.rerun_signals import SIGNALS, Floats, Signal
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec

if TYPE_CHECKING:
    import rerun as rr

APPLICATION = "glbench"
TIME = "time"
STEP = "step"
_LINE_WIDTH = 1.6


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
    shown.closeup()  # an impossible choice of days is told before anything is made
    stream = rerun.RecordingStream(APPLICATION, recording_id=recording_id(shown))
    memory = stream.memory_recording()
    send_shown(stream, shown, properties or {}, plain=plain)
    write_atomically(path, memory.drain_as_bytes())


def recording_id(shown: Shown) -> str:
    """Name of the recording in the viewer: the same runs of the same task replace each other there."""
    runs = "+".join(f"{course.controller}-{course.seed}" for course in shown.courses)
    return f"{shown.task.short_id}:{runs}"


def send_shown(stream: rr.RecordingStream, shown: Shown, properties: Mapping[str, str], *, plain: bool = False) -> None:
    """Send everything: properties, styles, limits, card, curves and the blueprint."""
    rerun = load_rerun()
    send_frame(stream, shown)
    if properties:
        stream.send_property("glbench", rerun.AnyValues(**properties))
    for label, course in zip(shown.labels, shown.courses, strict=True):
        send_course(stream, label, course)
    send_weather(stream, shown.longest)
    send_limits(stream, shown.task, [0, shown.task.steps])
    send_layout(stream, shown, plain=plain)


def send_layout(stream: rr.RecordingStream, shown: Shown, *, live: bool = False, plain: bool = False) -> None:
    """Send the blueprint; see ``blueprint``."""
    stream.send_blueprint(blueprint(shown, live=live, plain=plain), make_active=True, make_default=True)


def send_card(stream: rr.RecordingStream, shown: Shown) -> None:
    """Send the card, or a new one in the place of an earlier one."""
    rerun = load_rerun()
    stream.log("card", rerun.TextDocument(card(shown), media_type=rerun.MediaType.MARKDOWN), static=True)


def send_frame(stream: rr.RecordingStream, shown: Shown) -> None:
    """Send what does not depend on the values: name, styles, card."""
    stream.send_recording_name(f"{shown.task.short_id}: {', '.join(shown.labels)}")
    for signal in SIGNALS:
        if signal.limits is not None:
            _send_band_style(stream, shown.task, signal)
        if signal.shared:
            _send_style(stream, entity(signal, None), signal, signal.title, WEATHER)
            continue
        for colour, label in zip(PALETTE, shown.labels, strict=False):
            _send_style(stream, entity(signal, label), signal, label, colour)
    send_card(stream, shown)


def entity(signal: Signal, label: str | None) -> str:
    """Path of a curve in the recording."""
    rerun = load_rerun()
    parts = signal.path.split("/")
    path: str = rerun.new_entity_path(parts if label is None else [*parts, label])
    return path


def send_course(stream: rr.RecordingStream, label: str, course: Course, first: int = 0) -> None:
    """Send the curves of one controller from step ``first`` on."""
    for signal in SIGNALS:
        if not signal.shared:
            _send_curve(stream, entity(signal, label), signal, course, first)


def send_weather(stream: rr.RecordingStream, course: Course, first: int = 0) -> None:
    """Send the weather, which is the task's and the same for all, from any course of it."""
    for signal in SIGNALS:
        if signal.shared:
            _send_curve(stream, entity(signal, None), signal, course, first)


def _send_curve(stream: rr.RecordingStream, path: str, signal: Signal, course: Course, first: int) -> None:
    rerun = load_rerun()
    times = course.times[:-1] if signal.moment == "start" else course.times[1:]
    values: Floats = signal.values(course.columns)
    stream.send_columns(
        path,
        indexes=[
            rerun.TimeColumn(STEP, sequence=np.arange(first, course.steps) + 1),
            rerun.TimeColumn(TIME, timestamp=times[first:].astype("datetime64[ns]")),
        ],
        columns=rerun.Scalars.columns(scalars=values[first:]),
    )


def _send_style(stream: rr.RecordingStream, path: str, signal: Signal, label: str, colour: Colour) -> None:
    rerun = load_rerun()
    drawn = rerun.components.InterpolationMode
    style = rerun.SeriesLines(
        names=f"{label} [{signal.unit}]",
        colors=colour.rgb,
        widths=_LINE_WIDTH,
        interpolation_mode=drawn.StepAfter if signal.moment == "start" else drawn.Linear,
        # Many steps share a pixel when days are squeezed: the mean of the extremes hides no excursion.
        aggregation_policy=rerun.components.AggregationPolicy.MinMaxAverage,
    )
    stream.log(path, style, static=True)


def send_limits(stream: rr.RecordingStream, task: TaskSpec, steps: Sequence[int]) -> None:
    """Send the bands between the limits at the ends of ``steps``; the viewer draws them from one to the next.

    A band is a measurement in its middle whose deviation is half its width; its own line has no width.
    """
    rerun = load_rerun()
    moments = task.disturbances().times[list(steps)].astype("datetime64[ns]")
    for signal in SIGNALS:
        if signal.limits is None:
            continue
        limit = dict(task.constraints.items())[signal.limits]
        middle, half = (limit.high + limit.low) / 2.0, (limit.high - limit.low) / 2.0
        stream.send_columns(
            entity(signal, "limits"),
            indexes=[rerun.TimeColumn(STEP, sequence=list(steps)), rerun.TimeColumn(TIME, timestamp=moments)],
            columns=rerun.Measurements.columns(values=[middle] * len(steps), variances=[half**2] * len(steps)),
        )


def _send_band_style(stream: rr.RecordingStream, task: TaskSpec, signal: Signal) -> None:
    rerun = load_rerun()
    limit = dict(task.constraints.items())[str(signal.limits)]
    style = rerun.Measurements.from_fields(
        names=f"limits {limit.low:g} to {limit.high:g} [{signal.unit}]", colors=LIMITS.rgb, widths=0.0
    )
    stream.log(entity(signal, "limits"), style, static=True)
