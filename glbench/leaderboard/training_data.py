"""What an agent was trained on and for how long, and whether that holds what the agent is judged by.

All of it is what a card says (of a submission its own, of a shipped baseline those of its trainings), so a statement and no proof. What is
not stated is ``None`` and not 0. A baseline that ships several policies acts with the one trained on the task itself; failing that, with
the one of the nearest uncertainty among those with the same observations and actions: the budget is that policy's. For tuned rules it is
that of the page for the task's reward. Where a task has no splits, training and evaluation share a season, and there is nothing to mark.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from functools import cache
from pathlib import Path

from pydantic import Field

from glbench.agents.baselines import digests_of_baseline, read_baseline
from glbench.agents.card import Split, Year
from glbench.agents.plans import Recording
from glbench.agents.tuned_rules import RulePages, TunedRuleSettings
from glbench.evaluation import Result
from glbench.leaderboard.statistics import FrozenModel
from glbench.resources import data_folder, left_out
from glbench.tasks import TaskSpec, list_tasks, published_task


@dataclass(frozen=True)
class Budget:
    """Control steps of all environments together, and hours on the machine that trained; 0 steps: not trained.

    ``tasks``, ``split`` and ``years`` are what it was trained on, as far as the training of a shipped baseline states it.
    """

    steps: int | None
    hours: float | None
    tasks: tuple[str, ...] = ()
    split: str | None = None
    years: tuple[int, ...] = ()


UNKNOWN = Budget(None, None)


def budget_of(result: Result) -> Budget:
    """Training of the agent that made ``result``."""
    agent, task_id = result.agent, result.task.id
    if agent.card is not None and agent.card.training is not None:
        return Budget(agent.card.training.steps, agent.card.training.wall_hours)
    if agent.kind != "baseline" or agent.digest not in digests_of_baseline(agent.name):
        return UNKNOWN
    settings, name = _settings(agent.name), agent.name
    if isinstance(settings, RulePages) and settings.kind is TunedRuleSettings:
        task = _published_tasks().get(task_id)
        page = None if task is None else settings.page_for(tuple(task.reward.modules), task_id, task.model_id)
        return UNKNOWN if page is None else _budget_in(page.parent.parent / "training" / f"{page.stem}.toml")[1]
    if isinstance(settings, Recording):
        name = str(settings.about["agent"])  # whose training made the recording what it is
    deltas = {one: task.uncertainty.delta for one, task in _published_tasks().items()}
    files = sorted((data_folder("baselines") / name / "training").glob("*.toml"))
    budgets = {task: budget for task, budget in map(_budget_in, files) if task in deltas}
    if not budgets:
        return Budget(0, 0.0)
    alike = [one for one in budgets if task_id in deltas and _interface(one) == _interface(task_id)]
    if not alike:
        return UNKNOWN
    delta = deltas[task_id]
    return budgets[min(alike, key=lambda one: (one != task_id, abs(deltas[one] - delta), deltas[one]))]


@cache
def _published_tasks() -> Mapping[str, TaskSpec]:
    return {task.id: task for task in list_tasks()}


@cache
def _settings(name: str) -> object:
    """Settings of a baseline; None where they are not installed, which are policies and plans, no rules and no recording."""
    return None if name in left_out() else read_baseline(name).settings


@cache
def _interface(task_id: str) -> tuple[tuple[str, ...], ...]:
    """What a policy for a task sees, and what it does."""
    task = published_task(task_id)
    return tuple(one.name for one in task.observed()), tuple(action.name for action in task.actions)


@cache
def _budget_in(file: Path) -> tuple[str | None, Budget]:
    """Task and budget of a training, from its card; with the steps and the time of the policy that it started from, if it did."""
    card = tomllib.loads(file.read_text(encoding="utf-8"))
    task, training, start = card["task"], card["training"], card.get("start")
    tasks = tuple(map(str, task["ids"] if "ids" in task else (task["id"],)))
    years = training.get("years")
    if not years:  # those of the weather, where the task has one season
        spec = next((one for one in list_tasks() if one.id == tasks[0] and len(one.scenario.seasons) == 1), None)
        first = None if spec is None else spec.weather.start
        last = None if spec is None else spec.weather.start + timedelta(days=spec.weather.days)
        years = () if first is None or last is None else range(first.year, last.year + 1)
    steps, seconds = int(training["steps"]), float(card["wall_seconds"]["total"])
    if start is not None and "steps" not in start:
        return task.get("id"), UNKNOWN
    if start is not None:
        steps, seconds = steps + int(start["steps"]), seconds + float(start["wall_seconds"])
    return task.get("id"), Budget(steps, seconds / 3600.0, tasks, training.get("split"), tuple(years))


class TrainingData(FrozenModel):
    """What a training saw: tasks, the last of their splits, the years of the weather, and the first and last seed of its episodes."""

    tasks: tuple[str, ...] = ()
    split: str | None = Field(default=None, description="training, validation, test, or none of any season; null when not stated")
    years: tuple[int, ...] = ()
    seeds: tuple[int, ...] = ()

    @property
    def words(self) -> str:
        """``GreenhouseReal-v1, training split, 2008 to 2010``; ``unknown`` where nothing is stated."""
        if self.split == "none":
            return "no training recorded"
        parts = [task.rpartition("/")[2] for task in self.tasks]
        parts += [f"{self.split} split"] if self.split else []
        parts += [_years(self.years)] if self.years else []
        return ", ".join(parts) or "unknown"


def training_data_of(result: Result) -> TrainingData:
    """What the agent that made ``result`` was trained on, as far as it is stated."""
    card = result.agent.card
    if card is not None and card.training is not None:
        training = card.training
        return TrainingData(tasks=training.tasks, split=training.split, years=training.years, seeds=training.seeds)
    budget = budget_of(result)
    return TrainingData(split="none") if budget.steps == 0 else TrainingData(tasks=budget.tasks, split=budget.split, years=budget.years)


def contamination_warning(result: Result, data: TrainingData) -> str:
    """Reason for the contamination mark, in words that go on after "it"; empty where its training saw nothing of what it is judged by."""
    split: Split | None = result.task.split
    if split is None or split == "training":
        return ""
    shared: set[Year] = set(data.years) & set(result.task.years or ()) if split == "test" else set()
    if data.split == "test":
        return "was trained on the test split"
    return f"was trained on weather of {_years(tuple(sorted(shared)))}, which the test split is made of" if shared else ""


def _years(years: tuple[int, ...]) -> str:
    """``2008 to 2010``, ``2008, 2011``."""
    ordered = sorted(set(years))
    if len(ordered) > 2 and ordered[-1] - ordered[0] == len(ordered) - 1:
        return f"{ordered[0]} to {ordered[-1]}"
    return ", ".join(map(str, ordered))
