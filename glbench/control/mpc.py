"""Predictive control: in every step a plan for the hours ahead, of which the first step is taken.

A plan is made from the one before, a step later, by the iterations that plan a season (``glbench.control.trust_region``): linearise,
improve within a trust region, simulate several lengths of the improvement, keep the best. What the state at the end of the horizon is
worth is given by an ``EndValue``. Reasons and figures: docs/adr/0020-predictive-control.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.arrays import Floats
from glbench.control.delivery import Delivery
from glbench.control.machines import Machines, Schedule
from glbench.control.scenario import with_schedule
from glbench.control.season import EndValue, money_in_reward
from glbench.control.stage import StageReward, judged_at_the_end, with_constraints
from glbench.control.trust_region import LENGTHS, feasible, radius_shares, trust_region_step
from glbench.env.air import AIR
from glbench.env.spaces import the_task
from glbench.errors import ShapeError, StepError, TaskError, UnknownNameError, did_you_mean, refuse, whole_number
from glbench.kernel import Kernel
from glbench.kernel.trajectories import RolloutError, Trajectory
from glbench.tasks import TaskSpec
from glbench.untrusted import quoted

Rows = NDArray[np.intp]
_Result = TypeVar("_Result")

_FIRST_RADIUS, _LEAST_RADIUS, _LARGEST_RADIUS = 0.1, 0.02, 0.3
"""Trust region of a run: how far a control may move in an iteration."""
_SHORT, _LONG = 1, 5
"""Up to this place of ``LENGTHS`` a trust region shrinks, from this one on it grows."""
_SHRINK, _GROW = 0.75, 1.3
_SMOOTHING = 0.003
"""Width within which violations count quadratically, as a share of the distance between the limits."""
_NEXT = 8
"""Coming steps whose derivatives every decision recomputes."""
_ROOM = 1.5
"""Memory for the derivatives of so many horizons."""
_TOGETHER = 8
"""Runs whose plans are improved together: as many as the processor's cache and its vectors hold."""


