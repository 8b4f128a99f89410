"""``glbench episodes dispatch``: what boiler, engine, buffer and prices earned in recorded runs, and what they could have earned."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output, print_warning, put, put_json, table
from glbench.cli.options import AsJson, RoundFile, round_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from glbench.bounds.energy_costs import Costs

_ROWS = {
    "run": "As the runs did it",
    "least": "At least",
    "blind": "At least, planned at mean prices",
    "without_buffer": "At least, without the buffer",
    "without_engine": "At least, without the engine",
    "boiler_alone": "At least, with the boiler alone",
}
_EARNS = {
    "buffer_earns": "the buffer",
    "engine_earns": "the engine",
    "looking_earns": "looking at the prices",
}


def dispatch(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT", help="A result file (.json) with its recorded actions, of a task with an energy system."
        ),
    ],
    run: Annotated[
        list[int] | None, typer.Option("--run", help="Seed of a run; repeatable. Default: all runs.")
    ] = None,
    buffer: Annotated[
        float | None,
        typer.Option("--buffer", min=0, help="Size of another buffer to try [MJ m-2]. Default: the task's."),
    ] = None,
    round_file: RoundFile = None,
    as_json: AsJson = False,
) -> None:
    """Show what the energy of recorded runs cost, and what it could have cost: what buffer, engine and looking at prices earn.

    For the same heat in the pipes, light and CO2 in every step, a linear programme finds the cheapest way to run boiler and engine, with
    all prices known beforehand. The engine may run at any load and start at any time, so that no real control is cheaper.
    """
    from glbench.bounds.energy_costs import costs_of_result, mean_costs
    from glbench.evaluation import load_result

    failed = [one.seed for one in load_result(result).failed if not run or one.seed in run]
    if failed:
        print_warning(f"Failed runs are left out: {', '.join(map(str, failed))}.")
    with messages().status("simulating the runs again, and dispatching them"):
        found = dict(costs_of_result(result, run or (), buffer, round_of(round_file)))
    if as_json:
        put_json({"unit": "EUR m-2", "runs": {str(seed): asdict(one) for seed, one in found.items()}})
    else:
        _show(result, list(found.values()), mean_costs(list(found.values())), buffer)


def _show(result: Path, found: Sequence[Costs], mean: Costs, buffer: float | None) -> None:
    many = len(found) > 1
    numbers = ("Cost", *(("Range",) if many else ()), "Saved")
    size = "" if buffer is None else f"; all but the first with a buffer of {buffer:g} MJ/m2"
    caption = f"EUR/m2, {f'mean of {len(found)} runs' if many else 'one run'}; saved: of what the runs paid{size}"
    view = table(f"Energy and CO2 of {result.name.removesuffix('.json')}", "", *numbers, right=numbers, caption=caption)
    for name, words in _ROWS.items():
        value, every = getattr(mean, name), [getattr(one, name) for one in found]
        span = [] if not many else ["-" if value is None else f"{min(every):.3f} to {max(every):.3f}"]
        saved = "-" if name == "run" or value is None else f"{mean.run - value:+.3f}"
        view.add_row(words, _money(value), *span, saved)
    output().print(view)
    earned = [
        f"{words} {_money(getattr(mean, name))}" for name, words in _EARNS.items() if getattr(mean, name) is not None
    ]
    if earned:
        put(f"Earned at best [EUR/m2]: {', '.join(earned)}. Left by the runs: {_money(mean.left)}.")


def _money(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
