"""What a kernel and a pool of kernels have in common: checking inputs, and turning failures into errors."""

from __future__ import annotations

import math
from abc import abstractmethod
from types import TracebackType
from typing import Self

import numpy as np
import numpy.typing as npt

from glbench.errors import ShapeError, StepError
from glbench.kernel.records import Description, FloatArray, Rows, StepFailure, as_rows
from glbench.kernel.sensitivities import Differentiable


class Stepper(Differentiable):
    """x(t + h) from x(t) with controls, weather and parameters held constant in between.

    Row i of a batch gives the same bits as the row stepped alone, whatever the other rows and earlier calls were. Not
    thread-safe. A context manager: leaving it calls ``close``.

    Attributes
    ----------
    step_seconds : float
        Length h of the control step [s].
    backend : str
        Name of the backend that steps: ``"compiled"``, ``"casadi"`` or ``"cvodes"``.
    """

    step_seconds: float
    backend: str

    def step(self, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike) -> FloatArray:
        """State after one control step.

        Parameters
        ----------
        x : array_like
            States, (28,) or (n, 28), units of ``glbench.model.STATES``.
        u, d, p : array_like
            Controls (6,) [0..1], disturbances (10,), parameters (208,), each with or without a leading axis of n.

        Returns
        -------
        ndarray
            A new array in the shape of ``x``.

        Raises
        ------
        ShapeError, ActionError
            When an input has the wrong shape or is not finite, or a control lies outside 0..1.
        StepError
            When a row could not be integrated; says which, at which model time and with which inputs.
        """
        rows = as_rows(x, u, d, p)
        stepped, failures = self.advance(rows)
        if failures:
            raise StepError(self._failure(failures, rows.x.shape[0]))
        return stepped[0] if np.ndim(x) == 1 else stepped

    def try_step(
        self, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike
    ) -> tuple[FloatArray, list[StepFailure]]:
        """Step a batch (n, 28); a row that fails keeps its old state and is reported, the others are stepped.

        Inputs and errors as for ``step``, but without StepError for rows that fail.
        """
        if np.ndim(x) != 2:
            msg = f"try_step wants a batch of states (rows, 28), not the shape {np.shape(x)}; use step for one state."
            raise ShapeError(msg)
        return self.advance(as_rows(x, u, d, p))

    @abstractmethod
    def advance(self, rows: Rows) -> tuple[FloatArray, list[StepFailure]]:
        """Like ``try_step``, on rows that have been checked already."""

    @abstractmethod
    def describe(self) -> Description:
        """What made the numbers: backend, method, tolerances, versions, model digest. Recorded in results."""

    @abstractmethod
    def close(self) -> None:
        """Release what the kernel holds. Closing twice is fine."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _failure(self, failures: list[StepFailure], count: int) -> str:
        first = failures[0]
        more = f" {len(failures)} of {count} rows failed." if len(failures) > 1 else ""
        return (
            f"The step of {self.step_seconds:g} s failed in row {first.row} of {count}: {first.reason}.{more} "
            "Use try_step to go on with the other rows."
        )


def positive_seconds(step_seconds: float) -> float:
    """Check the length of a control step [s]."""
    try:
        seconds = float(step_seconds)
    except (TypeError, ValueError):
        seconds = math.nan
    if not (math.isfinite(seconds) and seconds > 0.0):
        msg = f"The control step lasts {step_seconds!r} s; it must be a positive, finite number (usual: 300 or 900 s)."
        raise ShapeError(msg)
    return seconds
