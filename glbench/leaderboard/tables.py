"""Leaderboards as files: Markdown for people, LaTeX for papers, CSV, Parquet and JSON for programs.

A table is a list of columns and a list of rows; the writers here and that of the terminal (``glbench.cli.leaderboard``) know nothing
else. The rows of tasks and those of suites hold the same facts about an agent, so they share their columns.
"""

from __future__ import annotations

import io
import json
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from glbench.agents.naming import without_seed
from glbench.errors import ResultError, did_you_mean, refuse
from glbench.leaderboard.catalogue import Catalogue, Metric, catalogue, of_published
from glbench.leaderboard.collect import short_board
from glbench.leaderboard.entries import resolution_of
from glbench.leaderboard.fresh_draws import fresh_note
from glbench.leaderboard.ranking import Row, TaskTable
from glbench.leaderboard.regret import PARTS, PENALTY, BestKnownMeans
from glbench.leaderboard.statistics import RESOLUTION, SCORES, Estimate, FrozenModel, Interval
from glbench.leaderboard.suites import RULES, SuiteRow, SuiteTable
from glbench.leaderboard.violations import FACTORS
from glbench.quantities import MONEY
from glbench.resources import write_atomically
from glbench.tasks import PAPER_TASK, get_task
from glbench.untrusted import visible

if TYPE_CHECKING:
    import pandas as pd

PRIVILEGED_MARK, UNSANDBOXED_MARK, REPRODUCED_MARK, RANGE_MARK, SEEN_MARK, FAILED_MARK = "†", "‡", "✓", "↔", "§", "✗"
DROP_MARK = "¶"
NONE = "–"
OVERALL_NOTE = (
    "Overall 95 %: interval of the mean over trainings and runs, for agents with several trainings. With two or three it is wide, because "
    "so few say little about others."
)
YEARS_NOTE = (
    "Columns of years: mean over the runs whose season has most of its days from that year. Intervals and ranks cover draws from these "
    "years only. Another year can differ as much as these do, or more."
)
AGAINST_NOTE = f" More than {RULES}: mean over the tasks of the score minus that of {RULES}, paired by run, with its 95 % interval."
SEEN_NOTE = f"{SEEN_MARK} its training saw what it is judged by, as its card states: the test split, or weather of the years of that split."
FAILED_NOTE = f"{FAILED_MARK} some runs failed: they count at the task's stated penalty."
FRESH_NOTE = (
    "Fresh draws: mean of a second evaluation with draws that did not exist when the agent was handed in. Seasons differ, so the two means "
    f"do, too. {DROP_MARK} it dropped by more than reference agents in the same seasons: it may know the published draws."
)
REGRET_NOTE = (
    "Regret: reward of the best known run with the same seed minus that of the run, mean over the runs that have one. Its parts are the "
    "profit that is given away and the violations that are added. Who made a best known run may have known the whole season in advance. "
    "It is no bound: a better one may exist, and who finds it has a negative regret."
)
REVERSAL_NOTE = "P(reversed): probability that the agent is truly better than the one above it: half the p-value of their paired test."
PRICES_NOTE = (
    "At 0.5×, at 2×: mean and, after #, rank at half and at double the price of violations. Agents act as they were made for the task's "
    "price. Frontier: no other agent that sees observations has as much profit with as few violations."
)
FOOTNOTES = (
    "Mean over the task's seeded runs, with the 95 % interval of the mean (Student's t); IQM is the mean of the middle half of the runs. "
    "{units} {name} is {profit}. Failed runs count at the task's stated penalty.",
    "CVaR10 is the mean of the worst tenth of the runs in what ranks; of several trainings the mean over them.",
    f"{RANGE_MARK} is a range, not an interval: the lowest and the highest of several trainings with different seeds, around their mean. "
    "A 95 % interval covers the {draws}, and one training; {beyond} or another training can lie far outside.",
    "Agents that cannot be told apart share a rank: paired t-tests of the difference of the means, over runs with the same seeds and over "
    "trainings, corrected for the number of pairs (Benjamini-Hochberg), at 5 %.",
    "Source: released with glbench; own, evaluated by you; trial, with other seeds than the task's, such as fewer runs, and not ranked.",
    f"{PRIVILEGED_MARK} privileged: sees more than the observations, or acts without the rate limit.",
    f"{UNSANDBOXED_MARK} unsandboxed: ran with all rights of the evaluation, so that nothing but its code tells what it used.",
    f"{REPRODUCED_MARK} reproduced: glbench verify simulated all runs again from the recorded actions and got the same numbers.",
    "Stated by the file, not checked: decision time (of one decision of one run), training (control steps; 0: not trained, –: not stated), "
    "what the training saw, sandbox.",
)
RESOLUTION_NOTE = (
    "Where a task draws nothing, all runs are alike and there is no interval. Closed loops amplify rounding there, so a reward that "
    f"differs by less than {RESOLUTION:g} counts as the same."
)
RESOLUTION_PLACE = 4  # Where it stands among the footnotes of tasks that have such a resolution
_UNITS = (("Reward and penalty have no unit.", False), ("A score in EUR/m² is the profit minus what violations of the limits cost.", True))
_PROFIT = "what is earned minus what is paid"


def footnotes(tables: Sequence[TaskTable]) -> list[str]:
    """What the figures of the tables mean."""
    tasks = [table.task for table in tables] or [None]
    meanings = {(task or get_task(PAPER_TASK)).ledger.meaning.rpartition(": ")[2] for task in tasks}
    profit = meanings.pop() if len(meanings) == 1 else ""
    priced = {one.units.get(PENALTY) == MONEY if one.task is None else bool(one.task.violation_prices) for one in tables} or {False}
    units = " ".join(words for words, is_priced in _UNITS if is_priced in priced)
    name = "Profit" if priced == {True} else "EPI"
    rows = [row for table in tables for row in table.rows]
    extra = [OVERALL_NOTE] * any(map(_has_overall, rows)) + [YEARS_NOTE] * any(row.by_year for row in rows)
    extra += [SEEN_NOTE] * any(row.saw_scored for row in rows)
    extra += [FAILED_NOTE] * any(row.failed for row in rows)
    extra += [FRESH_NOTE] * any(map(has_fresh_draws, tables))
    extra += [REGRET_NOTE] * any(map(has_regret, tables))
    extra += [PRICES_NOTE] * any(row.at_prices for row in rows) + [REVERSAL_NOTE] * any(row.reversal is not None for row in rows)
    profit = profit or (_PROFIT if name == "Profit" else f"the profit: {_PROFIT}")
    words = catalogue(*tasks)
    notes = [note.format(name=name, profit=profit, units=units, draws=words.draws, beyond=words.beyond) for note in FOOTNOTES]
    if any(resolution_of(table.metric, table.task, table.units) for table in tables) or not tables:
        notes.insert(RESOLUTION_PLACE, RESOLUTION_NOTE)
    return [*notes, *extra]


