"""The leaderboard for papers and programs: LaTeX, and JSON with a published schema."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from glbench.evaluation.metrics import UNITS
from glbench.leaderboard.aggregates import Interval
from glbench.leaderboard.ranking import Row, TaskTable
from glbench.leaderboard.suites import SuiteRow, SuiteTable
from glbench.leaderboard.tables import COLUMNS, latex_text, sandbox_word, steps_text


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


Sandbox = Literal["bubblewrap", "unsandboxed", "built-in"]
_SANDBOX: TypeAdapter[Sandbox | None] = TypeAdapter(Sandbox | None)


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
    training_steps: int | None = Field(
        default=None,
        description="control steps that it was trained for; 0 when nothing was learnt, null when nobody says",
    )
    training_hours: float | None = Field(default=None, description="hours that the training took [h]")
    sandbox: Sandbox | None = Field(
        default=None, description="how it ran; null in results of glbench without sandboxes"
    )
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


class SuiteFiguresEntry(_Frozen):
    """What an agent earned, grew and used over a suite: means over the tasks, in the units that ``units`` names."""

    metrics: dict[str, float]
    failed_runs: int
    decision_ms: float
    training_steps: int | None = Field(description="of the task with the longest training; null when nobody says")
    privileged: bool
    information: str
    sandbox: str
    verified: bool = Field(description="whether all of its results were proved")


class ProbabilityEntry(_Frozen):
    """Probability that a run of ``first`` scores above a run of ``second`` on the same task, ties half, with its interval."""

    first: str
    second: str
    probability: IntervalEntry


class ProfileEntry(_Frozen):
    """Share of an agent's runs with a normalised score above each threshold, with pointwise 95 % bands."""

    agent: str
    thresholds: tuple[float, ...]
    share: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


class SuiteRowEntry(_Frozen):
    """One agent over a suite, in normalised scores: 0 is doing nothing, 1 the best known result of each task."""

    rank: int | None
    agent: str
    iqm: IntervalEntry
    mean: IntervalEntry
    median: IntervalEntry
    optimality_gap: IntervalEntry
    missing_tasks: tuple[str, ...]
    figures: SuiteFiguresEntry | None = None


class SuiteEntry(_Frozen):
    """One suite and all agents on it, best first."""

    name: str
    tasks: tuple[str, ...]
    rows: tuple[SuiteRowEntry, ...]
    improvements: tuple[ProbabilityEntry, ...] = ()
    profiles: tuple[ProfileEntry, ...] = ()


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
    """A task's tables for a paper (``booktabs``, units in the head): mean and 95 % interval, then what was grown and used."""
    scores = [
        ["", "Agent", *(latex_text(column.heading) for column in COLUMNS[:3]), "Runs"],
        *map(_latex_row, table.rows),
    ]
    words = ["Decision [ms]", "Training [steps]", "Sees", "Sandboxed", "Verified"]
    used = [
        ["Agent", *(latex_text(column.heading) for column in COLUMNS[3:]), *words],
        *map(_latex_resources, table.rows),
    ]
    comment = f"% {table.task_id}, digest {table.digest[:12]}; needs \\usepackage{{booktabs}}"
    return "\n".join([comment, *_tabular("rlrrrr", scores), "", *_tabular("lrrrrrrrlll", used)]) + "\n"


def _tabular(columns: str, rows: Sequence[Sequence[str]]) -> list[str]:
    head, *body = [" & ".join(row) + r" \\" for row in rows]
    return [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"]


def _latex_resources(row: Row) -> list[str]:
    return [
        latex_text(row.agent),
        *(f"${row.estimates[column.metric].mean:.{column.decimals}f}$" for column in COLUMNS[3:]),
        f"${row.decision_milliseconds:.3f}$",
        latex_text(steps_text(row.training_steps)),
        "privileged" if row.privileged else "observations",
        latex_text(sandbox_word(row.sandbox)),
        "yes" if row.verified else "no",
    ]


def _latex_row(row: Row) -> list[str]:
    cells = ["--" if row.rank is None else str(row.rank), latex_text(row.agent) + (r"\dag" if row.privileged else "")]
    for column in COLUMNS[:3]:
        one = row.estimates[column.metric]
        text = f"${one.mean:.{column.decimals}f}$"
        if one.low < one.high:
            text += f" $[{one.low:.{column.decimals}f}, {one.high:.{column.decimals}f}]$"
        cells.append(text)
    return [*cells, str(row.runs)]


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
        training_steps=row.training_steps,
        training_hours=row.training_hours,
        sandbox=_SANDBOX.validate_python(row.sandbox),
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
        rows=tuple(map(_suite_row, table.rows)),
        improvements=tuple(
            ProbabilityEntry(first=one.first, second=one.second, probability=_interval(one.probability))
            for one in table.improvements
        ),
        profiles=tuple(
            ProfileEntry(
                agent=agent,
                **{part: tuple(getattr(one, part).tolist()) for part in ("thresholds", "share", "low", "high")},
            )
            for agent, one in table.profiles.items()
        ),
    )


def _suite_row(row: SuiteRow) -> SuiteRowEntry:
    one, figures = row.aggregate, row.figures
    return SuiteRowEntry(
        rank=row.rank,
        agent=one.agent,
        iqm=_interval(one.iqm),
        mean=_interval(one.mean),
        median=_interval(one.median),
        optimality_gap=_interval(one.optimality_gap),
        missing_tasks=row.missing,
        figures=None
        if figures is None
        else SuiteFiguresEntry(
            metrics=dict(figures.metrics),
            failed_runs=figures.failed,
            decision_ms=figures.decision_milliseconds,
            training_steps=figures.training_steps,
            privileged=figures.privileged,
            information=figures.information,
            sandbox=figures.sandbox,
            verified=figures.verified,
        ),
    )


def _interval(interval: Interval) -> IntervalEntry:
    return IntervalEntry(value=interval.value, low=interval.low, high=interval.high)
