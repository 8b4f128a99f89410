"""``glbench evaluate``: run agents on tasks, print and save the results. An agent that fails does not stop the others."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime as dt
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import HEAVY_HEAD

from glbench.cli import console, options
from glbench.cli.console import Markup, count, plain, styled
from glbench.cli.options import REPORTS
from glbench.cli.progress import EvaluationBar, JobsBar, Wait
from glbench.cli.results import failure_lines, reason_lines, summary_table
from glbench.cli.view import live_view, live_viewer
from glbench.errors import GlbenchError, SubmissionError, TaskError, refuse
from glbench.extras import require
from glbench.resources import standard_output_to

if TYPE_CHECKING:
    from glbench.evaluation import Evaluation, Protected, Result
    from glbench.evaluation import SandboxChoice as SandboxName
    from glbench.evaluation.jobs import Engine, Job, Outcome, Report
    from glbench.leaderboard.catalogue import Metric
    from glbench.tasks import Round, TaskSpec


_LONGEST_REASON = 500
_SIDE_BY_SIDE = 4
_MOST_REASONS, _MOST_LINES = 2, 3
_MOST_PRINTS, _LONGEST_LINE = 20, 300
_CAPTION = "* some runs failed; their missing steps count at the task's price"
_PROTECTIONS = {"bubblewrap": "in a sandbox (bubblewrap)", "unsandboxed": "[yellow]unsandboxed[/yellow]", "built-in": "a built-in agent"}


def evaluate(
    agents: Annotated[
        list[str], typer.Argument(metavar="AGENT", help="Submissions (.py, .zip, .pt, .ts, .onnx, or a folder) or names of baselines.")
    ],
    task: Annotated[
        list[str] | None, typer.Option("--task", "-t", help="Task id or task file (.toml); repeatable. Default: the benchmark's.")
    ] = None,
    suite: Annotated[list[str] | None, typer.Option("--suite", help="All tasks of a suite, such as paper; repeatable.")] = None,
    runs: Annotated[int | None, typer.Option("--runs", "-n", min=1, help="Number of runs. Default: what the task says.")] = None,
    seed: Annotated[int | None, typer.Option("--seed", min=0, help="Seed of the first run. Default: what the task says.")] = None,
    workers: options.Workers = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for results/ and for the checkpoint of unfinished work.")] = REPORTS,
    episodes: options.Episodes = "best,worst,median",
    as_json: options.AsJson = False,
    live: Annotated[
        bool, typer.Option("--live", help="Watch the first run in the viewer while it is simulated (needs glbench[view]).")
    ] = False,
    sandbox: options.SandboxChoice = options.Sandbox.AUTO,
    show_prints: Annotated[bool, typer.Option("--show-prints", help="Show what sandboxed agents print, also when nothing fails.")] = False,
    engine: options.Engine = options.EngineName.LOCAL,
    address: options.Address = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Evaluate again even if the result is there, and forget unfinished work.")] = False,
    fresh_draws: Annotated[
        bool,
        typer.Option(
            "--fresh-draws", help="Evaluate again with draws from a new secret salt, and save both in the result (docs/statistics.md)."
        ),
    ] = False,
    round_file: options.RoundFile = None,
    split: Annotated[
        str, typer.Option("--split", help="Scenarios: test, which scores, or validation, to choose between agents (a trial).")
    ] = "test",
    late: Annotated[
        bool, typer.Option("--late", help="Evaluate although the round (--round) has closed; its leaderboard reports the result as late.")
    ] = False,
) -> None:
    """Evaluate agents on tasks: seeded runs in lockstep, a table with intervals, and a result file each.

    Results depend neither on --workers nor on --engine. What is interrupted (Ctrl-C, a crash, a power cut) continues with the
    same command; finished evaluations are not repeated. Exits with 1 when an agent cannot be used or all of its runs failed.
    """
    if late and round_file is None:
        refuse("--late is for a round that has closed: name its file with --round.", GlbenchError)
    if live:
        require("--live", "view", "rerun")
    options.check_engine(engine, address)
    with console.leaving_at_once():
        from glbench.evaluation.jobs import Job, Options
        from glbench.evaluation.sandbox.choosing import keep_out_of_sight
        from glbench.kernel import why_not_compiled, will_compile

    printer = console.Printer(as_json)
    with (
        console.interruption("Nothing was evaluated yet."),
        agents_print_to_stderr(as_json),
        console.messages().status("preparing") as status,
        Wait(status.update, "the agents to load"),
    ):
        sealed = options.round_of(round_file)
        if sealed is not None and sealed.is_late(dt.datetime.now(dt.UTC)):
            msg = f"This round closed at {sealed.closing_words}."
            if not late:
                msg += " To evaluate nevertheless, with a result that counts as late, add --late. To begin a new round: glbench round new."
                raise TaskError(msg)
            console.print_warning(f"{msg} A result made now is late, and glbench leaderboard --round says so.")
        tasks = select_tasks(task or [], suite or [], sealed, split)
        usable, unusable = load_agents(agents, sandbox.value)
        if round_file is not None:
            keep_out_of_sight(round_file, usable.values())
        if any(will_compile(task.model_value) for task in tasks):
            status.update("building the kernel, once on this machine: some seconds")
        settings = Options(out, runs, seed, workers, fresh, episodes)
        jobs = [Job(task, ref, agent, settings) for task in tasks for ref, agent in usable.items()]
        if fresh_draws:
            from glbench.evaluation.fresh_draws import check_fresh_draws

            for job in jobs:
                check_fresh_draws(job)
        single = jobs[0].prepare() if len(jobs) == 1 and not unusable and engine is options.EngineName.LOCAL else None
    reason = None if as_json else why_not_compiled()
    if reason is not None:
        console.print_warning(
            f"{reason} Until then CasADi's own integrator steps the model: an hour instead of seconds for the default task."
        )
    has_steps = True
    if single is not None:
        with live_viewer() if live else contextlib.nullcontext() as viewer:
            result = _evaluate(single, printer, viewer=viewer, again=jobs[0] if fresh_draws else None)
        succeeded = len(result.failed) < len(result.runs)
        if not succeeded:
            console.tell(Markup(styled(_all_failed(result), "bold red")))
        has_steps = any(run.steps for run in result.runs)
        if show_prints or result.failed:
            console.put_parts(print_lines(single.agent.name, single.prints.text(), everything=show_prints))
    else:
        if live:
            refuse("--live shows one evaluation on this machine: name one agent and one task, without --engine.", GlbenchError)
        from glbench.evaluation.jobs import LocalEngine, RayEngine

        place: Engine = LocalEngine() if engine is options.EngineName.LOCAL else RayEngine(address, workers)
        if fresh_draws:
            place = _WithFreshDraws(place)
        succeeded = _evaluate_many(jobs, place, unusable, printer, prints=show_prints)
    if not as_json and (succeeded or single is not None):
        from glbench.evaluation.evaluation import results_folder

        folder = results_folder(out, tasks[0])
        board = f"leaderboard{'' if folder == REPORTS else f' --out {folder}'}"
        console.tell(f"Next: glbench {board if has_steps else f'submit check {agents[0]}'}")
    if not succeeded:
        raise typer.Exit(1)


def _all_failed(result: Result) -> str:
    runs = "The only run" if len(result.runs) == 1 else f"All {len(result.runs)} runs"
    return f"{runs} of {result.agent.name} failed: the result counts missing steps at the task's price alone, and is no evaluation."


def select_tasks(names: Sequence[str], suites: Sequence[str], sealed: Round | None, split: str = "test") -> list[TaskSpec]:
    """The tasks of these names, each once, with the draws of a ``sealed`` round if there is one; the default task when none is named.

    Raises ``TaskError`` when a task has no such split, or two differ only in their namespace: their results would share one file.
    """
    from glbench.tasks import DEFAULT_TASK, get_suite, get_task

    tasks = [get_task(name) for name in names] + [task for name in suites for task in get_suite(name)]
    by_folder: dict[str, TaskSpec] = {}
    for task in tasks or [get_task(DEFAULT_TASK)]:
        other = by_folder.setdefault(task.short_id, task)
        if other.digest != task.digest:
            msg = f"{other.id} ({other.source}) and {task.id} ({task.source}) would share one result folder. Evaluate them one by one."
            raise TaskError(msg)
    tasks = list(by_folder.values())
    if split != "test":
        if sealed is not None or split in ("training", "preview"):
            why = (
                "training and preview seasons are not scored. Use --split validation" if sealed is None else "a round has only a test split"
            )
            refuse(f"--split {split} is not evaluated: {why}.", TaskError)
        return [task.in_split(split) for task in tasks]
    return tasks if sealed is None else [task.in_split("test", sealed.secret) for task in tasks]


def load_agents(refs: Sequence[str], sandbox: SandboxName) -> tuple[dict[str, Protected], dict[str, str]]:
    """The agents of these names, each once, and the reasons why others cannot be used. A single one that cannot be used raises.

    Raises ``SubmissionError`` when two different agents have one name: their results would overwrite each other.
    """
    from glbench.evaluation import protect
    from glbench.evaluation.sandbox.choosing import EXAMPLES

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
        agent = protected.agent
        other = by_name.setdefault(agent.name, protected)
        if other.agent.digest != agent.digest:
            refuse(f"Two different agents are called '{agent.name}' and would share one result file. Rename one of them.", SubmissionError)
        if other is not protected:
            continue
        usable[ref] = protected
        if EXAMPLES.get(agent.name, agent.digest) != agent.digest:
            console.print_warning(
                f"'{agent.name}' is the name of an example of glbench, and this one is changed: the leaderboard leaves its result out. "
                "Copy it to a name of your own."
            )
    return usable, unusable


def _evaluate(evaluation: Evaluation, printer: console.Printer, *, viewer: str | None, again: Job | None) -> Result:
    """Run one evaluation, or load its stored result, and show it; ``viewer`` is the address of a live view.

    ``again`` is its job if fresh draws are to follow, else ``None``.
    """
    from glbench.evaluation import SavingError

    printer.say(announcement(evaluation))
    result = evaluation.stored
    if result is None:
        try:
            result = _run(evaluation, as_json=printer.as_json, viewer=viewer)
        except SavingError as error:
            printer.show(result_view(error.result, evaluation.task))
            raise
    else:
        words = f"Already evaluated on {result.created}: this is the stored result (--fresh evaluates again)."
        printer.say(console.Line(words, aside=True, wrap="always"))
        evaluation.complete(result)
    if again is not None and printer.as_json:
        result = _with_fresh_draws(again, printer)
    printer.show(result_view(result, evaluation.task))
    if again is not None and not printer.as_json:
        from glbench.leaderboard.fresh_draws import fresh_words

        result = _with_fresh_draws(again, printer)
        printer.say(console.paragraph(f"With fresh draws: {fresh_words(result, _ranking_metric(evaluation.task))}"))
    if evaluation.path is not None:
        path, here = evaluation.path, Path.cwd()
        file = path.relative_to(here) if path.is_relative_to(here) else path
        sealed = "" if result.task.salt_commitment is None else " --round FILE"
        printer.say(console.aside(f"Saved: {file}"), console.aside(f"Reproduce it: glbench verify {console.quoted(file)}{sealed}"))
    return result


def _with_fresh_draws(job: Job, printer: console.Printer) -> Result:
    """Add fresh draws to the finished ``job``, and return its result."""
    from glbench.evaluation.fresh_draws import add_fresh_draws

    def run(part: Job) -> Result:
        evaluation = part.prepare()
        if evaluation.stored is not None:
            return evaluation.stored
        printer.say(console.aside(f"{part.agent_name} with {'fresh' if part.task.sealed else 'the published'} draws"))
        return _run(evaluation, as_json=printer.as_json, viewer=None)

    return add_fresh_draws(job, run)


class _WithFreshDraws:
    """An engine that evaluates each agent a second time with fresh draws."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def run(self, jobs: Sequence[Job], report: Report) -> Iterator[Outcome]:
        """Do the jobs, each with the published and then with fresh draws."""
        from glbench.evaluation.fresh_draws import add_fresh_draws
        from glbench.evaluation.jobs import LocalEngine

        outcomes = self._engine.run(jobs, report)
        # A cluster is left before it is joined again.
        for outcome in outcomes if isinstance(self._engine, LocalEngine) else tuple(outcomes):

            def run(part: Job, whole: Outcome = outcome) -> Result:
                (again,) = self._engine.run([part], lambda _, standing: report(whole.job, standing))
                if again.result is None:
                    raise SubmissionError(again.reason or "")
                return again.result

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


