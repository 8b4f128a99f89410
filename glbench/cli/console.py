"""The terminal: one console for what was asked for, one for everything said beside it."""

from __future__ import annotations

import logging
import os
from functools import cache
from typing import TYPE_CHECKING

from glbench.untrusted import visible

if TYPE_CHECKING:
    from rich.console import Console

DEBUG_VARIABLE = "GLBENCH_DEBUG"


@cache
def output() -> Console:
    """Console of standard output: results and tables."""
    from rich.console import Console

    return Console(highlight=False)


@cache
def messages() -> Console:
    """Console of standard error: progress, warnings and errors, out of the way of output that is piped on."""
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def say(console: Console, text: str, style: str | None = None) -> None:
    """Print a paragraph: in a terminal lines end between words, elsewhere it is one line.

    A word longer than a line, such as a path, is left to the terminal, so that it can be copied.
    """
    whole = not console.is_terminal or max(map(len, text.split()), default=0) > console.width
    console.print(text, style=style, soft_wrap=whole)


def harmless(text: str) -> str:
    """``text`` without characters that steer a terminal: names of files and words of strangers may hold them."""
    return visible(text, keep="\n\t")


def print_error(text: str) -> None:
    """``Error: ...`` in red on standard error. Long lines are left to the terminal, so that paths can be copied."""
    from rich.text import Text

    messages().print(Text.assemble(("Error: ", "bold red"), harmless(text)), soft_wrap=True)


def print_warning(text: str) -> None:
    """``Note: ...`` in yellow on standard error."""
    from rich.text import Text

    messages().print(Text.assemble(("Note: ", "bold yellow"), harmless(text)), soft_wrap=True)


def debugging() -> bool:
    """Whether tracebacks are wanted (``--debug`` or the environment variable ``GLBENCH_DEBUG=1``)."""
    return os.environ.get(DEBUG_VARIABLE, "") not in {"", "0"}


class _ShowWarnings(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        print_warning(record.getMessage())


def show_warnings() -> None:
    """Show what the library logs as notes on standard error."""
    logger = logging.getLogger("glbench")
    if not any(isinstance(handler, _ShowWarnings) for handler in logger.handlers):
        logger.addHandler(_ShowWarnings(logging.WARNING))
