from __future__ import annotations

import signal
import time
from collections.abc import Iterator

import pytest

from glbench.evaluation.limits import TimeUp, guarded


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
