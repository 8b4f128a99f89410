"""Inside the sandbox: the process that loads an agent, shows it observations and sends its actions.

In a sandbox it is started as a script with the number of its socket and the version of glbench; for a check without a sandbox as a module,
with the number of its socket. Until it loads the submission everything here can
be trusted; from then on nothing can, and whoever reads the answers knows that.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import os
import pickle
import resource
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NoReturn

if __name__ == "__main__" and "glbench" not in sys.modules:
    # The package without what its __init__ does: there are no tasks here to register, and Gymnasium takes its time to load.
    _package = ModuleType("glbench")
    _package.__path__ = [str(Path(__file__).parents[2])]
    _package.__dict__["__version__"] = sys.argv[2]
    sys.modules["glbench"] = _package

import numpy as np
from numpy.typing import NDArray

from glbench.agents.loading import load_agent
from glbench.agents.protocol import PerRunAgent, action_problems, read_actions
from glbench.errors import ActionError, SubmissionError
from glbench.evaluation.limits import guarded, in_words
from glbench.evaluation.sandbox import frames
from glbench.tasks.card import set_task

_CREATE_RULESET, _RESTRICT_SELF = 444, 446  # Numbers of the system calls, on all processors the same
_MAKE_DEVICES: Final = 1 << 6 | 1 << 11  # A domain must forbid something; devices cannot be made in the sandbox anyhow
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_MOST_HEARD = 5
_REMOVING = frozenset({"os.remove", "os.rename", "os.mkdir", "os.rmdir"})
_NETWORK = (socket.AF_INET, socket.AF_INET6)
_NOBODY_ASKS_ANY_MORE = 0
_LETTING_GO_SECONDS = 0.25  # Less than the patience of who asked, on top of a call that took all of its time


class Line:
    """The worker's end of the socket; one question at a time."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._buffer = memoryview(bytearray(1 << 16))
        self._number = 0

    def question(self) -> tuple[int, memoryview]:
        """Kind and body of the next question; leaves the process when nobody asks any more. The body is valid until the next call."""
        got = self._receive(0, frames.HEADER.size)
        kind, self._number, length = frames.HEADER.unpack_from(self._buffer)
        whole = frames.HEADER.size + length
        if whole > len(self._buffer):
            larger = memoryview(bytearray(whole))
            larger[:got] = self._buffer[:got]
            self._buffer = larger
        self._receive(got, whole)
        return kind, self._buffer[frames.HEADER.size : whole]

    def answer(self, kind: frames.Kind, *parts: bytes) -> None:
        """Answer the question that was asked last."""
        body = b"".join(parts)
        self._sock.sendall(frames.HEADER.pack(kind, self._number, len(body)) + body)

    def failed(self, status: str, reason: str) -> None:
        """Answer that the call failed for all rows."""
        self.answer(frames.Kind.FAILED, bytes([frames.STATUSES.index(status)]), frames.encoded(reason))

    def _receive(self, got: int, enough: int) -> int:
        while got < enough:
            more = self._sock.recv_into(self._buffer[got:])
            if more == 0:
                os._exit(_NOBODY_ASKS_ANY_MORE)
            got += more
        return got


def limit_this_process(sizes: frames.SandboxLimits) -> None:
    """Take the limits of the sandbox upon this process and all that it starts; there is no way back."""
    limits = {
        resource.RLIMIT_AS: sizes.memory,
        resource.RLIMIT_FSIZE: sizes.scratch,
        resource.RLIMIT_NPROC: sizes.tasks,
        resource.RLIMIT_NOFILE: sizes.files,
        resource.RLIMIT_CORE: 0,
    }
    for what, size in limits.items():
        _, hard = resource.getrlimit(what)
        size = size if hard == resource.RLIM_INFINITY else min(size, hard)
        resource.setrlimit(what, (size, size))


