"""The process that runs a submission for a short while: ``python -m glbench.evaluation.submitting.probe``.

It lives apart from the command that started it, so that an agent may hang, exit or crash. What it finds goes line by line, as JSON, to a
pipe of its own; what the agent prints goes wherever its output goes and is counted there.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from glbench.agents import Agent, load_agent
from glbench.env import Simulation
from glbench.errors import GlbenchError, SubmissionError
from glbench.evaluation.acting import Answer, guarded
from glbench.evaluation.actions import read_actions
from glbench.evaluation.limits import TimeLimits
from glbench.evaluation.sandbox.limits import MIB
from glbench.evaluation.submitting import words
from glbench.evaluation.submitting.findings import Finding, problem
from glbench.evaluation.submitting.memory import MEMORY_LIMIT, Memory
from glbench.evaluation.submitting.surroundings import Listener
from glbench.tasks import get_task, task_card

if TYPE_CHECKING:
    from glbench.agents import LoadedAgent

STEPS = 96
"""Steps of the short run: a day in steps of a quarter of an hour, with its night."""
RUNS = 4
_LEAST = 0.6
"""Share of the time that is the agent's, however long packages took to be imported."""
_SHARE_RUN, _SHARE_REPEAT, _SHARE_ALONE = 0.5, 0.4, 0.4
"""Shares of the time that is left, for the first run, its repetition, and each row alone."""

T = TypeVar("T")
Decided = tuple[NDArray[np.float64], dict[int, str]]


