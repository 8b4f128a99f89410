"""The process that runs a submission for a short while: ``python -m glbench.evaluation.submitting.probe``.

It lives apart from the command that started it, so that an agent outside of a sandbox may hang, exit or crash. What it finds goes line by
line, as JSON, to a pipe of its own.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import sys
import time
from contextlib import closing
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.agents import identify
from glbench.env import Simulation
from glbench.errors import GlbenchError, SubmissionError
from glbench.evaluation.limits import Answer, TimeLimits
from glbench.evaluation.sandbox.frames import MIB
from glbench.evaluation.sandbox.process import LostError
from glbench.evaluation.submitting import findings as words
from glbench.evaluation.submitting.candidates import Candidate, Decided, LocalCandidate, SandboxedCandidate
from glbench.evaluation.submitting.findings import MEMORY_LIMIT, Finding, Memory, address_space, problem
from glbench.tasks import TaskCard, TaskSpec, get_task, task_card

STEPS = 96
"""Steps of the short run: a day in steps of a quarter of an hour, with its night."""
RUNS = 4
_SHOWN = 160
_LEAST = 0.6
"""Share of the time that is the agent's, however long packages took to be imported."""
_SHARE_RUN, _SHARE_REPEAT, _SHARE_ALONE = 0.5, 0.4, 0.4
"""Shares of the time that is left, for the first run, its repetition, and each row alone."""


class Probe:
    """Runs one submission on one task and says what is wrong with it."""

    def __init__(self, candidate: Candidate, task: TaskSpec, card: TaskCard, deadline: float, channel: int) -> None:
        self._candidate, self._deadline, self._channel = candidate, deadline, channel
        self._task, self._card = task, card
        self._limits = TimeLimits.of_table(task.evaluation.time_limits)
        self._dialogue: list[tuple[NDArray[np.float32], NDArray[np.float64]]] = []
        self._memory = Memory()

    def run(self) -> None:
        """Look at everything, in the order in which things can go wrong."""
        try:
            if self._loaded() and self._made(RUNS):
                self._say(checked="loading")
                # Who does not repeat himself would be found to decide differently alone, too.
                if self._short_run() and self._repeat():
                    self._alone()
                self._say(checked="surroundings")
                self._find(*words.surroundings(*self._candidate.overheard()))
        except GlbenchError as error:
            self._find(problem("decisions", str(error)))
        self._say(stage="", printed=self._candidate.printed()[0])

    def _loaded(self) -> bool:
        self._say(stage="while its file was loaded")
        try:
            self._candidate.load(self._left())
        except SubmissionError as error:
            late = isinstance(error.__cause__, LostError) and error.__cause__.status == "timed_out"
            text = "It did not come back while its file was loaded: it hangs, or waits for something."
            self._find(problem("time", text) if late else problem("loading", str(error)))
            return False
        return True

    def _made(self, runs: int, *, again: bool = False) -> bool:
        """Make a fresh agent and reset it; false when that fails, which is told."""
        self._say(stage="in make_agent or reset")
        failure = self._candidate.make(runs, min(self._limits.start, self._left()))
        if failure is not None:
            when = " a second time" if again else ""
            reason = failure.reason.removeprefix("glbench.errors.SubmissionError: ")
            self._find(problem("loading", f"The agent cannot be made{when}: {reason.rstrip('.')}."))
        return failure is None

    def _ask(self, shown: NDArray[np.float32]) -> Answer[Decided]:
        return self._candidate.ask(shown, min(self._limits.step * len(shown), max(self._left(), 0.5)))

    def _short_run(self) -> bool:
        """Run a day in closed loop; false when it ends early, after which nothing can be compared."""
        self._say(stage="while the simulation was prepared")
        simulation = Simulation(self._task, RUNS)
        first, steps = self._task.evaluation.first_seed, min(STEPS, self._task.steps)
        observations = simulation.reset(range(first, first + RUNS))
        self._say(stage="in act")
        began, until = time.monotonic(), time.monotonic() + _SHARE_RUN * self._left()
        seconds = []
        for step in range(1, steps + 1):
            shown = observations.astype(np.float32)
            answer = self._ask(shown)
            actions = self._accepted(answer, step)
            if actions is None:
                return False
            self._dialogue.append((shown, actions))
            seconds.append(answer.seconds / RUNS)
            self._memory.add(*self._candidate.memory())
            outcome = simulation.step(actions)
            observations = outcome.observations
            if outcome.failed:
                text = f"Step {step} cannot be simulated with these actions: {outcome.failed[0].reason}."
                self._find(problem("decisions", text))
                return False
            if time.monotonic() > until:
                break
        self._measured(seconds)
        if len(seconds) < steps:
            self._find(words.unseen(len(seconds), steps, time.monotonic() - began))
        return True

    def _accepted(self, answer: Answer[Decided], step: int) -> NDArray[np.float64] | None:
        """The actions, or ``None`` after telling why they are none."""
        if answer.failure is not None and answer.failure.status == "timed_out":
            together = RUNS if answer.failure.row is None else 1
            self._find(words.no_answer(answer.seconds, together, step, self._task.steps, self._limits))
            return None
        self._say(checked="decisions")
        if answer.value is None:
            text = f"act fails in step {step}: {_why_not(answer)}.{self._last_words(answer)} The runs it decides for would end there."
            self._find(problem("decisions", text))
            return None
        actions, wrong = answer.value
        if wrong:
            row, reason = next(iter(wrong.items()))
            who = "every run" if len(wrong) == RUNS else f"run {row + 1} of {RUNS}"
            text = f"In step {step}, {who}: {reason}. The run would end there, and each missing step costs."
            self._find(problem("decisions", text))
            return None
        return actions

    def _last_words(self, answer: Answer[Decided]) -> str:
        """What a process that ended has printed last."""
        last = self._candidate.printed()[1] if answer.failure is not None and answer.failure.status == "crashed" else ""
        return f' Its last words: "{last[:_SHOWN]}"' if last else ""

    def _measured(self, seconds: list[float]) -> None:
        self._say(checked="time")
        each, steps, runs = sum(seconds) / len(seconds), self._task.steps, self._task.evaluation.runs
        whole = words.duration(each * steps * runs)
        self._say(fact={"time": f"{1e3 * each:.3g} ms a decision of one run; {whole} for {runs} runs of {steps} steps"})
        self._find(*words.times(each, max(seconds), steps, self._limits))
        self._say(checked="memory")
        among = " with the simulation" if isinstance(self._candidate, LocalCandidate) else ""
        taken = f"{self._memory.peak / MIB:,.0f} MiB{among}; limit {MEMORY_LIMIT / MIB:,.0f} MiB"
        self._say(fact={"memory": taken})
        self._find(*words.memory(self._memory.growth_a_step(), self._memory.last, steps))

    def _repeat(self) -> bool:
        """Show a fresh agent the same observations: it must decide the same, to the last bit."""
        if not self._made(RUNS, again=True):
            return False
        self._say(stage="in act, when the same observations were shown again", checked="repeatable")
        until = time.monotonic() + _SHARE_REPEAT * self._left()
        for step, (shown, before) in enumerate(self._dialogue, start=1):
            answer = self._ask(shown)
            if answer.value is None:
                self._find(words.unrepeatable(step, None, _why_not(answer)))
                return False
            if answer.value[0].tobytes() != before.tobytes():
                self._find(words.unrepeatable(step, float(np.abs(answer.value[0] - before).max()), ""))
                return False
            if time.monotonic() > until:
                break
        return True

    def _alone(self) -> None:
        """Show fresh agents single runs: what they decide must not depend on the company."""
        for row in (0, RUNS - 1):
            if not self._made(1, again=True):
                return
            self._say(stage="in act, with a single run", checked="rows")
            until = time.monotonic() + _SHARE_ALONE * self._left()
            for step, (shown, together) in enumerate(self._dialogue, start=1):
                answer = self._ask(shown[row : row + 1])
                if answer.value is None or answer.value[1]:
                    who = f"With one run instead of {RUNS} the agent"
                    text = f"{who} fails in step {step}: {_why_not(answer)}. So would `--runs 1`."
                    self._find(problem("rows", text))
                    return
                difference = float(np.abs(answer.value[0] - together[row : row + 1]).max())
                if difference > 0.0:
                    self._find(words.company(difference, step))
                    return
                if time.monotonic() > until:
                    break

    def _left(self) -> float:
        """Seconds until the whole check should be over."""
        return max(self._deadline - time.time(), 0.1)

    def _find(self, *findings: Finding) -> None:
        for finding in findings:
            self._say(finding=asdict(finding))

    def _say(self, **said: Any) -> None:
        _tell(self._channel, **said)


