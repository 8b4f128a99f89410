"""``glbench evaluate``: run agents on tasks, show what they earned, save it."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.choices import Sandbox
from glbench.cli.console import messages, output, print_warning, say
from glbench.cli.leaving import INTERRUPTED, leaving_at_once, tell_interrupted
from glbench.cli.view import live_view, live_viewer
from glbench.errors import GlbenchError, SubmissionError, TaskError

if TYPE_CHECKING:
    from glbench.evaluation import Evaluation, Protected, Result, SandboxChoice
    from glbench.evaluation.engines import Engine
    from glbench.tasks import TaskSpec


class EngineName(StrEnum):
    """The choices of ``--engine``."""

    LOCAL = "local"
    RAY = "ray"


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
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", "-w", min=1, help="Cores that share the simulation; changes no number. Default: all."
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for results/ and for the checkpoint of unfinished work.")
    ] = Path("reports"),
    episodes: Annotated[
        str,
        typer.Option(
            "--episodes",
            help="Runs to keep as full episodes (3 MB each): all, none, or a list of best, worst, median and seeds. "
            "The actions of all runs are kept anyway, so that the others can be made later.",
        ),
    ] = "best,worst,median",
    as_json: Annotated[
        bool, typer.Option("--json", help="Print each result as one line of JSON and nothing else.")
    ] = False,
    live: Annotated[
        bool,
        typer.Option("--live", help="Watch the first run in the viewer while it is simulated (needs glbench[view])."),
    ] = False,
    sandbox: Annotated[
        Sandbox,
        typer.Option(
            "--sandbox",
            envvar="GLBENCH_SANDBOX",
            help="Where submissions run: bubblewrap (no network, no weather, no seeds, limited in size), or none (with your rights: "
            "for code that you wrote or have read). auto: bubblewrap, but unchanged examples of glbench run without where there is none.",
        ),
    ] = Sandbox.AUTO,
    show_prints: Annotated[
        bool, typer.Option("--show-prints", help="Show what sandboxed agents print, also when nothing fails.")
    ] = False,
    engine: Annotated[
        EngineName,
        typer.Option("--engine", help="Where evaluations run: local, or ray (a Ray cluster; needs glbench[ray])."),
    ] = EngineName.LOCAL,
    address: Annotated[
        str | None,
        typer.Option(
            "--address", help="Address of a Ray cluster, such as auto. Default: one is started on this machine."
        ),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Evaluate again even if the result is there, and forget unfinished work.")
    ] = False,
) -> None:
    """Evaluate agents on tasks: seeded runs in lockstep, a table with intervals, and a result file each.

    Results depend neither on --workers nor on --engine. What is interrupted (Ctrl-C, a crash, a power cut) goes on with the
    same command, and what is finished is not done again.
    """
    with leaving_at_once():
        from glbench.cli.evaluate_many import Told, evaluate_many
        from glbench.cli.evaluation_tables import print_prints
        from glbench.evaluation.engines import Job, Options

    try:
        with _quiet_agents(as_json), messages().status("preparing") as status:
            tasks = _tasks(task or [], suite or [])
            usable, unusable = _agents(agents, sandbox.value)
            if _kernel_is_new(tasks):
                status.update("building the kernel, once on this machine: some seconds")
            options = Options(out, runs, seed, workers, fresh, episodes)
            jobs = [Job(chosen, ref, agent, options) for chosen in tasks for ref, agent in usable.items()]
            first = jobs[0].prepare() if len(jobs) == 1 and not unusable and engine is EngineName.LOCAL else None
    except KeyboardInterrupt:
        tell_interrupted("Nothing was evaluated yet.")
        raise typer.Exit(INTERRUPTED) from None
    if not as_json:
        _say_if_slow()
    if first is not None:
        with live_viewer() if live else contextlib.nullcontext() as viewer:
            result = _evaluate(first, as_json=as_json, viewer=viewer)
        if show_prints or result.failed:
            print_prints(first.agent.name, first.prints.text(), everything=show_prints)
    else:
        if live:
            msg = "--live shows one evaluation on this machine: name one agent and one task, without --engine."
            raise GlbenchError(msg)
        chosen_engine = _engine(engine, address, workers)
        told = Told(as_json=as_json, prints=show_prints)
        if not evaluate_many(jobs, chosen_engine, unusable, quiet=lambda: _quiet_agents(as_json), told=told):
            raise typer.Exit(1)
    if not as_json:
        option = "" if out == Path("reports") else f" --out {out}"
        messages().print(f"Next: glbench leaderboard{option}", markup=False, soft_wrap=True)


def _engine(name: EngineName, address: str | None, workers: int | None) -> Engine:
    from glbench.evaluation.engines import LocalEngine

    if name is EngineName.LOCAL:
        if address is not None:
            msg = "--address is that of a Ray cluster: add --engine ray."
            raise GlbenchError(msg)
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
        print_warning(f"{reason} Until then CasADi's own integrator steps the model: minutes instead of seconds.")


def _tasks(names: Sequence[str], suites: Sequence[str]) -> list[TaskSpec]:
    """The tasks asked for, each once; the default task when none is.

    Raises
    ------
    TaskError
        When two tasks differ in their namespace only: their results would overwrite each other.
    """
    from glbench.tasks import DEFAULT_TASK, get_suite, get_task

    chosen = [get_task(name) for name in names] + [task for name in suites for task in get_suite(name)]
    by_folder: dict[str, TaskSpec] = {}
    for task in chosen or [get_task(DEFAULT_TASK)]:
        other = by_folder.setdefault(task.short_id, task)
        if other.digest != task.digest:
            msg = f"{other.id} ({other.source}) and {task.id} ({task.source}) would share one result folder. Evaluate them one by one."
            raise TaskError(msg)
    return list(by_folder.values())


def _agents(refs: Sequence[str], sandbox: SandboxChoice) -> tuple[dict[str, Protected], dict[str, str]]:
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
    return usable, unusable


def _evaluate(evaluation: Evaluation, *, as_json: bool, viewer: str | None = None) -> Result:
    """Run one evaluation, or take its stored result, and show it; ``viewer`` is the address of a live view."""
    from glbench.cli.evaluation_tables import announcement
    from glbench.evaluation import SavingError

    if not as_json:
        say(messages(), announcement(evaluation))
    result = evaluation.stored
    if result is None:
        try:
            result = _run(evaluation, as_json=as_json, viewer=viewer)
        except SavingError as error:
            _show(error.result, as_json=as_json)
            raise
    elif not as_json:
        messages().print(f"Already evaluated on {result.created}: this is the stored result (--fresh evaluates again).")
    if evaluation.stored is not None:
        evaluation.complete_episodes(evaluation.stored)
    _show(result, as_json=as_json)
    if evaluation.path is not None and not as_json:
        messages().print(f"Saved: {_shown(evaluation.path)}", markup=False, soft_wrap=True)
        messages().print(f"Reproduce it: glbench verify {_shown(evaluation.path)}", markup=False, soft_wrap=True)
    return result


def _show(result: Result, *, as_json: bool) -> None:
    """What was earned, as a table or as one line of JSON."""
    from glbench.cli.evaluation_tables import print_failures, summary_table

    if as_json:
        output().out(result.model_dump_json(by_alias=True), highlight=False)
        return
    output().print(summary_table(result))
    print_failures(result)


def _run(evaluation: Evaluation, *, as_json: bool, viewer: str | None) -> Result:
    from glbench.cli.evaluation_progress import ProgressBar
    from glbench.evaluation import SavingError

    try:
        with (
            _quiet_agents(as_json),
            live_view(viewer, evaluation) as watcher,
            ProgressBar(evaluation) as bar,
        ):
            return evaluation.run(bar.update, watcher)
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
    """A path as short as it can be copied: relative when it lies below the current folder."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)
