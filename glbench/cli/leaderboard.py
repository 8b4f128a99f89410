"""``glbench leaderboard``: rank all stored results and show them; on request, write the tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import harmless, messages, output, print_warning
from glbench.cli.stored import check_folder, tables_by_name, warn_of
from glbench.errors import ResultError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table

    from glbench.leaderboard import StoredResult, TaskTable
    from glbench.leaderboard.suites import SuiteTable

_REPORTS = Path("reports")


def leaderboard(
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Show this task (repeatable). Default: the one evaluated last."),
    ] = None,
    suite: Annotated[
        list[str] | None,
        typer.Option("--suite", "-s", help="Show agents over all tasks of this suite: normalised scores (repeatable)."),
    ] = None,
    members: Annotated[
        bool, typer.Option("--members", help="Show each training below the entry that it belongs to.")
    ] = False,
    show_all: Annotated[bool, typer.Option("--all", help="Show every task and suite that has results.")] = False,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder with results/ in it.")] = _REPORTS,
    write: Annotated[
        bool,
        typer.Option("--write", help="Write leaderboard.md, .csv, .parquet, .json and .tex into that folder, too."),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON and nothing else.")] = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit code 1 when a result file cannot be used.")] = False,
) -> None:
    """Rank all results, with 95 % intervals. Nothing is written unless you ask for it (--write).

    Results are read from OUT/results and from the released results that come with glbench. Trainings that differ in their seed alone
    (NAME, NAME_seed1, NAME_seed2) are one entry with its range.
    """
    from glbench.leaderboard import rank, to_frame, write_leaderboard
    from glbench.leaderboard.published import own_and_released_results, published_expectations
    from glbench.leaderboard.suite_views import suite_frame
    from glbench.leaderboard.suites import suite_tables
    from glbench.tasks import list_suites

    check_folder(out)
    stored, problems = own_and_released_results(out)
    warn_of(problems)
    if not stored:
        msg = (
            f"There are no results in {out / 'results'} yet. Make one with `glbench evaluate submissions/my_agent.py`."
        )
        raise ResultError(msg)
    expected, suites = published_expectations(), list_suites()
    tables = rank(stored, expected)
    shown = _chosen(tables, stored, task or [], show_all) if task or show_all or not suite else []
    _check_suites(suite or [])
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
        _print(shown, suites_shown, len(tables), paths, out, members=members)
    if strict and problems:
        raise typer.Exit(1)


def _chosen(
    tables: Sequence[TaskTable], stored: Sequence[StoredResult], wanted: Sequence[str], show_all: bool
) -> list[TaskTable]:
    """The tables asked for; without a wish that of the user's latest result, else that of the default task."""
    from glbench.tasks import DEFAULT_TASK

    if show_all:
        return list(tables)
    if not wanted:
        own = [item for item in stored if not item.released]
        usual = [item for item in stored if item.result.task.id == DEFAULT_TASK]
        latest = max(own or usual or stored, key=lambda item: (item.result.created, item.result.task.id)).result.task.id
        return [table for table in tables if table.task_id == latest]
    by_name = tables_by_name(tables)
    for name in wanted:
        if name not in by_name:
            msg = f"There are no results of a task '{name}'.{did_you_mean(name, [table.task_id for table in tables])}"
            raise ResultError(msg)
    return list({by_name[name].task_id: by_name[name] for name in wanted}.values())


def _check_suites(wanted: Sequence[str]) -> None:
    from glbench.tasks import list_suites

    known = list_suites()
    for name in wanted:
        if name not in known:
            msg = f"There is no suite '{name}'.{did_you_mean(name, known)} There are: {', '.join(known)}."
            raise ResultError(msg)


def _print(
    shown: Sequence[TaskTable],
    suites: Sequence[SuiteTable],
    total: int,
    paths: Sequence[Path],
    out: Path,
    *,
    members: bool,
) -> None:
    from glbench.cli.leaderboard_tables import resource_table, score_table, suite_resource_table, suite_score_table
    from glbench.leaderboard.suite_views import SCORE_NOTE
    from glbench.leaderboard.tables import FOOTNOTES, kernel_note

    for scores in suites:
        _print_fitted(suite_score_table(scores, output()), suite_resource_table(scores, output()))
        for scored in scores.rows:
            if scored.missing:
                names = ", ".join(task.rpartition("/")[2] for task in scored.missing)
                _say(f"{scored.aggregate.agent} is not ranked: it lacks {names}.", style="dim")
        _say(SCORE_NOTE, style="dim")
    for table in shown:
        _print_fitted(score_table(table, output(), members=members), resource_table(table, output(), members=members))
        for row in table.rows:
            if row.failed:
                _say(f"{row.agent}: {row.failed} of {row.runs} runs failed.")
            if row.remark:
                _say(f"{row.agent} is {row.remark}.")
        if kernel_note(table):
            _say(kernel_note(table), style="yellow")
        if not members and any(row.is_range for row in table.rows):
            messages().print("Each training by itself: --members", style="dim")
    for note in FOOTNOTES:
        output().print(note, style="dim", markup=False)
    hidden = total - len(shown) if shown else 0
    if hidden > 0:
        messages().print(
            f"{hidden} more {'task has' if hidden == 1 else 'tasks have'} results: glbench leaderboard --all; over a suite: --suite paper"
        )
    if paths:
        messages().print("Written: " + ", ".join(str(path) for path in paths), soft_wrap=True)
    option = "" if out == _REPORTS else f" --out {out}"
    messages().print(f"As a page to look into: glbench report{option}", markup=False, soft_wrap=True)


def _say(text: str, style: str | None = None) -> None:
    """A line with words from result files in it: no markup, no characters that steer the terminal."""
    output().print(harmless(text), style=style, markup=False)


def _print_fitted(*views: tuple[Table, tuple[str, ...]]) -> None:
    for view, dropped in views:
        output().print(view)
        if dropped:
            words = f"No room for: {', '.join(dropped)}. A wider terminal or --json has them."
            output().print(words, style="dim", markup=False)
        output().print()
