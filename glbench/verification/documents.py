"""Checks before anything is simulated: result, record, task and full episodes have to belong together."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from glbench.episodes import ActionLog, Episode, read_episode, read_log
from glbench.episodes.header import PARTS, task_of
from glbench.errors import EpisodeError, GlbenchError, ResultError, TaskError
from glbench.evaluation import Result
from glbench.evaluation.files import load_with_bytes
from glbench.evaluation.metrics import with_missing_steps
from glbench.evaluation.saving import run_facts
from glbench.registration import task_ids
from glbench.resources import data_folder, is_released
from glbench.tasks import Round, TaskSpec, get_task
from glbench.tasks.digest import PROSE
from glbench.verification.proof import Agreement, cannot_tell, refute

_MOST_STEPS = 600_000
"""Of a task that a record brings along: a year of minutes has 525,600, and a task takes memory for the weather of each step."""


def read_result(path: Path) -> tuple[Result, bytes]:
    """The result and the bytes of its file, or the verdict on a file that is none."""
    try:
        return load_with_bytes(path)
    except ResultError as error:
        if isinstance(error.__cause__, ValidationError):
            refute("inconsistent", f"The result contradicts itself. {error}")
        if isinstance(error.__cause__, ValueError) and not isinstance(error.__cause__, UnicodeError):  # no JSON
            refute("inconsistent", str(error))
        cannot_tell("no_result", str(error))


def read_record(path: Path, result: Result) -> ActionLog:
    """The recorded actions of ``result``, after everything that can be compared without simulating."""
    if result.record is None:
        cannot_tell("no_record", "The result names no recorded actions. Evaluate again with `glbench evaluate --fresh`.")
    file = path.with_name(result.record.file)
    if not file.exists():
        remedy = "Put the file back beside the result."
        if is_released(path):
            name, task = result.agent.name, result.task.id
            ref = name if result.agent.kind == "baseline" else f"submissions/{name}"
            if (data_folder("submissions") / f"{name}.py").is_file():
                ref += ".py"
            remedy = (
                f"Released results come without them. Evaluate the agent again with `glbench evaluate {ref} --task {task} --fresh "
                f"--out again`; `glbench leaderboard --task {task} --out again` then says whether it is the same as the released one."
            )
        cannot_tell("no_record", f"The recorded actions {file} are not there. {remedy}")
    try:
        log = read_log(file)
    except EpisodeError as error:
        if isinstance(error.__cause__, TaskError) and result.task.id not in task_ids():  # its model may be registered elsewhere
            cannot_tell("no_task", str(error))
        refute("damaged_record", f"The recorded actions cannot be used. {error}")
    _same_evaluation(result, log)
    _same_runs(result, log)
    if log.digest != result.record.digest:
        reason = (
            f"The content of {file.name} is not what the result was made from: its digest is {log.digest[:12]}..., the result "
            f"names {result.record.digest[:12]}.... Actions, rewards or final states were changed."
        )
        refute("record_digest", reason)
    return log


def _same_evaluation(result: Result, log: ActionLog) -> None:
    """The record is of the result's task, agent, kernel and versions."""
    task, agent = log.provenance.task, log.provenance.agent
    if (task.id, task.digest) != (result.task.id, result.task.digest):
        reason = (
            f"The recorded actions are of the task {task.id} (digest {task.digest[:12]}...), the result of {result.task.id} "
            f"(digest {result.task.digest[:12]}...)."
        )
        refute("record_of_other_task", reason)
    if task.salt_commitment != result.task.salt_commitment:
        recorded, claimed = (
            "public draws" if one is None else f"the draws of the sealed round {one[:12]}..."
            for one in (task.salt_commitment, result.task.salt_commitment)
        )
        refute("record_of_other_round", f"The recorded actions are of {recorded}, the result says {claimed}.")
    if (task.title, task.steps, task.step_seconds) != (result.task.title, result.task.steps, result.task.step_seconds):
        refute("record_of_other_task", "Title, steps or step length of the task differ between the record and the result.")
    for name in ("name", "kind", "digest", "privileged", "information"):
        recorded, claimed = getattr(agent, name), getattr(result.agent, name)
        if recorded != claimed:
            reason = f"The recorded actions are of another agent: its {name} is {recorded!r}, the result says {claimed!r}."
            refute("record_of_other_agent", reason)
    if agent.acts == "controls" and not agent.privileged:
        refute("privileged", "The agent set controls and says that it is not privileged. Only the privileged set controls.")
    if log.provenance.kernel != result.evaluation.kernel:
        refute("other_kernel", "The record was made with another kernel than the result says.")
    versions = result.versions.model_dump()
    for name, number in log.provenance.versions.items():
        if versions.get(name) != number:
            refute("other_versions", f"The record was made with {name} {number}, the result says {versions.get(name)}.")