def result_view(result: Result, task: TaskSpec) -> console.View:
    """What was earned, as a table or as one line of JSON."""

    def parts() -> Iterator[console.Part]:
        from glbench.leaderboard.catalogue import catalogue

        if any(run.steps for run in result.runs):
            yield summary_table(result, catalogue(task))
        yield from failure_lines(result)

    return console.View(parts(), lambda: result.model_dump_json(by_alias=True))


def _run(evaluation: Evaluation, *, as_json: bool, viewer: str | None) -> Result:
    from glbench.evaluation import SavingError

    def consequence() -> str:
        if evaluation.interrupted:
            return "What could be written is kept: the same command (without --fresh) continues from the last checkpoint."
        return "Interrupted before the first checkpoint; the same command starts over."

    try:
        with (
            console.interruption(consequence),
            agents_print_to_stderr(as_json),
            live_view(viewer, evaluation) as watcher,
            EvaluationBar(evaluation) as bar,
        ):
            return evaluation.run(bar.update, watcher)
    except (SubmissionError, SavingError):
        raise
    except GlbenchError as error:
        if not evaluation.interrupted:
            raise
        refuse(f"{error}\n{consequence()}", type(error), error)


@contextlib.contextmanager
def agents_print_to_stderr(as_json: bool) -> Iterator[None]:
    """With ``as_json`` keep standard output for the JSON: what agents and solvers print, from Python or C, goes to standard error."""
    if not as_json:
        yield
        return
    with standard_output_to(2), contextlib.redirect_stdout(sys.stderr):
        yield


