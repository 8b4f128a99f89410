"""``glbench leaderboard``: rank all stored results and show them, on request write them; and ``glbench badge``."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.cells import cell_len

from glbench.cli import console, options
from glbench.cli.console import Markup, plain, styled
from glbench.cli.options import REPORTS
from glbench.errors import ResultError, did_you_mean, refuse
from glbench.resources import where_results_are, write_atomically
from glbench.untrusted import visible

if TYPE_CHECKING:
    from glbench.leaderboard import Row, StoredResult, TaskTable
    from glbench.leaderboard.suites import SuiteRow, SuiteTable
    from glbench.leaderboard.tables import TableColumn

_AGENT = "Agent"
_TURNS = 3  # Orders that hang on the price of violations that the terminal names
_SPAN = "95 % interval\nor range ↔"


def leaderboard(
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Show this task: id or file (.toml); repeatable. Default: the one evaluated last."),
    ] = None,
    suite: Annotated[list[str] | None, typer.Option("--suite", "-s", help="Show agents over all tasks of this suite (repeatable).")] = None,
    members: Annotated[
        bool, typer.Option("--members", "--trainings", help="Show each training below the entry that it belongs to.")
    ] = False,
    show_all: Annotated[bool, typer.Option("--all", help="Show every task and suite that has results.")] = False,
    out: options.Out = REPORTS,
    write: Annotated[
        bool, typer.Option("--write", help="Write leaderboard.md, .csv, .parquet, .json and .tex into that folder, too.")
    ] = False,
    as_json: options.AsJson = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 when a result file cannot be used.")] = False,
    round_file: Annotated[
        Path | None, typer.Option("--round", help="The file of a sealed round (docs/maintain.md): name entries made after it closed.")
    ] = None,
) -> None:
    """Rank all results, with 95 % intervals. Nothing is written unless you ask for it (--write).

    Results are read from OUT/results and from the released results that come with glbench. Trainings of one recipe, as stated in their
    cards, are one entry with its range.
    """
    from glbench.leaderboard import rank, to_frame, write_leaderboard
    from glbench.leaderboard.collect import own_and_released_results, published_expectations
    from glbench.leaderboard.suites import suite_tables
    from glbench.leaderboard.tables import suite_frame
    from glbench.tasks import list_suites

    options.check_folder(out)
    sealed, names, suite = options.round_of(round_file), options.task_ids(task or []), suite or []
    stored, problems = own_and_released_results(out)
    options.warn_of(problems)
    if not stored:
        refuse(f"There are no results in {out / 'results'} yet. Make one with `glbench evaluate submissions/my_agent.py`.", ResultError)
    expected, suites = published_expectations(), list_suites()
    if show_all and (names or suite):
        refuse("--all shows every task and suite. Leave out --task and --suite.", ResultError)
    if members and suite and not names:
        refuse("--members shows the trainings in a task's table. Add --task TASK, or leave it out.", ResultError)
    for name in suite:
        if name not in suites:
            refuse(f"There is no suite '{name}'.{did_you_mean(name, suites)}", ResultError)
    tables = rank(stored if write or show_all or suite else _of_boards(stored, names), expected)
    if sealed is not None:
        from glbench.leaderboard.ranking import with_late_entries

        tables = with_late_entries(tables, stored, sealed)
    if show_all:
        selection = list(tables)
    elif names:
        selection = _by_names(tables, names)
    else:
        selection = [] if suite else [table for table in tables if table.task_id == _usual(stored)]
    aggregated = suite_tables(stored, expected, tables) if write or suite or show_all else ()
    of_suites = [table for table in aggregated if show_all or table.suite in suite]
    paths = write_leaderboard(tables, suites, out, aggregated) if write else ()

    def document() -> Any:
        frame = to_frame(selection) if selection else suite_frame(of_suites)
        return json.loads(frame.to_json(orient="records", double_precision=15))

    def more() -> Iterator[console.Line]:
        boards = {table.task_id for table in selection}
        for item in stored:
            if item.confirmed and item.board in boards:
                name = item.result.agent.name
                yield console.Line(f"Your own result of {name} on {item.board} is the same as the released one.", wrap="always")
        where = "" if out == REPORTS else f" --out {console.quoted(out)}"
        hidden = len({item.board for item in stored}) - len(boards) if boards else 0
        if hidden > 0:
            have = "board has" if hidden == 1 else "boards have"
            yield console.aside(f"{hidden} more {have} results: glbench leaderboard --all{where}; over a suite: --suite paper")
        if paths:
            yield console.aside("Written: " + ", ".join(str(path) for path in paths))
        yield console.aside(f"As a page to look into: glbench report{where}")

    missing = [name for name in suite if name not in {table.suite for table in aggregated}]
    hints = {name: where_results_are(suites[name]) for name in missing}
    lacks = {name: f"results here.{hint}" if hint else "both results and a best known one yet." for name, hint in hints.items()}
    notes = [f"No task of the suite '{name}' has {what}" for name, what in lacks.items()]
    notes += ["The JSON has tasks only. For suites, use --suite without --task or --all."] * bool(as_json and selection and of_suites)
    notes += [words for table in selection for words in table.late] * bool(as_json)
    console.show(
        console.View(
            chain(_parts(selection, of_suites, members=members), more()), document, notes=notes, code=int(strict and bool(problems))
        ),
        as_json=as_json,
    )


def badge(
    agent: Annotated[str, typer.Argument(help="Name of an agent that has a result.")],
    task: Annotated[
        str | None, typer.Option("--task", "-t", help="Of this task: id or file (.toml). Default: the default task, if it has results.")
    ] = None,
    out: options.Out = REPORTS,
    file: Annotated[Path, typer.Option("--file", "-f", help="Where the picture goes.")] = Path("badge.svg"),
) -> None:
    """Draw a badge: task, rank, reward, and whether the result was reproduced."""
    from glbench.leaderboard import rank
    from glbench.leaderboard.collect import own_and_released_results, published_expectations
    from glbench.leaderboard.tables import badge as draw
    from glbench.tasks import DEFAULT_TASK, usual_task

    options.check_folder(out)
    options.check_file(file, ".svg")
    stored, problems = own_and_released_results(out)
    options.warn_of(problems)
    tables = rank(stored, published_expectations())
    has = [table.task_id for table in tables if any(row.agent == agent for row in table.rows)]
    (table,) = _by_names(tables, options.task_ids([task]) if task else [usual_task(has) or next(iter(has), DEFAULT_TASK)])
    write_atomically(file, draw(table, agent))
    console.tell(f"Written: {file}")


def _of_boards(stored: Sequence[StoredResult], names: Sequence[str]) -> Sequence[StoredResult]:
    """The results of these boards, or of the usual one; all where a name is none of theirs."""
    if not names:
        usual = _usual(stored)
        return [item for item in stored if item.board == usual]
    boards = {item.board for item in stored}
    selection = {board for board in boards if board in names or board.rpartition("/")[2] in names}
    return stored if len(selection) < len(set(names)) else [item for item in stored if item.board in selection]


def _usual(stored: Sequence[StoredResult]) -> str:
    """Board of the user's latest result, else that of the default task."""
    from glbench.tasks import usual_task

    own = [item for item in stored if not item.released]
    task_id = usual_task(item.result.task.id for item in stored)
    usual = [item for item in stored if item.result.task.id == task_id]
    return max(own or usual or stored, key=lambda item: (item.result.created, item.board)).board


