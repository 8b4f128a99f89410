"""Proximal policy optimisation (Schulman et al., 2017) as one compiled function: a rollout in all greenhouses, then learning from it.

The greenhouses are stepped from inside the function (``glbench.jax``). Actor and critic are perceptrons with tanh between their layers; the
spread of actions is a number for each of them. Observations are normalised by running statistics, rewards by the spread of returns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from glbench.errors import TrainingError, did_you_mean
from glbench.jax import Environment, State

if TYPE_CHECKING:
    from glbench.tasks import TaskSpec
    from glbench.training.compiled_settings import CompiledSettings

_LEAST = 1e-3
"""Least scale of a column that the settings do not name."""
_TINY = 1e-8


class Statistics(NamedTuple):
    """Running mean and variance of columns, and of how many rows they are."""

    mean: Any
    variance: Any
    count: Any

    @classmethod
    def begun(cls, *shape: int) -> Statistics:
        """Those of nothing."""
        return cls(jnp.zeros(shape), jnp.ones(shape), jnp.zeros(()))

    def with_rows(self, rows: Any) -> Statistics:
        """Also of ``rows`` ``(n, ...)``."""
        added, spread, n = rows.mean(0), rows.var(0), rows.shape[0]
        count, apart = self.count + n, added - self.mean
        among = self.variance * self.count + spread * n + apart**2 * self.count * n / count
        return Statistics(self.mean + apart * n / count, among / count, count)


class Moments(NamedTuple):
    """First and second moments of gradients, and of how many (Adam)."""

    first: Any
    second: Any
    count: Any


class Learning(NamedTuple):
    """Everything that the rest of a training depends on, besides settings and seed: arrays in a tree."""

    weights: Any
    moments: Moments
    columns: Statistics
    returns: Statistics
    state: State
    observation: Any
    stock: Any
    begun: Any
    discounted: Any


@dataclass(frozen=True)
class Learner:
    """The compiled learner of a task: ``begin`` a training, and ``update`` it.

    ``update(learning, key, share)`` gives what follows and the mean reward of its steps, without what is paid for training alone; ``share``
    is how much of the training is over, 0 to 1.
    """

    settings: CompiledSettings
    environment: Environment
    least_scale: NDArray[np.float32]

    @classmethod
    def of(cls, task: TaskSpec, settings: CompiledSettings) -> Learner:
        """The learner for a task.

        Raises
        ------
        TrainingError
            When the settings name a column or a state that the task does not have.
        TaskError
            When the compiled kernel cannot step the task.
        """
        names = [column.name for column in task.observed()]
        least = np.full(len(names), _LEAST, np.float32)
        for name, value in settings.least_scale.items():
            if name in names:
                least[names.index(name)] = value
        accrual = settings.accrual
        if accrual is not None and accrual.state not in task.model_value.state_names:
            near = did_you_mean(accrual.state, task.model_value.state_names)
            msg = f"'accrual.state: {accrual.state}': the model of {task.id} has no such state.{near}"
            raise TrainingError(msg)
        environment = Environment(
            task,
            settings.kernel_preset,
            seeds=settings.seeds,
            places=settings.places,
            info=() if accrual is None else (accrual.state,),
        )
        return cls(settings, environment, least)

    def begin(self, key: Any) -> Learning:
        """An untrained learner, its greenhouses spread over seasons."""
        s, environment = self.settings, self.environment
        columns, actions = environment.obs_shape[0], environment.num_actions
        keys = jax.random.split(key, 3)
        weights = {
            "actor": _network(keys[0], [columns, *s.net_arch, actions], last=0.01),
            "critic": _network(keys[1], [columns, *s.net_arch, 1], last=1.0),
            "spread": jnp.full(actions, s.log_std_init),
        }
        nothing = jax.tree.map(jnp.zeros_like, weights)
        observation, state = jax.vmap(environment.reset)(jax.random.split(keys[2], s.n_envs))
        none = jnp.zeros(s.n_envs)
        return Learning(
            weights,
            Moments(nothing, nothing, jnp.zeros((), jnp.int32)),
            Statistics.begun(columns),
            Statistics.begun(),
            state,
            observation,
            none,
            jnp.ones(s.n_envs, jnp.bool_),
            none,
        )

    def scale(self, columns: Statistics) -> Any:
        """What the columns of observations are divided by."""
        return jnp.sqrt(columns.variance + self.least_scale**2)

    def update(self, learning: Learning, key: Any, share: Any) -> tuple[Learning, Any]:
        """One rollout, and what is learnt from it."""
        s = self.settings
        keys = jax.random.split(key, s.n_steps + s.n_epochs)

        def step(learning: Learning, key: Any) -> Any:
            return self._step(learning, key)

        after, told = jax.lax.scan(step, learning, keys[: s.n_steps])
        seen, action, likelihood, value, reward, paid, done, discounted, raw = told
        returns = learning.returns.with_rows(discounted.reshape(-1))
        limit = s.normalize.clip_rewards
        scaled = jnp.clip(paid / jnp.sqrt(returns.variance + _TINY), -limit, limit)
        last = _apply(learning.weights["critic"], self._seen(learning.columns, after.observation))[:, 0]
        gain = self._advantages(value, scaled, done, last)
        rows = jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), (seen, action, likelihood, gain, gain + value))
        rate = s.learning_rate + (s.last_learning_rate - s.learning_rate) * share

        def batch(learner: Any, chosen: Any) -> Any:
            weights, moments = learner
            gradient = jax.grad(self._loss)(weights, jax.tree.map(lambda a: a[chosen], rows))
            return self._adam(weights, moments, gradient, rate), None

        def epoch(learner: Any, key: Any) -> Any:
            return jax.lax.scan(batch, learner, jax.random.permutation(key, s.rollout).reshape(-1, s.batch_size))

        (weights, moments), _ = jax.lax.scan(epoch, (after.weights, after.moments), keys[s.n_steps :])
        columns = learning.columns.with_rows(raw.reshape(s.rollout, -1))
        return after._replace(weights=weights, moments=moments, columns=columns, returns=returns), reward.mean()

    def _seen(self, columns: Statistics, observation: Any) -> Any:
        limit = self.settings.normalize.clip_observations
        return jnp.clip((observation - columns.mean) / self.scale(columns), -limit, limit)

    def _step(self, now: Learning, key: Any) -> Any:
        """One step of all greenhouses with the noise of exploration."""
        s, keys = self.settings, jax.random.split(key, self.settings.n_envs + 1)
        seen = self._seen(now.columns, now.observation)
        mean, spread = _apply(now.weights["actor"], seen), now.weights["spread"]
        action = mean + jnp.exp(spread) * jax.random.normal(keys[0], mean.shape)
        observation, state, reward, done, info = jax.vmap(self.environment.step)(keys[1:], now.state, action)
        paid, stock = reward, now.stock
        if s.accrual is not None:
            stock = info[s.accrual.state]
            paid += jnp.where(
                now.begun, 0.0, s.accrual.price * (stock - now.stock)
            )  # what was there at first is not known
        discounted = now.discounted * s.gamma + paid
        value = _apply(now.weights["critic"], seen)[:, 0]
        likelihood = _log_likelihood(mean, spread, action)
        after = now._replace(
            state=state,
            observation=observation,
            stock=stock,
            begun=done,
            discounted=jnp.where(done, 0.0, discounted),
        )
        return after, (seen, action, likelihood, value, reward, paid, done, discounted, now.observation)

    def _advantages(self, value: Any, reward: Any, done: Any, last: Any) -> Any:
        """Generalised advantages ``(steps, envs)``; the end of a season is an end, nothing comes after it."""
        s = self.settings

        def back(carry: Any, now: Any) -> Any:
            advantage, following = carry
            value, reward, going = now
            advantage = reward + s.gamma * following * going - value + s.gamma * s.gae_lambda * going * advantage
            return (advantage, value), advantage

        told = value, reward, 1.0 - done
        return jax.lax.scan(back, (jnp.zeros_like(last), last), told, reverse=True)[1]

    def _loss(self, weights: Any, batch: Any) -> Any:
        s = self.settings
        seen, action, before, gain, target = batch
        gain = (gain - gain.mean()) / (gain.std() + _TINY)
        ratio = jnp.exp(_log_likelihood(_apply(weights["actor"], seen), weights["spread"], action) - before)
        bounded = jnp.clip(ratio, 1.0 - s.clip_range, 1.0 + s.clip_range)
        wrong = ((_apply(weights["critic"], seen)[:, 0] - target) ** 2).mean()
        return (
            s.vf_coef * wrong - jnp.minimum(ratio * gain, bounded * gain).mean() - s.ent_coef * weights["spread"].sum()
        )

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


def _network(key: Any, sizes: Sequence[int], last: float) -> list[tuple[Any, Any]]:
    """Weights and biases of a perceptron: orthogonal, those of the last layer of size ``last``."""
    sizes_of = list(pairwise(sizes))
    gains = [math.sqrt(2.0)] * (len(sizes_of) - 1) + [last]
    keys = jax.random.split(key, len(gains))
    return [
        (jax.nn.initializers.orthogonal(gain)(one, size, jnp.float32), jnp.zeros(size[1]))
        for one, size, gain in zip(keys, sizes_of, gains, strict=True)
    ]


def _apply(network: list[tuple[Any, Any]], x: Any) -> Any:
    for weights, bias in network[:-1]:
        x = jnp.tanh(x @ weights + bias)
    return x @ network[-1][0] + network[-1][1]


def _log_likelihood(mean: Any, spread: Any, action: Any) -> Any:
    return (-0.5 * ((action - mean) / jnp.exp(spread)) ** 2 - spread - 0.5 * math.log(2.0 * math.pi)).sum(-1)
