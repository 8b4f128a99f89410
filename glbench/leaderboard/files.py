"""Writing the leaderboard: Markdown for people, CSV and Parquet for programs."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from glbench.leaderboard.ranking import TaskTable
from glbench.leaderboard.tables import to_frame, to_markdown
from glbench.resources import write_atomically


def write_leaderboard(tables: Sequence[TaskTable], suites: Mapping[str, Sequence[str]], out: Path) -> tuple[Path, ...]:
    """Write ``leaderboard.md``, ``.csv`` and ``.parquet`` into ``out``, each whole or not at all, and return their paths.

    Raises
    ------
    GlbenchError
        When the folder cannot be written.
    """
    frame = to_frame(tables)
    parquet = io.BytesIO()
    frame.to_parquet(parquet, index=False)
    contents: dict[str, bytes | str] = {
        "leaderboard.md": to_markdown(tables, suites),
        "leaderboard.csv": frame.to_csv(index=False, lineterminator="\n"),
        "leaderboard.parquet": parquet.getvalue(),
    }
    paths = []
    for name, content in contents.items():
        write_atomically(out / name, content)
        paths.append(out / name)
    return tuple(paths)
