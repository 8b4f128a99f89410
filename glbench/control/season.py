"""Perfect-information plans for a whole season, and what they say of the worth of states at the end of a short horizon.

Plans are made by sequential convex programming along the trajectory. Each iteration linearises the season's steps around the plan, improves
the rewards of the linearised season within a trust region of each day, corrects the improvement by what the linearised season got wrong
about it, and simulates eight step lengths. Each day keeps the length that serves it best, judged by what it earns itself and by what the
rest of the season makes of the state that it leaves (the costates). No result is worse than the controls that it began with. Why it is
done like this: docs/adr/0019-plans-by-sequential-convex-programming.md.

An end value is made of the costates of such plans. Why a short horizon needs one: docs/adr/0020-predictive-control.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from glbench.arrays import Floats
from glbench.control.machines import Machines, Schedule
from glbench.control.scenario import Scenario, with_schedule
from glbench.control.stage import StageReward, StageValues, judged_at_the_end
from glbench.control.trust_region import LENGTHS, feasible, radius_shares, trust_region_step
from glbench.env.actuation import actions_of
from glbench.env.program import calendar_columns
from glbench.env.spaces import the_task
from glbench.errors import GlbenchError, ShapeError, TaskError, refuse, whole_number
from glbench.kernel import Kernel
from glbench.tasks import TaskSpec

_FIRST_RADIUS, _LARGEST_RADIUS = 0.1, 0.3
"""Trust region of a day: how far a control may move."""
_SHORT, _LONG = 1, 4
"""Up to this place of ``LENGTHS`` a trust region shrinks, from this one on it grows."""
_SHRINK, _GROW = 0.85, 1.3
_FIRST_SMOOTHING, _LAST_SMOOTHING = 0.01, 0.001
"""Width within which violations count quadratically, as a share of the distance between the limits."""
_INNER, _CORRECTING = 60, 30
"""Gradient steps on a linearised season: to improve it, and to correct the improvement."""
_CORRECTING_RATE = 0.1
"""Length of the first of the latter in trust regions."""
_BETWEEN = 4
"""Iterations after which machines are dispatched (again)."""


@dataclass(frozen=True, eq=False)
class SeasonPlan:
    """Controls for all steps of a run, and what they earn in it."""

    scenario: Scenario
    """The run, of which everything was known."""
    controls: Floats
    """What acts, fractions ``(T, c)``: what actuators deliver of the commands."""
    states: Floats
    """Where they lead ``(T + 1, s)``."""
    values: StageValues
    """What the steps earn, by the kernel that planned; ``glbench evaluate`` scores with ``reference``."""
    commands: Floats
    """The actuators' commands ``(T, c)``, the controls where all are ideal; none changes by more than ``max_change`` in a step, but for
    scheduled ones and machines that switch."""

    @property
    def reward(self) -> float:
        """Sum of all steps."""
        return float(self.values.reward.sum())

    def actions(self) -> Floats:
        """Actions ``(T, actions)`` that give these commands. Raises ``TaskError`` when actions are set points of a process computer."""
        return actions_of(self.scenario.task, np.vstack([self.scenario.u_before, self.commands[:-1]]), self.commands)


@dataclass(frozen=True)
class Iteration:
    """How far a search has come."""

    number: int
    """From 1."""
    reward: float
    """Of the plan."""
    gained: float
    """By this iteration."""
    radius: float
    """Mean trust region of the days."""


def plan_season(
    scenario: Scenario, controls: ArrayLike, *, iterations: int = 35, preset: str = "fast",
    watch: Callable[[Iteration], None] | None = None, dispatch: Callable[[SeasonPlan], Floats | None] | None = None,
) -> SeasonPlan:  # fmt: skip
    """Improve the controls of a season with perfect information.

    Raises ``ShapeError`` when the controls have another shape or are not finite, or the number of iterations is none. Raises ``TaskError``
    when the reward has no derivatives. Raises ``StepError`` when a step of the first plan cannot be integrated.

    ``scenario`` is the run; its task needs a reward with derivatives (``StageReward``). The search begins at ``controls``, fractions
    ``(T, c)``: the commands of a good controller, brought within the bounds and the largest change. Machines that are off or on are taken
    to run as the task lets them. An iteration takes about 3 s of one core for 5,760 steps; ``watch`` is called after each. ``preset`` is
    that of the kernel that plans. The plan returned is the best one known, and no proof that there is none better. The same arguments give
    the same bits. ``dispatch``, such as ``glbench.bounds.commitment.redispatched``, is asked every few iterations how machines that are off
    or on should run for what the plan asks of them: commands ``(T, c)``, or ``None``.
    """
    count = whole_number(iterations, "The number of iterations")
    search = _Search(scenario, np.asarray(controls, dtype=np.float64), preset)
    best = search.plan
    shrink = (_LAST_SMOOTHING / _FIRST_SMOOTHING) ** (1.0 / max(count, 1))
    again = range(_BETWEEN, count, _BETWEEN) if dispatch is not None else ()
    turns = ([*again] or [count // 2]) if scenario.task.on_off else []
    for number in range(count):
        if number in turns:
            search.switch(None if dispatch is None else dispatch(search.plan))
        gained = search.improve(_FIRST_SMOOTHING * shrink**number)
        if search.schedule is not None or not turns:
            best = max(best, search.plan, key=lambda plan: plan.reward)
        if watch is not None:
            watch(Iteration(number + 1, search.plan.reward, gained, float(search.radius.mean())))
    return best


class _Search:
    """A plan, and what is needed to improve it."""

    def __init__(self, scenario: Scenario, controls: Floats, preset: str) -> None:
        self.scenario, task = scenario, scenario.task
        shape = (task.steps, len(scenario.high))
        if controls.shape != shape or not np.isfinite(controls).all():
            refuse(f"The controls to begin with are finite and have the shape {shape}; got {controls.shape}.", ShapeError)
        self.task, self.near = task, judged_at_the_end(task)
        self.reward = StageReward(task)
        self.kernel = Kernel(task.model_value, task.step_seconds, preset=preset)
        self.plain = Kernel(self.near.model_value, task.step_seconds, preset=preset)
        # The model without meters has the same states and parameters, without those of the meters at the end.
        self.s = len(self.near.model_value.states)
        self.p = scenario.p[..., : len(self.near.model_value.parameter_names)]
        self.starts = np.arange(0, task.steps, task.steps_per_day)
        self.ends = np.minimum(self.starts + task.steps_per_day, task.steps)
        self.days = np.repeat(np.arange(len(self.starts)), self.ends - self.starts)
        self.radius = np.full(len(self.starts), _FIRST_RADIUS)
        self.machines = Machines(task)
        self.schedule: Schedule | None = None
        self.plan = self._simulated(self._feasible(controls)[None])[0]

    def switch(self, dispatched: Floats | None = None) -> None:
        """Go on with machines that are off or on, as they are in ``dispatched``, or else near the plan in which they ran at any load."""
        if dispatched is None and self.schedule is not None:
            return
        commands, before = self.plan.commands[None], self.scenario.u_before[None]
        if dispatched is None:
            schedule, other = self.machines.near(commands, before, self.machines.since), self.machines.at_full_load(commands)
        else:
            other = dispatched[None]
            schedule = self.machines.scheduled(other[..., self.machines.columns] > 0.5 * self.machines.lowest, before)
        self.schedule, candidates = schedule.of_rows(0), np.concatenate([commands, other])
        self.plan = max(self._simulated(self._feasible(candidates)), key=lambda plan: plan.reward)
        if dispatched is not None:
            self.radius[:] = _FIRST_RADIUS

    def improve(self, smoothing: float) -> float:
        """One iteration; gives what it gained."""
        plan, stage, calendar = self.plan, StageReward(self.near, smoothing=smoothing, inward=True), self.scenario.calendar
        linearisation = self.plain.linearise_trajectory(plan.states[0, : self.s], plan.controls, self.scenario.d, self.p)
        _, slopes = stage.gradient(linearisation.x, plan.controls, calendar)
        # What the rest of the season makes of a state: without the end of the step that led there.
        worth = linearisation.pull(slopes.states).costates
        worth[1:] -= slopes.after
        radius = self.radius[self.days, None] * radius_shares(stage, linearisation)
        delivery = self.scenario.delivery
        move = trust_region_step(stage, linearisation, plan.commands, calendar, radius, self._feasible, steps=_INNER, delivery=delivery)
        # Second-order correction: the move is improved again where the states are that it really leads to.
        p = self.p if self.p.ndim == 1 else self.p[None]
        effect = move if delivery is None else delivery(move)
        there = self.plain.rollout(linearisation.x[:1], self.scenario.delivered(plan.commands + move)[None], self.scenario.d, p)[0]
        bend = -move + trust_region_step(
            stage, linearisation, plan.commands, calendar, radius, self._feasible, steps=_CORRECTING, rate=_CORRECTING_RATE,
            start=move, x=there - linearisation.push(effect), delivery=delivery,
        )  # fmt: skip

        def at(length: float | Floats) -> Floats:
            return self._feasible(plan.commands + length * move + length**2 * bend)

        candidates = self._simulated(np.array([at(length) for length in LENGTHS]))
        # The length that serves each day best, by what it earns and what its last state is worth to the days after.
        scores = np.empty((len(candidates), len(self.starts)))
        for place, candidate in enumerate(candidates):
            ahead = ((candidate.states - plan.states)[:, : self.s] * worth).sum(axis=1)
            earned = np.add.reduceat(candidate.values.reward, self.starts)
            scores[place] = earned + ahead[self.ends] - ahead[self.starts]
        best = scores.argmax(axis=0)
        merged = self._simulated(at(LENGTHS[best][self.days, None])[None])
        self.plan = max([plan, *candidates, *merged], key=lambda one: one.reward)
        self.radius = np.where(best <= _SHORT, self.radius * _SHRINK, self.radius)
        self.radius = np.where(best >= _LONG, np.minimum(self.radius * _GROW, _LARGEST_RADIUS), self.radius)
        return self.plan.reward - plan.reward

    def _simulated(self, commands: Floats) -> list[SeasonPlan]:
        """Plans of commands ``(n, T, c)``."""
        scenario, n, controls = self.scenario, len(commands), self.scenario.delivered(commands)
        p = scenario.p if scenario.p.ndim == 1 else scenario.p[None]
        states = self.kernel.rollout(np.tile(scenario.x0, (n, 1)), controls, scenario.d, p)
        plans = zip(controls, states, commands, strict=True)
        return [SeasonPlan(scenario, u, x, self.reward(x, u, scenario.calendar), command) for u, x, command in plans]

    def _feasible(self, controls: Floats) -> Floats:
        one = self.scenario
        within = feasible(controls, one.u_before, one.high, one.max_change)
        return with_schedule(one.task, self.machines.within(within, controls, one.u_before, self.schedule), one.calendar)


_DAYS = 10.0
"""Costates are averaged over so many days,"""
_HOURS = 3.0
"""and over so many hours of the day."""
_LEAST = 1e-4
"""What a state has to be worth as it changes from day to day, to be kept [EUR m-2]."""
_SMOOTHING = 0.15
"""Width within which violations count quadratically, as a share of the distance between the limits: a plan runs along a limit, where the
derivative of a violation is all or nothing, and a controller that comes there again gives way."""
_DIGITS = 3
"""Significant digits of what is kept: more than plans of two seasons agree on."""


@dataclass(frozen=True, eq=False)
class EndValue:
    """What a unit of each state is worth [EUR m-2], by the days left and by the hour of day: the product of two profiles.

    The value of states is linear in them, and 0 at the end of the season. Between its points it is interpolated.
    """

    states: tuple[str, ...]
    """Names of those that are worth something."""
    days_left: Floats
    """Days to the end of the season, rising, the first 0 ``(k,)``."""
    by_days_left: Floats
    """Mean over the hours of a day ``(k, states)``; the first row is 0."""
    by_hour: Floats
    """Factors for hours of the day, their mean 1 ``(8, states)``: the first for 0:00 to 3:00, in the middle of these hours."""
    gross: bool = False
    """Whether it includes what states add to the value of stocks (heads of lettuce). The reward of each step has that, too, at a price that
    depends on the states, so ``PredictiveController`` subtracts it. Without: it is subtracted already, at the mean of the plans."""

    @classmethod
    def of_plans(cls, plans: Sequence[SeasonPlan], *, preset: str = "fast") -> EndValue:
        """The mean over plans for seasons of tasks with one model and one length, from scenarios that may be trained on.

        States that are worth less than a hundredth of a cent, as they change from day to day, are left out.

        Raises ``GlbenchError`` when there is no plan, or plans differ in model or length.
        """
        kinds = {(plan.scenario.task.model_id, plan.scenario.task.steps, plan.scenario.task.step_seconds) for plan in plans}
        if len(kinds) != 1:
            msg = f"An end value is the mean over plans of one model and one length; got {len(plans)} plans of {len(kinds)} kinds."
            raise GlbenchError(msg)
        task = plans[0].scenario.task
        model = judged_at_the_end(task).model_value
        money = money_in_reward(task)
        worth, days, hours = [], [], []
        changes = np.zeros(len(model.states))
        for plan in plans:
            worth.append(_worth(plan, preset) / money)
            days.append(np.arange(task.steps, 0, -1) / task.steps_per_day)
            hours.append(plan.scenario.calendar[:-1, 0])
            daily = plan.states[:: task.steps_per_day, : len(changes)]
            changes += np.abs(np.diff(daily, axis=0)).mean(axis=0) / len(plans)
        values, days_left, hour = np.concatenate(worth), np.concatenate(days), np.concatenate(hours)
        blocks = np.arange(0.0, task.steps / task.steps_per_day, _DAYS)
        by_days = np.array([values[(days_left > start) & (days_left <= start + _DAYS)].mean(axis=0) for start in blocks])
        ends = np.minimum(blocks + _DAYS, days_left.max())
        starts = np.arange(0.0, 24.0, _HOURS)
        of_hours = np.array([values[(hour >= start) & (hour < start + _HOURS)].mean(axis=0) for start in starts])
        mean = of_hours.mean(axis=0)
        counts = np.abs(mean) * changes > _LEAST
        factors = of_hours[:, counts] / mean[counts]
        return cls(
            tuple(name for name, own in zip(model.state_names, counts, strict=True) if own),
            np.concatenate([[0.0], (blocks + ends) / 2.0]),
            _rounded(np.vstack([np.zeros(counts.sum()), by_days[:, counts]])),
            _rounded(factors),
            gross=True,
        )

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> EndValue:
        """The end value that ``written`` gave. Raises ``GlbenchError`` when ``content`` is none."""
        try:
            states = content["states"]
            value = cls(
                tuple(map(str, states)),
                np.array(content["days_left"], dtype=np.float64),
                np.array([entry["by_days_left"] for entry in states.values()], dtype=np.float64).T,
                np.array([entry["by_hour"] for entry in states.values()], dtype=np.float64).T,
                gross=bool(content.get("gross", False)),
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            msg = "This is no end value. Expected days_left, a list of numbers, and states with by_days_left and by_hour."
            raise GlbenchError(msg) from error
        days, count = value.days_left, len(value.states)
        rising = days.ndim == 1 and days.size > 0 and days[0] == 0.0 and bool((np.diff(days) > 0.0).all())
        shapes = value.by_days_left.shape == (days.size, count) and value.by_hour.shape == (int(24.0 / _HOURS), count)
        if not (rising and shapes and all(np.isfinite(a).all() for a in (days, value.by_days_left, value.by_hour))):
            msg = "This is no end value: days_left rise from 0, each state has a number for each of them and 8 for the hours, all finite."
            raise GlbenchError(msg)
        return value

    def written(self) -> dict[str, Any]:
        """The end value as plain values, for a file."""
        return {
            "days_left": self.days_left.tolist(),
            "gross": self.gross,
            "states": {
                name: {"by_days_left": self.by_days_left[:, i].tolist(), "by_hour": self.by_hour[:, i].tolist()}
                for i, name in enumerate(self.states)
            },
        }

    def __call__(self, task: TaskSpec | str, hour_of_day: ArrayLike, days_left: ArrayLike) -> Floats:
        """What a unit of each state of the task's model is worth ``(n, s)``, in the unit of the task's reward.

        Raises ``TaskError`` when the model lacks a state, or the reward does not count money. Of ``task`` counts whose model has the
        states; meters of violations are worth nothing. Horizons end at ``hour_of_day`` and ``days_left``, ``(n,)`` or numbers.
        """
        task = the_task(task)
        names = task.model_value.state_names
        missing = [name for name in self.states if name not in names]
        if missing:
            refuse(f"This end value is not for {task.id}: its model {task.model_id} has no {', '.join(missing)}.", TaskError)
        hour, days = (np.atleast_1d(np.asarray(moment, dtype=np.float64)) for moment in (hour_of_day, days_left))
        middles = np.arange(-_HOURS / 2.0, 24.0 + _HOURS, _HOURS)
        around = np.vstack([self.by_hour[-1:], self.by_hour, self.by_hour[:1]])
        worth = np.zeros((max(len(hour), len(days)), len(names)))
        for i, name in enumerate(self.states):
            level = np.interp(days, self.days_left, self.by_days_left[:, i])
            worth[:, names.index(name)] = level * np.interp(hour, middles, around[:, i])
        worth *= money_in_reward(task)
        return worth


def _worth(plan: SeasonPlan, preset: str, smoothing: float = _SMOOTHING) -> Floats:
    """What a unit of each state is worth to the steps after it ``(T, s)``, stocks of now included, in the unit of the reward."""
    scenario, near = plan.scenario, judged_at_the_end(plan.scenario.task)
    model = near.model_value
    kernel = Kernel(model, near.step_seconds, preset=preset)
    p = scenario.p[..., : len(model.parameter_names)]
    linearisation = kernel.linearise_trajectory(scenario.x0[: len(model.states)], plan.controls, scenario.d, p)
    _, slopes = StageReward(near, smoothing=smoothing).gradient(linearisation.x, plan.controls, scenario.calendar)
    costates = linearisation.pull(slopes.states).costates
    _, sold = StageReward(near, counted="epi").gradient(linearisation.x, plan.controls, scenario.calendar)
    costates[1:] -= slopes.after - money_in_reward(near) * sold.after  # limits that the step before broke are no matter of the days after
    return costates[:-1]


@lru_cache(maxsize=64)
def money_in_reward(task: TaskSpec) -> float:
    """What 1 EUR m-2 is worth in the task's reward."""
    # The same step with all controls off and on: what that costs, and what it does to the reward. Its states do not matter.
    states, controls = (np.full((2, 2, len(task.model_value.states)), 10.0), np.zeros((2, 1, len(task.model_value.controls))))
    controls[1] = 1.0
    calendar = np.ones((2, 2, calendar_columns(task)))
    stage = StageReward(task)(states, controls, calendar)
    earned, reward = (float(a[1, 0] - a[0, 0]) for a in (stage.epi, stage.reward))
    if earned == 0.0 or reward == 0.0:
        refuse(f"An end value counts money, which does not count in the reward of {task.id}.", TaskError)
    return reward / earned


def _rounded(values: Floats) -> Floats:
    """Significant digits only."""
    return np.array([float(f"{value:.{_DIGITS}g}") for value in values.ravel().tolist()]).reshape(values.shape)
