"""From actions to controls: small named parts, one of which a task chooses.

A part is made once for a task. In every step it turns the controls in force, fractions per row, and the actions into
the controls of the step. Controls that the task does not grant follow its schedule or stay at 0. To add one, register a function:

    register_actuation("direct", "the action is the control", lambda task: Direct(task), low=0.0, high=1.0)

The kinds that glbench ships are recorded: ``RecordedActuation``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats, real_numbers, unknown_type
from glbench.env import process_computer
from glbench.env.process_computer import Measured, at_least, held_switch, select, within
from glbench.env.registries import PartRegistry
from glbench.env.weather_pool import CLOCK
from glbench.errors import ActionError, TaskError, refuse
from glbench.kernel.environment import ActionBounds
from glbench.kernel.tape import Read
from glbench.tasks import TaskSpec
from glbench.tasks.quantities import Action
from glbench.tasks.tables import DueTable, OnOffTable
from glbench.tasks.vocabulary import ACTUATION_KINDS, ActuationKind

Actuation = Callable[[Floats, Floats], Floats]
"""New controls of those granted ``(n, c)`` from those in force ``(n, c)``, and the actions ``(n, m)``; changes neither of them."""

MakeActuation = Callable[["TaskSpec"], Actuation]

ACTUATIONS: PartRegistry[MakeActuation] = PartRegistry("kind of actuation", ACTUATION_KINDS)

PART = "actuation"
"""The actuation's part of a run's memory."""

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

    Raises ``TaskError`` when the name is taken, or the bounds are not finite and in order.
    """
    if not (np.isfinite([low, high]).all() and low < high):
        refuse(f"Actions of '{name}' cannot lie between {low:g} and {high:g}. Give finite bounds, the lower one first.", TaskError)
    ACTUATION_KINDS.add(ActuationKind(name, meaning, low, high, actions))
    ACTUATIONS.provide(name, make)


def make_actuation(task: TaskSpec) -> Actuation:
    """The task's kind of actuation. Raises ``UnknownNameError`` for a kind without a part, with the nearest known one."""
    move = ACTUATIONS[task.actuation.kind](task)
    names, columns = task.model_value.control_names, task.actuation.controls
    places = [names.index(name) for name in columns]
    everything = places == list(range(len(names)))

    def move_granted(controls: Floats, actions: Floats) -> Floats:
        before = controls if everything else controls[:, places]
        after = np.asarray(move(before, actions), dtype=np.float64)
        if after.shape != before.shape:
            msg = (
                f"The actuation '{task.actuation.kind}' of {task.id} returned an array of shape {after.shape}; it must be "
                f"{before.shape}: a row for every run, and a column each for {', '.join(columns)}."
            )
            raise TaskError(msg)
        if everything:
            return after
        moved = np.zeros_like(controls)
        moved[:, places] = after
        return moved

    return move_granted


@dataclass(frozen=True)
class ActuationInputs:
    """What a recorded kind of actuation may look at, at the start of a step: recorded values."""

    actions: Mapping[str, Any]
    controls: Mapping[str, Any]
    """``actions`` and ``controls``: entries of the action, and controls in force that the task grants, by name."""
    memory: Mapping[str, Any]
    """What the kind wrote in the previous step, by the names in ``RecordedActuation.memory``."""
    measured: Measured | None
    """Climate and clock as the process computer reads them; ``None`` in a model without an air."""
    due: Mapping[str, Any] = field(default_factory=dict)
    """States by which machines are due, by control."""


@dataclass(frozen=True)
class RecordedActuation:
    """A kind of actuation as arithmetic, which the compiled kernel can do."""

    work: Callable[[TaskSpec, ActuationInputs], tuple[Mapping[str, Any], Mapping[str, Any]]]
    """From a task and the inputs to the granted controls, and the memory for the next step."""
    memory: Mapping[str, float] = field(default_factory=dict)
    """Names and start values of the memory (``glbench.env.memory_layout``), without the clocks of machines that are switched."""


_Position = Callable[["TaskSpec", Any, Any, int, "OnOffTable | None"], Any]
"""Where a control goes: from that in force, the action and its column; arithmetic on arrays or on recorded values.

Of a machine that is switched, on an axis on which off lies near its lowest load (``off_position``).
"""


def _rate(task: TaskSpec, control: Any, action: Any, column: int, machine: OnOffTable | None) -> Any:
    """Control plus max_change times action, kept within 0 and 1 (a valve that is fully open stays open) unless it is a machine's."""
    position = action * task.actuation.max_change + control
    return np.minimum(np.maximum(position, 0.0), 1.0) if machine is None else position


