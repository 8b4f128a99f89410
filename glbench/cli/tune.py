"""``glbench tune``: the last layer of a trained policy, adapted by the rewards of whole seasons."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glbench.cli.console import messages
from glbench.cli.leaving import INTERRUPTED, tell_interrupted
from glbench.cli.training_support import Task, needs_the_extra, say_what_came_out, the_task


def tune(
    policy: Annotated[
        Path, typer.Argument(metavar="POLICY", help="Policy file (policy.npz), or a folder of glbench train.")
    ],
    task: Task = None,
    config: Annotated[
        Path | None,
        typer.Option("--config", "-c", help="Settings (YAML; docs/training.md). Default: those of the docs."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the search.")] = 0,
    generations: Annotated[
        int | None, typer.Option("--generations", "-g", min=1, help="Generations. Default: the settings'.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the search. Default: runs/tuned-TASK-seedSEED.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with what the folder holds.")] = False,
) -> None:
    """Adapt the last layer of a trained policy (CMA-ES): seasons of the simulator, no gradients, decide what is better.

    The folder then holds the policy (policy.npz), the learning curve and card.toml, and is an agent itself: glbench evaluate FOLDER.
    """
    with needs_the_extra("train"):
        from glbench.training.season_search import SearchSettings, read_season_search, search
    from glbench.cli.training_progress import TrainingBar

    chosen = the_task(task)
    file = (policy / "policy.npz" if policy.is_dir() else policy).resolve()
    settings = read_season_search(config, chosen.id, file) if config else SearchSettings.of(file)
    if generations is not None:
        settings = settings.model_copy(update={"generations": generations})
    folder = out or Path("runs") / f"tuned-{chosen.short_id}-seed{seed}"
    messages().print(
        f"Tuning [bold]{policy}[/bold] on [bold]{chosen.id}[/bold]: {settings.generations} generations of "
        f"{settings.population} seasons, seed {seed}, in {folder}",
        soft_wrap=True,
    )
    bar = TrainingBar(settings.generations * settings.population * chosen.steps)
    try:
        with bar:
            found = search(chosen, settings, folder, seed=seed, resume=resume, listeners=[bar])
    except KeyboardInterrupt:
        tell_interrupted("The same command with --resume goes on from the last evaluation.")
        raise typer.Exit(INTERRUPTED) from None
    if found.already_done:
        messages().print("Already tuned with these settings. More: --generations N --resume.")
    say_what_came_out(found, task)
