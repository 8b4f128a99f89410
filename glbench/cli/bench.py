"""``glbench bench``: how fast the model steps here, beside the method of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.cli.console import messages, output, table, tell

if TYPE_CHECKING:
    from rich.table import Table

    from glbench.speed import Measurement, SpeedRecord


def bench(
    what: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[WHAT]...", help="Groups or single measurements, such as step or vector/512. Default: all of them."
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="The most telling measurements only, in half a minute.")
    ] = False,
    rounds: Annotated[int, typer.Option(min=1, help="How often each is set against the reference.")] = 7,
    out: Annotated[Path | None, typer.Option(help="Save the figures as JSON in this file.")] = None,
) -> None:
    """Measure how fast the model steps on this machine, as ratios to CVODES measured in the same run.

    The reference is the method of the benchmark's paper: CasADi with CVODES at 1e-6, compiled just in time. Processor time is
    counted, so that other work on the machine disturbs little; only threads are timed on the wall.
    """
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from glbench.evaluation.files import ensure_writable
    from glbench.speed import choose_subjects, measure, save_record

    if out is not None:
        ensure_writable(out.parent)
    subjects = choose_subjects(what or (), quick=quick)
    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=messages(), transient=True) as bar:
        task = bar.add_task("compiling model and reference", total=len(subjects))

        def show(words: str, done: int, total: int) -> None:
            bar.update(task, description=words, completed=done, total=total)

        record = measure(subjects, rounds=rounds, processes=not what, progress=show)
    _print(record)
    if out is not None:
        save_record(record, out)
        tell(f"Saved {out}")


def _print(record: SpeedRecord) -> None:
    from glbench.speed.subjects import GROUPS

    machine = record.machine
    output().print(
        f"[bold]Speed of glbench {record.versions.glbench}[/] on {machine.processor}, {machine.cores} cores, {machine.system}"
    )
    lanes = record.kernel.get("lanes")
    how = f"backend {record.kernel['backend']}" + (f", {lanes:.0f} lanes, {record.kernel['compiler']}" if lanes else "")
    output().print(f"Kernel: {how}", markup=False)
    output().print(f"Reference: {record.reference}; {record.rounds} rounds in turn", markup=False)
    for group, title in GROUPS.items():
        rows = [one for one in record.measurements if one.group == group]
        if rows:
            output().print(_table(title, rows))
    if record.first_use is not None:
        output().print(
            f"First use on an empty cache: {record.first_use.seconds:.1f} s, at most {record.first_use.megabytes:,.0f} MB "
            "(a wheel that carries the kernel has no such wait)"
        )
    if record.memory is not None:
        memory = record.memory
        each = (memory.megabytes - memory.megabytes_of_one) / memory.environments * 1024
        output().print(
            f"Memory: {memory.megabytes:,.0f} MB for {memory.environments:,} environments, {memory.megabytes_of_one:,.0f} MB for one "
            f"({each:.1f} kB for each more)"
        )


def _table(title: str, rows: list[Measurement]) -> Table:
    numbers = ("us a step", "steps/s", "x CVODES", "range")
    view = table(title, "", *numbers, right=numbers, pad_edge=False)
    for column, width in zip(view.columns, (28, 9, 9, 8, 13), strict=True):
        column.min_width = width
    for one in rows:
        view.add_row(
            one.title,
            f"{one.microseconds:,.2f}",
            f"{one.steps_per_second:,.0f}",
            f"[bold]{one.ratio:,.1f}x[/]",
            f"{one.ratio_low:,.1f}..{one.ratio_high:,.1f}",
        )
    return view
