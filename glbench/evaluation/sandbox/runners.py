"""Runners of agents in a sandbox. Of the answers of the agent's process nothing is believed but the wording of complaints."""

from __future__ import annotations

import contextlib
import pickle
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, cast

import numpy as np
from numpy.typing import NDArray

from glbench.agents import Identity
from glbench.arrays import Floats
from glbench.errors import SubmissionError
from glbench.evaluation.limits import Failure, TimeLimits
from glbench.evaluation.runners import AgentRunner, Decision, Inputs, Mask, invalid_actions
from glbench.evaluation.sandbox import frames
from glbench.evaluation.sandbox.process import AgentProcess, LostError
from glbench.evaluation.sandbox.visible import place_inside
from glbench.kernel import built_libraries
from glbench.tasks import TaskCard, TaskSpec, task_card
from glbench.tasks.card import public_definition

_LONGEST_REASON = 640
_ERROR: Final = re.compile(r'(File ".*", line \d+ .*)?[\w.<>]+(: .*|\Z| \([^()]*:\d+ in [^()]*\)\Z)')
"""How an error of Python begins: its name alone, with words behind a colon, or with a place; reasons of the evaluation never do."""
_MOST_LINES = 8
_PLANNERS: Final = b"glbench.control"  # What a submission imports that needs the compiled derivatives of the model


@dataclass(frozen=True)
class SandboxedAgent:
    """All that is needed to start the process of an agent; without ``walls`` it has all rights of the user.

    ``definition`` is the task's as its agents may know it, ``libraries`` the compiled kernels that the process sees, by name.
    """

    submission: Identity
    card: TaskCard
    runs: int
    time: TimeLimits
    sizes: frames.SandboxLimits
    prints: frames.Prints
    walls: bool = True
    definition: str = ""
    libraries: Mapping[str, Path] = field(default_factory=dict)

    @staticmethod
    def of(
        submission: Identity,
        task: TaskSpec,
        runs: int,
        time: TimeLimits,
        sizes: frames.SandboxLimits,
        prints: frames.Prints,
        *,
        walls: bool = True,
    ) -> SandboxedAgent:
        """A submission for ``runs`` runs of ``task``."""
        from glbench.control.stage import judged_at_the_end  # not at the top: only agents plan

        # Those who plan leave out the meters of violations (docs/control.md), which makes it another model.
        tasks = (task, judged_at_the_end(task)) if walls else ()
        plans = any(_PLANNERS in file.read_bytes() for file in submission.all_files() if file.suffix == ".py")
        libraries = dict[str, Path]()
        for one in tasks:
            libraries |= built_libraries(one.model_value, one.parameters(), for_plans=plans)
        definition = public_definition(task)
        return SandboxedAgent(submission, task_card(task), runs, time, sizes, prints, walls, definition, libraries)

    def started(self) -> tuple[AgentProcess, bool]:
        """A process with the agent made, and whether it is one agent a run.

        Raises ``SubmissionError`` when the agent cannot be made, and ``SandboxError`` when the sandbox does not start.
        """
        process = self.process()
        try:
            return process, self.made_in(process)
        except BaseException:
            process.close()
            raise

    def process(self) -> AgentProcess:
        """A process with nothing in it yet. Raises ``SandboxError`` when the sandbox does not start."""
        n, m = self.runs, len(self.card.actions)
        longest = n * (8 * m + frames.ROW.size + frames.LONGEST_TEXT)
        return AgentProcess(self.submission, self.sizes, self.prints, longest, walls=self.walls, libraries=self.libraries)

    def made_in(self, process: AgentProcess) -> bool:
        """Load the submission in ``process`` and make the agent; whether it is one a run. Raises ``SubmissionError`` when that fails."""
        limit = self.time.start
        until = time.monotonic() + limit
        place = place_inside(self.submission) if self.walls else self.submission.path
        setup = frames.AgentSetup(str(place), self.card, self.runs, self.time, self.sizes, self.definition)
        doing = "loading it"
        try:
            process.ask(frames.Kind.LOAD, 0, pickle.dumps(setup), seconds=limit)
            kind, body = process.answer(0, until, f"{doing} took longer than its limit of {limit:g} s")
            if kind == frames.Kind.LOADED:
                doing = "make_agent"
                kind, body = process.answer(0, until, f"{doing} took longer than its limit of {limit:g} s")
            if kind == frames.Kind.FAILED and len(body) > 1:
                raise SubmissionError(words(body[1:], len(body)))
            if kind != frames.Kind.MADE or len(body) != 1:
                process.refuse(f"a frame of kind {kind} where an agent was to be made")
        except LostError as lost:
            output = "".join(f"\n  {line}" for line in self.prints.last_lines(_MOST_LINES))
            msg = f"The agent '{self.submission.name}' cannot be made: {lost.reason}." + (f" It printed:{output}" if output else "")
            raise SubmissionError(msg) from lost
        return bool(body[0])


