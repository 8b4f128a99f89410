"""Inside the sandbox: the process that loads an agent, shows it observations and sends its actions.

It is started as a script with the number of its socket and the version of glbench. Until it loads the submission everything here can
be trusted; from then on nothing can, and whoever reads the answers knows that.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import pickle
import resource
import socket
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NoReturn

if __name__ == "__main__":
    # The package without what its __init__ does: there are no tasks here to register, and Gymnasium takes its time to load.
    _package = ModuleType("glbench")
    _package.__path__ = [str(Path(__file__).parents[2])]
    _package.__dict__["__version__"] = sys.argv[2]
    sys.modules["glbench"] = _package

import numpy as np
from numpy.typing import NDArray

from glbench.agents.actions import action_problems, read_actions
from glbench.agents.loading import load_agent
from glbench.agents.protocol import PerRunAgent
from glbench.errors import ActionError, SubmissionError
from glbench.evaluation.limits import guarded, in_words
from glbench.evaluation.sandbox.domain import enter_domain
from glbench.evaluation.sandbox.frames import (
    HEADER,
    ROW,
    STATUSES,
    Kind,
    Order,
    SandboxLimits,
    encoded,
    packed_problems,
)

if TYPE_CHECKING:
    from glbench.agents.protocol import Agent
    from glbench.evaluation.sandbox.listening import Listener

_NOBODY_ASKS_ANY_MORE = 0
_LETTING_GO_SECONDS = 0.25
"""Less than the patience of who asked, on top of a call that took all of its time."""


class Line:
    """The guest's end of the socket; one question at a time."""

    def __init__(self, sock: socket.socket) -> None:
        self._sock = sock
        self._buffer = memoryview(bytearray(1 << 16))
        self._number = 0

    def question(self) -> tuple[int, memoryview]:
        """Kind and body of the next question; leaves the process when nobody asks any more. The body is valid until the next call."""
        got = self._receive(0, HEADER.size)
        kind, self._number, length = HEADER.unpack_from(self._buffer)
        whole = HEADER.size + length
        if whole > len(self._buffer):
            larger = memoryview(bytearray(whole))
            larger[:got] = self._buffer[:got]
            self._buffer = larger
        self._receive(got, whole)
        return kind, self._buffer[HEADER.size : whole]

    def answer(self, kind: Kind, *parts: bytes) -> None:
        """Answer the question that was asked last."""
        body = b"".join(parts)
        self._sock.sendall(HEADER.pack(kind, self._number, len(body)) + body)

    def failed(self, status: str, reason: str) -> None:
        """Answer that the call failed for all rows."""
        self.answer(Kind.FAILED, bytes([STATUSES.index(status)]), encoded(reason))

    def _receive(self, got: int, enough: int) -> int:
        while got < enough:
            more = self._sock.recv_into(self._buffer[got:])
            if more == 0:
                os._exit(_NOBODY_ASKS_ANY_MORE)
            got += more
        return got


def limit_this_process(sizes: SandboxLimits) -> None:
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
        self._order: Order
        self._listener: Listener | None = None

    def do(self, kind: int, body: memoryview) -> None:
        """Answer a question."""
        if kind == Kind.REHEARSE:
            self._listener = rehearse(bytes(body).decode())
            self._line.answer(Kind.DONE)
        elif kind == Kind.HEARD and self._listener is not None:
            heard = [f"c {where}" for where in self._listener.connections] + [
                f"w {what}" for what in self._listener.written
            ]
            self._line.answer(Kind.TOLD, encoded("\n".join(heard)))
        elif self._listener is not None:
            with self._listener.listening():
                self._ask_agent(kind, body)
        else:
            self._ask_agent(kind, body)

    def _ask_agent(self, kind: int, body: memoryview) -> None:
        line = self._line
        if kind == Kind.LOAD:
            order = self._order = pickle.loads(body)
            limit_this_process(order.sizes)
            self._agents = make_agents(line, order)
            self._single = bool(self._agents) and isinstance(self._agents[0], PerRunAgent)
            if self._agents:
                line.answer(Kind.MADE, bytes([self._single]))
        elif self._single:
            answer_by_row(line, self._order, self._agents, kind, body)
        elif kind == Kind.RESET:
            reset(line, self._order, self._agents[0])
        else:
            act(line, self._order, self._agents[0], body)


