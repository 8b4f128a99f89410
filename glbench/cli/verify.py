"""``glbench verify``: reproduce results from their records alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from glbench.cli.console import harmless, messages, output, print_warning, put_json, say, tell
from glbench.cli.options import AsJson, RoundFile, Workers, round_of
from glbench.errors import GlbenchError

if TYPE_CHECKING:
    from glbench.verification import Verdict

_WORST_FIRST = (1, 2, 3, 0)
_HEADINGS = {
    "reproduced": "[bold green]reproduced[/]",
    "refuted": "[bold red]refuted[/]",
    "unknown": "[bold yellow]cannot tell[/]",
    "sealed": "[bold yellow]sealed: cannot be told before the round is over[/]",
}


def verify(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT", help="Result files (.json), each with its .actions.mcap beside it; or folders of them."
        ),
    ],
    episodes: Annotated[
        Path | None,
        typer.Option(
            "--episodes",
            help="Folder with full episodes to compare. Default: where evaluate puts them, if there are any.",
        ),
    ] = None,
    task: Annotated[
        Path | None,
        typer.Option(
            "--task", "-t", help="Task file of a task that is not published. Default: the copy in the record."
        ),
    ] = None,
    round_file: RoundFile = None,
    workers: Workers = None,
    proof: Annotated[
        bool, typer.Option(help="Leave a note (.proof.json) beside each reproduced result, which leaderboards show.")
    ] = True,
    as_json: AsJson = False,
) -> None:
    """Simulate every run again from task, seed and recorded actions, and compare it with what the result says.

    Exits with 0 when all are reproduced, 1 when one is refuted, 2 when (none is refuted and) one cannot be told, 3 when one cannot
    be told before its round is over.
    """
    from glbench.evaluation import load_result
    from glbench.resources import is_released
    from glbench.verification import save_proof
    from glbench.verification import verify as verify_result

    sealed, codes = round_of(round_file), []
    for path in _files(results):
        with messages().status(f"simulating {escape(harmless(path.name))} again"):
            verdict = verify_result(path, episodes=episodes, task=task, sealed=sealed, workers=workers)
        codes.append(verdict.exit_code)
        if (
            sealed is not None
            and verdict.outcome == "reproduced"
            and sealed.is_late(created := load_result(path).created)
        ):
            closed = f"the round closed at {sealed.closing_words}"
            print_warning(f"{path.name} is late: it states that it was made at {harmless(created)}, and {closed}.")
        if proof and not is_released(path):  # released results keep the note that came with them
            try:
                save_proof(verdict)
            except GlbenchError as error:
                print_warning(f"The verdict stands, but no note of it was stored. {error}")
        if as_json:
            put_json(_plain(verdict), indent=None)
        else:
            _show(verdict)
    raise typer.Exit(next(code for code in _WORST_FIRST if code in codes))


def _files(given: list[Path]) -> list[Path]:
    """The result files named, and those in the folders named."""
    from glbench.verification import SUFFIX

    found = [
        file
        for path in given
        for file in (sorted(path.rglob("*.json")) if path.is_dir() else [path])
        if not (path.is_dir() and file.name.endswith(SUFFIX))
    ]
    if not found:
        tell(f"There are no results in {', '.join(map(str, given))}.")
        raise typer.Exit(2)
    return found


def _show(verdict: Verdict) -> None:
    from glbench.verification import stated_words

    heading = _HEADINGS[verdict.outcome]
    if verdict.exactness == "tolerance":
        heading = "[bold yellow]reproduced within 1e-9[/]"
    output().print(f"{heading} {escape(harmless(str(verdict.path)))}", soft_wrap=True)
    say(output(), f"  {escape(harmless(verdict.reason))}")
    if verdict.outcome == "reproduced":
        seeds = ", ".join(map(str, verdict.episodes[:8])) + (" ..." if len(verdict.episodes) > 8 else "")
        whole = f"; every column of the full episodes of the seeds {seeds}" if verdict.episodes else ""
        profile = "; the profile" if "profile" in verdict.reproduced else ""
        if "fresh_draws.references" in verdict.reproduced:
            profile += "; the fresh draws, and the scores of the reference agents with both sets of draws"
        say(
            output(),
            f"  Reproduced: {verdict.steps:,} rewards, {verdict.runs} final states, all metrics and their means; the digests of the task "
            f"and of the result{whole}{profile}.",
        )
        say(output(), f"  Stated, not checked: {'; '.join(stated_words(verdict.stated))}.")
    for note in verdict.notes:
        say(output(), f"  Note: {escape(harmless(note))}")


def _plain(verdict: Verdict) -> dict[str, object]:
    same = ("outcome", "cause", "reason", "exactness", "largest_difference", "runs", "steps")
    return {
        "result": str(verdict.path),
        **{name: getattr(verdict, name) for name in same},
        "full_episodes": list(verdict.episodes),
        **{name: list(getattr(verdict, name)) for name in ("reproduced", "stated", "notes")},
    }
