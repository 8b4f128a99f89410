"""Messages between a kernel pool and its workers, over one socket each.

Like ``multiprocessing.connection.Connection``, but a message goes out in one piece however long it is: the other process wakes
once for it instead of twice, which is most of what a message costs.
"""

from __future__ import annotations

import pickle
import socket
from typing import Any

_LENGTH_BYTES = 8


class Link:
    """Sends and receives Python objects. Both ends are processes of ours, so what arrives can be unpickled."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end

    def send(self, message: object) -> None:
        """Send an object. OSError when the other end has gone."""
        content = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
        self._socket.sendall(len(content).to_bytes(_LENGTH_BYTES, "little") + content)

    def receive(self) -> Any:
        """Wait for an object. EOFError or OSError when the other end has gone."""
        length = int.from_bytes(self._exactly(_LENGTH_BYTES), "little")
        return pickle.loads(self._exactly(length))

    def close(self) -> None:
        """Close this end; the other one sees the end of the file."""
        self._socket.close()

    def _exactly(self, length: int) -> bytearray:
        content = bytearray(length)
        rest = memoryview(content)
        while rest:
            count = self._socket.recv_into(rest)
            if count == 0:
                raise EOFError
            rest = rest[count:]
        return content
