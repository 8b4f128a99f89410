"""Failures are values with a sentence; interrupts are not failures."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from types import FrameType

import numpy as np
import pytest

from glbench.errors import StepError
from glbench.kernel import Kernel
from glbench.kernel.cvodes import SUBSTEP_LIMIT, signals_wait
from tests.kernel.known_steps import Array, KnownSteps


def test_a_failed_row_keeps_its_state_and_the_others_are_stepped(kernel: Kernel, steps_900: KnownSteps, p: Array, leafless: Array) -> None:
    x, u, d = steps_900.x[:4].copy(), steps_900.u[:4], steps_900.d[:4]
    expected = kernel.step(x, u, d, p)
    x[2] = leafless
    after, failures = kernel.try_step(x, u, d, p)
    assert [failure.row for failure in failures] == [2]
    assert np.array_equal(after[2], leafless)
    assert np.array_equal(np.delete(after, 2, axis=0), np.delete(expected, 2, axis=0))


def test_the_reason_names_states_time_and_inputs(kernel: Kernel, steps_900: KnownSteps, p: Array, leafless: Array) -> None:
    _, (failure,) = kernel.try_step(leafless[None], steps_900.u[0], steps_900.d[0], p)
    assert "rate of change is not finite" in failure.reason
    assert "cBuf (" in failure.reason
    assert f"model time {leafless[27]:.5f} days" in failure.reason
    assert f"uBoil {steps_900.u[0, 0]:.3g}" in failure.reason
    assert f"tOut {steps_900.d[0, 1]:.4g} °C" in failure.reason


def test_step_raises_for_the_first_failed_row_and_counts_them(kernel: Kernel, steps_900: KnownSteps, p: Array, leafless: Array) -> None:
    x = steps_900.x[:5].copy()
    x[[1, 3]] = leafless
    with pytest.raises(StepError, match=r"step of 900 s failed in row 1 of 5: .*2 of 5 rows failed.*try_step"):
        kernel.step(x, steps_900.u[:5], steps_900.d[:5], p)


def test_an_endless_step_is_given_up_and_says_where(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    # With hardly any leaves in the cold, the denominator of photosynthesis passes through zero.
    x = steps_900.x[0].copy()
    x[23], x[4], x[2] = 750.0, 14.7, 15.8
    d = np.array([635.0, 18.6, 1889.0, 730.0, 6.2, 5.0, 12.0, 0.0, 0.0, 0.0])
    _, (failure,) = kernel.try_step(x[None], np.array([0.9, 0.2, 0.2, 0.9, 1.0, 1.0]), d, p)
    assert f"more than {SUBSTEP_LIMIT} internal steps" in failure.reason
    assert "fastest at its start was" in failure.reason


def test_nothing_is_printed_for_a_failed_row(
    kernel: Kernel, steps_900: KnownSteps, p: Array, leafless: Array, capfd: pytest.CaptureFixture[str]
) -> None:
    kernel.try_step(leafless[None], steps_900.u[0], steps_900.d[0], p)
    assert capfd.readouterr() == ("", "")


class InterruptionError(Exception):
    """What a program's own signal handler raises."""


@pytest.fixture
def interrupt_soon() -> Iterator[None]:
    """Sends SIGUSR1 to this process after 50 ms; its handler raises."""

    def handler(_number: int, _frame: FrameType | None) -> None:
        raise InterruptionError

    before = signal.signal(signal.SIGUSR1, handler)
    timer = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGUSR1))
    timer.start()
    yield
    timer.join()
    signal.signal(signal.SIGUSR1, before)


@pytest.mark.usefixtures("interrupt_soon")
def test_an_interrupt_is_raised_and_not_taken_for_a_failed_row(kernel: Kernel, steps_900: KnownSteps, p: Array) -> None:
    def step_for_a_while() -> None:
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            _, failures = kernel.try_step(steps_900.x, steps_900.u, steps_900.d, p)
            assert failures == []

    with pytest.raises(InterruptionError):
        step_for_a_while()


def test_handlers_are_put_back_and_run_once_after_the_block() -> None:
    seen: list[int] = []
    before = signal.signal(signal.SIGUSR2, lambda number, _frame: seen.append(number))
    try:
        handler = signal.getsignal(signal.SIGUSR2)
        with signals_wait() as arrived:
            signal.raise_signal(signal.SIGUSR2)
            signal.raise_signal(signal.SIGUSR2)
            assert seen == []
            assert arrived == [signal.SIGUSR2] * 2
        assert seen == [signal.SIGUSR2]
        assert signal.getsignal(signal.SIGUSR2) is handler
    finally:
        signal.signal(signal.SIGUSR2, before)


def test_a_thread_can_step_too(steps_900: KnownSteps, kernel: Kernel, p: Array) -> None:
    expected = kernel.step(steps_900.x[0], steps_900.u[0], steps_900.d[0], p)
    found: list[Array] = []
    thread = threading.Thread(target=lambda: found.append(kernel.step(steps_900.x[0], steps_900.u[0], steps_900.d[0], p)))
    thread.start()
    thread.join()
    assert np.array_equal(found[0], expected)
