"""Machines that are off or on in plans: schedules near relaxed ones, and loads that a schedule allows.

A plan is made twice. Relaxed, a machine may run at any load from 0 to 1. Then a schedule follows the relaxed loads as closely as the hold
times allow (``near``): sum-up rounding, which keeps the difference of the two sums small at every moment. With the machine off and on as
in the schedule, the loads and all other controls are planned anew (``loads``).

Where a machine runs, its load moves by at most ``max_change`` in a step, from ``lowest`` when it starts to ``lowest`` when it stops, as
the actuation of a task moves it.

Source: Sager, Jung and Kirches (2011), Combinatorial integral approximation, Mathematical Methods of Operations Research 73, 363-380.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.env.actuation import LONG_AGO, hold_steps

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]
Switched = NDArray[np.bool_]

_TIE = 1e-9


class Machines:
    """The machines of a task that are off or on, and for how long each has been in each of some runs.

    Attributes
    ----------
    columns
        Of them among the controls ``(m,)``.
    lowest
        Load at which each runs at least ``(m,)``.
    since
        Steps since each was switched ``(runs, m)``.
    """

    def __init__(self, task: TaskSpec, runs: int = 1) -> None:
        names = task.model_value.control_names
        self.columns = np.array([names.index(name) for name in task.on_off], np.intp)
        self.lowest = np.array([machine.lowest for machine in task.on_off.values()])
        self._hold = np.array([int(np.ceil(hold_steps(task, machine) - _TIE)) for machine in task.on_off.values()])
        self._change = task.actuation.max_change
        self.since = np.full((runs, len(self.columns)), LONG_AGO)

    def follow(self, before: Floats, controls: Floats) -> None:
        """Count a step in which controls ``(runs, c)`` follow those ``before``."""
        switched = (before[:, self.columns] > 0.0) != (controls[:, self.columns] > 0.0)
        self.since = np.where(switched, 1.0, self.since + 1.0)

    def near(self, relaxed: Floats, before: Floats, since: Floats) -> Switched:
        """Schedules near relaxed controls ``(n, T, c)``: whether each machine runs in each step ``(n, T, m)``.

        ``before`` are the controls in force ``(n, c)``, and ``since`` the steps since each machine was switched ``(n, m)``.
        """
        wanted = relaxed[..., self.columns]
        runs, windows = np.zeros(wanted.shape, np.bool_), np.maximum(self._hold, 1)
        sums = np.cumsum(np.concatenate([np.zeros_like(wanted[:, :1]), wanted], axis=1), axis=1)
        load, owing, places = before[:, self.columns].copy(), np.zeros(since.shape), np.arange(len(windows))
        for step in range(wanted.shape[1]):
            ends = np.minimum(step + windows, wanted.shape[1])
            coming = sums[:, ends, places] - sums[:, step]
            more = owing + coming > 0.5 * (ends - step)
            running, may = load > 0.0, since >= self._hold
            starts, stops = ~running & more & may, running & ~more & may & (load <= self.lowest + _TIE)
            slower = np.maximum(load - self._change, self.lowest)
            changed = np.where(more, np.minimum(load + self._change, 1.0), slower)
            load = np.where(starts, self.lowest, np.where(running & ~stops, changed, 0.0))
            owing += wanted[:, step] - load
            since = np.where(starts | stops, 1.0, since + 1.0)
            runs[:, step] = load > 0.0
        return runs

    def at_full_load(self, controls: Floats) -> Floats:
        """Controls ``(..., T, c)`` with all machines at full load: where plans with a schedule begin."""
        controls = controls.copy()
        controls[..., self.columns] = 1.0
        return controls

    def within(self, controls: Floats, wanted: Floats, before: Floats, switched: Switched | None) -> Floats:
        """Controls ``(..., T, c)`` with machines as ``wanted``: at any load from 0 to 1, or as a schedule allows."""
        if not self.columns.size:
            return controls
        controls = controls.copy()
        controls[..., self.columns] = np.clip(wanted[..., self.columns], 0.0, 1.0)
        return controls if switched is None else self.loads(controls, before, switched)

    def loads(self, controls: Floats, before: Floats, switched: Switched) -> Floats:
        """Controls ``(..., T, c)`` with the loads that schedules ``(..., T, m)`` allow: 0, or from ``lowest`` up, with ramps at both ends.

        ``before`` are the controls in force ``(..., c)``.
        """
        steps, most = switched.shape[-2], np.ones(switched.shape)
        load = before[..., self.columns]
        for step in range(steps):
            load = np.where(switched[..., step, :], np.where(load > 0.0, np.minimum(load + self._change, 1.0), self.lowest), 0.0)
            most[..., step, :] = load
        least = before[..., self.columns]
        low = np.zeros(switched.shape)
        for step in range(steps):
            least = np.where(switched[..., step, :], np.maximum(least - self._change, self.lowest), 0.0)
            low[..., step, :] = least
        for step in range(steps - 2, -1, -1):
            after = np.where(switched[..., step + 1, :], most[..., step + 1, :] + self._change, self.lowest)
            most[..., step, :] = np.minimum(most[..., step, :], after)
        controls = controls.copy()
        load = np.clip(controls[..., self.columns], low, np.maximum(most, low))
        before_load = before[..., self.columns]
        for step in range(steps):
            moved = np.clip(load[..., step, :], before_load - self._change, before_load + self._change)
            load[..., step, :] = before_load = np.where(switched[..., step, :] & (before_load > 0.0), moved, load[..., step, :])
        controls[..., self.columns] = load
        return controls
