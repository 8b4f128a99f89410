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
from collections.abc import Callable, Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from glbench.agents.network_policy import FAST, Actor, ActorAgent, NetworkPolicy
from glbench.arrays import Floats
from glbench.env import Simulation
from glbench.errors import TrainingError, did_you_mean, refuse
from glbench.kernel import make_kernel
from glbench.resources import write_atomically
from glbench.settings import validated
from glbench.tasks import TaskSpec, task_card
from glbench.tasks.record import FIRST_TRAINING_SEED
from glbench.training.card import POLICY, TrainingFacts, policy_in, start_of
from glbench.training.compiled_settings import CompiledSettings
from glbench.training.constant_columns import varies, without_constant_columns
from glbench.training.folder import Trained
from glbench.training.periodic_evaluation import CurvePoint, Listener, Probe, ProbeResult, Progress, season_sums
from glbench.training.settings import EvaluationPlan, FrozenSettings, PolicyFile, TrainingSeed, section
from glbench.training.strategy import HANSEN, Search

Singles = NDArray[np.float32]
_LOOKED_AT = 5  # Only every fifth step of the runs is used to compute the directions
_ADDED = {"actions": [], "seasons": 1}  # Settings that earlier searches did not have; their digests stay what they were


class BatchedPolicy(ActorAgent):
    """Acts with another last layer in each row. ``seconds`` is the time spent on actions so far [s]."""

    def __init__(self, policy: Actor, task: TaskSpec) -> None:
        super().__init__(policy.with_arithmetic(FAST))
        self._card = task_card(task)
        self.seconds = 0.0

    def take(self, layers: Sequence[tuple[Singles, Singles]]) -> None:
        """As many runs begin as there are last layers: weights ``(hidden, actions)`` and biases ``(actions,)``."""
        self.reset(self._card, len(layers))
        self._weights = np.stack([weights for weights, _ in layers])
        self._biases = np.stack([biases for _, biases in layers])

    def act(self, observations: Singles) -> Floats:
        """Actions ``(n, actions)`` for observations ``(n, columns)``, row i by the last layer i."""
        start, network = time.perf_counter(), self.policy.network
        self.hidden: Singles = network.hidden(network.normalised(self._inputs(observations)).astype(np.float32))
        output = (self.hidden[:, None, :] @ self._weights)[:, 0] + self._biases
        actions = self._moved(network.bounded(output.astype(np.float64)))
        self.seconds += time.perf_counter() - start
        return actions


class SearchSettings(FrozenSettings):
    """Settings of a search."""

    start_from: PolicyFile
    """Policy file to adapt; in a settings file relative to it."""
    begin_anew: dict[str, float] = Field(default_factory=dict)
    """Actions, by name, whose output begins with that value instead, whatever is observed."""
    actions: tuple[str, ...] = ()
    """Actions, by name, whose output is varied; all of them if empty."""
    directions: int = Field(default=12, gt=0)
    """Principal components of the last hidden layer that a variation works with."""
    population: int = Field(default=64, gt=3)
    generations: int = Field(default=150, gt=0)
    """``population`` and ``generations``: variations a generation, each rewarded with seasons, and how many generations."""
    seasons: int = Field(default=1, gt=0)
    """Seasons that each variation plays; the mean of its rewards counts."""
    sigma: float = Field(default=0.08, gt=0)
    """Size of the first variations; 1 moves an action by its bound, along a typical deviation of a direction."""
    first_seed: TrainingSeed = 3 * FIRST_TRAINING_SEED
    """Seed of the first scenario; each generation has the next ones, the same for all its variations."""
    evaluation: EvaluationPlan = EvaluationPlan(every=4_000_000)
    """Evaluation of the mean of all variations, on seeds of its own; the best one is kept."""
    kernel_preset: Literal["fast", "reference"] = "fast"

    @classmethod
    def of(cls, policy: Path) -> SearchSettings:
        """The usual settings for a policy file. Raises ``TrainingError`` when there is none."""
        return validated(cls, {"start_from": policy}, "the settings", policy, TrainingError)

    def steps(self, task: TaskSpec) -> int:
        """Environment steps of the search on a task."""
        return self.generations * self.population * self.seasons * task.steps

    def check_actions(self, names: Sequence[str]) -> None:
        """Raises ``TrainingError`` when it names an action that is not one of ``names``."""
        for setting, own in {"actions": self.actions, "begin_anew": self.begin_anew}.items():
            for name in own:
                if name not in names:
                    refuse(f"'{setting}' names '{name}', which is not an action of the task.{did_you_mean(name, names)}", TrainingError)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) over all settings but the number of generations, and over the policy."""
        return self.digest_from(sha256(self.start_from.read_bytes()).hexdigest())

    def digest_from(self, start: str) -> str:
        """The same with a policy to start from that has the SHA-256 ``start`` (hex)."""
        content = self.model_dump(mode="json", exclude={"generations", "start_from"})
        for name, usual in _ADDED.items():
            if content[name] == usual:
                del content[name]
        content["start"] = start
        return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def read_season_search(file: Path, task_id: str, start_from: Path | None = None) -> SearchSettings:
    """Settings of a search for a task, from a YAML file with a section ``default:``; ``start_from`` instead of the file's.

    Raises ``TrainingError`` when the file cannot be read, or a value is impossible.
    """
    content = section(file, task_id)
    if start_from is not None:
        content["start_from"] = start_from
    return validated(SearchSettings, content, "the settings", file, TrainingError)


class Variations:
    """The policies that a search chooses from: numbers to last layers and back to a network."""

    def __init__(self, policy: NetworkPolicy, hidden: NDArray[np.float32], directions: int, actions: Sequence[str] = ()) -> None:
        self._policy = policy
        self._varied = [policy.action_names.index(name) for name in actions or policy.action_names]
        self._mean = hidden.mean(axis=0, dtype=np.float64)
        _, sizes, axes = np.linalg.svd(hidden - self._mean, full_matrices=False)
        rank = min(directions, int(np.count_nonzero(sizes > 1e-6 * sizes[0])))
        self._axes = axes[:rank] / (sizes[:rank, None] / np.sqrt(len(hidden)))
        self.shape = (len(self._varied), rank + 2)

    @property
    def size(self) -> int:
        """Numbers of a variation."""
        return self.shape[0] * self.shape[1]

    def layer(self, numbers: Floats) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Weights ``(hidden, actions)`` and biases ``(actions,)`` of the last layer."""
        along, shift, gain = np.split(numbers.reshape(self.shape), [-2, -1], axis=1)
        added, varied = along @ self._axes, self._varied
        weights, biases = self._policy.weights[-1].copy(), self._policy.biases[-1].copy()
        weights[:, varied] = weights[:, varied] * (1.0 + gain[:, 0]) + added.T
        biases[varied] = biases[varied] * (1.0 + gain[:, 0]) + shift[:, 0] - added @ self._mean
        return weights.astype(np.float32), biases.astype(np.float32)

    def policy(self, numbers: Floats, about: dict[str, str | int | float]) -> NetworkPolicy:
        """The policy of a variation."""
        weights, biases = self.layer(numbers)
        base = self._policy
        return replace(base, weights=(*base.weights[:-1], weights), biases=(*base.biases[:-1], biases), about=about)


