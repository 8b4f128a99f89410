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

from glbench.leaderboard.escaping import number_text
from glbench.leaderboard.suite_views import score_text, span_text, suite_label
from glbench.leaderboard.tables import (
    COLUMNS,
    PRIVILEGED_MARK,
    RANGE_MARK,
    REPRODUCED_MARK,
    UNSANDBOXED_MARK,
    agent_label,
    columns_of,
    format_estimate,
    steps_text,
)
from glbench.untrusted import visible

if TYPE_CHECKING:
    from rich.console import Console

    from glbench.leaderboard import Row, TaskTable
    from glbench.leaderboard.suites import SuiteRow, SuiteTable
    from glbench.leaderboard.tables import Column

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


def score_table(table: TaskTable, console: Console, *, members: bool = False) -> tuple[Table, tuple[str, ...]]:
    """Ranks and what they rest on, and the names of the columns that found no room. ``members`` shows each training below its entry."""
    rows = _shown(table, members=members)
    first, *others = (column for column in columns_of(table) if column.interval)
    ranking = [row.estimates[first.metric] for row in rows]
    columns = [
        _Figures(
            first.heading.replace(" [", "\n["), tuple(number_text(one.mean, first.decimals) for one in ranking), 0
        ),
        _Figures("95 % interval\nor range ↔", tuple(_span_of_row(row, first) for row in rows), 2),
        _Figures("IQM", tuple(number_text(one.iqm, first.decimals) for one in ranking), 5),
        *(
            _Figures(
                column.heading.replace(" [", "\n["),
                tuple(number_text(row.estimates[column.metric].mean, column.decimals) for row in rows),
                place,
            )
            for column, place in zip(others, (1, 3), strict=True)
        ),
        _Figures("Runs", tuple(_runs(row) for row in rows), 4),
        _Figures("Source", tuple("" if row.training_seed is not None else row.origin for row in rows), 0),
    ]
    title = f"{escape(visible(table.title))}\n[dim]{escape(visible(table.task_id))}[/dim]"
    ranks = ["" if row.training_seed is not None else "–" if row.rank is None else str(row.rank) for row in rows]
    marked = [row.privileged or row.unsandboxed for row in rows]
    reproduced = [
        (REPRODUCED_MARK if mark else f" {REPRODUCED_MARK}") if row.reproduced else ""
        for row, mark in zip(rows, marked, strict=True)
    ]
    names = [agent_label(row) + mark for row, mark in zip(rows, reproduced, strict=True)]
    styles = ["dim" if row.rank is None or row.training_seed is not None else None for row in rows]
    return _fitting(title, ranks, names, columns, styles, console)


def resource_table(table: TaskTable, console: Console, *, members: bool = False) -> tuple[Table, tuple[str, ...]]:
    """What each agent grew and used, and the names of the columns that found no room."""
    rows = _shown(table, members=members)
    wanted = [column for column in COLUMNS if not column.interval]
    columns = [
        _Figures(
            column.heading.replace(" ", "\n"),
            tuple(format_estimate(row.estimates[column.metric], column) for row in rows),
            place,
        )
        for place, column in enumerate(wanted)
    ]
    columns += [
        _Figures("Decision\n[ms]", tuple(number_text(row.decision_milliseconds, 3) for row in rows), len(wanted)),
        _Figures("Training\n[steps]", tuple(steps_text(row.training_steps) for row in rows), len(wanted) - 1),
    ]
    names = [agent_label(row) for row in rows]
    styles = ["dim" if row.training_seed is not None else None for row in rows]
    return _fitting("Harvest, resources, climate", None, names, columns, styles, console)


def _shown(table: TaskTable, *, members: bool) -> list[Row]:
    """The entries; with ``members`` each of several trainings below them."""
    return [row for entry in table.rows for row in (entry, *(entry.trainings if members and entry.is_range else ()))]


def suite_score_table(table: SuiteTable, console: Console) -> tuple[Table, tuple[str, ...]]:
    """Agents over a suite: normalised scores, and the names of the columns that found no room."""
    rows = table.rows
    columns = [
        _Figures("Mean", tuple(score_text(row.aggregate.mean.value) for row in rows), 0),
        _Figures("95 % interval\nor range ↔", tuple(_span(row, "mean") for row in rows), 2),
        _Figures("IQM", tuple(score_text(row.aggregate.iqm.value) for row in rows), 1),
        _Figures("Median", tuple(score_text(row.aggregate.median.value) for row in rows), 5),
        _Figures("Optimality\ngap", tuple(score_text(row.aggregate.optimality_gap.value) for row in rows), 3),
        _Figures("Runs", tuple(str(row.aggregate.runs) for row in rows), 4),
        _Figures("Source", tuple("" if row.figures is None else row.figures.origin for row in rows), 0),
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
            tuple(number_text(one.metrics[column.metric], column.decimals) for one in figures),
            place,
        )
        for place, column in enumerate(wanted)
    ]
    columns += [
        _Figures(
            "Decision\n[ms]", tuple(number_text(one.decision_milliseconds, 3) for one in figures), len(wanted) + 1
        ),
        _Figures("Training\n[steps]", tuple(steps_text(one.training_steps) for one in figures), len(wanted)),
    ]
    names = [_suite_label(row) for row in rows]
    styles = ["dim" if row.missing else None for row in rows]
    title = "Money, harvest, resources, climate: means over the tasks with results"
    return _fitting(title, None, names, columns, styles, console)


def _suite_label(row: SuiteRow) -> str:
    figures = row.figures
    if figures is None:
        return suite_label(row)
    marks = (PRIVILEGED_MARK if figures.privileged else "") + (
        UNSANDBOXED_MARK if figures.sandbox == "unsandboxed" else ""
    )
    marks += REPRODUCED_MARK if figures.reproduced else ""
    return f"{suite_label(row)} {marks}" if marks else suite_label(row)


def _span(row: SuiteRow, score: str) -> str:
    return span_text(getattr(row.aggregate, score), is_range=row.aggregate.trainings[1] > 1) or "–"


def _span_of_row(row: Row, column: Column) -> str:
    one = row.estimates[column.metric]
    low, high = number_text(one.low, column.decimals), number_text(one.high, column.decimals)
    return f"{low} {RANGE_MARK if row.is_range else 'to'} {high}" if one.low < one.high else "–"


def _runs(row: Row) -> str:
    runs = f"{len(row.trainings)}×{row.trainings[0].runs}" if row.is_range else str(row.runs)
    return runs if row.failed == 0 else f"{row.runs - row.failed}/{row.runs}"


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
