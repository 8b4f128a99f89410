"""What one agent does differently from another, and what that earns: their recorded actions on the same seeds, taken again side by side.

Each step of a run belongs to one of four periods of the day, which add up to the run. Everything told of a period is a mean or a sum
over its steps; none of it says why.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.episodes import ActionLog, Episode, replayed_episodes
from glbench.episodes.episode import local_days, sums_by
from glbench.episodes.recorder import LARGEST_TRACE, bytes_a_step
from glbench.episodes.signals import Curve, Line, signals_of
from glbench.errors import ResultError
from glbench.evaluation import Result, load_result
from glbench.evaluation.saving import recorded_actions, task_of_result
from glbench.kernel import make_kernel
from glbench.leaderboard.pairs import failures
from glbench.report.task_words import clock_of

if TYPE_CHECKING:
    from glbench.env.kernels import Stepper
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]
Places = NDArray[np.integer[Any]]

DARK = 5.0
"""Global radiation outside below which it is dark [W m-2]."""
BEFORE_LIGHT, AFTER_LIGHT = 1.0, 2.0
"""Dawn: from so long before the first light of a day until so long after it [h]."""
NIGHT, DAWN, DAY = range(3)
"""Parts of a day."""
PERIODS = ("night", "dawn", "bright days", "dull days")
BRIGHT_DAYS, DULL_DAYS = 2, 3
MEANINGS = (
    f"from dusk until {BEFORE_LIGHT:g} h before the first light; it is dark below {DARK:g} W/m² outside",
    f"from {BEFORE_LIGHT:g} h before the first light until {AFTER_LIGHT:g} h after it",
    "the rest of those days on which the sum of radiation outside is at least the median of all days and runs",
    "the rest of the other days",
)
_RADIATION = "iGlob"
_HOURS = 24
_DAYS = 7
_SHOWN = ("Climate", "Controls")


@dataclass(frozen=True, eq=False)
class Story:
    """Two agents on the same runs; index 0 of an axis of two is the agent, 1 the one that it is held against.

    Attributes
    ----------
    task
        With the draws of the runs.
    agents, seeds
        Their names, and the runs that both ended.
    left_out
        Seeds that both have and that one of them did not end.
    failed
        Of each agent that did not end all shared runs, how many failed and how.
    levels
        What is shown as a mean: climate and controls, as the viewer draws them.
    lines
        What is shown as a sum: light, amounts, money.
    clock
        The clock of the hours and days.
    hours
        Mean levels by hour of the local day, ``(2, 24, levels)``.
    times
        Hours a run in each period, ``(periods,)``, mean over the runs.
    means
        Mean levels in each period, ``(2, periods, levels)``; not a number in a period that never was.
    sums
        Sums of the lines, ``(2, runs, periods, lines)``.
    weeks
        Sums of the lines by week of the run, mean over the runs, ``(2, weeks, lines)``; of light the mean of a day.
    days
        Days of each week, ``(weeks,)``.
    """

    task: TaskSpec
    agents: tuple[str, str]
    seeds: tuple[int, ...]
    left_out: tuple[int, ...]
    failed: tuple[str, ...]
    levels: tuple[Curve, ...]
    lines: tuple[Line, ...]
    clock: str
    hours: Floats
    times: Floats
    means: Floats
    sums: Floats
    weeks: Floats
    days: Places

    def line(self, kind: str) -> int:
        """Place of the one line of a kind: profit, violations, score."""
        return next(place for place, line in enumerate(self.lines) if line.kind == kind)

    def gaps(self) -> Floats:
        """Agent minus the other, mean over the runs, ``(periods, lines)``."""
        found: Floats = (self.sums[0] - self.sums[1]).mean(axis=0)
        return found


def tell(path: Path, against: Path, workers: int = 1) -> Story:
    """The story of the result at ``path`` against that at ``against``, from the actions recorded beside them.

    Raises
    ------
    ResultError
        When they are not of one task and split, have no run in common that both ended, or are of one agent.
    EpisodeError
        When the recorded actions of one are missing or of another result.
    """
    paths = (path, against)
    results = (load_result(path), load_result(against))
    _check(paths, results)
    task = task_of_result(results[0], path)
    shared = sorted({run.seed for run in results[0].runs} & {run.seed for run in results[1].runs})
    ended = [{run.seed for run in one.runs if run.status == "ok"} for one in results]
    seeds = tuple(seed for seed in shared if seed in ended[0] and seed in ended[1])
    common = [[run for run in one.runs if run.seed in shared] for one in results]
    told = [failures(one.agent.name, runs) for one, runs in zip(results, common, strict=True)]
    failed = tuple(words for words in told if words)
    if not shared:
        msg = (
            f"{path} and {against} have no seed in common. "
            "Evaluate one of them again with the seeds of the other (--seed, --runs)."
        )
        raise ResultError(msg)
    if not seeds:
        broken = " and ".join(str(place) for place, words in zip(paths, told, strict=True) if words)
        msg = (
            f"{'; '.join(failed)}. The two have no run in common that both ended, so there is nothing to tell. "
            f"The reasons of the failures stand in {broken}."
        )
        raise ResultError(msg)
    logs = [recorded_actions(result, place) for result, place in zip(results, paths, strict=True)]
    with make_kernel(task.model_value, task.step_seconds, workers=workers) as kernel:
        sides = [_side(task, log, seeds, kernel) for log in logs]
    signals = signals_of(task)
    return Story(
        task=task,
        agents=(results[0].agent.name, results[1].agent.name),
        seeds=seeds,
        left_out=tuple(seed for seed in shared if seed not in seeds),
        failed=failed,
        levels=levels_of(task),
        lines=signals.accounts,
        clock=clock_of(task),
        hours=np.stack([side.hours for side in sides]),
        times=sides[0].times,
        means=np.stack([side.means for side in sides]),
        sums=np.stack([side.sums for side in sides]),
        weeks=np.stack([side.weeks for side in sides]),
        days=sides[0].days,
    )


def _check(paths: tuple[Path, Path], results: tuple[Result, Result]) -> None:
    one, other = results
    if (one.task.digest, one.task.split) != (other.task.digest, other.task.split):
        msg = f"{paths[0]} is of {_whose(one)}, {paths[1]} of {_whose(other)}: only results of one task can be told against each other."
        raise ResultError(msg)
    if one.agent.name == other.agent.name:
        msg = (
            f"Both results are of {one.agent.name}. Give one of another agent: --against NAME or --against RESULT.json."
        )
        raise ResultError(msg)


def _whose(result: Result) -> str:
    return (
        f"{result.task.id}{f' ({result.task.split})' if result.task.split else ''}, digest {result.task.digest[:12]}..."
    )


def levels_of(task: TaskSpec) -> tuple[Curve, ...]:
    """Climate and controls, without sums since midnight."""
    today = {drawn.path for drawn in task.model_value.signals() if drawn.today is not None}
    pages = (page for page in signals_of(task).pages if page.title in _SHOWN)
    return tuple(curve for page in pages for curve in page.curves if not curve.summed and curve.path not in today)


def parts_of(radiation: Floats, days: Places, step_seconds: float) -> Places:
    """The part of the day that each step belongs to, ``(steps,)``.

    Parameters
    ----------
    radiation
        Global radiation outside during each step [W m-2], ``(steps,)``.
    days
        Day on which each step begins, ``(steps,)``, from 0 without gaps.
    step_seconds
        Length of a step [s].
    """
    found = np.full(len(radiation), NIGHT)
    before, after = (round(hours * 3600.0 / step_seconds) for hours in (BEFORE_LIGHT, AFTER_LIGHT))
    for day in range(int(days[-1]) + 1):
        lit = np.flatnonzero((days == day) & (radiation >= DARK))
        if len(lit):
            first, last = int(lit[0]), int(lit[-1])
            found[first : last + 1] = DAY
            found[max(first - before, 0) : min(first + after, last + 1)] = DAWN
    return found


def periods_of(light: Floats) -> Places:
    """The period of each part of each day, ``(..., days, parts)``, from sums of radiation ``(..., days)`` of all days and runs."""
    found = np.empty((*light.shape, len((NIGHT, DAWN, DAY))), dtype=np.int64)
    found[..., NIGHT], found[..., DAWN] = NIGHT, DAWN
    found[..., DAY] = np.where(light >= np.median(light), BRIGHT_DAYS, DULL_DAYS)
    return found


@dataclass(frozen=True, eq=False)
class _Side:
    """One agent; fields as in ``Story``, without its axis of two."""

    hours: Floats
    times: Floats
    means: Floats
    sums: Floats
    weeks: Floats
    days: Places


@dataclass(frozen=True, eq=False)
class _Run:
    """One run: sums of levels by hour of the day with the number of steps; then by day and part; and each day's sum of radiation."""

    by_hour: Floats
    steps_by_hour: Places
    levels: Floats
    steps: Places
    lines: Floats
    light: Floats


