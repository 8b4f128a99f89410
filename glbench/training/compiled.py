"""``train_compiled``: one agent by the compiled PPO (``glbench.training.learner``), in a folder that can be continued."""

from __future__ import annotations

import io
import json
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from numpy.typing import NDArray

from glbench.agents.network_policy import FAST, Actor, ActorAgent, Gru, NetworkPolicy
from glbench.errors import ShapeError, TrainingError
from glbench.resources import write_atomically
from glbench.tasks import task_card
from glbench.training.card import POLICY, TrainingFacts, note_session, write_card
from glbench.training.compiled_settings import NAME
from glbench.training.constant_columns import without_constant_columns
from glbench.training.folder import DAMAGED, LEARNER, SETTINGS, Trained, altered, claim, folder_lock, open_folder
from glbench.training.learner import Learner, Learning
from glbench.training.periodic_evaluation import CurvePoint, History, Listener, Pace, Probe, Progress

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.training.compiled_settings import CompiledSettings

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_CONSTANT = 1e-4
"""A column whose spread is less than this share of its mean counts as constant."""


def train_compiled(
    task: TaskSpec,
    settings: CompiledSettings,
    folder: Path,
    *,
    seed: int = 0,
    resume: bool = False,
    listeners: Sequence[Listener] = (),
) -> Trained:
    """Train one agent in ``folder``; the same task, settings and seed give the same policy on the same machine.

    Parameters
    ----------
    task, settings, seed
        What to train. The seed is the learner's: first weights, first places, exploration, batches. The bits of the policy also depend on
        the number of cores, or ``PJRT_NPROC``.
    folder
        Where to keep the learner's state, the best policy, the learning curve and the card.
    resume
        Continue from what ``folder`` holds, with the same bits as without the interruption; begin if it holds nothing.
    listeners
        Receive progress, evaluations and saves.

    Raises
    ------
    TrainingError
        When ``folder`` holds something else, or an unfinished training without ``resume``; when the learner diverges, or the
        compiled kernel cannot step the task.
    TaskError
        When the task has only a test split.
    """
    task.check_training()
    with folder_lock(folder), jax.default_device(jax.devices("cpu")[0]):
        identity = {"task_digest": task.digest, "settings_digest": settings.digest, "seed": seed}
        state = folder / LEARNER if (folder / LEARNER).is_file() else None
        target = {"steps": settings.updates * settings.rollout}
        card = claim(folder, identity, state, start=None, target=target, resume=resume)
        if card is not None:
            return Trained.of(folder, card, already_done=True)
        under_way = _Training(task, settings, seed, identity)
        if state is not None:
            under_way.go_on(state)
        note_session(under_way.history, task, under_way.steps)
        open_folder(folder, settings.model_dump(mode="json", exclude_none=True))
        _run(under_way, folder, listeners)
        card = write_card(folder, task, _facts(under_way), settings.evaluation, under_way.history)
    return Trained.of(folder, card, already_done=False)


