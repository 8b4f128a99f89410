"""From actions to controls: small named parts, one of which a task chooses.

A part is made once for a task. In every step it turns the controls in force, fractions per row, and the actions into
the controls of the step. Controls that the task does not grant stay at 0. To add one, register a function that makes it:

    register_actuation("direct", "the action is the control", lambda task: Direct(task), low=0.0, high=1.0)

The kinds that glbench ships are recorded: ``RecordedActuation``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import real_numbers
from glbench.env import process_computer
from glbench.env.process_computer import Measured, at_least, held_switch, select, within
from glbench.env.registries import PartRegistry
from glbench.errors import ActionError, TaskError
from glbench.kernel.environment import ActionBounds
from glbench.tasks.quantities import Action
from glbench.tasks.vocabulary import ACTUATION_KINDS, ActuationKind

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.tasks.tables import OnOffTable

Floats = NDArray[np.float64]

Actuation = Callable[[Floats, Floats], Floats]
"""New controls of those granted ``(n, c)`` from those in force ``(n, c)``, and the actions ``(n, m)``; changes neither of them."""

MakeActuation = Callable[["TaskSpec"], Actuation]

ACTUATIONS: PartRegistry[MakeActuation] = PartRegistry("kind of actuation", ACTUATION_KINDS)

PART = "actuation"
"""Under which it asks for memory."""

ROUNDING = 1e-6
"""How far an action may lie outside its bounds: what float32 arithmetic and scaling lose. Taken as the bound itself."""

LONG_AGO = 1e6
"""Steps since a machine was switched that never was."""

TO_NUMBERS = "Give a NumPy array of float32; a tensor becomes one with tensor.detach().cpu().float().numpy()."
"""What to do about actions that are no numbers."""

_TIE = 1e-9
"""What a sum of fractions, or a time counted in steps, may lose by rounding."""


def register_actuation(
    name: str,
    meaning: str,
    make: MakeActuation,
    *,
    low: float = 0.0,
    high: float = 1.0,
    actions: Callable[[tuple[str, ...]], tuple[Action, ...]] | None = None,
) -> None:
    """Make a kind of actuation known under ``name``, here and in task files.

    Its actions have an entry between ``low`` and ``high`` for each control that the task grants, or those that ``actions`` gives for these
    controls: names, bounds, and what they stand for (``glbench.tasks.Action``).

    Raises
    ------
    TaskError
        When the name is taken, or the bounds are not finite and in order.
    """
    if not (np.isfinite([low, high]).all() and low < high):
        msg = f"Actions of '{name}' cannot lie between {low:g} and {high:g}. Give finite bounds, the lower one first."
        raise TaskError(msg)
    ACTUATION_KINDS.add(ActuationKind(name, meaning, low, high, actions))
    ACTUATIONS.provide(name, make)


def make_actuation(task: TaskSpec) -> Actuation:
    """The task's kind of actuation.

    Raises
    ------
    UnknownNameError
        For a kind without a part, with the nearest known one.
    """
    move = _checked(task, ACTUATIONS[task.actuation.kind](task))
    names = task.model_value.control_names
    granted = [names.index(name) for name in task.actuation.controls]
    if granted == list(range(len(names))):
        return move

    def move_granted(controls: Floats, actions: Floats) -> Floats:
        moved = np.zeros_like(controls)
        moved[:, granted] = move(controls[:, granted], actions)
        return moved

    return move_granted


def _checked(task: TaskSpec, move: Actuation) -> Actuation:
    """``move``, refusing to return what is not a control of each run."""

    def checked(controls: Floats, actions: Floats) -> Floats:
        moved = np.asarray(move(controls, actions), dtype=np.float64)
        if moved.shape != controls.shape:
            msg = (
                f"The actuation '{task.actuation.kind}' of {task.id} returned an array of shape {moved.shape}; it must be "
                f"{controls.shape}: a row for every run, and a column each for {', '.join(task.actuation.controls)}."
            )
            raise TaskError(msg)
        return moved

    return checked


@dataclass(frozen=True)
class ActuationInputs:
    """What a recorded kind of actuation may look at, at the start of a step: recorded values.

    Attributes
    ----------
    actions, controls
        Entries of the action, and controls in force that the task grants, by name.
    memory
        What the kind wrote in the step before, by the names that it asked for.
    measured
        Climate and clock as the process computer reads them; ``None`` in a model without an air.
    """

    actions: Mapping[str, Any]
    controls: Mapping[str, Any]
    memory: Mapping[str, Any]
    measured: Measured | None


@dataclass(frozen=True)
class RecordedActuation:
    """A kind of actuation as arithmetic, which the compiled kernel can do.

    Attributes
    ----------
    work
        From a task and the inputs to the controls that the task grants, and what is remembered.
    memory
        Names and start values of what is remembered (``glbench.env.memory_layout``), besides the clocks of machines that are switched.
    """

    work: Callable[[TaskSpec, ActuationInputs], tuple[Mapping[str, Any], Mapping[str, Any]]]
    memory: Mapping[str, float] = field(default_factory=dict)


_Move = Callable[["TaskSpec", Any, Any, int], Any]
"""The new value of one control from that in force, the action and its column: arithmetic on arrays or on recorded values."""

_Goal = Callable[["TaskSpec", Any, Any, int, "OnOffTable"], Any]
"""The same for a machine that is switched, on an axis on which off lies near its lowest load (``off_position``)."""


def _moved(task: TaskSpec, control: Any, action: Any, column: int) -> Any:
    """Control plus max_change times action, kept within 0 and 1 (a valve that is fully open stays open)."""
    return np.minimum(np.maximum(action * task.actuation.max_change + control, 0.0), 1.0)


def _moved_on_axis(task: TaskSpec, control: Any, action: Any, column: int, machine: OnOffTable) -> Any:
    """The machine's position plus max_change times action."""
    return action * task.actuation.max_change + control


