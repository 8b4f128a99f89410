"""Full episodes against the record: each belongs to its run, is whole, and has the columns that its actions lead to."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from glbench.episodes import ActionLog, Episode, read_episode
from glbench.errors import EpisodeError
from glbench.verification.comparing import Agreement
from glbench.verification.verdict import cannot_tell, refute


def read_episodes(folder: Path, log: ActionLog, *, wanted: bool) -> list[tuple[int, Episode]]:
    """Full episodes of ``log``'s runs in ``folder``, with the place of their run.

    ``wanted`` is true when the folder was named on purpose: then it must hold some.
    """
    task = log.provenance.task.id.rpartition("/")[2]
    below = folder / task / log.provenance.agent.name
    files = sorted((below if wanted and below.is_dir() else folder).glob("*.mcap"))
    if wanted and not files:
        cannot_tell("no_episodes", f"There are no episodes (*.mcap) in {folder}.")
    found: dict[int, Episode] = {}
    for file in files:
        episode = _read(file)
        row = _place(file, episode, log)
        if row in found:
            refute("swapped_episode", f"{file} is a second episode of the run with seed {episode.run.seed}.")
        found[row] = episode
    return sorted(found.items(), key=lambda pair: pair[0])


def _read(file: Path) -> Episode:
    try:
        return read_episode(file)
    except EpisodeError as error:
        refute("damaged_episode", f"A full episode cannot be used. {error}")


def _place(file: Path, episode: Episode, log: ActionLog) -> int:
    """Row of the run that the episode is of."""
    run = episode.run
    named = re.fullmatch(r"seed-(\d+)", file.stem)
    if run.seed not in log.seeds or (named is not None and int(named[1]) != run.seed):
        refute(
            "swapped_episode",
            f"{file} holds the run with seed {run.seed}, which is not the one that it is named after.",
        )
    if episode.provenance != log.provenance:
        what = "task" if episode.provenance.task != log.provenance.task else "agent"
        reason = (
            f"{file} is an episode of another evaluation: its {what}, kernel or versions are not those of the result."
        )
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


def compare_episode(found: Agreement, episode: Episode, replayed: Episode) -> Agreement:
    """Compare every column of a recorded episode with the one simulated again."""
    where = f"episode of seed {episode.run.seed}"
    if [group.columns for group in episode.groups] != [group.columns for group in replayed.groups]:
        refute("episode_columns", f"The {where} has other columns or units than this glbench records.")
    if (episode.times != replayed.times).any():
        step = int(np.flatnonzero(episode.times != replayed.times)[0])
        refute(
            "episode_time", f"The {where} has {episode.times[step]} as time {step}, the task {replayed.times[step]}."
        )
    if episode.tables["action"].tobytes() != replayed.tables["action"].tobytes():
        same = (episode.tables["action"] == replayed.tables["action"]).all(axis=1)
        step = int(np.flatnonzero(~same)[0]) if not same.all() else 0
        refute("episode_action", f"The {where} has another action in step {step + 1} than the record of the result.")
    for group in episode.groups:
        for_start = f"{where} at the start"
        if group.name in episode.start:
            found = found.add(
                "episode",
                episode.start[group.name][np.newaxis],
                replayed.start[group.name][np.newaxis],
                group.names,
                for_start,
            )
        found = found.add(
            "episode", episode.tables[group.name], np.ascontiguousarray(replayed.tables[group.name]), group.names, where
        )
    return found
