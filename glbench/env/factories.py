"""Registries of the parts an environment is composed of: a name in a task file and what makes the part."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Generic, TypeVar

from glbench.errors import TaskError, UnknownNameError, did_you_mean
from glbench.tasks.vocabulary import Registry, Word

Make = TypeVar("Make")


class Factories(Generic[Make]):
    """Makers of parts by name.

    The tasks' vocabulary knows which words a task file may use; this knows what they do. Registering a part adds its name
    to both.
    """

    def __init__(self, kind: str, vocabulary: Registry[Any]) -> None:
        self.kind = kind
        self._vocabulary = vocabulary
        self._makers: dict[str, Make] = {}
        self._recorded: dict[str, Any] = {}

    def register(self, name: str, meaning: str, make: Make) -> None:
        """Make a part known under a new name.

        Raises
        ------
        TaskError
            When the name is taken.
        """
        if name in self._vocabulary:
            msg = f"There is a {self.kind} called '{name}' already. Give the new one another name."
            raise TaskError(msg)
        self.provide(name, meaning, make)

    def provide(self, name: str, meaning: str, make: Make) -> None:
        """Supply the behaviour of ``name``; a word that task files do not know yet is added to their vocabulary."""
        if name not in self._vocabulary:
            self._vocabulary.add(Word(name, meaning))
        self._makers[name] = make

    def record(self, name: str, recorded: Any) -> None:
        """Say how the part ``name`` is recorded for the compiled kernel (``glbench.env.program``)."""
        self._recorded[name] = (self._makers[name], recorded)

    def recorded(self, name: str) -> Any:
        """What ``record`` was told; ``None`` for a part that only numpy knows."""
        make, recorded = self._recorded.get(name, (None, None))
        return recorded if make is self[name] else None

    def __getitem__(self, name: str) -> Make:
        try:
            return self._makers[name]
        except KeyError:
            msg = f"There is no {self.kind} called '{name}'.{did_you_mean(name, self._makers)}"
            raise UnknownNameError(msg) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._makers)