def _same_runs(result: Result, log: ActionLog) -> None:
    """The record has the result's runs: none dropped, none added, none shortened."""
    seeds, recorded = [run.seed for run in result.runs], list(log.seeds)
    if seeds != recorded:
        dropped = sorted(set(recorded) - set(seeds))
        missing = sorted(set(seeds) - set(recorded))
        if dropped and not missing:
            refute("dropped_run", f"The result leaves out {_seeds(dropped)} of the {len(recorded)} runs that were made.")
        if missing and not dropped:
            refute("missing_run", f"The recorded actions lack {_seeds(missing)} of the result's {len(seeds)} runs.")
        refute("seeds", f"The result's runs have the seeds {seeds}, the recorded ones {recorded}.")
    for expected, run in zip(run_facts(result.runs), log.runs, strict=True):
        if run.steps != expected.steps:
            refute("shortened", f"The record of the run with seed {run.seed} has {run.steps} steps, the result says {expected.steps}.")
        if run != expected:
            reason = (
                f"The run with seed {run.seed} is '{expected.status}' ({expected.reason or 'no reason'}) in the result and "
                f"'{run.status}' ({run.reason or 'no reason'}) in the record."
            )
            refute("status", reason)


def find_task(result: Result, log: ActionLog, file: Path | None) -> TaskSpec:
    """The task of the result, of the very version that it was made on."""
    published = result.task.id in task_ids()
    if published and file is not None:
        cannot_tell("no_task", f"{result.task.id} is published, and is verified as published. Leave out --task.")
    try:
        own = task_of(log.definition) if file is None and not published else None
        if own is not None and own.steps > _MOST_STEPS:
            cannot_tell("no_task", f"The task in the record has {own.steps:,} steps, more than {_MOST_STEPS:,}. Give its file with --task.")
        task = (own or get_task(result.task.id if published or file is None else file)).scored_in(result.task.split)
        fingerprint = task.fingerprint()
    except EpisodeError as error:
        refute("definition", str(error))
    except GlbenchError as error:
        cannot_tell("no_task", f"The task {result.task.id} is not available here: {error}")
    if task.id != result.task.id:
        cannot_tell("no_task", f"{file} defines the task {task.id}, the result is of {result.task.id}.")
    parts = {name: getattr(fingerprint, name) for name in PARTS}
    if fingerprint.digest != result.task.digest:
        differing = [name for name in PARTS if log.provenance.task.parts.get(name) != parts[name]]
        what = f" What differs: {', '.join(differing)}." if differing else ""
        where = "the published task" if published else "the task's definition in the record"
        reason = (
            f"The result is of another version of {result.task.id} (digest {result.task.digest[:12]}...) than {where}.{what} "
            "Evaluate the agent again on the task as it is."
        )
        refute("other_task_version", reason)
    if log.provenance.task.parts != parts or log.provenance.task.start != task.weather.start.isoformat():
        refute("record_of_other_task", "The record names digests of the task's parts, or a first day, that are not the task's.")
    recorded, defined = ({k: v for k, v in one.attachment().items() if k not in PROSE} for one in (task_of(log.definition), task))
    if recorded != defined:
        refute("definition", f"The task definition in the record is not that of {task.id}.")
    facts, claims = (task.title, task.steps, task.step_seconds), result.task
    if facts != (claims.title, claims.steps, claims.step_seconds):
        refute("task_facts", f"The task's title, steps or step length are not those of {task.id}.")
    years = None if claims.salt_commitment is not None else task.season_years
    if (claims.split, claims.years) != (task.split, years):
        refute("task_facts", f"The split or the years of the seasons are not those of {task.id}.")
    return task


