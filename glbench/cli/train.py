"""``glbench train``, ``tune``, ``export`` and ``sweep``: agents that learn, and rules whose numbers are tuned."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import HEAVY_HEAD
from typer.core import TyperGroup

from glbench.cli.console import messages, output, say, table, tell
from glbench.cli.exiting import INTERRUPTED, tell_interrupted
from glbench.cli.options import (
    Address,
    Config,
    EngineName,
    OneTask,
    Resume,
    Seed,
    TrainingFolder,
    check_address,
)
from glbench.cli.progress import Bar
from glbench.cli.seeds import Where, on_cluster, seeds_of, train_with_seeds
from glbench.errors import TrainingError
from glbench.extras import require
from glbench.untrusted import real_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from glbench.leaderboard.catalogue import Catalogue, Metric
    from glbench.tasks import TaskSpec
    from glbench.training import CurvePoint, Listener, Trained, TrainingSettings
    from glbench.training import Progress as Standing
    from glbench.training.settings import EvaluationPlan
    from glbench.training.sweep import TrialReport

_TRIALS_SHOWN = 20
NOTHING_LEARNT = 3
"""Exit code of a training that finished and never beat the policy that it began with."""


def train(
    algorithm: Annotated[
        str,
        typer.Argument(
            help="ppo (compiled by JAX), sac, or a class path such as sb3_contrib.RecurrentPPO (with --config). "
            "ppo --config baselines/ppo/paper.yml is the paper's, by Stable-Baselines3."
        ),
    ],
    task: OneTask = None,
    config: Config = None,
    seed: Seed = 0,
    steps: Annotated[
        int | None, typer.Option("--steps", min=1, help="Environment steps. Default: the settings'.")
    ] = None,
    out: TrainingFolder = None,
    resume: Resume = False,
    wandb: Annotated[
        bool, typer.Option("--wandb", help="Log to Weights & Biases too (WANDB_MODE=offline needs no account).")
    ] = False,
    tensorboard: Annotated[bool, typer.Option(help="Write files for TensorBoard.")] = True,
    seeds: Annotated[
        str | None,
        typer.Option("--seeds", help="Train with each of these seeds: 0-4, or 0,1,7-9. Resumes interrupted ones."),
    ] = None,
    engine: Annotated[
        EngineName, typer.Option("--engine", help="With --seeds, where to train: here, or on a Ray cluster.")
    ] = EngineName.LOCAL,
    address: Address = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", "-w", min=1, help="With --seeds: trainings at a time. Default: all cores."),
    ] = None,
) -> None:
    """Train an agent on a task, keep its best policy, and tell how it was made.

    The folder then holds the policy (policy.npz, evaluated with numpy alone), the learning curve, the settings and card.toml,
    and is an agent itself: glbench evaluate FOLDER. Exit code 3: the training finished, but never beat the policy it began with.
    """
    check_address(address, engine)
    if seeds is None and (engine is EngineName.RAY or workers is not None):
        msg = "--engine ray and --workers are for trainings of several seeds: add --seeds 0-4."
        raise TrainingError(msg)
    if seeds is not None and wandb:
        msg = "--wandb logs one training: give --seed instead of --seeds."
        raise TrainingError(msg)
    if engine is EngineName.RAY:
        require("--engine ray", "ray", "ray")
    if wandb:
        require("--wandb", "wandb", "wandb")
    if algorithm != "ppo":
        require("This training", "train", "torch", "stable_baselines3")
    from glbench.training.compiled_settings import is_compiled

    chosen = the_task(task)
    several = None if seeds is None else (seeds_of(seeds), Where(engine is EngineName.RAY, address, workers))
    if algorithm == "ppo" and is_compiled(config, chosen):
        _train_compiled(chosen, config, steps, out, several, seed=seed, resume=resume, wandb=wandb, named=task)
        return
    with needs_the_extra("train"):
        from glbench.training import algorithms as a
        from glbench.training import read_settings, shipped_settings
    a.algorithm_class(algorithm)
    settings = read_settings(config or shipped_settings(algorithm), algorithm, chosen.id)
    if steps is not None:
        settings = settings.model_copy(update={"n_timesteps": steps})
    folder = out or Path("runs") / f"{a.short_name(algorithm)}-{chosen.short_id}-seed{seed}"
    a.check_settings(settings)
    total, rollout = a.steps_to_make(settings, chosen.steps), a.rollout_steps(settings, chosen.steps)
    rounded = "" if total == settings.n_timesteps else f" ({settings.n_timesteps:,} in whole rollouts of {rollout:,})"
    which = f"seed {seed}, in {folder}" if seeds is None else f"seeds {seeds}"
    say(
        messages(),
        f"Training [bold]{algorithm}[/bold] on [bold]{chosen.id}[/bold]: {total:,} steps{rounded}, "
        f"{settings.n_envs} greenhouses, {which}",
    )
    if several is not None:
        from glbench.training import train as training

        folders = _folders(out, f"{a.short_name(algorithm)}-{chosen.short_id}", several[0])
        train_with_seeds(training, chosen, settings, folders, several[1], tensorboard=tensorboard)
        return
    trained = _trained(chosen, settings, folder, seed=seed, resume=resume, wandb=wandb, tensorboard=tensorboard)
    if trained.already_done:
        messages().print("Already trained with these settings. More steps: --steps N --resume.")
    _say_what_came_out(trained, chosen, settings.evaluation, task)


class _PolicyUnlessNamed(TyperGroup):
    """``glbench tune POLICY`` is ``glbench tune policy POLICY``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the name of the command first where it is left out."""
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = ["policy", *args]
        return super().parse_args(ctx, args)


tune = typer.Typer(
    cls=_PolicyUnlessNamed,
    help="Tune what is there on whole seasons (CMA-ES): the last layer of a policy (glbench tune POLICY), or the numbers of rules.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@tune.command("rules")
def tune_rules(
    task: Annotated[
        list[str] | None,
        typer.Option(
            "--task", "-t", help="Task id or file; several for the mean of their rewards. Default: the benchmark's."
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option("--config", "-c", help="Rules to begin with (YAML). Default: the shipped ones.")
    ] = None,
    seed: Seed = 0,
    seasons: Annotated[
        int | None,
        typer.Option(
            "--seasons", "-n", min=1, help="Simulated runs in all, rounded up to whole generations. Default: 6,400."
        ),
    ] = None,
    population: Annotated[
        int | None, typer.Option("--population", "-p", min=4, help="Candidates a generation. Default: 64.")
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(
            "--sigma", min=1e-6, max=1.0, help="First spread, in widths of the numbers' bounds. Default: 0.1."
        ),
    ] = None,
    out: TrainingFolder = None,
) -> None:
    """Tune the numbers of rules for one task or several; the same command resumes what was interrupted.

    The folder then holds the rules (rules.yml), the learning curve and card.toml, and is an agent itself: glbench evaluate FOLDER.
    """
    with needs_the_extra("train"):
        from glbench.training import rule_search as r
    tasks = [the_task(name) for name in task] if task else [the_task(None)]
    start = config or r.shipped_start(tasks)
    given = {"seasons": seasons, "population": population, "sigma": sigma}
    settings = r.RuleSearchSettings.model_validate({name: value for name, value in given.items() if value is not None})
    names = ", ".join(one.id for one in tasks)
    folder = out or Path("runs") / f"rules-{'-'.join(one.short_id for one in tasks)}-seed{seed}"
    generations = settings.generations(tasks)
    messages().print(
        f"Tuning rules for [bold]{names}[/bold]: {generations} generations of {settings.population} candidates, "
        f"a run of each task for each, seed {seed}, in {folder}",
        soft_wrap=True,
    )
    bar = _TrainingBar(
        generations * settings.population * sum(one.steps for one in tasks), tasks[0], settings.evaluation
    )
    try:
        with bar:
            found = r.tune_rules(tasks, start, settings, folder, seed=seed, listeners=[bar])
    except KeyboardInterrupt:
        tell_interrupted("Run the same command again to continue from the last generation.")
        raise typer.Exit(INTERRUPTED) from None
    if found.already_done:
        messages().print("Already tuned with these settings. More: --seasons N.")
    _say_what_came_out(found, tasks[0], settings.evaluation, task[0] if task else None, "rules")


@tune.command("policy")
def tune_policy(
    policy: Annotated[
        Path, typer.Argument(metavar="POLICY", help="Policy file (policy.npz), or a folder of glbench train.")
    ],
    task: OneTask = None,
    config: Config = None,
    seed: Seed = 0,
    generations: Annotated[
        int | None, typer.Option("--generations", "-g", min=1, help="Generations. Default: the settings'.")
    ] = None,
    out: TrainingFolder = None,
    resume: Resume = False,
) -> None:
    """Adapt the last layer of a trained policy with CMA-ES: by simulated runs, without gradients.

    The folder then holds the policy (policy.npz), the learning curve and card.toml, and is an agent itself: glbench evaluate FOLDER.
    """
    with needs_the_extra("train"):
        from glbench.training.season_search import SearchSettings, read_season_search, search
    chosen = the_task(task)
    file = real_path(policy / "policy.npz" if policy.is_dir() else policy)
    settings = read_season_search(config, chosen.id, file) if config else SearchSettings.of(file)
    if generations is not None:
        settings = settings.model_copy(update={"generations": generations})
    folder = out or Path("runs") / f"tuned-{chosen.short_id}-seed{seed}"
    messages().print(
        f"Tuning [bold]{policy}[/bold] on [bold]{chosen.id}[/bold]: {settings.generations} generations of "
        f"{settings.population} runs, seed {seed}, in {folder}",
        soft_wrap=True,
    )
    bar = _TrainingBar(settings.generations * settings.population * chosen.steps, chosen, settings.evaluation)
    try:
        with bar:
            found = search(chosen, settings, folder, seed=seed, resume=resume, listeners=[bar])
    except KeyboardInterrupt:
        tell_interrupted("The same command with --resume continues from the last evaluation.")
        raise typer.Exit(INTERRUPTED) from None
    if found.already_done:
        messages().print("Already tuned with these settings. More: --generations N --resume.")
    _say_what_came_out(found, chosen, settings.evaluation, task)


def export(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL", help="model.zip of Stable-Baselines3, or a folder of glbench train.")
    ],
    task: OneTask = None,
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
    tell(f"Next: glbench evaluate {folder}")


def sweep(
    config: Annotated[Path, typer.Option("--config", "-c", help="What is searched (YAML; docs/training.md).")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of study and trials. Default: sweeps/NAME.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option("--workers", "-w", min=1, help="Trials at a time, a core each. Default: 1; on Ray all cores."),
    ] = None,
    engine: Annotated[
        EngineName, typer.Option("--engine", help="Where trials are trained: here, or on a Ray cluster.")
    ] = EngineName.LOCAL,
    address: Address = None,
    wandb: Annotated[
        bool, typer.Option("--wandb", help="Let Weights & Biases choose the trials (needs an account).")
    ] = False,
) -> None:
    """Search hyperparameters: an Optuna study in a local file. The same command resumes an interrupted search."""
    check_address(address, engine)
    if wandb and engine is EngineName.RAY:
        msg = "--wandb trains on this machine: leave out --engine."
        raise TrainingError(msg)
    if wandb:
        require("--wandb", "wandb", "wandb")
    if engine is EngineName.RAY:
        require("--engine ray", "ray", "ray")
    require("The sweep", "train", "optuna", "stable_baselines3", "torch")
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
    chosen = the_task(search.task)
    score = _words(chosen).score
    try:
        with contextlib.ExitStack() as stack:
            cluster, at_once = None, workers or 1
            if engine is EngineName.RAY:
                cluster, at_once = stack.enter_context(on_cluster(Where(True, address, workers), [chosen]))
            trials = run_sweep(
                search, folder, workers=at_once, report=lambda trial: _say_trial(trial, score), cluster=cluster
            )
    except KeyboardInterrupt:
        tell_interrupted("Finished trials are kept. Run the same command again to continue.")
        raise typer.Exit(INTERRUPTED) from None
    _print_trials(trials, score)
    if not any(trial.state != "fail" for trial in trials):
        msg = f"None of the {len(trials)} trials succeeded; the reasons are above. Correct {config} and choose a new folder with --out."
        raise TrainingError(msg)


def _folders(out: Path | None, name: str, seeds: list[int]) -> dict[int, Path]:
    return {seed: (out or Path("runs")) / f"{name}-seed{seed}" for seed in seeds}


def _train_compiled(
    task: TaskSpec,
    config: Path | None,
    steps: int | None,
    out: Path | None,
    several: tuple[list[int], Where] | None,
    *,
    seed: int,
    resume: bool,
    wandb: bool,
    named: str | None,
) -> None:
    """Train with the compiled PPO; ``several`` seeds instead of ``seed``, and where."""
    with needs_the_extra("jax"):
        from glbench.training.compiled import train_compiled
        from glbench.training.compiled_settings import read_compiled_settings
        from glbench.training.folder import LEARNER

    settings = read_compiled_settings(config, task, steps)
    name = f"ppo-{task.short_id}"
    folder = out or Path("runs") / f"{name}-seed{seed}"
    total = settings.updates * settings.rollout
    which = f"seed {seed}, in {folder}" if several is None else f"seeds {', '.join(map(str, several[0]))}"
    say(
        messages(),
        f"Training [bold]ppo[/bold] on [bold]{task.id}[/bold]: {total:,} steps in rollouts of {settings.rollout:,}, "
        f"{settings.n_envs} greenhouses, {which}",
    )
    if several is not None:
        train_with_seeds(train_compiled, task, settings, _folders(out, name, several[0]), several[1])
        return
    trained = _watched(
        lambda listeners: train_compiled(task, settings, folder, seed=seed, resume=resume, listeners=listeners),
        _TrainingBar(total, task, settings.evaluation),
        settings.model_dump(mode="json"),
        folder,
        wandb=wandb,
        begun=(folder / LEARNER).is_file,
    )
    if trained.already_done:
        messages().print(
            "Already trained with these settings. A different number of steps is a different training: --steps N --out FOLDER."
        )
    _say_what_came_out(trained, task, settings.evaluation, named, how="--steps N --out FOLDER")


def _trained(
    task: TaskSpec, settings: TrainingSettings, folder: Path, *, seed: int, resume: bool, wandb: bool, tensorboard: bool
) -> Trained:
    from glbench.training import train as run_training
    from glbench.training.algorithms import steps_to_make
    from glbench.training.folder import CHECKPOINT, find_checkpoint

    return _watched(
        lambda listeners: run_training(
            task, settings, folder, seed=seed, resume=resume, tensorboard=tensorboard, listeners=listeners
        ),
        _TrainingBar(steps_to_make(settings, task.steps), task, settings.evaluation),
        settings.model_dump(mode="json"),
        folder,
        wandb=wandb,
        begun=lambda: find_checkpoint(folder / CHECKPOINT) is not None,
    )


def _watched(
    run: Callable[[list[Listener]], Trained],
    progress: _TrainingBar,
    settings: dict[str, Any],
    folder: Path,
    *,
    wandb: bool,
    begun: Callable[[], bool],
) -> Trained:
    """Run a training with the listeners that were asked for; ``begun`` says whether there is something to continue."""
    with contextlib.ExitStack() as stack:
        bar = stack.enter_context(progress)
        listeners: list[Listener] = [bar]
        if wandb:
            from glbench.training.wandb_log import WandbListener

            logger = WandbListener(folder.name, settings, folder)
            stack.callback(logger.close)
            listeners.append(logger)
        try:
            return run(listeners)
        except KeyboardInterrupt:
            bar.__exit__(None, None, None)
            tell_interrupted(
                "The same command with --resume continues from the last checkpoint."
                if begun()
                else "Interrupted before the first checkpoint; the same command starts over."
            )
            raise typer.Exit(INTERRUPTED) from None


def _words(task: TaskSpec) -> Catalogue:
    """What the task's reward, profit and penalty are called."""
    from glbench.leaderboard.catalogue import catalogue

    return catalogue(task)


