"""Everything that is given in a run: start, weather, parameters, calendar, and how far controls may go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env import run_weather
from glbench.env.scenario import RunScenarios
from glbench.env.simulation import read_only, run_parameters
from glbench.env.spaces import checked_seed, the_task

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scenario:
    """What happens in the run of a task with a seed, whatever its controls are, to the bits of ``Simulation``.

    This is privileged knowledge: no agent sees the draws of its run or the weather to come. It serves to find out what can be reached, and
    plans that say that they know it. All arrays are read-only.

    Attributes
    ----------
    task, seed
        Whose run it is; the task says in which split.
    x0
        States at the start ``(s,)``.
    u_before
        Controls in force before the first step, fractions ``(c,)``.
    d
        Disturbances of each step ``(T, disturbances)``.
    p
        Parameters, ``(p,)`` where the run keeps them to its end, ``(T, p)`` where steps draw some.
    calendar
        Hour of day [h], day of year and prices of the task's price tables, at the start of each step and at the end of the last one,
        ``(T + 1, columns)``.
    low, high
        Bounds of the controls ``(c,)``; those that the task does not grant stay at 0.
    max_change
        The largest change of a control in a step.
    """

    task: TaskSpec
    seed: int
    x0: Floats
    u_before: Floats
    d: Floats
    p: Floats
    calendar: Floats
    low: Floats
    high: Floats
    max_change: float

    @classmethod
    def of(cls, task: TaskSpec | str, seed: int) -> Scenario:
        """The scenario of the run with ``seed`` of a task, or of the task with an id.

        Raises
        ------
        GlbenchError
            When the seed is not a whole number from 0 to 2**64 - 1.
        """
        task, seed = the_task(task), checked_seed(seed)
        scenarios = RunScenarios(task)
        scene = scenarios.draw([seed])
        names, granted = task.model_value.control_names, task.actuation.controls
        return cls(
            task=task,
            seed=seed,
            x0=read_only(scene.states[0]),
            u_before=read_only(np.zeros(len(names))),
            d=read_only(run_weather(task, seed).values[: task.steps]),
            p=read_only(run_parameters(task, seed)),
            calendar=read_only(scenarios.pool.calendar[scene.first[0] + np.arange(task.steps + 1)]),
            low=read_only(np.zeros(len(names))),
            high=read_only(np.array([float(name in granted) for name in names])),
            max_change=task.actuation.max_change,
        )
