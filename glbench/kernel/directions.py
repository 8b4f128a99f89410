"""Directions in which a step is differentiated: those of a caller, checked, and one for every input."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from glbench.errors import ShapeError, UnknownNameError, did_you_mean
from glbench.kernel.records import FloatArray
from glbench.model import CONTROL_NAMES, DISTURBANCE_NAMES, PARAMETER_NAMES, STATE_NAMES

SIZES = {"x": len(STATE_NAMES), "u": len(CONTROL_NAMES), "d": len(DISTURBANCE_NAMES), "p": len(PARAMETER_NAMES)}
ORDER = ("u", "d", "p", "x")
"""Inputs in the order of ``all_directions``: states last, for vectors of directions that move states only are cheaper."""


@dataclass(frozen=True)
class Directions:
    """Directions of differentiation.

    Attributes
    ----------
    count : int
        How many for each row.
    shared : bool
        Whether all rows have the same.
    seeds : dict
        For each input ("x", "u", "d", "p") that is not held, a table (rows, or 1 when shared; count; size of the input).
    """

    count: int
    shared: bool
    seeds: dict[str, FloatArray]

    def of_rows(self, rows: npt.NDArray[np.intp]) -> Directions:
        """The directions of some rows."""
        chosen = self.seeds if self.shared else {key: table[rows] for key, table in self.seeds.items()}
        return Directions(self.count, self.shared, chosen)


def parameter_numbers(names: tuple[str, ...]) -> tuple[int, ...]:
    """Numbers of the parameters of those names; UnknownNameError where there is none."""
    for name in names:
        if name not in PARAMETER_NAMES:
            msg = f"The model has no parameter '{name}'.{did_you_mean(name, PARAMETER_NAMES)}"
            raise UnknownNameError(msg)
    return tuple(PARAMETER_NAMES.index(name) for name in names)


@lru_cache(maxsize=32)
def all_directions(parameters: tuple[int, ...]) -> Directions:
    """One direction for each state, control, disturbance and chosen parameter, shared by all rows."""
    sizes = widths(len(parameters))
    count, start = sum(sizes), 0
    seeds: dict[str, FloatArray] = {}
    for key, width in zip(ORDER, sizes, strict=True):
        if width:
            table = np.zeros((1, count, SIZES[key]))
            table[0, np.arange(start, start + width), parameters if key == "p" else np.arange(width)] = 1.0
            seeds[key] = table
        start += width
    return Directions(count, shared=True, seeds=seeds)


def widths(parameters: int) -> tuple[int, ...]:
    """How many directions ``all_directions`` has for each input, in ``ORDER``."""
    return SIZES["u"], SIZES["d"], parameters, SIZES["x"]


def as_seeds(key: str, values: npt.ArrayLike, count: int, *, one: bool, what: str = "direction") -> FloatArray:
    """A direction or cotangent as a table (rows, directions, size); ShapeError where it is none."""
    size = SIZES[key]
    try:
        table = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        msg = f"The {what} in {key} is not made of numbers ({error})."
        raise ShapeError(msg) from error
    shape = table.shape
    if shape == (size,):
        table = np.broadcast_to(table, (count, 1, size))
    elif one and table.ndim == 2 and shape[1] == size:
        table = table[None]
    elif not one and table.ndim in (2, 3) and shape[0] == count and shape[-1] == size:
        table = table.reshape(count, -1, size)
    else:
        wanted = f"({size},) or (m, {size})" if one else f"({size},), ({count}, {size}) or ({count}, m, {size})"
        msg = f"The {what} in {key} has the shape {shape}; expected {wanted}."
        raise ShapeError(msg)
    if not np.isfinite(table).all():
        msg = f"The {what} in {key} has values that are not finite."
        raise ShapeError(msg)
    return np.ascontiguousarray(table)


def directions_differ(counts: dict[str, int]) -> str:
    """Why directions with ``counts`` for each input do not go together, for an error."""
    if not counts:
        return "forward needs a direction: give at least one of dx, du, dd, dp."
    listed = ", ".join(f"d{key} {count}" for key, count in counts.items())
    return f"The numbers of directions differ ({listed}). Give every input as many, or leave it out to hold it."
