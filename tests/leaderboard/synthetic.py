"""Results made up for tests of the leaderboard: consistent records, no simulation."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, Literal

from glbench.agents.card import SubmissionCard
from glbench.evaluation.metrics import METRIC_NAMES, UNITS
from glbench.evaluation.records import (
    AgentRecord,
    EvaluationRecord,
    Machine,
    Result,
    RunResult,
    TaskRecord,
    TrainingRecord,
    Versions,
    results_digest,
    summarise,
)
from glbench.leaderboard import StoredResult
from glbench.leaderboard.entries import Entry, entry_of

TASK = "glbench/Meadow-v1"
MONEY = {"reward": "EUR m-2", "epi": "EUR m-2", "penalty": "EUR m-2"}
CARD = {"name": "x", "authors": ["y"], "licence": "MIT", "information": ["observations"]}


def digest_of(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def make_result(
    agent: str,
    rewards: list[float],
    *,
    task_id: str = TASK,
    task_digest: str = digest_of("meadow"),
    first_seed: int = 666,
    privileged: bool = False,
    crashed: int = 0,
    created: str = "2026-01-01T00:00:00Z",
    sandbox: Literal["bubblewrap", "unsandboxed", "built-in"] | None = "bubblewrap",
    clusters: list[str] | None = None,
    training: dict[str, Any] | None = None,
    recipe: tuple[str, int] | None = None,
    authors: tuple[str, ...] | None = ("y",),
    policy: str | None = None,
    **of_task: Any,
) -> Result:
    """Result with one run a value of ``rewards``; every other metric is the reward divided by 1000. The last ``crashed`` runs failed.

    ``clusters`` are the groups of the runs, ``training`` is the card's table, ``of_task`` what a task of splits and salts states.
    ``recipe`` is the id of a recipe and the seed of the training; without ``authors`` it has no card, and by default its own ``policy``.
    """
    runs = tuple(
        RunResult(
            seed=first_seed + i,
            status="ok" if i < len(rewards) - crashed else "crashed",
            reason=None if i < len(rewards) - crashed else "ValueError: no",
            steps=100 if i < len(rewards) - crashed else 7,
            metrics={name: reward if name == "reward" else reward / 1000 for name in METRIC_NAMES},
            cluster=None if clusters is None else clusters[i],
        )
        for i, reward in enumerate(rewards)
    )
    record = AgentRecord.model_construct(  # unchecked, so that tables can be shown names that no file may have
        name=agent, kind="submission", digest=digest_of(agent), privileged=privileged, information="observations",
        card=None if authors is None or (training is None and recipe is None) else SubmissionCard.model_validate(
            CARD | {"authors": authors} | ({} if training is None else {"training": training})
            | ({} if recipe is None else {"recipe": recipe[0], "seed": recipe[1]})
        ),
        training=None if recipe is None else TrainingRecord(
            recipe=recipe[0], seed=recipe[1], form="sb3", policy=digest_of(policy or f"policy of {agent}")
        ),
    )  # fmt: skip
    return Result(
        task=TaskRecord(id=task_id, digest=task_digest, title="A meadow", steps=100, step_seconds=900.0, **of_task),
        agent=record,
        evaluation=EvaluationRecord(
            runs=len(rewards),
            sandbox=sandbox,
            seeds=tuple(run.seed for run in runs),
            workers=1,
            wall_seconds=1.0,
            steps_per_second=100.0,
            decision_seconds=0.1,
            decision_milliseconds=0.1,
            resumed_at_step=None,
            limits={},
            kernel={"backend": "none"},
        ),
        versions=Versions(glbench="0", model="0", python="0", numpy="0", casadi="0", gymnasium="0"),
        machine=Machine(processor="p", architecture="a", cores=1, system="s"),
        git=None,
        created=created,
        units=UNITS,
        runs=runs,
        summary=summarise(runs),
        results_digest=results_digest(task_digest, record, runs, of_task.get("salt_commitment")),
    )


def make_entry(agent: str, rewards: list[float], **keywords: Any) -> Entry:
    """Entry of one result, see ``make_result``."""
    return entry_of(StoredResult(Path(f"{agent}.json"), make_result(agent, rewards, **keywords)))


def of_another_version(result: Result, lacks: tuple[str, ...], more: dict[str, tuple[str, float]]) -> Result:
    """``result`` as another version would have written it: without the metrics in ``lacks``, and with ``more`` (unit and value)."""
    runs = tuple(
        run.model_copy(
            update={
                "metrics": {name: value for name, value in run.metrics.items() if name not in lacks}
                | {name: value for name, (_, value) in more.items()}
            }
        )
        for run in result.runs
    )
    known = {name: value for name, value in result.summary.mean.items() if name not in lacks}
    mean = known | {name: value for name, (_, value) in more.items()}
    units = {name: unit for name, unit in result.units.items() if name not in lacks}
    changes = {
        "runs": runs,
        "summary": result.summary.model_copy(update={"mean": mean}),
        "units": units | {name: unit for name, (unit, _) in more.items()},
        "results_digest": results_digest(result.task.digest, result.agent, runs),
    }
    return result.model_copy(update=changes)


def result_with(agent: str, epi: list[float], penalty: list[float], rewards: list[float] | None = None, **more: object) -> Result:
    """A result with these profits and penalties, and their differences as rewards unless told otherwise."""
    rewards = rewards or [p - v for p, v in zip(epi, penalty, strict=True)]
    result = make_result(agent, rewards, **more)  # type: ignore[arg-type]
    runs = tuple(
        run.model_copy(update={"metrics": run.metrics | {"epi": p, "penalty": v}})
        for run, p, v in zip(result.runs, epi, penalty, strict=True)
    )
    digest = results_digest(result.task.digest, result.agent, runs, result.task.salt_commitment)
    changes = {"runs": runs, "summary": summarise(runs), "results_digest": digest, "units": result.units | MONEY}
    return result.model_copy(update=changes)


def stored(result: Result) -> StoredResult:
    """The result as if it were read from a file."""
    return StoredResult(Path(f"{result.agent.name}.json"), result)
