"""The reward of every step of a trajectory and the air along it, with gradients, by the formulas of the task's program; no weather."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glbench.arrays import Floats
from glbench.env import REWARDS
from glbench.env.air import AIR, air_quantities
from glbench.env.program import calendar_columns, info_columns, record_quantities
from glbench.env.spaces import the_task
from glbench.errors import GlbenchError, ShapeError, TaskError, UnknownNameError, refuse
from glbench.kernel.tape import Read, Recorder, Source, TapeDerivatives, Target
from glbench.model import Model
from glbench.tasks import TaskSpec


@dataclass(frozen=True, eq=False)
class StageValues:
    """What the steps of a trajectory earn; a batch of trajectories has leading axes everywhere."""

    reward: Floats
    """Reward of each step ``(T,)``."""
    epi: Floats
    """Profit of each step ``(T,)`` [EUR m-2]."""
    penalty: Floats
    """Sum of the violations, each divided by its scale or at its price ``(T,)``, as the task's quantity ``penalty``."""
    violations: Mapping[str, Floats]
    """By name of the quantity, such as ``violation_co2_high``, in its unit ``(T,)``."""


@dataclass(frozen=True, eq=False)
class StageGradient:
    """Derivatives of each step's reward; a batch of trajectories has leading axes everywhere."""

    before: Floats
    after: Floats
    """``before`` and ``after``: with respect to the states at the start and at the end of the step ``(T, s)``."""
    controls: Floats
    """With respect to the controls of the step ``(T, c)``."""

    @property
    def states(self) -> Floats:
        """Derivatives of the sum of all rewards with respect to the trajectory's states ``(T + 1, s)``."""
        shape = (*self.after.shape[:-2], self.after.shape[-2] + 1, self.after.shape[-1])
        states = np.zeros(shape)
        states[..., :-1, :] = self.before
        states[..., 1:, :] += self.after
        return states


class StageReward:
    """The reward of a task, step by step, for states and controls that an optimiser chose.

    Without smoothing the numbers have the bits that ``Simulation`` gives for the same states, in any batch. At kinks (a limit, a price by
    the weight of a head) the derivatives are those of the branch taken; at a limit that is just kept they are 0.

    Where a task judges the end of a step, a violation follows from the air at that moment. Where it judges means, it follows from meters,
    which are states: how they depend on air and controls is in the derivatives of the kernel's step. A step that stays within a limit has
    none for it, however close it comes; ``air_of`` tells how close.

    What a task charges for a step that fails is no matter of states, and not in here.

    Raises ``TaskError`` when a part of the reward was registered, Python without derivatives, or depends on changes of controls.
    Raises ``ShapeError`` when the smoothing is negative or not finite, and ``UnknownNameError`` for anything else ``counted``.

    ``smoothing`` is the width w within which violations count quadratically, as a share of the distance between the two limits of a
    quantity: a violation v counts as v^2 / (2 w) up to w, and as v - w / 2 from there. 0 is exact. At 0.03 limits of 15 and 34 degC have
    w = 0.57 K. ``counted`` is what counts as the reward: "reward", or "epi" for the profit alone. With ``inward``, ``gradient``
    takes controls a billionth inside their bounds, for its values too: with lamps and engine off, electricity then has a price.
    """

    def __init__(self, task: TaskSpec | str, *, smoothing: float = 0.0, counted: str = "reward", inward: bool = False) -> None:
        self.task = task = the_task(task)
        self.smoothing, self._inward = smoothing, 1e-9 if inward else 0.0
        tape = record_quantities(task)
        if tape is None:
            registered = ", ".join(f"'{name}'" for name in task.reward.modules if not REWARDS.recorded(name))
            shipped = ", ".join(name for name in REWARDS if REWARDS.recorded(name))
            msg = f"The reward of {task.id} has no derivatives: {registered} is Python that somebody registered. Others have: {shipped}."
            raise TaskError(msg)
        if not (np.isfinite(smoothing) and smoothing >= 0.0):
            refuse(f"The smoothing is a finite share of the distance between two limits, 0 or more; got {smoothing!r}.", ShapeError)
        if counted not in ("reward", "epi"):
            refuse(f"counted='{counted}' is unknown: choose 'reward', or 'epi' for the profit alone.", UnknownNameError)
        first = info_columns(task)
        columns = {quantity.name: first + place for place, quantity in enumerate(task.quantities)}
        widths = {
            f"violation_{name}_{side}": smoothing * (limits.high - limits.low)
            for name, limits in task.constraints.items()
            for side in ("low", "high")
        }
        self._names = ("reward", "epi", "penalty", *widths)

        def count_quadratically(width: float) -> Callable[[Any], Any]:
            """Makes a violation count quadratically up to ``width``."""

            def count(violation: Any) -> Any:
                near = np.minimum(violation, width)
                return near * near / (2.0 * width) + (violation - near)

            return count

        rounded: dict[tuple[Target, int], Callable[[Any], Any]] = {
            ("table", columns[name]): count_quadratically(width) for name, width in widths.items() if width > 0.0
        }
        outputs: list[tuple[Target, int]] = [("table", columns[name]) for name in (counted, *self._names[1:])]
        self._derivatives = TapeDerivatives(tape, outputs, ("before", "after", "controls"), count=1, changes=rounded)
        if self._derivatives.reads("controls_before"):
            msg = (
                f"The reward of {task.id} depends on what controls were before a step (a line of its ledger prices starts), and has no "
                "derivatives there. Plan for the task without that line."
            )
            raise TaskError(msg)
        self._sizes = len(task.model_value.states), len(task.model_value.control_names)
        self._calendar_columns = calendar_columns(task)

    def __call__(self, x: ArrayLike, u: ArrayLike, calendar: ArrayLike | None = None) -> StageValues:
        """What the steps of a trajectory earn.

        States ``x`` are ``(T + 1, s)``, and controls ``u``, fractions, ``(T, c)``, or batches ``(..., T + 1, s)`` and ``(..., T, c)``.
        ``calendar`` has the rows of the scenario's calendar at the start of each step and at the end of the last one ``(T + 1, columns)``,
        such as ``scenario.calendar[k : k + T + 1]``; needed where prices change. Raises ``ShapeError`` for what does not fit.
        """
        read, shape = self._inputs(x, u, calendar)
        return self._stages(self._derivatives.values(read), shape)

    def gradient(self, x: ArrayLike, u: ArrayLike, calendar: ArrayLike | None = None) -> tuple[StageValues, StageGradient]:
        """What the steps of a trajectory earn, and the derivatives of each step's reward. Parameters and errors as of a call."""
        read, shape = self._inputs(x, np.clip(u, self._inward, 1.0 - self._inward) if self._inward else u, calendar)
        states, controls = self._sizes
        slopes: dict[Source, Floats] = {
            "before": np.zeros((*shape, 1, states)),
            "after": np.zeros((*shape, 1, states)),
            "controls": np.zeros((*shape, 1, controls)),
        }
        values = self._stages(self._derivatives(read, slopes), shape)
        return values, StageGradient(*(slopes[source][..., 0, :] for source in ("before", "after", "controls")))

    def _inputs(self, x: ArrayLike, u: ArrayLike, calendar: ArrayLike | None) -> tuple[Read, tuple[int, ...]]:
        """What the formulas read in the steps of a trajectory, and the shape of these."""
        states, controls = (np.asarray(values, dtype=np.float64) for values in (x, u))
        shape, (s, c) = controls.shape[:-1], self._sizes
        if not shape or controls.shape != (*shape, c) or states.shape != (*shape[:-1], shape[-1] + 1, s):
            msg = (
                f"States of shape {states.shape} and controls of shape {controls.shape} are no trajectory of {self.task.id}. Expected "
                f"(..., T + 1, {s}) and (..., T, {c})."
            )
            raise ShapeError(msg)
        read: dict[Source, Floats] = {"before": states[..., :-1, :], "after": states[..., 1:, :], "controls": controls}
        if self._derivatives.reads("calendar") or self._derivatives.reads("calendar_before"):
            expected = (shape[-1] + 1, self._calendar_columns)
            rows = np.asarray(() if calendar is None else calendar, dtype=np.float64)
            if rows.shape not in (expected, (*shape[:-1], *expected)):
                got = "none" if calendar is None else f"one of shape {rows.shape}"
                msg = (
                    f"Prices of {self.task.id} change: its reward needs the calendar of the steps, of shape {expected}, and got {got}. "
                    "Take it from a Scenario, from step k on: calendar=scenario.calendar[k : k + T + 1]."
                )
                raise ShapeError(msg)
            read |= {"calendar_before": rows[..., :-1, :], "calendar": rows[..., 1:, :]}
        return (lambda source, index: read[source][..., index]), shape

    def _stages(self, values: list[Any], shape: tuple[int, ...]) -> StageValues:
        reward, epi, penalty, *violations = (np.broadcast_to(column, shape).copy() for column in values)
        return StageValues(reward, epi, penalty, dict(zip(self._names[3:], violations, strict=True)))


