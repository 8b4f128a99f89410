"""The terminal and the process: what commands show as data, the one printer of it, and how a command ends.

A command makes a ``View``: parts for people (lines and tables) and the document that ``--json`` prints. ``show`` prints either.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from types import FrameType
from typing import Any, Literal, NoReturn

import rich.table
import typer
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.padding import Padding
from rich.text import Text

from glbench.resources import signal_handlers_kept
from glbench.untrusted import visible

DEBUG_VARIABLE = "GLBENCH_DEBUG"
NOTHING_LEARNT = 3  # Exit code of a training that finished and never beat the policy that it began with
INTERRUPTED = 130  # Exit code after Ctrl-C, as shells have it: 128 and the signal's number
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_PATIENCE_SECONDS = 2.0
_COPIED = "\n\t" + "".join(map(chr, range(0xDC80, 0xDD00)))
"""Kept in lines that are not wrapped, although not printable: the last ones are bytes of file names that are no text, printed escaped."""
_NARROWEST, _NARROW = 8, 18
"""Least width of an elastic column: the second before a column is left out, the first when none is left to leave out."""


# Text


class Markup(str):
    """Text with rich's markup; words from elsewhere in it have to go through ``plain`` or ``styled``."""

    __slots__ = ()


def harmless(text: str) -> str:
    """``text`` without characters that control a terminal: file names and text of submissions may contain them."""
    return visible(text, keep="\n\t")


def plain(text: object) -> str:
    """``text`` for use in markup, shown as it is."""
    return escape(harmless(str(text)))


def styled(text: object, style: str) -> str:
    """``text`` in a style, for use in markup."""
    return f"[{style}]{plain(text)}[/]"


def count(number: int, noun: str) -> str:
    """``1 run``, ``2 runs``."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


# What a command shows


@dataclass(frozen=True)
class Line:
    """A line of text. ``wrap``: ``never``, between ``words`` in a terminal only, or ``always``; ``aside``: to standard error."""

    text: str
    style: str = ""
    aside: bool = False
    wrap: Literal["never", "words", "always"] = "never"
    indent: int = 0


def paragraph(text: str, style: str = "", *, aside: bool = False) -> Line:
    """Text that breaks between words in a terminal."""
    return Line(text, style, aside, "words")


def aside(text: str, style: str = "") -> Line:
    """A line beside the result, on standard error."""
    return Line(text, style, aside=True)


def warning(text: str) -> Line:
    """``Note: ...`` in yellow on standard error."""
    return aside(Markup(f"[bold yellow]Note: [/]{plain(text)}"))


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Numbers are aligned right. The lines of a ``fold`` column may break. In a terminal that is too narrow columns that give way are left
    out, the highest number first; an ``elastic`` column takes the width that the others leave.
    """

    heading: str
    number: bool = False
    fold: bool = False
    style: str | None = None
    min_width: int | None = None
    gives_way: int = 0
    elastic: bool = False


@dataclass(frozen=True)
class Row:
    """Cells of a row; ``ends_section``: a rule follows."""

    cells: tuple[str, ...]
    style: str | None = None
    ends_section: bool = False


@dataclass
class Table:
    """A table as data; ``look`` are options of ``rich.table.Table``, ``margin`` the blank lines after and columns before it."""

    title: str | None
    columns: list[Column]
    rows: list[Row] = field(default_factory=list)
    caption: str | None = None
    look: Mapping[str, Any] = field(default_factory=dict)
    margin: tuple[int, int] = (0, 0)

    def add(self, *cells: str, style: str | None = None) -> None:
        """Add a row."""
        self.rows.append(Row(cells, style))

    def end_section(self) -> None:
        """Draw a rule after the last row."""
        if self.rows:
            last = self.rows.pop()
            self.rows.append(Row(last.cells, last.style, ends_section=True))


def table(
    title: str | None,
    *headings: str,
    numbers: Collection[str] = (),
    fold: Collection[str] = (),
    caption: str | None = None,
    margin: tuple[int, int] = (0, 0),
    **look: Any,
) -> Table:
    """An empty table with these headings; columns in ``numbers`` hold numbers, only those in ``fold`` break their lines."""
    columns = [Column(one, number=one in numbers, fold=one in fold) for one in headings]
    return Table(title, columns, caption=caption, look=look, margin=margin)


Part = Line | Table


