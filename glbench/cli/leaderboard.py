"""``glbench leaderboard``: rank all stored results, show them, and write the tables."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output
from glbench.errors import ResultError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from rich.table import Table

    from glbench.leaderboard import StoredResult, TaskTable


def leaderboard(
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Show this task (repeatable). Default: the one evaluated last."),
    ] = None,
    show_all: Annotated[bool, typer.Option("--all", help="Show every task that has results.")] = False,
    out: Annotated[
        Path,
        typer.Option("--out", help="Folder with results/ in it; leaderboard.md, .csv and .parquet are written there."),
    ] = Path("reports"),
    as_json: Annotated[bool, typer.Option("--json", help="Print the rows as JSON and nothing else.")] = False,
) -> None:
    """Rank all results, with 95 % intervals, and write leaderboard.md, .csv and .parquet.

    Results are read from OUT/results and from the released results of the rule-based controllers that come with glbench.
    """
    from glbench.leaderboard import rank, to_frame, write_leaderboard
    from glbench.leaderboard.published import own_and_released_results, published_expectations
    from glbench.leaderboard.suites import scores_by_task, suite_table
    from glbench.tasks import list_suites
    from glbench.tasks.references import read_references

    stored = own_and_released_results(out)
    if not stored:
        msg = (
            f"There are no results in {out / 'results'} yet. Make one with `glbench evaluate submissions/my_agent.py`."
        )
        raise ResultError(msg)
    expected, suites = published_expectations(), list_suites()
    tables = rank(stored, expected)
    shown = _chosen(tables, stored, task or [], show_all)
    scores, references = scores_by_task(stored, expected), read_references()
    scored = [suite_table(name, tuple(ids), scores, references) for name, ids in suites.items()]
    aggregated = [table for table in scored if table is not None]
    paths = write_leaderboard(tables, suites, out, aggregated)
    if as_json:
        rows = to_frame(shown).to_json(orient="records", double_precision=15)
        output().out(json.dumps(json.loads(rows), indent=2), highlight=False)
        return
    _print(shown, len(tables), paths)


def _chosen(
    tables: Sequence[TaskTable], stored: Sequence[StoredResult], wanted: Sequence[str], show_all: bool
) -> list[TaskTable]:
    """The tables asked for; without a wish that of the result made last."""
    if show_all:
        return list(tables)
    if not wanted:
        latest = max(stored, key=lambda item: (item.result.created, item.result.task.id)).result.task.id
        return [table for table in tables if table.task_id == latest]
    by_name: Mapping[str, TaskTable] = {
        name: table for table in tables for name in (table.task_id, table.task_id.rpartition("/")[2])
    }
    for name in wanted:
        if name not in by_name:
            msg = f"There are no results of a task '{name}'.{did_you_mean(name, [table.task_id for table in tables])}"
            raise ResultError(msg)
    return list({by_name[name].task_id: by_name[name] for name in wanted}.values())


def _print(shown: Sequence[TaskTable], total: int, paths: Sequence[Path]) -> None:
    from glbench.leaderboard.tables import FOOTNOTES

    for table in shown:
        output().print(_score_table(table))
        output().print(_resource_table(table))
        for row in table.rows:
            if row.failed:
                output().print(f"{row.agent}: {row.failed} of {row.runs} runs failed.")
            if row.remark:
                output().print(f"{row.agent} is {row.remark}.")
    for note in FOOTNOTES:
        output().print(note, style="dim")
    hidden = total - len(shown)
    if hidden > 0:
        messages().print(
            f"{hidden} more {'task has' if hidden == 1 else 'tasks have'} results: glbench leaderboard --all"
        )
    messages().print("Written: " + ", ".join(str(path) for path in paths), soft_wrap=True)
    folder = paths[0].parent
    option = "" if folder == Path("reports") else f" --out {folder}"
    messages().print(f"As a page to look into: glbench report{option}", markup=False, soft_wrap=True)


def _score_table(table: TaskTable) -> Table:
    """Ranks and what they rest on, within 80 columns."""
    from rich import box
    from rich.table import Table

    from glbench.leaderboard.tables import VERIFIED_MARK, agent_label

    title = f"{table.title}\n[dim]{table.task_id}[/dim]"
    view = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, collapse_padding=True)
    view.add_column("#", justify="right")
    view.add_column("Agent", overflow="fold", min_width=16)
    for heading in ("Reward", "95 % interval", "IQM", "EPI\n[EUR/m²]", "Penalty", "Runs"):
        view.add_column(heading.replace("[", r"\["), justify="right", no_wrap=True)
    for row in table.rows:
        reward = row.estimates["reward"]
        view.add_row(
            "–" if row.rank is None else str(row.rank),
            agent_label(row) + (VERIFIED_MARK if row.verified else ""),
            f"{reward.mean:.1f}",
            f"{reward.low:.1f} to {reward.high:.1f}" if reward.low < reward.high else "–",
            f"{reward.iqm:.1f}",
            f"{row.estimates['epi'].mean:.3f}",
            f"{row.estimates['penalty'].mean:.1f}",
            str(row.runs) if row.failed == 0 else f"{row.runs - row.failed}/{row.runs}",
            style="dim" if row.rank is None else None,
        )
    return view


def _resource_table(table: TaskTable) -> Table:
    """What each agent grew and used, within 80 columns."""
    from rich import box
    from rich.table import Table

    from glbench.leaderboard.tables import COLUMNS, agent_label, format_estimate

    view = Table(title="Harvest, resources, climate", title_justify="left", box=box.SIMPLE_HEAD, collapse_padding=True)
    view.add_column("Agent", overflow="fold", min_width=16)
    columns = [column for column in COLUMNS if not column.interval]
    for column in columns:
        view.add_column(column.heading.replace(" ", "\n").replace("[", r"\["), justify="right")
    for row in table.rows:
        view.add_row(agent_label(row), *(format_estimate(row.estimates[column.metric], column) for column in columns))
    return view