def judged_at_the_end(task: TaskSpec) -> TaskSpec:
    """The task, judged by the air at the end of each step: a limit is seen from within, which meters do not show."""
    return with_constraints(task, {"judged": "end"}) if task.judges_means else task


def with_constraints(task: TaskSpec, changes: Mapping[str, Any]) -> TaskSpec:
    """The task with other entries of its table of constraints, for planning; unlike ``task.replace`` this needs no weather."""
    return task.model_copy({"constraints": task.constraints.model_copy(update=dict(changes))})


@dataclass(frozen=True, eq=False)
class AirAlong:
    """Air temperature [degC], CO2 [ppm] and relative humidity [%] of some states."""

    values: Floats
    """``(..., 3)``."""
    gradient: Floats
    """Derivative by the states ``(..., 3, s)``; it is 0 where a hygrometer would show less than 0 or more than 100 %."""


def air_of(model: Model, states: ArrayLike) -> AirAlong:
    """The air in ``states`` ``(..., s)`` of ``model``, with the bits of ``Simulation.air``.

    Raises ``GlbenchError`` when the model has no air. Raises ``ShapeError`` when the states are not those of the model.
    """
    x = np.asarray(states, dtype=np.float64)
    if model.air is None:
        refuse(f"{model.id} has no air: its `air` is None.", GlbenchError)
    if x.shape[-1:] != (len(model.states),):
        refuse(f"The states have shape {x.shape}; the last axis must have the {len(model.states)} states of {model.id}.", ShapeError)
    values, gradient = np.empty((*x.shape[:-1], len(AIR))), np.zeros((*x.shape[:-1], len(AIR), x.shape[-1]))
    for place, column in enumerate(_air(model)(lambda source, index: x[..., index], {"after": gradient})):
        values[..., place] = column
    return AirAlong(values, gradient)


@lru_cache(maxsize=8)
def _air(model: Model) -> TapeDerivatives:
    assert model.air is not None
    with Recorder() as recorder:
        states = (recorder.input("after", model.state_index(name)) for name in model.air)
        for place, value in enumerate(air_quantities(*model.air_of(*states))):
            recorder.output("table", place, value)
    return TapeDerivatives(recorder.tape(), [("table", place) for place in range(len(AIR))], ("after",))
