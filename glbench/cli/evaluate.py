"""``glbench evaluate``: run agents on tasks, show what they earned, save it. Of several, one that fails does not stop the others."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime as dt
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import HEAVY_HEAD
from rich.markup import escape

from glbench.cli.console import harmless, messages, output, print_warning, say, table, tell
from glbench.cli.exiting import INTERRUPTED, leaving_at_once, tell_interrupted
from glbench.cli.options import (
    REPORTS,
    Address,
    AsJson,
    EngineName,
    Episodes,
    RoundFile,
    Sandbox,
    SandboxChoice,
    Workers,
    check_address,
    round_of,
)
from glbench.cli.progress import Bar, Wait
from glbench.cli.view import live_view, live_viewer
from glbench.errors import GlbenchError, SubmissionError, TaskError
from glbench.extras import require

if TYPE_CHECKING:
    from rich.table import Table

    from glbench.agents import LoadedAgent
    from glbench.evaluation import Evaluation, Protected, Result
    from glbench.evaluation import Progress as Standing
    from glbench.evaluation import SandboxChoice as ChosenSandbox
    from glbench.evaluation.engines import Engine, Job, Outcome, Report
    from glbench.leaderboard.catalogue import Metric
    from glbench.tasks import Round, TaskSpec


_LONGEST_REASON = 500
_SIDE_BY_SIDE = 4
_SHOWN_REASONS, _SHOWN_LINES = 2, 3
_SHOWN_PRINTS, _LONGEST_LINE = 20, 300
_CAPTION = "* some runs failed; their missing steps count at the task's price"
_PROTECTIONS = {
    "bubblewrap": "in a sandbox (bubblewrap)",
    "unsandboxed": "[yellow]unsandboxed[/yellow]",
    "built-in": "a built-in agent",
}
_LINE_SHARE = 0.1
_SHORTEST_LINE_SECONDS, _LONGEST_LINE_SECONDS = 2.0, 30.0
"""Where there is no bar: a line every tenth of the steps, not more often than this, and one at least so often."""


def evaluate(
    agents: Annotated[
        list[str],
        typer.Argument(
            metavar="AGENT", help="Submissions (.py, .zip, .pt, .ts, .onnx, or a folder) or names of baselines."
        ),
    ],
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Task id or task file (.toml); repeatable. Default: the benchmark's."),
    ] = None,
    suite: Annotated[
        list[str] | None, typer.Option("--suite", help="All tasks of a suite, such as paper; repeatable.")
    ] = None,
    runs: Annotated[
        int | None, typer.Option("--runs", "-n", min=1, help="Number of runs. Default: what the task says.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", min=0, help="Seed of the first run. Default: what the task says.")
    ] = None,
    workers: Workers = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for results/ and for the checkpoint of unfinished work.")
    ] = REPORTS,
    episodes: Episodes = "best,worst,median",
    as_json: AsJson = False,
    live: Annotated[
        bool,
        typer.Option("--live", help="Watch the first run in the viewer while it is simulated (needs glbench[view])."),
    ] = False,
    sandbox: SandboxChoice = Sandbox.AUTO,
    show_prints: Annotated[
        bool, typer.Option("--show-prints", help="Show what sandboxed agents print, also when nothing fails.")
    ] = False,
    engine: Annotated[
        EngineName,
        typer.Option("--engine", help="Where evaluations run: local, or ray (a Ray cluster; needs glbench[ray])."),
    ] = EngineName.LOCAL,
    address: Address = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Evaluate again even if the result is there, and forget unfinished work.")
    ] = False,
    fresh_draws: Annotated[
        bool,
        typer.Option(
            "--fresh-draws",
            help="Evaluate again with draws from a new secret salt, and save both in the result (docs/statistics.md).",
        ),
    ] = False,
    round_file: RoundFile = None,
    split: Annotated[
        str,
        typer.Option(
            "--split", help="Scenarios: test, which scores, or validation, to choose between agents (a trial)."
        ),
    ] = "test",
    late: Annotated[
        bool,
        typer.Option(
            "--late",
            help="Evaluate although the round (--round) has closed; its leaderboard reports the result as late.",
        ),
    ] = False,
) -> None:
    """Evaluate agents on tasks: seeded runs in lockstep, a table with intervals, and a result file each.

    Results depend neither on --workers nor on --engine. What is interrupted (Ctrl-C, a crash, a power cut) continues with the
    same command; finished evaluations are not repeated. Exits with 1 when an agent cannot be used or all of its runs failed.
    """
    if live:
        require("--live", "view", "rerun")
    if engine is EngineName.RAY:
        require("--engine ray", "ray", "ray")
    with leaving_at_once():
        from glbench.evaluation.engines import Job, Options
        from glbench.evaluation.fresh_draws import check_fresh_draws
        from glbench.evaluation.sandbox.choosing import keep_out_of_sight

    try:
        with (
            _quiet_agents(as_json),
            messages().status("preparing") as status,
            Wait(status.update, "the agents to load"),
        ):
            sealed = round_of(round_file)
            _check_open(sealed, late=late)
            tasks = _tasks(task or [], suite or [], sealed, split)
            usable, unusable = _agents(agents, sandbox.value)
            if round_file is not None:
                keep_out_of_sight(round_file, usable.values())
            if _kernel_is_new(tasks):
                status.update("building the kernel, once on this machine: some seconds")
            options = Options(out, runs, seed, workers, fresh, episodes)
            jobs = [Job(chosen, ref, agent, options) for chosen in tasks for ref, agent in usable.items()]
            for job in jobs if fresh_draws else ():
                check_fresh_draws(job)
            first = jobs[0].prepare() if len(jobs) == 1 and not unusable and engine is EngineName.LOCAL else None
    except KeyboardInterrupt:
        tell_interrupted("Nothing was evaluated yet.")
        raise typer.Exit(INTERRUPTED) from None
    if not as_json:
        _say_if_slow()
    begun = True
    if first is not None:
        with live_viewer() if live else contextlib.nullcontext() as viewer:
            result = _evaluate(first, as_json=as_json, viewer=viewer, again=jobs[0] if fresh_draws else None)
        succeeded = len(result.failed) < len(result.runs)
        if not succeeded:
            messages().print(f"[bold red]{escape(_all_failed(result))}[/bold red]", soft_wrap=True)
        begun = any(run.steps for run in result.runs)
        if show_prints or result.failed:
            _print_prints(first.agent.name, first.prints.text(), everything=show_prints)
    else:
        if live:
            msg = "--live shows one evaluation on this machine: name one agent and one task, without --engine."
            raise GlbenchError(msg)
        chosen_engine = _engine(engine, address, workers)
        if fresh_draws:
            chosen_engine = _WithFreshDraws(chosen_engine)
        succeeded = _evaluate_many(jobs, chosen_engine, unusable, as_json=as_json, prints=show_prints)
    if not as_json and (succeeded or first is not None):
        from glbench.evaluation.preparing import results_folder

        folder = results_folder(out, tasks[0])
        board = f"leaderboard{'' if folder == REPORTS else f' --out {folder}'}"
        tell(f"Next: glbench {board if begun else f'submit check {agents[0]}'}")
    if not succeeded:
        raise typer.Exit(1)


def _all_failed(result: Result) -> str:
    runs = "The only run" if len(result.runs) == 1 else f"All {len(result.runs)} runs"
    return f"{runs} of {result.agent.name} failed: the result counts missing steps at the task's price alone, and is no evaluation."


def _engine(name: EngineName, address: str | None, workers: int | None) -> Engine:
    from glbench.evaluation.engines import LocalEngine

    check_address(address, name)
    if name is EngineName.LOCAL:
        return LocalEngine()
    from glbench.evaluation.engines.ray import RayEngine

    return RayEngine(address, workers)


def _kernel_is_new(tasks: Sequence[TaskSpec]) -> bool:
    from glbench.kernel import will_compile

    return any(will_compile(task.model_value) for task in tasks)


def _say_if_slow() -> None:
    """A word about the kernel where it is the slow one."""
    from glbench.kernel import why_not_compiled

    reason = why_not_compiled()
    if reason is not None:
        print_warning(
            f"{reason} Until then CasADi's own integrator steps the model: half an hour instead of seconds for the default task."
        )


def _tasks(names: Sequence[str], suites: Sequence[str], sealed: Round | None, split: str = "test") -> list[TaskSpec]:
    """The tasks asked for, each once, with the draws of a ``sealed`` round if there is one; the default task when none is named.

    Raises
    ------
    TaskError
        When a task has no such split, or when two tasks differ in their namespace only: their results would overwrite each other.
    """
    from glbench.tasks import DEFAULT_TASK, get_suite, get_task

    chosen = [get_task(name) for name in names] + [task for name in suites for task in get_suite(name)]
    by_folder: dict[str, TaskSpec] = {}
    for task in chosen or [get_task(DEFAULT_TASK)]:
        other = by_folder.setdefault(task.short_id, task)
        if other.digest != task.digest:
            msg = f"{other.id} ({other.source}) and {task.id} ({task.source}) would share one result folder. Evaluate them one by one."
            raise TaskError(msg)
    chosen = list(by_folder.values())
    if split != "test":
        if sealed is not None or split == "training":
            msg = f"--split {split} is not evaluated: a round has a test alone, and training seasons are to learn from."
            raise TaskError(msg)
        return [task.in_split(split) for task in chosen]
    return chosen if sealed is None else [task.in_split("test", sealed.secret) for task in chosen]


def _check_open(sealed: Round | None, *, late: bool) -> None:
    """Refuse to evaluate in a round that has closed; with ``--late`` only warn.

    Raises
    ------
    TaskError
        When it has closed.
    """
    if sealed is None or not sealed.is_late(dt.datetime.now(dt.UTC)):
        return
    msg = f"This round closed at {sealed.closing_words}."
    if not late:
        msg += " To evaluate nevertheless, with a result that counts as late, add --late. To begin a new round: glbench round new."
        raise TaskError(msg)
    print_warning(f"{msg} The result is late, and glbench leaderboard --round says so.")


def _agents(refs: Sequence[str], sandbox: ChosenSandbox) -> tuple[dict[str, Protected], dict[str, str]]:
    """The agents named, each once, and the reasons why others cannot be used. A single one that cannot be used raises.

    Raises
    ------
    SubmissionError
        When two different agents have one name: their results would overwrite each other.
    """
    from glbench.evaluation import protect

    usable: dict[str, Protected] = {}
    unusable: dict[str, str] = {}
    by_name: dict[str, Protected] = {}
    for ref in refs:
        try:
            protected = protect(ref, sandbox)
        except GlbenchError as error:
            if len(refs) == 1:
                raise
            unusable[ref] = str(error)
            continue
        other = by_name.setdefault(protected.agent.name, protected)
        if other.agent.digest != protected.agent.digest:
            msg = f"Two different agents are called '{protected.agent.name}' and would share one result file. Rename one of them."
            raise SubmissionError(msg)
        if other is protected:
            usable[ref] = protected
            _say_if_borrowed(protected.agent)
    return usable, unusable


def _say_if_borrowed(agent: LoadedAgent) -> None:
    """A word before the runs where the leaderboard will leave the result out."""
    from glbench.evaluation.sandbox.choosing import EXAMPLES

    if EXAMPLES.get(agent.name, agent.digest) != agent.digest:
        print_warning(
            f"'{agent.name}' is the name of an example of glbench, and this one is changed: the leaderboard leaves its result out. "
            "Copy it to a name of your own."
        )


def _evaluate(evaluation: Evaluation, *, as_json: bool, viewer: str | None = None, again: Job | None = None) -> Result:
    """Run one evaluation, or load its stored result, and show it; ``viewer`` is the address of a live view.

    ``again`` is its job if fresh draws are to follow, else ``None``.
    """
    from glbench.evaluation import SavingError
    from glbench.leaderboard.fresh_draws import fresh_words

    if not as_json:
        say(messages(), _announcement(evaluation))
    result = evaluation.stored
    if result is None:
        try:
            result = _run(evaluation, as_json=as_json, viewer=viewer)
        except SavingError as error:
            _show(error.result, evaluation.task, as_json=as_json)
            raise
    elif not as_json:
        messages().print(f"Already evaluated on {result.created}: this is the stored result (--fresh evaluates again).")
    if evaluation.stored is not None:
        evaluation.complete_episodes(evaluation.stored)
    if again is not None and as_json:
        result = _again(again, as_json=True)
    _show(result, evaluation.task, as_json=as_json)
    if again is not None and not as_json:
        result = _again(again, as_json=False)
        say(output(), f"With fresh draws: {escape(fresh_words(result, _ranks(evaluation.task)))}")
    if evaluation.path is not None and not as_json:
        tell(f"Saved: {_shown(evaluation.path)}")
        sealed = "" if result.task.salt_commitment is None else " --round FILE"
        tell(f"Reproduce it: glbench verify {_shown(evaluation.path)}{sealed}")
    return result


def _again(job: Job, *, as_json: bool) -> Result:
    """Add fresh draws to the finished ``job``, and return its result."""
    from glbench.evaluation.fresh_draws import add_fresh_draws

    def run(part: Job) -> Result:
        evaluation = part.prepare()
        if evaluation.stored is None and not as_json:
            draws = "fresh" if part.task.sealed else "the published"
            messages().print(f"{escape(part.agent_name)} with {draws} draws", soft_wrap=True)
        return evaluation.stored or _run(evaluation, as_json=as_json, viewer=None)

    return add_fresh_draws(job, run)


class _WithFreshDraws:
    """An engine that evaluates each agent a second time with fresh draws."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs, each with the published and then with fresh draws."""
        from glbench.evaluation.engines import LocalEngine
        from glbench.evaluation.fresh_draws import add_fresh_draws

        coming = self._engine.run(jobs, report)
        # A cluster is left before it is joined again.
        for outcome in coming if isinstance(self._engine, LocalEngine) else tuple(coming):

            def run(part: Job, whole: Outcome = outcome) -> Result:
                (done,) = self._engine.run([part], lambda _, standing: report(whole.job, standing))
                if done.result is None:
                    raise SubmissionError(done.reason or "")
                return done.result

            if outcome.result is None:
                yield outcome
                continue
            try:
                result = add_fresh_draws(outcome.job, run)
            except GlbenchError as error:
                reason = f"Its result with the published draws is saved. With fresh draws it failed: {error}"
                yield dataclasses.replace(outcome, result=None, reason=reason)
            else:
                yield dataclasses.replace(outcome, result=result)


