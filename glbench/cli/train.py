"""``glbench train``, ``export`` and ``sweep``: agents from Stable-Baselines3."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output, say
from glbench.cli.leaving import INTERRUPTED, tell_interrupted
from glbench.cli.training_support import Task, needs_the_extra, say_what_came_out, the_task
from glbench.errors import TrainingError

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.training import Listener, Trained, TrainingSettings
    from glbench.training.sweep import TrialReport

_TRIALS_SHOWN = 20


def train(
    algorithm: Annotated[
        str, typer.Argument(help="ppo, sac, or a class path such as sb3_contrib.RecurrentPPO (with --config).")
    ],
    task: Task = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Settings (YAML). Default: the paper's, for ppo and sac.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of weights, exploration and batches.")] = 0,
    steps: Annotated[
        int | None, typer.Option("--steps", min=1, help="Environment steps. Default: the settings'.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of the training. Default: runs/ALGORITHM-TASK-seedSEED.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the last checkpoint; nothing is lost but the minutes after it.")
    ] = False,
    wandb: Annotated[
        bool, typer.Option("--wandb", help="Log to Weights & Biases too (WANDB_MODE=offline needs no account).")
    ] = False,
    tensorboard: Annotated[bool, typer.Option(help="Write files for TensorBoard.")] = True,
) -> None:
    """Train an agent on a task, keep its best policy, and tell how it was made.

    The folder then holds the policy (policy.npz, evaluated with numpy alone), the learning curve, the settings and card.toml,
    and is an agent itself: glbench evaluate FOLDER. Exit code 3: the training finished, but never beat the policy it began with.
    """
    with needs_the_extra("train"):
        from glbench.training import read_settings, shipped_settings
        from glbench.training.algorithms import (
            algorithm_class,
            check_settings,
            rollout_steps,
            short_name,
            steps_to_make,
        )
    algorithm_class(algorithm)
    chosen = the_task(task)
    settings = read_settings(config or shipped_settings(algorithm), algorithm, chosen.id)
    if steps is not None:
        settings = settings.model_copy(update={"n_timesteps": steps})
    folder = out or Path("runs") / f"{short_name(algorithm)}-{chosen.short_id}-seed{seed}"
    check_settings(settings)
    total, rollout = steps_to_make(settings, chosen.steps), rollout_steps(settings, chosen.steps)
    rounded = "" if total == settings.n_timesteps else f" ({settings.n_timesteps:,} in whole rollouts of {rollout:,})"
    say(
        messages(),
        f"Training [bold]{algorithm}[/bold] on [bold]{chosen.id}[/bold]: {total:,} steps{rounded}, "
        f"{settings.n_envs} greenhouses, seed {seed}, in {folder}",
    )
    trained = _trained(chosen, settings, folder, seed=seed, resume=resume, wandb=wandb, tensorboard=tensorboard)
    if trained.already_done:
        messages().print("Already trained with these settings. More steps: --steps N --resume.")
    say_what_came_out(trained, task)


def export(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="model.zip of Stable-Baselines3, or a folder of glbench train.")
    ],
    task: Task = None,
    algorithm: Annotated[
        str | None, typer.Option("--algorithm", "-a", help="Of a model.zip: ppo (the default), sac, or a class path.")
    ] = None,
    normalization: Annotated[
        Path | None,
        typer.Option(
            "--normalization",
            help="Of a model.zip: the VecNormalize saved with it. Default: vecnormalize.pkl beside it, if there; none: none.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder for a model.zip's policy and card.")] = None,
) -> None:
    """Write a trained policy to a small file without code in it, which numpy alone evaluates to the same bits everywhere.

    Loading a model.zip runs code from it: export only files you trust.
    """
    with needs_the_extra("train"):
        from glbench.training.card import POLICY
        from glbench.training.export import export_model
        from glbench.training.run import export_best
    if model.is_dir():
        if out or algorithm or normalization:
            msg = f"{model} is the folder of a training, which says all of --out, --algorithm and --normalization itself. Leave them out."
            raise TrainingError(msg)
        folder, reason = model, export_best(model, None if task is None else the_task(task))
        if reason is not None:
            raise TrainingError(reason)
    else:
        folder, beside = out or model.with_suffix(""), model.with_name("vecnormalize.pkl")
        if normalization is None and beside.is_file():
            normalization = beside
        elif normalization == Path("none"):
            normalization = None
        export_model(model, algorithm or "ppo", normalization, the_task(task), folder)
    size = (folder / POLICY).stat().st_size
    output().print(f"{folder / POLICY}: {size / 1000:,.0f} kB", soft_wrap=True)
    messages().print(f"Next: glbench evaluate {folder}", markup=False, soft_wrap=True)


def sweep(
    config: Annotated[Path, typer.Option("--config", "-c", help="What is searched (YAML; docs/training.md).")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of study and trials. Default: sweeps/NAME.")
    ] = None,
    workers: Annotated[int, typer.Option("--workers", "-w", min=1, help="Trials at a time, a core each.")] = 1,
    wandb: Annotated[
        bool, typer.Option("--wandb", help="Let Weights & Biases choose the trials (needs an account).")
    ] = False,
) -> None:
    """Search hyperparameters: an Optuna study in a local file. The same command goes on with an interrupted search."""
    with needs_the_extra("train"):
        from glbench.training.sweep import read_search
        from glbench.training.sweep import sweep as run_sweep
        from glbench.training.wandb_log import wandb_sweep
    search = read_search(config)
    folder = out or Path("sweeps") / config.stem
    messages().print(
        f"Searching {', '.join(search.parameters)} of [bold]{search.algorithm}[/bold] on {search.task}: "
        f"{search.trials} trials of {search.steps:,} steps, in {folder}",
        soft_wrap=True,
    )
    if wandb:
        wandb_sweep(search, folder)
        return
    try:
        trials = run_sweep(search, folder, workers=workers, report=_say_trial)
    except KeyboardInterrupt:
        tell_interrupted("Trials that ended are kept: the same command goes on.")
        raise typer.Exit(INTERRUPTED) from None
    _print_trials(trials)


def _trained(
    task: TaskSpec, settings: TrainingSettings, folder: Path, *, seed: int, resume: bool, wandb: bool, tensorboard: bool
) -> Trained:
    from glbench.cli.training_progress import TrainingBar
    from glbench.training import train as run_training
    from glbench.training.algorithms import steps_to_make
    from glbench.training.checkpoint import CHECKPOINT, find_checkpoint

    with contextlib.ExitStack() as stack:
        bar = stack.enter_context(TrainingBar(steps_to_make(settings, task.steps)))
        listeners: list[Listener] = [bar]
        if wandb:
            from glbench.training.wandb_log import WandbListener

            logger = WandbListener(folder.name, settings.model_dump(mode="json"), folder)
            stack.callback(logger.close)
            listeners.append(logger)
        try:
            return run_training(
                task, settings, folder, seed=seed, resume=resume, tensorboard=tensorboard, listeners=listeners
            )
        except KeyboardInterrupt:
            bar.__exit__(None, None, None)
            tell_interrupted(
                "The same command with --resume continues from the last checkpoint."
                if find_checkpoint(folder / CHECKPOINT)
                else "Nothing was trained long enough to be kept: the same command starts again."
            )
            raise typer.Exit(INTERRUPTED) from None


def _say_trial(trial: TrialReport) -> None:
    why = "" if trial.reason is None else f": {trial.reason}"
    messages().print(
        f"trial {trial.number:>3}  {trial.state:8}  reward {_reward(trial):>8}  {_choices(trial)}{why}",
        soft_wrap=True,
        markup=False,
    )


def _print_trials(trials: list[TrialReport]) -> None:
    from rich.table import Table

    table = Table(title="Trials, best first", title_justify="left")
    for name in ("trial", "state", "best reward", "settings"):
        table.add_column(name, justify="right" if name in ("trial", "best reward") else "left")
    for trial in trials[:_TRIALS_SHOWN]:
        table.add_row(str(trial.number), trial.state, _reward(trial), _choices(trial))
    output().print(table)


def _reward(trial: TrialReport) -> str:
    return "-" if trial.reward is None else f"{trial.reward:,.1f}"


def _choices(trial: TrialReport) -> str:
    return ", ".join(f"{name.rpartition('.')[2]} {_short(value)}" for name, value in trial.choices.items())


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
