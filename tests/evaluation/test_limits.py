from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from glbench.evaluation import TimeLimits, evaluate
from glbench.evaluation.limits import TimeUp, guarded
from glbench.tasks import TaskSpec
from tests.evaluation.agent_files import AgentWriter


@pytest.fixture
def own_alarm() -> Iterator[list[bool]]:
    """Somebody else's alarm, far away; what pytest's time-out had set is put back afterwards."""
    rang: list[bool] = []
    handler = signal.signal(signal.SIGALRM, lambda *_: rang.append(True))
    before = signal.setitimer(signal.ITIMER_REAL, 50.0)
    yield rang
    signal.setitimer(signal.ITIMER_REAL, *before)
    signal.signal(signal.SIGALRM, handler)


def test_the_alarm_gives_back_the_one_that_was_set(own_alarm: list[bool]) -> None:
    handler = signal.getsignal(signal.SIGALRM)
    answer = guarded(lambda: time.sleep(0.05), 5.0, "act")
    left, _ = signal.getitimer(signal.ITIMER_REAL)

    assert answer.failure is None
    assert signal.getsignal(signal.SIGALRM) is handler
    assert 45.0 < left <= 50.0 - 0.05


def test_the_alarm_is_given_back_after_it_rang(own_alarm: list[bool]) -> None:
    answer = guarded(lambda: time.sleep(30.0), 0.05, "act")
    left, _ = signal.getitimer(signal.ITIMER_REAL)

    assert answer.failure is not None
    assert answer.failure.status == "timed_out"
    assert 45.0 < left < 50.0
    assert not own_alarm


def test_what_is_too_slow_where_no_alarm_can_ring_is_found_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("glbench.evaluation.limits.threading.current_thread", lambda: None)
    answer = guarded(lambda: time.sleep(0.05), 0.01, "act")

    assert answer.value is None
    assert answer.failure is not None
    assert answer.failure.reason == "act took longer than its limit of 0.01 s"


def test_no_agent_catches_the_alarm_by_catching_errors() -> None:
    assert not issubclass(TimeUp, Exception)


def test_ctrl_c_is_nobodys_failure() -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        guarded(interrupt, 1.0, "act")


_STOPPED = """
import time
from glbench.evaluation.limits import guarded

def act():
    end = time.process_time() + 1.0
    while time.process_time() < end:
        pass
    time.sleep({sleeps})

print("ready", flush=True)
answer = guarded(act, 3.0, "act")
print(answer.failure is None, answer.seconds < 3.0, answer.failure)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs signals that stop a process")
@pytest.mark.parametrize(("sleeps", "in_time"), [(0.1, True), (6.0, False)])
def test_time_in_which_the_process_stood_still_does_not_count(sleeps: float, in_time: bool) -> None:
    command = [sys.executable, "-c", _STOPPED.format(sleeps=sleeps)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        time.sleep(0.3)
        process.send_signal(signal.SIGSTOP)
        time.sleep(4.0)
        process.send_signal(signal.SIGCONT)
        answer, _ = process.communicate(timeout=60)

    assert answer.startswith("True True" if in_time else "False"), answer
    assert in_time or "act took longer than its limit of 3 s" in answer


def test_a_result_under_other_limits_is_not_taken_for_this_one(day_task: TaskSpec, write_agent: AgentWriter, tmp_path: Path) -> None:
    agent = write_agent("    def act(self, observations):\n        __import__('time').sleep(0.05)\n        return np.zeros((self.n, 6))\n")
    for limit, status in ((0.001, "timed_out"), (10.0, "ok")):
        result = evaluate(day_task, agent, out=tmp_path, limits=TimeLimits(step=limit))
        assert {run.status for run in result.runs} == {status}
