"""``glbench story``: what an agent does differently from the rules, in words, and what that earns."""

from __future__ import annotations

import os
import shlex
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output, print_warning, put_json, say, tell
from glbench.cli.options import REPORTS, AsJson, Workers
from glbench.errors import ResultError
from glbench.extras import require

if TYPE_CHECKING:
    from glbench.evaluation import Result

_RULES, _ENERGY_RULES = "rule_based_tuned", "rule_based_energy"


def story(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result file (.json) with its recorded actions.")],
    against: Annotated[
        str | None,
        typer.Option(
            "--against",
            metavar="RESULT|AGENT",
            help="Another result file, or the name of an agent with a result in the same folder. "
            f"Default: {_RULES}; of a task with an energy system {_ENERGY_RULES}.",
        ),
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--page", help="Write a page (.html) with tables and charts, too.")
    ] = None,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    as_json: AsJson = False,
    workers: Workers = None,
) -> None:
    """Tell what an agent does differently from another, at night, at dawn, on bright and on dull days, and what each period earns.

    Both are simulated again from their recorded actions, on the seeds that they share. The periods add up to the whole run.
    """
    from glbench.evaluation import load_result
    from glbench.report.story import tell as tell_story
    from glbench.report.story_page import document_of, page_of, text_of
    from glbench.resources import write_atomically

    if show and page is None:
        msg = "--open opens the page that --page FILE.html writes: give it, too."
        raise ResultError(msg)
    if page is not None:
        require("--page", "report", "jinja2")
    other = _other(result, load_result(result), against)
    with messages().status("simulating both again"):
        told = tell_story(result, other, workers or os.cpu_count() or 1)
    if as_json:
        put_json(document_of(told))
    else:
        for number, paragraph in enumerate(text_of(told)):
            say(output(), paragraph, style="bold" if number == 0 else None)
            output().print()
    if page is not None:
        write_atomically(page, page_of(told))
        tell(f"Saved: {page}")
    if show and page is not None and not webbrowser.open(page.resolve().as_uri()):
        print_warning(f"No browser could be started. Open {page.resolve().as_uri()} yourself.")


def _other(path: Path, result: Result, against: str | None) -> Path:
    """The result to hold it against: a file, or that of an agent in the same folder."""
    if against is not None and (against.endswith(".json") or Path(against).is_file()):
        return Path(against)
    name = against or _default(result, path)
    found = path.with_name(f"{name}.json")
    if not found.is_file():
        seeds = result.evaluation.seeds
        here = sorted(one.stem for one in path.parent.glob("*.json") if "." not in one.stem and one != path)
        msg = (
            f"There is no result {found} to tell {path.name} against. Make it, with the same seeds: "
            f"glbench evaluate {name} --task {result.task.id} --seed {seeds[0]} --runs {len(seeds)}{_out_of(path)}, "
            f"or give another: --against {' or '.join(here) if here else 'RESULT.json'}."
        )
        raise ResultError(msg)
    return found


def _out_of(path: Path) -> str:
    """The options by which an evaluation lands beside ``path``, where they have to be given."""
    from glbench.evaluation.preparing import TRIALS, VALIDATION

    out = path.resolve().parent.parent.parent  # OUT/results/TASK/agent.json, of a trial OUT/trials/results/...
    split = " --split validation" if out.name == VALIDATION else ""
    out = out.parent if out.name in (TRIALS, VALIDATION) else out
    return split + ("" if out == REPORTS.resolve() else f" --out {shlex.quote(str(out))}")


def _default(result: Result, path: Path) -> str:
    from glbench.evaluation.episodes import task_of_result
    from glbench.model.equipment import lacks_energy

    return _RULES if lacks_energy(task_of_result(result, path).model_value) else _ENERGY_RULES