def sandboxed_runner(agent: SandboxedAgent) -> AgentRunner:
    """The agent in its sandbox, ready for a reset. Raises ``SubmissionError`` when it cannot be made, ``SandboxError`` without one."""
    process, single = agent.started()
    return in_process(agent, process, single=single)


def in_process(agent: SandboxedAgent, process: AgentProcess, *, single: bool) -> AgentRunner:
    """The harness of an agent that was made in ``process``; ``single``: one agent a run."""
    return SandboxedRuns(agent, process) if single else SandboxedBatch(agent, process)


class SandboxedBatch(AgentRunner):
    """One agent that decides for all runs at once."""

    def __init__(self, agent: SandboxedAgent, process: AgentProcess) -> None:
        super().__init__(agent.card, agent.runs, agent.time)
        self._process, self._number = process, 0
        self._asked_at: float | None = None  # of the question that waits for its answer

    def start(self) -> tuple[Failure, ...]:
        """Reset the agent."""
        limit = self.limits.start
        try:
            until = time.monotonic() + limit
            self._send(frames.Kind.RESET, (bytes([1]) * self.n,), limit)
            kind, body = self._answer(until, limit, "reset")
            if kind == frames.Kind.FAILED:
                return (self._failure(body),)
            if kind != frames.Kind.DONE:
                self._process.refuse(f"a frame of kind {kind} to a reset")
        except LostError as lost:
            return (Failure(None, lost.status, lost.reason),)
        return ()

    def ask(self, step: int, inputs: Inputs, alive: Mask) -> None:
        """Send the observations; the answer is waited for in ``decide``."""
        parts = (alive.tobytes(), inputs.astype(np.float32, copy=False).tobytes())
        self._asked_at = time.monotonic()
        with contextlib.suppress(LostError):  # raised again when the answer is waited for
            self._send(frames.Kind.ACT, parts, self.limits.step * int(np.count_nonzero(alive)))

    def _decided(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        if self._asked_at is None:
            self.ask(step, inputs, alive)
        began, self._asked_at = cast(float, self._asked_at), None
        deciding = int(np.count_nonzero(alive))
        limit = self.limits.step * deciding
        actions: Floats = np.zeros(self.shape)
        failures: tuple[Failure, ...]
        try:
            kind, body = self._answer(began + limit, limit, "act (for all runs)")
            actions, failures = self._read(kind, body, alive)
        except LostError as lost:
            failures = (Failure(None, lost.status, lost.reason),)
        seconds: Floats = np.where(alive, (time.monotonic() - began) / deciding, 0.0)
        return Decision(actions, failures, seconds)

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _send(self, kind: frames.Kind, parts: tuple[bytes, ...], seconds: float) -> None:
        self._number += 1
        self._process.ask(kind, self._number, *parts, seconds=seconds)

    def _answer(self, until: float, seconds: float, what: str) -> tuple[int, memoryview]:
        return self._process.answer(self._number, until, f"{what} took longer than its limit of {seconds:g} s")

    def _read(self, kind: int, body: memoryview, alive: Mask) -> tuple[Floats, tuple[Failure, ...]]:
        """Actions and failures out of an answer, of which nothing is believed but the wording of complaints."""
        n, m = self.shape
        if kind == frames.Kind.FAILED:
            return np.zeros(self.shape), (self._failure(body),)
        size = 8 * n * m
        if (kind != frames.Kind.ACTIONS or len(body) != size) and (kind != frames.Kind.PROBLEMS or len(body) < size):
            self._process.refuse(f"a frame of kind {kind} with {len(body):,} bytes to a question for {n} x {m} actions")
        actions = np.frombuffer(body[:size], dtype=np.float64).reshape(n, m).copy()
        try:
            reasons = {row: words(text, _LONGEST_REASON) for row, text in frames.unpacked_problems(bytes(body[size:]))}
        except ValueError:
            self._process.refuse("a list of problems that cannot be read")
        problems = {row: reason for row, reason in reasons.items() if row < n}
        actions[list(problems)] = 0.0
        return actions, invalid_actions(problems, alive)

    def _failure(self, body: memoryview) -> Failure:
        if len(body) < 2 or not 1 <= body[0] < len(frames.STATUSES):
            self._process.refuse("a failure without a reason")
        if frames.STATUSES[body[0]] == "timed_out":
            self._process.refuse("a timeout, which is not for it to find")
        return told_failure(None, body[0], body[1:])


@dataclass(frozen=True)
class _Exchange:
    """A question to agents for single runs, whom it was put to, and what they decided."""

    kind: frames.Kind
    inputs: Inputs | None
    rows_asked: Mask
    actions: Floats


class SandboxedRuns(AgentRunner):
    """One agent a run, all in one process: what ends the process ends the run that was being asked."""

    one_by_one = True

    def __init__(self, agent: SandboxedAgent, process: AgentProcess) -> None:
        super().__init__(agent.card, agent.runs, agent.time)
        self._agent, self._process, self._number = agent, process, 0
        self._past: list[_Exchange] = []
        self._repeating_seconds = 0.0

    def start(self) -> tuple[Failure, ...]:
        """Reset the agents."""
        return self._ask_rows(frames.Kind.RESET, None, np.ones(self.n, dtype=np.bool_)).failures

    def _decided(self, step: int, inputs: Inputs, alive: Mask) -> Decision:
        return self._ask_rows(frames.Kind.ACT, inputs.astype(np.float32, copy=False), alive)

    def close(self) -> None:
        """End the process."""
        self._process.close()

    def _ask_rows(self, kind: frames.Kind, inputs: Inputs | None, alive: Mask) -> Decision:
        """Ask the rows that are alive, one after the other, again in a new process where one of them ends it."""
        rows_asked, lost_rows = alive.copy(), dict[int, Failure]()
        while True:
            actions, seconds = np.zeros(self.shape), np.zeros(self.n)
            failures = dict[int, Failure]()
            lost = self._exchange(kind, inputs, rows_asked, actions, seconds, failures)
            if lost is None:
                break
            row, why = lost
            lost_rows[row] = Failure(row, why.status, why.reason)
            rows_asked[row] = False
            for failure in self._bring_back(rows_asked):
                rows_asked[failure.row], lost_rows[failure.row] = False, failure  # type: ignore[index]
            if not rows_asked.any():
                break
        self._past.append(_Exchange(kind, inputs, rows_asked, actions))
        return Decision(actions, (*lost_rows.values(), *failures.values()), seconds)

    def _exchange(
        self, kind: frames.Kind, inputs: Inputs | None, rows_asked: Mask, actions: Floats, seconds: Floats, failures: dict[int, Failure]
    ) -> tuple[int, LostError] | None:
        """Ask the rows in ``asked`` and fill in what they say; the row at which the process was lost, and why, if it was."""
        self._number += 1
        limits = self.limits
        limit, what = (limits.step, "act") if kind == frames.Kind.ACT else (limits.start, "reset")
        # The process looks at its own clock and ends a slow call alone; past these seconds it does not, and is ended.
        patience = limit + max(0.5, 0.05 * limit)
        late = f"{what} took longer than its limit of {limit:g} s"
        timeouts = 0
        rows = np.flatnonzero(rows_asked).tolist()
        row = rows[0]
        try:
            parts = (rows_asked.tobytes(), inputs.tobytes() if inputs is not None else b"")
            asked_at = time.perf_counter()
            self._process.ask(kind, self._number, *parts, seconds=patience)
            for row in rows:
                began = time.perf_counter()
                answer, body = self._process.answer(self._number, time.monotonic() + patience, late)
                failure = self._read_row(answer, body, row, actions if kind == frames.Kind.ACT else None)
                seconds[row] = time.perf_counter() - began
                if failure is not None and failure.status == "timed_out":
                    # Which call took the time, the process says; that the time has passed, only the clock here.
                    timeouts += 1
                    if time.perf_counter() - asked_at < timeouts * limit:
                        self._process.refuse(f"that run {row} took longer than {limit:g} s, which it did not")
                    failure = Failure(row, "timed_out", late)
                if failure is not None:
                    failures[row] = failure
        except LostError as lost:
            return row, lost
        return None

    def _read_row(self, kind: int, body: memoryview, row: int, actions: Floats | None) -> Failure | None:
        row_in_frame, status = frames.ROW.unpack_from(body) if kind == frames.Kind.ROW and len(body) >= frames.ROW.size else (-1, -1)
        rest = body[frames.ROW.size :]
        if row_in_frame != row or not 0 <= status < len(frames.STATUSES):
            self._process.refuse(f"a frame of kind {kind} with {len(body):,} bytes, when run {row} was asked")
        if status:
            return told_failure(row, status, rest)
        if len(rest) != (8 * self.shape[1] if actions is not None else 0):
            self._process.refuse(f"{len(rest):,} bytes for {self.shape[1]} actions of run {row}")
        if actions is not None:
            actions[row] = np.frombuffer(rest, dtype=np.float64)
        return None

    def _bring_back(self, needed: Mask) -> list[Failure]:
        """Start a new process and show the agents what they had seen; the rows out of ``needed`` that cannot go on."""
        if not needed.any():
            return []
        began = time.monotonic()
        try:
            self._process, _ = self._agent.started()
            differing = self._repeat(needed, began)
        except (SubmissionError, LostError) as error:
            return self._all(needed, f"{error} (when it was started again after another run had ended its process)")
        finally:
            self._repeating_seconds += time.monotonic() - began
        reason = "another run ended the process of the agent, and shown the same observations again in a new one it decided differently"
        return [Failure(row, "crashed", reason) for row in differing]

    def _repeat(self, needed: Mask, began: float) -> list[int]:
        differing = np.zeros(self.n, dtype=np.bool_)
        limit = self.limits.run
        for exchange in self._past:
            if self._repeating_seconds + time.monotonic() - began > limit:
                reason = f"bringing the agent back took longer than {limit:g} s"
                raise LostError(status="timed_out", reason=reason)
            if not exchange.rows_asked.any():
                continue
            actions: Floats = np.zeros(self.shape)
            ignored: NDArray[np.float64] = np.zeros(self.n)
            lost = self._exchange(exchange.kind, exchange.inputs, exchange.rows_asked, actions, ignored, {})
            if lost is not None:
                raise lost[1]
            differing |= (actions.view(np.uint64) != exchange.actions.view(np.uint64)).any(axis=1)
        return np.flatnonzero(differing & needed).tolist()

    @staticmethod
    def _all(needed: Mask, reason: str) -> list[Failure]:
        short = reason if len(reason) <= _LONGEST_REASON else reason[: _LONGEST_REASON - 4] + " ..."
        return [Failure(row, "crashed", short) for row in np.flatnonzero(needed).tolist()]


def told_failure(row: int | None, status: int, text: memoryview) -> Failure:
    """A failure as the agent's process tells it. What does not read like an error of Python is marked as its own words."""
    reason = words(text, _LONGEST_REASON)
    if frames.STATUSES[status] == "crashed" and not _ERROR.match(reason):
        reason = f"the agent's process said: {reason}"
    return Failure(row, frames.STATUSES[status], reason)  # type: ignore[arg-type]


def words(text: bytes | memoryview, longest: int) -> str:
    """A text of the agent's process as it may stand in a result: one line, printable, not empty, not too long."""
    printable = " ".join(frames.plain(bytes(text).decode("utf-8", errors="replace")).split()) or "nothing that can be shown"
    return printable if len(printable) <= longest else printable[: longest - 4] + " ..."
