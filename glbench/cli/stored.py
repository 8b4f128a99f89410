"""Finding stored results for commands: by file, or by the name of an agent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from glbench.cli.console import print_warning
from glbench.cli.options import REPORTS
from glbench.errors import ResultError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from glbench.leaderboard import StoredResult, TaskTable


def task_ids(names: Sequence[str]) -> list[str]:
    """The tasks that ``--task`` names, each file (.toml) by the id in it. Errors as for ``glbench.tasks.get_task``."""
    from glbench.tasks import get_task

    return [get_task(name).id if name.endswith(".toml") else name for name in names]


def find_results(wanted: str, tasks: Sequence[str], reports: Path) -> list[StoredResult]:
    """Results that ``wanted`` means: a result file, or all of an agent's below ``reports`` and of the released ones.

    ``tasks`` (ids or their short forms) keeps those of these tasks only.

    Raises
    ------
    ResultError
        When there is none.
    """
    from glbench.evaluation import load_result
    from glbench.leaderboard.collect import StoredResult, own_and_released_results

    check_folder(reports)
    if wanted.endswith(".json") or Path(wanted).is_file():
        return [StoredResult(Path(wanted), load_result(Path(wanted)))]
    found, problems = own_and_released_results(reports)
    warn_of([problem for problem in problems if wanted in str(problem)])
    agents = sorted({item.result.agent.name for item in found})
    if wanted not in agents:
        msg = (
            f"There are no results of an agent '{wanted}'.{did_you_mean(wanted, agents)} Give its name or a result file; "
            "`glbench evaluate` makes one."
        )
        raise ResultError(msg)
    everywhere = chosen = [item for item in found if item.result.agent.name == wanted]
    if tasks:
        chosen = [item for item in chosen if {item.result.task.id, item.result.task.id.rpartition("/")[2]} & {*tasks}]
        if not chosen:
            known = [item.result.task.id.rpartition("/")[2] for item in everywhere]
            near = did_you_mean(tasks[0].rpartition("/")[2], known)
            msg = f"'{wanted}' has no result on {', '.join(tasks)}.{near} It has: {', '.join(known)}."
            raise ResultError(msg)
    return chosen


def tables_by_name(tables: Sequence[TaskTable]) -> dict[str, TaskTable]:
    """Tables by their board and by its short form, which means the published task where several have it.

    A task whose only board is one of other draws (``ID@...``) is that board.
    """
    from glbench.leaderboard.collect import task_of_board
    from glbench.registration import task_ids

    published = task_ids()
    ordered = sorted(tables, key=lambda table: table.task_id in published)
    tasks = [task_of_board(table.task_id) for table in ordered]
    only = {task: table for task, table in zip(tasks, ordered, strict=True) if tasks.count(task) == 1}
    named = [*only.items(), *((table.task_id, table) for table in ordered)]
    return {**{name.rpartition("/")[2]: table for name, table in named}, **dict(named)}


def check_folder(out: Path) -> None:
    """Refuse a folder that was asked for and is not there: a mistyped name must not look like an empty leaderboard."""
    if out == REPORTS or out.is_dir():
        return
    around = out.absolute().parent
    near = did_you_mean(out.name, [path.name for path in around.iterdir() if path.is_dir()] if around.is_dir() else [])
    msg = f"There is no folder {out}.{near} `glbench evaluate ... --out FOLDER` makes one."
    raise ResultError(msg)


def warn_of(problems: Sequence[ResultError]) -> None:
    """List the result files that are left out, and why."""
    if problems:
        one = len(problems) == 1
        lines = "\n".join(f"  {problem}" for problem in problems)
        print_warning(f"{len(problems)} result file{' is' if one else 's are'} left out:\n{lines}")
