"""``glbench episodes recording``: an agent that replays what another one did, without looking."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from glbench.cli.console import messages, output


def recording(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A result file (.json) with its recorded actions.")],
    run: Annotated[int, typer.Option("--run", help="Seed of the run whose actions are taken.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write, which glbench evaluate runs.")],
) -> None:
    """Make an agent of the recorded actions of one run. It replays them without looking: what feedback is worth is what it loses."""
    from glbench.evaluation.recordings import write_recording

    made = write_recording(result, run, out)
    output().print(str(out), markup=False, soft_wrap=True)
    messages().print(
        f"{len(made.actions)} steps of {made.about['agent']}. Next: glbench evaluate {out}",
        markup=False,
        soft_wrap=True,
    )
