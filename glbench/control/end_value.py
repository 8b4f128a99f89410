"""What the states at the end of a short horizon are worth to the days after it: costates of plans for a whole season.

Why a short horizon needs it, and what it is worth: docs/adr/0020-predictive-control.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from glbench.control.stage import StageReward, judged_at_the_end
from glbench.env.spaces import the_task
from glbench.errors import GlbenchError, TaskError
from glbench.kernel import Kernel

if TYPE_CHECKING:
    from glbench.control.season import SeasonPlan
    from glbench.tasks import TaskSpec

Floats = NDArray[np.float64]

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

    Attributes
    ----------
    states
        Names of those that are worth something.
    days_left
        Days to the end of the season, rising, the first 0 ``(k,)``.
    by_days_left
        Mean over the hours of a day ``(k, states)``; the first row is 0.
    by_hour
        Factors for hours of the day, their mean 1 ``(8, states)``: the first for 0:00 to 3:00, in the middle of these hours.
    """

    states: tuple[str, ...]
    days_left: Floats
    by_days_left: Floats
    by_hour: Floats

    @classmethod
    def of_plans(cls, plans: Sequence[SeasonPlan], *, preset: str = "fast") -> EndValue:
        """The mean over plans for seasons of tasks with one model and one length, from scenarios that may be trained on.

        States that are worth less than a hundredth of a cent, as they change from day to day, are left out.

        Raises
        ------
        GlbenchError
            When there is no plan, or plans differ in model or length.
        """
        kinds = {
            (plan.scenario.task.model_id, plan.scenario.task.steps, plan.scenario.task.step_seconds) for plan in plans
        }
        if len(kinds) != 1:
            msg = f"An end value is the mean over plans of one model and one length; got {len(plans)} plans of {len(kinds)} kinds."
            raise GlbenchError(msg)
        task = plans[0].scenario.task
        model = judged_at_the_end(task).model_value
        money = _money(task)
        worth, days, hours = [], [], []
        changes = np.zeros(len(model.states))
        for plan in plans:
            worth.append(_worth(plan, preset) / money)
            days.append(np.arange(task.steps, 0, -1) / task.steps_per_day)
            hours.append(plan.scenario.calendar[:-1, 0])
            daily = plan.states[:: task.steps_per_day, : len(changes)]
            changes += np.abs(np.diff(daily, axis=0)).mean(axis=0) / len(plans)
        values, left, hour = np.concatenate(worth), np.concatenate(days), np.concatenate(hours)
        blocks = np.arange(0.0, task.steps / task.steps_per_day, _DAYS)
        by_days = np.array([values[(left > start) & (left <= start + _DAYS)].mean(axis=0) for start in blocks])
        ends = np.minimum(blocks + _DAYS, left.max())
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
        )

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> EndValue:
        """The end value that ``written`` gave.

        Raises
        ------
        GlbenchError
            When ``content`` is none.
        """
        try:
            states = content["states"]
            found = cls(
                tuple(map(str, states)),
                np.array(content["days_left"], dtype=np.float64),
                np.array([entry["by_days_left"] for entry in states.values()], dtype=np.float64).T,
                np.array([entry["by_hour"] for entry in states.values()], dtype=np.float64).T,
            )
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            msg = (
                "This is no end value. Expected days_left, a list of numbers, and states with by_days_left and by_hour."
            )
            raise GlbenchError(msg) from error
        days, count = found.days_left, len(found.states)
        rising = days.ndim == 1 and days.size > 0 and days[0] == 0.0 and bool((np.diff(days) > 0.0).all())
        shapes = found.by_days_left.shape == (days.size, count) and found.by_hour.shape == (int(24.0 / _HOURS), count)
        if not (rising and shapes and all(np.isfinite(a).all() for a in (days, found.by_days_left, found.by_hour))):
            msg = "This is no end value: days_left rise from 0, each state has a number for each of them and 8 for the hours, all finite."
            raise GlbenchError(msg)
        return found

    def written(self) -> dict[str, Any]:
        """The end value as plain values, for a file."""
        return {
            "days_left": self.days_left.tolist(),
            "states": {
                name: {"by_days_left": self.by_days_left[:, i].tolist(), "by_hour": self.by_hour[:, i].tolist()}
                for i, name in enumerate(self.states)
            },
        }

    def __call__(self, task: TaskSpec | str, hour_of_day: ArrayLike, days_left: ArrayLike) -> Floats:
        """What a unit of each state of the task's model is worth ``(n, s)``, in the unit of the task's reward.

        Parameters
        ----------
        task
            Whose model has the states. Meters of violations are worth nothing.
        hour_of_day, days_left
            Where horizons end, ``(n,)`` or numbers.

        Raises
        ------
        TaskError
            When the model lacks a state, or the reward does not count money.
        """
        task = the_task(task)
        names = task.model_value.state_names
        missing = [name for name in self.states if name not in names]
        if missing:
            msg = f"This end value is not for {task.id}: its model {task.model_id} has no {', '.join(missing)}."
            raise TaskError(msg)
        hour, left = (np.atleast_1d(np.asarray(given, dtype=np.float64)) for given in (hour_of_day, days_left))
        middles = np.arange(-_HOURS / 2.0, 24.0 + _HOURS, _HOURS)
        around = np.vstack([self.by_hour[-1:], self.by_hour, self.by_hour[:1]])
        worth = np.zeros((max(len(hour), len(left)), len(names)))
        for i, name in enumerate(self.states):
            level = np.interp(left, self.days_left, self.by_days_left[:, i])
            worth[:, names.index(name)] = level * np.interp(hour, middles, around[:, i])
        worth *= _money(task)
        return worth


def _worth(plan: SeasonPlan, preset: str, smoothing: float = _SMOOTHING) -> Floats:
    """What a unit of each state is worth to the steps after it ``(T, s)``, in the unit of the reward."""
    given, near = plan.scenario, judged_at_the_end(plan.scenario.task)
    model = near.model_value
    kernel = Kernel(model, near.step_seconds, preset=preset)
    p = given.p[..., : len(model.parameter_names)]
    lines = kernel.linearise_trajectory(given.x0[: len(model.states)], plan.controls, given.d, p)
    _, slopes = StageReward(near, smoothing=smoothing).gradient(lines.x, plan.controls, given.calendar)
    costates = lines.pull(slopes.states).costates
    costates[1:] -= slopes.after  # what the step before earned by leading there is no matter of the days after
    return costates[:-1]


def _money(task: TaskSpec) -> float:
    """What 1 EUR m-2 is worth in the task's reward."""
    # The same step with all controls off and on: what that costs, and what it does to the reward. Its states do not matter.
    states, controls = (
        np.full((2, 2, len(task.model_value.states)), 10.0),
        np.zeros((2, 1, len(task.model_value.controls))),
    )
    controls[1] = 1.0
    calendar = np.ones((2, 2, 2 + len(task.price_tables)))
    stage = StageReward(task)(states, controls, calendar)
    earned, reward = (float(a[1, 0] - a[0, 0]) for a in (stage.epi, stage.reward))
    if earned == 0.0 or reward == 0.0:
        msg = f"An end value counts money, which does not count in the reward of {task.id}."
        raise TaskError(msg)
    return reward / earned


def _rounded(values: Floats) -> Floats:
    """Significant digits only."""
    return np.array([float(f"{value:.{_DIGITS}g}") for value in values.ravel().tolist()]).reshape(values.shape)
