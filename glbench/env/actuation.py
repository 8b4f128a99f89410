"""From actions to controls: small named parts, one of which a task chooses.

A part is made once for a task. In every step it turns the controls in force and the actions, both fractions per row, into
the controls of the step. Controls that the task does not grant stay at 0. To add one, register a function that makes it:

    register_actuation("direct", "the action is the control", lambda task: Direct(task), low=0.0, high=1.0)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.env.parts import Parts
from glbench.errors import ActionError, TaskError
from glbench.model import CONTROL_NAMES
from glbench.tasks.card import task_card
from glbench.tasks.vocabulary import ACTUATION_KINDS, ActuationKind

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

Actuation = Callable[[Floats, Floats], Floats]
"""New controls ``(n, 6)`` from the controls in force ``(n, 6)`` and the actions ``(n, m)``; changes neither of them."""

MakeActuation = Callable[["TaskSpec"], Actuation]

ACTUATIONS: Parts[MakeActuation] = Parts("kind of actuation", ACTUATION_KINDS)

ROUNDING = 1e-6
"""How far an action may lie outside its bounds: what float32 arithmetic and scaling lose. Taken as the bound itself."""


def register_actuation(name: str, meaning: str, make: MakeActuation, *, low: float = 0.0, high: float = 1.0) -> None:
    """Make a kind of actuation known under ``name``, here and in task files, whose actions lie between ``low`` and ``high``.

    Raises
    ------
    TaskError
        When the name is taken, or the bounds are not finite and in order.
    """
    if not (np.isfinite([low, high]).all() and low < high):
        msg = f"Actions of '{name}' cannot lie between {low:g} and {high:g}. Give finite bounds, the lower one first."
        raise TaskError(msg)
    ACTUATION_KINDS.add(ActuationKind(name, meaning, low, high))
    ACTUATIONS.provide(name, meaning, make)


def make_actuation(task: TaskSpec) -> Actuation:
    """The task's kind of actuation.

    Raises
    ------
    UnknownNameError
        For a kind without a part, with the nearest known one.
    """
    move = ACTUATIONS[task.actuation.kind](task)
    granted = [CONTROL_NAMES.index(name) for name in task.actuation.controls]
    if granted == list(range(len(CONTROL_NAMES))):
        return move

    def move_granted(controls: Floats, actions: Floats) -> Floats:
        moved = np.zeros_like(controls)
        moved[:, granted] = move(controls[:, granted], actions)
        return moved

    return move_granted


def _rate(task: TaskSpec) -> Actuation:
    """Control plus max_change times action, kept within 0 and 1 (a valve that is fully open stays open)."""
    max_change = task.actuation.max_change
    return lambda controls, actions: _moved(controls, actions, max_change)


def _moved(control: Any, action: Any, max_change: float) -> Any:
    return np.minimum(np.maximum(action * max_change + control, 0.0), 1.0)


def _set_point(task: TaskSpec) -> Actuation:
    """Towards the control asked for, by at most max_change; exactly there when it is within reach.

    The lower bound of the action asks for 0, the upper one for 1.
    """
    max_change = task.actuation.max_change
    low, high = action_bounds(task)
    return lambda controls, actions: _approached(controls, actions, max_change, low, high)


def _approached(control: Any, action: Any, max_change: float, low: Any, high: Any) -> Any:
    wanted = (action - low) / (high - low)
    return np.minimum(np.maximum(wanted, control - max_change), control + max_change)


ACTUATIONS.provide("rate", "an action from -1 to 1 moves its control by up to max_change a step", _rate)
ACTUATIONS.provide(
    "set_point", "an action from 0 to 1 asks for a control, reached by at most max_change a step", _set_point
)

RecordedActuation = Callable[["TaskSpec", Any, Any, int], Any]
"""The same for one control and one action, numbers recorded for the compiled kernel, and the action's column."""


def _recorded_rate(task: TaskSpec, control: Any, action: Any, column: int) -> Any:
    return _moved(control, action, task.actuation.max_change)


def _recorded_set_point(task: TaskSpec, control: Any, action: Any, column: int) -> Any:
    low, high = (float(bound[column]) for bound in action_bounds(task))
    return _approached(control, action, task.actuation.max_change, low, high)


ACTUATIONS.record("rate", _recorded_rate)
ACTUATIONS.record("set_point", _recorded_set_point)


def action_bounds(task: TaskSpec) -> tuple[Floats, Floats]:
    """Lowest and highest action of the task's card, each ``(m,)``."""
    actions = task_card(task).actions
    return np.array([action.low for action in actions]), np.array([action.high for action in actions])


class ActionReader:
    """Checks actions, or controls, of ``n`` rows against names and bounds, and hands on a float64 copy within the bounds."""

    def __init__(self, what: str, names: tuple[str, ...], low: Floats, high: Floats) -> None:
        self.what, self.names, self.low, self.high = what, names, low, high
        self.lowest, self.highest = low - ROUNDING, high + ROUNDING

    @classmethod
    def of_task(cls, task: TaskSpec) -> ActionReader:
        """Reader of a task's actions."""
        return cls("action", task.actuation.controls, *action_bounds(task))

    @classmethod
    def of_controls(cls) -> ActionReader:
        """Reader of controls that are applied as they are."""
        return cls("control", CONTROL_NAMES, np.zeros(len(CONTROL_NAMES)), np.ones(len(CONTROL_NAMES)))

    def __call__(self, given: object, n: int, ended: NDArray[np.bool_] | None = None) -> Floats:
        """Own copy of ``given`` as ``(n, m)`` float64. Rows that are ``ended`` are not looked at and read as the bound ``low``.

        Raises
        ------
        ActionError
            For a wrong shape or type, a value that is not finite, or one outside its bounds by more than ``ROUNDING``;
            the message names row, action and value.
        """
        actions = self.read(given, n)
        if ended is not None:
            actions[ended] = self.low
        inside = (actions >= self.lowest) & (actions <= self.highest)  # False for NaN as well
        if not inside.all():
            raise ActionError(self._complaint(actions, inside))
        actions += 0.0  # -0.0 becomes 0.0: which of two zeros is the larger depends on the place in the batch
        np.maximum(actions, self.low, out=actions)
        np.minimum(actions, self.high, out=actions)
        return actions

    def read(self, given: object, n: int) -> Floats:
        """Own copy of ``given`` as ``(n, m)`` float64, whatever its values are.

        Raises
        ------
        ActionError
            For a wrong shape or type.
        """
        try:
            actions = np.array(given, dtype=np.float64)
        except (TypeError, ValueError) as error:
            msg = f"The {self.what}s cannot be read as numbers: {error}. {self._expected(n)}"
            raise ActionError(msg) from error
        if actions.shape != (n, len(self.names)):
            msg = f"The {self.what}s have shape {actions.shape}. {self._expected(n)}"
            raise ActionError(msg)
        return actions

    def _expected(self, n: int) -> str:
        return f"Expected shape ({n}, {len(self.names)}): one row a run, in each {', '.join(self.names)}."

    def _complaint(self, actions: Floats, inside: NDArray[np.bool_]) -> str:
        row, column = (int(index) for index in np.argwhere(~inside)[0])
        value = float(actions[row, column])
        where = f"{self.what} {column} ('{self.names[column]}') of row {row} is {value!r}"
        if not np.isfinite(value):
            return f"The {where}, which is not a finite number. Check what computes it; nothing was simulated."
        bounds = f"{self.low[column]:g} to {self.high[column]:g}"
        return f"The {where}, outside its bounds {bounds}. Limit it before the step; nothing was simulated."