def _approached(task: TaskSpec, control: Any, action: Any, column: int) -> Any:
    """Towards the control asked for, by at most max_change; exactly there when it is within reach.

    The lower bound of the action asks for 0, the upper one for 1.
    """
    wanted, max_change = _asked(task, action, column), task.actuation.max_change
    return np.minimum(np.maximum(wanted, control - max_change), control + max_change)


def _approached_on_axis(task: TaskSpec, control: Any, action: Any, column: int, machine: OnOffTable) -> Any:
    """Towards the load asked for, by at most max_change; less than half of the lowest load asks for off."""
    asked, max_change = _asked(task, action, column), task.actuation.max_change
    runs = at_least(asked, 0.5 * machine.lowest)
    wanted = select(runs, np.maximum(asked, machine.lowest), off_position(task, machine))
    return np.minimum(np.maximum(wanted, control - max_change), control + max_change)


def _asked(task: TaskSpec, action: Any, column: int) -> Any:
    low, high = (float(bound[column]) for bound in action_bounds(task))
    return (action - low) / (high - low)


def off_position(task: TaskSpec, machine: OnOffTable) -> float:
    """Where off lies when loads that there are not are left out: one ``max_change`` below the lowest load, at 0 where that is nearer."""
    return max(machine.lowest - task.actuation.max_change, 0.0)


def hold_steps(task: TaskSpec, machine: OnOffTable) -> float:
    """Steps for which the machine stays on or off; no whole number where the time is none of steps."""
    return machine.hold_minutes * 60.0 / task.step_seconds


def hold_clock(control: str) -> str:
    """Name in memory of the steps that a control has been on or off."""
    return f"{control}_steps"


def _switched(
    task: TaskSpec, goal: _Goal, control: Any, action: Any, column: int, machine: OnOffTable, steps: Any
) -> tuple[Any, Any]:
    """A machine that is off, or runs between its lowest load and 1: its control, and for how many steps it will have been on or off.

    It is switched where its position passes the middle between off and the lowest load, unless it was switched too short a time ago.
    Then it stays off, or at the load nearest to what was asked for.
    """
    runs = np.sign(control)
    off, lowest = off_position(task, machine), machine.lowest
    there = goal(task, select(runs, control, off), action, column, machine)
    wanted = at_least(there, 0.5 * (off + lowest) - _TIE)
    runs, steps = held_switch(runs, steps, wanted, hold_steps(task, machine) - _TIE)
    return runs * within(there, lowest, 1.0), steps


def _provide(name: str, move: _Move, goal: _Goal) -> None:
    """A kind of actuation that moves each control by itself, and can be recorded."""

    def make(task: TaskSpec) -> Actuation:
        if task.on_off:
            return _only_recorded(task)
        return lambda controls, actions: np.stack(
            [move(task, controls[:, column], actions[:, column], column) for column in range(actions.shape[1])], axis=1
        )

    def work(task: TaskSpec, given: ActuationInputs) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        moved, kept = {}, {}
        for place, name in enumerate(task.actuation.controls):
            control, action = given.controls[name], given.actions[name]
            if name in task.on_off:
                clock = hold_clock(name)
                moved[name], kept[clock] = _switched(
                    task, goal, control, action, place, task.on_off[name], given.memory[clock]
                )
            else:
                moved[name] = move(task, control, action, place)
        return moved, kept

    ACTUATIONS.provide(name, make, recorded=RecordedActuation(work))


