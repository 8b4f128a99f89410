"""``glbench report``: one page of all results; ``glbench story``: what an agent does differently from the rules, in words."""

from __future__ import annotations

import os
import webbrowser
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli import console, options
from glbench.cli.console import plain
from glbench.cli.console import show as show_view
from glbench.cli.options import REPORTS, AsJson, OneTask, Out, Workers, check_file, is_file, result_file, task_or_default, warn_of
from glbench.errors import ResultError, did_you_mean, refuse
from glbench.extras import require
from glbench.resources import data_package, how_to_get_data, is_released, write_atomically
from glbench.untrusted import visible

if TYPE_CHECKING:
    from glbench.evaluation import Result

_MOST_NAMES = 3
_RULES, _ENERGY_RULES, _HARVEST_RULES = "rule_based_tuned", "rule_based_energy", "rule_based_harvest"


def report(
    out: Out = REPORTS,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    complete: Annotated[
        bool,
        typer.Option(
            "--complete",
            help="First make the missing profiles (days, season, worst run) by replaying the recorded actions of results in OUT.",
        ),
    ] = False,
    workers: Workers = None,
) -> None:
    """Make a page of all results: leaderboard, agents, comparisons, tasks. It works offline and on a phone.

    Results are read from OUT/results and from the released results that come with glbench. Nothing is simulated, but for --complete.
    """
    require("The report", "report", "jinja2", "plotly")
    options.check_folder(out)
    from glbench.report import write_report

    if complete:
        _complete(out, workers or os.cpu_count() or 1)
    with console.messages().status("making the page"):
        path, page = write_report(out)
    warn_of(page.left_out)
    if page.sealed:
        console.print_warning(
            "The page shows weather and climate of the runs of a sealed round. Publish it only after the round; before, "
            "publish the tables of glbench leaderboard --write."
        )
    size = path.stat().st_size / 1e6
    console.write(f"{path} ({console.count(page.results, 'result')}, {size:.1f} MB)")
    package = data_package()
    elsewhere = package is not None and package.folder is None
    if elsewhere:
        console.print_warning(f"The page lacks days, seasons and worst runs of the results that came with glbench. {how_to_get_data()}")
    missing = [path for path in page.without_profile if not (elsewhere and is_released(path))]
    if missing and not complete:
        which = "No result has" if len(missing) == page.results else f"{len(missing)} of {page.results} results do not have"
        own_first = sorted(missing, key=lambda path: not path.is_relative_to(out))
        console.print_warning(
            f"{which} a profile, so that the page lacks typical day, season and worst run of {_names(own_first)}. "
            "`glbench report --complete` makes them where the recorded actions (.actions.mcap) are beside the result; "
            "elsewhere evaluate again with --fresh."
        )
    if show:
        _open(path)


def _complete(out: Path, workers: int) -> None:
    """Make profiles of the results below ``out``; beside those that come with glbench nothing is written."""
    from glbench.evaluation.evaluation import TRIALS, VALIDATION
    from glbench.leaderboard.collect import read_folder
    from glbench.report import complete_profiles

    with console.messages().status("looking for missing profiles") as status:
        folders = [out / "results", *(out / place / "results" for place in (TRIALS, VALIDATION))]
        stored = [item for folder in folders for item in read_folder(folder)[0]]  # in one call, the full result would hide its trial
        completion = complete_profiles(stored, workers, lambda path: status.update(f"replaying {plain(visible(str(path)))}"))
    for path in completion.profiles:
        console.tell(f"Made: {visible(str(path))}")
    if completion.impossible:
        console.print_warning(
            f"{console.count(len(completion.impossible), 'result')} cannot have days and seasons: "
            f"{_names([path for path, _ in completion.impossible])}. {visible(completion.impossible[0][1])} Evaluate again with "
            "`glbench evaluate ... --fresh`, which makes profiles by itself."
        )


def _names(paths: Sequence[Path]) -> str:
    names = [visible(f"{path.parent.name}/{path.name.removesuffix('.json')}") for path in paths]
    return ", ".join(names[:_MOST_NAMES]) + (f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else "")


