"""Adapting the last layer of a trained policy by the rewards of whole seasons.

Gradients of a policy look a few hours ahead; what pays days later, or what a policy has given up, they do not find. Here nothing is
differentiated: the covariance matrix adaptation evolution strategy (CMA-ES, Hansen 2016, arXiv:1604.00772; package ``cmaes``) varies
the last layer of the actor, and the sum of the rewards of a season says which variation is better. That takes a simulator that steps
many greenhouses at once: a generation of 64 is 64 runs in the same scenario.

A variation adds to each action's output a linear function of the main directions (principal components) in which the last hidden layer
varies over a season, and scales it: ``directions + 2`` numbers for each action.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from glbench.agents.network_policy import FAST, NetworkPolicy
from glbench.env import Simulation
from glbench.errors import TrainingError, did_you_mean
from glbench.kernel import make_kernel
from glbench.resources import write_atomically
from glbench.settings import validated
from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.training.card import POLICY, TrainingFacts, note_session, write_card
from glbench.training.constant_columns import varies, without_constant_columns
from glbench.training.export import policy_in, start_of
from glbench.training.folder import SEARCH, SETTINGS, Trained, claim, folder_lock, open_folder
from glbench.training.periodic_evaluation import CurvePoint, History, Listener, Pace, Probe, Progress, season_sums
from glbench.training.settings import (
    EvaluationPlan,
    FrozenSettings,
    PolicyFile,
    TrainingSeed,
    section,
)
from glbench.training.strategy import Strategy
from glbench.untrusted import real_path

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec


Singles = NDArray[np.float32]
Floats = NDArray[np.float64]
_LOOKED_AT = 5
"""Only every fifth step of the runs is used to compute the directions."""


class BatchedPolicy:
    """Acts with another last layer in each row.

    Attributes
    ----------
    seconds
        Time spent on actions so far [s].
    """

    def __init__(self, policy: NetworkPolicy) -> None:
        self._policy = replace(policy, arithmetic=FAST)
        self.take([(policy.weights[-1], policy.biases[-1])])
        self.seconds = 0.0

    def take(self, layers: Sequence[tuple[Singles, Singles]]) -> None:
        """Last layers, one a run: weights ``(hidden, actions)`` and biases ``(actions,)``."""
        self._weights = np.stack([weights for weights, _ in layers])
        self._biases = np.stack([biases for _, biases in layers])

    def hidden(self, observations: Singles) -> Singles:
        """The last hidden layer ``(n, hidden)``."""
        x: Singles = self._policy.hidden(self._policy.normalised(observations).astype(np.float32))
        return x

    def act(self, observations: Singles) -> Floats:
        """Actions ``(n, actions)`` for observations ``(n, columns)``, row i by the last layer i."""
        start = time.perf_counter()
        output = (self.hidden(observations)[:, None, :] @ self._weights)[:, 0] + self._biases
        actions = self._policy.bounded(output.astype(np.float64))
        self.seconds += time.perf_counter() - start
        return actions


class SearchSettings(FrozenSettings):
    """Settings of a search.

    Attributes
    ----------
    start_from
        Policy file to adapt; in a settings file relative to it.
    begin_anew
        Actions, by name, whose output begins with that value instead, whatever is observed.
    directions
        Principal components of the last hidden layer that a variation works with.
    population, generations
        Variations a generation, each rewarded with a season, and how many generations.
    sigma
        Size of the first variations; 1 moves an action by its bound, along a typical deviation of a direction.
    first_seed
        Seed of the scenario of the first generation; each generation has the next one, the same for all its variations.
    evaluation
        Evaluation of the mean of all variations, on seeds of its own; the best one is kept.
    """

    start_from: PolicyFile
    begin_anew: dict[str, float] = Field(default_factory=dict)
    directions: int = Field(default=12, gt=0)
    population: int = Field(default=64, gt=3)
    generations: int = Field(default=150, gt=0)
    sigma: float = Field(default=0.08, gt=0)
    first_seed: TrainingSeed = 3 * FIRST_TRAINING_SEED
    evaluation: EvaluationPlan = EvaluationPlan(every=4_000_000)
    kernel_preset: Literal["fast", "reference"] = "fast"

    @classmethod
    def of(cls, policy: Path) -> SearchSettings:
        """The usual settings for a policy file.

        Raises
        ------
        TrainingError
            When there is none.
        """
        return validated(cls, {"start_from": policy}, "the settings", policy, TrainingError)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) over all settings but the number of generations, and over the policy."""
        content = self.model_dump(mode="json", exclude={"generations", "start_from"})
        content["start"] = sha256(self.start_from.read_bytes()).hexdigest()
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_season_search(file: Path, task_id: str, start_from: Path | None = None) -> SearchSettings:
    """Settings of a search for a task, from a YAML file with a section ``default:``; ``start_from`` instead of the file's.

    Raises
    ------
    TrainingError
        When the file cannot be read, or a value is impossible.
    """
    content = section(file, task_id)
    if start_from is not None:
        content["start_from"] = start_from
    elif isinstance(content.get("start_from"), str):
        content["start_from"] = real_path(file.parent / content["start_from"])
    return validated(SearchSettings, content, "the settings", file, TrainingError)


