"""Plans for a whole season with everything known: sequential convex programming along the trajectory.

Each iteration linearises the season's steps around the plan, improves the rewards of the linearised season within a trust region of
each day, corrects the improvement by what the linearised season got wrong about it, and simulates eight step lengths. Each day keeps the
length that serves it best, judged by what it earns itself and by what the rest of the season makes of the state that it leaves (the
costates). A plan is never worse than the one that it was made from. Why it is done like this:
docs/adr/0019-plans-by-sequential-convex-programming.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.control.air import air_of
from glbench.control.stage import StageReward, StageValues
from glbench.env.climate import AIR
from glbench.errors import ShapeError, TaskError, whole_number
from glbench.kernel import Kernel

if TYPE_CHECKING:
    from glbench.control.scenario import Scenario
    from glbench.kernel.trajectories import Trajectory
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

_LENGTHS = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0, 1.25])
"""Shares of an improvement that are simulated."""
_SHORT, _LONG = 1, 4
"""Up to this place of ``_LENGTHS`` a day's trust region shrinks, from this one on it grows."""
_SHRINK, _GROW = 0.85, 1.3
_FIRST_RADIUS, _LARGEST_RADIUS = 0.1, 0.3
"""Trust region of a day: how far a control may move."""
_FIRST_SMOOTHING, _LAST_SMOOTHING = 0.01, 0.001
"""Width within which violations count quadratically, as a share of the distance between the limits."""
_INNER, _CORRECTING = 60, 30
"""Gradient steps on a linearised season: to improve it, and to correct the improvement."""
_FIRST_RATE, _CORRECTING_RATE, _LAST_RATE = 0.2, 0.1, 0.005
"""Length of these steps in trust regions, from the first of either kind to the last."""
_MOMENTUM, _MEMORY = 0.9, 0.97
"""Weights of the past in the mean of gradients and in that of their squares."""
_FLAT = 1e-3
"""Gradients of less than this share of the root mean square count as flat."""


@dataclass(frozen=True, eq=False)
class SeasonPlan:
    """Controls for all steps of a run, and what they earn in it.

    Attributes
    ----------
    scenario
        The run, of which everything was known.
    controls
        Fractions ``(T, c)``; none changes by more than ``max_change`` in a step.
    states
        Where they lead ``(T + 1, s)``.
    values
        What the steps earn, by the kernel that planned; ``glbench evaluate`` scores with ``reference``.
    """

    scenario: Scenario
    controls: Floats
    states: Floats
    values: StageValues

    @property
    def reward(self) -> float:
        """Sum of all steps."""
        return float(self.values.reward.sum())

    def actions(self) -> Floats:
        """What an agent has to do to get these controls ``(T, actions)``.

        Raises
        ------
        TaskError
            When the task's actions are not about single controls: set points of a process computer.
        """
        task = self.scenario.task
        names = task.model_value.control_names
        granted = [names.index(name) for name in task.actuation.controls]
        wanted = self.controls[:, granted]
        if task.actuation.kind == "set_point":
            return wanted
        if task.actuation.kind != "rate":
            msg = f"A plan gives controls, and the actions of {task.id} are of the kind '{task.actuation.kind}'."
            raise TaskError(msg)
        before = np.vstack([self.scenario.u_before[granted], wanted[:-1]])
        return np.clip((wanted - before) / self.scenario.max_change, -1.0, 1.0)


@dataclass(frozen=True)
class Iteration:
    """How far a search has come.

    Attributes
    ----------
    number
        From 1.
    reward
        Of the plan.
    gained
        By this iteration.
    radius
        Mean trust region of the days.
    """

    number: int
    reward: float
    gained: float
    radius: float


