"""Proximal policy optimisation (Schulman et al., 2017) as one compiled function: a rollout in all greenhouses, then learning from it.

The greenhouses are stepped from inside the function (``glbench.jax``). Actor and critic are perceptrons with tanh between their layers;
the spread of the actor's output is one number per action. Inputs are normalised by running statistics, rewards by the spread of returns.
Before and after the actor come the parts of ``agents.network_policy``: traces, and controls that are moved to the positions it outputs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from glbench.agents.network_policy import Actor, Arithmetic, affine, gru_step, hidden
from glbench.errors import TaskError, TrainingError, UnknownNameError, did_you_mean, refuse
from glbench.jax import Environment, State
from glbench.registration import task_argument
from glbench.tasks import TaskSpec
from glbench.training.compiled_settings import CompiledSettings, in_view

_LEAST = 1e-3  # Smallest scale of a column that the settings do not name
_TINY = 1e-8
_JAX = Arithmetic(jnp, affine, {"Tanh": jnp.tanh}, jax.nn.sigmoid)


class Statistics(NamedTuple):
    """Running mean and variance of columns, and the number of rows behind them."""

    mean: Any
    variance: Any
    count: Any

    @classmethod
    def empty(cls, *shape: int) -> Statistics:
        """Statistics of no rows."""
        return cls(jnp.zeros(shape), jnp.ones(shape), jnp.zeros(()))

    def with_rows(self, rows: Any, at_most: float = math.inf) -> Statistics:
        """Statistics with ``rows`` ``(n, ...)`` added; earlier rows count as at most ``at_most``."""
        added, spread, n = rows.mean(0), rows.var(0), rows.shape[0]
        before = jnp.minimum(self.count, at_most)
        count, apart = before + n, added - self.mean
        among = self.variance * before + spread * n + apart**2 * before * n / count
        return Statistics(self.mean + apart * n / count, among / count, count)


class Moments(NamedTuple):
    """First and second moments of gradients, and their number (Adam)."""

    first: Any
    second: Any
    count: Any


class Greenhouses(NamedTuple):
    """The state of the greenhouses of a training; the first axis of each array is the greenhouse."""

    state: State
    observations: Any
    """Observation and, after it, traces."""
    positions: Any
    """Of the controls, as ``ActorAgent`` keeps them."""
    info: Any
    """What ``info`` contained after the last step."""
    is_first: Any
    """Whether an episode begins here, so that ``info`` belongs to an earlier one."""
    discounted: Any
    """Rewards so far, discounted."""
    memory: Any
    """The recurrent unit's memory before the current observation; ``None`` without a unit."""


class Learning(NamedTuple):
    """Everything that the rest of a training depends on, apart from settings and seed: a tree of arrays."""

    weights: Any
    moments: Moments
    columns: Statistics
    privileged: Statistics
    returns: Statistics
    now: Greenhouses


class Rollout(NamedTuple):
    """What a rollout leaves: arrays ``(steps, greenhouses, ...)``."""

    observations: Any
    privileged: Any
    actor_input: Any
    critic_input: Any
    samples: Any
    likelihood: Any
    value: Any
    reward: Any
    paid: Any
    ended: Any
    discounted: Any


