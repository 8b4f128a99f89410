"""The leaderboard's tables on a terminal, as wide as it is: columns that find no room are left out, numbers are never cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich import box
from rich.cells import cell_len
from rich.markup import escape
from rich.measure import Measurement
from rich.table import Table

from glbench.leaderboard.suite_views import score_text
from glbench.leaderboard.tables import (
    COLUMNS,
    PRIVILEGED_MARK,
    UNSANDBOXED_MARK,
    VERIFIED_MARK,
    agent_label,
    format_estimate,
    steps_text,
)

if TYPE_CHECKING:
    from rich.console import Console

    from glbench.leaderboard import Row, TaskTable
    from glbench.leaderboard.aggregates import Interval
    from glbench.leaderboard.suites import SuiteRow, SuiteTable

_NARROWEST_AGENT = 8
_NARROW_AGENT = 18
"""Agents' names are folded to this width before a column is left out, and further only when nothing is left to leave out."""


@dataclass(frozen=True)
class _Figures:
    """A column: heading, one text a row, and how willingly it is left out (0: never; the highest goes first)."""

    heading: str
    texts: tuple[str, ...]
    dispensable: int

    @property
    def name(self) -> str:
        return self.heading.replace("\n", " ")


def score_table(table: TaskTable, console: Console) -> tuple[Table, tuple[str, ...]]:
    """Ranks and what they rest on, and the names of the columns that found no room."""
    rows = table.rows
    columns = [
        _Figures("Reward", tuple(f"{row.estimates['reward'].mean:.1f}" for row in rows), 0),
        _Figures("95 % interval", tuple(_interval(row) for row in rows), 2),
        _Figures("IQM", tuple(f"{row.estimates['reward'].iqm:.1f}" for row in rows), 5),
        _Figures("EPI\n[EUR/m²]", tuple(f"{row.estimates['epi'].mean:.3f}" for row in rows), 1),
        _Figures("Penalty", tuple(f"{row.estimates['penalty'].mean:.1f}" for row in rows), 3),
        _Figures("Runs", tuple(_runs(row) for row in rows), 4),
    ]
    title = f"{escape(table.title)}\n[dim]{escape(table.task_id)}[/dim]"
    ranks = ["–" if row.rank is None else str(row.rank) for row in rows]
    marked = [row.privileged or row.unsandboxed for row in rows]
    proved = [
        (VERIFIED_MARK if mark else f" {VERIFIED_MARK}") if row.verified else ""
        for row, mark in zip(rows, marked, strict=True)
    ]
    names = [agent_label(row) + mark for row, mark in zip(rows, proved, strict=True)]
    styles = ["dim" if row.rank is None else None for row in rows]
    return _fitting(title, ranks, names, columns, styles, console)


def resource_table(table: TaskTable, console: Console) -> tuple[Table, tuple[str, ...]]:
    """What each agent grew and used, and the names of the columns that found no room."""
    wanted = [column for column in COLUMNS if not column.interval]
    columns = [
        _Figures(
            column.heading.replace(" ", "\n"),
            tuple(format_estimate(row.estimates[column.metric], column) for row in table.rows),
            place,
        )
        for place, column in enumerate(wanted)
    ]
    rows = table.rows
    columns += [
        _Figures("Decision\n[ms]", tuple(f"{row.decision_milliseconds:.3f}" for row in rows), len(wanted)),
        _Figures("Training\n[steps]", tuple(steps_text(row.training_steps) for row in rows), len(wanted) - 1),
    ]
    names = [agent_label(row) for row in table.rows]
    return _fitting("Harvest, resources, climate", None, names, columns, [None] * len(names), console)


def suite_score_table(table: SuiteTable, console: Console) -> tuple[Table, tuple[str, ...]]:
    """Agents over a suite: normalised scores, and the names of the columns that found no room."""
    rows = table.rows
    columns = [
        _Figures("Mean", tuple(score_text(row.aggregate.mean.value) for row in rows), 0),
        _Figures("95 % interval", tuple(_span(row.aggregate.mean) for row in rows), 3),
        _Figures("IQM", tuple(score_text(row.aggregate.iqm.value) for row in rows), 1),
        _Figures("of the IQM", tuple(_span(row.aggregate.iqm) for row in rows), 4),
        _Figures("Median", tuple(score_text(row.aggregate.median.value) for row in rows), 6),
        _Figures("Optimality\ngap", tuple(score_text(row.aggregate.optimality_gap.value) for row in rows), 2),
        _Figures("Runs", tuple(str(row.aggregate.runs) for row in rows), 5),
    ]
    title = (
        f"Suite {escape(table.suite)}, {len(table.tasks)} tasks: normalised scores\n"
        "[dim]0 is doing nothing, 1 the best known result of each task[/dim]"
    )
    ranks = ["–" if row.rank is None else str(row.rank) for row in rows]
    styles = ["dim" if row.rank is None else None for row in rows]
    return _fitting(title, ranks, [_suite_label(row) for row in rows], columns, styles, console)