class Probe:
    """Runs one submission on one task and says what is wrong with it."""

    def __init__(self, ref: str, task: str, deadline: float, channel: int) -> None:
        self._ref, self._deadline, self._channel = ref, deadline, channel
        self._task = get_task(task)
        self._card = task_card(self._task)
        self._limits = TimeLimits.of_table(self._task.evaluation.time_limits)
        self._dialogue: list[tuple[NDArray[np.float32], NDArray[np.float64]]] = []
        self._listener = Listener()
        self._memory = Memory()

    def run(self) -> None:
        """Look at everything, in the order in which things can go wrong."""
        try:
            loaded = self._loaded()
            agent = self._made(loaded, RUNS) if loaded is not None else None
            if loaded is not None and agent is not None:
                self._say(checked="loading")
                # Who does not repeat himself would be found to decide differently alone, too.
                if self._short_run(agent) and self._repeat(loaded):
                    self._alone(loaded)
                self._say(checked="surroundings")
                self._find(*words.surroundings(self._listener.connections, self._listener.written))
        except GlbenchError as error:
            self._find(problem("decisions", str(error)))
        self._say(stage="")

    def _loaded(self) -> LoadedAgent | None:
        self._say(stage="while its file was loaded")
        try:
            with self._listener.listening():
                return load_agent(self._ref)
        except SubmissionError as error:
            self._find(problem("loading", str(error)))
            return None

    def _made(self, loaded: LoadedAgent, runs: int, *, again: bool = False) -> Agent | None:
        """A fresh agent that was reset; ``None`` when that fails, which is told."""

        def make() -> Agent:
            agent = loaded.make(self._card)
            agent.reset(self._card, runs)
            if not isinstance(agent, Agent):
                msg = f"{loaded.name} is a controller of glbench, not a submission"
                raise SubmissionError(msg)
            return agent

        self._say(stage="in make_agent or reset")
        answer = self._guarded(make, min(self._limits.start, self._left()), "make_agent and reset")
        if answer.failure is not None:
            when = " a second time" if again else ""
            reason = answer.failure.reason.removeprefix("glbench.errors.SubmissionError: ")
            self._find(problem("loading", f"The agent cannot be made{when}: {reason.rstrip('.')}."))
        return answer.value

    def _ask(self, agent: Agent, shown: NDArray[np.float32]) -> Answer[Decided]:
        limit = min(self._limits.step * len(shown), max(self._left(), 0.5))
        return self._guarded(lambda: read_actions(agent.act(shown.copy()), self._card, len(shown)), limit, "act")

    def _short_run(self, agent: Agent) -> bool:
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
            answer = self._ask(agent, shown)
            actions = self._accepted(answer, step)
            if actions is None:
                return False
            self._dialogue.append((shown, actions))
            seconds.append(answer.seconds / RUNS)
            self._memory.look()
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
            self._find(words.no_answer(answer.seconds, RUNS, step, self._task.steps, self._limits))
            return None
        self._say(checked="decisions")
        if answer.value is None:
            text = f"act fails in step {step}: {_why_not(answer)}. The runs it decides for would end there."
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

    def _measured(self, seconds: list[float]) -> None:
        self._say(checked="time")
        each, steps, runs = sum(seconds) / len(seconds), self._task.steps, self._task.evaluation.runs
        whole = words.duration(each * steps * runs)
        self._say(fact={"time": f"{1e3 * each:.3g} ms a decision of one run; {whole} for {runs} runs of {steps} steps"})
        self._find(*words.times(each, max(seconds), steps, self._limits))
        self._say(checked="memory")
        taken = f"{self._memory.peak / MIB:,.0f} MiB with the simulation; limit {MEMORY_LIMIT / MIB:,.0f} MiB"
        self._say(fact={"memory": taken})
        self._find(*words.memory(self._memory.growth_a_step(), self._memory.last, steps))

    def _repeat(self, loaded: LoadedAgent) -> bool:
        """Show a fresh agent the same observations: it must decide the same, to the last bit."""
        agent = self._made(loaded, RUNS, again=True)
        if agent is None:
            return False
        self._say(stage="in act, when the same observations were shown again", checked="repeatable")
        until = time.monotonic() + _SHARE_REPEAT * self._left()
        for step, (shown, before) in enumerate(self._dialogue, start=1):
            answer = self._ask(agent, shown)
            if answer.value is None:
                self._find(words.unrepeatable(step, None, _why_not(answer)))
                return False
            if answer.value[0].tobytes() != before.tobytes():
                self._find(words.unrepeatable(step, float(np.abs(answer.value[0] - before).max()), ""))
                return False
            if time.monotonic() > until:
                break
        return True

    def _alone(self, loaded: LoadedAgent) -> None:
        """Show fresh agents single runs: what they decide must not depend on the company."""
        for row in (0, RUNS - 1):
            agent = self._made(loaded, 1, again=True)
            if agent is None:
                return
            self._say(stage="in act, with a single run", checked="rows")
            until = time.monotonic() + _SHARE_ALONE * self._left()
            for step, (shown, together) in enumerate(self._dialogue, start=1):
                answer = self._ask(agent, shown[row : row + 1])
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

    def _guarded(self, call: Callable[[], T], seconds: float, what: str) -> Answer[T]:
        with self._listener.listening():
            return guarded(call, seconds, what)

    def _left(self) -> float:
        """Seconds until the whole check should be over."""
        return max(self._deadline - time.time(), 0.1)

    def _find(self, *findings: Finding) -> None:
        for finding in findings:
            self._say(finding=asdict(finding))

    def _say(self, **said: Any) -> None:
        os.write(self._channel, (json.dumps(said) + "\n").encode())


def _why_not(answer: Answer[Decided]) -> str:
    """Why an answer of ``act`` cannot be used."""
    if answer.failure is not None:
        return answer.failure.reason
    return (
        next(iter(answer.value[1].values())) if answer.value is not None and answer.value[1] else "it returned nothing"
    )


def main(arguments: list[str]) -> None:
    """``probe REF TASK SECONDS CHANNEL PACKAGE...``: time for the agent, number of an open file, what to import beforehand."""
    ref, task, seconds, channel, *packages = arguments
    began = time.time()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT + Memory.own(), resource.RLIM_INFINITY))
    for package in packages:
        with contextlib.suppress(ImportError):  # told when the agent itself imports it
            importlib.import_module(package)
    # Large packages take their time on a busy machine, which is not the agent's.
    deadline = max(began + float(seconds), time.time() + _LEAST * float(seconds))
    os.write(int(channel), (json.dumps({"deadline": deadline}) + "\n").encode())
    Probe(ref, task, deadline, int(channel)).run()


if __name__ == "__main__":
    main(sys.argv[1:])
