"""``glbench tasks``: list, explain, check and lock the tasks; ``glbench round``: the secret of a sealed round."""

from __future__ import annotations

import dataclasses
import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from glbench.cli import console
from glbench.cli.console import Markup, count, plain, styled
from glbench.cli.options import AsJson, Out
from glbench.errors import GlbenchError, TaskError, UnknownNameError, did_you_mean, refuse

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

_DRAFT = "draft"  # Shown instead of the digest of a shipped task that may still change

app = typer.Typer(help="List, explain, check and lock the tasks.", no_args_is_help=True)
round_app = typer.Typer(help="Make and check the secret of a sealed round (docs/maintain.md).", no_args_is_help=True)


@app.command("list")
def list_command(
    suite: Annotated[str | None, typer.Option("--suite", "-s", help="Only the tasks of this suite.")] = None, as_json: AsJson = False
) -> None:
    """List the tasks that come with glbench, suite by suite, the default task first: what each is, how long, under which weather."""
    from glbench.tasks import DEFAULT_TASK, list_drafts, list_tasks, read_lock
    from glbench.tasks.references import read_deprecated

    published, drafts = list_tasks(), list_drafts()
    suites_of = list(dict.fromkeys(task.suites for task in (*published, *drafts)))
    first = next((task.suites for task in published if task.id == DEFAULT_TASK), ())

    def place(task: TaskSpec) -> tuple[bool, bool, int, bool]:
        return not task.suites, task.suites != first, suites_of.index(task.suites), task.id != DEFAULT_TASK

    tasks = sorted((*published, *drafts), key=place)
    if suite is not None:
        suites = dict.fromkeys(name for task in tasks for name in task.suites)
        if suite not in suites:
            refuse(f"There is no suite '{suite}'.{did_you_mean(suite, suites)}", UnknownNameError)
        tasks = [task for task in tasks if suite in task.suites]
    lock = read_lock()
    digests = {task.id: lock[task.id].digest if task.id in lock else None for task in published}

    def parts() -> Iterator[console.Part]:
        yield from listing(tasks, {**digests, **dict.fromkeys((task.id for task in drafts), _DRAFT)})
        deprecated = read_deprecated()
        for task in tasks:
            if task.id in deprecated:
                yield console.Line(Markup(f"[yellow]Deprecated:[/yellow] {plain(deprecated[task.id].in_words(task.id))}"))
        words = f"Commands without --task take {DEFAULT_TASK}. `glbench tasks show ID` explains a task."
        yield console.Line(words, "dim", aside=True, wrap="always")

    console.show(console.View(parts(), lambda: [_summary(task, digests.get(task.id)) for task in tasks]), as_json=as_json)


@app.command("show")
def show_command(
    task: Annotated[str, typer.Argument(help="Id of a task, its short form, or a .toml file.", metavar="ID|FILE")], as_json: AsJson = False
) -> None:
    """Explain a task in words: goal, period, what is seen and done, limits, prices, reward, evaluation."""
    from glbench.tasks import get_task

    spec = get_task(task)
    console.show(console.View(explanation(spec), lambda: definition_document(spec)), as_json=as_json)


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
    from glbench.model.plausibility import find_doubts
    from glbench.registration import DRAFTS, draft_files, task_files
    from glbench.tasks import TaskSpec
    from glbench.tasks.library import price_doubts, series_in_words

    paths = [] if tasks else draft_files()
    lacking = [path for path in (*paths, *task_files()) if not tasks and _lacks_data(path)]
    drafts = {f"tasks/{DRAFTS}/{path.name}": path for path in paths if path not in lacking}
    outcomes = {name: _check(name) for name in tasks} if tasks else check_all()
    outcomes |= {name: _check(str(path)) for name, path in drafts.items()}
    wrong = sum(isinstance(outcome, str) for outcome in outcomes.values())
    doubts = {
        name: [doubt.text for doubt in find_doubts(one.parameters_by_name())]
        for name, one in outcomes.items()
        if isinstance(one, TaskSpec) and not one.locked
    }

    def parts() -> Iterator[console.Part]:
        for name, outcome in outcomes.items():
            if isinstance(outcome, TaskSpec):
                is_draft = name in drafts
                state = "as published" if outcome.locked else "draft, valid" if is_draft else "valid, not published"
                if state == "valid, not published" and outcome.id.startswith("glbench/"):
                    state += "; use a namespace of your own: glbench/ is that of shipped tasks"
                yield console.Line(Markup(f"[green]ok[/green]     {plain(outcome.id)}  {outcome.digest[:8]}  {state}"))
                if name.endswith(".toml") and not outcome.locked and not is_draft:
                    for doubt in doubts[name]:
                        yield console.Line(Markup(f"[yellow]doubt[/yellow]  {plain(doubt)}"), wrap="always")
                    for words in series_in_words(outcome):
                        yield console.Line(f"       {words}")
                    yield first_weather(outcome)
            else:
                yield console.Line(Markup(f"[red]wrong[/red]  {plain(outcome)}"))
        total = f"{count(len(outcomes), 'task')} checked"
        number = sum(map(len, doubts.values())) + sum(
            len(price_doubts(one)) for one in outcomes.values() if isinstance(one, TaskSpec) and not one.locked
        )
        verdict = f"{wrong} wrong" if wrong else f"usable, but {count(number, 'doubt')} above" if number else "nothing wrong"
        yield console.aside(f"{total}, {verdict}.")
        if lacking:
            names = ", ".join(path.stem for path in lacking)
            yield console.aside(
                f"Not checked, because an extra with their weather, or glbench-data with their pictures, is missing: {names}."
            )

    def document() -> list[dict[str, Any]]:
        return [
            {"task": name, "ok": False, "problem": one}
            if isinstance(one, str)
            else {"task": name, "ok": True, "id": one.id, "digest": one.digest, "locked": one.locked}
            | ({"doubts": doubts[name]} if doubts.get(name) else {})
            for name, one in outcomes.items()
        ]

    console.show(console.View(parts(), document, code=1 if wrong else 0), as_json=as_json)


