"""Machines that are off or on in plans: schedules near relaxed plans, and the loads that a schedule allows.

A plan is made twice. Relaxed, a machine may run at any load from 0 to 1. Then a schedule follows the relaxed loads as closely as the hold
times allow: sum-up rounding, which keeps the difference of the two sums small at every moment. With machines off and on as scheduled, their
loads and all other controls are planned again.

Where a machine runs, its load starts and stops at ``lowest``, and moves by at most ``max_change`` in a step.

Source: Sager, Jung and Kirches (2011), Combinatorial integral approximation, Mathematical Methods of Operations Research 73, 363-380.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from glbench.arrays import Floats
from glbench.control.trust_region import feasible
from glbench.env.actuation import LONG_AGO, hold_steps
from glbench.tasks import TaskSpec

_TIE = 1e-9


@dataclass(frozen=True, eq=False)
class Schedule:
    """When machines run: the lowest and the highest load in each step ``(..., T, m)``, both 0 where one is off."""

    low: Floats
    high: Floats

    def of_rows(self, rows: NDArray[np.intp] | int) -> Schedule:
        """The schedule of some runs."""
        return Schedule(self.low[rows], self.high[rows])


class Machines:
    """The machines of a task that are off or on, and for how long each has been in each of some runs.

    ``columns`` are their places among the controls ``(m,)``, ``since`` the steps since each was switched ``(runs, m)``. Each has a
    ``lowest`` load and stays off or on for ``hold`` steps ``(m,)``; loads change by at most ``change`` in a step.
    """

    def __init__(self, task: TaskSpec, runs: int = 1) -> None:
        names = task.model_value.control_names
        self.columns = np.array([names.index(name) for name in task.on_off], np.intp)
        self.since = np.full((runs, len(self.columns)), LONG_AGO)
        self.lowest = np.array([machine.lowest for machine in task.on_off.values()])
        self.hold = np.array([max(int(np.ceil(hold_steps(task, machine) - _TIE)), 1) for machine in task.on_off.values()], np.intp)
        self.change = task.actuation.max_change

    def follow(self, before: Floats, controls: Floats) -> None:
        """Count a step in which controls ``(runs, c)`` follow those ``before``."""
        switched = (before[:, self.columns] > 0.0) != (controls[:, self.columns] > 0.0)
        self.since = np.where(switched, 1.0, self.since + 1.0)

    def near(self, relaxed: Floats, before: Floats, since: Floats) -> Schedule:
        """The schedule near relaxed controls ``(n, T, c)``.

        In each step a machine should run if the load that it owes, with the demand until it may be switched again, is more than half of
        what it would then have run. ``before`` are the controls in force ``(n, c)``; ``since`` ``(n, m)`` is as the attribute.
        """
        demand, places = relaxed[..., self.columns], np.arange(len(self.hold))
        steps, load = demand.shape[1], before[:, self.columns]
        sums = np.concatenate([np.zeros_like(demand[:, :1]), np.cumsum(demand, axis=1)], axis=1)
        running, owed = np.zeros(demand.shape, bool), np.zeros(since.shape)
        for step in range(steps):
            ends = np.minimum(step + self.hold, steps)
            wants = owed + sums[:, ends, places] - sums[:, step] > 0.5 * (ends - step)
            on, free = load > 0.0, since >= self.hold
            stops = on & ~wants & free & (load <= self.lowest + _TIE)
            runs = running[:, step] = (on & ~stops) | (~on & wants & free)
            since = np.where(runs == on, since + 1.0, 1.0)
            slower, faster = (self._moved(load, change, runs) for change in (-self.change, self.change))
            load = np.where(wants, faster, slower)
            owed = owed + demand[:, step] - load
        return self.scheduled(running, before)

    def scheduled(self, running: NDArray[np.bool_], before: Floats) -> Schedule:
        """The schedule of machines that run as ``running`` ``(n, T, m)`` says, from the controls in force ``(n, c)`` on."""
        low, high = np.zeros(running.shape), np.zeros(running.shape)
        least = most = before[:, self.columns]
        steps = running.shape[1]
        for step in range(steps):
            low[:, step] = least = self._moved(least, -self.change, running[:, step])
            high[:, step] = most = self._moved(most, self.change, running[:, step])
        for step in range(steps - 2, -1, -1):  # as low as it has to be to stop in time
            after = np.where(high[:, step + 1] > 0.0, high[:, step + 1] + self.change, self.lowest)
            high[:, step] = np.minimum(high[:, step], after)
        return Schedule(np.minimum(low, high), high)

    def _moved(self, load: Floats, change: float, runs: NDArray[np.bool_]) -> Floats:
        """Load after a step: changed as far as it goes, the lowest where a machine starts, 0 where it does not run."""
        return np.where(runs, np.where(load > 0.0, np.clip(load + change, self.lowest, 1.0), self.lowest), 0.0)

    def at_full_load(self, controls: Floats) -> Floats:
        """Controls ``(..., T, c)`` with all machines at full load: where plans with a schedule begin."""
        controls = controls.copy()
        controls[..., self.columns] = 1.0
        return controls

    def within(self, controls: Floats, demand: Floats, before: Floats, schedule: Schedule | None) -> Floats:
        """Controls ``(..., T, c)`` with the machines as in ``demand``: at any load from 0 to 1, or at those that a schedule allows.

        ``before`` are the controls in force ``(..., c)``.
        """
        if not self.columns.size:
            return controls
        controls, loads = controls.copy(), np.clip(demand[..., self.columns], 0.0, 1.0)
        if schedule is not None:
            # Off lies one change below the lowest load; loads between limits that move little enough stay there.
            off = self.lowest - self.change
            loads = np.where(schedule.high > 0.0, np.clip(loads, schedule.low, schedule.high), off)
            load = before[..., self.columns]
            loads = feasible(loads, np.where(load > 0.0, load, off), np.ones(len(off)), self.change)
            loads = np.clip(loads, schedule.low, schedule.high)
        controls[..., self.columns] = loads
        return controls
