"""What the published tasks ask of results: digest, seeds and metric, from the task files and the lock alone."""

from __future__ import annotations

from pathlib import Path

from glbench.leaderboard.collect import Expectation, StoredResult, collect_results
from glbench.resources import data_folder
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


def own_and_released_results(out: Path) -> tuple[StoredResult, ...]:
    """The results in ``<out>/results``, and those of the baselines that come with glbench where there are none of one's own.

    Raises
    ------
    ResultError
        When a file is no valid result.
    """
    # In a checkout the released results lie where one's own are made: of those only the baselines' are released.
    own = (out / "results").resolve()
    return tuple(
        item
        for item in collect_results([out / "results", data_folder("reports/results")])
        if item.result.agent.kind == "baseline" or item.path.resolve().is_relative_to(own)
    )
