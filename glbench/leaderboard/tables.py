"""Leaderboards as Markdown, and as one data frame for CSV and Parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from glbench.evaluation.metrics import METRICS, UNITS
from glbench.leaderboard.comparisons import RESOLUTION
from glbench.leaderboard.ranking import Estimate, Row, TaskTable

if TYPE_CHECKING:
    import pandas as pd

PRIVILEGED_MARK = "†"
UNSANDBOXED_MARK = "‡"
VERIFIED_MARK = "✓"
FOOTNOTES = (
    "Mean over the task's seeded runs, with the 95 % bootstrap interval of the mean; IQM is the mean of the middle half of the runs. "
    "Reward and penalty have no unit. EPI is revenue minus the costs of heat, electricity and CO2. "
    "Failed runs count at the task's stated penalty.",
    "Agents that cannot be told apart share a rank: paired Wilcoxon tests of the rewards on the same seeds, corrected for their "
    "number (Holm), at 5 %.",
    "Where a task draws nothing, all runs are alike and there is no interval. That does not make a figure sharp: closed loops "
    f"amplify rounding, so a reward that differs by less than {RESOLUTION:g} counts as the same there.",
    f"{PRIVILEGED_MARK} privileged: sees more than the observations, or acts without the rate limit.",
    f"{UNSANDBOXED_MARK} unsandboxed: ran with all rights of the evaluation, so that nothing but its code tells what it used.",
    "Decision: time of one decision of one run on the machine of the evaluation. Training: control steps, as the agent's makers say; "
    "0 when nothing was learnt, – when nobody says.",
    f"{VERIFIED_MARK} verified: `glbench verify` simulated every run again from its recorded actions and found what the result says.",
)


@dataclass(frozen=True)
class Column:
    """A metric column of the Markdown tables: heading with unit, number of decimals, with or without interval."""

    metric: str
    heading: str
    decimals: int
    interval: bool


COLUMNS = (
    Column("reward", "Reward", 1, interval=True),
    Column("epi", "EPI [EUR/m²]", 3, interval=True),
    Column("penalty", "Penalty", 1, interval=True),
    Column("yield", "Yield, fresh [kg/m²]", 2, interval=False),
    Column("heat", "Heat [kWh/m²]", 1, interval=False),
    Column("electricity", "Electricity [kWh/m²]", 1, interval=False),
    Column("co2", "CO2 [kg/m²]", 2, interval=False),
    Column("hours_outside_limits", "Outside limits [h]", 0, interval=False),
)


def format_estimate(estimate: Estimate, column: Column) -> str:
    """Text of one cell, ``-4.716 [-4.720, -4.712]`` or ``12.3``, in the column's unit; runs that are all alike have no interval."""
    text = f"{estimate.mean:.{column.decimals}f}"
    if column.interval and estimate.low < estimate.high:
        text += f" [{estimate.low:.{column.decimals}f}, {estimate.high:.{column.decimals}f}]"
    return text


