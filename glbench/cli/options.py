"""Options shared by several commands, and look-ups of the tasks, rounds and stored results that they name.

The choices are repeated here so that ``--help`` need not load the evaluation.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import print_warning
from glbench.errors import GlbenchError, ResultError, TrainingError, did_you_mean, refuse
from glbench.extras import require
from glbench.untrusted import visible

if TYPE_CHECKING:
    from glbench.leaderboard import StoredResult, TaskTable
    from glbench.tasks import Round, TaskSpec

REPORTS = Path("reports")
_MOST_NUMBERS = 1000


class Sandbox(StrEnum):
    """The choices of ``--sandbox``."""

    AUTO = "auto"
    BUBBLEWRAP = "bubblewrap"
    NONE = "none"


class EngineName(StrEnum):
    """The choices of ``--engine``."""

    LOCAL = "local"
    RAY = "ray"


OneTask = Annotated[str | None, typer.Option("--task", "-t", help="Task id or task file (.toml). Default: the benchmark's.")]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder with results/ in it.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
Workers = Annotated[int | None, typer.Option("--workers", "-w", min=1, help="Cores to work with; changes no number. Default: all.")]
Engine = Annotated[EngineName, typer.Option("--engine", help="Where to work: local, or ray (a Ray cluster; needs glbench[ray]).")]
Address = Annotated[
    str | None, typer.Option("--address", help="Address of a Ray cluster, such as auto. Default: start one on this machine.")
]
Episodes = Annotated[
    str,
    typer.Option(
        "--episodes",
        help="Runs to keep as full episodes (3 MB each): all, none, or a list of best, worst, median and seeds. "
        "The actions of all runs are kept anyway, so that the others can be made later.",
    ),
]
SandboxChoice = Annotated[
    Sandbox,
    typer.Option(
        "--sandbox",
        envvar="GLBENCH_SANDBOX",
        help="Where submissions run: bubblewrap (no network, no weather, no seeds, limited in size), or none (with your rights: "
        "for code that you wrote or have read). auto: bubblewrap; where there is none, evaluate runs unchanged examples of glbench only, "
        "and check runs nothing.",
    ),
]
RoundFile = Annotated[
    Path | None,
    typer.Option("--round", help="The file of a sealed round (docs/maintain.md), which holds its secret. Default: public draws."),
]
Config = Annotated[Path | None, typer.Option("--config", "-c", help="Settings (YAML; docs/training.md). Default: those of the docs.")]
TrainingFolder = Annotated[Path | None, typer.Option("--out", "-o", help="Folder of the training. Default: runs/WHAT-TASK-seedSEED.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all that is random in the training.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint; nothing is lost but the minutes after it.")]


def check_engine(engine: EngineName, address: str | None) -> None:
    """Refuse an address without the engine ``ray``, and ``ray`` without its package, with a ``GlbenchError``."""
    if engine is EngineName.RAY:
        require("--engine ray", "ray", "ray")
    elif address is not None:
        refuse("--address is for a Ray cluster: add --engine ray.", GlbenchError)


def numbers_of(text: str, what: str, example: str) -> list[int]:
    """The seeds or years (``what``) that ``0-4`` or ``0,1,7-9`` names, each once; a ``GlbenchError`` for a part with none, or too many."""
    numbers = dict[int, None]()
    for part in text.split(","):
        matched = re.fullmatch(r"(\d{1,18})(?:-(\d{1,18}))?", part.strip())
        first, last = (int(matched[1]), int(matched[2] or matched[1])) if matched else (1, 0)
        if not 0 <= last - first < _MOST_NUMBERS:
            count = "no" if last < first else f"more than {_MOST_NUMBERS:,}"
            refuse(f"--{what} {text}: '{part.strip()}' names {count} {what}. Write {example}.", GlbenchError)
        numbers |= dict.fromkeys(range(first, last + 1))
    return list(numbers)


def check_new(file: Path, *, replace: bool) -> None:
    """Refuse a file that exists, unless it is to be replaced, with a ``GlbenchError``."""
    if file.exists() and not replace:
        refuse(f"{file} exists already. Choose another name with --out, or replace it with --replace.", GlbenchError)


def check_file(file: Path | None, ending: str) -> None:
    """Raise ``GlbenchError`` before the work if an output file has the wrong ending, is a folder, or lies where we cannot write."""
    from glbench.evaluation.files import ensure_writable

    if file is not None:
        if file.suffix != ending:
            refuse(f"{file} should end with {ending}.", GlbenchError)
        if file.is_dir():
            refuse(f"{file} is a folder. Choose another name.", GlbenchError)
        ensure_writable(file.parent)


def round_of(file: Path | None) -> Round | None:
    """The round that ``--round`` names, if any. Errors as for ``glbench.tasks.read_round``."""
    if file is None:
        return None
    from glbench.tasks import read_round

    return read_round(file)


def task_or_default(name: str | None) -> TaskSpec:
    """The task of that name, or the benchmark's. Errors as for ``glbench.tasks.get_task``."""
    from glbench.tasks import DEFAULT_TASK, get_task

    return get_task(name or DEFAULT_TASK)