def plan_season(
    scenario: Scenario,
    controls: ArrayLike,
    *,
    iterations: int = 35,
    preset: str = "fast",
    watch: Callable[[Iteration], None] | None = None,
) -> SeasonPlan:
    """Improve the controls of a season in which everything is known.

    Parameters
    ----------
    scenario
        The run. Its task needs a reward with derivatives (``StageReward``).
    controls
        Where the search begins, fractions ``(T, c)``: those of a good controller, brought within the bounds and the largest change.
    iterations
        How many; one takes some seconds for 5,760 steps.
    preset
        Of the kernel that plans.
    watch
        Is told of each iteration.

    Returns
    -------
    SeasonPlan
        The best plan found. It is the best one known, and no proof that there is none better. The same arguments give the same bits.

    Raises
    ------
    ShapeError
        When the controls have another shape or are not finite, or the number of iterations is none.
    TaskError
        When the reward has no derivatives.
    StepError
        When a step of the first plan cannot be integrated.
    """
    count = whole_number(iterations, "The number of iterations")
    search = _Search(scenario, np.asarray(controls, dtype=np.float64), preset)
    shrink = (_LAST_SMOOTHING / _FIRST_SMOOTHING) ** (1.0 / max(count, 1))
    for number in range(count):
        gained = search.improve(_FIRST_SMOOTHING * shrink**number)
        if watch is not None:
            watch(Iteration(number + 1, search.plan.reward, gained, float(search.radius.mean())))
    return search.plan


def feasible(controls: ArrayLike, before: Floats, high: Floats, max_change: float) -> Floats:
    """The controls nearest to those wanted, in the middle of what is possible, that keep bounds and change little enough.

    Parameters
    ----------
    controls
        Wanted ``(T, c)``.
    before, high
        In force before the first step, and upper bounds ``(c,)``; the lower ones are 0.
    max_change
        The largest change in a step.
    """
    wanted = np.clip(np.asarray(controls, dtype=np.float64), 0.0, high)
    reach = int(np.ceil(1.0 / max_change))
    padded = np.pad(wanted, ((reach, reach), (0, 0)), mode="edge")
    steps = len(wanted)
    lowest, highest = wanted.copy(), wanted.copy()
    for shift in range(-reach, reach + 1):
        there, change = padded[reach + shift : reach + shift + steps], max_change * abs(shift)
        np.minimum(highest, there + change, out=highest)
        np.maximum(lowest, there - change, out=lowest)
    moved: Floats = 0.5 * (lowest + highest)
    first = max_change * np.arange(1, min(steps, reach) + 1)[:, None]
    moved[: len(first)] = np.clip(moved[: len(first)], before - first, before + first)
    return np.clip(moved, 0.0, high)