@dataclass(frozen=True)
class Learner:
    """The compiled learner of a task: ``begin`` a training, and ``update`` it.

    ``update(learning, key, share)`` returns the next state and the mean reward of its steps, without what is paid in training only;
    ``share`` is how much of the training is over, 0 to 1.
    """

    settings: CompiledSettings
    environment: Environment
    """``settings`` and ``environment``: how it learns, and in what."""
    least_scale: NDArray[np.float32]
    """Smallest scale by which a column and a trace are divided."""
    traced: NDArray[np.int64]
    shares: NDArray[np.float64]
    """``traced`` and ``shares``: columns with traces, and how far these move towards a reading in a step."""
    max_change: NDArray[np.float64]
    """How far an action of 1 moves its control in a step; 0 where the actor outputs the action itself."""
    visible: NDArray[np.bool_]
    """Which columns and traces actor and critic see; the others count as their mean."""
    spread: NDArray[np.float32]
    """Logarithm of the standard deviation of each of the actor's outputs at first."""

    @classmethod
    def of(cls, task: TaskSpec, settings: CompiledSettings) -> Learner:
        """The learner for a task.

        Raises ``TrainingError`` when the settings name a column, a quantity or a state that the task does not have, traces of a column that
        is out of view, or the compiled kernel cannot step the task.
        """
        names, columns_in_view = [column.name for column in task.observed()], in_view(task, settings)
        least = np.full(len(names), _LEAST, np.float32)
        for name, value in settings.least_scale.items():
            if name in names:
                least[names.index(name)] = value
        hours, columns = settings.memory.hours, settings.memory.columns if settings.memory.hours else ()
        for name in columns:
            if name not in names:
                refuse(f"'memory.columns': {task.id} shows no column '{name}'.{did_you_mean(name, names)}", TrainingError)
            if name not in columns_in_view:
                refuse(f"'memory.columns': '{name}' is out of the view {', '.join(settings.view or ())}.", TrainingError)
        traced = np.array([names.index(name) for name in columns], np.int64)
        shares = -np.expm1(-task.step_seconds / (3600.0 * np.array(hours, np.float64)))
        accrual = settings.accrual
        if accrual is not None:
            accrual.places(task)
        actions = [action.name for action in task.actions]
        for name in settings.log_std_of:
            if name not in actions:
                refuse(f"'log_std_of': {task.id} has no action '{name}'.{did_you_mean(name, actions)}", TrainingError)
        privileged = settings.critic_sees if accrual is None else (*accrual.states, *settings.critic_sees)
        try:
            environment = Environment(
                task, settings.kernel_preset, seeds=settings.seeds, places=settings.places, info=tuple(dict.fromkeys(privileged))
            )
        except UnknownNameError as error:
            refuse(f"'critic_sees': {error}", TrainingError, error)
        except TaskError as error:
            command = f"glbench train stable_baselines3.PPO --task {task_argument(task.id)}"
            refuse(f"{error} Or train with Stable-Baselines3, which supports it: {command}", TrainingError, error)
        return cls(
            settings,
            environment,
            np.concatenate([least, np.tile(least[traced], len(hours))]),
            traced,
            shares,
            steps_of_controls(task) if settings.steer else np.zeros(environment.num_actions),
            np.array([name in columns_in_view for name in names] + [True] * len(traced) * len(hours), np.bool_),
            np.array([settings.log_std_of.get(name, settings.log_std_init) for name in actions], np.float32),
        )

    def begin_with(self, learning: Learning, actor: Actor, name: str, count: float) -> Learning:
        """``learning`` with the actor of a policy and its statistics, which then stand for ``count`` observations.

        Raises ``TrainingError`` when the policy would act differently here: its network, running means, normalisation or actions differ
        from those of the settings, or it uses a column that is out of view; ``name`` is the policy's.
        """
        network, weights = actor.network, dict(learning.weights)
        kinds: dict[str, tuple[Any, Any]] = {
            "layers ('net_arch', 'memory')": (
                [matrix.shape for matrix in network.weights],
                [matrix.shape for matrix, _ in weights["actor"]],
            ),
            "activation and output": ([network.activation, network.output], ["Tanh", "clip"]),
            "places of remembered columns ('memory.columns')": (actor.traced.tolist(), self.traced.tolist()),
            "running means, by the share of a reading that they take in ('memory.hours'),": (actor.shares.tolist(), self.shares.tolist()),
            "changes of controls in a step ('steer')": (actor.max_change.tolist(), self.max_change.tolist()),
            "limits of normalised observations ('normalize.clip_observations')": (network.clip, self.settings.normalize.clip_observations),
        }
        for what, (its, ours) in kinds.items():
            if its != ours:
                refuse(f"The training cannot start from {name}: its {what} are {its}; those of this training are {ours}.", TrainingError)
        columns = len(self.least_scale)
        self._check_columns(actor, name, columns)
        weights["actor"] = [(jnp.asarray(w), jnp.asarray(b)) for w, b in zip(network.weights, network.biases, strict=True)]
        if actor.gru is not None:
            weights["gru"] = {part: jnp.asarray(getattr(actor.gru, part)) for part in ("weights", "bias", "recurrent")}
        mean, scale = (jnp.asarray(values[:columns], jnp.float32) for values in (network.mean, network.scale))
        variance = jnp.maximum(scale**2 - self.least_scale**2, 0.0)
        return learning._replace(weights=weights, columns=Statistics(mean, variance, jnp.float32(count)))

    def _check_columns(self, actor: Actor, name: str, columns: int) -> None:
        used = np.any(actor.network.weights[0][:columns] != 0.0, axis=1)
        if actor.gru is not None:
            used |= np.any(actor.gru.weights[:columns] != 0.0, axis=1)
        is_raised = actor.network.scale[:columns] < 0.999 * self.least_scale
        reasons = {
            "it uses '{}', which is not in 'view'": ~self.visible,
            "'least_scale' is above the policy's own scale of '{}'": is_raised,
        }
        for reason, places in reasons.items():
            if (used & places).any():
                column = actor.network.observation_names[int(np.flatnonzero(used & places)[0])]
                refuse(f"The training cannot start from {name}: {reason.format(column)}.", TrainingError)

    def begin(self, key: Any) -> Learning:
        """An untrained learner, its greenhouses spread over seasons."""
        s, environment = self.settings, self.environment
        inputs, actions, units = len(self.least_scale), environment.num_actions, s.memory.gru
        keys = jax.random.split(key, 3)
        actor = _network(keys[0], [inputs + units, *s.net_arch, actions], last=0.01)
        actor[-1] = (actor[-1][0], jnp.where(self.max_change > 0, 0.5, 0.0).astype(np.float32))
        weights = {
            "actor": actor,
            "critic": _network(keys[1], [inputs + len(s.critic_sees) + units, *s.net_arch, 1], last=1.0),
            "spread": jnp.array(self.spread),
        }
        if units:
            weights["gru"] = _gru(jax.random.fold_in(key, 0), inputs, units)
        nothing = jax.tree.map(jnp.zeros_like, weights)
        observation, state = jax.vmap(environment.reset)(jax.random.split(keys[2], s.n_envs))
        none = jnp.zeros(s.n_envs)
        now = Greenhouses(
            state,
            self._with_traces(observation, self._first_traces(observation)),
            jnp.zeros((s.n_envs, actions)),
            dict.fromkeys(environment.info, none),
            jnp.ones(s.n_envs, jnp.bool_),
            none,
            jnp.zeros((s.n_envs, units)) if units else None,
        )
        return Learning(
            weights,
            Moments(nothing, nothing, jnp.zeros((), jnp.int32)),
            Statistics.empty(inputs),
            Statistics.empty(len(s.critic_sees)),
            Statistics.empty(),
            now,
        )

    def scale(self, columns: Statistics) -> Any:
        """What columns and traces are divided by."""
        return jnp.sqrt(columns.variance + self.least_scale**2)

    def update(self, learning: Learning, key: Any, share: Any) -> tuple[Learning, Any]:
        """One rollout, and the learning from it."""
        s = self.settings
        keys = jax.random.split(key, s.n_steps + s.n_epochs)

        def step(now: Greenhouses, key: Any) -> Any:
            return self._step(learning, now, key)

        now, all_of = jax.lax.scan(step, learning.now, keys[: s.n_steps])
        returns = learning.returns.with_rows(all_of.discounted.reshape(-1), s.reward_window)
        limit = s.normalize.clip_rewards
        scaled = jnp.clip(all_of.paid / jnp.sqrt(returns.variance + _TINY), -limit, limit)
        last = self._value(learning, now)[1]
        gain = self._advantages(all_of.value, scaled, all_of.ended, last)
        of_batch = all_of.actor_input, all_of.critic_input, all_of.samples, all_of.likelihood, gain, gain + all_of.value
        if s.memory.gru:  # a row is the sequence of a greenhouse
            rows = jax.tree.map(lambda a: a.swapaxes(0, 1), (*of_batch, all_of.ended)), learning.now.memory
        else:
            rows = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), of_batch)
        n_rows, n_batches = s.n_envs if s.memory.gru else s.rollout, s.rollout // s.batch_size
        rate = s.learning_rate + (s.last_learning_rate - s.learning_rate) * share

        def batch(learner: Any, places: Any) -> Any:
            weights, moments = learner
            gradient = jax.grad(self._loss)(weights, jax.tree.map(lambda a: a[places], rows))
            return self._adam(weights, moments, gradient, rate), None

        def epoch(learner: Any, key: Any) -> Any:
            return jax.lax.scan(batch, learner, jax.random.permutation(key, n_rows).reshape(n_batches, -1))

        (weights, moments), _ = jax.lax.scan(epoch, (learning.weights, learning.moments), keys[s.n_steps :])
        if s.critic_first:
            alone = share < s.critic_first
            policy = {part: before for part, before in learning.weights.items() if part != "critic"}
            weights |= jax.tree.map(lambda before, after: jnp.where(alone, before, after), policy, {part: weights[part] for part in policy})
        columns = learning.columns.with_rows(all_of.observations.reshape(s.rollout, -1))
        privileged = learning.privileged.with_rows(all_of.privileged.reshape(s.rollout, -1))
        return Learning(weights, moments, columns, privileged, returns, now), all_of.reward.mean()

    def _first_traces(self, observation: Any) -> Any:
        return jnp.repeat(observation[:, None, self.traced], len(self.shares), 1)

    def _with_traces(self, observation: Any, traces: Any) -> Any:
        return jnp.concatenate([observation, traces.reshape(len(observation), -1)], 1)

    def _privileged_inputs(self, now: Greenhouses) -> Any:
        """What only the critic sees ``(greenhouses, quantities)``."""
        names = self.settings.critic_sees
        return jnp.stack([now.info[name] for name in names], 1) if names else jnp.zeros((len(now.is_first), 0))

    def _value(self, learning: Learning, now: Greenhouses) -> tuple[Any, Any, Any, Any]:
        """Input of the critic and its output, input of the actor, and the memory that both see besides."""
        columns, privileged = learning.columns, learning.privileged
        limit = self.settings.normalize.clip_observations
        actor_input = jnp.clip((now.observations - columns.mean) / self.scale(columns), -limit, limit)
        if not self.visible.all():
            actor_input = jnp.where(self.visible, actor_input, 0.0)
        floor = _LEAST * jnp.abs(privileged.mean) + _TINY
        besides = jnp.clip((self._privileged_inputs(now) - privileged.mean) / jnp.sqrt(privileged.variance + floor**2), -limit, limit)
        critic_input = jnp.concatenate([actor_input, jnp.where(now.is_first[:, None], 0.0, besides)], 1)
        gru, memory = learning.weights.get("gru"), now.memory
        if memory is not None:
            memory = _remember(gru, _input_gates(gru, actor_input), memory)
        value = _apply(learning.weights["critic"], _beside(critic_input, memory))[:, 0]
        return critic_input, value, actor_input, memory

    def _step(self, learning: Learning, now: Greenhouses, key: Any) -> tuple[Greenhouses, Rollout]:
        """One step of all greenhouses with the noise of exploration."""
        s, keys = self.settings, jax.random.split(key, self.settings.n_envs + 1)
        critic_input, value, actor_input, memory = self._value(learning, now)
        mean, spread = _apply(learning.weights["actor"], _beside(actor_input, memory)), learning.weights["spread"]
        sample = mean + jnp.exp(spread) * jax.random.normal(keys[0], mean.shape)
        action, positions = self._act(sample, now.positions)
        observation, state, reward, ended, info = jax.vmap(self.environment.step)(keys[1:], now.state, action)
        paid = reward
        if s.accrual is not None:  # the state before the first step is not known
            states = zip(s.accrual.states, s.accrual.prices, strict=True)
            paid += jnp.where(now.is_first, 0.0, sum(price * (info[state] - now.info[state]) for state, price in states))
        discounted = now.discounted * s.gamma + paid
        traces = now.observations[:, self.environment.obs_shape[0] :].reshape(s.n_envs, len(self.shares), len(self.traced))
        traces += self.shares[:, None].astype(np.float32) * (observation[:, None, self.traced] - traces)
        traces = jnp.where(ended[:, None, None], self._first_traces(observation), traces)
        after = Greenhouses(
            state,
            self._with_traces(observation, traces),
            jnp.where(ended[:, None], 0.0, positions),
            {name: info[name] for name in now.info},
            ended,
            jnp.where(ended, 0.0, discounted),
            None if memory is None else jnp.where(ended[:, None], 0.0, memory),
        )
        likelihood = _log_likelihood(mean, spread, sample)
        return after, Rollout(
            now.observations,
            self._privileged_inputs(now),
            actor_input,
            critic_input,
            sample,
            likelihood,
            value,
            reward,
            paid,
            ended,
            discounted,
        )

    def _act(self, sample: Any, positions: Any) -> tuple[Any, Any]:
        """Actions, and where controls stand after them."""
        steered, change = self.max_change > 0, np.where(self.max_change > 0, self.max_change, 1.0).astype(np.float32)
        action = jnp.where(steered, (jnp.clip(sample, 0.0, 1.0) - positions) / change, sample)
        box = self.environment.action_space()
        action = jnp.clip(action, box.low, box.high)
        return action, jnp.clip(positions + change * action, 0.0, 1.0)

    def _advantages(self, value: Any, reward: Any, ended: Any, last: Any) -> Any:
        """Generalised advantages ``(steps, envs)``; a season's end is terminal: no value follows."""
        s = self.settings

        def back(carry: Any, now: Any) -> Any:
            advantage, following = carry
            value, reward, going = now
            advantage = reward + s.gamma * following * going - value + s.gamma * s.gae_lambda * going * advantage
            return (advantage, value), advantage

        sequences = value, reward, 1.0 - ended
        return jax.lax.scan(back, (jnp.zeros_like(last), last), sequences, reverse=True)[1]

    def _replayed(self, weights: Any, sequences: Any) -> Any:
        """The batch of the steps of sequences, with what the recurrent unit remembers at each: gradients go through all of them."""
        (actor_input, critic_input, *others, ended), memory = sequences
        inputs = _input_gates(weights["gru"], actor_input).swapaxes(0, 1), ended.swapaxes(0, 1)[..., None]

        def step(memory: Any, now: Any) -> Any:
            after = _remember(weights["gru"], now[0], memory)
            return jnp.where(now[1], 0.0, after), after

        memories = jax.lax.scan(step, memory, inputs)[1].swapaxes(0, 1)
        batch = _beside(actor_input, memories), _beside(critic_input, memories), *others
        return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), batch)

    def _loss(self, weights: Any, batch: Any) -> Any:
        s = self.settings
        if s.memory.gru:
            batch = self._replayed(weights, batch)
        actor_input, critic_input, sample, before, gain, target = batch
        gain = (gain - gain.mean()) / (gain.std() + _TINY)
        ratio = jnp.exp(_log_likelihood(_apply(weights["actor"], actor_input), weights["spread"], sample) - before)
        bounded = jnp.clip(ratio, 1.0 - s.clip_range, 1.0 + s.clip_range)
        wrong = ((_apply(weights["critic"], critic_input)[:, 0] - target) ** 2).mean()
        return s.vf_coef * wrong - jnp.minimum(ratio * gain, bounded * gain).mean() - s.ent_coef * weights["spread"].sum()

    def _adam(self, weights: Any, moments: Moments, gradient: Any, rate: Any) -> tuple[Any, Moments]:
        size = jnp.sqrt(sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(gradient)))
        shrunk = jnp.minimum(1.0, self.settings.max_grad_norm / (size + 1e-6))
        gradient = jax.tree.map(lambda leaf: leaf * shrunk, gradient)
        first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, moments.first, gradient)
        second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g**2, moments.second, gradient)
        count = moments.count + 1
        rate = rate * jnp.sqrt(1.0 - 0.999**count) / (1.0 - 0.9**count)
        moved = jax.tree.map(lambda w, m, v: w - rate * m / (jnp.sqrt(v) + 1e-5), weights, first, second)
        return moved, Moments(first, second, count)


