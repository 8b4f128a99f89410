"""The same bits for a run alone and among others, from libraries whose matrix products round by the size of the batch.

A library picks another way of adding up for one row than for thirty, and sometimes another for odd widths, by where a row lies in memory.
So a policy is always asked with the same number of rows, filled up with zeros. Whether a row's place in that block matters is tried out
once, with the policy itself: rows are moved through all places. Where it does matter, the policy is asked row by row, from
one and the same piece of memory; that is slower and cannot depend on anything else.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from glbench.errors import SubmissionError

Rows = NDArray[np.float32]
Function = Callable[[Rows], NDArray[np.floating]]
"""Answers ``(b, m)`` for ``b`` rows ``(b, k)``."""

BLOCK = 32
"""Rows in a block: the 30 runs of an evaluation fit into one."""
_SIZES = (0.01, 1.0, 100.0)


class EvenRows:
    """``function`` asked so that row i of the answer depends on row i of the question only, to the last bit.

    Parameters
    ----------
    function
        A policy that takes ``(b, width)`` float32 for the ``b`` of a block.
    width
        Columns of a row.
    block
        Rows that are asked for at once; 1 for a policy that takes a single row only.
    """

    def __init__(self, function: Function, width: int, block: int = BLOCK) -> None:
        self._function = function
        self._width = width
        self.block = block
        """Rows asked for at once: the block's, or 1 where the place in the block changes bits."""
        self._memory = np.zeros((block, width), dtype=np.float32)
        if block > 1 and not self._even():
            self.block = 1
            self._memory = np.zeros((1, width), dtype=np.float32)

    def __call__(self, rows: Rows) -> NDArray[np.floating]:
        """Answers ``(n, m)`` for ``rows`` ``(n, width)``, any ``n`` from 1 on."""
        parts = [self._ask(rows[first : first + self.block]) for first in range(0, len(rows), self.block)]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _ask(self, rows: Rows) -> NDArray[np.floating]:
        memory = self._memory
        memory[: len(rows)] = rows
        memory[len(rows) :] = 0.0
        answer = np.array(self._function(memory))
        if answer.ndim != 2 or len(answer) != self.block:
            msg = (
                f"the policy answers {self.block} rows of observations with an array of shape {answer.shape}, "
                f"expected ({self.block}, number of actions)"
            )
            raise SubmissionError(msg)
        return answer[: len(rows)]

    def _even(self) -> bool:
        """Whether rows have the same answers in every place of the block and beside zeros."""
        draws = np.random.default_rng(0).standard_normal((self.block, self._width))
        for size in _SIZES:
            rows = (size * draws).astype(np.float32)
            together = self._ask(rows)
            for shift in range(1, self.block):
                moved = np.roll(self._ask(np.roll(rows, shift, axis=0)), -shift, axis=0)
                if moved.tobytes() != together.tobytes():
                    return False
            if any(self._ask(rows[i : i + 1]).tobytes() != together[i : i + 1].tobytes() for i in range(self.block)):
                return False
        return True