def _computed(task: TaskSpec, given: ActuationInputs) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    if given.measured is None:
        msg = f"{task.source}: [actuation] A process computer needs an air to measure, and {task.model_id} has none."
        raise TaskError(msg)
    wanted = {action.name: action.value(given.actions[action.name]) for action in task.actions}
    return process_computer.work(task, wanted, given.controls, given.measured, given.memory)


def _only_recorded(task: TaskSpec) -> Actuation:
    what = (
        f"of {', '.join(task.on_off)} remembers" if task.on_off else f"'{task.actuation.kind}' remembers and measures"
    )
    msg = f"The actuation {what}: it works in the step of a Simulation only."
    raise TaskError(msg)


_provide("rate", _moved, _moved_on_axis)
_provide("set_point", _approached, _approached_on_axis)
ACTUATIONS.provide("process_computer", _only_recorded, recorded=RecordedActuation(_computed, process_computer.MEMORY))


def recorded_actuation(task: TaskSpec) -> RecordedActuation | None:
    """How the controls of a task move; ``None`` for a kind that somebody registered, which is Python.

    Raises
    ------
    UnknownNameError
        For a kind without a part, with the nearest known one.
    """
    recorded: RecordedActuation | None = ACTUATIONS.recorded(task.actuation.kind)
    return recorded


def actuation_memory(task: TaskSpec) -> Mapping[str, float]:
    """What the actuation of a task remembers from step to step, with start values (``glbench.env.memory_layout``)."""
    recorded = recorded_actuation(task)
    return {} if recorded is None else {**recorded.memory, **{hold_clock(name): LONG_AGO for name in task.on_off}}


def action_bounds(task: TaskSpec) -> tuple[Floats, Floats]:
    """Lowest and highest action of a task, each ``(m,)``."""
    return np.array([action.low for action in task.actions]), np.array([action.high for action in task.actions])


class ActionReader:
    """Checks actions, or controls, of ``n`` rows against names and bounds, and hands on a float64 copy within the bounds."""

    def __init__(self, what: str, names: tuple[str, ...], low: Floats, high: Floats) -> None:
        self.what, self.names = what, names
        self.bounds = ActionBounds(low - ROUNDING, high + ROUNDING, low, high)

    @classmethod
    def of_task(cls, task: TaskSpec) -> ActionReader:
        """Reader of a task's actions."""
        return cls("action", tuple(action.name for action in task.actions), *action_bounds(task))

    @classmethod
    def of_controls(cls, task: TaskSpec) -> ActionReader:
        """Reader of controls that are applied as they are."""
        names = task.model_value.control_names
        return cls("control", names, np.zeros(len(names)), np.ones(len(names)))

    def __call__(self, given: object, n: int, ended: NDArray[np.bool_] | None = None) -> Floats:
        """Own copy of ``given`` as ``(n, m)`` float64. Rows that are ``ended`` are not looked at and read as the bound ``low``.

        Raises
        ------
        ActionError
            For a wrong shape or type, a value that is not finite, or one outside its bounds by more than ``ROUNDING``;
            the message names row, action and value.
        """
        actions, bounds = self.read(given, n), self.bounds
        if ended is not None:
            actions[ended] = bounds.low
        inside = (actions >= bounds.lowest) & (actions <= bounds.highest)  # False for NaN as well
        if not inside.all():
            raise ActionError(self._complaint(actions, inside))
        actions += 0.0  # -0.0 becomes 0.0: which of two zeros is the larger depends on the place in the batch
        np.maximum(actions, bounds.low, out=actions)
        np.minimum(actions, bounds.high, out=actions)
        return actions

    def read(self, given: object, n: int) -> Floats:
        """Own copy of ``given`` as ``(n, m)`` float64, whatever its values are.

        Raises
        ------
        ActionError
            For a wrong shape or type.
        """
        numbers = real_numbers(given)
        if numbers is None:
            kind = f"array of {given.dtype}" if type(given) is np.ndarray else type(given).__name__
            problem = f"The {self.what}s ({kind}) are not real numbers in rows of one length."
            msg = f"{problem} {self._expected(n)} {TO_NUMBERS}"
            raise ActionError(msg)
        with np.errstate(over="ignore"):  # of a longdouble
            actions = numbers.astype(np.float64)
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
        bounds = f"{self.bounds.low[column]:g} to {self.bounds.high[column]:g}"
        return f"The {where}, outside its bounds {bounds}. Limit it before the step; nothing was simulated."