class _SeasonSearch(Search):
    """A search for the last layer of a policy, for one task."""

    def prepare(self) -> None:
        (task,), settings = self.tasks, self.settings
        kernel = make_kernel(task.model_value, task.step_seconds, preset=settings.kernel_preset)
        self._simulation = Simulation(task, settings.population * settings.seasons, kernel)
        self._probe = Probe(task.chosen_on, settings.evaluation, settings.kernel_preset)
        start = _begun_anew(settings, task)
        network = start.network
        self._start, self._batched = start, BatchedPolicy(start, task)
        self._batched.take([(network.weights[-1], network.biases[-1])] * len(self._probe.seeds))
        hidden: list[Singles] = []

        def act(observations: Singles) -> Floats:
            actions = self._batched.act(observations)
            hidden.append(self._batched.hidden)
            return actions

        self._probe.of(act)
        self._variations = Variations(network, np.concatenate(hidden[::_LOOKED_AT]), settings.directions, settings.actions)
        self.begin(np.zeros(self._variations.size))

    @property
    def steps_a_generation(self) -> int:
        """Environment steps of a generation."""
        return super().steps_a_generation * int(self.settings.seasons)

    def advance(self) -> float:
        clock, batched, seasons = self.history.time, self._batched, self.settings.seasons
        with clock.spend("learning"):
            candidates = self.ask()
            batched.take([layer for layer in map(self._variations.layer, candidates) for _ in range(seasons)])
        before = batched.seconds
        with clock.spend("simulator"):
            first = self.settings.first_seed + self.generations * seasons
            seeds = [*range(first, first + seasons)] * self.settings.population
            rewards = season_sums(self._simulation, seeds, batched.act)["reward"].reshape(-1, seasons).mean(axis=1)
        clock.policy += batched.seconds - before
        clock.simulator -= batched.seconds - before
        with clock.spend("learning"):
            self.tell(candidates, rewards)
        return float(rewards.mean())

    def evaluate(self) -> ProbeResult:
        self._batched.take([self._variations.layer(self.mean)] * len(self._probe.seeds))
        return self._probe.of(self._batched.act)

    def save_best(self) -> None:
        task = self.tasks[0]
        about: dict[str, str | int | float] = {
            "algorithm": "CMA-ES", "seed": self.seed, "steps": self.steps, "task_digest": task.digest,
        }  # fmt: skip
        network = replace(self._variations.policy(self.mean, about), task_id=task.id, delta=task.uncertainty.delta)
        actor = Actor.of(network) if self._start.plain else replace(self._start, network=network)
        write_atomically(self.folder / POLICY, actor.to_bytes())

    def facts(self) -> TrainingFacts:
        file, task = self.settings.start_from, self.tasks[0]
        return TrainingFacts(
            title=f"The last layer of {file.name} adapted to {task.id} by CMA-ES, seed {self.seed}",
            description=f"The best mean of {self.generations} generations of {self._simulation.n} runs, {self.steps:,} steps.",
            command="glbench tune; the tables below tell the rest.",
            sources=(HANSEN,),
            training=self.table(),
        )