def _set_point(task: TaskSpec, control: Any, action: Any, column: int, machine: OnOffTable | None) -> Any:
    """Towards the control that the action stands for, by at most max_change; exactly there when it is within reach.

    The lower bound of the action stands for 0, the upper one for 1, and less than half of a machine's lowest load for off.
    """
    low, high = (float(bound[column]) for bound in action_bounds(task))
    target, max_change = (action - low) / (high - low), task.actuation.max_change
    if machine is not None:
        runs = at_least(target, 0.5 * machine.lowest)
        target = select(runs, np.maximum(target, machine.lowest), off_position(task, machine))
    return np.minimum(np.maximum(target, control - max_change), control + max_change)


def _due_from(task: TaskSpec, due: DueTable, action: Any, column: int) -> Any:
    """Value of the state from which on the machine runs: straight from ``last`` at the lowest action to ``first`` at the highest."""
    low, high = (float(bound[column]) for bound in action_bounds(task))
    return (action - low) * ((due.first - due.last) / (high - low)) + due.last


def off_position(task: TaskSpec, machine: OnOffTable) -> float:
    """Where off lies when loads that there are not are left out: one ``max_change`` below the lowest load, at 0 where that is nearer."""
    return max(machine.lowest - task.actuation.max_change, 0.0)


def actions_of(task: TaskSpec, before: Floats, controls: Floats) -> Floats:
    """What an agent has to do to get from the controls in force ``(..., c)`` to ``controls`` ``(..., c)``; ``(..., actions)``.

    A control that is off or on is asked for the nearest that it can do; whether it may be switched is not looked at.

    Raises ``TaskError`` when the task's actions are not about single controls: set points of a process computer.
    """
    names = task.model_value.control_names
    columns = [names.index(name) for name in task.actuation.controls]
    if task.actuation.kind == "set_point":
        return controls[..., columns]
    if task.actuation.kind != "rate":
        refuse(f"A plan gives controls, and the actions of {task.id} are of the kind '{task.actuation.kind}'.", TaskError)
    change = controls[..., columns] - before[..., columns]
    for place, name in enumerate(task.actuation.controls):
        if name in task.on_off:
            machine, column = task.on_off[name], names.index(name)
            off = off_position(task, machine)
            there, here = (
                np.where(u >= 0.5 * machine.lowest, np.maximum(u, machine.lowest), off)
                for u in (controls[..., column], before[..., column])
            )
            change[..., place] = there - here if machine.due is None else np.where(there > off, 1.0, -1.0)
    return np.clip(change / task.actuation.max_change, -1.0, 1.0)


def hold_steps(task: TaskSpec, machine: OnOffTable) -> float:
    """Steps for which the machine stays on or off; no whole number where the time is none of steps."""
    return machine.hold_minutes * 60.0 / task.step_seconds


def hold_clock(control: str) -> str:
    """Name in memory of the steps that a control has been on or off."""
    return f"{control}_steps"


def _provide(name: str, position: _Position) -> None:
    """A kind of actuation that moves each control by itself, and can be recorded."""

    def make(task: TaskSpec) -> Actuation:
        if task.on_off:
            return _only_recorded(task)
        return lambda controls, actions: np.stack(
            [position(task, controls[:, column], actions[:, column], column, None) for column in range(actions.shape[1])], axis=1
        )

    def work(task: TaskSpec, inputs: ActuationInputs) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        controls, memory = {}, {}
        for column, name in enumerate(task.actuation.controls):
            control, action = inputs.controls[name], inputs.actions[name]
            if name not in task.on_off:
                controls[name] = position(task, control, action, column, None)
                continue
            # A machine is off, or runs between its lowest load and 1. It is switched where its position passes the middle between off and
            # the lowest load, unless it was switched too short a time ago. Then it stays off, or at the load nearest to the target.
            machine, clock, running = task.on_off[name], hold_clock(name), np.sign(control)
            off, lowest = off_position(task, machine), machine.lowest
            target = position(task, select(running, control, off), action, column, machine)
            runs = at_least(target, 0.5 * (off + lowest) - _TIE)
            if machine.due is not None:
                runs, target = at_least(inputs.due[name], _due_from(task, machine.due, action, column) - _TIE), lowest
            runs, memory[clock] = held_switch(running, inputs.memory[clock], runs, hold_steps(task, machine) - _TIE)
            controls[name] = runs * within(target, lowest, 1.0)
        return controls, memory

    ACTUATIONS.provide(name, make, recorded=RecordedActuation(work))


def _computed(task: TaskSpec, inputs: ActuationInputs) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    if inputs.measured is None:
        refuse(f"{task.source}: [actuation] A process computer needs an air to measure, and {task.model_id} has none.", TaskError)
    set_points = {action.name: action.value(inputs.actions[action.name]) for action in task.actions}
    return process_computer.work(task, set_points, inputs.controls, inputs.measured, inputs.memory)


