"""The command ``glbench``: puts the groups of commands together and turns errors into words."""

from __future__ import annotations

import io
import os
import sys
from typing import Annotated, NoReturn

import typer

from glbench import __version__
from glbench.cli import console, episodes, submit, tasks, weather
from glbench.cli.bound import bound
from glbench.cli.console import DEBUG_VARIABLE, INTERRUPTED
from glbench.cli.evaluate import evaluate
from glbench.cli.leaderboard import badge, leaderboard
from glbench.cli.report import report, story
from glbench.cli.results import compare, show
from glbench.cli.studies import bench, validate
from glbench.cli.train import export, sweep, train, tune
from glbench.cli.verify import verify
from glbench.cli.view import view
from glbench.errors import GlbenchError

app = typer.Typer(
    name="glbench",
    help="A reproducible benchmark for greenhouse climate control on the GreenLight model.",
    epilog="Start with: glbench evaluate submissions/my_agent.py",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _command in (evaluate, leaderboard, show, compare, badge, report, story, verify, view, bound, bench, validate):
    app.command(_command.__name__)(_command)
app.add_typer(submit.app, name="submit")
app.add_typer(tasks.round_app, name="round")
for _training in (train, export, sweep):
    app.command(_training.__name__)(_training)
app.add_typer(tune, name="tune")
for _group in (episodes, tasks, weather):
    app.add_typer(_group.app, name=_group.__name__.rpartition(".")[2])


def print_version(is_requested: bool) -> None:
    """Callback of ``--version``."""
    if is_requested:
        typer.echo(f"glbench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=print_version, is_eager=True)
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help=f"Show tracebacks of errors (or set {DEBUG_VARIABLE}=1).")
    ] = False,
) -> None:
    if debug:
        os.environ[DEBUG_VARIABLE] = "1"
    console.show_warnings()


def _words_for(error: GlbenchError | OSError | RuntimeError) -> str | None:
    """The message of an error; of one that nobody expected ``None``, and its traceback has to show."""
    if isinstance(error, GlbenchError):
        return str(error)
    if isinstance(error, OSError):  # a name too long, a full disk behind a pipe, a folder that may not be read
        place = "" if error.filename is None else f": {os.fsdecode(error.filename)}"
        return f"{error.strerror or error}{place}. Nothing more was done; {DEBUG_VARIABLE}=1 shows where."
    if str(error).startswith("Symlink loop"):  # of pathlib, before Python 3.13
        link = str(error).removeprefix("Symlink loop from ")
        return f"A link leads back to itself: {link}. Remove it, or name a real file."
    return None


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit with 0 (done), 1 (an error, in words), 2 (wrong usage), 130 (Ctrl-C) or 128 + a signal."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files need not be text
            stream.reconfigure(errors="backslashreplace")
    with console.interruptible() as signals:
        try:
            app(arguments)
        except (GlbenchError, OSError, RuntimeError) as error:
            words = _words_for(error)
            if words is None or console.debugging():
                raise
            console.print_error(words)
            sys.exit(1)
        except KeyboardInterrupt:
            signals.tell()
            sys.exit(signals.exit_code)
        except SystemExit as end:
            if end.code != INTERRUPTED:
                raise
            signals.tell()
            sys.exit(signals.exit_code)
    sys.exit(0)


def run() -> NoReturn:
    """``main`` as a process of its own, which ends when the command has ended."""
    try:
        main()
    except SystemExit as end:
        console.leave(int(end.code or 0))
