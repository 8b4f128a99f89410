"""What the published tasks ask of results: digest, seeds and metric, from the task files and the lock alone."""

from __future__ import annotations

from glbench.leaderboard.collect import Expectation
from glbench.tasks import list_tasks, read_lock


def published_expectations() -> dict[str, Expectation]:
    """Expectation of every locked task by id. The digests are those of the lock; nothing is computed again."""
    locked = read_lock()
    return {
        task.id: Expectation(
            digest=locked[task.id].digest,
            seeds=tuple(range(task.evaluation.first_seed, task.evaluation.first_seed + task.evaluation.runs)),
        )
        for task in list_tasks()
        if task.id in locked
    }
