"""Several agents, or several tasks: one line for each, a summary in the end, and nothing that stops the others."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer
from rich.markup import escape
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn
from rich.table import Table

from glbench.cli.console import harmless, messages, output
from glbench.cli.evaluation_tables import print_prints, print_reasons, reward_in_words
from glbench.cli.leaving import INTERRUPTED, tell_interrupted

if TYPE_CHECKING:
    from glbench.evaluation import Progress as Standing
    from glbench.evaluation import Result
    from glbench.evaluation.engines import Engine, Job, Outcome

_REFRESH_SECONDS = 0.1
_LONGEST_REASON = 500
_SIDE_BY_SIDE = 4
_SHOWN_REASONS, _SHOWN_LINES = 2, 3
_CAPTION = "* some runs failed; their missing steps count at the task's price"


@dataclass(frozen=True)
class Told:
    """How outcomes are reported: as JSON only, or in words, with everything that agents print or only the last lines of those that fail."""

    as_json: bool = False
    prints: bool = False


def evaluate_many(
    jobs: Sequence[Job],
    engine: Engine,
    unusable: dict[str, str],
    *,
    quiet: Callable[[], AbstractContextManager[None]],
    told: Told,
) -> bool:
    """Do all ``jobs`` and say how each ended; whether none failed.

    ``unusable`` names the agents that could not be loaded, with the reasons; ``quiet`` keeps what agents print out of the way.
    """
    outcomes: list[Outcome] = []
    bar = _Bar(len(jobs))
    try:
        with bar:
            coming = iter(engine.run(jobs, bar.report))
            while (outcome := _next(coming, quiet)) is not None:
                outcomes.append(outcome)
                bar.ended(outcome)
                _print(outcome, len(outcomes), len(jobs), told)
    except KeyboardInterrupt:
        done = sum(outcome.result is not None for outcome in outcomes)
        tell_interrupted(
            f"{done} of {len(jobs)} evaluations are done and saved. The same command (without --fresh) goes on: what is done is not "
            "done again, what was under way goes on from its checkpoint."
        )
        raise typer.Exit(INTERRUPTED) from None
    failures = [(f"{o.job.agent_name} on {o.job.task.short_id}", o.reason) for o in outcomes if o.reason is not None]
    failures += list(unusable.items())
    if not told.as_json:
        output().print(_summary(jobs, outcomes))
    if failures:
        messages().print(f"[bold red]{len(failures)} failed:[/bold red]")
        for what, reason in failures:
            messages().print(f"  [red]{escape(harmless(what))}[/red]: {escape(_short(reason or ''))}", soft_wrap=True)
    return not failures


def _next(coming: Iterator[Outcome], quiet: Callable[[], AbstractContextManager[None]]) -> Outcome | None:
    with quiet():
        return next(coming, None)


def _print(outcome: Outcome, number: int, of: int, told: Told) -> None:
    """A line a job, and why runs failed; with ``as_json`` the result as one line on standard output, and the words beside it."""
    result, name = outcome.result, outcome.job.agent_name
    if told.as_json:
        if result is not None:
            output().out(result.model_dump_json(by_alias=True), highlight=False)
        return
    width = len(str(of))
    begin = f"[dim]{number:{width}}/{of}[/dim] [bold]{escape(name)}[/bold] on {escape(outcome.job.task.short_id)}: "
    if result is None:
        said = f"[red]failed[/red] after {outcome.seconds:.1f} s: {escape(_short(outcome.reason or ''))}"
    else:
        took = "already there" if outcome.stored else f"{outcome.seconds:.1f} s"
        said = f"{reward_in_words(result)}, {_runs(result)}, {took}"
    messages().print(begin + said, soft_wrap=True)
    if result is not None and (told.prints or result.failed):
        print_reasons(result, _SHOWN_REASONS, indent="    ")
        print_prints(name, outcome.printed, everything=told.prints, last=_SHOWN_LINES, indent="    ")


def _runs(result: Result) -> str:
    runs = f"{len(result.runs)} run{'s' if len(result.runs) > 1 else ''}"
    return f"{runs}, [red]{len(result.failed)} failed[/red]" if result.failed else runs


def _summary(jobs: Sequence[Job], outcomes: Sequence[Outcome]) -> Table:
    """Mean reward of every agent on every task; a few agents side by side, many below each other."""
    cells = {(outcome.job.agent_name, outcome.job.task.short_id): _cell(outcome) for outcome in outcomes}
    agents = list(dict.fromkeys(job.agent_name for job in jobs))
    tasks = list(dict.fromkeys(job.task.short_id for job in jobs))
    failures = any(outcome.result is not None and outcome.result.failed for outcome in outcomes)
    table = Table(
        title="Reward [-], mean over the runs",
        title_justify="left",
        title_style="bold",
        caption=_CAPTION if failures else None,
        caption_justify="left",
    )
    if len(agents) <= _SIDE_BY_SIDE:
        table.add_column("Task")
        for agent in agents:
            table.add_column(escape(agent), justify="right")
        for task in tasks:
            table.add_row(task, *[cells.get((agent, task), "") for agent in agents])
        return table
    table.add_column("Agent")
    for task in tasks:
        table.add_column(escape(task.replace("-", "\n")), justify="right")
    for agent in agents:
        table.add_row(escape(agent), *[cells.get((agent, task), "") for task in tasks])
    return table


def _cell(outcome: Outcome) -> str:
    if outcome.result is None:
        return "[red]failed[/red]"
    return f"{outcome.result.summary.mean['reward']:,.1f}" + ("*" if outcome.result.failed else "")


def _short(reason: str) -> str:
    words = harmless(" ".join(reason.split()))
    return words if len(words) <= _LONGEST_REASON else words[: _LONGEST_REASON - 4] + " ..."


class _Bar:
    """A bar for all jobs together, on standard error, shown on a terminal only."""

    def __init__(self, jobs: int) -> None:
        console = messages()
        self._jobs = jobs
        self._parts: dict[int, float] = {}
        self._done = 0
        self._shown = 0.0
        self._bar = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[done]} done"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("starting", total=jobs, done=f"0 of {jobs}")

    def __enter__(self) -> _Bar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def report(self, job: Job, standing: Standing) -> None:
        """A job has come to a step."""
        self._parts[id(job)] = standing.step / standing.steps
        now = time.monotonic()
        if now - self._shown >= _REFRESH_SECONDS:
            self._shown = now
            self._show(
                f"{job.agent_name} on {job.task.short_id}" if len(self._parts) == 1 else f"{len(self._parts)} at once"
            )

    def ended(self, outcome: Outcome) -> None:
        """A job has ended."""
        self._parts.pop(id(outcome.job), None)
        self._done += 1
        self._show("running")

    def _show(self, description: str) -> None:
        completed = self._done + sum(self._parts.values())
        self._bar.update(
            self._task, completed=completed, description=escape(description), done=f"{self._done} of {self._jobs}"
        )