def _open(page: Path) -> None:
    if not webbrowser.open(page.resolve().as_uri()):
        console.print_warning(f"No browser could be started. Open {page.resolve().as_uri()} yourself.")


def story(
    agent: Annotated[
        str, typer.Argument(metavar="RESULT|AGENT", help="A result file (.json) with its recorded actions, or an agent that has one.")
    ],
    task: OneTask = None,
    against: Annotated[
        str | None,
        typer.Option(
            "--against",
            metavar="RESULT|AGENT",
            help="Another result file, or the name of an agent with a result in the same folder. "
            f"Default: {_RULES}; {_ENERGY_RULES} on tasks that show the price of power; {_HARVEST_RULES} on tasks with a harvest.",
        ),
    ] = None,
    page: Annotated[Path | None, typer.Option("--page", help="Write a page (.html) with tables and charts, too.")] = None,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    as_json: AsJson = False,
    workers: Workers = None,
) -> None:
    """Tell what an agent does differently from another, at night, at dawn, on bright and on dull days, and what each period earns.

    Both are simulated again from their recorded actions, on the seeds that they share. The periods add up to the whole run.
    """
    from glbench.evaluation import load_result
    from glbench.report.story import document_of, page_of, text_of
    from glbench.report.story import tell as tell_story

    if show and page is None:
        refuse("--open opens the page that --page FILE.html writes: give it, too.", ResultError)
    if page is not None:
        require("--page", "report", "jinja2")
    result = result_file(agent, task)
    loaded = load_result(result)
    if task is not None and loaded.task.id != task_or_default(task).id:
        refuse(f"{result} is a result on {loaded.task.id}, but --task says {task}. Leave out --task.", ResultError)
    check_file(page, ".html")
    other = _other(result, loaded, against)
    with console.messages().status("simulating both again"):
        differences = tell_story(result, other, workers or os.cpu_count() or 1)

    def parts() -> Iterator[console.Line]:
        for number, text in enumerate(text_of(differences)):
            yield console.paragraph(text, "bold" if number == 0 else "")
            yield console.Line("")

    show_view(console.View(parts(), lambda: document_of(differences)), as_json=as_json)
    if page is not None:
        write_atomically(page, page_of(differences))
        console.tell(f"Saved: {page}")
        if show:
            _open(page)


def _other(path: Path, result: Result, against: str | None) -> Path:
    """The result to compare with: a file, or that of an agent in the same folder. Raises ``ResultError`` when there is none."""
    from glbench.agents.energy_rules import POWER
    from glbench.agents.harvest_rules import HARVEST
    from glbench.evaluation.evaluation import TRIALS, VALIDATION
    from glbench.evaluation.saving import task_of_result
    from glbench.registration import task_argument

    if against is not None and is_file(against):
        return Path(against)
    if against is None:
        task = task_of_result(result, path)
        harvests, priced = HARVEST in task.actuation.controls, POWER in (column.name for column in task.observed())
        against = _HARVEST_RULES if harvests else _ENERGY_RULES if priced else _RULES
    other = path.with_name(f"{against}.json")
    if other.is_file():
        return other
    out = path.resolve().parent.parent.parent  # OUT/results/TASK/agent.json, of a trial OUT/trials/results/...
    split = " --split validation" if out.name == VALIDATION else ""
    out = out.parent if out.name in (TRIALS, VALIDATION) else out
    where = split + ("" if out == REPORTS.resolve() else f" --out {console.quoted(out)}")
    seeds = result.evaluation.seeds
    here = sorted(one.stem for one in path.parent.glob("*.json") if "." not in one.stem and one != path)
    msg = (
        f"There is no result {other} to tell {path.name} against.{did_you_mean(against, here, list_few=False)} "
        "Make that result, with the same seeds: "
        f"glbench evaluate {console.quoted(against)} --task {task_argument(result.task.id)} --seed {seeds[0]} --runs {len(seeds)}{where}, "
        f"or give another: --against {' or '.join(here) if here else 'RESULT.json'}."
    )
    raise ResultError(msg)
