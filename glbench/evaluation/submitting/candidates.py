"""The agent that is checked, in a sandbox or in this process: made afresh, asked, watched."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from glbench.agents import Agent, Identity, load_agent
from glbench.agents.actions import read_actions
from glbench.errors import GlbenchError, SubmissionError
from glbench.evaluation.limits import Answer, Failure, TimeLimits, guarded
from glbench.evaluation.runners import AgentRunner
from glbench.evaluation.sandbox.frames import Kind, SandboxLimits
from glbench.evaluation.sandbox.listening import Listener
from glbench.evaluation.sandbox.process import LostError, Prints
from glbench.evaluation.sandbox.runners import SandboxedAgent, SandboxedBatch, SandboxedRuns
from glbench.evaluation.submitting.findings import peak, resident
from glbench.tasks import TaskCard

T = TypeVar("T")
Decided = tuple[NDArray[np.float64], dict[int, str]]
"""Actions, and by row what is wrong with them."""
_PACKAGES_SECONDS = 60.0


class Candidate(Protocol):
    """An agent under check."""

    def load(self, seconds: float) -> None:
        """Run its file, where that can be done apart from making it. Raises ``SubmissionError``, also for want of time."""

    def make(self, runs: int, seconds: float) -> Failure | None:
        """Make and reset a fresh agent for that many runs; why that fails."""

    def ask(self, shown: NDArray[np.float32], seconds: float) -> Answer[Decided]:
        """What it decides, of itself or because the time is over."""

    def memory(self) -> tuple[int, int]:
        """Bytes that it takes now, and the most it ever took."""

    def overheard(self) -> tuple[list[str], list[str]]:
        """Where it connected to, and what it wrote."""

    def printed(self) -> tuple[int, str]:
        """Bytes that it printed and the last line, as far as that is known here."""

    def close(self) -> None:
        """Let go of it."""


class LocalCandidate:
    """An agent in this process, with all rights that this process has."""

    def __init__(self, ref: str, card: TaskCard) -> None:
        self._ref, self._card = ref, card
        self._listener = Listener()
        self._agent: Agent | None = None

    def load(self, seconds: float) -> None:
        """Run its file; who started this process looks at the clock."""
        with self._listener.listening():
            load_agent(self._ref)

    def make(self, runs: int, seconds: float) -> Failure | None:
        """Run its file again and make an agent, as a new evaluation would."""

        def make() -> Agent:
            loaded = load_agent(self._ref)
            agent = loaded.make(self._card)
            agent.reset(self._card, runs)
            if not isinstance(agent, Agent):
                msg = f"{loaded.name} is a controller of glbench, not a submission"
                raise SubmissionError(msg)
            return agent

        answer = self._guarded(make, seconds, "make_agent and reset")
        self._agent = answer.value
        return answer.failure

    def ask(self, shown: NDArray[np.float32], seconds: float) -> Answer[Decided]:
        """Ask it."""
        agent = self._agent
        if agent is None:
            msg = "The agent was not made yet."
            raise GlbenchError(msg)
        return self._guarded(lambda: read_actions(agent.act(shown.copy()), self._card, len(shown)), seconds, "act")

    def memory(self) -> tuple[int, int]:
        """Memory of this process, simulation included."""
        return resident(), peak()

    def overheard(self) -> tuple[list[str], list[str]]:
        """What its Python code did."""
        return self._listener.connections, self._listener.written

    def printed(self) -> tuple[int, str]:
        """Nothing: what it prints goes wherever this process prints to."""
        return 0, ""

    def close(self) -> None:
        """Nothing to do."""

    def _guarded(self, call: Callable[[], T], seconds: float, what: str) -> Answer[T]:
        with self._listener.listening():
            return guarded(call, seconds, what)


class SandboxedCandidate:
    """An agent in the sandbox of an evaluation. All agents that are made live in one process there, each from the file run afresh."""

    def __init__(self, submission: Identity, card: TaskCard, limits: TimeLimits, packages: tuple[str, ...]) -> None:
        sizes = SandboxLimits()
        self._prints = Prints(sizes.printed)
        self._guest = SandboxedAgent(submission, card, 1, limits, sizes, self._prints)
        self._most = 0
        self._driver: AgentRunner | None = None
        self._process = self._guest.process()
        self._process.ask(Kind.REHEARSE, 0, "\0".join(packages).encode(), seconds=_PACKAGES_SECONDS)
        self._process.answer(0, time.monotonic() + _PACKAGES_SECONDS, "importing its packages takes too long")

    def load(self, seconds: float) -> None:
        """Run its file and make an agent, of which nothing more is asked."""
        self._made(1, seconds)

    def make(self, runs: int, seconds: float) -> Failure | None:
        """Run its file again and make an agent."""
        try:
            guest, single = self._made(runs, seconds)
        except SubmissionError as error:
            cause = error.__cause__
            return Failure(None, cause.status if isinstance(cause, LostError) else "crashed", str(error))
        self._driver = (SandboxedRuns if single else SandboxedBatch)(guest, self._process)
        return next(iter(self._driver.start()), None)

    def ask(self, shown: NDArray[np.float32], seconds: float) -> Answer[Decided]:
        """Ask it; its time was set when it was made."""
        if self._driver is None:
            msg = "The agent was not made yet."
            raise GlbenchError(msg)
        began = time.perf_counter()
        decision = self._driver.decide(0, shown, np.ones(len(shown), dtype=np.bool_))
        took = time.perf_counter() - began
        for failure in decision.failures:
            if failure.row is None or failure.status != "invalid_action":
                # Agents for single runs have one clock each; what the others took does not matter.
                return Answer(None, failure, took if failure.row is None else min(took, self._guest.time.step))
        wrong = {failure.row: failure.reason for failure in decision.failures if failure.row is not None}
        return Answer((decision.actions, wrong), None, took)

    def memory(self) -> tuple[int, int]:
        """Memory of all its processes."""
        now = self._process.memory()
        self._most = max(self._most, now)
        return now, self._most

    def overheard(self) -> tuple[list[str], list[str]]:
        """What it says itself, and nothing once its process has ended."""
        try:
            self._process.ask(Kind.HEARD, 0, seconds=1.0)
            _, body = self._process.answer(0, time.monotonic() + 1.0, "no answer")
        except LostError:
            return [], []
        lines = bytes(body).decode("utf-8", errors="replace").splitlines()
        told: dict[str, list[str]] = {"c": [], "w": []}
        for line in lines:
            told.get(line[:1], []).append(line[2:])
        return told["c"], told["w"]

    def printed(self) -> tuple[int, str]:
        """What came through its output."""
        return self._prints.size, next(iter(self._prints.last_lines(1)), "")

    def close(self) -> None:
        """End its process."""
        (self._driver or self._process).close()

    def _made(self, runs: int, seconds: float) -> tuple[SandboxedAgent, bool]:
        limits = self._guest.time
        start, step = min(limits.start, round(seconds, 1)), min(limits.step, round(seconds / runs, 1))
        hasty = TimeLimits(start=start, step=step, run=limits.run)
        guest = replace(self._guest, runs=runs, time=hasty)
        return guest, guest.made_in(self._process)
