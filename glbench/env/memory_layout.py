"""Per-run memory that the components of a task request by name, besides states and controls, and the places of what they draw.

A part says what it needs and with which value a run starts. ``allocate`` gives every number a place in the row of memory of a run
(``glbench.kernel.environment``), which the part's tapes read and write:

    layout = allocate(actuation={"heating": 0.0}, sensors={"held": 20.0})
    layout.of("sensors")["held"]  # 1
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, Protocol

import numpy as np

from glbench.arrays import Floats
from glbench.errors import TaskError, refuse


@dataclass(frozen=True, eq=False)
class MemoryLayout:
    """Places in a row of memory."""

    parts: Mapping[str, Mapping[str, int]]
    """For each part of the task, the place of each of its numbers."""
    start: Floats
    """Value of every place when a run starts, ``(m,)``, read-only."""

    @property
    def width(self) -> int:
        """How many numbers a run keeps."""
        return len(self.start)

    def of(self, part: str) -> Mapping[str, int]:
        """Places of the numbers of ``part`` by name; empty where it has none."""
        return self.parts.get(part, {})

    def rows(self, n: int) -> Floats:
        """What ``n`` runs start with, ``(n, m)``."""
        return np.tile(self.start, (n, 1))


def allocate(**requests: Mapping[str, float]) -> MemoryLayout:
    """Give a place to every number that parts ask for: names and start values by part, in the order given.

    Raises ``TaskError`` when a start value is not a finite number.
    """
    parts: dict[str, Mapping[str, int]] = {}
    start: list[float] = []
    for part, numbers in requests.items():
        parts[part] = MappingProxyType({name: len(start) + place for place, name in enumerate(numbers)})
        for name, value in numbers.items():
            if not np.isfinite(value):
                refuse(f"'{name}' of the {part} starts at {value!r}. The memory of a run starts with finite numbers.", TaskError)
            start.append(float(value))
    array = np.array(start, dtype=np.float64)
    array.flags.writeable = False
    return MemoryLayout(MappingProxyType(parts), array)


class DrawingPart(Protocol):
    """A part of a task that draws numbers of its own: in every step, and once a run."""

    STREAM: ClassVar[str]
    TRAIT_STREAM: ClassVar[str]

    @property
    def numbers(self) -> int:
        """Uniform numbers needed in a step."""

    @property
    def trait_numbers(self) -> int:
        """Uniform numbers needed once a run."""

    @property
    def trait_count(self) -> int:
        """Traits that are made of these."""

    def traits(self, numbers: Floats) -> Floats:
        """Traits ``(n, trait_count)`` from uniform numbers ``(n, trait_numbers)``."""


@dataclass(frozen=True)
class DrawPlaces:
    """Where the numbers of a part begin among those that tapes read: ``noise`` of the step, and ``trait`` of the run."""

    noise: int = 0
    trait: int = 0

    def after(self, part: DrawingPart) -> DrawPlaces:
        """Where those of the next part begin."""
        return DrawPlaces(self.noise + part.numbers, self.trait + part.trait_count)