def _evaluate_many(jobs: Sequence[Job], engine: Engine, unusable: dict[str, str], printer: console.Printer, *, prints: bool) -> bool:
    """Do all ``jobs`` and print how each ended, as JSON or as text; return whether every agent succeeded in at least one run.

    ``unusable`` names the agents that could not be loaded, with the reasons. With ``prints`` everything that agents print is shown, else
    the last lines of those that fail.
    """
    outcomes: list[Outcome] = []
    bar = JobsBar(len(jobs))

    def consequence() -> str:
        finished = sum(outcome.result is not None for outcome in outcomes)
        return (
            f"{finished} of {len(jobs)} evaluations are done and saved. The same command (without --fresh) continues: these are not "
            "repeated, unfinished ones continue from their checkpoints."
        )

    with console.interruption(consequence), bar:
        stream = iter(engine.run(jobs, bar.report))
        while True:
            with agents_print_to_stderr(printer.as_json):
                outcome = next(stream, None)
            if outcome is None:
                break
            outcomes.append(outcome)
            bar.ended(outcome)
            number = f"{len(outcomes):{len(str(len(jobs)))}}/{len(jobs)}"
            if outcome.result is not None or not printer.as_json:
                printer.show(outcome_view(outcome, number, prints=prints))
    failures = [(outcome, outcome.reason) for outcome in outcomes if outcome.reason is not None]
    failures += [
        (outcome, _all_failed(outcome.result))
        for outcome in outcomes
        if outcome.result is not None and len(outcome.result.failed) == len(outcome.result.runs)
    ]
    reasons = [(f"{one.job.agent_name} on {one.job.task.short_id}", reason) for one, reason in failures]
    reasons += unusable.items()
    printer.say(outcomes_table(jobs, outcomes))
    if reasons:
        console.tell(Markup(f"[bold red]{len(reasons)} failed:[/bold red]"))
        for what, reason in reasons:
            console.tell(Markup(f"  {styled(what, 'red')}: {plain(_short(reason))}"))
    return not reasons


