"""Derivatives of one control step: along directions, in reverse, or all of them as matrices.

They are those of the numerical step with its substeps held where they are, exact to rounding. Where the model has a kink (a
minimum, a maximum, a condition) they belong to the branch that the step took. Method, accuracy, speed: docs/sensitivities.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from glbench.errors import ShapeError, StepError, UnknownNameError, did_you_mean, refuse
from glbench.kernel.records import FloatArray, Rows, StepFailure, all_finite, as_rows
from glbench.model import Model

ORDER = ("u", "d", "p", "x")
"""Inputs in the order of ``all_directions``: states last, for vectors of directions that move states only are cheaper."""

INPUTS = ("x", "u", "d")
"""Inputs with respect to which ``linearise`` differentiates when nothing is said; parameters are asked for by name."""


@dataclass(frozen=True)
class Linearisation:
    """A control step and its Jacobians; a batch has a leading axis of n everywhere.

    ``x_next`` (states,) has the same bits as from ``step``. ``dx`` (states, states), ``du`` (states, controls) and ``dd`` (states,
    disturbances) are its derivatives with respect to states, controls and disturbances; element [i, j] is in units of state i per unit of
    input j. One that was not asked for has no columns: (states, 0). ``dp`` (states, q) is that for the parameters asked for, in order.
    """

    x_next: FloatArray
    dx: FloatArray
    du: FloatArray
    dd: FloatArray
    dp: FloatArray


@dataclass(frozen=True)
class Adjoint:
    """Gradient of ``cotangent . x_next`` with respect to the inputs of a step; a batch has a leading axis of n everywhere.

    ``x`` (states,), ``u`` (controls,), ``d`` (disturbances,) and, when it was asked for, ``p`` (parameters,) [unit of ``cotangent .
    x_next`` per unit of the input]. Rows that share inputs have a gradient each: add them up for that of the shared input.
    """

    x: FloatArray
    u: FloatArray
    d: FloatArray
    p: FloatArray | None


@dataclass(frozen=True)
class Directions:
    """Directions of differentiation: ``count`` for each row, ``shared`` when all rows have the same.

    ``seeds`` has for each input ("x", "u", "d", "p") that is not held a table (rows, or 1 when shared; count; size of the input).
    """

    count: int
    shared: bool
    seeds: dict[str, FloatArray]

    def of_rows(self, rows: npt.NDArray[np.intp]) -> Directions:
        """The directions of some rows."""
        seeds = self.seeds if self.shared else {key: table[rows] for key, table in self.seeds.items()}
        return Directions(self.count, self.shared, seeds)


class Forward(NamedTuple):
    """States (n, states), their derivatives along each direction (n, m, states), and which rows failed (n,)."""

    x_next: FloatArray
    tangents: FloatArray
    failed: npt.NDArray[np.bool_]


class Reverse(NamedTuple):
    """States (n, states), the gradient for each input (n, size of the input), and which rows failed (n,)."""

    x_next: FloatArray
    gradients: dict[str, FloatArray]
    failed: npt.NDArray[np.bool_]


class Differentiator(Protocol):
    """How a backend differentiates checked rows. Row i has the same bits whatever the other rows are."""

    def forward(self, rows: Rows, directions: Directions) -> Forward:
        """Step and differentiate along directions."""

    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, states) back; the gradient for the parameters is only there when asked for."""

    def reverse_horizons(self, rows: Rows, steps: int, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """The same through horizons of ``steps`` rows each; what comes from a row is added to the cotangent of the row before."""

    def push(self, jacobians: FloatArray, along: FloatArray, first: FloatArray) -> FloatArray:
        """Changes of all states (n, T + 1, states) from those of the inputs ``along`` (n, T, moves) and of the first states.

        ``jacobians`` (n, T, moves + states, states) hold what each direction does, those in inputs before those in states.
        """

    def pull(self, jacobians: FloatArray, cotangents: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Costates (n, T + 1, states) and gradients of the inputs (n, T, moves) from cotangents (n, T + 1, states)."""


class Differentiable(ABC):
    """A stepper with derivatives; the first call may build a library for some ten seconds."""

    model: Model
    step_seconds: float

    @abstractmethod
    def advance(self, rows: Rows) -> tuple[FloatArray, list[StepFailure]]:
        """Step checked rows."""

    @abstractmethod
    def differentiator(self) -> Differentiator:
        """What differentiates the steps of this stepper."""

    def linearise(
        self,
        x: npt.ArrayLike,
        u: npt.ArrayLike,
        d: npt.ArrayLike,
        p: npt.ArrayLike,
        *,
        inputs: Sequence[str] = INPUTS,
        parameters: Sequence[str] = (),
    ) -> Linearisation:
        """One control step and its Jacobians, of one state or a batch, as for ``step``.

        ``inputs`` are which of ``"x"``, ``"u"`` and ``"d"`` to differentiate with respect to; the fewer, the cheaper. ``parameters`` are
        names of parameters to differentiate with respect to, see ``Model.parameter_names``. Raises ``ShapeError``, ``ActionError`` or
        ``StepError`` as for ``step``, StepError also when a derivative is not finite, and ``UnknownNameError`` for an unknown name.
        """
        rows = as_rows(self.model.names, x, u, d, p)
        names = self.model.parameter_names
        for name in parameters:
            if name not in names:
                refuse(f"The model has no parameter '{name}'.{did_you_mean(name, names)}", UnknownNameError)
        numbers = tuple(map(names.index, parameters))
        sizes = self.model.sizes
        keys = checked_inputs(inputs)
        result = self._forward(rows, all_directions(tuple(sizes.items()), numbers, keys))
        widths = {**{key: sizes[key] if key in keys else 0 for key in INPUTS}, "p": len(numbers)}
        table = np.ascontiguousarray(result.tangents.swapaxes(1, 2))
        bounds = np.cumsum([widths[key] for key in ORDER])[:-1]
        by_key = dict(zip(ORDER, map(np.ascontiguousarray, np.split(table, bounds, axis=-1)), strict=True))
        values = [result.x_next, *(by_key[key] for key in sizes)]
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
        """One control step, as for ``step``, and how its result changes along directions of the inputs.

        ``dx``, ``du``, ``dd`` and ``dp`` are the direction in each input, in its units; inputs without one are held. For one state it is
        (size,), or (m, size) for m directions at once; for a batch (size,) for all rows, (n, size), (n, m, size), or (1, m, size) for all
        rows. Returns the state after the step, and its derivative along the direction in the same shape, or with an axis of m before the
        last one. Raises ``ShapeError``, ``ActionError`` or ``StepError`` as for ``step``; StepError also when a derivative is not finite.
        """
        rows = as_rows(self.model.names, x, u, d, p)
        one = np.ndim(x) == 1
        seeds = {"x": dx, "u": du, "d": dd, "p": dp}
        tables = {key: self._seeds(key, seed, len(rows.x), one=one) for key, seed in seeds.items() if seed is not None}
        counts = {table.shape[1] for table in tables.values()}
        if not counts:
            refuse("forward needs a direction: give at least one of dx, du, dd, dp.", ShapeError)
        if len(counts) > 1:
            listed = ", ".join(f"d{key} {table.shape[1]}" for key, table in tables.items())
            refuse(f"The numbers of directions differ ({listed}). Give every input as many, or leave it out to hold it.", ShapeError)
        shared = all(len(table) == 1 for table in tables.values())
        if not shared:
            tables = {key: np.ascontiguousarray(_for_each(table, len(rows.x))) for key, table in tables.items()}
        result = self._forward(rows, Directions(counts.pop(), shared=shared, seeds=tables))
        several = any(np.ndim(seed) == (2 if one else 3) for seed in seeds.values() if seed is not None)
        tangents = result.tangents if several else result.tangents[:, 0]
        return (result.x_next[0], tangents[0]) if one else (result.x_next, tangents)

    def adjoint(
        self, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike, cotangent: npt.ArrayLike, *, parameters: bool = False
    ) -> tuple[FloatArray, Adjoint]:
        """One control step, as for ``step``, and the gradient of ``cotangent . x_next`` with respect to its inputs.

        ``cotangent`` is the weight of each state after the step, in the shape of ``x``, or (states,) for all rows. Returns the state after
        the step, with the same bits as from ``step``, and the gradients with respect to x, u, d and, with ``parameters``, p. Raises
        ``ShapeError``, ``ActionError`` or ``StepError`` as for ``step``; StepError also when a derivative is not finite.
        """
        rows = as_rows(self.model.names, x, u, d, p)
        one = np.ndim(x) == 1
        seeds = self._seeds("x", cotangent, len(rows.x), one=one, what="cotangent")
        if seeds.shape[1] != 1:
            msg = f"The cotangent has the shape {np.shape(cotangent)}; it must have that of x, {np.shape(x)}, or ({rows.x.shape[1]},)."
            raise ShapeError(msg)
        cotangents = np.ascontiguousarray(_for_each(seeds[:, 0], len(rows.x)))
        result = self.differentiator().reverse(rows, cotangents, parameters=parameters)
        self._check(rows, result.failed, list(result.gradients.values()))
        values = {key: table[0] if one else table for key, table in result.gradients.items()}
        gradient = Adjoint(values["x"], values["u"], values["d"], values.get("p"))
        return result.x_next[0] if one else result.x_next, gradient

    def _seeds(self, key: str, values: npt.ArrayLike, count: int, *, one: bool, what: str = "direction") -> FloatArray:
        """A direction or cotangent as a table (rows, or 1 when shared; directions; size); ShapeError where it is none."""
        size = self.model.sizes[key]
        try:
            table = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError) as error:
            refuse(f"The {what} in {key} is not made of numbers ({error}).", ShapeError, error)
        shape = table.shape
        if shape == (size,):
            table = table[None, None]
        elif one and table.ndim == 2 and shape[1] == size:
            table = table[None]
        elif not one and shape[-1:] == (size,) and (shape[:-1] == (count,) or (table.ndim == 3 and shape[0] in (1, count))):
            table = table[:, None] if table.ndim == 2 else table
        else:
            expected = f"({size},) or (m, {size})" if one else f"({size},), ({count}, {size}) or ({count}, m, {size})"
            refuse(f"The {what} in {key} has the shape {shape}; expected {expected}.", ShapeError)
        if not np.isfinite(table).all():
            refuse(f"The {what} in {key} has values that are not finite.", ShapeError)
        return np.ascontiguousarray(table)

    def _forward(self, rows: Rows, directions: Directions) -> Forward:
        result = self.differentiator().forward(rows, directions)
        self._check(rows, result.failed, [result.tangents])
        return result

    def _check(self, rows: Rows, failed: npt.NDArray[np.bool_], derivatives: Sequence[FloatArray], *, steps: int = 0) -> None:
        """Raise StepError for rows, or horizons of ``steps`` each, with step, that failed or have derivatives that are not finite."""
        if failed.any():
            _, failures = self.advance(rows)
            reason = failures[0] if failures else StepFailure(0, "it could be stepped, but not differentiated")
            refuse(f"The step of {self.step_seconds:g} s failed in row {reason.row} of {len(rows.x)}: {reason.reason}.", StepError)
        if all(map(all_finite, derivatives)):
            return
        bad = [~np.isfinite(table).all(axis=tuple(range(1, table.ndim))) for table in derivatives]
        rows_without = np.flatnonzero(np.logical_or.reduce(bad))
        if rows_without.size:
            row = int(rows_without[0])
            where = f"horizon {row // steps}, step {row % steps}" if steps else f"row {row} of {len(rows.x)}"
            msg = (
                f"The step of {self.step_seconds:g} s from {where} has no finite derivative: an input lies "
                "where the model is not differentiable (a root at zero). Move it by a millionth of its size."
            )
            raise StepError(msg)


def checked_inputs(inputs: Sequence[str]) -> tuple[str, ...]:
    """The inputs to differentiate with respect to; UnknownNameError where one is none of ``INPUTS``."""
    for name in inputs:
        if name not in INPUTS:
            msg = f"There is no input '{name}' to differentiate with respect to: choose from x, u, d. Parameters are asked for by name."
            raise UnknownNameError(msg)
    return tuple(inputs)


@lru_cache(maxsize=32)
def all_directions(sizes: tuple[tuple[str, int], ...], parameters: tuple[int, ...], inputs: tuple[str, ...] = INPUTS) -> Directions:
    """One direction for each entry of the chosen inputs and for each chosen parameter, shared by all rows."""
    size = dict(sizes)
    widths = {key: size[key] if key in inputs else 0 for key in INPUTS} | {"p": len(parameters)}
    count, start = sum(widths.values()), 0
    seeds: dict[str, FloatArray] = {}
    for key in ORDER:
        if widths[key]:
            table = np.zeros((1, count, size[key]))
            columns = parameters if key == "p" else np.arange(size[key])
            table[0, np.arange(start, start + widths[key]), columns] = 1.0
            seeds[key] = table
        start += widths[key]
    return Directions(count, shared=True, seeds=seeds)


def _for_each(table: FloatArray, count: int) -> FloatArray:
    """A table with a leading axis of ``count``, without a copy; one of 1 is repeated."""
    return np.broadcast_to(table, (count, *table.shape[1:]))