@app.command("lock")
def lock_command(as_json: AsJson = False) -> None:
    """Publish new tasks: add those that are not locked yet to tasks/lock.toml and tasks/behaviour.toml. Never changes an entry."""
    from glbench.env.behaviour import lock_behaviour
    from glbench.tasks import get_task, lock_new_tasks, read_lock

    new = lock_new_tasks()
    computed = lock_behaviour(get_task(task_id) for task_id in read_lock())
    parts = [console.Line(f"locked {entry.id}  {entry.digest[:8]}") for entry in new]
    parts += [console.Line(f"computed {task_id}, in tasks/behaviour.toml") for task_id in computed]
    if not parts:
        parts = [console.aside(f"Nothing to do: all {len(read_lock())} tasks are locked, and none has changed.")]
    document = [{"id": entry.id, "file": entry.file, "digest": entry.digest} for entry in new]
    console.show(console.View(parts, document), as_json=as_json)


def check_all() -> dict[str, TaskSpec | str]:
    """Every shipped task whose data are here, and every entry of the lock whose file is gone; a problem is a text instead of a task."""
    from glbench.registration import task_files
    from glbench.tasks import read_lock

    outcomes: dict[str, TaskSpec | str] = {}
    files = set()
    for path in task_files():
        if not _lacks_data(path):
            outcomes[f"tasks/{path.name}"] = _check(str(path), published=True)
        files.add(path.name)
    for entry in read_lock().values():
        if entry.file not in files:
            outcomes[f"tasks/{entry.file}"] = (
                f"tasks/lock.toml lists {entry.id}, but its file tasks/{entry.file} is gone. Published tasks stay: restore the file."
            )
    return outcomes


def _lacks_data(path: Path) -> bool:
    """Whether the weather of a task, or its pictures, come with a package that is not installed."""
    from glbench.resources import lacks_pictures
    from glbench.tasks.inheritance import read_tables
    from glbench.weather.trace import lacks_package

    try:
        tables = read_tables(path).content
        return lacks_package(tables["weather"]["source"]) or ("camera" in tables and lacks_pictures())
    except (GlbenchError, KeyError, TypeError):
        return False  # the check says what is wrong with it


def _check(name: str, *, published: bool = False) -> TaskSpec | str:
    """The task, or a text that says what is wrong with it. ``published``: it also has to be locked, and its file named after it."""
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
                refuse(f"{task.source} is not locked yet. Publish it with `glbench tasks lock`.", TaskError)
        task.check_start()
        make_reward(task, make_accounts(task))
        if task.locked:
            check_behaviour(task)
        else:
            WeatherPool.of(task.scored)  # the weather of all seasons, with what a forecast shows beyond their end
    except GlbenchError as error:
        return str(error)
    return task


def _summary(task: TaskSpec, digest: str | None) -> dict[str, Any]:
    return {
        **{name: getattr(task, name) for name in ("id", "title", "step_seconds", "steps")},
        "suites": list(task.suites),
        "start": task.weather.start.isoformat(),
        "days": task.weather.days,
        "delta": task.uncertainty.delta,
        "half_width": task.uncertainty.half_width,
        "splits": None if task.splits is None else task.splits.model_dump(mode="json", exclude_none=True),
        "weather": task.weather.source,
        "preprocessing": task.weather.preprocessing,
        "model_variant": task.model.variant,
        "locked": digest is not None,
        "digest": digest,
    }


