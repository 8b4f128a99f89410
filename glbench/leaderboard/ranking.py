"""From stored results to ranked rows: entries with their estimates, complete results first. ``leaderboard.json`` holds them, too."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import Field, computed_field

from glbench.evaluation.records import RANKING_METRIC
from glbench.leaderboard import statistics
from glbench.leaderboard.catalogue import Catalogue, catalogue_of
from glbench.leaderboard.collect import ORIGINS, Expectation, Origin, StoredResult, refuse_mixed_digests, years_of_runs
from glbench.leaderboard.entries import Entry, entries_by_task, expected_seeds, metric_of, resolution_of
from glbench.leaderboard.fresh_draws import FreshScore, fresh_score, fresh_score_over
from glbench.leaderboard.regret import PENALTY, BestKnownMeans, Regret, best_known_means, can_be_best_known, regret_of
from glbench.leaderboard.training_data import TrainingData, budget_of, contamination_warning, training_data_of
from glbench.leaderboard.violations import AtPrice, Turn, at_prices
from glbench.quantities import MONEY
from glbench.tasks import Round
from glbench.untrusted import html_of

Sandbox = Literal["bubblewrap", "unsandboxed", "built-in"]
SANDBOXES = ("unknown", "unsandboxed", "bubblewrap", "built-in")  # How an agent ran; what says least comes first
_SHORT = 6
Number = TypeVar("Number", int, float)


class OfYear(statistics.FrozenModel):
    """Mean of the ranking metric over the runs of one weather year; of several trainings, the mean over them."""

    year: int
    runs: int
    mean: float


class Row(statistics.FrozenModel):
    """One entry on one task: an agent, or several trainings of one recipe."""

    rank: int | None = Field(description="shared by agents that cannot be told apart; null when runs are missing")
    agent: str
    privileged: bool = Field(description="whether it sees more than observations or acts without the rate limit")
    information: str = Field(description="what it sees, in words")
    runs: int
    failed: int = Field(serialization_alias="failed_runs")
    origin: Origin = Field(description="released with glbench, the user's own, or a trial with other seeds than the task's")
    reproduced: bool = Field(description="whether glbench verify simulated all runs again and got the same numbers")
    decision_milliseconds: float = Field(
        serialization_alias="decision_ms", description="time of one decision for one run [ms]; stated by the file, not checked"
    )
    training_steps: int | None = Field(
        default=None, description="control steps that it was trained for; 0 when not trained, null when not stated; not checked"
    )
    training_hours: float | None = Field(default=None, description="hours that the training took [h]; not checked")
    sandbox: Sandbox | None = Field(default=None, description="how it ran; null in results of glbench without sandboxes; not checked")
    kernel: str = Field(description="backend and preset of the kernel that stepped the model")
    build: str = Field(serialization_alias="kernel_build", description="short digests of the kernel's library and of all its settings")
    remark: str
    worst_tenth: statistics.Interval | None = Field(
        default=None,
        description="what ranks, as the mean of the worst tenth of the runs (CVaR10) with its 95 % bootstrap interval; of several "
        "trainings the mean over them with the lowest and the highest; null where a result does not hold what ranks",
    )
    regret: Regret | None = Field(
        default=None, description="how far it stays below the best known runs; null where none of its runs has one"
    )
    reversal: float | None = Field(default=None, description="probability that it is truly better than the ranked row above it")
    at_prices: tuple[AtPrice, ...] = Field(default=(), description="places at other prices of violations; empty if they have none in money")
    frontier: bool | None = Field(default=None, description="not privileged, and no such agent has its profit with fewer violations")
    fresh_draws: FreshScore | None = Field(default=None, description="score with fresh draws; null without them")
    by_year: tuple[OfYear, ...] = Field(
        default=(),
        description="mean of the ranking metric by weather year, each run in the year of most of its days; empty if all runs are of one "
        "year, or the task is not known",
    )
    trained_on: TrainingData = Field(default=TrainingData(), description="what its training saw; not checked")
    saw_scored: str = Field(default="", description="why it is marked as trained on what is scored; empty where it is not")
    results_digest: str = Field(description="of several trainings that of the first")
    estimates: dict[str, statistics.Estimate] = Field(serialization_alias="metrics")
    training_seed: int | None = Field(default=None, description="of one training among several: the seed it was trained with")
    trainings: tuple[Row, ...] = Field(default=(), description="trainings of the entry, by seed")
    task_id: str = Field(exclude=True)
    task_digest: str = Field(exclude=True)
    unsandboxed: bool = Field(exclude=True)
    """Whether a submission ran with all rights of the evaluation, so that only a reader of its code knows what it saw."""
    units: dict[str, str] = Field(exclude=True)
    """Units of the metrics, as the result states them."""
    path: str = Field(default="", exclude=True)
    """The result's file."""
    plan_counts: bool = Field(default=False, exclude=True)
    """Whether its runs could be best known ones: it acts through the task's actuation."""

    @property
    def is_range(self) -> bool:
        """Whether ``low`` and ``high`` of the estimates are the lowest and highest training, and no interval."""
        return len(self.trainings) > 1

    @property
    def results(self) -> tuple[Row, ...]:
        """One row a result: the trainings, or the row itself."""
        return self.trainings or (self,)

    @property
    def means(self) -> dict[str, float]:
        """Mean of every metric that the result holds."""
        return {name: one.mean for name, one in self.estimates.items()}


