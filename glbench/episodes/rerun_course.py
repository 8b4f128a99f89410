"""What controllers did in their runs, as plain columns: what the viewer shows together, in which colours, and the card beside the plots."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glbench.episodes.accounts import ACTING, weeks_of
from glbench.episodes.episode import Episode
from glbench.episodes.signals import Curve, Floats, Line, Signals, signals_of
from glbench.errors import GlbenchError
from glbench.quantities import raised_unit
from glbench.tasks import TaskSpec, task_card
from glbench.tasks.prices import local_times

Times = NDArray[np.datetime64]
HOURS_PER_DAY = 24
SHOWN_DAYS = 2
_NOTHING = "There is nothing to show: no run was chosen."
_UNITS = {"degC": "°C"}
_LEAST = 0.005
"""What is smaller in every week is 0.00 in the table, and left out."""


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

    Attributes
    ----------
    controller
        Name of the agent.
    seed
        Seed of the run.
    times
        UTC at the start and at the end of every step, ``(steps + 1,)`` datetime64[ns].
    columns
        Values of each step by column name, ``(steps,)`` float64 each.
    remark
        Why the run ended early, in words; empty when it did not.
    began
        Day on which it began, where that is not the day from which its curves are drawn.
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
class Shown:
    """Trajectories of one task to be shown together.

    Attributes
    ----------
    task, trajectories
        The task and what was done in it.
    labels
        What the curves of each trajectory are called.
    signals
        What is shown of them; every trajectory has the columns that it needs.
    first_day, days
        The days that fast quantities show first; without a first day those with most violations.
    """

    task: TaskSpec
    trajectories: tuple[Trajectory, ...]
    labels: tuple[str, ...]
    signals: Signals
    first_day: dt.date | None = None
    days: int = SHOWN_DAYS

    def __post_init__(self) -> None:
        for trajectory in self.trajectories:
            missing = [name for name in self.signals.needed if name not in trajectory.columns]
            if missing:
                msg = f"The record of '{trajectory.controller}' lacks {', '.join(missing)}, which the viewer shows."
                raise GlbenchError(msg)

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

    def closeup(self) -> tuple[np.datetime64, np.datetime64]:
        """Start and end of the days that fast quantities show first.

        Without a chosen first day these are the whole days in which the shown runs together broke their limits most.

        Raises
        ------
        GlbenchError
            When the chosen day is none of the episode's.
        """
        times = self.longest.times
        per_day = round(HOURS_PER_DAY * 3600 / self.task.step_seconds)
        width = min(self.days * per_day, self.longest.steps)
        first = self._most_broken(per_day, width) if self.first_day is None else self._chosen()
        return times[first], times[min(first + width, self.longest.steps)]

    def _chosen(self) -> int:
        """Step at which the chosen first day begins."""
        times, midnight = self.longest.times, np.datetime64(str(self.first_day), "ns")
        day = np.timedelta64(1, "D")
        if not times[0] - day < midnight < times[-1]:
            msg = f"{self.first_day} is not a day of what is shown, which lasts from {str(times[0])[:10]} to {str(times[-1])[:10]}."
            raise GlbenchError(msg)
        return int(np.searchsorted(times, midnight))

    def _most_broken(self, per_day: int, width: int) -> int:
        """Step at which the ``width`` steps with the largest penalty begin, at the start of a day."""
        penalty = np.zeros(self.longest.steps)
        for trajectory in self.trajectories:
            penalty[: trajectory.steps] += trajectory.columns[self.signals.worst]
        before = np.concatenate([[0.0], np.cumsum(penalty)])
        firsts = np.arange(0, len(penalty) - width + 1, per_day)
        return int(firsts[np.argmax(before[firsts + width] - before[firsts])])


def trajectory_of(episode: Episode) -> Trajectory:
    """The trajectory of a recorded episode."""
    run = episode.run
    columns = {name: np.asarray(episode[name], dtype=np.float64) for name in episode.names}
    remark = run.reason or episode.problem or ""
    return Trajectory(episode.provenance.agent.name, run.seed, episode.times, columns, remark)


def shown_of(episodes: Sequence[Episode]) -> Shown:
    """Recorded episodes of one task, to be shown together.

    Raises
    ------
    GlbenchError
        When they are not of one and the same task, and as ``show_together`` does.
    """
    if not episodes:
        raise GlbenchError(_NOTHING)
    facts = [episode.provenance.task for episode in episodes]
    for other in facts[1:]:
        if other.digest != facts[0].digest:
            what = "another version of it" if other.id == facts[0].id else other.id
            msg = f"Only runs of one task can be shown together: the first is of {facts[0].id}, another of {what}."
            raise GlbenchError(msg)
    return show_together(episodes[0].task(), [trajectory_of(episode) for episode in episodes])


def provenance_words(episodes: Sequence[Episode]) -> dict[str, str]:
    """Where the shown runs come from, for the properties of the recording."""
    first = episodes[0].provenance
    words = {"task": first.task.id, "task_digest": first.task.digest, "glbench": first.versions["glbench"]}
    for number, episode in enumerate(episodes, 1):
        agent, run = episode.provenance.agent, episode.run
        words[f"run_{number}"] = (
            f"{agent.name}, digest {agent.digest}, seed {run.seed}, {run.status}, {run.steps} steps"
        )
    return words


def show_together(task: TaskSpec, trajectories: Sequence[Trajectory]) -> Shown:
    """Trajectories with labels: the controller's name, with the seed where one controller is shown twice.

    Raises
    ------
    GlbenchError
        For no trajectory, an empty one, the same run twice, or more trajectories than there are colours.
    """
    if not trajectories:
        raise GlbenchError(_NOTHING)
    if len(trajectories) > len(PALETTE):
        msg = f"At most {len(PALETTE)} runs can be told apart by their colours; these are {len(trajectories)}. Choose fewer."
        raise GlbenchError(msg)
    for trajectory in trajectories:
        if trajectory.steps == 0:
            msg = f"The run of '{trajectory.controller}' with seed {trajectory.seed} has no steps to show."
            raise GlbenchError(msg)
    names = [trajectory.controller for trajectory in trajectories]
    labels = tuple(
        name if names.count(name) == 1 else f"{name} (seed {trajectory.seed})"
        for name, trajectory in zip(names, trajectories, strict=True)
    )
    for label in labels:
        if labels.count(label) > 1:
            msg = f"{label} is there twice. Give each run once, or rename one of the agents."
            raise GlbenchError(msg)
    signals = signals_of(task)
    derived = {one.name for one in signals.vector("derived")}  # records of earlier versions have fewer of them
    missing = {name for trajectory in trajectories for name in derived.difference(trajectory.columns)}
    return Shown(task, _aligned(trajectories), labels, signals.lacking(missing))


def _aligned(trajectories: Sequence[Trajectory]) -> tuple[Trajectory, ...]:
    """Runs of several seasons on the dates of the first, each with the day on which it began."""
    first = trajectories[0].times[0]
    if all(trajectory.times[0] == first for trajectory in trajectories):
        return tuple(trajectories)
    return tuple(replace(one, times=one.times - one.times[0] + first, began=_day(one.times[0])) for one in trajectories)


def _day(start: np.datetime64) -> dt.date:
    """The day that begins at ``start``, which is midnight on some clock [UTC]."""
    day: dt.date = (
        (start.astype("datetime64[h]") + np.timedelta64(HOURS_PER_DAY // 2, "h")).astype("datetime64[D]").item()
    )
    return day


def card(shown: Shown) -> str:
    """The card beside the plots, as Markdown: the task in words, and who is shown in which colour."""
    task, signals, facts = shown.task, shown.signals, task_card(shown.task)
    limits = "; ".join(
        f"{signals.names.get(limit.name, limit.name)} **{limit.low:g} to {limit.high:g} {_UNITS.get(limit.unit, limit.unit)}**"
        for limit in facts.constraints
    )
    several = any(trajectory.began for trajectory in shown.trajectories)
    start = _day(shown.trajectories[0].times[0])
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
    for colour, label, trajectory in zip(PALETTE, shown.labels, shown.trajectories, strict=False):
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
        f"per m² of floor; times are UTC{_clock_words(shown)}.",
    ]
    return "\n".join(lines)


def weeks_card(shown: Shown) -> str:
    """The accounts of every controller by week, as Markdown."""
    lines, signals, accounts = ["# By week", ""], shown.signals, shown.signals.accounts
    acting = (one.name for source in ACTING for one in signals.vector(source))
    needed = {*(line.column for line in accounts if line.column), *acting}
    for label, trajectory in zip(shown.labels, shown.trajectories, strict=True):
        clock = local(trajectory, shown.signals.clock)
        if clock is None or not needed <= trajectory.columns.keys():
            lines += [f"**{label}**: its record lacks what a table of weeks needs.", ""]
            continue
        weeks = weeks_of(trajectory.columns, shown.signals, clock)
        told = [place for place in range(len(accounts)) if abs(weeks.sums[:, place]).max() >= _LEAST]
        heads = [f"{accounts[place].title} [{_account_unit(accounts[place])}]" for place in told]
        lines += [f"**{label}**", "", f"| Week from | {' | '.join(heads)} |", f"|---|{'---:|' * len(heads)}"]
        for first, days, sums in zip(weeks.first, weeks.days, weeks.sums, strict=True):
            short = "" if days == weeks.days[0] else f" ({days} days)"
            lines.append(f"| {first}{short} | {' | '.join(f'{sums[place]:.2f}'.replace('-', '−') for place in told)} |")
        lines.append("")
    return "\n".join([*lines, "Light is the mean of a day. Natural gas by its lower heating value, 31.65 MJ m⁻³."])


def _account_unit(line: Line) -> str:
    unit = raised_unit(line.unit)
    return "–" if unit == "-" else f"{unit} d⁻¹" if line.kind == "light" else unit


def local(trajectory: Trajectory, clock: str) -> Times | None:
    """The moments of ``trajectory`` on the greenhouse's clock, whose hours are its column ``clock``; None where the record has none."""
    hours = trajectory.columns.get(clock)
    if hours is None or not trajectory.steps or not ((hours >= 0.0) & (hours <= 24.0)).all():
        return None
    ends = trajectory.times[1:]
    ahead = local_times(ends, hours) - ends.astype("datetime64[s]")
    shown: Times = trajectory.times + np.concatenate([ahead[:1], ahead])
    return shown


def _clock_words(shown: Shown) -> str:
    """How far the greenhouse's clock is ahead of UTC, where it is."""
    first = shown.trajectories[0]
    clock = local(first, shown.signals.clock)
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
    return [
        f"EPI {result} EUR/m² = revenue {total(*signals.income):.2f} − costs {total(*signals.costs):.2f}",
        "; ".join([*harvest, f"reward {total(signals.reward):.1f}"]),
    ]
