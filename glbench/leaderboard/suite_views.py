"""Tables over suites: Markdown for people, a data frame for CSV and Parquet, LaTeX for papers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from glbench.evaluation.metrics import METRIC_NAMES, UNITS
from glbench.leaderboard.aggregates import Interval
from glbench.leaderboard.escaping import latex_text, markdown_text, number_text
from glbench.leaderboard.suites import SuiteRow, SuiteTable
from glbench.leaderboard.tables import (
    COLUMNS,
    COVERS,
    PRIVILEGED_MARK,
    RANGE_MARK,
    REPRODUCED_MARK,
    WORD_HEADINGS,
    sandbox_word,
    sees_word,
    steps_text,
)
from glbench.untrusted import visible

if TYPE_CHECKING:
    import pandas as pd

SCORES = ("iqm", "mean", "median", "optimality_gap")
SCORE_HEADINGS = {"iqm": "IQM", "mean": "Mean", "median": "Median", "optimality_gap": "Optimality gap"}
RESOURCES = tuple(column for column in COLUMNS if column.metric != "reward")


SCORE_STEP = 0.01
"""Narrower intervals of normalised scores are not shown: another season or training can move a score by more."""
SCORE_NOTE = (
    f"Intervals cover the {COVERS}. Where they are narrower than {SCORE_STEP} they are left out: another season or another "
    f"training can move a score by more than that. {RANGE_MARK}: what the lowest and the highest training of each task make."
)


def span_text(interval: Interval, *, is_range: bool) -> str:
    """``0.91 to 0.93``, of trainings ``0.910 ↔ 0.934``; empty where an interval is narrower than ``SCORE_STEP``."""
    if is_range:
        return (
            f"{score_text(interval.low)} {RANGE_MARK} {score_text(interval.high)}"
            if interval.low < interval.high
            else ""
        )
    if interval.high - interval.low < SCORE_STEP:
        return ""
    return f"{interval.low:.2f} to {interval.high:.2f}"


def format_interval(interval: Interval, *, is_range: bool) -> str:
    """``0.912 [0.91 to 0.93]`` or ``0.912``, without unit."""
    span = span_text(interval, is_range=is_range)
    return f"{score_text(interval.value)} [{span}]" if span else score_text(interval.value)


def score_text(value: float) -> str:
    """A normalised score with three decimals; what rounds to zero has no sign."""
    return f"{round(value, 3) + 0.0:.3f}"


def suite_label(row: SuiteRow) -> str:
    """Name of the entry, with the number of its trainings on a task."""
    fewest, most = row.aggregate.trainings
    name = visible(row.aggregate.agent)
    if most == 1:
        return name
    return f"{name} ({most} trainings)" if fewest == most else f"{name} ({fewest} to {most} trainings)"


def chance_text(value: float) -> str:
    """A probability with two decimals, never as certain as 0 or 1."""
    return ">0.99" if value > 0.99 else "<0.01" if value < 0.01 else f"{value:.2f}"


def probability_text(interval: Interval) -> str:
    """A probability, with its interval where that is wider than a hundredth."""
    low, high = chance_text(interval.low), chance_text(interval.high)
    return chance_text(interval.value) if low == high else f"{chance_text(interval.value)} [{low}, {high}]"


def runs_of(row: SuiteRow) -> str:
    """Number of runs, of failed ones and of missing tasks."""
    failed = f" ({row.figures.failed} failed)" if row.figures is not None and row.figures.failed else ""
    lacks = f", lacks {len(row.missing)} task{'s' if len(row.missing) != 1 else ''}" if row.missing else ""
    return f"{row.aggregate.runs}{failed}{lacks}"


def suite_markdown(table: SuiteTable) -> list[str]:
    """Normalised scores, means of what was earned and used, and who improves on whom."""
    heads = ["#", "Agent", *SCORE_HEADINGS.values(), "Runs"]
    lines = [
        f"Normalised score over the {len(table.tasks)} tasks: 0 is doing nothing, 1 the best known result of each task. "
        "Ranks go by the mean.",
        "",
        SCORE_NOTE,
        "",
        *_head(heads),
        *(_line([_rank(row), markdown_text(suite_label(row)), *_scores(row), runs_of(row)])
          for row in table.rows),
        "",
        "Means over the tasks:",
        "",
        *_head(["Agent", *(column.heading for column in RESOURCES), "Decision [ms]", "Training [steps]", *WORD_HEADINGS]),
        *(_line(cells) for row in table.rows for cells in [_figures(row)] if cells),
        "",
    ]  # fmt: skip
    return lines + _improvement_lines(table)


def suite_frame(tables: Sequence[SuiteTable]) -> pd.DataFrame:
    """One row an agent and suite: scores with intervals, and the mean over tasks of every metric with the unit in brackets."""
    import pandas as pd

    records = []
    for table in tables:
        for row in table.rows:
            one, figures = row.aggregate, row.figures
            record: dict[str, object] = {
                "suite": table.suite, "rank": row.rank, "agent": one.agent, "tasks": one.tasks, "runs": one.runs,
                "missing_tasks": " ".join(row.missing),
                "fewest_trainings": one.trainings[0], "most_trainings": one.trainings[1],
                "low_and_high": "range over trainings" if one.trainings[1] > 1 else "95 % interval over runs",
            }  # fmt: skip
            for name in SCORES:
                interval = getattr(one, name)
                record |= {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}
            for name in METRIC_NAMES:
                record[f"{name}_mean [{UNITS[name]}]"] = None if figures is None else figures.metrics[name]
            record |= {
                "failed_runs": figures and figures.failed,
                "decision [ms]": figures and figures.decision_milliseconds,
                "training [steps]": figures and figures.training_steps,
                "privileged": figures and figures.privileged,
                "information": figures and figures.information,
                "sandbox": figures and figures.sandbox,
                "reproduced": figures and figures.reproduced,
                "origin": figures and figures.origin,
            }
            records.append(record)
    whole = {"rank": "Int64", "training [steps]": "Int64", "failed_runs": "Int64"}
    return pd.DataFrame(records).astype(whole) if records else pd.DataFrame()


def suite_latex(table: SuiteTable) -> str:
    """A suite's scores for a paper: ``booktabs``, estimates with 95 % intervals."""
    heads = " & ".join(["", "Agent", *SCORE_HEADINGS.values(), "Runs"])
    rows = []
    for row in table.rows:
        cells = [latex_text(text) for text in _scores(row)]
        name = latex_text(suite_label(row)) + (r"\dag" if row.figures is not None and row.figures.privileged else "")
        rank = "--" if row.rank is None else str(row.rank)
        rows.append(" & ".join([rank, name, *cells, runs_of(row)]) + r" \\")
    return "\n".join([
        f"% suite {visible(table.suite)}, normalised scores over {len(table.tasks)} tasks; needs \\usepackage{{booktabs}}",
        r"\begin{tabular}{rlrrrrr}", r"\toprule", heads + r" \\", r"\midrule", *rows, r"\bottomrule", r"\end{tabular}", "",
    ])  # fmt: skip


