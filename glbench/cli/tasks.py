"""``glbench tasks``: list, explain, check and lock the tasks."""

from __future__ import annotations

import dataclasses
import datetime as dt
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.padding import Padding
from rich.text import Text

from glbench.cli.console import harmless, messages, output, put, put_json, table
from glbench.cli.options import AsJson, Out
from glbench.errors import GlbenchError, TaskError, UnknownNameError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from rich.console import RenderableType
    from rich.table import Table

    from glbench.tasks import TaskSpec

_DRAFT = "draft"
"""What stands for the digest of a shipped task that may still change."""

app = typer.Typer(
    help="List, explain, check and lock the tasks.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command("list")
def list_command(
    suite: Annotated[str | None, typer.Option("--suite", "-s", help="Only the tasks of this suite.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the tasks that come with glbench, suite by suite, the default task first: what each is, how long, under which weather."""
    from glbench.tasks import DEFAULT_TASK, list_drafts, list_tasks, read_lock
    from glbench.tasks.deprecated import read_deprecated

    published, drafts = list_tasks(), list_drafts()
    tasks = _by_suite([*published, *drafts], DEFAULT_TASK)
    if suite is not None:
        suites = dict.fromkeys(name for task in tasks for name in task.suites)
        if suite not in suites:
            msg = f"There is no suite '{suite}'.{did_you_mean(suite, suites)}"
            raise UnknownNameError(msg)
        tasks = [task for task in tasks if suite in task.suites]
    lock = read_lock()
    digests = {task.id: lock[task.id].digest if task.id in lock else None for task in published}
    if as_json:
        put_json([_summary(task, digests.get(task.id)) for task in tasks])
        return
    for part in _listing(tasks, {**digests, **dict.fromkeys((task.id for task in drafts), _DRAFT)}):
        output().print(part)
    deprecated = read_deprecated()
    for task in tasks:
        if task.id in deprecated:
            output().print(f"[yellow]Deprecated:[/yellow] {deprecated[task.id].in_words(task.id)}", soft_wrap=True)
    messages().print(
        f"Commands without --task take {DEFAULT_TASK}. `glbench tasks show ID` explains a task.", style="dim"
    )


@app.command("show")
def show_command(
    task: Annotated[str, typer.Argument(help="Id of a task, its short form, or a .toml file.", metavar="ID|FILE")],
    as_json: AsJson = False,
) -> None:
    """Explain a task in words: goal, period, what is seen and done, limits, prices, reward, evaluation."""
    from glbench.tasks import get_task

    spec = get_task(task)
    if as_json:
        put_json(_explained(spec))
        return
    for part in _explanation(spec):
        output().print(part)


@app.command("check")
def check_command(
    tasks: Annotated[
        list[str] | None, typer.Argument(help="Ids or .toml files; all shipped tasks without.", metavar="[ID|FILE ...]")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Check tasks: the shipped ones, with what is computed from them, against what was published; your own files for mistakes.

    Exits with 1 if one is wrong.
    """
    from glbench.registration import DRAFTS, draft_files
    from glbench.tasks import TaskSpec
    from glbench.tasks.stale_prices import series_in_words

    drafts = {} if tasks else {f"tasks/{DRAFTS}/{path.name}": path for path in draft_files()}
    found = {name: _check(name) for name in tasks} if tasks else _check_all()
    found |= {name: _check(str(path)) for name, path in drafts.items()}
    wrong = {name: outcome for name, outcome in found.items() if isinstance(outcome, str)}
    if as_json:
        put_json([_checked(name, outcome) for name, outcome in found.items()])
    else:
        for name, outcome in found.items():
            if isinstance(outcome, TaskSpec):
                state = (
                    "as published" if outcome.locked else "draft, valid" if name in drafts else "valid, not published"
                )
                output().print(f"[green]ok[/green]     {outcome.id}  {outcome.digest[:8]}  {state}", soft_wrap=True)
                if name.endswith(".toml") and not outcome.locked and name not in drafts:
                    for words in series_in_words(outcome):
                        put(f"       {words}")
                    output().print(_first_weather(outcome))
            else:
                output().print("[red]wrong[/red]  ", end="")
                output().print(harmless(outcome), markup=False, soft_wrap=True)
        messages().print(_verdict(len(found), len(wrong)))
    if wrong:
        raise typer.Exit(1)


@app.command("lock")
def lock_command(as_json: AsJson = False) -> None:
    """Publish new tasks: add those that are not locked yet to tasks/lock.toml and tasks/behaviour.toml. Never changes an entry."""
    from glbench.env.behaviour import lock_behaviour
    from glbench.tasks import get_task, lock_new_tasks, read_lock

    new = lock_new_tasks()
    computed = lock_behaviour(get_task(task_id) for task_id in read_lock())
    if as_json:
        put_json([{"id": entry.id, "file": entry.file, "digest": entry.digest} for entry in new])
        return
    for entry in new:
        output().print(f"locked {entry.id}  {entry.digest[:8]}", soft_wrap=True)
    for task_id in computed:
        output().print(f"computed {task_id}, in tasks/behaviour.toml", soft_wrap=True)
    if not new and not computed:
        messages().print(f"Nothing to do: all {len(read_lock())} tasks are locked, and none has changed.")


def _check_all() -> dict[str, TaskSpec | str]:
    """Every shipped task, and every entry of the lock whose file is gone; a text says what is wrong."""
    from glbench.registration import task_files
    from glbench.tasks import read_lock

    outcomes: dict[str, TaskSpec | str] = {}
    seen = set()
    for path in task_files():
        outcome = _check(str(path), published=True)
        outcomes[f"tasks/{path.name}"] = outcome
        seen.add(path.name)
    for entry in read_lock().values():
        if entry.file not in seen:
            outcomes[f"tasks/{entry.file}"] = (
                f"tasks/lock.toml lists {entry.id}, but its file tasks/{entry.file} is gone. Published tasks stay: restore the file."
            )
    return outcomes


def _check(name: str, *, published: bool = False) -> TaskSpec | str:
    """The task, or what is wrong with it. ``published``: it also has to be locked and its file called after it."""
    from glbench.env.accounts import make_accounts
    from glbench.env.behaviour import check_behaviour
    from glbench.env.rewards import make_reward
    from glbench.env.weather_pool import WeatherPool
    from glbench.tasks import get_task
    from glbench.tasks.library import check_file_name

    try:
        task = get_task(name)
        if published:
            check_file_name(task, Path(name))
            if not task.locked:
                msg = f"{task.source} is not locked yet. Publish it with `glbench tasks lock`."
                raise TaskError(msg)
        task.check_start()
        make_reward(task, make_accounts(task))
        if task.locked:
            check_behaviour(task)
        else:
            WeatherPool.of(task.scored)  # the weather of all seasons, with what a forecast shows beyond their end
    except GlbenchError as error:
        return str(error)
    return task


def _verdict(total: int, wrong: int) -> str:
    counted = f"{total} task{'s' if total != 1 else ''}"
    return f"{counted} checked, {wrong} wrong." if wrong else f"{counted} checked, nothing wrong."


def _summary(task: TaskSpec, digest: str | None) -> dict[str, Any]:
    return {
        "id": task.id,
        "title": task.title,
        "suites": list(task.suites),
        "start": task.weather.start.isoformat(),
        "days": task.weather.days,
        "step_seconds": task.step_seconds,
        "steps": task.steps,
        "delta": task.uncertainty.delta,
        "half_width": task.uncertainty.half_width,
        "splits": None if task.splits is None else task.splits.model_dump(mode="json", exclude_none=True),
        "weather": task.weather.source,
        "preprocessing": task.weather.preprocessing,
        "model_variant": task.model.variant,
        "locked": digest is not None,
        "digest": digest,
    }


def _checked(name: str, outcome: TaskSpec | str) -> dict[str, Any]:
    if isinstance(outcome, str):
        return {"task": name, "ok": False, "problem": outcome}
    return {"task": name, "ok": True, "id": outcome.id, "digest": outcome.digest, "locked": outcome.locked}


@app.command("references")
def references_command(
    write: Annotated[bool, typer.Option("--write", help="Write tasks/references.toml and tasks/best_known/.")] = False,
    out: Out = Path("reports/released"),
) -> None:
    """Show what scores are measured by: the reward of doing nothing, and that of the best known runs.

    Both come from results: that of submissions/do_nothing.py, and for each seed the best one of all agents that act through the task's
    actuation.
    """
    from glbench.leaderboard import collect_results
    from glbench.leaderboard.collect import published_expectations
    from glbench.leaderboard.regret import best_known_from
    from glbench.leaderboard.suites import references_from
    from glbench.tasks.best_known import write_best_known
    from glbench.tasks.references import read_references, write_references

    if write:
        stored, expected = collect_results([out / "results"]), published_expectations()
        found = references_from(stored, expected)
        if not found:
            msg = f"There is no complete result of do_nothing in {out / 'results'}. Evaluate submissions/do_nothing.py first."
            raise GlbenchError(msg)
        messages().print(f"Written: {write_references({**read_references(), **found})}", soft_wrap=True)
        for known in best_known_from(stored, expected).values():
            messages().print(f"Written: {write_best_known(known)}", soft_wrap=True)
    headings, numbers = ("Task", "Doing nothing", "Best known", "by"), ("Doing nothing", "Best known")
    view = table("Zero and one of normalised scores", *headings, right=numbers, folded=("Task", "by"))
    for task_id, one in read_references().items():
        view.add_row(task_id.rpartition("/")[2], f"{one.nothing:,.1f}", f"{one.best:,.1f}", one.best_agent)
    output().print(view)


def _by_suite(tasks: Sequence[TaskSpec], default: str) -> list[TaskSpec]:
    """Tasks of a suite together; its suite and the default task itself come first, tasks in no suite last."""
    suites = list(dict.fromkeys(task.suites for task in tasks))
    first = next((task.suites for task in tasks if task.id == default), ())

    def place(task: TaskSpec) -> tuple[bool, bool, int, bool]:
        return not task.suites, task.suites != first, suites.index(task.suites), task.id != default

    return sorted(tasks, key=place)


def _listing(tasks: Sequence[TaskSpec], digests: Mapping[str, str | None]) -> Iterator[RenderableType]:
    """Tasks suite by suite, under their period and weather, a table for each; ``digests`` are the lock's."""
    for suites, of_suite in groupby(tasks, key=lambda task: task.suites):
        yield Text(f"Suite {', '.join(suites)}" if suites else "In no suite", style="bold")
        for common, group in groupby(of_suite, key=_common):
            yield Text(common, style="dim")
            rows = list(group)
            noisy = any(task.conventions.shows_delta for task in rows)
            columns = ("Task", "What it is", *(("Delta",) if noisy else ()), "Digest")
            view = _plain_table(columns, ("Delta",))
            for task in rows:
                digest = digests[task.id]
                delta = (f"{100 * task.uncertainty.delta:g} %",) if noisy else ()
                view.add_row(task.short_id, task.title, *delta, digest[:8] if digest else "not locked")
            yield Padding(view, (0, 0, 1, 2), expand=False)


def _common(task: TaskSpec) -> str:
    """What the tasks of a group share: period, step and weather in words."""
    from glbench.report.task_words import minutes, period

    weather = task.weather
    return (
        f"{period(task)}, step {minutes(task.step_seconds)}, "
        f"weather '{weather.source}', prepared '{weather.preprocessing}'"
    )


def _explanation(task: TaskSpec) -> Iterator[RenderableType]:
    """The task in words and tables."""
    from glbench.report.task_words import definition_in_words
    from glbench.tasks.stale_prices import series_in_words

    task.record()  # a mistake in the weather has to show
    state = "published" if task.locked else "not published"
    yield Text.assemble((task.title, "bold"), "\n", (f"{task.id}  ({state}, digest {task.digest[:8]})", "dim"))
    if task.description.strip():
        yield Text("\n" + " ".join(task.description.split()))
    for section in definition_in_words(task):
        yield Text("\n" + section.heading, style="bold")
        if section.lines:
            yield Padding(Text("\n".join(section.lines)), (0, 0, 0, 2), expand=False)
        if section.rows:
            view = _plain_table(section.columns, section.right)
            for row in section.rows:
                view.add_row(*map(Text, row))
            yield Padding(view, (0, 0, 0, 2), expand=False)
    series = series_in_words(task)
    if series:
        yield Text("\nSeries of prices", style="bold")
        yield Padding(Text("\n".join(series)), (0, 0, 0, 2), expand=False)


def _explained(task: TaskSpec) -> dict[str, Any]:
    """The same for machines: card, definition, digests, uncertain parameters."""
    from glbench.tasks import task_card

    card = dataclasses.asdict(task_card(task))
    card["start"] = card["start"].isoformat()
    del card["written"]  # the definition follows
    return {
        "id": task.id,
        "title": task.title,
        "description": task.description,
        "suites": list(task.suites),
        "source": task.source,
        "base": task.base,
        "changes": [dataclasses.asdict(change) for change in task.changes],
        "locked": task.locked,
        "digest": task.digest,
        "fingerprint": dataclasses.asdict(task.fingerprint()),
        "card": card,
        "uncertain_parameters": list(task.uncertain_parameters()),
        "definition": task.definition(),
    }


def _first_weather(task: TaskSpec, rows: int = 4) -> RenderableType:
    """The weather of the first steps, so that a mistake in the period shows."""
    from zoneinfo import ZoneInfo

    from glbench.env.scenario import run_weather

    generated, zone = task.scenario.generated, ZoneInfo(task.record().timezone)
    weather = task.disturbances() if generated is None else run_weather(task, generated.first_seed)
    headings = [
        "Step",
        "UTC",
        "Local",
        "Sun\nW m-2",
        "Air\ndegC",
        "Vapour\nPa",
        "CO2\nmg m-3",
        "Wind\nm s-1",
        "Sky\ndegC",
    ]
    look = {"box": None, "header_style": "bold", "title_style": None}
    title = f"Weather of the first steps{'' if generated is None else ' of the first season'}"
    view = table(title, *headings, right=headings, folded=headings, **look)
    for row, (moment, values) in enumerate(zip(weather.times[:rows], weather.values[:rows], strict=True)):
        cells = (f"{value:.1f}" for value in values[:6])
        local = moment.astype(dt.datetime).replace(tzinfo=dt.UTC).astimezone(zone)
        view.add_row(str(row), str(moment).replace("T", " ")[:16], f"{local:%H:%M}", *cells)
    return Padding(view, (0, 0, 1, 7), expand=False)


def _plain_table(columns: Sequence[str], right: Sequence[str]) -> Table:
    free = [name for name in columns if name not in ("Name", "Control")]
    look = {"box": None, "pad_edge": False, "header_style": "dim"}
    view = table(None, *columns, right=right, folded=free, **look)
    if columns[0] == "":
        view.columns[0].style = "dim"
    return view