def has_regret(table: TaskTable) -> bool:
    """Whether one of its rows has a regret."""
    return any(row.regret is not None for row in table.rows)


def has_fresh_draws(table: TaskTable) -> bool:
    """Whether one of its results has fresh draws."""
    return any(row.fresh_draws is not None for row in table.results)


def _has_overall(row: Row) -> bool:
    return any(one.overall is not None for one in row.estimates.values())


SCORE_STEP = 0.01  # Narrower intervals of normalised scores are not shown: another season or training can move a score by more


def scale_words(table: SuiteTable) -> str:
    """What the scores of a suite are: what 0 and 1 mean, or why money is shown instead."""
    tasks = f"over the {len(table.tasks)} tasks" if len(table.tasks) > 1 else "on its only task"
    if not table.in_money:
        versions, zero = " and ".join(map(str, sorted(set(table.scale_versions.values())))), " or ".join(table.zero)
        return f"Normalised score {tasks}: 0 is the mean of {zero}, 1 the best known result of each task (scale version {versions})."
    without = ", ".join(task.rpartition("/")[2] for task in table.without_plans)
    lacking = f" {RULES} lacks tasks, so none is compared with it." * (not any(row.against_rules for row in table.shown_rows))
    return f"Mean score in money {tasks}, not normalised: for {without} no plans are known, so 1 would be some agent's own score.{lacking}"


def suite_note(table: SuiteTable) -> str:
    """What the intervals and the columns of a suite are."""
    words = of_published(table.tasks)
    money = f"Intervals cover the {words.draws}, and trainings, if there are several; they say nothing about {words.beyond}."
    columns = AGAINST_NOTE * any(row.against_rules for row in table.rows) + f" {REVERSAL_NOTE}"
    return (money if table.in_money else score_note(table.tasks)) + columns + f" {PRICES_NOTE}" * any(row.at_prices for row in table.rows)


def score_note(task_ids: Iterable[str]) -> str:
    """What the intervals of normalised scores over these tasks are."""
    words = of_published(task_ids)
    return (
        f"Intervals cover the {words.draws}, and one training; if an agent has several trainings, the interval of its mean covers "
        f"trainings, too. Intervals narrower than {SCORE_STEP} are left out, because {words.beyond} or another training can move a score "
        f"by more. {RANGE_MARK}: range from the lowest to the highest training of each task."
    )


# Text of result files is chosen by whoever makes them, so it is never trusted.

_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#", "%": r"\%", "_": r"\_",
        "^": r"\textasciicircum{}", "~": r"\textasciitilde{}", "<": r"\textless{}", ">": r"\textgreater{}",
        "²": "$^2$", "–": "--", "↔": r"$\leftrightarrow$", "×": r"$\times$", "†": r"\dag", "§": r"\S", "¶": r"\P",
    }
)  # fmt: skip
_MARKDOWN = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "|": r"\|", "`": r"\`", "[": r"\[", "]": r"\]", "*": r"\*", "\\": r"\\"})
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def markdown_text(text: str) -> str:
    """``text`` as Markdown shows it, also in the cell of a table: no HTML, no links, no new columns."""
    return visible(text).translate(_MARKDOWN)


def latex_text(text: str) -> str:
    """``text`` with LaTeX's special characters escaped."""
    return visible(text).translate(_LATEX)


def number_text(value: float | None, decimals: int) -> str:
    """``value`` with so many decimals; what no greenhouse makes in powers of ten, so that it does not fill the screen; or a dash.

    What rounds to zero has no sign.
    """
    if value is None:
        return NONE
    return f"{value:z.{decimals}f}" if abs(value) < 1e9 else f"{value:.3e}"


@dataclass(frozen=True)
class TableColumn:
    """A column: heading with unit, and the text of a row in it.

    ``words`` stand on the left; ``free`` text is somebody's own and escaped; a ``number`` is one and nothing else. On a narrow terminal
    columns that give way are left out, the highest first (0: never).
    """

    heading: str
    cell: Callable[[Any], str]
    words: bool = False
    free: bool = False
    number: bool = False
    gives_way: int = 0


def of_numbers(heading: str, value: Callable[[Any], float | None], digits: int, gives_way: int = 0) -> TableColumn:
    """What ``value`` is of each row, with so many decimals."""
    return TableColumn(heading, lambda row: number_text(value(row), digits), number=True, gives_way=gives_way)


def of_metric(metric: Metric, gives_way: int = 0) -> TableColumn:
    """The mean of a metric."""
    return of_numbers(metric.headed, lambda row: row.means.get(metric.name), metric.digits, gives_way)


def with_interval(metric: Metric) -> TableColumn:
    """The mean of a metric with its interval or range, where it has one."""
    if not metric.interval:
        return of_metric(metric)

    def text(row: Row) -> str:
        estimate = row.estimates.get(metric.name)
        return NONE if estimate is None else format_estimate(estimate, metric.digits, is_range=row.is_range)

    return TableColumn(metric.headed, text)


DECISION = of_numbers("Decision [ms]", lambda row: row.decision_milliseconds, 3)
TRAINING = TableColumn("Training [steps]", lambda row: steps_text(row.training_steps))
SOURCE = TableColumn("Source", lambda row: str(row.origin), words=True)
_SANDBOXED = {"bubblewrap": "yes", "unsandboxed": "no", "built-in": "part of glbench"}
WORDS = (
    SOURCE,
    TableColumn("Sees", lambda row: sees_word(privileged=row.privileged, information=row.information), words=True),
    TableColumn("Sandboxed", lambda row: _SANDBOXED.get(row.sandbox or "", NONE), words=True),
)
_CHECKED = TableColumn("Reproduced", lambda row: REPRODUCED_MARK if row.reproduced else NONE, words=True)
_CHECKED_IN_WORDS = TableColumn("Reproduced", lambda row: "yes" if row.reproduced else "no", words=True)


