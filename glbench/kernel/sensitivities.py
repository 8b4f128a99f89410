"""Derivatives of one control step: along directions, in reverse, or all of them as matrices.

They are those of the numerical step with its substeps held where they are, exact to rounding. Where the model has a kink (a
minimum, a maximum, a condition) they belong to the branch that the step took. Method, accuracy, speed: docs/sensitivities.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, NoReturn, Protocol

import numpy as np
import numpy.typing as npt

from glbench.errors import GlbenchError, ShapeError, StepError
from glbench.kernel.directions import (
    ORDER,
    SIZES,
    Directions,
    all_directions,
    as_seeds,
    directions_differ,
    parameter_numbers,
    widths,
)
from glbench.kernel.finite import all_finite
from glbench.kernel.records import FloatArray, Rows, StepFailure, as_rows


@dataclass(frozen=True)
class Linearisation:
    """A control step and its Jacobians; a batch has a leading axis of n everywhere.

    Attributes
    ----------
    x_next : ndarray
        State after the step (28,), the same bits as from ``step``.
    dx, du, dd : ndarray
        Derivatives of ``x_next`` with respect to states (28, 28), controls (28, 6) and disturbances (28, 10); element [i, j]
        is in units of state i per unit of input j.
    dp : ndarray
        The same for the parameters that were asked for (28, q), in their order.
    """

    x_next: FloatArray
    dx: FloatArray
    du: FloatArray
    dd: FloatArray
    dp: FloatArray


@dataclass(frozen=True)
class Adjoint:
    """Gradient of ``cotangent . x_next`` with respect to the inputs of a step; a batch has a leading axis of n everywhere.

    Attributes
    ----------
    x, u, d : ndarray
        (28,), (6,), (10,) [unit of ``cotangent . x_next`` per unit of the input].
    p : ndarray or None
        (208,), when it was asked for. Rows that share inputs have a gradient each: add them up for that of the shared input.
    """

    x: FloatArray
    u: FloatArray
    d: FloatArray
    p: FloatArray | None


class Forward(NamedTuple):
    """States (n, 28), their derivatives along each direction (n, m, 28), and which rows failed (n,)."""

    x_next: FloatArray
    tangents: FloatArray
    failed: npt.NDArray[np.bool_]


class Reverse(NamedTuple):
    """States (n, 28), the gradient for each input (n, size of the input), and which rows failed (n,)."""

    x_next: FloatArray
    gradients: dict[str, FloatArray]
    failed: npt.NDArray[np.bool_]


class Differentiator(Protocol):
    """How a backend differentiates checked rows. Row i has the same bits whatever the other rows are."""

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""
        ...

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, 28) back; the gradient for the parameters is only there when asked for."""
        ...


