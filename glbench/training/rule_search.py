"""Tuning the numbers of rules by the rewards of whole seasons.

The rules are those of ``glbench.agents.tuned_rules``, of ``energy_rules`` for tasks that show the price of power, or of ``harvest_rules``
where a crew is called; a page of settings says where to begin, and the bounds of its numbers how far to go.
CMA-ES varies the numbers. All candidates of a generation have the same scenarios and run side by side, one per row. The search keeps the
generation mean that earned most on the validation split or, for tasks without splits, in runs with separate seeds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from glbench.agents import tuned_rules
from glbench.agents.energy_rules import POWER, EnergyRulesAgent, EnergyRuleSettings
from glbench.agents.harvest_rules import HARVEST, HarvestRulesAgent, HarvestRuleSettings
from glbench.arrays import Floats
from glbench.env import Simulation
from glbench.errors import TrainingError, refuse
from glbench.kernel import make_kernel
from glbench.resources import data_folder, write_atomically
from glbench.tasks import TaskCard, TaskSpec, task_card
from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.training import periodic_evaluation
from glbench.training.card import CARD, TrainingFacts, start_of
from glbench.training.folder import Trained
from glbench.training.settings import EvaluationPlan, FrozenSettings, TrainingSeed
from glbench.training.strategy import HANSEN, Search

RULES = "rules.yml"  # The page of the best rules, in the folder of a search
_AGENTS: dict[type[tuned_rules.TunedRuleSettings], tuple[str, type[tuned_rules.TunedRulesAgent]]] = {
    tuned_rules.TunedRuleSettings: ("rule_based_tuned", tuned_rules.TunedRulesAgent),
    EnergyRuleSettings: ("rule_based_energy", EnergyRulesAgent),
    HarvestRuleSettings: ("rule_based_harvest", HarvestRulesAgent),
}
"""Name of the controller, and the controller, that follow each kind of numbers."""
_START = "start.yml"  # The page that a search in the folder began with


class RuleSearchSettings(FrozenSettings):
    """Settings of a search for numbers of rules."""

    population: int = Field(default=64, ge=4)
    """Candidates a generation. Each has one run of every task, in the same scenario for all."""
    seasons: int = Field(default=6400, gt=0)
    """Simulated runs in all (candidates, generations, tasks), rounded up to whole generations."""
    sigma: float = Field(default=0.1, gt=0, le=1)
    """Standard deviation of the first generation, in widths of each number's bounds."""
    first_seed: TrainingSeed = 3 * FIRST_TRAINING_SEED
    """Seed of the first generation's scenario; the following ones have the next."""
    evaluation: EvaluationPlan = EvaluationPlan(every=4_000_000, runs=16)
    """How often the generation mean is evaluated (``every``, in environment steps), and in how many runs of each task."""
    kernel_preset: Literal["fast", "reference"] = "fast"

    def generations(self, tasks: Sequence[TaskSpec]) -> int:
        """Number of generations for these runs, rounded up."""
        return math.ceil(self.seasons / (self.population * len(tasks)))

    def digest(self, start: tuned_rules.RulePage) -> str:
        """SHA-256 (hex) over all settings except the number of runs, and over the page that the search starts from."""
        return sha256((self.model_dump_json(exclude={"seasons"}) + tuned_rules.settings_text(start)).encode()).hexdigest()


def shipped_start(tasks: Sequence[TaskSpec]) -> Path:
    """File of the shipped page for ``tasks``: for their reward, or for the first of them where pages are for tasks.

    Raises ``TrainingError`` when none is shipped, or as for ``reward_of``.
    """
    reward, kind = reward_of(tasks), kind_for(tasks)
    folder = data_folder("baselines") / _AGENTS[kind][0] / "rules"
    file = None
    if folder.is_dir():
        file = tuned_rules.read_rule_pages(folder, kind).page_for(reward, tasks[0].id, tasks[0].model_id)
    if file is not None:
        return file
    what = f"{tasks[0].id}" if _is_for_tasks(kind) else f"the reward {', '.join(reward)}"
    msg = f"No rules are shipped for {what}. Give a page to begin with: --config START.yml."
    raise TrainingError(msg)


