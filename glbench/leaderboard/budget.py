"""What a result's agent was trained for: from the card of a submission, or from the trainings that a shipped baseline keeps.

A baseline that ships several policies acts with the one trained on the task itself; failing that, with the one of the nearest uncertainty
among those with the same observations and actions. The budget is that policy's. For tuned rules it is that of the page for the task's
reward. What is not stated is ``None`` and not 0.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import timedelta
from functools import cache
from pathlib import Path
from typing import Any

from glbench.agents.baselines import read_baseline, shipped_digest
from glbench.agents.identity import baseline_names
from glbench.agents.plans import Recording
from glbench.agents.tuned_rules import RulePages, TunedRuleSettings
from glbench.errors import GlbenchError
from glbench.evaluation import Result
from glbench.resources import data_folder, left_out
from glbench.tasks import list_tasks, published_task


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
    agent = result.agent
    if agent.card is not None and agent.card.training is not None:
        return Budget(agent.card.training.steps, agent.card.training.wall_hours)
    if agent.kind != "baseline" or digest_of_baseline(agent.name) != agent.digest:
        return UNKNOWN
    settings = _settings(agent.name)
    if isinstance(settings, RulePages) and settings.kind is TunedRuleSettings:
        return _tuned(settings, result.task.id)
    trained = _trainings(data_folder("baselines") / _trained(agent.name) / "training")
    if not trained:
        return Budget(0, 0.0)
    task, published = result.task.id, _deltas()
    fitting = [one for one in trained if task in published and _interface(one) == _interface(task)]
    if not fitting:
        return UNKNOWN
    delta = published[task]
    return trained[min(fitting, key=lambda one: (one != task, abs(published[one] - delta), published[one]))]


@cache
def _settings(name: str) -> object:
    """Settings of a baseline; None where they are not installed, which are policies and plans, no rules and no recording."""
    return None if name in left_out() else read_baseline(name).settings


def _trained(name: str) -> str:
    """Baseline whose training made ``name`` what it is: for a recording the agent that was recorded."""
    settings = _settings(name)
    return str(settings.about["agent"]) if isinstance(settings, Recording) else name


def _tuned(pages: RulePages, task_id: str) -> Budget:
    """Of rules, the tuning of the page that a published task is played by."""
    reward = _rewards().get(task_id)
    page = None if reward is None else pages.page_for(reward, task_id)
    if page is None:
        return UNKNOWN
    record = page.parent.parent / "training" / f"{page.stem}.toml"
    return _spent(tomllib.loads(record.read_text(encoding="utf-8")))


@cache
def digest_of_baseline(name: str) -> str | None:
    """Digest of the baseline as it is shipped today; of another one nothing is known."""
    if name not in baseline_names():
        return None
    try:
        return shipped_digest(name)
    except GlbenchError:
        return None


@cache
def _deltas() -> Mapping[str, float]:
    return {task.id: task.uncertainty.delta for task in list_tasks()}


@cache
def _interface(task_id: str) -> tuple[tuple[str, ...], ...]:
    """What a policy for a task sees, and what it does."""
    task = published_task(task_id)
    return tuple(one.name for one in task.observed()), tuple(action.name for action in task.actions)


@cache
def _rewards() -> Mapping[str, tuple[str, ...]]:
    return {task.id: tuple(task.reward.modules) for task in list_tasks()}


@cache
def _years() -> Mapping[str, tuple[int, ...]]:
    """Years of the weather of published tasks that have one season."""
    found = {}
    for task in list_tasks():
        if len(task.scenario.seasons) == 1:
            last = task.weather.start + timedelta(days=task.weather.days)
            found[task.id] = tuple(range(task.weather.start.year, last.year + 1))
    return found


@cache
def _trainings(folder: Path) -> Mapping[str, Budget]:
    """Budgets by the published task that they were trained on."""
    cards = [tomllib.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.toml"))]
    return {card["task"]["id"]: _spent(card) for card in cards if card["task"].get("id") in _deltas()}


def _spent(card: Mapping[str, Any]) -> Budget:
    """Steps and time of a training, with those of the policy that it started from, if it did."""
    steps, seconds = int(card["training"]["steps"]), float(card["wall_seconds"]["total"])
    start = card.get("start")
    task, training = card["task"], card["training"]
    tasks = tuple(map(str, task["ids"] if "ids" in task else (task["id"],)))
    data = tasks, training.get("split"), tuple(training.get("years") or _years().get(tasks[0], ()))
    if start is None:
        return Budget(steps, seconds / 3600.0, *data)
    if "steps" not in start:
        return UNKNOWN
    return Budget(steps + int(start["steps"]), (seconds + float(start["wall_seconds"])) / 3600.0, *data)