def _improvement_lines(table: SuiteTable) -> list[str]:
    agents = [row.aggregate.agent for row in table.rows if row.rank is not None]
    if len(agents) < 2:
        return []
    known = {(one.first, one.second): one.probability for one in table.improvements}
    return [
        "Probability of improvement: that a run of the agent of the row scores above a run of the agent of the column on the same task.",
        "",
        *_head(["", *agents]),
        *(_line([a, *("–" if a == b else probability_text(known[a, b]) for b in agents)]) for a in agents),
        "",
    ]


def _scores(row: SuiteRow) -> list[str]:
    return [format_interval(getattr(row.aggregate, name), is_range=row.aggregate.trainings[1] > 1) for name in SCORES]


def _figures(row: SuiteRow) -> list[str]:
    figures = row.figures
    if figures is None:
        return []
    return [
        markdown_text(suite_label(row)) + (f" {PRIVILEGED_MARK}" if figures.privileged else ""),
        *(number_text(figures.metrics[column.metric], column.decimals) for column in RESOURCES),
        number_text(figures.decision_milliseconds, 3),
        steps_text(figures.training_steps),
        figures.origin,
        sees_word(privileged=figures.privileged, information=figures.information),
        sandbox_word(figures.sandbox),
        REPRODUCED_MARK if figures.reproduced else "–",
    ]


def _rank(row: SuiteRow) -> str:
    return "–" if row.rank is None else str(row.rank)


def _head(heads: Sequence[str]) -> list[str]:
    words = {"", "Agent", *WORD_HEADINGS}
    return [_line(heads), "|" + "|".join("---" if head in words else "---:" for head in heads) + "|"]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
