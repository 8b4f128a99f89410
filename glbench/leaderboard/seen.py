"""What the training of an agent saw, and whether that holds what the agent is judged by.

It is what a card says (of a submission its own, of a shipped baseline those of its trainings), so a statement and no proof. Where a task
has no splits, training and evaluation share a season, and there is nothing to mark.
"""

from __future__ import annotations

from pydantic import Field

from glbench.agents.card import Split, Year
from glbench.env import run_years
from glbench.evaluation import Result
from glbench.leaderboard.budget import budget_of
from glbench.leaderboard.collect import StoredResult
from glbench.leaderboard.statistics import Published


class Seen(Published):
    """What a training saw: tasks, the last of their splits, the years of the weather, and the first and last seed of its episodes."""

    tasks: tuple[str, ...] = ()
    split: str | None = Field(
        default=None, description="training, validation, test, or none of any season; null when not stated"
    )
    years: tuple[int, ...] = ()
    seeds: tuple[int, ...] = ()

    @property
    def words(self) -> str:
        """``Spring-v1, training split, 2008 to 2010``; ``unknown`` where nothing is stated."""
        if self.split == "none":
            return "not trained on any season"
        parts = [task.rpartition("/")[2] for task in self.tasks]
        parts += [f"{self.split} split"] if self.split else []
        parts += [_years(self.years)] if self.years else []
        return ", ".join(parts) or "unknown"


def seen_by(result: Result) -> Seen:
    """What the agent that made ``result`` was trained on, as far as it is stated."""
    card = result.agent.card
    if card is not None and card.training is not None:
        told = card.training
        return Seen(tasks=told.tasks, split=told.split, years=told.years, seeds=told.seeds)
    budget = budget_of(result)
    if budget.steps == 0:
        return Seen(split="none")
    return Seen(tasks=budget.tasks, split=budget.split, years=budget.years)


def years_of_runs(item: StoredResult) -> tuple[int, ...]:
    """Weather year of each run; empty if all are of one year, or the task's definition or its secret salt is not known."""
    evaluated, task = item.result.task, item.task
    if task is None or evaluated.salt_commitment != task.salt_commitment:
        return ()
    return run_years(task.scored_in(evaluated.split), item.result.evaluation.seeds)


def what_it_should_not_have_seen(result: Result, seen: Seen) -> str:
    """Why a row is marked, in words that go on after "it": empty where its training saw nothing of what it is judged by."""
    judged: Split | None = result.task.split
    if judged is None or judged == "training":
        return ""
    shared: set[Year] = set(seen.years) & set(result.task.years or ()) if judged == "test" else set()
    if seen.split == "test":
        return "was trained on the test split"
    if shared:
        return f"was trained on weather of {_years(tuple(sorted(shared)))}, which the test split is made of"
    return ""


def _years(years: tuple[int, ...]) -> str:
    """``2008 to 2010``, ``2008, 2011``."""
    ordered = sorted(set(years))
    if len(ordered) > 2 and ordered[-1] - ordered[0] == len(ordered) - 1:
        return f"{ordered[0]} to {ordered[-1]}"
    return ", ".join(map(str, ordered))
