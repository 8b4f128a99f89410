"""The language between an evaluation and the process of its agent: frames, the limits that both sides know, and what the agent prints.

A frame is a 16-byte header and a body. The header holds the kind, the number of the question that a frame asks or answers, and the
length of the body. Numbers are in the machine's own byte order, both ends being on one machine. Questions come from the trusted side, and
the first holds a pickle. Answers come from a process that may have been taken over: they are numbers of known length and short texts, and
nothing in them is ever executed.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from glbench.errors import refuse

if TYPE_CHECKING:
    from glbench.evaluation.limits import TimeLimits
    from glbench.tasks import TaskCard


HEADER = struct.Struct("=IIQ")  # Kind, number of the question, length of the body in bytes
ROW = struct.Struct("=II")
"""Begins the body of a ``Kind.ROW`` (row, index into ``STATUSES``), and every text in a ``Kind.PROBLEMS`` (row, length)."""
STATUSES = ("", "crashed", "timed_out", "invalid_action")
"""Statuses by the number that stands for them; the first means that nothing is wrong."""
LONGEST_TEXT = 1024  # Bytes of one text in an answer; a longer one makes it no answer
MIB = 2**20
GIB = 2**30


class Kind(IntEnum):
    """Kinds of frames; those before ``HELLO`` are questions."""

    LOAD = 1
    """Load and make the agent. Body: pickle of an ``AgentSetup``."""
    RESET = 2
    """Reset it. Body: mask of the rows, one byte each."""
    ACT = 3
    """Decide. Body: mask of the rows, one byte each, then observations (n, d) float32."""

    REHEARSE = 4
    """Make ready for a check: import packages, and listen to what the agent does besides. Body: their names, with zeros between them."""
    HEARD = 5
    """Tell what was overheard."""

    HELLO = 16
    """The process is there; sent once, unasked."""
    LOADED = 17
    """The submission's file was run; ``MADE`` or ``FAILED`` follows."""
    MADE = 18
    """There is an agent. Body: one byte, 1 when it is one agent a run."""
    DONE = 19
    """Reset without trouble."""
    ACTIONS = 20
    """Body: actions (n, m) float64."""
    PROBLEMS = 21
    """Body: actions (n, m) float64, then what is wrong with the answer, by row."""
    ROW = 22
    """One row of an answer of agents for single runs. Body: ``ROW``, then actions (m,) float64, nothing, or the reason."""
    FAILED = 23
    """The call failed for all rows. Body: index into ``STATUSES``, one byte, then the reason."""
    TOLD = 24
    """What was overheard. Body: lines, ``c`` for a connection or ``w`` for a file written, a space, where to."""


@dataclass(frozen=True)
class AgentSetup:
    """What the process is to do: the path of the agent as seen from inside, its task, the number of runs, and its limits.

    ``definition`` is what ``get_task`` finds inside (``glbench.tasks.card``).
    """

    path: str
    card: TaskCard
    runs: int
    time: TimeLimits
    sizes: SandboxLimits
    definition: str = ""


def encoded(text: str) -> bytes:
    """A text as it stands in an answer, cut where it is too long."""
    return text.encode("utf-8", errors="replace")[:LONGEST_TEXT]


def packed_problems(problems: Mapping[int, str]) -> bytes:
    """What is wrong, by row."""
    texts = {row: encoded(reason) for row, reason in problems.items()}
    return b"".join(ROW.pack(row, len(text)) + text for row, text in texts.items())


def unpacked_problems(body: bytes) -> Iterator[tuple[int, bytes]]:
    """Rows and texts out of ``packed_problems``. Raises ``ValueError`` when ``body`` was not made by it."""
    at = 0
    while at < len(body):
        if len(body) - at < ROW.size:
            refuse("cut off")
        row, length = ROW.unpack_from(body, at)
        at += ROW.size
        if length > min(LONGEST_TEXT, len(body) - at):
            refuse("too long")
        yield row, body[at : at + length]
        at += length


@dataclass(frozen=True)
class SandboxLimits:
    """Sizes in bytes. The same on every machine, so that an agent that runs on one runs on the other."""

    memory: int = 4 * GIB
    """Address space of one process, and resident memory of all its processes together."""
    scratch: int = 256 * MIB
    """Size of its /tmp, and of the largest file in it."""
    shared: int = 64 * MIB
    """Size of its /dev/shm."""
    tasks: int = 128
    """Processes and threads together."""
    files: int = 256
    """Open files of one process."""
    open_files: int = 1024
    """Open files, pipes and sockets of all processes together: each may hold memory of the kernel."""
    made: int = 65536
    """Files and folders in /tmp and /dev/shm."""
    printed: int = 64 * 1024
    """What is kept of its output: the first half and the last."""


class Prints:
    """The output of an agent's processes: the first half of ``size`` bytes, and the last."""

    def __init__(self, size: int = 64 * 1024) -> None:
        self._half = size // 2
        self._head = b""
        self._tail = b""
        self._total = 0

    def add(self, output: bytes) -> None:
        """Take in more output."""
        self._total += len(output)
        room = self._half - len(self._head)
        self._head += output[:room]
        self._tail = (self._tail + output[room:])[-self._half :] if len(output) > room else self._tail

    @property
    def size(self) -> int:
        """Bytes of all that was printed, kept or not."""
        return self._total

    def text(self) -> str:
        """The output with a note where some of it was left out; free of control characters, which could forge what a terminal shows."""
        left_out = self._total - len(self._head) - len(self._tail)
        note = f"\n[... {left_out:,} bytes left out ...]\n".encode() if left_out else b""
        return plain((self._head + note + self._tail).decode("utf-8", errors="replace"))

    def last_lines(self, number: int) -> list[str]:
        """The last lines that are not empty."""
        return [line for line in self.text().splitlines() if line.strip()][-number:]


def plain(text: str) -> str:
    """``text`` without control characters other than ends of lines and tabulators."""
    return "".join(letter for letter in text if letter.isprintable() or letter in "\n\t")
