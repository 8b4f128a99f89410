"""The progress of an evaluation: a bar with steps, speed, time left, or plain lines where standard error is no terminal."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

from glbench.cli.console import messages

if TYPE_CHECKING:
    from glbench.evaluation import Evaluation
    from glbench.evaluation import Progress as Standing

_REFRESH_SECONDS = 0.1
_LINE_SHARE = 0.1
_SHORTEST_LINE_SECONDS, _LONGEST_LINE_SECONDS = 2.0, 30.0
"""Where there is no bar: a line every tenth of the steps, not more often than this, and one at least so often."""


class ProgressBar:
    """A bar on standard error; where that is no terminal, a plain line now and then."""

    def __init__(self, evaluation: Evaluation) -> None:
        console = messages()
        self._runs = len(evaluation.seeds)
        self._steps = evaluation.task.steps
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("step {task.completed:.0f} of {task.total:.0f}"),
            TextColumn("{task.fields[speed]}"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("starting", total=self._steps, speed="")
        self._lines = not console.is_terminal
        self._shown = 0.0
        self._line = (time.monotonic(), 0)
        self._began: tuple[float, int] | None = None

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        self._bar.stop()

    def update(self, standing: Standing) -> None:
        """Show where the evaluation stands, at most ten times a second."""
        now = time.monotonic()
        if standing.replaying:
            self._show(now, standing, "reminding the agent")
            return
        if self._began is None:
            # What was replayed says nothing about the speed of what is simulated now.
            self._bar.reset(self._task, completed=standing.step, description="running")
            self._began = (now, standing.step)
            self._line = (now, standing.step)
            if standing.step > 0:
                messages().print(f"Going on at step {standing.step} of {standing.steps}, where it was interrupted.")
        self._show(now, standing, "running")

    def _show(self, now: float, standing: Standing, description: str) -> None:
        if self._lines:
            self._show_line(now, standing, description)
            return
        if now - self._shown < _REFRESH_SECONDS and standing.step < standing.steps:
            return
        self._shown = now
        lost = standing.runs - standing.alive
        self._bar.update(
            self._task,
            completed=standing.step,
            description=description + (f" [red]({lost} of {standing.runs} runs failed)[/red]" if lost else ""),
            speed=self._speed(now, standing),
        )

    def _show_line(self, now: float, standing: Standing, description: str) -> None:
        when, step = self._line
        far = standing.step - step >= _LINE_SHARE * standing.steps and now - when >= _SHORTEST_LINE_SECONDS
        if not far and now - when < _LONGEST_LINE_SECONDS:
            return
        self._line = (now, standing.step)
        share = f"{100.0 * standing.step / standing.steps:.0f} %"
        words = [f"{description}: step {standing.step} of {standing.steps} ({share})", self._speed(now, standing)]
        if standing.alive < standing.runs:
            words.append(f"{standing.runs - standing.alive} of {standing.runs} runs failed")
        messages().print(", ".join(word for word in words if word), soft_wrap=True)

    def _speed(self, now: float, standing: Standing) -> str:
        """Greenhouse steps of all runs together, a second."""
        if self._began is None or now <= self._began[0]:
            return ""
        began, first = self._began
        return f"{(standing.step - first) * self._runs / (now - began):,.0f} steps/s"
