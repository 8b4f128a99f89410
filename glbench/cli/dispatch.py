"""``glbench episodes dispatch``: what recorded runs paid for energy and CO2, and the least they could have paid."""

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
    "run": "As recorded",
    "least": "Least cost",
    "blind": "Planned at mean prices",
    "without_buffer": "Least cost without the buffer",
    "without_engine": "Least cost without the engine",
    "boiler_alone": "Least cost with the boiler alone",
}
_EARNS = {
    "buffer_earns": "the buffer",
    "engine_earns": "the engine",
    "looking_earns": "knowing how prices vary",
}


def dispatch(
    result: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT",
            help="Result file (.json) of a task with an energy system; its recorded actions are beside it.",
        ),
    ],
    run: Annotated[
        list[int] | None, typer.Option("--run", help="Seed of a run to compare; repeatable. Default: all runs.")
    ] = None,
    buffer: Annotated[
        float | None,
        typer.Option("--buffer", min=0, help="Try a buffer of this size [MJ m-2]. Default: the task's."),
    ] = None,
    round_file: RoundFile = None,
    as_json: AsJson = False,
) -> None:
    """Compare what recorded runs paid for energy and CO2 with the least they could have paid: what buffer and engine earn.

    For the same heat in the pipes, light and CO2 in every step, a linear programme finds the cheapest way to run boiler, engine and
    buffer, with all prices known in advance. The engine may run at any load and start at any time, so no real control is cheaper.
    """
    from glbench.bounds.energy_costs import costs_of_result, mean_costs
    from glbench.evaluation import load_result

    failed = [one.seed for one in load_result(result).failed if not run or one.seed in run]
    if failed:
        print_warning(f"Failed runs are left out: {', '.join(map(str, failed))}.")
    with messages().status("replaying the runs and finding their least cost"):
        found = dict(costs_of_result(result, run or (), buffer, round_of(round_file)))
    if as_json:
        put_json({"unit": "EUR m-2", "runs": {str(seed): asdict(one) for seed, one in found.items()}})
    else:
        _show(result, list(found.values()), mean_costs(list(found.values())), buffer)


def _show(result: Path, found: Sequence[Costs], mean: Costs, buffer: float | None) -> None:
    many = len(found) > 1
    numbers = ("Cost", *(("Range",) if many else ()), "Saved")
    size = "" if buffer is None else f"; all rows but the first with a buffer of {buffer:g} MJ/m2"
    caption = (
        f"EUR/m2, {f'mean of {len(found)} runs' if many else 'one run'}; saved: relative to what the runs paid{size}"
    )
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
        put(f"Earned at best [EUR/m2]: {', '.join(earned)}. Missed by the runs: {_money(mean.left)}.")


def _money(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"
