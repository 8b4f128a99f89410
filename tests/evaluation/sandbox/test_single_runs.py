"""Agents for single runs share a process, and what one of them does to it ends its own run only."""

from __future__ import annotations

import dataclasses

import pytest

from glbench.evaluation import TimeLimits, evaluate
from glbench.evaluation.sandbox.frames import GIB, SandboxLimits
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import AgentWriter
from tests.evaluation.sandbox.conftest import Prepare, ends

AGENT = """
def reset(self, task):
    Agent.made = getattr(Agent, "made", 0) + 1
    self.number, self.calls, self.total = Agent.made, 0, 0.0
def act(self, observation):
    self.calls += 1
    self.total += float(observation[0])
    if {when}: {deed}
    return np.full(6, np.cos(self.total))
"""
LIMITS = TimeLimits(start=120.0, step=2.0, run=600.0)


def agent(when: str, deed: str) -> str:
    return AGENT.format(when=when, deed=deed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("deed", "status", "words"),
    [
        ("os._exit(7)", "crashed", "the agent's process ended with exit code 7"),
        ("import ctypes; ctypes.string_at(0)", "crashed", "the agent's process ended by the signal SIGSEGV"),
        ("sum(range(10**18))", "timed_out", "act took longer than its limit of 2 s"),
        ("import signal; signal.pause()", "timed_out", "act took longer than its limit of 2 s"),
        (  # says all the time that it goes on after a stop
            "import os, signal; any(os.kill(os.getpid(), signal.SIGCONT) for _ in iter(int, 1))",
            "timed_out",
            "act took longer than its limit of 2 s",
        ),
    ],
)
def test_who_ends_the_process_ends_alone_and_the_others_go_on_with_the_same_bits(
    day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare, deed: str, status: str, words: str
) -> None:
    clean = evaluate(day_task, write_agent(agent("False", "pass"), single=True))
    result = sandboxed(write_agent(agent("(self.number, self.calls) == (2, 9)", deed), single=True), limits=LIMITS).run()

    assert ends(result) == [("ok", 24), (status, 8), ("ok", 24)]
    assert result.runs[1].reason == words
    assert (result.runs[0], result.runs[2]) == (clean.runs[0], clean.runs[2])


@pytest.mark.parametrize(
    ("deed", "words"),
    [
        (
            "import gc, socket, struct; body = struct.pack('=II', 1, 2) + b'late'; "
            "fd = next(thing for thing in gc.get_objects() if isinstance(thing, socket.socket)).fileno(); "
            "os.write(fd, struct.pack('=IIQ', 22, self.calls + 1, len(body)) + body)",
            "sent what is no answer: that run 1 took longer than 2 s, which it did not",
        ),
        ("import signal; signal.raise_signal(signal.SIGALRM)", "TimeUp (agent_under_test.py"),
    ],
)
def test_a_timeout_is_not_for_the_agent_to_find(write_agent: AgentWriter, sandboxed: Prepare, deed: str, words: str) -> None:
    result = sandboxed(write_agent(agent("(self.number, self.calls) == (2, 9)", deed), single=True), limits=LIMITS).run()

    assert ends(result) == [("ok", 24), ("crashed", 8), ("ok", 24)]
    assert words in (result.runs[1].reason or "")


def test_one_after_the_other_ends_the_process(day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare) -> None:
    clean = evaluate(day_task, write_agent(agent("False", "pass"), single=True), runs=5)
    result = sandboxed(write_agent(agent("self.number < 5 and self.calls == 3 * self.number", "os._exit(1)"), single=True), runs=5).run()

    assert ends(result) == [("crashed", 2), ("crashed", 5), ("crashed", 8), ("crashed", 11), ("ok", 24)]
    assert result.runs[4] == clean.runs[4]


def test_all_end_the_process_in_one_step(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    result = sandboxed(write_agent(agent("self.calls == 3", "os._exit(1)"), single=True)).run()

    assert ends(result) == [("crashed", 2)] * 3


def test_one_ends_the_process_while_it_is_reset(day_task: TaskSpec, write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = AGENT.replace("Agent.made, 0, 0.0", "Agent.made, 0, 0.0\n    if self.number == 2: os._exit(1)")
    clean = evaluate(day_task, write_agent(agent("False", "pass"), single=True))
    # Its own instance of the second run is reset first again in the new process, and is the second there, too.
    result = sandboxed(write_agent(body.format(when="False", deed="pass").replace("Agent.made =", "Agent.made ="), single=True)).run()

    assert result.runs[0] == clean.runs[0]
    assert result.runs[1].status == "crashed"
    assert result.runs[1].steps == 0


def test_an_agent_that_does_not_repeat_itself_cannot_be_brought_back(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = agent("(self.number, self.calls) == (2, 9)", "os._exit(7)")
    body = body.replace("np.cos(self.total)", "np.cos(self.total) if self.number == 3 else time.time() % 1")
    result = sandboxed(write_agent(body, single=True)).run()

    assert ends(result) == [("crashed", 8), ("crashed", 8), ("ok", 24)]
    assert "shown the same observations again in a new one it decided differently" in (result.runs[0].reason or "")


def test_an_interrupted_evaluation_with_a_lost_process_goes_on(
    write_agent: AgentWriter, sandboxed: Prepare, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = write_agent(agent("(self.number, self.calls) == (2, 5)", "os._exit(7)"), single=True)
    out = tmp_path_factory.mktemp("reports")

    def stop(standing: object) -> None:
        if getattr(standing, "step", 0) == 11 and not getattr(standing, "replaying", True):
            raise InterruptedError

    with pytest.raises(InterruptedError):
        sandboxed(path, out=out, checkpoint_seconds=0.0).run(stop)
    resumed = sandboxed(path, out=out).run()

    assert resumed.evaluation.resumed_at_step == 11
    assert resumed.runs == sandboxed(path).run().runs
    assert ends(resumed) == [("ok", 24), ("crashed", 4), ("ok", 24)]


LEAKING = """
def reset(self, task):
    Agent.made = getattr(Agent, "made", 0) + 1
    self.number, self.calls, self.kept, self.me = Agent.made, 0, [], self
def act(self, observation):
    self.calls += 1
    if self.number == 2: self.kept.append(np.ones(4 << 20))
    elif self.calls > 20: np.ones(16 << 20)
    return np.zeros(6)
"""


def test_what_a_failed_run_held_is_the_others_to_have(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    evaluation = sandboxed(write_agent(LEAKING, single=True))
    result = dataclasses.replace(evaluation, sizes=SandboxLimits(memory=GIB // 2)).run()

    assert [run.status for run in result.runs] == ["ok", "crashed", "ok"]
    assert "MemoryError" in (result.runs[1].reason or "")


def test_an_agent_that_does_not_let_go_delays_nobody(write_agent: AgentWriter, sandboxed: Prepare) -> None:
    body = agent("(self.number, self.calls) == (2, 9)", "raise ValueError('enough')")
    body += "def __del__(self):\n    while self.number == 2: time.sleep(1)\n"
    result = sandboxed(write_agent(body, single=True), limits=LIMITS).run()

    assert ends(result) == [("ok", 24), ("crashed", 8), ("ok", 24)]
    assert (result.runs[1].reason or "").startswith("ValueError: enough")
