"""``train_compiled``: one agent by the compiled PPO (``glbench.training.learner``), in a folder that can be continued."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from glbench.agents.network_policy import FAST, Actor, ActorAgent, Gru, NetworkPolicy
from glbench.errors import ShapeError, TrainingError
from glbench.kernel.cvodes import signals_wait
from glbench.resources import write_atomically
from glbench.tasks import TaskSpec, task_card
from glbench.training.card import POLICY, TrainingFacts, policy_in, start_of, training_table
from glbench.training.compiled_settings import NAME, CompiledSettings, in_view
from glbench.training.constant_columns import without_constant_columns
from glbench.training.folder import LEARNER, Trained
from glbench.training.learner import Learner, Learning
from glbench.training.periodic_evaluation import Listener, Probe, ProbeResult
from glbench.training.session import Arrays, Session

_ROLLOUTS = 100  # The statistics of a policy to start from count as this many rollouts
_CONSTANT = 1e-4  # A column whose spread is less than this share of its mean counts as constant


def train_compiled(
    task: TaskSpec, settings: CompiledSettings, folder: Path, *, seed: int = 0, resume: bool = False, listeners: Sequence[Listener] = ()
) -> Trained:
    """Train one agent in ``folder``; the same task, settings and seed give the same policy on the same machine.

    Raises ``TrainingError`` when ``folder`` holds something else, or an unfinished training without ``resume``; when the learner diverges,
    or the compiled kernel cannot step the task, and ``TaskError`` when the task has only a test split. The seed is the learner's: first
    weights, first places, exploration, batches. The bits of the policy also depend on the number of cores, or ``PJRT_NPROC``. ``folder``
    keeps the learner's state, the best policy, the learning curve and the card; ``resume`` continues from it, with the same bits as without
    the interruption, or begins if it holds nothing. ``listeners`` receive progress, evaluations and saves.
    """
    task.check_training()
    steps, policy = settings.updates * settings.rollout, settings.start_from
    start = None if policy is None else start_of(policy)
    with jax.default_device(jax.devices("cpu")[0]):
        under_way = _Training([task], settings, settings.digest, seed, folder)
        return under_way.carry_out({"steps": steps}, steps, listeners, resume=resume, policy=policy, start=start)


class _Training(Session):
    """A training, new or from its saved state."""

    what, state = "training", LEARNER
    settings: CompiledSettings
    updates = 0

    def prepare(self) -> None:
        (self.task,), settings = self.tasks, self.settings
        self._learner = Learner.of(self.task, settings)
        self._update = jax.jit(self._learner.update)
        self._key = jax.random.key(self.seed)
        self._learning: Learning = jax.jit(self._learner.begin)(jax.random.fold_in(self._key, 0))
        if settings.start_from is not None:
            actor, weight = policy_in(settings.start_from, self.task), _ROLLOUTS * settings.rollout
            self._learning = self._learner.begin_with(self._learning, actor, str(settings.start_from), weight)
        self._probe = Probe(self.task.chosen_on, settings.evaluation, settings.kernel_preset)

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        return self.updates * self.settings.rollout

    def advance(self) -> float:
        with signals_wait():  # a process that ends during an update, a fraction of a second, may crash
            return self.update() * self.task.steps

    def update(self) -> float:
        """Do a rollout and learn from it; return its mean reward per step."""
        with self.history.time.spend("learning"):
            key, share = jax.random.fold_in(self._key, self.updates + 1), self.updates / self.settings.updates
            self._learning, reward = self._update(self._learning, key, share)
            self.updates += 1
            return float(reward)

    def policy(self) -> Actor:
        """The policy as it stands, without the noise of exploration. Raises ``TrainingError`` when its weights are no longer finite."""
        card, learning, learner = task_card(self.task), self._learning, self._learner
        columns, layers, names = learning.columns, learning.weights["actor"], card.observation_names
        hours, steered = self.settings.memory.hours, learner.max_change > 0
        mean, spread = np.asarray(columns.mean, np.float64), np.sqrt(np.asarray(columns.variance, np.float64))
        units, varying = self.settings.memory.gru, (spread > _CONSTANT * np.abs(mean)) & learner.visible
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
                about={"algorithm": NAME, "seed": self.seed, "steps": self.steps, "task_digest": self.task.digest},
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

    def evaluate(self) -> ProbeResult:
        agent = ActorAgent(self.policy().with_arithmetic(FAST))
        agent.reset(task_card(self.task), len(self._probe.seeds))
        return self._probe.of(agent.act)

    def save_best(self) -> None:
        write_atomically(self.folder / POLICY, self.policy().to_bytes())

    def arrays(self) -> Arrays:
        return {f"leaf_{number}": np.asarray(leaf) for number, leaf in enumerate(jax.tree.leaves(self._learning))}

    def counts(self) -> dict[str, int]:
        return {"updates": self.updates}

    def restore(self, arrays: Arrays, facts: Mapping[str, Any]) -> None:
        leaves = [jax.numpy.asarray(arrays[name]) for name in self.arrays()]
        self._learning, self.updates = jax.tree.unflatten(jax.tree.structure(self._learning), leaves), facts["updates"]

    def facts(self) -> TrainingFacts:
        settings, accrual, memory = self.settings, self.settings.accrual, self.settings.memory
        columns, traces = in_view(self.task, settings), ""
        if settings.view is not None:
            traces = f" It looks at {len(columns)} of {len(self.task.observed())} observed columns: {', '.join(settings.view)}."
        if memory.hours:
            traces += f" It keeps running means of {', '.join(memory.columns)} over {', '.join(f'{h:g} h' for h in memory.hours)}."
        if memory.gru:
            traces += f" It remembers with a gated recurrent unit of {memory.gru} units."
        paid = "" if accrual is None else f" {accrual.in_words(self.task)}"
        return TrainingFacts(
            title=f"Compiled PPO trained on {self.task.id}, seed {self.seed}",
            description=f"The best policy of {self.steps:,} steps by evaluation return, without the noise of exploration.{traces}{paid}",
            command="glbench train ppo, with the settings in settings.yml; the tables below tell the rest.",
            sources=("Schulman et al. (2017). Proximal policy optimization algorithms. arXiv:1707.06347",),
            controller="actor",
            training={
                **training_table(NAME, settings, self.identity["settings_digest"], self.seed, self.steps),
                "first_env_seed": settings.first_env_seed,
                "scenarios": settings.scenarios,
                "n_envs": settings.n_envs,
                **({} if settings.view is None else {"view": list(settings.view), "columns_in_view": columns}),
            },
        )