def _show(result: Result, task: TaskSpec, *, as_json: bool) -> None:
    """What was earned, as a table or as one line of JSON."""
    from glbench.cli.results import print_failures, summary_table
    from glbench.leaderboard.catalogue import catalogue

    if as_json:
        output().out(result.model_dump_json(by_alias=True), highlight=False)
        return
    if any(run.steps for run in result.runs):
        output().print(summary_table(result, catalogue(task)))
    print_failures(result)


def _run(evaluation: Evaluation, *, as_json: bool, viewer: str | None) -> Result:
    from glbench.evaluation import SavingError

    try:
        with _quiet_agents(as_json), live_view(viewer, evaluation) as watcher, _Progress(evaluation) as progress:
            return evaluation.run(progress.update, watcher)
    except KeyboardInterrupt:
        tell_interrupted(_what_is_kept(evaluation))
        raise typer.Exit(INTERRUPTED) from None
    except (SubmissionError, SavingError):
        raise
    except GlbenchError as error:
        if not evaluation.interrupted:
            raise
        msg = f"{error}\n{_what_is_kept(evaluation)}"
        raise type(error)(msg) from error


def _what_is_kept(evaluation: Evaluation) -> str:
    if evaluation.interrupted:
        return "What could be written is kept: the same command (without --fresh) continues from the last checkpoint."
    return "Nothing was computed long enough to be kept: the same command starts again."


