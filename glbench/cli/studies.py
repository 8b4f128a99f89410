"""Studies of the model: its speed here (``bench``), how close it is to a measured season (``validate``), a fit to one (``identify``)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from glbench.cli import console
from glbench.cli.console import Markup, plain, styled
from glbench.cli.options import AsJson, check_file
from glbench.cli.progress import Bar, status_bar
from glbench.errors import ArchiveError, GlbenchError, refuse

if TYPE_CHECKING:
    from glbench.realism import ClimateComparison, Comparison, House
    from glbench.realism.board import Board
    from glbench.realism.climate import Errors
    from glbench.speed import SpeedRecord

_FIGURES, _PICTURE = "comparison.json", "comparison.png"
_CLIMATE, _BOARD = "climate.json", "board.json"
_BOARD_HOUSES = ("bleiswijk_2020", "mixed_2020")
_WIDTHS = (28, 9, 9, 8, 13)


def bench(
    what: Annotated[
        list[str] | None,
        typer.Argument(metavar="[WHAT]...", help="Groups or single measurements, such as step or vector/512. Default: all of them."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The most telling measurements only, in half a minute.")] = False,
    rounds: Annotated[int, typer.Option(min=1, help="How often each is set against the reference.")] = 7,
    out: Annotated[Path | None, typer.Option(help="Save the figures in this file (.json).")] = None,
) -> None:
    """Measure how fast the model steps on this machine, as ratios to CVODES measured in the same run.

    The reference is the method of the benchmark's paper: CasADi with CVODES at 1e-6, compiled just in time. Processor time is
    counted, so that other work on the machine disturbs little; only threads are timed on the wall.
    """
    from rich.progress import MofNCompleteColumn

    from glbench.speed import choose_subjects, measure, save_record

    check_file(out, ".json")
    if what and quick:
        refuse(f"--quick chooses the measurements itself. Leave out --quick or {' '.join(what)}.", GlbenchError)
    subjects = choose_subjects(what or (), quick=quick)
    with status_bar("compiling model and reference", len(subjects), MofNCompleteColumn()) as update:

        def progress(words: str, completed: int, total: int) -> None:
            update(description=words, completed=completed, total=total)

        record = measure(subjects, rounds=rounds, processes=not what, progress=progress)
    console.show(console.View(speed_parts(record)))
    if out is not None:
        save_record(record, out)
        console.tell(f"Saved {out}")


def speed_parts(record: SpeedRecord) -> Iterator[console.Part]:
    """The machine, a table for each group of measurements, first use and memory."""
    from glbench.speed.subjects import GROUPS

    machine, lanes = record.machine, record.kernel.get("lanes")
    name = styled(f"Speed of glbench {record.versions.glbench}", "bold")
    where = f"{machine.processor}, {machine.cores} cores, {machine.system}"
    yield console.Line(Markup(f"{name} on {plain(where)}"), wrap="always")
    how = f"backend {record.kernel['backend']}" + (f", {lanes:.0f} lanes, {record.kernel['compiler']}" if lanes else "")
    yield console.Line(f"Kernel: {how}", wrap="always")
    yield console.Line(f"Reference: {record.reference}; {console.count(record.rounds, 'round')} in turn", wrap="always")
    numbers = ("us a step", "steps/s", "x CVODES", "range")
    for group, title in GROUPS.items():
        view = console.table(title, "", *numbers, numbers=numbers, pad_edge=False)
        view.columns = [replace(column, min_width=width) for column, width in zip(view.columns, _WIDTHS, strict=True)]
        for one in record.measurements:
            if one.group == group:
                view.add(
                    one.title,
                    f"{one.microseconds:,.2f}",
                    f"{one.steps_per_second:,.0f}",
                    Markup(f"[bold]{one.ratio:,.1f}x[/]"),
                    f"{one.ratio_low:,.1f}..{one.ratio_high:,.1f}",
                )
        if view.rows:
            yield view
    if record.first_use is not None:
        yield console.Line(
            f"First use on an empty cache: {record.first_use.seconds:.1f} s, at most {record.first_use.megabytes:,.0f} MB "
            "(a wheel that carries the kernel has no such wait)",
            wrap="always",
        )
    if record.memory is not None:
        memory = record.memory
        each = (memory.megabytes - memory.megabytes_of_one) / memory.environments * 1024
        yield console.Line(
            f"Memory: {memory.megabytes:,.0f} MB for {memory.environments:,} environments, {memory.megabytes_of_one:,.0f} MB for one "
            f"({each:.1f} kB for each more)",
            wrap="always",
        )


def validate(
    folder: Annotated[
        Path,
        typer.Argument(
            help="The unpacked archive of the second Autonomous Greenhouse Challenge (docs/realism.md), or a greenhouse's own export "
            "(docs/measured-data.md)."
        ),
    ],
    by: Annotated[
        Literal["actuators", "set-points"] | None,
        typer.Option(
            "--by",
            help="What drives the simulation: what vents, screens, lamps, CO2 and pipes did, to compare the climate; or set points, to "
            "compare heat and harvest. Default: both where they can be compared.",
        ),
    ] = None,
    sets: Annotated[
        list[str] | None,
        typer.Option("--set", "-s", help="Parameter set, such as paper, or a page that glbench identify wrote; repeatable. Default: all."),
    ] = None,
    settings: Annotated[
        Path | None, typer.Option("--settings", help="Page of assumptions (TOML): lamps, plants, set points. Default: that of glbench.")
    ] = None,
    warmer: Annotated[
        float, typer.Option("--warmer", min=-10.0, max=10.0, help="Heat and ventilate at so much more than the page says [K].")
    ] = 0.0,
    agents: Annotated[
        str | None,
        typer.Option("--agents", help="Controllers, such as rule_based_tuned,grower: what each would have earned in the season."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help=f"Folder for {_FIGURES} and {_CLIMATE} (statistics) and for pictures (needs matplotlib)."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Compare a simulated with a measured season: climate by what the actuators did, heat and harvest by set points, money by --agents.

    By actuators, each compartment with a measured climate is simulated from its first reading on, with the measured weather. By set points,
    each compartment is simulated with the measured weather and the measured daily light and CO2; with --by set-points, one that has set
    points in its indoor climate by those.
    """
    from glbench import realism
    from glbench.evaluation.files import ensure_writable
    from glbench.resources import write_atomically

    if agents is not None and by is not None:
        refuse("--agents compares money alone. Leave --by out, or run the two one after the other.", ArchiveError)
    if agents is not None and not sets:
        sets = [next(name for name in _BOARD_HOUSES if name in realism.HOUSES)]
    houses = realism.choose_houses(tuple(sets or ()))
    page = realism.read_settings(settings or realism.SHIPPED)
    if out is not None:
        if agents is None:
            realism.check_pictures()
        ensure_writable(out)
    archive = realism.read_archive(folder, page.place.clock)
    if warmer and (agents is not None or by == "actuators" or (archive.own and by is None)):
        instead = "" if agents or archive.own else ", or compare --by set-points"
        refuse(f"--warmer shifts set points, and no set points are compared here. Leave it out{instead}.", ArchiveError)
    if agents is not None:
        from glbench.realism.board import board
        from glbench.realism.money import read_prices

        controllers = [name.strip() for name in agents.split(",") if name.strip()]
        with Bar("simulating", 100, "{task.fields[words]}", time_left=True, words="") as bar:
            rows = board(
                archive,
                houses,
                page,
                read_prices(),
                controllers,
                out=out,
                progress=lambda words, at, of: bar.move(100 * at // of, words=words),
            )
        if out is not None:
            write_atomically(out / _BOARD, rows.model_dump_json(indent=1) + "\n")
        console.show(console.View(board_parts(rows), lambda: rows.model_dump(mode="json")), as_json=as_json)
        return
    has_climate = any(one.indoor is not None for one in archive.compartments)
    if by == "actuators" and not has_climate:
        msg = f"No compartment in {folder} has an indoor climate (GreenhouseClimate.csv). Add one, or compare --by set-points."
        raise ArchiveError(msg)
    parts: list[Iterator[console.Part]] = []
    answers: dict[str, Any] = {}
    files: list[Path] = []
    if by != "set-points" and has_climate:
        with Bar("simulating", 100, "{task.fields[words]}", time_left=True, words="by actuators") as bar:
            climate, runs = realism.compare_climate(
                archive, houses, page, progress=lambda step, steps: bar.move(100 * step // steps, words="by actuators")
            )
        parts.append(climate_parts(climate, notes=climate.notes if by == "actuators" or archive.own else ()))
        answers["actuators"] = climate.model_dump(mode="json")
        if out is not None:
            write_atomically(out / _CLIMATE, climate.model_dump_json(indent=1) + "\n")
            files.append(out / _CLIMATE)
            for run, compartment in zip(runs, climate.compartments, strict=True):
                files += [out / f"mean-days-{run.name}.png", out / f"errors-{run.name}.png"]
                realism.draw_mean_days(run, files[-2])
                realism.draw_errors(compartment, files[-1])
    if by == "set-points" or (not archive.own and by is None):
        with Bar("simulating", len(houses) * archive.days, "{task.fields[words]}", time_left=True, words="") as bar:

            def update(house: House, day: int, days: int) -> None:
                bar.move(houses.index(house) * days + day, words=house.name)
                if day == days and not bar.on_terminal:
                    console.tell(f"{house.name}: {console.count(days, 'day')} simulated")

            comparison, seasons = realism.compare(archive, houses, page, own_set_points=by == "set-points", warmer=warmer, progress=update)
        parts.append(comparison_parts(comparison))
        answers["set_points"] = comparison.model_dump(mode="json")
        if out is not None:
            files += [out / _FIGURES, out / _PICTURE]
            write_atomically(files[-2], comparison.model_dump_json(indent=1) + "\n")
            realism.write_picture(archive, seasons, page, files[-1])
    view = console.View(chain(*parts), lambda: answers if len(answers) > 1 else next(iter(answers.values())))
    console.show(view, as_json=as_json)
    if files:
        names = ", ".join(path.name for path in files)
        console.tell(f"Saved in {out}: {names}. Pictures show measured values: mind the archive's licence.")


def climate_parts(comparison: ClimateComparison, notes: Sequence[str]) -> Iterator[console.Part]:
    """Errors of the free run by house, and by month and hours of the day of the house that is closest by temperature."""
    for note in (*notes, *(note for compartment in comparison.compartments for note in compartment.notes)):
        yield console.warning(note)
    numbers = ("K", "bias", "%", "bias", "ppm", "bias")

    def row(errors: Errors) -> list[str]:
        cells = []
        for channel, digits in (("air_temperature", 2), ("humidity", 1), ("co2", 0)):
            one = errors.get(channel)
            cells += ["-", "-"] if one is None else [f"{one.rmse:.{digits}f}", f"{one.bias:+.{digits}f}"]
        return cells

    for compartment in comparison.compartments:
        view = console.table(
            f"{compartment.name}, {comparison.first} to {comparison.last}, by actuators: temperature, humidity, CO2",
            "", *numbers, numbers=numbers, padding=(0, 1),
            caption="Simulated against measured air: root mean square error (K, %, ppm) and bias. Nothing of the measured air is used.",
        )  # fmt: skip
        for house in compartment.houses:
            view.add(Markup(styled(house.name, "bold")), *row(house.overall))
        view.end_section()
        closest = min(compartment.houses, key=lambda house: house.overall["air_temperature"].rmse)
        for title, groups in (("by month", closest.months), ("hours of day", closest.hours), ("weeks", closest.weeks)):
            view.add(Markup(styled(f"{closest.name}, {title}", "bold")), *[""] * len(numbers))
            for name, errors in groups.items():
                view.add(f"  {name}", *row(errors))
        yield view
        doubts = compartment.doubts
        yield console.Line(f"The climate of {compartment.name} is {'usable, but:' if doubts else 'usable.'}")
        for doubt in doubts:
            yield console.warning(doubt)


def board_parts(board: Board) -> Iterator[console.Part]:
    """Notes, a table of accounts for what was measured and for each house, and what is assumed."""
    for note in (*board.notes, *board.refused):
        yield console.warning(note)
    for house, ratio in {one.house: one.fruit_ratio for one in board.accounts}.items():
        numbers = ("fruit", "power", "heat", "CO2", *(("labour", "plants", "net") if house is None else ("net", "scaled")))
        title = f"{'Measured' if house is None else f'Simulated in {house}'}, {board.first} to {board.last}: EUR/m2, and amounts a m2"
        view = console.table(title, "", *numbers, numbers=numbers, padding=(0, 1), pad_edge=False)
        for one in (one for one in board.accounts if one.house == house):
            net, scaled = Markup(styled(f"{one.net():.2f}", "bold")), "-" if ratio is None else f"{one.net(ratio):.2f}"
            rest = (f"{-one.labour:.2f}", f"{-one.plants:.2f}", net) if house is None else (net, scaled)
            costs = (one.cost_electricity, one.cost_heat, one.cost_co2)
            view.add(one.name, f"{one.income:.2f}", *(f"{0.0 - cost:.2f}" for cost in costs), *rest)
            amounts = (f"{one.fruit:.1f} kg", f"{one.electricity:.0f} kWh", f"{one.heat:.0f} MJ", f"{one.co2:.1f} kg")
            view.add("", *amounts, *[""] * len(rest))
        yield view
    yield console.Line(
        f"Simulated fruit has {100.0 * board.dry_matter:.2f} % dry matter and {board.brix:.2f} degrees Brix, the means of "
        f"{board.compartment}, and is all of class A; net profit also pays for labour and plants as there. {board.compartment} is "
        "simulated by its own set points. Scaled: with all simulated fruit times measured over simulated fruit of that row"
        + "".join(f", {house} {ratio:.2f}" for house, ratio in {one.house: one.fruit_ratio for one in board.accounts}.items() if ratio)
        + ". Agents were made for other seasons, prices and crops, and had no budget of light.",
        wrap="always",
    )


def comparison_parts(comparison: Comparison) -> Iterator[console.Part]:
    """Sums of the season, bias by month, and limits of the comparison."""
    for note in (*comparison.notes, *_unused_capacity(comparison)):
        yield console.warning(note)
    yield _season(comparison)
    months = {month: f"{month[5:]}/{month[2:4]}" for month in comparison.months}
    title = "Simulated minus measured: heat in MJ/m2 a day, fruit in kg/m2 a month"
    view = console.table(title, "", "", *months.values(), numbers=months.values(), padding=(0, 1))
    for house in comparison.houses:
        view.add(house.name, "heat", *(f"{house.heat_bias(month):+.2f}" for month in months))
        view.add("", "fruit", *(f"{house.harvest_bias(month):+.2f}" for month in months))
    yield view
    by_pipes = ", ".join(f"{house.name} {house.pipe_heat:.0f}" for house in comparison.houses)
    yield console.Line(
        "The organisers computed the measured heat from pipe temperatures; the simulated heat is the boiler's. By their formula "
        f"the simulated pipes give off, in MJ/m2: {by_pipes}."
    )
    yield console.Line(
        f"Growers differ by {comparison.heat_spread:.2f} MJ/m2/d in one weather (RMS of a compartment's measured heat around the mean of "
        "all): a simulation that knows nothing of theirs cannot come closer to single compartments."
    )


def _season(comparison: Comparison) -> console.Table:
    """Sums and days: a block a parameter set, a row a compartment."""

    def pair(measured: float, simulated: float, digits: int) -> tuple[str, str, str]:
        ratio = simulated / measured if measured else math.nan
        return f"{measured:.{digits}f}", f"{simulated:.{digits}f}", "-" if math.isnan(ratio) else f"{ratio:.2f}"

    numbers = ("heat", "sim.", "ratio", "bias", "RMSE", "fruit", "sim.", "ratio")
    warmer = f", {comparison.warmer:+g} K" if comparison.warmer else ""
    view = console.table(
        f"{comparison.first} to {comparison.last}{warmer}: heat in MJ/m2, fruit in kg/m2",
        "", *numbers, numbers=numbers, padding=(0, 1),
        caption="Bold: mean of all compartments; sim.: simulated. Bias and RMSE: simulated minus measured heat of a day, in MJ/m2.",
    )  # fmt: skip
    for house in comparison.houses:
        heat = (house.mean(lambda one: one.heat.measured), house.mean(lambda one: one.heat.simulated))
        fruit = (house.mean(lambda one: one.harvest.measured), house.mean(lambda one: one.harvest.simulated))
        means = (*pair(*heat, 0), f"{house.heat_bias():+.2f}", f"{house.heat_rmse:.2f}", *pair(*fruit, 1))
        view.add(*(Markup(styled(text, "bold")) for text in (house.name, *means)))
        for one in house.compartments:
            view.add(
                f"  {one.name}",
                *pair(one.heat.measured, one.heat.simulated, 0),
                f"{one.heat.bias:+.2f}",
                f"{one.heat.rmse:.2f}",
                *pair(one.harvest.measured, one.harvest.simulated, 1),
            )
        view.end_section()
    return view


def _unused_capacity(comparison: Comparison) -> Iterator[str]:
    """Light or CO2 that the installed capacity could not give."""
    for house in comparison.houses:
        for one in house.compartments:
            for what, supply, unit in (("lamps", one.lamps, "kWh/m2"), ("CO2", one.co2, "kg/m2")):
                if supply.simulated < supply.measured * (1.0 - 1e-3):
                    yield (
                        f"{house.name}, {one.name}: of {supply.measured:.2f} {unit} measured ({what}) the simulation used "
                        f"{supply.simulated:.2f}, which is all that is installed."
                    )


def identify(
    folder: Annotated[Path, typer.Argument(help="Folder with weather and indoor climate (docs/identify.md).")],
    model_id: Annotated[str | None, typer.Option("--model", help="Id of a model. Default: the page's, else that of the house.")] = None,
    house_name: Annotated[str | None, typer.Option("--set", "-s", help="House at the start: a name, or a page of a house (.toml).")] = None,
    numbers: Annotated[
        str | None,
        typer.Option("--parameters", help="Fit only these, separated by commas: numbers of the page, or parameters of the model."),
    ] = None,
    page_file: Annotated[Path | None, typer.Option("--page", help="Page of what is fitted (.toml). Default: that of glbench.")] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for set, report and state.")] = Path("runs/identify"),
    split: Annotated[
        list[str] | None,
        typer.Option("--split", help="weeks, date or date:2020-03-01; repeatable, the first makes the set. Default: weeks, date."),
    ] = None,
    compartment: Annotated[str | None, typer.Option("--compartment", help="Which one, where several have an indoor climate.")] = None,
    settings: Annotated[Path | None, typer.Option("--settings", help="Page of assumptions, as for glbench validate.")] = None,
    as_json: AsJson = False,
) -> None:
    """Fit numbers of a greenhouse to its measured air, and test them on weeks that are held out.

    Writes a parameter set (identified.toml) and a report. Stop it whenever you like; the same command goes on.
    """
    from glbench import realism
    from glbench.evaluation.files import ensure_writable
    from glbench.realism import identify as fitting
    from glbench.resources import write_atomically

    only = tuple(filter(None, (numbers or "").replace(" ", "").split(",")))
    page = fitting.read_page(page_file or fitting.SHIPPED_PAGE, only, model=model_id, set=house_name)
    ensure_writable(out)
    problem, source, notes = fitting.read_problem(folder, page, realism.read_settings(settings or realism.SHIPPED), compartment)
    splits = [fitting.make_split(problem.season, text) for text in dict.fromkeys(split or ("weeks", "date"))]
    words = f"at most {fitting.MOST_POINTS} points a fit, each {len(problem.names) + 1} seasons"
    with (
        console.interruption("The points computed so far are kept. Run the same command again to continue."),
        Bar("fitting", len(splits) * fitting.MOST_POINTS, "{task.fields[words]}", time_left=True, words=words) as bar,
    ):

        def update(number: int, points: float) -> None:
            bar.move(number * fitting.MOST_POINTS + points, words=f"{splits[number].fitted}, point {math.ceil(points)}; {words}")
            if not bar.on_terminal and points == int(points):
                console.tell(f"{splits[number].fitted}: {console.count(int(points), 'point')} computed")

        fits = fitting.identify(problem, splits, out / "state.json", update)
    report = fitting.report_text(problem, fits, source)
    write_atomically(out / "identified.toml", fitting.page_text(problem, fits[0], source, out.resolve().name))
    write_atomically(out / "report.md", report)
    document = {
        fit.split.name: {
            "settled": fit.settled,
            "numbers": {one.name: one._asdict() for one in fit.estimates},
            "correlations": fit.correlations,
            **{
                when: {
                    part: {channel: error.model_dump() if error.readings else None for channel, error in errors.items()}
                    for part, errors in parts.items()
                }
                for when, parts in (("before", fit.before), ("after", fit.after))
            },
        }
        for fit in fits
    }
    console.show(console.View((*map(console.warning, notes), console.Line(report)), document), as_json=as_json)
    console.tell(f"Saved {out / 'identified.toml'} and {out / 'report.md'}")
