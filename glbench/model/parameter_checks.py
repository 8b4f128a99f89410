"""Checks of parameter values: what is impossible for one parameter, and for several together."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from glbench.errors import ParameterError, refuse
from glbench.model.parameter_table import ParameterInfo

ROUNDING = 1e-9
"""Excess of a sum of shares over 1 that counts as rounding [-]."""


@dataclass(frozen=True)
class Shares:
    """Parts of one whole: their sum cannot exceed 1."""

    whole: str
    parts: tuple[str, ...]


@dataclass(frozen=True)
class Order:
    """Two quantities of which the first must be the smaller one."""

    smaller: str
    larger: str
    reason: str


def check_value(info: ParameterInfo, value: float) -> None:
    """Refuse a value that the parameter cannot have. Raises ``ParameterError`` with the value, the unit and what is possible."""
    possible, words = {
        "fraction": (0 <= value <= 1, "between 0 and 1"),
        "positive": (value > 0, "above 0"),
        "nonnegative": (value >= 0, "not below 0"),
        "negative": (value < 0, "below 0"),
        "any": (True, "a number"),
    }[info.check]
    if not (possible and math.isfinite(value)):
        msg = f"Parameter {info.name} ({info.meaning}) cannot be {value:g} {info.unit}: it must be finite and {words}."
        if info.is_derived:
            msg += f" It follows from others: {info.name} = {info.formula}."
        raise ParameterError(msg)


def check_together(
    table: Sequence[ParameterInfo],
    vector: Sequence[float],
    changed: Collection[str],
    shares: Sequence[Shares] = (),
    orders: Sequence[Order] = (),
) -> None:
    """Refuse a complete ``vector`` of the entries of ``table`` that contradict each other, by ``shares`` and ``orders``.

    Shares are checked where one of them was ``changed`` from the named set: the published benchmark itself lets its thermal screen transmit
    0.75 and reflect 0.35 of the light, and its results rest on that. Raises ``ParameterError`` with the values that contradict each other.
    """
    values = {info.name: value for info, value in zip(table, vector, strict=True)}
    for whole in shares:
        total = sum(values[name] for name in whole.parts)
        if total > 1 + ROUNDING and not set(whole.parts).isdisjoint(changed):
            parts = " + ".join(f"{name} {values[name]:g}" for name in whole.parts)
            refuse(f"More than all of {whole.whole} would be used: {parts} = {total:g}. Their sum cannot exceed 1.", ParameterError)
    for order in orders:
        if not values[order.smaller] < values[order.larger]:
            msg = f"{order.smaller} ({values[order.smaller]:g}) must be below {order.larger} ({values[order.larger]:g}): {order.reason}."
            raise ParameterError(msg)
    for info in table:
        check_value(info, values[info.name])
