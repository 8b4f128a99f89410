"""Comparing numbers to the last bit, or within a tolerance where the machine is another one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from glbench.verification.verdict import Refused

TOLERANCE = 1e-9
"""Largest relative difference that another processor, compiler or backend may make."""
CHAOS = 1e-3
"""Between the tolerance and this, another machine can be the cause: an adaptive step that was accepted there and not here."""

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Agreement:
    """What was found so far: ``largest`` relative difference, and the first value beyond the last bit in words."""

    largest: float = 0.0
    first: str = ""
    cause: str = ""

    @property
    def exact(self) -> bool:
        """Whether all bits were the same."""
        return not self.first

    def add(self, cause: str, recorded: Floats, found: Floats, words: tuple[str, ...], where: str) -> Agreement:
        """Compare tables ``(steps, columns)``, of which ``words`` name the columns; step 1 is the first row."""
        differs = ~_same_bits(recorded, found)
        if not differs.any():
            return self
        size = np.max(np.abs(np.concatenate([recorded, found])), axis=0)
        apart = np.abs(np.subtract(recorded, found, dtype=np.float64)) / np.where(size > 0.0, size, 1.0)
        largest = float(np.max(np.where(differs, np.nan_to_num(apart, nan=np.inf, posinf=np.inf), 0.0)))
        result = replace(self, largest=max(self.largest, largest))
        if largest <= TOLERANCE and self.first:
            return result
        # Where values differ by much, the first of those is what a reader wants to see, not a last digit before it.
        shown = (apart > TOLERANCE) | ~np.isfinite(apart) if largest > TOLERANCE else differs
        if self.first and self.largest > TOLERANCE:
            return result
        step, column = (int(index) for index in np.argwhere(shown)[0])
        place = f"step {step + 1}, {words[column]}" if len(recorded) > 1 else words[column]
        text = f"{where}, {place}: recorded {recorded[step, column]!s}, found {found[step, column]!s}"
        return replace(result, first=text, cause=cause)

    def verdict(self, *, same_machine: bool, other: str) -> Refused | None:
        """Why this is no proof; ``None`` when it is one. ``other`` says what is different here."""
        if self.exact:
            return None
        if same_machine:
            return Refused("refuted", self.cause, f"{self.first}. The recorded actions do not lead there.")
        if self.largest <= TOLERANCE:
            return None
        if self.largest <= CHAOS:
            reason = (
                f"{self.first}. The largest relative difference is {self.largest:.1e}, more than {TOLERANCE:g}, and {other}: "
                "that can be the cause. Verify where the result was made."
            )
            return Refused("unknown", "other_machine", reason)
        return Refused(
            "refuted",
            self.cause,
            f"{self.first}. The recorded actions do not lead there; {other}, which cannot explain it.",
        )


def _same_bits(one: Floats, other: Floats) -> NDArray[np.bool_]:
    """Bit patterns, so that 0.0 and -0.0 differ and nan equals nan."""
    if one.dtype != other.dtype:
        return np.asarray(one == other)
    whole = np.uint64 if one.dtype.itemsize == 8 else np.uint32
    return np.asarray(np.ascontiguousarray(one).view(whole) == np.ascontiguousarray(other).view(whole))
