"""The command ``glbench``: puts the groups of commands together and turns errors into words."""

from __future__ import annotations

import io
import os
import sys
from typing import Annotated, NoReturn

import typer

from glbench import __version__
from glbench.cli import episodes, rounds, submit, tasks, weather
from glbench.cli.bench import bench
from glbench.cli.bound import bound
from glbench.cli.console import DEBUG_VARIABLE, debugging, print_error, show_warnings
from glbench.cli.evaluate import evaluate
from glbench.cli.exiting import INTERRUPTED, interruptible, leave
from glbench.cli.leaderboard import badge, leaderboard
from glbench.cli.report import report
from glbench.cli.results import compare, show
from glbench.cli.story import story
from glbench.cli.train import export, sweep, train, tune
from glbench.cli.validate import validate
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
app.add_typer(rounds.app, name="round")
for _training in (train, export, sweep):
    app.command(_training.__name__)(_training)
app.add_typer(tune, name="tune")
for _group in (episodes, tasks, weather):
    app.add_typer(_group.app, name=_group.__name__.rpartition(".")[2])


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"glbench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help=f"Show tracebacks of errors (or set {DEBUG_VARIABLE}=1).")
    ] = False,
) -> None:
    if debug:
        os.environ[DEBUG_VARIABLE] = "1"
    show_warnings()


def _in_words(error: OSError) -> str:
    """An error of the system that nobody expected: a name too long, a full disk behind a pipe, a folder that may not be read."""
    what = error.strerror or str(error)
    place = "" if error.filename is None else f": {os.fsdecode(error.filename)}"
    return f"{what}{place}. Nothing more was done; {DEBUG_VARIABLE}=1 shows where."


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit with 0 (done), 1 (an error, in words), 2 (wrong usage), 130 (Ctrl-C) or 128 + a signal."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files need not be text
            stream.reconfigure(errors="backslashreplace")
    with interruptible() as interruption:
        try:
            app(arguments)
        except GlbenchError as error:
            if debugging():
                raise
            print_error(str(error))
            sys.exit(1)
        except OSError as error:
            if debugging():
                raise
            print_error(_in_words(error))
            sys.exit(1)
        except RuntimeError as error:
            if debugging() or not str(error).startswith("Symlink loop"):  # of pathlib, before Python 3.13
                raise
            print_error(
                f"A link leads back to itself: {str(error).removeprefix('Symlink loop from ')}. Remove it, or name a real file."
            )
            sys.exit(1)
        except KeyboardInterrupt:
            interruption.tell()
            sys.exit(interruption.exit_code)
        except SystemExit as left:
            if left.code != INTERRUPTED:
                raise
            interruption.tell()
            sys.exit(interruption.exit_code)
    sys.exit(0)


def run() -> NoReturn:
    """``main`` as a process of its own, which ends when the command has ended."""
    try:
        main()
    except SystemExit as left:
        leave(int(left.code or 0))
