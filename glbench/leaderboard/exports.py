"""The leaderboard for papers and programs: LaTeX, and JSON with a published schema."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from glbench.evaluation.metrics import UNITS
from glbench.leaderboard.ranking import Row, TaskTable
from glbench.leaderboard.suites import SuiteTable
from glbench.leaderboard.tables import COLUMNS


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class MetricEntry(_Frozen):
    """A metric of one agent on one task, over the task's runs, in the unit that ``units`` names."""

    mean: float = Field(description="arithmetic mean over the runs")
    iqm: float = Field(description="mean of the middle half of the runs")
    low: float = Field(description="lower end of the 95 % bootstrap interval of the mean")
    high: float = Field(description="upper end of it")


class RowEntry(_Frozen):
    """One agent on one task."""

    rank: int | None = Field(description="shared by agents that cannot be told apart; null when runs are missing")
    agent: str
    privileged: bool = Field(description="whether it sees more than observations or acts without the rate limit")
    information: str = Field(description="what it sees, in words")
    runs: int
    failed_runs: int
    verified: bool = Field(description="whether the result was proved from its record")
    decision_ms: float = Field(description="time of one decision for one run [ms]")
    remark: str
    results_digest: str
    metrics: dict[str, MetricEntry]


class TaskEntry(_Frozen):
    """One task and all agents on it, best first."""

    id: str
    title: str
    digest: str
    rows: tuple[RowEntry, ...]


class IntervalEntry(_Frozen):
    """An estimate with its 95 % stratified bootstrap interval."""

    value: float
    low: float
    high: float


class SuiteRowEntry(_Frozen):
    """One agent over a suite, in normalised scores: 0 is doing nothing, 1 the best known result of each task."""

    rank: int | None
    agent: str
    iqm: IntervalEntry
    mean: IntervalEntry
    median: IntervalEntry
    optimality_gap: IntervalEntry
    missing_tasks: tuple[str, ...]


class SuiteEntry(_Frozen):
    """One suite and all agents on it, best first."""

    name: str
    tasks: tuple[str, ...]
    rows: tuple[SuiteRowEntry, ...]


class LeaderboardDocument(_Frozen):
    """``leaderboard.json``."""

    schema_name: Literal["glbench/leaderboard"] = Field(default="glbench/leaderboard", alias="schema")
    schema_version: Literal[1] = 1
    units: dict[str, str] = Field(description="unit of every metric; '-' for none")
    tasks: tuple[TaskEntry, ...]
    suites: tuple[SuiteEntry, ...]


def to_json(tables: Sequence[TaskTable], suites: Sequence[SuiteTable] = ()) -> str:
    """The leaderboard as ``LeaderboardDocument``, indented, ending in a newline."""
    document = LeaderboardDocument(
        units=UNITS, tasks=tuple(_task(table) for table in tables), suites=tuple(_suite(table) for table in suites)
    )
    return document.model_dump_json(by_alias=True, indent=1) + "\n"


def json_schema() -> str:
    """JSON Schema of ``leaderboard.json``, as published in ``docs/schema/leaderboard.schema.json``."""
    schema: dict[str, Any] = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **LeaderboardDocument.model_json_schema(by_alias=True, mode="serialization"),
    }
    return json.dumps(schema, indent=1) + "\n"


def to_latex(table: TaskTable) -> str:
    """A task's table for a paper: ``booktabs``, mean and 95 % interval, units in the head."""
    heads = " & ".join(["", "Agent", *(_escaped(column.heading) for column in COLUMNS[:3]), "Runs"])
    lines = [
        f"% {table.task_id}, digest {table.digest[:12]}; needs \\usepackage{{booktabs}}",
        r"\begin{tabular}{rlrrrr}",
        r"\toprule",
        heads + r" \\",
        r"\midrule",
        *(_latex_row(row) for row in table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _latex_row(row: Row) -> str:
    cells = ["--" if row.rank is None else str(row.rank), _escaped(row.agent) + (r"\dag" if row.privileged else "")]
    for column in COLUMNS[:3]:
        one = row.estimates[column.metric]
        text = f"${one.mean:.{column.decimals}f}$"
        if one.low < one.high:
            text += f" $[{one.low:.{column.decimals}f}, {one.high:.{column.decimals}f}]$"
        cells.append(text)
    return " & ".join([*cells, str(row.runs)]) + r" \\"


def _escaped(text: str) -> str:
    for plain, latex in (
        ("\\", r"\textbackslash "),
        ("_", r"\_"),
        ("%", r"\%"),
        ("&", r"\&"),
        ("#", r"\#"),
        ("²", "$^2$"),
    ):
        text = text.replace(plain, latex)
    return text


def _task(table: TaskTable) -> TaskEntry:
    return TaskEntry(id=table.task_id, title=table.title, digest=table.digest, rows=tuple(map(_row, table.rows)))


def _row(row: Row) -> RowEntry:
    return RowEntry(
        rank=row.rank,
        agent=row.agent,
        privileged=row.privileged,
        information=row.information,
        runs=row.runs,
        failed_runs=row.failed,
        verified=row.verified,
        decision_ms=row.decision_milliseconds,
        remark=row.remark,
        results_digest=row.results_digest,
        metrics={
            name: MetricEntry(mean=one.mean, iqm=one.iqm, low=one.low, high=one.high)
            for name, one in row.estimates.items()
        },
    )


def _suite(table: SuiteTable) -> SuiteEntry:
    return SuiteEntry(
        name=table.suite,
        tasks=table.tasks,
        rows=tuple(
            SuiteRowEntry(
                rank=row.rank,
                agent=row.aggregate.agent,
                missing_tasks=row.missing,
                **{
                    part: IntervalEntry(value=one.value, low=one.low, high=one.high)
                    for part in ("iqm", "mean", "median", "optimality_gap")
                    for one in [getattr(row.aggregate, part)]
                },
            )
            for row in table.rows
        ),
    )
