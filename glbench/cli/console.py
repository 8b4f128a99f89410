"""The terminal: one console for what was asked for, one for everything said beside it."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Collection
from functools import cache
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from glbench.untrusted import visible

DEBUG_VARIABLE = "GLBENCH_DEBUG"


@cache
def output() -> Console:
    """Console of standard output: results and tables."""
    return Console(highlight=False)


@cache
def messages() -> Console:
    """Console of standard error: progress, warnings and errors, out of the way of output that is piped on."""
    return Console(stderr=True, highlight=False)


def say(console: Console, text: str, style: str | None = None) -> None:
    """Print a paragraph: in a terminal lines end between words, elsewhere it is one line.

    A word longer than a line, such as a path, is left to the terminal, so that it can be copied.
    """
    whole = not console.is_terminal or max(map(len, text.split()), default=0) > console.width
    console.print(text, style=style, soft_wrap=whole)


def put(text: object) -> None:
    """Print a line of a result as it is: no markup, and long lines are left to the terminal, so that paths can be copied."""
    output().print(str(text), markup=False, soft_wrap=True)


def tell(text: str) -> None:
    """As ``put``, beside the results."""
    messages().print(text, markup=False, soft_wrap=True)


def put_json(value: Any, indent: int | None = 2) -> None:
    """Print JSON and nothing else."""
    output().out(json.dumps(value, indent=indent, allow_nan=False), highlight=False)


def table(
    title: str | None, *headings: str, right: Collection[str] = (), folded: Collection[str] = (), **look: Any
) -> Table:
    """An empty table with these headings; columns in ``right`` hold numbers, only those in ``folded`` break their lines."""
    style: dict[str, Any] = {"title_justify": "left", "title_style": "bold", "box": box.SIMPLE_HEAD}
    view = Table(title=title, **(style | look))
    for heading in headings:
        fold = heading in folded
        view.add_column(
            heading,
            justify="right" if heading in right else "left",
            no_wrap=not fold,
            overflow="fold" if fold else "ellipsis",
        )
    return view


def harmless(text: str) -> str:
    """``text`` without characters that steer a terminal: names of files and words of strangers may hold them."""
    return visible(text, keep="\n\t")


def print_error(text: str) -> None:
    """``Error: ...`` in red on standard error. Long lines are left to the terminal, so that paths can be copied."""
    messages().print(Text.assemble(("Error: ", "bold red"), harmless(text)), soft_wrap=True)


def print_warning(text: str) -> None:
    """``Note: ...`` in yellow on standard error."""
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
