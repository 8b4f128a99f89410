"""Keeps Python's signal handlers out of CasADi's integrators.

While an integrator runs, CasADi lets Python handle pending signals at every evaluation of the right-hand side. When a handler
raises, as it does for Ctrl-C, CasADi takes that for a failed evaluation and swallows the exception: the row would be reported as
not integrable and the program would go on. So handlers wait until the integrator has returned, some milliseconds later.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator

# Signals that programs handle in Python; those that do not exist on a platform are left out.
_NUMBERS = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGUSR1", "SIGUSR2", "SIGCHLD")
    if hasattr(signal, name)
)


@contextlib.contextmanager
def signals_wait() -> Iterator[list[int]]:
    """Give the list of signals that have arrived so far; they are raised again at the end of the block, once each.

    Entering and leaving costs about 20 us, so enter it once for many rows and leave when something has arrived.
    """
    arrived: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield arrived  # Python handles signals nowhere but in the main thread
        return
    # The stack puts every handler back, even if one that did come through in between raises.
    with contextlib.ExitStack() as stack:
        for number in _NUMBERS:
            handler = signal.getsignal(number)
            if callable(handler):
                stack.callback(signal.signal, number, handler)
                signal.signal(number, lambda number, _frame: arrived.append(number))
        yield arrived
    for number in dict.fromkeys(arrived):
        signal.raise_signal(number)
