"""Rules that call the crew to cut a crop, on a day or at a mass that samples show; the climate is that of the tuned rules.

All arithmetic goes element by element over arrays of shape (n,), as in the tuned rules.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from glbench.agents.controllers import controller
from glbench.agents.tuned_rules import TunedRulesAgent, TunedRuleSettings, number, read_rule_pages
from glbench.errors import SubmissionError, refuse
from glbench.tasks.set_points import WORKED

if TYPE_CHECKING:
    from glbench.tasks import TaskCard

Array = NDArray[np.float64]

HARVEST = "uHarvest"
"""The control that calls the crew."""
_AGE, _SAMPLE = "days_since_planting", "mean_head_mass"
_AT_WORK = 0.05  # Plants are no older than this [day] while a crew is at work


class HarvestRuleSettings(TunedRuleSettings):
    """Numbers of the rules for the day of harvest, besides those of the climate. A page names the tasks that it is for."""

    title: ClassVar[str] = "harvest rules"
    scope_key: ClassVar[str] = "tasks"

    harvest_days: float = number(10.0, 100.0, "day", "after planting the crew is called at the latest", section="Harvest")
    harvest_mass: float = number(0.0, 800.0, "g", "or when heads are thought to weigh so much; 0: nobody looks at the samples")
    harvest_growth: float = number(0.0, 30.0, "g day-1", "that a head is thought to gain after it was weighed")
    harvest_sample: float = number(0.1, 1.0, "-", "part of a new sample in what is thought; the rest is what was thought before")


@controller("rule_based_harvest", read=partial(read_rule_pages, kind=HarvestRuleSettings), version="1")
class HarvestRulesAgent(TunedRulesAgent):
    """Rules that say when to cut; an ``Agent``. It remembers how heavy it thinks the heads of every run are.

    ``settings`` are pages of numbers, of which the task chooses one, or numbers for every run, one a run.
    """

    title = "the harvest rules"
    kind = HarvestRuleSettings
    works = (*WORKED, HARVEST)
    needed = (*TunedRulesAgent.needed, _AGE)
    welcome = (*TunedRulesAgent.welcome, _SAMPLE)

    def reset(self, task: TaskCard, n_runs: int, /) -> None:
        """As the tuned rules; also raises ``SubmissionError`` if ``harvest_mass`` is set and the task shows no sample."""
        super().reset(task, n_runs)
        if np.any(self._numbers.harvest_mass) and _SAMPLE not in task.observation_names:
            refuse(
                f"{task.id} does not show '{_SAMPLE}', which harvest_mass needs. Set harvest_mass to 0, or add samples.", SubmissionError
            )
        self._sample = np.full(n_runs, np.nan)
        self._mass, self._age = np.zeros(n_runs), np.zeros(n_runs)
        self._weighed = np.zeros(n_runs, dtype=bool)

    def decide(self, readings: dict[str, Array], positions: dict[str, Array], /) -> Array:
        """As the tuned rules, with the highest action where the crew is called, else the lowest."""
        actions, place = super().decide(readings, positions), self.task.action_names.index(HARVEST)
        lowest, highest = self.task.actions[place].low, self.task.actions[place].high
        actions[:, place] = np.where(self._called > 0.0, highest, lowest)
        return actions

    def _rules(self, readings: dict[str, Array], vents: Array) -> dict[str, Array]:
        self._called = self._harvest(readings)
        return {**super()._rules(readings, vents), HARVEST: self._called}

    def _harvest(self, readings: dict[str, Array]) -> Array:
        """1 in runs in which the crew is called, else 0."""
        n: Any = self._numbers
        age = readings[_AGE]
        called = age >= n.harvest_days
        if _SAMPLE in readings:
            sample = readings[_SAMPLE]
            thought = self._mass + n.harvest_growth * (age - self._age)
            self._weighed &= age > _AT_WORK  # young plants: what was weighed before is sold
            new = sample != self._sample
            mixed = np.where(self._weighed, thought + n.harvest_sample * (sample - thought), sample)
            self._mass, self._age, self._sample = np.where(new, mixed, self._mass), np.where(new, age, self._age), sample
            self._weighed |= new
            heavy = self._mass + n.harvest_growth * (age - self._age) >= n.harvest_mass
            called |= (n.harvest_mass > 0.0) & self._weighed & heavy
        return np.where(called & (age > _AT_WORK), 1.0, 0.0)