def ranked_columns(table: TaskTable) -> list[Metric]:
    """The metrics that are columns, that which ranks first."""
    columns, ranks = table.words.columns, table.words.metrics[table.metric]
    if not ranks.column:
        ranks = replace(ranks, heading=ranks.label, digits=ranks.decimals)
    return [ranks, *(metric for metric in columns if metric.name != table.metric)]


def _task_columns(table: TaskTable) -> list[TableColumn]:
    first, *others = ranked_columns(table)
    return [
        TableColumn("#", lambda row: NONE if row.rank is None else "" if row.training_seed is not None else str(row.rank)),
        TableColumn("Agent", agent_label, words=True, free=True),
        *map(with_interval, (first, *others)),
        iqm_column(first, f"{first.heading}, IQM"),
        *([fresh_column(first)] if has_fresh_draws(table) else []),
        worst_column(first),
        *([reversal_column()] if any(row.reversal is not None for row in table.rows) else []),
        *price_columns(table.rows),
        *year_columns(table.rows, first),
        *(regret_columns(table) if has_regret(table) else []),
        *([overall_column(first)] if any(map(_has_overall, table.rows)) else []),
        *([deviation_column(first)] if any(row.is_range for row in table.rows) else []),
        DECISION,
        TRAINING,
        *([TRAINED_ON] if table.split is not None else []),
        TableColumn("Runs", lambda row: f"{runs_label(row)}; {row.remark}" if row.remark else runs_label(row)),
        *WORDS,
        _CHECKED,
    ]


def fresh_column(metric: Metric) -> TableColumn:
    """Mean of the ranking metric with fresh draws."""
    return of_numbers("Fresh draws", lambda row: row.fresh_draws and row.fresh_draws.mean, metric.digits)


def worst_column(metric: Metric, gives_way: int = 0) -> TableColumn:
    """The worst tenth of the runs in what ranks."""
    return of_numbers("CVaR10", lambda row: row.worst_tenth and row.worst_tenth.value, metric.digits, gives_way)


def regret_columns(table: TaskTable, gives_way: tuple[int, int, int] = (0, 0, 0), *, spans: bool = True) -> list[TableColumn]:
    """Regret and its parts, profit and violations; with their intervals or ranges unless told otherwise."""
    words = table.words
    metrics = (words.score, words.profit, words.of_kind("penalty")[0])

    def column(part: str, metric: Metric, gives_way: int) -> TableColumn:
        def text(row: Row) -> str:
            estimate: Estimate | None = None if row.regret is None else getattr(row.regret, part)
            if estimate is None:
                return NONE
            if not spans:
                return number_text(estimate.mean, metric.digits)
            return format_estimate(estimate, metric.digits, is_range=row.is_range)

        name = "Regret" if part == "total" else f"Regret, {part}"
        return TableColumn(replace(metric, heading=name).headed, text, number=not spans, gives_way=gives_way)

    return [column(part, metric, way) for part, metric, way in zip(PARTS, metrics, gives_way, strict=True)]


def overall_column(metric: Metric, gives_way: int = 0) -> TableColumn:
    """The interval over trainings and runs."""

    def text(row: Row) -> str:
        estimate = row.estimates.get(metric.name)
        if estimate is None or estimate.overall is None:
            return NONE
        return " to ".join(number_text(end, metric.digits) for end in (estimate.overall.low, estimate.overall.high))

    return TableColumn("Overall 95 %", text, gives_way=gives_way)


def year_columns(rows: Iterable[Row], metric: Metric, gives_way: int = 0) -> list[TableColumn]:
    """Columns with the mean of the ranking metric by weather year; none if no row has several years."""

    def column(year: int) -> TableColumn:
        return of_numbers(f"{year}", lambda row: {one.year: one.mean for one in row.by_year}.get(year), metric.digits, gives_way)

    return [column(year) for year in sorted({one.year for row in rows for one in row.by_year})]


def deviation_column(metric: Metric, gives_way: int = 0) -> TableColumn:
    """How far trainings of one recipe spread."""
    return of_numbers("SD of trainings", lambda row: getattr(row.estimates.get(metric.name), "deviation", None), metric.digits, gives_way)


TRAINED_ON = TableColumn("Trained on", lambda row: visible(row.trained_on.words), words=True, free=True)


def iqm_column(metric: Metric, heading: str, gives_way: int = 0) -> TableColumn:
    """The interquartile mean of a metric."""
    return of_numbers(heading, lambda row: getattr(row.estimates.get(metric.name), "iqm", None), metric.digits, gives_way)


def _score_columns(table: SuiteTable) -> list[TableColumn]:
    def score(name: str) -> TableColumn:
        heading = "IQM" if name == "iqm" else name.replace("_", " ").capitalize()
        return TableColumn(heading, lambda row: format_interval(getattr(row, name), is_range=name != "mean" and row.trainings[1] > 1))

    return [
        TableColumn("#", lambda row: NONE if row.rank is None else str(row.rank)),
        TableColumn("Agent", suite_label, words=True, free=True),
        *([] if table.in_money else map(score, SCORES)),
        *money_columns(table),
        reversal_column(),
        *price_columns(table.rows),
        TableColumn("Runs", runs_of),
    ]


def reversal_column(gives_way: int = 0) -> TableColumn:
    """The probability that the order of neighbours reverses."""
    chance = "P(reversed)"
    return TableColumn(chance, lambda row: NONE if row.reversal is None else chance_text(row.reversal), free=True, gives_way=gives_way)


def price_columns(rows: Iterable[Row | SuiteRow], gives_way: int = 0) -> list[TableColumn]:
    """Mean and rank at half and double the price of violations, and who is on the frontier; none where violations have no such price."""
    if not any(row.at_prices for row in rows):
        return []

    def at(factor: float) -> TableColumn:
        def text(row: Row | SuiteRow) -> str:
            return next((f"{number_text(one.mean, 2)} #{one.rank}" for one in row.at_prices if one.factor == factor), NONE)

        return TableColumn(f"At {factor:g}× [EUR/m²]", text, gives_way=gives_way)

    frontier = TableColumn("Frontier", lambda row: "yes" if row.frontier else NONE, gives_way=gives_way and gives_way + 1)
    return [*(at(factor) for factor in FACTORS if factor != 1.0), frontier]


