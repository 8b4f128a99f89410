"""Fresh draws: a second evaluation with draws from a new secret salt, together with reference agents.

Seeds and code are published, so an agent can carry plans for the published draws of a test, and no sandbox can detect them. It cannot carry
plans for draws that did not exist when it was handed in. Both evaluations give the agent the same task card and number of runs, each in a
new process. The draws are those of a sealed round with one agent (``glbench.tasks.sealed``), whose salt is published with the result.
``glbench.leaderboard.fresh_draws`` computes whether the agent dropped.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

from glbench.episodes import actions_path
from glbench.errors import ResultError, SandboxError, SubmissionError, TaskError, refuse
from glbench.evaluation.evaluation import results_folder
from glbench.evaluation.files import result_path, save_result
from glbench.evaluation.jobs import Job, Options
from glbench.evaluation.records import FreshDraws, RecordReference, ReferenceRuns, Result
from glbench.evaluation.sandbox.choosing import keep_out_of_sight, protect
from glbench.evaluation.saving import result_lock
from glbench.resources import write_atomically
from glbench.tasks import Round, TaskSpec, read_round
from glbench.tasks.sealed import write_round

FOLDER: Final = "fresh-draws"
"""Folder below ``out`` for unfinished evaluations with fresh draws, their salts, and results of the reference agents."""
REFERENCES: Final = ("rule_based_tuned", "rule_based_unlit", "rule_based_energy", "rule_based_fair", "rule_based")
"""Fast rule-based agents in the order in which they are tried: the first ``WANTED`` that fit the task are the reference agents."""
REFERENCE_COUNT: Final = 2

Run = Callable[[Job], Result]  # Does a job, or loads its stored result


def check_fresh_draws(job: Job) -> None:
    """Refuse a job that cannot be evaluated with fresh draws, before any evaluation.

    Raises ``TaskError`` for no test split, another split, or a sealed round, and ``SandboxError`` for an agent without a sandbox.
    """
    task = job.task
    if task.splits is None or "test" not in task.splits.names:
        msg = (
            f"{task.id} has no fresh draws: all its runs share their season, and an agent may know them by heart. "
            "Evaluate it without --fresh-draws."
        )
        raise TaskError(msg)
    if task.split == "validation" or task.sealed:
        other = "the validation split" if task.split == "validation" else "a sealed round"
        refuse(f"Fresh draws are for the public test split, and this is {other}. Evaluate it without --fresh-draws.", TaskError)
    if job.agent.protection == "unsandboxed":
        msg = (
            f"Without a sandbox '{job.agent_name}' could read the salt of the fresh draws. "
            "With --fresh-draws, run submissions with --sandbox bubblewrap."
        )
        raise SandboxError(msg)


def add_fresh_draws(job: Job, run: Run) -> Result:
    """Evaluate the agent of the finished ``job`` again with fresh draws, and save them in its result, which is returned.

    ``job`` has the published draws, and its result is saved; ``run`` does a job and returns its result. Calling it again continues an
    interrupted evaluation. A result that already has fresh draws is returned unchanged. Raises ``GlbenchError`` when an evaluation or a
    file fails, or no reference agent fits the task. Other errors as for ``check_fresh_draws``.
    """
    check_fresh_draws(job)
    evaluation = replace(job, options=replace(job.options, fresh=False)).prepare()
    result = evaluation.stored
    if result is None or evaluation.out is None:
        refuse(f"'{job.agent_name}' has no result on {job.task.id} to which fresh draws can be added. Evaluate it first.", ResultError)
    place = job.options.out.expanduser().resolve() / FOLDER
    file = place / job.task.short_id / f"{job.agent_name}.toml"
    target = fresh_actions_path(result_path(evaluation.out, job.task.id, job.agent_name))
    if result.fresh_draws is not None:  # a kill may have left the evaluation
        file.unlink(missing_ok=True)
        _remove_runs(place, job.task.in_split("test", Round(result.fresh_draws.salt).secret))
        return result
    if target.exists():  # of an earlier result, which may have published the salt
        file.unlink(missing_ok=True)
        target.unlink()
    keep_out_of_sight(file, [job.agent])
    if not file.exists():
        write_round(Round.new(), file)
    salt = read_round(file)
    task = job.task.in_split("test", salt.secret)
    options = replace(job.options, out=place, episodes="none", fresh=False)
    again = replace(job, task=task, options=options)
    fresh = run(again)
    actions = again.prepare().path
    if actions is None or fresh.record is None:
        refuse(f"The evaluation of '{job.agent_name}' with fresh draws has no recorded actions, so it cannot be verified.", ResultError)
    fresh_draws = FreshDraws(
        salt=salt.salt,
        metric=task.evaluation.metric,
        runs=fresh.runs,
        references=_references(job, task, options, run),
        record=RecordReference(file=target.name, digest=fresh.record.digest),
        digest="0" * 64,
    )
    fresh_draws = fresh_draws.model_copy(update={"digest": fresh_draws.computed_digest(result.results_digest)})
    updated = Result(**{name: getattr(result, name) for name in Result.model_fields} | {"fresh_draws": fresh_draws})
    with result_lock(evaluation.out, task.id, job.agent_name):
        write_atomically(target, actions_path(actions).read_bytes())
        file.unlink(missing_ok=True)  # before its salt is public: no later evaluation can use it
        save_result(updated, evaluation.out)
    _remove_runs(place, task)
    return updated


def _remove_runs(place: Path, task: TaskSpec) -> None:
    shutil.rmtree(results_folder(place, task), ignore_errors=True)


def fresh_actions_path(result: Path) -> Path:
    """Path of the recorded actions with fresh draws, ``<agent>.actions.fresh.mcap``, beside ``<agent>.json``."""
    return result.with_name(result.name.removesuffix(".json") + ".actions.fresh.mcap")


def _references(job: Job, task: TaskSpec, options: Options, run: Run) -> tuple[ReferenceRuns, ...]:
    """The reference agents that fit the task, with the draws of ``job`` and with those of ``task``."""
    references: list[ReferenceRuns] = []
    for name in REFERENCES:
        try:
            agent = protect(name, "auto")
            if agent.agent.digest == job.agent.agent.digest:
                continue
            published, fresh = (run(Job(one, name, agent, options)) for one in (job.task, task))
        except SubmissionError:
            continue
        values = [one.values(task.evaluation.metric) for one in (published, fresh)]
        if published.summary.ok:
            references.append(ReferenceRuns(name=name, digest=agent.agent.digest, published=values[0], fresh=values[1]))
        if len(references) == REFERENCE_COUNT:
            break
    if not references:
        msg = f"Fresh draws need a reference agent, and none fits {task.id} ({', '.join(REFERENCES)}). Evaluate it without --fresh-draws."
        raise ResultError(msg)
    return tuple(references)