def _say_trial(trial: TrialReport, score: Metric) -> None:
    why = "" if trial.reason is None else f": {trial.reason}"
    tell(f"trial {trial.number:>3}  {trial.state:8}  {score.words} {_reward(trial, score):>8}  {_choices(trial)}{why}")


def _print_trials(trials: list[TrialReport], score: Metric) -> None:
    best = f"best {score.words}"
    headings, numbers = ("trial", "state", best, "settings"), ("trial", best)
    view = table("Trials, best first", *headings, right=numbers, folded=headings, box=HEAVY_HEAD, title_style=None)
    for trial in trials[:_TRIALS_SHOWN]:
        view.add_row(str(trial.number), trial.state, _reward(trial, score), _choices(trial))
    output().print(view)


def _reward(trial: TrialReport, score: Metric) -> str:
    return "-" if trial.reward is None else score.number(trial.reward)


def _choices(trial: TrialReport) -> str:
    return ", ".join(f"{name.rpartition('.')[2]} {_short(value)}" for name, value in trial.choices.items())


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


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
            f'Install them with `pip install "glbench[{extra}]"`, or in a checkout with `uv sync --inexact --extra {extra}`.'
        )
        raise TrainingError(msg) from error


def _say_what_came_out(
    trained: Trained,
    task: TaskSpec,
    evaluation: EvaluationPlan,
    named: str | None,
    what: str = "policy",
    how: str = "--resume",
) -> None:
    """The best policy of a training, or the best of ``what`` else was sought, and what to do with it; ``how`` to train for more steps.

    Raises
    ------
    typer.Exit
        With code 3 when nothing was learnt.
    """
    score = _words(task).score
    more = "more runs (--seasons N)" if what == "rules" else f"more steps ({how})"
    if not trained.learnt:
        messages().print(
            f"[bold yellow]Nothing was learnt.[/bold yellow] The training never beat the {what} that it began with: "
            f"{score.said(trained.best_reward)} at step 0, {score.number(trained.last_reward)} after {trained.steps:,} steps. "
            f"Train for {more}, or with other settings. {trained.folder} holds the {what} of step 0.",
            soft_wrap=True,
        )
        raise typer.Exit(NOTHING_LEARNT)
    output().print(
        f"Best {what}: {score.said(trained.best_reward)} after {trained.best_steps:,} of {trained.steps:,} steps; "
        f"the last one: {score.number(trained.last_reward)}. Means of {_seasons(task, evaluation)}; the score is that of glbench evaluate.",
        soft_wrap=True,
    )
    agent = trained.folder
    if trained.not_exported is not None:
        tell(f"No policy.npz was written: {trained.not_exported}")
        agent = trained.model
    option = "" if named is None else f" --task {named}"
    tell(f"Next: glbench evaluate {agent}{option}")