class _Training:
    """A training, new or from its saved state."""

    def __init__(self, task: TaskSpec, settings: CompiledSettings, seed: int, identity: dict[str, Any]) -> None:
        self.task, self.settings, self.identity = task, settings, identity
        self._learner = Learner.of(task, settings)
        self._update = jax.jit(self._learner.update)
        self._key = jax.random.key(seed)
        self._learning: Learning = jax.jit(self._learner.begin)(jax.random.fold_in(self._key, 0))
        self._probe = Probe(task.chosen_on, settings.evaluation, settings.kernel_preset)
        self.updates = 0
        self.history = History()

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.updates * self.settings.rollout

    def update(self) -> float:
        """Do a rollout and learn from it; return its mean reward per step."""
        with self.history.time.spend("learning"):
            key, share = jax.random.fold_in(self._key, self.updates + 1), self.updates / self.settings.updates
            self._learning, reward = self._update(self._learning, key, share)
            self.updates += 1
            return float(reward)

    def policy(self) -> Actor:
        """The policy as it stands, without the noise of exploration.

        Raises
        ------
        TrainingError
            When its weights are no longer finite.
        """
        card, learning, learner = task_card(self.task), self._learning, self._learner
        columns, layers, names = learning.columns, learning.weights["actor"], card.observation_names
        hours, steered = self.settings.memory.hours, learner.max_change > 0
        mean, spread = np.asarray(columns.mean, np.float64), np.sqrt(np.asarray(columns.variance, np.float64))
        units, varying = self.settings.memory.gru, spread > _CONSTANT * np.abs(mean)
        low, high = card.action_bounds
        try:
            network = NetworkPolicy(
                task_id=self.task.id,
                delta=self.task.uncertainty.delta,
                observation_names=(
                    *names,
                    *(f"{names[i]}, mean of {hour:g} h" for hour in hours for i in learner.traced),
                    *(f"memory {i}" for i in range(units)),
                ),
                action_names=card.action_names,
                low=np.where(steered, 0.0, low),
                high=np.where(steered, 1.0, high),
                mean=np.append(mean, np.zeros(units)),
                scale=np.append(np.asarray(learner.scale(columns), np.float64), np.ones(units)),
                clip=self.settings.normalize.clip_observations,
                weights=tuple(np.asarray(weights) for weights, _ in layers),
                biases=tuple(np.asarray(bias) for _, bias in layers),
                activation="Tanh",
                output="clip",
                about={
                    "algorithm": NAME,
                    "seed": self.identity["seed"],
                    "steps": self.steps,
                    "task_digest": self.task.digest,
                },
            )
            gru = None
            if units:
                arrays = {name: np.asarray(value) for name, value in self._learning.weights["gru"].items()}
                weights = np.where(varying[:, None], arrays["weights"], np.float32(0.0))
                gru = Gru(weights, arrays["bias"], arrays["recurrent"])
        except ShapeError as error:
            msg = f"The training diverged within {self.steps:,} steps: {error} Lower the learning rate, or max_grad_norm."
            raise TrainingError(msg) from error
        network = without_constant_columns(network, np.append(varying, np.ones(units, np.bool_)))
        return Actor(network, learner.traced, learner.shares, learner.max_change, low, high, gru)

    def evaluate(self, policy: Actor) -> CurvePoint:
        """A point of the learning curve."""
        with self.history.time.spend("evaluation"):
            agent = ActorAgent(policy.with_arithmetic(FAST))
            agent.reset(task_card(self.task), len(self._probe.seeds))
            result = self._probe.of(agent.act)
        if self.steps >= self.history.next_evaluation:  # an end between two evaluations does not shift them
            self.history.next_evaluation = self.steps + self.settings.evaluation.every
        return self.history.add(self.steps, result)

    def keep(self, file: Path) -> None:
        """Write what is needed to continue to ``file``."""
        leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(self._learning)]
        state = {"identity": self.identity, "history": asdict(self.history), "updates": self.updates}
        facts = json.dumps({**state, "digest": _digest(state, leaves)})
        arrays = {f"leaf_{number}": leaf for number, leaf in enumerate(leaves)}
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, facts=np.frombuffer(facts.encode(), np.uint8), **arrays)
        write_atomically(file, content.getvalue())

    def go_on(self, file: Path) -> None:
        """Continue from the state in ``file``.

        Raises
        ------
        TrainingError
            When the file belongs to another training, cannot be read, or has been changed.
        """
        first_leaves, tree = jax.tree.flatten(self._learning)
        try:
            with np.load(file, allow_pickle=False) as arrays:
                facts = json.loads(arrays["facts"].tobytes())
                leaves = [arrays[f"leaf_{number}"] for number in range(len(first_leaves))]
        except DAMAGED as error:
            msg = f"The state of the training {file} cannot be read: {error}. Remove it to start the training again."
            raise TrainingError(msg) from error
        if facts["identity"] != self.identity:
            msg = f"{file.parent} holds another training: task, settings or seed differ. Choose another folder with --out."
            raise TrainingError(msg)
        if facts.pop("digest", None) != _digest(facts, leaves):
            raise altered(file)
        self._learning = jax.tree.unflatten(tree, [jax.numpy.asarray(leaf) for leaf in leaves])
        self.history, self.updates = History.from_dict(facts["history"]), facts["updates"]