class TaskTable(statistics.FrozenModel):
    """One task and all agents on it, best first."""

    task_id: str = Field(serialization_alias="id")
    title: str
    digest: str
    metric: str = Field(description="what the rows are ranked by")
    rows: tuple[Row, ...]
    turns: tuple[Turn, ...] = Field(default=(), description="who changes places between half and double the price of violations")
    of_task: str = Field(default="", serialization_alias="task", description="id of the task; 'id' names the board")
    split: str | None = Field(default=None, description="split of the seasons; null of a task without splits")
    years: tuple[int, ...] = Field(default=(), description="years that the seasons are from")
    salt_commitment: str | None = Field(
        default=None, description="SHA-256 of the secret salt that entered the draws; null where all draws are public"
    )
    best_known: BestKnownMeans | None = Field(
        default=None, description="means over the best known runs, which regrets are measured by; null where none are known"
    )
    task: Any = Field(default=None, exclude=True)
    """The task's definition, where a result has it."""
    late: tuple[str, ...] = Field(default=(), exclude=True)
    """Sentences that name results made after the round closed."""

    @computed_field(description="unit of every metric in this task; '-' for none")  # type: ignore[prop-decorator]
    @property
    def units(self) -> dict[str, str]:
        """Unit of every metric in this task."""
        return {name: unit for row in self.results for name, unit in row.units.items()}

    @property
    def draws(self) -> str:
        """What the heading says of the draws of the board; empty where they are the public ones that the task is judged by."""
        split = f"{self.split} split" if self.split not in (None, "test") else ""
        sealed = f"sealed draws, salt commitment {self.salt_commitment}" if self.salt_commitment is not None else ""
        return "; ".join(part for part in (split, sealed) if part)

    def _repr_html_(self) -> str:
        """What a notebook shows: the ranks by the task's metric; ``to_frame`` has all metrics."""
        unit = next((row.units[self.metric] for row in self.rows if self.metric in row.units), "-")
        columns = ("rank", "agent", f"{self.metric} [{unit}]", "from", "to", "runs")
        rows = [
            (row.rank if row.rank is not None else "–", row.agent, one.mean, one.low, one.high, row.runs)
            for row in self.rows
            if (one := row.estimates.get(self.metric)) is not None
        ]
        facts = [("task", self.of_task or self.task_id), *([("draws", self.draws)] if self.draws else [])]
        return html_of(self.title, facts, columns, rows)

    @property
    def words(self) -> Catalogue:
        """What the task calls its metrics."""
        return catalogue_of(self.task, self.units)

    @property
    def results(self) -> tuple[Row, ...]:
        """One row a result, in the order of the rows."""
        return tuple(result for row in self.rows for result in row.results)

    @property
    def kernels(self) -> dict[tuple[str, str], tuple[str, ...]]:
        """Agents by the label and the build of the kernel that stepped the model for them; that of most agents first."""
        agents_of: dict[tuple[str, str], list[str]] = {}
        for entry in self.rows:
            alike = len({(row.kernel, row.build) for row in entry.results}) == 1
            for row in (entry,) if alike else entry.results:
                agents_of.setdefault((row.kernel, row.build), []).append(row.agent)
        ordered = sorted(agents_of.items(), key=lambda item: (-len(item[1]), item[0]))
        return {kernel: tuple(agents) for kernel, agents in ordered}


