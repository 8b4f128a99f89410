"""What the kernel takes and gives: validated rows of inputs, and failures as sentences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from glbench.errors import ActionError, ShapeError
from glbench.kernel.finite import all_finite
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES

FloatArray: TypeAlias = npt.NDArray[np.float64]
Description: TypeAlias = dict[str, str | float]

_NAMES = {"x": STATE_NAMES, "u": CONTROL_NAMES, "d": DISTURBANCE_NAMES, "p": PARAMETER_NAMES}
_KINDS = {"x": "state", "u": "control", "d": "disturbance", "p": "parameter"}


@dataclass(frozen=True)
class StepFailure:
    """One row of a batch that could not be stepped.

    Attributes
    ----------
    row : int
        Position in the batch, from 0.
    reason : str
        A sentence: what went wrong, at which model time, with which controls and weather.
    """

    row: int
    reason: str


class Rows(NamedTuple):
    """Inputs of one control step for ``n`` greenhouses: finite, C-contiguous float64, controls within 0..1.

    Attributes
    ----------
    x, u, d : FloatArray
        States (n, 28), controls (n, 6) [fraction of capacity], disturbances (n, 10).
    p : FloatArray
        Parameters, (n, 208), or (1, 208) when all rows share them.
    """

    x: FloatArray
    u: FloatArray
    d: FloatArray
    p: FloatArray

    def part(self, first: int, last: int) -> Rows:
        """Rows ``first`` up to, not including, ``last``; shared parameters stay shared."""
        p = self.p if self.p.shape[0] == 1 else self.p[first:last]
        return Rows(self.x[first:last], self.u[first:last], self.d[first:last], p)


def as_rows(x: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike) -> Rows:
    """Check the inputs of a step and give them as rows; an input without a leading axis serves every row.

    Raises
    ------
    ShapeError
        When a shape does not fit, or a value is not finite; names the row and the variable.
    ActionError
        When a control lies outside 0..1.
    """
    states = _table("x", x)
    count = states.shape[0]
    rows = Rows(states, _every_row("u", u, count), _every_row("d", d, count), _table("p", p))
    if rows.p.shape[0] not in (1, count):
        raise ShapeError(_wrong_rows("p", rows.p.shape[0], count))
    for key, values in (("x", rows.x), ("u", rows.u), ("d", rows.d), ("p", rows.p)):
        if not all_finite(values):
            _refuse_non_finite(key, values)
    if count and not (np.minimum.reduce(rows.u, axis=None) >= 0.0 and np.maximum.reduce(rows.u, axis=None) <= 1.0):
        row, column = np.argwhere((rows.u < 0.0) | (rows.u > 1.0))[0]
        msg = (
            f"Control {CONTROL_NAMES[column]} of row {row} is {rows.u[row, column]!r}; controls are fractions of the "
            "installed capacity and must lie within 0..1. Clip the set points before the step."
        )
        raise ActionError(msg)
    return rows


def _table(key: str, values: npt.ArrayLike) -> FloatArray:
    width = len(_NAMES[key])
    try:
        table = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        msg = f"The {_KINDS[key]}s {key} are not numbers ({error}). Give {width} of them, or a table (rows, {width})."
        raise ShapeError(msg) from error
    if table.ndim not in (1, 2) or table.shape[-1] != width:
        msg = (
            f"The {_KINDS[key]}s {key} have the shape {np.shape(values)}; expected ({width},) or (rows, {width}), "
            f"in the order {_NAMES[key][0]}, {_NAMES[key][1]}, ... {_NAMES[key][-1]}."
        )
        raise ShapeError(msg)
    return table.reshape(-1, width)


def _every_row(key: str, values: npt.ArrayLike, count: int) -> FloatArray:
    table = _table(key, values)
    if table.shape[0] == count:
        return table
    if np.ndim(values) == 1:
        return np.repeat(table, count, axis=0)
    raise ShapeError(_wrong_rows(key, table.shape[0], count))


def _wrong_rows(key: str, got: int, count: int) -> str:
    return (
        f"The {_KINDS[key]}s {key} have {got} rows, but the states x have {count}. "
        f"Give one row for each state, or a single vector of {len(_NAMES[key])} for all."
    )


def _refuse_non_finite(key: str, values: FloatArray) -> None:
    """Raise for the first value that is NaN or infinite; huge finite values only overflowed the cheap test."""
    bad = np.argwhere(~np.isfinite(values))
    if bad.size == 0:
        return
    row, column = bad[0]
    others = f" ({len(bad)} such values in all)" if len(bad) > 1 else ""
    msg = (
        f"The {_KINDS[key]} {_NAMES[key][column]} of row {row} is {values[row, column]}{others}. "
        "Values that are not finite are never stepped: look for their origin, or drop the row."
    )
    raise ShapeError(msg)


def inputs_in_words(rows: Rows, row: int) -> str:
    """Model time, controls and weather of one row, for a failure's sentence."""
    controls = ", ".join(f"{name} {value:.3g}" for name, value in zip(CONTROL_NAMES, rows.u[row], strict=True))
    weather = dict(zip(DISTURBANCE_NAMES, rows.d[row], strict=True))
    day = rows.x[row, STATE_NAMES.index("time")]
    return (
        f"model time {day:.5f} days; controls {controls}; outside {weather['tOut']:.1f} °C, "
        f"{weather['iGlob']:.0f} W m-2, wind {weather['wind']:.1f} m s-1, vapour pressure {weather['vpOut']:.0f} Pa"
    )
