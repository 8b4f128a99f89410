"""The progress of a training in the terminal: a bar, and a line an evaluation."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn

from glbench.cli.console import messages

if TYPE_CHECKING:
    from glbench.training import CurvePoint
    from glbench.training import Progress as Standing


class TrainingBar:
    """Steps, speed and time left on standard error; each evaluation leaves a line."""

    def __init__(self, total_steps: int) -> None:
        console = messages()
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("training"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
            TextColumn("{task.fields[speed]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("training", total=total_steps, speed="")

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, place: TracebackType | None
    ) -> None:
        self._bar.stop()

    def on_progress(self, progress: Standing) -> None:
        """Move the bar."""
        said = [f"{progress.steps_per_second:,.0f} steps/s"] if progress.steps_per_second else []
        left = progress.seconds_left
        if left is not None:
            said.append(f"{_duration(left)} left")
        if progress.season_reward is not None:
            said.append(f"season reward {progress.season_reward:,.0f}")
        self._bar.update(self._task, total=progress.total_steps, completed=progress.steps, speed=", ".join(said))

    def on_evaluation(self, point: CurvePoint) -> None:
        """A line with what the policy earns."""
        sums = point.result.sums
        best = "  [green]best[/green]" if point.is_best else ""
        messages().print(
            f"{point.steps:>9,} steps {_duration(point.seconds):>6}  reward {sums['reward']:8,.1f}  "
            f"EPI {sums['epi']:6.2f} EUR/m²  penalty {sums['penalty']:6.1f}{best}",
            soft_wrap=True,
        )

    def on_saved(self, steps: int) -> None:
        """Nothing to show: a checkpoint is no news."""


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