def steps_of_controls(task: TaskSpec) -> NDArray[np.float64]:
    """How far an action of 1 moves its control in a step, by action; 0 where actions are not rates, and for on/off machines."""
    if task.actuation.kind != "rate":
        return np.zeros(len(task.actions))
    return np.array([0.0 if name in task.on_off else task.actuation.max_change for name in task.actuation.controls])


def _network(key: Any, sizes: Sequence[int], last: float) -> list[tuple[Any, Any]]:
    """Weights and biases of a perceptron: orthogonal; the last layer is scaled by ``last``."""
    sizes_of = list(pairwise(sizes))
    gains = [math.sqrt(2.0)] * (len(sizes_of) - 1) + [last]
    keys = jax.random.split(key, len(gains))
    return [
        (jax.nn.initializers.orthogonal(gain)(one, size, jnp.float32), jnp.zeros(size[1]))
        for one, size, gain in zip(keys, sizes_of, gains, strict=True)
    ]


def _apply(network: list[tuple[Any, Any]], x: Any) -> Any:
    *layers, last = (affine(weights, bias) for weights, bias in network)
    return last(hidden(layers, x, jnp.tanh))


def _gru(key: Any, inputs: int, units: int) -> dict[str, Any]:
    """Weights of a gated recurrent unit, as ``Gru`` has them: orthogonal; at first it keeps three quarters in a step."""
    keys, initial = jax.random.split(key, 6), jax.nn.initializers.orthogonal()
    return {
        "weights": jnp.concatenate([initial(one, (inputs, units), jnp.float32) for one in keys[:3]], 1),
        "bias": jnp.zeros(3 * units).at[:units].set(1.0),
        "recurrent": jnp.concatenate([initial(one, (units, units), jnp.float32) for one in keys[3:]], 1),
    }


def _input_gates(gru: dict[str, Any], x: Any) -> Any:
    """The input as the gates get it: for all steps at once."""
    return affine(gru["weights"], gru["bias"])(x)


def _remember(gru: dict[str, Any], input_gates: Any, memory: Any) -> Any:
    """The memory after an input."""
    return gru_step(input_gates, memory @ gru["recurrent"], memory, _JAX)


def _beside(x: Any, memory: Any) -> Any:
    return x if memory is None else jnp.concatenate([x, memory], -1)


def _log_likelihood(mean: Any, spread: Any, action: Any) -> Any:
    return (-0.5 * ((action - mean) / jnp.exp(spread)) ** 2 - spread - 0.5 * math.log(2.0 * math.pi)).sum(-1)