def _runs(task: TaskSpec, log: ActionLog, seeds: Sequence[int], kernel: Stepper) -> Iterator[_Run]:
    """The runs of these seeds, as many at a time as fit into memory."""
    rows = [list(log.seeds).index(seed) for seed in seeds]
    together = max(1, LARGEST_TRACE // (task.steps * bytes_a_step(task)))
    for first in range(0, len(rows), together):
        for episode in replayed_episodes(task, log, rows[first : first + together], kernel):
            yield _run(task, episode)


def _run(task: TaskSpec, episode: Episode) -> _Run:
    signals, local = signals_of(task), episode.local_times
    radiation, days = np.asarray(episode[_RADIATION], dtype=np.float64), local_days(local)
    hours = ((local[:-1] - local[:-1].astype("datetime64[D]")) // np.timedelta64(1, "h")).astype(np.int64)
    parts, count = len((NIGHT, DAWN, DAY)), int(days[-1]) + 1
    places, size = days * parts + parts_of(radiation, days, task.step_seconds), count * parts
    values = [_values(episode, curve) for curve in levels_of(task)]
    return _Run(
        by_hour=np.stack([_summed(hours, one, _HOURS) for one in values], axis=1),
        steps_by_hour=np.bincount(hours, minlength=_HOURS),
        levels=np.stack([_summed(places, one, size) for one in values], axis=1).reshape(count, parts, -1),
        steps=np.bincount(places, minlength=size).reshape(count, parts),
        lines=sums_by(episode, signals, places, size).reshape(count, parts, -1),
        light=_summed(days, radiation, count),
    )


def _summed(places: Places, values: Floats, count: int) -> Floats:
    return np.asarray(np.bincount(places, values, count), dtype=np.float64)


def _values(episode: Episode, curve: Curve) -> Floats:
    return curve.values({name: np.asarray(episode[name], dtype=np.float64) for name in curve.columns})


def _side(task: TaskSpec, log: ActionLog, seeds: Sequence[int], kernel: Stepper) -> _Side:
    runs = list(_runs(task, log, seeds, kernel))
    chosen = periods_of(np.stack([run.light for run in runs]))
    masks = [chosen == period for period in range(len(PERIODS))]  # (runs, days, parts) each
    steps, levels, lines = (np.stack([getattr(run, name) for run in runs]) for name in ("steps", "levels", "lines"))
    steps_in = np.array([steps[mask].sum() for mask in masks])
    weeks = np.arange(lines.shape[1]) // _DAYS
    by_week = np.stack([lines[:, weeks == week].sum(axis=(1, 2)).mean(axis=0) for week in range(weeks[-1] + 1)])
    lengths = np.bincount(weeks)
    by_week[:, [line.kind == "light" for line in signals_of(task).accounts]] /= lengths[:, None]
    by_hour: Floats = np.stack([run.by_hour for run in runs]).sum(axis=0)
    steps_by_hour = np.stack([run.steps_by_hour for run in runs]).sum(axis=0)
    with np.errstate(invalid="ignore"):  # an hour or a period that never was has no mean
        return _Side(
            hours=by_hour / steps_by_hour[:, None],
            times=steps_in * (task.step_seconds / 3600.0) / len(seeds),
            means=np.stack([levels[mask].sum(axis=0) for mask in masks]) / steps_in[:, None],
            sums=np.stack([(lines * mask[..., None]).sum(axis=(1, 2)) for mask in masks], axis=1),
            weeks=by_week,
            days=lengths,
        )