def _by_names(tables: Sequence[TaskTable], names: Sequence[str]) -> list[TaskTable]:
    by_name = options.tables_by_name(tables)
    for name in names:
        if name not in by_name:
            boards = sorted({by_name[board].task_id for board in by_name if board.startswith(name if "@" in name else f"{name}@")})
            if boards:
                refuse(f"'{name}' has several boards here, of sealed rounds or other splits. Name one: {', '.join(boards)}.", ResultError)
            if namesakes := [board for board in by_name if board.endswith(f"/{name}")]:
                refuse(f"Several tasks here are called '{name}'. Name one: {', '.join(namesakes)}.", ResultError)
            hint = where_results_are([name]) or did_you_mean(name, [table.task_id for table in tables])
            refuse(f"There are no results of a task '{name}'.{hint}", ResultError)
    return list({by_name[name].task_id: by_name[name] for name in names}.values())


def _parts(tables: Sequence[TaskTable], suites: Sequence[SuiteTable], *, members: bool) -> Iterator[console.Part]:
    from glbench.leaderboard import tables as t

    for suite in suites:
        yield from _suite_tables(suite)
        for note in (*t.missing_notes(suite), *t.turn_notes(suite, _TURNS)):
            yield _note(note)
        yield _note(t.suite_note(suite), "dim")
        if not tables and any(row.regret is not None for row in suite.rows):
            yield _note(t.REGRET_NOTE, "dim")
    for table in tables:
        yield from _task_tables(table, members=members)
        for entry in table.rows:
            if entry.failed:
                yield _note(f"{entry.agent}: {entry.failed} of {entry.runs} runs failed.")
            if entry.remark:
                yield _note(f"{entry.agent} is {entry.remark}.")
        for note in (*t.turn_notes(table, _TURNS), *t.card_notes(table), *t.fresh_notes(table)):
            yield _note(note, "yellow")
        for note in t.regret_notes(table):
            yield _note(note, "green")
        if t.kernel_note(table):
            yield _note(t.kernel_note(table), "yellow")
        if not members and any(row.is_range for row in table.rows):
            yield console.aside("Each training by itself: --trainings", "dim")
    for note in t.footnotes(tables):
        yield _note(note, "dim")