class Differentiable(ABC):
    """A stepper with derivatives; the first call may build a library for some ten seconds."""

    step_seconds: float

    @abstractmethod
    def advance(self, rows: Rows) -> tuple[FloatArray, list[StepFailure]]:
        """Step checked rows."""

    def differentiator(self) -> Differentiator:
        """What differentiates the steps of this stepper.

        Raises
        ------
        GlbenchError
            When it cannot.
        """
        msg = (
            f"A {type(self).__name__} gives no derivatives: its processes only step. Use Kernel(...), with threads=... on "
            "several cores."
        )
        raise GlbenchError(msg)

    def linearise(
        self,
        x: npt.ArrayLike,
        u: npt.ArrayLike,
        d: npt.ArrayLike,
        p: npt.ArrayLike,
        *,
        parameters: Sequence[str] = (),
    ) -> Linearisation:
        """One control step and its Jacobians.

        Parameters
        ----------
        x, u, d, p : array_like
            As for ``step``: one state (28,) or a batch (n, 28).
        parameters : sequence of str
            Names of parameters to differentiate with respect to, see ``glbench.model.PARAMETER_NAMES``.

        Raises
        ------
        ShapeError, ActionError, StepError
            As for ``step``; StepError also when a derivative is not finite.
        UnknownNameError
            When there is no such parameter.
        """
        rows = as_rows(x, u, d, p)
        found = self._forward(rows, all_directions(parameter_numbers(tuple(parameters))))
        table = np.ascontiguousarray(found.tangents.swapaxes(1, 2))
        bounds = np.cumsum(widths(len(parameters)))[:-1]
        by_key = dict(zip(ORDER, map(np.ascontiguousarray, np.split(table, bounds, axis=-1)), strict=True))
        values = [found.x_next, *(by_key[key] for key in SIZES)]
        return Linearisation(*(a[0] for a in values) if np.ndim(x) == 1 else values)

    def forward(
        self,
        x: npt.ArrayLike,
        u: npt.ArrayLike,
        d: npt.ArrayLike,
        p: npt.ArrayLike,
        *,
        dx: npt.ArrayLike | None = None,
        du: npt.ArrayLike | None = None,
        dd: npt.ArrayLike | None = None,
        dp: npt.ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """One control step, and how its result changes along directions of the inputs.

        Parameters
        ----------
        x, u, d, p : array_like
            As for ``step``: one state (28,) or a batch (n, 28).
        dx, du, dd, dp : array_like, optional
            Direction in each input, in its units. For one state (size,), or (m, size) for m directions at once; for a batch
            (size,) for all rows, (n, size), or (n, m, size). Inputs without one are held.

        Returns
        -------
        x_next, tangent : ndarray
            State after the step, and its derivative along the direction in the same shape, or with an axis of m before the
            last one.

        Raises
        ------
        ShapeError, ActionError, StepError
            As for ``step``; StepError also when a derivative is not finite.
        """
        rows = as_rows(x, u, d, p)
        one = np.ndim(x) == 1
        seeds = {"x": dx, "u": du, "d": dd, "p": dp}
        tables = {key: as_seeds(key, seed, len(rows.x), one=one) for key, seed in seeds.items() if seed is not None}
        counts = {table.shape[1] for table in tables.values()}
        if len(counts) != 1:
            raise ShapeError(directions_differ({key: table.shape[1] for key, table in tables.items()}))
        found = self._forward(rows, Directions(counts.pop(), shared=False, seeds=tables))
        several = any(np.ndim(seed) == (2 if one else 3) for seed in seeds.values() if seed is not None)
        tangents = found.tangents if several else found.tangents[:, 0]
        return (found.x_next[0], tangents[0]) if one else (found.x_next, tangents)

    def adjoint(
        self,
        x: npt.ArrayLike,
        u: npt.ArrayLike,
        d: npt.ArrayLike,
        p: npt.ArrayLike,
        cotangent: npt.ArrayLike,
        *,
        parameters: bool = False,
    ) -> tuple[FloatArray, Adjoint]:
        """One control step, and the gradient of ``cotangent . x_next`` with respect to its inputs.

        Parameters
        ----------
        x, u, d, p : array_like
            As for ``step``: one state (28,) or a batch (n, 28).
        cotangent : array_like
            In the shape of ``x``, or (28,) for all rows: weight of each state after the step.
        parameters : bool
            Whether to give the gradient with respect to the parameters as well.

        Returns
        -------
        x_next : ndarray
            State after the step, the same bits as from ``step``.
        gradient : Adjoint
            Gradients with respect to x, u, d and, if asked for, p.

        Raises
        ------
        ShapeError, ActionError, StepError
            As for ``step``; StepError also when a derivative is not finite.
        """
        rows = as_rows(x, u, d, p)
        one = np.ndim(x) == 1
        seeds = as_seeds("x", cotangent, len(rows.x), one=one, what="cotangent")
        if seeds.shape[1] != 1:
            msg = f"The cotangent has the shape {np.shape(cotangent)}; it must have that of x, {np.shape(x)}, or (28,)."
            raise ShapeError(msg)
        found = self.differentiator().reverse(rows, np.ascontiguousarray(seeds[:, 0]), parameters=parameters)
        self._check(rows, found.failed, list(found.gradients.values()))
        values = {key: table[0] if one else table for key, table in found.gradients.items()}
        gradient = Adjoint(values["x"], values["u"], values["d"], values.get("p"))
        return found.x_next[0] if one else found.x_next, gradient

    def _forward(self, rows: Rows, directions: Directions) -> Forward:
        found = self.differentiator().forward(rows, directions)
        self._check(rows, found.failed, [found.tangents])
        return found

    def _check(self, rows: Rows, failed: npt.NDArray[np.bool_], derivatives: Sequence[FloatArray]) -> None:
        """Raise StepError for rows that failed, or whose derivatives are not finite."""
        if failed.any():
            self._refuse(rows)
        if all(map(all_finite, derivatives)):
            return
        bad = [~np.isfinite(table).all(axis=tuple(range(1, table.ndim))) for table in derivatives]
        rows_without = np.flatnonzero(np.logical_or.reduce(bad))
        if rows_without.size:
            row = int(rows_without[0])
            msg = (
                f"The step of {self.step_seconds:g} s from row {row} of {len(rows.x)} has no finite derivative: an input lies "
                "where the model is not differentiable (a root at zero). Move it by a millionth of its size."
            )
            raise StepError(msg)

    def _refuse(self, rows: Rows) -> NoReturn:
        _, failures = self.advance(rows)
        reason = failures[0] if failures else StepFailure(0, "it could be stepped, but not differentiated")
        msg = f"The step of {self.step_seconds:g} s failed in row {reason.row} of {len(rows.x)}: {reason.reason}."
        raise StepError(msg)
