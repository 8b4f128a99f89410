"""Writing what an evaluation computed, and reading it again: results, recorded actions, profiles, full episodes, recordings.

No crash and no full disk leaves half of it or loses an earlier result. The record (large) is written under another name first, then the
result (small) that names its digest, then the record gets its name. A full disk stops this before anything of an earlier evaluation was
touched. After a kill between the last two steps the next evaluation finds the record under its other name and finishes the renaming.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import filelock
import numpy as np

from glbench import episodes
from glbench.agents.identity import CARD_FILE
from glbench.agents.plans import Recording
from glbench.errors import EpisodeError, GlbenchError, ResultError, TaskError, refuse
from glbench.evaluation.checkpoint import discard
from glbench.evaluation.files import SavingError, ensure_writable, load_result, result_path, save_result, short_task_id
from glbench.evaluation.profiles import load_profile, make_profile, profile_path, profiled
from glbench.evaluation.records import RecordReference, Result, RunResult
from glbench.registration import task_argument, task_ids
from glbench.resources import write_atomically
from glbench.tasks import Round, TaskSpec, get_task, task_card


@dataclass(frozen=True)
class Computed:
    """What an evaluation computed, before it is saved.

    ``trace`` is what episodes are made from without replaying, if it was kept; ``printed`` what a sandboxed agent printed.
    """

    result: Result
    log: episodes.ActionLog
    trace: episodes.Trace | None = None
    printed: str = ""


def save(computed: Computed, out: Path, task: TaskSpec, selection: Sequence[str], *, checkpointed: bool) -> Result:
    """Write result, profile, record and the episodes wanted below ``out``; the result as it is saved. Needs the lock of ``alone``.

    ``checkpointed`` says whether there is a checkpoint to go on from. Raises ``SavingError`` when something cannot be written; it has the
    result and says what is lacking. Where there was no result yet, the result is there nevertheless if it fits.
    """
    log = computed.log
    path = result_path(out, task.id, computed.result.agent.name)
    actions, waiting = episodes.actions_path(path), _waiting(path)
    result = computed.result.model_copy(update={"record": RecordReference(file=actions.name, digest=log.digest)})
    result, profile = profiled(task, result, path, log, computed.trace)
    lacking = "Nothing of this evaluation is saved"
    try:
        try:
            write_atomically(waiting, episodes.log_bytes(log))
        except GlbenchError:
            if not path.exists():
                save_result(result, out)
                lacking = "The result is saved, and not the recorded actions, without which nobody can verify it"
            raise
        own = episodes.episodes_folder(path)
        for file in own.glob("seed-*.mcap"):  # of an earlier result: they would be taken for those of the new one
            file.unlink()
        save_result(result, out)
        waiting.replace(actions)
        lacking = "The result and its recorded actions are saved, and not all of profile and full episodes"
        write_atomically(profile_path(path), profile.to_bytes())
        rows, trace = episodes.chosen_rows(selection, log.seeds, result.values(task.evaluation.metric)), computed.trace
        if trace is not None:
            _write((trace.episode(task, row, log.provenance, log.runs[row], log.actions[:, row]) for row in rows), own)
        elif rows:  # by replaying the actions, with the same bytes
            _write(episodes.replayed_episodes(task, log, rows), own)
    except (GlbenchError, OSError) as error:
        if actions.is_file() and result.record is not None:
            again = "makes what is missing"
        else:
            again = "continues from the last checkpoint" if checkpointed else "evaluates again"
        msg = f"{error}\n{lacking}: free some space; the same command then {again}."
        raise SavingError(msg, result) from error
    return result


def settle(out: Path, task_id: str, agent_name: str) -> None:
    """Finish or undo what a kill in the middle of ``save`` left; nothing to do but in that case."""
    path = result_path(out, task_id, agent_name)
    waiting = _waiting(path)
    if not waiting.exists():
        return
    with contextlib.suppress(GlbenchError), result_lock(out, task_id, agent_name):  # who holds the lock is saving just now
        try:
            stored = load_result(path)
            belongs = stored.record is not None and episodes.read_log(waiting).digest == stored.record.digest
        except (ResultError, EpisodeError):
            belongs = False
        if belongs:
            waiting.replace(episodes.actions_path(path))
        else:
            waiting.unlink(missing_ok=True)


def tidy(out: Path, task_id: str, agent_name: str, checkpoint: Path) -> None:
    """Remove what a kill at the very end of ``save`` left beside a finished result: its ``checkpoint`` and files half written."""
    folder = agent_folder(out, task_id, agent_name)
    if checkpoint.exists() or any(_leftovers(result_path(out, task_id, agent_name), folder)):
        with contextlib.suppress(GlbenchError), result_lock(out, task_id, agent_name):  # who holds the lock is at work just now
            discard(checkpoint)
            with contextlib.suppress(OSError):  # unfinished work with other seeds stays
                folder.rmdir()


@contextlib.contextmanager
def result_lock(out: Path, task_id: str, agent_name: str) -> Iterator[None]:
    """Hold the lock of a result: two processes would write each other's checkpoints. Leftovers of killed processes are removed.

    Raises ``GlbenchError`` when another process holds it, or the folders cannot be written.
    """
    folder = agent_folder(out, task_id, agent_name)
    path = result_path(out, task_id, agent_name)
    ensure_writable(path.parent)
    ensure_writable(folder.parent)
    lock = filelock.FileLock(folder.with_name(f"{folder.name}.lock"), blocking=False)
    try:
        lock.acquire()
    except filelock.Timeout as error:
        msg = (
            f"Another glbench process is evaluating '{agent_name}' on {task_id} into {out}. "
            "Wait for it, or choose another folder with --out."
        )
        raise GlbenchError(msg) from error
    try:
        for leftover in _leftovers(path, folder):
            leftover.unlink(missing_ok=True)
        yield
    finally:
        # Removed while it is held, so that nobody else's is; folders that others use are not empty and stay.
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()
        for parent in (folder.parent, folder.parent.parent):
            with contextlib.suppress(OSError):
                parent.rmdir()


def agent_folder(out: Path, task_id: str, agent_name: str) -> Path:
    """Folder of all checkpoints of an agent on a task."""
    return out / ".partial" / short_task_id(task_id) / agent_name


def _waiting(path: Path) -> Path:
    """Where a record waits for its result."""
    actions = episodes.actions_path(path)
    return actions.with_name(f".{actions.name}.waiting")


def _leftovers(path: Path, checkpoints: Path) -> Iterator[Path]:
    """Files that a process was writing when it was killed."""
    for name in (path.name, profile_path(path).name, episodes.actions_path(path).name, _waiting(path).name):
        yield from path.parent.glob(f".{name}.*.partial")
    yield from path.parent.glob(".can-write-*.partial")
    yield from episodes.episodes_folder(path).glob(".seed-*.partial")
    yield from checkpoints.glob("*/.*.partial")


def run_facts(runs: Iterable[RunResult]) -> tuple[episodes.RunFacts, ...]:
    """The runs as records of episodes name them."""
    return tuple(
        episodes.RunFacts(
            seed=run.seed,
            status=run.status,
            reason=run.reason,
            steps=run.steps,
            # The step that could not be simulated belongs to the record: without its action nobody could see that it fails.
            actions=run.steps + (1 if run.status == "simulation_failed" else 0),
        )
        for run in runs
    )


def make_episodes(selection: Sequence[str], result: Result, path: Path, task: TaskSpec, folder: Path | None = None) -> tuple[Path, ...]:
    """Make the chosen full episodes of a stored result by replaying; those that are there already stay as they are.

    Raises ``EpisodeError`` when the recorded actions are missing, damaged, or of another result, or when ``folder`` already holds an
    episode of another evaluation under the same name.
    """
    rows = episodes.chosen_rows(selection, [run.seed for run in result.runs], result.values(task.evaluation.metric))
    own = episodes.episodes_folder(path)
    files = {row: episodes.episode_path(folder or own, result.runs[row].seed) for row in rows}
    present = [file for file in files.values() if file.exists()]
    if folder not in (None, own) and present:  # in its own folder are those of this evaluation
        provenance = recorded_actions(result, path).provenance
        for file in present:
            if episodes.read_episode(file).provenance != provenance:
                refuse(f"{file} is an episode of another evaluation. Choose another folder with --to, or remove it.", EpisodeError)
    missing = [row for row, file in files.items() if file not in present]
    if missing:
        _write(episodes.replayed_episodes(task, recorded_actions(result, path), missing), folder or own)
    return tuple(files.values())


def task_of_result(result: Result, path: Path, sealed: Round | None = None) -> TaskSpec:
    """The task of ``result``: the published one, or a user's own as the record holds it.

    With the secret of a ``sealed`` round it has the draws of that round; without one, the public draws, with which the runs of a sealed
    round cannot be simulated again. Raises ``EpisodeError`` when it is of another version of the task, or its actions cannot be used.
    """
    task = get_task(result.task.id) if result.task.id in task_ids() else recorded_actions(result, path).task()
    task = in_its_split(task, result, path)
    if task.digest != result.task.digest:
        msg = (
            f"{path} is of another version of {task.id} (digest {result.task.digest[:12]}..., here {task.digest[:12]}...): "
            "its actions would lead elsewhere. Evaluate again with --fresh."
        )
        raise EpisodeError(msg)
    return task if sealed is None else task.in_split("test", sealed.secret)


def in_its_split(task: TaskSpec, result: Result, path: Path) -> TaskSpec:
    """``task`` in the split that ``result``, at ``path``, names. Raises ``EpisodeError`` when there is none."""
    try:
        return task.scored_in(result.task.split)
    except TaskError as error:
        refuse(f"{path} cannot be simulated again: {error}", EpisodeError, error)


def complete_profile(result: Result, path: Path, task: TaskSpec) -> None:
    """Make the profile that a result names and that is missing or damaged; errors as of ``Evaluation.complete``."""
    if result.profile is None or not episodes.actions_path(path).exists():
        return
    with contextlib.suppress(ResultError):
        if load_profile(result, path) is not None:
            return
    profile = make_profile(task, result, recorded_actions(result, path), None)
    if profile.digest != result.profile.digest:
        refuse(f"The profile that {path} names cannot be made again here: evaluate again with --fresh.", ResultError)
    write_atomically(profile_path(path), profile.to_bytes())


def recorded_actions(result: Result, path: Path) -> episodes.ActionLog:
    """The recorded actions of ``result``, at ``path``. Raises ``EpisodeError`` when they are missing, damaged, or of another one."""
    if result.record is None:
        refuse(f"{path} has no recorded actions: it was made by an earlier glbench. Evaluate again with --fresh.", EpisodeError)
    log = episodes.read_log(path.with_name(result.record.file))
    if log.digest != result.record.digest:
        msg = (
            f"{result.record.file} does not hold the actions of {path} (digest {log.digest[:12]}..., "
            f"the result names {result.record.digest[:12]}...)."
        )
        raise EpisodeError(msg)
    return log


def _write(records: Iterable[episodes.Episode], folder: Path) -> None:
    for episode in records:
        episodes.write_episode(episodes.episode_path(folder, episode.run.seed), episode)


ACTIONS_FILE = "actions.npz"


def write_recording(result: Path, seed: int, folder: Path) -> Recording:
    """Write the actions of the run with ``seed`` of the stored ``result`` as an agent into the new folder ``folder``.

    Raises ``EpisodeError`` when the run is missing or failed, its record is damaged or missing, it sets controls, or ``folder`` has files.
    """
    loaded = load_result(result)
    log = recorded_actions(loaded, result)
    agent, card = log.provenance.agent, task_card(task_of_result(loaded, result))
    if agent.acts != "actions":
        msg = f"{agent.name} sets controls directly and takes no actions that another agent could replay. Record an agent that acts."
        raise EpisodeError(msg)
    if seed not in log.seeds:
        refuse(f"{result} has no run with seed {seed}. Its seeds: {', '.join(str(one) for one in log.seeds)}.", EpisodeError)
    row = log.seeds.index(seed)
    run = log.runs[row]
    if run.status != "ok":
        refuse(f"The run with seed {seed} of {result} failed ({run.reason}). Record one that did not.", EpisodeError)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        refuse(f"{folder} is there already. Choose another folder with --out.", EpisodeError)
    recording = Recording(
        actions=log.actions[: run.actions, row].astype(np.float32),
        names=card.action_names,
        low=tuple(action.low for action in card.actions),
        high=tuple(action.high for action in card.actions),
        actuation=card.actuation,
        about={"agent": agent.name, "agent_digest": agent.digest, "task": loaded.task.id, "task_digest": loaded.task.digest, "seed": seed},
    )
    write_atomically(folder / ACTIONS_FILE, recording.to_bytes())
    text = {
        "title": f"Recording of {agent.name}, seed {seed}",
        "controller": "recording",
        "settings": ACTIONS_FILE,
        "description": f"The actions that {agent.name} took in the run with seed {seed} of {loaded.task.id}, replayed without looking at "
        f"any observation. What it earns beside {agent.name} tells what feedback is worth there.",
        "made": f"glbench evaluate {agent.name} --task {task_argument(loaded.task.id)} --seed {seed} --runs 1, then "
        f"glbench episodes recording RESULT --run {seed}",
    }
    # A string of JSON is one of TOML; names come from a result, which may be a stranger's.
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in text.items()]
    write_atomically(folder / CARD_FILE, "".join(lines) + "sources = []\n")
    return recording
