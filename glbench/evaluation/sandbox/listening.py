"""What an agent's code does to the world around it, overheard from Python: files opened for writing, connections."""

from __future__ import annotations

import os
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_MOST = 5
_REMOVING = frozenset({"os.remove", "os.rename", "os.mkdir", "os.rmdir"})
_NETWORK = (socket.AF_INET, socket.AF_INET6)
_DEVICES = ("/dev/", "/proc/")


class Listener:
    """Hears of connections and of writing, while it is told to listen. Code that avoids Python's own calls is not heard.

    An audit hook cannot be taken away again: for processes that end with the agent.
    """

    def __init__(self) -> None:
        self._addresses: list[str] = []
        self._network = False
        self.written: list[str] = []
        self._on = False
        self._free = (str(Path(tempfile.gettempdir()).resolve()), "/tmp", *_DEVICES)
        sys.addaudithook(self._hear)

    @property
    def connections(self) -> list[str]:
        """Where it connected to, or wanted to."""
        return self._addresses or (["the network"] if self._network else [])

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen while the agent's code runs."""
        self._on = True
        try:
            yield
        finally:
            self._on = False

    def _hear(self, event: str, arguments: tuple[object, ...]) -> None:
        if not self._on:
            return
        if event in {"socket.connect", "socket.getaddrinfo"}:
            self._add(self._addresses, _address(event, arguments))
        elif event == "socket.__new__" and arguments[1] in _NETWORK:
            self._network = True  # a sandbox refuses here, before any address is named
        elif event in _REMOVING or (event == "open" and isinstance(arguments[2], int) and arguments[2] & _WRITING):
            self._write(arguments[0])

    def _write(self, path: object) -> None:
        if isinstance(path, str | bytes | os.PathLike):
            given = Path(os.fsdecode(path))
            place = str(given)
            # Beside the agent's own /tmp nothing will be there to write to; a relative path may lead anywhere.
            if not given.is_absolute() or not place.startswith(self._free):
                self._add(self.written, place)

    @staticmethod
    def _add(told: list[str], what: str) -> None:
        if what not in told and len(told) < _MOST:
            told.append(what)


def _address(event: str, arguments: tuple[object, ...]) -> str:
    if event == "socket.getaddrinfo":
        return str(arguments[0])
    address = arguments[1]
    return f"{address[0]}:{address[1]}" if isinstance(address, tuple) and len(address) >= 2 else str(address)