def turn_notes(table: TaskTable | SuiteTable, most: int | None = None) -> list[str]:
    """A sentence on the orders that hang on the price of violations; none where there are no such orders."""
    turns = [f"that of {turn.first} and {turn.second} at {turn.factor:.2g} times" for turn in table.turns[:most]]
    rest = f" (and {len(table.turns) - len(turns)} more)" * (len(table.turns) > len(turns))
    return [f"Orders that hang on the price of violations, and where they turn: {', '.join(turns)} the price{rest}."] if turns else []


def money_columns(table: SuiteTable, gives_way: tuple[int, int] = (0, 0), *, spans: bool = True) -> list[TableColumn]:
    """Columns of a suite whose tasks all score money: the mean, if it is shown in money, difference to the tuned rules, and regret."""

    def column(name: str, heading: str, gives_way: int) -> TableColumn:
        def text(row: SuiteRow) -> str:
            interval: Interval | None = getattr(row, name)
            if interval is None:
                return NONE
            center, low, high = (number_text(part, 3) for part in (interval.value, interval.low, interval.high))
            return f"{center} [{low}, {high}]" if spans and interval.low < interval.high else center

        return TableColumn(heading, text, gives_way=gives_way)

    columns = [("mean", "Mean [EUR/m²]", 0)] if table.in_money else []
    columns += [("against_rules", f"More than {RULES} [EUR/m²]", gives_way[0]), ("regret", "Regret [EUR/m²]", gives_way[1])]
    return [column(*one) for one in columns if any(getattr(row, one[0]) is not None for row in table.shown_rows)]


def of_figures(column: TableColumn) -> TableColumn:
    """The same column for the figures of a row of a suite."""
    return replace(column, cell=lambda row: column.cell(row.figures))


def resources(words: Catalogue, *, without_intervals: bool = False) -> list[Metric]:
    """Metrics that are columns besides the score; without those that are shown with intervals, too."""
    return [metric for metric in words.columns if not (metric.interval if without_intervals else metric.kind == "score")]


def markdown(columns: Sequence[TableColumn], rows: Iterable[Any]) -> list[str]:
    """A table in Markdown."""
    return [
        _line([column.heading for column in columns]),
        "|" + "|".join("---" if column.words else "---:" for column in columns) + "|",
        *(_line([markdown_text(column.cell(row)) if column.free else column.cell(row) for column in columns]) for row in rows),
    ]