def to_markdown(
    tables: Sequence[TaskTable],
    suites: Mapping[str, Sequence[str]],
    of_suites: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """The whole leaderboard: an overview of every suite that has results, then one table a task.

    ``of_suites`` holds lines by suite that follow its overview, see ``suite_views.suite_markdown``.
    """
    parts = ["# Leaderboard", ""]
    for name, task_ids in suites.items():
        parts += _overview(name, [table for task_id in task_ids for table in tables if table.task_id == task_id])
        parts += (of_suites or {}).get(name, ())
    for table in tables:
        parts += [
            f"## {table.title}",
            "",
            f"`{table.task_id}`, digest `{table.digest[:12]}`",
            "",
            *_task_rows(table),
            "",
            *(line for note in [kernel_note(table)] if note for line in (note, "")),
        ]
    parts += [line for note in FOOTNOTES for line in (note, "")]
    return "\n".join(parts).rstrip() + "\n"


def to_frame(tables: Sequence[TaskTable]) -> pd.DataFrame:
    """One row an agent and task: rank, provenance, and ``<metric>_mean``, ``_iqm``, ``_low``, ``_high`` with the unit in brackets."""
    import pandas as pd

    records = []
    for table in tables:
        for row in table.rows:
            record: dict[str, object] = {
                "task": row.task_id,
                "rank": row.rank,
                "agent": row.agent,
                "privileged": row.privileged,
                "unsandboxed": row.unsandboxed,
                "runs": row.runs,
                "failed_runs": row.failed,
                "verified": row.verified,
                "information": row.information,
                "decision [ms]": row.decision_milliseconds,
                "training [steps]": row.training_steps,
                "training [h]": row.training_hours,
                "sandbox": row.sandbox or "unknown",
                "remark": row.remark,
                "kernel": row.kernel,
            }
            for metric in METRICS:
                estimate = row.estimates[metric.name]
                for part in ("mean", "iqm", "low", "high"):
                    record[f"{metric.name}_{part} [{UNITS[metric.name]}]"] = getattr(estimate, part)
            records.append({**record, "task_digest": row.task_digest, "results_digest": row.results_digest})
    return (
        pd.DataFrame(records).astype({"rank": "Int64", "training [steps]": "Int64", "training [h]": "Float64"})
        if records
        else pd.DataFrame()
    )


def _overview(suite: str, tables: Sequence[TaskTable]) -> list[str]:
    """Mean reward, EPI and penalty of every agent over the tasks of a suite, side by side."""
    if len(tables) < 2:
        return []
    agents = sorted({row.agent for table in tables for row in table.rows if row.rank is not None})
    lines = [f"## Suite `{suite}` at a glance", ""]
    for column in COLUMNS[:3]:
        heads = [table.task_id.rpartition("/")[2] for table in tables]
        lines += [f"| {column.heading}, mean | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
        lines += [
            "| " + " | ".join([agent, *(_mean_of(agent, table, column) for table in tables)]) + " |" for agent in agents
        ]
        lines.append("")
    return lines


def _mean_of(agent: str, table: TaskTable, column: Column) -> str:
    for row in table.rows:
        if row.agent == agent and row.rank is not None:
            return f"{row.estimates[column.metric].mean:.{column.decimals}f}"
    return "–"


def _task_rows(table: TaskTable) -> list[str]:
    words = ["Sees", "Sandboxed", "Verified"]
    heads = [
        "#",
        "Agent",
        *(column.heading for column in COLUMNS),
        "Reward, IQM",
        "Decision [ms]",
        "Training [steps]",
        "Runs",
        *words,
    ]
    numbers = len(heads) - 2 - len(words)
    lines = ["| " + " | ".join(heads) + " |", "|---:|---|" + "---:|" * numbers + "---|" * len(words)]
    return lines + ["| " + " | ".join(_cells(row)) + " |" for row in table.rows]


def kernel_note(table: TaskTable) -> str:
    """Which rows were stepped by another kernel than most; empty when all had the same."""
    (usual, *_), others = table.kernels, list(table.kernels.items())[1:]
    if not others:
        return ""
    exceptions = "; ".join(f"{', '.join(agents)}: {kernel}" for kernel, agents in others)
    return (
        f"Not all of these were stepped by the same kernel ({exceptions}; the others: {usual}). Kernels agree closely in a step, but a "
        "closed loop can amplify the difference: do not read much into small gaps between such rows."
    )


def agent_label(row: Row) -> str:
    """Name of the agent, with the marks of the privileged and the unsandboxed."""
    marks = (PRIVILEGED_MARK if row.privileged else "") + (UNSANDBOXED_MARK if row.unsandboxed else "")
    return f"{row.agent} {marks}" if marks else row.agent


def runs_label(row: Row) -> str:
    """Number of runs, and how many of them failed."""
    return f"{row.runs}" if row.failed == 0 else f"{row.runs} ({row.failed} failed)"


def verified_label(row: Row) -> str:
    """A mark, or a dash where no proof of the result is there."""
    return VERIFIED_MARK if row.verified else "–"


def steps_text(steps: int | None) -> str:
    """Steps of a training as people write them: ``2.02M``; 0 when nothing was learnt, a dash when nobody says."""
    if steps is None:
        return "–"
    for size, letter in ((1_000_000, "M"), (1_000, "k")):
        if steps >= size:
            return f"{steps / size:.3g}{letter}"
    return str(steps)


def sandbox_word(sandbox: str | None) -> str:
    """How an agent was kept apart, in a word."""
    return {"bubblewrap": "yes", "unsandboxed": "no", "built-in": "part of glbench"}.get(sandbox or "", "–")


def latex_text(text: str) -> str:
    """Text with LaTeX's special characters escaped."""
    for plain, latex in (
        ("\\", r"\textbackslash "),
        ("_", r"\_"),
        ("%", r"\%"),
        ("&", r"\&"),
        ("#", r"\#"),
        ("²", "$^2$"),
        ("–", "--"),
    ):
        text = text.replace(plain, latex)
    return text


def _cells(row: Row) -> list[str]:
    """Texts of a row in the order of the headings."""
    return [
        "–" if row.rank is None else str(row.rank),
        agent_label(row),
        *(format_estimate(row.estimates[column.metric], column) for column in COLUMNS),
        f"{row.estimates['reward'].iqm:.1f}",
        f"{row.decision_milliseconds:.3f}",
        steps_text(row.training_steps),
        f"{runs_label(row)}; {row.remark}" if row.remark else runs_label(row),
        "privileged" if row.privileged else "observations",
        sandbox_word(row.sandbox),
        verified_label(row),
    ]
