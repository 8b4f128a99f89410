"""Many control steps in one call: rollouts, linearised trajectories, gradients of whole horizons.

For season-long optimisation and model predictive control. Method and speed: docs/sensitivities.md, "Trajectories".
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from glbench.errors import ActionError, ShapeError, StepError, refuse
from glbench.kernel.environment import Program
from glbench.kernel.records import BoundStep, FloatArray, Names, Rows, StepFailure, all_finite
from glbench.kernel.sensitivities import ORDER, Differentiable, Reverse, all_directions, checked_inputs

_KINDS = {"x": "state", "u": "control", "d": "disturbance", "p": "parameter"}


@dataclass(frozen=True)
class Horizons:
    """Inputs of ``n`` horizons of T steps: finite float64, controls within 0..1.

    ``x`` (n, states) are the states at the start. ``u`` (n, T, controls) and ``d`` (n, T, disturbances) may share memory between horizons.
    ``p`` is (n or 1, T or 1, parameters): 1 where they are shared.
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

    Raises ``ShapeError`` when a shape does not fit, or a value is not finite, and ``ActionError`` when a control lies outside 0..1;
    both name horizon, step and variable.
    """
    inputs = {key: _numbers(key, values) for key, values in (("x", x0), ("u", u), ("d", d), ("p", p))}
    size = {key: len(names[key]) for key in inputs}
    x = inputs["x"]
    if x.ndim not in (1, 2) or x.shape[-1] != size["x"]:
        raise ShapeError(_wrong_shape("states x0", x.shape, f"({size['x']},) or (horizons, {size['x']})"))
    count = None if x.ndim == 1 else len(x)
    table = inputs["u"]
    if table.ndim not in (2, 3):
        expected = f"(steps, {size['u']})" + ("" if count is None else f" or ({count}, steps, {size['u']})")
        raise ShapeError(_wrong_shape("controls u", table.shape, expected))
    steps = table.shape[-2]
    tables = {key: by_horizon(f"{_KINDS[key]}s {key}", inputs[key], count, (steps, size[key]), finite=False) for key in "ud"}
    horizons = Horizons(np.atleast_2d(x), tables["u"], tables["d"], _parameters(inputs["p"], count, steps, size["p"]))
    for key, values in inputs.items():
        if all_finite(values):
            continue
        table = getattr(horizons, key)
        for horizon, *at, column in np.argwhere(~np.isfinite(table))[:1]:
            where = f"horizon {horizon}" + (f", step {at[0]}" if at else "")
            msg = (
                f"The {_KINDS[key]} {names[key][column]} of {where} is {table[(horizon, *at, column)]}: "
                "values that are not finite are never stepped."
            )
            raise ShapeError(msg)
    controls = horizons.u
    if controls.size and not (controls.min() >= 0.0 and controls.max() <= 1.0):
        horizon, step, column = np.argwhere((controls < 0.0) | (controls > 1.0))[0]
        msg = (
            f"Control {names['u'][column]} of horizon {horizon}, step {step} is {controls[horizon, step, column]}; "
            "controls are fractions of the installed capacity and must lie within 0..1. Clip them before the rollout."
        )
        raise ActionError(msg)
    return horizons


def by_horizon(what: str, values: npt.ArrayLike, count: int | None, shape: tuple[int, ...], *, finite: bool = True) -> FloatArray:
    """A table (horizons, *shape); ``count`` is None for one horizon without an axis. Raises ``ShapeError`` when ``values`` do not fit."""
    table = _numbers(what, values)
    if finite and not all_finite(table):
        refuse(f"The {what} of a rollout have values that are not finite.", ShapeError)
    if table.shape == shape:
        return np.broadcast_to(table, (1 if count is None else count, *shape))
    if count is not None and table.shape == (count, *shape):
        return table
    expected = f"{shape}" if count is None else f"{shape} for all horizons or {(count, *shape)}"
    raise ShapeError(_wrong_shape(what, table.shape, expected))


class StatesOnly(ABC):
    """What backends share that step rows and nothing else, and have nothing to build; see ``Backend`` for the methods."""

    @abstractmethod
    def advance(self, rows: Rows, out: FloatArray) -> list[StepFailure]:
        """Write x(t + h) of all rows to ``out``; a row that fails keeps its old state and is reported."""

    def bind(self, rows: Rows, out: FloatArray) -> BoundStep:
        """A step of these very rows without checks; see ``Kernel.bind``."""

        def step() -> None:
            failures = self.advance(rows, out)
            if failures:
                refuse(f"The step failed in row {failures[0].row} of {len(out)}: {failures[0].reason}.", StepError)

        return step

    def walk(self, horizons: Horizons, states: FloatArray) -> int:
        """Step all horizons in step; see ``Backend.walk``."""
        for step in range(horizons.steps):
            if self.advance(horizons.at(step, states[step]), states[step + 1]):
                return step
        return horizons.steps

    def prepare(self, p: FloatArray) -> None:  # noqa: B027  that there is nothing to do is the method
        """There is nothing to build."""

    def environments(self, program: Program, n: int) -> None:  # noqa: B027
        """None: such a backend has no environments."""


class DifferentiatesBySteps(ABC):
    """The methods of a ``Differentiator`` for whole horizons, step by step and in NumPy."""

    @abstractmethod
    def reverse(self, rows: Rows, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents (n, states) back."""

    def reverse_horizons(self, rows: Rows, steps: int, cotangents: FloatArray, *, parameters: bool) -> Reverse:
        """Step and pull cotangents back through horizons, step by step."""
        return reverse_by_steps(self.reverse, rows, steps, cotangents, parameters=parameters)

    def push(self, jacobians: FloatArray, along: FloatArray, first: FloatArray) -> FloatArray:
        """Changes of all states."""
        return push_by_steps(jacobians, along, first)

    def pull(self, jacobians: FloatArray, cotangents: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Costates and gradients of the inputs."""
        return pull_by_steps(jacobians, cotangents)


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
        refuse(f"The {_KINDS.get(key, key)}s {key} of a rollout are not a table of numbers ({error}).", ShapeError, error)


def _wrong_shape(what: str, shape: tuple[int, ...], expected: str) -> str:
    return f"The {what} of a rollout have the shape {shape}; expected {expected}."


class RolloutError(StepError):
    """A step of a rollout could not be integrated.

    It is ``step`` of ``horizon``, from 0; of several, the first of the earliest step. ``states`` are what all horizons had reached by then:
    (step + 1, states), or (n, step + 1, states) of a batch.
    """

    horizon: int
    step: int
    states: FloatArray


@dataclass(frozen=True)
class TrajectoryGradient:
    """Gradient of ``sum_t cotangents[t] . x[t]``; a batch has a leading axis of n everywhere.

    ``x0`` (states,), ``u`` (T, controls) and ``d`` (T, disturbances) are with respect to the state at the start, controls and disturbances
    [unit of the sum per unit of the input], without columns where the trajectory has no such derivatives. Horizons that share inputs have a
    gradient each: add them up for that of the shared input. ``p``, when it was asked for, is with respect to the parameters: (parameters,),
    or (T, parameters) where they differ by step. ``costates`` (T + 1, states) are for each state x[t], with its own cotangent.
    """

    x0: FloatArray
    u: FloatArray
    d: FloatArray
    p: FloatArray | None
    costates: FloatArray


@dataclass(frozen=True)
class Trajectory:
    """Consecutive control steps and their Jacobians, made by ``linearise_trajectory``; a batch has a leading axis of n everywhere.

    ``x`` (T + 1, states) are the states, with the same bits as from ``step``; ``inputs`` are with respect to what there are derivatives.
    ``jacobians`` are how the sweeps read them: (n, T, directions, states), directions in u, then d, then x. ``kernel`` made it.
    """

    x: FloatArray
    inputs: tuple[str, ...]
    jacobians: FloatArray
    kernel: Differentiable

    @property
    def dx(self) -> FloatArray:
        """Derivatives of x[t + 1] with respect to x[t] (T, states, states): a view, as are the others."""
        return self._columns("x")

    @property
    def du(self) -> FloatArray:
        """Those with respect to u[t] (T, states, controls); (T, states, 0) when they were not asked for."""
        return self._columns("u")

    @property
    def dd(self) -> FloatArray:
        """Those with respect to d[t] (T, states, disturbances); (T, states, 0) when they were not asked for."""
        return self._columns("d")

    def push(self, du: npt.ArrayLike | None = None, dx0: npt.ArrayLike | None = None, dd: npt.ArrayLike | None = None) -> FloatArray:
        """Changes of the states (T + 1, states) in their units, to first order, for changes of the inputs; the first is ``dx0``.

        ``du`` (T, controls), ``dd`` (T, disturbances) and ``dx0`` (states,), at the start, are the changes in their units; for a batch, one
        for all or with a leading axis of n. Inputs without one are held. Raises ``ShapeError`` when a shape does not fit, or there are no
        derivatives with respect to an input that changes.
        """
        tables = {"u": du, "d": dd}
        size, steps = self._sizes, self.jacobians.shape[1]
        for key, table in tables.items():
            if table is not None and key not in self.inputs:
                msg = f"There are no derivatives with respect to {key}: linearise_trajectory(..., inputs={(*self.inputs, key)}) has them."
                raise ShapeError(msg)
        moves = [
            by_horizon(f"changes d{key}", np.zeros((steps, size[key])) if table is None else table, self._count, (steps, size[key]))
            for key, table in tables.items()
        ]
        start = np.zeros(size["x"]) if dx0 is None else dx0
        first = by_horizon("changes dx0", start, self._count, (size["x"],))
        result = self.kernel.differentiator().push(self.jacobians, np.concatenate(moves, axis=2), first)
        return result[0] if self._count is None else result

    def pull(self, cotangents: npt.ArrayLike) -> TrajectoryGradient:
        """Gradient of ``sum_t cotangents[t] . x[t]``, to first order.

        ``cotangents`` are the weight of each state (T + 1, states); for a batch, one table for all or (n, T + 1, states). Raises
        ``ShapeError`` when the shape does not fit.
        """
        size, steps = self._sizes, self.jacobians.shape[1]
        table = by_horizon("cotangents", cotangents, self._count, (steps + 1, size["x"]))
        costates, along = self.kernel.differentiator().pull(self.jacobians, table)
        result = costates[:, 0], along[..., : size["u"]], along[..., size["u"] :], costates
        x0, u, d, costates = (a[0] for a in result) if self._count is None else result
        return TrajectoryGradient(x0, u, d, None, costates)

    @property
    def _count(self) -> int | None:
        return None if self.x.ndim == 2 else len(self.x)

    @property
    def _sizes(self) -> dict[str, int]:
        """How many directions there are in each input."""
        return {key: size if key in self.inputs else 0 for key, size in self.kernel.model.sizes.items()}

    def _columns(self, key: str) -> FloatArray:
        sizes, start = self._sizes, 0
        for other in ORDER[: ORDER.index(key)]:
            start += sizes[other]
        table = self.jacobians[:, :, start : start + sizes[key]].swapaxes(2, 3)
        return table[0] if self._count is None else table


class Trajectories(Differentiable):
    """A stepper that takes many steps at once.

    All calls take one horizon or a batch of them:

    ======================  ============================  =================================================
    input                   one horizon of T steps        batch of n horizons
    ======================  ============================  =================================================
    ``x0``                  (states,)                     (n, states)
    ``u``                   (T, controls)                 (T, controls) for all, or (n, T, controls)
    ``d``                   (T, disturbances)             (T, disturbances) for all, or (n, T, disturbances)
    ``p`` for all steps     (parameters,)                 (parameters,) for all, or (n, parameters)
    ``p`` by step           (T, parameters)               (n, T, parameters), or (1, T, parameters) for all
    ======================  ============================  =================================================

    The shape of ``x0`` decides which it is, so nothing is ambiguous: two axes of ``p`` are steps in one horizon and horizons in a
    batch, even where n = T.
    """

    @abstractmethod
    def walk(self, horizons: Horizons, states: FloatArray) -> int:
        """Step checked horizons: write ``states`` (T + 1, n, states), whose first is there; gives how many steps all of them took."""

    def rollout(self, x0: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike) -> FloatArray:
        """States (T + 1, states), or (n, T + 1, states) of a batch, along consecutive control steps; the first is ``x0``.

        They have the same bits as from ``step`` in a loop; controls are within 0..1, and the shapes of the inputs are as above. Raises
        ``ShapeError`` or ``ActionError`` when an input has the wrong shape or is not finite, or a control lies outside 0..1. Raises
        ``RolloutError`` when a step could not be integrated: a StepError with horizon, step and the states that were reached.
        """
        states = self._rollout(as_horizons(self.model.names, x0, u, d, p), one=np.ndim(x0) == 1)
        return states[0] if np.ndim(x0) == 1 else states

    def linearise_trajectory(
        self, x0: npt.ArrayLike, u: npt.ArrayLike, d: npt.ArrayLike, p: npt.ArrayLike, *, inputs: Sequence[str] = ("x", "u")
    ) -> Trajectory:
        """A rollout, as for ``rollout``, with the Jacobians of all its steps.

        ``inputs`` are which of ``"x"``, ``"u"`` and ``"d"`` to differentiate with respect to; ``"x"`` is always one. Jacobians take 8
        bytes times T times states times directions: 44 MB for 5,760 steps of the tomato model, in x and u. Raises ``ShapeError``,
        ``ActionError`` or ``RolloutError`` as for ``rollout``; ShapeError also when ``"x"`` is missing. Raises ``StepError`` when a
        derivative is not finite, and ``UnknownNameError`` when there is no such input.
        """
        keys = checked_inputs(inputs)
        if "x" not in keys:
            refuse(f'A trajectory is linearised with respect to its states: add "x" to the inputs {keys}.', ShapeError)
        one = np.ndim(x0) == 1
        horizons = as_horizons(self.model.names, x0, u, d, p)
        x = self._rollout(horizons, one=one)
        rows = horizons.rows(x)
        result = self.differentiator().forward(rows, all_directions(tuple(self.model.sizes.items()), (), keys))
        self._check(rows, result.failed, [result.tangents], steps=horizons.steps)
        jacobians = result.tangents.reshape(horizons.count, horizons.steps, *result.tangents.shape[1:])
        return Trajectory(x[0] if one else x, keys, jacobians, self)

    def rollout_adjoint(
        self,
        x0: npt.ArrayLike,
        u: npt.ArrayLike,
        d: npt.ArrayLike,
        p: npt.ArrayLike,
        cotangents: npt.ArrayLike,
        *,
        parameters: bool = False,
    ) -> tuple[FloatArray, TrajectoryGradient]:
        """A rollout and the gradient of ``sum_t cotangents[t] . x[t]`` with respect to its inputs; keeps states, no Jacobians.

        The inputs are as for ``rollout``. ``cotangents`` are the weight of each state (T + 1, states); for a batch, one table for all or
        (n, T + 1, states). Returns the states, as from ``rollout``, and the gradients with respect to x0, u, d and, with ``parameters``, p,
        and the costates. Raises errors as ``rollout``, and ``StepError`` for a derivative that is not finite.
        """
        one = np.ndim(x0) == 1
        horizons = as_horizons(self.model.names, x0, u, d, p)
        n, steps = horizons.count, horizons.steps
        table = by_horizon("cotangents", cotangents, None if one else n, (steps + 1, horizons.x.shape[1]))
        x = self._rollout(horizons, one=one)
        rows = horizons.rows(x)
        ends = table[:, 1:].reshape(rows.x.shape)
        result = self.differentiator().reverse_horizons(rows, steps, ends, parameters=parameters)
        self._check(rows, result.failed, list(result.gradients.values()), steps=steps)
        gradients = {key: a.reshape(n, steps, a.shape[1]) for key, a in result.gradients.items()}
        costates = table.copy()
        costates[:, :-1] += gradients["x"]
        x0, own_u, own_d, costates = (a[0] if one else a for a in (costates[:, 0], gradients["u"], gradients["d"], costates))
        own_p = None
        if parameters:
            by_step = np.ndim(p) == (2 if one else 3)
            own_p = gradients["p"] if by_step else gradients["p"].sum(axis=1)
            own_p = own_p[0] if one else own_p
        return (x[0] if one else x), TrajectoryGradient(x0, own_u, own_d, own_p, costates)

    def _rollout(self, horizons: Horizons, *, one: bool) -> FloatArray:
        """States (n, T + 1, states)."""
        states = np.empty((horizons.steps + 1, *horizons.x.shape))
        states[0] = horizons.x
        step = self.walk(horizons, states)
        reached = np.ascontiguousarray(states[: step + 1].swapaxes(0, 1))
        if step < horizons.steps:
            _, failures = self.advance(horizons.at(step, states[step]))
            horizon, reason = failures[0].row, failures[0].reason
            of = f"horizon {horizon} of {horizons.count}, step {step} of {horizons.steps}"
            error = RolloutError(f"The rollout failed in {of} of {self.step_seconds:g} s: {reason}.")
            error.horizon, error.step, error.states = horizon, step, reached[0] if one else reached
            raise error
        return reached


def reverse_by_steps(reverse: Callable[..., Reverse], rows: Rows, steps: int, cotangents: FloatArray, *, parameters: bool) -> Reverse:
    """``Differentiator.reverse_horizons`` by calls of its ``reverse``, one a step."""
    count = len(rows.x)
    firsts = np.arange(0, count, max(steps, 1))
    x_next, failed = np.empty_like(rows.x), np.zeros(count, dtype=np.bool_)
    sizes = {key: table.shape[1] for key, table in rows._asdict().items() if parameters or key != "p"}
    gradients = {key: np.zeros((count, size)) for key, size in sizes.items()}
    costates = cotangents.copy()
    for step in reversed(range(steps)):
        now = firsts + step
        result = reverse(rows.take(now), costates[now], parameters=parameters)
        for key, gradient in result.gradients.items():
            gradients[key][now] = gradient
        x_next[now], failed[now] = result.x_next, result.failed
        if step:
            costates[now - 1] += result.gradients["x"]
    return Reverse(x_next, gradients, failed)


def push_by_steps(jacobians: FloatArray, along: FloatArray, first: FloatArray) -> FloatArray:
    """``Differentiator.push`` in NumPy."""
    n, steps, _, size = jacobians.shape
    changes = np.empty((n, steps + 1, size))
    changes[:, 0] = first
    for step in range(steps):
        directions = np.concatenate([along[:, step], changes[:, step]], axis=1)
        changes[:, step + 1] = np.einsum("nm,nms->ns", directions, jacobians[:, step])
    return changes


def pull_by_steps(jacobians: FloatArray, cotangents: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``Differentiator.pull`` in NumPy."""
    n, steps, directions, size = jacobians.shape
    costates, along = cotangents.copy(), np.empty((n, steps, directions - size))
    for step in reversed(range(steps)):
        gradient = np.einsum("nms,ns->nm", jacobians[:, step], costates[:, step + 1])
        along[:, step] = gradient[:, : directions - size]
        costates[:, step] += gradient[:, directions - size :]
    return costates, along
