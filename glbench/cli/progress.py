"""Progress of long work on standard error: bars on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Self

from rich import progress as bars
from rich.markup import escape

from glbench.cli.console import Markup, count, messages, tell

if TYPE_CHECKING:
    from glbench.evaluation import Evaluation
    from glbench.evaluation import Progress as Standing
    from glbench.evaluation.jobs import Job, Outcome
    from glbench.leaderboard.catalogue import Metric
    from glbench.tasks import TaskSpec
    from glbench.training import CurvePoint
    from glbench.training import Progress as TrainingProgress
    from glbench.training.settings import EvaluationPlan

_REFRESH_SECONDS = 0.1
_LINE_SHARE = 0.1
_SHORTEST_LINE_SECONDS, _LONGEST_LINE_SECONDS = 2.0, 30.0
"""Where there is no bar: a line every tenth of the steps, not more often than this, and one at least so often."""
_PATIENCE_SECONDS = 10.0  # A longer wait is reported; without a bar, again after three times as long, and so on


class Wait:
    """Context manager that reports a wait, from its own thread, because the calling thread may be blocked.

    On a terminal, ``show`` gets the message every second; elsewhere a line is printed at growing intervals.
    """

    def __init__(self, show: Callable[[str], None] | None = None, what: str = "") -> None:
        self._show = show if messages().is_terminal else None
        self._thread = threading.Thread(target=self._look, daemon=True, name="waiting")
        self._end = threading.Event()
        self._for = (what, 0.0, time.monotonic())

    def begin(self, what: str, limit: float = 0.0) -> None:
        """Start to report a wait for ``what``, at most ``limit`` seconds; stop if it is empty."""
        self._for = (what, limit, time.monotonic())

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()

    def _look(self) -> None:
        current, due = self._for, _PATIENCE_SECONDS
        while not self._end.wait(1.0):
            what, limit, since = now = self._for
            if now is not current:
                current, due = now, _PATIENCE_SECONDS
            seconds = time.monotonic() - since
            if not what or seconds < (_PATIENCE_SECONDS if self._show else due):
                continue
            words = f"waiting for {what}, {seconds:.0f}{f' of {limit:.0f}' if limit else ''} s"
            if self._show is None:
                tell(words)
                due = 3.0 * due
            else:
                self._show(words)


class Bar:
    """A bar with words before it (``description``) and after it (``columns``, which show ``fields``); to be entered."""

    def __init__(self, description: str, total: float, *columns: str, time_left: bool = False, **fields: Any) -> None:
        self.on_terminal = messages().is_terminal
        begin = (bars.SpinnerColumn(), bars.TextColumn("{task.description}"), bars.BarColumn(), bars.TaskProgressColumn())
        rest = (bars.TimeRemainingColumn(), bars.TextColumn("left")) if time_left else ()
        texts = map(bars.TextColumn, columns)
        self._bar = bars.Progress(*begin, *texts, *rest, console=messages(), transient=True, disable=not self.on_terminal)
        self._task = self._bar.add_task(description, total=total, **fields)
        self._last_drawing = 0.0
        self.wait = Wait(lambda words: self._bar.update(self._task, description=escape(words)))

    def __enter__(self) -> Self:
        self._bar.start()
        self.wait.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.wait.__exit__()
        self._bar.stop()

    def is_time(self) -> bool:
        """Whether to draw again: at most ten times a second."""
        now = time.monotonic()
        if now - self._last_drawing < _REFRESH_SECONDS:
            return False
        self._last_drawing = now
        return True

    def move(self, completed: float, **fields: Any) -> None:
        """Show how far the work is."""
        self._bar.update(self._task, completed=completed, **fields)

    def reset(self, completed: int, description: str) -> None:
        """Begin to measure the time that is left from here."""
        self._bar.reset(self._task, completed=completed, description=description)


@contextlib.contextmanager
def status_bar(description: str, total: int | None, *columns: bars.ProgressColumn) -> Iterator[Callable[..., None]]:
    """A bar with ``columns`` and the elapsed time; yields a function that updates its fields."""
    words = bars.TextColumn("{task.description}")
    look = (bars.SpinnerColumn(), words, bars.BarColumn(), *columns, bars.TimeElapsedColumn())
    with bars.Progress(*look, console=messages(), transient=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda **fields: bar.update(task, **fields)


class JobsBar(Bar):
    """A bar for all jobs together, shown on a terminal only."""

    def __init__(self, jobs: int) -> None:
        super().__init__("starting", jobs, "{task.fields[done]} done", done=f"0 of {jobs}")
        self._jobs = jobs
        self._parts: dict[int, float] = {}
        self._last_report: dict[int, Standing] = {}
        self._count = 0

    def report(self, job: Job, standing: Standing) -> None:
        """A job has come to a step."""
        if self._last_report.get(id(job)) != standing:
            self._last_report[id(job)] = standing
            what = f"{standing.waiting} of {job.agent_name} on {job.task.short_id}" if standing.waiting else ""
            self.wait.begin(what, standing.limit)
        self._parts[id(job)] = standing.step / standing.steps
        if self.is_time():
            alone = len(self._parts) == 1
            self._show(f"{job.agent_name} on {job.task.short_id}" if alone else f"{len(self._parts)} at once")

    def ended(self, outcome: Outcome) -> None:
        """A job has ended."""
        self._parts.pop(id(outcome.job), None)
        self.wait.begin("")
        self._count += 1
        self._show("running")

    def _show(self, description: str) -> None:
        completed = self._count + sum(self._parts.values())
        self.move(completed, description=escape(description), done=f"{self._count} of {self._jobs}")


class EvaluationBar(Bar):
    """The progress of one evaluation: a bar; where standard error is no terminal, a plain line now and then."""

    def __init__(self, evaluation: Evaluation) -> None:
        columns = ("step {task.completed:.0f} of {task.total:.0f}", "{task.fields[speed]}")
        super().__init__("starting", evaluation.task.steps, *columns, time_left=True, speed="")
        self._runs, self._agent = len(evaluation.seeds), evaluation.agent.name
        self._line = (time.monotonic(), 0)
        self._began: tuple[float, int] | None = None

    def update(self, standing: Standing) -> None:
        """Show where the evaluation stands."""
        now = time.monotonic()
        self.wait.begin(f"{standing.waiting} of {self._agent}" if standing.waiting else "", standing.limit)
        if standing.waiting in ("loading", "reset"):
            return
        if not standing.replaying and self._began is None:
            # What was replayed says nothing about the speed of what is simulated now.
            self.reset(standing.step, description="running")
            self._began = self._line = (now, standing.step)
            if standing.step > 0:
                tell(f"Going on at step {standing.step} of {standing.steps}, where it was interrupted.")
        description = "replaying recorded steps" if standing.replaying else "running"
        lost = standing.runs - standing.alive
        failed = f"{lost} of {standing.runs} runs failed" if lost else ""
        if not self.on_terminal:
            when, step = self._line
            is_far = standing.step - step >= _LINE_SHARE * standing.steps and now - when >= _SHORTEST_LINE_SECONDS
            if is_far or now - when >= _LONGEST_LINE_SECONDS:
                self._line = (now, standing.step)
                share = f"{100.0 * standing.step / standing.steps:.0f} %"
                where = f"{description}: step {standing.step} of {standing.steps} ({share})"
                tell(", ".join(words for words in (where, self._speed(now, standing), failed) if words))
        elif self.is_time() or standing.step == standing.steps:
            description += f" [red]({failed})[/red]" if lost else ""
            self.move(standing.step, description=description, speed=self._speed(now, standing))

    def _speed(self, now: float, standing: Standing) -> str:
        """Greenhouse steps of all runs together, a second."""
        if self._began is None or now <= self._began[0]:
            return ""
        began, first = self._began
        return f"{(standing.step - first) * self._runs / (now - began):,.0f} steps/s"


class TrainingBar(Bar):
    """Steps, speed and time left on standard error; each evaluation leaves a line. The first line explains what is evaluated."""

    def __init__(self, total_steps: int, task: TaskSpec, evaluation: EvaluationPlan) -> None:
        columns = ("{task.completed:,.0f} of {task.total:,.0f} steps", "{task.fields[speed]}")
        super().__init__("training", total_steps, *columns, speed="")
        from glbench.leaderboard.catalogue import catalogue

        words = catalogue(task)
        self._metrics = {one.name: one for one in words.of_kind("score", "profit", "penalty")}
        self._score = words.score
        self._announced: str | None = f"Each evaluation is the mean of {seasons_in_words(task, evaluation)}, without exploration."
        if task.splits is not None:
            test = task.scored
            self._announced += (
                f" The score is the mean of {test.evaluation.runs} seasons of the {test.split} split, made of other years: "
                "expect another figure."
            )

    def on_progress(self, progress: TrainingProgress) -> None:
        """Move the bar."""
        words = [f"{progress.steps_per_second:,.0f} steps/s"] if progress.steps_per_second else []
        if progress.seconds_left is not None:
            words.append(f"{_duration(progress.seconds_left)} left")
        if progress.season_reward is not None:
            words.append(f"season {self._score.phrase(progress.season_reward)}")
        self.move(progress.steps, total=progress.total_steps, speed=", ".join(words))

    def on_evaluation(self, point: CurvePoint) -> None:
        """A line with what the policy earns."""
        if self._announced is not None:
            tell(self._announced)
            self._announced = None
        sums = "  ".join(one.phrase(point.result.sums[name]) for name, one in self._metrics.items())
        best = "  [green]best[/green]" if point.is_best else ""
        tell(Markup(f"{point.steps:>9,} steps {_duration(point.seconds):>6}  {sums}{best}"))

    def on_saved(self, steps: int) -> None:
        """Show nothing."""


def seasons_in_words(task: TaskSpec, evaluation: EvaluationPlan) -> str:
    """The seasons in which a training evaluates its policies."""
    where = "with seeds that are not scored" if task.chosen_on.split is None else f"of the {task.chosen_on.split} split"
    return f"{count(len(evaluation.seeds(task.chosen_on)), 'season')} {where}"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"


class TrainingLines:
    """A line for every evaluation of a training."""

    def __init__(self, seed: int, score: Metric) -> None:
        self._seed, self._score = seed, score

    def on_progress(self, progress: object) -> None:
        """Show nothing: several trainings run at once."""

    def on_evaluation(self, point: Any) -> None:
        """What the policy earns."""
        best = "  best" if point.is_best else ""
        tell(f"seed {self._seed}: {point.steps:>9,} steps  {self._score.phrase(point.result.reward)}{best}")

    def on_saved(self, steps: int) -> None:
        """Show nothing."""