@app.command("references")
def references_command(
    write: Annotated[bool, typer.Option("--write", help="Write tasks/references.toml and tasks/best_known/.")] = False,
    out: Out = Path("reports/released"),
) -> None:
    """Show what scores are measured by: for each task the agent whose mean is zero, and the best known runs, whose mean is one.

    Both come from results. A zero is that of the agent that the file names, taken once and kept; one is, for each seed, the best run of all
    agents that act through the task's actuation.
    """
    from glbench.leaderboard import collect_results
    from glbench.leaderboard.collect import published_expectations
    from glbench.leaderboard.regret import best_known_from
    from glbench.leaderboard.suites import references_from
    from glbench.tasks.references import read_references, write_best_known, write_references

    if write:
        stored, expected = collect_results([out / "results"]), published_expectations()
        books = best_known_from(stored, expected)
        console.tell(f"Written: {write_references(references_from(stored, expected, read_references()))}")
        for book in books.values():
            console.tell(f"Written: {write_best_known(book)}")
    headings, numbers = ("Task", "Version", "Zero", "is the mean of", "One", "is that of the runs of"), ("Version", "Zero", "One")
    view = console.table("Zero and one of normalised scores", *headings, numbers=numbers, fold=("Task", "is that of the runs of"))
    for task_id, one in read_references().items():
        zero, best = ("–" if end is None else f"{end:,.1f}" for end in (one.zero, one.best))
        runs = f"{one.best_agent or '–'}{'' if one.plans else ' (no plans)'}"
        view.add(task_id.rpartition("/")[2], f"{one.version}", zero, one.zero_agent, best, runs)
    console.show(console.View([view]))


def listing(tasks: Sequence[TaskSpec], digests: Mapping[str, str | None]) -> Iterator[console.Part]:
    """Tasks suite by suite, under their period and weather, a table for each; ``digests`` are the lock's."""
    from glbench.report.task_words import minutes, period

    def common(task: TaskSpec) -> str:
        weather = f"weather '{task.weather.source}', prepared '{task.weather.preprocessing}'"
        return f"{period(task)}, step {minutes(task.step_seconds)}, {weather}"

    for suites, of_suite in groupby(tasks, key=lambda task: task.suites):
        yield console.Line(f"Suite {', '.join(suites)}" if suites else "In no suite", "bold", wrap="always")
        for words, group in groupby(of_suite, key=common):
            yield console.Line(words, "dim", wrap="always")
            rows = list(group)
            noisy = any(task.conventions.shows_delta for task in rows)
            view = _plain_table(("Task", "What it is", *(("Delta",) if noisy else ()), "Digest"), ("Delta",), (1, 2))
            for task in rows:
                digest = digests[task.id]
                delta = (f"{100 * task.uncertainty.delta:g} %",) if noisy else ()
                view.add(task.short_id, task.title, *delta, digest[:8] if digest else "not locked")
            yield view


def explanation(task: TaskSpec) -> Iterator[console.Part]:
    """The task in words and tables."""
    from glbench.report.task_words import definition_in_words
    from glbench.tasks.library import series_in_words

    task.record()  # raises if the weather is wrong
    state = "published" if task.locked else "not published"
    name = styled(f"{task.id}  ({state}, digest {task.digest[:8]})", "dim")
    yield console.Line(Markup(f"{styled(task.title, 'bold')}\n{name}"), wrap="always")
    if task.description.strip():
        yield console.Line("\n" + " ".join(task.description.split()), wrap="always")
    for section in definition_in_words(task):
        yield console.Line("\n" + section.heading, "bold", wrap="always")
        if section.lines:
            yield console.Line("\n".join(section.lines), indent=2)
        if section.rows:
            view = _plain_table(section.columns, section.right, (0, 2))
            for row in section.rows:
                view.add(*row)
            yield view
    series = series_in_words(task)
    if series:
        yield console.Line("\nSeries of prices", "bold", wrap="always")
        yield console.Line("\n".join(series), indent=2)


def definition_document(task: TaskSpec) -> dict[str, Any]:
    """The same for machines: card, definition, digests, uncertain parameters."""
    from glbench.tasks import task_card

    card = dataclasses.asdict(task_card(task))
    card["start"] = card["start"].isoformat()
    del card["definition"]  # it follows
    return {
        **{name: getattr(task, name) for name in ("id", "title", "description", "source", "base", "locked", "digest")},
        "suites": list(task.suites),
        "changes": [dataclasses.asdict(change) for change in task.changes],
        "fingerprint": dataclasses.asdict(task.fingerprint()),
        "card": card,
        "uncertain_parameters": list(task.uncertain_parameters()),
        "definition": task.definition(),
    }


