"""Writing the leaderboard: Markdown for people, LaTeX for papers, CSV, Parquet and JSON for programs."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from glbench.leaderboard.exports import to_json, to_latex
from glbench.leaderboard.ranking import TaskTable
from glbench.leaderboard.suites import SuiteTable
from glbench.leaderboard.tables import to_frame, to_markdown
from glbench.resources import write_atomically


def write_leaderboard(
    tables: Sequence[TaskTable],
    suites: Mapping[str, Sequence[str]],
    out: Path,
    aggregated: Sequence[SuiteTable] = (),
) -> tuple[Path, ...]:
    """Write ``leaderboard.md``, ``.csv``, ``.parquet``, ``.json`` and ``.tex`` into ``out``, each whole or not at all.

    Parameters
    ----------
    tables
        Ranked rows of every task.
    suites
        Task ids by suite, for the overviews.
    out
        The folder.
    aggregated
        Normalised scores over suites.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    GlbenchError
        When the folder cannot be written.
    """
    frame = to_frame(tables)
    parquet = io.BytesIO()
    frame.to_parquet(parquet, index=False)
    contents: dict[str, bytes | str] = {
        "leaderboard.md": to_markdown(tables, suites, aggregated),
        "leaderboard.csv": frame.to_csv(index=False, lineterminator="\n"),
        "leaderboard.parquet": parquet.getvalue(),
        "leaderboard.json": to_json(tables, aggregated),
        "leaderboard.tex": "\n".join(to_latex(table) for table in tables),
    }
    paths = []
    for name, content in contents.items():
        write_atomically(out / name, content)
        paths.append(out / name)
    return tuple(paths)
