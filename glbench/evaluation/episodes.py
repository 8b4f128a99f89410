"""The full episodes of a result: choosing runs, writing them from the trace of the evaluation or by replaying, clearing old ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from glbench.episodes import (
    ActionLog,
    Episode,
    RunFacts,
    Trace,
    chosen_rows,
    episode_path,
    episodes_folder,
    read_log,
    replayed_episodes,
    write_episode,
)
from glbench.errors import EpisodeError
from glbench.evaluation.records import Result, RunResult
from glbench.registration import task_ids
from glbench.tasks import Round, TaskSpec, get_task


def run_facts(runs: Iterable[RunResult]) -> tuple[RunFacts, ...]:
    """The runs as records of episodes name them."""
    return tuple(
        RunFacts(
            seed=run.seed,
            status=run.status,
            reason=run.reason,
            steps=run.steps,
            # The step that could not be simulated belongs to the record: without its action nobody could see that it fails.
            actions=run.steps + (1 if run.status == "simulation_failed" else 0),
        )
        for run in runs
    )


def write_episodes(
    selection: Sequence[str], result: Result, path: Path, task: TaskSpec, log: ActionLog, trace: Trace | None
) -> tuple[Path, ...]:
    """Write the chosen runs of ``result``, which is at ``path``, as full episodes, and return the files.

    Without a trace of the evaluation they are made by replaying the actions, with the same bytes.
    """
    rows = chosen_rows(selection, log.seeds, result.values(task.evaluation.metric))
    return _write(_episodes(task, log, rows, trace), episodes_folder(path))


def make_episodes(
    selection: Sequence[str], result: Result, path: Path, task: TaskSpec, folder: Path | None = None
) -> tuple[Path, ...]:
    """Make the chosen full episodes of a stored result by replaying; those that are there already stay as they are.

    Raises
    ------
    EpisodeError
        When the recorded actions are missing, damaged, or of another result.
    """
    rows = chosen_rows(selection, [run.seed for run in result.runs], result.values(task.evaluation.metric))
    folder = folder or episodes_folder(path)
    files = {row: episode_path(folder, result.runs[row].seed) for row in rows}
    missing = [row for row, file in files.items() if not file.exists()]
    if missing:
        _write(replayed_episodes(task, recorded_actions(result, path), missing), folder)
    return tuple(files.values())


def task_of_result(result: Result, path: Path, sealed: Round | None = None) -> TaskSpec:
    """The task of ``result``: the published one, or a user's own as the record holds it.

    With the secret of a ``sealed`` round it has the draws of that round; without one, the public draws, with which the runs of a sealed
    round cannot be simulated again.

    Raises
    ------
    EpisodeError
        When the result is of another version of the task, or its recorded actions cannot be used.
    """
    task = (
        get_task(result.task.id) if result.task.id in task_ids() else recorded_actions(result, path).task()
    ).scored_in(result.task.split)
    if task.digest != result.task.digest:
        msg = (
            f"{path} is of another version of {task.id} (digest {result.task.digest[:12]}..., here {task.digest[:12]}...): "
            "its actions would lead elsewhere. Evaluate again with --fresh."
        )
        raise EpisodeError(msg)
    return task if sealed is None else task.in_split("test", sealed.secret)


def recorded_actions(result: Result, path: Path) -> ActionLog:
    """The recorded actions that belong to ``result``, which is at ``path``.

    Raises
    ------
    EpisodeError
        When they are missing, damaged, or of another result.
    """
    if result.record is None:
        msg = f"{path} has no recorded actions: it was made by an earlier glbench. Evaluate again with --fresh."
        raise EpisodeError(msg)
    log = read_log(path.with_name(result.record.file))
    if log.digest != result.record.digest:
        msg = (
            f"{result.record.file} does not hold the actions of {path} (digest {log.digest[:12]}..., "
            f"the result names {result.record.digest[:12]}...)."
        )
        raise EpisodeError(msg)
    return log


def forget_episodes(path: Path) -> None:
    """Remove full episodes of an earlier result at ``path``; they would be taken for those of the new one."""
    for file in episodes_folder(path).glob("seed-*.mcap"):
        file.unlink()


def _episodes(task: TaskSpec, log: ActionLog, rows: Sequence[int], trace: Trace | None) -> Iterator[Episode]:
    if trace is None:
        yield from replayed_episodes(task, log, rows) if rows else ()
        return
    for row in rows:
        yield trace.episode(task, row, log.provenance, log.runs[row], log.actions[:, row])


def _write(episodes: Iterable[Episode], folder: Path) -> tuple[Path, ...]:
    paths = []
    for episode in episodes:
        path = episode_path(folder, episode.run.seed)
        write_episode(path, episode)
        paths.append(path)
    return tuple(paths)
