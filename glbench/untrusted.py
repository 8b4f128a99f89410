"""Reading and showing what strangers made: regular files only, no larger than they may be, expanded no further than is allowed.

Everything here is for files that may be hostile: results, records, profiles and cards from elsewhere.
"""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import stat
import unicodedata
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import IO, Any, Final
from zipfile import ZipFile

from glbench.errors import refuse

MIB: Final = 2**20
MOST_MARKS: Final = 500_000
"""Objects, lists and keys of a JSON text: each costs up to a kilobyte to read or to refuse. A result of 10,000 runs has 260,000."""
LARGEST_INTEGER: Final = 2**53 - 1  # Largest whole number in a result or a record: beyond it, JSON programs disagree about the value
AGENT_NAME_RULE: Final = "1 to 100 letters, digits, '.', '_' and '-', beginning with a letter or digit, not ending in '.proof'"
_AGENT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_DECIMAL_COMMA = re.compile(r"""(?<![\w.,"'\[])([+-]?\d[\d.]*),(\d+)(?![\w.]|,\d)""")
_LINE = re.compile(r"\(at line (\d+), column \d+\)")
_LONGEST_QUOTE = 80
_LONGEST_READ: Final = 4 * MIB  # Bytes that are read at once: tens of thousands of names, where a model has hundreds
_STEERING = frozenset("\u2028\u2029\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
"""Ends of lines and changes of direction, which Unicode does not count as control characters."""


def read_regular(path: Path, largest: int) -> bytes:
    """Content of the regular file ``path``, which has at most ``largest`` bytes.

    Raises ``OSError`` when it is missing, cannot be read, is larger, or is a folder, a pipe or a device. A pipe is not waited for.
    """
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > largest:
            refuse(f"it is larger than {_size(largest)}", OSError)
        return read_pieces(file.read, size)


@contextmanager
def open_regular(path: Path) -> Iterator[IO[bytes]]:
    """The regular file ``path``, open for reading, unbuffered. Raises ``OSError`` for any other, at once for a pipe."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
    try:
        handle = os.open(path, flags)
    except ValueError as error:  # a null character in the path
        raise OSError(str(error)) from error
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            refuse("it is a folder, a pipe or a device, and not a regular file", OSError)
        with os.fdopen(handle, "rb", buffering=0, closefd=False) as file:
            yield file
    finally:
        os.close(handle)


def decimal_point(text: str) -> str:
    """``"write 18.5, not 18,5"`` for a text with a number with a decimal comma; empty without one. A list such as ``1,2,3`` has none."""
    comma = _DECIMAL_COMMA.search(text)
    whole = f"{comma[1]}{comma[2]} or " if comma and len(comma[2]) == 3 and re.fullmatch(r"[+-]?[1-9]\d{0,2}", comma[1]) else ""
    return "" if comma is None else f"write {whole}{comma[1].replace('.', '')}.{comma[2]}, not {comma[0]}"


def toml_fault(error: Exception, text: str) -> str:
    """What ``tomllib`` found wrong with ``text``, with the line; of a decimal comma, how to write the number."""
    place = _LINE.search(str(error))
    line = text.split("\n")[int(place[1]) - 1].strip() if place else ""
    advice = decimal_point(line.partition("#")[0])
    return f"line {place[1]}, {quoted(line)}: {advice}" if place and advice else reason_of(error)


def real_path(path: Path) -> Path:
    """``path`` without links and ``..``. A link to itself stays, instead of the ``RuntimeError`` of ``Path.resolve``."""
    return Path(os.path.realpath(path))


@contextmanager
def opened_archive(file: Path) -> Iterator[ZipFile]:
    """The archive in ``file``.

    Raises ``ValueError`` when its contents are too many, and what ``ZipFile`` does: ``OSError``, ``BadZipFile``, ``NotImplementedError``.
    """
    with _InPieces(file) as stream, ZipFile(stream) as archive:
        yield archive


class _InPieces(io.FileIO):
    """A file of which only so much can be read at once."""

    def read(self, size: int | None = -1, /) -> bytes:
        """At most ``size`` bytes, or all that are left."""
        if size is None or size < 0:
            here = self.tell()
            size = self.seek(0, io.SEEK_END) - here
            self.seek(here)
        if size > _LONGEST_READ:
            refuse(f"its table of contents is longer than {_LONGEST_READ // MIB} MiB")
        return super().read(size) or b""


def gunzip(data: bytes, largest: int) -> bytes:
    """The content of a gzip file.

    Raises ``OSError``, ``EOFError``, ``zlib.error`` when it is damaged, and ``ValueError`` beyond ``largest`` bytes; no more is held.
    """
    with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
        content = read_pieces(file.read, largest + 1)
    if len(content) > largest:
        refuse(f"it expands to more than {_size(largest)}")
    return content


def read_pieces(read: Callable[[int], bytes], most: int) -> bytes:
    """What ``read(size)`` gives until it gives nothing, ``most`` bytes of it; a promise of many bytes takes no memory."""
    pieces, remaining = [], most
    while remaining > 0 and (piece := read(min(MIB, remaining))):
        pieces.append(piece)
        remaining -= len(piece)
    return b"".join(pieces)


def parse_json(text: bytes | str) -> Any:
    """The value of a JSON text.

    Raises ``ValueError`` when it is no JSON, holds an integer of thousands of digits, is nested too deeply, or is too crowded.
    ``json.JSONDecodeError`` is one.
    """
    refuse_crowd(text)
    if text[:3] == b"\xef\xbb\xbf" or text[:1] == "\ufeff":
        refuse("it begins with a byte order mark: save it as UTF-8 without one")
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        raise
    except (RecursionError, ValueError) as error:
        raise ValueError(reason_of(error)) from error


def reason_of(error: Exception) -> str:
    """Why a file cannot be read, as the end of a sentence: without the numbers and the advice to programmers that Python adds."""
    if isinstance(error, UnicodeDecodeError):
        return f"byte {error.start + 1:,} is not UTF-8 text"
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, gzip.BadGzipFile | EOFError | zlib.error):
        return "it is not a whole gzip file"
    if isinstance(error, FileExistsError):
        return "a file, or a link that leads nowhere, has the name of a folder"
    if isinstance(error, OSError):
        return error.strerror or str(error)
    digits = "integer string conversion" in str(error)
    return "it holds a whole number of thousands of digits" if digits else str(error)


def place_of(parts: Iterable[object]) -> str:
    """Where in a document pydantic met a problem, without the functions that it names for the choices of a union."""
    return visible(".".join(str(part)[:_LONGEST_QUOTE] for part in parts if "[" not in str(part)))


def refuse_crowd(text: bytes | str) -> None:
    """Raises ``ValueError`` for a JSON text of more than ``MOST_MARKS`` objects, lists and keys, which would fill the memory."""
    marks = sum(map(text.count, "{[:")) if isinstance(text, str) else sum(map(text.count, (b"{", b"[", b":")))
    if marks > MOST_MARKS:
        refuse(f"it has more than {MOST_MARKS:,} objects, lists and keys")


def quoted(value: object) -> str:
    """``value`` as Python writes it, shortened, on one line."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, or lists nested without end
        return "a value that is too large to show"
    return visible(text if len(text) <= _LONGEST_QUOTE else f"{text[: _LONGEST_QUOTE - 4]} ...")


def visible(text: str, keep: str = "") -> str:
    """``text`` as it may be displayed: a question mark for all that is not printable, no no-break space and not in ``keep``."""
    return "".join(letter if letter.isprintable() or letter in f"\u00a0{keep}" else "?" for letter in text)


def html_of(heading: str, facts: Iterable[tuple[str, object]], columns: Sequence[str] = (), rows: Iterable[Sequence[object]] = ()) -> str:
    """HTML for notebooks: a heading, a table of facts, and one with ``columns``; texts escaped, numbers on the right."""
    fact_rows = "".join(f'<tr><th style="text-align:left">{escaped(name)}</th>{_cell(value, "left")}</tr>' for name, value in facts)
    parts = [f"<p><strong>{escaped(heading)}</strong></p>", f"<table>{fact_rows}</table>"]
    if columns:
        head = "".join(f"<th>{escaped(column)}</th>" for column in columns)
        body = "".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>" for row in rows)
        parts.append(f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>")
    return f"<div>{''.join(parts)}</div>"


def _cell(value: object, side: str | None = None) -> str:
    side = side or ("right" if isinstance(value, int | float) else "left")
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f'<td style="text-align:{side}">{escaped(text)}</td>'


def escaped(text: str) -> str:
    """``text`` for HTML: printable characters only, with markup escaped."""
    return escape(visible(text))


def is_agent_name(name: str) -> bool:
    """Whether results can be filed under ``name``; ``.proof.json`` is the ending of the files that `glbench verify` writes."""
    return _AGENT_NAME.fullmatch(name) is not None and not name.lower().endswith(".proof")


def as_one_line(text: str) -> str:
    """``text`` as ``one_line`` takes it: U+FFFD in the place of every character that it refuses."""
    return "".join("\ufffd" if steers(letter) else letter for letter in text)


def steers(letter: str) -> bool:
    """Whether a character steers a terminal, ends a line, changes the direction of writing, or is half of one."""
    return unicodedata.category(letter) in {"Cc", "Cs"} or letter in _STEERING


def one_line(text: str) -> str:
    """``text``, if it can be shown on one line. Raises ``ValueError`` when it holds a character that steers a terminal or ends the line."""
    if text.isascii() and text.isprintable():  # as nearly all
        return text
    strange = next((letter for letter in text if steers(letter)), None)
    if strange is not None:
        refuse(f"the character U+{ord(strange):04X} cannot be shown")
    return text


def _size(count: int) -> str:
    return f"{count // MIB} MiB" if count >= MIB else f"{count // 1024} KiB"
