"""Profiles of results that were made without one: by replaying their recorded actions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from glbench.episodes.recorder import check_round
from glbench.errors import EpisodeError
from glbench.evaluation.episodes import recorded_actions, task_of_result
from glbench.evaluation.profiles import load_profile, make_profile, profile_path
from glbench.kernel import make_kernel
from glbench.leaderboard import StoredResult
from glbench.resources import write_atomically


@dataclass(frozen=True)
class Completion:
    """Profiles that were ``made``, and results that cannot have one here, with the reason."""

    made: tuple[Path, ...]
    impossible: tuple[tuple[Path, str], ...]


def complete_profiles(
    stored: Iterable[StoredResult], workers: int = 1, progress: Callable[[Path], None] | None = None
) -> Completion:
    """Make the profiles that are missing; results stay as they are. ``progress`` is called with each result that is replayed.

    Raises
    ------
    GlbenchError
        When a profile cannot be written, or one that is there was changed.
    """
    made, impossible = [], []
    for item in stored:
        if load_profile(item.result, item.path) is not None:
            continue
        try:
            task = task_of_result(item.result, item.path)
            log = recorded_actions(item.result, item.path)
            check_round(task, log.provenance)
        except EpisodeError as error:
            impossible.append((item.path, str(error)))
            continue
        if progress is not None:
            progress(item.path)
        with make_kernel(task.model_value, task.step_seconds, workers=workers) as kernel:
            profile = make_profile(task, item.result, log, None, kernel)
        write_atomically(profile_path(item.path), profile.to_bytes())
        made.append(profile_path(item.path))
    return Completion(tuple(made), tuple(impossible))
