"""``glbench ladder``: trains agents that see more and more of a task, evaluates them, and says whether looking inside pays."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer
from rich.progress import MofNCompleteColumn, TaskProgressColumn

from glbench.cli import console, options
from glbench.cli.evaluate import load_agents, outcome_view, select_tasks
from glbench.cli.progress import JobsBar, status_bar
from glbench.cli.train import Where, executor_of
from glbench.errors import GlbenchError, TrainingError, did_you_mean, refuse

if TYPE_CHECKING:
    from glbench.evaluation import Result
    from glbench.leaderboard.ladder import Ladder, Rung
    from glbench.tasks import TaskSpec
    from glbench.training.multi_seed import Training
    from glbench.training.season_search import SearchSettings

Policies = Mapping[Path, tuple[str, int]]
"""View and seed of each training, by its folder."""
_BREAKS = re.compile(r" \(| (?=from )")  # Where the lines of a cell break
_MPC = "mpc_"


def ladder(
    task: Annotated[str | None, typer.Argument(metavar="[TASK]", help="Task id or task file (.toml). Default: the benchmark's.")] = None,
    views: Annotated[
        str, typer.Option("--views", help="Rungs to train (docs/ladder.md); each: one more for every sensor, and the forecast, left out.")
    ] = "clock,outdoor,blind,two_sensors,sensors,memory",
    trainings: Annotated[int, typer.Option("--trainings", min=1, help="Trainings of each rung, with the seeds 0, 1, ...")] = 5,
    steps: Annotated[int, typer.Option("--steps", min=1, help="Environment steps of each training.")] = 5_000_000,
    config: options.Config = None,
    search: Annotated[
        list[Path] | None,
        typer.Option("--search", help="Settings of a glbench tune policy that follows each training (YAML); repeat it for more."),
    ] = None,
    split: Annotated[
        str, typer.Option("--split", help="Scenarios to evaluate in: validation, or test, by which nothing may be chosen.")
    ] = "validation",
    runs: Annotated[int, typer.Option("--runs", "-n", min=2, help="Runs of each evaluation.")] = 30,
    agents: Annotated[
        str | None,
        typer.Option(
            "--agents",
            help="Agents besides: names or paths; mpc is the one for the task's model, mpc_VIEW sees a view. "
            "Default: mpc_blind,mpc where they can plan for the task.",
        ),
    ] = None,
    agent_runs: Annotated[
        int | None,
        typer.Option("--agent-runs", min=2, help="Runs of these agents, the first of --runs, where they take long. Default: all."),
    ] = None,
    rules: Annotated[
        str, typer.Option("--rules", help="The rules that blind agents are compared with: a name, or a folder of glbench tune rules.")
    ] = "rule_based_tuned",
    zero: Annotated[str, typer.Option("--zero", help="The agent over which leads are counted: a name or a path.")] = "rule_based_unlit",
    workers: Annotated[
        int | None, typer.Option("--workers", "-w", min=1, help="Trainings at a time, and cores of an evaluation. Default: all.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder of trainings, results and ladder.json. Default: runs/ladder-TASK.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """Train agents of one recipe that see more and more of a task, and print what each rung of this ladder earns.

    The same command continues what was interrupted: finished trainings and evaluations are not repeated. Views, trainings and agents may
    be added later, searches may not. Exits with 1 when a training failed, or an agent could not be evaluated.
    """
    from glbench.agents.predictive import can_be_planned
    from glbench.leaderboard.catalogue import catalogue
    from glbench.leaderboard.ladder import Ladder, rows_of, separation_of, verdicts_of
    from glbench.resources import write_atomically

    spec, scored = options.task_or_default(task), select_tasks([task] if task else [], [], None, split)[0]
    names, printer, folder = _view_names(spec, views), console.Printer(as_json), out or Path("runs") / f"ladder-{spec.short_id}"
    if agents is None:
        agents = "mpc_blind,mpc" if can_be_planned(spec) else ""
    if agent_runs is not None and not agents.strip(" ,"):
        refuse(f"--agent-runs limits agents, and there are none for {spec.id}. Name some with --agents, or leave it out.", GlbenchError)
    refs = [zero, rules, *(name.strip() for name in agents.split(",") if name.strip())]
    for ref, reason in load_agents([ref for ref in refs if not _is_view_of_mpc(ref)], "auto")[1].items():
        refuse(f"{ref}: {reason}", GlbenchError)
    _check_start(scored, {"--zero": zero, "--rules": rules})
    searches = _searches(spec, search or [])
    others: dict[str, int] = {}
    for ref in refs:
        others.setdefault(_agent(folder, ref, spec), runs if ref in (zero, rules) else min(agent_runs or runs, runs))
    if split == "test":
        console.print_warning("These are the runs of the test split: choose nothing by them.")
    with console.interruption("Run the same command again to continue: nothing that is finished is repeated."):
        places = {name: folder / f"ppo-{spec.short_id}-{name}" for name in names}
        policies = _train(spec, places, config, searches, steps, trainings, workers)
        results = _evaluate(scored, {**dict.fromkeys(map(str, policies), runs), **others}, folder, workers, printer)
    rungs, metric = _rungs(spec, results, policies), catalogue(spec).metrics[spec.evaluation.metric]
    seeds = max((result.evaluation.seeds for result in results.values()), key=len)
    zero_name, rules_name = (results[ref].agent.name if ref in results else ref for ref in (zero, rules))
    document = Ladder(
        task=spec.id, task_digest=spec.digest, split=split, seeds=seeds, metric=metric.name, unit=metric.unit, digits=min(metric.digits, 2),
        steps=steps, search_steps=sum(one.steps(spec) for one in searches),
        observed=len(spec.observed()), zero=zero_name, rules=rules_name, rungs=tuple(rungs), rows=rows_of(rungs, zero_name),
        verdicts=verdicts_of(rungs, rules_name, zero_name), separation=separation_of(rungs, rules_name),
    )  # fmt: skip
    is_whole = len(policies) == len(names) * trainings and len(results) == len(policies) + len(others)
    file = folder / ("ladder.json" if split == "validation" else f"ladder-{split}.json")
    if is_whole or not file.exists():
        write_atomically(file, document.model_dump_json(by_alias=True, indent=1) + "\n")
        printer.say(console.aside(f"Saved: {file}"))
    else:
        console.print_warning(f"This ladder is not complete, so {file} stays as it is.")
    printer.show(ladder_view(document, code=0 if is_whole else 1))


def ladder_view(ladder: Ladder, code: int) -> console.View:
    """The table of a ladder and its verdicts, or its JSON; ``code`` is that of the exit."""

    def parts() -> Iterator[console.Part]:
        from glbench.leaderboard.ladder import table_cells, table_notes, verdict_lines

        (rung, _, _, *numbers), *rows = table_cells(ladder)
        title = f"{ladder.task.rpartition('/')[2]}, {ladder.split} split, {len(ladder.seeds)} runs; {ladder.trained}"
        table = console.table(title, rung, *numbers, fold=numbers, padding=(0, 1, 0, 0))
        for name, _, trainings, *cells in rows:
            trained = "" if trainings == "–" else "\n" + console.count(int(trainings), "training")
            table.add(name + trained, *(_BREAKS.sub("\n", cell).replace(")", "") for cell in cells))
        yield table
        yield from map(console.paragraph, (table_notes(ladder), *verdict_lines(ladder)))

    return console.View(parts(), lambda: ladder.model_dump_json(by_alias=True), code=code)


def _check_start(task: TaskSpec, refs: Mapping[str, str]) -> None:
    """Refuse agents, by their option, that cannot begin a run of the task: without them a ladder has no leads, or no verdict."""
    from glbench.evaluation import prepare

    for option, ref in refs.items():
        try:
            prepare(task, ref, runs=1, sandbox="auto").check_start()
        except GlbenchError as error:
            remedy = f"Name others: {option} rule_based_fair, or {option} grower where a process computer works the actuators"
            remedy += ", or rule_based_harvest and rule_based_harvest_46 where agents call a crew."
            refuse(f"{option} {ref}: {error} {remedy}", GlbenchError, error)


def _view_names(task: TaskSpec, text: str) -> list[str]:
    """The views that ``--views`` names. Raises ``GlbenchError`` when there is none of a name, or the task lacks it."""
    from glbench.agents.views import VIEWS, left_out_views, visible_columns

    names: list[str] = []
    for name in (part.strip() for part in text.split(",")):
        if name not in ("each", *VIEWS) and not name.startswith("without_"):
            refuse(f"--views: there is no view '{name}'.{did_you_mean(name, ('each', *VIEWS))}", TrainingError)
        names += left_out_views(task) if name == "each" else [name]
    for name in names:
        if visible_columns(task, (name,)).all() and name.startswith("without_"):
            refuse(f"--views: '{name}' leaves nothing out, because {task.id} shows no such column.", TrainingError)
    return list(dict.fromkeys(names))


def _is_view_of_mpc(name: str) -> bool:
    """Whether an agent is called ``mpc_VIEW``."""
    from glbench.agents.views import VIEWS

    return name.startswith(_MPC) and name.removeprefix(_MPC) in VIEWS


def _agent(folder: Path, name: str, task: TaskSpec) -> str:
    """The agent that ``--agents`` names: ``mpc`` is the baseline that plans for the task, and ``mpc_VIEW`` is written to ``folder``."""
    from glbench.agents.predictive import predictive_baseline, write_predictive_agent

    if not _is_view_of_mpc(name):
        return predictive_baseline(task) if name == "mpc" else name
    write_predictive_agent(folder / name, name.removeprefix(_MPC), task)
    return str(folder / name)


def _searches(task: TaskSpec, files: Sequence[Path]) -> list[SearchSettings]:
    """The searches that follow each training. Raises ``TrainingError`` when a file cannot be read, or a value is impossible."""
    if not files:
        return []
    with options.needs_the_extra("train"):
        from glbench.training.season_search import read_season_search
    searches = [read_season_search(file, task.id, file) for file in files]  # their start is the training, which is still to come
    for one in searches:
        one.check_actions([action.name for action in task.actions])
    return searches


def _train(
    task: TaskSpec,
    places: Mapping[str, Path],
    config: Path | None,
    searches: Sequence[SearchSettings],
    steps: int,
    trainings: int,
    workers: int | None,
) -> dict[Path, tuple[str, int]]:
    """Train what is missing; the trainings that succeeded. One that fails is reported and stops no other."""
    with options.needs_the_extra("jax"):
        from glbench.training import Listener
        from glbench.training.compiled import train_compiled
        from glbench.training.compiled_settings import read_compiled_settings
        from glbench.training.multi_seed import train_seeds

    class Moving(Listener):
        """Moves the bar for one training."""

        def __init__(self, key: tuple[str, int]) -> None:
            self._key = key

        def on_progress(self, progress: Any) -> None:
            shares[self._key] = progress.steps / progress.total_steps
            move(completed=sum(shares.values()))

    settings = {name: read_compiled_settings(config, task, steps, [name]) for name in places}
    training, extras = cast("Training", train_compiled), dict[str, Any]()
    if searches:
        from glbench.training.season_search import train_then_search

        training, extras = train_then_search, {"train": train_compiled, "searches": searches}
    shares, policies = dict[tuple[str, int], float](), dict[Path, tuple[str, int]]()
    total, where = len(places) * trainings, Where(on_ray=False, address=None, workers=workers)
    with status_bar("training", total, TaskProgressColumn(), MofNCompleteColumn()) as move, executor_of(where, task) as executor:
        for name, place in places.items():
            folders = {seed: place.with_name(f"{place.name}-seed{seed}") for seed in range(trainings)}
            listeners = {seed: [Moving((name, seed))] for seed in folders}
            for seed, trained in train_seeds(executor, training, task, settings[name], folders, listeners=listeners.__getitem__, **extras):
                shares[name, seed] = 1.0
                if isinstance(trained, GlbenchError):
                    console.print_warning(f"{name}, seed {seed}: {trained}")
                    continue
                policies[folders[seed]] = (name, seed)
                console.tell(f"{name}, seed {seed}: trained, best {trained.best_reward:,.3f} ({len(policies)} of {total})")
    return policies


def _evaluate(task: TaskSpec, runs: Mapping[str, int], out: Path, workers: int | None, printer: console.Printer) -> dict[str, Result]:
    """Results by agent of ``runs``, which has the number for each, stored in ``out``.

    One that cannot be used, or fails in all runs, is left out, and tried again the next time.
    """
    from glbench.evaluation.jobs import Job, LocalEngine, Options

    usable, unusable = load_agents(list(runs), "auto")
    for ref, reason in unusable.items():
        console.print_warning(f"{ref}: {reason}")
    jobs = [Job(task, ref, agent, Options(out, runs[ref], workers=workers)) for ref, agent in usable.items()]
    results: dict[str, Result] = {}
    with JobsBar(len(jobs)) as bar:
        for number, outcome in enumerate(LocalEngine().run(jobs, bar.report), 1):
            if outcome.stored and _is_lost(outcome.result):
                again = dataclasses.replace(outcome.job, options=dataclasses.replace(outcome.job.options, fresh=True))
                (outcome,) = LocalEngine().run([again], bar.report)
            bar.ended(outcome)
            printer.say(*outcome_view(outcome, f"{number}/{len(jobs)}", prints=False).parts)
            if outcome.result is not None and not _is_lost(outcome.result):
                results[outcome.job.ref] = outcome.result
    if not results:
        refuse("No agent of the ladder could be evaluated; the reasons are above.", GlbenchError)
    return results


def _is_lost(result: Result | None) -> bool:
    """Whether there is no run that did not fail."""
    return result is None or len(result.failed) == len(result.runs)


def _rungs(task: TaskSpec, results: Mapping[str, Result], policies: Policies) -> list[Rung]:
    """The rungs: views, then agents that are not trained; of predictive control that sees everything the name is ``mpc``."""
    from glbench.agents.predictive import PREDICTIVE_BASELINES
    from glbench.agents.views import VIEWS, visible_columns
    from glbench.leaderboard.ladder import Rung

    by_name: dict[str, dict[int | None, Result]] = {}
    for ref, result in results.items():
        name, seed = policies.get(Path(ref), (result.agent.name, None))
        name = "mpc" if name in PREDICTIVE_BASELINES else name
        by_name.setdefault(name, {})[seed] = result
    rungs = []
    for name, by_seed in by_name.items():
        seeds, view = [seed for seed in by_seed if seed is not None], name.removeprefix(_MPC)
        is_mpc = name == "mpc" or _is_view_of_mpc(name)
        columns = int(visible_columns(task, (view,)).sum()) if seeds or (is_mpc and view in VIEWS) else None
        kind = "ppo" if seeds else "mpc" if is_mpc else "other"
        values = [result.values(task.evaluation.metric) for result in by_seed.values()]
        failed = sum(len(result.failed) for result in by_seed.values())
        parts = {"name": name, "kind": kind, "columns": columns, "seeds": seeds, "values": values, "failed": failed}
        rungs.append(Rung.model_validate(parts))
    return rungs