def suite_resource_table(table: SuiteTable, console: Console) -> tuple[Table, tuple[str, ...]]:
    """What agents earned, grew and used: means over the tasks; and the names of the columns that found no room."""
    rows = [row for row in table.rows if row.figures is not None]
    figures = [row.figures for row in rows if row.figures is not None]
    wanted = [column for column in COLUMNS if column.metric != "reward"]
    columns = [
        _Figures(
            column.heading.replace(" ", "\n"),
            tuple(f"{one.metrics[column.metric]:.{column.decimals}f}" for one in figures),
            place,
        )
        for place, column in enumerate(wanted)
    ]
    columns += [
        _Figures("Decision\n[ms]", tuple(f"{one.decision_milliseconds:.3f}" for one in figures), len(wanted) + 1),
        _Figures("Training\n[steps]", tuple(steps_text(one.training_steps) for one in figures), len(wanted)),
    ]
    names = [_suite_label(row) for row in rows]
    styles = ["dim" if row.missing else None for row in rows]
    title = "Money, harvest, resources, climate: means over the tasks with results"
    return _fitting(title, None, names, columns, styles, console)


def _suite_label(row: SuiteRow) -> str:
    figures = row.figures
    if figures is None:
        return row.aggregate.agent
    marks = (PRIVILEGED_MARK if figures.privileged else "") + (
        UNSANDBOXED_MARK if figures.sandbox == "unsandboxed" else ""
    )
    marks += VERIFIED_MARK if figures.verified else ""
    return f"{row.aggregate.agent} {marks}" if marks else row.aggregate.agent


def _span(interval: Interval) -> str:
    low, high = score_text(interval.low), score_text(interval.high)
    return f"{low} to {high}" if low != high else "–"


def _interval(row: Row) -> str:
    reward = row.estimates["reward"]
    return f"{reward.low:.1f} to {reward.high:.1f}" if reward.low < reward.high else "–"


def _runs(row: Row) -> str:
    return str(row.runs) if row.failed == 0 else f"{row.runs - row.failed}/{row.runs}"


def _fitting(
    title: str,
    ranks: Sequence[str] | None,
    names: Sequence[str],
    columns: Sequence[_Figures],
    styles: Sequence[str | None],
    console: Console,
) -> tuple[Table, tuple[str, ...]]:
    """The table with as many columns as the console has room for, and the names of the others."""
    longest = max((cell_len(name) for name in names), default=0)
    kept = list(columns)
    while True:
        narrow = min(longest, _NARROW_AGENT if any(column.dispensable for column in kept) else _NARROWEST_AGENT)
        narrow = max(narrow, len("Agent"))
        unlimited = console.options.update(max_width=10_000)
        taken = Measurement.get(console, unlimited, _table(title, ranks, names, kept, styles, narrow)).minimum
        room = console.width - taken
        most = max(kept, key=lambda column: column.dispensable)
        if room >= 0 or most.dispensable == 0:
            break
        kept.remove(most)
    view = _table(title, ranks, names, kept, styles, min(max(longest, narrow), narrow + max(room, 0)))
    return view, tuple(column.name for column in columns if column not in kept)


def _table(
    title: str,
    ranks: Sequence[str] | None,
    names: Sequence[str],
    columns: Sequence[_Figures],
    styles: Sequence[str | None],
    agent_width: int,
) -> Table:
    view = Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    if ranks is not None:
        view.add_column("#", justify="right", no_wrap=True)
    view.add_column("Agent", overflow="fold", width=agent_width)
    for column in columns:
        # A column is as wide as its longest number: rich would cut it otherwise, when the terminal is narrow.
        width = max(cell_len(line) for text in (column.heading, *column.texts) for line in text.split("\n"))
        view.add_column(escape(column.heading), justify="right", no_wrap=True, min_width=width)
    for place, name in enumerate(names):
        head = [] if ranks is None else [ranks[place]]
        view.add_row(*head, escape(name), *(column.texts[place] for column in columns), style=styles[place])
    return view
