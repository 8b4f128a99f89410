"""Writing the leaderboard: Markdown for people, LaTeX for papers, CSV, Parquet and JSON for programs."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from glbench.leaderboard.escaping import cell_text
from glbench.leaderboard.exports import to_json, to_latex
from glbench.leaderboard.ranking import TaskTable
from glbench.leaderboard.suite_views import suite_frame, suite_latex, suite_markdown
from glbench.leaderboard.suites import SuiteTable
from glbench.leaderboard.tables import to_frame, to_markdown
from glbench.resources import write_atomically

if TYPE_CHECKING:
    import pandas as pd


def write_leaderboard(
    tables: Sequence[TaskTable],
    suites: Mapping[str, Sequence[str]],
    out: Path,
    aggregated: Sequence[SuiteTable] = (),
) -> tuple[Path, ...]:
    """Write ``leaderboard.md``, ``.csv``, ``.parquet``, ``.json`` and ``.tex`` into ``out``, each whole or not at all.

    With suites, ``leaderboard.suites.csv`` and ``.parquet`` hold one row an entry and suite.

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
    contents: dict[str, bytes | str] = {
        "leaderboard.md": to_markdown(tables, suites, {table.suite: suite_markdown(table) for table in aggregated}),
        "leaderboard.json": to_json(tables, aggregated),
        "leaderboard.tex": "\n".join([*map(to_latex, tables), *map(suite_latex, aggregated)]),
        **_of_frame("leaderboard", to_frame(tables)),
        **(_of_frame("leaderboard.suites", suite_frame(aggregated)) if aggregated else {}),
    }
    paths = []
    for name, content in contents.items():
        write_atomically(out / name, content)
        paths.append(out / name)
    return tuple(paths)


def _of_frame(name: str, frame: pd.DataFrame) -> dict[str, bytes | str]:
    parquet = io.BytesIO()
    frame.to_parquet(parquet, index=False)
    cells = frame.map(lambda cell: cell_text(cell) if isinstance(cell, str) else cell)
    return {f"{name}.csv": cells.to_csv(index=False, lineterminator="\n"), f"{name}.parquet": parquet.getvalue()}
