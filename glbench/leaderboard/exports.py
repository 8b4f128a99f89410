"""The leaderboard for papers and programs: LaTeX, and JSON with a published schema."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from glbench.evaluation.metrics import UNITS
from glbench.leaderboard.aggregates import Interval
from glbench.leaderboard.collect import Origin
from glbench.leaderboard.escaping import latex_text, number_text
from glbench.leaderboard.ranking import Row, TaskTable
from glbench.leaderboard.suites import SuiteRow, SuiteTable
from glbench.leaderboard.tables import (
    Column,
    columns_of,
    entry_label,
    format_estimate,
    runs_label,
    sandbox_word,
    sees_word,
    steps_text,
)
from glbench.untrusted import visible


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


Sandbox = Literal["bubblewrap", "unsandboxed", "built-in"]
_SANDBOX: TypeAdapter[Sandbox | None] = TypeAdapter(Sandbox | None)


class MetricEntry(_Frozen):
    """A metric of one entry on one task, over the task's runs, in the unit that ``units`` names."""

    mean: float = Field(description="arithmetic mean over the runs; of several trainings the mean over them")
    iqm: float = Field(description="mean of the middle half of the runs; of several trainings the mean over them")
    low: float = Field(
        description="lower end of the 95 % bootstrap interval of the mean; of several trainings the lowest of their means"
    )
    high: float = Field(description="upper end of it; of several trainings the highest of their means")


class RowEntry(_Frozen):
    """One entry on one task: an agent, or several trainings of one recipe."""

    rank: int | None = Field(description="shared by agents that cannot be told apart; null when runs are missing")
    agent: str
    privileged: bool = Field(description="whether it sees more than observations or acts without the rate limit")
    information: str = Field(description="what it sees, in words")
    runs: int
    failed_runs: int
    origin: Origin = Field(
        description="released with glbench, the user's own, or a trial with other seeds than the task's"
    )
    reproduced: bool = Field(description="whether glbench verify simulated all runs again and got the same numbers")
    decision_ms: float = Field(description="time of one decision for one run [ms]; stated by the file, not checked")
    training_steps: int | None = Field(
        default=None,
        description="control steps that it was trained for; 0 when not trained, null when not stated; not checked",
    )
    training_hours: float | None = Field(default=None, description="hours that the training took [h]; not checked")
    sandbox: Sandbox | None = Field(
        default=None, description="how it ran; null in results of glbench without sandboxes; not checked"
    )
    kernel: str = Field(description="backend and preset of the kernel that stepped the model")
    kernel_build: str = Field(description="short digests of the kernel's library and of all its settings")
    remark: str
    results_digest: str = Field(description="of several trainings that of the first")
    metrics: dict[str, MetricEntry]
    training_seed: int | None = Field(
        default=None, description="of one training among several: the seed it was trained with"
    )
    trainings: tuple[RowEntry, ...] = Field(default=(), description="trainings of the entry, by seed")


class TaskEntry(_Frozen):
    """One task and all agents on it, best first."""

    id: str
    title: str
    digest: str
    metric: str = Field(description="what the rows are ranked by")
    rows: tuple[RowEntry, ...]


class IntervalEntry(_Frozen):
    """An estimate with its 95 % stratified bootstrap interval over runs; where a task has several trainings, with the range over them."""

    value: float
    low: float
    high: float


class SuiteFiguresEntry(_Frozen):
    """What an agent earned, grew and used over a suite: means over the tasks, in the units that ``units`` names."""

    metrics: dict[str, float]
    failed_runs: int
    decision_ms: float
    training_steps: int | None = Field(description="of the task with the longest training; null when not stated")
    privileged: bool
    information: str
    sandbox: str
    reproduced: bool = Field(description="whether all of its results were reproduced")
    origin: Origin = Field(description="released when all of its results are")


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
    trainings: tuple[int, int] = Field(description="fewest and most trainings on a task")
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
    schema_version: Literal[2] = 2
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
    """A task's tables for a paper (``booktabs``, units in the head): mean and 95 % interval or range, then what was grown and used."""
    columns = columns_of(table)
    scored, used = columns[:3], columns[3:]
    scores = [
        ["", "Agent", *(latex_text(column.heading) for column in scored), "Runs"],
        *(_latex_row(row, scored) for row in table.rows),
    ]
    words = ["Decision [ms]", "Training [steps]", "Source", "Sees", "Sandboxed", "Reproduced"]
    resources = [
        ["Agent", *(latex_text(column.heading) for column in used), *words],
        *(_latex_resources(row, used) for row in table.rows),
    ]
    comment = f"% {visible(table.task_id)}, digest {table.digest[:12]}; needs \\usepackage{{booktabs}}"
    return "\n".join([comment, *_tabular("rlrrrr", scores), "", *_tabular("lrrrrrrrllll", resources)]) + "\n"


def _tabular(columns: str, rows: Sequence[Sequence[str]]) -> list[str]:
    head, *body = [" & ".join(row) + r" \\" for row in rows]
    return [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", head, r"\midrule", *body, r"\bottomrule", r"\end{tabular}"]


def _latex_resources(row: Row, columns: Sequence[Column]) -> list[str]:
    return [
        latex_text(entry_label(row)),
        *(f"${number_text(row.estimates[column.metric].mean, column.decimals)}$" for column in columns),
        f"${number_text(row.decision_milliseconds, 3)}$",
        latex_text(steps_text(row.training_steps)),
        row.origin,
        sees_word(privileged=row.privileged, information=row.information),
        latex_text(sandbox_word(row.sandbox)),
        "yes" if row.reproduced else "no",
    ]


def _latex_row(row: Row, columns: Sequence[Column]) -> list[str]:
    name = latex_text(entry_label(row)) + (r"\dag" if row.privileged else "")
    return [
        "--" if row.rank is None else str(row.rank),
        name,
        *(
            latex_text(format_estimate(row.estimates[column.metric], column, is_range=row.is_range))
            for column in columns
        ),
        latex_text(runs_label(row)),
    ]


def _task(table: TaskTable) -> TaskEntry:
    return TaskEntry(
        id=table.task_id, title=table.title, digest=table.digest, metric=table.metric, rows=tuple(map(_row, table.rows))
    )


def _row(row: Row) -> RowEntry:
    return RowEntry(
        rank=row.rank,
        agent=row.agent,
        privileged=row.privileged,
        information=row.information,
        runs=row.runs,
        failed_runs=row.failed,
        origin=row.origin,
        reproduced=row.reproduced,
        decision_ms=row.decision_milliseconds,
        training_steps=row.training_steps,
        training_hours=row.training_hours,
        sandbox=_SANDBOX.validate_python(row.sandbox),
        kernel=row.kernel,
        kernel_build=row.build,
        remark=row.remark,
        results_digest=row.results_digest,
        training_seed=row.training_seed,
        trainings=tuple(map(_row, row.trainings)),
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
        trainings=one.trainings,
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
            reproduced=figures.reproduced,
            origin=figures.origin,
        ),
    )


def _interval(interval: Interval) -> IntervalEntry:
    return IntervalEntry(value=interval.value, low=interval.low, high=interval.high)
