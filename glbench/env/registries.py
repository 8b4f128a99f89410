"""Registries of the parts of an environment: their names in task files, and functions that make them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Generic, TypeVar

from glbench.errors import UnknownNameError, did_you_mean
from glbench.tasks.vocabulary import Registry, Word

Make = TypeVar("Make")


class PartRegistry(Generic[Make]):
    """Makers of parts by name.

    The tasks' vocabulary knows which words a task file may use and their meaning; this knows what they do. Registering a part fills both.
    """

    def __init__(self, kind: str, vocabulary: Registry[Any]) -> None:
        self.kind = kind
        self._vocabulary = vocabulary
        self._makers: dict[str, tuple[Make, Any]] = {}

    def register(self, name: str, meaning: str, make: Make) -> None:
        """Make a part known under a new name, here and in task files. Raises ``TaskError`` when the name is taken."""
        self._vocabulary.add(Word(name, meaning))
        self.provide(name, make)

    def provide(self, name: str, make: Make, recorded: Any = None) -> None:
        """Supply the behaviour of a word of the vocabulary, and how it is recorded for the compiled kernel (``glbench.env.program``)."""
        self._makers[name] = make, recorded

    def recorded(self, name: str) -> Any:
        """How the part ``name`` is recorded; ``None`` for one that only numpy knows."""
        return self._entry(name)[1]

    def __getitem__(self, name: str) -> Make:
        return self._entry(name)[0]

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)

    def _entry(self, name: str) -> tuple[Make, Any]:
        try:
            return self._makers[name]
        except KeyError:
            msg = f"There is no {self.kind} called '{name}'.{did_you_mean(name, self._makers)}"
            raise UnknownNameError(msg) from None
