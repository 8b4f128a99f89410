"""A compiled step of fixed arrays: one call of the library, all pointers set beforehand."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from glbench.errors import StepError
from glbench.kernel.compiled.batch import SIZES, Array
from glbench.kernel.compiled.binding import RowPointers

if TYPE_CHECKING:
    from glbench.kernel.compiled.stepper import CompiledStepper

Arrays: TypeAlias = tuple[Array, Array, Array, Array, Array]
"""States, controls, disturbances, parameters and results of some rows."""


class CompiledBoundStep:
    """Made by ``CompiledStepper.bind``: ``step()`` advances the rows of ``x`` into ``out``.

    Attributes
    ----------
    status : ndarray
        0 for rows that were stepped (n,).
    substeps : ndarray
        Substeps that each row took (n,), rejected ones included.
    reached : ndarray
        Time within the step that each row reached (n,) [s].
    """

    def __init__(
        self, stepper: CompiledStepper, call: Callable[[], int], pointers: RowPointers, arrays: Arrays
    ) -> None:
        self._stepper = stepper
        self._call = call
        self._arrays = arrays
        n = len(arrays[0])
        self.status, self.substeps, self.reached = np.zeros(n, np.int32), np.zeros(n, np.int32), np.zeros(n)
        x, u, d, p, out = arrays
        pointers.n, pointers.p_stride = n, SIZES["p"] if len(p) > 1 else 0
        pointers.x, pointers.u, pointers.d, pointers.p, pointers.out = (a.ctypes.data for a in (x, u, d, p, out))
        pointers.status, pointers.substeps = self.status.ctypes.data, self.substeps.ctypes.data
        pointers.reached = self.reached.ctypes.data

    def __call__(self) -> None:
        """Step the rows.

        Raises
        ------
        StepError
            When a row could not be integrated, or an input is not finite; the other rows have been stepped.
        """
        if self._call():
            self._step_again()

    def _step_again(self) -> None:
        """Rows that need the library of the full model, and failures."""
        x, u, d, p, out = self._arrays
        rows = np.flatnonzero(self.status)
        stepped = np.empty((rows.size, SIZES["x"]))
        status = self._stepper.step_rows(x[rows], u[rows], d[rows], p[rows] if len(p) > 1 else p, stepped)
        out[rows], self.status[rows] = stepped, status
        self.substeps[rows], self.reached[rows] = self._stepper.substeps, self._stepper.reached
        failed = np.flatnonzero(status)
        if failed.size:
            reason = self._stepper.explain(int(failed[0]))
            msg = f"The step of {self._stepper.step_seconds:g} s failed in row {rows[failed[0]]}: {reason}."
            raise StepError(msg)
