"""``glbench validate``: the model against a season that was measured and published."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import output, print_warning, put, put_json, table, tell
from glbench.cli.options import AsJson
from glbench.cli.progress import Bar

if TYPE_CHECKING:
    from rich.table import Table

    from glbench.realism import Comparison, House

_FIGURES, _PICTURE = "comparison.json", "comparison.png"


def validate(
    folder: Annotated[
        Path,
        typer.Argument(help="The unpacked archive of the second Autonomous Greenhouse Challenge (docs/realism.md)."),
    ],
    sets: Annotated[
        list[str] | None,
        typer.Option(
            "--set", "-s", help="Parameter set to compare, such as paper or mixed_2021; repeatable. Default: all."
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            "--settings", help="Page of assumptions (TOML): lamps, plants, set points. Default: that of glbench."
        ),
    ] = None,
    warmer: Annotated[
        float,
        typer.Option(
            "--warmer", min=-10.0, max=10.0, help="Heat and ventilate at so much more than the page says [K]."
        ),
    ] = 0.0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", "-o", help=f"Folder for {_FIGURES} (sums and statistics) and {_PICTURE} (days; needs matplotlib)."
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare simulated with measured heat and harvest, by day, month and season.

    Each compartment is simulated with the measured weather and the measured daily light and CO2. Its set points were not read from the
    archive: the same page of settings stands for all growers.
    """
    from glbench.evaluation.files import ensure_writable
    from glbench.realism import (
        SHIPPED,
        check_pictures,
        choose_houses,
        compare,
        read_archive,
        read_settings,
        save_comparison,
        write_picture,
    )

    houses = choose_houses(tuple(sets or ()))
    page = read_settings(settings or SHIPPED)
    if out is not None:
        check_pictures()
        ensure_writable(out)
    archive = read_archive(folder)
    with Bar("simulating", len(houses) * archive.days, "{task.fields[words]}", time_left=True, words="") as bar:

        def show(house: House, done: int, days: int) -> None:
            bar.move(houses.index(house) * days + done, words=house.name)
            if done == days and not bar.on_terminal:
                tell(f"{house.name}: {days} days simulated")

        comparison, seasons = compare(archive, houses, page, warmer=warmer, progress=show)
    if out is not None:
        save_comparison(comparison, out / _FIGURES)
        write_picture(archive, seasons, page, out / _PICTURE)
    if as_json:
        put_json(comparison.model_dump(mode="json"))
    else:
        _print(comparison)
    if out is not None:
        tell(
            f"Saved {out / _FIGURES} and {out / _PICTURE}. The picture shows measured days: mind the archive's licence."
        )


def _print(comparison: Comparison) -> None:
    for note in comparison.notes:
        print_warning(note)
    for unused in _unused(comparison):
        print_warning(unused)
    output().print(_season(comparison))
    output().print(_months(comparison))
    by_pipes = ", ".join(f"{house.name} {house.pipe_heat:.0f}" for house in comparison.houses)
    put(
        "The organisers computed the measured heat from pipe temperatures; the simulated heat is the boiler's. By their formula "
        f"the simulated pipes give off, in MJ/m2: {by_pipes}."
    )
    put(
        f"Growers differ by {comparison.heat_spread:.2f} MJ/m2/d in one weather (RMS of a compartment's measured heat around the mean of "
        "all): a simulation that knows nothing of theirs cannot come closer to single compartments."
    )


def _season(comparison: Comparison) -> Table:
    """Sums and days: a block a parameter set, a row a compartment."""
    numbers = ("heat", "sim.", "ratio", "bias", "RMSE", "fruit", "sim.", "ratio")
    warmer = f", {comparison.warmer:+g} K" if comparison.warmer else ""
    view = table(
        f"{comparison.first} to {comparison.last}{warmer}: heat in MJ/m2, fruit in kg/m2",
        "", *numbers, right=numbers, padding=(0, 1),
        caption="Bold: mean of all compartments; sim.: simulated. Bias and RMSE: simulated minus measured heat of a day, in MJ/m2.",
    )  # fmt: skip
    for house in comparison.houses:
        heat, fruit = (
            (house.mean(lambda one: one.heat.measured), house.mean(lambda one: one.heat.simulated)),
            (house.mean(lambda one: one.harvest.measured), house.mean(lambda one: one.harvest.simulated)),
        )
        view.add_row(
            f"[bold]{house.name}[/]",
            *(
                f"[bold]{text}[/]"
                for text in (*_pair(*heat, 0), f"{house.heat_bias():+.2f}", f"{house.heat_rmse:.2f}", *_pair(*fruit, 1))
            ),
        )
        for one in house.compartments:
            view.add_row(
                f"  {one.name}",
                *_pair(one.heat.measured, one.heat.simulated, 0),
                f"{one.heat.bias:+.2f}",
                f"{one.heat.rmse:.2f}",
                *_pair(one.harvest.measured, one.harvest.simulated, 1),
            )
        view.add_section()
    return view


def _pair(measured: float, simulated: float, digits: int) -> tuple[str, str, str]:
    """Measured, simulated and their ratio."""
    ratio = simulated / measured if measured else math.nan
    return f"{measured:.{digits}f}", f"{simulated:.{digits}f}", "-" if math.isnan(ratio) else f"{ratio:.2f}"


def _months(comparison: Comparison) -> Table:
    """What is off in which month, means over the compartments."""
    months = comparison.months
    shown = [f"{month[5:]}/{month[2:4]}" for month in months]
    title = "Simulated minus measured: heat in MJ/m2 a day, fruit in kg/m2 a month"
    view = table(title, "", "", *shown, right=shown, padding=(0, 1))
    for house in comparison.houses:
        heat = (f"{house.heat_bias(month):+.2f}" for month in months)
        fruit = (f"{house.harvest_bias(month):+.2f}" for month in months)
        view.add_row(house.name, "heat", *heat)
        view.add_row("", "fruit", *fruit)
    return view


def _unused(comparison: Comparison) -> list[str]:
    """Light or CO2 that the installed capacity could not give."""
    said = []
    for house in comparison.houses:
        for one in house.compartments:
            for what, given, unit in (("lamps", one.lamps, "kWh/m2"), ("CO2", one.co2, "kg/m2")):
                if given.simulated < given.measured * (1.0 - 1e-3):
                    said.append(
                        f"{house.name}, {one.name}: of {given.measured:.2f} {unit} measured ({what}) the simulation used "
                        f"{given.simulated:.2f}, which is all that is installed."
                    )
    return said
