"""Perfect-information plans for a whole season: sequential convex programming along the trajectory.

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

from glbench.control.acting import actions_of
from glbench.control.ascent import LENGTHS, feasible, improvement, shares_of_reach
from glbench.control.stage import StageReward, StageValues, judged_at_the_end
from glbench.errors import ShapeError, whole_number
from glbench.kernel import Kernel

if TYPE_CHECKING:
    from glbench.control.scenario import Scenario
    from glbench.kernel.trajectories import Trajectory

Floats = NDArray[np.float64]

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
        return actions_of(self.scenario.task, np.vstack([self.scenario.u_before, self.controls[:-1]]), self.controls)


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
    """Improve the controls of a season with perfect information.

    Parameters
    ----------
    scenario
        The run. Its task needs a reward with derivatives (``StageReward``).
    controls
        Where the search begins, fractions ``(T, c)``: those of a good controller, brought within the bounds and the largest change.
    iterations
        How many; one takes about 3 s of one core for 5,760 steps.
    preset
        Of the kernel that plans.
    watch
        Called after each iteration.

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


class _Search:
    """A plan, and what is needed to improve it."""

    def __init__(self, scenario: Scenario, controls: Floats, preset: str) -> None:
        self.scenario, task = scenario, scenario.task
        shape = (task.steps, len(scenario.high))
        if controls.shape != shape or not np.isfinite(controls).all():
            msg = f"The controls to begin with are finite and have the shape {shape}; got {controls.shape}."
            raise ShapeError(msg)
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
        self.plan = self._simulated(self._feasible(controls)[None])[0]

    def improve(self, smoothing: float) -> float:
        """One iteration; gives what it gained."""
        plan, stage = self.plan, StageReward(self.near, smoothing=smoothing)
        lines = self.plain.linearise_trajectory(plan.states[0, : self.s], plan.controls, self.scenario.d, self.p)
        _, slopes = stage.gradient(lines.x, plan.controls, self.scenario.calendar)
        # What the rest of the season makes of a state: without the end of the step that led there.
        worth = lines.pull(slopes.states).costates
        worth[1:] -= slopes.after
        reach = self.radius[self.days, None] * shares_of_reach(stage, lines)
        move = improvement(stage, lines, plan.controls, self.scenario.calendar, reach, self._feasible, steps=_INNER)
        bend = self._corrected(stage, lines, reach, move) - move

        def at(length: float | Floats) -> Floats:
            return self._feasible(plan.controls + length * move + length**2 * bend)

        tried = self._simulated(np.array([at(length) for length in LENGTHS]))
        best = self._best_by_day(tried, worth)
        merged = self._simulated(at(LENGTHS[best][self.days, None])[None])
        self.plan = max([plan, *tried, *merged], key=lambda one: one.reward)
        self.radius = np.where(best <= _SHORT, self.radius * _SHRINK, self.radius)
        self.radius = np.where(best >= _LONG, np.minimum(self.radius * _GROW, _LARGEST_RADIUS), self.radius)
        return self.plan.reward - plan.reward

    def _corrected(self, stage: StageReward, lines: Trajectory, reach: Floats, move: Floats) -> Floats:
        """``move``, improved again where the states are that it really leads to (second-order correction)."""
        u = self.plan.controls
        there = self.plain.rollout(
            lines.x[:1], (u + move)[None], self.scenario.d, self.p if self.p.ndim == 1 else self.p[None]
        )[0]
        return improvement(
            stage,
            lines,
            u,
            self.scenario.calendar,
            reach,
            self._feasible,
            steps=_CORRECTING,
            rate=_CORRECTING_RATE,
            start=move,
            x=there - lines.push(move),
        )

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