class Variations:
    """The policies that a search chooses from: numbers to last layers and back to a policy."""

    def __init__(self, policy: NetworkPolicy, hidden: NDArray[np.float32], directions: int) -> None:
        self._policy = policy
        self._mean = hidden.mean(axis=0, dtype=np.float64)
        _, sizes, axes = np.linalg.svd(hidden - self._mean, full_matrices=False)
        rank = min(directions, int(np.count_nonzero(sizes > 1e-6 * sizes[0])))
        self._axes = axes[:rank] / (sizes[:rank, None] / np.sqrt(len(hidden)))
        self.shape = (len(policy.action_names), rank + 2)

    @property
    def size(self) -> int:
        """Numbers of a variation."""
        return self.shape[0] * self.shape[1]

    def layer(self, numbers: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Weights ``(hidden, actions)`` and biases ``(actions,)`` of the last layer."""
        along, shift, gain = np.split(numbers.reshape(self.shape), [-2, -1], axis=1)
        added = along @ self._axes
        weights = self._policy.weights[-1] * (1.0 + gain[:, 0]) + added.T
        biases = self._policy.biases[-1] * (1.0 + gain[:, 0]) + shift[:, 0] - added @ self._mean
        return weights.astype(np.float32), biases.astype(np.float32)

    def policy(self, numbers: Floats, about: dict[str, str | int | float]) -> NetworkPolicy:
        """The policy of a variation."""
        weights, biases = self.layer(numbers)
        base = self._policy
        return replace(base, weights=(*base.weights[:-1], weights), biases=(*base.biases[:-1], biases), about=about)


class _Search:
    """A search from its beginning or from what was kept of it."""

    def __init__(self, task: TaskSpec, settings: SearchSettings, seed: int) -> None:
        self.task, self.settings = task, settings
        kernel = make_kernel(task.model_value, task.step_seconds, preset=settings.kernel_preset)
        self._simulation = Simulation(task, settings.population, kernel)
        self._probe = Probe(task.chosen_on, settings.evaluation, settings.kernel_preset)
        start = _begun_anew(settings, task)
        self._batched = BatchedPolicy(start)
        self.variations = Variations(start, self._hidden_of_a_season(start), settings.directions)
        self.strategy = Strategy(np.zeros(self.variations.size), settings.sigma, population=settings.population, seed=seed)
        self.history = History()

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.generations * self.settings.population * self.task.steps

    @property
    def generations(self) -> int:
        """Generations so far."""
        return len(self.strategy.rewards)

    @property
    def mean(self) -> Floats:
        """The middle of the variations."""
        return self.strategy.mean

    def generation(self) -> None:
        """Ask the strategy for variations, reward each with a season, and tell it the rewards."""
        clock, batched = self.history.time, self._batched
        with clock.spend("learning"):
            candidates = self.strategy.ask()
            batched.take([self.variations.layer(numbers) for numbers in candidates])
        before = batched.seconds
        with clock.spend("simulator"):
            seeds = [self.settings.first_seed + self.generations] * self.settings.population
            rewards = season_sums(self._simulation, seeds, batched.act)["reward"]
        clock.policy += batched.seconds - before
        clock.simulator -= batched.seconds - before
        with clock.spend("learning"):
            self.strategy.tell(candidates, rewards)

    def evaluate(self) -> CurvePoint:
        """A point of the learning curve: the middle of the variations."""
        with self.history.time.spend("evaluation"):
            self._batched.take([self.variations.layer(self.mean)] * len(self._probe.seeds))
            result = self._probe.of(self._batched.act)
        if self.steps >= self.history.next_evaluation:  # an end between two evaluations moves none
            self.history.next_evaluation = self.steps + self.settings.evaluation.every
        return self.history.add(self.steps, result)

    def _hidden_of_a_season(self, policy: NetworkPolicy) -> NDArray[np.float32]:
        batched = BatchedPolicy(policy)
        layer = policy.weights[-1], policy.biases[-1]
        batched.take([layer] * len(self._probe.seeds))
        hidden: list[NDArray[np.float32]] = []

        def act(observations: NDArray[np.float32]) -> Floats:
            hidden.append(batched.hidden(observations))
            return batched.act(observations)

        self._probe.of(act)
        return np.concatenate(hidden[::_LOOKED_AT])


def search(
    task: TaskSpec,
    settings: SearchSettings,
    folder: Path,
    *,
    seed: int = 0,
    resume: bool = False,
    listeners: Sequence[Listener] = (),
) -> Trained:
    """Adapt a policy in ``folder``; the same task, settings and seed give the same policy on the same machine.

    Parameters
    ----------
    task, settings, seed
        What is searched for. The seed is the strategy's.
    folder
        Where it is kept: rewards so far, the best policy, the learning curve, the card.
    resume
        Go on from what ``folder`` holds, to the same bits as without the interruption; begin when it holds nothing.
    listeners
        Receive progress, evaluations and saves.

    Raises
    ------
    TrainingError
        When ``folder`` holds another search, or one that was begun and is not to be resumed; when the policy does not fit the task.
    SubmissionError
        When there is no policy to start from.
    TaskError
        When the task has a test alone.
    """
    task.check_training()
    with folder_lock(folder):
        identity = {"task_digest": task.digest, "settings_digest": settings.digest, "seed": seed}
        state = folder / SEARCH if (folder / SEARCH).is_file() else None
        card = claim(
            folder,
            identity,
            state,
            start=settings.start_from,
            target={"generations": settings.generations},
            resume=resume,
        )
        if card is not None:
            return Trained.of(folder, card, already_done=True)
        start = start_of(settings.start_from)
        under_way = _Search(task, settings, seed)
        if state is not None:
            under_way.history = under_way.strategy.go_on(state, identity)
        note_session(under_way.history, task, under_way.steps)
        open_folder(folder, settings.model_dump(mode="json"))
        _run(under_way, folder, listeners, identity)
        history, facts = under_way.history, _facts(under_way, identity)
        card = write_card(folder, task, facts, settings.evaluation, history, start)
    return Trained.of(folder, card, already_done=False)


def _run(under_way: _Search, folder: Path, listeners: Sequence[Listener], identity: dict[str, Any]) -> None:
    settings = under_way.settings
    total = settings.generations * settings.population * under_way.task.steps
    pace = Pace(under_way.steps)
    while under_way.generations < settings.generations:
        if under_way.steps >= under_way.history.next_evaluation:
            _evaluate(under_way, folder, listeners, identity)
        under_way.generation()
        mean = float(under_way.strategy.rewards[-1].mean())
        for listener in listeners:
            listener.on_progress(Progress(under_way.steps, total, pace.rate(under_way.steps), mean))
    curve = under_way.history.curve
    if not curve or curve[-1]["steps"] < under_way.steps:
        _evaluate(under_way, folder, listeners, identity)


def _evaluate(under_way: _Search, folder: Path, listeners: Sequence[Listener], identity: dict[str, Any]) -> None:
    point = under_way.evaluate()
    if point.is_best:
        about: dict[str, str | int | float] = {
            "algorithm": "CMA-ES", "seed": identity["seed"], "steps": under_way.steps, "task_digest": under_way.task.digest,
        }  # fmt: skip
        policy = under_way.variations.policy(under_way.mean, about)
        write_atomically(
            folder / POLICY,
            replace(policy, task_id=under_way.task.id, delta=under_way.task.uncertainty.delta).to_bytes(),
        )
    under_way.history.write_curve(folder)
    under_way.strategy.keep(folder / SEARCH, identity, under_way.history)
    for listener in listeners:
        listener.on_evaluation(point)
        listener.on_saved(under_way.steps)


def _begun_anew(settings: SearchSettings, task: TaskSpec) -> NetworkPolicy:
    policy = policy_in(settings.start_from, task)
    weights, biases = policy.weights[-1].copy(), policy.biases[-1].copy()
    for name, value in settings.begin_anew.items():
        if name not in policy.action_names:
            msg = f"'begin_anew' names '{name}', which is not an action of {task.id}.{did_you_mean(name, policy.action_names)}"
            raise TrainingError(msg)
        column = policy.action_names.index(name)
        if policy.output == "tanh" and not -1.0 < value < 1.0:
            msg = f"'begin_anew: {name}: {value}': the output of this policy lies between -1 and 1."
            raise TrainingError(msg)
        weights[:, column], biases[column] = 0.0, value if policy.output == "clip" else np.arctanh(value)
    start = replace(policy, weights=(*policy.weights[:-1], weights), biases=(*policy.biases[:-1], biases))
    return without_constant_columns(start, varies(policy.mean - policy.scale, policy.mean + policy.scale))


def _facts(under_way: _Search, identity: dict[str, Any]) -> TrainingFacts:
    settings, steps = under_way.settings, under_way.steps
    return TrainingFacts(
        title=f"The last layer of {settings.start_from.name} adapted to {under_way.task.id} by CMA-ES, seed {identity['seed']}",
        description=f"The best mean of {under_way.generations} generations of {settings.population} runs, {steps:,} steps.",
        command="glbench tune; the tables below tell the rest.",
        sources=("Hansen (2016). The CMA evolution strategy: a tutorial. arXiv:1604.00772",),
        training={
            "algorithm": "CMA-ES",
            "seed": identity["seed"],
            "steps": steps,
            "generations": under_way.generations,
            "population": settings.population,
            "kernel_preset": settings.kernel_preset,
            "settings": SETTINGS,
            "settings_digest": identity["settings_digest"],
            "learning_curve": "learning_curve.csv",
        },
    )