def _note(text: str, style: str = "") -> console.Line:
    return console.Line(text, style, wrap="always")


def _task_tables(table: TaskTable, *, members: bool) -> Iterator[console.Table]:
    """Ranks and what they rest on, then what each agent grew and used."""
    from glbench.leaderboard import tables as t
    from glbench.leaderboard.collect import short_board

    def agent(row: Row) -> str:
        return t.agent_label(row) + (" " * (t.agent_label(row) == t.entry_label(row)) + t.REPRODUCED_MARK) * row.reproduced

    def agent_and_origin(row: Row) -> str:
        """For the table without a column for the source."""
        return t.agent_label(row) + " (trial)" * (row.origin == "trial" and row.training_seed is None)

    def span(row: Row) -> str:
        one = row.estimates.get(first.name)
        if one is None or not one.low < one.high:
            return t.NONE
        low, high = t.number_text(one.low, first.digits), t.number_text(one.high, first.digits)
        return f"{low} {t.RANGE_MARK if row.is_range else 'to'} {high}"

    def runs(row: Row) -> str:
        several = f"{len(row.trainings)}×{row.trainings[0].runs}" if row.is_range else str(row.runs)
        return several if row.failed == 0 else f"{row.runs - row.failed}/{row.runs}"

    def has(part: str) -> bool:
        estimates = [row.estimates[first.name] for row in table.rows if first.name in row.estimates]
        return any(getattr(one, part) is not None for one in estimates)

    rows = t.shown_rows(table, members=members)
    first, *others = (metric for metric in t.ranked_columns(table) if metric.interval or metric.name == table.metric)
    regrets = t.regret_columns(table, (2, 11, 10), spans=False) if t.has_regret(table) else []
    regrets = [replace(column, heading=column.heading.replace(", ", ",\n")) for column in regrets]
    scores = [
        t.of_metric(first),
        t.TableColumn(_SPAN, span, gives_way=1),
        *([replace(t.fresh_column(first), heading="Fresh\ndraws")] if t.has_fresh_draws(table) else []),
        *regrets[:1],
        t.worst_column(first, gives_way=5),
        *t.price_columns(table.rows, 5),
        t.reversal_column(9),
        *t.year_columns(table.rows, first, gives_way=6),
        *([replace(t.overall_column(first, gives_way=6), heading="Overall\n95 %")] if has("overall") else []),
        *([replace(t.deviation_column(first, gives_way=8), heading="SD of\ntrainings")] if has("deviation") else []),
        t.iqm_column(first, "IQM", gives_way=9),
        *(t.of_metric(metric, gives_way=3 + place) for place, metric in enumerate(others)),
        *regrets[1:],
        t.TableColumn("Runs", runs, gives_way=7),
        replace(t.SOURCE, cell=lambda row: "" if row.training_seed is not None else str(row.origin)),
    ]
    ranks = t.TableColumn("#", lambda row: "" if row.training_seed is not None else t.NONE if row.rank is None else str(row.rank))
    title = f"{plain(visible(table.title))}\n{styled(visible(short_board(table.task_id)), 'dim')}"
    if table.draws:
        title += f"\n{styled(table.draws, 'yellow')}"
    columns = [ranks, t.TableColumn(_AGENT, agent), *scores]
    yield _table(title, columns, rows, lambda row: row.rank is None or row.training_seed is not None)
    columns = [t.TableColumn(_AGENT, agent_and_origin), *_resources(t.resources(table.words, without_intervals=True), before=0)]
    yield _table("Harvest, resources, climate", columns, rows, lambda row: row.training_seed is not None)