def with_late_entries(tables: Sequence[TaskTable], stored: Sequence[StoredResult], sealed: Round) -> tuple[TaskTable, ...]:
    """The tables, with the late results of the round ``sealed`` named: those that state a time after it closed."""
    closed = f"the round closed at {sealed.closing_words}"
    late = [
        (item.board, f"{item.result.agent.name} is late: its result states that it was made at {item.result.created}, and {closed}.")
        for item in stored
        if item.result.task.salt_commitment == sealed.commitment and sealed.is_late(item.result.created)
    ]
    return tuple(table.model_copy(update={"late": tuple(words for board, words in late if board == table.task_id)}) for table in tables)


def rank(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> tuple[TaskTable, ...]:
    """Rank the entries of every task by the mean of the task's metric, highest first; those that cannot be told apart share a rank.

    Raises ``ResultError`` when results of different tasks stand under one id, or a task asks for a metric that cannot rank. ``expected``
    has digest, seeds and metric of the published tasks by id. A task that is not in it (a user's own) is ranked by the metric and over the
    seeds that its definition names; where no result has the definition, by the reward over the largest set of seeds among its results.
    """
    items = tuple(stored)
    refuse_mixed_digests(items, expected)
    return tuple(_table(task_id, entries, expected) for task_id, entries in entries_by_task(items, expected).items())


def _table(task_id: str, entries: Sequence[Entry], expected: Mapping[str, Expectation]) -> TaskTable:
    task = next((entry.task for entry in entries if entry.task is not None), None)
    metric = metric_of(task_id, expected, task)
    seeds = expected_seeds(task_id, [item for entry in entries for item in entry.trainings], expected)
    complete = {entry.name: entry for entry in entries if entry.complete and entry.states(metric)}
    resolution = resolution_of(metric, task, entries[0].first.units)
    rows: list[Row] = []
    fixed = {name for name, entry in complete.items() if entry.is_fixed}
    values = {name: (entry.by_training(metric),) for name, entry in complete.items()}
    order = statistics.tiers(values, (resolution,), fixed=fixed)
    for tier in order:
        shared = len(rows) + 1
        rows += [_row(complete[name], shared, "", metric) for name in tier]
    reversals = statistics.reversals([row.agent for row in rows], values, (resolution,), fixed=fixed)
    penalties = {name: (entry.by_training(PENALTY),) for name, entry in complete.items()} if scores_money(metric, rows) else {}
    places, turns = at_prices(values, penalties, order, {row.agent for row in rows if row.privileged}, fixed=fixed)
    rows = [row.model_copy(update={"reversal": reversals.get(row.agent), **places.get(row.agent, {})}) for row in rows]
    for entry in (entry for entry in entries if entry.name not in complete):
        runs, reason = len(entry.seeds), "a trial"
        if not entry.states(metric):
            reason = f"the result does not state '{metric}'"
        elif entry.seeds != seeds and entry.seeds == seeds[:runs]:
            reason = f"{runs} of {len(seeds)} runs"
        elif entry.seeds != seeds:
            reason = f"{runs} runs with other seeds than the task's {len(seeds)}"
        rows.append(_row(entry, None, f"not ranked: {reason}", metric))
    first = entries[0].first.task
    return TaskTable(
        task_id=task_id,
        title=first.title if task is None else task.title,
        digest=first.digest,
        rows=tuple(rows),
        turns=turns,
        metric=metric,
        of_task=first.id,
        split=first.split,
        years=first.years or (),
        salt_commitment=first.salt_commitment,
        best_known=best_known_means(entries[0].first),
        task=task,
    )


def scores_money(metric: str, rows: Sequence[Row]) -> bool:
    """Whether all rows state a score in money, which ranks them, and the penalty in it."""
    return bool(rows) and all(row.units.get(metric) == MONEY and PENALTY in row.means for row in rows) and metric == RANKING_METRIC


def _row(entry: Entry, rank_: int | None, remark: str, metric: str) -> Row:
    rows = tuple(
        _row_of_result(item, entry.origin, metric, rank=rank_, remark=remark, training_seed=seed)
        for item, seed in zip(entry.trainings, entry.training_seeds or (None,), strict=True)
    )
    if not entry.training_seeds:
        return rows[0].model_copy(update={"agent": entry.name})
    shared_metrics = [name for name in rows[0].estimates if all(name in row.estimates for row in rows)]
    sandbox = combined(rows)["sandbox"]
    data = [row.trained_on.model_copy(update={"seeds": ()}) for row in rows]  # seeds are those of one training
    return rows[0].model_copy(
        update={
            **combined(rows),
            "agent": entry.name,
            "estimates": {name: statistics.estimate_over_trainings(entry.by_training(name)) for name in shared_metrics},
            "worst_tenth": statistics.worst_of(entry.by_training(metric)) if entry.states(metric) else None,
            "regret": regret_of([item.result for item in entry.trainings]),
            "by_year": means_by_year(entry.trainings, metric) if entry.states(metric) else (),
            "fresh_draws": fresh_score_over([row.fresh_draws for row in rows]),
            "trained_on": data[0] if all(one == data[0] for one in data) else TrainingData(),
            "saw_scored": next((row.saw_scored for row in rows if row.saw_scored), ""),
            "unsandboxed": any(row.unsandboxed for row in rows),
            "training_hours": _longest([row.training_hours for row in rows]),
            "sandbox": None if sandbox == "unknown" else sandbox,
            "trainings": rows,
            "training_seed": None,
        }
    )


def means_by_year(trainings: Sequence[StoredResult], metric: str) -> tuple[OfYear, ...]:
    """Means of the ranking metric by weather year; empty if all runs are of one year, or the task is not known."""
    years = years_of_runs(trainings[0])
    values = np.mean([item.result.values(metric) for item in trainings], axis=0)
    of_year = {year: values[[one == year for one in years]] for year in sorted(set(years))}
    return tuple(OfYear(year=year, runs=runs.size, mean=float(runs.mean())) for year, runs in of_year.items())


def combined(rows: Sequence[Row]) -> dict[str, Any]:
    """What can be said of several results together: sums and means, of the rest what says the least. ``sandbox`` may be ``unknown``."""
    sandboxes, origins = {row.sandbox or "unknown" for row in rows}, {row.origin for row in rows}
    return {
        "runs": sum(row.runs for row in rows),
        "failed": sum(row.failed for row in rows),
        "decision_milliseconds": float(np.mean([row.decision_milliseconds for row in rows])),
        "training_steps": _longest([row.training_steps for row in rows]),
        "privileged": any(row.privileged for row in rows),
        "information": rows[0].information,
        "sandbox": next(kind for kind in SANDBOXES if kind in sandboxes),
        "reproduced": all(row.reproduced for row in rows),
        "origin": next(origin for origin in reversed(ORIGINS) if origin in origins),
    }


def _longest(trainings: Sequence[Number | None]) -> Number | None:
    numbers = [one for one in trainings if one is not None]
    return max(numbers) if len(numbers) == len(trainings) else None


def _row_of_result(item: StoredResult, origin: Origin, metric: str, **place: Any) -> Row:
    result, training_data = item.result, training_data_of(item.result)
    budget = budget_of(result)
    kernel, evaluation = result.evaluation.kernel, result.evaluation
    everything = hashlib.sha256(json.dumps(kernel, sort_keys=True).encode()).hexdigest()
    return Row(
        task_id=item.board,
        agent=result.agent.name,
        privileged=result.agent.privileged,
        runs=evaluation.runs,
        failed=result.summary.failed,
        estimates=statistics.estimates_of(result),
        units=dict(result.units),
        task_digest=result.task.digest,
        results_digest=result.results_digest,
        origin=origin,
        reproduced=item.reproduced,
        decision_milliseconds=evaluation.decision_milliseconds,
        information=result.agent.information,
        unsandboxed=result.agent.kind == "submission" and evaluation.sandbox not in ("bubblewrap", "built-in"),
        kernel="/".join(str(kernel[key]) for key in ("backend", "preset") if key in kernel),
        # Two builds of one preset are two kernels. The name begins like the library's digest in the file, so that one finds the other.
        build=f"{str(kernel.get('library_digest', everything))[:_SHORT]}.{everything[:_SHORT]}",
        training_steps=budget.steps,
        training_hours=budget.hours,
        sandbox=evaluation.sandbox,
        worst_tenth=statistics.worst_of(np.array(result.values(metric))) if metric in result.units else None,
        regret=regret_of([result]),
        by_year=means_by_year([item], metric) if metric in result.units else (),
        fresh_draws=fresh_score(result),
        path=str(item.path),
        plan_counts=can_be_best_known(result.agent),
        trained_on=training_data,
        saw_scored=contamination_warning(result, training_data),
        **place,
    )