def _run(under_way: _Training, folder: Path, listeners: Sequence[Listener]) -> None:
    settings, task = under_way.settings, under_way.task
    total, pace = settings.updates * settings.rollout, Pace(under_way.steps)
    while under_way.updates < settings.updates:
        if under_way.steps >= under_way.history.next_evaluation:
            _evaluate(under_way, folder, listeners)
        try:
            with _signals_wait():
                reward = under_way.update()
            for listener in listeners:
                listener.on_progress(Progress(under_way.steps, total, pace.rate(under_way.steps), reward * task.steps))
        except KeyboardInterrupt:
            under_way.keep(folder / LEARNER)
            raise
    if under_way.history.curve[-1]["steps"] < under_way.steps:
        _evaluate(under_way, folder, listeners)


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Ctrl-C and its like wait for the end of an update, a fraction of a second: a process that ends within one may crash."""
    mine = threading.current_thread() is threading.main_thread()  # no other thread may set handlers
    handlers = {number: signal.getsignal(number) for number in _SIGNALS} if mine else {}
    handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
    waiting: list[int] = []
    for number in handlers:
        signal.signal(number, lambda arrived, _frame: waiting.append(arrived))
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    for arrived in waiting:
        signal.raise_signal(arrived)


def _evaluate(under_way: _Training, folder: Path, listeners: Sequence[Listener]) -> None:
    if under_way.updates:  # an interruption costs the evaluation alone
        under_way.keep(folder / LEARNER)
    policy = under_way.policy()
    point = under_way.evaluate(policy)
    if point.is_best:
        write_atomically(folder / POLICY, policy.to_bytes())
    under_way.history.write_curve(folder)
    under_way.keep(folder / LEARNER)
    for listener in listeners:
        listener.on_evaluation(point)
        listener.on_saved(under_way.steps)


def _digest(facts: dict[str, Any], leaves: Sequence[NDArray[Any]]) -> str:
    """SHA-256 (hex) over the saved state of a training."""
    digest = sha256(json.dumps(facts, sort_keys=True).encode())
    for leaf in leaves:
        digest.update(f"{leaf.dtype.str} {leaf.shape}".encode() + leaf.tobytes())
    return digest.hexdigest()


def _facts(under_way: _Training) -> TrainingFacts:
    settings, steps, identity = under_way.settings, under_way.steps, under_way.identity
    accrual, memory = settings.accrual, settings.memory
    traces = (
        f" It keeps running means of {', '.join(memory.columns)} over {', '.join(f'{h:g} h' for h in memory.hours)}."
        if memory.hours
        else ""
    )
    if memory.gru:
        traces += f" It remembers with a gated recurrent unit of {memory.gru} units."
    paid = "" if accrual is None else f" {accrual.in_words}"
    return TrainingFacts(
        title=f"Compiled PPO trained on {under_way.task.id}, seed {identity['seed']}",
        description=f"The best policy of {steps:,} steps by evaluation return, without the noise of exploration.{traces}{paid}",
        command="glbench train ppo, with the settings in settings.yml; the tables below tell the rest.",
        sources=("Schulman et al. (2017). Proximal policy optimization algorithms. arXiv:1707.06347",),
        controller="actor",
        training={
            "algorithm": NAME,
            "seed": identity["seed"],
            "first_env_seed": settings.first_env_seed,
            "scenarios": settings.scenarios,
            "n_envs": settings.n_envs,
            "steps": steps,
            "kernel_preset": settings.kernel_preset,
            "settings": SETTINGS,
            "settings_digest": identity["settings_digest"],
            "learning_curve": "learning_curve.csv",
        },
    )
