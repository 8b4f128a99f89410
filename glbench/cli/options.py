"""Options that several commands share, and the choices among them, repeated here so that ``--help`` need not load the evaluation."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from glbench.errors import GlbenchError

if TYPE_CHECKING:
    from glbench.tasks import Round

REPORTS = Path("reports")


class Sandbox(StrEnum):
    """The choices of ``--sandbox``."""

    AUTO = "auto"
    BUBBLEWRAP = "bubblewrap"
    NONE = "none"


class EngineName(StrEnum):
    """The choices of ``--engine``."""

    LOCAL = "local"
    RAY = "ray"


OneTask = Annotated[
    str | None, typer.Option("--task", "-t", help="Task id or task file (.toml). Default: the benchmark's.")
]
Out = Annotated[Path, typer.Option("--out", "-o", help="Folder with results/ in it.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON and nothing else.")]
Workers = Annotated[
    int | None, typer.Option("--workers", "-w", min=1, help="Cores to work with; changes no number. Default: all.")
]
Address = Annotated[
    str | None,
    typer.Option("--address", help="Address of a Ray cluster, such as auto. Default: start one on this machine."),
]
Episodes = Annotated[
    str,
    typer.Option(
        "--episodes",
        help="Runs to keep as full episodes (3 MB each): all, none, or a list of best, worst, median and seeds. "
        "The actions of all runs are kept anyway, so that the others can be made later.",
    ),
]
SandboxChoice = Annotated[
    Sandbox,
    typer.Option(
        "--sandbox",
        envvar="GLBENCH_SANDBOX",
        help="Where submissions run: bubblewrap (no network, no weather, no seeds, limited in size), or none (with your rights: "
        "for code that you wrote or have read). auto: bubblewrap; where there is none, evaluate runs unchanged examples of glbench only, "
        "and check runs nothing.",
    ),
]
RoundFile = Annotated[
    Path | None,
    typer.Option(
        "--round", help="The file of a sealed round (docs/maintain.md), which holds its secret. Default: public draws."
    ),
]
Config = Annotated[
    Path | None, typer.Option("--config", "-c", help="Settings (YAML; docs/training.md). Default: those of the docs.")
]
TrainingFolder = Annotated[
    Path | None, typer.Option("--out", "-o", help="Folder of the training. Default: runs/WHAT-TASK-seedSEED.")
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all that is random in the training.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Go on from the last checkpoint; nothing is lost but the minutes after it.")
]


def check_address(address: str | None, engine: EngineName) -> None:
    """Refuse an address without the engine ``ray``.

    Raises
    ------
    GlbenchError
        That says what is missing.
    """
    if address is not None and engine is not EngineName.RAY:
        msg = "--address is for a Ray cluster: add --engine ray."
        raise GlbenchError(msg)


def round_of(file: Path | None) -> Round | None:
    """The round that ``--round`` names, if any. Errors as for ``glbench.tasks.read_round``."""
    if file is None:
        return None
    from glbench.tasks import read_round

    return read_round(file)