def search(
    task: TaskSpec, settings: SearchSettings, folder: Path, *, seed: int = 0, resume: bool = False, listeners: Sequence[Listener] = ()
) -> Trained:
    """Adapt a policy in ``folder``; the same task, settings and seed give the same policy on the same machine.

    Raises ``TrainingError`` when ``folder`` holds another search, or one that was begun and is not to be resumed; when the policy does not
    fit the task, and ``SubmissionError`` when there is no policy to start from, and ``TaskError`` when the task has a test alone.

    The seed is the strategy's. ``folder`` keeps rewards so far, the best policy, the learning curve and the card; ``resume`` continues
    it, to the same bits as in one go, or begins when it is empty. ``listeners`` receive progress, evaluations and saves.
    """
    task.check_training()
    under_way = _SeasonSearch([task], settings, settings.digest, seed, folder)
    policy, target = settings.start_from, {"generations": settings.generations}
    return under_way.carry_out(target, settings.steps(task), listeners, resume=resume, policy=policy, start=start_of(policy))


class _Part(Listener):
    """Passes on the news of a stage; its progress is that of all stages."""

    def __init__(self, listeners: Sequence[Listener], before: int, total: int) -> None:
        self._listeners, self._before, self._total = listeners, before, total

    def on_progress(self, progress: Progress) -> None:
        for listener in self._listeners:
            listener.on_progress(replace(progress, steps=self._before + progress.steps, total_steps=self._total))

    def on_evaluation(self, point: CurvePoint) -> None:
        for listener in self._listeners:
            listener.on_evaluation(point)

    def on_saved(self, steps: int) -> None:
        for listener in self._listeners:
            listener.on_saved(steps)


def train_then_search(
    task: TaskSpec,
    settings: CompiledSettings,
    folder: Path,
    *,
    train: Callable[..., Trained],
    searches: Sequence[SearchSettings],
    seed: int = 0,
    resume: bool = False,
    listeners: Sequence[Listener] = (),
) -> Trained:
    """Train a policy with ``train``, such as ``train_compiled``, and adapt it with each of ``searches``, the last of them in ``folder``.

    Earlier stages are beside it, in ``FOLDER-stage1``, ``FOLDER-stage2``, ...; each search starts from the stage before, whatever its
    ``start_from``. ``listeners`` receive the progress of all stages together. Raises what ``train`` and ``search`` raise, and
    ``TrainingError`` before any of them works when a search does not fit the task, or ``folder`` holds something else.
    """
    for one in searches:
        one.check_actions([action.name for action in task.actions])
    if searches:
        _claim_stages(folder, [settings, *searches])
    first, *others = [*(folder.with_name(f"{folder.name}-stage{number}") for number in range(1, len(searches) + 1)), folder]
    steps = [settings.updates * settings.rollout, *(one.steps(task) for one in searches)]
    parts = [[_Part(listeners, sum(steps[:number]), sum(steps))] for number in range(len(steps))]
    trained = train(task, settings, first, seed=seed, resume=resume, listeners=parts[0])
    for one, place, part in zip(searches, others, parts[1:], strict=True):
        started = one.model_copy(update={"start_from": trained.folder / POLICY})
        trained = search(task, started, place, seed=seed, resume=resume, listeners=part)
    return trained


def _claim_stages(folder: Path, stages: Sequence[FrozenSettings]) -> None:
    """Write the settings of all stages beside ``folder``. Raises ``TrainingError`` when it was begun with others: none is continued."""
    file = folder.with_name(f"{folder.name}-stages.json")
    settings = json.dumps([stage.model_dump(mode="json", exclude={"start_from"}) for stage in stages], indent=1)
    if not file.is_file() and folder.is_dir() and any(folder.iterdir()):
        refuse(f"{folder} holds a training without these searches. Choose another folder, or leave the searches out.", TrainingError)
    if file.is_file() and file.read_text(encoding="utf-8") != settings:
        refuse(f"{folder} was begun with other settings, those in {file}. Choose another folder, or those settings.", TrainingError)
    write_atomically(file, settings)


def _begun_anew(settings: SearchSettings, task: TaskSpec) -> Actor:
    actor = policy_in(settings.start_from, task)
    policy = actor.network
    weights, biases = policy.weights[-1].copy(), policy.biases[-1].copy()
    settings.check_actions(policy.action_names)
    for name, value in settings.begin_anew.items():
        column = policy.action_names.index(name)
        if policy.output == "tanh" and not -1.0 < value < 1.0:
            refuse(f"'begin_anew: {name}: {value}': the output of this policy lies between -1 and 1.", TrainingError)
        weights[:, column], biases[column] = 0.0, value if policy.output == "clip" else np.arctanh(value)
    start = replace(policy, weights=(*policy.weights[:-1], weights), biases=(*policy.biases[:-1], biases))
    start = without_constant_columns(start, varies(policy.mean - policy.scale, policy.mean + policy.scale))
    return Actor.of(start) if actor.plain else replace(actor, network=start)
