"""Perfect information: ``glbench bound`` searches for better plans, ``glbench episodes dispatch`` for the least cost of energy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli import console, options
from glbench.cli.console import Markup, styled
from glbench.cli.progress import Bar
from glbench.errors import GlbenchError, refuse

if TYPE_CHECKING:
    from glbench.bounds import PlanComparison, PlanOutcome, Search
    from glbench.bounds.energy_costs import Costs
    from glbench.control import Iteration

_EXAMPLE = "my_agent.py"
_ROWS = {
    "run": "As recorded",
    "least": "Least cost",
    "ruled": "With the machines' rules",
    "blind": "Planned at mean prices",
    "without_buffer": "Least cost without the buffer",
    "without_engine": "Least cost without the engine",
    "boiler_alone": "Least cost with the boiler alone",
}
_ITERATIONS = 35
_EARNS = {"buffer_earns": "the buffer", "engine_earns": "the engine", "looking_earns": "knowing how prices vary"}


def bound(
    task: Annotated[str | None, typer.Argument(metavar="[TASK]", help="Task id or task file (.toml).")] = None,
    scenario: Annotated[list[int] | None, typer.Option("--scenario", help="Seed of a run; repeatable. Default: all scored runs.")] = None,
    split: Annotated[str, typer.Option("--split", help="Split whose runs are planned, if the task has splits.")] = "test",
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            help="Agent whose controls each plan starts from, or its result (.json) in these runs: then it need not act again. Default: "
            "best_known if every run has a plan, else the example my_agent.",
        ),
    ] = None,
    iterations: Annotated[
        int, typer.Option("--iterations", "-n", min=1, help="Iterations per plan; one takes 3 to 12 s of one core for 5,760 steps.")
    ] = _ITERATIONS,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the plans. Default: runs/bound/TASK. Finished plans are skipped.")
    ] = None,
    submit: Annotated[
        list[Path] | None,
        typer.Option(
            "--submit",
            metavar="FILE",
            help="Hand in plans that beat the best known: a folder or file of this command, or any agent's result (.json); repeatable.",
        ),
    ] = None,
    sandbox: options.SandboxChoice = options.Sandbox.AUTO,
    engine: options.Engine = options.EngineName.LOCAL,
    address: options.Address = None,
    workers: options.Workers = None,
) -> None:
    """Search for the best plan for each run of a task, with perfect information: draws and weather to come.

    A plan shows what could be reached. It is the best found so far, not proven optimal. Stop the command whenever you like; run it
    again to continue with the remaining runs.
    """
    if (task is None) == (not submit):
        refuse("Name the task to plan for (glbench bound GreenhouseReal-v1), or plans to hand in (--submit FILE).", GlbenchError)
    if submit and (scenario or start or out or workers or iterations != _ITERATIONS):
        refuse("--submit hands in existing plans. Leave out --scenario, --start, --iterations, --workers and --out.", GlbenchError)
    if task is None:
        from glbench.bounds import submit as submit_plans

        with console.messages().status("replaying"):
            plans = list(submit_plans(submit or []))
        console.show(console.View(submission_parts(plans)))
        return
    options.check_engine(engine, address)
    search = replace(make_search(task, scenario, split, start, iterations, out, sandbox, workers), address=address)
    results = list(search.stored())
    if others := sum(one.how != (search.start.agent.name, search.iterations) for one in results):
        console.print_warning(
            f"{console.count(others, 'plan')} of another --start or --iterations kept. To plan again, choose another --out."
        )
    remaining = len(search.groups) - len(results)
    alike = "" if len(search.groups) == len(search.seeds) else ", with the same given in some of them"
    words = (
        f"Planning {styled(search.task.id, 'bold')}: {console.count(len(search.seeds), 'run')}{alike}; {remaining} to plan, each with "
        f"{console.count(search.iterations, 'iteration')}, beginning as {search.start.agent.name} does, in {search.folder}"
    )
    console.put_parts([console.paragraph(Markup(words), aside=True)])
    with console.interruption(lambda: f"{console.count(len(results), 'plan')} kept. Run the same command again to continue."):
        for one in _plans(search, engine, remaining):
            results.append(one)
            if one.reason:
                console.print_warning(f"No plan for seed {one.seeds[0]}: {one.reason}")
            elif one.value is not None and not console.messages().is_terminal:
                gain = one.value
                console.tell(f"seed {one.seeds[0]}: reward {gain.reward:,.2f}, profit {gain.epi:,.2f} EUR/m2, penalty {gain.penalty:,.2f}")
    console.show(console.View(plan_parts(search, results), code=1 if any(one.reason for one in results) else 0))


def make_search(
    task: str,
    scenario: Sequence[int] | None,
    split: str,
    start: str | None,
    iterations: int,
    out: Path | None,
    sandbox: options.Sandbox,
    workers: int | None,
) -> Search:
    """The search that the options of ``glbench bound`` describe."""
    from glbench.bounds import Search, best_known, repeats_actions
    from glbench.env.actuation import actions_of
    from glbench.evaluation import protect
    from glbench.evaluation.files import ensure_writable
    from glbench.evaluation.records import usable_cores
    from glbench.resources import data_folder
    from glbench.tasks import get_task

    spec = get_task(task)
    if spec.splits is not None and split != "preview":
        spec = spec.in_split(split)
    elif split != "test":
        refuse(f"{spec.id} has no split '{split}' to plan for. Leave --split out.", GlbenchError)
    actions_of(spec, spec.initial_controls, spec.initial_controls)  # refuses set points before the search
    seeds = tuple(dict.fromkeys(scenario or spec.evaluation.seeds))
    if start is None:
        book = best_known().book(spec)
        is_complete = book is not None and book.why_not(spec) is None and set(seeds) <= set(book.runs)
        start = "best_known" if is_complete else str(data_folder("submissions") / _EXAMPLE)
    folder = out or Path("runs") / "bound" / (spec.short_id + (f"-{split}" if split != "test" else ""))
    if Path(start).suffix == ".json":
        start = str(repeats_actions(Path(start), folder / "start"))
    agent = protect(start, sandbox.value)
    ensure_writable(folder)
    return Search(spec, seeds, agent, folder, iterations, workers or usable_cores())


def _plans(search: Search, engine: options.EngineName, remaining: int) -> Iterator[PlanOutcome]:
    """Plan the remaining runs, with a progress bar."""
    if not remaining:
        return
    steps = search.task.steps
    with Bar("beginning", steps, time_left=True) as bar:
        jobs = search.jobs(lambda standing: bar.move(standing.step) if bar.is_time() else None)
    with Bar("planning", remaining * search.iterations, "{task.fields[words]}", time_left=True, words="") as bar:
        completed = 0

        def listen(seed: int, iteration: Iteration) -> None:
            nonlocal completed
            completed += 1
            bar.move(completed, words=f"seed {seed}: {iteration.reward:,.2f}")
            if not bar.on_terminal:
                console.tell(f"seed {seed}, iteration {iteration.number} of {search.iterations}: reward {iteration.reward:,.2f} EUR/m2")

        yield from search.run(jobs, engine=engine.value, listener=listen)


def plan_parts(search: Search, results: Sequence[PlanOutcome]) -> Iterator[console.Part]:
    """Plans compared with the best known ones, and the next command."""
    from glbench.bounds import best_known
    from glbench.leaderboard.catalogue import catalogue
    from glbench.quantities import pretty_unit

    book, unit = best_known().book(search.task), pretty_unit(catalogue(search.task).metrics["reward"].unit)
    if book is not None and book.why_not(search.task) is not None:
        book = None
    plans = sorted((one for one in results if one.value is not None), key=lambda one: one.seeds)
    numbers = ("Reward", "Profit", "Penalty", "Known", "Gained")
    caption = f"Profit in EUR/m², all else in {unit or 'points'}. Known: the reward of the best known plan so far."
    view = console.table(f"Plans for {search.task.id}", "Seed", *numbers, numbers=("Seed", *numbers), caption=caption)
    total = 0.0
    for one in plans:
        assert one.value is not None
        total += one.value.reward * len(one.seeds)
        seeds = str(one.seeds[0]) if len(one.seeds) == 1 else f"{one.seeds[0]} + {len(one.seeds) - 1} alike"
        best = book.about_run(one.seeds[0]) if book is not None and one.seeds[0] in book.runs else None
        before = None if best is None else float(best["reward"])
        view.add(
            seeds,
            *(f"{value:,.2f}" for value in one.value),
            "-" if before is None else f"{before:,.2f}",
            "-" if before is None else f"{one.value.reward - before:+,.2f}",
        )
    yield view
    if not plans:
        return
    runs = sum(len(one.seeds) for one in plans)
    yield console.Line(f"Mean reward of {console.count(runs, 'run')}: {total / runs:,.3f} {unit}")
    folder, task = console.quoted(search.folder), console.quoted(search.task.short_id if search.task.locked else search.task.source)
    if search.task.locked and search.task.split in (None, "test"):
        yield console.aside(f"Hand in plans that beat the best known ones with: glbench bound --submit {folder}")
    elif search.task.split != "training":
        search.save_card()
        planned = sorted(seed for one in plans for seed in one.seeds)
        row = next((row for row, seed in enumerate(planned) if seed != planned[0] + row), len(planned))
        some = "" if planned == list(search.task.evaluation.seeds) else f" --seed {planned[0]} --runs {row}"
        split = "" if search.task.split in (None, "test") else f" --split {search.task.split}"
        yield console.aside(f"Evaluate the plans with: glbench evaluate {folder} --task {task}{split}{some}")


def submission_parts(plans: Sequence[PlanComparison]) -> Iterator[console.Part]:
    """Plans that were handed in beside the best known ones, task by task."""
    numbers = ("Handed in", "Known", "Gained")
    for task_id in dict.fromkeys(one.task.id for one in plans):
        of_task = [one for one in plans if one.task.id == task_id]
        view = console.table(f"Plans for {task_id}", "Seed", *numbers, "", numbers=("Seed", *numbers))
        for one in of_task:
            best = one.best_value.reward if one.best_value is not None else None
            view.add(
                str(one.seed),
                f"{one.value.reward:,.3f}",
                "-" if best is None else f"{best:,.3f}",
                "-" if best is None else f"{one.value.reward - best:+,.3f}",
                "taken" if one.is_better else "",
            )
        yield view
        better = sum(one.is_better for one in of_task)
        yield console.Line(f"{better} of {len(of_task)} plans for {task_id} are better than the best known and take their places.")


def dispatch(
    result: Annotated[
        Path,
        typer.Argument(metavar="RESULT", help="Result file (.json) of a task with an energy system; its recorded actions are beside it."),
    ],
    run: Annotated[list[int] | None, typer.Option("--run", help="Seed of a run to compare; repeatable. Default: all runs.")] = None,
    buffer: Annotated[
        float | None, typer.Option("--buffer", min=0, max=1e3, help="Try a buffer of this size [MJ m-2]. Default: the task's.")
    ] = None,
    round_file: options.RoundFile = None,
    as_json: options.AsJson = False,
) -> None:
    """Compare what recorded runs paid for energy and CO2 with the least they could have paid: what buffer and engine earn.

    For the same heat in the pipes, light and CO2 in every step, a linear programme finds the cheapest way to run boiler, engine and
    buffer, with all prices known in advance. The engine may run at any load and start at any time, so no real control is cheaper. Where
    the task switches the engine, another row has the cheapest way found that keeps its rules.
    """
    from glbench.bounds.energy_costs import costs_of_result, mean_costs
    from glbench.cli.evaluate import agents_print_to_stderr
    from glbench.evaluation import load_result

    failed = [one.seed for one in load_result(result).failed if not run or one.seed in run]
    if failed:
        console.print_warning(f"Failed runs are left out: {', '.join(map(str, failed))}.")
    with agents_print_to_stderr(as_json), console.messages().status("replaying the runs and finding their least cost"):
        costs = dict(costs_of_result(result, run or (), buffer, options.round_of(round_file)))
    document = {"unit": "EUR m-2", "runs": {str(seed): asdict(one) for seed, one in costs.items()}}
    every = list(costs.values())
    name = result.name.removesuffix(".json")
    console.show(console.View(cost_parts(name, every, mean_costs(every), buffer), document), as_json=as_json)


def cost_parts(name: str, costs: Sequence[Costs], mean: Costs, buffer: float | None) -> Iterator[console.Part]:
    """Energy and CO2 costs of runs: as recorded, the lower bound, and the value of buffer and engine."""

    def money(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}"

    several = len(costs) > 1
    numbers = ("Cost", *(("Range",) if several else ()), "Saved")
    size = "" if buffer is None else f"; all rows but the first: buffer of {buffer:g} MJ/m2"
    runs = f"mean of {len(costs)} runs" if several else "one run"
    caption = f"EUR/m2, {runs}; saved: relative to what the runs paid{size}"
    view = console.table(f"Energy and CO2 of {name}", "", *numbers, numbers=numbers, caption=caption)
    for row, words in _ROWS.items():
        value, every = getattr(mean, row), [getattr(one, row) for one in costs]
        if row == "ruled" and every == [None] * len(every):
            continue
        span = [] if not several else ["-" if value is None else f"{min(every):.3f} to {max(every):.3f}"]
        saved = "-" if row == "run" or value is None else f"{mean.run - value:+.3f}"
        view.add(words, money(value), *span, saved)
    yield view
    gains = [f"{words} {money(getattr(mean, one))}" for one, words in _EARNS.items() if getattr(mean, one) is not None]
    if gains:
        missed = f" Missed by the runs: {money(mean.left)}." if buffer is None else ""
        yield console.Line(f"Earned at best [EUR/m2]: {', '.join(gains)}.{missed}")
