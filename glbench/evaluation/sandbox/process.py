"""The process of a sandboxed agent, from outside: started, asked with deadlines, watched, ended.

Whatever it does, the evaluation gets an answer of the right form or a ``LostError`` with the reason, in bounded time. Nothing waits for the
process without a deadline, its output is read while it is waited for, and it is gone when ``close`` returns. The kernel limits each
process by itself (``worker.limit_this_process``); what many of them take together is found out by looking. So is what stands in nobody's
account: the kernel's own memory behind sockets and empty files.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

from glbench.agents import Identity
from glbench.children import Child
from glbench.errors import SandboxError, refuse
from glbench.evaluation.records import Status
from glbench.evaluation.sandbox import bubblewrap
from glbench.evaluation.sandbox.frames import GIB, HEADER, LONGEST_TEXT, Kind, Prints, SandboxLimits
from glbench.resources import Scratch

_LOOK_SECONDS = 0.2
_SOME_MORE = 8  # Tasks that do not belong to the agent: bubblewrap's own, and those that are just coming or going
_KIB = 1024
_START_SECONDS: Final = 60.0  # For Python and numpy to come up; the agent's own time begins afterwards
_END_SECONDS: Final = 5.0
_GULP: Final = 1 << 16
_EAGER_SECONDS: Final = 0.5e-3
"""An answer that comes so soon is not slept for: waking up takes as long as a small agent's decision, on a colder processor."""


class Watch:
    """Looks at the processes below ``root``, a process id, not more often than is useful."""

    def __init__(self, root: int, sizes: SandboxLimits) -> None:
        self._root = root
        self._sizes = sizes
        self._next = 0.0

    def complaint(self) -> str | None:
        """What has grown too large, in words; ``None`` while nothing has, and between two looks."""
        now = time.monotonic()
        if now < self._next:
            return None
        self._next = now + _LOOK_SECONDS
        return self._look()

    def memory(self) -> int:
        """Memory of all processes now [bytes]."""
        return self._resources().memory

    def _look(self) -> str | None:
        used, sizes = self._resources(), self._sizes
        if used.tasks > sizes.tasks + _SOME_MORE:
            return f"the agent started more than {sizes.tasks} processes and threads, which is its limit"
        if used.memory > sizes.memory:
            return f"the agent's processes took more than {sizes.memory / GIB:.3g} GiB of memory together, which is their limit"
        if used.open_files > sizes.open_files:
            return f"the agent's processes opened more than {sizes.open_files:,} files, pipes and sockets together, which is their limit"
        if sum(map(self._count_files, ("tmp", "dev/shm"))) > sizes.made:
            return f"the agent made more than {sizes.made:,} files in /tmp and /dev/shm, which is its limit"
        return None

    def _resources(self) -> _Resources:
        """What all processes take; not counted on where there are too many already."""
        waiting, used = [self._root], _Resources()
        while waiting and used.tasks <= self._sizes.tasks + _SOME_MORE:
            place = Path("/proc") / str(waiting.pop())
            threads: list[Path] = []
            try:
                threads = list((place / "task").iterdir())
                used.memory += _memory(place)
                waiting += [int(child) for thread in threads for child in _children(thread)]
                used.open_files += sum(1 for _ in (place / "fd").iterdir())
            except OSError:  # it ended while we looked
                continue
            finally:
                used.tasks += len(threads)
        return used

    def _count_files(self, place: str) -> int:
        """Files in a folder of the sandbox that is in memory: each takes some of it, which no size limits."""
        try:
            statistics = os.statvfs(f"/proc/{self._root}/root/{place}")
        except OSError:  # it has ended
            return 0
        return statistics.f_files - statistics.f_ffree


@dataclass
class _Resources:
    """What the processes of a sandbox take together; ``memory`` in bytes."""

    tasks: int = 0
    memory: int = 0
    open_files: int = 0


def _memory(place: Path) -> int:
    """Memory of a process that is not the content of files [bytes]."""
    numbers = [
        int(line.split()[1]) * _KIB
        for line in (place / "status").read_text(encoding="utf-8", errors="replace").splitlines()
        if line.startswith(("RssAnon:", "RssShmem:"))
    ]
    return sum(numbers)


def _children(thread: Path) -> list[str]:
    """Ids of the processes that a thread started; none where the kernel keeps no such list."""
    try:
        return (thread / "children").read_text(encoding="ascii").split()
    except FileNotFoundError:
        return []


class LostError(Exception):
    """The process is of no more use; ``status`` and ``reason`` are those of the runs it was asked for."""

    def __init__(self, status: Status, reason: str) -> None:
        super().__init__(reason)
        self.status: Status = status
        self.reason = reason