@dataclass(frozen=True)
class View:
    """What a command shows: ``parts`` to people, ``document`` with ``--json``; ``notes`` and the exit ``code`` in both cases.

    The parts may come from a generator, which then runs only if they are printed; a function as document is called only with
    ``--json``. A string as document is JSON already.
    """

    parts: Iterable[Part] = ()
    document: Any = None
    notes: Sequence[str] = ()
    code: int = 0
    indent: int | None = 2


# The printer


@cache
def output() -> Console:
    """Console of standard output: results and tables."""
    return Console(highlight=False)


@cache
def messages() -> Console:
    """Console of standard error: progress, warnings and errors, out of the way of output that is piped on."""
    return Console(stderr=True, highlight=False)


@dataclass(frozen=True)
class Printer:
    """Prints for people, or with ``--json`` for programs."""

    as_json: bool = False

    def say(self, *parts: Part) -> None:
        """Print for people; nothing with ``--json``."""
        if not self.as_json:
            put_parts(parts)

    def show(self, view: View) -> None:
        """Print a view. Raises ``typer.Exit`` with the view's exit code, unless it is 0."""
        for note in view.notes:
            print_warning(note)
        if self.as_json:
            document = view.document() if callable(view.document) else view.document
            text = document if isinstance(document, str) else json.dumps(document, indent=view.indent, allow_nan=False)
            output().out(text, highlight=False)
        else:
            put_parts(view.parts)
        if view.code:
            raise typer.Exit(view.code)


def show(view: View, *, as_json: bool = False) -> None:
    """Print a view, with ``as_json`` its document. Errors as for ``Printer.show``."""
    Printer(as_json).show(view)


def put_parts(parts: Iterable[Part]) -> None:
    """Print lines and tables."""
    for part in parts:
        if isinstance(part, Table):
            _put_table(part)
        else:
            _put_line(part)


def _put_line(line: Line) -> None:
    console = messages() if line.aside else output()
    text: str | Text = line.text
    if not isinstance(line.text, Markup):  # what is not wrapped can be copied, paths for example
        text = Text(visible(line.text, keep=_COPIED) if line.wrap == "never" else harmless(line.text))
    if line.indent:
        console.print(Padding(text, (0, 0, 0, line.indent), expand=False), style=line.style)
    elif line.wrap == "words":
        say(console, text, line.style)
    else:
        console.print(text, style=line.style, soft_wrap=line.wrap == "never")


def say(console: Console, text: str | Text, style: str | None = None) -> None:
    """Print a paragraph: in a terminal lines end between words, elsewhere it is one line.

    A word longer than a line, such as a path, is left to the terminal, so that it can be copied.
    """
    longest = max(map(len, str(text).split()), default=0)
    console.print(text, style=style, soft_wrap=not console.is_terminal or longest > console.width)


def write(text: object) -> None:
    """Print a line of a result as it is: no markup, and long lines are left to the terminal, so that paths can be copied."""
    _put_line(Line(str(text)))


def tell(text: str) -> None:
    """As ``write``, on standard error."""
    _put_line(Line(text, aside=True))


def print_error(text: str) -> None:
    """``Error: ...`` in red on standard error. Long lines are left to the terminal, so that paths can be copied."""
    messages().print(Text.assemble(("Error: ", "bold red"), harmless(text)), soft_wrap=True)


def print_warning(text: str) -> None:
    """Print a ``warning``."""
    _put_line(warning(text))


def _put_table(view: Table) -> None:
    columns, missing, width = list(view.columns), list[str](), None
    if any(column.elastic for column in columns):
        columns, width = _fitting(view)
        missing = [column.heading.replace("\n", " ") for column in view.columns if column not in columns]
    shape: Any = _rich(view, columns, width)
    output().print(Padding(shape, (0, 0, *view.margin), expand=False) if any(view.margin) else shape)
    if missing:
        words = f"Hidden columns (terminal too narrow): {', '.join(missing)}. Use --json to see them."
        output().print(Text(words), style="dim")
    if width is not None:
        output().print()


def _fitting(view: Table) -> tuple[list[Column], int]:
    """The columns that the terminal has room for, and the width of the elastic one."""
    console, columns = output(), list(view.columns)
    place = next(place for place, column in enumerate(columns) if column.elastic)
    longest = max((cell_len(row.cells[place]) for row in view.rows), default=0)
    while True:
        narrow = min(longest, _NARROW if any(column.gives_way for column in columns) else _NARROWEST)
        narrow = max(narrow, cell_len(view.columns[place].heading))
        grid = _rich(view, columns, narrow)
        room = console.width - Measurement.get(console, console.options.update(max_width=10_000), grid).minimum
        first = max(columns, key=lambda column: column.gives_way)
        if room >= 0 or first.gives_way == 0:
            return columns, min(max(longest, narrow), narrow + max(room, 0))
        columns.remove(first)


