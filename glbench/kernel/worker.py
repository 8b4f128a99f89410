"""What runs in each process of a ``KernelPool``: take settings, then chunks of rows, until the socket closes."""

from __future__ import annotations

import signal
import socket
import traceback

from glbench.errors import GlbenchError, StepError
from glbench.kernel.kernel import Kernel
from glbench.kernel.link import Link


def serve(descriptor: int) -> None:
    """Answer on the socket ``descriptor``: settings with a description, rows with states and failures.

    An error is answered with the error itself; the parent raises it.
    """
    # Ctrl-C reaches the whole process group; only the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    link = Link(socket.socket(fileno=descriptor))
    kernel: Kernel | None = None
    # The parent hanging up, in the middle of an answer or between two, is the ordinary end.
    try:
        while True:
            message = link.receive()
            try:
                if kernel is None:
                    kernel = Kernel(**message)
                    answer: object = kernel.describe()
                else:
                    answer = kernel.advance(message)
            except GlbenchError as error:
                answer = error
            except Exception:
                answer = StepError(f"A kernel worker failed unexpectedly:\n{traceback.format_exc()}")
            link.send(answer)
    except (EOFError, OSError):
        return