def latex(columns: Sequence[TableColumn], rows: Iterable[Any]) -> list[str]:
    """A table in LaTeX, with booktabs."""

    def cell(column: TableColumn, row: Any) -> str:
        text = latex_text(column.cell(row))
        return f"${text}$" if column.number and text != "--" else text

    lines = [["" if column.heading == "#" else latex_text(column.heading) for column in columns]]
    lines += [[cell(column, row) for column in columns] for row in rows]
    head, *body = [" & ".join(line) + r" \\" for line in lines]
    places = "".join("l" if column.words else "r" for column in columns)
    return [rf"\begin{{tabular}}{{{places}}}", r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"]


def to_markdown(
    tables: Sequence[TaskTable], suites: Mapping[str, Sequence[str]], of_suites: Mapping[str, Sequence[str]] | None = None
) -> str:
    """The whole leaderboard: an overview of every suite that has results, then one table a task.

    ``of_suites`` holds lines by suite that follow its overview, see ``suite_markdown``.
    """
    parts = ["# Leaderboard", ""]
    for name, task_ids in suites.items():
        parts += _overview(name, [table for task_id in task_ids for table in tables if table.task_id == task_id])
        parts += (of_suites or {}).get(name, ())
    for table in tables:
        name = visible(table.task_id).replace("`", "")
        draws = f" ({table.draws})" if table.draws else ""
        parts += [f"## {markdown_text(table.title)}{draws}", "", f"`{name}`, digest `{table.digest[:12]}`", ""]
        parts += [*markdown(_task_columns(table), shown_rows(table, members=True)), ""]
        parts += [
            line
            for note in [*turn_notes(table), kernel_note(table), *card_notes(table), *fresh_notes(table), *regret_notes(table)]
            if note
            for line in (markdown_text(note), "")
        ]
    parts += [line for note in footnotes(tables) for line in (note, "")]
    return "\n".join(parts).rstrip() + "\n"


def _overview(suite: str, tables: Sequence[TaskTable]) -> list[str]:
    """Means of every agent over the tasks of a suite, side by side."""
    if len(tables) < 2:
        return []
    agents = sorted({row.agent for table in tables for row in table.rows if row.rank is not None})
    lines = [f"## Suite `{suite}` at a glance", ""]
    for metric in catalogue(*(table.task for table in tables)).headlines:

        def of_task(table: TaskTable, metric: Metric = metric) -> TableColumn:
            means = {row.agent: row.means.get(metric.name) for row in table.rows if row.rank is not None}
            heading = markdown_text(table.task_id.rpartition("/")[2])
            return TableColumn(heading, lambda name: number_text(means.get(name), metric.digits))

        agent = TableColumn(f"{metric.headed}, mean", str, words=True, free=True)
        lines += [*markdown([agent, *map(of_task, tables)], agents), ""]
    return lines


def shown_rows(table: TaskTable, *, members: bool) -> list[Row]:
    """The entries; with ``members`` each of several trainings below them."""
    return [row for entry in table.rows for row in (entry, *(entry.trainings if members and entry.is_range else ()))]


def suite_markdown(table: SuiteTable) -> list[str]:
    """Normalised scores, means of what was earned and used, and who improves on whom."""
    metrics = [of_metric(metric) for metric in resources(of_published(table.tasks))]
    figures = [
        TableColumn(
            "Agent",
            lambda row: suite_label(row) + (f" {PRIVILEGED_MARK}" if row.figures and row.figures.privileged else ""),
            words=True,
            free=True,
        ),
        *map(of_figures, (*metrics, DECISION, TRAINING, *WORDS, _CHECKED)),
    ]
    lines = [
        f"{scale_words(table)} Ranks go by the mean.",
        "",
        suite_note(table),
        "",
        *markdown(_score_columns(table), table.shown_rows),
        "",
        *(line for note in (*missing_notes(table), *turn_notes(table)) for line in (markdown_text(note), "")),
        "Means over the tasks:",
        "",
        *markdown(figures, [row for row in table.rows if row.figures is not None]),
        "",
    ]
    agents = [row.agent for row in table.rows if row.rank is not None]
    if len(agents) < 2:
        return lines
    chances = {(one.first, one.second): one.probability for one in table.improvements}

    def against(other: str) -> TableColumn:
        return TableColumn(other, lambda agent: NONE if agent == other else probability_text(chances[agent, other]))

    return [
        *lines,
        "Probability of improvement: that the agent of the row scores above the agent of the column in the same run.",
        "",
        *markdown([TableColumn("", str, words=True), *map(against, agents)], agents),
        "",
    ]


def missing_notes(table: SuiteTable) -> list[str]:
    """A sentence for each agent that lacks tasks of the suite."""
    lacking = [(row.agent, ", ".join(task.rpartition("/")[2] for task in row.missing)) for row in table.rows if row.missing]
    return [f"{agent} is not ranked: it lacks {tasks}. Its figures are over the tasks that it has." for agent, tasks in lacking]


def to_latex(table: TaskTable) -> str:
    """A task's tables for a paper (``booktabs``, units in the head): mean and 95 % interval or range, then what was grown and used."""
    columns = ranked_columns(table)
    scores = [
        TableColumn("#", lambda row: NONE if row.rank is None else str(row.rank)),
        TableColumn(
            "Agent",
            lambda row: (
                entry_label(row)
                + PRIVILEGED_MARK * row.privileged
                + SEEN_MARK * bool(row.saw_scored)
                + DROP_MARK * bool(row.fresh_draws is not None and row.fresh_draws.marked)
            ),
            words=True,
        ),
        *map(with_interval, columns[:3]),
        *([fresh_column(columns[0])] if has_fresh_draws(table) else []),
        worst_column(columns[0]),
        *(regret_columns(table)[:1] if has_regret(table) else []),
        TableColumn("Runs", runs_label),
    ]
    used = [TableColumn("Agent", entry_label, words=True), *map(of_metric, columns[3:]), DECISION, TRAINING, *WORDS, _CHECKED_IN_WORDS]
    draws = f" ({table.draws})" if table.draws else ""
    comment = f"% {visible(table.task_id)}{draws}, digest {table.digest[:12]}; needs \\usepackage{{booktabs}}"
    return "\n".join([comment, *latex(scores, table.rows), "", *latex(used, table.rows)]) + "\n"


def suite_latex(table: SuiteTable) -> str:
    """A suite's scores for a paper: ``booktabs``, estimates with 95 % intervals or ranges."""

    def agent(row: SuiteRow) -> str:
        return suite_label(row) + PRIVILEGED_MARK * bool(row.figures and row.figures.privileged)

    columns = [replace(one, cell=agent) if one.heading == "Agent" else one for one in _score_columns(table)]
    tasks = f"{'money' if table.in_money else 'normalised scores'} over {len(table.tasks)} tasks; needs \\usepackage{{booktabs}}"
    return "\n".join([f"% suite {visible(table.suite)}, {tasks}", *latex(columns, table.shown_rows), ""])


def to_frame(tables: Sequence[TaskTable]) -> pd.DataFrame:
    """One row a result: rank, provenance, and ``<metric>_mean``, ``_iqm``, ``_low``, ``_high`` with the unit in brackets.

    Where the unit of a metric differs between tasks, it stands in a column ``<metric>_unit`` instead.

    Trainings of one entry have the same ``entry``, whose mean over ``trainings`` and range over them stand in ``entry_<metric>_...``.
    """
    rows = [(table, entry, row) for table in tables for entry in table.rows for row in entry.results]
    metrics, fresh = _metrics(tables), any(map(has_fresh_draws, tables))
    return _frame([_record(table, entry, row, metrics, fresh=fresh) for table, entry, row in rows])


def _metrics(tables: Sequence[TaskTable]) -> list[Metric]:
    """Metrics of the tasks, and what else the rows hold; without a unit where it differs between tasks."""
    rows = [row for table in tables for row in table.results]
    units: dict[str, set[str]] = {}
    for name, unit in (item for row in rows for item in row.units.items()):
        units.setdefault(name, set()).add(unit)
    words = catalogue(*(table.task for table in tables))
    names = words.known_first(name for row in rows for name in row.estimates)
    return [replace(words.metric(name, {}), unit=_shared(units.get(name, {"-"}))) for name in names]


def _shared(units: Iterable[str]) -> str:
    """The unit that all have; empty where they differ."""
    one, *others = {*units}
    return "" if others else one


def _record(table: TaskTable, entry: Row, row: Row, metrics: Sequence[Metric], *, fresh: bool) -> dict[str, object]:
    record: dict[str, object] = {
        "task": row.task_id, "rank": row.rank, "agent": row.agent, "entry": entry.agent, "trainings": len(entry.results),
        "training_seed": row.training_seed, "origin": row.origin, "privileged": row.privileged, "unsandboxed": row.unsandboxed,
        "runs": row.runs, "failed_runs": row.failed, "reproduced": row.reproduced, "information": row.information,
        "decision [ms]": row.decision_milliseconds, "training [steps]": row.training_steps, "training [h]": row.training_hours,
        "trained_on": row.trained_on.words, "saw_scored": row.saw_scored, "split": table.split or "",
        "salt_commitment": table.salt_commitment or "", "sandbox": row.sandbox or "unknown", "remark": row.remark, "kernel": row.kernel,
        "kernel_build": row.build,
    }  # fmt: skip
    for metric in metrics:
        record |= _cells(metric.name, row.estimates.get(metric.name), ("mean", "iqm", "low", "high"), _bracketed(metric.unit))
        record |= {} if metric.unit else {f"{metric.name}_unit": row.units.get(metric.name)}
    ends = {"mean": "mean", "lowest": "low", "highest": "high"} if entry.is_range else dict.fromkeys(("mean", "lowest", "highest"), "mean")
    for metric in (one for one in metrics if one.column and one.interval):
        of_all, name, unit = entry.estimates.get(metric.name), f"entry_{metric.name}", _bracketed(metric.unit)
        record |= _cells(name, of_all, ends, unit) | _cells(name, of_all, ("deviation",), unit)
        record |= _cells(f"{name}_overall", of_all and of_all.overall, ("low", "high"), unit)
    record["by_year"] = "; ".join(f"{one.year}: {one.mean:.17g} ({one.runs} runs)" for one in row.by_year)
    record |= _cells("worst_tenth", row.worst_tenth, ("value", "low", "high"))
    record["regret_unit"] = row.regret and row.regret.unit  # it differs between tasks, but for the profit's
    for part in PARTS:
        name, unit = "regret" if part == "total" else f"regret_{part}", " [EUR m-2]" if part == "profit" else ""
        record |= _cells(name, row.regret and getattr(row.regret, part), ("mean", "low", "high"), unit)
    record |= _places(entry, "entry_")
    record["regret_runs"] = row.regret and row.regret.runs
    record["regret_runs_ahead"] = row.regret and row.regret.runs_ahead
    record |= _cells("entry_regret", entry.regret and entry.regret.total, ends)
    if fresh:
        record |= _cells("fresh_draws", row.fresh_draws, ("mean", "drop", "low", "margin", "reference", "failed", "marked"))
    return {**record, "task_digest": row.task_digest, "results_digest": row.results_digest}


def _bracketed(unit: str) -> str:
    return f" [{unit}]" if unit else ""


def _places(row: Row | SuiteRow, prefix: str = "") -> dict[str, object]:
    """Rank and mean at other prices of violations, the frontier and the reversal; ``None`` where there is none."""
    record: dict[str, object] = {f"{prefix}reversal": row.reversal, f"{prefix}frontier": row.frontier}
    for factor in (factor for factor in FACTORS if factor != 1.0):
        place, name = next((one for one in row.at_prices if one.factor == factor), None), f"{prefix}at_{factor:g}x"
        record |= {f"{name}_rank": place and place.rank, f"{name}_mean [EUR m-2]": place and place.mean}
    return record


def _cells(name: str, of: object, parts: Iterable[str] | Mapping[str, str], unit: str = "") -> dict[str, object]:
    """Parts of an estimate as ``<name>_<part>``, or under other names (name to part); ``None`` where there is none."""
    named = parts if isinstance(parts, Mapping) else {part: part for part in parts}
    return {f"{name}_{part}{unit}": getattr(of, attribute, None) for part, attribute in named.items()}


def suite_frame(tables: Sequence[SuiteTable]) -> pd.DataFrame:
    """One row an agent and suite: scores with intervals, and the mean over tasks of every metric with the unit in brackets.

    Where the unit of a metric differs between tasks, it stands in a column ``<metric>_unit`` instead, empty where it differs in the suite.
    """
    words = of_published(task for table in tables for task in table.tasks)
    units = [{name: _shared(of_tasks) for name, of_tasks in _units_of(table.tasks).items()} for table in tables]
    shared = {name: _shared(one[name] for one in units if name in one) for name in words.metrics}
    records = []
    for table, own_units, row in [(one, own, row) for one, own in zip(tables, units, strict=True) for row in one.rows]:
        figures = row.figures
        record: dict[str, object] = {
            "suite": table.suite, "rank": row.rank, "agent": row.agent, "tasks": row.tasks, "runs": row.runs,
            "missing_tasks": " ".join(row.missing),
            "fewest_trainings": row.trainings[0], "most_trainings": row.trainings[1],
            "low_and_high": "range over trainings" if row.trainings[1] > 1 else "95 % interval over runs",
            "low_and_high_of_mean": f"95 % interval over runs{' and trainings' if row.trainings[1] > 1 else ''}",
        }  # fmt: skip
        scores: list[tuple[str, Interval | None, str]] = [(str(name), getattr(row, name), "") for name in SCORES]
        money, unit = row.money, " [EUR m-2]"
        in_money = [("regret", row.regret, unit), (f"more_than_{RULES}", row.against_rules, unit)]
        if money is not None:
            in_money += [("money", money.mean, unit), (f"money_more_than_{RULES}", money.against_rules, unit)]
        for name, interval, unit in scores + in_money:
            record |= {f"{name}{unit}": interval and interval.value, **_cells(name, interval, ("low", "high"), unit)}
        record |= {"money_rank": money and money.rank, "money_reversal": money and money.reversal, **_places(row)}
        record |= {"zero": " ".join(table.zero), "without_plans": " ".join(table.without_plans)}
        for name, unit in shared.items():
            record[f"{name}_mean{_bracketed(unit)}"] = figures and figures.metrics.get(name)
            record |= {} if unit else {f"{name}_unit": own_units.get(name)}
        records.append(record | {
            "failed_runs": figures and figures.failed,
            "decision [ms]": figures and figures.decision_milliseconds,
            "training [steps]": figures and figures.training_steps,
            **{name: figures and getattr(figures, name) for name in ("privileged", "information", "sandbox", "reproduced", "origin")},
        })  # fmt: skip
    return _frame(records)


def _units_of(tasks: Iterable[str]) -> dict[str, set[str]]:
    """Units of every metric in some published tasks."""
    units: dict[str, set[str]] = {}
    for metric in (metric for task in tasks for metric in of_published([task]).metrics.values()):
        units.setdefault(metric.name, set()).add(metric.unit)
    return units


def _frame(records: Sequence[Mapping[str, object]]) -> pd.DataFrame:
    import pandas as pd

    frame = pd.DataFrame(records)
    whole = ["rank", "training_seed", "training [steps]", "regret_runs", "regret_runs_ahead", "money_rank"]
    whole += [f"{entry}at_{factor:g}x_rank" for entry in ("", "entry_") for factor in FACTORS]
    types = dict.fromkeys(whole, "Int64") | dict.fromkeys(("frontier", "entry_frontier"), "boolean") | {"training [h]": "Float64"}
    if "suite" in frame:
        types["failed_runs"] = "Int64"
    return frame.astype({name: kind for name, kind in types.items() if name in frame})


_NO_FRESH_DRAWS: Any = {"__all__": {"fresh_draws": True, "trainings": {"__all__": {"fresh_draws"}}}}
"""Of rows of ``leaderboard.json``: what is left out."""


class LeaderboardDocument(FrozenModel):
    """``leaderboard.json``."""

    schema_name: Literal["glbench/leaderboard"] = Field(default="glbench/leaderboard", alias="schema")
    schema_version: Literal[4] = 4
    units: dict[str, str] = Field(description="unit of every metric whose unit is the same in all tasks; '-' for none")
    tasks: tuple[TaskTable, ...]
    suites: tuple[SuiteTable, ...]


def to_json(tables: Sequence[TaskTable], suites: Sequence[SuiteTable] = ()) -> str:
    """The leaderboard as ``LeaderboardDocument``, indented, ending in a newline."""
    units = {metric.name: metric.unit for metric in _metrics(tables) if metric.unit}
    document = LeaderboardDocument(units=units, tasks=tuple(tables), suites=tuple(suites))
    # Without fresh draws, files stay as in earlier versions.
    absent = None if any(map(has_fresh_draws, tables)) else {"tasks": {"__all__": {"rows": _NO_FRESH_DRAWS}}}
    return document.model_dump_json(by_alias=True, indent=1, exclude=absent) + "\n"


def json_schema() -> str:
    """JSON Schema of ``leaderboard.json``, as published in ``docs/schema/leaderboard.schema.json``."""
    schema: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **LeaderboardDocument.model_json_schema(by_alias=True, mode="serialization"),
    }
    text = json.dumps(schema)
    for name, published in {"Bounds": "Ends", "TrainingData": "Seen"}.items():
        text = text.replace(f'"{name}"', f'"{published}"').replace(f"#/$defs/{name}", f"#/$defs/{published}")
    schema = json.loads(text)
    schema["$defs"] = dict(sorted(schema["$defs"].items()))
    return json.dumps(schema, indent=1) + "\n"


