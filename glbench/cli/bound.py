"""``glbench bound``: search for better plans for a task's runs with perfect information, and hand in those that beat the best known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output, print_warning, put, say, table, tell
from glbench.cli.exiting import INTERRUPTED, tell_interrupted
from glbench.cli.options import Address, EngineName, Sandbox, SandboxChoice, Workers, check_address
from glbench.cli.progress import Bar
from glbench.errors import GlbenchError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from glbench.bounds import Better, Found, Search
    from glbench.control import Iteration

_EXAMPLE = "my_agent.py"


def bound(
    task: Annotated[str | None, typer.Argument(metavar="[TASK]", help="Task id or task file (.toml).")] = None,
    scenario: Annotated[
        list[int] | None, typer.Option("--scenario", help="Seed of a run; repeatable. Default: all scored runs.")
    ] = None,
    split: Annotated[
        str, typer.Option("--split", help="Split whose runs are planned, if the task has splits.")
    ] = "test",
    start: Annotated[
        str | None,
        typer.Option(
            "--start",
            help="Agent whose controls each plan starts from. Default: best_known if every run has a plan, else the example my_agent.",
        ),
    ] = None,
    iterations: Annotated[
        int,
        typer.Option(
            "--iterations", "-n", min=1, help="Iterations per plan; one takes about 3 s of one core for 5,760 steps."
        ),
    ] = 35,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Folder for the plans. Default: runs/bound/TASK. Finished plans are skipped."),
    ] = None,
    submit: Annotated[
        list[Path] | None,
        typer.Option(
            "--submit",
            metavar="FILE",
            help="Hand in plans that beat the best known: a folder or file of this command, or any agent's result (.json); repeatable.",
        ),
    ] = None,
    sandbox: SandboxChoice = Sandbox.AUTO,
    engine: Annotated[
        EngineName, typer.Option("--engine", help="Where to plan: on this machine, or on a Ray cluster.")
    ] = EngineName.LOCAL,
    address: Address = None,
    workers: Workers = None,
) -> None:
    """Search for the best plan for each run of a task, with perfect information: draws and weather to come.

    A plan shows what could be reached. It is the best found so far, not proven optimal. Stop the command whenever you like; run it
    again to continue with the remaining runs.
    """
    if (task is None) == (not submit):
        msg = "Name the task to plan for (glbench bound Spring-v1), or plans to hand in (glbench bound --submit FILE)."
        raise GlbenchError(msg)
    if submit:
        _submit(submit)
    else:
        assert task is not None
        check_address(address, engine)
        search = _the_search(task, scenario, split, start, iterations, out, sandbox, workers)
        _search(replace(search, address=address), engine)


def _the_search(
    task: str,
    scenario: Sequence[int] | None,
    split: str,
    start: str | None,
    iterations: int,
    out: Path | None,
    sandbox: Sandbox,
    workers: int | None,
) -> Search:
    from glbench.bounds import Search, best_known
    from glbench.evaluation import protect
    from glbench.evaluation.provenance import usable_cores
    from glbench.resources import data_folder
    from glbench.tasks import get_task

    chosen = get_task(task)
    if chosen.splits is not None:
        chosen = chosen.in_split(split)
    elif split != "test":
        msg = f"{chosen.id} has no splits: all its runs share their seasons. Leave --split out."
        raise GlbenchError(msg)
    seeds = tuple(dict.fromkeys(scenario or chosen.evaluation.seeds))
    if start is None:
        book = best_known().book(chosen)
        all_known = book is not None and book.why_not(chosen) is None and set(seeds) <= set(book.runs)
        start = "best_known" if all_known else str(data_folder("submissions") / _EXAMPLE)
    name = chosen.short_id + (f"-{split}" if split != "test" else "")
    return Search(
        chosen,
        seeds,
        protect(start, sandbox.value),
        out or Path("runs") / "bound" / name,
        iterations,
        workers or usable_cores(),
    )


def _search(search: Search, engine: EngineName) -> None:
    stored = search.stored()
    left = len(search.groups) - len(stored)
    alike = "" if len(search.groups) == len(search.seeds) else ", with the same given in some of them"
    say(
        messages(),
        f"Planning [bold]{search.task.id}[/bold]: {len(search.seeds)} runs{alike}; {left} to plan, each with "
        f"{search.iterations} iterations, beginning as {search.start.agent.name} does, in {search.folder}",
    )
    found = list(stored)
    try:
        for one in _planned(search, engine, left):
            found.append(one)
            if one.reason:
                print_warning(f"No plan for seed {one.seeds[0]}: {one.reason}")
            elif not messages().is_terminal:
                tell(f"seed {one.seeds[0]}: {_said(one)}")
    except KeyboardInterrupt:
        tell_interrupted("The plans found so far are kept. Run the same command again to continue.")
        raise typer.Exit(INTERRUPTED) from None
    _show(search, found)
    if any(one.reason for one in found):
        raise typer.Exit(1)


def _planned(search: Search, engine: EngineName, left: int) -> Iterator[Found]:
    """Plan the remaining runs, with a progress bar."""
    if not left:
        return
    steps = search.task.steps
    with Bar("beginning", steps, time_left=True) as bar:
        orders = search.orders(lambda standing: bar.move(standing.step) if bar.is_time() else None)
    with Bar("planning", left * search.iterations, "{task.fields[words]}", time_left=True, words="") as bar:
        done = 0

        def listen(seed: int, iteration: Iteration) -> None:
            nonlocal done
            done += 1
            bar.move(done, words=f"seed {seed}: {iteration.reward:,.2f}")

        yield from search.run(orders, engine=engine.value, listener=listen)


def _said(found: Found) -> str:
    assert found.earned is not None
    return (
        f"reward {found.earned.reward:,.2f}, profit {found.earned.epi:,.2f} EUR/m2, penalty {found.earned.penalty:,.2f}"
    )


def _show(search: Search, found: Sequence[Found]) -> None:
    from glbench.bounds import best_known

    book = best_known().book(search.task)
    if book is not None and book.why_not(search.task) is not None:
        book = None
    whole = [one for one in found if one.earned is not None]
    numbers = ("Reward", "Profit", "Penalty", "Known", "Gained")
    caption = "Profit in EUR/m2. Known: the reward of the best known plan so far."
    view = table(f"Plans for {search.task.id}", "Seed", *numbers, right=("Seed", *numbers), caption=caption)
    for one in sorted(whole, key=lambda one: one.seeds):
        assert one.earned is not None
        seeds = str(one.seeds[0]) if len(one.seeds) == 1 else f"{one.seeds[0]} + {len(one.seeds) - 1} alike"
        known = book.about_run(one.seeds[0]) if book is not None and one.seeds[0] in book.runs else None
        before = None if known is None else float(known["reward"])
        view.add_row(
            seeds,
            *(f"{value:,.2f}" for value in one.earned),
            "-" if before is None else f"{before:,.2f}",
            "-" if before is None else f"{one.earned.reward - before:+,.2f}",
        )
    output().print(view)
    if whole:
        runs = sum(len(one.seeds) for one in whole)
        mean = sum(one.earned.reward * len(one.seeds) for one in whole if one.earned is not None) / runs
        put(f"Mean reward of {runs} runs: {mean:,.3f}")
        if search.task.locked:
            tell(f"Hand in plans that beat the best known ones with: glbench bound --submit {search.folder}")
        elif search.task.split != "training":
            search.save_card()
            planned = sorted(seed for one in whole for seed in one.seeds)
            row = next((row for row, seed in enumerate(planned) if seed != planned[0] + row), len(planned))
            some = "" if planned == list(search.task.evaluation.seeds) else f" --seed {planned[0]} --runs {row}"
            split = "" if search.task.split in (None, "test") else f" --split {search.task.split}"
            tell(f"Evaluate the plans with: glbench evaluate {search.folder} --task {search.task.source}{split}{some}")


def _submit(files: Sequence[Path]) -> None:
    from glbench.bounds import submit

    with messages().status("replaying"):
        compared = list(submit(files))
    tasks: dict[str, list[Better]] = {}
    for one in compared:
        tasks.setdefault(one.task.id, []).append(one)
    for task_id, ones in tasks.items():
        _show_submitted(task_id, ones)


def _show_submitted(task_id: str, ones: Sequence[Better]) -> None:
    numbers = ("Handed in", "Known", "Gained")
    view = table(f"Plans for {task_id}", "Seed", *numbers, "", right=("Seed", *numbers))
    for one in ones:
        known = one.known.reward if one.known is not None else None
        view.add_row(
            str(one.seed),
            f"{one.earned.reward:,.3f}",
            "-" if known is None else f"{known:,.3f}",
            "-" if known is None else f"{one.earned.reward - known:+,.3f}",
            "taken" if one.is_better else "",
        )
    output().print(view)
    put(
        f"{sum(one.is_better for one in ones)} of {len(ones)} plans for {task_id} are better than the best known and take their places."
    )