def _suite_tables(table: SuiteTable) -> Iterator[console.Table]:
    """Agents over a suite: scores, then what they earned, grew and used."""
    from glbench.leaderboard import tables as t
    from glbench.leaderboard.catalogue import of_published

    def agent(row: SuiteRow) -> str:
        one = row.figures
        if one is None:
            return t.suite_label(row)
        marks = t.PRIVILEGED_MARK * one.privileged + t.UNSANDBOXED_MARK * (one.sandbox == "unsandboxed")
        marks += t.REPRODUCED_MARK * one.reproduced
        return f"{t.suite_label(row)} {marks}" if marks else t.suite_label(row)

    def score(heading: str, name: str, gives_way: int) -> TableColumn:
        return t.TableColumn(heading, lambda row: t.score_text(getattr(row, name).value), gives_way=gives_way)

    normalised = [
        score("Mean", "mean", 0),
        t.TableColumn("95 %\ninterval", lambda row: t.span_text(row.mean, is_range=False) or t.NONE, gives_way=2),
        score("IQM", "iqm", 1),
    ]
    money = t.money_columns(table, (1, 2), spans=table.in_money)
    scores = [
        t.TableColumn("#", lambda row: t.NONE if row.rank is None else str(row.rank)),
        t.TableColumn(_AGENT, agent),
        *([] if table.in_money else normalised),
        *(replace(one, heading=one.heading.replace(" ", "\n")) for one in (*money, *t.price_columns(table.rows, 6), t.reversal_column(7))),
        *([] if table.in_money else [score("Median", "median", 5), score("Optimality\ngap", "optimality_gap", 3)]),
        t.TableColumn("Runs", lambda row: str(row.runs), gives_way=4),
        replace(t.SOURCE, cell=lambda row: "" if row.figures is None else str(row.figures.origin)),
    ]
    title = f"Suite {plain(table.suite)}, {console.count(len(table.tasks), 'task')}\n{styled(t.scale_words(table), 'dim')}"
    yield _table(title, scores, table.shown_rows, lambda row: row.rank is None)
    rows = [row for row in table.rows if row.figures is not None]
    figures = [t.of_figures(one) for one in _resources(t.resources(of_published(table.tasks)), before=1)]
    title = "Money, harvest, resources, climate: means over the tasks with results"
    yield _table(title, [t.TableColumn(_AGENT, agent), *figures], rows, lambda row: bool(row.missing))


def _resources(metrics: Sequence[Any], before: int) -> list[TableColumn]:
    """Metrics, decision and training, with their headings word below word; the last ones give way first."""
    from glbench.leaderboard import tables as t

    columns = [t.of_metric(metric, gives_way=place) for place, metric in enumerate(metrics)]
    places = len(columns) + before
    columns += [replace(t.DECISION, gives_way=places), replace(t.TRAINING, gives_way=places - 1)]
    return [replace(column, heading=column.heading.replace(" ", "\n")) for column in columns]


def _table(title: str, columns: Sequence[TableColumn], rows: Sequence[Any], is_dim: Callable[[Any], bool]) -> console.Table:
    """A table that fits the terminal: agents' names fold, numbers are never cut, columns give way."""
    view = console.Table(Markup(title), [], look={"padding": (0, 1, 0, 0), "show_edge": False})
    for row in rows:
        view.add(*(column.cell(row) for column in columns), style="dim" if is_dim(row) else None)
    for place, column in enumerate(columns):
        heading = column.heading.replace(" [", "\n[")
        if column.heading == _AGENT:
            view.columns.append(console.Column(heading, fold=True, elastic=True))
            continue
        texts = (heading, *(row.cells[place] for row in view.rows))
        wide = max(cell_len(line) for text in texts for line in text.split("\n"))
        view.columns.append(console.Column(heading, number=True, min_width=wide, gives_way=column.gives_way))
    return view