def write_leaderboard(
    tables: Sequence[TaskTable], suites: Mapping[str, Sequence[str]], out: Path, aggregated: Sequence[SuiteTable] = ()
) -> tuple[Path, ...]:
    """Write ``leaderboard.md``, ``.csv``, ``.parquet``, ``.json`` and ``.tex`` into ``out``, each whole or not at all; the paths.

    ``suites`` are task ids by suite, for the overviews. With normalised scores over suites (``aggregated``), ``leaderboard.suites.csv`` and
    ``.parquet`` hold one row an entry and suite. Raises ``GlbenchError`` when the folder cannot be written.
    """
    contents: dict[str, bytes | str] = {
        "leaderboard.md": to_markdown(tables, suites, {table.suite: suite_markdown(table) for table in aggregated}),
        "leaderboard.json": to_json(tables, aggregated),
        "leaderboard.tex": "\n".join([*map(to_latex, tables), *map(suite_latex, aggregated)]),
        **_of_frame("leaderboard", to_frame(tables)),
        **(_of_frame("leaderboard.suites", suite_frame(aggregated)) if aggregated else {}),
    }
    for name, content in contents.items():
        write_atomically(out / name, content)
    return tuple(out / name for name in contents)


def _of_frame(name: str, frame: pd.DataFrame) -> dict[str, bytes | str]:
    """The frame as CSV, no cell of which a spreadsheet takes for a formula, and as Parquet."""
    parquet = io.BytesIO()
    frame.to_parquet(parquet, index=False)
    harmless = partial(re.sub, f"^(?=[{re.escape(''.join(_FORMULA))}])", "'")
    cells = frame.rename(columns=harmless).map(lambda cell: harmless(cell) if isinstance(cell, str) else cell)
    return {f"{name}.csv": cells.to_csv(index=False, lineterminator="\n"), f"{name}.parquet": parquet.getvalue()}