def _only_recorded(task: TaskSpec) -> Actuation:
    what = f"of {', '.join(task.on_off)} remembers" if task.on_off else f"'{task.actuation.kind}' remembers and measures"
    refuse(f"The actuation {what}: it works in the step of a Simulation only.", TaskError)


_provide("rate", _rate)
_provide("set_point", _set_point)
ACTUATIONS.provide("process_computer", _only_recorded, recorded=RecordedActuation(_computed, process_computer.MEMORY))


def recorded_actuation(task: TaskSpec) -> RecordedActuation | None:
    """How controls move; ``None`` for a registered kind, which is Python. Raises ``UnknownNameError`` for an unknown one."""
    recorded: RecordedActuation | None = ACTUATIONS.recorded(task.actuation.kind)
    return recorded


def scheduled_controls(task: TaskSpec, read: Read) -> dict[str, Any]:
    """Scheduled controls in a step, by name, as arrays or recorded values.

    ``read`` gives columns of the pool's calendar at the start of the step ("calendar"), and the steps taken before it ("counter", 0).
    """
    first, controls = len(CLOCK) + len(task.price_tables), dict[str, Any].fromkeys(task.scheduled_places, 0.0)
    for place, entry in enumerate(task.schedule, first):
        applies = read("calendar", place)
        if entry.after_day:
            applies = applies * at_least(read("counter", 0), float(entry.after_day * task.steps_per_day))
        controls[entry.control] = select(applies, entry.value, controls[entry.control])
    return controls


def run_calendar(task: TaskSpec, rows: Floats, steps: NDArray[np.integer]) -> Floats:
    """Hour of day [h], day of year, prices and scheduled controls ``(..., columns)`` from rows of the pool after ``steps`` ``(...)``."""
    controls = scheduled_controls(task, lambda source, index: rows[..., index] if source == "calendar" else steps)
    return np.concatenate([rows[..., : len(CLOCK) + len(task.price_tables)], *(one[..., None] for one in controls.values())], axis=-1)


def actuation_memory(task: TaskSpec) -> Mapping[str, float]:
    """Memory of the actuation of a task from step to step, with start values (``glbench.env.memory_layout``)."""
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

    def __call__(self, values: object, n: int, ended: NDArray[np.bool_] | None = None) -> Floats:
        """Own copy of ``values`` as ``(n, m)`` float64. Rows that are ``ended`` are not looked at and read as the bound ``low``.

        Raises ``ActionError`` for a wrong shape or type, a value that is not finite, or one outside its bounds by more than ``ROUNDING``;
        the message names row, action and value.
        """
        actions, bounds = self.read(values, n), self.bounds
        if ended is not None:
            actions[ended] = bounds.low
        inside = (actions >= bounds.lowest) & (actions <= bounds.highest)  # False for NaN as well
        if not inside.all():
            row, column = (int(index) for index in np.argwhere(~inside)[0])
            value = float(actions[row, column])
            msg = f"The {self.what} {column} ('{self.names[column]}') of row {row} is {value!r}"
            if np.isfinite(value):
                msg += f", outside its bounds {bounds.low[column]:g} to {bounds.high[column]:g}. "
                msg += "Limit it before the step; nothing was simulated."
            else:
                msg += ", which is not a finite number. Check what computes it; nothing was simulated."
            raise ActionError(msg)
        actions += 0.0  # -0.0 becomes 0.0: which of two zeros is the larger depends on the place in the batch
        np.maximum(actions, bounds.low, out=actions)
        np.minimum(actions, bounds.high, out=actions)
        return actions

    def read(self, values: object, n: int) -> Floats:
        """Own copy of ``values`` as ``(n, m)`` float64, whatever they are. Raises ``ActionError`` for a wrong shape or type."""
        numbers = real_numbers(values)
        if numbers is None:
            kind = f"array of {values.dtype}" if type(values) is np.ndarray else type(values).__name__
            problem = unknown_type(values) or f"The {self.what}s ({kind}) are not real numbers in rows of one length."
            refuse(f"{problem} {self._expected(n)} {TO_NUMBERS}", ActionError)
        with np.errstate(over="ignore"):  # of a longdouble
            actions = numbers.astype(np.float64)
        if actions.shape != (n, len(self.names)):
            refuse(f"The {self.what}s have shape {actions.shape}. {self._expected(n)}", ActionError)
        return actions

    def _expected(self, n: int) -> str:
        return f"Expected shape ({n}, {len(self.names)}): one row a run, in each {', '.join(self.names)}."
