"""Making a whole file of what a killed writer left."""

from __future__ import annotations

import io
from pathlib import Path

from glbench.episodes.episode import Episode
from glbench.episodes.reading import read_episode
from glbench.episodes.writing import write_into
from glbench.resources import write_atomically

REMARK = "glbench recovery"


def recover(path: Path | str, out: Path | str) -> Episode:
    """Write what can be read of ``path`` to ``out`` and return it. The new file says how many steps it lacks.

    Raises
    ------
    EpisodeError
        When nothing can be read.
    GlbenchError
        When ``out`` cannot be written.
    """
    episode = read_episode(path, partial=True)
    buffer = io.BytesIO()
    words = {"steps": str(episode.steps), "of": str(episode.run.steps), "problem": episode.problem or "none"}
    write_into(buffer, episode, {REMARK: words})
    write_atomically(Path(out), buffer.getvalue())
    return episode
