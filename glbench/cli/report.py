"""``glbench report``: one page of all results, to be opened in a browser."""

from __future__ import annotations

import os
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, print_warning, put, tell
from glbench.cli.options import REPORTS, Out, Workers
from glbench.cli.stored import warn_of
from glbench.extras import require
from glbench.resources import data_package, how_to_get_data, is_released

if TYPE_CHECKING:
    from glbench.report import Completion

_SHOWN = 3


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

    Results are read from OUT/results and from the released results that come with glbench.
    Nothing is simulated, but for --complete.
    """
    require("The report", "report", "jinja2", "plotly")
    from glbench.report import write_report

    if complete:
        _complete(out, workers or os.cpu_count() or 1)
    with messages().status("making the page"):
        path, page = write_report(out)
    warn_of(page.left_out)
    size = path.stat().st_size / 1e6
    put(f"{path} ({page.results} results, {size:.1f} MB)")
    beside = data_package()
    elsewhere = beside is not None and beside.folder is None
    if elsewhere:
        print_warning(
            f"The page lacks days, seasons and worst runs of the results that came with glbench. {how_to_get_data()}"
        )
    missing = [path for path in page.without_profile if not (elsewhere and is_released(path))]
    if missing and not complete:
        ours = sorted(missing, key=lambda path: not path.is_relative_to(out))
        _say_what_is_missing(ours, page.results)
    if show and not webbrowser.open(path.resolve().as_uri()):
        print_warning(f"No browser could be started. Open {path.resolve().as_uri()} yourself.")


def _complete(out: Path, workers: int) -> None:
    """Profiles of the results below ``out``; those that come with glbench are not ours to write beside."""
    from glbench.leaderboard import collect_results
    from glbench.report import complete_profiles

    with messages().status("looking for missing profiles") as status:
        done = complete_profiles(
            collect_results([out / "results"]), workers, lambda path: status.update(f"replaying {path}")
        )
    _say_what_was_made(done)


def _say_what_was_made(done: Completion) -> None:
    for path in done.made:
        tell(f"Made: {path}")
    if not done.impossible:
        return
    print_warning(
        f"{len(done.impossible)} results stay without days and seasons, among them {_some([path for path, _ in done.impossible])}. "
        f"{done.impossible[0][1]} Evaluate them again with `glbench evaluate ... --fresh`, which makes profiles by itself."
    )


def _say_what_is_missing(paths: Sequence[Path], total: int) -> None:
    count = "No result has" if len(paths) == total else f"{len(paths)} of {total} results do not have"
    print_warning(
        f"{count} a profile, so that the page lacks typical day, season and worst run of {_some(paths)}. "
        "`glbench report --complete` makes them where the recorded actions (.actions.mcap) are beside the result; "
        "elsewhere evaluate again with --fresh."
    )


def _some(paths: Sequence[Path]) -> str:
    names = [f"{path.parent.name}/{path.name.removesuffix('.json')}" for path in paths]
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more
