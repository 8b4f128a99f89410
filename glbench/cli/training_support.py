"""What the commands that train have in common."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output
from glbench.errors import TrainingError

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.training import Trained

Task = Annotated[
    str | None, typer.Option("--task", "-t", help="Task id or task file (.toml). Default: the benchmark's.")
]

NOTHING_LEARNT = 3
"""Exit code of a training that finished and never beat the policy that it began with."""


def the_task(name: str | None) -> TaskSpec:
    """The task of that name, or the benchmark's."""
    from glbench.tasks import DEFAULT_TASK, get_task

    return get_task(name or DEFAULT_TASK)


@contextlib.contextmanager
def needs_the_extra(extra: str) -> Iterator[None]:
    """Say what to install when packages are missing.

    Raises
    ------
    TrainingError
        Instead of the import's own error.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        msg = (
            f"This needs packages that are not installed ({error.name}). "
            f'Install them with `pip install "glbench[{extra}]"`, or in a checkout with `uv sync --extra {extra}`.'
        )
        raise TrainingError(msg) from error


def say_what_came_out(trained: Trained, task: str | None) -> None:
    """The best policy of a training, and what to do with it.

    Raises
    ------
    typer.Exit
        With code 3 when nothing was learnt.
    """
    if not trained.learnt:
        messages().print(
            f"[bold yellow]Nothing was learnt.[/bold yellow] The training never beat the policy that it began with: reward "
            f"{trained.best_reward:,.1f} at step 0, {trained.last_reward:,.1f} after {trained.steps:,} steps. "
            f"Train for more steps (--resume), or with other settings. {trained.folder} holds the policy of step 0.",
            soft_wrap=True,
        )
        raise typer.Exit(NOTHING_LEARNT)
    output().print(
        f"Best policy: reward {trained.best_reward:,.1f} after {trained.best_steps:,} of {trained.steps:,} steps; "
        f"the last one: {trained.last_reward:,.1f}.",
        soft_wrap=True,
    )
    agent = trained.folder
    if trained.not_exported is not None:
        messages().print(f"No policy.npz was written: {trained.not_exported}", soft_wrap=True, markup=False)
        agent = trained.model
    option = "" if task is None else f" --task {task}"
    messages().print(f"Next: glbench evaluate {agent}{option}", markup=False, soft_wrap=True)
