"""From stored results to ranked rows: entries with their estimates, complete results first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from glbench.evaluation import Result
from glbench.evaluation.metrics import METRIC_NAMES
from glbench.leaderboard.budget import budget_of
from glbench.leaderboard.collect import Expectation, Origin, StoredResult, refuse_mixed_digests
from glbench.leaderboard.comparisons import RESOLUTION, tiers
from glbench.leaderboard.entries import RANKING_METRIC, Entry, entries_by_task, expected_seeds, metric_of
from glbench.leaderboard.kernels import kernel_build, kernel_label
from glbench.leaderboard.statistics import bootstrap_interval, interquartile_mean, mean

SANDBOXES = ("unknown", "unsandboxed", "bubblewrap", "built-in")
"""How an agent ran; what says least comes first."""


@dataclass(frozen=True)
class Estimate:
    """A metric over runs: mean, interquartile mean, and the 95 % bootstrap interval of the mean, all in the metric's unit.

    Of several trainings: the mean over them, and ``low`` and ``high`` are the means of the lowest and the highest training.
    """

    mean: float
    iqm: float
    low: float
    high: float


@dataclass(frozen=True)
class Row:
    """One entry on one task: an agent, or several trainings of one recipe.

    ``rank`` is shared by agents that cannot be told apart, see ``comparisons.tiers``. It is ``None`` when the result lacks runs of the
    task's evaluation; ``remark`` then says so.
    """

    task_id: str
    agent: str
    rank: int | None
    privileged: bool
    runs: int
    failed: int
    estimates: Mapping[str, Estimate]
    task_digest: str
    results_digest: str
    """Of several trainings that of the first."""
    remark: str
    origin: Origin = "own"
    """Whether it came with glbench, is the user's own, or a trial with other seeds than the task's."""
    reproduced: bool = False
    """Whether ``glbench verify`` simulated all runs again and got the same numbers; of several trainings, of all of them."""
    decision_milliseconds: float = 0.0
    """Time that the agent takes for one step of one run [ms], as the file states it."""
    information: str = ""
    """What the agent sees, in words."""
    unsandboxed: bool = False
    """Whether a submission ran with all rights of the evaluation, so that only a reader of its code knows what it saw."""
    kernel: str = ""
    """What stepped the model: backend and preset, as in ``compiled/reference``."""
    build: str = ""
    """A short name of the kernel's build and settings, see ``kernels.kernel_build``."""
    training_steps: int | None = None
    """Control steps of the (longest) training; 0: not trained; ``None``: not stated."""
    training_hours: float | None = None
    """Hours that the (longest) training took on its machine [h]."""
    sandbox: str | None = None
    """How the agent ran: ``bubblewrap``, ``unsandboxed``, ``built-in`` (part of glbench), or ``None`` when it is not known."""
    trainings: tuple[Row, ...] = ()
    """Its trainings in the order of their seeds. Empty for an agent that is no training among others."""
    training_seed: int | None = None
    """Of a row in ``trainings``: the seed that it was trained with."""

    @property
    def is_range(self) -> bool:
        """Whether ``low`` and ``high`` of the estimates are the lowest and highest training, and no interval."""
        return len(self.trainings) > 1

    @property
    def results(self) -> tuple[Row, ...]:
        """One row a result: the trainings, or the row itself."""
        return self.trainings or (self,)


@dataclass(frozen=True)
class TaskTable:
    """All rows of one task, best first, unranked rows last."""

    task_id: str
    title: str
    digest: str
    rows: tuple[Row, ...]
    metric: str = RANKING_METRIC
    """What the rows are ranked by."""

    @property
    def results(self) -> tuple[Row, ...]:
        """One row a result, in the order of the rows."""
        return tuple(result for row in self.rows for result in row.results)

    @property
    def kernels(self) -> dict[tuple[str, str], tuple[str, ...]]:
        """Agents by the label and the build of the kernel that stepped the model for them; that of most agents first."""
        found: dict[tuple[str, str], list[str]] = {}
        for entry in self.rows:
            alike = len({(row.kernel, row.build) for row in entry.results}) == 1
            for row in (entry,) if alike else entry.results:
                found.setdefault((row.kernel, row.build), []).append(row.agent)
        ordered = sorted(found.items(), key=lambda item: (-len(item[1]), item[0]))
        return {kernel: tuple(agents) for kernel, agents in ordered}


def estimate(values: Iterable[float]) -> Estimate:
    """Mean, interquartile mean and 95 % interval of one metric over runs."""
    sample = np.fromiter(values, dtype=np.float64)
    low, high = bootstrap_interval(sample)
    return Estimate(float(mean(sample)), float(interquartile_mean(sample)), low, high)


def estimates_of(result: Result) -> dict[str, Estimate]:
    """Estimates of every metric of ``result``."""
    return {name: estimate(result.values(name)) for name in METRIC_NAMES}


