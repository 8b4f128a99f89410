"""The command ``glbench``: puts the groups of commands together and turns errors into words."""

from __future__ import annotations

import io
import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from typer.core import TyperGroup

from glbench import __version__
from glbench.cli import console
from glbench.cli.console import DEBUG_VARIABLE, INTERRUPTED
from glbench.errors import GlbenchError

if TYPE_CHECKING:
    from typer._click.core import Command, Context

# In the order of the help: each command with its module and, for a group, the name of the group there.
_COMMANDS = {
    "evaluate": ("evaluate", None), "leaderboard": ("leaderboard", None), "show": ("results", None), "compare": ("results", None),
    "badge": ("leaderboard", None), "report": ("report", None), "story": ("report", None), "verify": ("verify", None),
    "view": ("view", None), "bound": ("bound", None), "serve": ("serve", None), "bench": ("studies", None), "validate": ("studies", None),
    "identify": ("studies", None), "train": ("train", None), "ladder": ("ladder", None), "sweep": ("train", None),
    "submit": ("submit", "app"), "round": ("tasks", "round_app"), "tune": ("train", "tune"), "export": ("train", "export"),
    "episodes": ("episodes", "app"), "tasks": ("tasks", "app"), "greenhouse": ("greenhouse", "app"), "weather": ("weather", "app"),
    "prices": ("prices", "app"),
}  # fmt: skip


class _CommandsOnDemand(TyperGroup):
    """All commands, of which only the one that runs is imported; help and an unknown name import them all."""

    def list_commands(self, ctx: Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: Context, cmd_name: str) -> Command | None:
        names = [cmd_name] if cmd_name in _COMMANDS else list(_COMMANDS)
        for name in names:
            if name not in self.commands:
                self.commands[name] = _load(name)
        return self.commands.get(cmd_name)


def _load(name: str) -> Command:
    """The command or group ``name``, from its module."""
    module_name, group_name = _COMMANDS[name]
    module = import_module(f"glbench.cli.{module_name}")
    part = typer.Typer(rich_markup_mode="markdown", pretty_exceptions_enable=False)
    if group_name is None:
        part.command(name)(getattr(module, name))
    else:
        part.add_typer(getattr(module, group_name), name=name)
    return typer.main.get_group(part).commands[name]


app = typer.Typer(
    name="glbench",
    cls=_CommandsOnDemand,
    help="A reproducible benchmark for greenhouse climate control on the GreenLight model.",
    epilog="Start with: glbench evaluate submissions/my_agent.py",
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def print_version(is_requested: bool) -> None:
    """Callback of ``--version``."""
    if is_requested:
        typer.echo(f"glbench {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", callback=print_version, is_eager=True)] = False,
    debug: Annotated[bool, typer.Option("--debug", help=f"Show tracebacks of errors (or set {DEBUG_VARIABLE}=1).")] = False,
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
