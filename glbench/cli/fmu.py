"""``glbench export fmu``: the greenhouse of a task for Simulink, Dymola, OpenModelica, fmpy and other programs that import FMUs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glbench.cli import console
from glbench.extras import require


def fmu(
    task: Annotated[str, typer.Argument(help="Id of a task, its short form, or a .toml file.", metavar="ID|FILE")],
    out: Annotated[Path, typer.Option("--out", "-o", help="The FMU to write (.fmu).")],
    seed: Annotated[int, typer.Option("--seed", min=0, help="Selects the season; the importing program can change it.")] = 1,
    split: Annotated[
        str | None, typer.Option("--split", help="training or validation; the importing program can change it. Default: validation.")
    ] = None,
    replace: Annotated[bool, typer.Option("--replace", help="Replace a file that exists.")] = False,
) -> None:
    """Write the greenhouse of a task as an FMU for co-simulation (FMI 2.0), with weather, crop, sensors and ledger.

    The FMU holds no model: it runs the glbench of the machine that imports it. See docs/fmu.md.
    """
    require("An FMU", "fmu", "pythonfmu")
    from glbench import __version__
    from glbench.fmu import export_fmu
    from glbench.tasks import get_task

    spec = get_task(task)
    with console.messages().status("writing the FMU"):
        export_fmu(spec, out, seed=seed, split=split, replace=replace)
    seconds = spec.step_seconds
    console.write(out)
    console.tell(
        f"{spec.id}, {spec.steps} steps of {seconds:g} s: set the communication step to {seconds:g} s. The FMU runs in tools for Linux on "
        f"x86-64 whose Python has this glbench: install glbench {__version__} there (README). docs/fmu.md says how, tool by tool."
    )
