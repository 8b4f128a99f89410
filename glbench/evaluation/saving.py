"""Writing what an evaluation computed, so that no crash and no full disk leaves half of it or loses what was there.

The record (large) is written under another name first, then the result (small) that names its digest, then the record gets its name.
A full disk stops this before anything of an earlier evaluation was touched. After a kill between the last two steps the next
evaluation finds the record under its other name and finishes the renaming.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import filelock

from glbench.episodes import ActionLog, Trace, actions_path, episodes_folder, log_bytes, read_log
from glbench.errors import EpisodeError, GlbenchError, ResultError
from glbench.evaluation.checkpoint import discard
from glbench.evaluation.episodes import forget_episodes, write_episodes
from glbench.evaluation.files import SavingError, ensure_writable, load_result, result_path, save_result, short_task_id
from glbench.evaluation.profiles import profile_path, profiled
from glbench.evaluation.records import RecordReference, Result
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec


@dataclass(frozen=True)
class Computed:
    """What an evaluation computed, before it is saved.

    ``trace`` is what episodes are made from without replaying, if it was kept; ``printed`` what a sandboxed agent printed.
    """

    result: Result
    log: ActionLog
    trace: Trace | None = None
    printed: str = ""


def save(computed: Computed, out: Path, task: TaskSpec, selection: Sequence[str], *, checkpointed: bool) -> Result:
    """Write result, profile, record and the episodes wanted below ``out``; the result as it is saved. Needs the lock of ``alone``.

    ``checkpointed`` says whether there is a checkpoint to go on from.

    Raises
    ------
    SavingError
        When something cannot be written; it has the result and says what is lacking. Where there was no result yet, the result is
        there nevertheless if it fits.
    """
    log = computed.log
    path = result_path(out, task.id, computed.result.agent.name)
    actions, waiting = actions_path(path), _waiting(path)
    result = computed.result.model_copy(update={"record": RecordReference(file=actions.name, digest=log.digest)})
    result, profile = profiled(task, result, path, log, computed.trace)
    lacking = "Nothing of this evaluation is saved"
    try:
        try:
            write_atomically(waiting, log_bytes(log))
        except GlbenchError:
            if not path.exists():
                save_result(result, out)
                lacking = "The result is saved, and not the recorded actions, without which nobody can verify it"
            raise
        save_result(result, out)
        waiting.replace(actions)
        lacking = "The result and its recorded actions are saved, and not all of profile and full episodes"
        write_atomically(profile_path(path), profile.to_bytes())
        forget_episodes(path)
        write_episodes(selection, result, path, task, log, computed.trace)
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
    with (
        contextlib.suppress(GlbenchError),
        result_lock(out, task_id, agent_name),
    ):  # who holds the lock is saving just now
        _finish(path, waiting)


def tidy(out: Path, task_id: str, agent_name: str, checkpoint: Path) -> None:
    """Remove what a kill at the very end of ``save`` left beside a finished result: its ``checkpoint`` and files half written."""
    folder = agent_folder(out, task_id, agent_name)
    if checkpoint.exists() or any(_leftovers(result_path(out, task_id, agent_name), folder)):
        with (
            contextlib.suppress(GlbenchError),
            result_lock(out, task_id, agent_name),
        ):  # who holds the lock is at work just now
            discard(checkpoint)
            with contextlib.suppress(OSError):  # unfinished work with other seeds stays
                folder.rmdir()


@contextlib.contextmanager
def result_lock(out: Path, task_id: str, agent_name: str) -> Iterator[None]:
    """Hold the lock of a result: two processes would write each other's checkpoints. Leftovers of killed processes are removed.

    Raises
    ------
    GlbenchError
        When another process holds it, or the folders cannot be written.
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
        for left in (folder.parent, folder.parent.parent):
            with contextlib.suppress(OSError):
                left.rmdir()


def agent_folder(out: Path, task_id: str, agent_name: str) -> Path:
    """Folder of all checkpoints of an agent on a task."""
    return out / ".partial" / short_task_id(task_id) / agent_name


def _waiting(path: Path) -> Path:
    """Where a record waits for its result."""
    actions = actions_path(path)
    return actions.with_name(f".{actions.name}.waiting")


def _finish(path: Path, waiting: Path) -> None:
    try:
        stored = load_result(path)
        belongs = stored.record is not None and read_log(waiting).digest == stored.record.digest
    except (ResultError, EpisodeError):
        belongs = False
    if belongs:
        waiting.replace(actions_path(path))
    else:
        waiting.unlink(missing_ok=True)


def _leftovers(path: Path, checkpoints: Path) -> Iterator[Path]:
    """Files that a process was writing when it was killed."""
    for name in (path.name, profile_path(path).name, actions_path(path).name, _waiting(path).name):
        yield from path.parent.glob(f".{name}.*.partial")
    yield from path.parent.glob(".can-write-*.partial")
    yield from episodes_folder(path).glob(".seed-*.partial")
    yield from checkpoints.glob("*/.*.partial")
