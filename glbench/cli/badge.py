"""``glbench badge``: a line of the leaderboard as a picture for a README."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glbench.cli.console import messages
from glbench.cli.stored import check_folder, tables_by_name, warn_of
from glbench.errors import ResultError, did_you_mean


def badge(
    agent: Annotated[str, typer.Argument(help="Name of an agent that has a result.")],
    task: Annotated[str | None, typer.Option("--task", "-t", help="Of this task. Default: the default task.")] = None,
    out: Annotated[Path, typer.Option("--out", help="Folder with results/ in it.")] = Path("reports"),
    file: Annotated[Path, typer.Option("--file", "-f", help="Where the picture goes.")] = Path("badge.svg"),
) -> None:
    """Draw a badge: task, rank, reward, and whether the result was reproduced."""
    from glbench.leaderboard import rank
    from glbench.leaderboard.badges import badge as draw
    from glbench.leaderboard.published import own_and_released_results, published_expectations
    from glbench.resources import write_atomically
    from glbench.tasks import DEFAULT_TASK

    check_folder(out)
    wanted = task or DEFAULT_TASK
    stored, problems = own_and_released_results(out)
    warn_of(problems)
    tables = rank(stored, published_expectations())
    names = tables_by_name(tables)
    if wanted not in names:
        msg = f"There are no results of a task '{wanted}'.{did_you_mean(wanted, names)}"
        raise ResultError(msg)
    write_atomically(file, draw(names[wanted], agent))
    messages().print(f"Written: {file}", markup=False, soft_wrap=True)