class Host:
    """Has the agents and does what is asked for, one question after the other."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._agents: list[Any] = []
        self._single = False
        self._setup: frames.AgentSetup
        self._listener: Listener | None = None

    def do(self, kind: int, body: memoryview) -> None:
        """Answer a question."""
        if kind == frames.Kind.REHEARSE:
            # packages whose time is not the agent's are imported first, then it listens
            for package in filter(None, bytes(body).decode().split("\0")):
                with contextlib.suppress(ImportError):  # told when the agent itself imports it
                    importlib.import_module(package)
            self._listener = Listener()
            self._line.answer(frames.Kind.DONE)
        elif self._listener is None:
            self._ask_agent(kind, body)
        elif kind == frames.Kind.HEARD:
            heard = [f"c {where}" for where in self._listener.connections]
            heard += [f"w {what}" for what in self._listener.paths]
            self._line.answer(frames.Kind.TOLD, frames.encoded("\n".join(heard)))
        else:
            with self._listener.listening():
                self._ask_agent(kind, body)

    def _ask_agent(self, kind: int, body: memoryview) -> None:
        if kind == frames.Kind.LOAD:
            self._make(pickle.loads(body))
        elif self._single:
            self._ask_one_by_one(kind, body)
        else:
            self._ask_for_all(kind, body)

    def _make(self, setup: frames.AgentSetup) -> None:
        """Make the agent, or one adapter with its agent for each run."""
        self._setup, self._agents = setup, []
        limit_this_process(setup.sizes)
        set_task(setup.definition)
        try:
            loaded = load_agent(Path(setup.path))
            self._line.answer(frames.Kind.LOADED)
            first = loaded.make(setup.card)
            self._single = isinstance(first, PerRunAgent)
            others = setup.runs - 1 if self._single else 0
            self._agents = [first, *(loaded.make(setup.card) for _ in range(others))]
        except SubmissionError as error:
            self._line.failed("crashed", str(error))
        except BaseException as error:  # the submission's code may raise anything; it is reported, not swallowed
            reason = f"The agent '{Path(setup.path).stem}' cannot be made: {described(error)}."
            self._line.failed("crashed", reason)
        else:
            self._line.answer(frames.Kind.MADE, bytes([self._single]))

    def _ask_for_all(self, kind: int, body: memoryview) -> None:
        """Reset a batched agent, or ask it for all rows."""
        card, n, agent = self._setup.card, self._setup.runs, self._agents[0]
        try:
            if kind == frames.Kind.RESET:
                agent.reset(card, n)
                self._line.answer(frames.Kind.DONE)
                return
            observations = np.frombuffer(body[n:], dtype=np.float32).reshape(n, -1).copy()
            actions, problems = read_actions(agent.act(observations), card, n)
            answer_kind = frames.Kind.PROBLEMS if problems else frames.Kind.ACTIONS
            self._line.answer(answer_kind, actions.tobytes(), frames.packed_problems(problems))
        except BaseException as error:
            if isinstance(error, ActionError) and kind == frames.Kind.ACT:
                self._line.failed("invalid_action", str(error).rstrip("."))
            else:
                self._line.failed("crashed", described(error))

    def _ask_one_by_one(self, kind: int, body: memoryview) -> None:
        """Reset or ask one agent after the other, and answer row by row, so that one who never returns is known by its place."""
        setup, agents, line = self._setup, self._agents, self._line
        card, n = setup.card, setup.runs
        rows = np.flatnonzero(np.frombuffer(body[:n], dtype=np.uint8))
        observations = np.frombuffer(body[n:], dtype=np.float32).reshape(n, -1).copy() if kind == frames.Kind.ACT else None
        for row in rows.tolist():
            if observations is None:
                failure = guarded(lambda r=row: agents[r].reset(card, 1), setup.time.start, "reset", through=()).failure  # type: ignore[misc]
                action: NDArray[np.float64] = np.empty(0)
            else:
                observation = observations[row : row + 1]
                answer = guarded(lambda r=row, o=observation: agents[r].act(o)[0], setup.time.step, "act", through=())  # type: ignore[misc]
                failure, action = answer.failure, np.asarray(answer.value)
            if failure is not None:
                # It is not asked again. What it holds is the others' to have, and the time in which it lets go is its own.
                guarded(lambda r=row: let_go(agents, r), _LETTING_GO_SECONDS, "letting go", through=())  # type: ignore[misc]
                # The adapter counts its own runs, of which it has one here.
                reason = failure.reason.replace(" in run 0", "")
                line.answer(frames.Kind.ROW, frames.ROW.pack(row, frames.STATUSES.index(failure.status)), frames.encoded(reason))
            elif observations is not None and action.shape != (len(card.actions),):
                reason = action_problems([action], card, 1)[0]
                line.answer(frames.Kind.ROW, frames.ROW.pack(row, frames.STATUSES.index("invalid_action")), frames.encoded(reason))
            else:
                line.answer(frames.Kind.ROW, frames.ROW.pack(row, 0), action.tobytes())


def let_go(agents: list[Any], row: int) -> None:
    """Forget the agent of a run that has failed."""
    agents[row] = None
    gc.collect()


def described(error: BaseException) -> str:
    """The error in words; its kind alone where the words themselves fail, as they do without memory."""
    try:
        return in_words(error)
    except BaseException:
        return str(type.__getattribute__(type(error), "__name__"))


def enter_domain() -> bool:
    """Put this process and all that it starts into a domain of its own (Landlock), so that they cannot look into bubblewrap's.

    In a user namespace the first process of the sandbox, which is bubblewrap's, belongs to the same user as the agent. System calls to
    trace it are refused by the filter, but ``/proc/1/mem`` is a file. ``/proc`` is read-only, and the kernel lets no process of a Landlock
    domain look into one outside of it. False where the kernel has none. Needs ``no_new_privs``.
    """
    library = ctypes.CDLL(None, use_errno=True)
    forbidden = ctypes.c_uint64(_MAKE_DEVICES)
    ruleset: int = library.syscall(_CREATE_RULESET, ctypes.byref(forbidden), ctypes.c_size_t(ctypes.sizeof(forbidden)), 0)
    return ruleset >= 0 and library.syscall(_RESTRICT_SELF, ruleset, 0) == 0


class Listener:
    """Records connections and files opened for writing while it is active, for a check of the agent.

    Code that avoids Python's own calls is not heard. An audit hook cannot be taken away again: for processes that end with the agent.
    """

    def __init__(self) -> None:
        import tempfile  # here: only a check needs it

        self._addresses: list[str] = []
        self._network = False
        self.paths: list[str] = []
        self._on = False
        self._free = (str(Path(tempfile.gettempdir()).resolve()), "/tmp", "/dev/", "/proc/")
        sys.addaudithook(self._hear)

    @property
    def connections(self) -> list[str]:
        """Where it connected to, or wanted to."""
        return self._addresses or (["the network"] if self._network else [])

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Listen while the agent's code runs."""
        self._on = True
        try:
            yield
        finally:
            self._on = False

    def _hear(self, event: str, arguments: tuple[object, ...]) -> None:
        if not self._on:
            return
        if event in {"socket.connect", "socket.getaddrinfo"}:
            place: Any = arguments[0] if event == "socket.getaddrinfo" else arguments[1]
            in_parts = isinstance(place, tuple) and len(place) >= 2
            self._add(self._addresses, f"{place[0]}:{place[1]}" if in_parts else str(place))
        elif event == "socket.__new__" and arguments[1] in _NETWORK:
            self._network = True  # a sandbox refuses here, before any address is named
        elif event in _REMOVING or (event == "open" and isinstance(arguments[2], int) and arguments[2] & _WRITING):
            self._write(arguments[0])

    def _write(self, path: object) -> None:
        if isinstance(path, str | bytes | os.PathLike):
            file = Path(os.fsdecode(path))
            place = str(file)
            # Beside the agent's own /tmp nothing will be there to write to; a relative path may lead anywhere.
            if not file.is_absolute() or not place.startswith(self._free):
                self._add(self.paths, place)

    @staticmethod
    def _add(entries: list[str], what: str) -> None:
        if what not in entries and len(entries) < _MOST_HEARD:
            entries.append(what)


def main(descriptor: int, *, walls: bool) -> NoReturn:
    """Say hello and serve; ``walls``: in a sandbox, whose own process the agent must not look into."""
    if walls:
        enter_domain()
        os.closerange(3, descriptor)
        os.closerange(descriptor + 1, 1024)
    line = Line(socket.socket(fileno=descriptor))
    line.answer(frames.Kind.HELLO)
    host = Host(line)
    while True:
        host.do(*line.question())


if __name__ == "__main__":
    main(int(sys.argv[1]), walls=len(sys.argv) > 2)
