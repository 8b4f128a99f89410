"""Comparing numbers: to the last bit, or within a tolerance where the arithmetic of two machines differs.

What a result says about its machine plays no part: it could be forged. The numbers themselves tell. Arithmetic that differs, differs in
every step that follows, so a whole run with the same bits says that the arithmetic is the same, and then all numbers must be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.verification.verdict import Refused

TOLERANCE = 1e-9
"""Largest relative difference at which a result is reproduced, though not to the last bit."""
CHAOS = 1e-3
"""Between the tolerance and this, another machine can be the cause: an adaptive step that was accepted there and not here."""

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Difference:
    """A value that differs: what kind of value, and which one in words."""

    cause: str
    words: str


@dataclass(frozen=True)
class Agreement:
    """What was found so far.

    Attributes
    ----------
    largest
        Largest relative difference.
    first
        The first value of which a bit differs.
    first_large
        The first value that differs by more than the tolerance.
    """

    largest: float = 0.0
    first: Difference | None = None
    first_large: Difference | None = None

    @property
    def exact(self) -> bool:
        """Whether all bits were the same."""
        return self.first is None

    def add(self, cause: str, recorded: Floats, found: Floats, words: tuple[str, ...], where: str) -> Agreement:
        """Compare tables ``(steps, columns)``, of which ``words`` name the columns; step 1 is the first row."""
        differs = ~same_bits(recorded, found)
        if not differs.any():
            return self
        with np.errstate(all="ignore"):  # what is not finite counts as infinitely far apart
            apart = np.where(differs, np.nan_to_num(_relative(recorded, found), nan=np.inf, posinf=np.inf), 0.0)

        def first(which: NDArray[np.bool_]) -> Difference | None:
            if not which.any():
                return None
            step, column = (int(index) for index in np.argwhere(which)[0])
            place = f"step {step + 1}, {words[column]}" if len(recorded) > 1 else words[column]
            text = f"{where}, {place}: recorded {recorded[step, column]!s}, found {found[step, column]!s}"
            return Difference(cause, text)

        return Agreement(
            max(self.largest, float(apart.max())),
            self.first or first(differs),
            self.first_large or first(apart > TOLERANCE),
        )

    def verdict(self, *, same_arithmetic: bool, stated: str) -> Refused | None:
        """Why this is not reproduced; ``None`` when it is. ``stated`` says what the result states of its machine."""
        if self.first is None:
            return None
        if same_arithmetic:
            reason = (
                f"{self.first.words}. The recorded actions do not lead there; and it is not the machine, because other numbers of "
                "whole runs are the same to the last bit."
            )
            return Refused("refuted", self.first.cause, reason)
        if self.first_large is None:
            return None
        large = self.first_large
        if self.largest <= CHAOS:
            reason = (
                f"{large.words}. The largest relative difference is {self.largest:.1e}, more than {TOLERANCE:g}: an adaptive step on "
                f"another machine can make it, and so can a change by hand. {stated} Verify on the machine that made the result."
            )
            return Refused("unknown", "other_machine", reason)
        reason = (
            f"{large.words}. The recorded actions do not lead there, and no difference between machines is as large."
        )
        return Refused("refuted", large.cause, reason)


def _relative(recorded: Floats, found: Floats) -> Floats:
    """Differences relative to the largest value of their column."""
    size = np.max(np.abs(np.concatenate([recorded, found])), axis=0)
    apart = np.abs(np.subtract(recorded, found, dtype=np.float64))
    return np.asarray(apart / np.where(size > 0.0, size, 1.0))


def same_bits(one: Floats, other: Floats) -> NDArray[np.bool_]:
    """Bit patterns, so that 0.0 and -0.0 differ and nan equals nan."""
    if one.dtype != other.dtype:
        return np.asarray(one == other)
    whole = np.uint64 if one.dtype.itemsize == 8 else np.uint32
    return np.asarray(np.ascontiguousarray(one).view(whole) == np.ascontiguousarray(other).view(whole))
