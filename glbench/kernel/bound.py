"""Steps of arrays that stay where they are: a call without arguments, without allocation, without checking values again."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from glbench.errors import ShapeError, StepError
from glbench.kernel.records import FloatArray, Rows, StepFailure
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES


class BoundStep(Protocol):
    """One control step of the arrays that it was made for, as they are at the time of the call.

    Rows that fail keep their state in ``out``, the others are stepped.

    Raises
    ------
    StepError
        When a row could not be integrated, or an input is not finite.
    """

    def __call__(self) -> None:
        """Step the rows."""


class Advances(Protocol):
    """A backend, as far as it matters here."""

    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out``; failed rows keep their old state and are reported."""


class PlainBoundStep:
    """A bound step of any backend."""

    def __init__(self, backend: Advances, rows: Rows, out: FloatArray) -> None:
        self._backend = backend
        self._rows = rows
        self._out = out

    def __call__(self) -> None:
        """Step the rows; see ``BoundStep``."""
        failures = self._backend.advance(self._rows, self._out)
        if failures:
            msg = f"The step failed in row {failures[0].row} of {len(self._out)}: {failures[0].reason}."
            raise StepError(msg)


def bound_rows(x: FloatArray, u: FloatArray, d: FloatArray, p: FloatArray, out: FloatArray) -> tuple[Rows, FloatArray]:
    """The same memory as rows (n, ·) and results (n, 28).

    Raises
    ------
    ShapeError
        When an array is not C-contiguous float64, has another shape, or ``out`` cannot be written.
    """
    count = len(x) if np.ndim(x) == 2 else 1
    widths = (len(STATE_NAMES), len(CONTROL_NAMES), len(DISTURBANCE_NAMES), len(PARAMETER_NAMES), len(STATE_NAMES))
    arrays = {"x": x, "u": u, "d": d, "p": p, "out": out}
    for (name, array), width in zip(arrays.items(), widths, strict=True):
        single = count == 1 or name == "p"
        shapes = ((count, width), (1, width), (width,)) if single else ((count, width),)
        usable = isinstance(array, np.ndarray) and array.dtype == np.float64 and array.flags.c_contiguous
        if not (usable and array.shape in shapes and (name != "out" or array.flags.writeable)):
            found = f"{getattr(array, 'dtype', type(array).__name__)}{np.shape(array)}"
            msg = (
                f"A bound step works in the caller's memory: {name} must be a C-contiguous float64 array of the shape "
                f"{' or '.join(map(str, shapes))}{', writeable' if name == 'out' else ''}, not {found}."
            )
            raise ShapeError(msg)
    rows = Rows(*(array.reshape(-1, width) for array, width in zip((x, u, d, p), widths[:4], strict=True)))
    return rows, out.reshape(-1, widths[4])
