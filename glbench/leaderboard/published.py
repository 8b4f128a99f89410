"""What the published tasks ask of results: digest, seeds and metric, from the task files and the lock alone."""

from __future__ import annotations

from pathlib import Path

from glbench.errors import ResultError
from glbench.leaderboard.collect import Expectation, StoredResult, collect_readable
from glbench.resources import data_folder
from glbench.tasks import list_tasks, read_lock


def published_expectations() -> dict[str, Expectation]:
    """Expectation of every locked task by id. The digests are those of the lock; nothing is computed again."""
    locked = read_lock()
    return {
        task.id: Expectation(
            digest=locked[task.id].digest,
            seeds=tuple(range(task.evaluation.first_seed, task.evaluation.first_seed + task.evaluation.runs)),
            metric=task.evaluation.metric,
        )
        for task in list_tasks()
        if task.id in locked
    }


def own_and_released_results(out: Path) -> tuple[tuple[StoredResult, ...], tuple[ResultError, ...]]:
    """The results in ``<out>/results``, and those of the baselines that come with glbench where there are none of one's own.

    Returns
    -------
    stored, problems
        Results, and an error for every file that is no valid result.

    Raises
    ------
    ResultError
        When one folder holds two results of one agent and task.
    """
    return collect_readable([out / "results", data_folder("reports/released/results")])
