"""What an agent prints, kept within bounds: how it began and how it ended."""

from __future__ import annotations


class Prints:
    """The output of an agent's processes: the first half of ``size`` bytes, and the last."""

    def __init__(self, size: int = 64 * 1024) -> None:
        self._half = size // 2
        self._head = b""
        self._tail = b""
        self._total = 0

    def add(self, said: bytes) -> None:
        """Take in more output."""
        self._total += len(said)
        room = self._half - len(self._head)
        self._head += said[:room]
        self._tail = (self._tail + said[room:])[-self._half :] if len(said) > room else self._tail

    @property
    def size(self) -> int:
        """Bytes of all that was printed, kept or not."""
        return self._total

    def text(self) -> str:
        """The output with a note where some of it was left out; free of control characters, which could forge what a terminal shows."""
        left_out = self._total - len(self._head) - len(self._tail)
        note = f"\n[... {left_out:,} bytes left out ...]\n".encode() if left_out else b""
        return plain((self._head + note + self._tail).decode("utf-8", errors="replace"))

    def last_lines(self, number: int) -> list[str]:
        """The last lines that are not empty."""
        return [line for line in self.text().splitlines() if line.strip()][-number:]


def plain(text: str) -> str:
    """``text`` without control characters other than ends of lines and tabulators."""
    return "".join(letter for letter in text if letter.isprintable() or letter in "\n\t")