def _why_not(answer: Answer[Decided]) -> str:
    """Why an answer of ``act`` cannot be used."""
    if answer.failure is not None:
        return answer.failure.reason
    return (
        next(iter(answer.value[1].values())) if answer.value is not None and answer.value[1] else "it returned nothing"
    )


def main(arguments: list[str]) -> None:
    """``probe REF TASK SECONDS CHANNEL PROTECTION PACKAGE...``: time for the agent, number of an open file, what to import beforehand."""
    ref, task_ref, seconds, channel, protection, *packages = arguments
    began = time.time()
    task = get_task(task_ref)
    card = task_card(task)
    try:
        candidate = _candidate(ref, task, card, protection, tuple(packages))
    except GlbenchError as error:
        _tell(int(channel), stage="", finding=asdict(problem("loading", str(error))))
        return
    with closing(candidate):
        # Large packages take their time on a busy machine, which is not the agent's.
        deadline = max(began + float(seconds), time.time() + _LEAST * float(seconds))
        _tell(int(channel), deadline=deadline)
        Probe(candidate, task, card, deadline, int(channel)).run()


def _tell(channel: int, **said: Any) -> None:
    os.write(channel, (json.dumps(said) + "\n").encode())


def _candidate(ref: str, task: TaskSpec, card: TaskCard, protection: str, packages: tuple[str, ...]) -> Candidate:
    """The agent where it is to run, with the packages imported."""
    submission = identify(ref)
    if protection == "bubblewrap" and submission is not None:
        return SandboxedCandidate(submission, card, TimeLimits.of_table(task.evaluation.time_limits), packages)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT + address_space(), resource.RLIM_INFINITY))
    for package in packages:
        with contextlib.suppress(ImportError):  # told when the agent itself imports it
            importlib.import_module(package)
    return LocalCandidate(ref, card)


if __name__ == "__main__":
    main(sys.argv[1:])