def format_estimate(estimate: Estimate, decimals: int, *, is_range: bool = False) -> str:
    """``-4.716 [-4.720, -4.712]``, of trainings ``-4.716 (-4.9 ↔ -4.5)``; runs that are all alike have no interval."""
    text, low, high = (number_text(value, decimals) for value in (estimate.mean, estimate.low, estimate.high))
    if not estimate.low < estimate.high:
        return text
    return f"{text} ({low} {RANGE_MARK} {high})" if is_range else f"{text} [{low}, {high}]"


def kernel_note(table: TaskTable) -> str:
    """Which kernels stepped the rows, where they differ; empty when all had the same."""
    kernels = table.kernels
    if len(kernels) < 2:
        return ""
    labels = {label for label, _ in kernels}
    # The library's digest tells most builds apart; where it does not, the digest of all settings is shown, too.
    short = {build.partition(".")[0] for _, build in kernels}
    words = []
    for (label, build), agents in kernels.items():
        name = build.partition(".")[0] if len(short) == len(kernels) else build
        words.append(f"{f'{label} ' if len(labels) > 1 else ''}{name} ({', '.join(agents)})")
    count = {2: "Two", 3: "Three", 4: "Four"}.get(len(kernels), str(len(kernels)))
    return visible(
        f"{count} kernel builds: {', '.join(words)}. They agree closely in a step, but a closed loop can amplify the difference: "
        "do not read much into small gaps between such rows."
    )


def card_notes(table: TaskTable) -> list[str]:
    """Sentences that name agents trained on the test split or its years, trainings with names of their own, and late results of a round."""
    notes = [f"{SEEN_MARK} {row.agent} {row.saw_scored}, as its card states." for row in table.rows if row.saw_scored]
    for row in table.rows:
        names = [one.agent for one in row.results]
        if len({without_seed(name) for name in names}) > 1:
            together = f"{', '.join(names[:-1])} and {names[-1]}"
            notes.append(
                f"{row.agent} is {together}: their cards state the same recipe and authors. Anyone can type those; ask whether they are "
                "of one author."
            )
    return [*notes, *table.late]


def fresh_notes(table: TaskTable) -> list[str]:
    """Sentences that name marked agents, with their drop with fresh draws."""
    first = ranked_columns(table)[0]
    return [
        f"{DROP_MARK} {fresh_note(row.agent, row.fresh_draws, first)}"
        for row in table.rows
        if row.fresh_draws is not None and row.fresh_draws.marked
    ]


def regret_notes(table: TaskTable) -> list[str]:
    """Which runs regrets cover, which agents beat best known runs, and how to hand those runs in.

    Of released results the best known ones are taken.
    """
    better = [
        better_note(row.agent, row.regret.runs_ahead, row.regret.runs, row.path)
        for row in table.results
        if row.origin != "released" and row.plan_counts and row.regret is not None and row.regret.runs_ahead
    ]
    partial = any(row.regret is not None and row.regret.runs < row.runs for row in table.results)
    return [*([regrets_of_first(table.best_known)] if partial and table.best_known is not None else []), *better]


def regrets_of_first(best: BestKnownMeans) -> str:
    """Which runs regrets cover on a task that has plans for its first runs only."""
    return f"Regrets are means over the first {best.runs} runs of the task; no plans are known for the others."


def better_note(agent: str, ahead: int, runs: int, path: str) -> str:
    """What to do with a result that is above the best known run in some runs."""
    return (
        f"{agent} is above the best known run in {ahead} of the {runs} runs that have one: a better plan than the best known. "
        f"Hand it in: glbench bound --submit {shlex.quote(path)}"
    )


