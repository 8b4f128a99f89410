"""Leaderboards as Markdown, and as one data frame for CSV and Parquet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from glbench.evaluation.metrics import METRICS, UNITS
from glbench.leaderboard.comparisons import RESOLUTION
from glbench.leaderboard.escaping import markdown_text, number_text
from glbench.leaderboard.ranking import Estimate, Row, TaskTable
from glbench.untrusted import visible

if TYPE_CHECKING:
    import pandas as pd

PRIVILEGED_MARK = "†"
UNSANDBOXED_MARK = "‡"
REPRODUCED_MARK = "✓"
RANGE_MARK = "↔"
WORD_HEADINGS = ("Source", "Sees", "Sandboxed", "Reproduced")
COVERS = "draws of one season, and one training"
"""What a 95 % interval over runs is about."""
FOOTNOTES = (
    "Mean over the task's seeded runs, with the 95 % bootstrap interval of the mean; IQM is the mean of the middle half of the runs. "
    "Reward and penalty have no unit. EPI is revenue minus the costs of heat, electricity and CO2. "
    "Failed runs count at the task's stated penalty.",
    f"{RANGE_MARK} is no interval but a range: the lowest and the highest of several trainings with different seeds, around their mean. "
    f"A 95 % interval covers the {COVERS}; another season or another training can lie far outside.",
    "Agents that cannot be told apart share a rank: paired Wilcoxon tests on the same seeds (of several trainings the mean run by run), "
    "corrected for their number (Holm), at 5 %.",
    "Where a task draws nothing, all runs are alike and there is no interval. Closed loops amplify rounding there, so a reward that "
    f"differs by less than {RESOLUTION:g} counts as the same.",
    "Source: released with glbench; own, evaluated by you; trial, with other seeds than the task's, such as fewer runs, and not ranked.",
    f"{PRIVILEGED_MARK} privileged: sees more than the observations, or acts without the rate limit.",
    f"{UNSANDBOXED_MARK} unsandboxed: ran with all rights of the evaluation, so that nothing but its code tells what it used.",
    f"{REPRODUCED_MARK} reproduced: glbench verify simulated all runs again from the recorded actions and got the same numbers.",
    "Stated by the file, not checked: decision time (of one decision of one run), training (control steps; 0: not trained, –: not stated), "
    "sandbox.",
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
    Column("electricity", "Lamp electricity [kWh/m²]", 1, interval=False),
    Column("co2", "CO2 [kg/m²]", 2, interval=False),
    Column("hours_outside_limits", "Outside limits [h]", 0, interval=False),
)


def columns_of(table: TaskTable) -> tuple[Column, ...]:
    """``COLUMNS``, that of the metric that ranks first."""
    return tuple(sorted(COLUMNS, key=lambda column: column.metric != table.metric))


def format_estimate(estimate: Estimate, column: Column, *, is_range: bool = False) -> str:
    """Text of one cell in the column's unit: ``-4.716 [-4.720, -4.712]``, of trainings ``-4.716 (-4.9 ↔ -4.5)``, or ``12.3``.

    Runs that are all alike have no interval.
    """
    text, low, high = (number_text(value, column.decimals) for value in (estimate.mean, estimate.low, estimate.high))
    if not column.interval or not estimate.low < estimate.high:
        return text
    return f"{text} ({low} {RANGE_MARK} {high})" if is_range else f"{text} [{low}, {high}]"


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
            f"## {markdown_text(table.title)}",
            "",
            f"`{visible(table.task_id).replace('`', '')}`, digest `{table.digest[:12]}`",
            "",
            *_task_rows(table),
            "",
            *(line for note in [kernel_note(table)] if note for line in (markdown_text(note), "")),
        ]
    parts += [line for note in FOOTNOTES for line in (note, "")]
    return "\n".join(parts).rstrip() + "\n"


def sees_word(*, privileged: bool, information: str) -> str:
    """What an agent sees, in one word; ``information`` says it in full."""
    return "privileged" if privileged else "nothing" if information.startswith("nothing") else "observations"


def to_frame(tables: Sequence[TaskTable]) -> pd.DataFrame:
    """One row a result: rank, provenance, and ``<metric>_mean``, ``_iqm``, ``_low``, ``_high`` with the unit in brackets.

    Trainings of one entry have the same ``entry``, whose mean over ``trainings`` and range over them stand in ``entry_<metric>_...``.
    """
    import pandas as pd

    records = []
    for table in tables:
        for entry, row in [(one, result) for one in table.rows for result in one.results]:
            record: dict[str, object] = {
                "task": row.task_id,
                "rank": row.rank,
                "agent": row.agent,
                "entry": entry.agent,
                "trainings": len(entry.results),
                "training_seed": row.training_seed,
                "origin": row.origin,
                "privileged": row.privileged,
                "unsandboxed": row.unsandboxed,
                "runs": row.runs,
                "failed_runs": row.failed,
                "reproduced": row.reproduced,
                "information": row.information,
                "decision [ms]": row.decision_milliseconds,
                "training [steps]": row.training_steps,
                "training [h]": row.training_hours,
                "sandbox": row.sandbox or "unknown",
                "remark": row.remark,
                "kernel": row.kernel,
                "kernel_build": row.build,
            }
            for metric in METRICS:
                estimate = row.estimates[metric.name]
                for part in ("mean", "iqm", "low", "high"):
                    record[f"{metric.name}_{part} [{UNITS[metric.name]}]"] = getattr(estimate, part)
            for metric in (one for one in METRICS if one.name in _OF_ENTRIES):
                estimate = entry.estimates[metric.name]
                lowest, highest = (estimate.low, estimate.high) if entry.is_range else (estimate.mean, estimate.mean)
                for part, value in (("mean", estimate.mean), ("lowest", lowest), ("highest", highest)):
                    record[f"entry_{metric.name}_{part} [{UNITS[metric.name]}]"] = value
            records.append({**record, "task_digest": row.task_digest, "results_digest": row.results_digest})
    return (
        pd.DataFrame(records).astype(
            {"rank": "Int64", "training_seed": "Int64", "training [steps]": "Int64", "training [h]": "Float64"}
        )
        if records
        else pd.DataFrame()
    )


_OF_ENTRIES = ("reward", "epi", "penalty")


def _overview(suite: str, tables: Sequence[TaskTable]) -> list[str]:
    """Mean reward, EPI and penalty of every agent over the tasks of a suite, side by side."""
    if len(tables) < 2:
        return []
    agents = sorted({row.agent for table in tables for row in table.rows if row.rank is not None})
    lines = [f"## Suite `{suite}` at a glance", ""]
    for column in COLUMNS[:3]:
        heads = [markdown_text(table.task_id.rpartition("/")[2]) for table in tables]
        lines += [f"| {column.heading}, mean | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
        lines += [
            "| " + " | ".join([markdown_text(agent), *(_mean_of(agent, table, column) for table in tables)]) + " |"
            for agent in agents
        ]
        lines.append("")
    return lines


def _mean_of(agent: str, table: TaskTable, column: Column) -> str:
    for row in table.rows:
        if row.agent == agent and row.rank is not None:
            return number_text(row.estimates[column.metric].mean, column.decimals)
    return "–"


def _task_rows(table: TaskTable) -> list[str]:
    columns = columns_of(table)
    ranking = columns[0].heading.partition(" [")[0]
    figures = [*(column.heading for column in columns), f"{ranking}, IQM", "Decision [ms]", "Training [steps]", "Runs"]
    heads = ["#", "Agent", *figures, *WORD_HEADINGS]
    lines = ["| " + " | ".join(heads) + " |", "|---:|---|" + "---:|" * len(figures) + "---|" * len(WORD_HEADINGS)]
    cells = [
        _cells(row, columns)
        for entry in table.rows
        for row in (entry, *entry.trainings[: len(entry.trainings) * entry.is_range])
    ]
    return lines + ["| " + " | ".join(one) + " |" for one in cells]


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


def entry_label(row: Row) -> str:
    """Name of the entry, with the number of its trainings, or the seed of a training among others."""
    if row.training_seed is not None:
        return f"· seed {row.training_seed}"
    count = len(row.trainings)
    return f"{visible(row.agent)} ({count} training{'s' if count > 1 else ''})" if count else visible(row.agent)


def agent_label(row: Row) -> str:
    """``entry_label`` with the marks of the privileged and the unsandboxed."""
    marks = (PRIVILEGED_MARK if row.privileged else "") + (UNSANDBOXED_MARK if row.unsandboxed else "")
    return f"{entry_label(row)} {marks}" if marks else entry_label(row)


def runs_label(row: Row) -> str:
    """Number of runs, and how many of them failed."""
    runs = f"{len(row.trainings)} × {row.trainings[0].runs}" if row.is_range else f"{row.runs}"
    return runs if row.failed == 0 else f"{runs} ({row.failed} failed)"


def reproduced_label(row: Row) -> str:
    """A mark, or a dash where no note of `glbench verify` is there."""
    return REPRODUCED_MARK if row.reproduced else "–"


def steps_text(steps: int | None) -> str:
    """Steps of a training as people write them: ``2.02M``; 0: not trained; a dash: not stated."""
    if steps is None:
        return "–"
    for size, letter in ((1_000_000, "M"), (1_000, "k")):
        if steps >= size:
            return f"{steps / size:.3g}{letter}"
    return str(steps)


def sandbox_word(sandbox: str | None) -> str:
    """How an agent was kept apart, in a word."""
    return {"bubblewrap": "yes", "unsandboxed": "no", "built-in": "part of glbench"}.get(sandbox or "", "–")


def _cells(row: Row, columns: Sequence[Column]) -> list[str]:
    """Texts of a row in the order of the headings."""
    return [
        "–" if row.rank is None else "" if row.training_seed is not None else str(row.rank),
        markdown_text(agent_label(row)),
        *(format_estimate(row.estimates[column.metric], column, is_range=row.is_range) for column in columns),
        number_text(row.estimates[columns[0].metric].iqm, columns[0].decimals),
        number_text(row.decision_milliseconds, 3),
        steps_text(row.training_steps),
        f"{runs_label(row)}; {row.remark}" if row.remark else runs_label(row),
        row.origin,
        sees_word(privileged=row.privileged, information=row.information),
        sandbox_word(row.sandbox),
        reproduced_label(row),
    ]