def outcome_view(outcome: Outcome, number: str, *, prints: bool) -> console.View:
    """A line for a job, and why runs failed; with ``--json`` the result."""
    from glbench.leaderboard.fresh_draws import fresh_words
    from glbench.leaderboard.statistics import estimate

    result, name, metric = outcome.result, outcome.job.agent_name, _ranking_metric(outcome.job.task)

    def parts() -> Iterator[console.Part]:
        title = f"{styled(number, 'dim')} {styled(name, 'bold')} on {plain(outcome.job.task.short_id)}: "
        if result is None:
            failed = f"[red]failed[/red] after {outcome.seconds:.1f} s: {plain(_short(outcome.reason or ''))}"
            yield console.aside(Markup(title + failed))
            return
        runs = count(len(result.runs), "run")
        if result.failed:
            runs += f", [red]{len(result.failed)} failed[/red]"
        time = "already there" if outcome.stored else f"{outcome.seconds:.1f} s"
        again = "" if result.fresh_draws is None else f"; with fresh draws {plain(fresh_words(result, metric))}"
        one = estimate(result.values(metric.name))
        spread = len(result.runs) > 1 and one.low < one.high
        score = metric.phrase(one.mean) + (f" ({metric.number(one.low)} to {metric.number(one.high)})" if spread else "")
        yield console.aside(Markup(f"{title}{score}, {runs}, {time}{again}"))
        if prints or result.failed:
            yield from reason_lines(result, _MOST_REASONS, indent="    ")
            yield from print_lines(name, outcome.printed, everything=prints, last=_MOST_LINES, indent="    ")

    return console.View(parts(), lambda: None if result is None else result.model_dump_json(by_alias=True))