@contextlib.contextmanager
def needs_the_extra(extra: str) -> Iterator[None]:
    """Say what to install when packages are missing. Raises ``TrainingError`` instead of the import's own error."""
    try:
        yield
    except ModuleNotFoundError as error:
        msg = (
            f"This needs packages that are not installed ({error.name}). "
            f'Install them with `pip install "glbench[{extra}]"`, or in a checkout with `uv sync --inexact --extra {extra}`.'
        )
        raise TrainingError(msg) from error


def task_ids(names: Sequence[str]) -> list[str]:
    """The tasks that ``--task`` names, each file (.toml) by the id in it. Errors as for ``glbench.tasks.get_task``."""
    from glbench.tasks import get_task

    return [get_task(name).id if name.endswith(".toml") else name for name in names]


def find_results(name: str, tasks: Sequence[str], reports: Path) -> list[StoredResult]:
    """Results that ``name`` means: a result file, or all of an agent's below ``reports`` and of the released ones.

    ``tasks`` (ids or their short forms) keeps those of these tasks only. Raises ``ResultError`` when there is none or a file is of another.
    """
    from glbench.evaluation import load_result
    from glbench.leaderboard.collect import StoredResult, own_and_released_results

    check_folder(reports)
    if is_file(name):
        one = StoredResult(Path(name), load_result(Path(name)))
        if tasks and not {one.result.task.id, one.result.task.id.rpartition("/")[2]} & {*tasks}:
            refuse(f"{name} is a result on {one.result.task.id}, but --task says {', '.join(tasks)}. Leave out --task.", ResultError)
        return [one]
    stored, problems = own_and_released_results(reports)
    warn_of([problem for problem in problems if name in str(problem)])
    agents = sorted({item.result.agent.name for item in stored})
    if name not in agents:
        msg = (
            f"There are no results of an agent '{name}'.{did_you_mean(name, agents)} Give its name or a result file; "
            "`glbench evaluate` makes one."
        )
        raise ResultError(msg)
    results = [item for item in stored if item.result.agent.name == name]
    if not tasks:
        return results
    selection = [item for item in results if {item.result.task.id, item.result.task.id.rpartition("/")[2]} & {*tasks}]
    has = {part for item in selection for part in (item.result.task.id, item.result.task.id.rpartition("/")[2])}
    if lacking := [task for task in tasks if task not in has]:
        others = [item.result.task.id.rpartition("/")[2] for item in results]
        near = did_you_mean(lacking[0].rpartition("/")[2], others, list_few=False)
        refuse(f"'{name}' has no result on {', '.join(lacking)}.{near} It has: {', '.join(others)}.", ResultError)
    return selection


def result_file(name: str, task: str | None) -> Path:
    """The file that ``name`` means: itself, or the result of an agent on a task (the benchmark's), the user's own before a released one.

    Raises ``ResultError`` when the agent has none, ``TaskError`` when there is no such task.
    """
    if is_file(name) or name.endswith(".mcap") or len(Path(name).parts) > 1:
        return Path(name)
    spec = task_or_default(task)
    own = REPORTS / "results" / spec.short_id / f"{name}.json"  # with the record that a released one lacks
    return own if own.is_file() else find_results(name, [spec.id], REPORTS)[0].path


def is_file(name: str) -> bool:
    """Whether ``name`` means a result file, and no agent."""
    return name.endswith(".json") or Path(name).is_file()


def tables_by_name(tables: Sequence[TaskTable]) -> dict[str, TaskTable]:
    """Tables by their board and by its short form, which means the published task where several have it, and nothing where none is.

    A task whose only board is one of other draws (``ID@...``) is that board.
    """
    from glbench.leaderboard.collect import short_board, task_of_board
    from glbench.registration import task_ids

    published = task_ids()
    ordered = sorted(tables, key=lambda table: table.task_id in published)
    tasks = [task_of_board(table.task_id) for table in ordered]
    only = {task: table for task, table in zip(tasks, ordered, strict=True) if tasks.count(task) == 1}
    cut = [short_board(table.task_id) for table in ordered]
    by_start = {name: table for name, table in zip(cut, ordered, strict=True) if cut.count(name) == 1}
    named = {**only, **by_start, **{table.task_id: table for table in ordered}}
    shorts = [name.rpartition("/")[2] for name in named]
    clear = {name: short for name, short in zip(named, shorts, strict=True) if name in published or shorts.count(short) == 1}
    return {**{short: named[name] for name, short in clear.items()}, **named}


def check_folder(out: Path) -> None:
    """Raise an error if ``--out`` names a folder that does not exist: a mistyped name must not look like an empty leaderboard."""
    if out == REPORTS or out.is_dir():
        return
    around = out.absolute().parent
    near = did_you_mean(out.name, [path.name for path in around.iterdir() if path.is_dir()] if around.is_dir() else [])
    refuse(f"There is no folder {out}.{near} `glbench evaluate ... --out FOLDER` makes one.", ResultError)


def warn_of(problems: Sequence[ResultError]) -> None:
    """List the result files that are left out, with reasons."""
    if problems:
        one = len(problems) == 1
        lines = "\n".join(f"  {visible(str(problem))}" for problem in problems)
        print_warning(f"{len(problems)} result file{' is' if one else 's are'} left out:\n{lines}")