def first_weather(task: TaskSpec, rows: int = 4) -> console.Table:
    """The weather of the first steps of the first scored run, so that a mistake in the period shows."""
    from zoneinfo import ZoneInfo

    from glbench.env.scenario import run_weather

    task = task.scored
    zone, weather = ZoneInfo(task.record().timezone), run_weather(task, task.evaluation.seeds[0])
    units = {"Sun": "W m-2", "Air": "degC", "Vapour": "Pa", "CO2": "mg m-3", "Wind": "m s-1", "Sky": "degC"}
    headings = ["Step", "UTC", "Local", *(f"{name}\n{unit}" for name, unit in units.items())]
    view = console.table(
        f"Weather of the first steps{'' if task.splits is None else ' of the first test season'}",
        *headings, numbers=headings, fold=headings, margin=(1, 7), box=None, header_style="bold", title_style=None,
    )  # fmt: skip
    for row, (moment, values) in enumerate(zip(weather.times[:rows], weather.values[:rows], strict=True)):
        local = moment.astype(dt.datetime).replace(tzinfo=dt.UTC).astimezone(zone)
        utc = str(moment).replace("T", " ")[:16]
        view.add(str(row), utc, f"{local:%H:%M}", *(f"{value:.1f}" for value in values[:6]))
    return view


def _plain_table(columns: Sequence[str], right: Sequence[str], margin: tuple[int, int]) -> console.Table:
    free = [name for name in columns if name not in ("Name", "Control")]
    look: dict[str, Any] = {"box": None, "pad_edge": False, "header_style": "dim"}
    view = console.table(None, *columns, numbers=right, fold=free, margin=margin, **look)
    if columns[0] == "":
        view.columns[0] = dataclasses.replace(view.columns[0], style="dim")
    return view


RoundPath = Annotated[Path, typer.Argument(metavar="FILE", help="The round's file (.toml).")]


@round_app.command("new")
def new_round(
    file: RoundPath,
    weather: Annotated[
        str | None, typer.Option("--weather", help="Weather record of the round's own, in place of the task's (glbench weather list).")
    ] = None,
    year: Annotated[list[int] | None, typer.Option("--year", help="A whole year of that record to draw from; repeatable.")] = None,
    closes: Annotated[
        str | None, typer.Option("--closes", help="Closing time, such as 2027-03-01T18:00+01:00. Results made after it count as late.")
    ] = None,
) -> None:
    """Make the secret of a round, write it to FILE, and print the commitment, which is to be published with the closing time."""
    from glbench.tasks.sealed import Round, closing_time, round_weather, write_round
    from glbench.weather import list_weather

    if (weather is None) != (not year):
        refuse("Weather of the round's own has a record and years: give --weather NAME and --year YEAR, or neither.", GlbenchError)
    closing = None if closes is None else closing_time(closes)
    sealed = Round.new(None if weather is None else round_weather(weather, year or ()), closing)
    write_round(sealed, file)
    console.write(sealed.commitment)
    console.tell(f"{file} is secret until the round is over: keep it, and a copy of it. Publish the commitment above.")
    if (checkout := next((one for one in file.resolve().parents if (one / ".git").exists()), None)) is not None:
        console.print_warning(f"{file} is in the git checkout {checkout}, where it could be committed. Move it out of there.")
    public = {one.digest: one.name for one in list_weather() if one.origin == "shipped"} if sealed.weather else {}
    if sealed.weather is not None and sealed.weather.digest in public:
        console.print_warning(
            f"The weather '{weather}' is the record '{public[sealed.weather.digest]}' that comes with glbench, so a submission "
            "can carry it. Take a record that nobody else has."
        )
    if closing is None:
        console.print_warning("This round never closes, so no result can be late. --closes gives it a closing time.")
    else:
        console.tell(f"The round closes at {sealed.closing_words}. Publish that, too; the commitment covers it.")


@round_app.command("check")
def check_round(
    file: RoundPath,
    commitment: Annotated[str | None, typer.Argument(metavar="[COMMITMENT]", help="The commitment that was published.")] = None,
) -> None:
    """Check that the secret in FILE fits its commitment, and the one that was published; print the commitment, and say if it is open."""
    from glbench.tasks import read_round

    sealed = read_round(file)
    if commitment is not None and commitment.strip().lower() != sealed.commitment:
        refuse(f"{file} opens the commitment {sealed.commitment}, and not {commitment}. It is not the secret of that round.", GlbenchError)
    console.write(sealed.commitment)
    weather = sealed.weather
    own = "" if weather is None else f" Weather {weather.digest}, years {', '.join(map(str, weather.years))}."
    state = "closed" if sealed.is_late(dt.datetime.now(dt.UTC)) else "open"
    until = " It has no closing time." if sealed.closes is None else f" The round is {state}: it closes at {sealed.closing_words}."
    console.tell(f"The secret in {file} fits.{own}{until.replace('it closes', 'it closed') if state == 'closed' else until}")
