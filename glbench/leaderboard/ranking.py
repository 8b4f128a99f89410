"""From stored results to ranked rows: estimates with intervals, complete results first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from glbench.evaluation import Result
from glbench.evaluation.metrics import METRIC_NAMES
from glbench.leaderboard.budget import budget_of
from glbench.leaderboard.collect import Expectation, StoredResult, refuse_mixed_digests
from glbench.leaderboard.comparisons import tiers
from glbench.leaderboard.statistics import bootstrap_interval, interquartile_mean, mean

RANKING_METRIC = "reward"


@dataclass(frozen=True)
class Estimate:
    """A metric over runs: mean, interquartile mean, and the 95 % bootstrap interval of the mean, all in the metric's unit."""

    mean: float
    iqm: float
    low: float
    high: float


@dataclass(frozen=True)
class Row:
    """One agent on one task.

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
    remark: str
    verified: bool = False
    """Whether ``glbench verify`` proved the result from its records."""
    decision_milliseconds: float = 0.0
    """Time that the agent takes for one step of one run [ms]."""
    information: str = ""
    """What the agent sees, in words."""
    unsandboxed: bool = False
    """Whether a submission ran with all rights of the evaluation, so that only a reader of its code knows what it saw."""
    kernel: str = ""
    """What stepped the model: backend and preset, as in ``compiled/reference``."""
    training_steps: int | None = None
    """Control steps that the agent was trained for; 0 when nothing was learnt, ``None`` when nobody says."""
    training_hours: float | None = None
    """Hours that the training took on its machine [h]."""
    sandbox: str | None = None
    """How the agent ran: ``bubblewrap``, ``unsandboxed``, ``built-in`` (part of glbench), or ``None`` when it is not known."""


@dataclass(frozen=True)
class TaskTable:
    """All rows of one task, best first, unranked rows last."""

    task_id: str
    title: str
    digest: str
    rows: tuple[Row, ...]

    @property
    def kernels(self) -> dict[str, tuple[str, ...]]:
        """Agents by the kernel that stepped the model for them; the kernel of most of them first."""
        by_kernel: dict[str, list[str]] = {}
        for row in self.rows:
            by_kernel.setdefault(row.kernel, []).append(row.agent)
        ordered = sorted(by_kernel.items(), key=lambda item: (-len(item[1]), item[0]))
        return {kernel: tuple(agents) for kernel, agents in ordered}


def estimate(values: Iterable[float]) -> Estimate:
    """Mean, interquartile mean and 95 % interval of one metric over runs."""
    sample = np.fromiter(values, dtype=np.float64)
    low, high = bootstrap_interval(sample)
    return Estimate(float(mean(sample)), float(interquartile_mean(sample)), low, high)


def kernel_label(result: Result) -> str:
    """What stepped the model: ``backend/preset``."""
    kernel = result.evaluation.kernel
    return "/".join(str(kernel[key]) for key in ("backend", "preset") if key in kernel)


def estimates_of(result: Result) -> dict[str, Estimate]:
    """Estimates of every metric of ``result``."""
    return {name: estimate(result.values(name)) for name in METRIC_NAMES}


def rank(stored: Iterable[StoredResult], expected: Mapping[str, Expectation]) -> tuple[TaskTable, ...]:
    """Rank the agents of every task by the mean of ``reward``, highest first; agents that cannot be told apart share a rank.

    Parameters
    ----------
    stored
        Results, at most one an agent and task.
    expected
        Digest and seeds of the published tasks by id. A task that is not in it (a user's own) is ranked over the largest
        set of seeds among its results.

    Raises
    ------
    ResultError
        When results of different tasks stand under one id.
    """
    items = tuple(stored)
    refuse_mixed_digests(items, expected)
    verified = frozenset(item.result.results_digest for item in items if item.verified)
    tables = []
    for task_id in sorted({item.result.task.id for item in items}):
        results = [item.result for item in items if item.result.task.id == task_id]
        tables.append(_table(task_id, results, _expected_seeds(task_id, results, expected), verified))
    return tuple(tables)


def _expected_seeds(task_id: str, results: list[Result], expected: Mapping[str, Expectation]) -> tuple[int, ...]:
    if task_id in expected:
        return expected[task_id].seeds
    return max((result.evaluation.seeds for result in results), key=lambda seeds: (len(seeds), seeds))


def _table(task_id: str, results: list[Result], seeds: tuple[int, ...], verified: frozenset[str]) -> TaskTable:
    complete = {result.agent.name: result for result in results if result.evaluation.seeds == seeds}
    rows: list[Row] = []
    for tier in tiers({agent: (np.array(result.values(RANKING_METRIC)),) for agent, result in complete.items()}):
        shared = len(rows) + 1
        rows += [_row(complete[agent], estimates_of(complete[agent]), shared, "", verified) for agent in tier]
    for result in sorted((r for r in results if r.evaluation.seeds != seeds), key=lambda r: r.agent.name):
        remark = f"not ranked: {result.evaluation.runs} runs with other seeds than the task's {len(seeds)}"
        if result.evaluation.seeds == seeds[: result.evaluation.runs]:
            remark = f"not ranked: {result.evaluation.runs} of {len(seeds)} runs"
        rows.append(_row(result, estimates_of(result), None, remark, verified))
    return TaskTable(task_id, results[0].task.title, results[0].task.digest, tuple(rows))


def _row(
    result: Result, estimates: Mapping[str, Estimate], rank_: int | None, remark: str, verified: frozenset[str]
) -> Row:
    budget = budget_of(result)
    return Row(
        task_id=result.task.id,
        agent=result.agent.name,
        rank=rank_,
        privileged=result.agent.privileged,
        runs=result.evaluation.runs,
        failed=result.summary.failed,
        estimates=estimates,
        task_digest=result.task.digest,
        results_digest=result.results_digest,
        remark=remark,
        verified=result.results_digest in verified,
        decision_milliseconds=result.evaluation.decision_milliseconds,
        information=result.agent.information,
        unsandboxed=result.agent.kind == "submission" and result.evaluation.sandbox not in ("bubblewrap", "built-in"),
        kernel=kernel_label(result),
        training_steps=budget.steps,
        training_hours=budget.hours,
        sandbox=result.evaluation.sandbox,
    )
