"""``glbench leaderboard``: rank all stored results and show them, on request write them; and ``glbench badge``.

Tables are as wide as the terminal: columns that find no room are left out, numbers are never cut.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.cells import cell_len
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from glbench.cli.console import harmless, messages, output, print_warning, tell
from glbench.cli.options import REPORTS, AsJson, Out, round_of
from glbench.cli.stored import check_folder, tables_by_name, task_ids, warn_of
from glbench.errors import ResultError, did_you_mean
from glbench.untrusted import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from glbench.leaderboard import Row, StoredResult, TaskTable
    from glbench.leaderboard.suites import SuiteRow, SuiteTable
    from glbench.leaderboard.tables import TableColumn

_NARROWEST_AGENT = 8
_NARROW_AGENT = 18
"""Agents' names are folded to this width before a column is left out, and further only when nothing is left to leave out."""
_SPAN = "95 % interval\nor range ↔"


def leaderboard(
    task: Annotated[
        list[str] | None,
        typer.Option(
            "--task", "-t", help="Show this task: id or file (.toml); repeatable. Default: the one evaluated last."
        ),
    ] = None,
    suite: Annotated[
        list[str] | None,
        typer.Option("--suite", "-s", help="Show agents over all tasks of this suite: normalised scores (repeatable)."),
    ] = None,
    members: Annotated[
        bool,
        typer.Option("--members", "--trainings", help="Show each training below the entry that it belongs to."),
    ] = False,
    show_all: Annotated[bool, typer.Option("--all", help="Show every task and suite that has results.")] = False,
    out: Out = REPORTS,
    write: Annotated[
        bool,
        typer.Option("--write", help="Write leaderboard.md, .csv, .parquet, .json and .tex into that folder, too."),
    ] = False,
    as_json: AsJson = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 when a result file cannot be used.")] = False,
    round_file: Annotated[
        Path | None,
        typer.Option(
            "--round", help="The file of a sealed round (docs/maintain.md): name entries made after it closed."
        ),
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

    check_folder(out)
    sealed = round_of(round_file)
    task = task_ids(task or [])
    stored, problems = own_and_released_results(out)
    warn_of(problems)
    if not stored:
        msg = (
            f"There are no results in {out / 'results'} yet. Make one with `glbench evaluate submissions/my_agent.py`."
        )
        raise ResultError(msg)
    expected, suites = published_expectations(), list_suites()
    for name in suite or []:
        if name not in suites:
            msg = f"There is no suite '{name}'.{did_you_mean(name, suites)} There are: {', '.join(suites)}."
            raise ResultError(msg)
    boards = len({item.board for item in stored})
    tables = rank(stored if write or show_all or suite else _of_boards(stored, task), expected)
    if sealed is not None:
        from glbench.leaderboard.ranking import with_late_entries

        tables = with_late_entries(tables, stored, sealed)
    shown = _chosen(tables, stored, task, show_all) if task or show_all or not suite else []
    aggregated = suite_tables(stored, expected, tables) if write or suite or show_all else ()
    suites_shown = aggregated if show_all else [table for table in aggregated if table.suite in (suite or [])]
    for name in suite or []:
        if name not in {table.suite for table in aggregated}:
            print_warning(f"No task of the suite '{name}' has both results and a best known one yet.")
    paths = write_leaderboard(tables, suites, out, aggregated) if write else ()
    if as_json:
        frame = to_frame(shown) if shown else suite_frame(suites_shown)
        rows = frame.to_json(orient="records", double_precision=15)
        output().out(json.dumps(json.loads(rows), indent=2), highlight=False)
    else:
        _print(shown, suites_shown, members=members)
        for item in stored:
            if item.confirmed and item.board in {table.task_id for table in shown}:
                _say(f"Your own result of {item.result.agent.name} on {item.board} is the same as the released one.")
        hidden = boards - len(shown) if shown else 0
        if hidden > 0:
            have = "task has" if hidden == 1 else "tasks have"
            messages().print(f"{hidden} more {have} results: glbench leaderboard --all; over a suite: --suite paper")
        if paths:
            messages().print("Written: " + ", ".join(str(path) for path in paths), soft_wrap=True)
        tell(f"As a page to look into: glbench report{'' if out == REPORTS else f' --out {out}'}")
    if strict and problems:
        raise typer.Exit(1)


def badge(
    agent: Annotated[str, typer.Argument(help="Name of an agent that has a result.")],
    task: Annotated[
        str | None,
        typer.Option(
            "--task", "-t", help="Of this task: id or file (.toml). Default: the default task, if it has results."
        ),
    ] = None,
    out: Out = REPORTS,
    file: Annotated[Path, typer.Option("--file", "-f", help="Where the picture goes.")] = Path("badge.svg"),
) -> None:
    """Draw a badge: task, rank, reward, and whether the result was reproduced."""
    from glbench.leaderboard import rank
    from glbench.leaderboard.badges import badge as draw
    from glbench.leaderboard.collect import own_and_released_results, published_expectations
    from glbench.resources import write_atomically
    from glbench.tasks import DEFAULT_TASK, usual_task

    check_folder(out)
    stored, problems = own_and_released_results(out)
    warn_of(problems)
    tables = rank(stored, published_expectations())
    has = [table.task_id for table in tables if any(row.agent == agent for row in table.rows)]
    (table,) = _by_names(tables, task_ids([task]) if task else [usual_task(has) or next(iter(has), DEFAULT_TASK)])
    write_atomically(file, draw(table, agent))
    tell(f"Written: {file}")


def _of_boards(stored: Sequence[StoredResult], wanted: Sequence[str]) -> Sequence[StoredResult]:
    """The results of the boards asked for, or of the one that is shown without a wish; all where a name is none of theirs."""
    if not wanted:
        board = _usual(stored)
        return [item for item in stored if item.board == board]
    boards = {item.board for item in stored}
    known = {board for board in boards if board in wanted or board.rpartition("/")[2] in wanted}
    return stored if len(known) < len(set(wanted)) else [item for item in stored if item.board in known]


def _usual(stored: Sequence[StoredResult]) -> str:
    """Board of the user's latest result, else that of the default task."""
    from glbench.tasks import usual_task

    own = [item for item in stored if not item.released]
    known = usual_task(item.result.task.id for item in stored)
    usual = [item for item in stored if item.result.task.id == known]
    return max(own or usual or stored, key=lambda item: (item.result.created, item.board)).board


def _chosen(
    tables: Sequence[TaskTable], stored: Sequence[StoredResult], wanted: Sequence[str], show_all: bool
) -> list[TaskTable]:
    """The tables asked for; without a wish that of the user's latest result, else that of the default task."""
    if show_all:
        return list(tables)
    if wanted:
        return _by_names(tables, wanted)
    usual = _usual(stored)
    return [table for table in tables if table.task_id == usual]


def _by_names(tables: Sequence[TaskTable], wanted: Sequence[str]) -> list[TaskTable]:
    by_name = tables_by_name(tables)
    for name in wanted:
        if name not in by_name:
            boards = [board for board in by_name if board.startswith(f"{name}@")]
            if boards:
                msg = f"'{name}' has several boards here, of sealed rounds or other splits. Name one: {', '.join(boards)}."
                raise ResultError(msg)
            msg = f"There are no results of a task '{name}'.{did_you_mean(name, [table.task_id for table in tables])}"
            raise ResultError(msg)
    return list({by_name[name].task_id: by_name[name] for name in wanted}.values())


def _print(shown: Sequence[TaskTable], suites: Sequence[SuiteTable], *, members: bool) -> None:
    from glbench.leaderboard.tables import (
        AGAINST_NOTE,
        REGRET_NOTE,
        footnotes,
        fresh_notes,
        kernel_note,
        regret_notes,
        score_note,
        seen_notes,
    )

    for scores in suites:
        _print_suite(scores)
        for scored in scores.rows:
            if scored.missing:
                names = ", ".join(task.rpartition("/")[2] for task in scored.missing)
                _say(f"{scored.agent} is not ranked: it lacks {names}.", style="dim")
        _say(score_note(scores.tasks) + AGAINST_NOTE * any(row.against_rules for row in scores.rows), style="dim")
        if not shown and any(row.regret is not None for row in scores.rows):
            _say(REGRET_NOTE, style="dim")
    for table in shown:
        _print_task(table, members=members)
        for row in table.rows:
            if row.failed:
                _say(f"{row.agent}: {row.failed} of {row.runs} runs failed.")
            if row.remark:
                _say(f"{row.agent} is {row.remark}.")
        for note in (*seen_notes(table), *fresh_notes(table)):
            _say(note, style="yellow")
        for note in regret_notes(table):
            _say(note, style="green")
        if kernel_note(table):
            _say(kernel_note(table), style="yellow")
        if not members and any(row.is_range for row in table.rows):
            messages().print("Each training by itself: --trainings", style="dim")
    for note in footnotes(shown):
        output().print(note, style="dim", markup=False)


def _say(text: str, style: str | None = None) -> None:
    """A line with words from result files in it: no markup, no characters that steer the terminal."""
    output().print(harmless(text), style=style, markup=False)


def _print_task(table: TaskTable, *, members: bool) -> None:
    """Ranks and what they rest on, then what each agent grew and used."""
    from glbench.leaderboard import tables as t

    def agent(row: Row) -> str:
        marks = " " * (t.agent_label(row) == t.entry_label(row)) + t.REPRODUCED_MARK
        return t.agent_label(row) + marks * row.reproduced

    def named(row: Row) -> str:
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
        found = [row.estimates[first.name] for row in table.rows if first.name in row.estimates]
        return any(getattr(one, part) is not None for one in found)

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
        *t.year_columns(table.rows, first, gives_way=6),
        *([replace(t.overall_column(first, gives_way=6), heading="Overall\n95 %")] if has("overall") else []),
        *([replace(t.deviation_column(first, gives_way=8), heading="SD of\ntrainings")] if has("deviation") else []),
        t.TableColumn("IQM", lambda row: t.number_text(t.iqm_of(row, first), first.digits), gives_way=9),
        *(t.of_metric(metric, gives_way=3 + place) for place, metric in enumerate(others)),
        *regrets[1:],
        t.TableColumn("Runs", runs, gives_way=7),
        replace(t.SOURCE, cell=lambda row: "" if row.training_seed is not None else str(row.origin)),
    ]
    ranks = t.TableColumn(
        "#", lambda row: "" if row.training_seed is not None else t.NONE if row.rank is None else str(row.rank)
    )
    title = f"{escape(visible(table.title))}\n[dim]{escape(visible(table.task_id))}[/dim]"
    if table.draws:
        title += f"\n[yellow]{escape(table.draws)}[/yellow]"
    _print_fitted(title, scores, rows, agent, lambda row: row.rank is None or row.training_seed is not None, ranks)
    used = _resources(t.resources(table.words, without_intervals=True), before=0)
    _print_fitted("Harvest, resources, climate", used, rows, named, lambda row: row.training_seed is not None)


def _print_suite(table: SuiteTable) -> None:
    """Agents over a suite: normalised scores, then what they earned, grew and used."""
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

    scores = [
        score("Mean", "mean", 0),
        t.TableColumn("95 %\ninterval", lambda row: t.span_text(row.mean, is_range=False) or t.NONE, gives_way=2),
        score("IQM", "iqm", 1),
        *(
            replace(one, heading=one.heading.replace(" ", "\n"))
            for one in t.money_columns(table.rows, (1, 2), spans=False)
        ),
        score("Median", "median", 5),
        score("Optimality\ngap", "optimality_gap", 3),
        t.TableColumn("Runs", lambda row: str(row.runs), gives_way=4),
        replace(t.SOURCE, cell=lambda row: "" if row.figures is None else str(row.figures.origin)),
    ]
    title = (
        f"Suite {escape(table.suite)}, {len(table.tasks)} tasks: normalised scores\n"
        "[dim]0 is doing nothing, 1 the best known result of each task[/dim]"
    )
    ranks = t.TableColumn("#", lambda row: t.NONE if row.rank is None else str(row.rank))
    _print_fitted(title, scores, table.rows, agent, lambda row: row.rank is None, ranks)
    rows = [row for row in table.rows if row.figures is not None]
    used = [t.of_figures(one) for one in _resources(t.resources(of_published(table.tasks)), before=1)]
    title = "Money, harvest, resources, climate: means over the tasks with results"
    _print_fitted(title, used, rows, agent, lambda row: bool(row.missing))


def _resources(metrics: Sequence[Any], before: int) -> list[TableColumn]:
    """Metrics, decision and training, with their headings word below word; the last ones give way first."""
    from glbench.leaderboard import tables as t

    columns = [t.of_metric(metric, gives_way=place) for place, metric in enumerate(metrics)]
    count = len(columns) + before
    columns += [replace(t.DECISION, gives_way=count), replace(t.TRAINING, gives_way=count - 1)]
    return [replace(column, heading=column.heading.replace(" ", "\n")) for column in columns]


def _print_fitted(
    title: str,
    columns: Sequence[TableColumn],
    rows: Sequence[Any],
    agent: Callable[[Any], str],
    dim: Callable[[Any], bool],
    ranks: TableColumn | None = None,
) -> None:
    """The table with as many columns as the console has room for, and the names of the others."""
    console, names = output(), [agent(row) for row in rows]
    longest = max((cell_len(name) for name in names), default=0)
    kept = list(columns)

    def drawn(width: int) -> Table:
        return _table(title, [*([ranks] if ranks else []), *kept], rows, names, [dim(row) for row in rows], width)

    while True:
        narrow = min(longest, _NARROW_AGENT if any(column.gives_way for column in kept) else _NARROWEST_AGENT)
        narrow = max(narrow, len("Agent"))
        room = console.width - _least_width(console, drawn(narrow))
        most = max(kept, key=lambda column: column.gives_way)
        if room >= 0 or most.gives_way == 0:
            break
        kept.remove(most)
    output().print(drawn(min(max(longest, narrow), narrow + max(room, 0))))
    dropped = [column.heading.replace("\n", " ") for column in columns if column not in kept]
    if dropped:
        words = f"No room for: {', '.join(dropped)}. A wider terminal or --json has them."
        output().print(words, style="dim", markup=False)
    output().print()


def _least_width(console: Console, view: Table) -> int:
    return Measurement.get(console, console.options.update(max_width=10_000), view).minimum


def _table(
    title: str,
    columns: Sequence[TableColumn],
    rows: Sequence[Any],
    names: Sequence[str],
    dim: Sequence[bool],
    width: int,
) -> Table:
    view = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    before = [column for column in columns if column.heading == "#"]
    after = [column for column in columns if column not in before]
    for column in before:
        view.add_column(column.heading, justify="right", no_wrap=True)
    view.add_column("Agent", overflow="fold", width=width)
    for column in after:
        # A column is as wide as its longest number: rich would cut it otherwise, when the terminal is narrow.
        heading = column.heading.replace(" [", "\n[")
        texts = (heading, *(column.cell(row) for row in rows))
        wide = max(cell_len(line) for text in texts for line in text.split("\n"))
        view.add_column(escape(heading), justify="right", no_wrap=True, min_width=wide)
    for row, name, is_dim in zip(rows, names, dim, strict=True):
        cells = [*(column.cell(row) for column in before), escape(name), *(column.cell(row) for column in after)]
        view.add_row(*cells, style="dim" if is_dim else None)
    return view