def _rich(view: Table, columns: Sequence[Column], width: int | None) -> rich.table.Table:
    def cell(text: str) -> str:
        return text if isinstance(text, Markup) else escape(harmless(text))

    look: dict[str, Any] = {"title_justify": "left", "title_style": "bold", "box": box.SIMPLE_HEAD}
    title, caption = (None if text is None else cell(text) for text in (view.title, view.caption))
    grid = rich.table.Table(title=title, caption=caption, **(look | dict(view.look)))
    for column in columns:
        grid.add_column(
            cell(column.heading),
            justify="right" if column.number else "left",
            no_wrap=not column.fold,
            overflow="fold" if column.fold else "ellipsis",
            style=column.style,
            min_width=column.min_width,
            width=width if column.elastic else None,
        )
    places = [place for place, column in enumerate(view.columns) if column in columns]
    for row in view.rows:
        cells = [cell(row.cells[place]) for place in places if place < len(row.cells)]
        grid.add_row(*cells, style=row.style, end_section=row.ends_section)
    return grid


# How a command ends


_interruptions: list[str] = []  # What was printed about interruptions, so that none is reported twice, and none goes unreported


def tell_interrupted(consequence: str = "") -> None:
    """Print that work was interrupted, and the consequence."""
    _interruptions.append(consequence)
    messages().print(f"\n[bold yellow]Interrupted.[/bold yellow] {consequence}".rstrip(), soft_wrap=True)


@contextlib.contextmanager
def interruption(consequence: str | Callable[[], str]) -> Iterator[None]:
    """Turn Ctrl-C into the message ``Interrupted.`` with its ``consequence``, and into ``typer.Exit`` with the code ``INTERRUPTED``."""
    try:
        yield
    except KeyboardInterrupt:
        tell_interrupted(consequence if isinstance(consequence, str) else consequence())
        raise typer.Exit(INTERRUPTED) from None


class Interruption:
    """Raises ``KeyboardInterrupt`` for the signals TERM and HUP, too; ``exit_code`` depends on the last signal."""

    def __init__(self) -> None:
        self._number = int(signal.SIGINT)
        self._reports_before = len(_interruptions)

    def tell(self) -> None:
        """Print that the command was interrupted, unless it has printed that itself."""
        if len(_interruptions) == self._reports_before:
            tell_interrupted()

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal."""
        return 128 + self._number

    def interrupt(self, number: int, _frame: FrameType | None) -> NoReturn:
        """Handle a signal."""
        self._number = number
        raise KeyboardInterrupt


@contextlib.contextmanager
def interruptible() -> Iterator[Interruption]:
    """Signals interrupt; afterwards the previous handlers are restored."""
    signals = Interruption()
    with _handled_by(signals.interrupt):
        yield signals


@contextlib.contextmanager
def leaving_at_once() -> Iterator[None]:
    """Signals end the process at once: for imports, where an exception would come out of a half-loaded module."""

    def leave_now(number: int, _frame: FrameType | None) -> NoReturn:
        os.write(2, b"\nInterrupted.\n")
        os._exit(128 + number)

    with _handled_by(leave_now):
        yield


@contextlib.contextmanager
def _handled_by(handler: Callable[[int, FrameType | None], NoReturn]) -> Iterator[None]:
    with signal_handlers_kept(_SIGNALS) as before:
        for number, usual in before.items():
            if usual != signal.SIG_IGN:  # ignored signals stay ignored (nohup)
                signal.signal(number, handler)
        yield


def quoted(path: object) -> str:
    """A path as a shell takes it, for commands that are printed."""
    return shlex.quote(str(path))


def leave(code: int) -> NoReturn:
    """End the process with ``code``, also when threads of an agent still run: Python would wait for them forever."""
    deadline = time.monotonic() + _PATIENCE_SECONDS
    # Python itself ends daemons and idle executors.
    threads = [
        one
        for one in threading.enumerate()
        if one is not threading.main_thread() and not one.daemon and not one.name.startswith("ThreadPoolExecutor")
    ]
    for thread in threads:
        thread.join(max(0.0, deadline - time.monotonic()))
    alive = [thread for thread in threads if thread.is_alive()]
    if alive:
        names = ", ".join(thread.name for thread in alive)
        tell(f"An agent left threads at work ({names}); they are ended with this command.")
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


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