def rehearse(packages: str) -> Listener:
    """Import packages whose time is not the agent's, and begin to listen."""
    from glbench.evaluation.sandbox.listening import Listener

    for package in filter(None, packages.split("\0")):
        with contextlib.suppress(ImportError):  # told when the agent itself imports it
            importlib.import_module(package)
    return Listener()


def make_agents(line: Line, order: Order) -> list[Any]:
    """The agent, or one adapter with its agent for each run; none when it failed, which is answered."""
    try:
        loaded = load_agent(Path(order.path))
        line.answer(Kind.LOADED)
        first = loaded.make(order.card)
        others = order.runs - 1 if isinstance(first, PerRunAgent) else 0
        return [first, *(loaded.make(order.card) for _ in range(others))]
    except SubmissionError as error:
        line.failed("crashed", str(error))
    except BaseException as error:  # the submission's code may raise anything; it is told, not swallowed
        line.failed("crashed", f"The agent '{Path(order.path).stem}' cannot be made: {described(error)}.")
    return []


def reset(line: Line, order: Order, agent: Agent) -> None:
    """Reset a batched agent."""
    try:
        agent.reset(order.card, order.runs)
    except BaseException as error:
        line.failed("crashed", described(error))
    else:
        line.answer(Kind.DONE)


def act(line: Line, order: Order, agent: Agent, body: memoryview) -> None:
    """Ask a batched agent for all rows."""
    card, n = order.card, order.runs
    observations = np.frombuffer(body[n:], dtype=np.float32).reshape(n, -1).copy()
    try:
        returned: object = agent.act(observations)
        actions = _plain(returned, (n, len(card.actions)))
        if actions is not None:
            line.answer(Kind.ACTIONS, actions.tobytes())
            return
        actions, problems = read_actions(returned, card, n)
        line.answer(Kind.PROBLEMS, actions.tobytes(), packed_problems(problems))
    except ActionError as error:
        line.failed("invalid_action", str(error).rstrip("."))
    except BaseException as error:
        line.failed("crashed", described(error))


def answer_by_row(line: Line, order: Order, agents: list[Any], kind: int, body: memoryview) -> None:
    """Reset or ask one agent after the other, and answer row by row, so that one who never returns is known by its place."""
    card, n = order.card, order.runs
    rows = np.flatnonzero(np.frombuffer(body[:n], dtype=np.uint8))
    observations = np.frombuffer(body[n:], dtype=np.float32).reshape(n, -1).copy() if kind == Kind.ACT else None
    for row in rows.tolist():
        if observations is None:
            failure = guarded(lambda r=row: agents[r].reset(card, 1), order.time.start, "reset", through=()).failure  # type: ignore[misc]
            given: NDArray[np.float64] = np.empty(0)
        else:
            shown = observations[row : row + 1]
            answer = guarded(lambda r=row, o=shown: agents[r].act(o)[0], order.time.step, "act", through=())  # type: ignore[misc]
            failure, given = answer.failure, np.asarray(answer.value)
        if failure is not None:
            # It is not asked again. What it holds is the others' to have, and the time in which it lets go is its own.
            guarded(lambda r=row: let_go(agents, r), _LETTING_GO_SECONDS, "letting go", through=())  # type: ignore[misc]
            # The adapter counts its own runs, of which it has one here.
            reason = failure.reason.replace(" in run 0", "")
            line.answer(Kind.ROW, ROW.pack(row, STATUSES.index(failure.status)), encoded(reason))
        elif observations is not None and given.shape != (len(card.actions),):
            reason = action_problems([given], card, 1)[0]
            line.answer(Kind.ROW, ROW.pack(row, STATUSES.index("invalid_action")), encoded(reason))
        else:
            line.answer(Kind.ROW, ROW.pack(row, 0), given.tobytes())


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


def _plain(returned: object, shape: tuple[int, int]) -> NDArray[np.float64] | None:
    """What ``act`` returned, when it is an array of numbers of the right shape; the other side looks at the values."""
    if isinstance(returned, np.ndarray) and returned.dtype.kind in "fiu" and returned.shape == shape:
        return np.ascontiguousarray(returned, dtype=np.float64)
    return None


def main(descriptor: int) -> NoReturn:
    """Say hello and serve."""
    enter_domain()
    os.closerange(3, descriptor)
    os.closerange(descriptor + 1, 1024)
    line = Line(socket.socket(fileno=descriptor))
    line.answer(Kind.HELLO)
    host = Host(line)
    while True:
        host.do(*line.question())


if __name__ == "__main__":
    main(int(sys.argv[1]))
