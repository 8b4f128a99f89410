"""``glbench verify``: reproduce results from their records alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from glbench.cli import console
from glbench.cli.console import Markup, plain
from glbench.cli.options import AsJson, RoundFile, Workers, round_of
from glbench.errors import GlbenchError, ResultError, last_line, refuse
from glbench.untrusted import visible

if TYPE_CHECKING:
    from glbench.verification import Verdict

_WORST_FIRST = (1, 2, 3, 0)
_HEADINGS = {
    "reproduced": "[bold green]reproduced[/]",
    "refuted": "[bold red]refuted[/]",
    "unknown": "[bold yellow]cannot tell[/]",
    "sealed": "[bold yellow]sealed: cannot be verified before the round is over[/]",
}


def verify(
    results: Annotated[
        list[Path],
        typer.Argument(metavar="RESULT", help="Result files (.json), each with its .actions.mcap beside it; or folders of them."),
    ],
    episodes: Annotated[
        Path | None,
        typer.Option("--episodes", help="Folder with full episodes to compare. Default: where evaluate puts them, if there are any."),
    ] = None,
    task: Annotated[
        Path | None, typer.Option("--task", "-t", help="Task file of a task that is not published. Default: the copy in the record.")
    ] = None,
    round_file: RoundFile = None,
    workers: Workers = None,
    proof: Annotated[bool, typer.Option(help="Leave a note (.proof.json) beside each reproduced result, which leaderboards show.")] = True,
    as_json: AsJson = False,
) -> None:
    """Simulate every run again from task, seed and recorded actions, and compare it with what the result says.

    Exit code 0: all are reproduced; 1: one is refuted; 2: one cannot be verified here; 3: one cannot yet, as its round is not over.
    """
    from glbench.resources import is_released
    from glbench.verification import save_proof

    sealed, codes = round_of(round_file), []
    for path in result_files(results):
        name = visible(path.name)  # on one line: a line break in a name could forge a verdict
        with console.messages().status(f"simulating {plain(name)} again"):
            verdict = _judged(path, episodes=episodes, task=task, sealed=sealed, workers=workers)
        codes.append(verdict.exit_code)
        if sealed is not None and verdict.outcome == "reproduced" and sealed.is_late(verdict.created):
            closed = f"the round closed at {sealed.closing_words}"
            console.print_warning(f"{name} is late: it states that it was made at {visible(verdict.created)}, and {closed}.")
        if proof and not is_released(path):  # released results keep the note that came with them
            try:
                if save_proof(verdict) is None and verdict.outcome == "reproduced":
                    console.print_warning(f"{name} changed while it was verified, so no note of it was stored. Verify it again.")
            except GlbenchError as error:
                console.print_warning(f"The verdict stands, but no note of it was stored. {visible(str(error))}")
        console.show(console.View(_parts(verdict), _document(verdict), indent=None), as_json=as_json)
    raise typer.Exit(next(code for code in _WORST_FIRST if code in codes))


def result_files(paths: list[Path]) -> list[Path]:
    """These result files, and those in these folders.

    Raises ``ResultError`` when a folder is missing that has results of trials beside it, and ``typer.Exit`` with code 2 when there is none.
    """
    from glbench.verification import SUFFIX

    for path in paths:
        trials = path.parent / "trials" / path.name
        if not path.exists() and trials.is_dir():
            refuse(
                f"There is no folder {path}, but there are results of trials (--runs): glbench verify {console.quoted(trials)}", ResultError
            )
    files = [
        file
        for path in paths
        for file in (sorted(path.rglob("*.json")) if path.is_dir() else [path])
        if not (path.is_dir() and file.name.endswith(SUFFIX))
    ]
    if not files:
        console.tell(f"There are no results in {visible(', '.join(map(str, paths)))}.")
        raise typer.Exit(2)
    return files


def _judged(path: Path, **how: Any) -> Verdict:
    """The verdict on one file. Whatever goes wrong with it, the others are judged, too."""
    from glbench.verification import Verdict, verify

    try:
        return verify(path, **how)
    except Exception as error:
        if console.debugging():
            raise
        return Verdict(path, "unknown", "error", f"It cannot be verified: {error if isinstance(error, GlbenchError) else last_line(error)}")


def _parts(verdict: Verdict) -> Iterator[console.Part]:
    from glbench.verification import stated_words

    heading = _HEADINGS[verdict.outcome]
    if verdict.exactness == "tolerance":
        heading = "[bold yellow]reproduced within 1e-9[/]"
    yield console.Line(Markup(f"{heading} {plain(visible(str(verdict.path)))}"))
    yield console.paragraph(f"  {visible(verdict.reason)}")
    if verdict.outcome == "reproduced":
        seeds = ", ".join(map(str, verdict.episodes[:8])) + (" ..." if len(verdict.episodes) > 8 else "")
        whole = f"; every column of the full episodes of the seed{'s' * (len(verdict.episodes) > 1)} {seeds}" if verdict.episodes else ""
        profile = "; the profile" if "profile" in verdict.reproduced else ""
        if "fresh_draws.references" in verdict.reproduced:
            profile += "; the fresh draws, and the scores of the reference agents with both sets of draws"
        yield console.paragraph(
            f"  Reproduced: {verdict.steps:,} rewards, {console.count(verdict.runs, 'final state')}, all metrics and their means; the "
            f"digests of the task and of the result{whole}{profile}."
        )
        yield console.paragraph(f"  Stated, not checked: {'; '.join(stated_words(verdict.stated))}.")
    for note in verdict.notes:
        yield console.paragraph(f"  Note: {visible(note)}")


def _document(verdict: Verdict) -> dict[str, object]:
    names = ("outcome", "cause", "reason", "exactness", "largest_difference", "runs", "steps")
    return {
        "result": str(verdict.path),
        **{name: getattr(verdict, name) for name in names},
        "full_episodes": list(verdict.episodes),
        **{name: list(getattr(verdict, name)) for name in ("reproduced", "stated", "notes")},
    }
