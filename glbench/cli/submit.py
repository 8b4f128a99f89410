"""``glbench submit``: look at a submission before the long run, and write a new one to start from."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.box import HEAVY_HEAD

from glbench import children
from glbench.cli import console
from glbench.cli.console import Markup, count, plain, styled
from glbench.cli.options import AsJson, OneTask, Sandbox, SandboxChoice, task_or_default

if TYPE_CHECKING:
    from glbench.evaluation.submitting import Report

app = typer.Typer(
    name="submit",
    help="Look at a submission before the long run, or write a new one to start from.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

_TRAINING_SECONDS = 300


@app.command("check")
def check(
    path: Annotated[str, typer.Argument(metavar="PATH", help="A .py file, a saved policy (.zip, .pt, .ts, .onnx), or a folder.")],
    task: OneTask = None,
    sandbox: SandboxChoice = Sandbox.AUTO,
    as_json: AsJson = False,
) -> None:
    """Find everything that will be wrong in an evaluation, within 20 seconds.

    The files are read, then the agent runs for a day, in the sandbox as in an evaluation. First decisions have their own time: an agent
    that plans takes longer for them, and the check as much longer. Exits with 0 when nothing has to be fixed, else with 1.
    """
    from glbench.evaluation.submitting import check_submission
    from glbench.tasks import DEFAULT_TASK

    with console.messages().status(f"checking {plain(path)}"):
        report = check_submission(path, task or DEFAULT_TASK, sandbox=sandbox.value)
    document = {
        "submission": report.name,
        "what": report.what,
        "task": report.task,
        "ok": report.ok,
        "findings": [{name: getattr(one, name) for name in ("subject", "level", "text")} for one in report.findings],
        "checked": sorted(report.checked),
        "measured": report.facts,
        "seconds": round(report.seconds, 2),
    }
    console.show(console.View(_parts(report, path, task), document, code=0 if report.ok else 1, indent=None), as_json=as_json)


@app.command("new")
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Folder to write; its name is the submission's.")],
    kind: Annotated[
        str,
        typer.Option(
            "--kind",
            "-k",
            help="rule (numpy only), sb3 (no code but a model), torch (a network), mpc (plans); "
            "or example: my_agent.py and the other examples, a file each.",
        ),
    ] = "rule",
) -> None:
    """Write a folder with a submission that runs at once: its code or model, a card, a README. Nothing is overwritten."""
    from glbench.agents.loading import EXAMPLE_KIND, KINDS, copy_examples, new_submission
    from glbench.errors import SubmissionError, did_you_mean, refuse

    folder = Path(name)
    if kind == EXAMPLE_KIND:
        for file in copy_examples(folder):
            console.tell(f"Wrote {file}")
        console.tell(f"Next: glbench evaluate {console.quoted(folder / 'my_agent.py')}")
        return
    if kind not in KINDS:
        refuse(f"There is no template '{kind}'.{did_you_mean(kind, (*KINDS, EXAMPLE_KIND))}", SubmissionError)
    files = new_submission(folder, kind)
    for file in (*files, *(_untrained_model(folder) if kind == "sb3" else ())):
        console.tell(f"Wrote {file}")
    console.tell(f"Next: glbench submit check {console.quoted(folder)}")


def _untrained_model(folder: Path) -> tuple[Path, ...]:
    """Let the template's own training save a model that has learned nothing, so that the folder runs."""
    from glbench.extras import how_to_install, missing

    if missing("stable_baselines3"):
        console.print_warning(
            f"The folder has no model yet, because Stable-Baselines3 is not installed here. {how_to_install('stable_baselines3')}, "
            f"then: python {folder / 'train.py'} --steps 0"
        )
        return ()
    with console.messages().status("saving an untrained model (python train.py --steps 0)"):
        process = children.run([sys.executable, str(folder / "train.py"), "--steps", "0"], timeout=_TRAINING_SECONDS)
    if process.returncode != 0:
        last = (process.stderr.strip().splitlines() or ["no message"])[-1]
        console.print_warning(f"The folder has no model yet: python {folder / 'train.py'} --steps 0 fails ({last}).")
        return ()
    return (folder / "model.zip", folder / "vecnormalize.pkl")


def _parts(report: Report, path: str, task: str | None) -> Iterator[console.Part]:
    from glbench.evaluation.submitting import CHECKS

    headings = ("Check", "", "Measured")
    view = console.table(f"{report.name} ({report.what}) on {report.task}", *headings, fold=headings, box=HEAVY_HEAD)
    for subject, words in CHECKS.items():
        levels = {finding.level for finding in report.of(subject)}
        if "problem" in levels:
            mark = styled("problem", "bold red")
        elif "note" in levels:
            mark = styled("note", "yellow")
        else:
            mark = styled("good", "green") if subject in report.checked else styled("not reached", "dim")
        view.add(words, Markup(mark), report.facts.get(subject, ""))
    yield view
    for finding in report.findings:
        mark = styled("Problem", "bold red") if finding.level == "problem" else styled("Note", "bold yellow")
        yield console.Line(Markup(f"{mark} ({finding.subject}) {plain(finding.text)}"))
    total = "No problems found." if report.ok else f"{count(len(report.problems), 'problem')} found."
    yield console.Line(Markup(f"[bold]{total}[/] Checked in {report.seconds:.1f} s."))
    if report.ok:
        on = "" if task is None else f" --task {console.quoted(task)}"
        # The test scores: what is tried out belongs in the validation split, where the task has one.
        splits = task_or_default(task).splits
        has_validation = splits is not None and "validation" in splits.names
        trial, score = (" --split validation", "these options: the score") if has_validation else ("", "--runs")
        yield console.aside(f"Next: glbench evaluate {console.quoted(path)}{on} --runs 2{trial}, then without {score}.")
