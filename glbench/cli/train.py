"""``glbench train``, ``tune``, ``export`` and ``sweep``: agents that learn, and rules whose numbers are tuned."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import HEAVY_HEAD
from typer.core import TyperGroup

from glbench.cli import console, options
from glbench.cli.console import Markup, plain, styled
from glbench.cli.fmu import fmu
from glbench.cli.progress import TrainingBar, TrainingLines, seasons_in_words
from glbench.errors import GlbenchError, TrainingError, refuse
from glbench.extras import require
from glbench.untrusted import real_path

if TYPE_CHECKING:
    from glbench.execution import Executor
    from glbench.leaderboard.catalogue import Metric
    from glbench.tasks import TaskSpec
    from glbench.training import Listener, Trained
    from glbench.training.multi_seed import Training
    from glbench.training.settings import EvaluationPlan
    from glbench.training.sweep import TrialReport

_MOST_TRIALS = 20


def train(
    algorithm: Annotated[
        str,
        typer.Argument(
            help="ppo (compiled by JAX), sac, or a class path such as sb3_contrib.RecurrentPPO (with --config). "
            "ppo --config baselines/ppo/paper.yml is the paper's, by Stable-Baselines3."
        ),
    ],
    task: options.OneTask = None,
    config: options.Config = None,
    seed: options.Seed = 0,
    steps: Annotated[int | None, typer.Option("--steps", min=1, help="Environment steps. Default: the settings'.")] = None,
    out: options.TrainingFolder = None,
    resume: options.Resume = False,
    wandb: Annotated[bool, typer.Option("--wandb", help="Log to Weights & Biases too (WANDB_MODE=offline needs no account).")] = False,
    tensorboard: Annotated[bool, typer.Option(help="Write files for TensorBoard (Stable-Baselines3 only).")] = True,
    seeds: Annotated[
        str | None, typer.Option("--seeds", help="Train with each of these seeds: 0-4, or 0,1,7-9. Resumes interrupted ones.")
    ] = None,
    engine: options.Engine = options.EngineName.LOCAL,
    address: options.Address = None,
    workers: Annotated[
        int | None, typer.Option("--workers", "-w", min=1, help="With --seeds: trainings at a time. Default: all cores.")
    ] = None,
    view: Annotated[
        str | None,
        typer.Option(
            "--view",
            help="What a compiled PPO looks at: views (clock, outdoor, blind, two_sensors, sensors, memory), observation modules and "
            "columns, and with - before it what it does not: sensors,-co2 (docs/ladder.md). Default: all that the task shows.",
        ),
    ] = None,
) -> None:
    """Train an agent on a task, keep its best policy, and tell how it was made.

    The folder then holds the policy (policy.npz, evaluated with numpy alone), the learning curve, the settings and card.toml,
    and is an agent itself: glbench evaluate FOLDER. Exit code 3: the training finished, but never beat the policy it began with.
    """
    if seeds is None and (engine is options.EngineName.RAY or workers is not None):
        refuse("--engine ray and --workers are for trainings of several seeds: add --seeds 0-4.", TrainingError)
    if seeds is not None and seed:
        refuse("--seed is for one training, --seeds for several: leave one of them out.", TrainingError)
    if seeds is not None and wandb:
        refuse("--wandb logs one training: give --seed instead of --seeds.", TrainingError)
    options.check_engine(engine, address)
    if wandb:
        require("--wandb", "wandb", "wandb")
    if algorithm != "ppo":
        require("This training", "train", "torch", "stable_baselines3")
    from glbench.training.compiled_settings import is_compiled

    spec = options.task_or_default(task)
    several = (
        None
        if seeds is None
        else (options.numbers_of(seeds, "seeds", "0-4, or 0,1,7-9"), Where(engine is options.EngineName.RAY, address, workers))
    )
    if algorithm == "ppo" and is_compiled(config, spec):
        plan = compiled_plan(spec, config, steps, None if view is None else [name.strip() for name in view.split(",")])
    else:
        if view is not None:
            refuse("--view is for the compiled PPO: glbench train ppo, without settings of Stable-Baselines3.", TrainingError)
        plan = sb3_plan(spec, algorithm, config, steps, tensorboard=tensorboard)
    settings, folder = plan.settings, out or Path("runs") / f"{plan.name}-seed{seed}"
    which = f"seed {seed}, in {folder}" if several is None else f"seeds {', '.join(map(str, several[0]))}"
    words = f"{plan.amount}, {settings.n_envs} greenhouses, {which}"
    text = f"Training {styled(algorithm, 'bold')} on {styled(spec.id, 'bold')}: {words}"
    console.put_parts([console.paragraph(Markup(text), aside=True)])
    if several is not None:
        train_with_seeds(plan, spec, out, several, task)
        return

    def consequence() -> str:
        if plan.has_checkpoint(folder):
            return "The same command with --resume continues from the last checkpoint."
        return "Interrupted before the first checkpoint; the same command starts over."

    with console.interruption(consequence), contextlib.ExitStack() as stack:
        listeners: list[Listener] = [stack.enter_context(TrainingBar(plan.steps, spec, settings.evaluation))]
        if wandb:
            from glbench.training.wandb_log import WandbListener

            logger = WandbListener(folder.name, settings.model_dump(mode="json"), folder)
            stack.callback(logger.close)
            listeners.append(logger)
        trained = plan.training(spec, settings, folder, seed=seed, resume=resume, listeners=listeners, **plan.extras)
    if trained.already_done:
        console.tell(f"Already trained with these settings. {plan.advice}")
    _put_outcome(trained, spec, settings.evaluation, task, how=plan.how)


@dataclass(frozen=True)
class Plan:
    """A training: the function that does it with its settings, and what the command says of it.

    ``name`` is that of its folder without the seed, ``amount`` its ``steps`` in words, ``advice`` and ``how`` what to do for more steps.
    """

    training: Training
    settings: Any
    name: str
    steps: int
    amount: str
    has_checkpoint: Callable[[Path], bool]
    extras: dict[str, Any]
    advice: str
    how: str


def compiled_plan(task: TaskSpec, config: Path | None, steps: int | None, view: Sequence[str] | None = None) -> Plan:
    """The compiled PPO, which looks at ``view``; at everything without one."""
    with options.needs_the_extra("jax"):
        from glbench.training.compiled import train_compiled
        from glbench.training.compiled_settings import read_compiled_settings
        from glbench.training.folder import LEARNER

    settings = read_compiled_settings(config, task, steps, view)
    total, how = settings.updates * settings.rollout, "--steps N --out FOLDER"
    amount = f"{total:,} steps in rollouts of {settings.rollout:,}"
    advice = f"A different number of steps is a different training: {how}."
    name = "-".join(["ppo", task.short_id, *(view or ())])
    return Plan(train_compiled, settings, name, total, amount, lambda folder: (folder / LEARNER).is_file(), {}, advice, how)


def sb3_plan(task: TaskSpec, algorithm: str, config: Path | None, steps: int | None, *, tensorboard: bool) -> Plan:
    """An algorithm of Stable-Baselines3."""
    with options.needs_the_extra("train"):
        from glbench.training import algorithms as a
        from glbench.training import read_settings, shipped_settings
    from glbench.training import train as training
    from glbench.training.folder import CHECKPOINT, find_checkpoint

    a.algorithm_class(algorithm)
    settings = read_settings(config or shipped_settings(algorithm), algorithm, task.id)
    if steps is not None:
        settings = settings.model_copy(update={"n_timesteps": steps})
    a.check_settings(settings)
    total, rollout = a.steps_to_make(settings, task.steps), a.rollout_steps(settings, task.steps)
    short = algorithm.rpartition(".")[2]
    rounded = "" if total == settings.n_timesteps else f" ({settings.n_timesteps:,} in whole rollouts of {rollout:,})"
    return Plan(
        training,
        settings,
        f"{short.lower() if short.lower() in a.SHORT else short}-{task.short_id}",
        total,
        f"{total:,} steps{rounded}",
        lambda folder: find_checkpoint(folder / CHECKPOINT) is not None,
        {"tensorboard": tensorboard},
        "More steps: --steps N --resume.",
        "--resume",
    )


class _PolicyUnlessNamed(TyperGroup):
    """``glbench tune POLICY`` is ``glbench tune policy POLICY``, and so with ``glbench export``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the name of the command first where it is left out."""
        if args and args[0] not in self.commands and args[0] not in ctx.help_option_names:
            args = ["policy", *args]
        return super().parse_args(ctx, args)


tune = typer.Typer(
    cls=_PolicyUnlessNamed,
    help="Tune what is there on whole seasons (CMA-ES): the last layer of a policy (glbench tune POLICY), or the numbers of rules.",
    no_args_is_help=True,
)


@tune.command("rules")
def tune_rules(
    task: Annotated[
        list[str] | None,
        typer.Option("--task", "-t", help="Task id or file; several for the mean of their rewards. Default: the benchmark's."),
    ] = None,
    config: Annotated[Path | None, typer.Option("--config", "-c", help="Rules to begin with (YAML). Default: the shipped ones.")] = None,
    seed: options.Seed = 0,
    seasons: Annotated[
        int | None, typer.Option("--seasons", "-n", min=1, help="Simulated runs in all, rounded up to whole generations. Default: 6,400.")
    ] = None,
    population: Annotated[int | None, typer.Option("--population", "-p", min=4, help="Candidates a generation. Default: 64.")] = None,
    sigma: Annotated[
        float | None, typer.Option("--sigma", min=1e-6, max=1.0, help="First spread, in widths of the numbers' bounds. Default: 0.1.")
    ] = None,
    out: options.TrainingFolder = None,
) -> None:
    """Tune the numbers of rules for one task or several; the same command resumes what was interrupted.

    The folder then holds the rules (rules.yml), the learning curve and card.toml, and is an agent itself: glbench evaluate FOLDER.
    """
    with options.needs_the_extra("train"):
        from glbench.training import rule_search as r
    tasks = [options.task_or_default(name) for name in task] if task else [options.task_or_default(None)]
    start = config or r.shipped_start(tasks)
    numbers = {"seasons": seasons, "population": population, "sigma": sigma}
    settings = r.RuleSearchSettings.model_validate({name: one for name, one in numbers.items() if one is not None})
    names = ", ".join(one.id for one in tasks)
    folder = out or Path("runs") / f"rules-{'-'.join(one.short_id for one in tasks)}-seed{seed}"
    generations = settings.generations(tasks)
    words = f"{console.count(generations, 'generation')} of {settings.population} candidates, a run of each task for each, seed {seed}"
    console.tell(Markup(f"Tuning rules for {styled(names, 'bold')}: {words}, in {plain(folder)}"))
    steps = generations * settings.population * sum(one.steps for one in tasks)
    bar = TrainingBar(steps, tasks[0], settings.evaluation)
    with console.interruption("Run the same command again to continue from the last generation."), bar:
        rules = r.tune_rules(tasks, start, settings, folder, seed=seed, listeners=[bar])
    if rules.already_done:
        console.tell("Already tuned with these settings. More: --seasons N.")
    _put_outcome(rules, tasks[0], settings.evaluation, task[0] if task else None, "rules")


@tune.command("policy")
def tune_policy(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="Policy file (policy.npz), or a folder of glbench train.")],
    task: options.OneTask = None,
    config: options.Config = None,
    seed: options.Seed = 0,
    generations: Annotated[int | None, typer.Option("--generations", "-g", min=1, help="Generations. Default: the settings'.")] = None,
    out: options.TrainingFolder = None,
    resume: options.Resume = False,
) -> None:
    """Adapt the last layer of a trained policy with CMA-ES: by simulated runs, without gradients.

    The folder then holds the policy (policy.npz), the learning curve and card.toml, and is an agent itself: glbench evaluate FOLDER.
    """
    with options.needs_the_extra("train"):
        from glbench.training.season_search import SearchSettings, read_season_search, search
    spec = options.task_or_default(task)
    file = real_path(policy / "policy.npz" if policy.is_dir() else policy)
    if not file.is_file():
        refuse(f"There is no policy file {file}. Give a policy.npz file or a folder made by glbench train.", TrainingError)
    settings = read_season_search(config, spec.id, file) if config else SearchSettings.of(file)
    if generations is not None:
        settings = settings.model_copy(update={"generations": generations})
    folder = out or Path("runs") / f"tuned-{spec.short_id}-seed{seed}"
    runs = settings.population * settings.seasons
    words = f"{console.count(settings.generations, 'generation')} of {runs} runs, seed {seed}, in {plain(folder)}"
    console.tell(Markup(f"Tuning {styled(policy, 'bold')} on {styled(spec.id, 'bold')}: {words}"))
    bar = TrainingBar(settings.steps(spec), spec, settings.evaluation)
    with console.interruption("The same command with --resume continues from the last evaluation."), bar:
        outcome = search(spec, settings, folder, seed=seed, resume=resume, listeners=[bar])
    if outcome.already_done:
        console.tell("Already tuned with these settings. More: --generations N --resume.")
    _put_outcome(outcome, spec, settings.evaluation, task)


export = typer.Typer(
    cls=_PolicyUnlessNamed,
    help="Export a trained policy (glbench export MODEL), or the greenhouse of a task for other programs.",
    no_args_is_help=True,
)
export.command("fmu")(fmu)


@export.command("policy")
def export_policy(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="model.zip of Stable-Baselines3, or a folder of glbench train.")],
    task: options.OneTask = None,
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
    with options.needs_the_extra("train"):
        from glbench.training.card import POLICY
        from glbench.training.export import export_model
        from glbench.training.run import export_best
    if model.is_dir():
        if out or algorithm or normalization:
            msg = f"{model} is the folder of a training, which says all of --out, --algorithm and --normalization itself. Leave them out."
            raise TrainingError(msg)
        folder, reason = model, export_best(model, None if task is None else options.task_or_default(task))
        if reason is not None:
            raise TrainingError(reason)
    else:
        folder, beside = out or model.with_suffix(""), model.with_name("vecnormalize.pkl")
        if normalization is None and beside.is_file():
            normalization = beside
        elif normalization == Path("none"):
            normalization = None
        export_model(model, algorithm or "ppo", normalization, options.task_or_default(task), folder)
    size = (folder / POLICY).stat().st_size
    console.write(f"{folder / POLICY}: {size / 1000:,.0f} kB")
    console.tell(_next(console.quoted(folder), task))


def sweep(
    config: Annotated[Path, typer.Option("--config", "-c", help="What is searched (YAML; docs/training.md).")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Folder of study and trials. Default: sweeps/NAME.")] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", "-w", min=1, help="Trials at a time, a core each. Default: 1; on Ray all cores.")
    ] = None,
    engine: options.Engine = options.EngineName.LOCAL,
    address: options.Address = None,
    wandb: Annotated[bool, typer.Option("--wandb", help="Let Weights & Biases choose the trials (needs an account).")] = False,
) -> None:
    """Search hyperparameters: an Optuna study in a local file. The same command resumes an interrupted search."""
    if wandb and (engine is options.EngineName.RAY or workers is not None):
        refuse("--wandb trains on this machine, one trial after the other: leave out --engine and --workers.", TrainingError)
    options.check_engine(engine, address)
    if wandb:
        require("--wandb", "wandb", "wandb")
    require("The sweep", "train", "optuna", "stable_baselines3", "torch")
    with options.needs_the_extra("train"):
        from glbench.training.sweep import read_search
        from glbench.training.sweep import sweep as run_sweep
        from glbench.training.wandb_log import wandb_sweep
    search = read_search(config)
    folder = out or Path("sweeps") / config.stem
    words = f"{plain(search.task)}: {console.count(search.total, 'trial')} of {search.steps:,} steps, in {plain(folder)}"
    parameters = plain(", ".join(search.parameters))
    console.tell(Markup(f"Searching {parameters} of {styled(search.algorithm, 'bold')} on {words}"))
    if wandb:
        wandb_sweep(search, folder)
        return
    from glbench.leaderboard.catalogue import catalogue

    spec = options.task_or_default(search.task)
    score = catalogue(spec).score
    stop = "Finished trials are kept. Run the same command again to continue."
    with console.interruption(stop), contextlib.ExitStack() as stack:
        executor = None
        if engine is options.EngineName.RAY or (workers or 1) > 1:
            executor = stack.enter_context(executor_of(Where(engine is options.EngineName.RAY, address, workers), spec))
        trials = run_sweep(search, folder, executor=executor, report=lambda trial: console.tell(trial_in_words(trial, score)))
    headings = ("trial", "state", f"best {score.words}", "settings")
    view = console.table("Trials, best first", *headings, numbers=headings[::2], fold=headings, box=HEAVY_HEAD, title_style=None)
    for trial in trials[:_MOST_TRIALS]:
        view.add(str(trial.number), trial.state, *_reward_and_choices(trial, score))
    console.put_parts([view])
    if not any(trial.state != "fail" for trial in trials):
        msg = f"None of the {len(trials)} trials succeeded; the reasons are above. Correct {config} and choose a new folder with --out."
        raise TrainingError(msg)


@dataclass(frozen=True)
class Where:
    """Where trainings are done: in ``workers`` processes, or on the Ray cluster at ``address``."""

    on_ray: bool
    address: str | None
    workers: int | None


@contextlib.contextmanager
def executor_of(where: Where, task: TaskSpec) -> Iterator[Executor]:
    """The executor for trainings on ``task``; without a number of workers, it uses all cores."""
    from glbench.execution import ProcessExecutor, RayExecutor

    if where.on_ray:
        from glbench.evaluation.jobs import Payload

        with contextlib.ExitStack() as stack:
            with console.messages().status("reaching the cluster"):
                executor = stack.enter_context(RayExecutor(where.address, where.workers, Payload.of([task]).unpack))
            yield executor
    else:
        from glbench.evaluation.records import usable_cores

        with ProcessExecutor(where.workers or usable_cores()) as processes:
            yield processes


def train_with_seeds(plan: Plan, task: TaskSpec, out: Path | None, several: tuple[list[int], Where], option: str | None) -> None:
    """Train with ``several`` seeds, each in ``out/NAME-seedSEED``, and print the outcome; ``option`` is what ``--task`` was given.

    Raises ``typer.Exit`` with code 1 when a training failed, else 3 when one learnt nothing, 130 when interrupted.
    """
    from glbench.leaderboard.catalogue import catalogue
    from glbench.training.multi_seed import train_seeds

    score, place, (seeds, where) = catalogue(task).score, out or Path("runs"), several
    folders = {seed: place / f"{plan.name}-seed{seed}" for seed in seeds}
    policies: dict[int, Trained] = {}
    failures = 0
    stop = "Run the same command again to continue: finished seeds are kept, the rest resume from their last checkpoints."
    with console.interruption(stop), executor_of(where, task) as executor:
        words = f"{console.count(len(folders), 'seed')}, {min(executor.workers, len(folders))} at a time, in {place}"
        console.put_parts([console.paragraph(words, aside=True)])
        outcomes = train_seeds(
            executor, plan.training, task, plan.settings, folders, listeners=lambda seed: [TrainingLines(seed, score)], **plan.extras
        )
        for seed, trained in outcomes:
            if isinstance(trained, GlbenchError):
                failures += 1
                console.print_warning(f"seed {seed}: {trained}")
            else:
                policies[seed] = trained
                state = "already trained" if trained.already_done else "done"
                console.tell(f"seed {seed}: {state}, best {score.phrase(trained.best_reward)}")
    numbers = ("Best", "after", "of", "Last")
    view = console.table(f"Trainings by {score.words}", "Seed", *numbers, "", numbers=("Seed", *numbers))
    for seed, one in sorted(policies.items()):
        remark = "" if one.learnt else "nothing was learnt"
        steps = (f"{one.best_steps:,}", f"{one.steps:,}")
        view.add(str(seed), score.number(one.best_reward), *steps, score.number(one.last_reward), remark)
    console.put_parts([view])
    if policies:
        console.write(_next(f"{console.quoted(place)}/{plan.name}-seed*", option))
    if failures or any(not one.learnt for one in policies.values()):
        raise typer.Exit(1 if failures else console.NOTHING_LEARNT)


def trial_in_words(trial: TrialReport, score: Metric) -> str:
    """``trial   7  complete  reward  3,751.9  batch_size 64``, with the reason of a failure."""
    why = "" if trial.reason is None else f": {trial.reason}"
    reward, choices = _reward_and_choices(trial, score)
    return f"trial {trial.number:>3}  {trial.state:8}  {score.words} {reward:>8}  {choices}{why}"


def _reward_and_choices(trial: TrialReport, score: Metric) -> tuple[str, str]:
    choices = (
        f"{name.rpartition('.')[2]} {value:.4g}" if isinstance(value, float) else f"{name.rpartition('.')[2]} {value}"
        for name, value in trial.choices.items()
    )
    return "-" if trial.reward is None else score.number(trial.reward), ", ".join(choices)


def _put_outcome(
    trained: Trained, spec: TaskSpec, evaluation: EvaluationPlan, task: str | None, what: str = "policy", how: str = "--resume"
) -> None:
    """Print the best policy or rules (``what``) of a training and what to do with it; ``how`` to train for more steps.

    Raises ``typer.Exit`` with code 3 when nothing was learnt.
    """
    from glbench.leaderboard.catalogue import catalogue

    score = catalogue(spec).score
    more = "more runs (--seasons N)" if what == "rules" else f"more steps ({how})"
    if not trained.learnt:
        console.tell(
            Markup(
                f"[bold yellow]Nothing was learnt.[/bold yellow] The training never beat the {what} that it began with: "
                f"{score.phrase(trained.best_reward)} at step 0, {score.number(trained.last_reward)} after {trained.steps:,} steps. "
                f"Train for {more}, or with other settings. {plain(trained.folder)} holds the {what} of step 0."
            )
        )
        raise typer.Exit(console.NOTHING_LEARNT)
    console.write(
        f"Best {what}: {score.phrase(trained.best_reward)} after {trained.best_steps:,} of {trained.steps:,} steps; the last one: "
        f"{score.number(trained.last_reward)}. Means of {seasons_in_words(spec, evaluation)}; the score is that of glbench evaluate."
    )
    agent = trained.folder
    if trained.not_exported is not None:
        console.tell(f"No policy.npz was written: {trained.not_exported}")
        agent = trained.model
    console.tell(_next(console.quoted(agent), task))


def _next(agent: str, task: str | None) -> str:
    """The command that evaluates what was made, on the task that it was made for."""
    return f"Next: glbench evaluate {agent}" + ("" if task is None else f" --task {console.quoted(task)}")