def kind_for(tasks: Sequence[TaskSpec]) -> type[tuned_rules.TunedRuleSettings]:
    """The kind of rules that are tuned for ``tasks``: for energy if all show the price of power, for harvest if in all a crew is called."""
    if all(POWER in (quantity.name for quantity in task.observed()) for task in tasks):
        return EnergyRuleSettings
    if all(HARVEST in task.actuation.controls for task in tasks):
        return HarvestRuleSettings
    return tuned_rules.TunedRuleSettings


def _is_for_tasks(kind: type[tuned_rules.TunedRuleSettings]) -> bool:
    """Whether pages of this kind name tasks, not rewards."""
    return kind.scope_key == "tasks"


def reward_of(tasks: Sequence[TaskSpec]) -> tuple[str, ...]:
    """Reward modules that all ``tasks`` share. Raises ``TrainingError`` when there is no task, one comes twice, or rewards differ."""
    if not tasks:
        refuse("Rules are tuned for a task: name one with --task.", TrainingError)
    rewards = {task.id: tuple(task.reward.modules) for task in tasks}
    if len(rewards) < len(tasks):
        refuse(f"A task is named twice: {', '.join(task.id for task in tasks)}. Name each once.", TrainingError)
    if len(set(rewards.values())) > 1:
        listed = "; ".join(f"{name}: {', '.join(modules)}" for name, modules in rewards.items())
        refuse(f"Tasks with different rewards cannot be added up ({listed}). Tune rules for each kind of reward.", TrainingError)
    return next(iter(rewards.values()))


class Candidates:
    """Numbers of a page as the strategy varies them: each from 0 to 1 between its bounds, those that are not tuned left out."""

    def __init__(self, start: tuned_rules.RulePage) -> None:
        self._start = start
        kind = type(start.numbers)
        self._names = kind.tuned_names()
        self._low, high = np.array([kind.bounds(name) for name in self._names]).T
        self._width = high - self._low
        numbers = np.array([getattr(start.numbers, name) for name in self._names])
        self.mean: Floats = (numbers - self._low) / self._width
        self.bounds: Floats = np.tile([0.0, 1.0], (len(self._names), 1))

    def numbers(self, candidate: Floats) -> tuned_rules.TunedRuleSettings:
        """The rules of a candidate."""
        values = self._low + np.clip(candidate, 0.0, 1.0) * self._width
        return self._start.numbers.model_copy(update=dict(zip(self._names, values.tolist(), strict=True)))

    def page(self, candidate: Floats) -> tuned_rules.RulePage:
        """The same as a page shows it, in four digits."""
        numbers = {name: tuned_rules.rounded(value) for name, value in self.numbers(candidate).model_dump().items()}
        return replace(self._start, numbers=type(self._start.numbers)(**numbers))


class _TaskRuns:
    """One task of a search: a row for every candidate, and the runs that select the best."""

    def __init__(self, task: TaskSpec, settings: RuleSearchSettings) -> None:
        kernel = make_kernel(task.model_value, task.step_seconds, preset=settings.kernel_preset)
        self.card: TaskCard = task_card(task)
        self._simulation = Simulation(task, settings.population, kernel)
        self._probe = periodic_evaluation.Probe(task.chosen_on, settings.evaluation, settings.kernel_preset)

    def rewards(self, candidates: Sequence[tuned_rules.TunedRuleSettings], seed: int) -> Floats:
        """Reward of a season for every candidate."""
        return periodic_evaluation.season_sums(self._simulation, [seed] * len(candidates), self._act(candidates))["reward"]

    def evaluate(self, numbers: tuned_rules.TunedRuleSettings) -> periodic_evaluation.ProbeResult:
        """Mean sums over the runs that select the best."""
        return self._probe.of(self._act([numbers] * len(self._probe.seeds)))

    def _act(self, numbers: Sequence[tuned_rules.TunedRuleSettings]) -> periodic_evaluation.Act:
        agent = _AGENTS[type(numbers[0])][1](numbers)
        agent.reset(self.card, len(numbers))
        return agent.act


