"""Everything that is given in a run: start, weather, parameters, calendar, how far controls may go; and actions for planned controls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from glbench.arrays import Floats
from glbench.control.delivery import Delivery
from glbench.env import run_weather
from glbench.env.actuation import run_calendar
from glbench.env.program import calendar_columns
from glbench.env.scenario import RunScenarios
from glbench.env.simulation import read_only, run_parameters
from glbench.env.spaces import checked_seed, the_task
from glbench.errors import ShapeError
from glbench.tasks import TaskSpec


@dataclass(frozen=True, eq=False)
class Scenario:
    """What happens in the run of a task with a seed, whatever its controls are, to the bits of ``Simulation``.

    This is privileged knowledge: no agent sees the draws of its run or the weather to come. It serves to find out what can be reached, and
    plans that say that they know it. All arrays are read-only.
    """

    task: TaskSpec
    seed: int
    """``task`` and ``seed``: whose run it is; the task says in which split."""
    x0: Floats
    """States at the start ``(s,)``."""
    u_before: Floats
    """Controls in force before the first step, fractions ``(c,)``."""
    d: Floats
    """Disturbances of each step ``(T, disturbances)``."""
    p: Floats
    """Parameters, ``(p,)`` where the run keeps them to its end, ``(T, p)`` where steps draw some."""
    calendar: Floats
    """Hour of day [h], day of year, prices of the task's price tables and its scheduled controls, at the start of each step and at the end
    of the last one, ``(T + 1, columns)``."""
    low: Floats
    high: Floats
    """``low`` and ``high``: bounds of the controls ``(c,)``; what the task does not grant stays at 0 or follows the schedule."""
    max_change: float
    """The largest change of a control in a step; of its command, where actuators are not ideal."""
    delivery: Delivery | None = None
    """What the actuators deliver of commands, with the run's faults; ``None`` where all are ideal."""

    @classmethod
    def of(cls, task: TaskSpec | str, seed: int) -> Scenario:
        """The scenario of the run with ``seed`` of a task or task id. Raises ``GlbenchError`` unless the seed is one, 0 to 2**64 - 1."""
        task, seed = the_task(task), checked_seed(seed)
        scenarios = RunScenarios(task)
        scene, steps = scenarios.draw([seed]), np.arange(task.steps + 1)
        names, controls = task.model_value.control_names, task.actuation.controls
        weather = run_weather(task, seed).values[: task.steps]
        return cls(
            task=task,
            seed=seed,
            x0=read_only(scene.states[0]),
            u_before=task.initial_controls,
            d=read_only(weather),
            p=read_only(run_parameters(task, seed)),
            calendar=read_only(run_calendar(task, scenarios.pool.calendar[scene.first[0] + steps], steps)),
            low=read_only(np.zeros(len(names))),
            high=read_only(np.array([float(name in controls) for name in names])),
            max_change=task.actuation.max_change,
            delivery=Delivery.of(scenarios, scene, seed, weather),
        )

    def delivered(self, commands: Floats) -> Floats:
        """What the actuators deliver of commands ``(..., T, c)``: the commands where all are ideal."""
        return commands if self.delivery is None else np.clip(self.delivery(commands), 0.0, 1.0)


def with_schedule(task: TaskSpec, controls: Floats, calendar: Floats) -> Floats:
    """Controls of steps ``(..., T, c)`` with the scheduled ones as in the calendar of a ``Scenario`` or ``Outlook``.

    ``calendar`` is ``(..., T + 1, columns)``, with the end of the last step; ShapeError when it has other columns.
    """
    if not task.schedule:
        return controls
    if calendar.shape[-1] != calendar_columns(task):
        msg = (
            f"The calendar of {task.id} has {calendar_columns(task)} columns; got {calendar.shape[-1]}. Take a Scenario's or an Outlook's."
        )
        raise ShapeError(msg)
    controls = controls.copy()
    controls[..., [*task.scheduled_places.values()]] = calendar[..., :-1, -len(task.scheduled_places) :]
    return controls
