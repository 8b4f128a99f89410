"""``glbench greenhouse``: a page for the numbers of your own greenhouse, a check of them, and a task with that greenhouse."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli import console
from glbench.cli.console import Markup, plain, styled
from glbench.cli.options import AsJson
from glbench.errors import TaskError, refuse

if TYPE_CHECKING:
    from glbench.greenhouse import Greenhouse
    from glbench.greenhouse.season import Outcome
    from glbench.tasks import TaskSpec

app = typer.Typer(help="Describe your own greenhouse, see what it can do, and make a task with it.", no_args_is_help=True)

PageFile = Annotated[Path, typer.Argument(metavar="PAGE", help="The page of your greenhouse (.toml).")]
_COLOURS = {"usable": "green", "usable, but": "yellow", "refused": "red"}


@app.command("new")
def new_command(page: PageFile = Path("greenhouse.toml")) -> None:
    """Write an empty page, on which every number is explained with its unit. Nothing is overwritten."""
    from glbench.greenhouse.page import EMPTY_PAGE
    from glbench.resources import write_atomically

    if page.exists():
        refuse(f"{page} is there already. Edit it, or give another name; nothing is overwritten.", TaskError)
    write_atomically(page, EMPTY_PAGE.read_text(encoding="utf-8"))
    console.tell(f"Wrote {page}")
    console.tell(f"Fill in what you know, then: glbench greenhouse check {console.quoted(page)}")


@app.command("check")
def check_command(page: PageFile, as_json: AsJson = False) -> None:
    """Say what follows from a page, what is doubtful or cannot be, and what the greenhouse can do. Exits with 1 when it is refused."""
    from glbench.greenhouse import design, read_page
    from glbench.greenhouse.writing import base_task

    settings = read_page(page)
    base_task(settings)
    house = design(settings)
    more = console.aside(f"Next: glbench greenhouse task {console.quoted(page)} my_house.toml")
    code = 1 if house.refusals else 0
    parts = (*_parts(house), *(() if house.refusals else (more,)))
    console.show(console.View(parts, lambda: _document(house), code=code), as_json=as_json)


@app.command("task")
def task_command(
    page: PageFile,
    task: Annotated[Path, typer.Argument(metavar="TASK", help="The task file to write (.toml); rules come into a folder beside it.")],
    replace: Annotated[bool, typer.Option("--replace", help="Overwrite the task file and the rules.")] = False,
    as_json: AsJson = False,
) -> None:
    """Write a task with the greenhouse of a page, and rules that fit it; then show four seasons of the rules.

    Exits with 1, and writes nothing, when the greenhouse is refused.
    """
    from glbench.greenhouse import design, read_page
    from glbench.greenhouse.season import try_season
    from glbench.greenhouse.writing import base_task, rules_text, task_text
    from glbench.resources import data_folder, write_atomically
    from glbench.tasks import get_task

    if task.suffix != ".toml" or task.resolve() == page.resolve():
        refuse(f"A task is written to a .toml file other than the page; got {task}.", TaskError)
    rules = task.with_name(f"{task.stem}_rules")
    present = [str(file) for file in (task, rules) if file.exists()]
    if present and not replace:
        refuse(f"{' and '.join(present)} is there already. Give another name, or --replace.", TaskError)
    settings = read_page(page)
    by_computer = base_task(settings).actuation.kind == "process_computer"
    house = design(settings)
    if house.refusals:
        console.show(console.View(_parts(house), lambda: _document(house), code=1), as_json=as_json)
        return
    name = "".join(word[:1].upper() + word[1:] for word in re.findall(r"[A-Za-z0-9]+", task.stem)) or "House"
    write_atomically(task, task_text(settings, house, f"my/{name}-v1", page.name))
    spec = get_task(task)
    if by_computer:  # the grower's page has set points, which no equipment scales
        texts = {name: (data_folder("baselines") / "grower" / name).read_text("utf-8") for name in ("card.toml", "settings.toml")}
    else:
        texts = rules_text(settings, spec)
    rules.mkdir(exist_ok=True)
    for name, text in texts.items():
        write_atomically(rules / name, text)
    with console.messages().status("four seasons of the rules"):
        outcome = try_season(spec, rules)

    def parts() -> Iterator[console.Part]:
        yield from _parts(house)
        yield from _season(spec, outcome)
        split = " --split validation" if outcome.split == "validation" else ""
        yield console.Line(f"Wrote {task} and {rules}. Next:", wrap="always")
        yield console.Line(f"  glbench evaluate {console.quoted(rules)} --task {console.quoted(task)}{split} --runs 4")
        yield console.Line(
            f"  glbench tune rules --task {console.quoted(task)} --config {console.quoted(rules / 'rules.yml')}"
            if split and not by_computer
            else f"  glbench tasks show {console.quoted(task)}"
        )

    console.show(
        console.View(parts(), lambda: _document(house) | {"task": str(task), "rules": str(rules), "season": outcome.sums}), as_json=as_json
    )


def _parts(house: Greenhouse) -> Iterator[console.Part]:
    view = console.table("Parameters that follow", "Name", "Value", "Unit", "From", numbers=("Value",), fold=("From",))
    for entry in house.entries:
        number = f"{entry.value:,.0f}" if abs(entry.value) >= 1000.0 else f"{entry.value:.4g}"
        view.add(entry.name, number, entry.unit, entry.reason)
    yield view
    if house.assumptions:
        yield console.Line("Assumed, because the page does not say it", "bold")
        yield from (console.Line(f"  {assumption}", wrap="always") for assumption in house.assumptions)
    can = house.capability
    if can is not None:
        lit = (
            f"{can.light:.0f} umol m-2 s-1 from {can.lamp_power:.4g} W m-2, {can.light / can.lamp_power:.2f} umol/J"
            if can.lamp_power
            else "none"
        )
        yield console.Line("What it can do", "bold")
        for words in (
            f"Heat: {can.boiler:.0f} W m-2 hold {can.cold_temperature:.1f} degC at -10 degC outside (clear night, wind 4 m/s, screens "
            f"closed), with rail pipes at {can.pipe_temperature:.0f} degC. 18 degC would need {can.cold_heat:.0f} W m-2.",
            "Energy screen: none"
            if can.saving is None
            else f"Energy screen: saves {100.0 * can.saving:.0f} % of the heat at 0 degC outside.",
            f"Lamps: {lit}",
            f"CO2: {can.dosing:.3g} g m-2 h-1, {10.0 * can.dosing:.3g} kg/ha/h",
            f"Roof vents: {100.0 * can.vent_area:.3g} % of the floor; open, they renew the air {can.air_changes:.0f} times an hour "
            "(26 degC inside, 20 degC outside, wind 3 m/s).",
        ):
            yield console.Line(f"  {words}", wrap="always")
    colour, problems = _COLOURS[house.verdict], house.refusals or house.doubts
    yield console.Line(Markup(f"{styled(house.verdict, f'bold {colour}')}{plain(':' if problems else '')}"))
    yield from (console.Line(f"  {problem}", wrap="always") for problem in problems)


def _season(task: TaskSpec, outcome: Outcome) -> Iterator[console.Part]:
    """What the ledger counts, in amounts and money; heat also as natural gas."""
    from glbench.episodes.signals import KWH_A_CUBIC_METRE
    from glbench.quantities import MONEY

    headings = ("", "Amount", "Unit", "Money")
    title = f"{console.count(task.weather.days, 'day')}, mean of {outcome.runs} {outcome.split} seasons with the rules [Money: {MONEY}]"
    view = console.table(title, *headings, numbers=("Amount", "Money"))
    for item in task.ledger.items:
        amount, money = outcome.sums[item.amount], item.sign * round(outcome.sums[item.name], 2)
        view.add(item.label or item.name, f"{amount:.2f}", item.amount_unit, f"{money + 0.0:.2f}")
        if item.flow == "heat":
            view.add("  as natural gas, boiler without losses", f"{amount / KWH_A_CUBIC_METRE:.2f}", "m3 m-2", "")
    yield view


def _document(house: Greenhouse) -> dict[str, object]:
    import dataclasses

    return {
        "verdict": house.verdict,
        **{name: list(getattr(house, name)) for name in ("refusals", "doubts", "assumptions", "controls")},
        "parameters": [entry._asdict() for entry in house.entries],
        "capability": None if house.capability is None else dataclasses.asdict(house.capability),
    }