class PredictiveController:
    """Plans the controls of some runs of a task over a receding horizon.

    It knows no more than each call tells: state, weather, parameters and prices may be true, estimated or guessed. Rows do not know of each
    other, and each has the bits that it has alone. A new one is ready for one run, as after ``reset(1)``.

    Raises ``TaskError`` when the reward has no derivatives, the limits leave no room for the margin, or the end value is none, or for
    another model, ``UnknownNameError`` when a margin is for a quantity without limits, and ``ShapeError`` when a number is too small.

    ``task`` has the model, the reward, which needs derivatives (``StageReward``), and the limits. ``horizon`` steps are planned ahead; at
    the end of a season it ends with it. ``iterations`` are those of each plan, ``first_iterations`` of the first one, which has no plan
    before it, each with ``ascent_steps`` gradient steps. ``end_value`` is what the state at the end of a horizon is worth. Without one only
    the horizon counts: fruit is not yet ripe, the soil cools, and carbohydrate in store is wasted. ``margin`` is how far the limits are
    moved inwards, by quantity, in its unit, for what is known roughly: ``{"relative_humidity": 1.0}`` plans for 84 % if the limit is 85 %.

    The derivatives of a step ahead are recomputed once in ``renew_every`` decisions, those of the coming steps in every decision. 1
    recomputes all of them in every decision; more is faster. No plan gets worse: each candidate is simulated (kernel ``preset``).
    """

    def __init__(
        self,
        task: TaskSpec | str,
        *,
        horizon: int = 96,
        iterations: int = 1,
        first_iterations: int = 12,
        end_value: EndValue | None = None,
        margin: Mapping[str, float] | None = None,
        ascent_steps: int = 30,
        renew_every: int = 1,
        preset: str = "fast",
    ) -> None:
        self.task = task = the_task(task)
        self.horizon = _at_least_one(horizon, "The horizon")
        self._room = int(_ROOM * self.horizon)
        self._iterations = _at_least_one(iterations, "The number of iterations")
        self._first_iterations = _at_least_one(first_iterations, "The number of first iterations")
        self._ascent_steps = _at_least_one(ascent_steps, "The number of gradient steps")
        self._renew_every = _at_least_one(renew_every, "The number of decisions after which derivatives are recomputed")
        judged = _within(task, dict(margin or {}))
        near = judged_at_the_end(judged)
        self._stage, self._smooth = StageReward(judged), StageReward(near, smoothing=_SMOOTHING)
        self._kernel = Kernel(near.model_value, task.step_seconds, preset=preset)
        # What is tried is judged as the task judges, by meters where it judges means. The model without meters has the same states and
        # parameters, without those of the meters at the end.
        self._judge = Kernel(judged.model_value, task.step_seconds, preset=preset)
        for kernel, whose in ((self._kernel, near), (self._judge, judged)):  # now, and not within the time of the first decision
            kernel.prepare(whose.parameters())
        self._states, self._parameters = len(near.model_value.states), len(near.model_value.parameter_names)
        self._meters, self._limits = (len(judged.model_value.states) - self._states, judged.parameters()[self._parameters :])
        self._end_value = end_value
        if end_value is not None:
            if not isinstance(end_value, EndValue):
                msg = (
                    f"The end value of a PredictiveController is an EndValue; got {quoted(end_value)}. Make one of plans, "
                    "EndValue.of_plans(plans), or of the content of a file, EndValue.read(json.loads(path.read_text()))."
                )
                raise TaskError(msg)
            end_value(near, 0.0, 0.0)  # says now whether it fits
        self._profit = StageReward(near, counted="epi") if end_value is not None and end_value.gross else None
        names = task.model_value.control_names
        self._high = np.array([float(name in task.actuation.controls) for name in names])
        self._near = near
        self.reset(1)

    def reset(self, runs: int, controls: ArrayLike | None = None) -> None:
        """``runs`` runs begin.

        ``controls`` are where the first plan begins, fractions: ``(T, c)`` or ``(runs, T, c)``. Without any it begins with the controls in
        force. Raises ``ShapeError`` when the number of runs is none, or the controls have another shape.
        """
        self._runs = _at_least_one(runs, "The number of runs")
        self._radius = np.full(self._runs, _FIRST_RADIUS)
        self._at, self._steps_done, self._decisions = 0, 0, 0
        # Steps ahead, in one piece of memory: the horizon moves on in it, and back to its start when the end is reached.
        self._jacobians, self._slots = np.zeros(0), np.arange(0)
        self._renewed = np.zeros(self._runs, dtype=np.bool_)
        self._plan = np.zeros((self._runs, 0, len(self._high)))
        self._machines, self._before = Machines(self.task, self._runs), np.zeros((self._runs, len(self._high)))
        if controls is not None:
            first = np.asarray(controls, dtype=np.float64)
            if first.ndim not in (2, 3) or first.shape[-1] != len(self._high) or first.shape[:-2] not in ((), (self._runs,)):
                msg = f"The first controls are (steps, {len(self._high)}), for each run or for all {self._runs}; got {first.shape}."
                raise ShapeError(msg)
            self._plan = np.array(np.broadcast_to(first, (self._runs, *first.shape[-2:])))
        self._relaxed = self._plan

    @property
    def plan(self) -> Floats:
        """Controls of the steps to come as they are planned now ``(runs, T, c)``; those that were taken are gone."""
        return self._plan[:, self._at :].copy()

    def decide(
        self,
        x: ArrayLike,
        u_before: ArrayLike,
        d: ArrayLike,
        p: ArrayLike,
        calendar: ArrayLike,
        days_left: float | None = None,
        delivery: Delivery | None = None,
    ) -> Floats:
        """Replan, and give the controls of the coming step.

        A run keeps its plan if its state or weather is not finite or a step cannot be integrated. A control in force that is not finite is
        taken to be the one before.

        Raises ``ShapeError`` when a shape does not fit, or the controller has an end value and is not told the days left.

        ``x`` are the states now ``(runs, s)``; those of meters may be missing. ``u_before`` are the controls in force ``(runs, c)``. ``d``
        are the disturbances of the steps ahead ``(T, disturbances)``, for each run or for all; T is how far is planned: ``horizon``, or
        less near the end of the season. ``p`` are parameters: ``(p,)``, ``(runs, p)``, or ``(runs, T, p)`` where they differ by step.
        ``calendar`` has hour of day [h], day of year, prices and scheduled controls at the start of each step and at the end of the last
        ``(T + 1, columns)``, for each run or for all, as in ``Scenario.calendar``. ``days_left`` are those to the end of the season, which
        an end value needs. ``delivery`` is what actuators are expected to deliver of the plan, whose controls are commands then
        (``StateEstimator.delivery``); all of it by default.

        Returns fractions ``(runs, c)``. They change by at most ``max_change``, unless machines switch; scheduled ones follow the calendar.
        """
        if self._end_value is not None and (days_left is None or np.isnan(days_left)):
            msg = (
                f"The end value needs the days from now to the end of the season; got days_left={days_left}. In step k they are "
                "(task.steps - k) / task.steps_per_day."
            )
            raise ShapeError(msg)
        states, before, weather, parameters, dates = self._checked(x, u_before, d, p, calendar)
        before = np.where(np.isfinite(before), before, self._before)
        steps, day = weather.shape[1], self.task.steps_per_day
        # The search begins with what is left of the plan, and behind it with what was planned a day before.
        planned, places = self._plan.shape[1], self._at + np.arange(steps)
        if planned:
            places -= np.where(places >= planned, np.minimum((places - planned) // day + 1, places // day) * day, 0)
            places = np.minimum(places, planned - 1)
        nothing = np.repeat(before[:, None], steps, axis=1)
        plan = self._feasible(self._relaxed[:, places] if planned else nothing, before, dates)
        rest = self._plan[:, places] if planned else nothing
        end = np.zeros((self._runs, self._states))
        if self._end_value is not None and days_left is not None:
            after = days_left - steps * self.task.step_seconds / 86400.0
            if after > 1e-9:  # nothing comes after horizons that end with the season
                end = self._end_value(self._near, dates[:, -1, 0], after)
        # Derivatives of the last decision stay in their slots, and those to recompute are marked.
        overlap = len(self._slots) - self._at
        self._move_on(overlap, steps)
        turn = (self._steps_done + np.arange(steps) - self._decisions) % self._renew_every == 0
        self._outdated = np.tile(turn, (self._runs, 1))
        self._outdated[:, :_NEXT] = self._outdated[:, max(overlap, 0) :] = True
        self._outdated[~self._renewed] = True
        self._renewed[:] = False
        rows = np.flatnonzero(np.isfinite(states).all(axis=1) & np.isfinite(weather).all(axis=(1, 2)))

        def improve(plan: Floats, iterations: int, schedule: Schedule | None = None) -> None:
            for first in range(0, len(rows), _TOGETHER):
                some = rows[first : first + _TOGETHER]
                for _ in range(iterations):
                    some = self._improve(plan, some, states, before, weather, parameters, dates, end, delivery, schedule)
                self._renewed[some] = True

        improve(plan, self._iterations if self._decisions else self._first_iterations)
        self._relaxed, self._before = plan, before
        if self._machines.columns.size:
            schedule = self._machines.near(plan, before, self._machines.since)
            plan = self._feasible(self._machines.at_full_load(plan), before, dates, schedule)
            self._renewed[:] = False
            improve(plan, self._iterations, schedule)
            plan[~self._renewed] = self._feasible(rest, before, dates)[~self._renewed]  # as it was planned before
        self._plan, self._at, self._decisions = plan, 0, self._decisions + 1
        return self.follow()

    def follow(self) -> Floats:
        """Take the next step of the plan as it stands ``(runs, c)``: cheaper than a new one. Raises ``ShapeError`` when it is over."""
        if self._at >= self._plan.shape[1]:
            refuse(f"The plan has {self._plan.shape[1]} steps, and all are taken: decide makes another one.", ShapeError)
        self._at, self._steps_done = self._at + 1, self._steps_done + 1
        controls = self._plan[:, self._at - 1].copy()
        self._machines.follow(self._before, controls)
        self._before = controls
        return controls.copy()

    def _improve(
        self,
        plan: Floats,
        rows: Rows,
        x: Floats,
        before: Floats,
        d: Floats,
        p: Floats,
        calendar: Floats,
        end: Floats,
        delivery: Delivery | None,
        schedule: Schedule | None,
    ) -> Rows:
        """One iteration on some rows of ``plan``, in place; gives those that can be improved further."""

        def linearise(some: Rows) -> Trajectory:
            return self._linearise(some, x[some], _delivered(plan[some], delivery, some), d[some], _of(p, some))

        linearisation, rows = _of_those_that_can(linearise, rows)
        if linearisation is None:
            return rows
        u, u0, dates, worth = plan[rows], before[rows], calendar[rows], end[rows]
        if self._profit is not None and worth.any():  # what stocks gain by the end is in the reward of the steps
            sold = self._profit.gradient(linearisation.x[:, -2:], u[:, -1:], dates[:, -2:])[1].after[:, 0]
            worth = worth - money_in_reward(self._near) * sold
        region = self._radius[rows, None, None] * radius_shares(self._smooth, linearisation)
        switched = None if schedule is None else schedule.of_rows(rows)
        move = trust_region_step(
            self._smooth,
            linearisation,
            u,
            dates,
            region,
            lambda controls: self._feasible(controls, u0, dates, switched),
            steps=self._ascent_steps,
            end=worth,
            delivery=None if delivery is None else delivery.of_rows(rows),
        )
        candidates = np.stack([self._feasible(u + share * move, u0, dates, switched) for share in LENGTHS], axis=1)
        controls = np.stack([_delivered(candidates[:, place], delivery, rows) for place in range(len(LENGTHS))], axis=1)
        ends = self._rollouts(controls, x[rows], d[rows], _of(p, rows))
        earned = self._stage(ends, controls, np.repeat(dates[:, None], len(LENGTHS), axis=1)).reward.sum(axis=-1)
        # Relative to where the plan leads, so that what the whole plants are worth does not hide what differs.
        last = ends[:, :, -1, : self._states]
        ahead = ((last - linearisation.x[:, None, -1]) * worth[:, None]).sum(axis=-1)
        best = np.where(np.isfinite(earned + ahead), earned + ahead, -np.inf).argmax(axis=1)
        plan[rows] = candidates[np.arange(len(rows)), best]
        radius = self._radius[rows]
        radius = np.where(best <= _SHORT, np.maximum(radius * _SHRINK, _LEAST_RADIUS), radius)
        self._radius[rows] = np.where(best >= _LONG, np.minimum(radius * _GROW, _LARGEST_RADIUS), radius)
        return rows

    def _linearise(self, rows: Rows, x: Floats, u: Floats, d: Floats, p: Floats) -> Trajectory:
        """The plans of ``rows``, simulated, with stored and recomputed derivatives."""
        kernel, outdated = self._kernel, self._outdated[rows]
        if outdated.all():
            linearisation = kernel.linearise_trajectory(x, u, d, p)
            if self._renew_every > 1:
                if not self._jacobians.size:
                    self._jacobians = np.zeros((self._runs, self._room, *linearisation.jacobians.shape[2:]))
                self._jacobians[rows[:, None], self._slots] = linearisation.jacobians
            return linearisation
        states = kernel.rollout(x, u, d, p)
        run, step = np.nonzero(outdated)
        renewed = kernel.linearise(
            states[run, step], u[run, step], d[run, step], p[run, step] if p.ndim == 3 else _of(p, run), inputs=("x", "u")
        )
        self._jacobians[rows[run], self._slots[step]] = np.concatenate([renewed.du, renewed.dx], axis=2).swapaxes(1, 2)
        ahead = self._jacobians[:, self._slots[0] : self._slots[-1] + 1]
        in_turn = len(rows) == rows[-1] - rows[0] + 1  # then nothing is copied
        return Trajectory(states, ("x", "u"), ahead[rows[0] : rows[-1] + 1] if in_turn else ahead[rows], kernel)

    def _move_on(self, overlap: int, steps: int) -> None:
        """Begin with the coming step; the derivatives of the first ``overlap`` steps are kept."""
        first = int(self._slots[0]) + self._at if overlap > 0 else 0
        if first + steps > self._room:
            for run in range(len(self._jacobians)):
                self._jacobians[run, :overlap] = self._jacobians[run, first : first + overlap].copy()
            first = 0
        self._slots = first + np.arange(steps)

    def _rollouts(self, candidates: Floats, x: Floats, d: Floats, p: Floats) -> Floats:
        """States ``(rows, lengths, T + 1, s)``, with meters where there are some; NaN where a step fails."""
        n, lengths, steps, _ = candidates.shape
        start = np.concatenate([x, np.zeros((n, self._meters))], axis=1)
        limits = np.broadcast_to(self._limits, (*p.shape[:-1], len(self._limits)))
        judged_p = np.concatenate([p, limits], axis=-1)
        states = np.full((n, lengths, steps + 1, start.shape[1]), np.nan)
        row, length = (part.ravel() for part in np.meshgrid(np.arange(n), np.arange(lengths), indexing="ij"))
        while len(row):
            try:
                states[row, length] = self._judge.rollout(start[row], candidates[row, length], d[row], _of(judged_p, row))
                break
            except RolloutError as failed:
                row, length = np.delete(row, failed.horizon), np.delete(length, failed.horizon)
        return states

    def _feasible(self, controls: Floats, before: Floats, calendar: Floats, schedule: Schedule | None = None) -> Floats:
        within = feasible(controls, before, self._high, self.task.actuation.max_change)
        return with_schedule(self.task, self._machines.within(within, controls, before, schedule), calendar)

    def _checked(
        self, x: ArrayLike, u_before: ArrayLike, d: ArrayLike, p: ArrayLike, calendar: ArrayLike
    ) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """The inputs of ``decide``, one row a run."""
        n = self._runs
        states, before, weather, parameters, dates = (np.asarray(a, dtype=np.float64) for a in (x, u_before, d, p, calendar))
        count = len(self.task.model_value.states)
        if states.shape not in ((n, count), (n, self._states)):
            raise ShapeError(_wrong("states", states, f"({n}, {count})"))
        if before.shape != (n, len(self._high)):
            raise ShapeError(_wrong("controls in force", before, f"({n}, {len(self._high)})"))
        if weather.ndim not in (2, 3) or weather.shape[:-2] not in ((), (n,)) or not 1 <= weather.shape[-2] <= self.horizon:
            raise ShapeError(_wrong("disturbances", weather, f"(T, d) or ({n}, T, d), with T from 1 to {self.horizon}"))
        weather = np.broadcast_to(weather, (n, *weather.shape[-2:]))
        if parameters.ndim not in (1, 2, 3) or parameters.shape[-1] < self._parameters:
            raise ShapeError(_wrong("parameters", parameters, "(p,), (runs, p) or (runs, T, p)"))
        if parameters.ndim > 1 and len(parameters) != n:
            raise ShapeError(_wrong("parameters", parameters, f"(p,) or a row for each run, ({n}, ...)"))
        steps = weather.shape[1]
        if dates.ndim not in (2, 3) or dates.shape[:-2] not in ((), (n,)) or dates.shape[-2] != steps + 1:
            raise ShapeError(_wrong("calendar", dates, f"({steps + 1}, columns) or ({n}, {steps + 1}, columns)"))
        dates = np.broadcast_to(dates, (n, *dates.shape[-2:]))
        return states[:, : self._states], before, weather, parameters[..., : self._parameters], dates


def _of_those_that_can(make: Callable[[Rows], _Result], rows: Rows) -> tuple[_Result | None, Rows]:
    """What ``make`` gives for those rows for which it does not fail, and these rows."""
    try:
        return (make(rows) if len(rows) else None), rows
    except StepError:
        if len(rows) == 1:
            return None, rows[:0]
    return _of_those_that_can(make, np.concatenate([_of_those_that_can(make, rows[i : i + 1])[1] for i in range(len(rows))]))


def _delivered(commands: Floats, delivery: Delivery | None, rows: Rows) -> Floats:
    """What actuators deliver of the commands of some rows."""
    if delivery is None:
        return commands
    of_rows = delivery.of_rows(rows)
    return np.clip(of_rows(commands) + of_rows.rest, 0.0, 1.0)


def _of(p: Floats, rows: Rows) -> Floats:
    """Parameters of some rows."""
    return p if p.ndim == 1 else p[rows]


def _within(task: TaskSpec, margin: dict[str, float]) -> TaskSpec:
    """The task with limits moved inwards."""
    limits = dict(task.constraints.items())
    for name in margin:
        if name not in limits:
            msg = f"{task.id} has no limits of '{name}', which a margin is for.{did_you_mean(name, limits)} Quantities: {', '.join(AIR)}."
            raise UnknownNameError(msg)
        if not (np.isfinite(margin[name]) and 0.0 <= margin[name] < (limits[name].high - limits[name].low) / 2.0):
            msg = (
                f"The margin of {name} is 0 or more, and less than half the distance between {limits[name].low:g} and "
                f"{limits[name].high:g}; got {margin[name]!r}."
            )
            raise ShapeError(msg)
    moved = {
        name: limits[name].model_copy(update={"low": limits[name].low + by, "high": limits[name].high - by})
        for name, by in margin.items()
        if by > 0.0
    }
    return with_constraints(task, moved) if moved else task


def _at_least_one(value: int, what: str) -> int:
    number = whole_number(value, what)
    if number < 1:
        refuse(f"{what} is 1 or more; got {number}.", ShapeError)
    return number


def _wrong(what: str, values: Floats, expected: str) -> str:
    return f"Wrong shape of the {what}: got {values.shape}, expected {expected}."