@contextlib.contextmanager
def _quiet_agents(wanted: bool) -> Iterator[None]:
    """Keep standard output for the JSON: whatever agents and solvers print, from Python or from C, goes to standard error."""
    if not wanted:
        yield
        return
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _shown(path: Path) -> str:
    """A path as short as it can be copied: relative when it is below the current folder."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def _evaluate_many(
    jobs: Sequence[Job], engine: Engine, unusable: dict[str, str], *, as_json: bool, prints: bool
) -> bool:
    """Do all ``jobs`` and print how each ended, as JSON or as text; return whether every agent succeeded in at least one run.

    ``unusable`` names the agents that could not be loaded, with the reasons. With ``prints`` everything that agents print is shown, else
    the last lines of those that fail.
    """
    outcomes: list[Outcome] = []
    bar = _JobsBar(len(jobs))
    try:
        with bar:
            coming = iter(engine.run(jobs, bar.report))
            while (outcome := _next(coming, quiet=as_json)) is not None:
                outcomes.append(outcome)
                bar.ended(outcome)
                _print(outcome, f"{len(outcomes):{len(str(len(jobs)))}}/{len(jobs)}", as_json=as_json, prints=prints)
    except KeyboardInterrupt:
        done = sum(outcome.result is not None for outcome in outcomes)
        tell_interrupted(
            f"{done} of {len(jobs)} evaluations are done and saved. The same command (without --fresh) continues: what is done is not "
            "done again, what was under way continues from its checkpoint."
        )
        raise typer.Exit(INTERRUPTED) from None
    failures = [(f"{o.job.agent_name} on {o.job.task.short_id}", o.reason) for o in outcomes if o.reason is not None]
    failures += [
        (f"{o.job.agent_name} on {o.job.task.short_id}", _all_failed(o.result))
        for o in outcomes
        if o.result is not None and len(o.result.failed) == len(o.result.runs)
    ]
    failures += list(unusable.items())
    if not as_json:
        output().print(_summary(jobs, outcomes))
    if failures:
        messages().print(f"[bold red]{len(failures)} failed:[/bold red]")
        for what, reason in failures:
            messages().print(f"  [red]{escape(harmless(what))}[/red]: {escape(_short(reason or ''))}", soft_wrap=True)
    return not failures


def _next(coming: Iterator[Outcome], *, quiet: bool) -> Outcome | None:
    with _quiet_agents(quiet):
        return next(coming, None)


def _print(outcome: Outcome, number: str, *, as_json: bool, prints: bool) -> None:
    """A line a job, and why runs failed; with ``as_json`` the result as one line on standard output, and the words beside it."""
    from glbench.cli.results import print_reasons
    from glbench.leaderboard.fresh_draws import fresh_words

    result, name = outcome.result, outcome.job.agent_name
    if as_json:
        if result is not None:
            output().out(result.model_dump_json(by_alias=True), highlight=False)
        return
    begin = f"[dim]{number}[/dim] [bold]{escape(name)}[/bold] on {escape(outcome.job.task.short_id)}: "
    if result is None:
        said = f"[red]failed[/red] after {outcome.seconds:.1f} s: {escape(_short(outcome.reason or ''))}"
    else:
        took = "already there" if outcome.stored else f"{outcome.seconds:.1f} s"
        said = f"{_score_in_words(result, _ranks(outcome.job.task))}, {_runs(result)}, {took}"
        if result.fresh_draws is not None:
            said += f"; with fresh draws {escape(fresh_words(result, _ranks(outcome.job.task)))}"
    messages().print(begin + said, soft_wrap=True)
    if result is not None and (prints or result.failed):
        print_reasons(result, _SHOWN_REASONS, indent="    ")
        _print_prints(name, outcome.printed, everything=prints, last=_SHOWN_LINES, indent="    ")


def _runs(result: Result) -> str:
    runs = f"{len(result.runs)} run{'s' if len(result.runs) > 1 else ''}"
    return f"{runs}, [red]{len(result.failed)} failed[/red]" if result.failed else runs


def _summary(jobs: Sequence[Job], outcomes: Sequence[Outcome]) -> Table:
    """Mean of what ranks on each task, of every agent; a few agents side by side, many below each other."""
    from glbench.quantities import pretty_unit

    cells = {(outcome.job.agent_name, outcome.job.task.short_id): _cell(outcome) for outcome in outcomes}
    agents = list(dict.fromkeys(job.agent_name for job in jobs))
    tasks = list(dict.fromkeys(job.task.short_id for job in jobs))
    failures = any(outcome.result is not None and outcome.result.failed for outcome in outcomes)
    look = {"caption": _CAPTION if failures else None, "caption_justify": "left", "box": HEAVY_HEAD}
    if len(agents) <= _SIDE_BY_SIDE:
        rows, columns, heads = tasks, agents, [escape(agent) for agent in agents]
    else:
        rows, columns, heads = agents, tasks, [escape(task.replace("-", "\n")) for task in tasks]
    first = "Task" if rows is tasks else "Agent"
    ranking = [_ranks(job.task) for job in jobs]
    scores = {f"{one.heading or one.label} [{pretty_unit(one.unit) or '-'}]" for one in ranking}
    view = table(
        f"{' or '.join(sorted(scores))}, mean over the runs", first, *heads, right=heads, folded=[first, *heads], **look
    )
    for row in rows:
        pairs = [(column, row) if rows is tasks else (row, column) for column in columns]
        view.add_row(row if rows is tasks else escape(row), *(cells.get(pair, "") for pair in pairs))
    return view


def _cell(outcome: Outcome) -> str:
    if outcome.result is None:
        return "[red]failed[/red]"
    metric = _ranks(outcome.job.task)
    mean = outcome.result.summary.mean.get(metric.name)
    return ("–" if mean is None else metric.number(mean)) + ("*" if outcome.result.failed else "")


def _ranks(task: TaskSpec) -> Metric:
    """What ranks on the task."""
    from glbench.leaderboard.catalogue import catalogue

    return catalogue(task).metrics[task.evaluation.metric]


def _short(reason: str) -> str:
    words = harmless(" ".join(reason.split()))
    return words if len(words) <= _LONGEST_REASON else words[: _LONGEST_REASON - 4] + " ..."


def _announcement(evaluation: Evaluation) -> str:
    """What is about to be evaluated, in two lines."""
    from glbench.cli.results import count

    task, seeds, days = evaluation.task, evaluation.seeds, evaluation.task.weather.days
    numbers = f"seeds {seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else f"seed {seeds[0]}"
    commitment = task.salt_commitment
    drawn = "" if commitment is None else f"\nsealed round {commitment}"
    split = ", [bold]validation split[/bold]" if task.split == "validation" else ""
    sees = " [yellow](privileged: sees more than the observations)[/yellow]" if evaluation.agent.privileged else ""
    return (
        f"[bold]{escape(evaluation.agent.name)}[/bold]{sees} on [bold]{escape(task.id)}[/bold]{split}: {escape(task.title)}\n"
        f"{count(len(seeds), 'run')} ({numbers}) of {count(days, 'day')}, {task.steps} steps of {task.step_seconds:g} s; "
        f"{count(evaluation.workers, 'worker')}, {evaluation.kernel['backend']} kernel, {_PROTECTIONS[evaluation.protection]}{drawn}"
    )


def _score_in_words(result: Result, metric: Metric) -> str:
    """``reward 3,751.9 (3,750.9 to 3,752.8)``: mean and 95 % interval of what ranks."""
    from glbench.leaderboard.estimates import estimate

    one = estimate(result.values(metric.name))
    spread = len(result.runs) > 1 and one.low < one.high
    return metric.said(one.mean) + (f" ({metric.number(one.low)} to {metric.number(one.high)})" if spread else "")


def _print_prints(name: str, printed: str, *, everything: bool, last: int = _SHOWN_PRINTS, indent: str = "") -> None:
    """What the sandboxed agent ``name`` printed: all that was kept of it, or its last lines."""
    lines = printed.rstrip().splitlines()
    shown = lines if everything else lines[-last:]
    more = (
        f" (the last {len(shown)} of {len(lines)} lines; --show-prints shows more)" if len(shown) < len(lines) else ""
    )
    if lines:
        messages().print(f"{indent}What {escape(name)} printed{more}:", soft_wrap=True)
    for line in shown:
        tell(f"{indent}  {line if everything or len(line) <= _LONGEST_LINE else f'{line[: _LONGEST_LINE - 4]} ...'}")


class _JobsBar(Bar):
    """A bar for all jobs together, shown on a terminal only."""

    def __init__(self, jobs: int) -> None:
        super().__init__("starting", jobs, "{task.fields[done]} done", done=f"0 of {jobs}")
        self._jobs = jobs
        self._parts: dict[int, float] = {}
        self._heard: dict[int, Standing] = {}
        self._done = 0

    def report(self, job: Job, standing: Standing) -> None:
        """A job has come to a step."""
        if self._heard.get(id(job)) != standing:
            self._heard[id(job)] = standing
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
        self._done += 1
        self._show("running")

    def _show(self, description: str) -> None:
        completed = self._done + sum(self._parts.values())
        self.move(completed, description=escape(description), done=f"{self._done} of {self._jobs}")


class _Progress(Bar):
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
                messages().print(f"Going on at step {standing.step} of {standing.steps}, where it was interrupted.")
        description, lost = (
            "replaying recorded steps" if standing.replaying else "running",
            standing.runs - standing.alive,
        )
        failed = f"{lost} of {standing.runs} runs failed" if lost else ""
        if not self.on_terminal:
            self._show_line(now, standing, description, failed)
        elif self.is_time() or standing.step == standing.steps:
            description += f" [red]({failed})[/red]" if lost else ""
            self.move(standing.step, description=description, speed=self._speed(now, standing))

    def _show_line(self, now: float, standing: Standing, description: str, failed: str) -> None:
        when, step = self._line
        far = standing.step - step >= _LINE_SHARE * standing.steps and now - when >= _SHORTEST_LINE_SECONDS
        if not far and now - when < _LONGEST_LINE_SECONDS:
            return
        self._line = (now, standing.step)
        share = f"{100.0 * standing.step / standing.steps:.0f} %"
        words = [
            f"{description}: step {standing.step} of {standing.steps} ({share})",
            self._speed(now, standing),
            failed,
        ]
        messages().print(", ".join(word for word in words if word), soft_wrap=True)

    def _speed(self, now: float, standing: Standing) -> str:
        """Greenhouse steps of all runs together, a second."""
        if self._began is None or now <= self._began[0]:
            return ""
        began, first = self._began
        return f"{(standing.step - first) * self._runs / (now - began):,.0f} steps/s"