def entry_label(row: Row) -> str:
    """Name of the entry, with the number of its trainings, or the seed of a training among others."""
    if row.training_seed is not None:
        return f"· seed {row.training_seed}"
    count = len(row.trainings)
    return f"{visible(row.agent)} ({count} training{'s' if count > 1 else ''})" if count else visible(row.agent)


def agent_label(row: Row) -> str:
    """``entry_label`` with the marks of the privileged, the unsandboxed, those that saw scored runs, and those with failed runs."""
    marks = (PRIVILEGED_MARK if row.privileged else "") + (UNSANDBOXED_MARK if row.unsandboxed else "")
    marks += SEEN_MARK * bool(row.saw_scored) + FAILED_MARK * bool(row.failed)
    marks += DROP_MARK * bool(row.fresh_draws is not None and row.fresh_draws.marked)
    return f"{entry_label(row)} {marks}" if marks else entry_label(row)


def suite_label(row: SuiteRow) -> str:
    """Name of the entry, with the number of its trainings on a task."""
    fewest, most = row.trainings
    name = visible(row.agent)
    if most == 1:
        return name
    return f"{name} ({most} trainings)" if fewest == most else f"{name} ({fewest} to {most} trainings)"


def runs_label(row: Row) -> str:
    """Number of runs, and how many of them failed."""
    runs = f"{len(row.trainings)} × {row.trainings[0].runs}" if row.is_range else f"{row.runs}"
    return runs if row.failed == 0 else f"{runs} ({row.failed} failed)"


def runs_of(row: SuiteRow) -> str:
    """Number of runs, of failed ones and of missing tasks."""
    failed = f" ({row.figures.failed} failed)" if row.figures is not None and row.figures.failed else ""
    lacks = f", lacks {len(row.missing)} task{'s' if len(row.missing) != 1 else ''}" if row.missing else ""
    return f"{row.runs}{failed}{lacks}"


def steps_text(steps: int | None) -> str:
    """Steps of a training as people write them: ``2.02M``; 0: not trained; a dash: not stated."""
    if steps is None:
        return NONE
    if steps < 1_000:
        return str(steps)
    size, letter = (1_000, "k") if steps < 999_500 else (1_000_000, "M")
    return f"{float(f'{steps / size:.3g}'):,.15g}{letter}"


def sees_word(*, privileged: bool, information: str) -> str:
    """What an agent sees, in one word; ``information`` says it in full."""
    return "privileged" if privileged else "nothing" if information.startswith("nothing") else "observations"


def span_text(interval: Interval, *, is_range: bool) -> str:
    """``0.91 to 0.93``, of trainings ``0.910 ↔ 0.934``; empty where an interval is narrower than ``SCORE_STEP``."""
    low, high = interval.low, interval.high
    if is_range:
        return f"{score_text(low)} {RANGE_MARK} {score_text(high)}" if low < high else ""
    return "" if high - low < SCORE_STEP else f"{low:.2f} to {high:.2f}"


def format_interval(interval: Interval, *, is_range: bool) -> str:
    """``0.912 [0.91 to 0.93]`` or ``0.912``, without unit."""
    span = span_text(interval, is_range=is_range)
    return f"{score_text(interval.value)} [{span}]" if span else score_text(interval.value)


def score_text(value: float) -> str:
    """A normalised score with three decimals; what rounds to zero has no sign."""
    return f"{round(value, 3) + 0.0:.3f}"


def chance_text(value: float) -> str:
    """A probability with two decimals, never as certain as 0 or 1."""
    return ">0.99" if value > 0.99 else "<0.01" if value < 0.01 else f"{value:.2f}"


def probability_text(interval: Interval) -> str:
    """A probability, with its interval where that is wider than a hundredth."""
    low, high = chance_text(interval.low), chance_text(interval.high)
    return chance_text(interval.value) if low == high else f"{chance_text(interval.value)} [{low}, {high}]"


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


# Badges: one line of a leaderboard as a small picture, for the README of an agent.

_CHARACTER = 6.6  # px, about the mean width of a character at 11 px
_PADDING = 8
_HEIGHT = 20
_COLOURS = {True: "#2f7d4f", False: "#8a6d1f"}


def badge(table: TaskTable, agent: str) -> str:
    """SVG: task on the left; rank, reward, trainings, origin and whether it was reproduced on the right. Green when reproduced, else ochre.

    Raises ``ResultError`` when the agent has no row in the table.
    """
    row = next((one for one in table.rows if one.agent == agent), None)
    if row is None:
        agents = [visible(one.agent) for one in table.rows]
        near = did_you_mean(agent, agents, list_few=False)
        refuse(f"'{agent}' is not in the table of {table.task_id}.{near} It has: {', '.join(agents)}.", ResultError)
    ranked = sum(one.rank is not None for one in table.rows)
    rank = f"rank {row.rank} of {ranked}" if row.rank is not None else "not ranked"
    mean, metric = row.means.get(table.metric), table.words.metrics[table.metric]
    parts = [rank]
    if mean is not None:
        score = f"{metric.words} {mean:,.0f}" if abs(mean) < 1e9 else f"{metric.words} {number_text(mean, 0)}"
        parts.append(metric.phrase(mean) if metric.unit != "-" and abs(mean) < 1e9 else score)
    if row.is_range:
        parts.append(f"mean of {len(row.trainings)} trainings")
    if row.origin != "own":
        parts.append(row.origin)
    if row.reproduced:
        parts.append("reproduced")
    left, right = visible(short_board(table.task_id)), ", ".join(parts)
    first, second = (round(len(text) * _CHARACTER) + 2 * _PADDING for text in (left, right))
    title = f"{escape(left)}: {escape(right)}"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{first + second}" height="{_HEIGHT}" role="img" aria-label="{title}">'
        f"<title>{title}</title>"
        f'<clipPath id="r"><rect width="{first + second}" height="{_HEIGHT}" rx="3"/></clipPath>'
        f'<g clip-path="url(#r)"><rect width="{first}" height="{_HEIGHT}" fill="#3e4c59"/>'
        f'<rect x="{first}" width="{second}" height="{_HEIGHT}" fill="{_COLOURS[row.reproduced]}"/></g>'
        f'<g fill="#fff" text-anchor="middle" font-family="Verdana,DejaVu Sans,sans-serif" font-size="11">'
        f'<text x="{first / 2}" y="14" textLength="{first - 2 * _PADDING}">{escape(left)}</text>'
        f'<text x="{first + second / 2}" y="14" textLength="{second - 2 * _PADDING}">{escape(right)}</text></g></svg>\n'
    )