def with_its_draws(result: Result, task: TaskSpec, secret_round: Round | None) -> TaskSpec:
    """``task`` with the draws that the result says it has: those of ``secret_round``, or without a round public ones.

    A result of another round, or of none, is refused: who names a round asks whether the result is of that round.
    """
    commitment = result.task.salt_commitment
    if commitment is not None and "test" not in (task.splits.names if task.splits is not None else ()):
        refute("sealed", f"The result says that its draws are sealed, and {task.id} has no test split that could be.")
    if secret_round is None:
        return task
    if commitment is None:
        cannot_tell(
            "other_round",
            f"The result names no commitment, so it is not of the round {secret_round.commitment}. Its draws are public: verify it without "
            "--round.",
        )
    if commitment != secret_round.commitment:
        reason = (
            f"The result is of the round {commitment}, and the secret given is that of {secret_round.commitment}: this is the wrong file, "
            "or the commitment in the result was changed."
        )
        cannot_tell("other_round", reason)
    try:
        sealed = task.in_split("test", secret_round.secret)
        sealed.season_record()
    except GlbenchError as error:
        cannot_tell("no_weather", f"The round's draws cannot be made here: {error}")
    return sealed


def check_sums(result: Result, log: ActionLog, task: TaskSpec) -> None:
    """The reward of a run is the sum of its recorded rewards and the price of missing steps: the same bits on every machine."""
    for row, run in enumerate(result.runs):
        total = float(np.add.accumulate(np.append(0.0, log.rewards[: run.steps, row]))[-1])
        expected = with_missing_steps({"reward": total}, task.steps - run.steps, {"reward": task.evaluation.failed_step.reward})
        if run.metrics["reward"] != expected["reward"]:
            reason = (
                f"The run with seed {run.seed} has the reward {run.metrics['reward']!r} in the result; its recorded rewards add up "
                f"to {expected['reward']!r}."
            )
            refute("metric", reason)


def check_seeds(result: Result, task: TaskSpec) -> tuple[str, ...]:
    """Notes on the seeds; a hole in them means that a run was taken out."""
    seeds, scored = result.evaluation.seeds, tuple(task.evaluation.seeds)
    if seeds == scored:
        return ()
    holes = sorted(set(range(seeds[0], seeds[0] + len(seeds))) - set(seeds))
    if holes:
        refute("dropped_run", f"The seeds are not consecutive: {_seeds(holes)} is missing. Evaluations leave no run out.")
    return (
        f"This is a trial of {len(seeds)} run{'s' * (len(seeds) > 1)} from seed {seeds[0]}; the task asks for {len(scored)} "
        f"from seed {scored[0]}. It is not ranked.",
    )


def check_setting(result: Result, log: ActionLog, task: TaskSpec) -> None:
    """Scores are made with the reference preset, for the task's step and equations, and with actions for its controls."""
    agent = log.provenance.agent
    columns = task.model_value.control_names if agent.acts == "controls" else tuple(action.name for action in task.actions)
    if agent.columns != columns:
        refute("record_of_other_task", f"The recorded actions are of {', '.join(agent.columns)}, the task's of {', '.join(columns)}.")
    kernel = result.evaluation.kernel
    required = {"preset": "reference", "step_seconds": task.step_seconds, "variant": task.model.variant}
    for name, value in required.items():
        if kernel.get(name) != value:
            refute("other_kernel", f"The result was made with a kernel whose {name} is {kernel.get(name)!r}, not {value!r}.")