class _Search:
    """A plan, and what is needed to improve it."""

    def __init__(self, scenario: Scenario, controls: Floats, preset: str) -> None:
        self.scenario, task = scenario, scenario.task
        shape = (task.steps, len(scenario.high))
        if controls.shape != shape or not np.isfinite(controls).all():
            msg = f"The controls to begin with are finite and have the shape {shape}; got {controls.shape}."
            raise ShapeError(msg)
        self.task, self.near = task, _judged_at_the_end(task)
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
        self.plan = self._simulated(self._feasible(controls)[None])[0]

    def improve(self, smoothing: float) -> float:
        """One iteration; gives what it gained."""
        plan, stage = self.plan, StageReward(self.near, smoothing=smoothing)
        lines = self.plain.linearise_trajectory(plan.states[0, : self.s], plan.controls, self.scenario.d, self.p)
        _, slopes = stage.gradient(lines.x, plan.controls, self.scenario.calendar)
        # What the rest of the season makes of a state: without the end of the step that led there.
        worth = lines.pull(slopes.states).costates
        worth[1:] -= slopes.after
        reach = self.radius[self.days, None] * self._scale(lines)
        move = self._better(stage, lines, reach)
        bend = self._corrected(stage, lines, reach, move) - move

        def at(length: float | Floats) -> Floats:
            return self._feasible(plan.controls + length * move + length**2 * bend)

        tried = self._simulated(np.array([at(length) for length in _LENGTHS]))
        best = self._best_by_day(tried, worth)
        merged = self._simulated(at(_LENGTHS[best][self.days, None])[None])
        self.plan = max([plan, *tried, *merged], key=lambda one: one.reward)
        self.radius = np.where(best <= _SHORT, self.radius * _SHRINK, self.radius)
        self.radius = np.where(best >= _LONG, np.minimum(self.radius * _GROW, _LARGEST_RADIUS), self.radius)
        return self.plan.reward - plan.reward

    def _better(self, stage: StageReward, lines: Trajectory, reach: Floats) -> Floats:
        """Changes of the controls, at most ``reach`` each, that improve the rewards of the linearised season."""
        nothing = np.zeros_like(self.plan.controls)
        return self._ascended(stage, lines, reach, lines.x, nothing, _INNER, _FIRST_RATE)

    def _corrected(self, stage: StageReward, lines: Trajectory, reach: Floats, move: Floats) -> Floats:
        """``move``, improved again where the states are that it really leads to (second-order correction)."""
        controls = self._feasible(self.plan.controls + move)
        p = self.p if self.p.ndim == 1 else self.p[None]
        there = self.plain.rollout(lines.x[:1], controls[None], self.scenario.d, p)[0]
        move = controls - self.plan.controls
        return self._ascended(stage, lines, reach, there - lines.push(move), move, _CORRECTING, _CORRECTING_RATE)

    def _ascended(
        self, stage: StageReward, lines: Trajectory, reach: Floats, x: Floats, move: Floats, count: int, rate: float
    ) -> Floats:
        """The best move that so many gradient steps find from ``move``, with states ``x`` where nothing moves."""
        u, calendar = self.plan.controls, self.scenario.calendar
        best, most = move, -np.inf
        mean, square, flat = np.zeros_like(u), np.zeros_like(u), 0.0
        for number in range(1, count + 1):
            values, slopes = stage.gradient(x + lines.push(move), u + move, calendar)
            total = float(values.reward.sum())
            if total > most:
                best, most = move, total
            gradient = slopes.controls + lines.pull(slopes.states).u
            if number == 1:
                flat = _FLAT * float(np.sqrt(np.mean(gradient**2))) or 1.0
            mean = _MOMENTUM * mean + (1.0 - _MOMENTUM) * gradient
            square = _MEMORY * square + (1.0 - _MEMORY) * gradient**2
            direction = mean / (1.0 - _MOMENTUM**number) / (np.sqrt(square / (1.0 - _MEMORY**number)) + flat)
            length = rate * (1.0 - number / count) ** 2 + _LAST_RATE
            move = np.clip(move + length * reach * direction, -reach, reach)
            move = self._feasible(u + move) - u
        return best

    def _scale(self, lines: Trajectory) -> Floats:
        """Shares of a trust region ``(T, c)``, so small that no control alone moves the air by more than from one limit to the other."""
        limits = dict(self.near.constraints.items())
        if self.near.model_value.air is None or not limits:
            return np.ones_like(self.plan.controls)
        slopes = np.abs(air_of(self.near.model_value, lines.x[1:]).gradient @ lines.du)
        spans = np.array([limits[name].high - limits[name].low if name in limits else np.inf for name in AIR])
        scale: Floats = np.minimum(1.0, 1.0 / ((slopes / spans[:, None]).sum(axis=1) + 1e-9))
        return scale

    def _best_by_day(self, tried: list[SeasonPlan], worth: Floats) -> NDArray[np.intp]:
        """Place of the length that serves each day best, by what it earns and what its last state is worth to the days after."""
        scores = np.empty((len(tried), len(self.starts)))
        for place, one in enumerate(tried):
            ahead = ((one.states - self.plan.states)[:, : self.s] * worth).sum(axis=1)
            earned = np.add.reduceat(one.values.reward, self.starts)
            scores[place] = earned + ahead[self.ends] - ahead[self.starts]
        best: NDArray[np.intp] = scores.argmax(axis=0)
        return best

    def _simulated(self, controls: Floats) -> list[SeasonPlan]:
        """Plans of controls ``(n, T, c)``."""
        given, n = self.scenario, len(controls)
        p = given.p if given.p.ndim == 1 else given.p[None]
        states = self.kernel.rollout(np.tile(given.x0, (n, 1)), controls, given.d, p)
        return [
            SeasonPlan(given, u, x, self.reward(x, u, given.calendar)) for u, x in zip(controls, states, strict=True)
        ]

    def _feasible(self, controls: Floats) -> Floats:
        return feasible(controls, self.scenario.u_before, self.scenario.high, self.scenario.max_change)


def _judged_at_the_end(task: TaskSpec) -> TaskSpec:
    """The task, judged by the air at the end of each step: a limit is seen from within, which meters do not show."""
    return task.replace(constraints={"judged": "end"}) if task.judges_means else task
