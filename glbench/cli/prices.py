"""``glbench prices``: files of prices as people have them, for price tables of tasks of their own."""

from __future__ import annotations

import datetime as dt
import json
import os
import re
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from glbench.cli import console
from glbench.cli.options import AsJson, check_new
from glbench.errors import TaskError, refuse

app = typer.Typer(help="Read files of prices: exports of exchanges, contracts, meters.", no_args_is_help=True)


@app.command("import")
def import_file(
    file: Annotated[Path, typer.Argument(help="An export of ENTSO-E, EPEX or SMARD, or any table of times and prices.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The plain file of prices (.csv), beside your task.")],
    table: Annotated[str, typer.Option("--table", help="Name of the price table.")] = "power",
    unit: Annotated[str, typer.Option("--unit", help="Unit of the price table.")] = "EUR kWh-1",
    clock: Annotated[
        str | None, typer.Option("--clock", help="IANA zone of times without an offset, such as Europe/Amsterdam; else UTC.")
    ] = None,
    column: Annotated[str | None, typer.Option("--column", help="Title of the prices, where there are several.")] = None,
    file_unit: Annotated[str | None, typer.Option("--file-unit", help="Unit of the prices, where the title has none.")] = None,
    base: Annotated[str | None, typer.Option("--base", help="Task that the prices are for; prints a task of your own.")] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace a file that exists.")] = False,
    as_json: AsJson = False,
) -> None:
    """Check a file of prices, write it as a plain file in UTC, and print the lines of a task that use it."""
    from glbench.outside_tables import Check
    from glbench.resources import write_atomically
    from glbench.tasks import get_task
    from glbench.tasks.price_files import doubts_of_prices, read_prices
    from glbench.tasks.prices import PriceTable

    check_new(out, replace=replace)
    if not re.fullmatch(r"[A-Za-z0-9_-]+", table):
        refuse(f"--table {table} cannot be the name of a price table. It may have letters, digits, - and _.", TaskError)
    task = None if base is None else get_task(base)
    prices = read_prices(file, unit, clock=clock, column=column, file_unit=file_unit)
    moments = [dt.datetime.fromtimestamp(second, tz=dt.UTC) for second in prices.seconds.tolist()]
    series = PriceTable(unit, series=tuple(zip(moments, prices.prices.tolist(), strict=True)))
    check = Check(prices.notes, (*prices.doubts, *doubts_of_prices(unit, series.mean, table)))
    rows = [f"{moment:%Y-%m-%dT%H:%MZ},{price!r}" for moment, price in series.series]
    write_atomically(out, "\n".join(["time,price", *rows]) + "\n")
    lines, quote = [], partial(json.dumps, ensure_ascii=False)
    if task is not None:
        of = os.path.relpath(str(base), out.parent) if str(base).endswith(".toml") else task.id
        name = f"mylab/{'Prices-' * task.id.startswith('mylab/')}{task.short_id}"
        lines = [f"base = {quote(of)}", f"id = {quote(name)}", f"title = {quote(f'{task.title}, own prices')}"]
    old = None if task is None else task.price_tables.get(table)
    if old is not None:
        lines.append(f'without = ["price_tables.{table}"]')
    if task is not None and (old is None or old.unit != unit):
        check = Check(check.notes, (*check.doubts, f"{task.id} has no price table '{table}' in {unit}; see `glbench tasks show`."))
    lines += [f"[price_tables.{table}]", f"unit = {quote(unit)}", f"file = {quote(out.name)}"]

    parts = [
        console.Line(f"{series.in_words()}, in {out}"),
        *(console.Line(f"Note: {note}") for note in check.notes),
        console.Line(f"The prices are {check.verdict}{':' if check.doubts else '.'}"),
        *(console.paragraph(f"Warning: {doubt}", "yellow", aside=True) for doubt in check.doubts),
        console.Line("In the file of your task:"),
        *(console.Line(f"  {line}") for line in lines),
    ]
    document = {"file": str(out), "prices": len(rows), "unit": unit, "mean": series.mean, **asdict(check), "task": "\n".join(lines)}
    console.show(console.View(parts, document), as_json=as_json)