class AgentProcess:
    """A process with the ``submission`` in it, ready to be asked.

    ``sizes`` limit how much of the machine it may take, and ``prints`` takes in what it prints; ``largest_answer`` is the longest answer
    there can be [bytes]. Without ``walls`` it runs in no sandbox and has all rights of this process. ``libraries`` are the compiled kernels
    that it sees, by their names inside. Raises ``SandboxError`` when the sandbox cannot be built, or does not start.
    """

    def __init__(
        self,
        submission: Identity,
        sizes: SandboxLimits,
        prints: Prints,
        largest_answer: int,
        *,
        walls: bool = True,
        libraries: Mapping[str, Path] | None = None,
    ) -> None:
        self._walls = walls
        self._libraries = libraries or {}
        self._prints = prints
        self._longest = max(largest_answer, 2 * LONGEST_TEXT)
        self._inbox = memoryview(bytearray(2 * (HEADER.size + self._longest)))
        self._from, self._to = 0, 0
        self._staging = Scratch()
        self._pidfd = -1
        self._watch: Watch | None = None
        self._lost: LostError | None = None
        self._closed = False
        try:
            self._start(submission, sizes)
        except BaseException:
            self._staging.remove()
            raise
        try:
            self._await_hello(sizes)
        except BaseException:
            self.close()
            raise

    def ask(self, kind: Kind, number: int, *parts: bytes | memoryview, seconds: float) -> None:
        """Ask a question, which must be taken within ``seconds``.

        Raises ``LostError`` when the process is gone, too large, does not listen, or has said something that nobody asked for; it is ended.
        """
        self._still_there()
        if self._from != self._to or self._has_more():
            self.refuse("it came before the question")
        question = memoryview(b"".join((HEADER.pack(kind, number, sum(map(len, parts))), *parts)))
        until = time.monotonic() + seconds
        while True:
            try:
                sent = self._sock.send(question)
            except BlockingIOError:
                sent = 0
            except OSError:
                self._raise_ended()
            question = question[sent:]
            if not question:
                return
            self._wait(until, select.POLLOUT, "the agent's process does not take its observations")

    def answer(self, number: int, until: float, late: str) -> tuple[int, memoryview]:
        """Kind and body of the answer to question ``number``; the body is valid until the next call.

        Raises ``LostError`` with the reason ``late`` when there is none by ``until`` (``time.monotonic()``); the process is ended.
        """
        self._still_there()
        if self._from == self._to:
            self._from = self._to = 0
        self._have(HEADER.size, until, late)
        kind, number_in_frame, length = HEADER.unpack_from(self._inbox, self._from)
        if number_in_frame != number or kind < Kind.HELLO or length > self._longest:
            self.refuse(f"an answer of kind {kind} to question {number_in_frame} with {length:,} bytes, when {number} was asked")
        self._have(HEADER.size + length, until, late)
        start = self._from + HEADER.size
        self._from = start + length
        return kind, self._inbox[start : self._from]

    def memory(self) -> int:
        """Memory of the process and all that it started [bytes]; 0 once it has ended."""
        return self._watch.memory() if self._watch is not None and self._lost is None else 0

    def refuse(self, what: str) -> NoReturn:
        """End the process, because it answered something that is no answer. Always raises ``LostError``."""
        self._end("crashed", f"the agent's process sent what is no answer: {what}")

    def close(self) -> None:
        """End the process and all that it started, and read what is left of its output."""
        if self._lost is None:
            self._lost = LostError("crashed", "the agent's process was ended")
        if self._closed:
            return
        self._closed = True
        self._kill()
        self._sock.close()
        self._read_output()
        os.close(self._output)
        self._staging.remove()

    def _start(self, submission: Identity, sizes: SandboxLimits) -> None:
        with contextlib.ExitStack() as undo, contextlib.ExitStack() as stack:
            self._sock, theirs = socket.socketpair()
            undo.callback(self._sock.close)
            stack.callback(theirs.close)
            self._output, writing = os.pipe()
            undo.callback(os.close, self._output)
            stack.callback(os.close, writing)
            self._facts, facts_writing = os.pipe()
            undo.callback(os.close, self._facts)
            stack.callback(os.close, facts_writing)
            inherited, environment = [theirs.fileno()], {**os.environ, **dict.fromkeys(bubblewrap.THREAD_VARIABLES, "1")}
            line = [sys.executable, "-m", "glbench.evaluation.sandbox.worker", str(theirs.fileno())]
            if self._walls:
                call_filter, environment = bubblewrap.system_call_filter(), bubblewrap.ENVIRONMENT_OF_BUBBLEWRAP
                filter_file = _readable(call_filter, stack) if call_filter is not None else None
                inside, arguments = bubblewrap.command(
                    submission, self._staging.folder, sizes, (theirs.fileno(), filter_file, facts_writing), self._libraries
                )
                words = _readable("\0".join(arguments).encode() + b"\0", stack)
                inherited += [facts_writing, words, *([filter_file] if filter_file is not None else [])]
                line = [*bubblewrap.program(), "--args", str(words), *inside]
            # A session of its own: Ctrl-C in the terminal is for the evaluation, which ends the agent in its own time.
            self._started = Child(line, stdin=subprocess.DEVNULL, stdout=writing, stderr=writing, pass_fds=inherited, env=environment)
            undo.pop_all()
        self._sock.setblocking(False)
        os.set_blocking(self._output, False)
        self._poll = select.poll()
        self._poll.register(self._sock, select.POLLIN)
        self._poll.register(self._output, select.POLLIN)

    def _await_hello(self, sizes: SandboxLimits) -> None:
        what = "sandbox" if self._walls else "agent's process"
        try:
            kind, _ = self.answer(0, time.monotonic() + _START_SECONDS, "Python does not come up")
        except LostError as lost:
            output = " ".join(self._prints.last_lines(5))
            refuse(f"The {what} does not start: {lost.reason}. {output or 'It output nothing.'}", SandboxError, lost)
        if kind != Kind.HELLO:
            refuse(f"The {what} does not start: it began with a frame of kind {kind}.", SandboxError)
        first = self._started.pid
        with os.fdopen(self._facts, "rb") as facts:
            self._facts = -1
            if self._walls:
                first = int(json.loads(facts.read())["child-pid"])
        if hasattr(os, "pidfd_open"):
            self._pidfd = os.pidfd_open(first)
        self._watch = Watch(first, sizes)

    def _have(self, size: int, until: float, late: str) -> None:
        """Receive until the inbox holds ``size`` bytes that were not taken out."""
        if self._from + size > len(self._inbox):
            rest = bytes(self._inbox[self._from : self._to])
            self._inbox[: len(rest)] = rest
            self._from, self._to = 0, len(rest)
        eager = time.monotonic() + _EAGER_SECONDS
        while self._to - self._from < size:
            try:
                got = self._sock.recv_into(self._inbox[self._to :])
            except BlockingIOError:
                if time.monotonic() < eager:
                    os.sched_yield()
                else:
                    self._wait(until, select.POLLIN, late)
                continue
            except OSError:
                got = 0
            if got == 0:
                self._raise_ended()
            self._to += got

    def _wait(self, until: float, event: int, late: str) -> None:
        """Wait until the socket is ready, reading the output and watching the size meanwhile."""
        if event != select.POLLIN:
            self._poll.modify(self._sock, event)
        try:
            while True:
                remaining = until - time.monotonic()
                if remaining <= 0.0:
                    self._end("timed_out", late)
                answered = False
                for descriptor, _ in self._poll.poll(min(remaining, _LOOK_SECONDS) * 1e3):
                    if descriptor == self._output:
                        self._read_output(once=True)
                    else:
                        answered = True
                if answered:
                    return
                self._look()
        finally:
            if event != select.POLLIN and self._lost is None:
                self._poll.modify(self._sock, select.POLLIN)

    def _has_more(self) -> bool:
        """Whether something has come that was not received yet."""
        try:
            return bool(self._sock.recv(1, socket.MSG_PEEK))
        except OSError:  # nothing has, or the other end is closed
            return False

    def _still_there(self) -> None:
        if self._lost is not None:
            raise self._lost
        self._look()

    def _look(self) -> None:
        complaint = self._watch.complaint() if self._watch is not None else None
        if complaint is not None:
            self._end("crashed", complaint)

    def _read_output(self, *, once: bool = False) -> None:
        while True:
            try:
                output = os.read(self._output, _GULP)
            except BlockingIOError:
                return
            if not output:
                with contextlib.suppress(KeyError):
                    self._poll.unregister(self._output)
                return
            self._prints.add(output)
            if once:
                return

    def _raise_ended(self) -> NoReturn:
        """The other end is closed: find out how the process ended."""
        try:
            code = self._started.wait(1.0)
        except subprocess.TimeoutExpired:
            self._end("crashed", "the agent's process closed the connection")
        self._end("crashed", f"the agent's process ended {_how(code)}")

    def _end(self, status: Status, reason: str) -> NoReturn:
        self._lost = LostError(status, reason)
        self.close()
        raise self._lost

    def _kill(self) -> None:
        if self._pidfd >= 0:
            # The first process of the sandbox takes all others with it, and has ended when they have.
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
            ended = select.poll()
            ended.register(self._pidfd, select.POLLIN)
            ended.poll(_END_SECONDS * 1e3)
            os.close(self._pidfd)
            self._pidfd = -1
        if self._facts >= 0:
            os.close(self._facts)
            self._facts = -1
        self._started.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._started.wait(_END_SECONDS)


def _how(code: int) -> str:
    """An exit code as bubblewrap hands it on, in words."""
    number = -code if code < 0 else code - 128
    names = {member.value: member.name for member in signal.Signals}
    if number in names and code != 0:
        hint = ", by itself or for lack of memory" if number == signal.SIGKILL else ""
        return f"by the signal {names[number]}{hint}"
    return f"with exit code {code}"


def _readable(content: bytes, stack: contextlib.ExitStack) -> int:
    """A file without a name that holds ``content``, to be read by another process."""
    file = os.memfd_create("glbench", os.MFD_CLOEXEC)
    stack.callback(os.close, file)
    os.write(file, content)
    os.lseek(file, 0, os.SEEK_SET)
    return file