class _RuleSearch(Search):
    """A search for numbers of rules; ``page`` is the one that it begins with."""

    def __init__(self, page: tuned_rules.RulePage, *session: Any) -> None:
        super().__init__(*session)
        self._page, self._candidates = page, Candidates(page)

    def prepare(self) -> None:
        self.begin(self._candidates.mean, self._candidates.bounds)
        self._runs = [_TaskRuns(task, self.settings) for task in self.tasks]

    def advance(self) -> float:
        clock = self.history.time
        with clock.spend("learning"):
            candidates = self.ask()
            numbers = [self._candidates.numbers(one) for one in candidates]
        with clock.spend("simulator"):
            seed = self.settings.first_seed + self.generations
            rewards = sum((runs.rewards(numbers, seed) for runs in self._runs), np.zeros(len(candidates))) / len(self._runs)
        with clock.spend("learning"):
            self.tell(candidates, rewards)
        self.keep()
        return float(rewards.mean())

    def evaluate(self) -> periodic_evaluation.ProbeResult:
        page = self._candidates.page(self.mean)
        sums = [runs.evaluate(page.numbers).sums for runs in self._runs]
        names = [name for name in sums[0] if all(name in other for other in sums)]
        return periodic_evaluation.ProbeResult({name: float(np.mean([one[name] for one in sums])) for name in names})

    def save_best(self) -> None:
        names = ", ".join(task.id for task in self.tasks)
        heading = (
            f"Numbers of the tuned rules for {names}, after {self.steps:,} steps of glbench tune rules, seed {self.seed}.",
            f"{CARD} tells how they were found, docs/training.md how to tune others.",
        )
        write_atomically(self.folder / _START, tuned_rules.settings_text(self._page))
        write_atomically(self.folder / RULES, tuned_rules.settings_text(self._candidates.page(self.mean), heading))

    def facts(self) -> TrainingFacts:
        settings, tasks = self.settings, self.tasks
        return TrainingFacts(
            title=f"Rules tuned for {', '.join(task.id for task in tasks)} by CMA-ES, seed {self.seed}",
            description=(
                f"The best mean of {self.generations} generations of {settings.population} candidates, {self.steps:,} steps. Set points by "
                "the sun and by light, humidity just below its limit; it sees observations only and acts through the task's actuation."
            ),
            command="glbench tune rules; the tables below tell the rest.",
            sources=(HANSEN,),
            training={
                **self.table(),
                "seasons": self.generations * settings.population * len(tasks),
                "season_seeds": [settings.first_seed, settings.first_seed + self.generations - 1],
            },
            controller=_AGENTS[kind_for(tasks)][0],
            acts_with=RULES,
        )


def tune_rules(
    tasks: Sequence[TaskSpec],
    start: Path,
    settings: RuleSearchSettings,
    folder: Path,
    *,
    seed: int = 0,
    listeners: Sequence[periodic_evaluation.Listener] = (),
) -> Trained:
    """Tune rules in ``folder``; the same tasks, start, settings and seed give the same rules on the same machine.

    An interrupted search continues and gives the same numbers. A finished one stays unchanged unless ``settings`` asks for more runs.
    Raises ``TrainingError`` when a task is in another split than that of training, ``folder`` holds another search, or as for
    ``reward_of``, ``TaskError`` when a task has a test alone, and ``SubmissionError`` when the page cannot be read or does not fit a task.

    ``tasks`` are tuned for in their training split where they have splits: the mean of their rewards counts. ``start`` is the file of the
    page to begin with; the reward that it names does not matter. The seed is the strategy's. ``folder`` keeps the best page, rewards so
    far, learning curve and card. ``listeners`` receive progress, evaluations and saves.
    """
    for task in tasks:
        task.check_training()
        if task.splits is not None and task.split != "training":
            refuse(f"Rules are tuned in the training split, and {task.id} was given in its split '{task.split}'.", TrainingError)
    reward, kind = reward_of(tasks), kind_for(tasks)
    scope = tuple(task.id for task in tasks) if _is_for_tasks(kind) else reward
    page = tuned_rules.RulePage(scope, tuned_rules.read_rule_page(start, kind).numbers)
    search = _RuleSearch(page, tasks, settings, settings.digest(page), seed, folder)
    generations = settings.generations(tasks)
    total = generations * search.steps_a_generation
    return search.carry_out({"generations": generations}, total, listeners, resume=True, start=start_of(start))
