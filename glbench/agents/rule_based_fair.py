"""The rule-based controller under the conditions of every agent: observations only, and the task's actuation.

Rules and settings are those of the published controller. What observations do not tell is estimated (``daylight``), and what
the rules ask for is approached as fast as the actuation allows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from glbench.agents.daylight import Daylight, DaylightEstimator
from glbench.agents.rule_settings import RuleSettings
from glbench.agents.rules import RuleInputs, Rules
from glbench.errors import ShapeError, SubmissionError, did_you_mean

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]

_DAYS_A_YEAR = 365.0  # as the observation counts
_SECONDS_AN_HOUR = 3600.0
_SECONDS_A_DAY = 86400.0

_MEASURED = ("air_temperature", "relative_humidity", "co2", "global_radiation", "outdoor_temperature")
_CLOCK = ("sin_hour_of_day", "cos_hour_of_day", "sin_day_of_year", "cos_day_of_year")


@dataclass(frozen=True)
class _Plan:
    """Where a task's observations are and how its actions act."""

    columns: dict[str, int]
    places: list[int]
    """The same without names."""
    granted: tuple[int, ...]
    """Of the six controls those that the agent acts on, in the order of its actions."""
    now: tuple[int, ...]
    """Observation column of each granted control."""
    at_one: Array
    """What each granted control delivers at 1, in the unit of its observation."""
    rate: bool
    max_change: float


class FairRuleBasedAgent:
    """Rules on observations and estimates; an ``Agent``. Its memory is the course of the radiation so far."""

    def __init__(self, settings: RuleSettings) -> None:
        self.settings = settings
        self._rules = Rules(settings)
        self._runs = 0

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """Forget the weather; ``n_runs`` runs of ``task`` begin.

        Raises
        ------
        SubmissionError
            When the task does not show a quantity that the rules need, or has a kind of actuation unknown here.
        """
        self._plan = _plan(task)
        # With the published timing the weather shown is that of the step before.
        age_seconds = task.step_seconds if task.timing == "published" else 0.0
        self._daylight = DaylightEstimator(n_runs, task.step_seconds, age_seconds)
        self._runs = n_runs

    def act(self, observations: NDArray[np.float32], /) -> Array:
        """Actions (n_runs, actions) towards the controls that the rules ask for.

        Raises
        ------
        ShapeError
            When there are not as many rows as runs were announced to ``reset``.
        """
        if len(observations) != self._runs:
            msg = f"act got observations of {len(observations)} runs, reset was called with {self._runs}. Call reset first."
            raise ShapeError(msg)
        plan = self._plan
        rows = np.array(observations.T[plan.places], dtype=np.float64, order="C")
        seen = dict(zip(plan.columns, rows, strict=True))
        hour, day = clock_from(seen)
        inputs = fair_inputs(seen, hour, day, self._daylight.observe(hour, seen["global_radiation"]))
        wanted = self._rules.controls(inputs)[:, plan.granted]
        if not plan.rate:
            return wanted
        now = observations.take(plan.now, axis=1).astype(np.float64) / plan.at_one
        return np.minimum(np.maximum((wanted - now) / plan.max_change, -1.0), 1.0)


def clock_from(seen: dict[str, Array]) -> tuple[Array, Array]:
    """Hour of day [h] and day of year [day] from their sines and cosines.

    The hour is rounded to whole seconds: float32 blurs it by milliseconds, and the rules compare it with full hours.
    """
    turn = np.arctan2(seen["sin_hour_of_day"], seen["cos_hour_of_day"]) / (2.0 * math.pi)
    seconds = np.mod(np.rint(turn * _SECONDS_A_DAY), _SECONDS_A_DAY)
    year = np.arctan2(seen["sin_day_of_year"], seen["cos_day_of_year"]) / (2.0 * math.pi)
    return seconds / _SECONDS_AN_HOUR, np.mod(year, 1.0) * _DAYS_A_YEAR


def fair_inputs(seen: dict[str, Array], hour: Array, day: Array, daylight: Daylight) -> RuleInputs:
    """What the rules look at, from observed quantities by name, the clock, and the estimates of the day."""
    return RuleInputs(
        air_temperature=seen["air_temperature"],
        relative_humidity=seen["relative_humidity"],
        co2=seen["co2"],
        radiation=seen["global_radiation"],
        outdoor_temperature=seen["outdoor_temperature"],
        day_radiation_sum=daylight.radiation_sum,
        is_day=daylight.is_day,
        is_day_smooth=daylight.is_day_smooth,
        hour_of_day=hour,
        day_of_year=day,
    )


def _plan(task: TaskCard) -> _Plan:
    if task.actuation not in ("rate", "set_point"):
        msg = (
            f"The fair rule-based agent knows the actuations 'rate' and 'set_point', not '{task.actuation}' of {task.id}."
            f"{did_you_mean(task.actuation, ('rate', 'set_point'))}"
        )
        raise SubmissionError(msg)
    by_name = {control.name: (index, control) for index, control in enumerate(task.controls)}
    granted = [by_name[name] for name in task.action_names]
    rate = task.actuation == "rate"
    acted_on = [control.quantity for _, control in granted] if rate else []
    columns = _columns(task, [*_MEASURED, *_CLOCK, *acted_on])
    # Where nothing is installed the observation is 0, whatever it is divided by.
    at_one = np.array([control.at_one if control.at_one > 0.0 else 1.0 for _, control in granted])
    return _Plan(
        columns={name: columns[name] for name in (*_MEASURED, *_CLOCK)},
        places=[columns[name] for name in (*_MEASURED, *_CLOCK)],
        granted=tuple(index for index, _ in granted),
        now=tuple(columns[name] for name in acted_on),
        at_one=at_one,
        rate=rate,
        max_change=task.max_change,
    )


def _columns(task: TaskCard, needed: Sequence[str]) -> dict[str, int]:
    columns = {name: index for index, name in enumerate(task.observation_names)}
    missing = [name for name in needed if name not in columns]
    if missing:
        msg = f"The fair rule-based agent needs the observations {', '.join(missing)}, which {task.id} does not show."
        raise SubmissionError(msg)
    return columns
