"""Tables over suites: Markdown for people, a data frame for CSV and Parquet, LaTeX for papers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from glbench.evaluation.metrics import METRIC_NAMES, UNITS
from glbench.leaderboard.aggregates import Interval
from glbench.leaderboard.suites import SuiteRow, SuiteTable
from glbench.leaderboard.tables import COLUMNS, PRIVILEGED_MARK, VERIFIED_MARK, latex_text, sandbox_word, steps_text

if TYPE_CHECKING:
    import pandas as pd

SCORES = ("iqm", "mean", "median", "optimality_gap")
SCORE_HEADINGS = {"iqm": "IQM", "mean": "Mean", "median": "Median", "optimality_gap": "Optimality gap"}
RESOURCES = tuple(column for column in COLUMNS if column.metric != "reward")


def format_interval(interval: Interval) -> str:
    """``0.9120 [0.9101, 0.9140]``, without unit."""
    if score_text(interval.low) < score_text(interval.high):
        return f"{score_text(interval.value)} [{score_text(interval.low)}, {score_text(interval.high)}]"
    return score_text(interval.value)


def score_text(value: float) -> str:
    """A normalised score with four decimals; what rounds to zero has no sign."""
    return f"{round(value, 4) + 0.0:.4f}"


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
        *_head(heads),
        *(_line([_rank(row), row.aggregate.agent, *(format_interval(getattr(row.aggregate, name)) for name in SCORES), runs_of(row)])
          for row in table.rows),
        "",
        "Means over the tasks:",
        "",
        *_head(["Agent", *(column.heading for column in RESOURCES), "Decision [ms]", "Training [steps]", "Sees", "Sandboxed", "Verified"]),
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
                "verified": figures and figures.verified,
            }
            records.append(record)
    whole = {"rank": "Int64", "training [steps]": "Int64", "failed_runs": "Int64"}
    return pd.DataFrame(records).astype(whole) if records else pd.DataFrame()


def suite_latex(table: SuiteTable) -> str:
    """A suite's scores for a paper: ``booktabs``, estimates with 95 % intervals."""
    heads = " & ".join(["", "Agent", *SCORE_HEADINGS.values(), "Runs"])
    rows = []
    for row in table.rows:
        cells = [f"${format_interval(getattr(row.aggregate, name))}$" for name in SCORES]
        name = latex_text(row.aggregate.agent) + (r"\dag" if row.figures is not None and row.figures.privileged else "")
        rank = "--" if row.rank is None else str(row.rank)
        rows.append(" & ".join([rank, name, *cells, runs_of(row)]) + r" \\")
    return "\n".join([
        f"% suite {table.suite}, normalised scores over {len(table.tasks)} tasks; needs \\usepackage{{booktabs}}",
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
        *(_line([a, *("–" if a == b else _probability(known[a, b]) for b in agents)]) for a in agents),
        "",
    ]


def _probability(interval: Interval) -> str:
    text = f"{interval.value:.2f}"
    low, high = f"{interval.low:.2f}", f"{interval.high:.2f}"
    return text if low == high else f"{text} [{low}, {high}]"


def _figures(row: SuiteRow) -> list[str]:
    figures = row.figures
    if figures is None:
        return []
    return [
        row.aggregate.agent + (f" {PRIVILEGED_MARK}" if figures.privileged else ""),
        *(f"{figures.metrics[column.metric]:.{column.decimals}f}" for column in RESOURCES),
        f"{figures.decision_milliseconds:.3f}",
        steps_text(figures.training_steps),
        "privileged" if figures.privileged else "observations",
        sandbox_word(figures.sandbox),
        VERIFIED_MARK if figures.verified else "–",
    ]


def _rank(row: SuiteRow) -> str:
    return "–" if row.rank is None else str(row.rank)


def _head(heads: Sequence[str]) -> list[str]:
    words = {"", "Agent", "Sees", "Sandboxed"}
    return [_line(heads), "|" + "|".join("---" if head in words else "---:" for head in heads) + "|"]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"