def outcomes_table(jobs: Sequence[Job], outcomes: Sequence[Outcome]) -> console.Table:
    """Mean of what ranks on each task, of every agent; a few agents side by side, many below each other."""
    from glbench.quantities import pretty_unit

    def cell(outcome: Outcome) -> str:
        if outcome.result is None:
            return Markup("[red]failed[/red]")
        metric = _ranking_metric(outcome.job.task)
        mean = outcome.result.summary.mean.get(metric.name)
        return ("–" if mean is None else metric.number(mean)) + ("*" if outcome.result.failed else "")

    cells = {(outcome.job.agent_name, outcome.job.task.short_id): cell(outcome) for outcome in outcomes}
    agents = list(dict.fromkeys(job.agent_name for job in jobs))
    tasks = list(dict.fromkeys(job.task.short_id for job in jobs))
    by_task = len(agents) <= _SIDE_BY_SIDE
    rows, columns = (tasks, agents) if by_task else (agents, tasks)
    first, heads = ("Task", agents) if by_task else ("Agent", [task.replace("-", "\n") for task in tasks])
    ranking = [_ranking_metric(job.task) for job in jobs]
    scores = {f"{one.heading or one.label} [{pretty_unit(one.unit) or '-'}]" for one in ranking}
    failures = any(outcome.result is not None and outcome.result.failed for outcome in outcomes)
    view = console.table(
        f"{' or '.join(sorted(scores))}, mean over the runs", first, *heads, numbers=heads, fold=[first, *heads],
        caption=_CAPTION if failures else None, caption_justify="left", box=HEAVY_HEAD,
    )  # fmt: skip
    for row in rows:
        view.add(row, *(cells.get((column, row) if by_task else (row, column), "") for column in columns))
    return view


def _ranking_metric(task: TaskSpec) -> Metric:
    from glbench.leaderboard.catalogue import catalogue

    return catalogue(task).metrics[task.evaluation.metric]


def _short(reason: str) -> str:
    words = " ".join(reason.split())
    return words if len(words) <= _LONGEST_REASON else words[: _LONGEST_REASON - 4] + " ..."


def announcement(evaluation: Evaluation) -> console.Line:
    """What is about to be evaluated, in two lines."""
    task, seeds, days = evaluation.task, evaluation.seeds, evaluation.task.weather.days
    numbers = f"seeds {seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else f"seed {seeds[0]}"
    sealed = "" if task.salt_commitment is None else f"\nsealed round {task.salt_commitment}"
    split = ", [bold]validation split[/bold]" if task.split == "validation" else ""
    sees = " [yellow](privileged: sees more than the observations)[/yellow]" if evaluation.agent.privileged else ""
    words = (
        f"{styled(evaluation.agent.name, 'bold')}{sees} on {styled(task.id, 'bold')}{split}: {plain(task.title)}\n"
        f"{count(len(seeds), 'run')} ({numbers}) of {count(days, 'day')}, {task.steps} steps of {task.step_seconds:g} s; "
        f"{count(evaluation.workers, 'worker')}, {evaluation.kernel['backend']} kernel, {_PROTECTIONS[evaluation.protection]}{sealed}"
    )
    return console.paragraph(Markup(words), aside=True)


def print_lines(name: str, prints: str, *, everything: bool, last: int = _MOST_PRINTS, indent: str = "") -> Iterator[console.Line]:
    """What the sandboxed agent ``name`` printed: all that was kept of it, or its last lines."""
    lines = prints.rstrip().splitlines()
    selection = lines if everything else lines[-last:]
    more = f" (the last {len(selection)} of {len(lines)} lines; --show-prints shows more)" if len(selection) < len(lines) else ""
    if lines:
        yield console.aside(f"{indent}What {name} printed{more}:")
    for line in selection:
        is_whole = everything or len(line) <= _LONGEST_LINE
        yield console.aside(f"{indent}  {line if is_whole else f'{line[: _LONGEST_LINE - 4]} ...'}")