def _seasons(task: TaskSpec, evaluation: EvaluationPlan) -> str:
    """The seasons in which a training evaluates its policies, in words."""
    chosen, runs = task.chosen_on, len(evaluation.seeds(task))
    where = "with seeds that are not scored" if chosen.split is None else f"of the {chosen.split} split"
    return f"{runs} season{'s' if runs > 1 else ''} {where}"


class _TrainingBar(Bar):
    """Steps, speed and time left on standard error; each evaluation leaves a line, after one that says what it evaluates."""

    def __init__(self, total_steps: int, task: TaskSpec, evaluation: EvaluationPlan) -> None:
        columns = ("{task.completed:,.0f} of {task.total:,.0f} steps", "{task.fields[speed]}")
        super().__init__("training", total_steps, *columns, speed="")
        words = _words(task)
        self._metrics = {one.name: one for one in words.of_kind("score", "profit", "penalty")}
        self._score = words.score
        self._announced: str | None = (
            f"Each evaluation is the mean of {_seasons(task, evaluation)}, without exploration."
        )
        if task.splits is not None:
            test = task.scored
            self._announced += (
                f" The score is the mean of {test.evaluation.runs} seasons of the {test.split} split, made of other years: "
                "expect another figure."
            )

    def on_progress(self, progress: Standing) -> None:
        """Move the bar."""
        said = [f"{progress.steps_per_second:,.0f} steps/s"] if progress.steps_per_second else []
        left = progress.seconds_left
        if left is not None:
            said.append(f"{_duration(left)} left")
        if progress.season_reward is not None:
            said.append(f"season {self._score.said(progress.season_reward)}")
        self.move(progress.steps, total=progress.total_steps, speed=", ".join(said))

    def on_evaluation(self, point: CurvePoint) -> None:
        """A line with what the policy earns."""
        if self._announced is not None:
            messages().print(self._announced, soft_wrap=True)
            self._announced = None
        sums = "  ".join(one.said(point.result.sums[name]) for name, one in self._metrics.items())
        best = "  [green]best[/green]" if point.is_best else ""
        messages().print(
            f"{point.steps:>9,} steps {_duration(point.seconds):>6}  {sums}{best}",
            soft_wrap=True,
        )

    def on_saved(self, steps: int) -> None:
        """Nothing to show: a checkpoint is no news."""


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes < 90 else f"{minutes / 60:.1f} h"