def _seeds(seeds: list[int]) -> str:
    return f"the {'seed' if len(seeds) == 1 else 'seeds'} {', '.join(map(str, seeds[:5]))}{' ...' if len(seeds) > 5 else ''}"


def read_episodes(folder: Path, log: ActionLog, *, required: bool) -> list[tuple[int, Episode]]:
    """Full episodes of ``log``'s runs in ``folder``, with the place of their run.

    ``required`` is true when the folder was named on purpose: then it must hold some.
    """
    task = log.provenance.task.id.rpartition("/")[2]
    below = folder / task / log.provenance.agent.name
    files = sorted((below if required and below.is_dir() else folder).glob("*.mcap"))
    if required and not files:
        cannot_tell("no_episodes", f"There are no episodes (*.mcap) in {folder}.")
    episodes: dict[int, Episode] = {}
    for file in files:
        try:
            episode = read_episode(file)
        except EpisodeError as error:
            refute("damaged_episode", f"A full episode cannot be used. {error}")
        row = _place(file, episode, log)
        if row in episodes:
            refute("swapped_episode", f"{file} is a second episode of the run with seed {episode.run.seed}.")
        episodes[row] = episode
    return sorted(episodes.items(), key=lambda pair: pair[0])


def _place(file: Path, episode: Episode, log: ActionLog) -> int:
    """Row of the run that the episode is of."""
    run = episode.run
    named = re.fullmatch(r"seed-(\d+)", file.stem)
    if run.seed not in log.seeds or (named is not None and int(named[1]) != run.seed):
        refute("swapped_episode", f"{file} holds the run with seed {run.seed}, which is not the one that it is named after.")
    if episode.provenance != log.provenance:
        what = "task" if episode.provenance.task != log.provenance.task else "agent"
        reason = f"{file} is an episode of another evaluation: its {what}, kernel or versions are not those of the result."
        refute("swapped_episode", reason)
    row = log.seeds.index(run.seed)
    if not episode.complete:
        refute("shortened_episode", f"{file} holds {episode.steps} of the {log.runs[row].steps} steps of its run.")
    if run != log.runs[row]:
        recorded = log.runs[row]
        reason = (
            f"{file} says that its run is '{run.status}' after {run.steps} steps; the record says "
            f"'{recorded.status}' after {recorded.steps}."
        )
        refute("shortened_episode" if run.steps < log.runs[row].steps else "status", reason)
    return row


def compare_episode(agreement: Agreement, episode: Episode, replayed: Episode) -> Agreement:
    """Compare every column of a recorded episode with the one simulated again."""
    where = f"episode of seed {episode.run.seed}"
    if [group.columns for group in episode.groups] != [group.columns for group in replayed.groups]:
        refute("episode_columns", f"The {where} has other columns or units than this glbench records.")
    if (episode.times != replayed.times).any():
        step = int(np.flatnonzero(episode.times != replayed.times)[0])
        refute("episode_time", f"The {where} has {episode.times[step]} as time {step}, the task {replayed.times[step]}.")
    if episode.tables["action"].tobytes() != replayed.tables["action"].tobytes():
        same = (episode.tables["action"] == replayed.tables["action"]).all(axis=1)
        step = int(np.flatnonzero(~same)[0]) if not same.all() else 0
        refute("episode_action", f"The {where} has another action in step {step + 1} than the record of the result.")
    for group in episode.groups:
        for_start = f"{where} at the start"
        if group.name in episode.start:
            agreement = agreement.add(
                "episode", episode.start[group.name][np.newaxis], replayed.start[group.name][np.newaxis], group.names, for_start
            )
        agreement = agreement.add(
            "episode", episode.tables[group.name], np.ascontiguousarray(replayed.tables[group.name]), group.names, where
        )
    return agreement
