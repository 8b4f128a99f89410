"""What the kernel takes and gives: checked rows of inputs, and failures as sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from glbench.errors import ActionError, ShapeError, refuse
from glbench.model import Model
from glbench.model.model import refuse_expression

FloatArray: TypeAlias = npt.NDArray[np.float64]
Description: TypeAlias = dict[str, str | float]
Names: TypeAlias = Mapping[str, tuple[str, ...]]
"""Names of the entries of x, u, d and p: ``Model.names``."""

_KINDS = {"x": "state", "u": "control", "d": "disturbance", "p": "parameter"}
_PRODUCT_SIZE = 8192
"""Up to here numpy's linear algebra takes a product without threads. Those it starts beyond go on spinning for their next task,
and took the other processors from whoever used them."""


@dataclass(frozen=True)
class StepFailure:
    """The ``row`` of a batch, from 0, that could not be stepped.

    The ``reason`` is a sentence: what went wrong, at which model time, with which controls and disturbances.
    """

    row: int
    reason: str


class Rows(NamedTuple):
    """Inputs of one control step for ``n`` greenhouses: finite, C-contiguous float64, controls within 0..1.

    ``x`` (n, states), ``u`` (n, controls) [fraction of capacity], ``d`` (n, disturbances), ``p`` (n, parameters) or shared (1, parameters).
    """

    x: FloatArray
    u: FloatArray
    d: FloatArray
    p: FloatArray

    def take(self, which: npt.NDArray[np.intp]) -> Rows:
        """Some of the rows; shared parameters stay shared."""
        return Rows(self.x[which], self.u[which], self.d[which], self.p if len(self.p) == 1 else self.p[which])


class BoundStep(Protocol):
    """One control step of the arrays that it was made for, as they are at the time of the call.

    Rows that fail keep their state in ``out``, the others are stepped.
    Raises ``StepError`` when a row could not be integrated, or an input is not finite.
    """

    def __call__(self) -> None:
        """Step the rows."""


def all_finite(values: npt.NDArray[np.floating[Any]]) -> bool:
    """Whether no value is infinite or not a number. Finite values beyond 1e150 may count as infinite."""
    if values.size <= _PRODUCT_SIZE:
        # A sum of squares is not finite as soon as one value is not: one pass, no temporary array, no warning.
        return math.isfinite(np.vdot(values, values))
    return bool(np.isfinite(values).all())


def as_rows(names: Names, x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike) -> Rows:
    """Check the inputs of a step and give them as rows; an input without a leading axis serves every row.

    Raises ``ShapeError`` when a shape does not fit, or a value is not finite, and ``ActionError`` when a control lies outside 0..1;
    both name the row and the variable.
    """
    states = _table(names, "x", x)
    count = states.shape[0]
    rows = Rows(states, _every_row(names, "u", u, count), _every_row(names, "d", d, count), _table(names, "p", p))
    if rows.p.shape[0] not in (1, count):
        raise ShapeError(_wrong_rows(names, "p", rows.p.shape[0], count))
    for key, values in (("x", rows.x), ("u", rows.u), ("d", rows.d), ("p", rows.p)):
        if all_finite(values):
            continue
        bad = np.argwhere(~np.isfinite(values))
        if bad.size:  # else huge finite values only overflowed the cheap test
            row, column = bad[0]
            others = f" ({len(bad)} such values in all)" if len(bad) > 1 else ""
            msg = (
                f"The {_KINDS[key]} {names[key][column]} of row {row} is {values[row, column]}{others}. "
                "Values that are not finite are never stepped: look for their origin, or drop the row."
            )
            raise ShapeError(msg)
    if rows.u.size and not (np.minimum.reduce(rows.u, axis=None) >= 0.0 and np.maximum.reduce(rows.u, axis=None) <= 1.0):
        row, column = np.argwhere((rows.u < 0.0) | (rows.u > 1.0))[0]
        msg = (
            f"Control {names['u'][column]} of row {row} is {rows.u[row, column]}; controls are fractions of the "
            "installed capacity and must lie within 0..1. Clip the set points before the step."
        )
        raise ActionError(msg)
    return rows


def bound_rows(names: Names, x: FloatArray, u: FloatArray, d: FloatArray, p: FloatArray, out: FloatArray) -> tuple[Rows, FloatArray]:
    """The same memory as rows (n, ·) and results (n, states). Raises ``ShapeError`` for other shapes and types, or read-only results."""
    count = len(x) if np.ndim(x) == 2 else 1
    arrays = {"x": x, "u": u, "d": d, "p": p, "out": out}
    tables = []
    for name, array in arrays.items():
        width = len(names["x" if name == "out" else name])
        single = count == 1 or name == "p"
        shapes = ((count, width), (1, width), (width,)) if single else ((count, width),)
        usable = isinstance(array, np.ndarray) and array.dtype == np.float64 and array.flags.c_contiguous
        if not (usable and array.shape in shapes and (name != "out" or array.flags.writeable)):
            got = f"{getattr(array, 'dtype', type(array).__name__)}{np.shape(array)}"
            msg = (
                f"A bound step works in the caller's memory: {name} must be a C-contiguous float64 array of the shape "
                f"{' or '.join(map(str, shapes))}{', writeable' if name == 'out' else ''}, not {got}."
            )
            raise ShapeError(msg)
        tables.append(array.reshape(1, width) if array.ndim == 1 else array)
    *inputs, result = tables
    return Rows(*inputs), result


def inputs_in_words(model: Model, rows: Rows, row: int) -> str:
    """Model time (a state in days), controls and disturbances of one row, for a failure's sentence."""
    days = [value for entry, value in zip(model.states, rows.x[row], strict=True) if entry.unit == "day"]
    controls = ", ".join(f"{name} {value:.3g}" for name, value in zip(model.control_names, rows.u[row], strict=True))
    outside = ", ".join(
        f"{entry.name} {value:.4g}{'' if entry.unit == '-' else f' {entry.unit}'}"
        for entry, value in zip(model.disturbances, rows.d[row], strict=True)
    )
    return "; ".join([*(f"model time {day:.5f} days" for day in days), f"controls {controls}", f"outside {outside}"])


def _table(names: Names, key: str, values: npt.ArrayLike) -> FloatArray:
    width = len(names[key])
    refuse_expression(f"The {_KINDS[key]}s {key}", values)
    try:
        table = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        refuse(f"The {_KINDS[key]}s {key} are not numbers ({error}). Give {width} of them, or a table (rows, {width}).", ShapeError, error)
    if table.ndim not in (1, 2) or table.shape[-1] != width:
        listed = names[key] if width <= 3 else (*names[key][:2], "...", names[key][-1])
        msg = (
            f"The {_KINDS[key]}s {key} have the shape {np.shape(values)}; expected ({width},) or (rows, {width}), "
            f"in the order {', '.join(listed)}."
        )
        raise ShapeError(msg)
    return table.reshape(1, width) if table.ndim == 1 else table


def _every_row(names: Names, key: str, values: npt.ArrayLike, count: int) -> FloatArray:
    table = _table(names, key, values)
    if table.shape[0] == count:
        return table
    if np.ndim(values) == 1:
        return np.repeat(table, count, axis=0)
    raise ShapeError(_wrong_rows(names, key, table.shape[0], count))


def _wrong_rows(names: Names, key: str, got: int, count: int) -> str:
    return (
        f"The {_KINDS[key]}s {key} have {got} rows, but the states x have {count}. "
        f"Give one row for each state, or a single vector of {len(names[key])} for all."
    )
