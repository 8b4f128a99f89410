"""What an entry of an action is: its name, its bounds and the quantity that it stands for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from glbench.errors import TaskError


@dataclass(frozen=True)
class Action:
    """One entry of an action: what it is called, its bounds, and the quantity that it stands for.

    Attributes
    ----------
    name
        A control of the task, or a set point.
    low, high
        Bounds of what an agent gives.
    unit, meaning
        Of the quantity that it stands for; "-" for a share.
    idle
        What an agent gives to ask for nothing: no change, no heat beyond frost protection, vents shut, screens open.
    stands_for
        Values [unit] that ``low`` and ``high`` stand for, in a straight line between them; ``None``: what is given is the value.

    Raises
    ------
    TaskError
        When there is ``stands_for``, and it or the bounds are not finite and in order.
    """

    name: str
    low: float
    high: float
    unit: str = "-"
    meaning: str = ""
    idle: float = 0.0
    stands_for: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.stands_for is None:
            return
        for low, high in ((self.low, self.high), self.stands_for):
            if not (math.isfinite(high - low) and low < high):
                msg = (
                    f"The action '{self.name}' from {self.low:g} to {self.high:g} cannot stand for values from {self.lowest:g} to "
                    f"{self.highest:g} {self.unit}. Give finite bounds, the lower one first."
                )
                raise TaskError(msg)

    @property
    def lowest(self) -> float:
        """Value [unit] that ``low`` stands for."""
        return self.low if self.stands_for is None else self.stands_for[0]

    @property
    def highest(self) -> float:
        """Value [unit] that ``high`` stands for."""
        return self.high if self.stands_for is None else self.stands_for[1]

    def of(self, value: Any) -> Any:
        """What to give for ``value`` [unit]: a number, or an array of any shape. Nothing is clipped."""
        return value if self.stands_for is None else (value - self.lowest) / self._slope + self.low

    def value(self, given: Any) -> Any:
        """The value [unit] that ``given`` stands for: a number, an array of any shape, or a recorded value."""
        return given if self.stands_for is None else (given - self.low) * self._slope + self.lowest

    @property
    def _slope(self) -> float:
        return (self.highest - self.lowest) / (self.high - self.low)