def estimate_over_trainings(trainings: Sequence[Estimate]) -> Estimate:
    """Mean over trainings, with the lowest and the highest of them; of one training its own estimate with its interval."""
    if len(trainings) == 1:
        return trainings[0]
    means = [one.mean for one in trainings]
    return Estimate(float(np.mean(means)), float(np.mean([one.iqm for one in trainings])), min(means), max(means))


def rank(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> tuple[TaskTable, ...]:
    """Rank the entries of every task by the mean of the task's metric, highest first; those that cannot be told apart share a rank.

    Parameters
    ----------
    stored
        Results.
    expected
        Digest, seeds and metric of the published tasks by id. A task that is not in it (a user's own) is ranked by the reward, over the
        largest set of seeds among its results.

    Raises
    ------
    ResultError
        When results of different tasks stand under one id, or a task asks for a metric that cannot rank.
    """
    items = tuple(stored)
    refuse_mixed_digests(items, expected)
    return tuple(
        _table(task_id, entries, expected_seeds(task_id, _results(entries), expected), metric_of(task_id, expected))
        for task_id, entries in entries_by_task(items, expected).items()
    )


def _results(entries: Iterable[Entry]) -> list[StoredResult]:
    return [item for entry in entries for item in entry.trainings]


def _table(task_id: str, entries: Sequence[Entry], seeds: tuple[int, ...], metric: str) -> TaskTable:
    complete = {entry.name: entry for entry in entries if entry.complete}
    # How far rounding spreads a figure where nothing is drawn is known of the reward alone.
    resolution = RESOLUTION if metric == "reward" else 0.0
    rows: list[Row] = []
    for tier in tiers({name: (entry.values(metric),) for name, entry in complete.items()}, (resolution,)):
        shared = len(rows) + 1
        rows += [_row(complete[name], shared, "") for name in tier]
    for entry in entries:
        if not entry.complete:
            runs = len(entry.seeds)
            remark = f"not ranked: {runs} runs with other seeds than the task's {len(seeds)}"
            if entry.seeds == seeds:
                remark = "not ranked: a trial"
            elif entry.seeds == seeds[:runs]:
                remark = f"not ranked: {runs} of {len(seeds)} runs"
            rows.append(_row(entry, None, remark))
    first = entries[0].first.task
    return TaskTable(task_id, first.title, first.digest, tuple(rows), metric)


def _row(entry: Entry, rank_: int | None, remark: str) -> Row:
    if not entry.training_seeds:
        return _row_of_result(entry.trainings[0], entry.name, None, entry.origin, rank_, remark)
    rows = tuple(
        _row_of_result(item, item.result.agent.name, seed, entry.origin, rank_, remark)
        for item, seed in zip(entry.trainings, entry.training_seeds, strict=True)
    )
    return over_trainings(entry.name, rows)


def over_trainings(name: str, rows: tuple[Row, ...]) -> Row:
    """The row of an entry with these trainings, of which it says the least that holds for all."""
    first = rows[0]
    steps, hours = [row.training_steps for row in rows], [row.training_hours for row in rows]
    sandboxes = {row.sandbox or "unknown" for row in rows}
    sandbox = next(kind for kind in SANDBOXES if kind in sandboxes)
    return Row(
        task_id=first.task_id,
        agent=name,
        rank=first.rank,
        privileged=any(row.privileged for row in rows),
        runs=sum(row.runs for row in rows),
        failed=sum(row.failed for row in rows),
        estimates={
            metric: estimate_over_trainings([row.estimates[metric] for row in rows]) for metric in first.estimates
        },
        task_digest=first.task_digest,
        results_digest=first.results_digest,
        remark=first.remark,
        origin=first.origin,
        reproduced=all(row.reproduced for row in rows),
        decision_milliseconds=float(np.mean([row.decision_milliseconds for row in rows])),
        information=first.information,
        unsandboxed=any(row.unsandboxed for row in rows),
        kernel=first.kernel,
        build=first.build,
        training_steps=None if None in steps else max(one for one in steps if one is not None),
        training_hours=None if None in hours else max(one for one in hours if one is not None),
        sandbox=None if sandbox == "unknown" else sandbox,
        trainings=rows,
    )


def _row_of_result(
    item: StoredResult, name: str, training_seed: int | None, origin: Origin, rank_: int | None, remark: str
) -> Row:
    result = item.result
    budget = budget_of(result)
    return Row(
        task_id=result.task.id,
        agent=name,
        rank=rank_,
        privileged=result.agent.privileged,
        runs=result.evaluation.runs,
        failed=result.summary.failed,
        estimates=estimates_of(result),
        task_digest=result.task.digest,
        results_digest=result.results_digest,
        remark=remark,
        origin=origin,
        reproduced=item.reproduced,
        decision_milliseconds=result.evaluation.decision_milliseconds,
        information=result.agent.information,
        unsandboxed=result.agent.kind == "submission" and result.evaluation.sandbox not in ("bubblewrap", "built-in"),
        kernel=kernel_label(result),
        build=kernel_build(result),
        training_steps=budget.steps,
        training_hours=budget.hours,
        sandbox=result.evaluation.sandbox,
        training_seed=training_seed,
    )
