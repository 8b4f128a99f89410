"""The command ``glbench``, from its first moment on.

A module of its own because importing the package takes a while (numpy, Gymnasium): Ctrl-C within that time ends the command
without a traceback, too.
"""

from __future__ import annotations

import os
import signal


def _leave(number: int, _frame: object) -> None:
    os.write(2, b"\nInterrupted.\n")
    os._exit(128 + number)


def main() -> None:
    """Run the command line."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup and the like stay what they are
            signal.signal(number, _leave)
    from glbench.cli.app import run

    run()
