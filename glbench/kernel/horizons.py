"""Inputs of consecutive control steps: one horizon or a batch of them, checked once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glbench.errors import ActionError, ShapeError
from glbench.kernel.records import FloatArray, Names, Rows, StepFailure, all_finite

_KINDS = {"x": "state", "u": "control", "d": "disturbance", "p": "parameter"}


@dataclass(frozen=True)
class Horizons:
    """Inputs of ``n`` horizons of T steps: finite float64, controls within 0..1.

    Attributes
    ----------
    x : FloatArray
        States at the start (n, states).
    u, d : FloatArray
        Controls (n, T, controls) and disturbances (n, T, disturbances); horizons may share memory.
    p : FloatArray
        Parameters (n or 1, T or 1, parameters): 1 where they are shared.
    """

    x: FloatArray
    u: FloatArray
    d: FloatArray
    p: FloatArray

    @property
    def count(self) -> int:
        """How many horizons, n."""
        return len(self.x)

    @property
    def steps(self) -> int:
        """How many steps each has, T."""
        return int(self.u.shape[1])

    def at(self, step: int, x: FloatArray) -> Rows:
        """Rows (n) of one step from the states ``x``."""
        p = self.p[:, step if self.p.shape[1] > 1 else 0]
        return Rows(x, *(np.ascontiguousarray(table) for table in (self.u[:, step], self.d[:, step], p)))

    def rows(self, states: FloatArray) -> Rows:
        """All steps as rows, horizon after horizon, from the states (n, T + 1, states) that a rollout reached."""
        shared = self.p.shape[:2] == (1, 1)
        p = self.p if shared else np.broadcast_to(self.p, (self.count, self.steps, self.p.shape[2]))
        tables = [np.ascontiguousarray(a) for a in (states[:, :-1], self.u, self.d, p)]
        return Rows(*(a.reshape(a.shape[0] * a.shape[1], a.shape[2]) for a in tables))


def as_horizons(names: Names, x0: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike) -> Horizons:
    """Check the inputs of a rollout.

    Raises
    ------
    ShapeError
        When a shape does not fit, or a value is not finite; names horizon, step and variable.
    ActionError
        When a control lies outside 0..1.
    """
    given = {key: _numbers(key, values) for key, values in (("x", x0), ("u", u), ("d", d), ("p", p))}
    size = {key: len(names[key]) for key in given}
    x = given["x"]
    if x.ndim not in (1, 2) or x.shape[-1] != size["x"]:
        raise ShapeError(_wrong_shape("states x0", x.shape, f"({size['x']},) or (horizons, {size['x']})"))
    count = None if x.ndim == 1 else len(x)
    table = given["u"]
    if table.ndim not in (2, 3):
        wanted = f"(steps, {size['u']})" + ("" if count is None else f" or ({count}, steps, {size['u']})")
        raise ShapeError(_wrong_shape("controls u", table.shape, wanted))
    steps = table.shape[-2]
    tables = {key: by_horizon(f"{_KINDS[key]}s {key}", given[key], count, (steps, size[key])) for key in "ud"}
    horizons = Horizons(np.atleast_2d(x), tables["u"], tables["d"], _parameters(given["p"], count, steps, size["p"]))
    for key, values in given.items():
        if not all_finite(values):
            _refuse_non_finite(names, key, getattr(horizons, key))
    controls = horizons.u
    if controls.size and not (controls.min() >= 0.0 and controls.max() <= 1.0):
        horizon, step, column = np.argwhere((controls < 0.0) | (controls > 1.0))[0]
        msg = (
            f"Control {names['u'][column]} of horizon {horizon}, step {step} is {controls[horizon, step, column]!r}; "
            "controls are fractions of the installed capacity and must lie within 0..1. Clip them before the rollout."
        )
        raise ActionError(msg)
    return horizons


def by_horizon(what: str, values: npt.ArrayLike, count: int | None, shape: tuple[int, ...]) -> FloatArray:
    """A table (horizons, *shape); ``count`` is None for one horizon without an axis of its own.

    Raises
    ------
    ShapeError
        When ``values`` have neither ``shape`` nor, in a batch, (count, *shape).
    """
    table = _numbers(what, values)
    if table.shape == shape:
        return np.broadcast_to(table, (1 if count is None else count, *shape))
    if count is not None and table.shape == (count, *shape):
        return table
    wanted = f"{shape}" if count is None else f"{shape} for all horizons or {(count, *shape)}"
    raise ShapeError(_wrong_shape(what, table.shape, wanted))


def walk(advance: Callable[[Rows, FloatArray], list[StepFailure]], horizons: Horizons, states: FloatArray) -> int:
    """Step all horizons in step and write ``states`` (T + 1, n, states), the first of which are there; gives how many steps succeeded."""
    for step in range(horizons.steps):
        if advance(horizons.at(step, states[step]), states[step + 1]):
            return step
    return horizons.steps


def _parameters(p: FloatArray, count: int | None, steps: int, size: int) -> FloatArray:
    """(n or 1, T or 1, parameters)."""
    if p.shape == (size,):
        return p[None, None]
    if count is None and p.shape == (steps, size):
        return p[None]
    if count is not None and p.shape == (count, size):
        return p[:, None]
    if count is not None and p.shape in ((count, steps, size), (1, steps, size)):
        return p
    by_horizon = f"({size},) or ({steps}, {size}), one row a step"
    in_batch = f"({size},), ({count}, {size}), one row a horizon, or ({count} or 1, {steps}, {size}), one row a step"
    raise ShapeError(_wrong_shape("parameters p", p.shape, by_horizon if count is None else in_batch))


def _numbers(key: str, values: npt.ArrayLike) -> FloatArray:
    try:
        return np.asarray(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        msg = f"The {_KINDS.get(key, key)}s {key} of a rollout are not a table of numbers ({error})."
        raise ShapeError(msg) from error


def _wrong_shape(what: str, found: tuple[int, ...], wanted: str) -> str:
    return f"The {what} of a rollout have the shape {found}; expected {wanted}."


def _refuse_non_finite(names: Names, key: str, values: FloatArray) -> None:
    bad = np.argwhere(~np.isfinite(values))
    if bad.size == 0:
        return
    horizon, *step, column = bad[0]
    where = f"horizon {horizon}" + (f", step {step[0]}" if step else "")
    msg = f"The {_KINDS[key]} {names[key][column]} of {where} is {values[tuple(bad[0])]}: values that are not finite are never stepped."
    raise ShapeError(msg)
